#include "experiments/cli/ik_stream.hpp"

#include <fmt/format.h>

#include <csignal>
#include <cstdio>
#include <iostream>
#include <nlohmann/json.hpp>

#include "experiments/cli/print.hpp"
#include "reports/ik_target.hpp"
#include "sim/core/error.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

using Json = nlohmann::ordered_json;

/// Signals that ask the command to end do so while it waits for a line, too.
void end_waiting_when_interrupted() {
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    struct sigaction action {};
    sigaction(signal, nullptr, &action);
    action.sa_flags &= ~SA_RESTART;
    sigaction(signal, &action, nullptr);
  }
}

}  // namespace

std::string unit_of(const ControlSettings& control) {
  return units_of(control.quantity).front();
}

Json json_of(const Simulation& simulation, const Robot& robot, const IkAnswer& answer) {
  const IkResult& result = answer.result;
  Json one;
  one["status"] = name_of(result.status);
  one["message"] = result.message;
  for (size_t j = 0; j < answer.free.size() && result.controls.size() > 0; ++j) {
    const ControlSettings& control = simulation.controls[answer.free[j]];
    one["controls"][control.id] = {{"value", result.controls[static_cast<Eigen::Index>(j)]},
                                   {"unit", unit_of(control)},
                                   {"bound", result.bound[j]}};
  }
  for (size_t i = 0; i < answer.achieved.size(); ++i) {
    one["channels"][answer.channels[i]] = {{"wanted", answer.wanted[i]},
                                           {"achieved", answer.achieved[i]},
                                           {"unit", robot.reading(answer.channels[i]).unit}};
  }
  if (answer.u.size() > 0) one["error_m"] = result.error;
  if (result.stiffness > 0) one["stiffness_N_per_m"] = result.stiffness;
  one["iterations"] = result.iterations;
  one["equilibria"] = result.solves;
  one["factorisations"] = result.factorisations;
  one["seconds"] = result.seconds;
  return one;
}

int stream_targets(const Simulation& simulation, const CommandOptions& options) {
  if (!options.name.empty() || !options.out.empty())
    throw InputError("--stream takes its targets from stdin and writes no folder; leave --target and --out out");
  const Robot robot = make_robot(simulation);
  RobotIk ik(simulation, robot, options.stop);
  end_waiting_when_interrupted();
  int number = 0;
  for (std::string text; std::getline(std::cin, text) && !options.interrupted();) {
    ++number;
    if (trimmed(text).empty()) continue;
    const Stopwatch stopwatch;
    Json answer;
    try {
      const Json line = Json::parse(text, nullptr, false);
      if (line.is_object() && line.contains("name")) answer["name"] = line["name"];
      const IkTarget target = read_ik_target(text, simulation, fmt::format("line {}", number));
      answer.update(json_of(simulation, robot, ik.solve(target)));
      answer["milliseconds"] = 1e3 * stopwatch.seconds();
    } catch (const InputError& error) {
      answer["error"] = error.what();
    }
    print_json(answer, -1);
    std::fflush(stdout);
  }
  return options.interrupted() ? exit_interrupted : exit_ok;
}

}  // namespace taut

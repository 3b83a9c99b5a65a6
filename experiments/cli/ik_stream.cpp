#include "experiments/cli/ik_stream.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <iostream>
#include <nlohmann/json.hpp>

#include "experiments/cli/print.hpp"
#include "sim/core/error.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

using Json = nlohmann::ordered_json;

/// A number in SI, or text with a unit.
double value_of(const Json& value, Quantity quantity, const std::string& where) {
  if (value.is_number()) return value.get<double>();
  if (value.is_string()) return parse_quantity(value.get<std::string>(), quantity, where);
  const std::string unit = units_of(quantity).front();
  throw InputError(
      fmt::format("{}: a number in {} or text with a unit belongs here, for example \"1 {}\"", where, unit, unit));
}

/// The entry of `list` with this id.
template <class Entry>
const Entry& known(const std::vector<Entry>& list, const std::string& id, const std::string& where, const char* what) {
  const auto found = std::ranges::find(list, id, &Entry::id);
  if (found != list.end()) return *found;
  std::vector<std::string> ids;
  for (const Entry& entry : list) ids.push_back(entry.id);
  throw InputError(fmt::format("{}: '{}' is not {}{}; allowed: {}", where, id, what, did_you_mean(id, ids), join(ids)));
}

/// "hold" and "stiffness": an object of ids.
const Json& object_of(const Json& value, const std::string& where) {
  if (!value.is_object())
    throw InputError(fmt::format("{}: an object belongs here, for example {{\"ID\": \"1 ...\"}}", where));
  return value;
}

IkTarget target_of(const Json& line, const Simulation& simulation, const std::string& where) {
  IkTarget target;
  std::vector<ChannelSettings> channels;
  std::ranges::copy_if(simulation.channels, std::back_inserter(channels),
                       [](const ChannelSettings& one) { return target_quantity(one).has_value(); });
  for (const auto& [key, value] : line.items()) {
    const std::string at = fmt::format("{}: {}", where, key);
    if (key == "hold") {
      for (const auto& [id, held] : object_of(value, at).items()) {
        known(simulation.ik->controls, id, at, "a control of [ik]");
        target.hold[id] = value_of(held, known(simulation.controls, id, at, "a control").quantity, at + "." + id);
      }
    } else if (key == "stiffness") {
      for (const auto& [id, wanted] : object_of(value, at).items()) {
        if (target_quantity(known(channels, id, at, "a channel of a place")) != Quantity::length || value.size() != 1)
          throw InputError(fmt::format("{}: one stiffness along one place belongs here", at));
        target.stiffness_of = id;
        target.stiffness = value_of(wanted, Quantity::stiffness, at + "." + id);
        if (!(target.stiffness > 0)) throw InputError(fmt::format("{}: the stiffness must be positive", at));
      }
    } else if (key != "name") {
      const Quantity quantity = *target_quantity(known(channels, key, where, "a channel of a place or angle"));
      target.values[key] = {value_of(value, quantity, at)};
    }
  }
  if (target.values.empty())
    throw InputError(fmt::format("{}: a target needs the value of a channel, for example {{\"{}\": \"1 {}\"}}", where,
                                 channels.empty() ? "tip_x" : channels.front().id,
                                 channels.empty() ? "m" : units_of(*target_quantity(channels.front())).front()));
  if (target.hold.size() == simulation.ik->controls.size())
    throw InputError(fmt::format("{}: all controls are held; leave one free at least", where));
  return target;
}

/// Signals that ask the command to end do so while it waits for a line, too.
void end_waiting_when_interrupted() {
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    struct sigaction action {};
    sigaction(signal, nullptr, &action);
    action.sa_flags &= ~SA_RESTART;
    sigaction(signal, &action, nullptr);
  }
}

/// The object that a line holds.
Json object_on(const std::string& line, const std::string& where) {
  Json json = Json::parse(line, nullptr, false);
  if (!json.is_object())
    throw InputError(fmt::format(
        "{}: this is no JSON object; a target looks like {{\"tip_x\": \"170 mm\", \"tip_y\": 0.06}}", where));
  return json;
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
      const std::string where = fmt::format("line {}", number);
      const Json line = object_on(text, where);
      if (line.contains("name")) answer["name"] = line["name"];
      answer.update(json_of(simulation, robot, ik.solve(target_of(line, simulation, where))));
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

#include "experiments/cli/simulate_command.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <boost/program_options.hpp>
#include <cmath>
#include <nlohmann/json.hpp>

#include "calib/data/files.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "experiments/cli/sensitivity_output.hpp"
#include "reports/simulation_run.hpp"
#include "sim/core/error.hpp"
#include "sim/files/simulation.hpp"
#include "sim/robots/simulate.hpp"
#include "sim/solve/reduction.hpp"

namespace taut {
namespace {

namespace po = boost::program_options;

nlohmann::ordered_json summary_json(const SimulationRecord& record) {
  nlohmann::ordered_json json;
  json["title"] = record.title;
  json["simulated"] = true;
  for (const auto& [label, text] : record.facts) json["facts"][label] = text;
  for (const Series& series : record.channels) {
    const auto [least, most] = std::minmax_element(series.values.begin(), series.values.end());
    json["channels"][series.id] = {
        {"unit", series.unit}, {"min", *least}, {"max", *most}, {"end", series.values.back()}};
  }
  for (const auto& workspace : record.workspaces) {
    json["workspace_m2"][workspace.mode] = workspace.area;
    json["workspace_error_m2"][workspace.mode] = workspace.area_error;
  }
  return json;
}

/// As people say it: angles in degrees.
std::string summary_text(double value, const std::string& unit) {
  return unit == "rad" ? fmt::format("{:.4g} deg", value * 180 / M_PI) : with_unit(value, unit);
}

void print_summary(const SimulationRecord& record) {
  fmt::print("{} (a simulation)\n", record.title);
  for (const auto& [label, text] : record.facts) fmt::print("{:<18} {}\n", label, text);
  fmt::print("{:<22} {:>14} {:>14} {:>14}\n", "channel", "least", "most", "end");
  for (const Series& series : record.channels) {
    const auto [least, most] = std::minmax_element(series.values.begin(), series.values.end());
    fmt::print("{:<22} {:>14} {:>14} {:>14}\n", series.id, summary_text(*least, series.unit),
               summary_text(*most, series.unit), summary_text(series.values.back(), series.unit));
  }
  for (const auto& workspace : record.workspaces)
    fmt::print("workspace {:<12} {:.4g} +- {:.2g} cm2 (half of the samples, or a finer outline)\n", workspace.mode,
               1e4 * workspace.area, 1e4 * workspace.area_error);
}

/// What was asked for besides the run, as facts.
void add_sensitivity_facts(const Robot& robot, const SimulationSensitivities& wanted, const SimulationResult& result,
                           SimulationRecord& record) {
  if (wanted.all_readings)
    record.facts.emplace_back("sensitivities",
                              fmt::format("of {} channels with respect to {} parameters at {} times: sensitivities.csv",
                                          robot.readings.size(), wanted.parameters.size(), result.derivatives.size()));
  if (!wanted.goals.empty() && result.goal_samples.empty())
    record.facts.emplace_back("gradient", "none: the run ended before the goal's time");
}

/// Runs a simulation file: states as VTU, channels as CSV, figures, a strip, an animation and report.html in a run
/// folder; a summary on stdout.
int simulate_main(const CommandOptions& options) {
  if (!is_simulation(options.target))
    throw InputError(
        fmt::format("{}: this is an experiment with a bench, not a simulation (there is no [simulation]); "
                    "use `taut replay` or `taut fit`",
                    options.target));
  const Simulation simulation = read_simulation(options.target);
  Progress progress(options.quiet);
  const Robot robot = make_robot(simulation);
  RunFolder folder(run_folder(options), RunFolder::Kind::simulation);
  progress.say(fmt::format("{}: {} unknowns", simulation.title, robot.scene.model->free_unknowns()));
  SimulateOptions simulate_options;
  simulate_options.stop = options.stop;
  simulate_options.sensitivities = read_sensitivities(options, simulation, robot);
  simulate_options.progress = [&](double t, const SimulationResult& so_far) {
    progress.show(
        fmt::format("{} of {}, {} steps", with_unit(t, "s"), with_unit(simulation.duration, "s"), so_far.steps));
  };
  const SimulationResult result = simulate(simulation, robot, simulate_options);
  if (result.times.empty()) {
    fmt::print(stderr, "taut: {}: {}\n", simulation.path, result.failure);
    return result.interrupted ? exit_interrupted : exit_solve;
  }
  SimulationRecord record = make_simulation_record(simulation, robot, result, program_of(options));
  const SimulationSensitivities& wanted = simulate_options.sensitivities;
  add_sensitivity_facts(robot, wanted, result, record);
  if (result.failure.empty())
    add_workspaces(
        simulation, robot, [&](const std::string& line) { progress.say(line); }, options.stop, record);
  const bool stopped = result.interrupted || options.interrupted();
  if (stopped && folder.finished()) {
    progress.say(fmt::format("interrupted; the finished run in {} stays as it is", folder.path()));
    return exit_interrupted;
  }
  if (wanted.all_readings) write_file(folder.next() + "/sensitivities.csv", sensitivities_csv(robot, wanted, result));
  publish(record, folder, stopped);
  if (options.json) {
    nlohmann::ordered_json json = summary_json(record);
    add_sensitivities(simulation, robot, wanted, result, json);
    print_json(json);
  } else {
    print_summary(record);
    fmt::print("{}", goal_table(simulation, robot, wanted, result));
  }
  progress.say(fmt::format("report: {}/report.html", folder.path()));
  if (stopped) return exit_interrupted;
  const bool unsound = result.smallest_jacobian <= 0 || result.intersecting > 0;
  return result.failure.empty() && !unsound ? exit_ok : exit_solve;
}

void add_simulate_options(AddOption add, CommandOptions& options) {
  add_out(add, options);
  add("sensitivities", po::bool_switch(&options.sensitivities),
      "derivatives of all channels at every time with respect to parameters and controls: sensitivities.csv");
  add("goal", po::value(&options.goal)->value_name("CHANNEL[@TIME]"),
      "gradient of this channel at the end, or at a time (tip_x@\"20 ms\")");
  add("wrt", po::value(&options.wrt)->value_name("ID,ID,..."),
      "parameters of both; default: all. A control counts as an offset of its whole schedule");
}

}  // namespace

int check_simulation(const CommandOptions& options) {
  const Simulation simulation = read_simulation(options.target);
  const Robot robot = make_robot(simulation);
  const Mesh& mesh = robot.scene.model->mesh();
  std::vector<std::pair<std::string, std::string>> lines;
  for (const Part& part : mesh.parts)
    lines.emplace_back("body " + part.name, fmt::format("{} elements, {} nodes", part.element_count, part.node_count));
  for (const std::string& remark : mesh.remarks) lines.emplace_back("mesh", remark);
  if (const std::string text = blind_patches(robot); !text.empty()) lines.emplace_back("no contact of", text);
  if (!simulation.encoding.empty()) lines.emplace_back("file", simulation.encoding);
  lines.emplace_back("unknowns", fmt::format("{}", Reduction(*robot.scene.model).size()));
  lines.emplace_back("time integration",
                     integrator_text(simulation) + fmt::format(", {} in all", with_unit(simulation.duration, "s")));
  for (size_t k = 0; k < robot.controls.size(); ++k) {
    const ControlSettings& control = simulation.controls[k];
    const std::string unit = units_of(control.quantity).front();
    lines.emplace_back("control " + control.id,
                       fmt::format("{} at the start, {} at the end", with_unit(simulation.schedules[k].at(0), unit),
                                   with_unit(simulation.schedules[k].at(simulation.duration), unit)));
  }
  for (const SceneReading& reading : robot.readings) lines.emplace_back("channel " + reading.id, reading.meaning);
  if (options.json) {
    nlohmann::ordered_json json;
    json["title"] = simulation.title;
    for (const auto& [label, text] : lines) json[label] = text;
    print_json(json);
    return exit_ok;
  }
  fmt::print("{} (a simulation)\n", simulation.title);
  for (const auto& [label, text] : lines) fmt::print("{:<24} {}\n", label, text);
  return exit_ok;
}

Command simulate_command() {
  return {"simulate",
          "SIMULATION",
          "Runs a simulation over time or through equilibria: states, plots, animation and report.",
          "  taut simulate experiments/ball_impact/experiment.toml\n"
          "  taut simulate experiments/finger_bend/experiment.toml --goal tip_angle --json\n",
          add_simulate_options,
          simulate_main};
}

}  // namespace taut

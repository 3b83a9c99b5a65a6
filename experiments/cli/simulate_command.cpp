#include "experiments/cli/simulate_command.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <boost/program_options.hpp>
#include <cmath>
#include <nlohmann/json.hpp>

#include "calib/data/files.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "experiments/cli/provenance.hpp"
#include "experiments/cli/sensitivity_output.hpp"
#include "reports/run_record.hpp"
#include "reports/simulation_report.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/files/simulation.hpp"
#include "sim/robots/simulate.hpp"
#include "sim/robots/workspace.hpp"
#include "sim/solve/reduction.hpp"

namespace taut {
namespace {

namespace po = boost::program_options;

std::string integrator_text(const Simulation& simulation) {
  const std::string steps = simulation.tolerance > 0
                                ? fmt::format("steps up to {}, error of a step kept at {:.2g} of the scene's size",
                                              with_unit(simulation.step, "s"), simulation.tolerance)
                                : fmt::format("steps of {}", with_unit(simulation.step, "s"));
  switch (simulation.method) {
    case SimulationMethod::quasi_static:
      return fmt::format("equilibria at {} intervals; no inertia", with_unit(simulation.step, "s"));
    case SimulationMethod::implicit_euler:
      return "implicit Euler (order 1), " + steps +
             fmt::format("; it damps a motion of frequency f by the ratio pi f h, {:.2g} at 10 Hz",
                         M_PI * 10 * simulation.step);
    case SimulationMethod::bdf2:
      return "BDF2 (order 2), " + steps;
    case SimulationMethod::cvode:
      return fmt::format("CVODE (BDF), outputs every {}", with_unit(simulation.step, "s"));
    case SimulationMethod::arkode_implicit:
      return fmt::format("ARKODE (implicit Runge-Kutta), outputs every {}", with_unit(simulation.step, "s"));
    case SimulationMethod::arkode_explicit:
      return fmt::format("ARKODE (explicit Runge-Kutta), outputs every {}", with_unit(simulation.step, "s"));
  }
  return "";
}

/// Where joined bodies do not see each other; "": there is no such place.
std::string blind_patches(const Robot& robot) {
  std::string text;
  for (const JoinedParts& joined : robot.joined) {
    if (joined.radius > 0)
      text += fmt::format("{}'{}' within {}", text.empty() ? "bodies that overlap about the pin of " : ", ",
                          joined.joint, with_unit(joined.radius, "m"));
  }
  return text;
}

/// Where the scene jumped from one path of equilibria to another.
std::string slips_text(const SimulationResult& result) {
  std::string when;
  constexpr size_t most = 3;
  for (size_t k = 0; k < std::min(most, result.slips.size()); ++k)
    when += fmt::format("{}at {} (by {})", k == 0 ? "" : ", ", with_unit(result.slips[k].t, "s"),
                        with_unit(result.slips[k].jump, "m"));
  if (result.slips.size() > most) when += fmt::format(" and {} more", result.slips.size() - most);
  return fmt::format(
      "YES: {}: the path of equilibria ends there and the scene jumps to another one; to which, inertia decides "
      "(integrator = \"bdf2\"), not statics",
      when);
}

/// What an independent test says of all accepted states, and what a run took.
void add_facts(const Simulation& simulation, const Robot& robot, const SimulationResult& result,
               SimulationRecord& record) {
  const auto add = [&](const char* label, const std::string& text) { record.facts.emplace_back(label, text); };
  const Mesh& mesh = robot.scene.model->mesh();
  const size_t states = result.states.size();
  add("model", fmt::format("{} {}, {} {} elements, {} unknowns", mesh.parts.size(),
                           mesh.parts.size() == 1 ? "body" : "bodies", mesh.element_count(),
                           order_of(mesh.shape) == 1 ? "linear" : "quadratic", Reduction(*robot.scene.model).size()));
  if (simulation.rigid_segments)
    add("rigid", fmt::format("{}: over 100 times as stiff as the softest region and taken not to deform; how much that "
                             "changes is not estimated here: compare with model = \"full\"",
                             join(rigid_regions(simulation), " and ")));
  add("time integration", integrator_text(simulation));
  add("took", fmt::format("{:.3g} s for {}: {} steps, {} repeated, {} Newton iterations, {} factorisations",
                          result.seconds, with_unit(result.times.back(), "s"), result.steps, result.repeated,
                          result.iterations, result.factorisations));
  if (!result.failure.empty()) add("ended early", result.failure);
  if (result.saddles_left > 0)
    add("buckling",
        fmt::format("{} equilibria were reached by leaving an unstable one{}", result.saddles_left,
                    result.side.empty()
                        ? ""
                        : "; symmetric bifurcation: the side was chosen by a fixed rule, towards " + result.side));
  if (!result.slips.empty()) add("slips", slips_text(result));
  add("inverted elements", result.smallest_jacobian > 0
                               ? fmt::format("none in {} states; smallest J = {:.3g}", states, result.smallest_jacobian)
                               : fmt::format("YES: smallest J = {:.3g}", result.smallest_jacobian));
  if (robot.intersects && result.intersecting > 0) {
    add("intersections", fmt::format("YES: in {} of {} states", result.intersecting, states));
  } else if (robot.intersects) {
    const bool near = std::isfinite(result.smallest_distance);
    add("intersections",
        fmt::format("none in {} states, by an exact test afterwards; smallest distance {}", states,
                    (near ? "" : "over ") + with_unit(near ? result.smallest_distance : 0.01 * mesh.diagonal(), "m")));
  }
  if (!robot.joints.empty())
    add("joints", fmt::format("largest gap {}, largest motor error {:.3g} deg",
                              with_unit(result.largest_joint_gap, "m"), result.largest_motor_error * 180 / M_PI));
}

/// Frames evenly over time; steps need not be even.
void add_frames(const Simulation& simulation, const SimulationResult& result, SimulationRecord& record) {
  const int frames = std::min(simulation.frames, static_cast<int>(result.times.size()));
  for (int i = 0; i < frames; ++i) {
    const double t = result.times.back() * i / std::max(1, frames - 1);
    const auto at = std::lower_bound(result.times.begin(), result.times.end(), t - 1e-12) - result.times.begin();
    if (!record.frames.empty() && record.frames.back() >= at) continue;
    record.frames.push_back(static_cast<int>(at));
    add_state(simulation, result.states[static_cast<size_t>(at)], record);
  }
}

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

/// How a workspace was sampled.
std::string samples_text(const WorkspaceResult& reached) {
  std::string text = fmt::format("{} equilibria", reached.samples);
  if (reached.mirrored >= 0)
    text += fmt::format(", each counted mirrored in {} as well, as the scene is symmetric", "xy"[reached.mirrored]);
  if (!reached.holds.empty()) text += fmt::format(", and those of {}", join(reached.holds, " and "));
  if (reached.failures > 0) text += fmt::format("; {} samples had no equilibrium and are left out", reached.failures);
  if (reached.slips > 0)
    text +=
        fmt::format("; {} were reached by a jump to another equilibrium, on no path that leads back", reached.slips);
  return text;
}

/// Samples the workspaces that the file asks for.
void add_workspaces(const Simulation& simulation, const Robot& robot, const CommandOptions& options, Progress& progress,
                    SimulationRecord& record) {
  const auto tell = [&](const std::string& mode) { progress.say(fmt::format("workspace of mode {}", mode)); };
  for (const WorkspaceResult& reached : sample_workspaces(simulation, robot, tell, options.stop)) {
    record.facts.emplace_back("workspace " + reached.mode, samples_text(reached));
    record.workspaces.push_back({reached.mode, reached.points, reached.area, reached.area_error, reached.outline});
  }
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
  SimulationRecord record = make_simulation_record(simulation, robot, result, options);
  const SimulationSensitivities& wanted = simulate_options.sensitivities;
  add_sensitivity_facts(robot, wanted, result, record);
  if (simulation.workspace && result.failure.empty()) add_workspaces(simulation, robot, options, progress, record);
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

int carriers_of(const Simulation& simulation) {
  return static_cast<int>(std::ranges::count_if(simulation.contact.grounds,
                                                [](const GroundSettings& ground) { return !ground.control.empty(); }));
}

void add_state(const Simulation& simulation, const Eigen::VectorXd& u, SimulationRecord& record) {
  const int d = record.mesh.dimension();
  Eigen::Index carrier = record.mesh.X.size();
  record.states.push_back(u.head(carrier));
  for (size_t k = 0; k < record.grounds.size(); ++k) {
    if (simulation.contact.grounds[k].control.empty()) continue;
    record.grounds[k].moved.push_back(u.segment(carrier, d));
    carrier += d;
  }
}

SimulationRecord start_simulation_record(const Simulation& simulation, const Robot& robot,
                                         const CommandOptions& options) {
  SimulationRecord record;
  record.name = file_name_of(experiment_name(simulation.path));
  record.title = simulation.title;
  record.description = simulation.description;
  record.at_rest = simulation.method == SimulationMethod::quasi_static;
  record.mesh = robot.scene.model->mesh();
  for (const std::string& remark : record.mesh.remarks) record.facts.emplace_back("mesh", remark);
  if (const std::string text = blind_patches(robot); !text.empty()) record.facts.emplace_back("no contact of", text);
  for (size_t k = 0; k < robot.cables.size(); ++k)
    record.lines.push_back({simulation.cables.cables[k].id, robot.cables[k].points});
  for (const std::vector<Eigen::Vector2d>& line : simulation.contact.obstacles)
    record.obstacles.emplace_back(line.begin(), line.end());
  for (const GroundSettings& ground : simulation.contact.grounds)
    record.grounds.push_back({ground.point, ground.normal, ground.kind, ground.radius});
  // Nodes of no element only carry grounds.
  record.mesh.X.conservativeResize(record.mesh.X.size() - record.mesh.dimension() * carriers_of(simulation));
  for (const ControlSettings& control : simulation.controls)
    record.controls.push_back({control.id, units_of(control.quantity).front(), control.id, {}});
  for (const SceneReading& reading : robot.readings)
    record.channels.push_back({reading.id, reading.unit, reading.meaning, {}});
  record.command_line = options.command_line;
  record.version = fmt::format("{} ({})", version(), commit());
  record.experiment_text = read_file(simulation.path);
  return record;
}

SimulationRecord make_simulation_record(const Simulation& simulation, const Robot& robot,
                                        const SimulationResult& result, const CommandOptions& options) {
  SimulationRecord record = start_simulation_record(simulation, robot, options);
  record.samples = result.times;
  for (size_t k = 0; k < record.controls.size(); ++k) record.controls[k].values = result.controls[k];
  for (size_t k = 0; k < record.channels.size(); ++k) record.channels[k].values = result.readings[k];
  if (simulation.method != SimulationMethod::quasi_static) {
    record.channels.push_back({"kinetic_energy", "J", "kinetic energy", result.kinetic});
    record.channels.push_back({"potential_energy", "J", "potential energy", result.potential});
  }
  add_frames(simulation, result, record);
  for (const RobotPlot& plot : simulation.plots) record.plots.push_back({plot.id, plot.title, plot.x, plot.y});
  add_facts(simulation, robot, result, record);
  return record;
}

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

void publish(const SimulationRecord& record, RunFolder& folder, bool stopped) {
  if (stopped) folder.mark_unfinished();
  try {
    write_simulation(record, folder.next());
  } catch (const InputError&) {
    folder.publish();
    throw;
  }
  folder.publish();
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

#include <fmt/format.h>

#include <algorithm>
#include <boost/program_options.hpp>
#include <nlohmann/json.hpp>

#include "calib/data/files.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "reports/axes.hpp"
#include "reports/simulation_run.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"
#include "sim/files/simulation.hpp"
#include "sim/files/simulation_text.hpp"
#include "sim/robots/optimise.hpp"

namespace taut {
namespace {

using Aim = OptimiseGoal::Aim;

constexpr std::string_view optimised_suffix = "_optimised";  ///< of the record's name, and so of its files

/// What was found, with the simulation whose controls it has.
struct Optimised {
  const Simulation& simulation;
  const Robot& robot;
  const ControlObjective objective;
  const OptimiseResult& result;

  std::string unit_of(const ControlObjective::Target& target) const {
    return units_of(simulation.controls[target.control].quantity).front();
  }
  const ControlSchedule::Piece& piece_of(const ControlObjective::Target& target) const {
    return simulation.schedules[target.control].pieces()[target.piece];
  }
};

std::string aim_text(const OptimiseGoal& goal, const std::string& unit) {
  switch (goal.aim) {
    case Aim::maximise:
      return "maximise";
    case Aim::minimise:
      return "minimise";
    case Aim::reach:
      break;
  }
  return "reach " + with_unit(goal.value, unit);
}

/// In the unit of files, so that values stand below each other: "-35.52 deg".
std::string in_written_unit(double value, const std::string& si_unit) {
  const WrittenUnit unit = written_unit(si_unit);
  return fmt::format("{:.4g} {}", value / unit.factor, unit.label);
}

std::string goal_text(const Optimised& found, size_t g) {
  const std::string& unit = found.robot.reading(found.simulation.optimise->goals[g].channel).unit;
  const OptimiseResult& result = found.result;
  return fmt::format("{}, before {}", with_unit(result.value.goals[g], unit),
                     with_unit(result.before_value.goals[g], unit));
}

std::string goal_label(const Optimised& found, size_t g) {
  const OptimiseGoal& goal = found.simulation.optimise->goals[g];
  return fmt::format("{} {} at {}", aim_text(goal, found.robot.reading(goal.channel).unit), goal.channel,
                     with_unit(goal.time, "s"));
}

std::string objective_text(const Optimised& found) {
  const OptimiseResult& result = found.result;
  return fmt::format("{:.6g}, of which {:.4g} effort; before {:.6g}, {:.4g}", result.value.objective,
                     result.value.effort, result.before_value.objective, result.before_value.effort);
}

std::string took_text(const OptimiseResult& result) {
  return fmt::format("{:.3g} s for {} simulations with gradients", result.seconds, result.simulations);
}

/// The run with the found controls, the controls of the file beside them.
SimulationRecord make_optimised_record(const Optimised& found, const std::string& text, const CommandOptions& options) {
  const OptimiseResult& result = found.result;
  SimulationRecord record =
      make_simulation_record(found.simulation, found.robot, result.value.run, program_of(options));
  record.name += optimised_suffix;
  record.title += ": optimised controls";
  record.experiment_text = text;
  for (const OptimiseRange& range : found.simulation.optimise->controls) {
    const auto k =
        static_cast<size_t>(std::ranges::find(record.controls, range.id, &Series::id) - record.controls.begin());
    Series before{range.id + "_before", record.controls[k].unit, range.id + " before", {}};
    const auto taken = [&](const Series& one) { return one.id == before.id; };  // by a channel of that name
    while (std::ranges::any_of(record.channels, taken) || std::ranges::any_of(record.controls, taken)) before.id += "_";
    for (const double t : record.samples) before.values.push_back(found.simulation.schedules[k].at(t));
    record.plots.push_back({range.id + "_optimised", range.id + " before and after", "", {range.id, before.id}});
    record.controls.push_back(std::move(before));
  }
  std::vector<std::pair<std::string, std::string>> facts{{"search", result.message}};
  for (size_t g = 0; g < result.value.goals.size(); ++g) facts.emplace_back(goal_label(found, g), goal_text(found, g));
  facts.emplace_back("objective", objective_text(found));
  facts.emplace_back("search took", took_text(result));
  record.facts.insert(record.facts.begin(), facts.begin(), facts.end());
  return record;
}

void print_optimised(const Optimised& found) {
  const OptimiseResult& result = found.result;
  fmt::print("{} (trajectory optimisation of a simulation)\n{}\n", found.simulation.title, result.message);
  for (size_t g = 0; g < result.value.goals.size(); ++g)
    fmt::print("{}: {}\n", goal_label(found, g), goal_text(found, g));
  fmt::print("objective: {}\ntook {}\n", objective_text(found), took_text(result));
  fmt::print("{:<16} {:>10} {:>14} {:>14}\n", "control", "until", "before", "found");
  for (size_t j = 0; j < result.bound.size(); ++j) {
    const ControlObjective::Target& target = found.objective.targets()[j];
    const auto at = static_cast<Eigen::Index>(j);
    fmt::print("{:<16} {:>10} {:>14} {:>14}{}\n", found.simulation.controls[target.control].id,
               with_unit(found.piece_of(target).until, "s"), in_written_unit(result.before[at], found.unit_of(target)),
               in_written_unit(result.found[at], found.unit_of(target)),
               result.bound[j] < 0   ? "  (lower bound)"
               : result.bound[j] > 0 ? "  (upper bound)"
                                     : "");
  }
}

nlohmann::ordered_json optimised_json(const Optimised& found, const std::string& path) {
  const OptimiseResult& result = found.result;
  nlohmann::ordered_json json;
  json["title"] = found.simulation.title;
  json["simulated"] = true;
  json["status"] = name_of(result.status);
  json["message"] = result.message;
  json["objective"] = {{"before", result.before_value.objective},
                       {"found", result.value.objective},
                       {"effort_before", result.before_value.effort},
                       {"effort", result.value.effort}};
  for (size_t g = 0; g < result.value.goals.size(); ++g) {
    const OptimiseGoal& goal = found.simulation.optimise->goals[g];
    json["goals"].push_back({{"channel", goal.channel},
                             {"time_s", found.result.value.run.times[result.value.run.goal_samples[g]]},
                             {"aim", goal.aim == Aim::reach      ? "reach"
                                     : goal.aim == Aim::maximise ? "maximise"
                                                                 : "minimise"},
                             {"unit", found.robot.reading(goal.channel).unit},
                             {"before", result.before_value.goals[g]},
                             {"found", result.value.goals[g]}});
    if (goal.aim == Aim::reach) json["goals"].back()["wanted"] = goal.value;
  }
  for (size_t j = 0; j < result.bound.size(); ++j) {
    const ControlObjective::Target& target = found.objective.targets()[j];
    nlohmann::ordered_json& control = json["controls"][found.simulation.controls[target.control].id];
    control["unit"] = found.unit_of(target);
    control["lower"] = target.lower;
    control["upper"] = target.upper;
    control["until_s"].push_back(found.piece_of(target).until);
    control["before"].push_back(result.before[static_cast<Eigen::Index>(j)]);
    control["found"].push_back(result.found[static_cast<Eigen::Index>(j)]);
    control["at_bound"].push_back(result.bound[j]);
  }
  for (const OptimiseIteration& one : result.iterations)
    json["iterations"].push_back({{"iteration", one.iteration},
                                  {"objective", one.objective},
                                  {"gradient_norm", one.gradient_norm},
                                  {"simulations", one.simulations}});
  json["simulations"] = result.simulations;
  json["failed"] = result.failed;
  json["seconds"] = result.seconds;
  json["file"] = path;
  return json;
}

std::string search_csv(const OptimiseResult& result) {
  std::string csv = "iteration,objective,gradient_norm,simulations\n";
  for (const OptimiseIteration& one : result.iterations)
    csv += fmt::format("{},{},{},{}\n", one.iteration, one.objective, one.gradient_norm, one.simulations);
  return csv;
}

/// Looks for the controls of [optimise]: iterations on stderr, a table on stdout; found.toml, which `taut simulate`
/// runs, search.csv and the files of its simulation in optimise/ of a run folder. Exit code 4 when the iterations were
/// not enough.
int optimise_main(const CommandOptions& options) {
  if (!is_simulation(options.target))
    throw InputError(
        fmt::format("{}: there is no [simulation]; `taut optimise` is for controls of simulations", options.target));
  const Simulation simulation = read_simulation(options.target);
  if (!simulation.optimise)
    throw InputError(
        fmt::format("{}: there is no [optimise]; add [optimise.control.ID] with lower and upper, and [[optimise.goal]]",
                    options.target));
  Progress progress(options.quiet);
  const Robot robot = make_robot(simulation);
  // A folder of its own, so that `taut simulate` of the same file does not replace what a search has found.
  RunFolder folder(run_folder(options) + "/optimise", RunFolder::Kind::simulation);
  progress.say(fmt::format("{}: {} unknowns", simulation.title, robot.scene.model->free_unknowns()));
  const OptimiseResult result = optimise(simulation, robot, options.stop, [&](const OptimiseIteration& one) {
    progress.say(fmt::format("iteration {}: objective {:.6g}, gradient {:.2e}, {} simulations", one.iteration,
                             one.objective, one.gradient_norm, one.simulations));
  });
  const bool stopped = result.status == OptimiseStatus::interrupted;
  if (result.value.run.goal_samples.empty()) {  // there is nothing to show
    fmt::print(stderr, "taut: {}: {}\n", simulation.path, result.message);
    return stopped ? exit_interrupted : exit_solve;
  }
  const Optimised found{simulation, robot, ControlObjective(simulation, robot), result};
  Simulation moved = simulation;
  moved.schedules = found.objective.schedules(result.found);
  const std::string text = text_with_schedules(moved);
  std::string path = folder.path() + "/found.toml";
  if (stopped && folder.finished()) {
    path = folder.path() + "/best_so_far.toml";
    write_file(path, text);
    progress.say(fmt::format("interrupted; the finished run in {} stays as it is", folder.path()));
  } else {
    write_file(folder.next() + "/found.toml", text);
    write_file(folder.next() + "/search.csv", search_csv(result));
    publish(make_optimised_record(found, text, options), folder, stopped);
    progress.say(fmt::format("report: {}/report.html", folder.path()));
  }
  options.json ? print_json(optimised_json(found, path)) : print_optimised(found);
  progress.say(fmt::format("controls: {}", path));
  if (stopped) return exit_interrupted;
  return result.status == OptimiseStatus::not_converged ? exit_fit : exit_ok;
}

void add_optimise_options(AddOption add, CommandOptions& options) {
  add_out(add, options, "run folder, in which all goes to optimise/; default: runs/<name of the experiment's folder>");
}

}  // namespace

Command optimise_command() {
  return {"optimise",
          "SIMULATION",
          "Finds the controls over time that bring channels of a simulation to its goals.",
          "  taut optimise experiments/swing_up/experiment.toml\n"
          "  taut optimise experiments/swing_up/experiment.toml --json\n",
          add_optimise_options,
          optimise_main};
}

}  // namespace taut

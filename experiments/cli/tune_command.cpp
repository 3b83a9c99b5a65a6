#include <fmt/format.h>

#include <algorithm>
#include <boost/program_options.hpp>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "calib/data/run_folder.hpp"
#include "calib/runs/open_bench.hpp"
#include "calib/runs/provenance.hpp"
#include "calib/studies/tuning.hpp"
#include "experiments/cli/bench_words.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "experiments/cli/run_controls.hpp"
#include "reports/axes.hpp"
#include "reports/run_record.hpp"
#include "reports/stiffness_map.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;
namespace po = boost::program_options;
using TuneJson = nlohmann::ordered_json;

/// --also "tip<5mm".
struct Demand {
  std::string text;
  size_t channel = 0;
  bool below = true;
  double limit = 0;  ///< SI
  bool holds(double value) const { return below ? value < limit : value > limit; }
};

/// What is asked, once the bench is known.
struct TuneTask {
  TuneQuestion question;
  std::vector<Demand> demands;
  Tuned tuned{};
};

Demand demand_of(const std::string& text, const std::vector<AxisRecord>& channels) {
  Demand demand;
  demand.text = text;
  const size_t at = text.find_first_of("<>");
  if (at == std::string::npos || at == 0 || at + 1 == text.size())
    throw InputError(fmt::format("--also {}: write CHANNEL<VALUE or CHANNEL>VALUE, for example --also \"{}<5 mm\"",
                                 text, channels.front().id));
  const std::string id(trimmed(std::string_view(text).substr(0, at)));
  demand.channel = place_of_id(channels, id, "--also " + text, "channel");
  demand.below = text[at] == '<';
  demand.limit = in_unit_of(channels[demand.channel], std::string(trimmed(std::string_view(text).substr(at + 1))),
                            "--also " + text);
  return demand;
}

/// The question for one control; the others as --hold says, else at their smallest size at the bench.
TuneTask task_of(const CommandOptions& options, const Bench& bench, size_t load, size_t control) {
  TuneTask task;
  const std::vector<AxisRecord>& axes = bench.controls();
  task.question.stiffness = parse_quantity(spaced(options.stiffness), Quantity::stiffness, "--stiffness");
  if (!(task.question.stiffness > 0))
    throw InputError("--stiffness: at an equilibrium that lasts it is larger than zero; give such a one");
  task.question.control = control;
  task.question.controls = held_controls(options, bench, load, control, "--at");
  if (!options.at.empty()) task.question.controls[load] = in_unit_of(axes[load], options.at, "--at");
  const std::vector<double> values = bench.values_of(control);
  task.question.lower = values.front();
  task.question.upper = values.back();
  if (!options.from.empty()) task.question.lower = in_unit_of(axes[control], options.from, "--from");
  if (!options.to.empty()) task.question.upper = in_unit_of(axes[control], options.to, "--to");
  if (!(task.question.lower < task.question.upper))
    throw InputError(
        fmt::format("the range of {} is from {} to {}; give a larger end with --to, or a smaller one with "
                    "--from",
                    axes[control].id, value_text(bench, control, task.question.lower),
                    value_text(bench, control, task.question.upper)));
  for (const std::string& demand : options.also) task.demands.push_back(demand_of(demand, bench.channels()));
  return task;
}

bool fulfils(const TuneTask& task, const TunedControl& found) {
  return std::ranges::all_of(task.demands,
                             [&](const Demand& demand) { return demand.holds(found.state.readings[demand.channel]); });
}

/// "path" of the protocol, and what of it is not plain.
std::string branch_text(const TunedControl& found) {
  std::string text =
      found.state.slipped ? "beyond a jump of the path to another equilibrium" : "on the path of the bench, from rest";
  if (found.two_equilibria) text += "; another equilibrium exists there, which another way may lead to";
  if (found.near_jump) text += "; near a fold, where the state jumps at a load 5 % away or less";
  return text;
}

std::string reachable_text(const Tuned& tuned) {
  std::vector<std::string> ranges;
  for (const auto& [low, high] : tuned.reachable)
    ranges.push_back(fmt::format("from {} to {}", with_unit(low, "N/m", 3), with_unit(high, "N/m", 3)));
  return join(ranges, " and ");
}

/// "12.3 mm to 12.5 mm"; an open end is that of the range.
std::string interval_text(const TuneTask& task, const TunedControl& found, const Bench& bench) {
  const auto end = [&](const std::optional<double>& at, double limit, const char* beyond) {
    return at ? value_text(bench, task.question.control, *at)
              : fmt::format("{} {}", beyond, value_text(bench, task.question.control, limit));
  };
  return end(found.lower95, task.question.lower, "below") + " to " + end(found.upper95, task.question.upper, "above");
}

void print_tuned(const TuneTask& task, const Bench& bench, size_t load) {
  const AxisRecord &axis = bench.controls()[task.question.control], &along = bench.controls()[load];
  const std::string wanted = with_unit(task.question.stiffness, "N/m");
  fmt::print("tangent stiffness along {} at {}, {} from {} to {}: {} is reachable\n", along.id,
             value_text(bench, load, task.question.controls[load]), axis.id,
             value_text(bench, task.question.control, task.question.lower),
             value_text(bench, task.question.control, task.question.upper), reachable_text(task.tuned));
  if (task.tuned.solutions.empty()) fmt::print("no {} there gives {}\n", axis.id, wanted);
  for (const auto& [before, after] : task.tuned.jumps)
    fmt::print("it jumps over {}: at {} it is {}, at {} it is {}\n", wanted,
               value_text(bench, task.question.control, before.controls[task.question.control]),
               with_unit(before.stiffness, "N/m"),
               value_text(bench, task.question.control, after.controls[task.question.control]),
               with_unit(after.stiffness, "N/m"));
  for (const TunedControl& found : task.tuned.solutions) {
    fmt::print("{} = {}{}\n", axis.id, value_text(bench, task.question.control, found.settable),
               fulfils(task, found) ? "" : ", but not as --also demands");
    fmt::print("  95 %: {} with noise and shares, +- {} from noise alone\n", interval_text(task, found, bench),
               with_unit(found.half.noise, axis.unit, 2));
    fmt::print("  surfaces {}; {}\n", found.state.touching ? "touch: closed" : "do not touch: open",
               branch_text(found));
    fmt::print("  replay at {}: {}\n", value_text(bench, task.question.control, found.settable),
               with_unit(found.replayed, "N/m", 5));
    for (size_t c = 0; c < bench.channels().size(); ++c)
      fmt::print("  {} = {} +- {}\n", bench.channels()[c].id,
                 with_unit(found.state.readings[c], bench.channels()[c].unit),
                 with_unit(found.reading_half95[c], bench.channels()[c].unit, 2));
    for (const Demand& demand : task.demands)
      fmt::print("  {}: {}\n", demand.text,
                 demand.holds(found.state.readings[demand.channel]) ? "holds" : "does not hold");
  }
}

TuneJson tuned_json(const TuneTask& task, const Bench& bench, size_t load) {
  const AxisRecord& axis = bench.controls()[task.question.control];
  TuneJson json{{"control", axis.id},
                {"unit", axis.unit},
                {"range", {task.question.lower, task.question.upper}},
                {"load", bench.controls()[load].id},
                {"wanted_N_per_m", task.question.stiffness}};
  for (size_t k = 0; k < bench.controls().size(); ++k) {
    if (k != task.question.control) json["at"][bench.controls()[k].id] = task.question.controls[k];
  }
  json["reachable_N_per_m"] = task.tuned.reachable;
  json["solutions"] = TuneJson::array();
  for (const TunedControl& found : task.tuned.solutions) {
    const auto end = [](const std::optional<double>& at) { return at ? TuneJson(*at) : TuneJson(); };
    TuneJson& one = json["solutions"].emplace_back();
    one = {{"value", found.value},
           {"interval95", {end(found.lower95), end(found.upper95)}},
           {"noise_half95", found.half.noise},
           {"total_half95", found.half.total},
           {"stiffness_slope", found.slope},
           {"touching", found.state.touching},
           {"slipped", found.state.slipped},
           {"two_equilibria", found.two_equilibria},
           {"near_jump", found.near_jump},
           {"replayed_at", found.settable},
           {"replayed_N_per_m", found.replayed}};
    for (size_t c = 0; c < bench.channels().size(); ++c)
      one["readings"].push_back({{"channel", bench.channels()[c].id},
                                 {"unit", bench.channels()[c].unit},
                                 {"value", found.state.readings[c]},
                                 {"half95", found.reading_half95[c]}});
    one["also"] = fulfils(task, found);
  }
  json["jumps"] = TuneJson::array();
  for (const auto& [before, after] : task.tuned.jumps)
    json["jumps"].push_back(
        {{"between", {before.controls[task.question.control], after.controls[task.question.control]}},
         {"stiffness_N_per_m", {before.stiffness, after.stiffness}}});
  json["scan"] = TuneJson::array();
  for (const TunedState& state : task.tuned.scan)
    json["scan"].push_back({{"at", state.controls[task.question.control]},
                            {"stiffness_N_per_m", state.stiffness},
                            {"touching", state.touching},
                            {"slipped", state.slipped}});
  return json;
}

/// The map of one control as figure and tables; returns a sentence about them.
std::string write_map(const RunRecord& record, const Bench& bench, const StiffnessReplay& replay, const TuneTask& task,
                      const std::string& folder, Progress& progress, TuneJson& json) {
  const size_t load = replay.load();
  const double largest = std::max(bench.values_of(load).back(), task.question.controls[load]);
  const StiffnessMap map = stiffness_map(replay, record.shares, task.question, largest, {},
                                         [&](const std::string& text) { progress.show(text); });
  const StiffnessMapText text = write_stiffness_map(map, record, bench, task.question, folder);
  std::vector<double> found;
  for (const TunedControl& one : task.tuned.solutions) found.push_back(one.value);
  draw_stiffness_map(map, text, task.question.stiffness, found, folder);
  const std::string worth = interpolation_error(map, text);
  json["map"] = {{"folder", folder}, {"nodes", map.nodes.size()}, {"checks", map.checks.size()}, {"error", worth}};
  return fmt::format("map: {}/stiffness_map.csv, .json, figures/stiffness_map.svg; interpolated, {}", folder, worth);
}

/// Finds the control that gives a stiffness with the parameters and covariance of a run, and maps the stiffness.
int tune_main(const CommandOptions& options) {
  if (options.stiffness.empty())
    throw InputError("taut tune: --stiffness is missing; say which one is wanted, for example --stiffness \"1 N/mm\"");
  settle_run_folder(options.target);
  const RunRecord record = read_run(options.target);
  const std::unique_ptr<Bench> bench =
      open_bench(experiment_of_run(record, options.target), {options.threads, options.stop});
  const size_t load = load_of(options, *bench);
  std::vector<TuneTask> tasks;
  for (const size_t control : controls_of(options, *bench, load))
    tasks.push_back(task_of(options, *bench, load, control));
  const StiffnessReplay replay(*bench, record.fit, load);
  Progress progress(options.quiet);
  if (misses_readings(record.fit))
    progress.say(
        "THE MODEL DID NOT DESCRIBE THE READINGS that it was fitted to: intervals count noise and shares only");
  if (record.simulated && !options.json) fmt::print("SIMULATED DATA: fitted to readings that were simulated.\n");
  TuneJson json{{"title", record.title}, {"data", record.simulated ? "simulated" : "measured"}};
  json["tuned"] = TuneJson::array();
  bool all_found = true;
  for (TuneTask& task : tasks) {
    const std::string id = bench->controls()[task.question.control].id;
    task.tuned = tune(replay, record.shares, task.question,
                      [&](const std::string& text) { progress.show(fmt::format("{}: {}", id, text)); });
    if (options.interrupted()) return exit_interrupted;
    all_found &= std::ranges::any_of(task.tuned.solutions, [&](const auto& found) { return fulfils(task, found); });
    TuneJson one = tuned_json(task, *bench, load);
    if (!options.json) print_tuned(task, *bench, load);
    if (!options.no_map) {
      fs::path folder = options.out.empty() ? fs::path(options.target) / "tune" : fs::path(options.out);
      if (tasks.size() > 1) folder /= id;
      progress.say(write_map(record, *bench, replay, task, folder.string(), progress, one));
    }
    json["tuned"].push_back(std::move(one));
    if (options.interrupted()) return exit_interrupted;
  }
  json["warnings"] = replay.failures();
  if (options.json) print_json(json);
  print_failures(replay.failures());
  return all_found ? exit_ok : exit_fit;
}

void add_tune_options(AddOption add, CommandOptions& options) {
  add("stiffness", po::value(&options.stiffness)->value_name("VALUE"), "wanted, dF/dx where the load acts: \"1 N/mm\"");
  add("at", po::value(&options.at)->value_name("VALUE"), "the load at which; default: none (0)");
  add("also", po::value(&options.also)->value_name("CHANNEL<VALUE")->composing(),
      "what else has to hold there, of a channel: \"tip<5 mm\"; may be repeated");
  add("control", po::value(&options.name)->value_name("ID"), "what is sought; default: each retraction");
  add("load", po::value(&options.load)->value_name("ID"), "the load; default: the one that figures are drawn over");
  add_assignments(add, options.set, "hold", "another control's value; default: its smallest at the bench");
  add("from", po::value(&options.from)->value_name("VALUE"), "begin of the range; default: the smallest at the bench");
  add("to", po::value(&options.to)->value_name("VALUE"), "its end; default: the largest at the bench");
  add("no-map", po::bool_switch(&options.no_map), "without the map over control and load");
  add_out(add, options, "folder of the map; default: tune in the run folder");
  add_threads(add, options);
}

}  // namespace

Command tune_command() {
  return {"tune",
          "RUN_FOLDER",
          "Finds the retraction for a wanted stiffness by a run, with its interval, and maps the stiffness.",
          "  taut tune runs/push_puppet --stiffness \"1 N/mm\" --at \"100 g\"\n"
          "  taut tune runs/push_puppet --stiffness \"2 N/mm\" --also \"tip<5 mm\" --no-map --json\n",
          add_tune_options,
          tune_main};
}

}  // namespace taut

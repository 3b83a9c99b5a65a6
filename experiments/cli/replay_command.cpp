#include <fmt/format.h>

#include <boost/program_options.hpp>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>

#include "calib/data/files.hpp"
#include "calib/runs/open_bench.hpp"
#include "calib/runs/replay.hpp"
#include "calib/runs/run_fit.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "experiments/cli/replay_output.hpp"
#include "reports/axes.hpp"
#include "reports/report.hpp"
#include "reports/vtu.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;
namespace po = boost::program_options;

/// The file's parameters with what --set says.
Params parameters_of(const CommandOptions& options, const Bench& bench) {
  Params p = bench.protocol().nominal();
  for (const auto& [id, text] : options.set) set_parameter(bench, id, text, "--set " + id, p);
  return p;
}

/// A replay's files go to the run folder; where a fit stands there, beside it.
std::string replay_folder(const CommandOptions& options) {
  const fs::path folder = run_folder(options);
  return (fs::exists(folder / "fit.json") ? folder / "replay" : folder).string();
}

void print_replay(const Replay& replay, const Bench& bench) {
  if (replay.record.simulated && !planned_rows(bench)) fmt::print("SIMULATED DATA in the column 'measured'.\n");
  if (replay.record.swings.empty())
    print_readings(replay.record);
  else
    print_swings(replay.record);
  print_cables(bench.cable_states());
  if (!replay.with_respect_to.empty()) print_sensitivities(replay, bench);
}

/// Simulates every row of the bench: table on stdout; predictions.csv, states as VTU.
int replay_main(const CommandOptions& options) {
  const std::unique_ptr<Bench> bench =
      open_bench(options.target, {options.threads, options.stop, Readings::may_be_blank, options.rows});
  Progress progress(options.quiet);
  const Params p = parameters_of(options, *bench);
  const std::optional<int> planned = planned_rows(*bench);
  progress.say(planned ? fmt::format("predicting {} rows without readings", *planned)
                       : "replaying " + bench->size_text());
  const Replay replay = replay_bench(*bench, p, options.sensitivities);
  const RunRecord& record = replay.record;
  if (!bench->choice().empty()) progress.say(bench->choice());
  const std::string comparison = bench->compare_models(p, replay.prediction.values, record.replay_seconds);
  if (!comparison.empty()) progress.say(comparison);
  const std::string folder = replay_folder(options);
  write_file((fs::path(folder) / "predictions.csv").string(), predictions_csv(record));
  const fs::path derivatives = fs::path(folder) / "sensitivities.csv";
  fs::remove(derivatives);  // of an earlier replay, with other parameters perhaps
  if (options.sensitivities) write_file(derivatives.string(), sensitivities_csv(replay, *bench));
  const std::string pictures = write_states(bench->states(), folder);
  if (options.json)
    print_json(replay_json(replay, *bench));
  else
    print_replay(replay, *bench);
  for (const std::string& warning : record.remarks) progress.say("warning: " + warning);
  for (const std::string& warning : bench->warnings_after()) progress.say("warning: " + warning);
  print_failures(replay.prediction.failures);
  progress.say(fmt::format("{:.2f} s, {}; {}/predictions.csv{}", record.replay_seconds, bench->effort(), folder,
                           pictures.empty() ? "" : ", " + pictures));
  if (options.interrupted()) return exit_interrupted;
  return replay.prediction.complete() ? exit_ok : exit_solve;
}

void add_replay_options(AddOption add, CommandOptions& options) {
  add_out(add, options);
  add_threads(add, options);
  add_assignments(add, options.set, "set", "a parameter instead of the file's value, with its unit: E_foam=47.3kPa");
  add("rows", po::value(&options.rows)->value_name("FILE"),
      "CSV file with the columns of controls, one row per prediction: instead of the bench file, which need not be "
      "there");
  add("sensitivities", po::bool_switch(&options.sensitivities),
      "derivatives of every row with respect to all parameters and controls, and the stiffness at each load: "
      "sensitivities.csv");
}

}  // namespace

Command replay_command() {
  return {
      "replay",
      "EXPERIMENT",
      "Simulates every row of the bench, or of a plan, with given parameters: table, CSV, VTU. Needs no readings.",
      "  taut replay experiments/silicone_block/experiment.toml\n"
      "  taut replay experiments/silicone_block/experiment.toml --set E_silicone=263.8kPa --out /tmp/replay\n"
      "  taut replay experiments/push_puppet/experiment.toml --rows plan.csv   # plan.csv: the columns of controls\n",
      add_replay_options,
      replay_main};
}

}  // namespace taut

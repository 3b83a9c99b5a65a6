#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <boost/program_options.hpp>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "calib/data/files.hpp"
#include "calib/data/run_folder.hpp"
#include "calib/runs/open_bench.hpp"
#include "calib/runs/provenance.hpp"
#include "calib/runs/run_fit.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "experiments/cli/version.hpp"
#include "reports/run_record.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;
namespace po = boost::program_options;
using RecheckJson = nlohmann::ordered_json;

constexpr double same_in_sigmas = 0.01;  ///< what counts as the same: of a reading's sigma, of a standard error

/// A stage of a run that is done again.
struct RecheckStage {
  std::string name;
  bool same = true;
  std::vector<std::string> differences{};  ///< sentences
  double largest = 0;                      ///< difference in sigmas, where it has one
};

/// The files beside fit.json are those that it was made from, and say the same.
RecheckStage recheck_inputs(const RunRecord& record, const std::string& folder) {
  RecheckStage stage{"inputs"};
  for (const InputRecord& input : record.provenance.inputs) {
    const std::string copy = (fs::path(folder) / input.copy).string();
    if (!fs::exists(copy))
      stage.differences.push_back(copy + " is missing");
    else if (sha256_of(copy) != input.sha256)
      stage.differences.push_back(copy + " is not the file that the run was made from");
  }
  stage.same = stage.differences.empty();
  return stage;
}

/// The record's readings are those that today's reader finds, and its held parameters today's.
void recheck_reading(const RunRecord& record, const Bench& bench, RecheckStage& stage) {
  if (record.readings.size() != bench.readings().size())
    return stage.differences.push_back(
        fmt::format("{} readings are read where there were {}", bench.readings().size(), record.readings.size()));
  for (size_t i = 0; i < record.readings.size(); ++i) {
    const BenchReading& now = bench.readings()[i];
    const ReadingRecord& then = record.readings[i];
    if (std::abs(now.value - then.measured) > 1e-9 * std::abs(then.measured) ||
        std::abs(now.sigma - then.sigma) > 1e-9 * std::abs(then.sigma))
      stage.differences.push_back(fmt::format("line {}: {} +- {} is read where there was {} +- {} (SI)", then.line,
                                              now.value, now.sigma, then.measured, then.sigma));
  }
  const ParameterTable& table = bench.protocol().parameters();
  const Params& nominal = bench.protocol().nominal();
  for (size_t k = 0; k < record.parameter_ids.size(); ++k) {
    const std::string& id = record.parameter_ids[k];
    const bool fitted =
        std::ranges::any_of(record.fit.parameters, [&](const ParameterEstimate& e) { return e.spec.id == id; });
    if (fitted || bench.sets(id)) continue;
    const double then = record.fit.p[static_cast<Eigen::Index>(k)];
    if (!table.contains(id))
      stage.differences.push_back(fmt::format("there is no parameter {} any more", id));
    else if (std::abs(nominal[table.index(id)] - then) > 1e-9 * std::abs(then))
      stage.differences.push_back(fmt::format("{} is {} where it was {}", id,
                                              with_unit(nominal[table.index(id)], table[table.index(id)].unit, 8),
                                              with_unit(then, table[table.index(id)].unit, 8)));
  }
}

/// Every reading predicted at the run's parameters, beside what the run predicted.
RecheckStage recheck_replay(const RunRecord& record, const Bench& bench) {
  RecheckStage stage{"replay at the same parameters"};
  recheck_reading(record, bench, stage);
  Protocol& protocol = bench.protocol();
  Params p = protocol.nominal();
  for (const ParameterEstimate& e : record.fit.parameters) p[protocol.parameters().index(e.spec.id)] = e.value;
  std::vector<int> followed;  // rows that the run predicted in another equilibrium
  for (const EquilibriaRecord& rows : record.equilibria) {
    if (rows.decided != "other") continue;
    for (const BenchReading& reading : bench.readings()) {
      if (reading.row >= 0 && std::ranges::count(rows.lines, reading.line) > 0) followed.push_back(reading.row);
    }
  }
  protocol.forget();
  if (!followed.empty()) protocol.follow(p, followed);
  const Prediction prediction = protocol.predict(p, {});
  for (const std::string& failure : prediction.failures) stage.differences.push_back(failure);
  const size_t count = std::min(record.readings.size(), bench.readings().size());
  std::string worst;
  for (size_t i = 0; i < count; ++i) {
    const BenchReading& now = bench.readings()[i];
    const ReadingRecord& then = record.readings[i];
    if (now.row < 0 || !std::isfinite(then.predicted)) continue;
    const double off = std::abs(prediction.values[now.row] - then.predicted) / then.sigma;
    if (!(off > stage.largest)) continue;
    stage.largest = off;
    const std::string& unit = bench.channels()[static_cast<size_t>(now.channel)].unit;
    worst = fmt::format("line {}, {}: {} is predicted where it was {}, {:.2g} sigmas apart", then.line, then.channel,
                        with_unit(prediction.values[now.row], unit, 8), with_unit(then.predicted, unit, 8), off);
  }
  if (stage.largest > same_in_sigmas) stage.differences.push_back(worst);
  stage.same = stage.differences.empty();
  return stage;
}

/// The fit once more, from the file's starts.
RecheckStage recheck_fit(const RunRecord& record, Bench& bench, const CommandOptions& options, Progress& progress) {
  RecheckStage stage{"fit"};
  const fs::path scratch = fs::temp_directory_path() / fmt::format("taut_recheck_{}", ::getpid());
  RunRecord again;
  {
    EvaluationLog log(scratch.string(), "recheck");
    RunEvents events;
    events.show = [&](const std::string& line) { progress.show(line); };
    RunOptions how;
    how.variants = false;
    how.stop = options.stop;
    how.fit_alone = true;
    again = run_fit(bench, start_record(bench), log, how, events);
  }
  fs::remove_all(scratch);
  if (options.interrupted()) return stage;
  if (again.fit.status != record.fit.status)
    stage.differences.push_back(
        fmt::format("it is {} where it was {}", name_of(again.fit.status), name_of(record.fit.status)));
  for (const ParameterEstimate& then : record.fit.parameters) {
    const auto now = std::ranges::find(again.fit.parameters, then.spec.id, [](const auto& e) { return e.spec.id; });
    if (now == again.fit.parameters.end()) {
      stage.differences.push_back(fmt::format("{} is not fitted any more", then.spec.id));
      continue;
    }
    const double off = std::abs(now->value - then.value) / then.standard_error;
    if (std::isfinite(off)) stage.largest = std::max(stage.largest, off);
    const bool error_differs = std::abs(now->standard_error - then.standard_error) > 0.01 * then.standard_error;
    if (off > same_in_sigmas || error_differs)
      stage.differences.push_back(
          fmt::format("{} is {}, standard error {}, where it was {}, standard error {}", then.spec.id,
                      with_unit(now->value, then.spec.unit, 6), with_unit(now->standard_error, then.spec.unit, 3),
                      with_unit(then.value, then.spec.unit, 6), with_unit(then.standard_error, then.spec.unit, 3)));
  }
  stage.same = stage.differences.empty();
  return stage;
}

void print_stage(const RecheckStage& stage) {
  fmt::print("{}: {}", stage.name, stage.same ? "same" : "DIFFERS");
  fmt::print("{}\n", stage.name != "inputs" ? fmt::format(" (at most {:.2g} sigmas)", stage.largest) : "");
  for (size_t i = 0; i < std::min<size_t>(12, stage.differences.size()); ++i)
    fmt::print("  {}\n", stage.differences[i]);
  if (stage.differences.size() > 12) fmt::print("  and {} more (--json)\n", stage.differences.size() - 12);
}

/// Does a run again from its own copies, stage by stage, and ends with the first that differs.
int recheck_main(const CommandOptions& options) {
  settle_run_folder(options.target);
  const RunRecord record = read_run(options.target);
  Progress progress(options.quiet);
  std::vector<RecheckStage> stages{recheck_inputs(record, options.target)};
  if (stages.back().same) {
    const std::unique_ptr<Bench> bench =
        open_bench(experiment_of_run(record, options.target), {options.threads, options.stop});
    progress.show("replaying " + bench->size_text());
    stages.push_back(recheck_replay(record, *bench));
    if (options.interrupted()) return exit_interrupted;
    if (stages.back().same && !options.no_fit) {
      progress.show("fitting again");
      stages.push_back(recheck_fit(record, *bench, options, progress));
      if (options.interrupted()) return exit_interrupted;
    }
  }
  const bool same = stages.back().same;
  RecheckJson json{{"run", options.target},
                   {"made_by", record.provenance.version},
                   {"made_by_commit", record.provenance.commit},
                   {"checked_by", version()},
                   {"checked_by_commit", commit()},
                   {"same", same},
                   {"differs_at", same ? RecheckJson() : RecheckJson(stages.back().name)}};
  for (const RecheckStage& stage : stages)
    json["stages"].push_back({{"name", stage.name},
                              {"same", stage.same},
                              {"largest_in_sigmas", stage.largest},
                              {"differences", stage.differences}});
  if (options.json) {
    print_json(json);
  } else {
    fmt::print("{}, made by taut {} ({}), checked by taut {} ({})\n", options.target, record.provenance.version,
               record.provenance.commit, version(), commit());
    for (const RecheckStage& stage : stages) print_stage(stage);
  }
  return same ? exit_ok : exit_differs;
}

void add_recheck_options(AddOption add, CommandOptions& options) {
  add("no-fit", po::bool_switch(&options.no_fit), "inputs and replay alone");
  add_threads(add, options);
}

}  // namespace

Command recheck_command() {
  return {"recheck",
          "RUN_FOLDER",
          "Does a run again from its own copies: whether inputs, replay and fit are still the same, else exit code 5.",
          "  taut recheck runs/push_puppet\n",
          add_recheck_options,
          recheck_main};
}

}  // namespace taut

#include <fmt/format.h>

#include <algorithm>
#include <boost/program_options.hpp>
#include <filesystem>
#include <optional>

#include "calib/data/files.hpp"
#include "calib/data/run_folder.hpp"
#include "calib/runs/open_bench.hpp"
#include "calib/runs/run_fit.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "experiments/cli/provenance.hpp"
#include "reports/report.hpp"
#include "reports/vtu.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;
namespace po = boost::program_options;

/// What is fitted, and what of it is known from an interrupted run.
void say_start(const Bench& bench, const RunRecord& record, const EvaluationLog& log, Progress& progress) {
  for (const std::string& warning : record.remarks) progress.say("warning: " + warning);
  for (const auto& [label, text] : record.setup) {
    if (label == "bench file" || label == "experiment file") progress.say(label + ": " + text);
  }
  progress.say("fitting " + bench.size_text());
  if (log.known() > 0)
    progress.say(
        fmt::format("going on with an interrupted run: {} evaluations are known and not made again (--fresh "
                    "starts anew)",
                    log.known()));
  if (log.discarded())
    progress.say("what an interrupted run of other inputs, or of another taut, had left is discarded");
}

/// The fit with all that follows; what is finished stands in folder.next() at once.
RunRecord fit_into(const CommandOptions& options, Bench& bench, RunRecord record, EvaluationLog& log,
                   const RunFolder& folder, Progress& progress) {
  bool copied = false;
  RunEvents events;
  events.say = [&](const std::string& line) { progress.say(line); };
  events.show = [&](const std::string& line) { progress.show(line); };
  events.keep = [&](const RunRecord& so_far) {
    write_file((fs::path(folder.next()) / "fit.json").string(), to_json(so_far));
    if (!std::exchange(copied, true)) copy_inputs(so_far.provenance.inputs, folder.next());
  };
  events.states = [&](const SolvedStates& states) { write_states(states, folder.next()); };
  return run_fit(bench, std::move(record), log, {!options.no_variants, options.stop}, events);
}

/// The exit code of a run that has nothing to take the place of what stands in the folder; nullopt: it has.
std::optional<int> came_to_nothing(const CommandOptions& options, const RunRecord& record, RunFolder& folder,
                                   Progress& progress) {
  if (record.fit.status == FitStatus::start_failed) {
    print_failures(record.fit.failures);
    fmt::print(stderr,
               "taut: the simulation failed at the start of the fit; change the start values, or look at the model "
               "with `taut replay`\n");
    if (options.interrupted()) return exit_interrupted;
    folder.forget_resume();  // it would fail again in the same way
    return exit_solve;
  }
  if (record.interrupted && record.fit.covariance.size() == 0) {
    progress.say("interrupted before the fit had a result; the same command goes on from here");
    return exit_interrupted;
  }
  if (record.interrupted && folder.finished()) {
    progress.say(fmt::format(
        "interrupted; the finished run in {} stays as it is, and the same command goes on from here", folder.path()));
    return exit_interrupted;
  }
  return std::nullopt;
}

/// Figures and report, the last and least of a run: where they fail, all else is there.
std::string write_all(const RunRecord& record, const std::string& folder) {
  try {
    write_run(record, folder);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

std::string cost_text(const RunRecord& record) {
  const FitCost &search = record.fit.search, &profiles = record.fit.profiles;
  return fmt::format(
      "{:.1f} s in all; fit {:.2f} s with {} factorisations in {} evaluations, {:.1f} times one cold replay's {:.2f} s "
      "with {}; profiles {:.2f} s with {}",
      record.provenance.wall_seconds, search.seconds, search.factorisations, record.fit.evaluations,
      search.seconds / record.replay_seconds, record.replay_seconds, record.replay_factorisations, profiles.seconds,
      profiles.factorisations);
}

int exit_code(const CommandOptions& options, const RunRecord& record, const std::string& report_failure) {
  if (options.interrupted()) return exit_interrupted;
  if (record.fit.status != FitStatus::converged) {
    fmt::print(stderr, "taut: the fit did not converge: {}\n", record.fit.message);
    return exit_fit;
  }
  if (!report_failure.empty()) {
    fmt::print(stderr, "taut: {}\n", report_failure);
    return exit_input;
  }
  return record.failed_stages > 0 ? exit_solve : exit_ok;
}

/// Fits the free parameters and writes a run folder.
int fit_main(const CommandOptions& options) {
  const std::unique_ptr<Bench> bench = open_bench(options.target, {options.threads, options.stop});
  Progress progress(options.quiet);
  RunFolder folder(run_folder(options));
  if (options.fresh) folder.forget_resume();
  RunRecord record = start_record(*bench);
  record.provenance = provenance_of(options, *bench);
  EvaluationLog log(folder.resume(), fingerprint_of(record.provenance.inputs));
  say_start(*bench, record, log, progress);
  const auto said = static_cast<std::ptrdiff_t>(record.remarks.size());
  record = fit_into(options, *bench, std::move(record), log, folder, progress);
  if (const auto code = came_to_nothing(options, record, folder, progress)) return *code;
  progress.show("writing " + folder.path());
  const std::string report_failure = write_all(record, folder.next());
  if (record.interrupted) folder.mark_unfinished();
  folder.publish();
  if (!record.interrupted) folder.forget_resume();

  if (options.json)
    fmt::print("{}\n", to_json(record));
  else
    print_fit(record);
  std::for_each(record.remarks.begin() + said, record.remarks.end(),
                [&](const std::string& remark) { progress.say("note: " + remark); });
  progress.say(cost_text(record));
  if (record.interrupted) progress.say("interrupted: the same command goes on from here");
  progress.say("report: " + (fs::path(folder.path()) / "report.html").string());
  return exit_code(options, record, report_failure);
}

void add_fit_options(AddOption add, CommandOptions& options) {
  add_out(add, options);
  add_threads(add, options);
  add("no-variants", po::bool_switch(&options.no_variants), "leave out the refits with other meshes");
  add("fresh", po::bool_switch(&options.fresh), "start anew where an interrupted run would be gone on with");
}

}  // namespace

Command fit_command() {
  return {"fit",
          "EXPERIMENT",
          "Fits the free parameters to the bench: run folder with report.html, figures, fit.json, predictions.csv.",
          "  taut fit experiments/silicone_block/experiment.toml\n"
          "  taut fit experiments/silicone_block/experiment.toml --no-variants --json --out runs/quick\n",
          add_fit_options,
          fit_main};
}

}  // namespace taut

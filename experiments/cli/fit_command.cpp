#include <fmt/format.h>

#include <algorithm>
#include <boost/program_options.hpp>
#include <filesystem>
#include <optional>

#include "calib/runs/open_bench.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/ensemble_output.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "reports/fit_run.hpp"
#include "reports/run_record.hpp"

namespace taut {
namespace {

namespace po = boost::program_options;

/// The exit code of a run that has nothing to take the place of what stands in the folder; nullopt: it has.
std::optional<int> came_to_nothing(const CommandOptions& options, const FitRun& run, const std::string& folder,
                                   Progress& progress) {
  switch (run.end) {
    case FitEnd::kept:
      return std::nullopt;
    case FitEnd::start_failed:
      print_failures(run.record.fit.failures);
      fmt::print(stderr,
                 "taut: the simulation failed at the start of the fit; change the start values, or look at the model "
                 "with `taut replay`\n");
      return options.interrupted() ? exit_interrupted : exit_solve;
    case FitEnd::no_result:
      progress.say("interrupted before the fit had a result; the same command goes on from here");
      return exit_interrupted;
    case FitEnd::not_replacing:
      progress.say(fmt::format(
          "interrupted; the finished run in {} stays as it is, and the same command goes on from here", folder));
      return exit_interrupted;
  }
  return std::nullopt;
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

/// Says what went wrong, even when quiet.
int exit_code(const CommandOptions& options, const RunRecord& record, const std::string& report_failure) {
  for (const std::string& failure : record.failed_stages) fmt::print(stderr, "taut: {}\n", failure);
  if (options.interrupted()) return exit_interrupted;
  if (record.fit.status != FitStatus::converged) {
    fmt::print(stderr, "taut: the fit did not converge: {}\n", record.fit.message);
    return exit_fit;
  }
  if (!report_failure.empty()) {
    fmt::print(stderr, "taut: {}\n", report_failure);
    return exit_input;
  }
  return record.failed_stages.empty() ? exit_ok : exit_solve;
}

/// Fits the free parameters and writes a run folder.
int fit_main(const CommandOptions& options) {
  const std::unique_ptr<Bench> bench = open_bench(options.target, {options.threads, options.stop});
  Progress progress(options.quiet);
  FitJob job{program_of(options), run_folder(options), !options.no_variants, options.fresh, options.stop};
  job.say = [&](const std::string& line) { progress.say(line); };
  job.show = [&](const std::string& line) { progress.show(line); };
  const unsigned draws = members_asked(options.posterior, "--posterior", 0);
  FitRun run = fit_bench(*bench, job);
  if (const auto code = came_to_nothing(options, run, job.folder, progress)) return *code;

  const RunRecord& record = run.record;
  std::optional<EnsembleRun> posterior;
  const EnsembleTask task{EnsembleKind::posterior, draws};
  if (draws > 0 && record.fit.status == FitStatus::converged && !record.interrupted)
    posterior = run_ensemble_of(run.record, *bench, task, ensemble_options(options, progress), job.folder);
  if (options.json)
    fmt::print("{}\n", to_json(record));
  else
    print_fit(record);
  if (posterior) print_ensemble(*posterior, task, progress, !options.json);
  std::for_each(record.remarks.begin() + static_cast<std::ptrdiff_t>(run.said), record.remarks.end(),
                [&](const std::string& remark) {
                  if (std::ranges::count(record.failed_stages, remark) == 0) progress.say("note: " + remark);
                });
  progress.say(cost_text(record));
  if (record.interrupted) progress.say("interrupted: the same command goes on from here");
  progress.say("report: " + (std::filesystem::path(job.folder) / "report.html").string());
  return exit_code(options, record, run.report_failure);
}

void add_fit_options(AddOption add, CommandOptions& options) {
  add_out(add, options);
  add_threads(add, options);
  add("no-variants", po::bool_switch(&options.no_variants), "leave out the refits with other meshes");
  add("posterior", po::value(&options.posterior)->value_name("N"),
      "then N draws from the posterior of the parameters (see `taut ensemble`); default: none");
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

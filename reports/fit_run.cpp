#include "reports/fit_run.hpp"

#include <fmt/format.h>
#include <stdlib.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <optional>
#include <utility>

#include "calib/data/files.hpp"
#include "calib/data/run_folder.hpp"
#include "calib/runs/run_fit.hpp"
#include "reports/report.hpp"
#include "reports/vtu.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;

/// A folder for what a fit without one evaluates; it goes with it.
struct TemporaryFolder {
  std::string path = (fs::temp_directory_path() / "taut-XXXXXX").string();
  TemporaryFolder() {
    if (mkdtemp(path.data()) == nullptr)
      throw InputError(fmt::format("{}: no temporary folder can be made there ({}); set TMPDIR to another one",
                                   fs::path(path).parent_path().string(), std::strerror(errno)));
  }
  ~TemporaryFolder() {
    std::error_code ignored;
    fs::remove_all(path, ignored);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
};

/// What is fitted, and what of it is known from an interrupted run.
void say_start(const Bench& bench, const RunRecord& record, const EvaluationLog& log, const FitJob& job) {
  for (const std::string& warning : record.remarks) job.say("warning: " + warning);
  for (const auto& [label, text] : record.setup) {
    if (label == "bench file" || label == "experiment file") job.say(label + ": " + text);
  }
  job.say("fitting " + bench.size_text());
  if (log.known() > 0)
    job.say(
        fmt::format("going on with an interrupted run: {} evaluations are known and not made again (--fresh "
                    "starts anew)",
                    log.known()));
  if (log.discarded()) job.say("what an interrupted run of other inputs, or of another taut, had left is discarded");
}

/// The fit with all that follows; what is finished stands in folder->next() at once.
RunRecord fit_into(const FitJob& job, Bench& bench, RunRecord record, EvaluationLog& log, const RunFolder* folder) {
  RunEvents events;
  events.say = job.say;
  events.show = job.show;
  bool copied = false;
  if (folder != nullptr) {
    events.keep = [&, folder](const RunRecord& so_far) {
      write_file((fs::path(folder->next()) / "fit.json").string(), to_json(so_far));
      if (!std::exchange(copied, true)) copy_inputs(so_far.provenance.inputs, folder->next());
    };
    events.states = [folder](const SolvedStates& states) { write_states(states, folder->next()); };
  }
  return run_fit(bench, std::move(record), log, {job.variants, job.stop}, events);
}

FitEnd end_of(const RunRecord& record, const RunFolder* folder) {
  if (record.fit.status == FitStatus::start_failed) return FitEnd::start_failed;
  if (!record.interrupted) return FitEnd::kept;
  if (record.fit.covariance.size() == 0) return FitEnd::no_result;
  return folder != nullptr && folder->finished() ? FitEnd::not_replacing : FitEnd::kept;
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

void publish(FitRun& run, RunFolder& folder, const FitJob& job) {
  job.show("writing " + folder.path());
  run.report_failure = write_all(run.record, folder.next());
  if (run.record.interrupted) folder.mark_unfinished();
  folder.publish();
  if (!run.record.interrupted) folder.forget_resume();
}

}  // namespace

FitRun fit_bench(Bench& bench, const FitJob& job) {
  std::optional<RunFolder> folder;
  std::optional<TemporaryFolder> temporary;
  if (job.folder.empty())
    temporary.emplace();
  else
    folder.emplace(job.folder);
  if (folder && job.fresh) folder->forget_resume();
  FitRun run;
  run.record = start_record(bench);
  run.record.provenance = provenance_of(job.program, bench);
  EvaluationLog log(folder ? folder->resume() : temporary->path,
                    fingerprint_of(job.program, run.record.provenance.inputs));
  say_start(bench, run.record, log, job);
  run.said = run.record.remarks.size();
  RunFolder* const into = folder ? &*folder : nullptr;
  run.record = fit_into(job, bench, std::move(run.record), log, into);
  run.end = end_of(run.record, into);
  const bool stopped = job.stop != nullptr && job.stop->load();
  if (folder && run.end == FitEnd::kept) publish(run, *folder, job);
  if (folder && run.end == FitEnd::start_failed && !stopped)
    folder->forget_resume();  // it would fail again in the same way
  return run;
}

}  // namespace taut

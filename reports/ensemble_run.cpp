#include "reports/ensemble_run.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>

#include "calib/data/files.hpp"
#include "calib/data/run_folder.hpp"
#include "reports/report.hpp"
#include "reports/run_record.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;

/// Of all that members are made from: the run's inputs and where its fit ended.
std::string fingerprint_of_run(const RunRecord& record) {
  std::string text, optimum;
  for (const InputRecord& input : record.provenance.inputs) text += input.sha256.substr(0, 8) + "-";
  for (const double value : record.fit.p) optimum += fmt::format("{} ", value);
  return text + fmt::format("{:08x}", crc32_of(optimum));
}

/// The record, the table and all that is drawn of them take the old ones' places.
void publish_ensemble(const RunRecord& record, const std::string& name, const std::string& table,
                      const std::string& path) {
  RunFolder folder(path);
  const fs::path next(folder.next());
  write_file((next / "fit.json").string(), to_json(record));
  write_file((next / (name + ".csv")).string(), table);
  write_run(record, folder.next());
  folder.publish(RunFolder::Publish::part);
}

}  // namespace

EnsembleRun run_ensemble_of(RunRecord& record, const Bench& bench, const EnsembleTask& task, StudyOptions options,
                            const std::string& folder) {
  const std::string name(name_of(task.kind));
  const fs::path store = fs::path(folder) / "ensembles";
  std::error_code error;
  fs::create_directories(store, error);
  if (error) throw InputError(fmt::format("{}: the folder cannot be made ({})", store.string(), error.message()));
  options.file = (store / (name + ".csv")).string();
  options.fingerprint = fingerprint_of_run(record);
  const auto members = run_ensemble(bench, record.fit, task, options);
  EnsembleRun run;
  run.missing = static_cast<int>(std::ranges::count_if(members, [](const auto& member) { return !member; }));
  if (options.is_part()) return run;
  run.record = summed_up(members, bench, record.fit, record.shares, task);
  if (run.missing > 0) return run;
  std::erase_if(record.ensembles, [&](const EnsembleRecord& old) { return old.kind == name; });
  record.ensembles.push_back(run.record);
  publish_ensemble(record, name, ensemble_csv(members, record.fit), folder);
  return run;
}

}  // namespace taut

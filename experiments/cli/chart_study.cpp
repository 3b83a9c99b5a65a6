#include "experiments/cli/chart_study.hpp"

#include <fmt/format.h>

#include "sim/core/error.hpp"
#include "sim/files/simulation.hpp"

namespace taut {
namespace {

std::vector<std::string> files_of(const Experiment& experiment) {
  std::vector<std::string> files;
  for (const RunInput& input : inputs_of(experiment)) files.push_back(input.path);
  return files;
}

std::vector<std::string> files_of(const Simulation& simulation) {
  std::vector<std::string> files{simulation.path};
  for (const BodySettings& body : simulation.bodies) {
    if (const std::string mesh = input_file(body.geometry); !mesh.empty()) files.push_back(mesh);
  }
  return files;
}

}  // namespace

Charted read_charted(const CommandOptions& options) {
  if (is_simulation(options.target)) return read_simulation(options.target);
  Experiment experiment = read_experiment(options.target);
  if (!experiment.kind->specimen)
    throw InputError(
        fmt::format("{}: {} has no mesh and no steps to compare; chart an experiment with a specimen or a "
                    "simulation over time",
                    options.target, experiment.kind->about));
  if (options.threads > 0) experiment.threads = options.threads;
  return experiment;
}

ChartFolder open_chart(const CommandOptions& options, const std::string& chart, const Charted& charted,
                       Progress& progress) {
  ChartFolder folder;
  folder.path = options.out.empty() ? run_folder(options) + "/charts" : options.out;
  std::error_code error;
  std::filesystem::create_directories(folder.path / "figures", error);
  if (error)
    throw InputError(fmt::format("{}: the folder cannot be made ({}); choose another one with --out",
                                 folder.path.string(), error.message()));
  folder.study.budget = options.budget;
  folder.study.file = (folder.path / (chart + ".csv")).string();
  folder.study.fingerprint = fingerprint_of(std::visit([](const auto& one) { return files_of(one); }, charted));
  folder.study.stop = options.stop;
  folder.study.progress = [&progress](const std::string& what, size_t done, size_t all) {
    progress.show(fmt::format("{} ({} of {})", what, done + 1, all));
  };
  return folder;
}

int close_chart(const CommandOptions& options, size_t missing, size_t all, Progress& progress) {
  if (missing > 0)
    progress.say(
        fmt::format("{} of {} settings are missing; run it again to go on, or with a larger --budget", missing, all));
  return options.stop != nullptr && options.stop->load() ? exit_interrupted : exit_ok;
}

}  // namespace taut

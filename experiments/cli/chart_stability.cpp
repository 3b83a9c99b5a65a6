#include "experiments/cli/chart_stability.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "calib/benches/uniaxial.hpp"
#include "calib/files/uniaxial_file.hpp"
#include "calib/studies/stability.hpp"
#include "experiments/cli/session.hpp"
#include "reports/stability_figures.hpp"
#include "sim/core/error.hpp"
#include "sim/files/simulation.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

/// What the chart is about, whichever kind of file it is.
struct ChartSubject {
  std::string title;
  bool simulated = false;
  std::vector<StabilityMap> maps;
  std::string fingerprint;  ///< of the file and its bench: what was run with others does not count
};

ChartSubject chart_subject(const std::string& path) {
  if (is_uniaxial(path))
    throw InputError(fmt::format(
        "{}: a material point has nothing to solve for; chart an experiment with a specimen or a simulation over time",
        path));
  const std::string fingerprint = sha256_of(path).substr(0, 8);
  if (is_simulation(path)) {
    const Simulation simulation = read_simulation(path);
    return {simulation.title, false, stability_maps(simulation), fingerprint};
  }
  const Experiment experiment = read_experiment(path);
  const Trials trials = experiment.recordings ? Trials() : read_trials(experiment.bench);
  return {experiment.title, experiment.simulated, stability_maps(experiment, trials),
          fingerprint + "-" + sha256_of(experiment.bench.path).substr(0, 8)};
}

/// A map's runs, counted by method and outcome.
Json counts_of(const StabilityMap& map, const std::vector<std::optional<StabilityRun>>& runs) {
  Json methods = Json::array();
  for (size_t m = 0; m < map.methods.size(); ++m) {
    Json method{{"method", map.methods[m]}, {"runs", 0}, {"newton_iterations", 0}, {"factorisations", 0}};
    for (size_t y = 0; y < map.y.size(); ++y) {
      for (size_t x = 0; x < map.x.size(); ++x) {
        const std::optional<StabilityRun>& run = runs[map.cell(m, x, y)];
        if (!run) continue;
        const std::string outcome(name_of(run->outcome));
        method["runs"] = method["runs"].get<int>() + 1;
        method["newton_iterations"] = method["newton_iterations"].get<int>() + run->iterations;
        method["factorisations"] = method["factorisations"].get<int>() + run->factorisations;
        method[outcome] = method.value(outcome, 0) + 1;
      }
    }
    methods.push_back(method);
  }
  return {{"map", map.id}, {"sentence", sentence_of(map, runs)}, {"methods", methods}};
}

void print_counts(const Json& map) {
  fmt::print("{}\n", map["sentence"].get<std::string>());
  for (const Json& method : map["methods"]) {
    std::string outcomes;
    for (int k = 0; k <= static_cast<int>(Outcome::intersected); ++k) {
      const std::string outcome(name_of(static_cast<Outcome>(k)));
      if (method.contains(outcome))
        outcomes += fmt::format("{}{} {}", outcomes.empty() ? "" : ", ", method[outcome].get<int>(), outcome);
    }
    fmt::print("  {:<30} {}; {} iterations\n", method["method"].get<std::string>(), outcomes,
               method["newton_iterations"].get<int>());
  }
}

}  // namespace

int chart_stability(const CommandOptions& options) {
  Progress progress(options.quiet);
  const ChartSubject subject = chart_subject(options.target);
  const fs::path folder = options.out.empty() ? fs::path(run_folder(options)) / "charts" : fs::path(options.out);
  std::error_code error;
  fs::create_directories(folder / "figures", error);
  if (error)
    throw InputError(fmt::format("{}: the folder cannot be made ({}); choose another one with --out", folder.string(),
                                 error.message()));
  StabilityStore store((folder / "stability.csv").string(), subject.fingerprint);
  StabilityOptions run;
  run.budget = options.budget;
  run.stop = options.stop;
  run.progress = [&](const StabilityMap& map, size_t done) {
    progress.show(fmt::format("{}: {} of {} runs", map.id, done, map.cells()));
  };
  const auto runs = run_stability(subject.maps, store, run);
  Json result = Json::array();
  size_t missing = 0;
  for (size_t k = 0; k < subject.maps.size(); ++k) {
    const StabilityMap& map = subject.maps[k];
    const auto empty = static_cast<size_t>(std::ranges::count_if(runs[k], [](const auto& one) { return !one; }));
    missing += empty;
    if (empty == map.cells()) continue;
    result.push_back(counts_of(map, runs[k]));
    if (!options.json) print_counts(result.back());
    draw_stability(map, runs[k], subject.title, subject.simulated, folder.string());
    progress.say(fmt::format("wrote {}", (folder / "figures" / ("stability_" + map.id + ".svg")).string()));
  }
  if (options.json) fmt::print("{}\n", Json{{"maps", result}, {"runs_left", missing}}.dump(2));
  if (missing > 0) progress.say(fmt::format("{} runs are left; the same command goes on with them", missing));
  return options.stop != nullptr && options.stop->load() ? exit_interrupted : exit_ok;
}

}  // namespace taut

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "calib/studies/stability.hpp"
#include "experiments/cli/chart.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "reports/stability_figures.hpp"

namespace taut {
namespace {

using Json = nlohmann::ordered_json;

std::vector<StabilityMap> maps_of(const Charted& charted) {
  if (const auto* simulation = std::get_if<Simulation>(&charted)) return stability_maps(*simulation);
  const Experiment& experiment = std::get<Experiment>(charted);
  return stability_maps(experiment, experiment.kind->at_rest ? read_trials(experiment.bench) : Trials());
}

/// Whether readings were simulated; a simulation is its own subject.
bool has_simulated_data(const Charted& charted) {
  const auto* experiment = std::get_if<Experiment>(&charted);
  return experiment != nullptr && experiment->simulated;
}

/// A map's runs, counted by method and outcome.
Json counts_of(const StabilityMap& map, const std::vector<std::optional<StabilityRun>>& runs) {
  Json methods = Json::array();
  for (size_t m = 0; m < map.methods.size(); ++m) {
    Json method{{"method", map.methods[m]}, {"runs", 0}, {"newton_iterations", 0}, {"factorisations", 0}};
    for (size_t cell = map.cell(m, 0, 0); cell < map.cell(m + 1, 0, 0); ++cell) {
      if (!runs[cell]) continue;
      const std::string outcome(name_of(runs[cell]->outcome));
      method["runs"] = method["runs"].get<int>() + 1;
      method["newton_iterations"] = method["newton_iterations"].get<int>() + runs[cell]->iterations;
      method["factorisations"] = method["factorisations"].get<int>() + runs[cell]->factorisations;
      method[outcome] = method.value(outcome, 0) + 1;
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
  const Charted charted = read_charted(options);
  const std::vector<StabilityMap> maps = maps_of(charted);
  const std::string title = std::visit([](const auto& one) { return one.title; }, charted);
  const ChartFolder folder = open_chart(options, "stability", charted, progress);
  const auto runs = run_stability(maps, folder.study);
  Json result = Json::array();
  size_t missing = 0, all = 0;
  for (size_t k = 0; k < maps.size(); ++k) {
    const StabilityMap& map = maps[k];
    const auto empty = static_cast<size_t>(std::count(runs[k].begin(), runs[k].end(), std::nullopt));
    missing += empty;
    all += map.cells();
    if (empty == map.cells() || folder.study.is_part()) continue;
    result.push_back(counts_of(map, runs[k]));
    if (!options.json) print_counts(result.back());
    draw_stability(map, runs[k], title, has_simulated_data(charted), folder.path.string());
    progress.say(fmt::format("wrote {}", (folder.path / "figures" / ("stability_" + map.id + ".svg")).string()));
  }
  if (options.json && !folder.study.is_part()) print_json(Json{{"maps", result}, {"runs_left", missing}});
  return close_chart(options, missing, all, progress);
}

}  // namespace taut

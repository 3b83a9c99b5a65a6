#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "calib/studies/accuracy.hpp"
#include "experiments/cli/chart.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "reports/accuracy_figures.hpp"

namespace taut {
namespace {

using Json = nlohmann::ordered_json;
using Runs = std::vector<std::optional<AccuracyRun>>;

/// Points from the fastest to the slowest.
std::vector<const AccuracyPoint*> by_time(const AccuracyChart& chart, const Runs& runs) {
  std::vector<const AccuracyPoint*> points;
  for (const AccuracyPoint& point : chart.points) points.push_back(&point);
  std::ranges::sort(points, {}, [&](const AccuracyPoint* point) { return runs[point->setting]->seconds; });
  return points;
}

Json json_of(const AccuracyStudy& study, const Runs& runs, const AccuracyChart& chart, size_t missing) {
  Json json{{"title", study.title},           {"data", study.simulated ? "simulated" : "measured"},
            {"reference", chart.reference},   {"uncertainty", chart.uncertainty},
            {"plane_section", chart.section}, {"missing", missing},
            {"settings", Json::array()},      {"failed", Json::array()}};
  for (const AccuracyPoint* point : by_time(chart, runs)) {
    const AccuracySetting& setting = study.settings[point->setting];
    const AccuracyRun& run = *runs[point->setting];
    json["settings"].push_back({{"axis", setting.axis},
                                {"setting", setting.name},
                                {"in_use", setting.in_use},
                                {"unknowns", run.unknowns},
                                {"seconds", run.seconds},
                                {"factorisations", run.factorisations},
                                {"error", point->error},
                                {"largest_error", point->largest},
                                {"parameter_errors", point->parameters},
                                {"on_front", point->on_front}});
    if (std::isfinite(point->model_error)) json["settings"].back()["model_error"] = point->model_error;
  }
  for (size_t i = 0; i < runs.size(); ++i) {
    if (runs[i] && !runs[i]->failure.empty())
      json["failed"].push_back({{"setting", study.settings[i].name}, {"reason", runs[i]->failure}});
  }
  return json;
}

void print_chart(const AccuracyStudy& study, const Runs& runs, const AccuracyChart& chart) {
  if (study.simulated) fmt::print("SIMULATED DATA, or a simulation: nothing was measured.\n");
  fmt::print("{:<52} {:>9} {:>9} {:>7} {:>9} {:>9}  {}\n", "setting", "unknowns", "time", "factor.", "error", "largest",
             "* nothing is faster and better; > in use");
  for (const AccuracyPoint* point : by_time(chart, runs)) {
    const AccuracySetting& setting = study.settings[point->setting];
    const AccuracyRun& run = *runs[point->setting];
    fmt::print("{:<52} {:>9} {:>7.3g} s {:>7} {:>7.2g} % {:>7.2g} %  {}{}\n", setting.name, run.unknowns, run.seconds,
               run.factorisations, 100 * point->error, 100 * point->largest, point->on_front ? "*" : "",
               setting.in_use ? ">" : "");
  }
  for (size_t i = 0; i < runs.size(); ++i) {
    if (runs[i] && !runs[i]->failure.empty())
      fmt::print("{:<52} failed: {}\n", study.settings[i].name, runs[i]->failure);
  }
  fmt::print("reference: {}; {}\n", chart.reference,
             std::isfinite(chart.uncertainty) ? fmt::format("known to {:.2g} %", 100 * chart.uncertainty)
                                              : "how well it is known cannot be said");
  if (!chart.section.empty()) fmt::print("{}\n", chart.section);
}

}  // namespace

int chart_accuracy(const CommandOptions& options) {
  const Charted charted = read_charted(options);
  const AccuracyStudy study = std::visit([](const auto& one) { return accuracy_study(one); }, charted);
  Progress progress(options.quiet);
  const ChartFolder folder = open_chart(options, "accuracy", charted, progress);
  progress.say(fmt::format("{} settings, at most {:.0f} s of simulations now; finished ones stand in {}",
                           study.settings.size(), options.budget, folder.study.file));
  const Runs runs = run_settings(study, folder.study);
  const auto missing = static_cast<size_t>(std::count(runs.begin(), runs.end(), std::nullopt));
  if (folder.study.is_part()) return close_chart(options, missing, runs.size(), progress);
  if (missing == runs.size() && options.interrupted()) return exit_interrupted;
  const AccuracyChart chart = judge(study, runs);
  progress.show("drawing");
  draw_accuracy(study, runs, chart, folder.path.string());
  if (options.json)
    print_json(json_of(study, runs, chart, missing));
  else
    print_chart(study, runs, chart);
  progress.say("figures: " + (folder.path / "figures" / "accuracy_cost.png").string());
  return close_chart(options, missing, runs.size(), progress);
}

}  // namespace taut

#include "experiments/cli/chart_accuracy.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "calib/benches/uniaxial.hpp"
#include "calib/files/uniaxial_file.hpp"
#include "calib/studies/accuracy.hpp"
#include "experiments/cli/session.hpp"
#include "reports/accuracy_figures.hpp"
#include "sim/core/error.hpp"
#include "sim/files/simulation.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

/// Runs of another version of the file or of its readings are others.
std::string fingerprint_of(const CommandOptions& options, const std::vector<std::string>& benches) {
  std::string text = sha256_of(options.target).substr(0, 8);
  for (const std::string& bench : benches) text += "-" + sha256_of(bench).substr(0, 8);
  return text;
}

}  // namespace

int chart_accuracy(const CommandOptions& options) {
  if (is_uniaxial(options.target))
    throw InputError(fmt::format(
        "{}: a material point has no mesh and no steps to compare; chart an experiment with a specimen or a "
        "simulation",
        options.target));
  AccuracyStudy study;
  AccuracyOptions how;
  if (is_simulation(options.target)) {
    study = accuracy_study(read_simulation(options.target));
    how.fingerprint = fingerprint_of(options, {});
  } else {
    Experiment experiment = read_experiment(options.target);
    if (options.threads > 0) experiment.threads = options.threads;
    study = accuracy_study(experiment);
    std::vector<std::string> benches{experiment.bench.path};
    if (experiment.recordings) {
      benches.clear();
      for (const RecordingSettings& recording : experiment.recordings->recordings) benches.push_back(recording.path);
    }
    how.fingerprint = fingerprint_of(options, benches);
  }
  const fs::path folder = options.out.empty() ? fs::path(run_folder(options)) / "charts" : fs::path(options.out);
  std::error_code ignored;
  fs::create_directories(folder, ignored);
  Progress progress(options.quiet);
  how.budget = options.budget;
  how.file = (folder / "accuracy.csv").string();
  how.stop = options.stop;
  how.progress = [&](const std::string& what) { progress.show(what); };
  progress.say(fmt::format("{} settings, at most {:.0f} s of simulations now; finished ones stand in {}",
                           study.settings.size(), options.budget, how.file));
  const std::vector<std::optional<AccuracyRun>> runs = run_settings(study, how);
  const auto missing = static_cast<size_t>(std::count(runs.begin(), runs.end(), std::nullopt));
  const bool interrupted = options.stop != nullptr && options.stop->load();
  if (interrupted && missing == runs.size()) return exit_interrupted;
  const AccuracyChart chart = judge(study, runs);
  progress.show("drawing");
  draw_accuracy(study, runs, chart, folder.string());

  std::vector<const AccuracyPoint*> points;
  for (const AccuracyPoint& point : chart.points) points.push_back(&point);
  std::sort(points.begin(), points.end(), [&](const AccuracyPoint* a, const AccuracyPoint* b) {
    return runs[a->setting]->seconds < runs[b->setting]->seconds;
  });
  if (options.json) {
    Json json{{"title", study.title},
              {"data", study.simulated ? "simulated" : "measured"},
              {"reference", chart.reference},
              {"uncertainty", std::isfinite(chart.uncertainty) ? Json(chart.uncertainty) : Json(nullptr)},
              {"missing", missing},
              {"settings", Json::array()},
              {"failed", Json::array()}};
    for (const AccuracyPoint* point : points) {
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
    }
    for (size_t i = 0; i < runs.size(); ++i) {
      if (runs[i] && !runs[i]->failure.empty())
        json["failed"].push_back({{"setting", study.settings[i].name}, {"reason", runs[i]->failure}});
    }
    fmt::print("{}\n", json.dump(2));
  } else {
    if (study.simulated) fmt::print("SIMULATED DATA, or a simulation: nothing was measured.\n");
    fmt::print("{:<52} {:>9} {:>9} {:>7} {:>9} {:>9}  {}\n", "setting", "unknowns", "time", "factor.", "error",
               "largest", "* nothing is faster and better; > in use");
    for (const AccuracyPoint* point : points) {
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
  }
  if (missing > 0)
    progress.say(fmt::format("{} of {} settings are missing; run it again to go on, or with a larger --budget", missing,
                             runs.size()));
  progress.say("figures: " + (folder / "figures" / "accuracy_cost.png").string());
  return interrupted ? exit_interrupted : exit_ok;
}

}  // namespace taut

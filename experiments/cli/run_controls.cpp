#include "experiments/cli/run_controls.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "calib/data/files.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"

namespace taut {

size_t load_of(const CommandOptions& options, const Bench& bench) {
  if (!options.load.empty()) return place_of_id(bench.controls(), options.load, "--load", "control of the bench");
  if (bench.drawn_control() < 0)
    throw InputError(fmt::format("{}: its bench hangs no load against which there is a stiffness", options.target));
  return static_cast<size_t>(bench.drawn_control());
}

std::vector<size_t> retractions_of(const Bench& bench) {
  std::vector<size_t> found;
  for (size_t k = 0; k < bench.controls().size(); ++k) {
    if (bench.experiment().cables.columns.contains(bench.controls()[k].id)) found.push_back(k);
  }
  return found;
}

std::vector<size_t> controls_of(const CommandOptions& options, const Bench& bench, size_t load) {
  if (!options.name.empty()) {
    const size_t named = place_of_id(bench.controls(), options.name, "--control", "control of the bench");
    if (named == load)
      throw InputError(
          fmt::format("--control {}: that is the load; say which control is sought beside it", options.name));
    if (!bench.controls()[named].labels.empty())
      throw InputError(fmt::format("--control {}: its values are names, between which there is nothing", options.name));
    return {named};
  }
  std::vector<size_t> found = retractions_of(bench);
  if (!found.empty()) return found;
  std::vector<std::string> others;
  for (size_t k = 0; k < bench.controls().size(); ++k) {
    if (k != load && bench.controls()[k].labels.empty()) others.push_back(bench.controls()[k].id);
  }
  throw InputError(others.empty() ? fmt::format("{}: its bench sets nothing besides the load, so that there is nothing "
                                                "to tune or map; a run with a retraction has",
                                                options.target)
                                  : fmt::format("{}: no cable is retracted; say with --control what is sought: {}",
                                                options.target, join(others)));
}

std::vector<double> held_controls(const CommandOptions& options, const Bench& bench, size_t load,
                                  std::optional<size_t> sought, const char* sets_load) {
  const std::vector<AxisRecord>& axes = bench.controls();
  std::vector<double> controls;
  for (size_t k = 0; k < axes.size(); ++k)
    controls.push_back(std::ranges::min(bench.values_of(k), {}, [](double value) { return std::abs(value); }));
  for (const auto& [id, text] : options.set) {
    const size_t k = place_of_id(axes, id, "--hold", "control of the bench");
    if (k == load || k == sought)
      throw InputError(fmt::format("--hold {}: that is {}; hold others", id,
                                   k == load ? fmt::format("the load, which {} sets", sets_load) : "what is sought"));
    controls[k] = in_unit_of(axes[k], text, "--hold " + id);
  }
  controls[load] = 0;
  return controls;
}

StiffnessMapText write_stiffness_map(const StiffnessMap& map, const RunRecord& record, const Bench& bench,
                                     const TuneQuestion& question, const std::string& folder) {
  const std::vector<AxisRecord>& axes = bench.controls();
  StiffnessMapText text{record.title, record.simulated, axes[map.control], axes[map.load]};
  for (size_t k = 0; k < axes.size(); ++k) {
    if (k == map.load || k == map.control) continue;
    text.held.push_back(axes[k]);
    text.held_at.push_back(question.controls[k]);
  }
  text.channels = bench.channels();
  const std::filesystem::path root(folder);
  write_file((root / "stiffness_map.csv").string(), stiffness_map_csv(map, text));
  write_file((root / "stiffness_map.json").string(), stiffness_map_json(map, text));
  return text;
}

}  // namespace taut

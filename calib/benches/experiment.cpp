#include "calib/benches/experiment.hpp"

#include <algorithm>

#include "calib/benches/control_name.hpp"
#include "sim/files/tables.hpp"
#include "sim/files/toml_reader.hpp"

namespace taut {

const std::vector<std::pair<std::string, Rung>>& rungs() {
  static const std::vector<std::pair<std::string, Rung>> all{
      {"full", Rung::full},   {"beam", Rung::beam},     {"rod", Rung::rod}, {"rigid_segments", Rung::rigid_segments},
      {"solid", Rung::solid}, {"auto", Rung::automatic}};
  return all;
}

const std::vector<std::pair<std::string, SectionLaw>>& section_laws() {
  static const std::vector<std::pair<std::string, SectionLaw>> all{{"neo_hookean", SectionLaw::neo_hookean},
                                                                   {"linear", SectionLaw::linear}};
  return all;
}

std::string_view name_of(Rung rung) {
  return std::find_if(rungs().begin(), rungs().end(), [&](const auto& known) { return known.second == rung; })->first;
}

std::vector<std::string> ids_set_by_columns(const Experiment& experiment) {
  std::vector<std::string> ids;
  for (const auto& [control, id] : experiment.set_by) ids.push_back(id);
  for (const SpecimenSettings& specimen : experiment.specimens) {
    for (const auto& [id, value] : specimen.set) ids.push_back(id);
  }
  return ids;
}

InstrumentNoise read_noise(TableReader& table, Quantity quantity, std::string_view key) {
  InstrumentNoise noise;
  auto given = table.optional_table(key);
  if (!given) return noise;
  noise.absolute = given->optional_quantity("absolute", quantity).value_or(0);
  noise.relative = given->optional_quantity("relative", Quantity::pure).value_or(0);
  noise.resolution = given->optional_quantity("resolution", quantity).value_or(0);
  if (noise.absolute < 0 || noise.relative < 0 || noise.resolution < 0) given->fail("", "noise must not be negative");
  given->finish();
  return noise;
}

std::string control_named(TableReader& table, std::string_view key, const Experiment& experiment) {
  const std::vector<BenchFormat::Control>& controls = experiment.bench.controls;
  const std::string named = table.text(key);
  const auto set_by = std::ranges::find(controls, named, &BenchFormat::Control::column);
  if (std::ranges::find(controls, named, &BenchFormat::Control::id) == controls.end()) {
    if (set_by != controls.end()) return set_by->id;
    const auto& retractions = experiment.cables.columns;
    if (named == "retraction" && retractions.size() == 1) return retractions.begin()->first;
  }
  return known_id(table, key, ids_of(controls), "set by the bench");
}

}  // namespace taut

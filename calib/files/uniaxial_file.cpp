#include "calib/files/uniaxial_file.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>

#include "calib/files/fit_tables.hpp"
#include "sim/core/error.hpp"
#include "sim/files/tables.hpp"
#include "sim/terms/solid.hpp"

namespace taut {
namespace {

constexpr PointMode all_modes[] = {PointMode::tension, PointMode::compression, PointMode::shear};

std::vector<std::string> read_modes(TableReader& table) {
  std::vector<std::string> known;
  for (PointMode mode : all_modes) known.emplace_back(name_of(mode));
  std::vector<std::string> modes;
  for (const std::string& name : table.texts_or_none("modes")) {
    if (std::find(known.begin(), known.end(), name) == known.end())
      table.fail("modes", fmt::format("'{}' is not a mode of loading{}; allowed: {}", name, did_you_mean(name, known),
                                      join(known)));
    modes.push_back(name);
  }
  return modes.empty() ? known : modes;
}

/// The constants of a law from `table`; those it does not have are taken from `otherwise`.
std::map<std::string, double> read_constants(TableReader& table, const std::string& law,
                                             const std::map<std::string, double>& otherwise) {
  std::map<std::string, double> constants;
  for (const ParameterSpec& spec : material_parameters(law)) {
    const auto before = otherwise.find(spec.id);
    constants[spec.id] = before != otherwise.end() && !table.has(spec.id)
                             ? before->second
                             : table.quantity(spec.id, quantity_of_si_unit(spec.unit));
    if (!(constants[spec.id] >= spec.lower && constants[spec.id] <= spec.upper)) {
      table.fail(spec.id, fmt::format("{:.6g} is outside the physical range of {}, {:.6g} to {:.7g} {}",
                                      constants[spec.id], spec.meaning, spec.lower, spec.upper, spec.unit));
    }
  }
  return constants;
}

void read_bench(TableReader table, Experiment& experiment) {
  const std::filesystem::path file = table.text("file"), beside = std::filesystem::path(experiment.path).parent_path();
  BenchFormat& bench = experiment.bench;
  bench.path = file.is_absolute() ? file.string() : (beside / file).lexically_normal().string();
  bench.trial_column = table.text("trial", "");
  bench.channel_column = table.text("mode");
  bench.controls = {{"strain", table.text("strain"), {Quantity::pure}}};
  bench.value_column = table.text("stress");
  bench.sigma_column = table.text("sigma", "");
  bench.ignored = table.texts_or_none("ignore");
  InstrumentNoise noise;
  if (auto given = table.optional_table("noise")) {
    noise.absolute = given->optional_quantity("absolute", Quantity::pressure).value_or(0);
    noise.relative = given->optional_quantity("relative", Quantity::pure).value_or(0);
    noise.resolution = given->optional_quantity("resolution", Quantity::pressure).value_or(0);
    if (noise.absolute < 0 || noise.relative < 0 || noise.resolution < 0) given->fail("", "noise must not be negative");
    given->finish();
  }
  if (bench.sigma_column.empty() && noise.absolute == 0 && noise.relative == 0 && noise.resolution == 0) {
    table.fail("",
               "the readings have no noise; add for example noise = { relative = \"5 %\", absolute = \"1 kPa\" }, or "
               "name a 'sigma' column");
  }
  table.finish();
  for (PointMode mode : all_modes) {
    BenchFormat::Channel channel;
    channel.id = name_of(mode);
    channel.quantity = Quantity::pressure;
    channel.noise = noise;
    bench.channels.push_back(channel);
  }
}

void read_fit(TableReader table, Experiment& experiment) {
  const MaterialSettings& material = experiment.materials.front();
  read_free(table, experiment);
  for (TableReader& entry : table.tables("variant")) {
    VariantSettings variant;
    variant.name = entry.text("name");
    variant.law = material.law;
    if (entry.has("law")) variant.law = entry.choice("law", material_laws());
    variant.constants = read_constants(entry, variant.law, material.constants);
    variant.modes = read_modes(entry);
    entry.finish();
    experiment.variants.push_back(variant);
  }
  read_references(table, experiment);
  table.finish();
}

}  // namespace

std::string_view name_of(PointMode mode) {
  return mode == PointMode::tension ? "tension" : mode == PointMode::compression ? "compression" : "shear";
}

PointMode mode_named(const std::string& name) {
  return *std::find_if(std::begin(all_modes), std::end(all_modes), [&](PointMode m) { return name_of(m) == name; });
}

Experiment read_uniaxial(const TomlFile& file, const std::string& path) {
  TableReader root = file.root();
  Experiment experiment;
  experiment.material_point = true;
  experiment.path = path;
  read_head(root, experiment);
  TableReader geometry = root.table("geometry");
  geometry.text("kind");
  geometry.finish();
  for (auto& [region, table] : root.named_tables("materials")) {
    MaterialSettings material;
    material.region = region;
    material.law = table.choice("law", material_laws());
    material.constants = read_constants(table, material.law, {});
    table.finish();
    experiment.materials.push_back(material);
  }
  if (experiment.materials.size() != 1)
    root.fail("", fmt::format("a uniaxial experiment has one material, not {}; give one [materials.NAME]",
                              experiment.materials.size()));
  read_bench(root.table("bench"), experiment);
  if (auto table = root.optional_table("fit")) read_fit(std::move(*table), experiment);
  root.finish();
  return experiment;
}

}  // namespace taut

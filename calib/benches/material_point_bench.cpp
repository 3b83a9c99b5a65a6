#include "calib/benches/material_point_bench.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <set>

#include "sim/core/units.hpp"
#include "sim/files/tables.hpp"
#include "sim/terms/solid.hpp"

namespace taut {
namespace {

VariantSettings whole_fit(const Experiment& experiment) {
  const MaterialSettings& material = experiment.materials.front();
  VariantSettings fit;
  fit.law = material.law;
  fit.constants = material.constants;
  for (const BenchFormat::Channel& mode : experiment.bench.channels) fit.modes.push_back(mode.id);
  return fit;
}

void read_bench(TableReader table, Experiment& experiment) {
  BenchFormat& bench = experiment.bench;
  bench.path = path_beside(experiment.path, table.text("file"));
  bench.trial_column = table.text("trial", "");
  bench.channel_column = table.text("mode");
  bench.controls = {{"strain", table.text("strain"), {Quantity::pure}}};
  if (table.has("order")) {
    if (!point_settings(experiment).mullins)
      table.fail("order", "it counts with softening only; add 'mullins' to the material, or leave it out");
    bench.controls.push_back({"order", table.text("order"), {Quantity::pure}});
  }
  bench.value_column = table.text("stress");
  bench.sigma_column = table.text("sigma", "");
  bench.ignored = table.columns_or_none("ignore");
  bench.excluded = table.integers_or_none("exclude", 1);
  const InstrumentNoise noise = read_noise(table, Quantity::pressure);
  if (bench.sigma_column.empty() && !noise.given()) {
    table.fail("",
               "the readings have no noise; add for example noise = { relative = \"5 %\", absolute = \"1 kPa\" }, or "
               "name a 'sigma' column");
  }
  table.finish();
  for (const std::string& mode : mode_names()) bench.channels.push_back({mode, "", Quantity::pressure, noise});
}

/// The table mullins of a material; without it there is no softening.
std::optional<Mullins> read_mullins(TableReader& material) {
  auto table = material.optional_table("mullins");
  if (!table) return std::nullopt;
  Mullins law;
  law.r = table->quantity("r", Quantity::pure);
  law.m = table->positive("m", Quantity::pressure, "energy density (1 kPa is 1 kJ/m3)");
  law.beta = table->optional_quantity("beta", Quantity::pure).value_or(0);
  if (!(law.r > 1)) table->fail("r", "a number above 1 belongs here: at most 1 / r of the stress is lost");
  if (law.beta < 0) table->fail("beta", "a number of zero or more belongs here");
  table->finish();
  return law;
}

/// What a file with geometry kind "uniaxial" says of its material (one) and its bench.
void read_uniaxial(TableReader& root, Experiment& experiment) {
  TableReader geometry = root.table("geometry");
  geometry.text("kind");
  geometry.finish();
  PointSettings settings;
  for (auto& [region, table] : root.named_tables("materials")) {
    MaterialSettings& material = experiment.materials.emplace_back();
    material.region = region;
    material.law = table.choice("law", material_laws());
    material.constants = read_constants(table, material.law);
    settings.mullins = read_mullins(table);
    table.finish();
  }
  if (experiment.materials.size() != 1)
    root.fail("", fmt::format("a uniaxial experiment has one material, not {}; give one [materials.NAME]",
                              experiment.materials.size()));
  experiment.own = settings;
  read_bench(root.table("bench"), experiment);
}

/// Keys law, its constants, and modes; what is missing is that of the material.
void read_uniaxial_variant(TableReader& table, const Experiment& experiment, VariantSettings& variant) {
  const MaterialSettings& material = experiment.materials.front();
  variant.law = table.has("law") ? table.choice("law", material_laws()) : material.law;
  variant.constants = read_constants(table, variant.law, material.constants);
  variant.modes = table.texts_or_none("modes");
  for (const std::string& name : variant.modes) check_id(table, "modes", name, mode_names(), "a mode of loading");
  if (variant.modes.empty()) variant.modes = mode_names();
}

}  // namespace

constinit const BenchKind material_point_kind{.name = "uniaxial",
                                              .about = "a material point",
                                              .specimen = false,
                                              .read = read_uniaxial,
                                              .read_variant = read_uniaxial_variant,
                                              .open = [](Experiment experiment) -> std::unique_ptr<Bench> {
                                                Trials trials = read_trials(experiment.bench);
                                                return std::make_unique<MaterialPointBench>(std::move(experiment),
                                                                                            std::move(trials));
                                              }};

MaterialPointBench::MaterialPointBench(Experiment experiment, Trials trials)
    : MaterialPointBench(experiment, std::move(trials), whole_fit(experiment)) {}

MaterialPointBench::MaterialPointBench(Experiment experiment, Trials trials, const VariantSettings& variant)
    : Bench(std::move(experiment)),
      trials_(std::move(trials)),
      fit_(variant),
      rows_(make_point_replay(experiment_.bench, trials_, point_settings(experiment_).mullins.has_value())),
      protocol_(protocol_of(rows_.rows)) {
  controls_ = {make_axis(trials_.control_ids.front(), Quantity::pure, "engineering strain")};
  drawn_label_ = "strain";
  for (const std::string& mode : trials_.channel_ids)
    channels_.push_back(make_axis(mode, Quantity::pressure, "nominal stress"));
  for (size_t i = 0; i < trials_.readings.size(); ++i) {
    const Reading& from = trials_.readings[i];
    const std::string& mode = trials_.channel_ids[static_cast<size_t>(from.channel)];
    if (std::find(fit_.modes.begin(), fit_.modes.end(), mode) == fit_.modes.end()) continue;
    if (!from.excluded) measurements_.push_back(rows_.measurements[i]);
    readings_.push_back({from, rows_.measurements[i].row, {}, {}});
    readings_.back().controls.resize(1);  // the order is in the rows
  }
}

std::unique_ptr<UniaxialProtocol> MaterialPointBench::protocol_of(std::vector<PointRow> rows) const {
  return std::make_unique<UniaxialProtocol>(experiment_.materials.front().region, fit_.law, fit_.constants,
                                            std::move(rows), point_settings(experiment_).mullins);
}

std::unique_ptr<Bench> MaterialPointBench::with(const VariantSettings& variant) const {
  return std::unique_ptr<Bench>(new MaterialPointBench(experiment_, trials_, variant));
}

std::string MaterialPointBench::model_text() const {
  std::string text = fit_.law;
  if (fit_.modes.size() == channels_.size()) return text;
  for (size_t i = 0; i < fit_.modes.size(); ++i) text += fmt::format("{}{}", i == 0 ? ", " : " and ", fit_.modes[i]);
  return text + " only";
}

std::string MaterialPointBench::size_text() const {
  return fmt::format("{} readings of a material point", readings_.size());
}

/// The curve of each mode that was fitted, from zero to the largest strain and at every reading: that of first loading.
std::vector<CurveRecord> MaterialPointBench::curves(const Params& p, const std::vector<FreeParameter>& free,
                                                    const Eigen::MatrixXd& covariance, const Ask& ask) const {
  constexpr int steps = 30;
  std::vector<CurveRecord> curves;
  for (const AxisRecord& mode : channels_) {
    std::set<double> strains;
    for (const BenchReading& reading : readings_) {
      if (channels_[static_cast<size_t>(reading.channel)].id == mode.id) strains.insert(reading.controls.front());
    }
    if (strains.empty()) continue;
    const double low = std::min(0.0, *strains.begin()), high = std::max(0.0, *strains.rbegin());
    for (int i = 0; i <= steps; ++i) strains.insert(low + (high - low) * i / steps);
    std::vector<PointRow> rows;
    for (double strain : strains) rows.push_back({mode_named(mode.id), strain});
    const std::unique_ptr<UniaxialProtocol> protocol = protocol_of(rows);
    const Prediction prediction = ask(*protocol, p, indices_of(free));
    const Eigen::VectorXd se = standard_errors(prediction, protocol->parameters(), p, free, covariance);
    CurveRecord& curve = curves.emplace_back();
    curve.channel = mode.id;
    curve.series = fit_.name.empty() ? model_text() + " (this fit)" : fit_.name;
    curve.load.assign(strains.begin(), strains.end());
    curve.value.assign(prediction.values.begin(), prediction.values.end());
    curve.se.assign(se.begin(), se.end());
  }
  return curves;
}

Lines MaterialPointBench::describe() const {
  Lines lines{{"data", experiment_.simulated ? "simulated" : "measured"},
              {"geometry", "material point: homogeneous deformation, free sides in tension and compression"}};
  add_material_lines(experiment_, lines);
  for (size_t channel = 0; channel < channels_.size(); ++channel) {
    std::set<double> strains;
    size_t count = 0;
    for (const BenchReading& reading : readings_) {
      if (reading.channel != static_cast<int>(channel)) continue;
      strains.insert(reading.controls.front());
      ++count;
    }
    if (count > 0)
      lines.emplace_back(channels_[channel].id, fmt::format("{} readings, strains from {:.3g} to {:.3g} %", count,
                                                            100 * *strains.begin(), 100 * *strains.rbegin()));
  }
  // The first remark counts conditions and trials as if each mode were read at every strain.
  for (size_t i = 1; i < trials_.remarks.size(); ++i) lines.emplace_back("bench", trials_.remarks[i]);
  if (!trials_.layout.empty()) lines.emplace_back("bench file", trials_.layout);
  return lines;
}

}  // namespace taut

#include "calib/uniaxial.hpp"

#include <fmt/format.h>
#include <toml++/toml.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <optional>

#include "calib/bench.hpp"
#include "calib/toml_reader.hpp"
#include "sim/core/error.hpp"
#include "sim/materials/all.hpp"
#include "sim/terms/solid.hpp"

namespace taut {
namespace {

constexpr PointMode all_modes[] = {PointMode::tension, PointMode::compression, PointMode::shear};

PointMode mode_named(const std::string& name) {
  return *std::find_if(std::begin(all_modes), std::end(all_modes), [&](PointMode m) { return name_of(m) == name; });
}

/// The lateral strain a - 1 at which sides are free; nothing when it is not found. Newton's method on ln a, in which
/// far stretches are near: dPsi/d ln a = 2 a P_22 on both sides together. The start, a = s^-nu with the law's Poisson's
/// ratio at rest, is the answer for laws of logarithmic strain, Ogden-Hill among them.
template <class Material>
std::optional<double> lateral_strain(const Material& material, double strain) {
  const Tangent<double, 3> rest = material.tangent(Tensor<double, 3>(Tensor<double, 3>::Zero()));
  double lateral = std::expm1(-rest(0, 4) / (rest(4, 4) + rest(4, 8)) * std::log1p(strain));
  for (int iteration = 0; iteration < 100; ++iteration) {
    const Tensor<double, 3> H = Eigen::Vector3d(strain, lateral, lateral).asDiagonal();
    const double a = 1 + lateral, residual = a * material.stress(H)(1, 1);
    const Tangent<double, 3> A = material.tangent(H);
    double step = -residual / (a * a * (A(4, 4) + A(4, 8)) + residual);
    if (!std::isfinite(step)) return std::nullopt;
    step = std::clamp(step, -0.5, 0.5);
    lateral += a * std::expm1(step);
    if (std::abs(step) <= 1e-9 * (std::abs(strain) + std::abs(lateral))) return lateral;  // what is left is its square
  }
  return std::nullopt;
}

struct PointStress {
  double value = 0;                 ///< nominal [Pa]
  std::vector<double> derivatives;  ///< with respect to each constant of the law
};

template <class Material>
std::optional<PointStress> stress_at(const PointRow& row, const Params& p) {
  std::array<double, std::tuple_size_v<decltype(Material::parameters())>> theta;
  for (size_t j = 0; j < theta.size(); ++j) theta[j] = p[static_cast<Eigen::Index>(j)];
  const Material material(theta);
  PointStress result;
  Tensor<double, 3> H = Tensor<double, 3>::Zero();
  double follows = 0;  // dP_11 / dP_22 as the sides give way
  if (row.mode == PointMode::shear) {
    H(0, 1) = row.strain;
    result.value = material.stress(H)(0, 1);
  } else {
    const std::optional<double> lateral = lateral_strain(material, row.strain);
    if (!lateral) return std::nullopt;
    H = Eigen::Vector3d(row.strain, *lateral, *lateral).asDiagonal();
    const Tangent<double, 3> A = material.tangent(H);
    follows = (A(0, 4) + A(0, 8)) / (A(4, 4) + A(4, 8));
    result.value = material.stress(H)(0, 0);
  }
  for (size_t j = 0; j < theta.size(); ++j) {
    const Tensor<double, 3> change = Material::derivative(theta, static_cast<int>(j)).stress(H);
    result.derivatives.push_back(row.mode == PointMode::shear ? change(0, 1) : change(0, 0) - follows * change(1, 1));
  }
  if (!std::isfinite(result.value)) return std::nullopt;
  return result;
}

template <class... Material>
std::optional<PointStress> stress_of_law(std::tuple<Material...>*, std::string_view law, const PointRow& row,
                                         const Params& p) {
  std::optional<PointStress> result;
  (void)((law == Material::id && (result = stress_at<Material>(row, p), true)) || ...);
  return result;
}

std::vector<PointMode> read_modes(TableReader& table) {
  std::vector<std::string> known;
  for (PointMode mode : all_modes) known.emplace_back(name_of(mode));
  std::vector<PointMode> modes;
  for (const std::string& name : table.texts_or_none("modes")) {
    if (std::find(known.begin(), known.end(), name) == known.end())
      table.fail("modes", fmt::format("'{}' is not a mode of loading{}; allowed: {}", name, did_you_mean(name, known),
                                      join(known)));
    modes.push_back(mode_named(name));
  }
  return modes.empty() ? std::vector<PointMode>(std::begin(all_modes), std::end(all_modes)) : modes;
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

void read_fit(TableReader table, UniaxialExperiment& experiment) {
  const MaterialSettings& material = experiment.common.materials.front();
  for (auto& [id, free] : table.named_tables("free")) {
    experiment.common.free.push_back(
        {id, free.optional_given("start"), free.optional_given("lower"), free.optional_given("upper")});
    free.finish();
  }
  for (TableReader& entry : table.tables("variant")) {
    UniaxialVariant variant;
    variant.name = entry.text("name");
    variant.law = material.law;
    if (entry.has("law")) variant.law = entry.choice("law", material_laws());
    variant.constants = read_constants(entry, variant.law, material.constants);
    variant.modes = read_modes(entry);
    entry.finish();
    experiment.variants.push_back(variant);
  }
  for (TableReader& entry : table.tables("reference")) {
    ReferenceValue reference;
    reference.parameter = entry.text("parameter");
    if (!entry.has("value")) entry.fail("", "'value' is missing; add the published value with its unit");
    reference.value = *entry.optional_given("value");
    reference.source = entry.text("source");
    entry.finish();
    experiment.common.references.push_back(reference);
  }
  table.finish();
}

}  // namespace

std::string_view name_of(PointMode mode) {
  return mode == PointMode::tension ? "tension" : mode == PointMode::compression ? "compression" : "shear";
}

UniaxialProtocol::UniaxialProtocol(const std::string& region, const std::string& law,
                                   const std::map<std::string, double>& constants, std::vector<PointRow> rows)
    : law_(law), rows_(std::move(rows)) {
  std::vector<std::string> known;
  for (const ParameterSpec& spec : material_parameters(law)) known.push_back(spec.id);
  for (const auto& [id, value] : constants) {
    if (std::find(known.begin(), known.end(), id) == known.end())
      throw InputError(fmt::format("material of region '{}': '{}' has no constant '{}'{}; it has: {}", region, law, id,
                                   did_you_mean(id, known), join(known)));
  }
  nominal_.resize(static_cast<Eigen::Index>(known.size()));
  for (ParameterSpec spec : material_parameters(law)) {
    const auto found = constants.find(spec.id);
    if (found == constants.end())
      throw InputError(fmt::format("material of region '{}': {} ({}) is missing; law '{}' needs {}", region, spec.id,
                                   spec.meaning, law, join(known)));
    spec.id += "_" + region;
    spec.meaning += " of " + region;
    const int index = table_.declare(std::move(spec));
    table_.check(index, found->second);
    nominal_[index] = found->second;
  }
}

Prediction UniaxialProtocol::predict(const Params& p, const std::vector<int>& free) {
  const Eigen::Index k = static_cast<Eigen::Index>(free.size());
  Prediction prediction;
  prediction.values = Eigen::VectorXd::Constant(row_count(), std::numeric_limits<double>::quiet_NaN());
  if (k > 0)
    prediction.derivatives = Eigen::MatrixXd::Constant(row_count(), k, std::numeric_limits<double>::quiet_NaN());
  for (Eigen::Index r = 0; r < row_count(); ++r) {
    const PointRow& row = rows_[static_cast<size_t>(r)];
    const auto stress = stress_of_law(static_cast<AllMaterials<>*>(nullptr), law_, row, p);
    if (!stress) {
      std::string at;
      for (int i = 0; i < table_.size(); ++i) at += fmt::format(" {} = {:.6g}", table_[i].id, p[i]);
      prediction.failures.push_back(fmt::format(
          "no stress in {} at the strain {:.6g} with{}: free sides were not found", name_of(row.mode), row.strain, at));
      continue;
    }
    prediction.values[r] = stress->value;
    for (Eigen::Index j = 0; j < k; ++j)
      prediction.derivatives(r, j) = stress->derivatives[static_cast<size_t>(free[static_cast<size_t>(j)])];
  }
  return prediction;
}

bool is_uniaxial(const std::string& path) {
  try {
    return toml::parse_file(path)["geometry"]["kind"].value_or(std::string()) == "uniaxial";
  } catch (const toml::parse_error&) {
    return false;
  }
}

UniaxialExperiment read_uniaxial(const std::string& path) {
  const toml::table file = toml::parse_file(path);
  TableReader root(file, path, "");
  UniaxialExperiment experiment;
  Experiment& common = experiment.common;
  common.path = path;
  common.title = root.text("title");
  const std::string data = root.text("data");
  if (data != "measured" && data != "simulated")
    root.fail("data", fmt::format("'{}' is not known{}; allowed: measured, simulated", data,
                                  did_you_mean(data, {"measured", "simulated"})));
  common.simulated = data == "simulated";
  TableReader geometry = root.table("geometry");
  common.geometry.kind = geometry.text("kind");
  geometry.finish();
  for (auto& [region, table] : root.named_tables("materials")) {
    MaterialSettings material;
    material.region = region;
    material.law = table.choice("law", material_laws());
    material.constants = read_constants(table, material.law, {});
    table.finish();
    common.materials.push_back(material);
  }
  if (common.materials.size() != 1)
    root.fail("", fmt::format("a uniaxial experiment has one material, not {}; give one [materials.NAME]",
                              common.materials.size()));
  read_bench(root.table("bench"), common);
  if (auto table = root.optional_table("fit")) read_fit(std::move(*table), experiment);
  root.finish();
  return experiment;
}

UniaxialBench make_uniaxial_bench(const BenchFormat& format, const Trials& trials) {
  UniaxialBench bench;
  for (const Reading& reading : trials.readings) {
    const PointMode mode = mode_named(trials.channel_ids[static_cast<size_t>(reading.channel)]);
    const double strain = reading.controls.front();
    const bool wrong_sign =
        (mode == PointMode::tension && strain < 0) || (mode == PointMode::compression && strain > 0);
    if (wrong_sign || (mode != PointMode::shear && !(strain > -1))) {
      throw InputError(
          fmt::format("{}, line {}: the engineering strain {:.6g} is not one of {}; tension has positive "
                      "strains, compression negative ones above -1",
                      format.path, reading.line, strain, name_of(mode)));
    }
    const auto found = std::find_if(bench.rows.begin(), bench.rows.end(),
                                    [&](const PointRow& r) { return r.mode == mode && r.strain == strain; });
    const int row = static_cast<int>(found - bench.rows.begin());
    if (found == bench.rows.end()) bench.rows.push_back({mode, strain});
    bench.measurements.push_back({row, reading.value, reading.sigma, row});
  }
  return bench;
}

std::vector<FreeParameter> free_parameters_of_law(const Experiment& experiment, const Protocol& protocol) {
  Experiment known = experiment;
  std::erase_if(known.free, [&](const FreeSettings& free) { return !protocol.parameters().contains(free.id); });
  return free_parameters(known, protocol);
}

}  // namespace taut

#include "calib/benches/uniaxial.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "calib/benches/static_replay.hpp"
#include "sim/core/error.hpp"
#include "sim/materials/laws.hpp"

namespace taut {
namespace {

constexpr PointMode all_modes[] = {PointMode::tension, PointMode::compression, PointMode::shear};

/// The lateral strain a - 1 at which sides are free; nothing when it is not found. Newton's method on ln a, in which
/// far stretches are near: dPsi/d ln a = 2 a P_22 on both sides together. The start, a = s^-nu with the law's Poisson's
/// ratio at rest, is the answer for laws of logarithmic strain, Ogden-Hill among them.
std::optional<double> lateral_strain(const PointLaw<3>& material, double strain) {
  const Tangent<double, 3> rest = material.tangent(Tensor<double, 3>::Zero());
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

std::optional<PointStress> stress_at(const PointLaw<3>& material, const PointRow& row, Eigen::Index constants) {
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
  for (int j = 0; j < constants; ++j) {
    const Tensor<double, 3> change = material.stress_derivative(H, j);
    result.derivatives.push_back(row.mode == PointMode::shear ? change(0, 1) : change(0, 0) - follows * change(1, 1));
  }
  if (!std::isfinite(result.value)) return std::nullopt;
  return result;
}

}  // namespace

std::string_view name_of(PointMode mode) {
  return mode == PointMode::tension ? "tension" : mode == PointMode::compression ? "compression" : "shear";
}

PointMode mode_named(const std::string& name) {
  return *std::find_if(std::begin(all_modes), std::end(all_modes), [&](PointMode m) { return name_of(m) == name; });
}

std::vector<std::string> mode_names() {
  std::vector<std::string> names;
  for (PointMode mode : all_modes) names.emplace_back(name_of(mode));
  return names;
}

UniaxialProtocol::UniaxialProtocol(const std::string& region, const std::string& law,
                                   const std::map<std::string, double>& constants, std::vector<PointRow> rows)
    : law_(law), rows_(std::move(rows)) {
  const auto parameters = region_parameters(region, law, constants);
  nominal_.resize(static_cast<Eigen::Index>(parameters.size()));
  for (const auto& [spec, value] : parameters) {
    const int index = table_.declare(spec);
    table_.check(index, value);
    nominal_[index] = value;
  }
}

Prediction UniaxialProtocol::predict(const Params& p, const std::vector<int>& free) {
  const Eigen::Index k = static_cast<Eigen::Index>(free.size());
  Prediction prediction;
  prediction.values = Eigen::VectorXd::Constant(row_count(), std::numeric_limits<double>::quiet_NaN());
  if (k > 0)
    prediction.derivatives = Eigen::MatrixXd::Constant(row_count(), k, std::numeric_limits<double>::quiet_NaN());
  const std::unique_ptr<PointLaw<3>> material = law_named(law_).solid({p.begin(), p.end()}, false);
  for (Eigen::Index r = 0; r < row_count(); ++r) {
    const PointRow& row = rows_[static_cast<size_t>(r)];
    const auto stress = stress_at(*material, row, p.size());
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

PointReplay make_point_replay(const BenchFormat& format, const Trials& trials) {
  PointReplay bench;
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

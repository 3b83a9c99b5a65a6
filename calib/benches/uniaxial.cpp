#include "calib/benches/uniaxial.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <optional>
#include <utility>

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

/// H = F - I of a row; nothing when its free sides are not found.
std::optional<Tensor<double, 3>> deformation_at(const PointLaw<3>& material, PointMode mode, double strain) {
  Tensor<double, 3> H = Tensor<double, 3>::Zero();
  if (mode == PointMode::shear) {
    H(0, 1) = strain;
    return H;
  }
  const std::optional<double> lateral = lateral_strain(material, strain);
  if (!lateral) return std::nullopt;
  H = Eigen::Vector3d(strain, *lateral, *lateral).asDiagonal();
  return H;
}

/// A number with its derivatives with respect to each constant of the law.
struct PointValue {
  double value = 0;
  std::vector<double> derivatives;
};

/// Energy density [J/m^3]. dW/dtheta at fixed H is the work of dP/dtheta on a straight way to it: Gauss's rule with
/// three points on each of 24 pieces.
PointValue energy_at(const PointLaw<3>& material, const Tensor<double, 3>& H, Eigen::Index constants) {
  constexpr int pieces = 24;
  const double reach = std::sqrt(0.6);
  PointValue result{material.energy(H), {}};
  for (int j = 0; j < constants; ++j) {
    double work = 0;
    for (int i = 0; i < pieces; ++i) {
      for (const auto& [at, weight] : {std::pair{-reach, 5.0 / 18}, {0.0, 8.0 / 18}, {reach, 5.0 / 18}})
        work +=
            weight / pieces * material.stress_derivative((i + 0.5 + 0.5 * at) / pieces * H, j).cwiseProduct(H).sum();
    }
    result.derivatives.push_back(work);
  }
  return result;
}

/// Nominal stress [Pa].
std::optional<PointValue> stress_at(const PointLaw<3>& material, const PointRow& row, Eigen::Index constants) {
  const std::optional<Tensor<double, 3>> deformation = deformation_at(material, row.mode, row.strain);
  if (!deformation) return std::nullopt;
  const Tensor<double, 3>& H = *deformation;
  PointValue result;
  double follows = 0;  // dP_11 / dP_22 as the sides give way
  if (row.mode == PointMode::shear) {
    result.value = material.stress(H)(0, 1);
  } else {
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

/// The stress of a specimen that has seen the row's peak; derivatives of the softening's parameters stand behind those
/// of the law's constants.
std::optional<PointValue> softened(const PointLaw<3>& material, const PointRow& row, Eigen::Index constants,
                                   const Mullins& law, PointValue stress) {
  if (std::abs(row.peak) <= std::abs(row.strain)) {  // first loading
    stress.derivatives.resize(stress.derivatives.size() + 3, 0.0);
    return stress;
  }
  const auto here = deformation_at(material, row.mode, row.strain), peak = deformation_at(material, row.mode, row.peak);
  if (!here || !peak) return std::nullopt;
  const PointValue energy = energy_at(material, *here, constants), largest = energy_at(material, *peak, constants);
  const Softening softening(law, energy.value, largest.value);
  PointValue result{softening.eta * stress.value, {}};
  for (size_t j = 0; j < stress.derivatives.size(); ++j)
    result.derivatives.push_back(
        softening.eta * stress.derivatives[j] +
        stress.value * (softening.by_energy * energy.derivatives[j] + softening.by_largest * largest.derivatives[j]));
  for (const double by : softening.by_parameter) result.derivatives.push_back(stress.value * by);
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
                                   const std::map<std::string, double>& constants, std::vector<PointRow> rows,
                                   const std::optional<Mullins>& mullins)
    : law_(law), rows_(std::move(rows)) {
  auto parameters = region_parameters(region, law, constants);
  if (mullins) {
    softening_ = static_cast<int>(parameters.size());
    const auto add = [&](const char* symbol, const char* unit, double lower, double upper, const char* meaning,
                         double value) {
      parameters.push_back(
          {{fmt::format("mullins_{}_{}", symbol, region), symbol, unit, lower, upper, meaning, *unit == 'P'}, value});
    };
    add("r", "1", 1, 1e3, "softening by the first loading: at most 1 / r of the stress is lost", mullins->r);
    add("m", "Pa", 1e-9, 1e12, "softening by the first loading: the energy density that it takes", mullins->m);
    add("beta", "1", 0, 1e3, "softening by the first loading: growth of m with the largest energy", mullins->beta);
  }
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
  const Eigen::Index constants = softening_ < 0 ? p.size() : softening_;
  const std::unique_ptr<PointLaw<3>> material = law_named(law_).solid({p.begin(), p.begin() + constants}, false);
  for (Eigen::Index r = 0; r < row_count(); ++r) {
    const PointRow& row = rows_[static_cast<size_t>(r)];
    std::optional<PointValue> stress = stress_at(*material, row, constants);
    if (stress && softening_ >= 0)
      stress = softened(*material, row, constants, {p[softening_], p[softening_ + 1], p[softening_ + 2]},
                        *std::move(stress));
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

namespace {

/// Of each reading, the strain of largest size that its specimen has seen before.
std::vector<double> peaks_of(const Trials& trials) {
  std::vector<size_t> order(trials.readings.size());
  std::iota(order.begin(), order.end(), size_t{0});
  if (trials.control_ids.size() > 1)
    std::ranges::stable_sort(order, {}, [&](size_t i) { return trials.readings[i].controls[1]; });
  std::map<std::pair<int, std::string>, double> seen;  // by mode and trial
  std::vector<double> peaks(order.size());
  for (const size_t i : order) {
    const Reading& reading = trials.readings[i];
    double& peak = seen[{reading.channel, reading.trial}];
    peaks[i] = peak;
    if (std::abs(reading.controls.front()) > std::abs(peak)) peak = reading.controls.front();
  }
  return peaks;
}

}  // namespace

PointReplay make_point_replay(const BenchFormat& format, const Trials& trials, bool softening) {
  PointReplay bench;
  const std::vector<double> peaks = softening ? peaks_of(trials) : std::vector<double>(trials.readings.size(), 0.0);
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
    // What was less than this reading leaves no trace in it.
    double peak = peaks[static_cast<size_t>(&reading - trials.readings.data())];
    if (std::abs(peak) <= std::abs(strain)) peak = 0;
    const auto found = std::find_if(bench.rows.begin(), bench.rows.end(), [&](const PointRow& r) {
      return r.mode == mode && r.strain == strain && r.peak == peak;
    });
    const int row = static_cast<int>(found - bench.rows.begin());
    if (found == bench.rows.end()) bench.rows.push_back({mode, strain, peak});
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

#include "calib/fit/gauss_newton.hpp"

#include <algorithm>
#include <cmath>

#include "calib/fit/goodness_of_fit.hpp"
#include "sim/core/dense.hpp"

namespace taut {

double scale_of(const FreeParameter& parameter, const ParameterTable& table, const Params& p) {
  const double value = p[parameter.index], range = parameter.upper - parameter.lower;
  if (table[parameter.index].logarithmic) return value;
  return std::isfinite(range) ? range : std::max(std::abs(value), 1e-12);
}

std::vector<FreeParameter> free_at(const FitResult& fit, const ParameterTable& table) {
  std::vector<FreeParameter> free;
  for (const ParameterEstimate& e : fit.parameters) free.push_back({table.index(e.spec.id), e.value, e.lower, e.upper});
  return free;
}

std::vector<FreeParameter> free_beyond_bounds(const FitResult& fit, const ParameterTable& table) {
  std::vector<FreeParameter> free = free_at(fit, table);
  for (FreeParameter& one : free) {
    const double range = one.upper - one.lower;
    const bool logarithmic = table[one.index].logarithmic;
    const auto apart = [&](double bound) {
      return logarithmic ? std::abs(std::log(one.start / bound)) : std::abs(one.start - bound) / range;
    };
    if (apart(one.lower) < 1e-6 || apart(one.upper) < 1e-6) continue;
    one.lower = logarithmic ? std::min(one.lower, one.start / 4) : one.lower - range;
    one.upper = logarithmic ? std::max(one.upper, one.start * 4) : one.upper + range;
  }
  return free;
}

Eigen::VectorXd gauss_newton_step(const Prediction& prediction, const std::vector<Measurement>& measurements,
                                  const ParameterTable& table, const Params& p,
                                  const std::vector<FreeParameter>& free) {
  const Eigen::Index n = static_cast<Eigen::Index>(free.size());
  Eigen::VectorXd range(n), lowest(n), highest(n);
  auto [r, J] = noise_scaled(prediction, measurements);
  // Logarithmic parameters by d = 1 - value/new, so new = value / (1 - d); others in units of their range.
  for (Eigen::Index j = 0; j < n; ++j) {
    const FreeParameter& parameter = free[static_cast<size_t>(j)];
    const double value = p[parameter.index];
    range[j] = scale_of(parameter, table, p);
    if (table[parameter.index].logarithmic) {
      lowest[j] = std::max(-2.0, 1 - value / parameter.lower);
      highest[j] = std::min(2.0 / 3, 1 - value / parameter.upper);
    } else {
      lowest[j] = (parameter.lower - value) / range[j];
      highest[j] = (parameter.upper - value) / range[j];
    }
  }
  J *= range.asDiagonal();
  // The one that would leave its bounds by most stops there, and the others are asked again: what it drags along may
  // stay within its own.
  Eigen::VectorXd d = Eigen::VectorXd::Zero(n);
  std::vector<bool> held(free.size(), false);
  for (bool changed = true; changed;) {
    changed = false;
    Eigen::VectorXd left = -r;
    Eigen::MatrixXd open = J;
    for (Eigen::Index j = 0; j < n; ++j) {
      if (!held[static_cast<size_t>(j)]) continue;
      left -= d[j] * J.col(j);
      open.col(j).setZero();
    }
    const auto [U, s, V] = singular_values(open);
    const Eigen::VectorXd inverse = s.cwiseQuotient(s.cwiseMax(0.01).cwiseAbs2());
    const Eigen::VectorXd step = V * inverse.asDiagonal() * (U.transpose() * left);
    Eigen::Index farthest = 0;
    double most = 0;
    for (Eigen::Index j = 0; j < n; ++j) {
      if (held[static_cast<size_t>(j)]) continue;
      d[j] = std::clamp(step[j], lowest[j], highest[j]);
      if (std::abs(d[j] - step[j]) <= most) continue;
      most = std::abs(d[j] - step[j]);
      farthest = j;
    }
    if (most > 0) held[static_cast<size_t>(farthest)] = changed = true;
  }
  for (Eigen::Index j = 0; j < n; ++j)
    d[j] = table[free[static_cast<size_t>(j)].index].logarithmic ? -std::log1p(-d[j]) : d[j] * range[j];
  return d;
}

}  // namespace taut

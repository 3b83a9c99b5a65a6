#include "calib/fit/held_out.hpp"

#include <cmath>

#include "calib/fit/distributions.hpp"
#include "calib/fit/goodness_of_fit.hpp"
#include "sim/core/dense.hpp"

namespace taut {
namespace {

constexpr double least_seen = 1e-9;  ///< singular value of unit columns below which a direction is not seen
constexpr double only_there = 0.01;  ///< of 1 - H_gg: errors ten times as large without the part
constexpr double much_worse = 9;     ///< ratio of variances: errors three times as large without the part
constexpr double at_bound = 1e-6;    ///< of the range between the bounds

/// Derivatives of the parameters that may move, each column of unit length.
Eigen::MatrixXd unit_columns(const Eigen::MatrixXd& jacobian, const FitResult& fit) {
  Eigen::MatrixXd J = jacobian.leftCols(static_cast<Eigen::Index>(fit.parameters.size()));
  for (Eigen::Index j = 0; j < J.cols(); ++j) {
    const ParameterEstimate& e = fit.parameters[static_cast<size_t>(j)];
    const double room = std::min(e.value - e.lower, e.upper - e.value), norm = J.col(j).norm();
    if (norm > 0 && room > at_bound * std::min(e.upper - e.lower, std::abs(e.value)))
      J.col(j) /= norm;
    else
      J.col(j).setZero();
  }
  return J;
}

/// Variances of the parameters in units of unit_columns(); those that J does not see have almost none to bound them.
Eigen::VectorXd variances(const Eigen::MatrixXd& J) {
  const SymmetricModes modes = symmetric_modes(J.transpose() * J);
  const Eigen::VectorXd inverse = modes.values.cwiseMax(1e-14).cwiseInverse();
  return (modes.vectors.cwiseAbs2() * inverse);
}

}  // namespace

HeldOut held_out(const Prediction& prediction, const std::vector<Measurement>& measurements, const FitResult& fit,
                 const std::string& part, const std::vector<size_t>& rows) {
  const NoiseScaled scaled = noise_scaled(prediction, measurements);
  const Eigen::MatrixXd J = unit_columns(scaled.jacobian, fit);
  const auto [U, s, V] = singular_values(J);
  const Eigen::MatrixXd basis = U.leftCols((s.array() > least_seen).count());
  const auto n = static_cast<Eigen::Index>(rows.size());
  Eigen::MatrixXd of_part(n, basis.cols()), without = J;
  Eigen::VectorXd r(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const auto row = static_cast<Eigen::Index>(rows[static_cast<size_t>(i)]);
    of_part.row(i) = basis.row(row);
    r[i] = scaled.residuals[row];
    without.row(row).setZero();
  }
  HeldOut result;
  result.part = part;
  result.readings = static_cast<int>(n);
  const SymmetricModes open = symmetric_modes(Eigen::MatrixXd::Identity(n, n) - of_part * of_part.transpose());
  for (Eigen::Index k = 0; k < n; ++k) {
    if (open.values[k] < only_there) continue;
    ++result.dof;
    result.chi_squared += std::pow(open.vectors.col(k).dot(r), 2) / open.values[k];
  }
  result.p_value = chi_squared_probability(result.chi_squared, result.dof);
  const Eigen::VectorXd growth = variances(without).cwiseQuotient(variances(J));
  for (Eigen::Index j = 0; j < J.cols(); ++j) {
    if (growth[j] > much_worse && !J.col(j).isZero(0))
      result.own.push_back(fit.parameters[static_cast<size_t>(j)].spec.id);
  }
  return result;
}

}  // namespace taut

#include "calib/fit/goodness_of_fit.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include "calib/fit/distributions.hpp"

namespace taut {

NoiseScaled noise_scaled(const Prediction& prediction, const std::vector<Measurement>& measurements) {
  const Eigen::Index count = static_cast<Eigen::Index>(measurements.size());
  NoiseScaled scaled{Eigen::VectorXd(count), Eigen::MatrixXd(count, prediction.derivatives.cols())};
  for (Eigen::Index i = 0; i < count; ++i) {
    const Measurement& m = measurements[static_cast<size_t>(i)];
    scaled.residuals[i] = (prediction.values[m.row] - m.value) / m.sigma;
    if (scaled.jacobian.cols() > 0) scaled.jacobian.row(i) = prediction.derivatives.row(m.row) / m.sigma;
  }
  return scaled;
}

LackOfFit lack_of_fit(const std::vector<Measurement>& measurements, double chi_squared, size_t parameters) {
  struct Sums {
    double w = 0, wy = 0;
  };
  std::map<int, Sums> groups;
  for (const Measurement& m : measurements) {
    Sums& sums = groups[m.group];
    const double w = 1 / (m.sigma * m.sigma);
    sums.w += w;
    sums.wy += w * m.value;
  }
  double pure_error = 0;
  for (const Measurement& m : measurements) {
    const Sums& sums = groups[m.group];
    pure_error += std::pow((m.value - sums.wy / sums.w) / m.sigma, 2);
  }
  LackOfFit result;
  result.pure_error = pure_error;
  result.pure_error_dof = static_cast<int>(measurements.size() - groups.size());
  result.lack_of_fit = std::max(0.0, chi_squared - pure_error);
  result.lack_of_fit_dof = static_cast<int>(groups.size()) - static_cast<int>(parameters);
  result.available = result.pure_error_dof > 0 && result.lack_of_fit_dof > 0 && pure_error > 0;
  if (result.available) {
    result.F = (result.lack_of_fit / result.lack_of_fit_dof) / (result.pure_error / result.pure_error_dof);
    result.p_value = f_probability(result.F, result.lack_of_fit_dof, result.pure_error_dof);
  }
  return result;
}

}  // namespace taut

#pragma once
#include <vector>

#include "calib/fit/fit.hpp"

namespace taut {

/// Residuals (predicted - measured) / sigma of measurements, and derivatives of a prediction over sigma.
struct NoiseScaled {
  Eigen::VectorXd residuals;
  Eigen::MatrixXd jacobian;  ///< measurements x the prediction's derivatives
};
/// Residuals over their sigmas; see NoiseScaled.
NoiseScaled noise_scaled(const Prediction& prediction, const std::vector<Measurement>& measurements);

/// Splits chi squared into the scatter of repeats about their weighted means and the rest, and compares the two (see
/// LackOfFit). `parameters` is the number that was fitted.
LackOfFit lack_of_fit(const std::vector<Measurement>& measurements, double chi_squared, size_t parameters);

}  // namespace taut

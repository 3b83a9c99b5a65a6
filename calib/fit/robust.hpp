#pragma once
#include <string>
#include <vector>

#include "calib/fit/fit.hpp"

namespace taut {

/// Standard deviations from which a reading is an outlier of a robust fit: Student's t with 4 degrees of freedom gives
/// it a fifth of its weight.
inline constexpr double outlier_from = 4;

/// What a robust fit found.
struct RobustFit {
  std::string method;                           ///< "Student's t, 4 degrees of freedom"
  std::vector<double> values, standard_errors;  ///< per free parameter, SI
  Eigen::VectorXd residuals;                    ///< per measurement: measured - predicted, over sigma
  int evaluations = 0;
};

/// The parameters that make readings most likely whose noise has Student's t distribution with nu = 4 degrees of
/// freedom, scaled by the declared sigmas, so that readings far off count little: minimises sum (nu + 1) ln(1 + r^2 /
/// nu), by iteratively reweighted Gauss-Newton steps from the optimum of `fit` (weights (nu + 1) / (nu + r^2); in the
/// linearised model until they no longer change, then one more prediction). Standard errors by the Fisher information
/// of that distribution, (nu + 3) / (nu + 1) (J^T J)^-1 (Lange, Little and Taylor, J. Am. Stat. Assoc. 84, 1989): 1.18
/// times those of least squares. Of several minima the one near `fit` is found. Throws InputError when it does not
/// converge within 12 predictions or a simulation fails.
RobustFit robust_fit(Protocol& protocol, const std::vector<Measurement>& measurements,
                     const std::vector<FreeParameter>& free, const FitResult& fit);

}  // namespace taut

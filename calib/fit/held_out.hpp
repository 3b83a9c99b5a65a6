#pragma once
#include <string>
#include <vector>

#include "calib/fit/fit.hpp"

namespace taut {

/// How the fit of all other readings predicts those of one part (cross-validation).
struct HeldOut {
  std::string part;              ///< "retraction = 5.89 mm"
  int readings = 0;              ///< of it
  double chi_squared = 0;        ///< of their distances from that prediction, over its own errors and the noise
  int dof = 0;                   ///< readings, less the directions that this part alone determines
  double p_value = 1;            ///< of so large a chi squared
  std::vector<std::string> own;  ///< free parameters that the other readings determine three times worse or not at all
};

/// To first order at the optimum of all readings, without a simulation: with J the derivatives and r the residuals over
/// the sigmas, H = J (J^T J)^-1 J^T and g the part's rows, the fit without them misses them by (1 - H_gg)^-1 r_g, whose
/// covariance is (1 - H_gg)^-1; so chi squared is r_g^T (1 - H_gg)^-1 r_g. Directions in which 1 - H_gg < 0.01 are
/// those that only this part determines. `prediction` has the derivatives with respect to `fit.parameters` first, in
/// their order; parameters at their bounds do not move. `rows` are places in `measurements`.
HeldOut held_out(const Prediction& prediction, const std::vector<Measurement>& measurements, const FitResult& fit,
                 const std::string& part, const std::vector<size_t>& rows);

/// The probability below which a part is not what the others predict, corrected for `parts` of them.
inline double telling_held_out(size_t parts) {
  return 0.01 / static_cast<double>(parts);
}

}  // namespace taut

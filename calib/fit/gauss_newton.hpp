#pragma once
#include <vector>

#include "calib/fit/fit.hpp"

namespace taut {

/// What changes of a free parameter are relative to: its value if it is logarithmic, else its range.
double scale_of(const FreeParameter& parameter, const ParameterTable& table, const Params& p);

/// The parameters that were fitted, as free ones of another table that has them too, from where the fit ended.
std::vector<FreeParameter> free_at(const FitResult& fit, const ParameterTable& table);

/// The same for what an assumption does to them: a bound that a parameter does not rest at is out of the way, since
/// what it would be with another assumption is no less for a bound nearby.
std::vector<FreeParameter> free_beyond_bounds(const FitResult& fit, const ParameterTable& table);

/// One Gauss-Newton step of a fit's weighted least squares from the parameters `p`, at which `prediction` holds values
/// and derivatives: what fit() would find with this model, to first order in 1/E for logarithmic parameters (in which
/// displacements of a linear solid are linear), within the bounds of `free`, by at most a factor of three. Parameters
/// that the readings do not see stay, by the regularised inverse of fit(). Returns the change on the fitted scale: of
/// the logarithm for logarithmic parameters, else SI.
Eigen::VectorXd gauss_newton_step(const Prediction& prediction, const std::vector<Measurement>& measurements,
                                  const ParameterTable& table, const Params& p, const std::vector<FreeParameter>& free);

}  // namespace taut

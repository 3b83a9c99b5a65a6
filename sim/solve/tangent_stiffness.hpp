#pragma once
#include <Eigen/Core>
#include <memory>
#include <vector>

#include "sim/model/channel.hpp"
#include "sim/solve/equilibrium.hpp"

namespace taut {

/// The stiffness k = 1/(c^T H^-1 c) [N/m] along displacement weights c (mean_weights(), say) at the last equilibrium: a
/// force along c over how far its place goes, controls held. Throws std::logic_error without a factor.
double stiffness_along(const Equilibrium& equilibrium, const Eigen::VectorXd& direction);

/// d ln k/dp_j along the equilibria for each of `indices`, shape (1 x indices): with w = H^-1 c it is k w^T (dH/dp_j)
/// w, dH/dp_j the central difference of two Hessian products `steps`[j] to either side on the tangent of the
/// equilibria. No equilibrium is solved. Not for models with rigid bodies, whose unknowns turn with the state. Throws
/// as above.
Eigen::RowVectorXd log_stiffness_slopes(const Equilibrium& equilibrium, const Eigen::VectorXd& direction,
                                        const std::vector<int>& indices, const Eigen::VectorXd& steps);

/// The same of any equilibrium, as a channel:
///
///   k = 1/(c^T w),  w = H^-1 c,   dk/du = k^2 d(H w)/du w,   dk/dp = k^2 w^T (dH/dp) w,
///
/// the last two as central differences of H w and of d2Pi/du dp along w, exact to its square. Within a step what
/// relaxes and sticks resists as in that step. NaN where the Hessian is not positive definite. The model outlives it.
std::unique_ptr<Channel> make_tangent_stiffness(const Model& model, Eigen::VectorXd weights);

}  // namespace taut

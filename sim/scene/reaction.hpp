#pragma once
#include <Eigen/Core>
#include <memory>

#include "sim/model/channel.hpp"
#include "sim/model/model.hpp"

namespace taut {

/// The force [N] that supports exert on the nodes of `tag` along `direction` (normalised here; its sense is the sign):
///
///   y = (w . dPi/du) / share,   w = the direction's components at the tag's supported displacement components,
///   dy/du = H w / share,   dy/dp = w . d2Pi/du dp / share,
///
/// because in equilibrium what is left of the gradient of the energy, there and nowhere else, is what the supports
/// bring. It is the whole force on nodes that two supports share. `share` is that of the body in the model: 0.5 for one
/// half of a symmetric one. At rest only: inertia and viscosity of a time step are left out, what relaxes is not. The
/// model has to outlive the channel. Throws InputError when the direction has not the mesh's dimension or no support
/// holds the tag along it.
std::unique_ptr<Channel> make_reaction(const Model& model, const Tag& tag, const Eigen::VectorXd& direction,
                                       double share = 1);

}  // namespace taut

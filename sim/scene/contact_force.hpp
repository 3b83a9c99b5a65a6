#pragma once
#include <Eigen/Core>
#include <array>
#include <memory>
#include <vector>

#include "sim/contact/contact_term.hpp"
#include "sim/mesh/mesh.hpp"
#include "sim/model/channel.hpp"

namespace taut {

/// The net force [N] along `direction` (normalised here; its sense is the sign) that one side of contact exerts on a
/// part of the mesh:
///
///   y = - w . dE/du,   dy/du = - d2E/du2 w,   dy/dp = - w . d2E/du dp,
///
/// E what the part and that side have of the energies `terms` (the contact's barrier, friction), w the direction at all
/// nodes of the part. Friction counts in a step that has a past. The terms outlive the channel.
std::unique_ptr<Channel> make_contact_force(const Mesh& mesh, const std::vector<const SidedTerm*>& terms,
                                            const Part& part, int by, const Eigen::VectorXd& direction);

/// The forces of contact on all nodes of a state [N], f = - dE/du with E the energies `terms`, of all unknowns; zero at
/// nodes of no element, which carry grounds. Of what is modelled: of one half where the other follows by symmetry.
Eigen::VectorXd contact_forces(const Mesh& mesh, const std::vector<const SidedTerm*>& terms, const Point& at);

/// A piece of the boundary on which something presses: neighbouring nodes whose forces go the same way, so that two
/// faces that meet in a notch are two patches.
struct ContactPatch {
  std::vector<int> nodes;  ///< of the mesh, ascending
  Eigen::VectorXd force;   ///< on them, net [N]
  Eigen::VectorXd centre;  ///< mean of their places, each with the size of its force as weight [m]
};
/// All patches of a state, the hardest pressed first; `forces` as contact_forces() has them. Their net forces add up to
/// the sum of those.
std::vector<ContactPatch> contact_patches(const Mesh& mesh, const Eigen::VectorXd& u, const Eigen::VectorXd& forces);

}  // namespace taut

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

}  // namespace taut

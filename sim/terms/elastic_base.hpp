#pragma once
#include <memory>

#include "sim/mesh/mesh.hpp"
#include "sim/model/term.hpp"

namespace taut {

/// A clamp that gives way a little (2D): a face is held by springs against its translation and its rotation,
///
///   E = K/2 |sum_i w_i u_i|^2 + c/2 theta^2   [J],
///   theta = atan2( sum_i w_i A_i x (A_i + u_i), sum_i w_i A_i . (A_i + u_i) )   [rad],
///
/// over the nodes of `tag`: w_i their shares of its length (as in mean_weights(), sum 1), A_i = X_i - sum_j w_j X_j
/// their arms at rest. theta is the rotation of the polar decomposition of sum_i w_i (x_i - x_c) A_i^T, the best rigid
/// fit, so the face may deform freely. `rotation_stiffness` is the table index of c [N m/rad]; `translation_stiffness`
/// is the constant K [N/m], to be chosen so stiff that the clamp's translation does not count beside what is measured.
///
/// The clique holds all nodes of the tag. The projected Hessian leaves theta's own curvature out. Valid for |theta| <
/// pi; energy +inf where theta is undefined (a face that is folded onto itself so that no rotation fits better than
/// another). Throws InputError for a 3D mesh, a tag that does not define a rotation (all its nodes on one point), or a
/// K that is not positive.
std::unique_ptr<Term> make_elastic_base(const Mesh& mesh, const Tag& tag, int rotation_stiffness,
                                        double translation_stiffness);

}  // namespace taut

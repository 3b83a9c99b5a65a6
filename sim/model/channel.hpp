#pragma once
#include <Eigen/Core>
#include <memory>
#include <vector>

#include "sim/mesh/mesh.hpp"
#include "sim/model/term.hpp"

namespace taut {

/// One measured quantity y(u; p) of a state (a displacement [m], a cable's tension [N]), with its derivatives.
class Channel {
 public:
  virtual ~Channel() = default;
  virtual double value(const Point& at) const = 0;  ///< y, SI
  /// dy/du, all unknowns.
  virtual Eigen::VectorXd gradient(const Point& at) const = 0;
  /// dy/dp_index at fixed u; displacements have none.
  virtual double parameter_derivative(const Point&, int /*index*/) const { return 0.0; }
  /// Change of y at fixed u and p where the memory at the step's beginning changes so; displacements have none.
  virtual double memory_derivative(const Point&, const Eigen::VectorXd& /*change*/) const { return 0.0; }
};

/// y = weights . u: displacement of a material point, mean displacement of a face (see sim/mesh/weights.hpp).
std::unique_ptr<Channel> make_linear_channel(Eigen::VectorXd weights);

/// Displacement in `direction` (normalised here; its sense is the sign) of a marker that stands `standoff` [m] off the
/// material point `foot` and turns with the patch `tag`:
///
///   y = direction . ( u(foot) + (R - I) standoff ),   R = the rotation of the polar decomposition of sum_i w_i (x_i -
///   x_c)(X_i - X_c)^T
///
/// over the patch's nodes, w_i their shares of the patch, c its weighted centre. A patch rather than the rotation at
/// one point, because beside a line load the latter depends on the mesh. Throws InputError when the patch does not
/// define a rotation (nodes on one point; in 3D, on one line).
std::unique_ptr<Channel> make_marker_channel(const Mesh& mesh, const MaterialPoint& foot,
                                             const Eigen::VectorXd& standoff, const Tag& patch,
                                             const Eigen::VectorXd& direction);

/// The same for a marker whose foot is the mean of some material points, with which it turns: the patch is those
/// points, all of one weight. Throws as above.
std::unique_ptr<Channel> make_marker_channel(const Mesh& mesh, const std::vector<MaterialPoint>& section,
                                             const Eigen::VectorXd& standoff, const Eigen::VectorXd& direction);

/// Rotation of a patch from rest [rad], that of the polar decomposition above: in 2D its angle, counter-clockwise; in
/// 3D its component about `axis` (normalised here), atan2(axis . w, tr R - 1) with w the axial vector of R - R^T, which
/// is the angle itself when the patch turns about that axis. Within pi of rest. Throws as above.
std::unique_ptr<Channel> make_rotation_channel(const Mesh& mesh, const Tag& patch, const Eigen::VectorXd& axis);

}  // namespace taut

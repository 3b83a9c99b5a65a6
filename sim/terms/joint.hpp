#pragma once
#include <Eigen/Core>
#include <memory>
#include <string>
#include <vector>

#include "sim/mesh/mesh.hpp"
#include "sim/model/channel.hpp"
#include "sim/model/term.hpp"

namespace taut {

/// Where a joint holds a body: a point at rest, and nodes with weights that follow it, s(x) = sum_i w_i x_i. Without
/// nodes it is fixed in space.
struct Attachment {
  Eigen::VectorXd point;  ///< [m], in the rest configuration
  std::vector<int> nodes;
  std::vector<double> weights;
};

/// Attaches `point` [m] to a part: to all nodes of its elements whose centroids are within `radius` [m] of the point,
/// and of the one that contains it. The weights reproduce affine functions, sum w = 1 and sum w X = point, so rigid and
/// homogeneous deformations carry the point along; among those they minimise sum w^2 / m, m a node's share of the
/// patch. A force is then spread over the patch with a density that is affine and has a limit under refinement. Radius
/// 0: the shape functions at the point itself, as in section III-C of the push-puppet paper; the compliance of such
/// a point grows with ln(1/h) without limit.
/// Throws InputError when the point lies outside the part or the radius is negative.
Attachment make_attachment(const Mesh& mesh, const Part& part, const Eigen::VectorXd& point, double radius);
/// A point fixed in space.
Attachment world_attachment(const Eigen::VectorXd& point);

/// A revolute joint by zero-length springs. Each pair holds one point: first on body A, then on body B.
struct Joint {
  std::string name;
  Attachment pivot_a, pivot_b;
  Attachment axis_a, axis_b;    ///< 3D: a second point of the axis; its direction, from the pivot, is the sense of the
                                ///< angle
  Attachment motor_a, motor_b;  ///< a point off the axis whose turn is the angle; no coordinates: none
  int angle = -1;               ///< table index of theta [rad]; -1: a free pin
  int pin_stiffness = -1;       ///< table index of k_pin [N/m]
  int motor_stiffness = -1;     ///< table index of k_mot [N/m], with an angle
};

/// Energy of a revolute joint (Eqs. 5 to 7 of the push-puppet paper), with s the pivot, s2 the second point of the
/// axis (3D) and t the motor point on the bodies A and B:
///
///   E = k_pin/2 (|s_A - s_B|^2 + |s2_A - s2_B|^2) + k_mot/2 |t_B - t_C|^2   [J],
///   t_C = s_A + R(theta, n) (t_A - s_A),   n = (s2_A - s_A)/|s2_A - s_A|  (3D),  n = out of the plane (2D).
///
/// Eq. 6 is printed with + t_A at its end, where the text says "rotating t_A about s_A": that is + s_A. Eqs. 5 and 7
/// are printed without stiffnesses. The axis n turns with A, and with it the sense of theta, so E is invariant under
/// rigid motions: between two bodies the joint exerts neither a net force nor a net moment.
///
/// In 2D both springs are quadratic in u, so the Hessian is constant for a given theta and positive semi-definite. In
/// 3D the curvature of n adds a part in proportion to t_B - t_C, which the projected Hessian leaves out.
///
/// The torque on B about the pivot is dE/dtheta = k_mot r^2 sin(phi) for phi = theta - actual angle and r = |t - s|: it
/// falls beyond phi = 90 degrees and vanishes at 180 (an unstable equilibrium). Command theta in increments of 30
/// degrees or less from one solve to the next; whole turns are then followed.
///
/// The clique holds all nodes of all attachments. Throws InputError when the points of A and B differ, no point is
/// attached to a body, the motor point lies on the axis, the axis has no length, or a point that the angle needs is
/// missing.
std::unique_ptr<Term> make_joint(const Mesh& mesh, const Joint& joint);

/// Gap of the pins sqrt(|s_A - s_B|^2 + |s2_A - s2_B|^2) [m]; where it is zero its gradient is given as zero.
std::unique_ptr<Channel> make_joint_gap(const Mesh& mesh, const Joint& joint);

/// Actual angle [rad] about n from t_A - s_A to t_B - s_B, within pi of the commanded one, or of 0 for a free pin.
/// Throws InputError without a motor point.
std::unique_ptr<Channel> make_joint_angle(const Mesh& mesh, const Joint& joint);

/// Torque dE/dtheta [Nm] that the motor exerts on B about the pivot (and, reversed, on A). Throws InputError for a free
/// pin.
std::unique_ptr<Channel> make_joint_torque(const Mesh& mesh, const Joint& joint);

}  // namespace taut

#pragma once
#include <Eigen/Core>
#include <vector>

#include "sim/model/node_set.hpp"
#include "sim/terms/cable.hpp"

namespace taut {

/// The path of a cable through its points: the nodes that govern it, the lengths of its segments and the angles between
/// them, with derivatives with respect to the displacements of those nodes (node by node, as NodeSet has them).
class CablePath {
 public:
  /// `regular`: the length that a segment without one has [m]; 0: 1e-9 of the path. Throws InputError for a path
  /// without length.
  CablePath(const Mesh& mesh, const std::vector<CablePoint>& points, double regular);

  const NodeSet& on() const { return on_; }                              ///< the nodes
  Eigen::Index segments() const { return rest_.cols(); }                 ///< one less than points
  double rest_length() const { return rest_length_; }                    ///< L0 [m]
  const Eigen::VectorXd& rest_lengths() const { return rest_lengths_; }  ///< of the segments [m]
  double regular() const { return regular_; }                            ///< see CablePath()

  /// L(x) - L0 [m].
  double elongation(const Eigen::VectorXd& u) const;
  /// dL/du of the nodes' displacements.
  Eigen::VectorXd gradient(const Eigen::VectorXd& u) const;
  /// Adds `factor` d2L/du2: each segment has (I - t t^T)/length in the difference of its ends.
  void add_hessian(const Eigen::VectorXd& u, double factor, Eigen::MatrixXd& H) const;

  /// By how much each segment is longer than at rest, |d| - |D| = (2 D + d - D) . (d - D) / (|d| + |D|) [m]: rounding
  /// is relative to the elongation, not to the length.
  Eigen::VectorXd elongations(const Eigen::VectorXd& u) const;
  /// Their derivatives, a column each.
  Eigen::MatrixXd gradients(const Eigen::VectorXd& u) const;
  /// Adds the second derivatives of the segments' lengths, each times its factor.
  void add_hessian(const Eigen::VectorXd& u, const Eigen::VectorXd& factors, Eigen::MatrixXd& H) const;

  /// The angles by which the path turns at its inner points [rad], from 0 to pi.
  Eigen::VectorXd turnings(const Eigen::VectorXd& u) const;
  /// Their derivatives, a column each; 0 where the path is straight, at the kink of that angle.
  Eigen::MatrixXd turning_gradients(const Eigen::VectorXd& u) const;

 private:
  double regular_length(const Eigen::VectorXd& d) const;
  Eigen::MatrixXd changes(const Eigen::VectorXd& u) const;

  NodeSet on_;
  Eigen::MatrixXd rest_;     ///< (dimension x segments): vector from each point to the next, at rest [m]
  Eigen::MatrixXd weights_;  ///< (nodes x segments): derivative of that vector with respect to a node
  Eigen::VectorXd rest_lengths_;
  double regular_ = 0, rest_length_ = 0;
};

}  // namespace taut

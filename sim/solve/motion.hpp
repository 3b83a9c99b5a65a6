#pragma once
#include <Eigen/Core>
#include <vector>

#include "sim/model/model.hpp"

namespace taut {

/// The way along which a step is tried. A straight step turns a stiff body only by stretching it, to second order in
/// the angle; the energy of that hides the progress of everything soft. Here stiff bodies turn as they are: with c, t
/// the mean position and step of a body's nodes, r = x - c, and w the step's mean rotation,
///
///   x(a) = c + a t + R(a w) (r + a (step - t - w x r)),   x(a) = x + a step for all other nodes,
///
/// without the strain, step - t - w x r, of what is rigid. dx/da at a = 0 is the step, so Newton's order and the slope
/// of the energy are untouched.
class Motion {
 public:
  /// Bodies without supports whose modulus at `p` is more than 100 times the softest one's count as stiff, rigid ones
  /// always. `straight`: none but the rigid ones do. `unchecked`: nothing is in the way.
  Motion(const Model& model, const Params& p, bool straight = false, bool unchecked = false);

  /// u(fraction), all unknowns.
  Eigen::VectorXd along(const Eigen::VectorXd& u, const Eigen::VectorXd& step, double fraction) const;

  /// u(a) for the largest a <= fraction found for which the straight line from u to u(a) is admissible: it and all of
  /// the way there are free of contact. Lowers `fraction` to that a; 0 when no way is left.
  Eigen::VectorXd admissible(const Eigen::VectorXd& u, const Eigen::VectorXd& step, const Params& p,
                             double& fraction) const;

 private:
  const Model* model_;
  std::vector<const Body*> stiff_;
  bool unchecked_;
};

}  // namespace taut

#pragma once
#include <array>

#include "calib/models/rod_algebra.hpp"

namespace taut::rod {

/// The unit quaternion (w, x, y, z) of a rotation vector [rad].
Vector4d turn(const Vector3d& rotation);

/// An element between nodes: its shear and stretch v and its curvature k, with derivatives by (r_a, turn_a, r_b,
/// turn_b).
class RodElement {
 public:
  /// Between two nodes' positions [m] and rotations, `length` at rest.
  RodElement(const Vector3d& ra, const Vector4d& qa, const Vector3d& rb, const Vector4d& qb, double length);

  Vector3d v, k;                                 ///< [-], [1/m]
  const Matrix3d& middle() const { return R_; }  ///< half way
  /// Small turns behind it by those of the ends.
  Matrix36 middle_turns() const;
  bool possible() const { return w_ > 0.25; }  ///< it has not turned by too much

  /// Derivatives of v, then of k.
  Matrix612 slopes() const;

  /// Sum of stress, by v and then by k, times second derivatives.
  Matrix12 curvature(const Vector6& stress) const;

 private:
  using Matrix34 = Eigen::Matrix<double, 3, 4>;
  using Matrix46 = Eigen::Matrix<double, 4, 6>;
  /// Of q_a + q_b by the turns.
  Matrix46 sum_slopes() const;
  /// Of v by q_a + q_b.
  Matrix34 by_sum() const;
  /// Of x by the turns.
  Matrix36 half_turn_slopes() const;

  double l_, w_, n_;
  Vector4d qa_, qb_, s_;
  Matrix3d R_;                 ///< half way
  Vector3d u_, x_;             ///< (r_b - r_a)/l; sine of half of the turn from a to b, times its axis
  std::array<double, 3> arc_;  ///< that turn over twice that sine, with derivatives
};

}  // namespace taut::rod

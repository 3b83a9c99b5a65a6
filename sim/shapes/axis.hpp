#pragma once
#include <Eigen/Core>
#include <functional>

namespace taut {

/// What a cross-section resists with; in 2D per unit of thickness, and only `area` and `second`.
struct CrossSection {
  double area = 0;     ///< A [m2]
  double first = 0;    ///< I_1 [m4], integral of the second coordinate squared: bending about the first direction
  double second = 0;   ///< I_2 [m4], about the second
  double torsion = 0;  ///< J [m4], Saint-Venant's
};

/// The straight centre line of a long body at rest: points are had from the arc length s along it, a distance from it
/// and an angle about it, from the section's first direction to its second.
struct BodyAxis {
  Eigen::VectorXd origin;         ///< s = 0 [m]
  Eigen::VectorXd along;          ///< unit length, towards growing s
  Eigen::VectorXd first, second;  ///< of the section, unit length, square to `along`; in 2D there is no second one
  double length = 0;              ///< [m]
  std::function<CrossSection(double s)> section;  ///< at arc length s [m]

  /// origin + s along + radius (cos(angle) first + sin(angle) second).
  Eigen::VectorXd point(double s, double radius, double angle) const;
  /// radius (cos(angle) first + sin(angle) second) + ahead along: a vector that starts on the axis or beside it.
  Eigen::VectorXd offset(double radius, double angle, double ahead = 0) const;
};

/// The axis of a bar from `origin` along a coordinate axis (0: x, 1: y, 2: z), forwards or backwards, without its
/// section. The section's directions are the next coordinate axes in the circle x, y, z, x, whichever way the bar runs:
/// y and z of a bar along x, z and x of one along y, x and y of one along z; in 2D the other axis.
BodyAxis coordinate_axis(const Eigen::VectorXd& origin, int axis, bool forwards, double length);

}  // namespace taut

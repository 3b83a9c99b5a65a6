#include "sim/shapes/axis.hpp"

#include <cmath>

namespace taut {

Eigen::VectorXd BodyAxis::point(double s, double radius, double angle) const {
  return origin + s * along + offset(radius, angle);
}

Eigen::VectorXd BodyAxis::offset(double radius, double angle, double ahead) const {
  Eigen::VectorXd result = radius * std::cos(angle) * first + ahead * along;
  if (second.size() > 0) result += radius * std::sin(angle) * second;
  return result;
}

BodyAxis coordinate_axis(const Eigen::VectorXd& origin, int axis, bool forwards, double length) {
  const int d = static_cast<int>(origin.size());
  BodyAxis result;
  result.origin = origin;
  result.along = (forwards ? 1.0 : -1.0) * Eigen::VectorXd::Unit(d, axis);
  result.first = Eigen::VectorXd::Unit(d, (axis + 1) % d);
  if (d == 3) result.second = Eigen::VectorXd::Unit(d, (axis + 2) % d);
  result.length = length;
  return result;
}

}  // namespace taut

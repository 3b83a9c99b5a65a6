#include "sim/robots/reach.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "sim/core/error.hpp"

namespace taut {
namespace {

/// Points of a polar grid about the origin, closer to one another than 0.05.
std::vector<Eigen::Vector2d> polar(double inner, double outer, double from, double to) {
  std::vector<Eigen::Vector2d> points;
  for (double r = inner; r <= outer + 1e-9; r += 0.02) {
    for (double angle = from; angle <= to + 1e-9; angle += 0.02)
      points.push_back(r * Eigen::Vector2d(std::cos(angle), std::sin(angle)));
  }
  return points;
}

double signed_area(const std::vector<Eigen::Vector2d>& polygon) {
  double twice = 0;
  for (size_t i = 0; i < polygon.size(); ++i) {
    const Eigen::Vector2d &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
    twice += a[0] * b[1] - a[1] * b[0];
  }
  return 0.5 * twice;
}

TEST(Reach, FollowsTheBayOfACrescentThatAHullWouldBridge) {
  const Reach reach = reach_of(polar(0.8, 1, -1.5, 1.5), 0.12);
  const double exact = 3.0 / 2 * (1 - 0.8 * 0.8);  // a hull: 1.5 - sin(1.5) cos(1.5) and more, three times as much
  EXPECT_NEAR(reach.area, exact, 0.05 * exact);
  EXPECT_NEAR(signed_area(reach.outline), reach.area, 1e-9) << "anticlockwise, of the same cells";
}

TEST(Reach, CountsNoHoleThatIsWiderThanTheDisc) {
  const Reach reach = reach_of(polar(0.5, 1, -std::numbers::pi, std::numbers::pi), 0.12);
  const double disc = std::numbers::pi;
  EXPECT_NEAR(reach.area, 0.75 * disc, 0.03 * disc);
  EXPECT_NEAR(signed_area(reach.outline), disc, 0.03 * disc) << "the outer boundary";
}

TEST(Reach, LeavesOutWhatIsFurtherThanTheDiscsDiameter) {
  std::vector<Eigen::Vector2d> points = polar(0, 0.4, -3.14, 3.14);
  const double near = reach_of(points, 0.1).area;
  points.emplace_back(0.9, 0.9);
  EXPECT_NEAR(reach_of(points, 0.1).area, near, 0.03 * near);
  EXPECT_NEAR(near, 0.16 * std::numbers::pi, 0.05 * near);
}

TEST(Reach, OfOnePointIsACellAndOfNoneNothing) {
  EXPECT_NEAR(reach_of({{0.3, 0.2}}, 0.12).area, 2.5e-5, 1e-12);
  EXPECT_EQ(reach_of({}, 0.12).area, 0);
  EXPECT_THROW(reach_of({{0, 0}}, 0), InputError);
}

}  // namespace
}  // namespace taut

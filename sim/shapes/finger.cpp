#include "sim/shapes/finger.hpp"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <cmath>

#include "sim/core/error.hpp"
#include "sim/mesh/gmsh.hpp"
#include "sim/mesh/mesh_budget.hpp"

namespace taut {
namespace {

/// Where a joint stands: its hinge's middle, and its axes, of which the second is the bisector of its faces.
struct Frame {
  Eigen::Vector2d origin;
  Eigen::Rotation2Dd turn;
  Eigen::Vector2d operator()(double x, double y) const { return origin + turn * Eigen::Vector2d(x, y); }
};

/// Segments are as long below as they are said to be; half of each turn is on either side of a joint.
std::vector<Frame> joints_of(const Finger& finger) {
  std::vector<Frame> joints;
  Eigen::Vector2d corner(finger.segment_length, 0);  // lower right corner of the segment before the joint
  double heading = 0;
  for (int k = 1; k < finger.segments; ++k) {
    const Eigen::Rotation2Dd turn(heading - 0.5 * finger.rest_turn);
    joints.push_back({corner + turn * Eigen::Vector2d(0.5 * finger.hinge, 0), turn});
    heading -= finger.rest_turn;
    corner =
        joints.back()(0.5 * finger.hinge, 0) + Eigen::Rotation2Dd(heading) * Eigen::Vector2d(finger.segment_length, 0);
  }
  return joints;
}

/// One side of a joint from the lower to the upper side of the finger; `side` -1 left, +1 right.
std::vector<Eigen::Vector2d> face(const Finger& finger, const Frame& joint, int side, double inset) {
  const double half = 0.5 * finger.hinge, wide = std::tan(0.5 * finger.opening),
               narrow = std::tan(0.5 * finger.closing);
  const double foam = finger.foam_height, lip = finger.lip_height, top = finger.height;
  return {joint(side * half, 0), joint(side * (half + foam * wide), foam), joint(side * (half + lip * wide), lip),
          joint(side * (lip * narrow + inset), lip), joint(side * (top * narrow + inset), top)};
}

PolygonRegion polygon(const std::string& region, const std::vector<Eigen::Vector2d>& points) {
  PolygonRegion result{region, {}, std::vector<std::string>(points.size())};
  for (const Eigen::Vector2d& point : points) result.vertices.push_back({point[0], point[1]});
  return result;
}

/// Upper corners of the two end faces, base and tip.
std::pair<Eigen::Vector2d, Frame> ends(const Finger& finger, const std::vector<Frame>& joints) {
  const Frame& last = joints.back();
  const Eigen::Rotation2Dd turn(last.turn.angle() - 0.5 * finger.rest_turn);
  return {Eigen::Vector2d(0, finger.height),
          Frame{last(0.5 * finger.hinge, 0) + turn * Eigen::Vector2d(finger.segment_length, 0), turn}};
}

}  // namespace

std::vector<ShapeKey> Finger::keys() {
  const Allowed any = Allowed::any(), positive = Allowed::positive();
  return {
      {"segments", &segments, Allowed::at_least(2, most_repeated), "plastic segments", Quantity::pure},
      {"segment_length", &segment_length, positive, "of each, along its lower side"},
      {"height", &height, positive, "of the segments"},
      {"hinge", &hinge, positive, "width of the foam at the lower side"},
      {"foam_height", &foam_height, positive, "of the foam's triangles"},
      {"lip_height", &lip_height, positive, "lips reach from here to the upper side"},
      {"cable_depth", &cable_depth, positive, "of the cable below the upper side"},
      {"via_inset", &via_inset, positive, "of the cable's points behind the lips' faces"},
      {"opening", &opening, positive, "angle of the foam's triangles", Quantity::angle},
      {"closing", &closing, positive, "angle between two lips at rest", Quantity::angle},
      {"rest_turn", &rest_turn, any, "each segment is turned downwards by this at rest", Quantity::angle},
  };
}

void Finger::check() const {
  const Finger& f = *this;
  const auto fail = [](const std::string& what) { throw InputError("finger: " + what); };
  if (f.segments < 2) fail("it needs at least two segments");
  for (double length : {f.segment_length, f.height, f.hinge, f.foam_height, f.lip_height, f.cable_depth, f.via_inset}) {
    if (!(length > 0 && std::isfinite(length))) fail("all lengths must be positive");
  }
  if (!(f.foam_height <= f.lip_height && f.lip_height < f.height - f.cable_depth))
    fail(
        fmt::format("foam_height ({:.4g} mm), lip_height ({:.4g} mm) and the cable ({:.4g} mm) must lie in this order "
                    "from below",
                    1e3 * f.foam_height, 1e3 * f.lip_height, 1e3 * (f.height - f.cable_depth)));
  if (!(f.closing > 0 && f.closing < f.opening && f.opening < 1.5))
    fail("closing must be positive, below opening, and opening below 1.5 rad");
  if (f.rest_turn < 0 || f.rest_turn > 1) fail("rest_turn must lie between 0 and 1 rad");
  // The faces of one segment lean towards each other by what the opening exceeds the turn.
  const double lean = std::tan(0.5 * (f.opening - f.rest_turn)) * f.lip_height;
  if (!(f.segment_length > 2 * lean + 1e-3))
    fail(fmt::format("a segment of {:.4g} mm has no room between its faces; make it longer than {:.4g} mm",
                     1e3 * f.segment_length, 1e3 * (2 * lean + 1e-3)));
}

Mesh Finger::mesh(const MeshSettings& settings, bool contact, bool compensate) const {
  check();
  const Finger& finger = *this;
  // Taken off every lip's face, see mesh_push_puppet().
  const double inset = contact && compensate ? 0.5 * resting_distance * contact_gap(settings, 0.1) : 0.0;
  const std::vector<Frame> joints = joints_of(finger);
  const auto [top_left, tip] = ends(finger, joints);
  std::vector<PolygonRegion> regions;
  for (int k = 0; k < finger.segments; ++k) {
    const bool first = k == 0, last = k + 1 == finger.segments;
    // Counter-clockwise: up the right side, down the left one.
    std::vector<Eigen::Vector2d> points =
        last ? std::vector<Eigen::Vector2d>{tip(0, 0), tip(0, finger.height)} : face(finger, joints[k], -1, inset);
    const size_t right = points.size();
    std::vector<Eigen::Vector2d> left =
        first ? std::vector<Eigen::Vector2d>{{0, 0}, top_left} : face(finger, joints[k - 1], 1, inset);
    points.insert(points.end(), left.rbegin(), left.rend());
    regions.push_back(polygon("plastic", points));
    if (last) regions.back().edge_tags[0] = "tip";
    if (first) regions.back().edge_tags[right] = "base";
  }
  for (const Frame& joint : joints) {
    const std::vector<Eigen::Vector2d> left = face(finger, joint, -1, inset), right = face(finger, joint, 1, inset);
    regions.push_back(polygon("foam", {left[0], right[0], right[1], left[1]}));
  }
  return mesh_polygons(regions, settings.size, settings.order);
}

std::vector<Eigen::Vector2d> cable_path(const Finger& finger) {
  const std::vector<Frame> joints = joints_of(finger);
  const auto [top_left, tip] = ends(finger, joints);
  const double y = finger.height - finger.cable_depth, narrow = std::tan(0.5 * finger.closing);
  std::vector<Eigen::Vector2d> points{{0, y}};
  for (const Frame& joint : joints) {
    for (int side : {-1, 1}) points.push_back(joint(side * (y * narrow + finger.via_inset), y));
  }
  points.push_back(tip(0, y));
  return points;
}

std::vector<Eigen::VectorXd> Finger::cable(size_t) const {
  const std::vector<Eigen::Vector2d> path = cable_path(*this);
  return {path.begin(), path.end()};
}

}  // namespace taut

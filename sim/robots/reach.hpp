#pragma once
#include <Eigen/Core>
#include <vector>

namespace taut {

/// What a cloud of points covers.
struct Reach {
  std::vector<Eigen::Vector2d> outline;  ///< of its largest connected part, anticlockwise [m]; empty without points
  double area = 0;                       ///< of that part, holes not counted [m^2]
};

/// The places that no disc of `radius` [m] can cover without covering one of the points as well (their closing by a
/// disc, or alpha hull): it follows bays wider than the disc, where a convex hull would bridge them, and leaves out
/// what is further than the disc's diameter from all points. On square cells of a 24th of the radius, which its
/// outline follows: the area is that of the cells. Throws InputError for a radius that is not positive.
Reach reach_of(const std::vector<Eigen::Vector2d>& points, double radius);

}  // namespace taut

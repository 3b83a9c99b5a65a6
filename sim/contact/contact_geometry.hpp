#pragma once
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <vector>

#include "sim/core/box_tree.hpp"
#include "sim/model/term.hpp"

// Plane geometry of contact: distances with derivatives, the barrier, motion without collision, crossing of segments,
// and the search for what is near. Relative positions are handed over as vectors, so that the caller can form them from
// displacements and keep their digits.
namespace taut {

/// The barrier b(d) of incremental potential contact, b = -dhat^q (s - 1)^2 ln s with s = d / dhat < 1, zero beyond.
/// q = 2 is the paper's Eq. 4 [m^2]; q = 1 has the unit of a length [m], so that a stiffness times it times a length of
/// boundary is an energy per depth (Li et al. 2023, Convergent Incremental Potential Contact). Twice continuously
/// differentiable at d = dhat, +inf for d -> 0. Valid for d > 0 and dhat > 0.
struct Barrier {
  double gap = 0;  ///< dhat [m]
  int power = 1;   ///< q

  double value(double d) const;         ///< b
  double slope(double d) const;         ///< db/dd <= 0
  double curvature(double d) const;     ///< d2b/dd2 >= 0
  double slope_by_gap(double d) const;  ///< d2b/(dd ddhat)
};

/// Where a segment from a to b comes closest to a point p.
struct Closest {
  /// Inside of the segment, or at a or b.
  enum class Part { inside, first_end, second_end };
  double distance = 0;   ///< [m]
  double parameter = 0;  ///< 0 at a, 1 at b
  Part part = Part::inside;
  Eigen::Vector2d normal;  ///< unit vector from there to p; zero at distance 0
};

/// `r` = p - a and `e` = b - a [m]. A segment of length 0 is its end a.
Closest closest_on_segment(const Eigen::Vector2d& r, const Eigen::Vector2d& e);

/// Distance d = |x_a - x_b| of two points, a function of (x_a, x_b) [4]. Valid for d > 0.
struct PointPointDistance {
  explicit PointPointDistance(const Eigen::Vector2d& r);  ///< r = x_a - x_b

  double value;  ///< d [m]
  Eigen::Vector2d normal;
  Eigen::Vector4d gradient() const;  ///< (n, -n), no unit
  /// Hessian of f(d): second * grad d grad d^T + first * Hess d, where `first` = f'(d) and `second` = f''(d); projected
  /// means the nearest positive semi-definite matrix, in closed form.
  Eigen::Matrix4d hessian(double first, double second, Curvature curvature = Curvature::exact) const;
};

/// Distance d = |e x r| / |e| of a point p to the line through a and b, a function of (p, a, b) [6]; e = b - a,
/// r = p - a. With the foot a + tau e, the unit tangent t and the normal n towards p
///     grad d = (n, -(1-tau) n, -tau n),   Hess d = -(T E^T + E T^T) / |e| - d / |e|^2 E E^T,
///     T = (t, -(1-tau) t, -tau t),        E = (0, -n, n),
/// in which nothing cancels. Valid for d > 0 and |e| > 0.
struct PointLineDistance {
  PointLineDistance(const Eigen::Vector2d& r, const Eigen::Vector2d& e);  ///< `r` = p - a, `e` = b - a [m]

  using Vector6 = Eigen::Matrix<double, 6, 1>;  ///< over (p, a, b)
  using Matrix6 = Eigen::Matrix<double, 6, 6>;  ///< over (p, a, b)
  double value;                                 ///< d [m]
  double parameter;                             ///< tau
  double length;                                ///< |e| [m]
  Eigen::Vector2d normal, tangent;
  Vector6 gradient() const;  ///< no unit
  /// As above; the projection is an eigenvalue problem in the three directions grad d, T and E.
  Matrix6 hessian(double first, double second, Curvature curvature = Curvature::exact) const;
};

/// A point and a segment moving on straight lines, t from 0 to 1: positions and displacements relative to the end a.
struct MovingPair {
  Eigen::Vector2d r, e;    ///< p - a and b - a at t = 0 [m]
  Eigen::Vector2d dr, de;  ///< their changes until t = 1 [m]
};

/// A t in [0, horizon] such that the distance is at least `keep` > 0 at every time up to t; `horizon` (<= 1) if that
/// holds all the way. Never too large; too small only where less than 2 `keep` are left at t.
///
/// Conservative advancement: at time t the direction n from the closest point to p separates the two as long as both
/// n . (p - a) and n . (p - b), linear in time, stay positive. That bounds the time of contact from below; from there
/// the next direction is taken. Additive CCD (Li et al. 2021, Codimensional Incremental Potential Contact) bounds the
/// approach by the lengths of the motions instead, and would crawl where narrow gaps slide. Returns 0 for a pair that
/// starts nearer than 2 `keep`; valid for `keep` above the rounding of the vectors.
double free_motion(const MovingPair& pair, double keep, double horizon = 1.0);

/// Sign of the area of the triangle a, b, c: +1 anticlockwise, -1 clockwise, 0 on a line. Exact for all doubles whose
/// products neither overflow nor underflow (a floating-point filter before exact expansions, Shewchuk 1997).
int orientation(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& c);

/// Whether the closed segments a-b and c-d have a point in common. Exact.
bool segments_meet(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& c,
                   const Eigen::Vector2d& d);

using Box = Eigen::AlignedBox2d;  ///< along the axes, of the plane [m]

}  // namespace taut

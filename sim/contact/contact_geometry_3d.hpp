#pragma once
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <vector>

#include "sim/core/box_tree.hpp"

// Geometry of contact in space: distances of points, lines and planes with derivatives, motion without collision,
// crossing of segments and triangles, and the search for what is near. Relative positions are handed over as vectors,
// so that the caller can form them from displacements and keep their digits.
namespace taut {

/// Distance d > 0 of two flat features as a function of their vertices x_k [m]: d = min |r| over the parameters beta of
///
///     r = sum_k c_k(beta) x_k,   n = r / d,   t_j = dr/dbeta_j,   G_ij = t_i . t_j.
///
/// The c_k are linear in beta, so with a vector (x) over the vertices and P the projection across n and all t_j
///
///     grad d = c (x) n,
///     Hess d = c c^T (x) P / d - sum_ij G^-1_ij [(c (x) t_i)(c,j (x) n)^T + (c,i (x) n)(c (x) t_j)^T
///                                                + d (c,i (x) n)(c,j (x) n)^T],
///
/// in which nothing cancels.
struct FeatureDistance {
  using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, 12, 1>;                ///< over the vertices' coordinates
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 12, 12>;  ///< over the vertices' coordinates

  /// Points p and a; r = p - a.
  static FeatureDistance point_point(const Eigen::Vector3d& r);
  /// Point p and the line through a and b, vertices (p, a, b); e = b - a.
  static FeatureDistance point_line(const Eigen::Vector3d& r, const Eigen::Vector3d& e);
  /// Point p and the plane through a, b and c, vertices (p, a, b, c); e = b - a and f = c - a.
  static FeatureDistance point_plane(const Eigen::Vector3d& r, const Eigen::Vector3d& e, const Eigen::Vector3d& f);
  /// Lines through a, b and c, d that are not parallel, vertices (a, b, c, d); r = a - c, e = b - a, f = d - c.
  static FeatureDistance line_line(const Eigen::Vector3d& r, const Eigen::Vector3d& e, const Eigen::Vector3d& f);

  int vertices = 0;    ///< 2 to 4
  int parameters = 0;  ///< 0 to 2
  bool round = true;   ///< whether the Hessian has P / d; without it a point or a line is like a plane across n
  double value = 0;    ///< d [m]
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  Eigen::Vector4d coefficients = Eigen::Vector4d::Zero();                      ///< c
  Eigen::Matrix<double, 4, 2> slopes = Eigen::Matrix<double, 4, 2>::Zero();    ///< c,j
  Eigen::Matrix<double, 3, 2> tangents = Eigen::Matrix<double, 3, 2>::Zero();  ///< t_j [m]

  Vector gradient() const;  ///< c (x) n, no unit
  /// Hessian of f(d): second * grad d grad d^T + first * Hess d, where `first` = f'(d) and `second` = f''(d).
  Matrix hessian(double first, double second) const;
};

/// Where two features come closest.
struct Closest3 {
  /// Which parts of the features.
  enum class Part {
    vertices,     ///< a vertex of either feature: `first` and `second`
    vertex_edge,  ///< vertex `first` of the first feature, an edge or the whole of the second
    edge_vertex,  ///< the whole of the first feature, vertex `second` of the second
    interior      ///< the insides of both: of the triangle, or of both segments
  };
  double distance = 0;  ///< [m]
  Part part = Part::interior;
  int first = 0, second = 0;  ///< second of vertex_edge with a triangle: its edge from vertex k to vertex k + 1
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();  ///< unit vector from the second to the first; zero at distance 0
};

/// Point p and the closed segment from a to b; r = p - a, e = b - a. `second` is 0 at a and 1 at b.
Closest3 closest_on_segment(const Eigen::Vector3d& r, const Eigen::Vector3d& e);
/// Point p and the closed triangle a, b, c; r = p - a, e = b - a, f = c - a. Outside of the triangle's prism exactly
/// what closest_on_segment() says of the nearest of the edges a-b, b-c, c-a.
Closest3 closest_on_triangle(const Eigen::Vector3d& r, const Eigen::Vector3d& e, const Eigen::Vector3d& f);
/// Closed segments a-b and c-d; r = a - c, e = b - a, f = d - c.
Closest3 closest_of_segments(const Eigen::Vector3d& r, const Eigen::Vector3d& e, const Eigen::Vector3d& f);

/// Whether a point and a triangle are farther apart than `reach` >= 0 [m], as a plane between them shows: along the
/// triangle, or upright on one of its edges. Costs a small part of closest_on_triangle(), and never says so of what is
/// nearer; false: one has to look. Arguments are those of closest_on_triangle().
bool surely_apart_from_triangle(const Eigen::Vector3d& r, const Eigen::Vector3d& e, const Eigen::Vector3d& f,
                                double reach);
/// The same of two segments, by a plane along both, or along one and upright on that. Arguments are those of
/// closest_of_segments().
bool surely_apart_segments(const Eigen::Vector3d& r, const Eigen::Vector3d& e, const Eigen::Vector3d& f, double reach);

/// How far two segments are from parallel, q = |e x f|^2 [m^4], and the mollifier m of Li et al. 2020 that takes the
/// barrier of parallel edges away, where its distance is not smooth: m = x (2 - x), x = q / threshold, 1 for x >= 1.
struct Mollifier {
  /// e and f now; `threshold` [m^4] > 0, 1e-3 times the product of the squared rest lengths.
  Mollifier(const Eigen::Vector3d& e, const Eigen::Vector3d& f, double threshold);

  double value = 1;                  ///< m
  double first = 0, second = 0;      ///< dm/dq, d2m/dq2
  FeatureDistance::Vector gradient;  ///< of q, vertices (a, b, c, d)
  FeatureDistance::Matrix hessian;   ///< of q
};

/// A point and a triangle, or two segments, moving on straight lines, t from 0 to 1: positions and displacements
/// relative to any common place.
struct MovingPair3 {
  /// Which features.
  enum class Kind { point_triangle, segments };
  Kind kind;
  std::array<Eigen::Vector3d, 4> x;   ///< (p, a, b, c) or (a, b, c, d) at t = 0 [m]
  std::array<Eigen::Vector3d, 4> dx;  ///< their changes until t = 1 [m]
  Closest3 closest(double t) const;   ///< at time t
};

/// A t in [0, horizon] such that the distance is at least `keep` > 0 at every time up to t; `horizon` (<= 1) if that
/// holds all the way. Conservative advancement as for MovingPair in 2D: the direction between the closest points
/// separates the two as long as it separates each vertex of one from each of the other, which is linear in time.
double free_motion(const MovingPair3& pair, double keep, double horizon = 1.0);

/// Sign of the determinant of (b - a, c - a, d - a): +1 when d sees a, b, c anticlockwise from their front, 0 in a
/// plane. Exact for all doubles whose products neither overflow nor underflow (a filter before exact expansions,
/// Shewchuk 1997).
int orientation(const Eigen::Vector3d& a, const Eigen::Vector3d& b, const Eigen::Vector3d& c, const Eigen::Vector3d& d);

/// Whether the closed segment a-b and the closed triangle have a point in common. Exact, for triangles with an area.
bool segment_meets_triangle(const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                            const std::array<Eigen::Vector3d, 3>& triangle);

using Box3 = Eigen::AlignedBox3d;  ///< along the axes, of space [m]

}  // namespace taut

#include "sim/contact/contact_geometry_3d.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "sim/contact/contact_geometry.hpp"
#include "sim/contact/exact_sum.hpp"

namespace taut {
namespace {

using Eigen::Vector3d;

constexpr double few_digits = 1e-8;       ///< squared sine below which the normal of two edges has few
constexpr double beyond_rounding = 1.01;  ///< times a reach: what is farther than that surely is farther

/// A point as it is seen along a coordinate axis.
Eigen::Vector2d without(int axis, const Vector3d& x) {
  return {x[(axis + 1) % 3], x[(axis + 2) % 3]};
}

}  // namespace

FeatureDistance FeatureDistance::point_point(const Vector3d& r) {
  FeatureDistance d;
  d.vertices = 2;
  d.value = r.norm();
  d.normal = r / d.value;
  d.coefficients << 1, -1, 0, 0;
  return d;
}

FeatureDistance FeatureDistance::point_line(const Vector3d& r, const Vector3d& e) {
  FeatureDistance d;
  d.vertices = 3;
  d.parameters = 1;
  const double square = e.squaredNorm(), along = r.dot(e), tau = along / square;
  // From the nearer end: the area is then as small as it can be, and so is its rounding.
  const Vector3d area = e.cross(2 * along > square ? Vector3d(r - e) : r), across = area.cross(e);
  d.value = area.norm() / std::sqrt(square);
  d.normal = across.normalized();
  d.coefficients << 1, -(1 - tau), -tau, 0;
  d.slopes.col(0) << 0, 1, -1, 0;
  d.tangents.col(0) = -e;
  return d;
}

FeatureDistance FeatureDistance::point_plane(const Vector3d& r, const Vector3d& e, const Vector3d& f) {
  FeatureDistance d;
  d.vertices = 4;
  d.parameters = 2;
  const Vector3d area = e.cross(f);
  const double square = area.squaredNorm(), height = r.dot(area) / std::sqrt(square);
  const double to_b = r.cross(f).dot(area) / square, to_c = e.cross(r).dot(area) / square;
  d.value = std::abs(height);
  d.normal = (height < 0 ? -1.0 : 1.0) * area / std::sqrt(square);
  d.coefficients << 1, -(1 - to_b - to_c), -to_b, -to_c;
  d.slopes.col(0) << 0, 1, -1, 0;
  d.slopes.col(1) << 0, 1, 0, -1;
  d.tangents << -e, -f;
  return d;
}

FeatureDistance FeatureDistance::line_line(const Vector3d& r, const Vector3d& e, const Vector3d& f) {
  FeatureDistance d;
  d.vertices = 4;
  d.parameters = 2;
  const Vector3d area = e.cross(f);
  const double square = area.squaredNorm(), height = r.dot(area) / std::sqrt(square);
  const double on_e = -r.cross(f).dot(area) / square, on_f = -r.cross(e).dot(area) / square;
  d.value = std::abs(height);
  d.normal = (height < 0 ? -1.0 : 1.0) * area / std::sqrt(square);
  d.coefficients << 1 - on_e, on_e, -(1 - on_f), -on_f;
  d.slopes.col(0) << -1, 1, 0, 0;
  d.slopes.col(1) << 0, 0, 1, -1;
  d.tangents << e, -f;
  return d;
}

FeatureDistance::Vector FeatureDistance::gradient() const {
  Vector g(3 * vertices);
  for (int k = 0; k < vertices; ++k) g.segment<3>(3 * k) = coefficients[k] * normal;
  return g;
}

FeatureDistance::Matrix FeatureDistance::hessian(double first, double second) const {
  Eigen::Matrix2d inverse = Eigen::Matrix2d::Zero();
  Eigen::Matrix3d across = Eigen::Matrix3d::Zero();
  if (round && parameters == 0) across = Eigen::Matrix3d::Identity() - normal * normal.transpose();
  if (parameters == 1) {
    const double square = tangents.col(0).squaredNorm();
    inverse(0, 0) = 1 / square;
    const Vector3d side = normal.cross(tangents.col(0));
    if (round) across = side * side.transpose() / square;
  }
  if (parameters == 2) {
    // Adjugate over |t1 x t2|^2, which does not cancel where the two are nearly parallel.
    const double dot = tangents.col(0).dot(tangents.col(1));
    inverse << tangents.col(1).squaredNorm(), -dot, -dot, tangents.col(0).squaredNorm();
    inverse /= tangents.col(0).cross(tangents.col(1)).squaredNorm();
  }
  const Eigen::Matrix3d normals = normal * normal.transpose();
  const Eigen::Matrix<double, 3, 2> dual = tangents * inverse;
  const Eigen::Matrix4d turn = slopes * inverse * slopes.transpose();
  Matrix H(3 * vertices, 3 * vertices);
  for (int k = 0; k < vertices; ++k) {
    for (int l = 0; l <= k; ++l) {
      const double both = coefficients[k] * coefficients[l];
      Eigen::Matrix3d block = (second * both - first * value * turn(k, l)) * normals + (first * both / value) * across;
      for (int j = 0; j < parameters; ++j) {
        block -= first * (coefficients[k] * slopes(l, j) * dual.col(j) * normal.transpose() +
                          slopes(k, j) * coefficients[l] * normal * dual.col(j).transpose());
      }
      H.block<3, 3>(3 * k, 3 * l) = block;
      H.block<3, 3>(3 * l, 3 * k) = block.transpose();
    }
  }
  return H;
}

Closest3 closest_on_segment(const Vector3d& r, const Vector3d& e) {
  Closest3 c;
  const double along = r.dot(e), square = e.squaredNorm();
  if (along > 0 && along < square) {
    const Vector3d area = e.cross(2 * along > square ? Vector3d(r - e) : r);
    c.part = Closest3::Part::vertex_edge;
    c.distance = area.norm() / std::sqrt(square);
    c.normal = area.cross(e).normalized();
    return c;
  }
  c.part = Closest3::Part::vertices;
  c.second = along <= 0 ? 0 : 1;
  const Vector3d way = along <= 0 ? r : Vector3d(r - e);
  c.distance = way.norm();
  c.normal = way.normalized();
  return c;
}

Closest3 closest_on_triangle(const Vector3d& r, const Vector3d& e, const Vector3d& f) {
  const Vector3d area = e.cross(f);
  const double square = area.squaredNorm();
  const double to_b = r.cross(f).dot(area), to_c = e.cross(r).dot(area);
  Closest3 c;
  if (to_b > 0 && to_c > 0 && to_b + to_c < square) {
    const double height = r.dot(area) / std::sqrt(square);
    c.distance = std::abs(height);
    c.normal = (height > 0 ? 1.0 : height < 0 ? -1.0 : 0.0) * area / std::sqrt(square);
    return c;
  }
  const Vector3d from[3] = {r, r - e, r - f}, along[3] = {e, f - e, -f};
  c.distance = std::numeric_limits<double>::infinity();
  for (int k = 0; k < 3; ++k) {
    Closest3 edge = closest_on_segment(from[k], along[k]);
    if (!(edge.distance < c.distance)) continue;
    edge.second = edge.part == Closest3::Part::vertices ? (k + edge.second) % 3 : k;
    c = edge;
  }
  return c;
}

Closest3 closest_of_segments(const Vector3d& r, const Vector3d& e, const Vector3d& f) {
  using On = Closest3::Part;
  const Vector3d area = e.cross(f);
  const double square = area.squaredNorm(), size = e.squaredNorm() * f.squaredNorm();
  Closest3 c;
  if (square > 1e-20 * size) {
    const double on_e = -r.cross(f).dot(area) / square, on_f = -r.cross(e).dot(area) / square;
    if (on_e > 0 && on_e < 1 && on_f > 0 && on_f < 1) {
      if (square > few_digits * size) {
        const double height = r.dot(area) / std::sqrt(square);
        c.distance = std::abs(height);
        c.normal = (height > 0 ? 1.0 : height < 0 ? -1.0 : 0.0) * area / std::sqrt(square);
      } else {  // the direction of a tiny area has few digits
        const Vector3d way = r + on_e * e - on_f * f;
        c.distance = way.norm();
        c.normal = way.normalized();
      }
      return c;
    }
  }
  c.distance = std::numeric_limits<double>::infinity();
  for (int end = 0; end < 2; ++end) {
    Closest3 on_second = closest_on_segment(end == 0 ? r : Vector3d(r + e), f);
    if (on_second.distance < c.distance) {
      on_second.first = end;
      c = on_second;
    }
    Closest3 on_first = closest_on_segment(end == 0 ? Vector3d(-r) : Vector3d(f - r), e);
    if (on_first.distance < c.distance) {
      c.distance = on_first.distance;
      c.normal = -on_first.normal;
      c.part = on_first.part == On::vertices ? On::vertices : On::edge_vertex;
      c.first = on_first.second;
      c.second = end;
    }
  }
  return c;
}

bool surely_apart_from_triangle(const Vector3d& r, const Vector3d& e, const Vector3d& f, double reach) {
  const Vector3d area = e.cross(f);
  const double square = area.squaredNorm();
  if (!(square > few_digits * e.squaredNorm() * f.squaredNorm())) return false;
  const double wide = beyond_rounding * reach, limit = wide * wide * square, height = r.dot(area);
  if (height * height > limit) return true;
  const double to_b = r.cross(f).dot(area), to_c = e.cross(r).dot(area);
  const auto outside = [&](double to, const Vector3d& edge) { return to < 0 && to * to > limit * edge.squaredNorm(); };
  return outside(to_b, f) || outside(to_c, e) || outside(square - to_b - to_c, f - e);
}

bool surely_apart_segments(const Vector3d& r, const Vector3d& e, const Vector3d& f, double reach) {
  const Vector3d area = e.cross(f);
  const double square = area.squaredNorm(), ee = e.squaredNorm(), ff = f.squaredNorm();
  // All of the second is as far from the first one's line as its start, but for what it leans.
  if (!(square > few_digits * ee * ff))
    return r.cross(e).norm() > std::sqrt(square) + beyond_rounding * reach * std::sqrt(ee);
  const double wide = beyond_rounding * reach, limit = wide * wide * square, height = r.dot(area);
  if (height * height > limit) return true;
  const auto aside = [&](double one_end, double other_end, double edge) {
    return one_end * other_end > 0 && std::min(one_end * one_end, other_end * other_end) > limit * edge;
  };
  const double a = r.cross(f).dot(area), c = -r.cross(e).dot(area);
  return aside(a, a + square, ff) || aside(c, c - square, ee);
}

Mollifier::Mollifier(const Vector3d& e, const Vector3d& f, double threshold) {
  const double x = e.cross(f).squaredNorm() / threshold;
  if (x >= 1) return;
  value = x * (2 - x);
  first = 2 * (1 - x) / threshold;
  second = -2 / (threshold * threshold);
  const double ee = e.squaredNorm(), ff = f.squaredNorm(), ef = e.dot(f);
  const Vector3d by_e = 2 * (ff * e - ef * f), by_f = 2 * (ee * f - ef * e);
  gradient.resize(12);
  gradient << -by_e, by_e, -by_f, by_f;
  const Eigen::Matrix3d I = Eigen::Matrix3d::Identity();
  const Eigen::Matrix3d E = 2 * (ff * I - f * f.transpose()), F = 2 * (ee * I - e * e.transpose());
  const Eigen::Matrix3d M = 2 * (2 * e * f.transpose() - f * e.transpose() - ef * I), N = M.transpose();
  hessian.resize(12, 12);
  hessian << E, -E, M, -M, -E, E, -M, M, N, -N, F, -F, -N, N, -F, F;
}

Closest3 MovingPair3::closest(double t) const {
  const auto from = [&](size_t b, size_t a) { return Vector3d((x[a] - x[b]) + t * (dx[a] - dx[b])); };
  return kind == Kind::point_triangle ? closest_on_triangle(from(1, 0), from(1, 2), from(1, 3))
                                      : closest_of_segments(from(2, 0), from(0, 1), from(2, 3));
}

double free_motion(const MovingPair3& pair, double keep, double horizon) {
  const size_t split = pair.kind == MovingPair3::Kind::point_triangle ? 1 : 2;
  double t = 0;
  for (int advance = 0; advance < 1000; ++advance) {
    const Closest3 now = pair.closest(t);
    if (!(now.distance > 0)) return 0;
    if (now.distance < 2 * keep) return t;
    double forward = 2;
    for (size_t i = 0; i < split; ++i) {
      for (size_t j = split; j < 4; ++j) {
        const double rate = now.normal.dot(pair.dx[i] - pair.dx[j]);
        const double apart = now.normal.dot(pair.x[i] - pair.x[j]) + t * rate;
        if (rate < 0) forward = std::min(forward, (apart - keep) / -rate);
      }
    }
    if (!(forward > 0)) return t;
    if (t + forward >= horizon) return horizon;
    t += forward;
  }
  return t;
}

int orientation(const Vector3d& a, const Vector3d& b, const Vector3d& c, const Vector3d& d) {
  const Vector3d ad = a - d, bd = b - d, cd = c - d;
  double determinant = 0, size = 0;
  for (int k = 0; k < 3; ++k) {
    const int l = (k + 1) % 3, m = (k + 2) % 3;
    const double one = bd[l] * cd[m], two = bd[m] * cd[l];
    determinant += ad[k] * (one - two);
    size += std::abs(ad[k]) * (std::abs(one) + std::abs(two));
  }
  // det(a - d, b - d, c - d) = -det(b - a, c - a, d - a); Shewchuk's bound (7 + 56 eps) eps with eps = 2^-53, and more.
  if (std::abs(determinant) > 8e-16 * size) return determinant > 0 ? -1 : 1;

  // det(b, c, d) - det(a, c, d) + det(a, b, d) - det(a, b, c), 24 products of three, each the sum of 4 doubles.
  ExactSum<97> sum;
  const auto add = [&](double sign, const Vector3d& x, const Vector3d& y, const Vector3d& z) {
    for (int k = 0; k < 3; ++k) {
      const int l = (k + 1) % 3, m = (k + 2) % 3;
      sum.add_product(sign * x[k], y[l], z[m]);
      sum.add_product(-sign * x[k], y[m], z[l]);
    }
  };
  add(1, b, c, d);
  add(-1, a, c, d);
  add(1, a, b, d);
  add(-1, a, b, c);
  return sum.sign();
}

bool segment_meets_triangle(const Vector3d& a, const Vector3d& b, const std::array<Vector3d, 3>& triangle) {
  const auto& [u, v, w] = triangle;
  const int side_a = orientation(u, v, w, a), side_b = orientation(u, v, w, b);
  if (side_a * side_b > 0) return false;
  if (side_a != 0 || side_b != 0) {
    const int one = orientation(a, b, u, v), two = orientation(a, b, v, w), three = orientation(a, b, w, u);
    return (one >= 0 && two >= 0 && three >= 0) || (one <= 0 && two <= 0 && three <= 0);
  }
  // All in one plane: seen along an axis along which the triangle has an area.
  for (int axis = 0; axis < 3; ++axis) {
    const Eigen::Vector2d A = without(axis, a), B = without(axis, b), U = without(axis, u), V = without(axis, v),
                          W = without(axis, w);
    const int turn = orientation(U, V, W);
    if (turn == 0) continue;
    if (segments_meet(A, B, U, V) || segments_meet(A, B, V, W) || segments_meet(A, B, W, U)) return true;
    return orientation(U, V, A) == turn && orientation(V, W, A) == turn && orientation(W, U, A) == turn;
  }
  return false;
}

}  // namespace taut

#include "sim/contact/contact_geometry.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "sim/contact/exact_sum.hpp"
#include "sim/core/dense.hpp"

namespace taut {
namespace {

double cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  return a[0] * b[1] - a[1] * b[0];
}

/// ln s and s - 1 for s = d / dhat; near s = 1 from the difference, so that the two go to zero together.
struct Logarithm {
  double s, below, ln;
  Logarithm(double d, double gap)
      : s(d / gap), below((d - gap) / gap), ln(below > -0.5 ? std::log1p(below) : std::log(s)) {}
};

}  // namespace

double Barrier::value(double d) const {
  if (d >= gap) return 0;
  const Logarithm l(d, gap);
  return -(power == 1 ? gap : gap * gap) * l.below * l.below * l.ln;
}

double Barrier::slope(double d) const {
  if (d >= gap) return 0;
  const Logarithm l(d, gap);
  return -(power == 1 ? 1.0 : gap) * (2 * l.below * l.ln + l.below * l.below / l.s);
}

double Barrier::curvature(double d) const {
  if (d >= gap) return 0;
  const Logarithm l(d, gap);
  const double ratio = l.below / l.s;
  return (power == 1 ? 1 / gap : 1.0) * (-2 * l.ln - 4 * ratio + ratio * ratio);
}

double Barrier::slope_by_gap(double d) const {
  // b' = dhat^(q-1) B'(s), so db'/ddhat = (q-1) b'/dhat - s b''.
  if (d >= gap) return 0;
  return (power - 1) * slope(d) / gap - d / gap * curvature(d);
}

Closest closest_on_segment(const Eigen::Vector2d& r, const Eigen::Vector2d& e) {
  Closest c;
  const double along = r.dot(e), square = e.squaredNorm();
  if (along > 0 && along < square) {
    const double length = std::sqrt(square);
    // From the nearer end: the area is then as small as it can be, and so is its rounding.
    const double area = 2 * along > square ? cross(e, r - e) : cross(e, r);
    c.parameter = along / square;
    c.distance = std::abs(area) / length;
    const double sign = area > 0 ? 1 : area < 0 ? -1 : 0;
    c.normal = sign / length * Eigen::Vector2d(-e[1], e[0]);
    return c;
  }
  c.part = along <= 0 ? Closest::Part::first_end : Closest::Part::second_end;
  c.parameter = along <= 0 ? 0 : 1;
  const Eigen::Vector2d way = along <= 0 ? r : Eigen::Vector2d(r - e);
  c.distance = way.norm();
  c.normal = c.distance > 0 ? Eigen::Vector2d(way / c.distance) : Eigen::Vector2d::Zero();
  return c;
}

PointPointDistance::PointPointDistance(const Eigen::Vector2d& r) : value(r.norm()), normal(r / value) {}

Eigen::Vector4d PointPointDistance::gradient() const {
  Eigen::Vector4d g;
  g << normal, -normal;
  return g;
}

Eigen::Matrix4d PointPointDistance::hessian(double first, double second, Curvature curvature) const {
  // Eigenvectors normal and tangent, in the difference of the two points.
  double across = first / value;
  if (curvature == Curvature::projected) {
    across = std::max(across, 0.0);
    second = std::max(second, 0.0);
  }
  const Eigen::Vector2d tangent(-normal[1], normal[0]);
  const Eigen::Matrix2d block = second * normal * normal.transpose() + across * tangent * tangent.transpose();
  Eigen::Matrix4d H;
  H << block, -block, -block, block;
  return H;
}

PointLineDistance::PointLineDistance(const Eigen::Vector2d& r, const Eigen::Vector2d& e) {
  const double square = e.squaredNorm(), along = r.dot(e);
  length = std::sqrt(square);
  tangent = e / length;
  parameter = along / square;
  const double area = 2 * along > square ? cross(e, r - e) : cross(e, r);
  value = std::abs(area) / length;
  normal = (area < 0 ? -1.0 : 1.0) * Eigen::Vector2d(-tangent[1], tangent[0]);
}

PointLineDistance::Vector6 PointLineDistance::gradient() const {
  Vector6 g;
  g << normal, -(1 - parameter) * normal, -parameter * normal;
  return g;
}

PointLineDistance::Matrix6 PointLineDistance::hessian(double first, double second, Curvature curvature) const {
  // H = B S B^T in the columns grad d, T, E. They are rows of tangents and normals with coefficients for p, a and b, so
  // the second block of 2 x 2 follows from 3 x 3 matrices in the frame (normal, tangent).
  const Eigen::Vector3d along(1, -(1 - parameter), -parameter), turn(0, -1, 1);
  const double mixed = -first / length, bend = -first * value / (length * length);
  Eigen::Matrix3d nn, nt;  // d2/(dn dn) and d2/(dn dt) of the three points
  Eigen::Matrix3d tt = Eigen::Matrix3d::Zero();
  if (curvature == Curvature::exact) {
    nn = second * along * along.transpose() + bend * turn * turn.transpose();
    nt = mixed * turn * along.transpose();
  } else {
    // Orthonormal directions: q1 ~ grad d and q3 ~ E minus its part along q1, both normal; q2 ~ T, tangential.
    const double size = along.norm();
    const Eigen::Vector3d q1 = along / size, rest = turn - turn.dot(q1) * q1, q3 = rest.normalized();
    const Eigen::Vector3d G(size, 0, 0), T(0, size, 0), E(turn.dot(q1), 0, rest.norm());
    const Eigen::Matrix3d S =
        second * G * G.transpose() + mixed * (T * E.transpose() + E * T.transpose()) + bend * E * E.transpose();
    const Eigen::Matrix3d P = positive_part(S);
    nn = P(0, 0) * q1 * q1.transpose() + P(2, 2) * q3 * q3.transpose();
    nn += P(2, 0) * (q3 * q1.transpose() + q1 * q3.transpose());
    nt = (P(1, 0) * q1 + P(2, 1) * q3) * q1.transpose();
    tt = P(1, 1) * q1 * q1.transpose();
  }
  const Eigen::Matrix2d NN = normal * normal.transpose(), NT = normal * tangent.transpose(),
                        TT = tangent * tangent.transpose();
  Matrix6 H;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      H.block<2, 2>(2 * i, 2 * j) = nn(i, j) * NN + nt(i, j) * NT + nt(j, i) * NT.transpose() + tt(i, j) * TT;
    }
  }
  return H;
}

double free_motion(const MovingPair& pair, double keep, double horizon) {
  double t = 0;
  for (int advance = 0; advance < 1000; ++advance) {
    const Eigen::Vector2d r = pair.r + t * pair.dr, e = pair.e + t * pair.de;
    const Closest now = closest_on_segment(r, e);
    if (!(now.distance > 0)) return 0;
    if (now.distance < 2 * keep) return t;
    // Both ends of the segment lie beyond the line through the closest point; neither may come nearer than `keep`.
    const Eigen::Vector2d& n = now.normal;
    const double to_first = n.dot(r), to_second = n.dot(r - e);
    const double first_rate = n.dot(pair.dr), second_rate = n.dot(pair.dr - pair.de);
    double forward = 2;
    if (first_rate < 0) forward = std::min(forward, (to_first - keep) / -first_rate);
    if (second_rate < 0) forward = std::min(forward, (to_second - keep) / -second_rate);
    if (!(forward > 0)) return t;
    if (t + forward >= horizon) return horizon;
    t += forward;
  }
  return t;
}

int orientation(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& c) {
  const double left = (a[0] - c[0]) * (b[1] - c[1]), right = (a[1] - c[1]) * (b[0] - c[0]);
  const double area = left - right;
  // Shewchuk's bound (3 + 16 eps) eps with eps = 2^-53, rounded up.
  if (std::abs(area) > 3.3306690738754731e-16 * (std::abs(left) + std::abs(right))) return area > 0 ? 1 : -1;

  // area = ax by - ay bx + bx cy - by cx + cx ay - cy ax as a sum of 12 doubles without rounding.
  ExactSum<13> sum;
  sum.add_product(a[0], b[1]);
  sum.add_product(-a[1], b[0]);
  sum.add_product(b[0], c[1]);
  sum.add_product(-b[1], c[0]);
  sum.add_product(c[0], a[1]);
  sum.add_product(-c[1], a[0]);
  return sum.sign();
}

bool segments_meet(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Vector2d& c,
                   const Eigen::Vector2d& d) {
  const int abc = orientation(a, b, c), abd = orientation(a, b, d);
  if (abc * abd > 0) return false;
  const int cda = orientation(c, d, a), cdb = orientation(c, d, b);
  if (cda * cdb > 0) return false;
  if (abc != 0 || abd != 0 || cda != 0 || cdb != 0) return true;
  // All on one line: their boxes decide.
  return Box(a.cwiseMin(b), a.cwiseMax(b)).intersects(Box(c.cwiseMin(d), c.cwiseMax(d)));
}

}  // namespace taut

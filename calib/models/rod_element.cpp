#include "calib/models/rod_element.hpp"

#include <algorithm>
#include <cmath>

namespace taut::rod {
namespace {

/// The symmetric M of u . (N_1 d1 + N_2 d2 + N_3 d3) = q^T M q for a unit quaternion.
Eigen::Matrix4d form_along(const Vector3d& N, const Vector3d& u) {
  // M = N_1 M_1 + N_2 M_2 + N_3 M_3, by products of a component of N and one of u.
  const auto p = [&](int i, int j) { return N[i] * u[j]; };
  Eigen::Matrix4d M;
  M(0, 0) = p(0, 0) + p(1, 1) + p(2, 2);
  M(1, 1) = p(0, 0) - p(1, 1) - p(2, 2);
  M(2, 2) = p(1, 1) - p(0, 0) - p(2, 2);
  M(3, 3) = p(2, 2) - p(0, 0) - p(1, 1);
  M(0, 1) = M(1, 0) = p(1, 2) - p(2, 1);
  M(0, 2) = M(2, 0) = p(2, 0) - p(0, 2);
  M(0, 3) = M(3, 0) = p(0, 1) - p(1, 0);
  M(1, 2) = M(2, 1) = p(0, 1) + p(1, 0);
  M(1, 3) = M(3, 1) = p(0, 2) + p(2, 0);
  M(2, 3) = M(3, 2) = p(1, 2) + p(2, 1);
  return M;
}

/// q e^(delta/2) = q + slopes delta + ...
Eigen::Matrix<double, 4, 3> slopes_of(const Vector4d& q) {
  Eigen::Matrix<double, 4, 3> slopes;
  slopes << -q[1], -q[2], -q[3], q[0], -q[3], q[2], q[3], q[0], -q[1], -q[2], q[1], q[0];
  return 0.5 * slopes;
}

/// 2 asin(sqrt(X))/sqrt(X), which turns half the sine of a rotation into its angle, with derivatives.
std::array<double, 3> arc_ratio(double X) {
  if (X < 2e-3) {
    return {2 * (1 + X * (1.0 / 6 + X * (3.0 / 40 + X * (15.0 / 336 + X * (105.0 / 3456))))),
            2 * (1.0 / 6 + X * (3.0 / 20 + X * (15.0 / 112 + X * (35.0 / 288 + X * 0.1118607954545455)))),
            2 * (3.0 / 20 + X * (15.0 / 56 + X * (35.0 / 96 + X * (0.4474431818181818 + X * 0.5220170454545455))))};
  }
  const double y = std::sqrt(X), c = std::sqrt(1 - X), h = std::asin(y) / y;
  const double first = (1 / c - h) / (2 * X), second = (0.5 / (c * c * c) - 3 * first) / (2 * X);
  return {2 * h, 2 * first, 2 * second};
}

}  // namespace

Vector4d turn(const Vector3d& rotation) {
  const double angle = rotation.norm();
  Vector4d q;
  q[0] = std::cos(0.5 * angle);
  q.tail<3>() = (angle < 1e-8 ? 0.5 : std::sin(0.5 * angle) / angle) * rotation;
  return q;
}

RodElement::RodElement(const Vector3d& ra, const Vector4d& qa, const Vector3d& rb, const Vector4d& qb, double length)
    : l_(length), qa_(qa), qb_(qa.dot(qb) < 0 ? Vector4d(-qb) : qb) {
  w_ = qa_.dot(qb_);
  s_ = qa_ + qb_;
  n_ = s_.squaredNorm();
  R_ = rotation_by(s_ / std::sqrt(n_));
  u_ = (rb - ra) / l_;
  x_ = product(Vector4d(qa[0], -qa[1], -qa[2], -qa[3]), qb_).tail<3>();
  arc_ = arc_ratio(std::min(x_.squaredNorm(), 0.99));
  v = R_.transpose() * u_;
  k = arc_[0] / l_ * x_;
}

Matrix36 RodElement::middle_turns() const {
  return 4 / std::sqrt(n_) * times(Matrix34(slopes_of(s_ / std::sqrt(n_)).transpose()), sum_slopes());
}

Matrix612 RodElement::slopes() const {
  const Matrix36 turned = times(by_sum(), sum_slopes()), half_turned = half_turn_slopes();
  Matrix3d by_half = 2 * arc_[1] * outer(x_, x_);
  by_half.diagonal().array() += arc_[0];
  const Matrix36 k_turned = times(by_half, half_turned);
  Matrix612 slopes = Matrix612::Zero();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      slopes(i, j) = -R_(j, i) / l_;
      slopes(i, j + 6) = R_(j, i) / l_;
      slopes(i, j + 3) = turned(i, j);
      slopes(i, j + 9) = turned(i, j + 3);
      slopes(i + 3, j + 3) = k_turned(i, j) / l_;
      slopes(i + 3, j + 9) = k_turned(i, j + 3) / l_;
    }
  }
  return slopes;
}

Matrix12 RodElement::curvature(const Vector6& stress) const {
  const Vector3d N = stress.head<3>(), m = stress.tail<3>() / l_;
  const Matrix46 S = sum_slopes();
  // Of N . v by the sum of the quaternions.
  const Matrix34 by = by_sum();
  const Vector4d g = N[0] * by.row(0) + N[1] * by.row(1) + N[2] * by.row(2);
  const Eigen::Matrix4d across_sum = outer(s_, g);
  Eigen::Matrix4d by_sums = form_along(N, u_) - across_sum - across_sum.transpose();
  by_sums.diagonal().array() -= N.dot(v);
  by_sums *= 2 / n_;
  Matrix6 turns = congruent(by_sums, S);
  // By that sum and the way from r_a to r_b.
  Eigen::Matrix<double, 3, 4> by_both;
  for (int i = 0; i < 3; ++i) {
    const Vector4d row = times(form_along(N, Vector3d::Unit(i)), s_);
    const double along = R_(i, 0) * N[0] + R_(i, 1) * N[1] + R_(i, 2) * N[2];
    for (int j = 0; j < 4; ++j) by_both(i, j) = 2 / (n_ * l_) * (row[j] - along * s_[j]);
  }
  const Matrix36 mixed = times(by_both, S);
  // Of m . k l by the half turn x, and of that by the turns.
  const double along = m.dot(x_);
  const Vector3d by_x = arc_[0] * m + 2 * arc_[1] * along * x_;
  const Matrix3d mx = outer(m, x_);
  Matrix3d by_xs = 2 * arc_[1] * (mx + mx.transpose()) + 4 * arc_[2] * along * outer(x_, x_);
  by_xs.diagonal().array() += 2 * arc_[1] * along;
  turns += congruent(by_xs, half_turn_slopes());
  const double inward = by_x.dot(x_), first = inward + g.dot(qa_), second = inward + g.dot(qb_);
  const Matrix3d bx = outer(by_x, x_);
  Matrix3d across = w_ * cross_matrix(by_x) + bx + bx.transpose();
  across.diagonal().array() -= inward;
  for (int i = 0; i < 3; ++i) {
    turns(i, i) -= 0.25 * first;
    turns(i + 3, i + 3) -= 0.25 * second;
    for (int j = 0; j < 3; ++j) {
      turns(i, j + 3) += 0.25 * across(i, j);
      turns(j + 3, i) += 0.25 * across(i, j);
    }
  }
  Matrix12 H = Matrix12::Zero();
  for (int i = 0; i < 6; ++i) {
    const int turn_i = i < 3 ? i + 3 : i + 6;
    for (int j = 0; j < 6; ++j) H(turn_i, j < 3 ? j + 3 : j + 6) = turns(i, j);
    for (int j = 0; j < 3; ++j) {
      H(j, turn_i) = H(turn_i, j) = -mixed(j, i);
      H(j + 6, turn_i) = H(turn_i, j + 6) = mixed(j, i);
    }
  }
  return H;
}

RodElement::Matrix46 RodElement::sum_slopes() const {
  const Eigen::Matrix<double, 4, 3> a = slopes_of(qa_), b = slopes_of(qb_);
  Matrix46 S;
  for (int j = 0; j < 3; ++j) {
    for (int i = 0; i < 4; ++i) {
      S(i, j) = a(i, j);
      S(i, j + 3) = b(i, j);
    }
  }
  return S;
}

RodElement::Matrix34 RodElement::by_sum() const {
  Eigen::Matrix<double, 3, 4> by;
  for (int i = 0; i < 3; ++i) {
    const Vector4d row = times(form_along(Vector3d::Unit(i), u_), s_);
    for (int j = 0; j < 4; ++j) by(i, j) = 2 / n_ * (row[j] - v[i] * s_[j]);
  }
  return by;
}

Matrix36 RodElement::half_turn_slopes() const {
  const Matrix3d X = cross_matrix(x_);
  Matrix36 slopes;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      const double half = i == j ? w_ : 0;
      slopes(i, j) = 0.5 * (X(i, j) - half);
      slopes(i, j + 3) = 0.5 * (X(i, j) + half);
    }
  }
  return slopes;
}

}  // namespace taut::rod

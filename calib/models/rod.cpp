#include "calib/models/rod.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>

#include "calib/models/fibre.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::Vector4d;
using Eigen::VectorXd;
using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;
using Vector12 = Eigen::Matrix<double, 12, 1>;
using Matrix12 = Eigen::Matrix<double, 12, 12>;
using Matrix36 = Eigen::Matrix<double, 3, 6>;
using Matrix46 = Eigen::Matrix<double, 4, 6>;
using Matrix612 = Eigen::Matrix<double, 6, 12>;

/// A B and A^T M A by loops: of Eigen's products of many sizes a compiler needs a gigabyte.
template <int R, int K, int C>
Eigen::Matrix<double, R, C> times(const Eigen::Matrix<double, R, K>& A, const Eigen::Matrix<double, K, C>& B) {
  Eigen::Matrix<double, R, C> AB;
  for (int c = 0; c < C; ++c) {
    for (int r = 0; r < R; ++r) AB(r, c) = A(r, 0) * B(0, c);
    for (int k = 1; k < K; ++k) {
      for (int r = 0; r < R; ++r) AB(r, c) += A(r, k) * B(k, c);
    }
  }
  return AB;
}
template <int K, int C>
Eigen::Matrix<double, C, C> congruent(const Eigen::Matrix<double, K, K>& M, const Eigen::Matrix<double, K, C>& A) {
  const Eigen::Matrix<double, K, C> MA = times(M, A);
  Eigen::Matrix<double, C, C> H;
  for (int c = 0; c < C; ++c) {
    for (int r = 0; r < C; ++r) {
      H(r, c) = A(0, r) * MA(0, c);
      for (int k = 1; k < K; ++k) H(r, c) += A(k, r) * MA(k, c);
    }
  }
  return H;
}

/// a b^T.
template <int R>
Eigen::Matrix<double, R, R> outer(const Eigen::Matrix<double, R, 1>& a, const Eigen::Matrix<double, R, 1>& b) {
  Eigen::Matrix<double, R, R> ab;
  for (int c = 0; c < R; ++c) {
    for (int r = 0; r < R; ++r) ab(r, c) = a[r] * b[c];
  }
  return ab;
}

Matrix3d cross_matrix(const Vector3d& a) {
  Matrix3d A;
  A << 0, -a[2], a[1], a[2], 0, -a[0], -a[1], a[0], 0;
  return A;
}

Vector3d cross(const Vector3d& a, const Vector3d& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

/// The product of quaternions (w, x, y, z).
Vector4d product(const Vector4d& a, const Vector4d& b) {
  return {a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3], a[0] * b[1] + b[0] * a[1] + a[2] * b[3] - a[3] * b[2],
          a[0] * b[2] + b[0] * a[2] + a[3] * b[1] - a[1] * b[3], a[0] * b[3] + b[0] * a[3] + a[1] * b[2] - a[2] * b[1]};
}

/// By a rotation vector.
Vector4d turn(const Vector3d& rotation) {
  const double angle = rotation.norm();
  Vector4d q;
  q[0] = std::cos(0.5 * angle);
  q.tail<3>() = (angle < 1e-8 ? 0.5 : std::sin(0.5 * angle) / angle) * rotation;
  return q;
}

Matrix3d rotation_by(const Vector4d& q) {
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  Matrix3d R;
  R << 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z), 1 - 2 * (x * x + z * z),
      2 * (y * z - w * x), 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y);
  return R;
}

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

/// An element between nodes: its shear and stretch v and its curvature k, with derivatives by (r_a, turn_a, r_b,
/// turn_b).
class Element {
 public:
  Element(const Vector3d& ra, const Vector4d& qa, const Vector3d& rb, const Vector4d& qb, double length)
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

  Vector3d v, k;
  const Matrix3d& middle() const { return R_; }  ///< half way
  /// Small turns behind it by those of the ends.
  Matrix36 middle_turns() const {
    return 4 / std::sqrt(n_) *
           times(Eigen::Matrix<double, 3, 4>(slopes_of(s_ / std::sqrt(n_)).transpose()), sum_slopes());
  }
  bool possible() const { return w_ > 0.25; }  ///< it has not turned by too much

  /// Derivatives of v, then of k.
  Matrix612 slopes() const {
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

  /// Sum of stress, by v and then by k, times second derivatives.
  Matrix12 curvature(const Vector6& stress) const {
    const Vector3d N = stress.head<3>(), m = stress.tail<3>() / l_;
    const Matrix46 S = sum_slopes();
    // Of N . v by the sum of the quaternions.
    const Eigen::Matrix<double, 3, 4> by = by_sum();
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

 private:
  /// Of q_a + q_b by the turns.
  Matrix46 sum_slopes() const {
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
  /// Of v by q_a + q_b.
  Eigen::Matrix<double, 3, 4> by_sum() const {
    Eigen::Matrix<double, 3, 4> by;
    for (int i = 0; i < 3; ++i) {
      const Vector4d row = times(form_along(Vector3d::Unit(i), u_), s_);
      for (int j = 0; j < 4; ++j) by(i, j) = 2 / n_ * (row[j] - v[i] * s_[j]);
    }
    return by;
  }
  /// Of x by the turns.
  Matrix36 half_turn_slopes() const {
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

  double l_, w_, n_;
  Vector4d qa_, qb_, s_;
  Matrix3d R_;                 ///< half way
  Vector3d u_, x_;             ///< (r_b - r_a)/l; sine of half of the turn from a to b, times its axis
  std::array<double, 3> arc_;  ///< that turn over twice that sine, with derivatives
};

/// w, w', w'', dw'/dnu of a fibre.
std::array<double, 4> fibre_of(double stretch, double E, double nu, bool by_poisson) {
  const auto mu_of = [&](const auto& poisson) { return E / (2.0 * (1.0 + poisson)); };
  const auto lambda_of = [&](const auto& poisson) { return E * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)); };
  if (!by_poisson) {
    const Jet<1> w = fibre_energy(Jet<1>::variable(stretch, 0), 2, mu_of(nu), lambda_of(nu));
    return {w.v, w.g[0], w.H(0, 0), 0};
  }
  const Jet<2> poisson = Jet<2>::variable(nu, 1);
  const Jet<2> w = fibre_energy(Jet<2>::variable(stretch, 0), 2, mu_of(poisson), lambda_of(poisson));
  return {w.v, w.g[0], w.H(0, 0), w.H(0, 1)};
}

/// A circle, times `sign`: fibres lie on lines square to the direction of bending, of lengths 2 sqrt(1 - x^2).
void add_circle(double sign, double radius, const Vector3d& by, double E, double nu, bool by_poisson,
                RodStretching& sum) {
  constexpr int points = 6;
  const double k = by.tail<2>().norm(), area = sign * std::numbers::pi * radius * radius;
  // Where it does not bend yet, any direction will do.
  const Eigen::Vector2d way = k > 0 ? Eigen::Vector2d(by.tail<2>() / k) : Eigen::Vector2d(1, 0);
  double moment = 0, stiffness = 0;
  for (int i = 1; i <= points; ++i) {
    const double angle = i * std::numbers::pi / (points + 1), arm = radius * std::cos(angle);
    const double dA = area * 2 / (points + 1) * std::sin(angle) * std::sin(angle);
    const auto [w, dw, ddw, dw_nu] = fibre_of(by[0] + k * arm, E, nu, by_poisson);
    const Vector3d slope(1, arm * way[0], arm * way[1]);
    sum.energy += dA * w;
    sum.stress += dA * dw * slope;
    sum.by_poisson += dA * dw_nu * slope;
    sum.tangent += dA * ddw * outer(slope, slope);
    moment += dA * dw * arm;
    stiffness += dA * ddw * arm * arm;
  }
  const double across = k * radius > 1e-5 ? moment / k : stiffness;
  sum.tangent(1, 1) += across * way[1] * way[1];
  sum.tangent(2, 2) += across * way[0] * way[0];
  sum.tangent(1, 2) -= across * way[0] * way[1];
  sum.tangent(2, 1) -= across * way[0] * way[1];
}

void add_rectangle(double half_first, double half_second, const Vector3d& by, double E, double nu, bool by_poisson,
                   RodStretching& sum) {
  constexpr double place[5] = {-0.9061798459386640, -0.5384693101056831, 0, 0.5384693101056831, 0.9061798459386640};
  constexpr double weight[5] = {0.2369268850561891, 0.4786286704993665, 0.5688888888888889, 0.4786286704993665,
                                0.2369268850561891};
  for (int i = 0; i < 5; ++i) {
    for (int j = 0; j < 5; ++j) {
      const Vector3d slope(1, half_second * place[j], -half_first * place[i]);
      const double dA = half_first * half_second * weight[i] * weight[j];
      const auto [w, dw, ddw, dw_nu] = fibre_of(slope.dot(by), E, nu, by_poisson);
      sum.energy += dA * w;
      sum.stress += dA * dw * slope;
      sum.by_poisson += dA * dw_nu * slope;
      sum.tangent += dA * ddw * outer(slope, slope);
    }
  }
}

/// Second derivatives of tau . exp(turn) arm by the turn.
Matrix3d arm_curvature(const Vector3d& arm, const Vector3d& tau) {
  return 0.5 * (outer(arm, tau) + outer(tau, arm)) - arm.dot(tau) * Matrix3d::Identity();
}

/// A symmetric matrix of 6 x 6 blocks on and beside the diagonal.
struct Blocks {
  std::vector<Matrix6> on, beside;  ///< (i, i), (i, i + 1)
};

/// Cholesky's factors L_i and W_i = L_i^-1 beside_i; nothing where the matrix plus shift times `scale` is not positive
/// definite. Loops by hand: of Eigen's decompositions a compiler needs a gigabyte.
class BlockFactors {
 public:
  static std::optional<BlockFactors> of(Blocks A, double shift, const Vector6& scale) {
    const size_t n = A.on.size();
    for (size_t i = 0; i < n; ++i) {
      Matrix6& L = A.on[i];
      L.diagonal() += shift * scale;
      if (i > 0) L -= congruent(Matrix6(Matrix6::Identity()), A.beside[i - 1]);
      for (int c = 0; c < 6; ++c) {
        for (int k = 0; k < c; ++k) {
          for (int r = c; r < 6; ++r) L(r, c) -= L(r, k) * L(c, k);
        }
        if (!(L(c, c) > 0 && std::isfinite(L(c, c)))) return std::nullopt;
        const double root = std::sqrt(L(c, c));
        for (int r = c; r < 6; ++r) L(r, c) /= root;
      }
      if (i + 1 == n) break;
      for (int c = 0; c < 6; ++c) forward(L, &A.beside[i](0, c));
    }
    return BlockFactors(std::move(A));
  }

  Eigen::MatrixXd solve(Eigen::MatrixXd b) const {
    const size_t n = factors_.on.size();
    for (Eigen::Index c = 0; c < b.cols(); ++c) {
      double* x = b.col(c).data();
      for (size_t i = 0; i < n; ++i, x += 6) {
        if (i > 0) Eigen::Map<Vector6>(x) -= factors_.beside[i - 1].transpose() * Eigen::Map<Vector6>(x - 6);
        forward(factors_.on[i], x);
      }
      for (size_t i = n; i-- > 0;) {
        x -= 6;
        if (i + 1 < n) Eigen::Map<Vector6>(x) -= factors_.beside[i] * Eigen::Map<Vector6>(x + 6);
        backward(factors_.on[i], x);
      }
    }
    return b;
  }

 private:
  explicit BlockFactors(Blocks factors) : factors_(std::move(factors)) {}
  /// L^-1 x and L^-T x in place.
  static void forward(const Matrix6& L, double* x) {
    for (int r = 0; r < 6; ++r) {
      for (int c = 0; c < r; ++c) x[r] -= L(r, c) * x[c];
      x[r] /= L(r, r);
    }
  }
  static void backward(const Matrix6& L, double* x) {
    for (int r = 5; r >= 0; --r) {
      for (int c = r + 1; c < 6; ++c) x[r] -= L(c, r) * x[c];
      x[r] /= L(r, r);
    }
  }

  Blocks factors_;
};

}  // namespace

struct Rod::Sums {
  double energy = 0;
  Eigen::VectorXd gradient;
  Blocks hessian;
  Eigen::MatrixXd by_values;
  std::vector<Vector3d> v;                           ///< of each element
  std::vector<Eigen::Matrix<double, 3, 12>> slopes;  ///< of v
};

/// A piece of tendon in the world.
struct Rod::Run {
  Eigen::Index element = 0, value = 0;
  double length = 0, part = 0;  ///< of the piece at rest [m], of its element
  RodReading direction;         ///< unit length
  Vector12 force;               ///< gradient by the unknowns of its element's nodes, per unit of tension
};

/// By how much each piece's direction, in its middle, is turned against that where its tendon is pulled.
struct Rod::Turning {
  VectorXd angle;
  MatrixXd change;  ///< a column of each piece: by how much where the unknowns change like a column of `dx`
  VectorXd left(double friction) const { return (-friction * angle).array().exp(); }  ///< of the tension
};

/// At a state with held tensions: what these do to it, and it to what friction leaves of them.
struct Rod::Feedback {
  std::vector<Run> runs;
  std::vector<Eigen::Index> pulling;   ///< pieces of tendons with a tension
  MatrixXd by_left;                    ///< H^-1 times the derivative of the gradient by what is left in each of these
  VectorXd by_angle;                   ///< derivative of what is left in each piece
  Eigen::PartialPivLU<MatrixXd> loop;  ///< 1 + (derivative by the state of what is left in these) by_left

  /// How what is left in the pulling ones changes with all angles.
  MatrixXd left_by(const Turning& turning) const {
    return (turning.change * by_angle.asDiagonal())(Eigen::all, pulling).transpose();
  }
};

Rod::Rod(RodShape shape) : shape_(std::move(shape)) {
  if (!(shape_.length > 0)) throw InputError("a rod has a positive length");
  if (shape_.nodes.empty()) {
    for (int i = 0; i <= 72; ++i) shape_.nodes.push_back(shape_.length * i / 72);
  }
  const std::vector<double>& nodes = shape_.nodes;
  if (nodes.size() < 2 || nodes.front() != 0 || nodes.back() != shape_.length ||
      std::adjacent_find(nodes.begin(), nodes.end(), std::greater_equal()) != nodes.end())
    throw InputError("the nodes of a rod ascend from its clamp to its end");
  for (size_t i = 0; i + 1 < nodes.size(); ++i) {
    Section section{shape_.section(0.5 * (nodes[i] + nodes[i + 1])), nodes[i + 1] - nodes[i]};
    const auto& [A, first, second, torsion] = section.of;
    if (!(A > 0 && first > 0 && second > 0 && torsion > 0)) throw InputError("a rod's sections have an area");
    const double sum = 4 * first / A, difference = A / std::numbers::pi;  // of the squares of outer and inner radius
    section.outer = std::sqrt(0.5 * (sum + difference));
    section.inner = sum - difference < 1e-9 * sum ? 0.0 : std::sqrt(0.5 * (sum - difference));
    const double square = std::pow(section.inner / section.outer, 2), whole = (1 + square) * (1 + square);
    section.shear = shape_.shear_factor * A * (shape_.round ? whole / (whole + 2.6 * square) : 1.0);
    section.half_first = std::sqrt(3 * second / A);
    section.half_second = std::sqrt(3 * first / A);
    sections_.push_back(section);
  }
  if (!shape_.down.isZero()) add_weight();
  for (size_t t = 0; t < shape_.tendons.size(); ++t) {
    const RodTendon& tendon = shape_.tendons[t];
    for (size_t i = 0; i < sections_.size(); ++i) {
      const double from = i == 0 ? tendon.start : std::max(nodes[i], tendon.start),
                   to = i + 1 == sections_.size() ? tendon.end : std::min(nodes[i + 1], tendon.end);
      if (to - from < 1e-9 * sections_[i].length) continue;
      const Eigen::Vector2d middle = tendon.eyelet(0.5 * (from + to)),
                            slope = (tendon.eyelet(to) - tendon.eyelet(from)) / (to - from);
      sections_[i].pieces.push_back({{middle[0], middle[1], 0},
                                     {slope[0], slope[1], 0},
                                     (to - from) / sections_[i].length,
                                     first_tension + static_cast<Eigen::Index>(t),
                                     pieces_++});
    }
  }
  for (size_t f = 0; f < shape_.forces.size(); ++f) {
    const RodForce& force = shape_.forces[f];
    for (const Share& share : shares_of(force.at, force.direction, first_force() + static_cast<Eigen::Index>(f)))
      shares_.push_back(share);
  }
}

/// By Gauss's rule along each element, what acts on a node in one.
void Rod::add_weight() {
  constexpr double place[3] = {0.1127016653792583, 0.5, 0.8872983346207417}, part[3] = {5.0 / 18, 4.0 / 9, 5.0 / 18};
  std::vector<Share> of_nodes;
  for (int i = 0; i <= elements(); ++i) of_nodes.push_back({i, Vector3d::Zero(), Vector3d::Zero(), weight});
  for (size_t i = 0; i < 3 * sections_.size(); ++i) {
    const double length = sections_[i / 3].length, s = shape_.nodes[i / 3] + place[i % 3] * length;
    const double volume = part[i % 3] * length * shape_.section(s).area;
    for (const Share& share : shares_of({s, Vector3d::Zero()}, volume * shape_.down, weight)) {
      Share& node = of_nodes[static_cast<size_t>(share.node)];
      const double before = node.force.norm(), more = share.force.norm();
      node.arm = (before * node.arm + more * share.arm) / (before + more);
      node.force += share.force;
    }
  }
  shares_.insert(shares_.end(), of_nodes.begin() + 1, of_nodes.end());
}

Rod::Place Rod::place_of(double s) const {
  const auto next = std::upper_bound(shape_.nodes.begin() + 1, shape_.nodes.end() - 1, s);
  const int element = static_cast<int>(next - shape_.nodes.begin()) - 1;
  const double length = sections_[static_cast<size_t>(element)].length;
  return {element, std::clamp((s - *(next - 1)) / length, 0.0, 1.0), length};
}

/// A point between two nodes is a mean of where both would carry it, each half way: its axis is a parabola between
/// them.
std::vector<Rod::Share> Rod::shares_of(const RodPoint& at, const Vector3d& force, Eigen::Index value) const {
  const auto [element, f, length] = place_of(at.s);
  const auto [before, after] = arms_of(at);
  std::vector<Share> shares;
  if (f < 1 && element > 0) shares.push_back({element, before, (1 - f) * force, value});  // the clamp carries its own
  if (f > 0) shares.push_back({element + 1, after, f * force, value});
  return shares;
}

std::array<Vector3d, 2> Rod::arms_of(const RodPoint& at) const {
  const auto [element, f, length] = place_of(at.s);
  const double beyond = at.s - std::clamp(at.s, 0.0, shape_.length);
  return {at.offset + Vector3d(0, 0, beyond + 0.5 * length * f),
          at.offset + Vector3d(0, 0, beyond - 0.5 * length * (1 - f))};
}

RodState Rod::rest() const {
  RodState x;
  for (const double s : shape_.nodes) {
    x.r.emplace_back(0, 0, s);
    x.q.emplace_back(1, 0, 0, 0);
  }
  return x;
}

Rod::Sums Rod::assemble(const RodState& x, const Values& values, Order order, bool by_values) const {
  const size_t n = sections_.size();
  Sums sum;
  if (order >= slopes) sum.gradient = Eigen::VectorXd::Zero(unknowns() + 6);  // the clamped node's come first
  if (order == curvatures) {
    sum.hessian.on.assign(n + 1, Matrix6::Zero());
    sum.hessian.beside.assign(n, Matrix6::Zero());
    sum.v.resize(n);
    sum.slopes.resize(n);
  }
  if (by_values) sum.by_values = Eigen::MatrixXd::Zero(unknowns() + 6, value_count());
  for (size_t i = 0; i < n; ++i) {
    if (!add_element(i, x, values, order, by_values, sum)) {
      sum.energy = std::numeric_limits<double>::infinity();
      return sum;
    }
  }
  for (const Share& share : shares_) {
    const size_t a = static_cast<size_t>(share.node);
    const Matrix3d R = rotation_by(x.q[a]);
    const double pull = values[share.value];
    sum.energy -= pull * share.force.dot(x.r[a] + R * share.arm);
    if (order < slopes) continue;
    const Vector3d tau = R.transpose() * share.force;
    Vector6 slope;
    slope << -share.force, -cross(share.arm, tau);
    sum.gradient.segment<6>(6 * share.node) += pull * slope;
    if (by_values) sum.by_values.col(share.value).segment<6>(6 * share.node) += slope;
    if (order == curvatures) sum.hessian.on[a].bottomRightCorner<3, 3>() -= pull * arm_curvature(share.arm, tau);
  }
  if (order >= slopes) sum.gradient = sum.gradient.tail(unknowns()).eval();
  if (by_values) sum.by_values = sum.by_values.bottomRows(unknowns()).eval();
  if (order == curvatures) {
    sum.hessian.on.erase(sum.hessian.on.begin());
    sum.hessian.beside.erase(sum.hessian.beside.begin());
  }
  return sum;
}

/// False where it has turned by too much.
bool Rod::add_element(size_t i, const RodState& x, const Values& values, Order order, bool by_values, Sums& sum) const {
  const Section& section = sections_[i];
  const double E = values[youngs], nu = values[poisson], G = E / (2 * (1 + nu));
  const Element e(x.r[i], x.q[i], x.r[i + 1], x.q[i + 1], sections_[i].length);
  if (!e.possible()) return false;
  const double shear = G * section.shear, twist = G * section.of.torsion;
  const RodStretching body = stretching_of(section, Vector3d(e.v[2], e.k[0], e.k[1]), E, nu, by_values);
  Vector6 stress;
  stress << shear * e.v[0], shear * e.v[1], body.stress, twist * e.k[2];
  const Vector6 of_body = stress;
  Matrix6 tangent = Matrix6::Zero();
  tangent.diagonal() << shear, shear, 0, 0, 0, twist;
  tangent.block<3, 3>(2, 2) = body.tangent;
  double stored = body.energy + 0.5 * (shear * e.v.head<2>().squaredNorm() + twist * e.k[2] * e.k[2]);
  Eigen::Matrix<double, 6, Eigen::Dynamic> pulls(6, section.pieces.size());  // stresses by tensions
  for (size_t t = 0; t < section.pieces.size(); ++t) {
    const Piece& piece = section.pieces[t];
    const Vector3d way = e.v + cross(e.k, piece.eyelet) + piece.slope;
    const double part = x.left.size() == 0 ? piece.part : piece.part * x.left[piece.index];
    const double length = way.norm(), tension = part * values[piece.value];
    const Vector3d along = way / length;
    Vector6 pull;
    pull << along, cross(piece.eyelet, along);
    pulls.col(static_cast<Eigen::Index>(t)) = part * pull;
    stored += tension * length;
    stress += tension * pull;
    Matrix3d across = -tension / length * outer(along, along);
    across.diagonal().array() += tension / length;
    Matrix36 by_strains;
    const Matrix3d arm = cross_matrix(piece.eyelet);
    for (int c = 0; c < 3; ++c) {
      for (int r = 0; r < 3; ++r) {
        by_strains(r, c) = r == c ? 1 : 0;
        by_strains(r, c + 3) = -arm(r, c);
      }
    }
    tangent += congruent(across, by_strains);
  }
  sum.energy += section.length * stored;
  if (order < slopes) return true;

  const Eigen::Index at = 6 * static_cast<Eigen::Index>(i);
  const Matrix612 B = e.slopes();
  const auto add_slope = [&](Eigen::Ref<Eigen::VectorXd> to, const Vector6& by_strains) {
    to.segment<12>(at) += section.length * (B.transpose() * by_strains);
  };
  add_slope(sum.gradient, stress);
  if (by_values) {
    Vector6 poissons;
    poissons << of_body[0], of_body[1], 0, 0, 0, of_body[5];
    poissons /= -(1 + nu);
    poissons.segment<3>(2) = body.by_poisson;
    add_slope(sum.by_values.col(youngs), of_body / E);
    add_slope(sum.by_values.col(poisson), poissons);
    for (size_t t = 0; t < section.pieces.size(); ++t)
      add_slope(sum.by_values.col(section.pieces[t].value), pulls.col(static_cast<Eigen::Index>(t)));
  }
  if (order < curvatures) return true;
  const Matrix12 H = section.length * (congruent(tangent, B) + e.curvature(stress));
  sum.hessian.on[i] += H.topLeftCorner<6, 6>();
  sum.hessian.on[i + 1] += H.bottomRightCorner<6, 6>();
  sum.hessian.beside[i] += H.topRightCorner<6, 6>();
  sum.v[i] = e.v;
  sum.slopes[i] = B.topRows<3>();
  return true;
}

RodStretching Rod::stretching_of(const Section& section, const Vector3d& by, double E, double nu,
                                 bool by_poisson) const {
  RodStretching sum;
  if (shape_.law == SectionLaw::linear) {
    const Vector3d stiffness(E * section.of.area, E * section.of.first, E * section.of.second);
    const Vector3d strains = by - Vector3d(1, 0, 0);
    sum.tangent = stiffness.asDiagonal();
    sum.stress = stiffness.cwiseProduct(strains);
    sum.energy = 0.5 * sum.stress.dot(strains);
  } else if (shape_.round) {
    add_circle(1, section.outer, by, E, nu, by_poisson, sum);
    if (section.inner > 0) add_circle(-1, section.inner, by, E, nu, by_poisson, sum);
  } else {
    add_rectangle(section.half_first, section.half_second, by, E, nu, by_poisson, sum);
  }
  return sum;
}

double Rod::energy(const RodState& x, const Values& values) const {
  return assemble(x, values, energies).energy;
}

Eigen::VectorXd Rod::gradient(const RodState& x, const Values& values) const {
  if (values[friction()] == 0) return assemble(x, values, slopes).gradient;
  RodState rubbed = x;
  rubbed.left = tension_left(x, values[friction()]);
  return assemble(rubbed, values, slopes).gradient;
}

Eigen::MatrixXd Rod::gradient_by_values(const RodState& x, const Values& values, bool by_friction) const {
  MatrixXd by_values = assemble(x, values, slopes, true).by_values;
  if (by_friction) {
    const std::vector<Run> runs = runs_of(x);
    const Turning turning = turning_of(runs, MatrixXd(unknowns(), 0));
    by_values.col(friction()) = pulled(runs, values, -turning.angle.cwiseProduct(turning.left(values[friction()])));
  }
  return by_values;
}

std::optional<Eigen::MatrixXd> Rod::solve_linear(const RodState& x, const Values& values,
                                                 const Eigen::MatrixXd& B) const {
  const std::optional<BlockFactors> factors =
      BlockFactors::of(assemble(x, values, curvatures).hessian, 0, Vector6::Zero());
  if (!factors) return std::nullopt;
  MatrixXd dx = factors->solve(B);
  if (values[friction()] == 0) return dx;
  const Feedback feedback = feedback_of(x, values, [&](MatrixXd b) { return factors->solve(std::move(b)); });
  dx -= feedback.by_left * feedback.loop.solve(feedback.left_by(turning_of(feedback.runs, dx)));
  if (!dx.allFinite()) return std::nullopt;
  return dx;
}

std::vector<Rod::Run> Rod::runs_of(const RodState& x) const {
  std::vector<Run> runs(static_cast<size_t>(pieces_));
  for (size_t i = 0; i < sections_.size(); ++i) {
    const Section& section = sections_[i];
    if (section.pieces.empty()) continue;
    const Element e(x.r[i], x.q[i], x.r[i + 1], x.q[i + 1], section.length);
    const Matrix36 turned = e.middle_turns();
    const Matrix612 strains = e.slopes();
    for (const Piece& piece : section.pieces) {
      // The way along the tendon per arc length, (r_b - r_a)/l + R_m (k x c + c'), with its derivatives.
      const Vector3d beside = cross(e.k, piece.eyelet) + piece.slope;
      const Matrix36 turns = times(Matrix3d(-e.middle() * cross_matrix(beside)), turned);
      const Eigen::Matrix<double, 3, 12> bends = times(Matrix3d(-e.middle() * cross_matrix(piece.eyelet)),
                                                       Eigen::Matrix<double, 3, 12>(strains.bottomRows<3>()));
      Eigen::Matrix<double, 3, 12> slopes_of_way = bends;
      for (int r = 0; r < 3; ++r) {
        slopes_of_way(r, r) -= 1 / section.length;
        slopes_of_way(r, r + 6) += 1 / section.length;
        for (int c = 0; c < 3; ++c) {
          slopes_of_way(r, c + 3) += turns(r, c);
          slopes_of_way(r, c + 9) += turns(r, c + 3);
        }
      }
      const Vector3d way = (x.r[i + 1] - x.r[i]) / section.length + e.middle() * beside;
      const double length = way.norm();
      const Vector3d direction = way / length;
      Run& run = runs[static_cast<size_t>(piece.index)];
      run.element = static_cast<Eigen::Index>(i);
      run.value = piece.value;
      run.part = piece.part;
      run.length = piece.part * section.length;
      run.direction.node = static_cast<int>(i);
      run.direction.value = direction;
      run.direction.slopes =
          times(Matrix3d((Matrix3d::Identity() - outer(direction, direction)) / length), slopes_of_way);
      run.force = run.length * (slopes_of_way.transpose() * direction);
    }
  }
  return runs;
}

Rod::Turning Rod::turning_of(const std::vector<Run>& runs, const MatrixXd& dx) const {
  Turning turning{VectorXd::Zero(pieces_), MatrixXd::Zero(dx.cols(), pieces_)};
  Eigen::Index before = -1;  // the piece from which the next one turns
  bool first = false;        // it is its tendon's first
  MatrixXd change_before;    // of its direction
  for (Eigen::Index i = 0; i < pieces_; ++i) {
    const Run& run = runs[static_cast<size_t>(i)];
    const bool begins = i == 0 || runs[static_cast<size_t>(i - 1)].value != run.value;
    if (begins) before = -1;
    // A tendon that ends a hair beyond a node has not turned there.
    if (!begins && (run.part < 0.01 || before < 0)) {
      turning.angle[i] = turning.angle[i - 1];
      turning.change.col(i) = turning.change.col(i - 1);
    }
    if (run.part < 0.01) continue;
    MatrixXd change = run.direction.change(dx);
    if (before >= 0) {
      const Run& last = runs[static_cast<size_t>(before)];
      const Vector3d &from = last.direction.value, &to = run.direction.value;
      const double cosine = from.dot(to), sine = cross(from, to).norm();
      const double angle = std::atan2(sine, cosine);
      VectorXd changes = VectorXd::Zero(dx.cols());
      // Where a path is straight the angle has a kink; its slopes are zero there.
      if (sine > 1e-12)
        changes =
            -(change.transpose() * (from - cosine * to) + change_before.transpose() * (to - cosine * from)) / sine;
      if (first) {  // as much turned before its middle
        const double share = last.length / (last.length + run.length);
        turning.angle[before] = share * angle;
        turning.change.col(before) = share * changes;
      }
      turning.angle[i] = turning.angle[before] + angle;
      turning.change.col(i) = turning.change.col(before) + changes;
    }
    first = before < 0;
    before = i;
    change_before = std::move(change);
  }
  return turning;
}

/// How the gradient changes where more is left of the tension of each piece, a row, than nothing.
MatrixXd Rod::pulled(const std::vector<Run>& runs, const Values& values, const MatrixXd& more) const {
  MatrixXd gradients = MatrixXd::Zero(unknowns() + 6, more.cols());
  for (Eigen::Index i = 0; i < pieces_; ++i) {
    const Run& run = runs[static_cast<size_t>(i)];
    gradients.middleRows<12>(6 * run.element) += values[run.value] * run.force * more.row(i);
  }
  return gradients.bottomRows(unknowns());
}

Rod::Feedback Rod::feedback_of(const RodState& x, const Values& values,
                               const std::function<MatrixXd(MatrixXd)>& by_hessian) const {
  Feedback feedback;
  feedback.runs = runs_of(x);
  for (Eigen::Index i = 0; i < pieces_; ++i) {
    if (values[feedback.runs[static_cast<size_t>(i)].value] != 0) feedback.pulling.push_back(i);
  }
  const Eigen::Index n = static_cast<Eigen::Index>(feedback.pulling.size());
  MatrixXd one = MatrixXd::Zero(pieces_, n);
  for (Eigen::Index i = 0; i < n; ++i) one(feedback.pulling[static_cast<size_t>(i)], i) = 1;
  feedback.by_left = by_hessian(pulled(feedback.runs, values, one));
  const Turning turning = turning_of(feedback.runs, feedback.by_left);
  feedback.by_angle = -values[friction()] * turning.left(values[friction()]);
  feedback.loop.compute(MatrixXd::Identity(n, n) + feedback.left_by(turning));
  return feedback;
}

Eigen::VectorXd Rod::tension_left(const RodState& x, double friction) const {
  return turning_of(runs_of(x), MatrixXd(unknowns(), 0)).left(friction);
}

/// Sections turn, and elements stretch and shear as the step says to first order: what they carry moves with them, and
/// no large turn stretches the rod.
RodState Rod::moved(const RodState& x, const Eigen::VectorXd& step, const Sums& at) const {
  RodState to = x;
  for (size_t i = 1; i < x.q.size(); ++i) {
    const Eigen::Index first = 6 * static_cast<Eigen::Index>(i - 1);
    to.q[i] = product(x.q[i], turn(step.segment<3>(first + 3))).normalized();
    Vector12 by = Vector12::Zero();
    if (i > 1) by.head<6>() = step.segment<6>(first - 6);
    by.tail<6>() = step.segment<6>(first);
    const Vector3d v = at.v[i - 1] + at.slopes[i - 1] * by;
    const Vector4d qb = to.q[i - 1].dot(to.q[i]) < 0 ? Vector4d(-to.q[i]) : to.q[i];
    to.r[i] = to.r[i - 1] + sections_[i - 1].length * (rotation_by((to.q[i - 1] + qb).normalized()) * v);
  }
  return to;
}

std::string Rod::solve(RodState& x, const Values& values, int& factorisations, int iterations) const {
  constexpr double negligible = 1e-12;  // of the rod's length; turns times an element's length
  const double size = shape_.length;
  Vector6 unit;
  const double mean = size / elements();
  unit << 1, 1, 1, mean, mean, mean;
  const auto length_of = [&](const Eigen::VectorXd& step) {
    double most = 0;
    for (Eigen::Index i = 0; i < step.size(); ++i) most = std::max(most, unit[i % 6] * std::abs(step[i]));
    return most;
  };
  double before = std::numeric_limits<double>::infinity();  // length of the last step
  for (int iteration = 0; iteration < iterations; ++iteration) {
    const Sums sum = assemble(x, values, curvatures);
    if (!std::isfinite(sum.energy)) return "the energy is not finite";
    std::optional<BlockFactors> factors;
    double shift = 0;
    const double softest = values[youngs] * sections_.back().of.area / mean;
    while (!factors) {
      ++factorisations;
      factors = BlockFactors::of(sum.hessian, shift, unit.cwiseAbs2());
      if (factors) break;
      shift = shift == 0 ? 1e-5 * softest : 8 * shift;
      if (!(shift < 1e6 * softest)) return "the energy is not finite";
    }
    const Eigen::VectorXd step = -factors->solve(sum.gradient);
    if (!step.allFinite()) return "the energy is not finite";
    const double length = length_of(step);
    // A thin rod is so much stiffer along itself than across that rounding keeps steps above what is negligible.
    const bool floor = shift == 0 && length < 1e-8 * size && length > 0.5 * before;
    if (length < negligible * size || floor) {
      x = moved(x, step, sum);
      return shift == 0 ? "" : "the equilibrium is not stable";
    }
    before = length;
    double largest_turn = 0;
    for (Eigen::Index i = 0; i + 6 <= step.size(); i += 6)
      largest_turn = std::max(largest_turn, step.segment<3>(i + 3).norm());
    double fraction = std::min(1.0, 1.5 / largest_turn);
    const double slope = sum.gradient.dot(step);
    RodState to;
    const auto accepted = [&] {
      to = moved(x, fraction * step, sum);
      const double reached = energy(to, values);
      // Below that energies differ by rounding.
      return std::isfinite(reached) &&
             (reached <= sum.energy + 1e-4 * fraction * slope || fraction * length < 1e-8 * size);
    };
    while (!accepted() && fraction > 1e-10) fraction *= 0.5;
    x = to;
  }
  return "Newton's method does not converge";
}

/// An equilibrium with the tensions that friction leaves there, from `x` on: these are taken from the state before, and
/// where that does not settle them quickly, by Newton's method for the tensions.
std::string Rod::settle(RodState& x, const Values& values, int& factorisations) const {
  std::string problem = solve(x, values, factorisations);
  if (values[friction()] == 0) return problem;
  double last = std::numeric_limits<double>::infinity();  // the last change
  for (int repetition = 0; problem.empty() && repetition < 50; ++repetition) {
    if (x.left.size() == 0) x.left = VectorXd::Ones(pieces_);
    VectorXd change = tension_left(x, values[friction()]) - x.left;
    const double most = change.lpNorm<Eigen::Infinity>();
    // What a thin rod's state is rounded to keeps it above what is negligible, see solve().
    if (most < 1e-12 || (most < 1e-8 && most > 0.5 * last)) return "";
    if (most > 0.2 * last) {
      ++factorisations;
      const std::optional<BlockFactors> factors =
          BlockFactors::of(assemble(x, values, curvatures).hessian, 0, Vector6::Zero());
      if (!factors) return "the equilibrium is not stable";
      const Feedback feedback = feedback_of(x, values, [&](MatrixXd b) { return factors->solve(std::move(b)); });
      change(feedback.pulling) = feedback.loop.solve(change(feedback.pulling).eval()).eval();
    }
    x.left = (x.left + change).cwiseMax(0).cwiseMin(1);
    last = most;
    problem = solve(x, values, factorisations);
  }
  return problem.empty() ? "the friction of its tendons does not settle" : problem;
}

std::string Rod::solve_from_rest(RodState& x, const Values& values, int& factorisations) const {
  const auto at = [&](double part) {
    Values some = values;
    some.segment(weight, friction() - weight) *= part;
    return some;
  };
  x = rest();
  double done = 0, step = 1;
  while (done < 1) {
    RodState next = x;
    const double until = std::min(1.0, done + step);
    const std::string problem = settle(next, at(until), factorisations);
    if (problem.empty()) {
      x = next;
      done = until;
      continue;
    }
    step = 0.5 * (until - done);
    if (step < 1.0 / 256) return problem;
  }
  return "";
}

RodReading Rod::position(const RodState& x, const RodPoint& point) const {
  const auto [element, f, length] = place_of(point.s);
  const auto [before, after] = arms_of(point);
  const size_t a = static_cast<size_t>(element);
  const Matrix3d Ra = rotation_by(x.q[a]), Rb = rotation_by(x.q[a + 1]);
  RodReading reading;
  reading.node = element;
  reading.value = (1 - f) * (x.r[a] + Ra * before) + f * (x.r[a + 1] + Rb * after);
  const Matrix3d A = times(Ra, cross_matrix(before)), B = times(Rb, cross_matrix(after));
  for (int c = 0; c < 3; ++c) {
    for (int r = 0; r < 3; ++r) {
      reading.slopes(r, c) = r == c ? 1 - f : 0;
      reading.slopes(r, c + 3) = -(1 - f) * A(r, c);
      reading.slopes(r, c + 6) = r == c ? f : 0;
      reading.slopes(r, c + 9) = -f * B(r, c);
    }
  }
  return reading;
}

Matrix3d Rod::end_rotation(const RodState& x) const {
  return rotation_by(x.q.back());
}

RodStrains Rod::strains(const RodState& x) const {
  RodStrains most;
  for (size_t i = 0; i < sections_.size(); ++i) {
    const Element e(x.r[i], x.q[i], x.r[i + 1], x.q[i + 1], sections_[i].length);
    const Section& section = sections_[i];
    const double bent = shape_.round ? section.outer * e.k.head<2>().norm()
                                     : section.half_second * std::abs(e.k[0]) + section.half_first * std::abs(e.k[1]);
    most.compression = std::max(most.compression, 1 - e.v[2] + bent);
    most.size = std::max({most.size, most.compression, e.v[2] - 1 + bent});
  }
  return most;
}

}  // namespace taut

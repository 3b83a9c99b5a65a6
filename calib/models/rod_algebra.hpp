#pragma once
#include <Eigen/Core>

/// Small fixed-size algebra of Cosserat rods, written out where Eigen's own would cost a compiler hundreds of
/// megabytes.
namespace taut::rod {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::Vector4d;
using Eigen::VectorXd;
using Vector6 = Eigen::Matrix<double, 6, 1>;     ///< by v and k, or by a node's translation and turn
using Matrix6 = Eigen::Matrix<double, 6, 6>;     ///< second derivatives by those
using Vector12 = Eigen::Matrix<double, 12, 1>;   ///< by the unknowns of an element's two nodes
using Matrix12 = Eigen::Matrix<double, 12, 12>;  ///< second derivatives by those
using Matrix36 = Eigen::Matrix<double, 3, 6>;    ///< a vector's derivatives by v and k, or by two turns
using Matrix312 = Eigen::Matrix<double, 3, 12>;  ///< a vector's derivatives by the unknowns of two nodes
using Matrix612 = Eigen::Matrix<double, 6, 12>;  ///< derivatives of v and k by the unknowns of two nodes

/// A B by loops: of Eigen's products of many sizes a compiler needs a gigabyte.
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
/// A^T M A, in the same way.
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

/// A of A b = a x b.
inline Matrix3d cross_matrix(const Vector3d& a) {
  Matrix3d A;
  A << 0, -a[2], a[1], a[2], 0, -a[0], -a[1], a[0], 0;
  return A;
}

/// a x b.
inline Vector3d cross(const Vector3d& a, const Vector3d& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

/// The product of quaternions (w, x, y, z).
inline Vector4d product(const Vector4d& a, const Vector4d& b) {
  return {a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3], a[0] * b[1] + b[0] * a[1] + a[2] * b[3] - a[3] * b[2],
          a[0] * b[2] + b[0] * a[2] + a[3] * b[1] - a[1] * b[3], a[0] * b[3] + b[0] * a[3] + a[1] * b[2] - a[2] * b[1]};
}

/// The rotation of a unit quaternion (w, x, y, z).
inline Matrix3d rotation_by(const Vector4d& q) {
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  Matrix3d R;
  R << 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z), 1 - 2 * (x * x + z * z),
      2 * (y * z - w * x), 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y);
  return R;
}

}  // namespace taut::rod

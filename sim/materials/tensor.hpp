#pragma once
#include <Eigen/Core>
#include <cmath>

namespace taut {

/// Second-order tensor, T its numbers.
template <class T, int D>
using Tensor = Eigen::Matrix<T, D, D>;
/// Fourth-order tensor as a matrix over vec(F), column-major: index of F_iJ is i + D * J.
template <class T, int D>
using Tangent = Eigen::Matrix<T, D * D, D * D>;

/// det(I + H) - 1 without the cancellation of subtracting 1.
template <class T, int D>
T jacobian_minus_one(const Eigen::Matrix<T, D, D>& H) {
  if constexpr (D == 2) {
    return H(0, 0) + H(1, 1) + (H(0, 0) * H(1, 1) - H(0, 1) * H(1, 0));
  } else {
    const T first = H(0, 0) + H(1, 1) + H(2, 2);
    const T second = (H(0, 0) * H(1, 1) - H(0, 1) * H(1, 0)) + (H(1, 1) * H(2, 2) - H(1, 2) * H(2, 1)) +
                     (H(0, 0) * H(2, 2) - H(0, 2) * H(2, 0));
    const T third = H(0, 0) * (H(1, 1) * H(2, 2) - H(1, 2) * H(2, 1)) -
                    H(0, 1) * (H(1, 0) * H(2, 2) - H(1, 2) * H(2, 0)) +
                    H(0, 2) * (H(1, 0) * H(2, 1) - H(1, 1) * H(2, 0));
    return first + second + third;
  }
}

/// Green's strain G = (H + H^T + H^T H) / 2.
template <class T, int D>
Eigen::Matrix<T, D, D> green_strain(const Eigen::Matrix<T, D, D>& H) {
  Eigen::Matrix<T, D, D> G = H.transpose() * H;
  for (int i = 0; i < D; ++i) {
    for (int j = 0; j < D; ++j) G(i, j) = 0.5 * (G(i, j) + (H(i, j) + H(j, i)));
  }
  return G;
}

/// F^-1 with F = I + H, by cofactors.
template <class T, int D>
Eigen::Matrix<T, D, D> inverse_of(const Eigen::Matrix<T, D, D>& H) {
  Eigen::Matrix<T, D, D> F = H;
  for (int i = 0; i < D; ++i) F(i, i) += 1.0;
  Eigen::Matrix<T, D, D> C;
  if constexpr (D == 2) {
    C << F(1, 1), -F(0, 1), -F(1, 0), F(0, 0);
  } else {
    C(0, 0) = F(1, 1) * F(2, 2) - F(1, 2) * F(2, 1);
    C(0, 1) = F(0, 2) * F(2, 1) - F(0, 1) * F(2, 2);
    C(0, 2) = F(0, 1) * F(1, 2) - F(0, 2) * F(1, 1);
    C(1, 0) = F(1, 2) * F(2, 0) - F(1, 0) * F(2, 2);
    C(1, 1) = F(0, 0) * F(2, 2) - F(0, 2) * F(2, 0);
    C(1, 2) = F(0, 2) * F(1, 0) - F(0, 0) * F(1, 2);
    C(2, 0) = F(1, 0) * F(2, 1) - F(1, 1) * F(2, 0);
    C(2, 1) = F(0, 1) * F(2, 0) - F(0, 0) * F(2, 1);
    C(2, 2) = F(0, 0) * F(1, 1) - F(0, 1) * F(1, 0);
  }
  const T J = 1.0 + jacobian_minus_one<T, D>(H);
  return C * (1.0 / J);
}

/// x - ln(1 + x), accurate for small x where both terms cancel.
template <class T>
T minus_log1p(const T& x) {
  using std::log1p;
  if (x < 1e-2 && x > -1e-2) {
    // Horner form of x^2/2 - x^3/3 + x^4/4 - ... ; nine terms leave less than 1e-18 of x^2.
    T sum(0.0);
    for (int n = 10; n >= 2; --n) sum = (n % 2 == 0 ? 1.0 : -1.0) / n + x * sum;
    return x * x * sum;
  }
  return x - log1p(x);
}

}  // namespace taut

#include "calib/models/block_factors.hpp"

#include <cmath>
#include <utility>

namespace taut::rod {
namespace {

/// L^-1 x and L^-T x in place.
void forward(const Matrix6& L, double* x) {
  for (int r = 0; r < 6; ++r) {
    for (int c = 0; c < r; ++c) x[r] -= L(r, c) * x[c];
    x[r] /= L(r, r);
  }
}
void backward(const Matrix6& L, double* x) {
  for (int r = 5; r >= 0; --r) {
    for (int c = r + 1; c < 6; ++c) x[r] -= L(c, r) * x[c];
    x[r] /= L(r, r);
  }
}

}  // namespace

std::optional<BlockFactors> BlockFactors::of(Blocks A, double shift, const Vector6& scale) {
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

MatrixXd BlockFactors::solve(MatrixXd b) const {
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

}  // namespace taut::rod

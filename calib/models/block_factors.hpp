#pragma once
#include <optional>
#include <vector>

#include "calib/models/rod_algebra.hpp"

namespace taut::rod {

/// A symmetric matrix of 6 x 6 blocks on and beside the diagonal.
struct Blocks {
  std::vector<Matrix6> on, beside;  ///< (i, i), (i, i + 1)
};

/// Cholesky's factors L_i and W_i = L_i^-1 beside_i; nothing where the matrix plus shift times `scale` is not positive
/// definite. Loops by hand: of Eigen's decompositions a compiler needs a gigabyte.
class BlockFactors {
 public:
  /// Of A plus `shift` times the diagonal blocks diag(scale).
  static std::optional<BlockFactors> of(Blocks A, double shift, const Vector6& scale);

  MatrixXd solve(MatrixXd b) const;  ///< A^-1 b, shape (6 n x k)

 private:
  explicit BlockFactors(Blocks factors) : factors_(std::move(factors)) {}

  Blocks factors_;
};

}  // namespace taut::rod

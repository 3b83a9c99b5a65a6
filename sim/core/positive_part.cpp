#include <Eigen/Eigenvalues>

#include "sim/core/dense.hpp"

namespace taut {

SmallMatrix positive_part(const SmallMatrix& A) {
  const Eigen::SelfAdjointEigenSolver<SmallMatrix> eigen(A);
  if (eigen.eigenvalues()[0] >= 0) return A;
  return eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(0.0).asDiagonal() * eigen.eigenvectors().transpose();
}

}  // namespace taut

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include "sim/core/dense.hpp"

namespace taut {

SymmetricModes symmetric_modes(const Eigen::MatrixXd& A) {
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(A);
  return {eigen.eigenvalues(), eigen.eigenvectors()};
}

std::optional<Eigen::MatrixXd> solve_positive_definite(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B) {
  const Eigen::LLT<Eigen::MatrixXd> factor(A);
  if (factor.info() != Eigen::Success) return std::nullopt;
  return factor.solve(B);
}

}  // namespace taut

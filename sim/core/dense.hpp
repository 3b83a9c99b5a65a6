#pragma once
#include <Eigen/Core>
#include <optional>

// Decompositions of dense matrices, compiled once: Eigen's templates of them cost seconds and hundreds of megabytes in
// every source that names them.
namespace taut {

/// Up to 12 x 12, never on the heap.
using SmallMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 12, 12>;

/// The nearest positive semi-definite matrix to a symmetric one, of which the lower triangle is read: its negative
/// eigenvalues become zero.
SmallMatrix positive_part(const SmallMatrix& A);

/// A = vectors diag(values) vectors^T of a symmetric matrix; values ascending, vectors orthonormal columns.
struct SymmetricModes {
  Eigen::VectorXd values;
  Eigen::MatrixXd vectors;
};
/// Of the matrix whose lower triangle is A's.
SymmetricModes symmetric_modes(const Eigen::MatrixXd& A);

/// A = U diag(s) V^T with orthonormal columns of U (m x k) and V (n x k), k = min(m, n), and s descending.
struct SingularValues {
  Eigen::MatrixXd U;
  Eigen::VectorXd s;
  Eigen::MatrixXd V;
};
/// By Jacobi's rotations, which keep small values accurate.
SingularValues singular_values(const Eigen::MatrixXd& A);

/// The x that makes |A x - b| smallest, by QR with column pivoting.
Eigen::VectorXd least_squares(const Eigen::MatrixXd& A, const Eigen::VectorXd& b);
/// The smallest of the x that make |A x - b| smallest, where A may not have full rank.
Eigen::VectorXd minimum_norm_solution(const Eigen::MatrixXd& A, const Eigen::VectorXd& b);
/// The x within `lower` and `upper` that makes |A x - b| smallest, by an active set (Stark and Parker 1995,
/// Computational Statistics 10, 129); of several one near zero. Bounds that are equal hold an entry.
Eigen::VectorXd bounded_least_squares(const Eigen::MatrixXd& A, const Eigen::VectorXd& b, const Eigen::VectorXd& lower,
                                      const Eigen::VectorXd& upper);
/// Rank of A: how many pivots of that QR are above `threshold` times the largest.
Eigen::Index rank_of(const Eigen::MatrixXd& A, double threshold);

/// A^-1 B by Cholesky's factorisation; nothing when A, of which the lower triangle is read, is not positive definite.
std::optional<Eigen::MatrixXd> solve_positive_definite(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B);

}  // namespace taut

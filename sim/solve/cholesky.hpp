#pragma once
#include <Eigen/Core>
#include <memory>
#include <vector>

#include "sim/model/model.hpp"

namespace taut {

/// Sparse Cholesky factorisation L L^T of the Hessian with CHOLMOD. The fill-reducing ordering and the symbolic
/// analysis are made once per pattern and reused by every factorisation. One object per thread.
class Cholesky {
 public:
  explicit Cholesky(const SparsePattern& pattern);  ///< analyses the pattern, once
  ~Cholesky();
  Cholesky(Cholesky&&) noexcept;             ///< takes over the factor
  Cholesky& operator=(Cholesky&&) noexcept;  ///< takes over the factor

  /// Factorises the matrix with these values (pattern.entries() of them) plus shift * I. False when it is not positive
  /// definite; the factor is then unusable until the next success.
  bool factorise(const std::vector<double>& values, double shift = 0);
  /// Solves with the last factor. Shape of b: (n) or (n x k).
  Eigen::MatrixXd solve(const Eigen::MatrixXd& b) const;
  /// What a factorisation costs, in solves. Its dense kernels do some 60 operations in the time in which a solve, which
  /// waits for memory, takes in one entry of the factor.
  double price() const;
  /// Number of factorisations tried so far: the unit in which solves are counted.
  int factorisations() const;

 private:
  struct Implementation;
  std::unique_ptr<Implementation> implementation_;
};

/// CHOLMOD's dense kernels on one thread: two cores are better spent on two states at a time. Returns false when the
/// BLAS in use cannot be told (the environment variable OPENBLAS_NUM_THREADS does it then).
bool use_one_blas_thread();

/// How many of `wanted` threads can call BLAS at the same time: all, unless `ulimit -v` bounds the address space.
/// OpenBLAS takes 128 MB of it for each such thread, keeps them, and tries without end where it cannot get them; so
/// what there is room for is taken here, in advance. 0: there is not even room for one. Not while another thread calls
/// BLAS.
int reserve_blas_buffers(int wanted);

}  // namespace taut

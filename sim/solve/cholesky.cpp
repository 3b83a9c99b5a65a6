#include "sim/solve/cholesky.hpp"

#include <cholmod.h>
#include <dlfcn.h>

#include <atomic>
#include <stdexcept>

namespace taut {
namespace {

std::atomic<bool> one_thread = false;

/// CHOLMOD asks OpenMP for four threads, whatever its environment variables say, and at our sizes they cost more than
/// they bring: half of the processor time of a factorisation. This forbids them; OpenMP keeps the setting per calling
/// thread.
void forbid_openmp_threads() {
  using Setter = void (*)(int);
  static const auto setter = reinterpret_cast<Setter>(dlsym(RTLD_DEFAULT, "omp_set_max_active_levels"));
  if (setter != nullptr) setter(0);
}

}  // namespace

struct Cholesky::Implementation {
  cholmod_common common;
  const SparsePattern* pattern;
  cholmod_factor* factor = nullptr;
  int factorisations = 0;

  explicit Implementation(const SparsePattern& pattern_) : pattern(&pattern_) {
    cholmod_start(&common);
    common.print = 0;
    common.supernodal = CHOLMOD_AUTO;
    common.final_ll = 1;  // L L^T in the simplicial case too, so that an indefinite matrix is always noticed
    common.quick_return_if_not_posdef = 1;
    cholmod_sparse A = view(nullptr);
    factor = cholmod_analyze(&A, &common);
    if (factor == nullptr) throw std::bad_alloc();
  }
  ~Implementation() {
    cholmod_free_factor(&factor, &common);
    cholmod_finish(&common);
  }
  Implementation(const Implementation&) = delete;
  Implementation& operator=(const Implementation&) = delete;

  cholmod_sparse view(const double* values) const {
    cholmod_sparse A{};
    A.nrow = A.ncol = static_cast<size_t>(pattern->size);
    A.nzmax = static_cast<size_t>(pattern->entries());
    A.p = const_cast<int*>(pattern->columns.data());
    A.i = const_cast<int*>(pattern->rows.data());
    A.x = const_cast<double*>(values);
    A.stype = -1;
    A.itype = CHOLMOD_INT;
    A.xtype = values == nullptr ? CHOLMOD_PATTERN : CHOLMOD_REAL;
    A.dtype = CHOLMOD_DOUBLE;
    A.sorted = 1;
    A.packed = 1;
    return A;
  }
};

Cholesky::Cholesky(const SparsePattern& pattern) : implementation_(std::make_unique<Implementation>(pattern)) {}
Cholesky::~Cholesky() = default;
Cholesky::Cholesky(Cholesky&&) noexcept = default;
Cholesky& Cholesky::operator=(Cholesky&&) noexcept = default;

bool Cholesky::factorise(const std::vector<double>& values, double shift) {
  Implementation& self = *implementation_;
  cholmod_sparse A = self.view(values.data());
  double beta[2] = {shift, 0};
  ++self.factorisations;
  self.common.status = CHOLMOD_OK;
  if (one_thread) forbid_openmp_threads();
  cholmod_factorize_p(&A, beta, nullptr, 0, self.factor, &self.common);
  if (self.common.status == CHOLMOD_OUT_OF_MEMORY) throw std::bad_alloc();
  return self.common.status == CHOLMOD_OK && self.factor->minor == self.factor->n;
}

Eigen::MatrixXd Cholesky::solve(const Eigen::MatrixXd& b) const {
  Implementation& self = *implementation_;
  cholmod_dense B{};
  B.nrow = B.d = static_cast<size_t>(b.rows());
  B.ncol = static_cast<size_t>(b.cols());
  B.nzmax = static_cast<size_t>(b.size());
  B.x = const_cast<double*>(b.data());
  B.xtype = CHOLMOD_REAL;
  B.dtype = CHOLMOD_DOUBLE;
  cholmod_dense* X = cholmod_solve(CHOLMOD_A, self.factor, &B, &self.common);
  if (X == nullptr) throw std::runtime_error("CHOLMOD could not solve");
  Eigen::MatrixXd x = Eigen::Map<const Eigen::MatrixXd>(static_cast<const double*>(X->x), b.rows(), b.cols());
  cholmod_free_dense(&X, &self.common);
  return x;
}

int Cholesky::factorisations() const {
  return implementation_->factorisations;
}

bool use_one_blas_thread() {
  one_thread = true;
  using Setter = void (*)(int);
  const auto setter = reinterpret_cast<Setter>(dlsym(RTLD_DEFAULT, "openblas_set_num_threads"));
  if (setter == nullptr) return false;
  setter(1);
  return true;
}

}  // namespace taut

#include "sim/solve/cholesky.hpp"

#include <cholmod.h>
#include <dlfcn.h>
#include <sys/mman.h>
#include <sys/resource.h>

#include <algorithm>
#include <atomic>
#include <numeric>
#include <stdexcept>
#include <utility>

namespace taut {
namespace {

std::atomic<bool> one_thread = false;

/// This thread is within CHOLMOD, which shall not use OpenMP's threads.
thread_local bool serial = false;

/// Makes this thread `serial` while it lives, where use_one_blas_thread() was asked for.
struct Serial {
  const bool before = std::exchange(serial, one_thread.load());
  Serial() = default;
  Serial(const Serial&) = delete;
  Serial& operator=(const Serial&) = delete;
  ~Serial() { serial = before; }
};

}  // namespace
}  // namespace taut

/// CHOLMOD opens a parallel region of four threads for each of thousands of small blocks, whatever its environment
/// variables say, and libgomp ends every region with a system call, even one of a single thread: more than half of a
/// factorisation's time at our sizes. This stands before libgomp's own function, which all other callers still get.
extern "C" __attribute__((visibility("default"))) void GOMP_parallel(void (*region)(void*), void* data,
                                                                     unsigned threads, unsigned flags) {
  if (taut::serial) return region(data);
  using Parallel = void (*)(void (*)(void*), void*, unsigned, unsigned);
  static const auto libgomp = reinterpret_cast<Parallel>(dlsym(RTLD_NEXT, "GOMP_parallel"));
  libgomp == nullptr ? region(data) : libgomp(region, data, threads, flags);
}

namespace taut {

/// CHOLMOD permutes and transposes its matrix in every factorisation. Here the matrix is put into the order of
/// elimination once, when its pattern comes, and CHOLMOD is told to keep that order.
struct Cholesky::Implementation {
  cholmod_common common;
  SparsePattern ordered;       ///< the pattern in the order of elimination
  std::vector<int> place;      ///< unknown to its place in that order
  std::vector<int> slot;       ///< entry of the given pattern to its place in `ordered`
  std::vector<double> values;  ///< of `ordered`
  cholmod_factor* factor = nullptr;
  cholmod_dense *solution = nullptr, *workspace[2] = {};  ///< kept from solve to solve
  int factorisations = 0;
  double price = 0;

  explicit Implementation(const SparsePattern& pattern) {
    cholmod_start(&common);
    common.print = 0;
    common.supernodal = CHOLMOD_AUTO;
    common.final_ll = 1;  // L L^T in the simplicial case too, so that an indefinite matrix is always noticed
    common.quick_return_if_not_posdef = 1;
    cholmod_sparse A = view(pattern, nullptr);
    factor = cholmod_analyze(&A, &common);
    if (factor == nullptr) throw std::bad_alloc();
    price = common.fl / std::max(1.0, 60 * common.lnz);
    order(pattern);
  }
  ~Implementation() {
    for (cholmod_dense** dense : {&solution, &workspace[0], &workspace[1]}) cholmod_free_dense(dense, &common);
    cholmod_free_factor(&factor, &common);
    cholmod_finish(&common);
  }
  Implementation(const Implementation&) = delete;
  Implementation& operator=(const Implementation&) = delete;

  struct Entry {
    int column, row, from;
  };
  /// Takes the analysis' order out of the factor and applies it to the pattern.
  void order(const SparsePattern& pattern) {
    place.resize(pattern.size);
    int* order = static_cast<int*>(factor->Perm);
    for (int k = 0; k < pattern.size; ++k) place[std::exchange(order[k], k)] = k;
    factor->ordering = CHOLMOD_NATURAL;

    // A counting sort by rows, then by columns.
    const auto sort_by = [&](auto&& key, const std::vector<Entry>& from) {
      std::vector<int> next(pattern.size + 1, 0);
      for (const Entry& entry : from) ++next[key(entry) + 1];
      std::partial_sum(next.begin(), next.end(), next.begin());
      std::vector<Entry> to(from.size());
      for (const Entry& entry : from) to[next[key(entry)]++] = entry;
      return to;
    };
    std::vector<Entry> entries;
    entries.reserve(pattern.rows.size());
    pattern.each([&](int k, int row, int column) {
      const int one = place[column], two = place[row];
      entries.push_back({std::min(one, two), std::max(one, two), k});
    });
    entries = sort_by([](const Entry& entry) { return entry.row; }, entries);
    entries = sort_by([](const Entry& entry) { return entry.column; }, entries);
    ordered.size = pattern.size;
    ordered.columns.assign(pattern.size + 1, 0);
    slot.resize(entries.size());
    for (const Entry& entry : entries) {
      slot[entry.from] = static_cast<int>(ordered.rows.size());
      ordered.rows.push_back(entry.row);
      ++ordered.columns[entry.column + 1];
    }
    std::partial_sum(ordered.columns.begin(), ordered.columns.end(), ordered.columns.begin());
    values.resize(entries.size());
  }

  static cholmod_sparse view(const SparsePattern& pattern, const double* values) {
    cholmod_sparse A{};
    A.nrow = A.ncol = static_cast<size_t>(pattern.size);
    A.nzmax = static_cast<size_t>(pattern.entries());
    A.p = const_cast<int*>(pattern.columns.data());
    A.i = const_cast<int*>(pattern.rows.data());
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
  for (size_t k = 0; k < self.slot.size(); ++k) self.values[self.slot[k]] = values[k];
  cholmod_sparse A = self.view(self.ordered, self.values.data());
  double beta[2] = {shift, 0};
  ++self.factorisations;
  self.common.status = CHOLMOD_OK;
  const Serial alone;
  cholmod_factorize_p(&A, beta, nullptr, 0, self.factor, &self.common);
  if (self.common.status == CHOLMOD_OUT_OF_MEMORY) throw std::bad_alloc();
  return self.common.status == CHOLMOD_OK && self.factor->minor == self.factor->n;
}

Eigen::MatrixXd Cholesky::solve(const Eigen::MatrixXd& b) const {
  Implementation& self = *implementation_;
  Eigen::MatrixXd x(b.rows(), b.cols());
  for (Eigen::Index i = 0; i < b.rows(); ++i) x.row(self.place[i]) = b.row(i);
  cholmod_dense B{};
  B.nrow = B.d = static_cast<size_t>(b.rows());
  B.ncol = static_cast<size_t>(b.cols());
  B.nzmax = static_cast<size_t>(b.size());
  B.x = x.data();
  B.xtype = CHOLMOD_REAL;
  B.dtype = CHOLMOD_DOUBLE;
  const Serial alone;
  if (cholmod_solve2(CHOLMOD_A, self.factor, &B, nullptr, &self.solution, nullptr, &self.workspace[0],
                     &self.workspace[1], &self.common) == 0) {
    if (self.common.status == CHOLMOD_OUT_OF_MEMORY) throw std::bad_alloc();
    throw std::runtime_error("CHOLMOD could not solve");
  }
  const Eigen::Map<const Eigen::MatrixXd> ordered(static_cast<const double*>(self.solution->x), b.rows(), b.cols());
  for (Eigen::Index i = 0; i < b.rows(); ++i) x.row(i) = ordered.row(self.place[i]);
  return x;
}

double Cholesky::price() const {
  return implementation_->price;
}

int Cholesky::factorisations() const {
  return implementation_->factorisations;
}

int reserve_blas_buffers(int wanted) {
  rlimit limit{};
  if (getrlimit(RLIMIT_AS, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY) return wanted;
  // OpenBLAS's own functions, not in its headers; another BLAS has none of them, and no such buffers.
  const auto take = reinterpret_cast<void* (*)(int)>(dlsym(RTLD_DEFAULT, "blas_memory_alloc"));
  const auto give = reinterpret_cast<void (*)(void*)>(dlsym(RTLD_DEFAULT, "blas_memory_free"));
  if (take == nullptr || give == nullptr) return wanted;
  constexpr size_t size = size_t{160} << 20;  // of a buffer, with room to spare
  static int known = 0;                       // buffers that it has
  std::vector<void*> taken;
  for (int i = 0; i < wanted; ++i) {
    if (i >= known) {
      void* room = mmap(nullptr, size, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
      if (room == MAP_FAILED) break;
      munmap(room, size);
    }
    taken.push_back(take(0));
  }
  for (void* buffer : taken) give(buffer);
  known = std::max(known, static_cast<int>(taken.size()));
  return static_cast<int>(taken.size());
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

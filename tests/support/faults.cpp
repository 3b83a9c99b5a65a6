#include <cholmod.h>
#include <dlfcn.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>

// A library to preload: it makes the n-th write to a file fail (a full disk), TAUT_FAIL_WRITE=n, or the n-th
// factorisation, TAUT_FAIL_SOLVE=n (of a matrix that is not positive definite; with TAUT_FAIL_MEMORY=1 for lack of
// memory). TAUT_FAULT_COUNTS names a file that gets how many of both there were. The command knows nothing of it.
namespace {

std::atomic<int> writes{0}, solves{0};

int wanted(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? -1 : std::atoi(value);
}

template <class Function>
Function next(const char* name) {
  return reinterpret_cast<Function>(dlsym(RTLD_NEXT, name));
}

bool is_file(int handle) {
  struct stat state {};
  return fstat(handle, &state) == 0 && S_ISREG(state.st_mode) && handle > 2;
}

/// What the command starts, such as gnuplot, has this library too.
bool in_taut() {
  static const bool is = std::strcmp(program_invocation_short_name, "taut") == 0;
  return is;
}

/// Whether this is the write to fail.
bool fails_now() {
  if (!in_taut()) return false;
  static const int which = wanted("TAUT_FAIL_WRITE");
  if (++writes != which) return false;
  errno = ENOSPC;
  return true;
}

struct Counts {
  ~Counts() {
    const char* path = std::getenv("TAUT_FAULT_COUNTS");
    if (path == nullptr || !in_taut()) return;
    if (std::FILE* file = std::fopen(path, "w")) {
      std::fprintf(file, "%d %d\n", writes.load(), solves.load());
      std::fclose(file);
    }
  }
} counts;

}  // namespace

extern "C" {

__attribute__((visibility("default"))) ssize_t write(int handle, const void* bytes, size_t size) {
  static const auto real = next<ssize_t (*)(int, const void*, size_t)>("write");
  if (is_file(handle) && fails_now()) return -1;
  return real(handle, bytes, size);
}

__attribute__((visibility("default"))) int fsync(int handle) {
  static const auto real = next<int (*)(int)>("fsync");
  return fails_now() ? -1 : real(handle);
}

__attribute__((visibility("default"))) int rename(const char* from, const char* to) {
  static const auto real = next<int (*)(const char*, const char*)>("rename");
  return fails_now() ? -1 : real(from, to);
}

__attribute__((visibility("default"))) int cholmod_factorize_p(cholmod_sparse* matrix, double* beta, int* set,
                                                               size_t size, cholmod_factor* factor,
                                                               cholmod_common* common) {
  static const auto real =
      next<int (*)(cholmod_sparse*, double*, int*, size_t, cholmod_factor*, cholmod_common*)>("cholmod_factorize_p");
  static const int which = wanted("TAUT_FAIL_SOLVE");
  static const bool memory = wanted("TAUT_FAIL_MEMORY") == 1;
  if (++solves != which) return real(matrix, beta, set, size, factor, common);
  common->status = memory ? CHOLMOD_OUT_OF_MEMORY : CHOLMOD_NOT_POSDEF;
  factor->minor = 0;
  return memory ? 0 : 1;
}
}

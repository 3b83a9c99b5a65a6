#include <sys/resource.h>
#include <unistd.h>

#include <cstddef>
#include <cstring>

// OpenBLAS starts a thread per core before main(), and each tries without end to get 128 MB of address space. Under
// `ulimit -v` that may never come: then the program starts again, telling OpenBLAS to start none. Sanitizers reserve
// more address space than such a limit leaves, and are not ready yet where this runs.
#if defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define TAUT_INSTRUMENTED
#endif
#endif
#if !defined(TAUT_INSTRUMENTED) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
namespace {

/// Before the libraries' own initialisation: nothing here may need any of it.
void start_without_blas_threads(int, char** argv, char** environment) {
  rlimit limit{};
  if (getrlimit(RLIMIT_AS, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY) return;
  static char one_thread[] = "OPENBLAS_NUM_THREADS=1";
  static char* wanted[4096];
  size_t count = 0;
  for (char** variable = environment; *variable != nullptr; ++variable) {
    if (std::strcmp(*variable, one_thread) == 0) return;  // it did start again, or was asked for that
    if (std::strncmp(*variable, one_thread, std::strlen("OPENBLAS_NUM_THREADS=")) == 0) continue;
    if (count + 2 >= sizeof wanted / sizeof *wanted) return;
    wanted[count++] = *variable;
  }
  wanted[count] = one_thread;
  execve("/proc/self/exe", argv, wanted);  // comes back where there is no /proc: all goes on as without this
}

__attribute__((section(".preinit_array"), used)) void (*const before_all)(int, char**,
                                                                          char**) = start_without_blas_threads;

}  // namespace
#endif

#pragma once
#include <algorithm>
#include <atomic>
#include <exception>
#include <functional>
#include <thread>
#include <vector>

#include "sim/solve/cholesky.hpp"

namespace taut {

/// Calls work(0), ..., work(count - 1), each once, the first ones first, on this many threads (0: as many as there are
/// cores). Throws what one of the calls threw, after all threads have ended.
template <class Work>
void in_parallel(size_t count, int threads, Work&& work) {
  const size_t cores = threads > 0 ? static_cast<size_t>(threads) : std::thread::hardware_concurrency();
  const size_t wanted = std::clamp<size_t>(cores, 1, std::max<size_t>(1, count));
  std::vector<std::exception_ptr> errors(std::max<size_t>(1, reserve_blas_buffers(static_cast<int>(wanted))));
  std::atomic<size_t> next{0};
  const auto run = [&](std::exception_ptr& error) {
    try {
      for (size_t i = next++; i < count; i = next++) work(i);
    } catch (...) {
      error = std::current_exception();
    }
  };
  std::vector<std::thread> others;
  try {
    for (size_t i = 1; i < errors.size(); ++i) others.emplace_back(run, std::ref(errors[i]));
  } catch (const std::exception&) {
    // No memory for another thread: those that there are do all of it.
  }
  run(errors[0]);
  for (std::thread& thread : others) thread.join();
  for (const std::exception_ptr& error : errors) {
    if (error) std::rethrow_exception(error);
  }
}

}  // namespace taut

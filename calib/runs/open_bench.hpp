#pragma once
#include <atomic>
#include <memory>
#include <string>

#include "calib/benches/bench.hpp"
#include "calib/files/experiment.hpp"

namespace taut {

/// How a bench computes.
struct BenchOptions {
  int threads = 0;                          ///< states solved at the same time; 0: as the file says
  const std::atomic<bool>* stop = nullptr;  ///< ends solves early
};

/// Reads an experiment file of any kind, its readings, and makes its model; with model = "beam" or "auto" cheaper ones
/// predict. Throws InputError.
std::unique_ptr<Bench> open_bench(const std::string& path, const BenchOptions& options = {});
/// The same of an experiment that was read (and perhaps changed).
std::unique_ptr<Bench> open_bench(Experiment experiment, const BenchOptions& options = {});

}  // namespace taut

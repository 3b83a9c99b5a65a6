#pragma once
#include <atomic>
#include <memory>
#include <optional>
#include <string>

#include "calib/benches/bench.hpp"
#include "calib/files/experiment.hpp"

namespace taut {

/// Whether a bench without any reading, a plan, will do: its readings are NaN then.
enum class Readings {
  needed,
  may_be_blank,        ///< all cells of readings may be empty
  rows_may_be_missing  ///< the bench file may even be a header alone
};

/// How a bench computes, and what it may lack.
struct BenchOptions {
  int threads = 0;                          ///< states solved at the same time; 0: as the file says
  const std::atomic<bool>* stop = nullptr;  ///< ends solves early
  Readings readings = Readings::needed;
  std::string rows = {};  ///< CSV file with the columns of controls, taken as a plan instead of the bench's own file
};

/// Reads an experiment file of any kind, its readings, and makes its model; with model = "beam" or "auto" cheaper ones
/// predict. Throws InputError.
std::unique_ptr<Bench> open_bench(const std::string& path, const BenchOptions& options = {});
/// The same of an experiment that was read (and perhaps changed).
std::unique_ptr<Bench> open_bench(Experiment experiment, const BenchOptions& options = {});

/// How many rows a bench has of which nothing is measured yet; nullopt: it has readings.
std::optional<int> planned_rows(const Bench& bench);

}  // namespace taut

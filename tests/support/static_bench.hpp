#pragma once
#include "calib/benches/static_replay.hpp"
#include "calib/files/experiment.hpp"
#include "tests/support/experiment_files.hpp"

// Benches at rest from files.
namespace taut::test {

/// Writes an experiment with its readings into `folder` and reads it.
inline Experiment experiment_in(const TemporaryFolder& folder, const std::string& toml, const std::string& csv) {
  folder.write("bench.csv", csv);
  return read_experiment(folder.write("experiment.toml", toml));
}

inline StaticReplay bench_of(const Experiment& experiment) {
  return make_static_replay(experiment, experiment.mesh, read_trials(experiment.bench));
}

/// What it predicts with its own parameters.
inline Prediction predicted(const StaticReplay& bench) {
  const Prediction prediction = bench.protocol->predict(bench.protocol->nominal(), {});
  for (const std::string& failure : prediction.failures) ADD_FAILURE() << failure;
  return prediction;
}

}  // namespace taut::test

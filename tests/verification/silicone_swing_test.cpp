#include <gtest/gtest.h>

#include <algorithm>
#include <map>

#include "calib/benches/recordings.hpp"
#include "calib/data/ring_down.hpp"
#include "calib/files/experiment.hpp"

namespace taut {
namespace {

/// Frequency and decay of the readings, and of what a protocol predicts for them, per recording.
struct Swing {
  std::string case_id;
  RingDown measured, simulated;
};

std::vector<Swing> swings(const Experiment& experiment, const std::vector<Sample>& samples,
                          const Eigen::VectorXd& predicted) {
  std::vector<Swing> result;
  for (size_t r = 0; r < recordings_of(experiment).recordings.size(); ++r) {
    std::vector<double> times, measured, simulated;
    for (size_t i = 0; i < samples.size(); ++i) {
      if (samples[i].recording != static_cast<int>(r)) continue;
      times.push_back(samples[i].time);
      measured.push_back(samples[i].value);
      simulated.push_back(predicted[static_cast<Eigen::Index>(i)]);
    }
    result.push_back(
        {recordings_of(experiment).recordings[r].case_id, ring_down(times, measured), ring_down(times, simulated)});
  }
  return result;
}

/// The experiment with fewer cells and longer steps than in its file, for the time of a test.
struct QuickSwing {
  Experiment experiment = read_experiment(std::string(TAUT_SOURCE_DIR) + "/experiments/silicone_swing/experiment.toml");
  std::vector<Sample> samples;
  RecordingReplay bench;
  Params p;

  QuickSwing() {
    experiment.mesh.cells = {6, 2};
    recordings_of(experiment).step = 3e-3;
    samples = read_samples(experiment);
    bench = make_recording_replay(experiment, experiment.mesh, samples);
    p = bench.protocol->nominal();
    // What the fit of the file finds.
    for (const auto& [id, value] : std::map<std::string, double>{{"E_silicone", 301.2e3},
                                                                 {"stiffness_damping_silicone_gravity", 2.276e-3},
                                                                 {"stiffness_damping_silicone_load52", 4.157e-3},
                                                                 {"stiffness_damping_silicone_load101", 6.645e-3},
                                                                 {"hand_gravity_a", 0.2593},
                                                                 {"hand_gravity_b", 0.2799},
                                                                 {"hand_load52_a", 0.4989},
                                                                 {"hand_load52_b", 0.6081},
                                                                 {"hand_load101_a", 0.9875},
                                                                 {"hand_load101_b", 0.7972},
                                                                 {"release_gravity_a", 0.05135},
                                                                 {"release_gravity_b", 0.04888},
                                                                 {"release_load52_a", 0.1067},
                                                                 {"release_load52_b", 0.1069},
                                                                 {"release_load101_a", 0.1325},
                                                                 {"release_load101_b", 0.1405}})
      p[bench.protocol->parameters().index(id)] = value;
  }
};

TEST(SlowSiliconeSwing, FrequenciesAreWithinThreePerCentAndDecaysBetweenThoseOfTheRepeats) {
  QuickSwing quick;
  const Prediction prediction = quick.bench.protocol->predict(quick.p, {});
  ASSERT_TRUE(prediction.complete()) << prediction.failures.front();
  const std::vector<Swing> all = swings(quick.experiment, quick.samples, prediction.values);
  ASSERT_EQ(all.size(), 6u);
  for (const Swing& swing : all) {
    EXPECT_NEAR(swing.simulated.frequency / swing.measured.frequency, 1, 0.03) << swing.case_id;
    double lowest = swing.measured.decay, highest = lowest;
    for (const Swing& other : all) {
      if (other.case_id != swing.case_id) continue;
      lowest = std::min(lowest, other.measured.decay);
      highest = std::max(highest, other.measured.decay);
    }
    // Coarser here than in the file: half a per cent beyond the repeats is left to that.
    EXPECT_GT(swing.simulated.decay, 0.995 * lowest) << swing.case_id;
    EXPECT_LT(swing.simulated.decay, 1.005 * highest) << swing.case_id;
  }
}

TEST(SlowSiliconeSwing, AHungLoadMovesAsAMassNotAsAForceAlone) {
  // With its weight but without its inertia, the block swings about as fast as without load.
  QuickSwing quick;
  for (LoadSettings& load : quick.experiment.loads) load.quantity = Quantity::force;
  for (RecordingSettings& recording : recordings_of(quick.experiment).recordings) {
    for (auto& [id, value] : recording.loads) value *= quick.experiment.gravity;
  }
  quick.bench = make_recording_replay(quick.experiment, quick.experiment.mesh, quick.samples);
  const Prediction prediction = quick.bench.protocol->predict(quick.p, {});
  ASSERT_TRUE(prediction.complete()) << prediction.failures.front();
  for (const Swing& swing : swings(quick.experiment, quick.samples, prediction.values)) {
    const double ratio = swing.simulated.frequency / swing.measured.frequency;
    if (swing.case_id == "gravity")
      EXPECT_NEAR(ratio, 1, 0.03);
    else
      EXPECT_GT(ratio, 1.6) << swing.case_id;
  }
}

}  // namespace
}  // namespace taut

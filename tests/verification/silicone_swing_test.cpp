#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
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

/// The mean time from one turning point of the readings to the next, by parabolas through three of them, in Hz.
double turning_frequency(const std::vector<Sample>& samples, int recording) {
  std::vector<Sample> own;
  for (const Sample& sample : samples)
    if (sample.recording == recording) own.push_back(sample);
  std::vector<double> turns;
  for (size_t i = 2; i + 1 < own.size(); ++i) {
    const double before = own[i - 1].value - own[i].value, after = own[i + 1].value - own[i].value;
    const bool turn = before * after > 0 || (after == 0 && before != 0);  // a flat one once, halfway
    if (!turn) continue;
    turns.push_back(own[i].time + 0.5 * (before - after) / (before + after) * (own[i + 1].time - own[i].time));
  }
  return 0.5 * static_cast<double>(turns.size() - 1) / (turns.back() - turns.front());
}

/// The first natural frequency of the block as a cantilever with a mass at its end [Hz]: Dunkerley's sum of bending
/// (Euler and Bernoulli), shear, and the mass on Timoshenko's static compliance.
double cantilever_frequency(double E, double mass) {
  const double length = 0.1, side = 0.03, density = 1070, G = E / (2 * (1 + 0.499)), shear_factor = 5.0 / 6;
  const double area = side * side, EI = E * std::pow(side, 4) / 12;
  const double bending = std::pow(1.8751 / length, 2) * std::sqrt(EI / (density * area));
  const double shear = M_PI / (2 * length) * std::sqrt(shear_factor * G / density);
  const double compliance = std::pow(length, 3) / (3 * EI) + length / (shear_factor * G * area);
  return 1 / (2 * M_PI * std::sqrt(1 / (bending * bending) + 1 / (shear * shear) + mass * compliance));
}

TEST(SlowSiliconeSwing, TheFittedModulusIsThatOfACantileverWithTheFrequencyOfTheRecordings) {
  const QuickSwing quick;
  const double E = quick.p[quick.bench.protocol->parameters().index("E_silicone")];
  const std::map<std::string, double> masses{{"load52", 52.016e-3}, {"load101", 102.031e-3}};
  const std::vector<RecordingSettings>& recordings = recordings_of(quick.experiment).recordings;
  const Prediction prediction = quick.bench.protocol->predict(quick.p, {});
  ASSERT_TRUE(prediction.complete()) << prediction.failures.front();
  const std::vector<Swing> all = swings(quick.experiment, quick.samples, prediction.values);
  int compared = 0;
  for (size_t r = 0; r < recordings.size(); ++r) {
    const auto mass = masses.find(recordings[r].case_id);
    if (mass == masses.end()) continue;  // without one the sum is 1.5 % low
    const double ratio = turning_frequency(quick.samples, static_cast<int>(r)) / cantilever_frequency(E, mass->second);
    const double simulated = all[r].simulated.frequency / cantilever_frequency(E, mass->second);
    std::printf("%s: measured %.4f, simulated %.4f of the cantilever's frequency\n", recordings[r].id.c_str(), ratio,
                simulated);
    // The simulated swing is 1.5 to 2 % slower than the small linear one. That was seen, not derived: this bar holds
    // the simulation where it is; the next one compares the modulus with what taut did not compute.
    EXPECT_NEAR(simulated, 0.9825, 0.01) << recordings[r].id;
    EXPECT_NEAR(ratio, 1, 0.012) << recordings[r].case_id << ": a modulus 3 % off shows as 1.5 %";
    ++compared;
  }
  EXPECT_EQ(compared, 4);
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

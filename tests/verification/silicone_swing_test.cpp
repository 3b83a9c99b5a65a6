#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <set>

#include "calib/benches/recordings.hpp"
#include "calib/data/ring_down.hpp"
#include "calib/files/experiment.hpp"

// The whole fit of this bench is in tests/golden; here are a small one and answers that do not come from taut.
namespace taut {
namespace {

/// Some of the recordings, with fewer cells and longer steps than in the file, for the time of a test.
struct QuickSwing {
  Experiment experiment = read_experiment(std::string(TAUT_SOURCE_DIR) + "/experiments/silicone_swing/experiment.toml");
  std::vector<Sample> samples;
  RecordingReplay bench;

  explicit QuickSwing(const std::set<std::string>& recordings) {
    std::erase_if(recordings_of(experiment).recordings,
                  [&](const RecordingSettings& recording) { return !recordings.contains(recording.id); });
    experiment.mesh.cells = {6, 2};
    recordings_of(experiment).step = 3e-3;
    prepare();
    std::erase_if(experiment.free,
                  [&](const FreeSettings& free) { return !bench.protocol->parameters().contains(free.id); });
  }
  void prepare() {
    samples = read_samples(experiment);
    bench = make_recording_replay(experiment, experiment.mesh, samples);
  }
  /// The samples of one recording.
  std::vector<Sample> of(int recording) const {
    std::vector<Sample> own;
    std::ranges::copy_if(samples, std::back_inserter(own),
                         [&](const Sample& sample) { return sample.recording == recording; });
    return own;
  }
};

/// What the turning points of a recording say, found by parabolas through three samples each.
struct Turns {
  double frequency = 0;  ///< [Hz], of the mean time from one to the next
  double decay = 0;      ///< [1/s], of the way from the first to the second against that of the last two
};

Turns turns_of(const std::vector<Sample>& samples) {
  std::vector<double> times, heights;
  for (size_t i = 2; i + 1 < samples.size(); ++i) {
    const double before = samples[i - 1].value - samples[i].value, after = samples[i + 1].value - samples[i].value;
    const bool turn = before * after > 0 || (after == 0 && before != 0);  // a flat one once, halfway
    if (!turn) continue;
    const double way = 0.5 * (before - after) / (before + after);
    times.push_back(samples[i].time + way * (samples[i + 1].time - samples[i].time));
    heights.push_back(samples[i].value - 0.25 * way * (before - after));
  }
  const size_t n = times.size();
  const double first = std::abs(heights[1] - heights[0]), last = std::abs(heights[n - 1] - heights[n - 2]);
  return {0.5 * static_cast<double>(n - 1) / (times.back() - times.front()),
          std::log(first / last) / (times[n - 2] - times[0])};
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

TEST(SlowSiliconeSwing, AFitFindsTheModulusOfACantileverAndTheDampingThatTheTurningPointsShow) {
  QuickSwing quick({"load52_a", "load101_a"});  // without a mass Dunkerley's sum is 1.5 % low
  FitOptions options;
  options.profiles = false;
  const FitResult found = fit(*quick.bench.protocol, quick.bench.measurements,
                              free_parameters(quick.experiment, *quick.bench.protocol), options);
  ASSERT_EQ(found.status, FitStatus::converged) << found.message;
  ASSERT_EQ(found.parameters.size(), 7u) << "modulus; damping, hand and release of each";
  const auto value = [&](const std::string& id) { return found.p[quick.bench.protocol->parameters().index(id)]; };
  const std::map<std::string, double> masses{{"load52", 52.016e-3}, {"load101", 102.031e-3}};
  const std::vector<RecordingSettings>& recordings = recordings_of(quick.experiment).recordings;
  double mean = 0;
  for (size_t r = 0; r < recordings.size(); ++r) {
    const std::string& load = recordings[r].case_id;
    const Turns seen = turns_of(quick.of(static_cast<int>(r)));
    const double expected = cantilever_frequency(value("E_silicone"), masses.at(load));
    const double damping = 2 * seen.decay / std::pow(2 * M_PI * seen.frequency, 2);
    std::printf(
        "%s: E %.5g, measured %.4f of the cantilever's frequency; damping %.4g s, of the decay %.4g s (%.3g /s)\n",
        load.c_str(), value("E_silicone"), seen.frequency / expected, value("stiffness_damping_silicone_" + load),
        damping, seen.decay);
    mean += seen.frequency / expected / static_cast<double>(recordings.size());
    EXPECT_NEAR(seen.frequency / expected, 1, 0.02) << load;
    EXPECT_NEAR(value("stiffness_damping_silicone_" + load) / damping, 1, 0.1) << load;
  }
  EXPECT_NEAR(mean, 1, 0.012) << "one modulus serves both; 3 % off shows as 1.5 %";
}

TEST(SlowSiliconeSwing, AHungLoadMovesAsAMassNotAsAForceAlone) {
  // With its weight but without its inertia, the block swings about as fast as without load.
  QuickSwing quick({"gravity_a", "load52_a", "load101_a"});
  const auto ratios = [&] {
    const Prediction prediction = quick.bench.protocol->predict(quick.bench.protocol->nominal(), {});
    EXPECT_TRUE(prediction.complete()) << prediction.failures.front();
    std::vector<double> times, measured, simulated, result;
    for (size_t i = 0; i < quick.samples.size(); ++i) {
      times.push_back(quick.samples[i].time);
      measured.push_back(quick.samples[i].value);
      simulated.push_back(prediction.values[static_cast<Eigen::Index>(i)]);
      if (i + 1 < quick.samples.size() && quick.samples[i + 1].recording == quick.samples[i].recording) continue;
      result.push_back(ring_down(times, simulated).frequency / ring_down(times, measured).frequency);
      times.clear(), measured.clear(), simulated.clear();
    }
    return result;
  };
  const std::vector<double> masses = ratios();
  for (LoadSettings& load : quick.experiment.loads) load.quantity = Quantity::force;
  for (RecordingSettings& recording : recordings_of(quick.experiment).recordings) {
    for (auto& [id, value] : recording.loads) value *= quick.experiment.gravity;
  }
  quick.prepare();
  const std::vector<double> forces = ratios();
  ASSERT_EQ(masses.size(), 3u);
  for (size_t r = 0; r < 3; ++r) EXPECT_NEAR(masses[r], 1, 0.03) << "recording " << r;
  EXPECT_NEAR(forces[0], masses[0], 1e-12) << "nothing hangs there";
  EXPECT_GT(forces[1], 1.6);
  EXPECT_GT(forces[2], 1.6);
}

TEST(SlowSiliconeSwing, OneModulusAndOnePairServeTheSwingAndTheRest) {
  // The values of experiments/silicone_swing/README.md against the measured motion and rest positions.
  Experiment experiment = read_experiment(std::string(TAUT_SOURCE_DIR) + "/experiments/silicone_swing/memory.toml");
  const std::vector<Sample> samples = read_samples(experiment);
  const RecordingReplay bench = make_recording_replay(experiment, experiment.mesh, samples);
  const std::map<std::string, double> found{{"E_silicone", 311.27e3},
                                            {"g_silicone", 0.07324},
                                            {"tau_silicone", 0.4191},
                                            {"hand_gravity_a", 0.26172},
                                            {"hand_gravity_b", 0.28264},
                                            {"hand_load52_a", 0.51213},
                                            {"hand_load52_b", 0.61999},
                                            {"hand_load101_a", 0.99221},
                                            {"hand_load101_b", 0.79722},
                                            {"release_gravity_a", 0.054939},
                                            {"release_gravity_b", 0.052392},
                                            {"release_load52_a", 0.112608},
                                            {"release_load52_b", 0.112899},
                                            {"release_load101_a", 0.139249},
                                            {"release_load101_b", 0.147259},
                                            {"stiffness_damping_silicone_gravity", 2.0876e-3},
                                            {"stiffness_damping_silicone_load52", 3.7503e-3},
                                            {"stiffness_damping_silicone_load101", 5.7677e-3}};
  Params p = bench.protocol->nominal();
  for (const auto& [id, value] : found) p[bench.protocol->parameters().index(id)] = value;
  const Prediction prediction = bench.protocol->predict(p, {});
  ASSERT_TRUE(prediction.complete());
  double chi_squared = 0, worst_at_rest = 0;
  for (size_t i = 0; i < samples.size(); ++i) {
    const double off = (samples[i].value - prediction.values[static_cast<Eigen::Index>(i)]) / samples[i].sigma;
    chi_squared += off * off;
    if (samples[i].still) worst_at_rest = std::max(worst_at_rest, std::abs(off));
  }
  EXPECT_LT(chi_squared, 229) << "as many as degrees of freedom";
  EXPECT_LT(worst_at_rest, 2.1);
  // The same modulus, that does not relax: neither the motion nor the rest.
  p[bench.protocol->parameters().index("g_silicone")] = 0;
  const Prediction elastic = bench.protocol->predict(p, {});
  double without = 0;
  for (size_t i = 0; i < samples.size(); ++i)
    without += std::pow((samples[i].value - elastic.values[static_cast<Eigen::Index>(i)]) / samples[i].sigma, 2);
  EXPECT_GT(without, 5 * chi_squared);
}

}  // namespace
}  // namespace taut

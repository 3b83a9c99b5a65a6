#include "calib/benches/recordings_bench.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "calib/files/experiment.hpp"
#include "tests/support/hung_mass.hpp"

// Motions over time as a bench: their curves, what they ring like, and what is said of them.
namespace taut {
namespace {

using namespace test;

RecordingsBench ringing_bench(const TemporaryFolder& folder, const std::string& toml, const std::string& csv) {
  folder.write("ring.csv", csv);
  return RecordingsBench(read_experiment(folder.write("experiment.toml", toml)));
}

Prediction asked(Protocol& protocol, const Params& p, const std::vector<int>& free) {
  return protocol.predict(p, free);
}

TEST(RecordingsBench, CurvesAreTheMotionFromTheFirstToTheLastSample) {
  const TemporaryFolder folder;
  const RecordingsBench bench = ringing_bench(folder, hung_mass_toml, hung_mass_csv(61));
  const std::vector<CurveRecord> curves = bench.curves(bench.protocol().nominal(), {}, {}, asked);
  ASSERT_EQ(curves.size(), 2u) << "one of each channel";
  EXPECT_EQ(curves[0].channel, "end");
  EXPECT_EQ(curves[1].channel, "side");
  for (const CurveRecord& curve : curves) {
    EXPECT_EQ(curve.series, "ring");
    ASSERT_EQ(curve.load.size(), 241u);
    ASSERT_EQ(curve.value.size(), 241u);
    EXPECT_EQ(curve.load.front(), 0);
    EXPECT_NEAR(curve.load.back(), 3e-3, 1e-15);
    EXPECT_EQ(curve.se.size(), 241u);
  }
  for (size_t k = 0; k < 241; ++k) {
    EXPECT_NEAR(curves[0].value[k], hung_mass_at(curves[0].load[k]), 0.01 * hung_F / hung_k)
        << "at " << curves[0].load[k];
    EXPECT_NEAR(curves[1].value[k], 0, 1e-9 * hung_F / hung_k);
  }
}

TEST(RecordingsBench, SwingsAreTheFrequenciesAndDecaysOfReadingsAndPredictions) {
  const TemporaryFolder folder;
  std::string csv = "time_ms,end_um,side_um\n";
  const auto ring = [](double t, double frequency, double decay) {
    return std::exp(-decay * t) * std::cos(2 * M_PI * frequency * t);
  };
  for (int i = 0; i < 60; ++i)
    csv += std::to_string(5 * i) + "," + std::to_string(3 + 1e3 * ring(5e-3 * i, 7, 4)) + "," +
           std::to_string(1e3 * ring(5e-3 * i, 11, 2)) + "\n";
  const std::string recording =
      "\n[[bench.recording]]\nfile = \"ring.csv\"\ncase = \"short\"\nuntil = \"30 ms\"\n"
      "\n[[bench.recording]]\nfile = \"ring.csv\"\ncase = \"rest\"\nfrom = \"100 ms\"\n"
      "rest = { after = \"2 s\", sigma = \"1 um\", end = \"3 um\" }\n";
  const RecordingsBench bench = ringing_bench(folder, hung_mass_toml + recording, csv);
  const size_t samples = bench.readings().size();
  ASSERT_EQ(samples, 2 * 60u + 2 * 7u + 2 * 40u + 1u);
  Eigen::VectorXd predicted(static_cast<Eigen::Index>(samples));
  for (Eigen::Index i = 0; i < predicted.size(); ++i) {
    const BenchReading& reading = bench.readings()[static_cast<size_t>(i)];
    predicted[i] = 2e-3 * ring(reading.controls[0], reading.channel == 0 ? 6 : 12, reading.channel == 0 ? 5 : 3);
  }
  const std::vector<SwingRecord> swings = bench.swings(predicted);
  ASSERT_EQ(swings.size(), 4u) << "seven samples are too few, and so is the place of rest";
  for (size_t k = 0; k < 4; ++k) {
    const SwingRecord& swing = swings[k];
    EXPECT_EQ(swing.recording, k < 2 ? "ring" : "rest");
    EXPECT_EQ(swing.channel, k % 2 == 0 ? "end" : "side");
    EXPECT_NEAR(swing.frequency, k % 2 == 0 ? 7 : 11, 1e-4);
    EXPECT_NEAR(swing.decay, k % 2 == 0 ? 4 : 2, 1e-3);
    EXPECT_NEAR(swing.predicted_frequency, k % 2 == 0 ? 6 : 12, 1e-6);
    EXPECT_NEAR(swing.predicted_decay, k % 2 == 0 ? 5 : 3, 1e-5);
  }
  predicted[3] = std::nan("");
  EXPECT_EQ(bench.swings(predicted).size(), 3u) << "a motion that failed rings like nothing";
}

TEST(RecordingsBench, WhatIsSaidOfARecordingIsWhatItsFileHolds) {
  const TemporaryFolder folder;
  const std::string more =
      "\n[[bench.recording]]\nfile = \"ring.csv\"\ncase = \"light\"\nloads = { mass = \"20 g\" }\nfrom = \"0.1 ms\"\n"
      "every = 2\n";
  const RecordingsBench bench = ringing_bench(folder, hung_mass_toml + more, hung_mass_csv(9));
  EXPECT_EQ(bench.readings().size(), 2 * 9u + 2 * 4u);
  EXPECT_EQ(bench.readings().back().trial, "light");
  // each.
  const std::string unknowns = std::to_string(bench.unknowns());
  EXPECT_EQ(bench.size_text(), "26 samples of 2 recordings, 2 trajectories with " + unknowns + " unknowns");
  const auto said = [&](const std::string& label) {
    for (const auto& [name, text] : bench.describe()) {
      if (name == label) return text;
    }
    return std::string("nothing");
  };
  EXPECT_EQ(said("data"), "simulated");
  EXPECT_EQ(said("recording ring"), "18 samples from 0 s to 0.4 ms; held by hand = 0.1 (SI), let go at 0.5 ms");
  EXPECT_EQ(said("recording light"), "8 samples from 0.1 ms to 0.4 ms; mass = 0.02 (SI); held at rest, let go at 0 s");
  EXPECT_EQ(said("integrator"), "BDF2, steps of 0.025 ms");
  EXPECT_EQ(said("load mass"), "mass on xmax, with its inertia");
  EXPECT_EQ(said("load hand"), "force on xmax");
  EXPECT_EQ(said("trajectories"), "2");
}

TEST(RecordingsBench, AVariantHasTheSameSamplesOnAnotherMesh) {
  const TemporaryFolder folder;
  const RecordingsBench bench = ringing_bench(folder, hung_mass_toml, hung_mass_csv(9));
  VariantSettings finer;
  finer.mesh = bench.experiment().mesh;
  finer.mesh.cells = {3, 1};
  std::ofstream(folder / "ring.csv") << "gone";  // samples are not read again
  const std::unique_ptr<Bench> other = bench.with(finer);
  ASSERT_EQ(other->measurements().size(), bench.measurements().size());
  for (size_t i = 0; i < bench.measurements().size(); ++i)
    EXPECT_EQ(other->measurements()[i].value, bench.measurements()[i].value);
  EXPECT_GT(other->unknowns(), 2 * bench.unknowns());
  // A bar without inertia is as stiff with one element as with three.
  const Eigen::VectorXd one = bench.protocol().predict(bench.protocol().nominal(), {}).values;
  const Eigen::VectorXd three = other->protocol().predict(other->protocol().nominal(), {}).values;
  EXPECT_LT((one - three).norm(), 1e-6 * one.norm());
}

}  // namespace
}  // namespace taut

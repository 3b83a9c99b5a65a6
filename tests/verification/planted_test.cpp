#include "calib/studies/planted.hpp"

#include <gtest/gtest.h>

#include <cstdio>

#include "calib/files/experiment.hpp"
#include "tests/support/experiment_files.hpp"

// Modules that were drawn at random, whose truth is known: does a fit find it, and do its intervals hold it?
namespace taut::test {
namespace {

TEST(SlowPlanted, SixModulesAreFoundFromTwoStartsAndIntervalsHoldTheTruth) {
  Experiment base = read_experiment(TAUT_SOURCE_DIR "/experiments/push_puppet/experiment.toml");
  base.mesh.size = 4e-3;
  const TemporaryFolder folder;
  StudyOptions options;
  options.budget = 600;
  options.file = folder / "planted.csv";
  options.fingerprint = "test";
  const auto results = run_planted(base, 6, options);
  int noise = 0, total = 0, of = 0;
  for (const auto& result : results) {
    ASSERT_TRUE(result.has_value());
    EXPECT_EQ(result->status[0], "converged");
    EXPECT_EQ(result->status[1], "converged");
    EXPECT_EQ(result->total_status, "converged");
    EXPECT_LT(result->apart, 0.02);
    EXPECT_GT(result->p, 1e-4);
    EXPECT_LT(result->cold_replays, 20);
    for (size_t j = 0; j < result->parameters.size(); ++j) {
      std::printf("%s %+.4f %d %d  ", result->parameters[j].c_str(), result->error[j], result->noise_holds[j],
                  result->total_holds[j]);
      noise += result->noise_holds[j] == 1;
      total += result->total_holds[j] == 1;
      ++of;
    }
    std::printf("apart %.3g, chi squared %.4g for %d, %.2g cold replays\n", result->apart, result->chi_squared,
                result->dof, result->cold_replays);
  }
  EXPECT_EQ(of, 18);
  EXPECT_GE(noise, 14);
  EXPECT_GE(total, 16);

  // What is in the store is not run again, and says the same.
  options.budget = 0;
  const auto again = run_planted(base, 6, options);
  for (size_t k = 0; k < 6; ++k) {
    ASSERT_TRUE(again[k].has_value());
    EXPECT_EQ(again[k]->noise_holds, results[k]->noise_holds);
    EXPECT_EQ(again[k]->parameters, results[k]->parameters);
  }
}

TEST(Planted, TheSameNumberIsTheSameBenchAndOffOnesDifferWithinTheirTolerances) {
  Experiment base = read_experiment(TAUT_SOURCE_DIR "/experiments/push_puppet/experiment.toml");
  base.mesh.size = 8e-3;
  base.mesh.order = 1;
  const PlantedBench one = plant(base, 3, false), same = plant(base, 3, false), off = plant(base, 3, true);
  ASSERT_EQ(one.trials.readings.size(), 48u);
  for (size_t i = 0; i < 48; ++i) EXPECT_EQ(one.trials.readings[i].value, same.trials.readings[i].value);
  EXPECT_EQ(one.planted, off.planted);
  EXPECT_EQ(one.truth.geometry.thickness, one.experiment.geometry.thickness);
  EXPECT_NE(off.truth.geometry.thickness, off.experiment.geometry.thickness);
  EXPECT_NEAR(off.truth.geometry.thickness, off.experiment.geometry.thickness, 0.4e-3) << "two tolerances";
  EXPECT_TRUE(off.experiment.tolerances.contains("geometry.gap_total"));
}

}  // namespace
}  // namespace taut::test

#include "calib/studies/score.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "sim/core/error.hpp"
#include "tests/support/experiment_files.hpp"

// Predictions against readings, by numbers that were worked out by hand.
namespace taut {
namespace {

using test::TemporaryFolder;

const char* const kRig = "trial,retraction_mm,mass_g,tip_mm\n1,0,50,3.0\n2,0,50,3.2\n1,0,100,6.0\n2,0,100,6.4\n";

struct Score : testing::Test {
  ScoreData read(const std::string& sim, std::map<std::string, std::string> noise = {},
                 const std::string& rig = kRig) const {
    folder.write("rig.csv", rig);
    folder.write("sim.csv", sim);
    return read_score({folder / "rig.csv", {folder / "sim.csv"}, "", {}, std::move(noise)});
  }
  static ScoreTable scored(const ScoreData& data) { return score(data.rig, data.sims, data.has_noise, data.closure); }
  std::string refusal(const std::string& sim, std::map<std::string, std::string> noise = {},
                      const std::string& rig = kRig) const {
    try {
      scored(read(sim, std::move(noise), rig));
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  }
  TemporaryFolder folder;
};

/// Misses 0, -0.2, 0.5 and 0.1 mm.
TEST_F(Score, RootMeanSquareBiasLargestMissAndChiSquaredAreThoseByHand) {
  const ScoreTable table = scored(read("retraction_mm,mass_g,tip_mm\n0,50,3.0\n0,100,6.5\n", {{"tip", "0.2 mm"}}));
  const SimScore& sim = table.sims.at(0);
  const ChannelScore& tip = sim.channels.at(0);
  EXPECT_EQ(tip.readings, 4);
  EXPECT_NEAR(tip.rmse, 1e-3 * std::sqrt(0.30 / 4), 1e-12);
  EXPECT_NEAR(tip.bias, 0.1e-3, 1e-12);
  EXPECT_NEAR(tip.relative, std::sqrt(0.30 / 4) / std::sqrt(9.71 / 4), 1e-9);
  EXPECT_EQ(tip.largest.line, 4);
  EXPECT_NEAR(tip.largest.predicted - tip.largest.measured, 0.5e-3, 1e-12);
  EXPECT_NEAR(tip.chi_squared, 7.5, 1e-9);
  EXPECT_NEAR(tip.p_value, std::exp(-3.75) * (1 + 3.75), 1e-9);  // of four degrees of freedom
  EXPECT_NEAR(sim.chi_squared, 7.5, 1e-9);
}

/// Repeats are 0.1 and 0.2 mm from their means.
TEST_F(Score, RepeatsSayWhatNoPredictionCanGetBelow) {
  const ScoreTable table = scored(read("retraction_mm,mass_g,tip_mm\n0,50,3.1\n0,100,6.2\n", {{"tip", "0.2 mm"}}));
  const RepeatScatter& repeats = table.repeats.at(0);
  EXPECT_EQ(repeats.dof, 2);
  EXPECT_NEAR(repeats.standard_deviation, 1e-3 * std::sqrt(0.10 / 2), 1e-12);
  EXPECT_NEAR(repeats.least_rmse, 1e-3 * std::sqrt(0.10 / 4), 1e-12);
  EXPECT_NEAR(repeats.least_chi_squared, 2.5, 1e-9);
  // The means of the repeats are the best prediction.
  EXPECT_NEAR(table.sims.at(0).channels.at(0).rmse, repeats.least_rmse, 1e-12);
  EXPECT_NEAR(table.sims.at(0).chi_squared, repeats.least_chi_squared, 1e-9);
}

TEST_F(Score, UnitsOfTheTableAreConvertedAndItsOrderDoesNotMatter) {
  const ScoreTable table = scored(read("tip [m];mass (kg);retraction_cm\n0,0065;0,1;0\n0,0030;0,05;0\n"));
  EXPECT_NEAR(table.sims.at(0).channels.at(0).rmse, 1e-3 * std::sqrt(0.30 / 4), 1e-12);
  EXPECT_TRUE(std::isnan(table.sims.at(0).chi_squared));  // no noise was given
}

TEST_F(Score, NoiseInPartsAddsUpAsRootOfSquares) {
  const ScoreTable table =
      scored(read("retraction_mm,mass_g,tip_mm\n0,50,3.0\n0,100,6.5\n", {{"tip", "0.1 mm + 2 %"}}));
  const auto term = [](double miss, double reading) { return miss * miss / (0.01 + std::pow(0.02 * reading, 2)); };
  EXPECT_NEAR(table.sims.at(0).chi_squared, term(0.2, 3.2) + term(0.5, 6.0) + term(0.1, 6.4), 1e-9);
}

TEST_F(Score, RowsMatchToAMillionthAndOthersAreListed) {
  folder.write("rig.csv", kRig);
  folder.write("sim.csv", "retraction_mm,mass_g,tip_mm\n0,50.00003,3.0\n0,100.0002,6.5\n0,200,7\n");
  const ScoreTable table = scored(read_score({folder / "rig.csv", {folder / "sim.csv"}, "", {"tip_mm"}, {}}));
  const SimScore& sim = table.sims.at(0);
  EXPECT_EQ(table.readings, 2);
  EXPECT_EQ(sim.unpredicted, (std::vector<int>{4, 5}));
  EXPECT_EQ(sim.unread, (std::vector<int>{3, 4}));
  EXPECT_NEAR(sim.channels.at(0).rmse, 1e-3 * std::sqrt(0.04 / 2), 1e-12);
}

TEST_F(Score, SeveralAreAskedForTheSameReadingsAndTheBestStandsFirst) {
  const std::string head = "retraction_mm,mass_g,tip_mm\n";
  folder.write("rig.csv", kRig);
  folder.write("far.csv", head + "0,50,4.1\n0,100,6.2\n");
  folder.write("near.csv", head + "0,50,3.2\n");
  const ScoreTable table =
      scored(read_score({folder / "rig.csv", {folder / "far.csv", folder / "near.csv"}, "", {}, {{"tip", "0.2 mm"}}}));
  EXPECT_EQ(table.readings, 2);  // 100 g is predicted by one of them alone
  EXPECT_EQ(table.sims.at(0).name, folder / "near.csv");
  EXPECT_NEAR(table.sims.at(0).chi_squared, 1, 1e-9);
  EXPECT_NEAR(table.sims.at(1).chi_squared, (1.1 * 1.1 + 0.9 * 0.9) / 0.04, 1e-9);
}

/// Measured 8, 6, 4 and 0.5 mm: closed after the third retraction; predicted 8, 6, 1 and 0.5 mm: after the second.
TEST_F(Score, ClosureIsWhereTheDisplacementFallsByTheLargestFactor) {
  const ScoreData data = read(
      "retraction_mm,mass_g,tip_mm\n0,100,8.01\n6,100,6.01\n12,100,1\n18,100,0.51\n0,50,4.01\n6,50,3.01\n12,50,2.01\n",
      {}, "retraction_mm,mass_g,tip_mm\n0,100,8\n6,100,6\n12,100,4\n18,100,0.5\n0,50,4\n6,50,3\n12,50,2\n");
  const ScoreTable table = score(data.rig, data.sims, data.has_noise, {{0}, 1, {0}});
  ASSERT_EQ(table.sims.at(0).closures.size(), 1u);
  const Closure& closure = table.sims.at(0).closures.at(0);
  EXPECT_NEAR(closure.held.at(1), 0.1, 1e-12);  // the largest load
  EXPECT_NEAR(closure.measured.from, 12e-3, 1e-12);
  EXPECT_NEAR(closure.measured.to, 18e-3, 1e-12);
  EXPECT_NEAR(closure.measured.factor, 8, 1e-9);
  EXPECT_NEAR(closure.predicted.from, 6e-3, 1e-12);
  EXPECT_NEAR(closure.predicted.factor, 6.01, 1e-9);
  EXPECT_NEAR(closure.reading, 0.5e-3, 1e-12);
  EXPECT_NEAR(closure.prediction, 0.51e-3, 1e-12);
}

/// Half of the loads of a sweep of its own are those of the rig.
TEST_F(Score, ASweepThatIsFinerThanTheRigsIsMatchedWhereItMeetsIt) {
  const ScoreTable table =
      scored(read("retraction_mm,mass_g,tip_mm\n0,25,1.5\n0,50,3.0\n0,75,4.4\n0,100,6.5\n0,125,8\n"));
  EXPECT_EQ(table.readings, 4);
  EXPECT_NEAR(table.sims.at(0).channels.at(0).rmse, 1e-3 * std::sqrt(0.30 / 4), 1e-12);
}

TEST_F(Score, TextThatBothFilesHaveIsAControl) {
  const ScoreTable table =
      scored(read("mode,load_N,tip_mm\npull,1,2.5\npush,1,3.5\n", {}, "mode,load_N,tip_mm\npull,1,2.0\npush,1,3.0\n"));
  EXPECT_EQ(table.sims.at(0).readings, 2);
  EXPECT_NEAR(table.sims.at(0).channels.at(0).bias, 0.5e-3, 1e-12);
}

TEST_F(Score, WhatIsWrongIsSaidInASentence) {
  const std::string head = "retraction_mm,mass_g,tip_mm\n";
  const auto holds = [](const std::string& text, const std::string& part) {
    EXPECT_NE(text.find(part), std::string::npos) << part << " is not in: " << text;
  };
  holds(refusal(head + "0,50,3.1\n0,50,3.3\n"), "lines 2 and 3: both predict channel 'tip' for the same controls");
  holds(refusal(head + "0,50,3.1\n0,100,x\n"), "'x' is not a finite number");
  holds(refusal("height_mm,width_mm\n1,2\n"), "they have no column in common");
  holds(refusal("mass_g,retraction_mm,tip_N\n50,0,3\n"), "'tip_N' ends in 'N', a unit of force, but length is needed");
  holds(refusal("mass_g,retraction_mm\n50,0\n"), "no column looks like a prediction");
  holds(refusal(head + "0,50,3.1\n", {{"top", "1 mm"}}), "--noise top: there is no such channel (did you mean 'tip'?)");
  holds(refusal(head + "0,50,3.1\n", {{"tip", "1 N"}}), "--noise tip");
  holds(refusal(head + "0,50,3.1\n", {{"tip", "0 mm"}}), "is no standard deviation");
}

}  // namespace
}  // namespace taut

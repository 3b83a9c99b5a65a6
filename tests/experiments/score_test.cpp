#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <sstream>

#include "tests/support/command.hpp"
#include "tests/support/experiment_files.hpp"

// `taut score` as its users call it.
namespace taut {
namespace {

using namespace test;
using nlohmann::json;

TEST(ScoreCommand, TakesThePredictionsOfAReplayBesideAnotherProgramsTable) {
  const TemporaryFolder folder;
  folder.write("beam.toml", beam_toml);
  folder.write("bench.csv", beam_csv);
  done_in(folder / "", {"replay", "beam.toml", "--quiet", "--out", "replay"});
  const json replay =
      json::parse(done_in(folder / "", {"replay", "beam.toml", "--quiet", "--json", "--out", "replay"}).out);
  double squares = 0;
  for (const json& row : replay.at("rows"))
    squares += std::pow(row.at("predicted_m").get<double>() - row.at("measured_m").get<double>(), 2);
  folder.write("other.csv", "pull_mN,tip_um\n50,1100\n100,2100\n");

  const json both = json::parse(done_in(folder / "", {"score", "bench.csv", "replay/predictions.csv", "other.csv",
                                                      "--experiment", "beam.toml", "--json"})
                                    .out);
  ASSERT_EQ(both.at("ranked").size(), 2u);
  for (const json& sim : both.at("ranked")) {
    const bool own = sim.at("file") == "replay/predictions.csv";
    const json& tip = sim.at("channels")[0];
    EXPECT_EQ(tip.at("readings"), 4);
    EXPECT_NEAR(tip.at("rmse").get<double>(), own ? std::sqrt(squares / 4) : 0.1e-3, 1e-9);
    EXPECT_NEAR(sim.at("chi_squared").get<double>(), own ? squares / 1e-8 : 4.0, own ? 1e-5 * squares / 1e-8 : 1e-9);
  }
  // Without the experiment: the one channel is the table's, whatever it is called.
  const json alone = json::parse(done_in(folder / "", {"score", "bench.csv", "replay/predictions.csv", "--json"}).out);
  EXPECT_NEAR(alone.at("ranked")[0].at("channels")[0].at("rmse").get<double>(), std::sqrt(squares / 4), 1e-9);
  EXPECT_TRUE(alone.at("ranked")[0].at("chi_squared").is_null());
}

/// Channels of unlike units stand in one column of a replay's table, each with its unit. The clamp bears the whole
/// pull.
TEST(ScoreCommand, TakesReplaysWhoseChannelsHaveUnlikeUnits) {
  const TemporaryFolder folder;
  folder.write("beam.toml",
               replaced(beam_toml, "\n[bench]",
                        "\n[[channel]]\nid = \"clamp\"\nkind = \"reaction\"\non = \"xmin\"\ndirection = [0, 1]\n"
                        "column = \"clamp_mN\"\nnoise = { absolute = \"2 mN\" }\n\n[bench]"));
  folder.write("bench.csv", "trial,pull_N,tip_mm,clamp_mN\na,0.05,1,52\na,0.1,2,99\n");
  done_in(folder / "", {"replay", "beam.toml", "--quiet", "--out", "replay"});
  ASSERT_NE(text_of(folder / "replay/predictions.csv").find(",unit,"), std::string::npos);
  const json scored = json::parse(
      done_in(folder / "", {"score", "bench.csv", "replay/predictions.csv", "--experiment", "beam.toml", "--json"})
          .out);
  const json& clamp = scored.at("ranked")[0].at("channels")[1];
  EXPECT_EQ(clamp.at("channel"), "clamp");
  EXPECT_NEAR(clamp.at("bias").get<double>(), (-2e-3 + 1e-3) / 2, 1e-8);
  EXPECT_NEAR(clamp.at("chi_squared").get<double>(), 1 + 0.25, 1e-4);
  // A rig that has but one of them must not take the other's numbers for it.
  folder.write("tips.csv", "trial,pull_N,tip_mm\na,0.05,1\na,0.1,2\n");
  const Outcome unknown = run_in(folder / "", {"score", "tips.csv", "replay/predictions.csv"});
  EXPECT_EQ(unknown.code, 2);
  expect_holds(unknown.err, {"'clamp' is none of the rig's channels, which are tip"});
}

/// Strains are pure numbers, per cent in the bench file; modes stand in a column of text.
TEST(ScoreCommand, TakesReplaysOfAMaterialPoint) {
  const TemporaryFolder folder;
  const std::string experiment = TAUT_SOURCE_DIR "/experiments/foam_point/experiment.toml";
  done_in(folder / "", {"replay", experiment, "--quiet", "--out", "replay"});
  double chi_squared = 0;
  std::istringstream lines(text_of(folder / "replay/predictions.csv"));
  for (std::string line; std::getline(lines, line);) {
    std::vector<std::string> cells;
    std::istringstream row(line);
    for (std::string cell; std::getline(row, cell, ',');) cells.push_back(cell);
    if (cells.at(0) != "line")  // strain, measured, sigma, predicted
      chi_squared += std::pow((std::stod(cells.at(6)) - std::stod(cells.at(4))) / std::stod(cells.at(5)), 2);
  }
  const std::string bench = TAUT_SOURCE_DIR "/data/foam_curves/bench.csv";
  const json scored = json::parse(
      done_in(folder / "", {"score", bench, "replay/predictions.csv", "--experiment", experiment, "--json"}).out);
  EXPECT_NEAR(scored.at("ranked")[0].at("chi_squared").get<double>(), chi_squared, 1e-6 * chi_squared);
}

TEST(ScoreCommand, SaysTheSameInWords) {
  const TemporaryFolder folder;
  folder.write("rig.csv", "trial,pull_N,tip_mm\na,0.05,1\nb,0.05,1.2\na,0.1,2\nb,0.1,2.2\n");
  folder.write("one.csv", "pull_N,tip_mm\n0.05,1.15\n0.1,2.3\n");
  folder.write("two.csv", "pull_N,tip_mm\n0.05,1.05\n0.2,4.3\n");
  const Outcome words = done_in(folder / "", {"score", "rig.csv", "one.csv", "two.csv", "--noise", "tip=0.1 mm"});
  expect_holds(words.out,
               {"controls: pull_N; channels: tip_mm; repeats by trial",
                "rows are matched by their controls, to 1e-06 of each one's largest value",
                "scored: 2 of 4 readings, those that all files predict",
                "tip: repeats scatter by 141 um (standard deviation); no simulator can have an RMSE below 100 um here",
                "chi squared below 2", "1.  ", "chi squared 2.5 for 2 readings",
                "it predicts nothing for lines 4 to 5 of the rig's file", "its line 3 has no reading at the rig"});
  const Outcome no_noise = done_in(folder / "", {"score", "rig.csv", "one.csv"});
  expect_holds(no_noise.out, {"no chi squared: no noise was given (--noise tip=\"...\", or --experiment)"});
}

TEST(ScoreCommand, WrongInputGetsOneSentence) {
  const TemporaryFolder folder;
  folder.write("rig.csv", "trial,pull_N,tip_mm\na,0.05,1\n");
  folder.write("sim.csv", "pull_N,tip_mm\n0.05,1.1\n");
  const Outcome no_sim = run_in(folder / "", {"score", "rig.csv"});
  EXPECT_EQ(no_sim.code, 2);
  expect_holds(no_sim.err, {"SIM.csv is missing"});
  const Outcome missing = run_in(folder / "", {"score", "rig.csv", "none.csv"});
  EXPECT_EQ(missing.code, 2);
  expect_holds(missing.err, {"none.csv"});
  const std::string swing = TAUT_SOURCE_DIR "/experiments/silicone_swing/experiment.toml";
  const Outcome recordings = run_in(folder / "", {"score", "rig.csv", "sim.csv", "--experiment", swing});
  EXPECT_EQ(recordings.code, 2);
  expect_holds(recordings.err, {"which stand in files of their own"});
  const Outcome no_channel = run_in(folder / "", {"score", "rig.csv", "sim.csv", "--channel", "top_mm"});
  EXPECT_EQ(no_channel.code, 2);
  expect_holds(no_channel.err, {"--channel top_mm: rig.csv has no such column"});
}

}  // namespace
}  // namespace taut

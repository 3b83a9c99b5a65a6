#include <fmt/format.h>
#include <gtest/gtest.h>

#include <array>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>
#include <tuple>

#include "tests/support/command.hpp"

// From nothing to a first report: `taut init`, and benches that hold no reading yet.
namespace taut {
namespace {

using namespace test;
using nlohmann::json;
namespace fs = std::filesystem;

const std::array<const char*, 6> kinds_to_start{"beam", "cantilever", "point", "push_puppet", "simulation", "tentacle"};

struct Start : testing::Test {
  Outcome taut(const std::vector<std::string>& arguments) const { return run_in(folder_ / "", arguments); }

  /// What a start of this kind writes, in a folder of its name.
  std::string begun(const std::string& kind) const {
    done_in(folder_ / "", {"init", kind, kind});
    return kind + "/experiment.toml";
  }

  json result(const std::vector<std::string>& arguments) const {
    std::vector<std::string> all = arguments;
    all.insert(all.end(), {"--json", "--quiet"});
    const Outcome outcome = done_in(folder_ / "", all);
    return outcome.code == 0 ? json::parse(outcome.out) : json();
  }

  /// Writes a cell of each row of a bench: the one in the column of readings of the strip.
  void read_drops(const std::string& bench, const auto& drop_mm_of) const {
    std::istringstream lines(text_of(folder_ / bench));
    std::string header, all;
    std::getline(lines, header);
    ASSERT_EQ(header, "trial,mass_g,tip_drop_mm,note");
    for (std::string line; std::getline(lines, line);) {
      int trial = 0;
      double mass = 0;
      ASSERT_EQ(std::sscanf(line.c_str(), "%d,%lf,,", &trial, &mass), 2) << line;
      all += fmt::format("{},{},{:.3f},\n", trial, mass, drop_mm_of(trial, mass));
    }
    folder_.write(bench, header + "\n" + all);
  }

  TemporaryFolder folder_;
};

/// Drop of a clamped strip's tip by Timoshenko's beam, small against its length [mm]. Lengths in mm, E in MPa, mass in
/// g.
double timoshenko_drop(double E, double nu, double length, double height, double width, double mass) {
  const double force = 9.81e-3 * mass, area = height * width, inertia = width * std::pow(height, 3) / 12;
  return force * std::pow(length, 3) / (3 * E * inertia) + force * length / (5.0 / 6 * E / (2 * (1 + nu)) * area);
}

TEST_F(Start, WhatIsWrittenPassesCheckAndSaysThatReadingsAreMissing) {
  for (const std::string kind : kinds_to_start) {
    const std::string file = begun(kind);
    const Outcome check = taut({"check", file});
    EXPECT_EQ(check.code, 0) << kind << check.err;
    if (kind == "simulation") continue;
    expect_holds(check.out, {"and no reading yet; fill in", "taut fit " + file});
    EXPECT_EQ(taut({"check", file, "--strict"}).code, 2) << kind;
    EXPECT_GT(result({"check", file}).at("rows_without_readings"), 5) << kind;
    const Outcome fit = taut({"fit", file});
    EXPECT_EQ(fit.code, 2) << kind;
    expect_holds(fit.err, {"no row below the header has a reading"});
  }
}

TEST_F(Start, WhatToMeasureIsMarkedAndTheProtocolIsThere) {
  for (const std::string kind : kinds_to_start) {
    const std::string file = begun(kind);
    expect_holds(text_of(folder_ / file), {"# MEASURE"});
    if (kind == "simulation") continue;
    expect_holds(text_of(folder_ / kind + "/README.md"),
                 {"**Zero.**", "**Pretension.**", "**Order.**", "**Dwell.**", "**Unloading.**", "**Three trials.**"});
  }
}

TEST_F(Start, NothingIsOverwritten) {
  const std::string file = begun("beam");
  folder_.write("beam/bench.csv", "mine");
  fs::remove(folder_ / "beam/README.md");
  fs::remove(folder_ / file);  // what was not there would not be half of a start either
  const Outcome again = taut({"init", "beam", "beam"});
  EXPECT_EQ(again.code, 2);
  expect_holds(again.err, {"bench.csv is there already and is not overwritten"});
  EXPECT_EQ(text_of(folder_ / "beam/bench.csv"), "mine");
  EXPECT_FALSE(fs::exists(folder_ / file));
}

TEST_F(Start, WrongWordsAreAnsweredInOneSentence) {
  const Outcome unknown = taut({"init", "pushpuppet", "here"});
  EXPECT_EQ(unknown.code, 2);
  expect_holds(unknown.err,
               {"no start 'pushpuppet' (did you mean 'push_puppet'?); allowed: beam, cantilever, point, "});
  EXPECT_FALSE(fs::exists(folder_ / "here"));
  const Outcome alone = taut({"init", "beam"});
  EXPECT_EQ(alone.code, 2);
  expect_holds(alone.err, {"taut init: beam|cantilever|point|push_puppet|simulation|tentacle DIR is missing"});
}

// The strip of a newcomer: ten lines edited, readings by Timoshenko's beam, to within the last digit of the instrument.
TEST_F(Start, ANewcomerEditsTenLinesAndHasAReport) {
  const auto began = std::chrono::steady_clock::now();
  const std::string file = begun("beam");
  const std::map<std::string, std::string> edits{
      {"title =", "title = \"Strip of my own\""},
      {"size =", "size = [\"150 mm +- 0.5 mm\", \"12 mm +- 0.05 mm\"]"},
      {"thickness =", "thickness = \"25 mm +- 0.1 mm\""},
      {"cells =", "cells = [50, 4]"},
      {"E =", "E = \"10 MPa\""},
      {"nu =", "nu = 0.4"},
      {"noise =", "noise = { absolute = \"0.02 mm\", resolution = \"0.01 mm\" }"},
      {"lower =", "lower = \"1 MPa\""},
      {"upper =", "upper = \"1 GPa\""},
      {"plane =", "plane = \"stress\""}};
  std::istringstream lines(text_of(folder_ / file));
  std::string edited;
  size_t count = 0;
  for (std::string line; std::getline(lines, line);) {
    for (const auto& [begin, text] : edits) {
      if (!line.starts_with(begin)) continue;
      line = text;
      ++count;
    }
    edited += line + "\n";
  }
  ASSERT_EQ(count, 10u);
  folder_.write(file, edited);

  const json plan = result({"replay", file, "--set", "E_strip=30MPa", "--out", "plan"});
  for (const json& row : plan.at("rows")) {
    const double drop = timoshenko_drop(30, 0.4, 150, 12, 25, 1e3 * row.at("controls")[0].get<double>());
    EXPECT_NEAR(1e3 * row.at("predicted_m").get<double>(), drop, 0.01 * drop);
    EXPECT_TRUE(row.at("measured_m").is_null());
  }
  read_drops("beam/bench.csv", [](int trial, double mass) {
    const double error = 0.015 * std::sin(7.0 * trial + mass);  // mm
    return timoshenko_drop(30, 0.4, 150, 12, 25, mass) + error;
  });
  expect_holds(done_in(folder_ / "", {"check", file}).out, {"15 readings: 5 conditions x 3 trials"});
  const json fit = result({"fit", file, "--out", "report"});
  ASSERT_TRUE(fit.contains("parameters"));
  EXPECT_NEAR(fit.at("parameters")[0].at("value").get<double>(), 30e6, 0.01 * 30e6);
  EXPECT_EQ(fit.at("parameters")[0].at("verdict"), "well determined");
  EXPECT_TRUE(fs::exists(folder_ / "report/report.html"));
  EXPECT_LT(std::chrono::steady_clock::now() - began, std::chrono::minutes(5));
}

TEST_F(Start, BlankReadingsArePredictedAsTheyAreWithReadings) {
  const std::string file = begun("push_puppet");
  const json blank = result({"replay", file});
  std::string csv = "trial,retraction_mm,mass_g,tip_drop_mm,note\n";
  for (const json& row : blank.at("rows"))
    csv += fmt::format("{},{:.6g},{:.6g},1,\n", row.at("trial").get<std::string>(),
                       1e3 * row.at("controls")[1].get<double>(), 1e3 * row.at("controls")[0].get<double>());
  folder_.write("push_puppet/bench.csv", csv);
  const json read = result({"replay", file});
  ASSERT_EQ(blank.at("rows").size(), 48u);
  ASSERT_EQ(read.at("rows").size(), 48u);
  for (size_t i = 0; i < 48; ++i) {
    EXPECT_EQ(blank.at("rows")[i].at("controls"), read.at("rows")[i].at("controls"));
    const double there = read.at("rows")[i].at("predicted_m");
    EXPECT_NEAR(blank.at("rows")[i].at("predicted_m").get<double>(), there, 1e-9 + 1e-6 * std::abs(there));
    EXPECT_EQ(read.at("rows")[i].at("measured_m"), 1e-3);
  }
}

TEST_F(Start, RowsOfAPlanNeedNoBenchFile) {
  const std::string file = begun("beam");
  fs::remove(folder_ / "beam/bench.csv");
  folder_.write("plan.csv", "mass_g\n3\n7.5\n");
  EXPECT_EQ(taut({"replay", file}).code, 2);
  const json replay = result({"replay", file, "--rows", "plan.csv"});
  ASSERT_EQ(replay.at("rows").size(), 2u);
  EXPECT_EQ(replay.at("rows")[0].at("line"), 2);
  for (const json& row : replay.at("rows")) {
    const double drop = timoshenko_drop(2, 0.45, 120, 10, 30, 1e3 * row.at("controls")[0].get<double>());
    EXPECT_NEAR(1e3 * row.at("predicted_m").get<double>(), drop, 0.01 * drop);
  }
  expect_holds(done_in(folder_ / "", {"check", file, "--rows", "plan.csv"}).out, {"plan.csv holds no readings"});
  folder_.write("wrong.csv", "mas_g\n3\n");
  const Outcome wrong = taut({"replay", file, "--rows", "wrong.csv"});
  EXPECT_EQ(wrong.code, 2);
  expect_holds(wrong.err, {"wrong.csv, line 1: column 'mass_g'", "is missing", "did you mean 'mas_g'"});
}

TEST_F(Start, AHeaderAloneCanBeCheckedAndNotReplayed) {
  const std::string file = begun("push_puppet");
  folder_.write("push_puppet/bench.csv", "trial,retraction_mm,mass_g,tip_drop_mm,note\n");
  const Outcome check = taut({"check", file});
  EXPECT_EQ(check.code, 0) << check.err;
  expect_holds(check.out, {"a header and no row yet", "retraction_mm", "mass_g"});
  const Outcome replay = taut({"replay", file});
  EXPECT_EQ(replay.code, 2);
  expect_holds(replay.err, {"there is a header but no row below it"});
  folder_.write("push_puppet/bench.csv", "trial,retraction_mm,mass_g,note\n");
  const Outcome incomplete = taut({"check", file});
  EXPECT_EQ(incomplete.code, 2);
  expect_holds(incomplete.err, {"column 'tip_drop_mm' for channel 'tip' is missing"});
}

TEST_F(Start, ABlankBetweenNumberAndUnitMayBeLeftOutOnTheCommandLine) {
  const std::string file = begun("beam");
  const json with = result({"replay", file, "--set", "E_strip=3.5 MPa"}),
             without = result({"replay", file, "--set", "E_strip=3.5MPa"});
  EXPECT_EQ(with.at("rows"), without.at("rows"));
  const Outcome wrong = taut({"replay", file, "--set", "E_strip=3.5MPaa"});
  EXPECT_EQ(wrong.code, 2);
  expect_holds(wrong.err, {"--set E_strip: 'MPaa' is not a unit of pressure"});
}

TEST_F(Start, BoundsThatAreNotGivenAreThoseOfWhatTheModulusStartsAs) {
  const std::string file = begun("beam");
  const std::string toml =
      replaced(replaced(text_of(folder_ / file), "lower = \"10 kPa\"\n", ""), "upper = \"10 GPa\"\n", "");
  for (const auto& [start, lower, upper] :
       {std::tuple{"2 MPa", 100.0, 1e9}, {"3 GPa", 1e6, 1e12}, {"50 MPa", 100.0, 5e9}}) {
    folder_.write(file, replaced(toml, "E = \"2 MPa\"", fmt::format("E = \"{}\"", start)));
    const json free = result({"check", file}).at("free");
    ASSERT_EQ(free.size(), 1u);
    EXPECT_DOUBLE_EQ(free[0].at("bounds")[0].get<double>(), lower) << start;
    EXPECT_DOUBLE_EQ(free[0].at("bounds")[1].get<double>(), upper) << start;
  }
}

TEST_F(Start, TheRetractionIsUnderstoodWhateverItsColumnIsCalled) {
  const std::string file = begun("push_puppet");
  folder_.write("push_puppet/bench.csv",
                replaced(text_of(folder_ / "push_puppet/bench.csv"), "retraction_mm", "winch_mm"));
  const std::string toml = replaced(text_of(folder_ / file), "\"retraction_mm\"", "\"winch_mm\"");
  for (const std::string per : {"retraction", "winch", "winch_mm"}) {
    std::string text = replaced(toml, "per = \"retraction\"", "per = \"" + per + "\"");
    text = replaced(text, "[fit.free.slack]", "[fit.free.zero_1]\n\n[fit.free.slack]");
    folder_.write(file, replaced(text, "trial = \"trial\"", "trial = \"trial\"\nzero_offset_per = \"" + per + "\""));
    const Outcome check = taut({"check", file});
    EXPECT_EQ(check.code, 0) << per << check.err;
    expect_holds(check.out, {"free zero_1"});
  }
  folder_.write(file, replaced(toml, "per = \"retraction\"", "per = \"rotation\""));
  const Outcome wrong = taut({"check", file});
  EXPECT_EQ(wrong.code, 2);
  expect_holds(wrong.err, {"[fit.diagnostic] per: 'rotation' is not set by the bench", "allowed: mass, winch"});
}

TEST_F(Start, RecordingsHaveNoRowsOfControls) {
  folder_.write("plan.csv", "mass_g\n3\n");
  const Outcome replay =
      taut({"replay", TAUT_SOURCE_DIR "/experiments/silicone_swing/experiment.toml", "--rows", "plan.csv"});
  EXPECT_EQ(replay.code, 2);
  expect_holds(replay.err, {"--rows: recordings", "has no rows of controls"});
}

}  // namespace
}  // namespace taut

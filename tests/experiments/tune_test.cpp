#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <sstream>

#include "tests/support/cable_bar.hpp"
#include "tests/support/command.hpp"
#include "tests/support/experiment_files.hpp"

// `taut tune`, on a bar of which all is a closed form.
namespace taut {
namespace {

using namespace test;
using nlohmann::json;

/// The tangent stiffness without load, with a bar of stiffness K at rest: K (1 + lambda^-2) / 2 of a neo-Hookean bar
/// with nu = 0, whose force is K L (lambda - 1 / lambda) / 2 at the stretch lambda, and k phi''(e) of the cable. Its
/// elongation e is the retraction less the slack and what its tension k phi'(e) shortens the bar by.
double stiffness_at(double retraction, double K, double k) {
  double e = retraction - kSlack, stretch = 1;
  for (int i = 0; i < 50; ++i) {
    const double z = std::max(0.0, e + kTransition / 2);
    const double tension = z < kTransition ? k * z * z / (2 * kTransition) : k * e;
    const double t = tension / (K * kLength);
    stretch = std::sqrt(1 + t * t) - t;  // of lambda - 1 / lambda = -2 t
    e = retraction - kSlack - (1 - stretch) * kLength;
  }
  return K * (1 + 1 / (stretch * stretch)) / 2 + k * std::clamp((e + kTransition / 2) / kTransition, 0.0, 1.0);
}

/// What the cable shortens the bar by at that state: a negative elongation [m].
double tip_at(double retraction, double K, double k) {
  double tip = 0;
  for (int i = 0; i < 50; ++i) {
    const double e = retraction - kSlack + tip, z = std::max(0.0, e + kTransition / 2);
    const double t = (z < kTransition ? k * z * z / (2 * kTransition) : k * e) / (K * kLength);
    tip = (std::sqrt(1 + t * t) - t - 1) * kLength;
  }
  return tip;
}

class Tune : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new TemporaryFolder;
    fit_own_readings(*folder_, "run", bar_toml, {0, 5, 10}, 0.1);
    const json fit = json::parse(text_of(*folder_ / "run/fit.json"));
    for (const json& p : fit.at("parameters")) (p.at("id") == "E_foam" ? E_ : k_) = p.at("value").get<double>();
    for (int i : {0, 1}) {
      for (int j : {0, 1}) covariance_[i][j] = fit.at("fit").at("covariance")[i][j].get<double>();
    }
  }
  static void TearDownTestSuite() { delete folder_; }

  static Outcome tune(std::vector<std::string> arguments, const std::string& run = "run") {
    arguments.insert(arguments.begin(), {"tune", run, "--quiet"});
    return run_in(*folder_ / "", arguments);
  }
  static double bar() { return E_ * kArea / kLength; }

  static TemporaryFolder* folder_;
  static double E_, k_, covariance_[2][2];
};
TemporaryFolder* Tune::folder_ = nullptr;
double Tune::E_ = 0, Tune::k_ = 0, Tune::covariance_[2][2] = {};

TEST_F(Tune, FindsTheRetractionOfTheClosedFormAndItsInterval) {
  const Outcome outcome = tune({"--stiffness", "404 N/m", "--json", "--no-map"});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const json tuned = json::parse(outcome.out).at("tuned")[0];
  ASSERT_EQ(tuned.at("solutions").size(), 1u);
  const json& found = tuned.at("solutions")[0];
  const double at = found.at("value").get<double>();
  EXPECT_NEAR(stiffness_at(at, bar(), k_), 404, 0.02);
  EXPECT_NEAR(at, kSlack, 0.3 * kTransition);
  // r = slack + eps ((k0 - K) / k - 1/2) but for what the tension shortens the bar by, which is some per cent of it.
  const double by_E = -kTransition * bar() / k_, by_k = -kTransition * (404 - bar()) / k_;
  const double variance =
      by_E * by_E * covariance_[0][0] + 2 * by_E * by_k * covariance_[0][1] + by_k * by_k * covariance_[1][1];
  EXPECT_NEAR(found.at("noise_half95").get<double>(), 1.96 * std::sqrt(variance), 0.04 * 1.96 * std::sqrt(variance));
  EXPECT_GE(found.at("total_half95").get<double>(), found.at("noise_half95").get<double>());
  EXPECT_NEAR(found.at("replayed_N_per_m").get<double>(), 404, 1e-2);
  EXPECT_FALSE(found.at("touching").get<bool>());
  const auto [low, high] = std::pair(tuned.at("reachable_N_per_m")[0][0], tuned.at("reachable_N_per_m")[0][1]);
  EXPECT_NEAR(low.get<double>(), bar(), 0.02);
  EXPECT_NEAR(high.get<double>(), stiffness_at(10e-3, bar(), k_), 0.03);  // the cable pulls at a point
}

TEST_F(Tune, TheStiffnessIsThatOfTheReadingsAtNeighbouringLoads) {
  const Outcome outcome = tune({"--stiffness", "403 N/m", "--at", "0.1 N", "--json", "--no-map"});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const double at = json::parse(outcome.out).at("tuned")[0].at("solutions")[0].at("value").get<double>();
  folder_->write("rows.csv", fmt::format("retraction_mm,pull_N\n{0:.10f},0.099\n{0:.10f},0.101\n", 1e3 * at));
  const json predicted =
      json::parse(done_in(*folder_ / "", {"predict", "run", "--rows", "rows.csv", "--json", "-q"}).out);
  const auto tip = [&](size_t i) { return predicted.at("rows")[i].at("predicted_m").get<double>(); };
  EXPECT_NEAR(0.002 / (tip(1) - tip(0)), 403, 0.01);
}

TEST_F(Tune, ACliffOfTheStiffnessIsNoSolution) {
  // From slack to taut within less than 0.1 um of retraction, which no value of four digits hits.
  std::string toml = replaced(bar_toml, "k = \"8 N/m\"", "k = \"4 kN/m\"");
  toml = replaced(toml, "smoothing = \"4 mm\"", "smoothing = \"0.00001 mm\"");
  toml = replaced(toml, "start = \"5 N/m\"", "start = \"3 kN/m\"");
  fit_own_readings(*folder_, "cliff", replaced(toml, "upper = \"1 kN/m\"", "upper = \"100 kN/m\""), {0, 5, 5.1}, 0.1);
  const Outcome outcome = tune({"--stiffness", "1 N/mm", "--to", "5.1 mm", "--no-map", "--json"}, "cliff");
  EXPECT_EQ(outcome.code, 4) << outcome.err;
  const json tuned = json::parse(outcome.out).at("tuned")[0];
  EXPECT_TRUE(tuned.at("solutions").empty());
  ASSERT_EQ(tuned.at("jumps").size(), 1u);
  const json& jump = tuned.at("jumps")[0];
  EXPECT_LT(jump.at("between")[0].get<double>(), kSlack);
  EXPECT_GT(jump.at("between")[1].get<double>(), kSlack);
  EXPECT_NEAR(jump.at("stiffness_N_per_m")[0].get<double>(), 400, 1);
  EXPECT_GT(jump.at("stiffness_N_per_m")[1].get<double>(),
            2000);  // 4400, were it not for the foam around the cable's end
}

TEST_F(Tune, AllSolutionsAreListed) {
  // Across the axis: a cable beside it stiffens the beam as it becomes taut, and its pull softens it from there on.
  std::string toml = replaced(bar_toml, "[4, 2]", "[8, 2]\nelement = \"quadratic\"");
  toml = replaced(toml, "E = \"100 kPa\"", "E = \"1 MPa\"");
  toml = replaced(toml, "k = \"8 N/m\"", "k = \"30 N/m\"");
  toml = replaced(toml, "slack = \"5 mm\"", "slack = \"2 mm\"");
  toml = replaced(toml, "smoothing = \"4 mm\"", "smoothing = \"2 mm\"");
  toml = replaced(toml, "y = [\"6 mm\", \"6 mm\"]", "y = [\"11 mm\", \"11 mm\"]");
  toml = replaced(toml, "direction = [1, 0]\ncolumn = \"pull_N\"", "direction = [0, -1]\ncolumn = \"pull_N\"");
  toml = replaced(toml, "direction = [1, 0]\ncolumn = \"tip_mm\"", "direction = [0, -1]\ncolumn = \"tip_mm\"");
  fit_own_readings(*folder_, "across", toml.substr(0, toml.find("[fit.free.k_cable]")), {0, 5, 8}, 0.02);
  const json scan =
      json::parse(tune({"--stiffness", "1 kN/m", "--no-map", "--json"}, "across").out).at("tuned")[0].at("scan");
  const auto k = [](const json& state) { return state.at("stiffness_N_per_m").get<double>(); };
  double most = 0;
  for (const json& state : scan) most = std::max(most, k(state));
  ASSERT_GT(most, 1.002 * k(scan.front()));
  ASSERT_LT(k(scan.back()), k(scan.front()));
  const double wanted = (k(scan.front()) + most) / 2;
  const Outcome outcome = tune({"--stiffness", fmt::format("{:.8g} N/m", wanted), "--no-map", "--json"}, "across");
  EXPECT_EQ(outcome.code, 0) << outcome.err;
  const json found = json::parse(outcome.out).at("tuned")[0].at("solutions");
  ASSERT_EQ(found.size(), 2u);
  EXPECT_GT(found[0].at("stiffness_slope").get<double>(), 0);
  EXPECT_LT(found[1].at("stiffness_slope").get<double>(), 0);
  EXPECT_LT(found[0].at("value").get<double>(), found[1].at("value").get<double>());
  for (const json& one : found) EXPECT_NEAR(one.at("replayed_N_per_m").get<double>(), wanted, 1e-3 * wanted);
}

TEST_F(Tune, WhatCannotBeReachedIsSaidWithTheRangeThatCan) {
  const Outcome outcome = tune({"--stiffness", "1 N/mm", "--no-map"});
  EXPECT_EQ(outcome.code, 4);
  expect_holds(outcome.out, {"SIMULATED DATA", "retraction from 0 mm to 10 mm", "from 400 N/m to 408 N/m is reachable",
                             "no retraction there gives 1 N/mm"});
}

TEST_F(Tune, OtherDemandsAreSaidAndDecideTheExitCode) {
  const Outcome holds = tune({"--stiffness", "404 N/m", "--also", "tip<1mm", "--no-map"});
  EXPECT_EQ(holds.code, 0);
  expect_holds(holds.out, {"tip<1mm: holds", "replay at ", "404 N/m", "on the path of the bench, from rest"});
  const Outcome fails = tune({"--stiffness", "404 N/m", "--also", "tip > 1 mm", "--no-map"});
  EXPECT_EQ(fails.code, 4);
  expect_holds(fails.out, {"but not as --also demands", "tip > 1 mm: does not hold"});
}

TEST_F(Tune, TheMapIsTheClosedFormWithinItsStatedError) {
  const Outcome outcome = tune({"--stiffness", "404 N/m", "--out", "map"});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const json map = json::parse(text_of(*folder_ / "map/stiffness_map.json"));
  EXPECT_EQ(map.at("data"), "simulated");
  const auto retractions = map.at("control").at("values").get<std::vector<double>>();
  for (size_t i = 0; i < retractions.size(); ++i)
    EXPECT_NEAR(map.at("stiffness_N_per_m")[i][0].get<double>(), stiffness_at(retractions[i], bar(), k_),
                0.03);  // the cable pulls at a point
  // As a controller would: between its nodes, without load.
  const double stated = map.at("interpolation").at("elsewhere").at("largest_relative_error").get<double>();
  EXPECT_LT(stated, 0.03);
  for (const double at : {0.7e-3, 3.4e-3, 4.9e-3, 7.2e-3}) {
    size_t i = 0;
    while (retractions[i + 1] < at) ++i;
    const double t = (at - retractions[i]) / (retractions[i + 1] - retractions[i]);
    const auto k = [&](size_t n) { return std::log(map.at("stiffness_N_per_m")[n][0].get<double>()); };
    const double closed = stiffness_at(at, bar(), k_);
    EXPECT_NEAR(std::exp((1 - t) * k(i) + t * k(i + 1)), closed, (stated + 2e-4) * closed) << at;
  }
  std::istringstream csv(text_of(*folder_ / "map/stiffness_map.csv"));
  std::string line;
  size_t rows = 0;
  while (std::getline(csv, line)) rows += line[0] != '#';
  EXPECT_EQ(rows, 1 + retractions.size() * map.at("load").at("values").size());
  expect_holds(text_of(*folder_ / "map/figures/stiffness_map.svg"), {"SIMULATED DATA", "retraction [mm]", "404 N/m"});
}

TEST_F(Tune, WrongInputIsOneSentence) {
  const auto refuses = [&](const std::vector<std::string>& arguments, const std::vector<std::string>& parts) {
    const Outcome outcome = tune(arguments);
    EXPECT_EQ(outcome.code, 2) << outcome.err;
    expect_holds(outcome.err, parts);
    EXPECT_EQ(std::count(outcome.err.begin(), outcome.err.end(), '\n'), 1) << outcome.err;
  };
  const auto with = [](std::vector<std::string> more) {
    more.insert(more.begin(), {"--stiffness", "404 N/m"});
    return more;
  };
  refuses({}, {"--stiffness is missing", "1 N/mm"});
  refuses({"--stiffness", "1 N"}, {"--stiffness", "not a unit of stiffness"});
  refuses({"--stiffness", "-1 N/mm"}, {"--stiffness", "larger than zero"});
  refuses(with({"--control", "retracton"}), {"--control", "did you mean 'retraction'"});
  refuses(with({"--control", "pull"}), {"--control pull", "the load"});
  refuses(with({"--load", "retraction"}), {"'retraction'", "force or a mass"});
  refuses(with({"--at", "3 mm"}), {"--at", "not a unit of force"});
  refuses(with({"--hold", "pull=1 N"}), {"--hold pull", "--at"});
  refuses(with({"--hold", "pull"}), {"--hold pull", "ID=VALUE"});
  refuses(with({"--also", "tip"}), {"--also tip", "CHANNEL<VALUE"});
  refuses(with({"--also", "tap<1 mm"}), {"--also", "did you mean 'tip'"});
  refuses(with({"--also", "tip<1 N"}), {"--also", "not a unit of length"});
  refuses(with({"--from", "5 mm", "--to", "2 mm"}), {"from 5 mm to 2 mm", "--to"});
}

TEST_F(Tune, ABenchWithoutARetractionHasNothingToTune) {
  folder_->write("beam.toml", replaced(beam_toml, "bench.csv", "beam.csv"));
  folder_->write("beam.csv", beam_csv);
  done_in(*folder_ / "", {"fit", "beam.toml", "--quiet", "--out", "beam", "--no-variants"});
  const Outcome outcome = run_in(*folder_ / "", {"tune", "beam", "--stiffness", "1 N/mm"});
  EXPECT_EQ(outcome.code, 2);
  expect_holds(outcome.err, {"nothing to tune"});
}

/// `taut export --to table`: the same map, with what the channel reads.
TEST_F(Tune, ItsMapIsExportedWithTheDisplacementsOfTheClosedForm) {
  done_in(*folder_ / "", {"export", "run", "--to", "table", "--quiet", "--out", "table"});
  std::istringstream lines(text_of(*folder_ / "table/stiffness_map.csv"));
  int checked = 0;
  for (std::string line; std::getline(lines, line);) {
    if (line.starts_with("#")) continue;
    if (line.starts_with("retraction_m")) {
      EXPECT_TRUE(line.ends_with(",touching,slipped,tip_m")) << line;
      continue;
    }
    std::vector<double> cells;
    std::istringstream row(line);
    for (std::string cell; std::getline(row, cell, ',');) cells.push_back(std::stod(cell));
    ASSERT_EQ(cells.size(), 8u);
    if (cells[1] != 0) continue;
    EXPECT_NEAR(cells[2], stiffness_at(cells[0], bar(), k_), 0.04) << line;
    // The cable pulls at a point, which gives way a little more than the mean of its face.
    const double tip = tip_at(cells[0], bar(), k_);
    EXPECT_NEAR(cells[7], tip, 3e-3 * std::abs(tip) + 1e-12) << line;
    ++checked;
  }
  EXPECT_GE(checked, 9);
}

}  // namespace
}  // namespace taut

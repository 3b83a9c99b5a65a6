#include "calib/studies/planning.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <map>
#include <random>

#include "calib/data/plan.hpp"
#include "calib/fit/gauss_newton.hpp"
#include "calib/fit/goodness_of_fit.hpp"
#include "calib/runs/new_reading.hpp"
#include "calib/runs/open_bench.hpp"
#include "sim/core/dense.hpp"
#include "tests/support/arch.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"

// What to measure next: expected variances and chosen rows against textbooks and against all combinations.
namespace taut {
namespace {

using namespace test;

constexpr double kQuantile = 1.959963984540054;

/// Rows of y = a + b x at these x, each with this sigma; nothing is known before.
PlanTask line_task(const std::vector<double>& x, double sigma) {
  PlanTask task;
  task.known = {Eigen::Matrix2d::Zero()};
  for (const double one : x) {
    const Eigen::Vector2d slopes(1, one);
    PlanRow row;
    row.controls = {one};
    row.information = {slopes * slopes.transpose() / (sigma * sigma)};
    task.rows.push_back(row);
  }
  return task;
}

std::vector<double> x_of(const PlanTask& task, const std::vector<size_t>& rows) {
  std::vector<double> x;
  for (const size_t row : rows) x.push_back(task.rows[row].controls.front());
  return x;
}

TEST(Planning, ASlopeIsKnownBestFromBothEnds) {
  PlanTask task = line_task({-1, -0.5, 0, 0.5, 1}, 0.3);
  task.goal.gradients = {Eigen::Vector2d(0, 1)};
  for (const size_t exhaustive : {0u, 20'000u}) {
    task.exhaustive_up_to = exhaustive;
    for (const int count : {2, 4, 6}) {
      task.count = count;
      const PlanChoice choice = choose_rows(task);
      std::vector<double> expected(static_cast<size_t>(count / 2), -1.0);
      expected.insert(expected.end(), static_cast<size_t>(count / 2), 1.0);
      EXPECT_EQ(x_of(task, choice.rows), expected);
      EXPECT_EQ(choice.exhaustive, exhaustive > 0);
      // sigma^2 / sum (x - mean)^2
      EXPECT_NEAR(widths_after(task, choice.rows).noise, kQuantile * 0.3 / std::sqrt(count), 1e-12);
    }
  }
}

TEST(Planning, AnExtrapolationTakesElfvingsWeights) {
  // From [-1, 1] to x = 3: (x + 1) / (2 x) of the rows at the near end, variance x^2 sigma^2 / n (Elfving 1952).
  PlanTask task = line_task({-1, -0.6, -0.2, 0.2, 0.6, 1}, 0.5);
  task.goal.gradients = {Eigen::Vector2d(1, 3)};
  task.count = 6;
  for (const size_t exhaustive : {0u, 20'000u}) {
    task.exhaustive_up_to = exhaustive;
    const PlanChoice choice = choose_rows(task);
    EXPECT_EQ(x_of(task, choice.rows), (std::vector<double>{-1, -1, 1, 1, 1, 1}));
    EXPECT_NEAR(widths_after(task, choice.rows).noise, kQuantile * 0.5 * 3 / std::sqrt(6.0), 1e-12);
  }
}

TEST(Planning, TheVarianceIsTheMeanOverTheDrawsAndARowThatFailsCountsByItsOdds) {
  PlanTask task;
  const auto number = [](double value) { return Eigen::MatrixXd::Constant(1, 1, value); };
  task.known = {number(4), number(1)};
  task.rows.push_back({{0}, 0, {number(5), number(3)}, 0, ""});
  task.rows.push_back({{1}, 0, {number(8), number(4)}, 0.25, "no equilibrium is found"});
  task.goal = {{Eigen::VectorXd::Constant(1, 2.0), Eigen::VectorXd::Constant(1, 1.0)}, 3};
  const double before = (4.0 / 4 + 1.0 / 1) / 2, one = (4.0 / 9 + 1.0 / 4) / 2,
               both = (4.0 / (4 + 5 + 6) + 1.0 / (1 + 3 + 3)) / 2;
  EXPECT_NEAR(widths_after(task, {}).noise, kQuantile * std::sqrt(before), 1e-12);
  EXPECT_NEAR(widths_after(task, {0}).noise, kQuantile * std::sqrt(one), 1e-12);
  EXPECT_NEAR(widths_after(task, {0, 1}).noise, kQuantile * std::sqrt(both), 1e-12);
  EXPECT_NEAR(widths_after(task, {1, 0}).total, std::hypot(kQuantile * std::sqrt(both), 3), 1e-12);
  // 8 x 0.75 is more than 5; with odds of 1 in 2 it is less.
  task.count = 1;
  EXPECT_EQ(choose_rows(task).rows, std::vector<size_t>{1});
  task.rows[1].fails = 0.5;
  EXPECT_EQ(choose_rows(task).rows, std::vector<size_t>{0});
}

TEST(Planning, AFloorIsNotNarrowed) {
  PlanTask task = line_task({0, 1}, 0.1);
  task.known = {Eigen::Matrix2d::Identity()};
  task.goal = {{Eigen::Vector2d(0, 1)}, 50};
  EXPECT_GT(widths_after(task, {1, 1, 1, 1}).total, 50);
  EXPECT_LT(widths_after(task, {1, 1, 1, 1}).total, std::hypot(50, kQuantile));
  EXPECT_LT(narrowing(task, {1, 1, 1, 1}), 1e-3);
  task.goal.floor = 0;
  EXPECT_GT(narrowing(task, {0, 1, 1, 1}), 0.8);
}

TEST(Planning, SetUpsAreMadeOnceAndHaveToBeWorthTheirTime) {
  PlanTask task = line_task({0, 1, 2}, 1);
  task.known = {Eigen::Matrix2d::Identity() * 0.01};
  task.rows[2].setup = 1;
  task.goal.gradients = {Eigen::Vector2d(0, 1)};
  task.costs = {.setup = 7, .rest = 2, .reading = 1};
  EXPECT_DOUBLE_EQ(minutes_of(task, {0, 1, 1}), 7 + 3 * 3);
  EXPECT_DOUBLE_EQ(minutes_of(task, {0, 2, 1}), 2 * 7 + 3 * 3);
  EXPECT_DOUBLE_EQ(minutes_of(task, {}), 0);
  task.count = 4;
  task.costs.setup = 1000;
  const std::vector<size_t> dear = choose_rows(task).rows;
  EXPECT_DOUBLE_EQ(minutes_of(task, dear), 1000 + 4 * 3);  // all in one set-up
  task.costs.setup = 0;
  const std::vector<size_t> cheap = choose_rows(task).rows;
  EXPECT_EQ(std::ranges::count(cheap, 0u), 2);
  EXPECT_EQ(std::ranges::count(cheap, 2u), 2);
  task.costs.setup = 7;
  task.count.reset();
  task.minutes = 9.9;
  EXPECT_TRUE(choose_rows(task).rows.empty());  // a set-up and a row take 10 minutes
  task.minutes = 22;
  EXPECT_LE(minutes_of(task, choose_rows(task).rows), 22);
  // Two rows at x = 0 and 2 in two set-ups (Sxx = 2) say more than five at 0 and 1 in one (Sxx = 1.2).
  std::vector<size_t> two = choose_rows(task).rows;
  std::ranges::sort(two);
  EXPECT_EQ(x_of(task, two), (std::vector<double>{0, 2}));
}

/// A task of random readings.
PlanTask random_task(std::mt19937& random, size_t rows, int setups) {
  std::normal_distribution<double> normal;
  constexpr int n = 3, draws = 3;
  PlanTask task;
  for (int d = 0; d < draws; ++d) task.known.push_back(Eigen::Matrix3d::Identity() * (0.05 + 0.05 * d));
  for (size_t i = 0; i < rows; ++i) {
    PlanRow row;
    row.setup = static_cast<int>(i) % setups;
    row.fails = i % 4 == 3 ? 0.3 : 0;
    Eigen::Vector3d slopes;
    for (double& one : slopes) one = normal(random);
    for (int d = 0; d < draws; ++d) {
      Eigen::Vector3d there = slopes;
      for (double& one : there) one *= 1 + 0.2 * normal(random);
      row.information.push_back(there * there.transpose());
    }
    task.rows.push_back(row);
  }
  Eigen::VectorXd goal(n);
  for (double& one : goal) one = normal(random);
  task.goal = {std::vector<Eigen::VectorXd>(draws, goal), 0.2};
  return task;
}

/// The formula of widths_after(), by explicit inverses.
double total_by_inverse(const PlanTask& task, const std::vector<size_t>& rows) {
  double variance = 0;
  for (size_t d = 0; d < task.known.size(); ++d) {
    Eigen::Matrix3d information = task.known[d];
    for (const size_t row : rows) information += (1 - task.rows[row].fails) * task.rows[row].information[d];
    const Eigen::Vector3d g = task.goal.gradients[d];
    variance += g.dot(information.inverse() * g) / static_cast<double>(task.known.size());
  }
  return std::hypot(kQuantile * std::sqrt(variance), task.goal.floor);
}

/// The best value of all multisets of exactly three rows, or of up to `most` in a time.
double best_of_all(const PlanTask& task, size_t most) {
  const double before = total_by_inverse(task, {});
  double best = -infinity;
  std::vector<size_t> rows;
  const auto go = [&](auto&& self, size_t first) -> void {
    if (!rows.empty()) {
      const double minutes = minutes_of(task, rows), total = total_by_inverse(task, rows);
      if (task.minutes && minutes <= *task.minutes + 1e-9) best = std::max(best, -total);
      if (!task.minutes && rows.size() == most) best = std::max(best, (before - total) / minutes);
    }
    if (rows.size() == most) return;
    for (size_t row = first; row < task.rows.size(); ++row) {
      rows.push_back(row);
      self(self, row);
      rows.pop_back();
    }
  };
  go(go, 0);
  return best;
}

double value_of(const PlanTask& task, const std::vector<size_t>& rows) {
  const double total = total_by_inverse(task, rows);
  return task.minutes ? -total : (total_by_inverse(task, {}) - total) / minutes_of(task, rows);
}

TEST(Planning, ThreeRowsAreTheBestOfAllMultisetsWithAndWithoutLookingAtAll) {
  std::mt19937 random(3);
  for (int k = 0; k < 60; ++k) {
    PlanTask task = random_task(random, 7, 1 + k % 4);
    task.costs = {.setup = std::vector<double>{0, 3, 20}[static_cast<size_t>(k) % 3], .rest = 1, .reading = 0.5};
    task.count = 3;
    for (const size_t exhaustive : {0u, 20'000u}) {
      task.exhaustive_up_to = exhaustive;
      const PlanChoice choice = choose_rows(task);
      ASSERT_EQ(choice.rows.size(), 3u);
      EXPECT_EQ(choice.exhaustive, exhaustive > 0);
      const double best = best_of_all(task, 3);
      EXPECT_NEAR(value_of(task, choice.rows), best, 1e-9 * best) << k << ", exhaustive up to " << exhaustive;
    }
  }
}

TEST(Planning, WhatFitsIntoATimeIsTheBestOfAllThatDoes) {
  std::mt19937 random(8);
  for (int k = 0; k < 40; ++k) {
    PlanTask task = random_task(random, 6, 1 + k % 3);
    task.costs = {.setup = 3.0 * (k % 4), .rest = 2, .reading = 1};
    task.minutes = task.costs.setup * (1 + k % 2) + 10;  // at most three rows, or six without a second set-up
    task.count = k % 2 == 0 ? std::nullopt : std::optional(3);
    for (const size_t exhaustive : {0u, 20'000u}) {
      task.exhaustive_up_to = exhaustive;
      const PlanChoice choice = choose_rows(task);
      EXPECT_LE(minutes_of(task, choice.rows), *task.minutes);
      const double best = best_of_all(task, task.count ? 3 : 6);
      EXPECT_NEAR(value_of(task, choice.rows), best, 1e-9 * std::abs(best)) << k << ", up to " << exhaustive;
    }
  }
}

TEST(Planning, SetUpsComeOneAfterTheOther) {
  std::mt19937 random(5);
  PlanTask task = random_task(random, 9, 3);
  task.costs.setup = 0.1;
  task.count = 6;
  const std::vector<size_t> rows = choose_rows(task).rows;
  int changes = 1;
  for (size_t i = 1; i < rows.size(); ++i) changes += task.rows[rows[i]].setup != task.rows[rows[i - 1]].setup;
  EXPECT_DOUBLE_EQ(minutes_of(task, rows), 0.1 * changes + 6 * 2);
}

TEST(Planning, TheCheapestRowsAreThoseOfTheFirstSetUp) {
  PlanTask task = line_task({0, 1, 2}, 1);
  task.rows[1].setup = 1;
  EXPECT_EQ(cheapest_rows(task, 13), (std::vector<size_t>{0, 2, 0, 2}));  // 5 + 4 x 2 min
  EXPECT_EQ(cheapest_rows(task, 12.9).size(), 3u);
  EXPECT_TRUE(cheapest_rows(task, 6.9).empty());
}

// ---- what is known before

TEST(Planning, BeforeReadingsThePriorIsAQuarterOfTheRangeOrAFactorOfThree) {
  const TemporaryFolder folder;
  folder.write("bench.csv", "trial,pull_N,tip_mm\na,0.05,\na,0.1,\n");
  const auto bench = [&](const std::string& toml) {
    return open_bench(folder.write("beam.toml", toml), {.readings = Readings::rows_may_be_missing});
  };
  const PlanBelief chosen = belief_before(*bench(beam_toml));
  ASSERT_EQ(chosen.parameters.size(), 1u);
  EXPECT_EQ(chosen.parameters[0].value, 50e3);
  EXPECT_NEAR(chosen.prior_deviations[0], std::log(10e6 / 1e3) / 4, 1e-12);
  EXPECT_NEAR(chosen.covariance(0, 0), std::pow(std::log(10e6 / 1e3) / 4, 2), 1e-12);
  const PlanBelief open = belief_before(*bench(replaced(beam_toml, "lower = \"1 kPa\"\nupper = \"10 MPa\"\n", "")));
  EXPECT_NEAR(open.prior_deviations[0], std::log(3), 1e-12);
  expect_input_error([&] { belief_before(*bench(beam_toml + "\n[fit.free.nu_foam]\nstart = 0.3\n")); },
                     {"[fit.free.nu_foam]: before any reading its bounds say how well it is known"});
  // A shift of its own: a quarter of its range in its own unit.
  const PlanBelief nu =
      belief_before(*bench(beam_toml + "\n[fit.free.nu_foam]\nstart = 0.3\nlower = 0.1\nupper = 0.4\n"));
  EXPECT_NEAR(nu.prior_deviations[1], 0.3 / 4, 1e-12);
}

FitResult fit_of(double E, double deviation) {
  FitResult fit;
  ParameterEstimate& one = fit.parameters.emplace_back();
  one.spec = {"E_foam", "E", "Pa", 1, 1e13, "modulus", true};
  one.value = E;
  one.lower = 1e3;
  one.upper = 10e6;
  fit.covariance = Eigen::MatrixXd::Constant(1, 1, deviation * deviation);
  return fit;
}

TEST(Planning, AfterAFitItsCovarianceCountsWithinTheBounds) {
  const double quarter = std::log(1e4) / 4;
  EXPECT_NEAR(belief_after(fit_of(50e3, 0.02)).covariance(0, 0), 4e-4, 1e-3 * 4e-4);
  // An invisible one is known to a quarter of its range, whatever the fit's deviation is.
  EXPECT_NEAR(belief_after(fit_of(50e3, 100)).covariance(0, 0), quarter * quarter, 1e-3 * quarter * quarter);
}

// ---- rows of a bench

/// The beam with readings, at its start E = 50 kPa.
struct PlannedBeam {
  TemporaryFolder folder;
  std::unique_ptr<Bench> bench;

  PlannedBeam() {
    folder.write("bench.csv", beam_csv);
    bench = open_bench(folder.write("beam.toml", beam_toml));
  }
};

double tip_at(const Bench& bench, double pull, double E) {
  const std::unique_ptr<Bench> there = bench.at_rows({{1, {pull}}});
  Params p = there->protocol().nominal();
  p[there->protocol().parameters().index("E_foam")] = E;
  return there->protocol().predict(p, {}).values[0];
}

TEST(Planning, InformationIsThatOfDifferencesAndThePriorIsAddedToTheReadings) {
  const PlannedBeam beam;
  const PlanBelief belief = belief_after(fit_of(60e3, 0.05));
  PlanQuestion question{{{0.05}, {0.2}}, {0}};
  question.predicted = {0, {0.15}};
  question.draws = 4;
  std::vector<double> asked;  // the values whose sigmas were asked for
  const SigmaOfReading sigma = [&](const BenchReading& at, double value) {
    asked.push_back(value);
    return 1e-4 * (1 + at.controls[0]);
  };
  const PlanKnowledge knowledge = ask_rows(*beam.bench, belief, question, sigma);
  ASSERT_EQ(knowledge.known.size(), 4u);
  for (const double pull : {0.05, 0.1, 0.2}) {
    const double tip = tip_at(*beam.bench, pull, 60e3);
    EXPECT_TRUE(std::ranges::any_of(asked, [&](double value) { return std::abs(value - tip) < 1e-8; })) << pull;
  }
  const auto slope = [&](double pull) {  // by ln E
    return (tip_at(*beam.bench, pull, 60e3 * std::exp(1e-3)) - tip_at(*beam.bench, pull, 60e3 * std::exp(-1e-3))) /
           2e-3;
  };
  for (size_t i = 0; i < 2; ++i) {
    const PlanRow& row = knowledge.candidates[i];
    const double pull = question.rows[i][0], expected = std::pow(slope(pull) / (1e-4 * (1 + pull)), 2);
    EXPECT_NEAR(row.information[0](0, 0), expected, 1e-4 * expected);
    EXPECT_EQ(row.fails, 0);
    EXPECT_EQ(row.setup, 0);  // the load alone is no set-up
  }
  // Two trials of each of two loads, sigma 0.1 mm as the file declares.
  const double readings = 2 * (std::pow(slope(0.05) / 1e-4, 2) + std::pow(slope(0.1) / 1e-4, 2));
  const double prior = std::pow(4 / std::log(1e4), 2);
  EXPECT_NEAR(knowledge.known[0](0, 0), readings + prior, 1e-4 * readings);
  ASSERT_EQ(knowledge.measured.size(), 2u);
  EXPECT_EQ(knowledge.measured[0].controls, std::vector<double>{0.05});
  const double again = std::pow(slope(0.05) / (1e-4 * 1.05), 2);
  EXPECT_NEAR(knowledge.measured[0].information[0](0, 0), again, 1e-4 * again);
  EXPECT_NEAR(knowledge.predicted, tip_at(*beam.bench, 0.15, 60e3), 1e-9);
  EXPECT_NEAR(knowledge.slopes[0][0], slope(0.15), 1e-4 * std::abs(slope(0.15)));
  // Other draws are other parameters, the same for the same seed.
  EXPECT_NE(knowledge.known[1](0, 0), knowledge.known[0](0, 0));
  EXPECT_EQ(ask_rows(*beam.bench, belief, question, sigma).known[3](0, 0), knowledge.known[3](0, 0));
  question.seed = 2;
  EXPECT_NE(ask_rows(*beam.bench, belief, question, sigma).known[3](0, 0), knowledge.known[3](0, 0));
}

TEST(Planning, RowsNearAJumpOrWithTwoEquilibriaFail) {
  const TemporaryFolder folder;
  folder.write("arch.msh", arch_msh());
  folder.write("bench.csv", arch_csv({{4, 0}, {8, 0}}));
  const std::unique_ptr<Bench> bench = open_bench(folder.write("arch.toml", arch_toml));
  FitResult fit = fit_of(1e6, 1e-3);
  fit.parameters[0].spec.id = "E_strip";
  // The arch snaps at 24.3 mN and has another equilibrium from 16 mN on.
  PlanQuestion question{{{8e-3}, {20e-3}, {24e-3}, {28e-3}}, {0}};
  question.draws = 2;
  const PlanKnowledge knowledge =
      ask_rows(*bench, belief_after(fit), question, [](const BenchReading&, double) { return 1e-5; });
  ASSERT_EQ(knowledge.candidates.size(), 4u);
  EXPECT_EQ(knowledge.candidates[0].fails, 0);
  EXPECT_GT(knowledge.candidates[0].information[0](0, 0), 0);
  for (const size_t i : {1u, 2u, 3u}) {
    EXPECT_EQ(knowledge.candidates[i].fails, 1) << i;
    EXPECT_NE(knowledge.candidates[i].why, "") << i;
  }
  EXPECT_NE(knowledge.candidates[1].why.find("another equilibrium"), std::string::npos);
  EXPECT_NE(knowledge.candidates[2].why.find("fold"), std::string::npos);
  EXPECT_NE(knowledge.candidates[3].why.find("jumps to another equilibrium on the way"), std::string::npos);
}

TEST(Planning, RowsToWhichAPathWithRetractionsSlipsAreNamed) {
  const TemporaryFolder folder;
  folder.write("arch.msh", arch_msh());
  folder.write("bench.csv", "push_mN,retraction_mm,drop_mm\n8,0,0\n28,0,0\n");
  const std::string slack_cable = R"([cables]
k = "1 N/m"
slack = "30 mm"
retraction = "retraction_mm"
[[cables.cable]]
id = "idle"
x = ["-20 mm", "50 mm"]
y = ["7 mm", "7 mm"]
)";
  const std::unique_ptr<Bench> bench = open_bench(folder.write("arch.toml", arch_toml + slack_cable));
  const Prediction snapped = bench->protocol().predict(bench->protocol().nominal(), {});
  EXPECT_LT(snapped.values[0], 5e-3);
  EXPECT_GT(snapped.values[1], 5e-3);
  EXPECT_EQ(bench->slipped_rows(), std::vector<int>{1});
}

TEST(Planning, ARowThatFailsInSomeDrawsHasTheOthersMean) {
  const TemporaryFolder folder;
  folder.write("arch.msh", arch_msh());
  folder.write("bench.csv", arch_csv({{1, 0}, {2, 0}}));
  const std::unique_ptr<Bench> bench = open_bench(folder.write("arch.toml", arch_toml));
  FitResult fit = fit_of(1e6, 0.3);
  fit.parameters[0].spec.id = "E_strip";
  PlanQuestion question{{{14e-3}}, {0}};
  question.draws = 8;
  const PlanKnowledge knowledge =
      ask_rows(*bench, belief_after(fit), question, [](const BenchReading&, double) { return 1e-5; });
  const PlanRow& row = knowledge.candidates.front();
  // The other equilibrium begins at about 16 mN x E / 1 MPa, so that softer arches have it.
  EXPECT_GT(row.fails, 0);
  EXPECT_LT(row.fails, 1);
  for (const Eigen::MatrixXd& information : row.information) EXPECT_GT(information(0, 0), 0);
  EXPECT_EQ(std::round(8 * row.fails), 8 * row.fails);
}

TEST(Planning, BenchesOfWhichThereIsNoPlanSayWhy) {
  const TemporaryFolder folder;
  folder.write("bench.csv", beam_csv);
  const auto refuses = [](const Bench& bench, const std::vector<std::string>& parts) {
    expect_input_error([&] { check_can_be_planned(bench); }, parts);
  };
  EXPECT_NO_THROW(check_can_be_planned(*open_bench(folder.write("beam.toml", beam_toml))));
  std::string relaxing = replaced(beam_toml, "nu = 0.3\n", "nu = 0.3\nprony = [{ g = 0.2, tau = \"60 s\" }]\n");
  relaxing = replaced(relaxing, "file = \"bench.csv\"", "file = \"bench.csv\"\ndwell = \"60 s\"\nrest = \"180 s\"");
  refuses(*open_bench(folder.write("relaxing.toml", relaxing)), {"relaxing.toml", "depends on the rows before them"});
  refuses(*open_bench(TAUT_SOURCE_DIR "/experiments/foam_point/experiment.toml"), {"a material point", "at rest"});
}

TEST(Planning, ANewReadingScattersAsDeclaredElseAsThoseOfTheRunDidNearItsLoad) {
  const TemporaryFolder folder;
  folder.write("bench.csv", "trial,pull_N,tip_mm,sigma_mm\na,0.05,1,0.1\na,0.1,2,0.2\nb,0.05,1,0.3\nb,0.1,2,0.2\n");
  const std::string listed = replaced(beam_toml, "trial = \"trial\"", "trial = \"trial\"\nsigma = \"sigma_mm\"");
  const std::unique_ptr<Bench> bench = open_bench(folder.write("beam.toml", listed));
  RunRecord record;
  record.load_control = 0;
  for (const BenchReading& reading : bench->readings()) {
    record.readings.emplace_back();
    record.readings.back().channel = "tip";
    record.readings.back().sigma = reading.sigma;
    record.load_newtons.push_back(*reading.load_newtons);
  }
  const auto sigma_at_pull = [&](double pull) {
    BenchReading at;
    at.controls = {pull};
    return sigma_of_new_reading(record, *bench, at, 1e-3);
  };
  const double low = std::sqrt((0.1 * 0.1 + 0.3 * 0.3) / 2) * 1e-3, high = 0.2e-3;
  EXPECT_NEAR(sigma_at_pull(0.01), low, 1e-12);
  EXPECT_NEAR(sigma_at_pull(0.0625), 0.75 * low + 0.25 * high, 1e-12);
  EXPECT_NEAR(sigma_at_pull(3), high, 1e-12);
  BenchReading at;
  at.controls = {0.05};
  EXPECT_NEAR(sigma_of_new_reading(*bench, at, 1e-3), 1e-4, 1e-12);  // the instrument's, where no run says more
  const std::string unsaid = replaced(listed, "noise = { absolute = \"0.1 mm\" }\n", "");
  const std::unique_ptr<Bench> silent = open_bench(folder.write("silent.toml", unsaid));
  expect_input_error([&] { sigma_of_new_reading(*silent, at, 1e-3); }, {"silent.toml", "'sigma_mm'", "noise"});
  const std::unique_ptr<Bench> declared = open_bench(TAUT_SOURCE_DIR "/experiments/foam_cantilever/experiment.toml");
  const double noise = declared->experiment().channels.empty() ? 0 : *declared->declared_sigma(0, 2e-3);
  at.controls = declared->readings().front().controls;
  EXPECT_EQ(sigma_of_new_reading(record, *declared, at, 2e-3), noise);
}

// ---- the module

/// Readings of a replay's rows: of each the row, and the standard deviation.
using Sampled = std::vector<Measurement>;

/// Where least squares of readings with this noise end, by Gauss-Newton steps from the truth.
Params refitted(Protocol& protocol, const Prediction& exact, const Params& truth,
                const std::vector<FreeParameter>& free, Sampled readings, const std::vector<double>& noise) {
  for (size_t i = 0; i < readings.size(); ++i)
    readings[i].value = exact.values[readings[i].row] + readings[i].sigma * noise[i];
  Params p = truth;
  Prediction at = exact;
  for (int k = 0; k < 6; ++k) {
    const Eigen::VectorXd step = gauss_newton_step(at, readings, protocol.parameters(), p, free);
    double largest = 0;
    for (size_t j = 0; j < free.size(); ++j) {
      const bool logarithmic = protocol.parameters()[free[j].index].logarithmic;
      const double change = step[static_cast<Eigen::Index>(j)];
      p[free[j].index] = logarithmic ? p[free[j].index] * std::exp(change) : p[free[j].index] + change;
      largest = std::max(largest, std::abs(change) / (logarithmic ? 1 : 1e-3));
    }
    if (largest < 1e-3) break;
    at = protocol.predict(p, indices_of(free));
    EXPECT_TRUE(at.complete());
  }
  return p;
}

/// The shipped module of linear elements, as a fit of its readings that ended here would have it.
struct PlannedModule {
  std::unique_ptr<Bench> bench;
  std::vector<FreeParameter> free;
  Params truth;
  FitResult fit;

  PlannedModule() {
    Experiment e = read_experiment(TAUT_SOURCE_DIR "/experiments/push_puppet/experiment.toml");
    e.mesh.order = 1;
    bench = open_bench(e);
    const std::map<std::string, double> values{
        {"E_foam", 61e3}, {"E_plastic", 3.2e9}, {"k_cable", 17e3}, {"slack", 0.29e-3}};
    Protocol& own = bench->protocol();
    free = bench->free();
    truth = own.nominal();
    Eigen::VectorXd scales(4);
    for (size_t j = 0; j < free.size(); ++j) {
      ParameterEstimate& estimate = fit.parameters.emplace_back();
      estimate.spec = own.parameters()[free[j].index];
      estimate.value = free[j].start = truth[free[j].index] = values.at(estimate.spec.id);
      estimate.lower = free[j].lower;
      estimate.upper = free[j].upper;
      scales[static_cast<Eigen::Index>(j)] = estimate.spec.logarithmic ? estimate.value : 1;
    }
    const Prediction there = own.predict(truth, indices_of(free));
    const Eigen::MatrixXd J = noise_scaled(there, bench->measurements()).jacobian * scales.asDiagonal();
    fit.covariance = *solve_positive_definite(J.transpose() * J, Eigen::MatrixXd::Identity(4, 4));
  }

  SigmaOfReading sigma() const {
    return [this](const BenchReading& at, double value) { return *bench->declared_sigma(at.channel, value); };
  }
};

TEST(SlowPlanning, ThePlasticOfTheModuleIsSeenFromWhereTheLipsMeet) {
  const PlannedModule module;
  PlanQuestion question;
  for (const double retraction : {0.0, 6e-3, 12e-3}) question.rows.push_back({0.05, retraction});
  question.channels = {0};
  question.draws = 1;
  const PlanBelief belief = belief_after(module.fit);
  const PlanKnowledge knowledge = ask_rows(*module.bench, belief, question, module.sigma());
  const PlanGoal goal = goal_of_parameter(belief, 1, 1, 0);
  const std::vector<PlanReach> found =
      where_seen(*module.bench, belief, question, module.sigma(), knowledge, goal, 4, 0.05);
  const auto reach = std::ranges::find(found, 1u, &PlanReach::control);
  ASSERT_NE(reach, found.end());
  EXPECT_TRUE(reach->above);
  // Gaps of 17.0 mm in all, and 0.29 mm of slack, close between these; the barrier begins a little before.
  EXPECT_GT(reach->controls[1], 16.8e-3);
  EXPECT_LT(reach->controls[1], 17.4e-3);
  EXPECT_EQ(reach->touching, std::optional(true));
  EXPECT_EQ(reach->touching_before, std::optional(false));
}

TEST(SlowPlanning, TheProposedRowsNarrowTheCableOfTheModuleTwiceAsMuchAsTheCheapestOnes) {
  const PlannedModule module;
  const std::unique_ptr<Bench>& bench = module.bench;
  const std::vector<FreeParameter>& free = module.free;
  const Params& truth = module.truth;
  PlanQuestion question;
  for (const double retraction : {0.0, 4.42e-3, 8.84e-3, 13.3e-3, 17.68e-3}) {
    for (const double mass : {0.05, 0.162, 0.275, 0.388, 0.5}) question.rows.push_back({mass, retraction});
  }
  ASSERT_EQ(bench->controls().front().id, "mass");
  question.channels = {0};
  const PlanBelief belief = belief_after(module.fit);
  const PlanKnowledge knowledge = ask_rows(*bench, belief, question, module.sigma());
  PlanTask task{knowledge.known, knowledge.candidates, goal_of_parameter(belief, 2, knowledge.known.size(), 0)};
  task.count = 4;
  const PlanChoice plan = choose_rows(task);
  PlanTask again = task;
  again.rows = knowledge.measured;
  const std::vector<size_t> cheapest = cheapest_rows(again, 13);
  ASSERT_EQ(cheapest.size(), 4u);

  // All rows of the bench, and those of the plan, in one replay.
  std::vector<LoadRow> lines;
  const auto line_of = [&](const std::vector<double>& controls) {
    const auto found = std::ranges::find(lines, controls, &LoadRow::controls);
    if (found != lines.end()) return found->line;
    lines.push_back({static_cast<int>(lines.size()) + 1, controls});
    return lines.back().line;
  };
  std::vector<int> base, planned, repeated;
  for (const BenchReading& reading : bench->readings()) base.push_back(line_of(reading.controls));
  for (const size_t row : plan.rows) planned.push_back(line_of(task.rows[row].controls));
  for (const size_t row : cheapest) repeated.push_back(line_of(again.rows[row].controls));
  const std::unique_ptr<Bench> all = bench->at_rows(lines);
  Protocol& protocol = all->protocol();
  const Prediction exact = protocol.predict(truth, indices_of(free));
  ASSERT_TRUE(exact.complete());
  const auto sampled = [&](std::vector<int> more) {
    Sampled readings;
    more.insert(more.begin(), base.begin(), base.end());
    for (const int line : more) {
      const BenchReading& reading = *std::ranges::find(all->readings(), line, &BenchReading::line);
      readings.push_back({reading.row, 0, *bench->declared_sigma(0, exact.values[reading.row]), reading.row});
    }
    return readings;
  };
  const Sampled without = sampled({}), with_plan = sampled(planned), with_repeats = sampled(repeated);
  std::mt19937 random(11);
  std::normal_distribution<double> normal;
  constexpr int sets = 50;
  const int k = protocol.parameters().index("k_cable");
  std::array<double, 3> squares{};
  for (int set = 0; set < sets; ++set) {
    std::vector<double> noise(base.size() + 4);  // the same for all three as far as they share readings
    for (double& one : noise) one = normal(random);
    size_t i = 0;
    for (const Sampled* readings : {&without, &with_repeats, &with_plan}) {
      const Params p = refitted(protocol, exact, truth, free, *readings, noise);
      squares[i++] += std::pow(std::log(p[k] / truth[k]), 2) / sets;
    }
  }
  const double before = std::sqrt(squares[0]), repeats = std::sqrt(squares[1]), after = std::sqrt(squares[2]);
  const auto expected = [&](const PlanTask& of, const std::vector<size_t>& rows) {
    return widths_after(of, rows).noise / kQuantile / truth[k];
  };
  std::printf("scatter of ln k_cable: %.4f, with the cheapest rows again %.4f, with the plan %.4f\n", before, repeats,
              after);
  std::printf("expected:              %.4f, with the cheapest rows again %.4f, with the plan %.4f\n",
              expected(task, {}), expected(again, cheapest), expected(task, plan.rows));
  for (const size_t row : plan.rows)
    std::printf("  retraction %.2f mm, mass %.0f g\n", 1e3 * task.rows[row].controls[1],
                1e3 * task.rows[row].controls[0]);
  // A deviation of 50 numbers is known to 10 %.
  EXPECT_NEAR(before, expected(task, {}), 0.25 * before);
  EXPECT_NEAR(repeats, expected(again, cheapest), 0.25 * repeats);
  EXPECT_NEAR(after, expected(task, plan.rows), 0.25 * after);
  EXPECT_GE(expected(task, {}) - expected(task, plan.rows), 2 * (expected(task, {}) - expected(again, cheapest)));
  EXPECT_GE(before - after, 2 * (before - repeats));
}

// ---- the file of a plan

TEST(PlanFile, HasTheColumnsOfTheBenchAndIsReadAgain) {
  BenchFormat format;
  const TemporaryFolder folder;
  format.path = folder / "next.csv";
  format.trial_column = "trial";
  format.controls = {{"retraction", "winch (mm)", {Quantity::length}, false},
                     {"mass", "mass_g", {Quantity::mass}, false}};
  format.channels = {{"tip", "tip_mm", Quantity::length, {1e-4}}, {"side", "side, left_mm", Quantity::length, {1e-4}}};
  const std::vector<RowToMeasure> rows{{"4", {0.01768, 0.5}}, {"5", {0.01768, 0.1625}}};
  const std::string csv = plan_csv(format, rows);
  EXPECT_EQ(csv, "trial,winch (mm),mass_g,tip_mm,\"side, left_mm\"\n4,17.68,500,,\n5,17.68,162.5,,\n");
  folder.write("next.csv", csv);
  const std::optional<Trials> read = read_plan(format, "", true);
  ASSERT_TRUE(read);
  ASSERT_EQ(read->readings.size(), 4u);
  EXPECT_EQ(read->readings[2].trial, "5");
  EXPECT_NEAR(read->readings[2].controls[1], 0.1625, 1e-12);
  EXPECT_EQ(read_load_rows(format, format.path).size(), 2u);
}

TEST(PlanFile, OfALongFileHasALineForEachLabel) {
  BenchFormat format;
  format.path = "next.csv";
  format.order_column = "order";
  format.controls = {{"pull", "pull", {Quantity::force}, false},
                     {"how", "how", {Quantity::pure}, false, {"up", "down"}}};
  format.channels = {{"m1_x", "x_mm", Quantity::length, {1e-4}, "m1"},
                     {"m1_y", "y_mm", Quantity::length, {1e-4}, "m1"},
                     {"m2_x", "x_mm", Quantity::length, {1e-4}, "m2"}};
  format.channel_column = "marker";
  EXPECT_EQ(plan_csv(format, {{"", {2.5e-3, 2}}}, {{"marker", "marker"}, {"pull", "pull [mN]"}}),
            "marker,pull [mN],order,how,x_mm,y_mm\nm1,2.5,1,down,,\nm2,2.5,1,down,,\n");
  expect_input_error([&] { plan_csv(format, {{"", {1, 1}}}); }, {"next.csv, control 'pull'"});
}

}  // namespace
}  // namespace taut

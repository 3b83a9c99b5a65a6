#include "calib/studies/planning.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "calib/data/plan.hpp"
#include "calib/runs/open_bench.hpp"
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
  EXPECT_NEAR(widths_after(task, {1, 1, 1, 1}).total, 50, 1e-2);
  EXPECT_LT(narrowing(task, {1, 1, 1, 1}), 1e-3);
  task.goal.floor = 0;
  EXPECT_GT(narrowing(task, {0, 1, 1, 1}), 0.9);
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
  EXPECT_EQ(choose_rows(task).rows.size(), 5u);  // five rows of one set-up
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
  const SigmaOfReading sigma = [](const BenchReading& at, double value) {
    EXPECT_NEAR(value, at.controls[0] < 0.1 ? 1.7e-3 : 7e-3, 5e-3);
    return 1e-4 * (1 + at.controls[0]);
  };
  const PlanKnowledge knowledge = ask_rows(*beam.bench, belief, question, sigma);
  ASSERT_EQ(knowledge.known.size(), 4u);
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
  EXPECT_NE(knowledge.candidates[3].why.find("slips"), std::string::npos);
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

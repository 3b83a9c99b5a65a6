#include "calib/fit/explanations.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <random>

#include "calib/fit/goodness_of_fit.hpp"
#include "sim/core/dense.hpp"

// Against linear models, whose fit with one unknown more is known in closed form.
namespace taut::test {
namespace {

Eigen::MatrixXd inverse_of(const Eigen::MatrixXd& A) {
  return *solve_positive_definite(A, Eigen::MatrixXd::Identity(A.rows(), A.cols()));
}

/// Drops y = m (1 - 0.8 R / R_max) / E + c m^2 at four masses, three retractions and three trials, and their fit.
struct LinearBench {
  ExplainedReadings detail;
  std::vector<Measurement> measurements;
  Prediction prediction;
  FitResult fit;
  Eigen::MatrixXd slopes;  ///< of E (of its logarithm) and c, if that is free, over sigma

  double E = 2, c = 0.01;
  bool with_c;

  explicit LinearBench(unsigned seed, bool c_is_free = false, double noise = 1) : with_c(c_is_free) {
    detail.channels = {{"tip", "m"}};
    detail.controls = {{"mass", "kg"}, {"retraction", "m"}};
    detail.load = 0;
    std::mt19937 random(seed);
    std::normal_distribution<double> normal;
    int line = 2;
    for (const double retraction : {0.0, 0.5, 1.0}) {
      for (const double mass : {1.0, 2.0, 4.0, 8.0}) {
        for (const char* trial : {"a", "b", "c"}) {
          Reading reading{line++, trial, {mass, retraction}, 0, 0, 0.01};
          reading.value = at(reading) + noise * reading.sigma * normal(random);
          detail.readings.push_back(reading);
        }
      }
    }
  }

  double at(const Reading& r) const {
    const double m = r.controls[0];
    return m * (1 - 0.8 * r.controls[1]) / E + c * m * m;
  }

  /// Row by row: the model with its derivatives at the parameters of least squares, found here by Newton's method.
  void solve() {
    for (int iteration = 0; iteration < 20; ++iteration) {
      evaluate();
      const NoiseScaled scaled = noise_scaled(prediction, measurements);
      slopes = scaled.jacobian.leftCols(with_c ? 2 : 1);
      slopes.col(0) *= E;
      const Eigen::VectorXd step = -least_squares(slopes, scaled.residuals);
      E *= std::exp(step[0]);
      if (with_c) c += step[1];
    }
    evaluate();
    fit.chi_squared = residuals().squaredNorm();
    fit.covariance = inverse_of(slopes.transpose() * slopes);
    fit.dof = static_cast<int>(measurements.size() - static_cast<size_t>(slopes.cols()));
    ParameterEstimate modulus, curvature;
    modulus.spec = {"E", "E", "Pa", 0, 1e3, "", true};
    modulus.value = E;
    modulus.lower = 1e-3;
    modulus.upper = 1e3;
    curvature.spec = {"c", "c", "1", -1, 1, "", false};
    curvature.value = c;
    curvature.lower = -1;
    curvature.upper = 1;
    fit.parameters = {modulus};
    if (with_c) fit.parameters.push_back(curvature);
  }

  Eigen::VectorXd residuals() const { return -noise_scaled(prediction, measurements).residuals; }

  std::vector<Explanation> explanations() {
    solve();
    return explain_misfit(detail, prediction, measurements, fit);
  }

 private:
  void evaluate() {
    measurements.clear();
    const auto n = static_cast<Eigen::Index>(detail.readings.size());
    prediction.values.resize(n);
    prediction.derivatives.resize(n, with_c ? 4 : 3);
    for (Eigen::Index i = 0; i < n; ++i) {
      const Reading& r = detail.readings[static_cast<size_t>(i)];
      const double m = r.controls[0], R = r.controls[1];
      measurements.push_back({static_cast<int>(i), r.value, r.sigma, static_cast<int>(i)});
      prediction.values[i] = at(r);
      Eigen::VectorXd row(prediction.derivatives.cols());
      if (with_c) {
        row << -m * (1 - 0.8 * R) / (E * E), m * m, (1 - 0.8 * R) / E + 2 * c * m, -0.8 * m / E;
      } else {
        row << -m * (1 - 0.8 * R) / (E * E), (1 - 0.8 * R) / E + 2 * c * m, -0.8 * m / E;
      }
      prediction.derivatives.row(i) = row.transpose();
    }
  }
};

const Explanation& named(const std::vector<Explanation>& all, const std::string& name) {
  for (const Explanation& e : all) {
    if (e.name == name) return e;
  }
  ADD_FAILURE() << name << " is not there";
  return all.front();
}

/// The explanation is what a full least-squares solve with these columns finds: r = J d + A b.
void expect_full_solve(LinearBench& bench, const Explanation& found, const Eigen::MatrixXd& A) {
  Eigen::MatrixXd all(A.rows(), bench.slopes.cols() + A.cols());
  all << bench.slopes, A;
  const Eigen::VectorXd r = bench.residuals(), x = least_squares(all, r);
  const Eigen::MatrixXd covariance = inverse_of(all.transpose() * all);
  EXPECT_NEAR(found.chi_squared, (r - all * x).squaredNorm(), 1e-8) << found.what;
  EXPECT_NEAR(found.fall, bench.fit.chi_squared - found.chi_squared, 1e-8) << found.what;
  EXPECT_EQ(found.dof, bench.fit.dof - static_cast<int>(A.cols())) << found.what;
  ASSERT_EQ(found.values.size(), static_cast<size_t>(A.cols())) << found.what;
  for (Eigen::Index k = 0; k < A.cols(); ++k) {
    const Eigen::Index at = bench.slopes.cols() + k;
    EXPECT_NEAR(found.values[static_cast<size_t>(k)], x[at], 1e-8 * (1 + std::abs(x[at]))) << found.what;
    EXPECT_NEAR(found.standard_errors[static_cast<size_t>(k)], std::sqrt(covariance(at, at)), 1e-8) << found.what;
  }
  EXPECT_NEAR(found.shifts[0], bench.E / (1 - x[0]) - bench.E, 1e-8 * bench.E)
      << found.what << ": to first order in 1/E";
  if (bench.with_c) {
    EXPECT_NEAR(found.shifts[1], x[1], 1e-10) << found.what;
  }
}

Eigen::MatrixXd column(const LinearBench& bench, const std::function<double(const Reading&, double)>& of) {
  Eigen::VectorXd values(static_cast<Eigen::Index>(bench.detail.readings.size()));
  for (Eigen::Index i = 0; i < values.size(); ++i) {
    const Reading& r = bench.detail.readings[static_cast<size_t>(i)];
    values[i] = of(r, bench.prediction.values[i]) / r.sigma;
  }
  return values;
}

TEST(Explanations, AreWhatAFullLeastSquaresSolveWithTheirColumnsFinds) {
  LinearBench bench(1, true);
  for (Reading& r : bench.detail.readings) r.value += 0.02;
  bench.detail.readings[7].value += 0.3;
  const std::vector<Explanation> all = bench.explanations();
  const auto one = [](const Reading&, double) { return 1.0; };
  const auto of_trial = [](const Reading& r, double y) { return (r.trial[0] - 'a') * y; };
  const auto of_line_9 = [](const Reading& r, double) { return r.line == 9 ? 1.0 : 0.0; };
  const auto of_row = [](const Reading& r, double y) { return (r.line - 2) / 35.0 * y; };
  expect_full_solve(bench, named(all, "a zero error of 'tip'"), column(bench, one));
  expect_full_solve(bench, named(all, "a drift from trial to trial"), column(bench, of_trial));
  expect_full_solve(bench, named(all, "a drift over the rows of the file"), column(bench, of_row));
  expect_full_solve(bench, named(all, "line 9 alone being off"), column(bench, of_line_9));
  Eigen::MatrixXd per_retraction(36, 3);
  for (int k = 0; k < 3; ++k)
    per_retraction.col(k) = column(bench, [&](const Reading& r, double) { return r.controls[1] == 0.5 * k; });
  expect_full_solve(bench, named(all, "a zero error of 'tip' for each 'retraction'"), per_retraction);
  const auto retraction = [&](const Reading& r, double) { return -0.8 * r.controls[0] / bench.E; };
  expect_full_solve(bench, named(all, "a zero error of 'retraction'"), column(bench, retraction));
  const auto law = [&](const Reading& r, double) {
    return -r.controls[0] * (1 - 0.8 * r.controls[1]) / bench.E * r.controls[0] / 8;
  };
  expect_full_solve(bench, named(all, "E that changes with 'mass' (another law?)"), column(bench, law));
}

TEST(Explanations, ExchangedLinesAreWhatAFullSolveWithTheExchangedReadingsFinds) {
  LinearBench bench(2, true);
  for (Reading& r : bench.detail.readings) r.sigma = 0.005 + 0.01 * r.value;
  std::swap(bench.detail.readings[4].value, bench.detail.readings[20].value);
  std::swap(bench.detail.readings[4].sigma, bench.detail.readings[20].sigma);
  const std::vector<Explanation> all = bench.explanations();
  const Explanation& found = all.front();
  EXPECT_EQ(found.name, "lines 6 and 22 exchanged");
  EXPECT_EQ(found.lines, (std::vector<int>{6, 22}));
  EXPECT_LT(found.p_value, 1e-3);
  EXPECT_EQ(found.dof, bench.fit.dof);
  std::swap(bench.measurements[4].value, bench.measurements[20].value);
  std::swap(bench.measurements[4].sigma, bench.measurements[20].sigma);
  const NoiseScaled turned = noise_scaled(bench.prediction, bench.measurements);
  Eigen::MatrixXd J = turned.jacobian.leftCols(2);
  J.col(0) *= bench.E;
  const Eigen::VectorXd x = least_squares(J, -turned.residuals);
  EXPECT_NEAR(found.chi_squared, (turned.residuals + J * x).squaredNorm(), 1e-7);
  EXPECT_NEAR(found.shifts[0], bench.E / (1 - x[0]) - bench.E, 1e-8);
  EXPECT_NEAR(found.shifts[1], x[1], 1e-10);
}

TEST(Explanations, EachIsNamedFirstWhereItIsTheFault) {
  const std::map<std::string, std::function<void(Reading&)>> faults{
      {"a zero error of 'tip'", [](Reading& r) { r.value += 0.04; }},
      {"a drift from trial to trial", [](Reading& r) { r.value *= 1 + 0.03 * (r.trial[0] - 'a'); }},
      {"a zero error of 'retraction'", [](Reading& r) { r.value -= 0.03 * 0.8 * r.controls[0] / 2; }},
      {"line 16 alone being off", [](Reading& r) { r.value *= r.line == 16 ? 10 : 1; }},
      {"another E at each 'retraction'", [](Reading& r) {
         if (r.controls[1] == 0.5) r.value += 0.06 * r.controls[0] * 0.6 / 2;
       }}};
  for (const auto& [name, fault] : faults) {
    LinearBench bench(3);
    for (Reading& r : bench.detail.readings) fault(r);
    const std::vector<Explanation> told = telling(bench.explanations());
    ASSERT_FALSE(told.empty()) << name;
    // What gives in proportion to the load is here what a retraction's zero error does.
    const bool with_another = std::ranges::find(told.front().like, name) != told.front().like.end();
    EXPECT_TRUE(told.front().name == name || with_another) << name << " is told as " << told.front().what;
    EXPECT_LE(told.size(), 5u);
    if (name.starts_with("line 16")) {
      EXPECT_NE(told.front().what.find("larger by 10: a slipped decimal"), std::string::npos) << told.front().what;
    }
    if (name.starts_with("a zero error of 'tip'")) {
      EXPECT_NEAR(told.front().values.front(), 0.04, 3 * told.front().standard_errors.front());
      EXPECT_NEAR(bench.E + told.front().shifts.front(), 2, 0.02) << "E without the zero error";
    }
  }
}

TEST(Explanations, OfCleanReadingsNothingIsToldAndPValuesCountAllThatWasTried) {
  int told = 0, small = 0;
  constexpr int draws = 300;
  for (unsigned seed = 100; seed < 100 + draws; ++seed) {
    const std::vector<Explanation> all = LinearBench(seed).explanations();
    told += !telling(all).empty();
    small += all.front().p_value < 0.05;
  }
  EXPECT_LE(told, 2);
  EXPECT_LE(small, 0.08 * draws) << "5 % are expected at most";
  EXPECT_GT(small, 0) << "or the correction is far too large";
}

TEST(Explanations, NoiseLargerThanDeclaredIsExplainedByNothing) {
  int told = 0;
  for (unsigned seed = 500; seed < 600; ++seed) told += !telling(LinearBench(seed, false, 3).explanations()).empty();
  EXPECT_LE(told, 2);
}

TEST(Explanations, WhatAFreeParameterMakesUpForIsSaid) {
  LinearBench bench(4, true);
  for (Reading& r : bench.detail.readings)
    r.value = LinearBench(4, true, 0).at({0, "", {1.03 * r.controls[0], r.controls[1]}, 0, 0, 0});
  const std::vector<Explanation> all = bench.explanations();
  EXPECT_TRUE(telling(all).empty()) << "masses that are 3 % heavier than written are another E and c";
  const Explanation& mass = named(all, "a scale error of 'mass' (or another g)");
  EXPECT_EQ(mass.like_parameters, (std::vector<std::string>{"E", "c"}));
  EXPECT_EQ(mass.p_value, 1);
}

TEST(Explanations, ThoseThatAreParallelAreToldTogether) {
  LinearBench bench(5);
  // One retraction is a scale of its own: with two of them a zero and a scale error of it are the same.
  for (Reading& r : bench.detail.readings) {
    r.controls[1] = r.controls[1] > 0 ? 1.0 : 0.0;
    r.value = bench.at(r);
  }
  for (Reading& r : bench.detail.readings) r.value -= r.controls[1] * 0.05 * r.controls[0];
  const std::vector<Explanation> all = bench.explanations(), told = telling(all);
  ASSERT_FALSE(told.empty());
  EXPECT_FALSE(told.front().like.empty());
  for (const Explanation& e : told) {
    for (const std::string& other : e.like)
      EXPECT_TRUE(std::ranges::none_of(told, [&](const Explanation& t) { return t.name == other; })) << other;
  }
}

TEST(Explanations, NeedDegreesOfFreedom) {
  LinearBench bench(6);
  bench.solve();
  EXPECT_FALSE(explain_misfit(bench.detail, bench.prediction, bench.measurements, bench.fit).empty());
  bench.fit.dof = 0;
  EXPECT_TRUE(explain_misfit(bench.detail, bench.prediction, bench.measurements, bench.fit).empty());
}

TEST(Explanations, AParameterAtABoundThatHoldsItDoesNotMove) {
  LinearBench bench(7, true);
  for (Reading& r : bench.detail.readings) r.value += 0.04;
  bench.solve();
  bench.fit.parameters[1].upper = bench.c;
  bool up_moves = true, down_moves = false;
  for (const double by : {1.0, -1.0}) {
    std::vector<Measurement> moved = bench.measurements;
    for (size_t i = 0; i < moved.size(); ++i)
      moved[i].value += by * 1e-3 * std::pow(bench.detail.readings[i].controls[0], 2);
    const auto all = explain_misfit(bench.detail, bench.prediction, moved, bench.fit);
    const double shift = named(all, "a zero error of 'tip'").shifts[1];
    (by > 0 ? up_moves : down_moves) = shift != 0;
  }
  EXPECT_FALSE(up_moves);
  EXPECT_TRUE(down_moves);
}

}  // namespace
}  // namespace taut::test

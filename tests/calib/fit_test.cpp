#include "calib/fit/fit.hpp"

#include <gtest/gtest.h>

#include <random>

#include "calib/benches/static_protocol.hpp"
#include "sim/mesh/structured.hpp"
#include "sim/mesh/weights.hpp"
#include "tests/support/closed_form_protocol.hpp"
#include "tests/support/message.hpp"

namespace taut {
namespace {

using namespace test;

constexpr double kZ95 = 1.959963984540054;

/// Both parameters of the stiffening spring, E 1000 Pa and c 0.01 in truth.
std::vector<FreeParameter> spring_parameters(double E = 500, double c = 0.03) {
  return {{0, E, 10, 1e5}, {1, c, 0.001, 0.1}};
}

/// Ends far below what noise would let one see, for comparisons with exact answers.
FitOptions precise() {
  FitOptions options;
  options.tolerance = 1e-15;
  return options;
}

Eigen::VectorXd values_of(ClosedFormProtocol& protocol) {
  return protocol.predict(protocol.nominal(), {}).values;
}

// ---- what a fit finds

TEST(Fit, WithoutNoiseTheTruthIsRecoveredExactly) {
  for (const auto& [E, c] : {std::pair{500.0, 0.03}, {2500.0, 0.02}, {120.0, 0.004}}) {
    ClosedFormProtocol protocol = stiffening_spring();
    const FitResult result = fit(protocol, measured(values_of(protocol), 1e-5), spring_parameters(E, c));
    EXPECT_EQ(result.status, FitStatus::converged) << result.message;
    EXPECT_NEAR(result.parameters[0].value, 1000, 1e-5);
    EXPECT_NEAR(result.parameters[1].value, 0.01, 1e-10);
    EXPECT_LT(result.chi_squared, 1e-8);
    EXPECT_EQ(result.p[0], result.parameters[0].value);
    EXPECT_EQ(result.p[1], result.parameters[1].value);
    EXPECT_EQ(result.dof, 3);
    EXPECT_NEAR(result.chi_squared_p, 1, 1e-6);
    EXPECT_EQ(result.failed_evaluations, 0);
    EXPECT_GT(result.evaluations, 2);
    EXPECT_LT(result.evaluations, 30);
  }
}

TEST(Fit, TheHistoryHasChiSquaredOfEveryEvaluationFromTheStartToTheColdReplay) {
  ClosedFormProtocol protocol = stiffening_spring();
  const Eigen::VectorXd y = values_of(protocol) + 1e-5 * Eigen::VectorXd::Unit(5, 2);
  const FitResult result = fit(protocol, measured(y, 1e-5), spring_parameters());
  ASSERT_EQ(static_cast<int>(result.history.size()), result.evaluations);
  EXPECT_NEAR(result.history.front().values.at(0), 500, 1e-10);
  EXPECT_EQ(result.history.front().values.at(1), 0.03);
  EXPECT_EQ(result.history.front().phase, "search");
  EXPECT_EQ(result.history.back().phase, "cold replay");
  for (const SearchStep& step : result.history) {
    double expected = 0;
    for (Eigen::Index i = 0; i < 5; ++i)
      expected += std::pow((y[i] - step.values[1] * std::asinh(1e3 * spring_loads[i] / step.values[0])) / 1e-5, 2);
    EXPECT_NEAR(step.chi_squared, expected, 1e-9 * expected + 1e-9);
  }
  EXPECT_EQ(result.history.back().chi_squared, result.chi_squared);
  // Where the simulation fails there is a point without a value.
  protocol.fails = [&](const Params& p) { return p[0] > 900 && protocol.calls < 4 ? "it failed" : ""; };
  protocol.calls = 0;
  const FitResult failing = fit(protocol, measured(y, 1e-5), spring_parameters());
  const auto failed =
      std::ranges::count_if(failing.history, [](const SearchStep& s) { return std::isnan(s.chi_squared); });
  EXPECT_GT(failed, 0);
  EXPECT_EQ(failed, failing.failed_evaluations);
}

TEST(Fit, ParametersThatAreNotFreeKeepTheirNominalValues) {
  ClosedFormProtocol protocol = stiffening_spring();
  const Eigen::VectorXd y = values_of(protocol);
  const FitResult result = fit(protocol, measured(y, 1e-5), {{1, 0.03, 0.001, 0.1}});
  EXPECT_EQ(result.p[0], 1000);
  EXPECT_NEAR(result.p[1], 0.01, 1e-10);
  EXPECT_EQ(result.parameters.size(), 1u);
}

TEST(Fit, StandardErrorsAndCorrelationsOfAStraightLineAreTheTextbookOnes) {
  const Eigen::VectorXd x = (Eigen::VectorXd(6) << 1, 2, 3, 5, 8, 13).finished();
  const double n = 6, sigma = 0.2, mean = x.mean(), Sxx = (x.array() - mean).square().sum();
  ClosedFormProtocol protocol = straight_line(x);
  const Eigen::VectorXd y = 1.5 - 0.25 * x.array() + 0.1 * (3 * x.array()).sin();
  const FitResult result = fit(protocol, measured(y, sigma), {{0, 0, -10, 10}, {1, 0, -10, 10}}, precise());
  const double b = (x.array() - mean).matrix().dot(y) / Sxx, a = y.mean() - b * mean;
  EXPECT_NEAR(result.parameters[0].value, a, 1e-9);
  EXPECT_NEAR(result.parameters[1].value, b, 1e-9);
  EXPECT_NEAR(result.parameters[0].standard_error, sigma * std::sqrt(x.squaredNorm() / (n * Sxx)), 1e-9);
  EXPECT_NEAR(result.parameters[1].standard_error, sigma / std::sqrt(Sxx), 1e-9);
  EXPECT_NEAR(result.correlation(0, 1), -mean / std::sqrt(x.squaredNorm() / n), 1e-9);
  EXPECT_NEAR(result.correlation(1, 0), result.correlation(0, 1), 1e-12);
  EXPECT_NEAR(result.correlation(0, 0), 1, 1e-12);
  for (Eigen::Index i = 0; i < x.size(); ++i) {
    EXPECT_NEAR(result.predicted[i], a + b * x[i], 1e-9);
    EXPECT_NEAR(result.residuals[i], y[i] - (a + b * x[i]), 1e-9) << "residuals are measured - predicted";
    EXPECT_NEAR(result.prediction_se[i], sigma * std::sqrt(1 / n + std::pow(x[i] - mean, 2) / Sxx), 1e-9);
  }
  EXPECT_NEAR(result.chi_squared, result.residuals.squaredNorm() / (sigma * sigma), 1e-9);
}

TEST(Fit, AMeasurementAboveThePredictionHasAPositiveResidual) {
  ClosedFormProtocol protocol = straight_line(Eigen::Vector3d(1, 2, 3));
  const FitResult result = fit(protocol, measured(Eigen::Vector3d(1, 2.4, 3), 0.1), {{1, 0.5, 0, 2}});
  EXPECT_NEAR(result.residuals[1], 2.4 - 2 * result.parameters[0].value, 1e-12);
  EXPECT_GT(result.residuals[1], 0.25);
  EXPECT_LT(result.residuals[2], 0);
}

TEST(Fit, SigmasAreAbsoluteSoThatTwiceTheSigmaIsTwiceTheStandardError) {
  FitResult results[2];
  for (int k = 0; k < 2; ++k) {
    ClosedFormProtocol protocol = stiffening_spring();
    Eigen::VectorXd y = values_of(protocol);
    y[1] += 4e-4;  // a misfit far beyond the smaller sigma, which does not widen the standard error
    results[k] = fit(protocol, measured(y, (k + 1) * 1e-5), spring_parameters());
  }
  for (size_t j = 0; j < 2; ++j) {
    EXPECT_NEAR(results[0].parameters[j].value, results[1].parameters[j].value, 1e-5 * results[0].parameters[j].value);
    EXPECT_NEAR(results[1].parameters[j].standard_error / results[0].parameters[j].standard_error, 2, 1e-5);
  }
  EXPECT_NEAR(results[0].chi_squared / results[1].chi_squared, 4, 1e-6);
  EXPECT_LT(results[0].chi_squared_p, 1e-10);
}

TEST(Fit, EachReadingCountsByItsOwnSigma) {
  ClosedFormProtocol protocol = straight_line(Eigen::VectorXd::Ones(2));
  const std::vector<Measurement> measurements{{0, 1.0, 0.1, 0}, {1, 2.0, 0.2, 1}};
  const FitResult result = fit(protocol, measurements, {{0, 0, -10, 10}}, precise());
  EXPECT_NEAR(result.parameters[0].value, (1.0 / 0.01 + 2.0 / 0.04) / (1 / 0.01 + 1 / 0.04), 1e-9);
  EXPECT_NEAR(result.parameters[0].standard_error, 1 / std::sqrt(1 / 0.01 + 1 / 0.04), 1e-9);
}

TEST(Fit, TheIntervalOfAModulusIsSymmetricInItsLogarithmAndOfANumberAsItIs) {
  ClosedFormProtocol protocol = stiffening_spring();
  const FitResult result = fit(protocol, measured(values_of(protocol), 5e-5), spring_parameters());
  const ParameterEstimate &E = result.parameters[0], &c = result.parameters[1];
  ASSERT_TRUE(E.lower95 && E.upper95 && c.lower95 && c.upper95);
  EXPECT_EQ(E.verdict, Verdict::well_determined);
  EXPECT_NEAR(*E.lower95 * *E.upper95, E.value * E.value, 1e-6 * E.value * E.value);
  EXPECT_GT(*E.upper95 - E.value, 1.001 * (E.value - *E.lower95));
  EXPECT_NEAR(std::log(*E.upper95 / E.value), kZ95 * E.standard_error / E.value, 1e-9);
  EXPECT_NEAR(0.5 * (*c.lower95 + *c.upper95), c.value, 1e-9 * c.value);
  EXPECT_NEAR(*c.upper95 - c.value, kZ95 * c.standard_error, 1e-12);
}

TEST(Fit, StandardErrorsOfNewPredictionsAreThoseOfTheFirstOrderFormula) {
  ClosedFormProtocol protocol = stiffening_spring();
  const Prediction prediction = protocol.predict(protocol.nominal(), {0, 1});
  const Eigen::Matrix2d C = (Eigen::Matrix2d() << 0.04, -0.003, -0.003, 0.0009).finished();
  const Eigen::VectorXd se =
      standard_errors(prediction, protocol.parameters(), protocol.nominal(), spring_parameters(), C);
  for (Eigen::Index i = 0; i < se.size(); ++i) {
    const double a = 1000 * prediction.derivatives(i, 0), b = prediction.derivatives(i, 1);  // by log E, by c
    EXPECT_NEAR(se[i], std::sqrt(0.04 * a * a - 0.006 * a * b + 0.0009 * b * b), 1e-12);
  }
  const Eigen::VectorXd none = standard_errors(prediction, protocol.parameters(), protocol.nominal(), {}, {});
  EXPECT_EQ(none, Eigen::VectorXd::Zero(5));
}

TEST(Fit, TheCovarianceOfAFitGivesTheSameBandWhenItIsAppliedToTheSameRows) {
  ClosedFormProtocol protocol = stiffening_spring();
  const FitResult result = fit(protocol, measured(values_of(protocol), 5e-5), spring_parameters());
  const Prediction prediction = protocol.predict(result.p, {0, 1});
  const Eigen::VectorXd se =
      standard_errors(prediction, protocol.parameters(), result.p, spring_parameters(), result.covariance);
  EXPECT_LT((se - result.prediction_se).cwiseAbs().maxCoeff(), 1e-9 * se.maxCoeff());
}

// ---- chi squared and lack of fit

/// Line through the origin, three places, two readings at each: m_i -+ d around means 1.1, 2.1, 3.4.
FitResult fit_of_repeats(double d, double sigma) {
  ClosedFormProtocol protocol = straight_line(Eigen::Vector3d(1, 2, 3));
  std::vector<Measurement> measurements;
  for (int row = 0; row < 3; ++row) {
    const double mean = (row == 0 ? 1.1 : row == 1 ? 2.1 : 3.4);
    measurements.push_back({row, mean - d, sigma, row});
    measurements.push_back({row, mean + d, sigma, row});
  }
  return fit(protocol, measurements, {{1, 0.5, 0, 3}}, precise());
}

TEST(LackOfFit, AgreesWithTheComputationByHand) {
  const FitResult result = fit_of_repeats(0.1, 0.1);
  // slope = 31/28; sum of squares 34.42 - 31^2/28; within the pairs 6 * 0.1^2.
  EXPECT_NEAR(result.parameters[0].value, 31.0 / 28, 1e-9);
  EXPECT_NEAR(result.chi_squared, 100 * (34.42 - 31.0 * 31 / 28), 1e-7);
  const LackOfFit& lack = result.lack_of_fit;
  ASSERT_TRUE(lack.available);
  EXPECT_NEAR(lack.pure_error, 6, 1e-9);
  EXPECT_NEAR(lack.lack_of_fit, 100 * (34.42 - 31.0 * 31 / 28) - 6, 1e-7);
  EXPECT_EQ(lack.lack_of_fit_dof, 2);
  EXPECT_EQ(lack.pure_error_dof, 3);
  EXPECT_NEAR(lack.F, (lack.lack_of_fit / 2) / (6.0 / 3), 1e-7);
  EXPECT_NEAR(lack.F, 0.96428571, 1e-7);
  EXPECT_NEAR(lack.p_value, std::pow(1 + 2 * lack.F / 3, -1.5), 1e-9);  // exact for 2 and 3 degrees of freedom
}

TEST(LackOfFit, TheProbabilityAtTheTabulatedQuantileOfFIsFivePercent) {
  const double f95 = 9.5521;  // 95 % quantile of F with 2 and 3 degrees of freedom
  const FitResult result = fit_of_repeats(0.1 * std::sqrt(0.96428571 / f95), 0.1);
  EXPECT_NEAR(result.lack_of_fit.F, f95, 1e-3);
  EXPECT_NEAR(result.lack_of_fit.p_value, 0.05, 1e-5);
}

TEST(LackOfFit, DoesNotDependOnTheSizeOfTheSigmas) {
  EXPECT_NEAR(fit_of_repeats(0.05, 0.1).lack_of_fit.F, fit_of_repeats(0.05, 0.7).lack_of_fit.F, 1e-6);
}

TEST(LackOfFit, IsNotAvailableWithoutRepeatsOrWithRepeatsThatAgreeToTheLastDigit) {
  ClosedFormProtocol protocol = straight_line(Eigen::Vector3d(1, 2, 3));
  EXPECT_FALSE(fit(protocol, measured(Eigen::Vector3d(1, 2, 3.5), 0.1), {{1, 0.5, 0, 3}}).lack_of_fit.available);
  EXPECT_FALSE(fit_of_repeats(0, 0.1).lack_of_fit.available);
}

TEST(ChiSquared, TheProbabilityAtTheTabulatedQuantileIsFivePercent) {
  const double q95 = 11.0705;  // 95 % quantile of chi squared with 5 degrees of freedom
  const double unscaled = 34.42 - 31.0 * 31 / 28;
  const FitResult result = fit_of_repeats(0.1, std::sqrt(unscaled / q95));
  EXPECT_EQ(result.dof, 5);
  EXPECT_NEAR(result.chi_squared, q95, 1e-4);
  EXPECT_NEAR(result.chi_squared_p, 0.05, 1e-5);
}

// ---- intervals cover the truth

constexpr int kDraws = 200;

TEST(Coverage, IntervalsOfTheStiffeningSpringHoldTheTruthIn90To98PercentOf200Draws) {
  ClosedFormProtocol protocol = stiffening_spring();
  const Eigen::VectorXd y = values_of(protocol);
  // Well determined: parabola. Weakly determined: profile likelihood.
  for (const double sigma : {1e-4, 1.2e-3}) {
    std::mt19937 random(1);
    std::normal_distribution<double> noise(0, sigma);
    int covered[2] = {0, 0}, profiled = 0;
    for (int draw = 0; draw < kDraws; ++draw) {
      Eigen::VectorXd noisy = y;
      for (double& value : noisy) value += noise(random);
      const FitResult result = fit(protocol, measured(noisy, sigma), spring_parameters());
      ASSERT_EQ(result.status, FitStatus::converged) << result.message;
      for (size_t j = 0; j < 2; ++j) {
        const ParameterEstimate& e = result.parameters[j];
        const double truth = j == 0 ? 1000 : 0.01;
        covered[j] += (!e.lower95 || *e.lower95 <= truth) && (!e.upper95 || *e.upper95 >= truth);
        profiled += e.verdict != Verdict::well_determined;
      }
    }
    std::printf("sigma %g: E covered in %.1f %%, c in %.1f %%; %d of %d estimates not well determined\n", sigma,
                covered[0] * 100.0 / kDraws, covered[1] * 100.0 / kDraws, profiled, 2 * kDraws);
    for (const int count : covered) {
      EXPECT_GE(count, 0.90 * kDraws) << "sigma " << sigma;
      EXPECT_LE(count, 0.98 * kDraws) << "sigma " << sigma;
    }
    if (sigma > 1e-3) {
      EXPECT_GT(profiled, kDraws / 2);
    }
  }
}

/// A slender cantilever of linear elements, E = 100 kPa, tip deflections at four loads that bend it by half its height.
StaticProtocol finite_element_cantilever() {
  SceneBuilder builder(rectangle(graded(0.06, 12), graded(0.01, 2), 1, "beam"), Plane::strain, 0.01);
  builder.add_solid("beam", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
  builder.fix("xmin", {0, 1});
  const int force = builder.declare({"force", "F", "N", -10, 10, "load on the tip"}, 0);
  builder.add_force("xmax", Eigen::Vector2d(0, -1), force);
  std::vector<NamedChannel> channels;
  channels.push_back({"tip", make_linear_channel(
                                 mean_weights(builder.mesh(), builder.mesh().select("xmax"), Eigen::Vector2d(0, -1)))});
  std::vector<StaticRow> rows;
  for (const double load : {0.005, 0.01, 0.015, 0.02}) rows.push_back({{load}, 0});
  return {builder.build(), std::move(channels), {force}, {}, rows, {}};
}

TEST(SlowCoverage, IntervalsOfAFiniteElementCantileverHoldTheTruthIn90To98PercentOf200Draws) {
  StaticProtocol protocol = finite_element_cantilever();
  const int E = protocol.parameters().index("E_beam");
  const Eigen::VectorXd y = protocol.predict(protocol.nominal(), {}).values;
  ASSERT_GT(y[3], 0.005) << "bent far enough to be nonlinear";
  const double sigma = 0.1 * y[3];
  std::mt19937 random(11);
  std::normal_distribution<double> noise(0, sigma);
  int covered = 0;
  for (int draw = 0; draw < kDraws; ++draw) {
    std::vector<Measurement> measurements;
    for (int repeat = 0; repeat < 2; ++repeat) {
      for (int row = 0; row < 4; ++row) measurements.push_back({row, y[row] + noise(random), sigma, row});
    }
    const FitResult result = fit(protocol, measurements, {{E, 6e4, 1e4, 1e6}});
    ASSERT_EQ(result.status, FitStatus::converged) << result.message;
    const ParameterEstimate& e = result.parameters[0];
    ASSERT_TRUE(e.lower95 && e.upper95);
    covered += *e.lower95 <= 1e5 && *e.upper95 >= 1e5;
  }
  std::printf("E covered in %.1f %% of %d draws\n", covered * 100.0 / kDraws, kDraws);
  EXPECT_GE(covered, 0.90 * kDraws);
  EXPECT_LE(covered, 0.98 * kDraws);
}

}  // namespace
}  // namespace taut

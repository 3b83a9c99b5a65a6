#include <gtest/gtest.h>

#include <algorithm>

#include "sim/core/units.hpp"
#include "tests/support/closed_form_protocol.hpp"
#include "tests/support/message.hpp"

// What a fit says about parameters that the readings do not determine, and about fits that go wrong.
namespace taut {
namespace {

using namespace test;

constexpr double kNormal95 = 1.959963984540054;
const Eigen::VectorXd kLoads = Eigen::VectorXd::LinSpaced(6, 1, 6);

void expect_says(const std::string& text, const std::vector<std::string>& parts) {
  for (const std::string& part : parts) EXPECT_NE(text.find(part), std::string::npos) << part << " is not in: " << text;
}

/// y = F y(k) at six loads F; k is a modulus.
ClosedFormProtocol one_modulus(std::function<double(double)> y, std::function<double(double)> dy) {
  return {{{modulus("k"), 1000.0}},
          [y](const Params& p) -> Eigen::VectorXd { return kLoads * y(p[0]); },
          [dy](const Params& p) -> Eigen::MatrixXd { return kLoads * dy(p[0]); }};
}

/// y = F / k.
ClosedFormProtocol compliance() {
  return one_modulus([](double k) { return 1 / k; }, [](double k) { return -1 / (k * k); });
}

// ---- bounded from one side

TEST(Verdict, AModulusTooLargeToShowIsBoundedFromBelowOnly) {
  // A soft spring of 100 N/m in series with k: beyond some k nothing changes.
  ClosedFormProtocol protocol =
      one_modulus([](double k) { return 0.01 + 1 / k; }, [](double k) { return -1 / (k * k); });
  const double sigma = 1e-4;
  const FitResult result = fit(protocol, measured(kLoads * (0.01 + 1e-12), sigma), {{0, 1e4, 1, 1e12}});
  const ParameterEstimate& k = result.parameters[0];
  EXPECT_EQ(k.verdict, Verdict::bounded_from_one_side) << k.explanation;
  ASSERT_TRUE(k.lower95);
  EXPECT_FALSE(k.upper95);
  // Chi squared rises by z95^2 where |F| / k = z95 sigma, as long as the optimum itself is beyond sight.
  EXPECT_NEAR(*k.lower95, kLoads.norm() / (kNormal95 * sigma), 0.02 * *k.lower95);
  expect_says(k.explanation, {"above", "nothing more"});
  expect_says(k.explanation, {with_unit(*k.lower95, "Pa")});
}

TEST(Verdict, AModulusTooSmallToShowIsBoundedFromAboveOnly) {
  // A spring of 100 N/m with k beside it.
  ClosedFormProtocol protocol =
      one_modulus([](double k) { return 1 / (100 + k); }, [](double k) { return -1 / ((100 + k) * (100 + k)); });
  const FitResult result = fit(protocol, measured(kLoads / (100 + 1e-3), 2e-4), {{0, 1000, 1e-6, 1e6}});
  const ParameterEstimate& k = result.parameters[0];
  EXPECT_EQ(k.verdict, Verdict::bounded_from_one_side) << k.explanation;
  EXPECT_FALSE(k.lower95);
  ASSERT_TRUE(k.upper95);
  // 1/100 - 1/(100 + k) = z95 sigma / |F|
  const double miss = kNormal95 * 2e-4 / kLoads.norm();
  EXPECT_NEAR(*k.upper95, 1 / (0.01 - miss) - 100, 0.03 * *k.upper95);
  expect_says(k.explanation, {"below", "nothing more"});
}

TEST(Verdict, AnIntervalDoesNotEndWhereSimulationsFail) {
  // As the first test, but nothing can be simulated below k = 1e5, where the readings still see no difference.
  ClosedFormProtocol protocol =
      one_modulus([](double k) { return 0.01 + 1 / k; }, [](double k) { return -1 / (k * k); });
  protocol.fails = [](const Params& p) { return p[0] < 1e5 ? "no equilibrium" : ""; };
  const FitResult result = fit(protocol, measured(kLoads * (0.01 + 1e-12), 1e-3), {{0, 1e7, 1, 1e12}});
  EXPECT_FALSE(result.parameters[0].lower95);
  EXPECT_FALSE(result.parameters[0].upper95);
}

// ---- tied

/// y1 = F / (a b), y2 = F / c: a and b appear as their product only.
ClosedFormProtocol product() {
  const Eigen::Index n = kLoads.size();
  return {{{modulus("a"), 20.0}, {modulus("b"), 50.0}, {modulus("c"), 700.0}},
          [n](const Params& p) {
            Eigen::VectorXd y(2 * n);
            y << kLoads / (p[0] * p[1]), kLoads / p[2];
            return y;
          },
          [n](const Params& p) {
            Eigen::MatrixXd D = Eigen::MatrixXd::Zero(2 * n, 3);
            D.col(0).head(n) = -kLoads / (p[0] * p[0] * p[1]);
            D.col(1).head(n) = -kLoads / (p[0] * p[1] * p[1]);
            D.col(2).tail(n) = -kLoads / (p[2] * p[2]);
            return D;
          }};
}

TEST(Verdict, TwoParametersThatAppearAsAProductAreTiedAndNameEachOther) {
  ClosedFormProtocol protocol = product();
  const Eigen::VectorXd y = protocol.predict(protocol.nominal(), {}).values;
  const FitResult result = fit(protocol, measured(y, 1e-5), {{0, 10, 1, 1e4}, {1, 40, 1, 1e4}, {2, 100, 10, 1e4}});
  const ParameterEstimate &a = result.parameters[0], &b = result.parameters[1], &c = result.parameters[2];
  EXPECT_EQ(result.status, FitStatus::converged) << result.message;
  EXPECT_NEAR(a.value * b.value, 1000, 1e-3) << "the product is found";
  for (const ParameterEstimate* tied : {&a, &b}) {
    EXPECT_EQ(tied->verdict, Verdict::tied) << tied->explanation;
    EXPECT_FALSE(tied->lower95) << *tied->lower95;
    EXPECT_FALSE(tied->upper95) << *tied->upper95;
    EXPECT_TRUE(std::isnan(tied->standard_error)) << tied->standard_error;
  }
  expect_says(a.explanation, {"cannot tell it from b", "fix one of them"});
  expect_says(b.explanation, {"cannot tell it from a", "fix one of them"});
  EXPECT_GT(std::abs(result.correlation(0, 1)), 0.999);

  // What is known stays known: the third parameter and the predictions.
  EXPECT_EQ(c.verdict, Verdict::well_determined) << c.explanation;
  EXPECT_NEAR(c.value, 700, 1e-3);
  EXPECT_NEAR(c.standard_error, 1e-5 * 700 * 700 / kLoads.norm(), 1e-6 * c.standard_error);
  ASSERT_TRUE(c.lower95 && c.upper95);
  for (Eigen::Index i = 0; i < kLoads.size(); ++i) {
    EXPECT_NEAR(result.prediction_se[i], 1e-5 * kLoads[i] / kLoads.norm(), 1e-9) << "row " << i;
    EXPECT_NEAR(result.prediction_se[i + 6], 1e-5 * kLoads[i] / kLoads.norm(), 1e-9) << "row " << i + 6;
  }
  EXPECT_NEAR(std::abs(result.weakest[0]), std::sqrt(0.5), 1e-6);
  EXPECT_NEAR(result.weakest[0], -result.weakest[1], 1e-6);
  EXPECT_NEAR(result.weakest[2], 0, 1e-6);
  EXPECT_LT(result.singular_values[2], 1e-6 * result.singular_values[0]);
}

TEST(Verdict, TheBoundOfOneTiedParameterIsNotPassedOffAsAnIntervalOfTheOther) {
  ClosedFormProtocol protocol = product();
  const Eigen::VectorXd y = protocol.predict(protocol.nominal(), {}).values;
  // b cannot go below 40, so a cannot go above 25: by that bound, not by the readings.
  const FitResult result = fit(protocol, measured(y, 1e-5), {{0, 10, 1, 1e4}, {1, 60, 40, 1e4}});
  const ParameterEstimate& a = result.parameters[0];
  EXPECT_EQ(a.verdict, Verdict::tied) << a.explanation;
  EXPECT_FALSE(a.upper95) << *a.upper95;
  EXPECT_FALSE(a.lower95) << *a.lower95;
  expect_says(a.explanation, {"cannot tell it from b"});
}

TEST(Verdict, AStrongCorrelationIsMentioned) {
  // Lines far from the origin: intercept and slope are known, but together.
  const Eigen::VectorXd x = Eigen::VectorXd::LinSpaced(6, 10, 15);
  ClosedFormProtocol protocol = straight_line(x);
  const FitResult result = fit(protocol, measured(1 + x.array(), 0.01), {{0, 0, -5, 5}, {1, 0, -5, 5}});
  EXPECT_EQ(result.parameters[0].verdict, Verdict::well_determined);
  expect_says(result.parameters[0].explanation, {"correlated with b", "-0.9"});
}

// ---- invisible

TEST(Verdict, AParameterWithoutInfluenceIsInvisible) {
  ClosedFormProtocol protocol{{{modulus("k"), 1000.0}, {modulus("idle"), 50.0}},
                              [](const Params& p) -> Eigen::VectorXd { return kLoads / p[0]; },
                              [](const Params& p) {
                                Eigen::MatrixXd D = Eigen::MatrixXd::Zero(kLoads.size(), 2);
                                D.col(0) = -kLoads / (p[0] * p[0]);
                                return D;
                              }};
  const FitResult result = fit(protocol, measured(kLoads / 1000, 1e-6), {{0, 500, 1, 1e6}, {1, 50, 1, 1e6}});
  const ParameterEstimate &k = result.parameters[0], &idle = result.parameters[1];
  EXPECT_EQ(idle.verdict, Verdict::invisible) << idle.explanation;
  EXPECT_DOUBLE_EQ(idle.value, 50);
  EXPECT_FALSE(idle.lower95 || idle.upper95);
  EXPECT_TRUE(std::isnan(idle.standard_error));
  expect_says(idle.explanation, {"do not depend on idle", "not a result"});
  EXPECT_EQ(k.verdict, Verdict::well_determined) << k.explanation;
  EXPECT_NEAR(k.value, 1000, 1e-3);
  EXPECT_TRUE(k.lower95 && k.upper95);
  EXPECT_TRUE(result.prediction_se.allFinite());
  EXPECT_NEAR(result.prediction_se[5], 1e-6 * 6 / kLoads.norm(), 1e-10);
}

TEST(Verdict, APlainNumberIsJudgedByTheRangeItMayHave) {
  // The same readings: an offset known to 0.01 is little in a range of 20 and much in one of 0.08.
  for (const auto& [range, verdict] : {std::pair{20.0, Verdict::well_determined}, {0.08, Verdict::weakly_determined}}) {
    ClosedFormProtocol protocol = straight_line(kLoads);
    const FitResult result = fit(protocol, measured(Eigen::VectorXd::Constant(6, 0.0105), 0.01 * std::sqrt(6.0)),
                                 {{0, 0.1 * range, -0.5 * range, 0.5 * range}});
    EXPECT_EQ(result.parameters[0].verdict, verdict) << result.parameters[0].explanation;
    EXPECT_NEAR(result.parameters[0].standard_error, 0.01, 1e-9);
  }
}

TEST(Verdict, APositiveNumberIsComparedWithItself) {
  // A thickness of 1 known to 0.5, whatever it was allowed to be.
  for (const double most : {2.1, 1e3}) {
    ParameterSpec thickness{"thickness", "t", "m", 0, 1e3, ""};
    ClosedFormProtocol protocol{{{thickness, 1.0}},
                                [](const Params& p) -> Eigen::VectorXd { return Eigen::VectorXd::Constant(4, p[0]); },
                                [](const Params&) -> Eigen::MatrixXd { return Eigen::MatrixXd::Ones(4, 1); }};
    const FitResult result = fit(protocol, measured(Eigen::VectorXd::Ones(4), 1.0), {{0, 0.9, 0.01, most}});
    EXPECT_EQ(result.parameters[0].verdict, Verdict::weakly_determined) << result.parameters[0].explanation;
  }
}

TEST(Verdict, WithoutChosenBoundsTheReadingsAreTheScale) {
  for (const auto& [sigma, verdict] : {std::pair{0.1, Verdict::well_determined}, {1.0, Verdict::weakly_determined}}) {
    ClosedFormProtocol protocol = straight_line(Eigen::VectorXd::Ones(4));
    const FitResult result = fit(protocol, measured(Eigen::VectorXd::Ones(4), sigma), {{0, 0.9, -1e9, 1e9, false}});
    EXPECT_EQ(result.parameters[0].verdict, verdict) << result.parameters[0].explanation;
  }
}

TEST(Verdict, WhatMissesTheReadingsDeterminesNothing) {
  ClosedFormProtocol protocol = compliance();
  Eigen::VectorXd y = kLoads / 1000;
  y[2] *= 10;  // a slipped decimal
  const FitResult result = fit(protocol, measured(y, 1e-6), {{0, 500, 1, 1e6}});
  EXPECT_EQ(result.status, FitStatus::converged);
  EXPECT_TRUE(misses_readings(result));
  EXPECT_EQ(result.parameters[0].verdict, Verdict::of_a_wrong_model);
  EXPECT_TRUE(result.parameters[0].profile.empty()) << "nothing to look for at such a chi squared";
}

// ---- intervals where chi squared is no parabola

TEST(Fit, AnIntervalWhoseEndsDoNotRiseAsPromisedBecomesAProfile) {
  // y = d + 2 d^2 with x = 1 + d: chi squared is (y / sigma)^2, and 3.84 where y = +-1.96 sigma.
  ParameterSpec spec{"x", "x", "1", -10, 10, ""};
  ClosedFormProtocol protocol{
      {{spec, 1.0}},
      [](const Params& p) -> Eigen::VectorXd {
        const double d = p[0] - 1;
        return Eigen::VectorXd::Constant(1, d + 2 * d * d);
      },
      [](const Params& p) -> Eigen::MatrixXd { return Eigen::MatrixXd::Constant(1, 1, 1 + 4 * (p[0] - 1)); }};
  const FitResult result = fit(protocol, measured(Eigen::VectorXd::Zero(1), 0.1 / kNormal95), {{0, 1.02, 0, 3}});
  const ParameterEstimate& x = result.parameters[0];
  ASSERT_EQ(x.verdict, Verdict::well_determined) << x.explanation;
  EXPECT_NEAR(x.value, 1, 1e-6);
  ASSERT_TRUE(x.lower95 && x.upper95);
  EXPECT_NEAR(*x.lower95, 1 + (-1 + std::sqrt(1 - 0.8)) / 4, 0.03 * 0.138);
  EXPECT_NEAR(*x.upper95, 1 + (-1 + std::sqrt(1 + 0.8)) / 4, 0.03 * 0.085);
}

TEST(Fit, ALowerMinimumThatAnIntervalMeetsIsTheResult) {
  // Wells a distance of 0.06 apart on a slope: from the one at 1 the profile comes by the deeper one at 0.94.
  constexpr double apart = 0.06, deep = 1.87, pi = 3.14159265358979;
  ParameterSpec spec{"x", "x", "1", -10, 10, ""};
  const auto wells = [](const Params& p) -> Eigen::VectorXd {
    const double d = p[0] - 1;
    return Eigen::Vector2d((d + apart) / (2 * apart), deep * std::sin(pi * d / apart));
  };
  const auto slopes = [](const Params& p) -> Eigen::MatrixXd {
    return Eigen::Vector2d(1 / (2 * apart), deep * pi / apart * std::cos(pi * (p[0] - 1) / apart));
  };
  for (const double start : {1.001, 0.941}) {
    ClosedFormProtocol protocol{{{spec, 1.0}}, wells, slopes};
    const FitResult result = fit(protocol, measured(Eigen::VectorXd::Zero(2), 1), {{0, start, 0, 3}});
    EXPECT_EQ(result.status, FitStatus::converged);
    EXPECT_NEAR(result.parameters[0].value, 0.94, 1e-5) << "from " << start;
    EXPECT_LT(result.chi_squared, 1e-6);
  }
}

TEST(Verdict, NamesAreForPeople) {
  EXPECT_EQ(name_of(Verdict::well_determined), "well determined");
  EXPECT_EQ(name_of(Verdict::bounded_from_one_side), "bounded from one side");
  EXPECT_EQ(name_of(Verdict::tied), "tied");
  EXPECT_EQ(name_of(Verdict::invisible), "invisible");
  EXPECT_EQ(name_of(FitStatus::start_failed), "start failed");
}

// ---- bounds

TEST(Verdict, WhatIsNothingAndMayNotBeLessIsBoundedFromAboveWithProfilesAndWithout) {
  // y = F (1 + c), c from 0 on, and readings that would have it a quarter of its standard error below.
  ClosedFormProtocol protocol{{{ParameterSpec{"c", "c", "1", 0, 2, ""}, 0.0}},
                              [](const Params& p) -> Eigen::VectorXd { return kLoads * (1 + p[0]); },
                              [](const Params&) -> Eigen::MatrixXd { return kLoads; }};
  const double error = 1e-2 / kLoads.norm();
  for (const bool profiles : {true, false}) {
    FitOptions options;
    options.profiles = profiles;
    const FitResult result = fit(protocol, measured(kLoads * (1 - 0.25 * error), 1e-2), {{0, 0, 0, 2}}, options);
    const ParameterEstimate& c = result.parameters[0];
    EXPECT_NEAR(c.value, 0, 1e-9);
    EXPECT_EQ(c.verdict, Verdict::bounded_from_one_side) << profiles << c.explanation;
    EXPECT_FALSE(c.lower95);
    ASSERT_TRUE(c.upper95);
    // Chi squared rises by (c^2 + c error/2)/error^2 from there.
    const double rise = std::sqrt(kNormal95 * kNormal95 + 0.0625) - 0.25;
    EXPECT_NEAR(*c.upper95, (profiles ? rise : kNormal95) * error, 0.03 * error);
    expect_says(c.explanation, {"below", "nothing more"});
  }
}

TEST(Fit, AFitThatEndsAtABoundSaysSo) {
  ClosedFormProtocol protocol = compliance();
  const FitResult result = fit(protocol, measured(kLoads / 1000, 1e-6), {{0, 300, 100, 400}});
  const ParameterEstimate& k = result.parameters[0];
  EXPECT_NEAR(k.value, 400, 1e-6);
  expect_says(k.explanation, {"beyond the bound that was set", "widen it"});
  EXPECT_EQ(k.verdict, Verdict::at_its_bound);
  EXPECT_FALSE(k.lower95 || k.upper95);
  const FitResult inside = fit(protocol, measured(kLoads / 1000, 1e-6), {{0, 300, 100, 4000}});
  EXPECT_EQ(inside.parameters[0].explanation.find("bound"), std::string::npos);
}

TEST(Fit, AStartOnItsBoundIsAllowed) {
  for (const double start : {100.0, 4000.0}) {
    ClosedFormProtocol protocol = compliance();
    const FitResult result = fit(protocol, measured(kLoads / 1000, 1e-6), {{0, start, 100, 4000}});
    EXPECT_EQ(result.status, FitStatus::converged);
    EXPECT_NEAR(result.parameters[0].value, 1000, 1e-3) << "from " << start;
  }
}

TEST(Fit, WrongQuestionsAreRefusedWithAMessage) {
  ClosedFormProtocol protocol = compliance();
  const std::vector<Measurement> one{{0, 0.001, 1e-6, 0}};
  expect_input_error([&] { fit(protocol, one, {{0, 50, 100, 400}}); }, {"k", "start 50 Pa", "bounds 100 and 400"});
  expect_input_error([&] { fit(protocol, one, {{0, 500, 100, 400}}); }, {"k", "start 500 Pa", "bounds 100 and 400"});
  expect_input_error([&] { fit(protocol, one, {{0, 100, 100, 100}}); }, {"k", "bounds"});
  expect_input_error([&] { fit(protocol, one, {{0, std::nan(""), 100, 400}}); }, {"k", "start"});
  expect_input_error([&] { fit(protocol, one, {}); }, {"no free parameter", "[fit.free]"});
  ClosedFormProtocol line = straight_line(kLoads);
  expect_input_error(
      [&] {
        fit(line, one, {{0, 0, -1, 1}, {1, 0, -1, 1}});
      },
      {"1 readings cannot determine 2 parameters", "fix parameters"});
}

// ---- failing simulations

/// y = F k / 1e6: a response in which a start that is too low overshoots.
ClosedFormProtocol proportional() {
  return one_modulus([](double k) { return 1e-6 * k; }, [](double) { return 1e-6; });
}

TEST(Fit, AFailingSimulationShortensTheStepAndIsCounted) {
  ClosedFormProtocol protocol = proportional();
  protocol.fails = [](const Params& p) {
    return p[0] > 1100 ? "no equilibrium at k = " + std::to_string(p[0]) : std::string();
  };
  const FitResult result = fit(protocol, measured(1e-3 * kLoads, 1e-5), {{0, 100, 10, 1e5}});
  EXPECT_EQ(result.status, FitStatus::converged) << result.message;
  EXPECT_NEAR(result.parameters[0].value, 1000, 1e-2);
  EXPECT_GT(result.failed_evaluations, 0);
  EXPECT_LT(result.failed_evaluations, result.evaluations);
  ASSERT_FALSE(result.failures.empty());
  EXPECT_LE(result.failures.size(), 5u);
  expect_says(result.failures[0], {"no equilibrium at k ="});
}

TEST(Fit, AGapOfFailuresBetweenStartAndOptimumIsSurvived) {
  // The first step of the fit lands between start and optimum; a gap is put right there.
  double landing = 0;
  for (const bool gap : {false, true}) {
    ClosedFormProtocol protocol = compliance();
    FitOptions options;
    options.progress = [&](const FitProgress& state) {
      if (!gap && state.evaluation == 2) landing = state.values[0];
    };
    if (gap) {
      ASSERT_GT(landing, 20);
      ASSERT_LT(landing, 990);
      protocol.fails = [&](const Params& p) { return std::abs(p[0] / landing - 1) < 0.1 ? "no equilibrium" : ""; };
    }
    const FitResult result = fit(protocol, measured(kLoads / 1000, 1e-6), {{0, 10, 1, 1e5}}, options);
    EXPECT_EQ(result.status, FitStatus::converged) << result.message;
    EXPECT_NEAR(result.parameters[0].value, 1000, 1e-2);
    EXPECT_EQ(result.failed_evaluations > 0, gap);
  }
}

TEST(Fit, AFitThatIsStoppedByFailuresBeforeItsOptimumHasNotConverged) {
  // The optimum, k = 1000, lies where nothing can be simulated.
  ClosedFormProtocol protocol = compliance();
  protocol.fails = [](const Params& p) { return p[0] < 1500 ? "no equilibrium" : ""; };
  const FitResult result = fit(protocol, measured(kLoads / 1000, 1e-6), {{0, 2000, 100, 4000}});
  EXPECT_EQ(result.status, FitStatus::not_converged) << result.message;
  EXPECT_GT(result.failed_evaluations, 0);
  expect_says(result.message, {"simulations fail"});
}

TEST(Fit, AFailureAtTheStartEndsTheFit) {
  ClosedFormProtocol protocol = compliance();
  protocol.fails = [](const Params&) { return "no equilibrium at force = 1 N"; };
  const FitResult result = fit(protocol, measured(kLoads / 1000, 1e-6), {{0, 300, 100, 4000}});
  EXPECT_EQ(result.status, FitStatus::start_failed);
  EXPECT_EQ(result.failed_evaluations, 1);
  ASSERT_EQ(result.failures.size(), 1u);
  EXPECT_EQ(result.failures[0], "no equilibrium at force = 1 N");
  EXPECT_DOUBLE_EQ(result.parameters[0].value, 300);
}

TEST(Fit, TooFewIterationsAreNotConvergence) {
  ClosedFormProtocol protocol = stiffening_spring();
  const Eigen::VectorXd y = protocol.predict(protocol.nominal(), {}).values;
  FitOptions options;
  options.max_iterations = 1;
  options.recover = false;
  const FitResult result = fit(protocol, measured(y, 1e-5), {{0, 5e4, 10, 1e5}, {1, 0.03, 0.001, 0.1}}, options);
  EXPECT_EQ(result.status, FitStatus::not_converged);
  EXPECT_LE(result.iterations, 1);
  EXPECT_EQ(result.covariance.size(), 0) << "no result, no errors";
  for (const ParameterEstimate& e : result.parameters) {
    EXPECT_EQ(e.verdict, Verdict::unknown);
    EXPECT_TRUE(std::isnan(e.standard_error));
    EXPECT_FALSE(e.lower95 || e.upper95);
  }
}

// ---- stopping, progress, recomputation

TEST(Fit, TheStopFlagInterruptsAndTheBestValuesSoFarAreKept) {
  ClosedFormProtocol protocol = compliance();
  std::atomic<bool> stop{false};
  FitOptions options;
  options.stop = &stop;
  options.progress = [&](const FitProgress& state) { stop = state.evaluation >= 2; };
  const FitResult result = fit(protocol, measured(kLoads / 1000, 1e-6), {{0, 500, 100, 4000}}, options);
  EXPECT_EQ(result.status, FitStatus::interrupted);
  EXPECT_LE(result.evaluations, 3);
  EXPECT_GT(result.parameters[0].value, 510) << "one step of the fit was taken";
  EXPECT_EQ(result.p[0], result.parameters[0].value);
}

TEST(Fit, AStopBeforeTheFitLeavesTheStart) {
  ClosedFormProtocol protocol = compliance();
  const std::atomic<bool> stop{true};
  FitOptions options;
  options.stop = &stop;
  const FitResult result = fit(protocol, measured(kLoads / 1000, 1e-6), {{0, 500, 100, 4000}}, options);
  EXPECT_EQ(result.status, FitStatus::interrupted);
  EXPECT_NEAR(result.parameters[0].value, 500, 1e-9);
  EXPECT_LE(protocol.calls, 1);
}

TEST(Fit, ProgressCountsEvaluationsAndShowsValuesInSi) {
  ClosedFormProtocol protocol = compliance();
  std::vector<FitProgress> states;
  FitOptions options;
  options.progress = [&](const FitProgress& state) { states.push_back(state); };
  fit(protocol, measured(kLoads / 1000, 1e-6), {{0, 500, 100, 4000}}, options);
  ASSERT_GE(states.size(), 3u);
  EXPECT_EQ(states[0].evaluation, 1);
  EXPECT_NEAR(states[0].values[0], 500, 1e-9);
  EXPECT_NEAR(states[0].chi_squared, kLoads.squaredNorm() * std::pow(1e6 * (1.0 / 500 - 1.0 / 1000), 2), 1e-3);
}

TEST(Fit, ProgressNamesThePhasesAndWhatTheyUsuallyTakeYet) {
  ClosedFormProtocol protocol = compliance();
  std::vector<FitProgress> seen;
  FitOptions options;
  options.all_profiles = true;
  options.progress = [&](const FitProgress& p) { seen.push_back(p); };
  fit(protocol, measured(kLoads / 1000.0, 1e-5), {{0, 4000, 1, 1e6}}, options);
  std::vector<std::string> phases;
  for (size_t i = 0; i < seen.size(); ++i) {
    if (i == 0 || seen[i].phase != seen[i - 1].phase) {
      phases.push_back(seen[i].phase);
      continue;
    }
    const int made = seen[i].evaluation - seen[i - 1].evaluation;
    EXPECT_EQ(seen[i].usually_left, std::max(0, seen[i - 1].usually_left - made)) << seen[i].phase;
  }
  EXPECT_EQ(phases, (std::vector<std::string>{"search", "cold replay", "profile of k"}));
  const auto profile = std::ranges::find(seen, "profile of k", &FitProgress::phase);
  EXPECT_GT(profile->usually_left, 0) << "a new phase has all of its own before it";
}

TEST(Fit, WhatIsReportedIsComputedAgainFromTheStartOfThePath) {
  ClosedFormProtocol protocol = compliance();
  const FitResult result = fit(protocol, measured(kLoads / 1000, 1e-6), {{0, 500, 100, 4000}});
  EXPECT_GE(protocol.forgotten, 1);
  EXPECT_EQ(result.status, FitStatus::converged);
}

/// A protocol whose warm path leads to another equilibrium than its cold one: by `gap`, and after forgetting for
/// `calls` calls.
class TwoPaths final : public Protocol {
 public:
  TwoPaths(double gap, int calls) : gap_(gap), calls_(calls) {}
  const ParameterTable& parameters() const override { return inner_.parameters(); }
  const Params& nominal() const override { return inner_.nominal(); }
  int row_count() const override { return inner_.row_count(); }
  Prediction predict(const Params& p, const std::vector<int>& free) override {
    Prediction prediction = inner_.predict(p, free);
    if (cold_ > 0) prediction.values.array() += gap_;
    --cold_;
    return prediction;
  }
  void forget() override { cold_ = calls_; }

 private:
  ClosedFormProtocol inner_ = compliance();
  double gap_;
  int calls_, cold_ = 0;
};

TEST(Fit, AnOptimumThatTheProtocolsOwnPathDoesNotReachIsLookedForAlongThatPath) {
  TwoPaths protocol(1e-4, 1);
  const Eigen::VectorXd y = kLoads / 1000 + Eigen::VectorXd::Constant(kLoads.size(), 1e-4);
  const FitResult result = fit(protocol, measured(y, 1e-6), {{0, 500, 100, 4000}});
  EXPECT_EQ(result.status, FitStatus::converged) << result.message;
  EXPECT_NEAR(result.parameters[0].value, 1000, 1e-2) << "the cold path's";
  ASSERT_FALSE(result.remarks.empty());
  expect_says(result.remarks.front(), {"protocol's own path", "more than one equilibrium"});
}

/// A cold path on which all rows jump where the modulus is below 1100, and a warm one that does not know of it.
class JumpsBeside final : public Protocol {
 public:
  const ParameterTable& parameters() const override { return inner_.parameters(); }
  const Params& nominal() const override { return inner_.nominal(); }
  int row_count() const override { return inner_.row_count(); }
  Prediction predict(const Params& p, const std::vector<int>& free) override {
    Prediction prediction = inner_.predict(p, free);
    if (std::exchange(cold_, false) && p[0] < 1100) prediction.values.array() += 1;
    return prediction;
  }
  void forget() override { cold_ = true; }

 private:
  ClosedFormProtocol inner_ = compliance();
  bool cold_ = false;
};

TEST(Fit, ASearchThatEndsWhereRowsJumpHasNotConverged) {
  JumpsBeside protocol;
  const FitResult result = fit(protocol, measured(kLoads / 1000, 1e-6), {{0, 2000, 100, 4000}});
  EXPECT_EQ(result.status, FitStatus::not_converged) << result.message;
  expect_says(result.message, {"still falls", "jump from one to another"});
  EXPECT_GE(result.parameters[0].value, 1100);
  EXPECT_EQ(result.parameters[0].verdict, Verdict::unknown);
}

// ---- other starts, other valleys, budgets

/// y = a + 2 sin 3a at several offsets: chi squared has many minima, and its lowest at a = 4 only is zero.
ClosedFormProtocol waves() {
  const auto y = [](const Params& p) -> Eigen::VectorXd {
    return Eigen::Vector4d(p[0], std::sin(3 * p[0]), std::cos(3 * p[0]), 1).array() * Eigen::Array4d(0.3, 2, 2, 1);
  };
  return {{{plain("a"), 0}}, y, [](const Params& p) {
            return Eigen::MatrixXd(Eigen::Vector4d(0.3, 6 * std::cos(3 * p[0]), -6 * std::sin(3 * p[0]), 0));
          }};
}

TEST(Fit, AnOptimumThatMissesTheReadingsIsTriedFromOtherStarts) {
  for (const bool recover : {false, true}) {
    ClosedFormProtocol protocol = waves();
    Params truth(1);
    truth << 4;
    FitOptions options;
    options.recover = recover;
    const std::vector<Measurement> measurements = measured(protocol.predict(truth, {}).values, 0.01);
    const FitResult result = fit(protocol, measurements, {{0, 0.2, -6, 8}}, options);
    EXPECT_EQ(result.status, FitStatus::converged) << result.message;
    if (!recover) {
      EXPECT_GT(std::abs(result.parameters[0].value - 4), 1);
      EXPECT_TRUE(result.remarks.empty());
      continue;
    }
    EXPECT_NEAR(result.parameters[0].value, 4, 1e-4);
    ASSERT_FALSE(result.remarks.empty());
    expect_says(result.remarks.front(), {"other", "the best has ended here"});
  }
}

TEST(Fit, OtherStartsCostNoMoreThanTheyMayAndNothingWhereTheFitIsFine) {
  ClosedFormProtocol protocol = compliance();
  FitOptions options;
  options.profiles = false;
  const auto calls = [&](const Eigen::VectorXd& y) {
    protocol.calls = 0;
    fit(protocol, measured(y, 1e-6), {{0, 500, 1, 1e6}}, options);
    return protocol.calls;
  };
  options.recover = false;
  const int fine = calls(kLoads / 1000), missing = calls(kLoads.array().square() / 1000);
  options.recover = true;
  EXPECT_EQ(calls(kLoads / 1000), fine);
  options.restart_budget = 3;
  EXPECT_GT(calls(kLoads.array().square() / 1000), missing);
  EXPECT_LE(calls(kLoads.array().square() / 1000), missing + 6) << "three, and what the last search had begun";
}

TEST(Fit, AnIntervalReachesIntoTheValleyThatAnotherProfileFound) {
  // Along the valley b = a^3 - a every b in its middle has three a: the profile of b that stays with the one near the
  // optimum ends at the fold, b = 0.385, where that of a goes on to a = 1.96 * 0.75.
  const ClosedFormProtocol::Values y = [](const Params& p) -> Eigen::VectorXd {
    return Eigen::Vector3d(p[0] / 0.75, 100 * (p[1] - p[0] * p[0] * p[0] + p[0]), 0);
  };
  ClosedFormProtocol protocol({{plain("a"), 0}, {plain("b"), 0}}, y, [](const Params& p) {
    Eigen::MatrixXd D(3, 2);
    D << 1 / 0.75, 0, 100 * (1 - 3 * p[0] * p[0]), 100, 0, 0;
    return D;
  });
  FitOptions options;
  options.profile_budget = 1000;  // in calls, here
  const FitResult result =
      fit(protocol, measured(Eigen::Vector3d::Zero(), 1), {{0, 0.01, -3, 3}, {1, 0.0, -20, 20}}, options);
  ASSERT_EQ(result.status, FitStatus::converged) << result.message;
  const double a = 1.96 * 0.75, b = a * a * a - a;
  ASSERT_TRUE(result.parameters[1].lower95 && result.parameters[1].upper95);
  EXPECT_NEAR(*result.parameters[0].upper95, a, 0.03 * a);
  EXPECT_NEAR(*result.parameters[1].upper95, b, 0.05 * b);
  EXPECT_NEAR(*result.parameters[1].lower95, -b, 0.05 * b);
  double before = -1;
  for (const auto& [value, rise] : result.parameters[1].profile) {
    if (value > 0) {
      EXPECT_GE(rise, before) << "points of the higher valley are not its profile";
    }
    before = value > 0 ? rise : -1;
  }
}

TEST(Fit, ProfilesThatHaveCostWhatTheyMayLeaveTheParabola) {
  FitOptions options;
  options.all_profiles = true;
  const auto result_with = [&](double budget) {
    ClosedFormProtocol protocol = stiffening_spring();
    const Eigen::VectorXd y = protocol.predict(protocol.nominal(), {}).values;
    options.profile_budget = budget;
    return fit(protocol, measured(y, 1e-4), {{0, 900, 10, 1e5}, {1, 0.012, 0.001, 0.1}}, options);
  };
  const FitResult whole = result_with(1000), cut = result_with(2);
  EXPECT_EQ(cut.status, FitStatus::converged);
  ASSERT_TRUE(cut.parameters[0].lower95);
  EXPECT_NE(*cut.parameters[0].lower95, *whole.parameters[0].lower95);
  expect_says(cut.parameters[0].explanation, {"profile was not finished", "2 cold replays"});
  EXPECT_EQ(whole.parameters[0].explanation.find("not finished"), std::string::npos);
}

TEST(Fit, AFitWhoseHistoryLedElsewhereGoesOnFromTheProtocolsOwnPath) {
  TwoPaths protocol(1e-4, 1000);
  const FitResult result =
      fit(protocol, measured(kLoads / 1000 + Eigen::VectorXd::Constant(6, 1e-4), 1e-6), {{0, 500, 100, 4000}});
  EXPECT_EQ(result.status, FitStatus::converged) << result.message;
  EXPECT_NEAR(result.parameters[0].value, 1000, 1e-2) << "the answer of the cold path";
  EXPECT_LT(result.chi_squared, 1e-6);
}

}  // namespace
}  // namespace taut

#include "calib/fit/posterior.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "calib/fit/gauss_newton.hpp"
#include "tests/support/closed_form_protocol.hpp"
#include "tests/support/nist.hpp"

namespace taut {
namespace {

using namespace test;

/// Draws about the optimum that fit() finds.
std::vector<PosteriorDraw> sampled(ClosedFormProtocol& protocol, const std::vector<Measurement>& measurements,
                                   const std::vector<FreeParameter>& start, unsigned count) {
  const FitResult found = fit(protocol, measurements, start);
  const std::vector<FreeParameter> free = free_at(found, protocol.parameters());
  FitOptions options;
  options.held = found.p;
  PosteriorSampler sampler(protocol, measurements, free, options);
  EXPECT_NEAR(sampler.chi_squared(), found.chi_squared, 1e-6 * (1 + found.chi_squared));
  std::vector<PosteriorDraw> draws;
  for (unsigned k = 0; k < count; ++k) draws.push_back(sampler.draw(k, 1));
  return draws;
}

WeightedValues of_parameter(const std::vector<PosteriorDraw>& draws, size_t j) {
  WeightedValues weighted;
  std::vector<double> logs;
  for (const PosteriorDraw& draw : draws) {
    if (draw.values.empty()) continue;
    weighted.values.push_back(draw.values[j]);
    logs.push_back(draw.log_weight);
  }
  weighted.weights = weights_of(logs);
  return weighted;
}

/// Density exp(-chi^2/2) of one parameter by the trapezoidal rule on `q`, evenly spaced.
WeightedValues by_quadrature(const std::vector<double>& values, const std::function<double(double)>& half_chi_squared) {
  WeightedValues exact{values, {}};
  for (double value : values) exact.weights.push_back(std::exp(-half_chi_squared(value)));
  return exact;
}

std::vector<double> evenly(double from, double to, int count) {
  std::vector<double> values;
  for (int i = 0; i < count; ++i) values.push_back(from + (to - from) * i / (count - 1));
  return values;
}

/// The means, deviations and ends of two samples agree within four Monte-Carlo errors.
void expect_alike(const WeightedValues& drawn, const WeightedValues& exact, const std::string& what) {
  const double n = effective_number(drawn.weights), sd = exact.deviation();
  EXPECT_NEAR(drawn.mean(), exact.mean(), 4 * sd / std::sqrt(n)) << what;
  EXPECT_NEAR(drawn.deviation(), sd, 4 * sd / std::sqrt(n)) << what;
  for (const double p : {0.025, 0.25, 0.5, 0.75, 0.975}) {
    // The share of the exact distribution below the drawn quantile has the deviation sqrt(p (1 - p) / n).
    double below = 0, all = 0;
    const double q = drawn.quantile(p);
    for (size_t i = 0; i < exact.values.size(); ++i) {
      all += exact.weights[i];
      below += exact.values[i] < q ? exact.weights[i] : 0;
    }
    EXPECT_NEAR(below / all, p, 4 * std::sqrt(p * (1 - p) / n) + 1e-3) << what << ", quantile " << p;
  }
}

TEST(Posterior, OfALinearModelIsTheNormalOneWithEqualWeights) {
  const Eigen::VectorXd x = Eigen::VectorXd::LinSpaced(9, 0, 4);
  ClosedFormProtocol line = straight_line(x, 0.3, 2);
  const double inf = std::numeric_limits<double>::infinity();
  const auto draws = sampled(line, measured(line.predict(line.nominal(), {}).values, 0.1),
                             {{0, 0, -inf, inf}, {1, 1, -inf, inf}}, 2000);
  // C = sigma^2 (X^T X)^-1 of a straight line.
  const double xx = (x.array() - x.mean()).square().sum(), sd_b = 0.1 / std::sqrt(xx),
               sd_a = 0.1 * std::sqrt(1.0 / 9 + x.mean() * x.mean() / xx);
  const WeightedValues a = of_parameter(draws, 0), b = of_parameter(draws, 1);
  for (double weight : a.weights) EXPECT_NEAR(weight, 1, 1e-9);
  EXPECT_NEAR(effective_number(a.weights), 2000, 1e-6);
  EXPECT_NEAR(a.mean(), 0.3, 4 * sd_a / std::sqrt(2000));
  EXPECT_NEAR(b.mean(), 2, 4 * sd_b / std::sqrt(2000));
  EXPECT_NEAR(a.deviation() / sd_a, 1, 4 / std::sqrt(4000));
  EXPECT_NEAR(b.deviation() / sd_b, 1, 4 / std::sqrt(4000));
  double covariance = 0;
  for (const PosteriorDraw& draw : draws) covariance += (draw.values[0] - 0.3) * (draw.values[1] - 2) / 2000;
  EXPECT_NEAR(covariance / (sd_a * sd_b), -x.mean() * sd_b / sd_a, 0.1);
}

/// One reading of y = exp(theta) with a sigma as large as it: the parabola is far off, the density is known.
TEST(Posterior, OfACurvedModelFollowsItsDensity) {
  ClosedFormProtocol curved(
      {{plain("t"), 0.0}}, [](const Params& p) { return Eigen::VectorXd::Constant(1, std::exp(p[0])); },
      [](const Params& p) { return Eigen::MatrixXd::Constant(1, 1, std::exp(p[0])); });
  const auto draws = sampled(curved, {{0, 1.0, 0.5, 0}}, {{0, 0.2, -4, 3}}, 4000);
  const auto exact = by_quadrature(evenly(-4, 3, 20001), [](double t) { return 2 * std::pow(std::exp(t) - 1, 2); });
  const WeightedValues drawn = of_parameter(draws, 0);
  EXPECT_GT(effective_number(drawn.weights), 400);
  expect_alike(drawn, exact, "t");
}

/// A stiffness of which the readings say only that it is large: the posterior is flat up to the bound.
TEST(Posterior, WhereReadingsBoundAParameterFromOneSideOnlyItFillsTheRest) {
  ClosedFormProtocol spring(
      {{modulus("E"), 1e4}}, [](const Params& p) { return Eigen::VectorXd::Constant(1, 1 / p[0]); },
      [](const Params& p) { return Eigen::MatrixXd::Constant(1, 1, -1 / (p[0] * p[0])); });
  const auto draws = sampled(spring, {{0, 1e-4, 1e-3, 0}}, {{0, 2e3, 10, 1e7}}, 4000);
  const auto exact = by_quadrature(evenly(std::log(10), std::log(1e7), 20001),
                                   [](double q) { return 0.5 * std::pow((std::exp(-q) - 1e-4) / 1e-3, 2); });
  WeightedValues drawn = of_parameter(draws, 0);
  for (double& value : drawn.values) value = std::log(value);
  EXPECT_GT(effective_number(drawn.weights), 400);
  expect_alike(drawn, exact, "ln E");
}

/// All parameters of one of NIST's sets, with this noise, against the density on a grid between their bounds.
void expect_density_of(const NistProblem& problem, double sigma, const std::vector<FreeParameter>& free,
                       const std::vector<int>& points, unsigned count) {
  const auto rows = static_cast<Eigen::Index>(problem.yx.size() / 2);
  const auto x_of = [&](Eigen::Index i) { return problem.yx[2 * static_cast<size_t>(i) + 1]; };
  const auto listed = [](const Params& p) { return std::vector<double>(p.begin(), p.end()); };
  std::vector<std::pair<ParameterSpec, double>> parameters;
  for (size_t j = 0; j < free.size(); ++j)
    parameters.emplace_back(plain("b" + std::to_string(j + 1)), problem.start2[j]);
  ClosedFormProtocol protocol(
      parameters,
      [&](const Params& p) {
        Eigen::VectorXd y(rows);
        for (Eigen::Index i = 0; i < rows; ++i) y[i] = problem.y(x_of(i), listed(p));
        return y;
      },
      [&](const Params& p) {
        Eigen::MatrixXd D(rows, p.size());
        for (Eigen::Index i = 0; i < rows; ++i) {
          const std::vector<double> row = problem.dy(x_of(i), listed(p));
          D.row(i) = Eigen::Map<const Eigen::RowVectorXd>(row.data(), p.size());
        }
        return D;
      });
  std::vector<Measurement> measurements;
  for (Eigen::Index i = 0; i < rows; ++i)
    measurements.push_back({static_cast<int>(i), problem.yx[2 * static_cast<size_t>(i)], sigma, static_cast<int>(i)});
  const auto draws = sampled(protocol, measurements, free, count);
  std::vector<WeightedValues> exact;
  size_t size = 1;
  for (size_t j = 0; j < free.size(); ++j) {
    const std::vector<double> values = evenly(free[j].lower, free[j].upper, points[j]);
    exact.push_back({values, std::vector<double>(values.size())});
    size *= values.size();
  }
  std::vector<double> at(free.size());
  for (size_t k = 0; k < size; ++k) {
    size_t rest = k;
    for (size_t j = 0; j < free.size(); ++j) {
      at[j] = exact[j].values[rest % exact[j].values.size()];
      rest /= exact[j].values.size();
    }
    double chi_squared = 0;
    for (const Measurement& m : measurements)
      chi_squared += std::pow((problem.y(x_of(m.row), at) - m.value) / sigma, 2);
    rest = k;
    for (WeightedValues& of : exact) {
      of.weights[rest % of.values.size()] += std::exp(-chi_squared / 2);
      rest /= of.values.size();
    }
  }
  for (size_t j = 0; j < free.size(); ++j) {
    const WeightedValues drawn = of_parameter(draws, j);
    EXPECT_GT(effective_number(drawn.weights), 300);
    expect_alike(drawn, exact[j], problem.name + ", b" + std::to_string(j + 1));
  }
}

/// Noise of thirty and of three times the residuals' deviation, so that the densities are no normal ones; the second is
/// cut off at b1 = 0.
TEST(Posterior, OfCertifiedSetsFollowsTheirDensities) {
  const NistProblem misra = misra1a(), chwirut = chwirut2();
  expect_density_of(misra, 30 * misra.residual_sd, {{0, 250, 100, 1000}, {1, 5e-4, 1e-4, 2e-3}}, {901, 951}, 3000);
  expect_density_of(chwirut, 3 * chwirut.residual_sd,
                    {{0, 0.15, 0, 0.7}, {1, 8e-3, 1e-3, 1.5e-2}, {2, 1e-2, 1e-3, 4e-2}}, {101, 91, 101}, 3000);
}

/// Two springs in series, of which the readings hardly see the stiff one: a curved density with a plateau up to the
/// bound, against the density on a grid.
TEST(Posterior, OfASoftAndAHardlySeenStiffSpringFollowsItsDensity) {
  const Eigen::VectorXd x = Eigen::VectorXd::LinSpaced(6, 0.5, 3);
  const auto values = [x](const Params& p) -> Eigen::VectorXd { return x.array() / p[0] + 1 / p[1]; };
  ClosedFormProtocol springs({{modulus("soft"), 100.0}, {modulus("stiff"), 2000.0}}, values, [x](const Params& p) {
    Eigen::MatrixXd D(x.size(), 2);
    D.col(0) = -x / (p[0] * p[0]);
    D.col(1).setConstant(-1 / (p[1] * p[1]));
    return D;
  });
  Eigen::VectorXd y = values(springs.nominal());
  y.array() += 1e-4 * (x.array() * 7).sin();  // some noise
  const double sigma = 4e-4;
  const std::vector<Measurement> measurements = measured(y, sigma);
  const auto draws = sampled(springs, measurements, {{0, 120, 10, 1000}, {1, 1000, 50, 1e6}}, 4000);
  const std::vector<double> soft = evenly(std::log(80), std::log(130), 401),
                            stiff = evenly(std::log(50), std::log(1e6), 2001);
  WeightedValues of_soft{soft, std::vector<double>(soft.size())}, of_stiff{stiff, std::vector<double>(stiff.size())};
  for (size_t i = 0; i < soft.size(); ++i) {
    for (size_t j = 0; j < stiff.size(); ++j) {
      const Eigen::VectorXd at = values(Eigen::Vector2d(std::exp(soft[i]), std::exp(stiff[j])));
      const double density = std::exp(-(at - y).squaredNorm() / (2 * sigma * sigma));
      of_soft.weights[i] += density;
      of_stiff.weights[j] += density;
    }
  }
  for (size_t j = 0; j < 2; ++j) {
    WeightedValues drawn = of_parameter(draws, j);
    for (double& value : drawn.values) value = std::log(value);
    EXPECT_GT(effective_number(drawn.weights), 400);
    expect_alike(drawn, j == 0 ? of_soft : of_stiff, j == 0 ? "soft" : "stiff");
  }
}

/// Readings that would move a modulus beyond its bound: what is left of its density piles up there.
TEST(Posterior, OfAParameterAtItsBoundIsItsDensityUpToThere) {
  ClosedFormProtocol spring(
      {{modulus("E"), 1000.0}}, [](const Params& p) { return Eigen::VectorXd::Constant(1, 1 / p[0]); },
      [](const Params& p) { return Eigen::MatrixXd::Constant(1, 1, -1 / (p[0] * p[0])); });
  const auto draws = sampled(spring, {{0, 1e-3, 2e-4, 0}}, {{0, 500, 10, 800}}, 4000);
  const auto exact = by_quadrature(evenly(std::log(10), std::log(800), 20001),
                                   [](double q) { return 0.5 * std::pow((std::exp(-q) - 1e-3) / 2e-4, 2); });
  WeightedValues drawn = of_parameter(draws, 0);
  for (double& value : drawn.values) value = std::log(value);
  EXPECT_GT(effective_number(drawn.weights), 400);
  expect_alike(drawn, exact, "ln E");
}

TEST(Posterior, ADrawIsTheSameWhoeverMakesIt) {
  const auto protocol_and_draw = [](std::vector<unsigned> numbers) {
    ClosedFormProtocol spring = stiffening_spring();
    const std::vector<FreeParameter> free{{0, 1000, 10, 1e5}, {1, 0.01, 0.001, 0.1}};
    const std::vector<Measurement> measurements = measured(spring.predict(spring.nominal(), {}).values, 1e-3);
    const FitOptions options;
    PosteriorSampler sampler(spring, measurements, free, options);
    PosteriorDraw last;
    for (unsigned number : numbers) last = sampler.draw(number, 7);
    return last;
  };
  const PosteriorDraw alone = protocol_and_draw({5}), after_others = protocol_and_draw({3, 9, 0, 5});
  ASSERT_EQ(alone.values.size(), 2U);
  EXPECT_EQ(alone.values, after_others.values);
  EXPECT_EQ(alone.log_weight, after_others.log_weight);
  EXPECT_EQ(alone.predicted, after_others.predicted);
  EXPECT_NE(alone.values, protocol_and_draw({6}).values);
}

/// A simulation that fails beyond some stiffness costs the draws that would lie there, and they say so.
TEST(Posterior, WhereTheSimulationFailsThereIsNoDraw) {
  ClosedFormProtocol spring = stiffening_spring();
  const std::vector<Measurement> measurements = measured(spring.predict(spring.nominal(), {}).values, 1e-3);
  const std::vector<FreeParameter> free{{0, 1000, 10, 1e5}, {1, 0.01, 0.001, 0.1}};
  spring.fails = [](const Params& p) { return p[0] > 1010 ? "no equilibrium" : ""; };
  const FitOptions options;
  PosteriorSampler sampler(spring, measurements, free, options);
  int failed = 0;
  for (unsigned k = 0; k < 60; ++k) {
    const PosteriorDraw draw = sampler.draw(k, 1);
    if (!draw.failure.empty()) {
      ++failed;
      EXPECT_TRUE(draw.values.empty());
      EXPECT_FALSE(draw.outside);
    } else {
      EXPECT_LE(draw.values[0], 1010);
    }
  }
  EXPECT_GT(failed, 5);
  EXPECT_LT(failed, 55);
}

TEST(Posterior, WeightedQuantilesAreThoseOfRepeatedValues) {
  const WeightedValues weighted{{3, 1, 2}, {1, 2, 1}};
  const WeightedValues repeated{{1, 1, 2, 3}, {1, 1, 1, 1}};
  EXPECT_DOUBLE_EQ(weighted.mean(), 7.0 / 4);
  EXPECT_DOUBLE_EQ(weighted.deviation(), repeated.deviation());
  EXPECT_DOUBLE_EQ(weighted.quantile(0.625), 2);
  EXPECT_DOUBLE_EQ(weighted.quantile(0.25), 1);
  EXPECT_DOUBLE_EQ(weighted.quantile(0.999), 3);
  EXPECT_DOUBLE_EQ(effective_number({1, 1, 0, 0}), 2);
  EXPECT_EQ(effective_number({}), 0);
}

}  // namespace
}  // namespace taut

#include "calib/fit/spread.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace taut {
namespace {

TEST(Spread, OfBalancedPartsIsTheirVarianceOverTheirNumber) {
  const std::vector<double> x{1, 3, 4, 8}, s(4, 0.5);
  const Spread spread = spread_of(x, s);
  const double mean = 4, variance = (9 + 1 + 0 + 16) / 3.0, t = 3.182446;
  EXPECT_NEAR(spread.mean, mean, 1e-9);
  EXPECT_NEAR(spread.omega * spread.omega, variance - 0.25, 1e-6);
  EXPECT_NEAR(spread.half_width, t * std::sqrt(variance / 4), 1e-5);
  EXPECT_NEAR(spread.next_half_width, t * std::sqrt(variance * (1 + 0.25)), 1e-5);
  EXPECT_TRUE(spread.resolved);
}

TEST(Spread, PartsThatAgreeHaveNone) {
  const Spread spread = spread_of({1, 1.1, 0.9, 1.05}, {0.2, 0.2, 0.1, 2});
  EXPECT_EQ(spread.omega, 0);
  EXPECT_FALSE(spread.resolved);
}

/// Intervals hold the mean in 95 +- 2 % of draws, also where errors are unequal.
TEST(Spread, IntervalsHoldThePlantedMeanIn95PercentOfDraws) {
  std::mt19937 engine(7);
  std::normal_distribution<double> normal;
  for (const std::vector<double>& s : {std::vector<double>(4, 1.0), std::vector<double>(8, 1.0), {1, 1, 1.2, 2, 1.5}}) {
    for (double omega : {1.0, 2.0, 4.0}) {
      int held = 0, next = 0;
      const int draws = 4000;
      for (int i = 0; i < draws; ++i) {
        std::vector<double> x;
        for (double error : s) x.push_back(5 + omega * normal(engine) + error * normal(engine));
        const Spread spread = spread_of(x, s);
        held += std::abs(spread.mean - 5) <= spread.half_width;
        next += std::abs(spread.mean - 5 - omega * normal(engine) - normal(engine)) <= spread.next_half_width;
      }
      EXPECT_NEAR(100.0 * held / draws, 95, 2) << s.size() << " parts, omega " << omega;
      EXPECT_GT(100.0 * next / draws, 92.5) << s.size() << " parts, omega " << omega;
    }
  }
}

}  // namespace
}  // namespace taut

#include "calib/fit/distributions.hpp"

#include <gtest/gtest.h>

#include <cmath>

namespace taut {
namespace {

// Critical values of the NIST/SEMATECH e-Handbook of Statistical Methods, 1.3.6.7.
TEST(Distributions, HoldTheTabulatedCriticalValues) {
  EXPECT_NEAR(chi_squared_probability(3.841, 1), 0.05, 2e-5);
  EXPECT_NEAR(chi_squared_probability(18.307, 10), 0.05, 2e-5);
  EXPECT_NEAR(chi_squared_probability(135.807, 100), 0.01, 2e-5);
  EXPECT_NEAR(f_probability(3.478, 4, 10), 0.05, 2e-5);
  EXPECT_NEAR(f_probability(5.964, 10, 4), 0.05, 2e-5);
  EXPECT_NEAR(t_probability(2.228, 10), 0.05, 2e-5);
  EXPECT_NEAR(t_probability(-2.228, 10), 0.05, 2e-5);
  EXPECT_NEAR(t_quantile(0.975, 10), 2.228, 5e-4);
  EXPECT_NEAR(t_quantile(0.025, 4), -2.776, 5e-4);
}

// Abramowitz and Stegun, Handbook of Mathematical Functions, table 26.1, and Kolmogorov's limits 1.358 and 1.628
// at 5 % and 1 % (Smirnov 1948).
TEST(Distributions, OfTheNormalOneAndKolmogorovs) {
  EXPECT_NEAR(normal_density(1), 0.24197, 1e-5);
  EXPECT_NEAR(normal_probability(1.96), 0.97500, 1e-5);
  EXPECT_NEAR(normal_quantile(0.975), 1.95996, 1e-5);
  EXPECT_NEAR(kolmogorov_probability(1.358e-3, 1'000'000), 0.05, 1e-3);
  EXPECT_NEAR(kolmogorov_probability(1.628e-3, 1'000'000), 0.01, 1e-3);
  EXPECT_NEAR(kolmogorov_probability(0.1340, 100), 0.05, 3e-3);  // exact for 100: Birnbaum 1952
  EXPECT_EQ(kolmogorov_probability(0, 10), 1);
}

TEST(Distributions, NineteenOfTwentyNormalErrorsStayWithinTheQuantile) {
  EXPECT_NEAR(std::erf(z95 / std::sqrt(2.0)), 0.95, 1e-15);
}

TEST(Distributions, NothingIsUnlikelyWithoutDegreesOfFreedom) {
  EXPECT_EQ(chi_squared_probability(100, 0), 1);
}

}  // namespace
}  // namespace taut

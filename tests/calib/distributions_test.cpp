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

TEST(Distributions, NineteenOfTwentyNormalErrorsStayWithinTheQuantile) {
  EXPECT_NEAR(std::erf(z95 / std::sqrt(2.0)), 0.95, 1e-15);
}

TEST(Distributions, NothingIsUnlikelyWithoutDegreesOfFreedom) {
  EXPECT_EQ(chi_squared_probability(100, 0), 1);
}

}  // namespace
}  // namespace taut

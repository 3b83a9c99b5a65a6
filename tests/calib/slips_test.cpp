#include "calib/data/slips.hpp"

#include <gtest/gtest.h>

namespace taut::test {
namespace {

TEST(Slips, FactorsAreToldApart) {
  EXPECT_NE(slip_of(9.84, 0.05).find("9.81"), std::string::npos);
  EXPECT_NE(slip_of(10.01, 0.05).find("10:"), std::string::npos);
  EXPECT_NE(slip_of(1.0 / 1000, 0.01).find("smaller by 1000"), std::string::npos);
  EXPECT_EQ(slip_of(3, 0.05), "");
}

}  // namespace
}  // namespace taut::test

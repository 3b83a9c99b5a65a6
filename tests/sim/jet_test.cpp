#include "sim/core/jet.hpp"

#include <gtest/gtest.h>

namespace taut::test {
namespace {

/// Every operation of a Jet once.
template <class T>
T everything(const T& x, const T& y) {
  using std::cos;
  using std::log;
  using std::sin;
  using std::sqrt;
  using std::tanh;
  const T sum = 2.0 + x * y - 0.5 * x / y + (1.0 - y) * 3.0 - 1.0;
  return sin(x) * cos(y) + log(x) / sqrt(y) + tanh(sum) + 2.0 / (x + y) - y / 3.0;
}

TEST(Jet, ItsDerivativesLeaveARemainderOfThirdOrder) {
  const Eigen::Vector2d at(0.7, 1.3), way(0.6, -0.8);
  const Jet<2> f = everything(Jet<2>::variable(at.x(), 0), Jet<2>::variable(at.y(), 1));
  EXPECT_DOUBLE_EQ(f.v, everything(at.x(), at.y()));
  const auto remainder = [&](double h) {
    const Eigen::Vector2d moved = at + h * way;
    return everything(moved.x(), moved.y()) - f.v - h * f.g.dot(way) - 0.5 * h * h * way.dot(f.H * way);
  };
  EXPECT_NEAR(std::log2(remainder(2e-3) / remainder(1e-3)), 3, 0.05);
  EXPECT_TRUE(f.H.isApprox(f.H.transpose(), 1e-15));
}

}  // namespace
}  // namespace taut::test

#include "sim/core/dense.hpp"

#include <gtest/gtest.h>

#include <limits>
#include <random>

namespace taut {
namespace {

constexpr double open_end = std::numeric_limits<double>::infinity();

/// The smallest |A x - b| within bounds: of all ways of having entries at their lower bound, at their upper one, or in
/// between, the best that is allowed.
double best_of_all(const Eigen::MatrixXd& A, const Eigen::VectorXd& b, const Eigen::VectorXd& lower,
                   const Eigen::VectorXd& upper) {
  const Eigen::Index n = A.cols();
  double best = open_end;
  const int ways = static_cast<int>(std::lround(std::pow(3, n)));
  for (int way = 0; way < ways; ++way) {
    Eigen::VectorXd x = lower;
    std::vector<Eigen::Index> between;
    for (Eigen::Index j = 0, rest = way; j < n; ++j, rest /= 3) {
      if (rest % 3 == 2) between.push_back(j);
      x[j] = rest % 3 == 0 ? lower[j] : rest % 3 == 1 ? upper[j] : 0.0;
    }
    if (!between.empty()) {
      const Eigen::MatrixXd part = A(Eigen::all, between);
      const Eigen::VectorXd rest = b - A * x;
      const Eigen::VectorXd solution = (part.transpose() * part).ldlt().solve(part.transpose() * rest);
      x(between) = solution;
    }
    if ((x.array() < lower.array()).any() || (x.array() > upper.array()).any()) continue;
    best = std::min(best, (A * x - b).norm());
  }
  return best;
}

TEST(BoundedLeastSquares, FindsTheBestOfAllChoicesOfBounds) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform(-1, 1);
  int at_bounds = 0;
  for (int trial = 0; trial < 200; ++trial) {
    const auto drawn = [&](Eigen::Index rows, Eigen::Index columns) {
      return Eigen::MatrixXd::NullaryExpr(rows, columns, [&] { return uniform(random); }).eval();
    };
    const Eigen::MatrixXd A = drawn(7, 4);
    const Eigen::VectorXd b = 3 * drawn(7, 1);
    const Eigen::VectorXd lower = (-1 - drawn(4, 1).array()).matrix(), upper = (1 + drawn(4, 1).array()).matrix();
    const Eigen::VectorXd x = bounded_least_squares(A, b, lower, upper);
    ASSERT_TRUE((x.array() >= lower.array()).all() && (x.array() <= upper.array()).all()) << trial;
    const double best = best_of_all(A, b, lower, upper);
    ASSERT_NEAR((A * x - b).norm(), best, 1e-9 * best) << trial;
    at_bounds += static_cast<int>((x.array() == lower.array() || x.array() == upper.array()).count());
  }
  EXPECT_GT(at_bounds, 100);
}

TEST(BoundedLeastSquares, WithoutBoundsIsTheSmallestSolution) {
  Eigen::MatrixXd A(3, 2);
  A << 1, 1, 2, 2, 3, 3;
  const Eigen::Vector2d open = Eigen::Vector2d::Constant(open_end);
  const Eigen::VectorXd x = bounded_least_squares(A, Eigen::Vector3d(2, 4, 6), -open, open);
  EXPECT_NEAR(x[0], 1, 1e-12);
  EXPECT_NEAR(x[1], 1, 1e-12);
}

// Two columns that are nearly alike, one of them held: the other does it alone, however far both together would go.
TEST(BoundedLeastSquares, WhatIsHeldHasNoPartInIt) {
  Eigen::MatrixXd A(2, 2);
  A << -37.458805296319653, -71.675185944799694, -74.917586248965733, -143.35033012912015;
  const Eigen::Vector2d b(0.89932691418689958, 1.7986758631347304);
  const Eigen::VectorXd x = bounded_least_squares(A, b, Eigen::Vector2d(-4, 0), Eigen::Vector2d(2, 0));
  EXPECT_NEAR(x[0], A.col(0).dot(b) / A.col(0).squaredNorm(), 1e-12);
  EXPECT_EQ(x[1], 0);
}

// What one of two columns that are alike cannot do, the other does.
TEST(BoundedLeastSquares, WhatABoundTakesFromOneTheOtherMakesUpFor) {
  Eigen::MatrixXd A(2, 3);
  A << 1, 1, 0, 0, 0, 1;
  const Eigen::VectorXd x =
      bounded_least_squares(A, Eigen::Vector2d(5, 7), Eigen::Vector3d(0, 0, 3), Eigen::Vector3d(0.5, open_end, 3));
  EXPECT_NEAR(x[0], 0.5, 1e-12);
  EXPECT_NEAR(x[1], 4.5, 1e-12);
  EXPECT_EQ(x[2], 3) << "held";
}

}  // namespace
}  // namespace taut

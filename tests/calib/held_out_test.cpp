#include "calib/fit/held_out.hpp"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>

namespace taut::test {
namespace {

/// y = a + b x + c (x > 9): nine readings, the last two of which alone see c.
struct Line {
  Prediction prediction;
  std::vector<Measurement> measurements;
  FitResult fit;

  explicit Line(bool step) {
    const Eigen::Index n = 9, count = step ? 3 : 2;
    Eigen::MatrixXd X = Eigen::MatrixXd::Zero(n, count);
    Eigen::VectorXd y(n);
    for (Eigen::Index i = 0; i < n; ++i) {
      X(i, 0) = 1;
      X(i, 1) = static_cast<double>(i > 6 ? i + 1 : i);
      if (step) X(i, 2) = i > 6 ? 1 : 0;
      y[i] = 3 + 0.5 * X(i, 1) + 0.3 * std::sin(7.0 * static_cast<double>(i));
    }
    const Eigen::VectorXd b = (X.transpose() * X).ldlt().solve(X.transpose() * y);
    prediction.values = X * b;
    prediction.derivatives = X;
    for (int i = 0; i < n; ++i) measurements.push_back({i, y[i], 0.2, i});
    for (Eigen::Index j = 0; j < count; ++j) {
      ParameterEstimate& e = fit.parameters.emplace_back();
      e.spec.id = std::string(1, "abc"[j]);
      e.value = b[j];
      e.lower = -100;
      e.upper = 100;
    }
  }
};

TEST(HeldOut, ChiSquaredIsThatOfALineThroughTheOtherPoints) {
  const Line line(false);
  const HeldOut part = held_out(line.prediction, line.measurements, line.fit, "x < 3", {0, 1, 2});
  // The same by a fit of the other six, its prediction, and the covariance of that.
  const Eigen::MatrixXd rest = line.prediction.derivatives.bottomRows(6), own = line.prediction.derivatives.topRows(3);
  Eigen::VectorXd y(9);
  for (int i = 0; i < 9; ++i) y[i] = line.measurements[static_cast<size_t>(i)].value;
  const Eigen::MatrixXd C = (rest.transpose() * rest).inverse() * 0.04;
  const Eigen::VectorXd miss = y.head(3) - own * (C / 0.04 * rest.transpose() * y.tail(6));
  const Eigen::MatrixXd covariance = own * C * own.transpose() + 0.04 * Eigen::MatrixXd::Identity(3, 3);
  EXPECT_NEAR(part.chi_squared, miss.dot(covariance.inverse() * miss), 1e-9 * part.chi_squared);
  EXPECT_EQ(part.dof, 3);
  EXPECT_EQ(part.readings, 3);
  EXPECT_TRUE(part.own.empty());
}

TEST(HeldOut, WhatOnlyThePartSeesIsNotPredicted) {
  const Line line(true);
  const HeldOut part = held_out(line.prediction, line.measurements, line.fit, "x > 7", {7, 8});
  EXPECT_EQ(part.dof, 1) << "their difference";
  EXPECT_EQ(part.own, std::vector<std::string>{"c"});
  EXPECT_GT(part.p_value, 0);
}

}  // namespace
}  // namespace taut::test

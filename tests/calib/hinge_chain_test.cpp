#include "calib/models/hinge_chain.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "sim/core/error.hpp"

// The chain that simulators are given: closed forms, and the elastica that it becomes with many hinges.
namespace taut {
namespace {

HingeChain straight(int hinges, double length) {
  HingeChain chain;
  for (int i = 0; i < hinges; ++i) chain.hinges.emplace_back((i + 0.5) * length / hinges, 0);
  return chain;
}

TEST(HingeChain, OneHingeTurnsAsItsSpringAllows) {
  const HingeChain chain = straight(1, 0.2);  // a lever of 0.1 m
  const double k = 0.1, F = 2;
  const Eigen::VectorXd turns = hinge_chain_equilibrium(chain, k, {{{1, {0.2, 0}}, {0, -F}}});
  ASSERT_EQ(turns.size(), 1);
  EXPECT_LT(turns[0], -0.5);
  EXPECT_NEAR(k * turns[0] + F * 0.1 * std::cos(turns[0]), 0, 1e-12);
}

TEST(HingeChain, TurnsAreLinearInSmallLoadsByTheirLevers) {
  const HingeChain chain = straight(4, 0.4);
  const double k = 1, F = 1e-5;
  const Eigen::VectorXd turns = hinge_chain_equilibrium(chain, k, {{{4, {0.4, 0}}, {0, -F}}});
  double drop = 0;  // levers 0.35, 0.25, 0.15, 0.05 m
  for (const double lever : {0.35, 0.25, 0.15, 0.05}) drop += F * lever * lever / k;
  EXPECT_NEAR(chain.where({4, {0.4, 0}}, turns).y(), -drop, 1e-6 * drop);
}

/// Tip drops of a cantilever under F L^2 / EI = 1, 2, 5, 10 (Bisshopp and Drucker 1945; Mattiasson 1981).
TEST(HingeChain, ManyHingesAreTheElastica) {
  const int n = 200;
  const HingeChain chain = straight(n, 1);
  const double EI = 1;
  HingeCurve curve;
  curve.load = curve.watched = {n, {1, 0}};
  curve.forces = {1, 2, 5, 10};
  const std::vector<double> drops = hinge_chain_curve(chain, EI * n, curve);
  const std::vector<double> known{0.30172, 0.49346, 0.71379, 0.81061};
  for (size_t i = 0; i < known.size(); ++i) EXPECT_NEAR(drops[i], known[i], 2e-5) << curve.forces[i];
}

TEST(HingeChain, HangsAsAPendulumWhereItsSpringIsWeak) {
  const HingeChain chain = straight(1, 2);
  const Eigen::VectorXd turns = hinge_chain_equilibrium(chain, 1e-9, {{{1, {2, 0}}, {0, -1}}});
  EXPECT_NEAR(turns[0], -1.5707963, 1e-6);
}

TEST(HingeChain, TheFitFindsTheStiffnessThatMadeACurve) {
  const HingeChain chain = straight(5, 0.1);
  HingeCurve curve;
  curve.load = {5, {0.1, 0}};
  curve.watched = {4, {0.08, 0.01}};
  curve.forces = {0.5, 1, 2, 4};
  curve.always = {{{5, {0.095, 0}}, {0, -0.3}}};  // a weight
  curve.displacements = hinge_chain_curve(chain, 0.123, curve);
  EXPECT_GT(curve.displacements.back(), 0.02);  // far from linear
  const HingeFit fit = fit_hinges(chain, curve);
  EXPECT_NEAR(fit.stiffness, 0.123, 1e-6);
  EXPECT_LT(fit.largest, 1e-5);
}

/// Two loads of a curve that no linear spring follows, drops d and 1.2 d at F and F small: the least squares of
/// relative misses. With drop = c F / k: minimise (c/k - 1)^2 + (c/(1.2 k) - 1)^2 over x = c/k, x = (1 + 1/1.2)/(1 +
/// 1/1.44).
TEST(HingeChain, TheDifferenceThatRemainsIsTheLargestRelativeOne) {
  const HingeChain chain = straight(1, 2);  // a lever of 1 m
  HingeCurve curve;
  curve.load = curve.watched = {1, {2, 0}};
  curve.forces = {1e-6, 2e-6};
  curve.displacements = {1e-6, 2.4e-6};
  const HingeFit fit = fit_hinges(chain, curve);
  const double x = (1 + 1 / 1.2) / (1 + 1 / 1.44);
  EXPECT_NEAR(fit.stiffness, 1 / x, 1e-6);
  EXPECT_NEAR(fit.largest, 1 - x / 1.2, 1e-5);
  EXPECT_EQ(fit.at, 2e-6);
}

TEST(HingeChain, WhatNoChainFollowsIsRefused) {
  const HingeChain chain = straight(2, 1);
  HingeCurve curve;
  curve.load = curve.watched = {2, {1, 0}};
  curve.forces = {1};
  curve.displacements = {-0.1};
  EXPECT_THROW(fit_hinges(chain, curve), InputError);
  curve.displacements = {0.1};
  curve.load_direction = {1, 0};
  EXPECT_THROW(fit_hinges(chain, curve), InputError);
}

}  // namespace
}  // namespace taut

#include "tests/support/push_puppet.hpp"

#include <gtest/gtest.h>

// The reference module against effective stiffnesses of an independent program (mesh-converged to 0.2 %, pair-sum
// contact with kappa = 1e5 N/m and dhat = 0.1 mm, a shared vertex counted once).
namespace taut::test {
namespace {

constexpr double kTable[4][4] = {
    {130.1, 140.5, 163.1, 261.8}, {284.2, 289.2, 308.5, 447.7}, {528.2, 536.7, 570.2, 940.3}, {7412, 7419, 7450, 7732}};
constexpr double kTension[4] = {0, 3.34, 7.49, 16.72};

Prediction replay(const Experiment& experiment) {
  const StaticReplay bench = make_static_replay(experiment, experiment.mesh, conditions_of());
  Prediction prediction = bench.protocol->predict(bench.protocol->nominal(), {});
  for (const std::string& failure : prediction.failures) ADD_FAILURE() << failure;
  return prediction;
}

TEST(PushPuppetModule, OpenRetractionsAreWithinHalfAPercentOfTheTable) {
  Experiment e = reference_module();
  e.contact.form = ContactForm::pair_sum_dedup;
  e.contact.stiffness = 1e5;
  e.mesh.contact_gap = 0.1e-3;
  e.contact.compensate = false;
  const Prediction prediction = replay(e);
  for (size_t u = 0; u < 3; ++u) {
    for (size_t m = 0; m < 4; ++m) {
      EXPECT_NEAR(stiffness(prediction, u, m) / kTable[u][m], 1, 0.005) << "retraction " << u << ", mass " << m;
    }
  }
  // Closed, a pair sum depends on where the nodes stand: 12 % are stated for twice as many.
  for (size_t m = 0; m < 4; ++m) EXPECT_NEAR(stiffness(prediction, 3, m) / kTable[3][m], 1, 0.12) << "mass " << m;
}

TEST(PushPuppetModule, WithoutStandOffLightLoadsOnOpenRetractionsStayWithinHalfAPercentOfTheTable) {
  const Prediction prediction = replay(reference_module());
  for (size_t u = 0; u < 3; ++u) {
    for (size_t m = 0; m < 3; ++m) EXPECT_NEAR(stiffness(prediction, u, m) / kTable[u][m], 1, 0.005);
  }
}

TEST(PushPuppetModule, CableTensionsAreThoseOfTheTable) {
  const Experiment e = reference_module();
  const StaticReplay bench = make_static_replay(e, e.mesh, conditions_of({0, 5.89e-3, 11.79e-3}, {0}));
  bench.protocol->predict(bench.protocol->nominal(), {});
  for (size_t c = 0; c < 3; ++c) {
    const auto& condition = bench.protocol->conditions()[c];
    const auto tension = make_cable_tension(bench.protocol->scene().model->mesh(), bench.cables[0]);
    EXPECT_NEAR(tension->value({condition.u, condition.p}), kTension[c], 0.005 * kTension[c] + 0.005);
  }
}

TEST(SlowPushPuppetModule, TheClosedStiffnessDoesNotDependOnContactGapOrNodesOnTheLips) {
  const Experiment e = reference_module();
  Experiment half = e, nodes = e;
  half.mesh.contact_gap = 0.5 * 2e-5 * 74e-3;  // the default is 2e-5 of the module's diagonal
  nodes.mesh.counts["lip_cells"] = 2 * PushPuppetMesh().lip_cells;
  const Prediction usual = replay(e), smaller = replay(half), doubled = replay(nodes);
  for (size_t m = 0; m < 4; ++m) {
    EXPECT_NEAR(stiffness(smaller, 3, m) / stiffness(usual, 3, m), 1, 0.02);
    EXPECT_NEAR(stiffness(doubled, 3, m) / stiffness(usual, 3, m), 1, 0.01);
    const double limit = 2 * stiffness(smaller, 3, m) - stiffness(usual, 3, m);
    EXPECT_NEAR(stiffness(usual, 3, m) / limit, 1, 0.03) << "extrapolated to no gap";
    std::printf("closed, %.0f g: %.1f N/m, half the gap %.1f, twice the nodes %.1f, no gap (extrapolated) %.1f\n",
                1e3 * kMasses[m], stiffness(usual, 3, m), stiffness(smaller, 3, m), stiffness(doubled, 3, m), limit);
  }
}

TEST(SlowPushPuppetModule, NewtonIterationsHardlyDependOnTheStiffnessRatio) {
  std::vector<int> iterations;
  for (double ratio : {4e4, 4e5, 4e6}) {
    Experiment e = reference_module();
    e.materials[1].constants["E"] = ratio * e.materials[0].constants["E"];
    const StaticReplay bench = make_static_replay(e, e.mesh, conditions_of());
    EXPECT_TRUE(bench.protocol->predict(bench.protocol->nominal(), {}).complete());
    iterations.push_back(bench.protocol->newton_iterations());
    std::printf("E_plastic / E_foam = %g: %d Newton iterations for 16 conditions\n", ratio, iterations.back());
  }
  const auto [fewest, most] = std::minmax_element(iterations.begin(), iterations.end());
  EXPECT_LE(*most, 1.5 * *fewest);
}

TEST(SlowPushPuppetModule, SensitivitiesOfAllDisplacementsHaveSlopeTwoWithContactActive) {
  Experiment e = reference_module(1);
  e.equilibrium.step_tolerance = 1e-11;  // the smallest remainders are 1e-11 m
  const StaticReplay bench = make_static_replay(e, e.mesh, conditions_of());
  StaticProtocol& protocol = *bench.protocol;
  const Params p = protocol.nominal();
  std::vector<int> free;
  for (const char* id : {"E_foam", "nu_foam", "E_plastic", "nu_plastic", "k_cable", "slack", "thickness"})
    free.push_back(protocol.parameters().index(id));
  const Prediction at = protocol.predict(p, free);
  ASSERT_TRUE(at.complete());
  for (size_t i = 0; i < free.size(); ++i) {
    const int index = free[i];
    const bool length = protocol.parameters()[index].id == "slack";
    const double scale = length ? 1e-3 : p[index];
    // Remainders of all rows together.
    const StaticReplay other = make_static_replay(e, e.mesh, conditions_of());
    std::vector<double> steps{4e-3, 2e-3, 1e-3, 5e-4}, remainders;
    for (double h : steps) {
      Params q = p;
      q[index] += h * scale;
      const Prediction moved = other.protocol->predict(q, {});
      remainders.push_back(
          (moved.values - at.values - h * scale * at.derivatives.col(static_cast<Eigen::Index>(i))).norm());
    }
    const double slope = std::log(remainders.front() / remainders.back()) / std::log(steps.front() / steps.back());
    std::printf("%s: remainders %.2e %.2e %.2e %.2e, slope %.2f\n", protocol.parameters()[index].id.c_str(),
                remainders[0], remainders[1], remainders[2], remainders[3], slope);
    EXPECT_NEAR(slope, 2, 0.2) << protocol.parameters()[index].id;
  }
}

TEST(SlowPushPuppetModule, TwoThreadsGiveTheSameBitsAsOne) {
  Experiment e = reference_module(1);
  e.threads = 1;
  const StaticReplay one = make_static_replay(e, e.mesh, conditions_of());
  e.threads = 2;
  const StaticReplay two = make_static_replay(e, e.mesh, conditions_of());
  const std::vector<int> free{one.protocol->parameters().index("E_foam")};
  Params p = one.protocol->nominal();
  for (int round = 0; round < 2; ++round) {  // cold, then warm
    const Prediction a = one.protocol->predict(p, free), b = two.protocol->predict(p, free);
    EXPECT_EQ(a.values, b.values);
    EXPECT_EQ(a.derivatives, b.derivatives);
    p[free[0]] *= 1.1;
  }
}

}  // namespace
}  // namespace taut::test

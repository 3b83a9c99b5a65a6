#include "tests/support/kinsol_equilibrium.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "sim/terms/cable.hpp"
#include "tests/support/problems.hpp"

namespace taut::test {
namespace {

double largest(const Eigen::VectorXd& v) {
  return v.cwiseAbs().maxCoeff();
}

/// A soft block that stands on its base, a cable to one side of its top.
Scene block_with_cable(int* retraction, int* force) {
  SceneBuilder builder(rectangle(graded(0.03, 4), graded(0.05, 6), 2, "block"), Plane::strain, 0.03);
  builder.add_solid("block", "neo_hookean", {{"E", 5e4}, {"nu", 0.2}});
  builder.fix("ymin", {0, 1});
  Cable cable;
  cable.points = {{{}, Eigen::Vector2d(-0.04, 0)}, {locate(builder.mesh(), Eigen::Vector2d(0.004, 0.048)), {}}};
  cable.stiffness = builder.declare({"k", "k", "N/m", 0, 1e9, "stiffness"}, 2000);
  cable.retraction = *retraction = builder.declare({"retraction", "u", "m", -1, 1, "retraction"}, 0.0);
  builder.add_cable(cable);
  *force = builder.declare({"force", "F", "N", -1e3, 1e3, "load"}, 0.0);
  builder.add_force("xmax", Eigen::Vector2d(1, 0), *force);
  return builder.build();
}

TEST(KinsolEquilibrium, FindsTheSameLoadedBlockWithACableAsTheMinimiser) {
  int retraction = -1, force = -1;
  const Scene scene = block_with_cable(&retraction, &force);
  Params p = scene.values;
  p[retraction] = 0.012;
  p[force] = 3;
  Equilibrium equilibrium(*scene.model);
  equilibrium.start_at_rest(scene.values);
  ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged);
  const KinsolResult result = kinsol_equilibrium(*scene.model, p, Eigen::VectorXd::Zero(scene.model->unknowns()));
  ASSERT_EQ(result.status, SolveStatus::converged) << result.words;
  EXPECT_TRUE(result.minimum);
  EXPECT_LT(largest(result.u - equilibrium.u()), 1e-7 * scene.model->length_scale());
  EXPECT_GT(largest(result.u), 5e-3) << "the block has to move";
  EXPECT_GT(result.iterations, 1);
  EXPECT_GE(result.factorisations, result.iterations);
}

TEST(KinsolEquilibrium, LandsOnTheSaddleOfAPerfectColumnThatTheMinimiserLeaves) {
  const double E = 1e5, L = 0.1, H = 0.01, t = 0.03;
  const double euler = E * t * H * H * H / 12 * std::pow(M_PI / (2 * L), 2);
  SceneBuilder builder(rectangle(graded(L, 20), {0, H / 2, H}, 2, "column"), Plane::strain, t);
  builder.add_solid("column", "neo_hookean", {{"E", E}, {"nu", 0.0}});
  const Problem problem = loaded_on_xmax(std::move(builder), {-1, 0});
  Params p = problem.scene.values;
  p[problem.force] = 1.3 * euler;
  const Model& model = *problem.scene.model;
  const KinsolResult result = kinsol_equilibrium(model, p, Eigen::VectorXd::Zero(model.unknowns()));
  ASSERT_EQ(result.status, SolveStatus::converged) << result.words;
  EXPECT_FALSE(result.minimum);
  double sideways = 0;
  for (int i = 0; i < model.mesh().node_count(); ++i) {
    if (std::abs(model.mesh().X[2 * i + 1] - H / 2) < 1e-9)
      sideways = std::max(sideways, std::abs(result.u[2 * i + 1]));
  }
  EXPECT_LT(sideways, 1e-6 * L) << "straight";
  EXPECT_NEAR(problem.tip.dot(result.u), 1.3 * euler * L / (E * t * H), 0.05 * 1.3 * euler * L / (E * t * H));

  Equilibrium equilibrium(model);
  equilibrium.start_at_rest(problem.scene.values);
  ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged);
  EXPECT_TRUE(equilibrium.report().left_saddle);
  EXPECT_GT(largest(equilibrium.u()), 0.3 * L);
}

TEST(KinsolEquilibrium, PrescribedDisplacementsAreImposed) {
  SceneBuilder builder(rectangle(graded(0.02, 2), graded(0.01, 1), 2, "bar"), Plane::strain, 0.03);
  builder.add_solid("bar", "neo_hookean", {{"E", 1e5}, {"nu", 0.0}});
  const int pull = builder.declare({"pull", "u", "m", -1, 1, "pull"}, 0.004);
  builder.fix("xmin", {0});
  builder.fix("ymin", {1});
  builder.prescribe("xmax", 0, pull);
  const Scene scene = builder.build();
  const KinsolResult result =
      kinsol_equilibrium(*scene.model, scene.values, Eigen::VectorXd::Zero(scene.model->unknowns()));
  ASSERT_EQ(result.status, SolveStatus::converged) << result.words;
  for (int i = 0; i < scene.model->mesh().node_count(); ++i)
    EXPECT_NEAR(result.u[2 * i], 0.2 * scene.model->mesh().X[2 * i], 1e-9) << "homogeneous stretch";
}

TEST(KinsolEquilibrium, AnInfeasibleStartAndTooFewIterationsAreSaid) {
  const Problem problem = problem_a1(2, 1);
  const Model& model = *problem.scene.model;
  Params p = problem.scene.values;
  p[problem.force] = 5;
  EXPECT_EQ(kinsol_equilibrium(model, p, -2 * model.mesh().X).status, SolveStatus::infeasible_start);
  KinsolOptions options;
  options.max_iterations = 1;
  const KinsolResult result = kinsol_equilibrium(model, p, Eigen::VectorXd::Zero(model.unknowns()), options);
  EXPECT_EQ(result.status, SolveStatus::iteration_limit);
  EXPECT_GT(result.gradient, 0.0);
  EXPECT_FALSE(result.words.empty());
}

}  // namespace
}  // namespace taut::test

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "calib/fit/fit.hpp"
#include "sim/terms/cable.hpp"
#include "tests/support/arm.hpp"
#include "tests/support/closed_form_protocol.hpp"
#include "tests/support/kinsol_equilibrium.hpp"
#include "tests/support/message.hpp"
#include "tests/support/problems.hpp"

// Where naive methods fail at equilibria: every scene shows the failure, and what the default does instead, against an
// answer that does not come from it.
namespace taut::test {
namespace {

/// The solver as it is but for one thing, without halving load steps: what one Newton search does.
EquilibriumOptions at_once(int iterations = 60) {
  return {.max_iterations = iterations, .max_halvings = 0};
}

struct Solved {
  SolveReport report;
  Eigen::VectorXd u;
};

Solved solved(const Scene& scene, const Params& p, const EquilibriumOptions& options = {}) {
  Equilibrium equilibrium(*scene.model, options);
  equilibrium.start_at_rest(scene.values);
  const SolveReport report = equilibrium.solve(p);
  return {report, equilibrium.u()};
}

Params with(const Scene& scene, int index, double value) {
  Params p = scene.values;
  p[index] = value;
  return p;
}

double distance(const Scene& scene, const Eigen::VectorXd& a, const Eigen::VectorXd& b) {
  return (a - b).cwiseAbs().maxCoeff() / scene.model->length_scale();
}

/// Drop of the tip of an inextensible cantilever over its length under a dead load P across its end,
/// alpha = P L^2 / (E I): elliptic integrals.
double elastica_drop(double alpha) {
  const auto start = [](double k) { return std::asin(1 / (k * std::sqrt(2.0))); };
  double low = std::sqrt(0.5), high = 1 - 1e-15;
  for (int i = 0; i < 200; ++i) {
    const double k = 0.5 * (low + high);
    (std::comp_ellint_1(k) - std::ellint_1(k, start(k)) < std::sqrt(alpha) ? low : high) = k;
  }
  return 1 - 2 / std::sqrt(alpha) * (std::comp_ellint_2(low) - std::ellint_2(low, start(low)));
}

/// 100 x 5 mm, plane strain, nu = 0.3.
Problem slender() {
  return cantilever(0.1, 0.005, 1e5, 0.3, 20, 1, 2);
}

TEST(Stress, FullStepsWithoutALineSearchFoldTheCantileverThatTheDefaultBendsOntoTheElastica) {
  const Problem problem = slender();
  const double force = 0.05, stiffness = 1e5 / (1 - 0.09) * 0.03 * std::pow(0.005, 3) / 12;
  const Params p = with(problem.scene, problem.force, force);
  EquilibriumOptions naive = at_once(400);
  naive.comparison.line_search = LineSearch::none;
  const Solved folded = solved(problem.scene, p, naive), bent = solved(problem.scene, p, at_once());
  EXPECT_NE(folded.report.status, SolveStatus::converged);
  EXPECT_LE(folded.report.iterations, 3) << "elements turned inside out, not merely slow";
  EXPECT_GT(folded.report.gradient, 100 * force) << "out-of-balance force [N]";
  ASSERT_EQ(bent.report.status, SolveStatus::converged) << bent.report.message();
  EXPECT_NEAR(problem.tip.dot(bent.u) / 0.1, elastica_drop(force * 0.01 / stiffness), 0.01);
}

TEST(Stress, ProjectingEveryHessianTakesManyTimesTheIterationsOfProjectingOnDemand) {
  const Problem problem = slender();
  for (double force : {0.05, 0.2, 1.0}) {
    const Params p = with(problem.scene, problem.force, force);
    EquilibriumOptions naive = at_once(400);
    naive.comparison.always_project = true;
    const Solved projected = solved(problem.scene, p, naive), exact = solved(problem.scene, p, at_once());
    ASSERT_EQ(exact.report.status, SolveStatus::converged) << exact.report.message();
    EXPECT_GT(projected.report.iterations, 2.5 * exact.report.iterations) << force << " N";
    EquilibriumOptions fine;
    fine.load_steps = 32;
    fine.max_total_iterations = 2000;
    EXPECT_LT(distance(problem.scene, exact.u, solved(problem.scene, p, fine).u), 1e-8) << "the path in 32 steps";
  }
}

TEST(Stress, StraightStepsWithTheEnergyAloneCreepAtStiffnessRatiosThatTheDefaultDoesNotFeel) {
  // 2 N on the layered block. The plastic's own compliance is what is left of the ratio in the answer.
  Problem problem = problem_a3(1, 2);
  const int plastic = problem.scene.model->parameters().index("E_plastic");
  std::vector<double> tips;
  for (double ratio : {1e4, 1e5, 1e6, 1e7}) {
    problem.scene.values[plastic] = 5e4 * ratio;
    const Params p = with(problem.scene, problem.force, 2);
    EquilibriumOptions naive = at_once(400);
    naive.comparison.straight_steps = true;
    naive.comparison.line_search = LineSearch::armijo;
    const Solved creeping = solved(problem.scene, p, naive), quick = solved(problem.scene, p, at_once());
    ASSERT_EQ(quick.report.status, SolveStatus::converged) << quick.report.message();
    EXPECT_LE(quick.report.iterations, 8) << ratio;
    EXPECT_GT(creeping.report.iterations, (ratio < 1e5 ? 4 : 10) * quick.report.iterations) << ratio;
    tips.push_back(problem.tip.dot(quick.u));
  }
  EXPECT_NEAR((tips[0] - tips[1]) / (tips[1] - tips[2]), 10, 0.1);
  EXPECT_NEAR((tips[1] - tips[2]) / (tips[2] - tips[3]), 10, 0.3);
}

TEST(Stress, ARootFinderOnTheForcesGetsNowhereWhereTheMinimiserNeedsSixIterations) {
  Problem problem = problem_a3(1, 2);
  const Params p = with(problem.scene, problem.force, 2);
  const Solved quick = solved(problem.scene, p, at_once());
  const KinsolResult root =
      kinsol_equilibrium(*problem.scene.model, p, Eigen::VectorXd::Zero(problem.scene.model->unknowns()));
  ASSERT_EQ(quick.report.status, SolveStatus::converged);
  EXPECT_LE(quick.report.iterations, 8);
  EXPECT_EQ(root.status, SolveStatus::iteration_limit);
  EXPECT_LT(problem.tip.dot(root.u), 0.1 * problem.tip.dot(quick.u)) << "after 200 iterations";
  // Started beside the minimiser's answer, the root finder agrees with it.
  const KinsolResult near = kinsol_equilibrium(*problem.scene.model, p, (1 - 1e-6) * quick.u);
  ASSERT_EQ(near.status, SolveStatus::converged) << near.words;
  EXPECT_LT(distance(problem.scene, near.u, quick.u), 1e-7);
}

TEST(Stress, AMotorTurnedBy172DegreesInOneStepDefeatsFullStepsAndTheRootFinderOnly) {
  SceneBuilder builder = arm_builder(1);
  builder.add_joint(arm_joint(0));
  const Scene scene = builder.build();
  const Params p = with(scene, scene.model->parameters().index("joint1"), 3.0);
  EquilibriumOptions naive = at_once(400);
  naive.comparison.line_search = LineSearch::none;
  EXPECT_NE(solved(scene, p, naive).report.status, SolveStatus::converged);
  const KinsolResult root = kinsol_equilibrium(*scene.model, p, Eigen::VectorXd::Zero(scene.model->unknowns()));
  EXPECT_EQ(root.status, SolveStatus::stalled);
  const Solved turned = solved(scene, p, at_once());
  ASSERT_EQ(turned.report.status, SolveStatus::converged) << turned.report.message();
  const Eigen::Vector2d rigid = Eigen::Vector2d(arm_base, 0) + arm_link * Eigen::Vector2d(std::cos(3.0), std::sin(3.0));
  EXPECT_LT((arm_tip(scene.model->mesh(), turned.u) - rigid).norm(), 1e-6);
}

TEST(Stress, ALargeLoadInOneStepFindsAnotherEquilibriumAndACheckedPathDoesNot) {
  // 20 N bend the short cantilever by more than its length. Several equilibria exist, and even the default, alone and
  // at once, ends in another one than the path from rest leads to. Only a check of the path shortens the steps.
  const Problem problem = problem_a1(4, 2);
  const Params p = with(problem.scene, problem.force, 20);
  EquilibriumOptions fine, checked;
  fine.load_steps = 64;
  fine.max_total_iterations = checked.max_total_iterations = 2000;
  checked.check_path = true;
  const Solved path = solved(problem.scene, p, fine), jump = solved(problem.scene, p, at_once()),
               sure = solved(problem.scene, p, checked);
  ASSERT_EQ(path.report.status, SolveStatus::converged);
  ASSERT_EQ(jump.report.status, SolveStatus::converged);
  ASSERT_EQ(sure.report.status, SolveStatus::converged);
  EXPECT_GT(distance(problem.scene, jump.u, path.u), 5e-3);
  EXPECT_LT(distance(problem.scene, sure.u, path.u), 1e-8);
  EXPECT_GT(sure.report.load_steps, 1);
  EXPECT_FALSE(sure.report.slipped);
}

TEST(Stress, WithoutATestForAMinimumAPerfectColumnStaysStraightAboveItsBucklingLoad) {
  const double L = 0.2, H = 0.002, E = 1e6, t = 0.03, euler = E * t * H * H * H / 12 * std::pow(M_PI / (2 * L), 2);
  SceneBuilder builder(rectangle(graded(L, 40), {0, H / 2, H}, 2, "column"), Plane::strain, t);
  builder.add_solid("column", "neo_hookean", {{"E", E}, {"nu", 0.0}});
  const Problem problem = loaded_on_xmax(std::move(builder), {-1, 0});
  const Mesh& mesh = problem.scene.model->mesh();
  const Eigen::VectorXd across = mean_weights(mesh, mesh.select("xmax"), Eigen::Vector2d(0, 1));
  const Params p = with(problem.scene, problem.force, 1.1517 * euler);
  EquilibriumOptions naive;
  naive.check_minimum = false;
  const Solved straight = solved(problem.scene, p, naive), buckled = solved(problem.scene, p);
  EXPECT_EQ(straight.report.status, SolveStatus::converged) << "it says nothing";
  EXPECT_FALSE(straight.report.left_saddle);
  EXPECT_LT(std::abs(across.dot(straight.u)), 1e-6 * L);
  EXPECT_EQ(buckled.report.status, SolveStatus::converged);
  EXPECT_TRUE(buckled.report.left_saddle);
  EXPECT_NEAR(std::abs(across.dot(buckled.u)) / L, 0.5932, 1e-3) << "the elastica at 1.1517 times the Euler load";
  EXPECT_NEAR(1 - problem.tip.dot(buckled.u) / L, 0.7410, 1e-3);
}

/// A shallow arch 100 x 2 mm that rises by 6 mm, clamped at both ends, pushed down at its middle by "force" [N].
struct FlatArch {
  Scene scene;
  int force;
  Eigen::VectorXd middle;

  FlatArch() {
    Mesh mesh = rectangle(graded(0.1, 24), graded(2e-3, 1), 2, "strip");
    map_vertices(mesh, [](const Eigen::VectorXd& X) {
      const double s = 2 * X[0] / 0.1 - 1;
      return Eigen::VectorXd(Eigen::Vector2d(X[0], X[1] + 6e-3 * (1 - s * s)));
    });
    SceneBuilder builder(mesh, Plane::strain, 0.03);
    builder.add_solid("strip", "neo_hookean", {{"E", 1e6}, {"nu", 0.2}});
    builder.fix("xmin", {0, 1});
    builder.fix("xmax", {0, 1});
    force = builder.declare({"force", "F", "N", -1e3, 1e3, "force"}, 0.0);
    const Eigen::Vector2d top(0.05, 8e-3), down(0, -1);
    builder.add_point_force(top, down, force);
    middle = point_weights(builder.mesh(), locate(builder.mesh(), top), down);
    scene = builder.build();
  }
};

TEST(Stress, AnArchSnapsThroughInSilenceUnlessThePathIsChecked) {
  const FlatArch arch;
  EquilibriumOptions checked;
  checked.check_path = true;
  checked.max_total_iterations = 2000;
  for (double force : {0.015, 0.05}) {
    const Params p = with(arch.scene, arch.force, force);
    const Solved silent = solved(arch.scene, p), said = solved(arch.scene, p, checked);
    ASSERT_EQ(silent.report.status, SolveStatus::converged);
    ASSERT_EQ(said.report.status, SolveStatus::converged);
    EXPECT_FALSE(silent.report.slipped);
    // Snapped through, the middle hangs below the line of the clamps, 6 mm under where it was.
    EXPECT_EQ(arch.middle.dot(said.u) > 6e-3, force == 0.05);
    EXPECT_EQ(said.report.slipped, force == 0.05) << said.report.message();
  }
}

TEST(Stress, LinearElementsLockWhereTheLockingFreeOnesBendAsABeam) {
  // Small load; P L^3 / (3 E' I) with E' = E / (1 - nu^2), shear adds 0.7 %. All diagonals of the cells go one way.
  const double L = 0.1, H = 0.01, E = 1e5, force = 1e-4;
  const auto beam = [&](double nu, int cells, int order, Formulation formulation) {
    Mesh mesh = rectangle(graded(L, 5 * cells), graded(H, cells), order, "beam", Diagonals::rising);
    SceneBuilder builder(std::move(mesh), Plane::strain, 0.03);
    builder.add_solid("beam", "neo_hookean", {{"E", E}, {"nu", nu}}, formulation);
    return loaded_on_xmax(std::move(builder), {0, -1});
  };
  for (double nu : {0.3, 0.49, 0.4999}) {
    const double drop = force * L * L * L * (1 - nu * nu) / (3 * E * 0.03 * H * H * H / 12);
    SolveReport report;
    const double free = tip_at(beam(nu, 6, 2, Formulation::locking_free), force, &report) / drop;
    EXPECT_EQ(report.status, SolveStatus::converged);
    const double locked = tip_at(beam(nu, 8, 1, Formulation::standard), force, &report) / drop;
    EXPECT_EQ(report.status, SolveStatus::converged) << "it says nothing";
    EXPECT_NEAR(free, 1.007, 0.015) << nu;
    EXPECT_LT(locked, nu == 0.3 ? 1.0 : nu == 0.49 ? 0.7 : 0.1) << nu << ": ten times too stiff at last";
    EXPECT_GT(locked, nu == 0.3 ? 0.85 : 0.0) << nu;
  }
}

TEST(Stress, AResidualThatIsSmallForTheStiffBlockStopsBeforeTheSoftOneHasMoved) {
  // A heavy stiff block on a light soft one, tilted gravity. Out-of-balance forces of a thousandth of the stiff block's
  // own start are all of what the soft one knows.
  const auto stacked = [](double ratio, int* gravity) {
    Mesh mesh = rectangle(graded(0.02, 4), graded(0.02, 8), 2, "soft");
    assign_regions(mesh, [](const Eigen::VectorXd& c) { return c[1] > 0.01 ? "hard" : "soft"; });
    SceneBuilder builder(std::move(mesh), Plane::strain, 0.03);
    builder.add_solid("soft", "neo_hookean", {{"E", 1e4}, {"nu", 0.3}});
    builder.add_solid("hard", "neo_hookean", {{"E", 1e4 * ratio}, {"nu", 0.3}});
    *gravity = builder.declare({"g", "g", "m/s2", 0, 1000, "gravity"}, 0.0);
    builder.add_weight("hard", 1000, Eigen::Vector2d(0.3, -1), *gravity);
    builder.add_weight("soft", 30, Eigen::Vector2d(0.3, -1), *gravity);
    builder.fix("ymin", {0, 1});
    return builder.build();
  };
  for (double ratio : {1e2, 1e4, 1e6}) {
    int gravity = -1;
    const Scene scene = stacked(ratio, &gravity);
    const Params p = with(scene, gravity, 50);
    const Eigen::VectorXd across =
        mean_weights(scene.model->mesh(), scene.model->mesh().select("ymax"), Eigen::Vector2d(1, 0));
    EquilibriumOptions loose, rough, fine;
    loose.comparison.stop_at_force = 1e-2;
    rough.comparison.stop_at_force = 1e-3;
    fine.load_steps = 16;
    const double exact = across.dot(solved(scene, p, fine).u);
    EXPECT_GT(exact, 1e-3);
    const Solved nothing = solved(scene, p, loose), little = solved(scene, p, rough), all = solved(scene, p);
    EXPECT_EQ(nothing.report.status, SolveStatus::converged) << "it says so, in all innocence";
    EXPECT_EQ(across.dot(nothing.u), 0.0) << ratio << ": 10 mN out of balance, and nothing has moved";
    EXPECT_GT(std::abs(across.dot(little.u) / exact - 1), ratio == 1e2 ? 1e-2 : 3e-4) << "1 mN";
    EXPECT_NEAR(across.dot(all.u) / exact, 1, 1e-8);
  }
}

/// A beam on its foot with three cables along it and a net of crossed ones, all of length zero slack: each load turns
/// some of them slack and others taut.
Scene netted(double smoothing, int* force) {
  SceneBuilder builder(rectangle(graded(0.01, 2), graded(0.06, 8), 2, "beam"), Plane::strain, 0.03);
  builder.add_solid("beam", "neo_hookean", {{"E", 5e4}, {"nu", 0.2}});
  builder.fix("ymin", {0, 1});
  const int stiffness = builder.declare({"k", "k", "N/m", 0, 1e12, "stiffness"}, 2e6);
  const auto add = [&](const std::vector<Eigen::Vector2d>& points) {
    Cable cable;
    cable.smoothing = smoothing;
    cable.stiffness = stiffness;
    for (const Eigen::Vector2d& point : points) cable.points.push_back({locate(builder.mesh(), point), {}});
    builder.add_cable(cable);
  };
  for (double x : {0.001, 0.005, 0.009}) add({{x, 0}, {x, 0.02}, {x, 0.04}, {x, 0.06}});
  for (int i = 1; i < 8; ++i) {
    for (double x : {0.0, 0.01}) add({{x, 0.0075 * (i - 1)}, {0.01 - x, 0.0075 * (i + 1)}});
  }
  *force = builder.declare({"force", "F", "N", -1e3, 1e3, "load"}, 0.0);
  builder.add_force("ymax", Eigen::Vector2d(1, 0.2), *force);
  return builder.build();
}

TEST(Stress, CablesBetweenSlackAndTautDefeatALineSearchOnTheEnergyAndFullStepsButNotTheDefault) {
  // A sharp change from slack to taut is known to make Newton's method go to and fro. Here it is the line search that
  // decides: the default copes without any smoothing, which then costs iterations rather than saving them.
  std::vector<double> tops;
  for (double smoothing : {0.0, 1e-9, 2e-6}) {
    int force = -1;
    const Scene scene = netted(smoothing, &force);
    const Params p = with(scene, force, 0.2);
    EquilibriumOptions energy = at_once(100), full = energy;
    energy.comparison.line_search = LineSearch::armijo;
    full.comparison.line_search = LineSearch::none;
    EXPECT_NE(solved(scene, p, energy).report.status, SolveStatus::converged) << smoothing;
    EXPECT_EQ(solved(scene, p, full).report.status == SolveStatus::converged, smoothing > 0);
    const Solved sound = solved(scene, p, at_once(100));
    ASSERT_EQ(sound.report.status, SolveStatus::converged) << sound.report.message();
    tops.push_back(sound.u.cwiseAbs().maxCoeff());
    // Equal to the root of the forces that KINSOL finds beside it.
    const KinsolResult root = kinsol_equilibrium(*scene.model, p, sound.u);
    EXPECT_TRUE(root.minimum);
    EXPECT_LT(distance(scene, root.u, sound.u), 1e-6);
  }
  EXPECT_NEAR(tops[0] / tops[1], 1, 1e-6);
  EXPECT_NEAR(tops[0] / tops[2], 1, 1e-4) << "2 um of smoothing hardly show";
}

TEST(Stress, AFreeBodyIsRefusedWhereASolverWouldFindASingularHessian) {
  const auto block = [](FreeBodies free_bodies) {
    SceneBuilder builder(rectangle(graded(0.02, 2), graded(0.02, 2), 1, "soft"));
    builder.add_solid("soft", "neo_hookean", {{"E", 1e4}, {"nu", 0.3}});
    const int force = builder.declare({"force", "F", "N", -1e3, 1e3, "load"}, 0.0);
    builder.add_force("xmax", Eigen::Vector2d(1, 0), force);
    return builder.build(free_bodies);
  };
  expect_input_error([&] { block(FreeBodies::none); }, {"leave 3 of 3 rigid motions free", "fix more components"});
  const Scene scene = block(FreeBodies::move);  // as if nobody had looked
  const Params p = with(scene, scene.model->parameters().index("force"), 1);
  const Solved lost = solved(scene, p);
  EXPECT_NE(lost.report.status, SolveStatus::converged);
  EXPECT_GT(lost.report.factorisations, 1.5 * lost.report.iterations) << "Cholesky fails, again and again";
  const KinsolResult root = kinsol_equilibrium(*scene.model, p, Eigen::VectorXd::Zero(scene.model->unknowns()));
  EXPECT_NE(root.status, SolveStatus::converged);
}

TEST(Stress, ACrumpledStartIsSmoothedOutOrRefusedAndFullStepsFoldIt) {
  const Problem problem = problem_a1(4, 2);
  const Model& model = *problem.scene.model;
  const Params p = with(problem.scene, problem.force, 12);
  const Eigen::VectorXd expected = solved(problem.scene, p).u;
  int refused = 0, smoothed = 0, folded = 0;
  for (unsigned seed = 1; seed <= 12; ++seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> uniform(-1, 1);
    const double amplitude = 2e-4 * seed;  // of elements 7.5 mm wide
    Eigen::VectorXd start(model.unknowns());
    for (Eigen::Index i = 0; i < start.size(); ++i) start[i] = amplitude * uniform(random);
    model.impose_supports(p, start);
    Assembly energy;
    model.evaluate({start, p}, energy);
    EquilibriumOptions naive = at_once();
    naive.comparison.line_search = LineSearch::none;
    Equilibrium sound(model, at_once()), full(model, naive);
    sound.start_at(start, p);
    full.start_at(start, p);
    const SolveReport report = sound.solve(p);
    if (!std::isfinite(energy.energy)) {
      EXPECT_EQ(report.status, SolveStatus::infeasible_start);
      ++refused;
      continue;
    }
    EXPECT_EQ(report.status, SolveStatus::converged) << report.message();
    EXPECT_LT(distance(problem.scene, sound.u(), expected), 1e-8) << "seed " << seed;
    ++smoothed;
    folded += full.solve(p).status != SolveStatus::converged;
  }
  EXPECT_GE(refused, 1);
  EXPECT_GE(smoothed, 4);
  EXPECT_GE(folded, 2) << "starts that full steps do not survive";
}

TEST(Stress, ASliverOfATenThousandthCostsTheDefaultNothing) {
  // One node of a fine mesh of linear elements is moved nearly onto the edge opposite to it.
  const auto beam = [](double quality) {
    Mesh mesh = rectangle(graded(0.06, 12), graded(0.012, 4), 1, "beam");
    for (int i = 0; i < mesh.node_count(); ++i) {
      if ((mesh.node(i) - Eigen::Vector2d(0.005, 0.003)).norm() < 1e-9) mesh.X[2 * i + 1] = 0.006 - 0.003 * quality;
    }
    SceneBuilder builder(std::move(mesh), Plane::strain, 0.02);
    builder.add_solid("beam", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
    return loaded_on_xmax(std::move(builder), {0, -1});
  };
  const Problem regular = beam(1);
  const Solved expected = solved(regular.scene, with(regular.scene, regular.force, 3), at_once());
  for (double quality : {1e-1, 1e-2, 1e-3, 1e-4}) {
    const Problem problem = beam(quality);
    const Params p = with(problem.scene, problem.force, 3);
    EquilibriumOptions full = at_once(), projected = at_once();
    full.comparison.line_search = LineSearch::none;
    projected.comparison.always_project = true;
    EXPECT_NE(solved(problem.scene, p, full).report.status, SolveStatus::converged);
    const Solved sound = solved(problem.scene, p, at_once());
    ASSERT_EQ(sound.report.status, SolveStatus::converged) << sound.report.message();
    EXPECT_LE(sound.report.iterations, expected.report.iterations + 4) << quality;
    EXPECT_GT(solved(problem.scene, p, projected).report.iterations, 2 * sound.report.iterations) << quality;
    EXPECT_NEAR(problem.tip.dot(sound.u) / regular.tip.dot(expected.u), 1, 0.01) << "the mesh is hardly another one";
  }
}

TEST(Stress, APlateMovedByHalfABlockInvertsTheElementsBesideItUnlessTheWholeBodyIsPredictedToFollow) {
  SceneBuilder builder(rectangle(graded(0.1, 3), graded(0.1, 3, 2.0), 2, "body"), Plane::strain, 0.02);
  builder.add_solid("body", "neo_hookean", {{"E", 1.0}, {"nu", 0.3}});
  const int travel = builder.declare({"travel", "u", "m", -1, 1, "travel of the plate"}, 0.0);
  builder.fix("xmin", {0});
  builder.fix("ymin", {1});
  builder.prescribe("xmax", 0, travel);
  const Scene scene = builder.build();
  const Params p = with(scene, travel, -0.05);
  // The plate alone is moved, as is usual: the start is inside out.
  EXPECT_EQ(kinsol_equilibrium(*scene.model, p, Eigen::VectorXd::Zero(scene.model->unknowns())).status,
            SolveStatus::infeasible_start);
  Equilibrium moved(*scene.model);
  Eigen::VectorXd start = Eigen::VectorXd::Zero(scene.model->unknowns());
  scene.model->impose_supports(p, start);
  moved.start_at(start, p);
  EXPECT_EQ(moved.solve(p).status, SolveStatus::infeasible_start);
  const Solved whole = solved(scene, p, at_once());
  ASSERT_EQ(whole.report.status, SolveStatus::converged) << whole.report.message();
  EXPECT_LE(whole.report.iterations, 6);
  Eigen::VectorXd reaction;
  Assembly out;
  out.gradient = &reaction;
  scene.model->evaluate({whole.u, p}, out);
  double force = 0;
  for (int node : scene.model->mesh().select("xmax").nodes()) force += reaction[2 * node];
  EXPECT_NEAR(force / (0.1 * 0.02), -1.084407, 1e-6) << "closed form of homogeneous compression to one half";
}

TEST(StressFit, AWrongLawPassesEveryLookAtTheCurveAndNotTheTestForLackOfFit) {
  // Readings of a spring that stiffens, two repeats each, fitted by a straight line.
  const Eigen::VectorXd x = Eigen::VectorXd::LinSpaced(8, 1, 8);
  const double sigma = 0.02;
  std::vector<Measurement> readings;
  std::mt19937 random(7);
  std::normal_distribution<double> noise(0, sigma);
  double mean = 0;
  for (int i = 0; i < 8; ++i) {
    for (int repeat = 0; repeat < 2; ++repeat) {
      readings.push_back({i, 0.5 * x[i] + 0.008 * x[i] * x[i] + noise(random), sigma, i});
      mean += readings.back().value / 16;
    }
  }
  ClosedFormProtocol line = straight_line(x);
  const FitResult wrong = fit(line, readings, {{0, 0, -5, 5}, {1, 1, -5, 5}});
  ASSERT_EQ(wrong.status, FitStatus::converged) << wrong.message;
  double left = 0, all = 0;
  for (Eigen::Index i = 0; i < 16; ++i) {
    left += wrong.residuals[i] * wrong.residuals[i];
    all += std::pow(readings[static_cast<size_t>(i)].value - mean, 2);
  }
  EXPECT_GT(1 - left / all, 0.997) << "R squared, at which a look at the curve ends";
  EXPECT_LT(wrong.parameters[1].standard_error, 0.01 * wrong.parameters[1].value)
      << "and its errors are small, and wrong";
  EXPECT_EQ(wrong.parameters[1].verdict, Verdict::of_a_wrong_model);
  ASSERT_TRUE(wrong.lack_of_fit.available);
  EXPECT_LT(wrong.lack_of_fit.p_value, 1e-3);
  EXPECT_LT(wrong.chi_squared_p, 1e-3);

  ClosedFormProtocol curve{
      {{plain("a"), 0}, {plain("b"), 0}, {plain("c"), 0}},
      [x](const Params& p) -> Eigen::VectorXd { return p[0] + p[1] * x.array() + p[2] * x.array().square(); },
      [x](const Params&) {
        Eigen::MatrixXd D(x.size(), 3);
        D << Eigen::VectorXd::Ones(x.size()), x, Eigen::VectorXd(x.array().square());
        return D;
      }};
  const FitResult right = fit(curve, readings, {{0, 0, -5, 5}, {1, 1, -5, 5}, {2, 0, -5, 5}});
  EXPECT_GT(right.lack_of_fit.p_value, 0.05);
  EXPECT_NEAR(right.parameters[2].value, 0.008, 3 * right.parameters[2].standard_error);
}

}  // namespace
}  // namespace taut::test

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "sim/mesh/structured.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/scene/scene.hpp"
#include "sim/solve/equilibrium.hpp"
#include "sim/solve/hessian.hpp"
#include "sim/solve/motion.hpp"

// Equilibria with contact, and the parts of the solver that serve them.
namespace taut::test {
namespace {

constexpr double kGap = 20e-6;

/// A soft block 20 x 10 mm on a clamped base, and a stiff stamp 1 mm above it that is pushed down by "push" [m].
struct Stamp {
  Scene scene;
  int push = -1;
};

Mesh two_blocks() {
  const Mesh block = rectangle(graded(20e-3, 8), graded(10e-3, 4), 1, "block");
  const Mesh stamp = rectangle(graded(8e-3, 5), graded(3e-3, 2), 1, "stamp");
  Mesh both = block;
  const int offset = block.node_count();
  both.X.conservativeResize(block.X.size() + stamp.X.size());
  for (int i = 0; i < stamp.node_count(); ++i) {
    both.X[2 * (offset + i)] = stamp.X[2 * i] + 6.3e-3;
    both.X[2 * (offset + i) + 1] = stamp.X[2 * i + 1] + 11e-3;
  }
  for (int node : stamp.elements) both.elements.push_back(node + offset);
  both.region.resize(both.region.size() + stamp.region.size(), 1);
  both.region_names = {"block", "stamp"};
  both.tags = {{"bottom", block.tags.at("ymin")}};
  Tag top = stamp.tags.at("ymax");
  for (int& node : top.entities) node += offset;
  both.tags["top"] = top;
  return both;
}

Stamp stamp() {
  SceneBuilder builder(two_blocks(), Plane::strain, 0.03);
  builder.add_solid("block", "neo_hookean", {{"E", 5e4}, {"nu", 0.2}});
  builder.add_solid("stamp", "neo_hookean", {{"E", 5e6}, {"nu", 0.3}});
  builder.fix("bottom", {0, 1});
  builder.fix("top", {0});
  Stamp result;
  result.push = builder.declare({"push", "u", "m", -1, 1, "push"}, 0.0);
  builder.prescribe("top", 1, result.push);
  builder.add_contact(kGap, {{"block", 5e4}, {"stamp", 5e5}});
  result.scene = builder.build();
  return result;
}

bool intersects(const Model& model, const Eigen::VectorXd& u) {
  ContactSettings settings;
  settings.edges = contact_edges(model.mesh());
  settings.stiffness.assign(settings.edges.size(), 0);
  settings.gap = 0;
  return Contact(model.mesh(), settings).intersects(u);
}

TEST(ContactSolve, ASupportThatIsMovedFarPushesWhatItMeetsAndPassesThroughNothing) {
  const Stamp s = stamp();
  for (double push : {-0.5e-3, -1.2e-3, -2e-3, -4e-3}) {
    Equilibrium equilibrium(*s.scene.model);
    equilibrium.start_at_rest(s.scene.values);
    Params p = s.scene.values;
    p[s.push] = push;
    ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged) << equilibrium.report().message();
    EXPECT_FALSE(intersects(*s.scene.model, equilibrium.u()));
    if (push < -1.1e-3) {
      EXPECT_LT(equilibrium.u().head(2 * 45).minCoeff(), 0.9 * (push + 1e-3)) << "the block gave way";
    } else {
      EXPECT_EQ(equilibrium.u().head(2 * 45).cwiseAbs().maxCoeff(), 0.0) << "nothing was touched";
    }
  }
}

TEST(ContactSolve, SensitivitiesThroughContactHaveSlopeTwo) {
  const Stamp s = stamp();
  Params p = s.scene.values;
  p[s.push] = -2e-3;
  auto solved = [&](const Params& q) {
    Equilibrium equilibrium(*s.scene.model, {.step_tolerance = 1e-11});
    equilibrium.start_at_rest(s.scene.values);
    equilibrium.solve(q);
    return equilibrium;
  };
  const Equilibrium at = solved(p);
  for (const char* id : {"E_block", "push", "contact_gap", "contact_pressure_block"}) {
    const int index = s.scene.model->parameters().index(id);
    const Eigen::VectorXd derivative = at.sensitivities({index});
    std::vector<double> remainders;
    for (double h : {2e-2, 1e-2, 5e-3}) {
      Params q = p;
      q[index] *= 1 + h;
      remainders.push_back((solved(q).u() - at.u() - h * p[index] * derivative).norm());
    }
    EXPECT_NEAR(std::log2(remainders[0] / remainders[1]), 2, 0.2) << id;
    EXPECT_NEAR(std::log2(remainders[1] / remainders[2]), 2, 0.2) << id;
  }
}

TEST(ContactSolve, ASolveThatFailsWithoutAChangeOfParametersIsNotRepeated) {
  const Stamp s = stamp();
  Params p = s.scene.values;
  p[s.push] = -2e-3;
  Equilibrium reference(*s.scene.model);
  reference.start_at_rest(s.scene.values);
  ASSERT_EQ(reference.solve(p).status, SolveStatus::converged);
  Equilibrium impatient(*s.scene.model, {.max_iterations = 1});
  Eigen::VectorXd u = reference.u();
  p[s.scene.model->parameters().index("E_block")] *= 0.5;
  impatient.start_at(u, p);
  EXPECT_EQ(impatient.solve(p).status, SolveStatus::iteration_limit);
  EXPECT_EQ(impatient.report().iterations, 1);
}

TEST(ContactSolve, CouplingsOfPairsThatComeTogetherEnterTheFactorisedHessian) {
  const Stamp s = stamp();
  const Model& model = *s.scene.model;
  Params p = s.scene.values;
  p[s.push] = -2e-3;
  Equilibrium equilibrium(model);
  equilibrium.start_at_rest(s.scene.values);
  ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged);
  Hessian hessian(model);
  for (int round = 0; round < 2; ++round) {  // the second time with the pattern that the first one left
    const Eigen::VectorXd rest = Eigen::VectorXd::Zero(model.unknowns());
    for (const Eigen::VectorXd* u : {&rest, &equilibrium.u()}) {
      hessian.assemble({*u, p}, Curvature::exact, nullptr);
      ASSERT_TRUE(hessian.factorise());
      Eigen::VectorXd v(model.free_unknowns());
      for (Eigen::Index i = 0; i < v.size(); ++i) v[i] = std::sin(1.0 + 0.7 * static_cast<double>(i));
      const Eigen::VectorXd Hv = model.restrict_to_free(model.hessian_times({*u, p}, model.extend_from_free(v)));
      EXPECT_LT((hessian.solve(Hv) - v).norm(), 1e-8 * v.norm());
    }
    if (round == 1) hessian.forget_couplings();
  }
}

/// A shallow arch 100 x 2 mm that rises by 6 mm, clamped at both ends, pushed down at its middle by "force" [N].
struct Arch {
  Scene scene;
  int force = -1;
  Eigen::VectorXd middle;  ///< weights of the middle's drop
};

Arch arch() {
  Mesh mesh = rectangle(graded(100e-3, 40), graded(2e-3, 1), 2, "strip");
  map_vertices(mesh, [](const Eigen::VectorXd& X) {
    const double s = 2 * X[0] / 100e-3 - 1;
    return Eigen::VectorXd(Eigen::Vector2d(X[0], X[1] + 6e-3 * (1 - s * s)));
  });
  SceneBuilder builder(mesh, Plane::strain, 0.03);
  builder.add_solid("strip", "neo_hookean", {{"E", 1e6}, {"nu", 0.2}});
  builder.fix("xmin", {0, 1});
  builder.fix("xmax", {0, 1});
  Arch result;
  result.force = builder.declare({"force", "F", "N", -1e3, 1e3, "force"}, 0.0);
  const Eigen::Vector2d top(50e-3, 8e-3), down(0, -1);
  builder.add_point_force(top, down, result.force);
  result.middle = point_weights(builder.mesh(), locate(builder.mesh(), top), down);
  result.scene = builder.build();
  return result;
}

TEST(Path, AnArchThatSnapsThroughIsSaidToHaveSlippedAndOneThatOnlySagsIsNot) {
  const Arch a = arch();
  for (const auto& [force, snaps] : {std::pair{0.015, false}, {0.05, true}}) {
    Equilibrium equilibrium(*a.scene.model, {.max_total_iterations = 2000, .check_path = true});
    equilibrium.start_at_rest(a.scene.values);
    Params p = a.scene.values;
    p[a.force] = force;
    ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged) << equilibrium.report().message();
    const double drop = a.middle.dot(equilibrium.u());
    std::printf("%g N: drop %.3f mm; %s\n", force, 1e3 * drop, equilibrium.report().message().c_str());
    EXPECT_EQ(drop > 8e-3, snaps);
    EXPECT_EQ(equilibrium.report().slipped, snaps);
    if (snaps) {
      EXPECT_GT(equilibrium.report().slipped_after, 0.3) << "0.015 N are carried";
      EXPECT_LT(equilibrium.report().slipped_after, 1);
    }
  }
}

TEST(Motion, AStiffBodyTurnsWithoutStretchingAndItsTangentIsTheStep) {
  // A stiff bar held by a soft one: the step turns the stiff one by half a radian about its centre.
  Mesh mesh = rectangle(graded(40e-3, 8), graded(10e-3, 2), 1, "soft");
  assign_regions(mesh, [](const Eigen::VectorXd& c) { return c[0] < 20e-3 ? "soft" : "stiff"; });
  SceneBuilder builder(mesh, Plane::strain, 0.03);
  builder.add_solid("soft", "neo_hookean", {{"E", 5e4}, {"nu", 0.2}});
  builder.add_solid("stiff", "neo_hookean", {{"E", 5e9}, {"nu", 0.2}});
  builder.fix("xmin", {0, 1});
  const Scene scene = builder.build();
  const Model& model = *scene.model;
  const Body* stiff = nullptr;
  for (const Body& body : model.bodies()) {
    if (!body.supported) stiff = &body;
  }
  ASSERT_NE(stiff, nullptr);
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  for (int node : stiff->nodes) centre += mesh.node(node) / static_cast<double>(stiff->nodes.size());
  const Eigen::Vector2d shift(1e-3, -2e-3);
  Eigen::VectorXd step = Eigen::VectorXd::Zero(mesh.X.size());
  for (int node : stiff->nodes) {
    const Eigen::Vector2d r = mesh.node(node) - centre;
    step.segment(2 * node, 2) = 0.5 * Eigen::Vector2d(-r[1], r[0]) + shift;
  }
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(mesh.X.size());
  const Motion motion(model, scene.values);
  const Eigen::VectorXd whole = motion.along(rest, step, 1.0);
  const Eigen::Matrix2d R = Eigen::Rotation2Dd(0.5).toRotationMatrix();
  for (int node : stiff->nodes) {
    const Eigen::Vector2d r = mesh.node(node) - centre, moved = centre + shift + R * r - mesh.node(node);
    EXPECT_LT((whole.segment(2 * node, 2) - moved).norm(), 1e-16);
  }
  // A step that strains the body as well keeps its tangent: what is left of u(a) - a step is of second order.
  for (int node : stiff->nodes) step[2 * node] += 0.1 * mesh.node(node)[1];
  const double one = (motion.along(rest, step, 1e-2) - 1e-2 * step).norm();
  const double half = (motion.along(rest, step, 5e-3) - 5e-3 * step).norm();
  EXPECT_NEAR(std::log2(one / half), 2, 0.01);
}

}  // namespace
}  // namespace taut::test

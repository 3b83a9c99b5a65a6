#include <gtest/gtest.h>

#include "sim/solve/equilibrium.hpp"
#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"
#include "tests/support/problems.hpp"
#include "tests/support/taylor.hpp"

namespace taut {
namespace {

using namespace test;

struct Inlay {
  Scene scene;
  int force = 0, torque = 0;
};

/// A soft bar, clamped at x = 0, with a stiff piece across its middle and one at its end that loads bend and turn. Both
/// are rigid where `modulus` is 0.
Inlay inlay(int d, double modulus, double nu = 0.3) {
  Mesh mesh = d == 2 ? rectangle(graded(0.2, 10), graded(0.05, 3), 2, "soft")
                     : box(graded(0.2, 5), graded(0.05, 2), graded(0.04, 1), 2, "soft");
  assign_regions(
      mesh, [](const Eigen::VectorXd& c) { return (c[0] > 0.08 && c[0] < 0.12) || c[0] > 0.16 ? "stiff" : "soft"; });
  SceneBuilder builder(std::move(mesh), Plane::strain, 0.04);
  builder.add_solid("soft", "neo_hookean", {{"E", 5e4}, {"nu", nu}});
  if (modulus > 0)
    builder.add_solid("stiff", "neo_hookean", {{"E", modulus}, {"nu", 0.3}});
  else
    builder.add_rigid("stiff");
  Inlay made;
  builder.fix("xmin", d == 2 ? std::vector{0, 1} : std::vector{0, 1, 2});
  made.force = builder.declare({"force", "F", "N", -1e3, 1e3, "force at the end"}, 0);
  made.torque = builder.declare({"twist", "F", "N", -1e3, 1e3, "force at a corner"}, 0);
  builder.add_force("xmax", d == 2 ? vec({0.3, -1}) : vec({0.3, -1, 0.4}), made.force);
  builder.add_point_force(d == 2 ? vec({0.2, 0.05}) : vec({0.2, 0.05, 0.04}), d == 2 ? vec({1, 0}) : vec({0, 0, 1}),
                          made.torque);
  made.scene = builder.build();
  return made;
}

Params loaded(const Inlay& made) {
  Params p = made.scene.values;
  p[made.force] = 0.6;
  p[made.torque] = 0.4;
  return p;
}

TEST(Rigid, RegionsAreTheLimitOfStiffOnes) {
  for (int d : {2, 3}) {
    const Inlay rigid = inlay(d, 0);
    Equilibrium limit(*rigid.scene.model);
    limit.start_at_rest(rigid.scene.values);
    ASSERT_EQ(limit.solve(loaded(rigid)).status, SolveStatus::converged) << limit.report().message();
    EXPECT_LE(limit.report().iterations, 12) << "Newton's order, whatever the angle";
    const double size = limit.u().cwiseAbs().maxCoeff();
    ASSERT_GT(size, 0.04) << "bent far";
    double before = 0;
    for (double modulus : {5e7, 5e8, 5e9}) {  // what is missing goes with 1 / E
      const Inlay elastic = inlay(d, modulus);
      Equilibrium solve(*elastic.scene.model);
      solve.start_at_rest(elastic.scene.values);
      ASSERT_EQ(solve.solve(loaded(elastic)).status, SolveStatus::converged) << solve.report().message();
      const double missing = (solve.u() - limit.u()).cwiseAbs().maxCoeff();
      if (before > 0) {
        EXPECT_NEAR(before / missing, 10, 0.3) << d << "D, E = " << modulus;
      }
      before = missing;
    }
    EXPECT_LT(before, 1e-4 * size);
  }
}

TEST(Rigid, BodiesKeepAllTheirDistances) {
  for (int d : {2, 3}) {
    const Inlay made = inlay(d, 0);
    const Model& model = *made.scene.model;
    Equilibrium equilibrium(model);
    equilibrium.start_at_rest(made.scene.values);
    ASSERT_EQ(equilibrium.solve(loaded(made)).status, SolveStatus::converged);
    int checked = 0;
    for (const Body& body : model.bodies()) {
      if (!body.rigid()) continue;
      for (size_t i = 1; i < body.nodes.size(); ++i) {
        const int a = body.nodes[0] * d, b = body.nodes[i] * d;
        const Eigen::VectorXd rest = model.mesh().X.segment(b, d) - model.mesh().X.segment(a, d);
        const Eigen::VectorXd now = rest + equilibrium.u().segment(b, d) - equilibrium.u().segment(a, d);
        EXPECT_NEAR(now.norm(), rest.norm(), 1e-14);
        ++checked;
      }
    }
    EXPECT_GT(checked, 20);
  }
}

TEST(Rigid, SensitivitiesAreTheSlopeOfTheWholeSolve) {
  for (int d : {2, 3}) {
    const Inlay made = inlay(d, 0);
    const EquilibriumOptions precise{.step_tolerance = 1e-11};
    const Params p = loaded(made);
    Equilibrium reference(*made.scene.model, precise);
    reference.start_at_rest(made.scene.values);
    ASSERT_EQ(reference.solve(p).status, SolveStatus::converged);
    const ParameterTable& table = made.scene.model->parameters();
    for (int k : {table.index("E_soft"), table.index("nu_soft"), made.force, made.torque}) {
      const Eigen::VectorXd slope = reference.sensitivities({k});
      EXPECT_GT(slope.norm() * std::abs(p[k]), 1e-3);
      expect_taylor_order(
          [&](double h) {
            Params q = p;
            q[k] += h;
            Equilibrium moved(*made.scene.model, precise);
            moved.start_at(reference.u(), p);
            EXPECT_EQ(moved.solve(q).status, SolveStatus::converged);
            return (moved.u() - reference.u() - h * slope).norm();
          },
          2, 1e-12, 0.1 * std::abs(p[k]), 5, table[k].id);
    }
  }
}

TEST(Rigid, TheHessianIsTheSlopeOfTheGradientOnTheUnknownsOfTheReduction) {
  for (int d : {2, 3}) {
    const Inlay made = inlay(d, 0);
    const Model& model = *made.scene.model;
    const Reduction reduction(model);
    const Params p = loaded(made);
    // Away from equilibrium, where nodal forces turn with the bodies.
    Eigen::VectorXd q = Eigen::VectorXd::Zero(reduction.size());
    for (Eigen::Index i = 0; i < q.size(); ++i) q[i] = 2e-4 * std::sin(1.0 + 0.9 * static_cast<double>(i));
    q.tail(6) *= 20;  // the last body turns by some degrees
    const Motion motion(model, p);
    const auto moved = [&](const Eigen::VectorXd& u, const Eigen::VectorXd& step) {
      return motion.along(u, reduction.extend_from_free(u, step), 1.0);
    };
    const Eigen::VectorXd u = moved(Eigen::VectorXd::Zero(model.unknowns()), q);
    Hessian hessian(model);
    Eigen::VectorXd gradient;
    hessian.assemble({u, p}, Curvature::exact, &gradient);
    const double energy = hessian.assemble({u, p}, Curvature::exact, nullptr).energy;
    const Eigen::VectorXd g = reduction.restrict_to_free(u, gradient), h = hessian.times(q);
    // The energy along the way: its slope is the gradient, its curvature the Hessian.
    expect_taylor_order(
        [&](double t) {
          Assembly out;
          model.evaluate({moved(u, t * q), p}, out);
          return std::abs(out.energy - energy - t * g.dot(q) - 0.5 * t * t * h.dot(q));
        },
        3, 1e-14 * std::abs(energy), 0.2, 5, std::to_string(d) + "D");
  }
}

TEST(Rigid, AClampedPieceStaysAndAHalfSupportedOneIsRefused) {
  const auto build = [](const std::vector<int>& components) {
    Mesh mesh = rectangle(graded(0.2, 4), graded(0.05, 2), 1, "soft");
    assign_regions(mesh, [](const Eigen::VectorXd& c) { return c[0] < 0.06 ? "stiff" : "soft"; });
    SceneBuilder builder(std::move(mesh));
    builder.add_solid("soft", "neo_hookean", {{"E", 5e4}, {"nu", 0.3}});
    builder.add_rigid("stiff");
    builder.fix("xmin", components);
    builder.fix("xmax", {0, 1});
    return builder.build();
  };
  const Scene scene = build({0, 1});
  for (const Body& body : scene.model->bodies()) {
    for (int node : body.nodes) {
      if (body.rigid()) {
        EXPECT_LT(scene.model->free_index(2 * node), 0);
      }
    }
  }
  expect_input_error([&] { build({0}); }, {"rigid body", "fix all components"});
}

}  // namespace
}  // namespace taut

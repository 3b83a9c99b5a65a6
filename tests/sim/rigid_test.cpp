#include <gtest/gtest.h>

#include "sim/solve/equilibrium.hpp"
#include "sim/solve/time_stepper.hpp"
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
Inlay inlay(int d, double modulus, double nu = 0.3, bool moving = false) {
  Mesh mesh = d == 2 ? rectangle(graded(0.2, 10), graded(0.05, 3), 2, "soft")
                     : box(graded(0.2, 5), graded(0.05, 2), graded(0.04, 1), 2, "soft");
  assign_regions(
      mesh, [](const Eigen::VectorXd& c) { return (c[0] > 0.08 && c[0] < 0.12) || c[0] > 0.16 ? "stiff" : "soft"; });
  SceneBuilder builder(std::move(mesh), Plane::strain, 0.04);
  builder.add_solid("soft", "neo_hookean", {{"E", 5e4}, {"nu", nu}});
  if (modulus > 0)
    builder.add_solid("stiff", "neo_hookean", {{"E", modulus}, {"nu", 0.3}});
  else
    builder.add_rigid("stiff", 2e9);
  if (moving) {
    builder.add_inertia("soft", 100);
    builder.add_inertia("stiff", 1000);
  }
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

/// The end's way and velocity after a swing under suddenly applied forces, by steps of 2 ms.
struct Swing {
  Eigen::VectorXd u, v;
  Eigen::MatrixXd du;
  std::vector<AcceptedStep> steps;
};
Swing swing(const Inlay& made, Integrator integrator, const Params& p, const std::vector<int>& tracked = {}) {
  TimeStepperOptions options;
  options.integrator = integrator;
  options.step = 2e-3;
  options.equilibrium.step_tolerance = 1e-13;
  const Model& model = *made.scene.model;
  TimeStepper stepper(model, options);
  const auto count = static_cast<int>(tracked.size());
  if (count > 0) {
    stepper.track(count, [&](double) {
      Eigen::MatrixXd dp = Eigen::MatrixXd::Zero(model.parameters().size(), count);
      for (int k = 0; k < count; ++k) dp(tracked[static_cast<size_t>(k)], k) = 1;
      return dp;
    });
  }
  const Eigen::VectorXd zero = Eigen::VectorXd::Zero(model.unknowns());
  stepper.start(0, zero, zero, [&](double) { return p; });
  Swing swing;
  for (int k = 1; k <= 60; ++k) {
    EXPECT_TRUE(stepper.advance(k * options.step)) << name_of(stepper.report().status);
    swing.steps.push_back(stepper.last());
  }
  swing.u = stepper.u();
  swing.v = stepper.v();
  swing.du = stepper.du();
  return swing;
}

TEST(Rigid, SwingsAreTheLimitOfThoseOfStiffRegions) {
  for (int d : {2, 3}) {
    for (Integrator integrator : {Integrator::implicit_euler, Integrator::bdf2}) {
      const Inlay rigid = inlay(d, 0, 0.3, true);
      const Swing limit = swing(rigid, integrator, loaded(rigid));
      const double size = limit.u.cwiseAbs().maxCoeff();
      ASSERT_GT(size, 0.03) << "turned far";
      double before = 0;
      for (double modulus : {5e7, 5e8, 5e9}) {
        const Inlay elastic = inlay(d, modulus, 0.3, true);
        const double missing = (swing(elastic, integrator, loaded(elastic)).u - limit.u).cwiseAbs().maxCoeff();
        if (before > 0) {
          EXPECT_NEAR(before / missing, 10, 1.5) << d << "D, E = " << modulus;
        }
        before = missing;
      }
      EXPECT_LT(before, 2e-4 * size);
      const Mesh& mesh = rigid.scene.model->mesh();
      for (const Body& body : rigid.scene.model->bodies()) {
        if (!body.rigid()) continue;
        const int a = body.nodes.front(), b = body.nodes.back();
        const double apart = (mesh.node(b) - mesh.node(a)).norm();
        const double now = (mesh.node(b) - mesh.node(a) + limit.u.segment(b * d, d) - limit.u.segment(a * d, d)).norm();
        EXPECT_NEAR(now / apart, 1, 1e-12);
      }
    }
  }
}

TEST(Rigid, DerivativesOfASwingAreThoseOfWhatWasComputed) {
  const Inlay made = inlay(2, 0, 0.3, true);
  const Model& model = *made.scene.model;
  const std::vector<int> indices{model.parameters().index("E_soft"), made.force,
                                 model.parameters().index("density_stiff")};
  const Params p = loaded(made);
  for (Integrator integrator : {Integrator::implicit_euler, Integrator::bdf2}) {
    const Swing at = swing(made, integrator, p, indices);
    Eigen::VectorXd weights(model.unknowns());
    for (Eigen::Index i = 0; i < weights.size(); ++i) weights[i] = std::sin(1.0 + 0.7 * static_cast<double>(i));
    std::vector<Eigen::VectorXd> gradients(at.steps.size());
    gradients.back() = weights;
    const Eigen::MatrixXd adjoint = adjoint_gradient(model, at.steps, gradients, indices).parameters;
    for (size_t k = 0; k < indices.size(); ++k) {
      const auto column = static_cast<Eigen::Index>(k);
      const double step = 1e-5 * p[indices[k]];
      Params more = p, less = p;
      more[indices[k]] += step;
      less[indices[k]] -= step;
      const Eigen::VectorXd difference =
          (swing(made, integrator, more).u - swing(made, integrator, less).u) / (2 * step);
      EXPECT_LT((at.du.col(column) - difference).norm(), 1e-6 * difference.norm()) << k;
      const double forward = at.du.col(column).dot(weights);
      EXPECT_NEAR(adjoint.row(column).sum(), forward, 1e-9 * at.du.col(column).norm()) << k;
    }
  }
}

TEST(Rigid, APieceWhoseFaceIsMovedMovesAsAWhole) {
  Mesh mesh = rectangle(graded(0.2, 4), graded(0.05, 2), 1, "soft");
  assign_regions(mesh, [](const Eigen::VectorXd& c) { return c[0] < 0.06 ? "stiff" : "soft"; });
  SceneBuilder builder(std::move(mesh));
  builder.add_solid("soft", "neo_hookean", {{"E", 5e4}, {"nu", 0.3}});
  builder.add_rigid("stiff", 2e9);
  const int lift = builder.declare({"lift", "u", "m", -1, 1, "way of the face"}, 0);
  builder.fix("xmin", {0});
  builder.prescribe("xmin", 1, lift);
  const Scene scene = builder.build();
  Equilibrium equilibrium(*scene.model);
  equilibrium.start_at_rest(scene.values);
  Params p = scene.values;
  p[lift] = 0.03;
  ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged);
  for (int i = 0; i < scene.model->mesh().node_count(); ++i) {
    EXPECT_NEAR(equilibrium.u()[2 * i], 0, 1e-12);
    EXPECT_NEAR(equilibrium.u()[2 * i + 1], 0.03, 1e-12);
  }
}

TEST(Rigid, AClampedPieceStaysAndAHalfSupportedOneIsRefused) {
  const auto build = [](const std::vector<int>& components) {
    Mesh mesh = rectangle(graded(0.2, 4), graded(0.05, 2), 1, "soft");
    assign_regions(mesh, [](const Eigen::VectorXd& c) { return c[0] < 0.06 ? "stiff" : "soft"; });
    SceneBuilder builder(std::move(mesh));
    builder.add_solid("soft", "neo_hookean", {{"E", 5e4}, {"nu", 0.3}});
    builder.add_rigid("stiff", 2e9);
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

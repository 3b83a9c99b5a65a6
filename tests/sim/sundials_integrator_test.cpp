#include "sim/solve/sundials_integrator.hpp"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <functional>

#include "sim/mesh/structured.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/scene/scene.hpp"
#include "tests/support/message.hpp"

namespace taut::test {
namespace {

constexpr OdeMethod all_methods[] = {OdeMethod::bdf, OdeMethod::explicit_runge_kutta, OdeMethod::implicit_runge_kutta};
const char* const method_names[] = {"bdf", "explicit Runge-Kutta", "implicit Runge-Kutta"};
std::string name(OdeMethod method) {
  return method_names[static_cast<int>(method)];
}

Schedule constant(const Params& p) {
  return [p](double) { return p; };
}

double largest(const Eigen::VectorXd& v) {
  return v.cwiseAbs().maxCoeff();
}

/// The same displacement or velocity of all nodes.
Eigen::VectorXd everywhere(const Model& model, double x, double y) {
  return Eigen::Vector2d(x, y).replicate(model.mesh().node_count(), 1);
}

/// A soft bar 60 x 10 mm, its left end clamped or moved along x by the control "base".
struct Bar {
  Scene scene;
  int base = -1, viscosity = -1, mass_damping = -1;
  double L = 0.06;
  int index(const char* id) const { return scene.model->parameters().index(id); }
};

Bar bar(MassForm form = MassForm::consistent, bool moving = false, double E = 1e5, double beta = 0, double alpha = 0) {
  Bar result;
  SceneBuilder builder(rectangle(graded(result.L, 6), graded(0.01, 1), 1, "bar"), Plane::strain, 0.02);
  builder.add_solid("bar", "neo_hookean", {{"E", E}, {"nu", 0.3}});
  result.viscosity = builder.declare({"beta", "beta", "s", 0, 10, "viscosity"}, beta);
  result.mass_damping = builder.declare({"alpha", "alpha", "1/s", 0, 1e3, "drag"}, alpha);
  builder.add_inertia("bar", 1000, form, result.mass_damping);
  builder.add_viscosity("bar", result.viscosity);
  if (moving) {
    result.base = builder.declare({"base", "u", "m", -1, 1, "place of the base"}, 0.0);
    builder.fix("xmin", {1});
    builder.prescribe("xmin", 0, result.base);
  } else {
    builder.fix("xmin", {0, 1});
  }
  result.scene = builder.build();
  return result;
}

/// Small vibrations about rest by dense linear algebra, K phi = w^2 M phi, phi^T M phi = 1, on all unknowns.
struct Modes {
  Eigen::VectorXd frequency;  ///< w [rad/s], rising
  Eigen::MatrixXd shape;      ///< (unknowns x modes)
  Eigen::MatrixXd mass;       ///< on all unknowns, supports included
};

Modes modes(const Model& model, const Params& p) {
  const int n = model.unknowns(), free = model.free_unknowns();
  Eigen::MatrixXd K(n, n), M(n, n), extend = Eigen::MatrixXd::Zero(n, free);
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(n);
  TimeStep step;
  step.inertia = 1;
  step.reference = step.previous = rest;
  step.rate = {1e-200, -1e-200, 0};
  for (int i = 0; i < n; ++i) {
    const Eigen::VectorXd e = Eigen::VectorXd::Unit(n, i);
    K.col(i) = model.hessian_times({rest, p}, e);
    Assembly out;
    Eigen::VectorXd product;
    out.direction = &e;
    out.product = &product;
    model.evaluate_inertia({rest, p, &step}, out);
    M.col(i) = product;
    if (model.free_index(i) >= 0) extend(i, model.free_index(i)) = 1;
  }
  const Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::MatrixXd> solver(extend.transpose() * K * extend,
                                                                         extend.transpose() * M * extend);
  return {solver.eigenvalues().cwiseSqrt(), extend * solver.eigenvectors(), M};
}

/// The lowest mode of the bar released from rest at an amplitude of 1e-5 of the size, so that the body is linear.
struct Release {
  Bar body;
  double w;              ///< [rad/s]
  Eigen::VectorXd u, v;  ///< at the start
};

Release release(Bar&& body) {
  const Modes m = modes(*body.scene.model, body.scene.values);
  const Eigen::VectorXd shape = m.shape.col(0) / largest(m.shape.col(0));
  const double amplitude = 1e-5 * body.scene.model->length_scale();
  return {std::move(body), m.frequency[0], amplitude * shape, Eigen::VectorXd::Zero(shape.size())};
}

/// Largest difference to q(t) u0 at 8 times within 1.3 periods, relative to the amplitude.
double mode_error(const Release& r, const OdeOptions& options, const std::function<double(double)>& q) {
  OdeIntegrator integrator(*r.body.scene.model, options);
  integrator.start(0, r.u, r.v, constant(r.body.scene.values));
  double error = 0;
  for (int k = 1; k <= 8; ++k) {
    const double t = 1.3 * 2 * M_PI / r.w * k / 8;
    EXPECT_TRUE(integrator.advance_to(t)) << integrator.report().message();
    EXPECT_EQ(integrator.t(), t);
    error = std::max(error, largest(integrator.u() - q(t) * r.u) / largest(r.u));
  }
  return error;
}

TEST(OdeIntegrator, AFreeBlockFallsAsGalileoSays) {
  SceneBuilder builder(rectangle(graded(0.02, 2), graded(0.01, 1), 2, "block"), Plane::strain, 0.02);
  builder.add_solid("block", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
  builder.add_inertia("block", 1000);
  const int g = builder.declare({"g", "g", "m/s2", 0, 100, "gravity"}, 9.81);
  builder.add_weight("block", 1000, Eigen::Vector2d(0, -1), g);
  const Scene scene = builder.build(FreeBodies::move);
  const Eigen::VectorXd down = everywhere(*scene.model, 0, -1);
  const Eigen::VectorXd along = everywhere(*scene.model, 1, 0);
  for (OdeMethod method : all_methods) {
    OdeOptions options;
    options.method = method;
    OdeIntegrator integrator(*scene.model, options);
    integrator.start(2.0, 0.001 * along, 0.5 * along, constant(scene.values));
    ASSERT_TRUE(integrator.advance_to(2.1)) << name(method) << ": " << integrator.report().message();
    const double error = largest(integrator.u() - 0.051 * along - 0.5 * 9.81 * 0.01 * down);
    EXPECT_LT(error, 1e-5) << name(method);
    EXPECT_LT(largest(integrator.v() - 0.5 * along - 0.981 * down), 1e-4) << name(method);
  }
}

TEST(OdeIntegrator, AModeOscillatesAsTheGeneralisedEigenvalueSaysByAllMethodsAndBothMasses) {
  for (MassForm form : {MassForm::consistent, MassForm::lumped}) {
    const Release r = release(bar(form));
    for (OdeMethod method : all_methods) {
      OdeOptions options;
      options.method = method;
      options.tolerance = 1e-8;
      const double error = mode_error(r, options, [&](double t) { return std::cos(r.w * t); });
      EXPECT_LT(error, 4e-3) << name(method);
    }
  }
}

TEST(OdeIntegrator, ErrorsFallWithTheToleranceForEveryOrder) {
  const Release r = release(bar());
  const auto errors_of = [&](OdeMethod method, int order) {
    std::vector<double> errors;
    for (double tolerance : {1e-5, 1e-6, 1e-7, 1e-8}) {
      OdeOptions options;
      options.method = method;
      options.tolerance = tolerance;
      options.order = order;
      errors.push_back(mode_error(r, options, [&](double t) { return std::cos(r.w * t); }));
    }
    // The closed form is that of infinitely small amplitudes.
    EXPECT_LT(errors.back(), std::max(0.03 * errors.front(), 2e-5)) << name(method) << ", order " << order;
    EXPECT_LT(errors.back(), 4e-3) << name(method) << ", order " << order;
  };
  for (int order : {2, 5}) errors_of(OdeMethod::bdf, order);
  for (int order : {2, 3, 4, 5}) errors_of(OdeMethod::implicit_runge_kutta, order);
}

TEST(OdeIntegrator, ViscosityDampsAModeByBetaOmegaHalfAndDragByAlphaOverTwoOmega) {
  const double w = release(bar()).w;
  const double zeta = 0.08;
  for (bool viscous : {true, false}) {
    const Release r = release(viscous ? bar(MassForm::consistent, false, 1e5, 2 * zeta / w)
                                      : bar(MassForm::consistent, false, 1e5, 0, 2 * zeta * w));
    const double wd = w * std::sqrt(1 - zeta * zeta);
    const auto decay = [&](double t) {
      return std::exp(-zeta * w * t) * (std::cos(wd * t) + zeta * w / wd * std::sin(wd * t));
    };
    for (OdeMethod method : all_methods) {
      OdeOptions options;
      options.method = method;
      options.tolerance = 1e-8;
      const double error = mode_error(r, options, decay);
      EXPECT_LT(error, 2e-3) << name(method);
    }
  }
}

TEST(OdeIntegrator, AShakenBasePullsThroughStiffnessAndConsistentMass) {
  for (MassForm form : {MassForm::consistent, MassForm::lumped}) {
    const Bar body = bar(form, true);
    const Model& model = *body.scene.model;
    const Modes m = modes(model, body.scene.values);
    // Base A (1 - cos W t), relative motion by modes: q'' + w^2 q = -(phi^T M r) A W^2 cos W t, r the rigid
    // translation.
    const double A = 1e-5 * model.length_scale(), W = 300;
    const Eigen::VectorXd r = everywhere(model, 1, 0);
    const auto exact = [&](double t) {
      Eigen::VectorXd u = A * (1 - std::cos(W * t)) * r;
      for (int k = 0; k < m.frequency.size(); ++k) {
        const double w = m.frequency[k], load = m.shape.col(k).dot(m.mass * r);
        u -= load * A * W * W * (std::cos(W * t) - std::cos(w * t)) / (w * w - W * W) * m.shape.col(k);
      }
      return u;
    };
    OdeOptions options;
    options.tolerance = 1e-8;
    OdeIntegrator integrator(model, options);
    integrator.start(0, 0 * r, 0 * r, [&](double t) {
      Params p = body.scene.values;
      p[body.base] = A * (1 - std::cos(W * t));
      return p;
    });
    for (double t : {0.004, 0.011, 0.02}) {
      ASSERT_TRUE(integrator.advance_to(t)) << integrator.report().message();
      EXPECT_LT(largest(integrator.u() - exact(t)), 5e-3 * A) << t;
      EXPECT_GT(largest(exact(t) - A * (1 - std::cos(W * t)) * r), 0.05 * A)
          << "the test has to see more than the base";
    }
    EXPECT_NEAR(integrator.v()[0], A * W * std::sin(W * 0.02), 2e-4 * A * W);
  }
}

TEST(OdeIntegrator, EnergyOfLargeUndampedVibrationsIsKeptToTheTolerance) {
  const Bar body = bar();
  const Model& model = *body.scene.model;
  const Modes m = modes(model, body.scene.values);
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(model.unknowns());
  const Eigen::VectorXd v = 1.5 / largest(m.shape.col(0)) * m.shape.col(0);
  const auto energy = [&](const OdeIntegrator& integrator) {
    Assembly out;
    model.evaluate({integrator.u(), body.scene.values}, out);
    return out.energy + 0.5 * integrator.v().dot(m.mass * integrator.v());
  };
  const double loss_allowed[] = {2e-5, 1e-7, 5e-6};
  for (OdeMethod method : all_methods) {
    OdeOptions options;
    options.method = method;
    options.tolerance = 1e-6;
    OdeIntegrator integrator(model, options);
    integrator.start(0, rest, v, constant(body.scene.values));
    const double start = energy(integrator);
    double travel = 0;
    for (int k = 1; k <= 5; ++k) {
      ASSERT_TRUE(integrator.advance_to(0.01 * k)) << integrator.report().message();
      travel = std::max(travel, largest(integrator.u()));
      EXPECT_LT(std::abs(energy(integrator) / start - 1), loss_allowed[static_cast<int>(method)]) << name(method);
    }
    EXPECT_GT(travel, 0.1 * body.L) << "the vibration has to be large";
  }
}

TEST(OdeIntegrator, SensitivitiesOfAModeAreTheDerivativesOfTheClosedForm) {
  const double w0 = release(bar()).w, zeta = 0.05;
  const Release r = release(bar(MassForm::consistent, false, 1e5, 2 * zeta / w0));
  const double E = 1e5, rho = 1000, beta = 2 * zeta / w0;
  const double scale = r.w * std::sqrt(rho / E);
  const auto q = [&](double E_, double rho_, double beta_, double t) {
    const double w = scale * std::sqrt(E_ / rho_), z = beta_ * w / 2, wd = w * std::sqrt(1 - z * z);
    return std::exp(-z * w * t) * (std::cos(wd * t) + z * w / wd * std::sin(wd * t));
  };
  OdeOptions options;
  options.tolerance = 1e-8;
  OdeIntegrator integrator(*r.body.scene.model, options);
  integrator.track({r.body.index("E_bar"), r.body.index("density_bar"), r.body.viscosity});
  integrator.start(0, r.u, r.v, constant(r.body.scene.values));
  for (int k = 1; k <= 3; ++k) {
    const double t = 0.4 * k * 2 * M_PI / r.w, h = 1e-5;
    ASSERT_TRUE(integrator.advance_to(t)) << integrator.report().message();
    // Logarithmic derivatives are numbers around one.
    const double expected[] = {(q(E * (1 + h), rho, beta, t) - q(E * (1 - h), rho, beta, t)) / (2 * h),
                               (q(E, rho * (1 + h), beta, t) - q(E, rho * (1 - h), beta, t)) / (2 * h),
                               (q(E, rho, beta * (1 + h), t) - q(E, rho, beta * (1 - h), t)) / (2 * h)};
    const double at[] = {E, rho, beta};
    for (int i = 0; i < 3; ++i) {
      const double error = largest(at[i] * integrator.du().col(i) - expected[i] * r.u) / largest(r.u);
      EXPECT_LT(error, 5e-3) << i << ", t = " << t << ", of " << expected[i];
      EXPECT_GT(std::abs(expected[i]), 0.04) << "nothing to compare with";
    }
  }
}

TEST(OdeIntegrator, SensitivitiesOfALargeMotionAreThoseOfCentralDifferencesOfWholeIntegrations) {
  SceneBuilder builder(rectangle(graded(0.06, 6), graded(0.01, 1), 1, "bar"), Plane::strain, 0.02);
  builder.add_solid("bar", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
  const int beta = builder.declare({"beta", "beta", "s", 0, 10, "viscosity"}, 3e-3);
  const int alpha = builder.declare({"alpha", "alpha", "1/s", 0, 1e3, "drag"}, 4);
  const int g = builder.declare({"g", "g", "m/s2", 0, 100, "gravity"}, 9.81);
  const int lift = builder.declare({"lift", "u", "m", -1, 1, "place of the base"}, 0.002);
  builder.add_inertia("bar", 1000, MassForm::consistent, alpha);
  builder.add_viscosity("bar", beta);
  const int force = builder.declare({"force", "F", "N", -10, 10, "load on the tip"}, 0.1);
  builder.add_weight("bar", 1000, Eigen::Vector2d(0, -1), g);
  builder.add_force("xmax", Eigen::Vector2d(0, -1), force);
  builder.fix("xmin", {0});
  builder.prescribe("xmin", 1, lift);
  const Scene scene = builder.build();
  const Model& model = *scene.model;
  const ParameterTable& table = model.parameters();
  const std::vector<int> indices = {
      table.index("E_bar"), table.index("density_bar"), table.index("thickness"), beta, alpha, g, lift, force};
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(model.unknowns());
  const double end = 0.04;
  OdeOptions options;
  options.tolerance = 1e-6;
  const auto run = [&](const Params& p) {
    OdeIntegrator integrator(model, options);
    integrator.start(0, rest, rest, constant(p));
    EXPECT_TRUE(integrator.advance_to(end)) << integrator.report().message();
    return integrator.u();
  };
  OdeIntegrator tracking(model, options);
  tracking.track(indices);
  tracking.start(0, rest, rest, constant(scene.values));
  ASSERT_TRUE(tracking.advance_to(end)) << tracking.report().message();
  EXPECT_GT(largest(tracking.u()), 0.01);
  for (size_t i = 0; i < indices.size(); ++i) {
    const int index = indices[i];
    const double h = 1e-2 * scene.values[index];
    Params up = scene.values, down = scene.values;
    up[index] += h;
    down[index] -= h;
    const Eigen::VectorXd expected = (run(up) - run(down)) / (2 * h);
    const double error = largest(tracking.du().col(static_cast<Eigen::Index>(i)) - expected) / largest(expected);
    EXPECT_LT(error, 5e-3) << table[index].id;
  }
}

/// A soft cantilever with a stiff end piece, and its weight.
Scene end_piece(double stiff, double gravity) {
  Mesh mesh = rectangle(graded(0.06, 6), graded(0.01, 1), 1, "soft");
  assign_regions(mesh, [](const Eigen::VectorXd& c) { return c[0] > 0.05 ? "stiff" : "soft"; });
  SceneBuilder builder(std::move(mesh), Plane::strain, 0.02);
  builder.add_solid("soft", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
  builder.add_solid("stiff", "neo_hookean", {{"E", stiff}, {"nu", 0.3}});
  const int g = builder.declare({"g", "g", "m/s2", 0, 100, "gravity"}, gravity);
  for (const char* region : {"soft", "stiff"}) {
    builder.add_inertia(region, 1000);
    builder.add_weight(region, 1000, Eigen::Vector2d(0, -1), g);
  }
  builder.fix("xmin", {0, 1});
  return builder.build();
}

/// Steps from rest to 50 ms under 2 m/s^2.
int steps_of(OdeMethod method, double stiff) {
  const Scene scene = end_piece(stiff, 2);
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(scene.model->unknowns());
  OdeIntegrator integrator(*scene.model, {.method = method});
  integrator.start(0, rest, rest, constant(scene.values));
  EXPECT_TRUE(integrator.advance_to(0.05)) << integrator.report().message();
  return integrator.report().steps;
}

TEST(OdeIntegrator, StepsOfTheExplicitMethodGrowWithTheStiffestPartAndThoseOfImplicitOnesDoNot) {
  const int slow = steps_of(OdeMethod::explicit_runge_kutta, 1e7);
  const int slower = steps_of(OdeMethod::explicit_runge_kutta, 1e9);
  EXPECT_GT(slower, 7 * slow) << "its frequency has grown by sqrt(100)";
  EXPECT_LT(slower, 15 * slow);
  for (OdeMethod method : {OdeMethod::bdf, OdeMethod::implicit_runge_kutta}) {
    const int stiff = steps_of(method, 1e9);
    EXPECT_LT(stiff, 1.3 * steps_of(method, 1e7)) << name(method);
    EXPECT_LT(20 * stiff, slower) << name(method);
  }
}

TEST(OdeIntegrator, OrdersAboveTwoShrinkTheirStepsToThePeriodOfUndampedRinging) {
  // Released in the lowest mode (53 rad/s) alone; the highest one has 6e4 rad/s.
  const Scene scene = end_piece(1e7, 0);
  const Modes m = modes(*scene.model, scene.values);
  const Eigen::VectorXd v = 0.1 / largest(m.shape.col(0)) * m.shape.col(0);
  int steps[2];
  for (int order : {2, 5}) {
    OdeIntegrator integrator(*scene.model, {.tolerance = 1e-3, .order = order});
    integrator.start(0, 0 * v, v, constant(scene.values));
    EXPECT_TRUE(integrator.advance_to(0.3)) << integrator.report().message();
    steps[order == 5] = integrator.report().steps;
  }
  EXPECT_LT(steps[0], 400);
  EXPECT_GT(steps[1], 8 * steps[0]);
}

/// A free soft block 10 x 10 mm above a ground at y = 0 or a thin shelf, with a push downwards as control.
struct Thrown {
  Scene scene;
  int push;
  double gap = 1e-4;
  double lowest(const Eigen::VectorXd& u) const {
    double y = 1e9;
    for (int i = 0; i < scene.model->mesh().node_count(); ++i)
      y = std::min(y, scene.model->mesh().X[2 * i + 1] + u[2 * i + 1]);
    return y;
  }
};
Thrown thrown(bool shelf) {
  Mesh mesh = rectangle(graded(0.01, 2), graded(0.01, 2), 1, "block");
  for (int i = 0; i < mesh.node_count(); ++i) mesh.X[2 * i + 1] += 0.01;
  SceneBuilder builder(std::move(mesh), Plane::strain, 0.02);
  builder.add_solid("block", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
  builder.add_inertia("block", 1000);
  Thrown result;
  result.push = builder.declare({"push", "F", "N", -1e6, 1e6, "push"}, 0.0);
  builder.add_force("ymax", Eigen::Vector2d(0, -1), result.push);
  if (shelf) {
    std::vector<Eigen::Vector2d> line;
    for (int i = 0; i <= 40; ++i) line.push_back({-0.03 + 0.002 * i, 0});
    builder.add_contact(result.gap, {{"block", 1e5}}, {line});
  } else {
    builder.add_contact(result.gap, {{"block", 1e5}}, {}, {{{0, 0}, {0, 1}}});
  }
  result.scene = builder.build(FreeBodies::move);
  return result;
}

TEST(OdeIntegrator, AThrownBlockBouncesOrIsSaidToHavePassedThroughNeverSilently) {
  for (bool shelf : {false, true}) {
    const Thrown block = thrown(shelf);
    const Model& model = *block.scene.model;
    const Eigen::VectorXd rest = Eigen::VectorXd::Zero(model.unknowns());
    const Eigen::VectorXd down = everywhere(model, 0, -1);
    for (OdeMethod method : all_methods) {
      for (double tolerance : {1e-4, 1e2}) {
        OdeOptions options;
        options.method = method;
        options.tolerance = tolerance;
        OdeIntegrator integrator(model, options);
        integrator.start(0, rest, 3 * down, constant(block.scene.values));
        bool going = true;
        double rise = 0;
        for (int k = 1; k <= 40 && going; ++k) {
          going = integrator.advance_to(0.5e-3 * k);
          EXPECT_GT(block.lowest(integrator.u()), 0.0) << name(method) << ", tolerance " << tolerance;
          rise = integrator.v().dot(-down);
        }
        if (going)
          EXPECT_GT(rise, 0.0) << name(method) << ": after 20 ms it has to be on its way back";
        else
          EXPECT_EQ(integrator.report().status, OdeStatus::passed_through) << integrator.report().message();
        EXPECT_TRUE(going || tolerance > 1) << name(method) << ": " << integrator.report().message();
      }
    }
  }
}

TEST(SlowOdeIntegrator, SensitivitiesAcrossAnImpactAreThoseOfCentralDifferences) {
  const Thrown block = thrown(false);
  const Model& model = *block.scene.model;
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(model.unknowns());
  const Eigen::VectorXd v = everywhere(model, 0.1, -1.5);
  const int E = model.parameters().index("E_block");
  const auto run = [&](double factor, bool track) {
    OdeIntegrator integrator(model, {.tolerance = 1e-6});
    if (track) integrator.track({E});
    Params p = block.scene.values;
    p[E] *= factor;
    integrator.start(0, rest, v, constant(p));
    EXPECT_TRUE(integrator.advance_to(0.012)) << integrator.report().message();
    EXPECT_GT(integrator.v().dot(everywhere(model, 0, 1)), 0.0) << "on its way back";
    return track ? Eigen::VectorXd(p[E] * integrator.du().col(0)) : integrator.u();
  };
  // What runs with steps of their own choice scatter by is divided by the difference: it must not be small.
  const double h = 4e-3;
  const Eigen::VectorXd expected = (run(1 + h, false) - run(1 - h, false)) / (2 * h);
  const double error = largest(run(1, true) - expected);
  EXPECT_LT(error, 0.03 * largest(expected));
  EXPECT_GT(largest(expected), 1e-3) << "[m]";
}

TEST(OdeIntegrator, AJumpOverAThinShelfWithinOneStepIsNoticed) {
  const Thrown block = thrown(true);
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(block.scene.model->unknowns());
  OdeOptions options;
  options.method = OdeMethod::implicit_runge_kutta;
  options.tolerance = 1e6;  // no control of the error
  OdeIntegrator integrator(*block.scene.model, options);
  integrator.start(0, rest, rest, [&](double t) {
    Params p = block.scene.values;
    p[block.push] = t > 1e-3 ? 10 : 0;
    return p;
  });
  EXPECT_FALSE(integrator.advance_to(0.05));
  EXPECT_EQ(integrator.report().status, OdeStatus::passed_through);
  EXPECT_NE(integrator.report().message().find("may have been passed through"), std::string::npos);
  EXPECT_GT(block.lowest(integrator.u()), 0.0) << "the state is the last sound one";
  EXPECT_FALSE(integrator.advance_to(0.1)) << "it does not go on from there";
}

TEST(OdeIntegrator, AnInfeasibleStartAndTooFewStepsAreSaid) {
  const Thrown block = thrown(false);
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(block.scene.model->unknowns());
  OdeOptions options;
  options.max_steps = 3;
  OdeIntegrator integrator(*block.scene.model, options);
  integrator.start(0, Eigen::VectorXd::Constant(rest.size(), -0.02), rest, constant(block.scene.values));
  EXPECT_FALSE(integrator.advance_to(1));
  EXPECT_EQ(integrator.report().status, OdeStatus::infeasible_start);
  const Bar body = bar();
  OdeIntegrator few(*body.scene.model, options);
  const Eigen::VectorXd zero = Eigen::VectorXd::Zero(body.scene.model->unknowns());
  Eigen::VectorXd v = zero;
  for (int i = 0; i < body.scene.model->mesh().node_count(); ++i) v[2 * i + 1] = body.scene.model->mesh().X[2 * i];
  few.start(0, zero, v, constant(body.scene.values));
  EXPECT_FALSE(few.advance_to(1));
  EXPECT_EQ(few.report().status, OdeStatus::step_limit);
  EXPECT_EQ(few.report().steps, 3);
}

TEST(OdeIntegrator, WrongOptionsAndBodiesWithoutMassAreRefused) {
  const Bar body = bar();
  const Model& model = *body.scene.model;
  expect_input_error([&] { OdeIntegrator(model, {.order = 6}); }, {"order 6", "1 to 5"});
  expect_input_error([&] { OdeIntegrator(model, {.method = OdeMethod::implicit_runge_kutta, .order = 1}); },
                     {"order 1", "2 to 5"});
  expect_input_error([&] { OdeIntegrator(model, {.tolerance = 0}); }, {"tolerance 0", "positive"});
  OdeIntegrator integrator(model);
  EXPECT_THROW(integrator.advance_to(1), std::logic_error) << "before any start";
  expect_input_error([&] { integrator.track({99}); }, {"parameter 99", "0 to"});
  OdeIntegrator runge_kutta(model, {.method = OdeMethod::implicit_runge_kutta});
  expect_input_error([&] { runge_kutta.track({0}); }, {"only the method bdf"});
  SceneBuilder builder(rectangle(graded(0.06, 2), graded(0.01, 1), 1, "bar"), Plane::strain, 0.02);
  builder.add_solid("bar", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
  builder.fix("xmin", {0, 1});
  const Scene light = builder.build();
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(light.model->unknowns());
  OdeIntegrator massless(*light.model);
  expect_input_error([&] { massless.start(0, rest, rest, constant(light.values)); }, {"singular", "add inertia"});
}

}  // namespace
}  // namespace taut::test

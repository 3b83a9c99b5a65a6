#include <gtest/gtest.h>

#include <cmath>

#include "sim/mesh/structured.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/scene/scene.hpp"
#include "sim/solve/sundials_integrator.hpp"
#include "sim/solve/time_stepper.hpp"

// Where naive methods fail over time: explicit steps beside stiff parts, orders that ring, steps that jump over things,
// penalties, and the damping of long implicit steps.
namespace taut::test {
namespace {

Schedule constant(const Params& p) {
  return [p](double) { return p; };
}

TimeStepperOptions steps_of(double h, Integrator integrator = Integrator::implicit_euler) {
  TimeStepperOptions options;
  options.step = h;
  options.integrator = integrator;
  return options;
}

double largest(const Eigen::VectorXd& v) {
  return v.cwiseAbs().maxCoeff();
}

/// A soft cantilever 60 x 10 mm with a stiff end piece, and gravity across it.
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

TEST(Stress, ExplicitStepsGrowWithTheRootOfTheStiffnessAndImplicitOnesDoNotAndBothAgree) {
  std::vector<int> steps;
  for (double stiff : {1e6, 1e8, 1e10}) {
    const Scene scene = end_piece(stiff, 2);
    const Eigen::VectorXd rest = Eigen::VectorXd::Zero(scene.model->unknowns());
    OdeIntegrator integrator(*scene.model, {.method = OdeMethod::explicit_runge_kutta});
    integrator.start(0, rest, rest, constant(scene.values));
    ASSERT_TRUE(integrator.advance_to(0.01)) << integrator.report().message();
    steps.push_back(integrator.report().steps);
    TimeStepper stepper(*scene.model, steps_of(2.5e-4, Integrator::bdf2));
    stepper.start(0, rest, rest, constant(scene.values));
    while (stepper.t() < 0.01) ASSERT_TRUE(stepper.advance(0.01));
    EXPECT_EQ(stepper.report().steps, 40) << "whatever the stiffness";
    EXPECT_LT(stepper.report().iterations, 4 * stepper.report().steps);
    EXPECT_LT(largest(stepper.u() - integrator.u()), 0.02 * largest(integrator.u())) << stiff;
  }
  EXPECT_NEAR(std::log10(static_cast<double>(steps[2]) / steps[1]), 1, 0.1)
      << "ten times the steps for 100 times the E";
  EXPECT_GT(steps[1], 2 * steps[0]);
  EXPECT_GT(steps[2], 100 * 40);
}

TEST(Stress, AnExplicitStepBeyondTheStabilityLimitBlowsUpOnTheStiffBodyAndNotOnTheSoftOne) {
  // Steps of a fixed size: no control of the error. The limit falls with the root of the modulus.
  const auto run = [](double stiff, double h) {
    const Scene scene = end_piece(stiff, 2);
    const Eigen::VectorXd rest = Eigen::VectorXd::Zero(scene.model->unknowns());
    OdeOptions options;
    options.method = OdeMethod::explicit_runge_kutta;
    options.tolerance = 1e12;
    options.longest_step = h;
    options.max_steps = 4000;
    OdeIntegrator integrator(*scene.model, options);
    integrator.start(0, rest, rest, constant(scene.values));
    const bool reached = integrator.advance_to(0.02);
    return reached && largest(integrator.u()) < 0.06;
  };
  EXPECT_TRUE(run(1e5, 1e-4));
  EXPECT_FALSE(run(1e9, 1e-4));
  EXPECT_FALSE(run(1e9, 2e-5)) << "still beyond";
  // The implicit step of the same size on the same stiff body.
  const Scene scene = end_piece(1e9, 2);
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(scene.model->unknowns());
  TimeStepper stepper(*scene.model, steps_of(1e-4));
  stepper.start(0, rest, rest, constant(scene.values));
  while (stepper.t() < 0.02) ASSERT_TRUE(stepper.advance(0.02));
  EXPECT_EQ(stepper.report().failures, 0);
}

TEST(Stress, BdfOfOrderFiveShrinksItsStepsToUndampedRingingAndOrderTwoDoesNot) {
  const Scene scene = end_piece(1e8, 0);
  const Mesh& mesh = scene.model->mesh();
  Eigen::VectorXd v = Eigen::VectorXd::Zero(scene.model->unknowns());
  for (int i = 0; i < mesh.node_count(); ++i) v[2 * i + 1] = 30 * mesh.X[2 * i] * mesh.X[2 * i];  // about 0.1 m/s
  OdeIntegrator second(*scene.model, {.tolerance = 1e-3, .order = 2}),
      fifth(*scene.model, {.tolerance = 1e-3, .order = 5, .max_steps = 8000});
  second.start(0, 0 * v, v, constant(scene.values));
  fifth.start(0, 0 * v, v, constant(scene.values));
  ASSERT_TRUE(second.advance_to(0.1)) << second.report().message();
  EXPECT_LT(second.report().steps, 1500);
  EXPECT_FALSE(fifth.advance_to(0.1));
  EXPECT_EQ(fifth.report().status, OdeStatus::step_limit);
  EXPECT_LT(fifth.t(), 0.05) << "after 8000 steps";
  TimeStepper stepper(*scene.model, steps_of(1e-4, Integrator::bdf2));
  stepper.start(0, 0 * v, v, constant(scene.values));
  while (stepper.t() < 0.1) ASSERT_TRUE(stepper.advance(0.1));
  EXPECT_LT(largest(second.u() - stepper.u()), 0.05 * largest(stepper.u()));
}

TEST(Stress, OneImplicitStepOfAThousandSecondsIsTheStaticEquilibrium) {
  const Scene scene = end_piece(2e9, 20);
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(scene.model->unknowns());
  Equilibrium equilibrium(*scene.model);
  Params without = scene.values;
  without[scene.model->parameters().index("g")] = 0;
  equilibrium.start_at_rest(without);
  ASSERT_EQ(equilibrium.solve(scene.values).status, SolveStatus::converged);
  for (double h : {1.0, 1e3}) {
    TimeStepper stepper(*scene.model, steps_of(h));
    stepper.start(0, rest, rest, constant(scene.values));
    ASSERT_TRUE(stepper.advance(h));
    EXPECT_EQ(stepper.report().steps, 1);
    EXPECT_LT(largest(stepper.u() - equilibrium.u()), (h > 1 ? 1e-8 : 1e-2) * largest(equilibrium.u())) << h;
  }
  EXPECT_GT(largest(equilibrium.u()), 0.01);
  // An explicit step of even a thousandth of a second is not to be had.
  OdeIntegrator integrator(*scene.model, {.method = OdeMethod::explicit_runge_kutta, .max_steps = 300});
  integrator.start(0, rest, rest, constant(scene.values));
  EXPECT_FALSE(integrator.advance_to(1.0));
  EXPECT_EQ(integrator.report().status, OdeStatus::step_limit);
  EXPECT_LT(integrator.t(), 1e-3) << "after 300 steps";
}

TEST(Stress, ImplicitEulerSwallowsASwingAndBdf2KeepsItAsTheirFactorsSay) {
  // A bar's lowest axial mode, w = pi / (2 L) sqrt(E / rho) for nu = 0, released; ten periods at 20 steps each.
  const double L = 0.1, w = M_PI / (2 * L) * std::sqrt(1e6 / 1000), h = 2 * M_PI / w / 20;
  SceneBuilder builder(rectangle(graded(L, 40), graded(0.002, 1), 1, "bar"), Plane::strain, 0.02);
  builder.add_solid("bar", "neo_hookean", {{"E", 1e6}, {"nu", 0.0}});
  builder.add_inertia("bar", 1000);
  builder.fix("xmin", {0});
  builder.fix("ymin", {1});
  builder.fix("ymax", {1});
  const Scene scene = builder.build();
  const Mesh& mesh = scene.model->mesh();
  Eigen::VectorXd u = Eigen::VectorXd::Zero(scene.model->unknowns());
  for (int i = 0; i < mesh.node_count(); ++i) u[2 * i] = 1e-7 * std::sin(M_PI * mesh.X[2 * i] / (2 * L));
  const Eigen::VectorXd tip = mean_weights(mesh, mesh.select("xmax"), Eigen::Vector2d(1, 0));
  double left[2];
  for (Integrator integrator : {Integrator::implicit_euler, Integrator::bdf2}) {
    TimeStepper stepper(*scene.model, steps_of(h, integrator));
    stepper.start(0, u, 0 * u, constant(scene.values));
    double top = 0;
    for (int step = 0; step < 200; ++step) {
      ASSERT_TRUE(stepper.advance(1.0));
      if (step >= 180) top = std::max(top, std::abs(tip.dot(stepper.u())));
    }
    left[integrator == Integrator::bdf2] = top / 1e-7;
  }
  // |1 / (1 + i w h)| per step, 180 steps at the beginning of the last period.
  const double euler = std::pow(1 + w * h * w * h, -0.5 * 190);
  EXPECT_NEAR(std::log(left[0]) / std::log(euler), 1, 0.1);
  EXPECT_LT(left[0], 1e-3);
  EXPECT_GT(left[1], 0.2);
}

/// A soft block 10 x 10 mm that falls at 5 m/s, 5 mm above a shelf 1 mm thick, standing on its end faces.
struct Falling {
  Scene scene;
  double lowest(const Eigen::VectorXd& u) const {
    double y = 1e9;
    for (int i = 0; i < scene.model->mesh().node_count(); ++i)
      y = std::min(y, scene.model->mesh().X[2 * i + 1] + u[2 * i + 1]);
    return y;
  }
};

Falling falling(ContactForm form) {
  Mesh mesh = rectangle(graded(0.01, 3), graded(0.01, 3), 1, "block");
  place(mesh, Eigen::Matrix2d::Identity(), Eigen::Vector2d(0, 0.005));
  SceneBuilder builder(std::move(mesh), Plane::strain, 0.02);
  builder.add_solid("block", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
  builder.add_inertia("block", 1000);
  std::vector<Eigen::Vector2d> shelf;
  for (int i = 0; i <= 30; ++i) shelf.push_back({-0.01 + 0.001 * i, 0});
  for (int i = 30; i >= 0; --i) shelf.push_back({-0.01 + 0.001 * i, -0.001});
  shelf.push_back(shelf.front());
  builder.add_contact(1e-4, {{"block", 1e5}}, {shelf}, {}, form);
  return {builder.build(FreeBodies::move)};
}

TEST(Stress, ALongStepTunnelsThroughAShelfOfPenaltiesAndStopsAtTheBarrier) {
  const Eigen::Vector2d down(0, -5);
  for (double h : {1e-4, 1e-3, 4e-3}) {
    for (ContactForm form : {ContactForm::length_weighted, ContactForm::penalty}) {
      const Falling block = falling(form);
      const Model& model = *block.scene.model;
      TimeStepper stepper(model, steps_of(h));
      const Eigen::VectorXd v = down.replicate(model.mesh().node_count(), 1);
      stepper.start(0, 0 * v, v, constant(block.scene.values));
      double lowest = 1;
      while (stepper.t() < 0.008 && stepper.advance(0.008)) lowest = std::min(lowest, block.lowest(stepper.u()));
      EXPECT_GE(stepper.t(), 0.0079) << "neither of them fails";
      if (form == ContactForm::length_weighted) {
        EXPECT_GT(lowest, 0) << h;
      } else {
        EXPECT_LT(lowest, -0.011) << h << ": all of it is below the shelf, or most";
      }
    }
  }
}

TEST(Stress, AnIntegratorThatKnowsNoContactJumpsOverTheShelfAndIsStoppedForIt) {
  // Pushed hard while it has no speed yet: the step that the last speed allows is too long. TimeStepper lands on top.
  Mesh mesh = rectangle(graded(0.01, 2), graded(0.01, 2), 1, "block");
  place(mesh, Eigen::Matrix2d::Identity(), Eigen::Vector2d(0, 0.01));
  SceneBuilder builder(std::move(mesh), Plane::strain, 0.02);
  builder.add_solid("block", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
  builder.add_inertia("block", 1000);
  const int push = builder.declare({"push", "F", "N", -1e6, 1e6, "push"}, 0.0);
  builder.add_force("ymax", Eigen::Vector2d(0, -1), push);
  std::vector<Eigen::Vector2d> shelf;
  for (int i = 0; i <= 40; ++i) shelf.push_back({-0.03 + 0.002 * i, 0});
  builder.add_contact(1e-4, {{"block", 1e5}}, {shelf});
  const Falling block{builder.build(FreeBodies::move)};
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(block.scene.model->unknowns());
  const Schedule pushed = [&](double t) {
    Params p = block.scene.values;
    p[push] = t > 1e-3 ? 10 : 0;
    return p;
  };
  for (OdeMethod method : {OdeMethod::bdf, OdeMethod::implicit_runge_kutta}) {
    OdeOptions options;
    options.method = method;
    options.tolerance = 1e6;  // no control of the error: fixed steps, as many codes have
    OdeIntegrator integrator(*block.scene.model, options);
    integrator.start(0, rest, rest, pushed);
    EXPECT_FALSE(integrator.advance_to(0.05));
    EXPECT_EQ(integrator.report().status, OdeStatus::passed_through) << integrator.report().message();
  }
  TimeStepper stepper(*block.scene.model, steps_of(0.01));
  stepper.start(0, rest, rest, pushed);
  while (stepper.t() < 0.05) {
    ASSERT_TRUE(stepper.advance(0.05));
    EXPECT_GT(block.lowest(stepper.u()), 0);
  }
}

}  // namespace
}  // namespace taut::test

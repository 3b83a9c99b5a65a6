#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

#include "sim/mesh/structured.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/scene/scene.hpp"
#include "sim/solve/sundials_integrator.hpp"
#include "sim/solve/time_stepper.hpp"

// Motions with known periods, and our steppers against SUNDIALS.
namespace taut {
namespace {

Schedule constant(const Params& p) {
  return [p](double) { return p; };
}

/// Times at which a quantity crosses zero, by linear interpolation between steps.
template <class Quantity>
std::vector<double> zero_crossings(TimeStepper& stepper, double end, Quantity&& quantity) {
  std::vector<double> times;
  double before = quantity(), t_before = stepper.t();
  while (stepper.t() < end) {
    if (!stepper.advance(end)) {
      ADD_FAILURE() << "stopped at " << stepper.t();
      break;
    }
    const double now = quantity();
    if (before * now < 0) times.push_back(t_before + (stepper.t() - t_before) * before / (before - now));
    before = now;
    t_before = stepper.t();
  }
  return times;
}

class Pendulum : public ::testing::TestWithParam<bool> {};

TEST_P(Pendulum, ABodyOnAFreePinSwingsWithThePeriodOfThePhysicalPendulum) {
  // Uniform rod of 100 x 4 mm about its end; T / T0 = (2/pi) K(sin(A/2)): 1.017409 at 30 and 1.180341 at 90 degrees.
  const double L = 0.1, w = 0.004, g = 9.81;
  Mesh mesh = rectangle(graded(w, 1), graded(L, 8), 2, "rod");
  place(mesh, Eigen::Matrix2d::Identity(), Eigen::Vector2d(-0.5 * w, -L));
  SceneBuilder builder(std::move(mesh), Plane::strain, 0.01);
  if (GetParam())
    builder.add_rigid("rod", 1e8);
  else
    builder.add_solid("rod", "neo_hookean", {{"E", 1e8}, {"nu", 0.3}});
  const int gravity = builder.declare({"g", "g", "m/s2", 0, 100, "gravity"}, g);
  builder.add_weight("rod", 1000, Eigen::Vector2d(0, -1), gravity);
  builder.add_inertia("rod", 1000);
  JointSettings pin;
  pin.id = "pin";
  pin.part_a = "world";
  pin.pivot = Eigen::Vector2d(0, 0);
  pin.radius = 0.001;
  builder.add_joint(pin);
  const Scene scene = builder.build(FreeBodies::move);
  const Eigen::VectorXd end =
      mean_weights(scene.model->mesh(), scene.model->mesh().select("ymin"), Eigen::Vector2d(1, 0));
  const double T0 = 2 * M_PI * std::sqrt((L * L / 3 + w * w / 12) / (g * 0.5 * L));
  for (auto [degrees, ratio] : {std::pair{30.0, 1.017409}, std::pair{90.0, 1.180341}}) {
    const Eigen::Matrix2d R = Eigen::Rotation2Dd(degrees * M_PI / 180).toRotationMatrix();
    Eigen::VectorXd u(scene.model->unknowns());
    for (int i = 0; i < scene.model->mesh().node_count(); ++i)
      u.segment<2>(2 * i) = R * scene.model->mesh().node(i) - scene.model->mesh().node(i);
    const auto period = [&](int steps) {
      TimeStepperOptions options;
      options.integrator = Integrator::bdf2;
      options.step = T0 / steps;
      TimeStepper stepper(*scene.model, options);
      stepper.start(0, u, Eigen::VectorXd::Zero(u.size()), constant(scene.values));
      const std::vector<double> crossings =
          zero_crossings(stepper, 0.9 * ratio * T0, [&] { return end.dot(stepper.u()); });
      return crossings.size() < 2 ? 0.0 : 2 * (crossings[1] - crossings[0]);
    };
    const double coarse = period(150), fine = period(300);
    EXPECT_NEAR((fine + (fine - coarse) / 3) / (ratio * T0), 1, 1e-3) << degrees;
    EXPECT_NEAR(fine / (ratio * T0), 1, 3e-3) << degrees;
  }
}
INSTANTIATE_TEST_SUITE_P(ElasticOrRigid, Pendulum, ::testing::Bool());

TEST(Cantilever, SwingsWithItsFirstBendingFrequency) {
  // f1 = 1.87510^2 / (2 pi L^2) sqrt(E I / (rho A)); shear and rotary inertia lower it by 0.3 % at L / H = 20.
  const double L = 0.1, H = 0.005, E = 1e6, rho = 1000;
  SceneBuilder builder(rectangle(graded(L, 20), graded(H, 1), 2, "beam"), Plane::stress, 0.01);
  builder.add_solid("beam", "neo_hookean", {{"E", E}, {"nu", 0.0}});
  builder.add_inertia("beam", rho);
  builder.fix("xmin", {0, 1});
  const int force = builder.declare({"force", "F", "N", -1, 1, "load"}, 0);
  builder.add_force("xmax", Eigen::Vector2d(0, -1), force);
  const Scene scene = builder.build();
  Equilibrium equilibrium(*scene.model);
  equilibrium.start_at_rest(scene.values);
  Params loaded = scene.values;
  loaded[force] = 1e-6;
  ASSERT_EQ(equilibrium.solve(loaded).status, SolveStatus::converged);
  const double f1 = 1.87510 * 1.87510 / (2 * M_PI * L * L) * std::sqrt(E * H * H / (12 * rho));
  TimeStepperOptions options;
  options.integrator = Integrator::bdf2;
  options.step = 1 / (300 * f1);
  TimeStepper stepper(*scene.model, options);
  stepper.start(0, equilibrium.u(), Eigen::VectorXd::Zero(equilibrium.u().size()), constant(scene.values));
  const Eigen::VectorXd tip =
      mean_weights(scene.model->mesh(), scene.model->mesh().select("xmax"), Eigen::Vector2d(0, 1));
  const std::vector<double> crossings = zero_crossings(stepper, 2.8 / f1, [&] { return tip.dot(stepper.u()); });
  ASSERT_GE(crossings.size(), 5u);
  const double f = 2 / (crossings[4] - crossings[0]);
  EXPECT_NEAR(f / f1, 0.997, 0.003);
}

/// A soft beam on a motorised joint with a cable that is retracted: what soft-rigid robots are made of.
struct CableAndJoint {
  Scene scene;
  int pull, motor;
  std::vector<int> parameters;
  Eigen::VectorXd tip;

  CableAndJoint() {
    SceneBuilder builder(rectangle(graded(0.06, 6), graded(0.012, 2), 1, "foam"), Plane::strain, 0.02);
    builder.add_solid("foam", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
    const int beta = builder.declare({"beta", "beta", "s", 0, 1, "damping"}, 2e-3);
    builder.add_inertia("foam", 100);
    builder.add_viscosity("foam", beta);
    pull = builder.declare({"pull", "u", "m", -1, 1, "retraction"}, 0);
    motor = builder.declare({"motor", "theta", "rad", -10, 10, "angle"}, 0);
    Cable cable;
    cable.stiffness = builder.declare({"k_cable", "k", "N/m", 1e-3, 1e9, "stiffness", true}, 500);
    cable.retraction = pull;
    cable.smoothing = 2e-4;
    for (double x : {0.0, 0.03, 0.06}) {
      const Eigen::Vector2d point(x, 0.011);
      cable.points.push_back({locate(builder.mesh(), point), point});
    }
    builder.add_cable(cable);
    JointSettings joint;
    joint.id = "shoulder";
    joint.part_a = "world";
    joint.pivot = Eigen::Vector2d(0.003, 0.006);
    joint.motor = Eigen::Vector2d(0.003, 0.010);
    joint.radius = 0.004;
    joint.stiffness = 2e4;
    builder.add_joint(joint, motor);
    scene = builder.build(FreeBodies::move);
    const ParameterTable& table = scene.model->parameters();
    parameters = {table.index("E_foam"), table.index("nu_foam"), table.index("beta"), table.index("k_cable"),
                  table.index("density_foam")};
    tip = mean_weights(scene.model->mesh(), scene.model->mesh().select("xmax"), Eigen::Vector2d(0, 1));
  }
  Schedule schedule() const {
    return [this](double t) {
      Params p = scene.values;
      p[pull] = 2e-3 * (1 - std::cos(60 * t));
      p[motor] = 0.3 * (1 - std::cos(40 * t));
      return p;
    };
  }
};

TEST(SlowSundials, OurStepperAndCvodeConvergeToOneTrajectoryAndOneSetOfSensitivities) {
  const CableAndJoint robot;
  const Model& model = *robot.scene.model;
  const double end = 0.04;
  const Eigen::VectorXd zero = Eigen::VectorXd::Zero(model.unknowns());
  OdeOptions options;
  options.tolerance = 1e-9;
  options.order = 5;
  OdeIntegrator cvode(model, options);
  cvode.track(robot.parameters);
  cvode.start(0, zero, zero, robot.schedule());
  ASSERT_TRUE(cvode.advance_to(end)) << cvode.report().message();

  const auto n = static_cast<Eigen::Index>(robot.parameters.size());
  const auto ours = [&](int steps) {
    TimeStepperOptions ours_options;
    ours_options.integrator = Integrator::bdf2;
    ours_options.step = end / steps;
    ours_options.equilibrium.step_tolerance = 1e-13;
    TimeStepper stepper(model, ours_options);
    stepper.track(static_cast<int>(n), [&](double) {
      Eigen::MatrixXd dp = Eigen::MatrixXd::Zero(model.parameters().size(), n);
      for (Eigen::Index k = 0; k < n; ++k) dp(robot.parameters[static_cast<size_t>(k)], k) = 1;
      return dp;
    });
    stepper.start(0, zero, zero, robot.schedule());
    while (stepper.t() < end) EXPECT_TRUE(stepper.advance(end));
    Eigen::VectorXd all(n + 1);
    all << robot.tip.dot(stepper.u()), stepper.du().transpose() * robot.tip;
    return all;
  };
  // Richardson: the error of BDF2 is h^2 and, its first step being implicit Euler, h^3.
  const Eigen::VectorXd a = ours(500), b = ours(1000), c = ours(2000);
  const Eigen::VectorXd ab = b + (b - a) / 3, bc = c + (c - b) / 3, limit = bc + (bc - ab) / 7;
  EXPECT_NEAR(limit[0] / robot.tip.dot(cvode.u()), 1, 1e-6);
  for (Eigen::Index k = 0; k < n; ++k) {
    const double reference = robot.tip.dot(cvode.du().col(k));
    ASSERT_NE(reference, 0);
    EXPECT_NEAR(limit[k + 1] / reference, 1, 1e-6) << model.parameters()[robot.parameters[static_cast<size_t>(k)]].id;
  }
}

}  // namespace
}  // namespace taut

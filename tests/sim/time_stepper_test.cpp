#include "sim/solve/time_stepper.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "sim/mesh/structured.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/scene/scene.hpp"
#include "tests/support/taylor.hpp"

namespace taut {
namespace {

using namespace test;

Schedule constant(const Params& p) {
  return [p](double) { return p; };
}

Eigen::VectorXd zero(const Scene& scene) {
  return Eigen::VectorXd::Zero(scene.model->unknowns());
}

/// Runs to `end`; every step has to be accepted.
void run(TimeStepper& stepper, double end) {
  while (stepper.t() < end)
    ASSERT_TRUE(stepper.advance(end)) << stepper.t() << " s: " << name_of(stepper.report().status);
}

double kinetic_energy(const Scene& scene, const TimeStepper& stepper) {
  TimeStep step;
  step.inertia = 1;
  step.rate = {1, -1, 0};
  step.previous = stepper.u();
  step.reference = stepper.u() - stepper.v();
  Assembly out;
  scene.model->evaluate_inertia({stepper.u(), stepper.p(), &step}, out);
  return out.energy;
}

double potential_energy(const Scene& scene, const TimeStepper& stepper) {
  Assembly out;
  scene.model->evaluate({stepper.u(), stepper.p()}, out);
  return out.energy;
}

/// One linear triangle without Poisson effect, of which one corner swings along x at tiny amplitude: one degree of
/// freedom of stiffness k = E t H / (2 L) and mass m = rho t L H / 6.
struct Oscillator {
  static constexpr double L = 0.1, H = 0.05, t = 0.02, E = 1e5, rho = 1000, amplitude = 1e-9;
  Scene scene;
  double omega = std::sqrt((E * t * H / (2 * L)) / (rho * t * L * H / 6));

  explicit Oscillator(double mass_damping = 0, double stiffness_damping = 0) {
    Mesh mesh;
    mesh.X = Eigen::VectorXd::Zero(6);
    mesh.X[2] = L;
    mesh.X[5] = H;
    mesh.elements = {0, 1, 2};
    mesh.region = {0};
    mesh.region_names = {"bar"};
    mesh.tags["wall"] = {0, 1, {0, 2}};
    mesh.tags["corner"] = {0, 1, {1}};
    SceneBuilder builder(std::move(mesh), Plane::strain, t);
    builder.add_solid("bar", "neo_hookean", {{"E", E}, {"nu", 0}});
    const int alpha = builder.declare({"alpha", "alpha", "1/s", 0, 1e6, "damping"}, mass_damping);
    const int beta = builder.declare({"beta", "beta", "s", 0, 1e6, "damping"}, stiffness_damping);
    builder.add_inertia("bar", rho, MassForm::lumped, alpha);
    builder.add_viscosity("bar", beta);
    builder.fix("wall", {0, 1});
    builder.fix("corner", {1});
    scene = builder.build();
  }
  Eigen::VectorXd stretched() const { return amplitude * Eigen::VectorXd::Unit(6, 2); }
  /// Displacement of the end over its amplitude after `periods` of the undamped motion, `steps` per period.
  double at(double periods, int steps, Integrator integrator) const {
    TimeStepperOptions options;
    options.integrator = integrator;
    const double period = 2 * M_PI / omega;
    options.step = period / steps;
    options.equilibrium.step_tolerance = 1e-15;
    TimeStepper stepper(*scene.model, options);
    stepper.start(0, stretched(), zero(scene), constant(scene.values));
    run(stepper, periods * period);
    return stepper.u()[2] / amplitude;
  }
};

TEST(TimeStepper, ImplicitEulerIsOfOrderOneAndBdf2OfOrderTwoOnAnOscillator) {
  const Oscillator oscillator;
  const double periods = 0.3, exact = std::cos(2 * M_PI * periods);
  for (Integrator integrator : {Integrator::implicit_euler, Integrator::bdf2}) {
    std::vector<double> errors;
    for (int steps : {400, 800, 1600}) errors.push_back(std::abs(oscillator.at(periods, steps, integrator) - exact));
    const double order = std::log2(errors[1] / errors[2]);
    EXPECT_NEAR(order, integrator == Integrator::bdf2 ? 2.0 : 1.0, 0.05) << errors[0] << " " << errors[2];
  }
}

TEST(TimeStepper, ImplicitEulerDampsAsItsAmplificationFactorSays) {
  // One step multiplies the amplitude by 1 / sqrt(1 + (w h)^2), exactly.
  const Oscillator oscillator;
  const int steps = 40;
  const double wh = 2 * M_PI / steps, angle = std::atan(wh);
  // u_n = Re[c z^n], z = 1/(1 + i w h); with v_0 = 0: u_n = cos(n angle) / sqrt(1 + w^2 h^2)^n.
  const int n = steps;
  EXPECT_NEAR(oscillator.at(1, steps, Integrator::implicit_euler),
              std::cos(n * angle) * std::pow(1 + wh * wh, -0.5 * n), 1e-6);
}

TEST(TimeStepper, BothDampingsDecayAsTheirRatiosSay) {
  // zeta = alpha / (2 w) + beta w / 2; u = exp(-zeta w t) (cos wd t + zeta w / wd sin wd t).
  const double omega = Oscillator().omega;
  for (auto [alpha, beta] : {std::pair{0.1 * omega, 0.0}, std::pair{0.0, 0.1 / omega}}) {
    const Oscillator oscillator(alpha, beta);
    const double zeta = 0.05, t = 2.3 * 2 * M_PI, damped = std::sqrt(1 - zeta * zeta);
    const double exact = std::exp(-zeta * t) * (std::cos(damped * t) + zeta / damped * std::sin(damped * t));
    const double coarse = oscillator.at(2.3, 400, Integrator::bdf2), fine = oscillator.at(2.3, 800, Integrator::bdf2);
    EXPECT_NEAR(fine + (fine - coarse) / 3, exact, 2e-5);
  }
}

/// A soft block without supports.
Scene free_block(double gravity, double mass_damping = 0) {
  SceneBuilder builder(rectangle(graded(0.04, 3), graded(0.03, 2), 2, "block"), Plane::strain, 0.02);
  builder.add_solid("block", "neo_hookean", {{"E", 5e4}, {"nu", 0.3}});
  const int g = builder.declare({"g", "g", "m/s2", 0, 100, "gravity"}, gravity);
  builder.add_weight("block", 500, Eigen::Vector2d(0, -1), g);
  const int alpha = builder.declare({"alpha", "alpha", "1/s", 0, 1e6, "damping"}, mass_damping);
  builder.add_inertia("block", 500, MassForm::consistent, alpha);
  return builder.build(FreeBodies::move);
}

TEST(TimeStepper, FreeFallIsOffByHalfAStepOfSpeedWithImplicitEuler) {
  const Scene scene = free_block(9.81);
  TimeStepperOptions options;
  options.step = 0.01;
  TimeStepper stepper(*scene.model, options);
  stepper.start(0, zero(scene), zero(scene), constant(scene.values));
  run(stepper, 0.2);
  for (Eigen::Index i = 1; i < stepper.u().size(); i += 2)
    EXPECT_NEAR(stepper.u()[i], -0.5 * 9.81 * 0.2 * 0.2 - 0.5 * 9.81 * 0.01 * 0.2, 1e-12);
  EXPECT_EQ(stepper.report().steps, 20);
}

TEST(TimeStepper, WithoutSupportsLinearMomentumIsKeptAndAngularMomentumToTheOrderOfTheMethod) {
  const Scene scene = free_block(0);
  const Mesh& mesh = scene.model->mesh();
  const Eigen::Vector2d centre(0.02, 0.015), drift(0.3, -0.2);
  const double spin = 20;
  Eigen::VectorXd v(mesh.X.size());
  for (int i = 0; i < mesh.node_count(); ++i) {
    const Eigen::Vector2d r = mesh.node(i) - centre;
    v.segment<2>(2 * i) = drift + spin * Eigen::Vector2d(-r[1], r[0]);
  }
  // M v by the gradient of the kinetic energy.
  auto momentum = [&](const Eigen::VectorXd& u, const Eigen::VectorXd& velocity) {
    TimeStep step;
    step.inertia = 1;
    step.rate = {1, -1, 0};
    step.previous = u;
    step.reference = u - velocity;
    Eigen::VectorXd mv;
    Assembly out;
    out.gradient = &mv;
    scene.model->evaluate_inertia({u, scene.values, &step}, out);
    Eigen::Vector3d total = Eigen::Vector3d::Zero();
    for (int i = 0; i < mesh.node_count(); ++i) {
      const Eigen::Vector2d x = mesh.node(i) + u.segment<2>(2 * i), m = mv.segment<2>(2 * i);
      total += Eigen::Vector3d(m[0], m[1], x[0] * m[1] - x[1] * m[0]);
    }
    return total;
  };
  for (Integrator integrator : {Integrator::implicit_euler, Integrator::bdf2}) {
    std::vector<double> lost;
    for (double h : {2e-3, 1e-3, 5e-4}) {
      TimeStepperOptions options;
      options.integrator = integrator;
      options.step = h;
      TimeStepper stepper(*scene.model, options);
      stepper.start(0, zero(scene), v, constant(scene.values));
      const Eigen::Vector3d before = momentum(zero(scene), v);
      run(stepper, 0.04);
      const Eigen::Vector3d after = momentum(stepper.u(), stepper.v());
      EXPECT_LE((after - before).head(2).norm(), 1e-9 * before.head(2).norm());
      lost.push_back(std::abs(after[2] - before[2]) / std::abs(before[2]));
    }
    EXPECT_LT(lost[2], integrator == Integrator::bdf2 ? 0.002 : 0.02);
    EXPECT_NEAR(std::log2(lost[1] / lost[2]), integrator == Integrator::bdf2 ? 2 : 1, 0.35)
        << lost[0] << " " << lost[2];
  }
}

TEST(TimeStepper, WithoutInputTheEnergyNeverGrows) {
  for (Integrator integrator : {Integrator::implicit_euler, Integrator::bdf2}) {
    const Scene scene = free_block(0);
    std::mt19937 random(4);
    std::normal_distribution<double> normal;
    Eigen::VectorXd v(scene.model->unknowns());
    for (double& x : v) x = 0.2 * normal(random);
    TimeStepperOptions options;
    options.integrator = integrator;
    options.step = 5e-4;
    TimeStepper stepper(*scene.model, options);
    stepper.start(0, zero(scene), v, constant(scene.values));
    double energy = kinetic_energy(scene, stepper) + potential_energy(scene, stepper);
    for (int k = 0; k < 60; ++k) {
      ASSERT_TRUE(stepper.advance(1));
      const double next = kinetic_energy(scene, stepper) + potential_energy(scene, stepper);
      EXPECT_LE(next, energy * (1 + 1e-9)) << "step " << k;
      energy = next;
    }
  }
}

/// A block that falls onto a ground, with damping of both kinds: contact comes and goes.
struct Bouncing {
  Scene scene;
  int g = 0;
  explicit Bouncing(double height = 0.002) {
    SceneBuilder builder(rectangle(graded(0.04, 3), graded(0.03, 2), 1, "block"), Plane::strain, 0.02);
    builder.add_solid("block", "neo_hookean", {{"E", 5e4}, {"nu", 0.3}});
    g = builder.declare({"g", "g", "m/s2", 0, 100, "gravity"}, 9.81);
    builder.add_weight("block", 500, Eigen::Vector2d(0.1, -1), g);
    const int alpha = builder.declare({"alpha", "alpha", "1/s", 0, 1e6, "damping"}, 2);
    const int beta = builder.declare({"beta", "beta", "s", 0, 1e6, "damping"}, 2e-3);
    builder.add_inertia("block", 500, MassForm::consistent, alpha);
    builder.add_viscosity("block", beta);
    builder.add_contact(4e-4, {{"block", 5e3}}, {}, {{Eigen::Vector2d(0, -height), Eigen::Vector2d(0, 1)}});
    scene = builder.build(FreeBodies::move);
  }
};

TEST(TimeStepper, NothingFallsThroughAGroundHoweverLongTheStep) {
  const Bouncing bouncing;
  for (double h : {1e-3, 1e-2, 0.1, 1.0}) {
    TimeStepperOptions options;
    options.step = h;
    options.equilibrium.max_iterations = 100;
    TimeStepper stepper(*bouncing.scene.model, options);
    Eigen::VectorXd v = zero(bouncing.scene);
    for (Eigen::Index i = 1; i < v.size(); i += 2) v[i] = -20;
    stepper.start(0, zero(bouncing.scene), v, constant(bouncing.scene.values));
    for (int k = 0; k < 20; ++k) {
      ASSERT_TRUE(stepper.advance(1e3)) << "h = " << h << ": " << name_of(stepper.report().status);
      const Eigen::VectorXd x = bouncing.scene.model->mesh().X + stepper.u();
      for (Eigen::Index i = 1; i < x.size(); i += 2) ASSERT_GT(x[i], -0.002);
    }
  }
}

/// p(t; theta) with theta scaling the listed parameters from their nominal values.
Schedule scaled(const Params& p, const std::vector<int>& indices, const Eigen::VectorXd& theta) {
  Params scaled = p;
  for (size_t k = 0; k < indices.size(); ++k) scaled[indices[k]] *= theta[static_cast<Eigen::Index>(k)];
  return constant(scaled);
}

TEST(TimeStepper, SensitivitiesAreTheDerivativesOfTheWholeTrajectoryWithContactActive) {
  const Bouncing bouncing;
  const Model& model = *bouncing.scene.model;
  std::vector<int> indices;
  for (const char* id : {"E_block", "nu_block", "density_block", "g", "alpha", "beta", "contact_gap"})
    indices.push_back(model.parameters().index(id));
  const auto n = static_cast<Eigen::Index>(indices.size());
  for (Integrator integrator : {Integrator::implicit_euler, Integrator::bdf2}) {
    TimeStepperOptions options;
    options.integrator = integrator;
    options.step = 2e-3;
    options.equilibrium.step_tolerance = 1e-12;
    auto end_state = [&](const Eigen::VectorXd& theta, Eigen::MatrixXd* du, Eigen::MatrixXd* dv) {
      TimeStepper stepper(model, options);
      if (du != nullptr) {
        stepper.track(static_cast<int>(n), [&](double) {
          Eigen::MatrixXd dp = Eigen::MatrixXd::Zero(model.parameters().size(), n);
          for (Eigen::Index k = 0; k < n; ++k)
            dp(indices[static_cast<size_t>(k)], k) = bouncing.scene.values[indices[static_cast<size_t>(k)]];
          return dp;
        });
      }
      stepper.start(0, zero(bouncing.scene), zero(bouncing.scene), scaled(bouncing.scene.values, indices, theta));
      run(stepper, 0.05);
      if (du != nullptr) *du = stepper.du();
      if (dv != nullptr) *dv = stepper.dv();
      Eigen::VectorXd both(2 * stepper.u().size());
      both << stepper.u(), 0.01 * stepper.v();
      return both;
    };
    const Eigen::VectorXd one = Eigen::VectorXd::Ones(n);
    Eigen::MatrixXd du, dv;
    const Eigen::VectorXd state = end_state(one, &du, &dv);
    Eigen::MatrixXd d(state.size(), n);
    d << du, 0.01 * dv;
    for (Eigen::Index k = 0; k < n; ++k) {
      ASSERT_GT(d.col(k).norm(), 1e-9) << "nothing depends on "
                                       << model.parameters()[indices[static_cast<size_t>(k)]].id;
      expect_taylor_order(
          [&](double h) {
            return (end_state(one + h * Eigen::VectorXd::Unit(n, k), nullptr, nullptr) - state - h * d.col(k)).norm();
          },
          2, 1e-12, 3e-2, 6, model.parameters()[indices[static_cast<size_t>(k)]].id);
    }
  }
}

TEST(TimeStepper, TheAdjointGradientEqualsTheForwardOneStepByStep) {
  const Bouncing bouncing;
  const Model& model = *bouncing.scene.model;
  const std::vector<int> indices{bouncing.g, model.parameters().index("E_block")};
  std::mt19937 random(8);
  std::normal_distribution<double> normal;
  for (Integrator integrator : {Integrator::implicit_euler, Integrator::bdf2}) {
    TimeStepperOptions options;
    options.integrator = integrator;
    options.step = 2e-3;
    options.equilibrium.step_tolerance = 1e-14;
    const int steps = 24;
    // Forward: theta_k is the parameter in step k alone; every second one, to spare time.
    TimeStepper stepper(model, options);
    stepper.track(steps, [&](double t) {
      Eigen::MatrixXd dp = Eigen::MatrixXd::Zero(model.parameters().size(), steps);
      const auto k = static_cast<Eigen::Index>(std::lround(t / options.step)) - 1;
      if (k >= 0) dp(indices[static_cast<size_t>(k) % 2], k) = 1;
      return dp;
    });
    stepper.start(0, zero(bouncing.scene), zero(bouncing.scene), constant(bouncing.scene.values));
    std::vector<AcceptedStep> accepted;
    std::vector<Eigen::VectorXd> gradients;
    Eigen::VectorXd forward = Eigen::VectorXd::Zero(steps);
    for (int k = 0; k < steps; ++k) {
      ASSERT_TRUE(stepper.advance((k + 1) * options.step));
      accepted.push_back(stepper.last());
      Eigen::VectorXd w(model.unknowns());
      for (double& x : w) x = k % 3 == 0 ? normal(random) : 0.0;  // Q = sum of w_k . u_k
      gradients.push_back(k % 3 == 0 ? w : Eigen::VectorXd());
      if (k % 3 == 0) forward += stepper.du().transpose() * w;
    }
    const Eigen::MatrixXd adjoint = adjoint_gradient(model, accepted, gradients, indices).parameters;
    for (int parity : {0, 1}) {
      double largest = 0;
      for (int k = parity; k < steps; k += 2) largest = std::max(largest, std::abs(forward[k]));
      ASSERT_GT(largest, 0.0);
      for (int k = parity; k < steps; k += 2) EXPECT_NEAR(adjoint(parity, k), forward[k], 1e-10 * largest) << k;
    }
  }
}

TEST(TimeStepper, MovingSupportsAndTheirSensitivitiesFollowTheSchedule) {
  SceneBuilder builder(rectangle(graded(0.1, 4), graded(0.02, 1), 2, "bar"), Plane::strain, 0.02);
  builder.add_solid("bar", "neo_hookean", {{"E", 5e4}, {"nu", 0.3}});
  builder.add_inertia("bar", 500);
  const int shake = builder.declare({"shake", "u", "m", -1, 1, "base motion"}, 0.0);
  builder.fix("xmin", {0});
  builder.prescribe("xmin", 1, shake);
  const Scene scene = builder.build();
  const Eigen::VectorXd tip =
      mean_weights(scene.model->mesh(), scene.model->mesh().select("xmax"), Eigen::Vector2d(0, 1));
  auto schedule = [&](double amplitude) -> Schedule {
    return [&scene, shake, amplitude](double t) {
      Params p = scene.values;
      p[shake] = amplitude * std::sin(60 * t);
      return p;
    };
  };
  TimeStepperOptions options;
  options.integrator = Integrator::bdf2;
  options.step = 2e-3;
  TimeStepper stepper(*scene.model, options);
  auto tip_at = [&](double amplitude) {
    stepper.start(0, zero(scene), zero(scene), schedule(amplitude));
    run(stepper, 0.1);
    return tip.dot(stepper.u());
  };
  stepper.track(1, [&](double t) {
    Eigen::MatrixXd dp = Eigen::MatrixXd::Zero(scene.values.size(), 1);
    dp(shake, 0) = std::sin(60 * t);
    return dp;
  });
  const double amplitude = 3e-3, y = tip_at(amplitude), slope = tip.dot(stepper.du().col(0));
  EXPECT_NEAR(stepper.u()[scene.model->mesh().select("xmin").nodes()[0] * 2 + 1], amplitude * std::sin(6.0), 1e-15);
  EXPECT_GT(std::abs(slope), 0.2);
  expect_taylor_order([&](double h) { return std::abs(tip_at(amplitude + h) - y - h * slope); }, 2, 1e-12, 1e-3, 5,
                      "base motion");
}

TEST(TimeStepper, AnAdaptiveStepKeepsTheErrorNearItsTolerance) {
  const Oscillator oscillator;
  for (Integrator integrator : {Integrator::implicit_euler, Integrator::bdf2}) {
    std::vector<double> errors;
    std::vector<int> steps;
    for (double tolerance : {1e-11, 1e-12, 1e-13}) {  // the amplitude is 1e-8 of the diagonal
      TimeStepperOptions options;
      options.integrator = integrator;
      options.step = 0.2 / oscillator.omega;
      options.tolerance = tolerance;
      options.equilibrium.step_tolerance = 1e-16;
      TimeStepper stepper(*oscillator.scene.model, options);
      stepper.start(0, oscillator.stretched(), zero(oscillator.scene), constant(oscillator.scene.values));
      const double end = 4 / oscillator.omega;
      run(stepper, end);
      errors.push_back(std::abs(stepper.u()[2] / oscillator.amplitude - std::cos(4.0)));
      steps.push_back(stepper.report().steps);
    }
    EXPECT_LT(errors[2], 0.35 * errors[0]);
    EXPECT_GT(steps[2], 1.5 * steps[0]);
  }
}

TEST(TimeStepper, AFailedStepIsHalvedAndNeverAccepted) {
  const Bouncing bouncing;
  TimeStepperOptions options;
  options.step = 0.02;
  options.equilibrium.max_iterations = 3;  // too few for an impact in one step
  TimeStepper stepper(*bouncing.scene.model, options);
  Eigen::VectorXd v = zero(bouncing.scene);
  for (Eigen::Index i = 1; i < v.size(); i += 2) v[i] = -3;
  stepper.start(0, zero(bouncing.scene), v, constant(bouncing.scene.values));
  run(stepper, 0.04);
  EXPECT_GT(stepper.report().failures, 0);
  EXPECT_GT(stepper.report().steps, 2);
  EXPECT_DOUBLE_EQ(stepper.t(), 0.04);

  options.equilibrium.max_iterations = 1;
  options.shortest = 0.6;  // no halving
  TimeStepper hopeless(*bouncing.scene.model, options);
  hopeless.start(0, zero(bouncing.scene), v, constant(bouncing.scene.values));
  EXPECT_FALSE(hopeless.advance(1));
  EXPECT_EQ(hopeless.t(), 0.0);
  EXPECT_EQ(hopeless.u().norm(), 0.0);
}

}  // namespace
}  // namespace taut

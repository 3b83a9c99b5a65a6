#include <gtest/gtest.h>

#include <cmath>
#include <complex>
#include <random>

#include "sim/mesh/structured.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/scene/scene.hpp"
#include "sim/solve/quasi_statics.hpp"
#include "sim/solve/time_stepper.hpp"
#include "tests/support/term_battery.hpp"

// Stresses that relax: solids with Prony pairs. The known answers are those of one linear standard solid.
namespace taut {
namespace {

using namespace test;

constexpr double g = 0.2, tau = 60;

/// A solid with two pairs, deformed at random, amid a step from another random state.
TermUnderTest relaxing_case(ElementShape shape, Formulation formulation, Plane plane = Plane::strain) {
  Mesh mesh = irregular_mesh(shape);
  const Eigen::VectorXd u = random_state(mesh, 0.1, 0.01, 3);
  SceneBuilder builder(mesh, plane, 0.3);
  builder.add_solid("body", "neo_hookean", {{"E", 2e5}, {"nu", formulation == Formulation::locking_free ? 0.45 : 0.3}},
                    formulation, {{0.2, 60}, {0.3, 5}});
  Scene scene = builder.build(FreeBodies::move);
  auto step = std::make_shared<TimeStep>();
  step->length = 12;
  std::mt19937 random(5);
  step->memory = 1e4 * random_vector(scene.model->memory_size(), random);
  // Stresses are symmetric.
  const int d = mesh.dimension();
  for (Eigen::Index first = 0; first < step->memory.size(); first += d * d) {
    const Eigen::MatrixXd S = step->memory.segment(first, d * d).reshaped(d, d);
    step->memory.segment(first, d * d) = (0.5 * (S + S.transpose())).reshaped();
  }
  return {std::move(*scene.model), scene.values, u, std::string(name_of(shape)), step};
}

template <class Action>
void for_each_relaxing(Action&& action) {
  for (ElementShape shape : all_shapes) {
    action(relaxing_case(shape, Formulation::standard));
    if (dimension_of(shape) == 2) action(relaxing_case(shape, Formulation::standard, Plane::stress));
    if (order_of(shape) == 2) action(relaxing_case(shape, Formulation::locking_free));
  }
}

TEST(Memory, DerivativesOfARelaxingSolidPassTheirTaylorTests) {
  for_each_relaxing([](const TermUnderTest& t) {
    expect_derivatives(t, 5e-5);
    expect_projection_is_semidefinite(t);
    expect_no_net_force_or_moment(t);
  });
}

TEST(Memory, TheGradientsDerivativesByParametersAndMemoryPassTheirTaylorTests) {
  for_each_relaxing([](const TermUnderTest& t) {
    const Eigen::VectorXd gradient = gradient_of(t.model, t.u, t.p, t.step.get());
    for (int k = 0; k < t.model.parameters().size(); ++k) {
      const Eigen::VectorXd by = t.model.parameter_gradient(t.at(), k);
      EXPECT_GT(by.norm(), 0.0) << t.model.parameters()[k].id;
      const auto remainder = [&](double h) {
        Params p = t.p;
        p[k] *= 1 + 0.1 * h;
        return (gradient_of(t.model, t.u, p, t.step.get()) - gradient - by * (p[k] - t.p[k])).norm();
      };
      expect_taylor_order(remainder, 2, 1e-13 * gradient.norm(), 1, 6, t.name + " " + t.model.parameters()[k].id);
    }
    std::mt19937 random(7);
    const Eigen::VectorXd change = 1e3 * random_vector(t.step->memory.size(), random);
    TimeStep other = *t.step;
    other.memory += change;
    // The history is linear in the energy.
    const Eigen::VectorXd difference = gradient_of(t.model, t.u, t.p, &other) - gradient;
    EXPECT_LT((difference - t.model.memory_product(t.at(), change)).norm(), 1e-10 * difference.norm()) << t.name;
  });
}

TEST(Memory, WhatIsRememberedChangesAsItsDerivativesSay) {
  for_each_relaxing([](const TermUnderTest& t) {
    std::mt19937 random(9);
    const Eigen::VectorXd du = 1e-3 * random_vector(t.u.size(), random);
    const Eigen::VectorXd dmemory = 1e3 * random_vector(t.step->memory.size(), random);
    Params dp = 0.05 * t.p.cwiseProduct(random_vector(t.p.size(), random));
    const Eigen::VectorXd now = t.model.remember(t.at());
    const Eigen::VectorXd change = t.model.remember_change(t.at(), du, dp, dmemory);
    const auto remainder = [&](double h) {
      TimeStep step = *t.step;
      step.memory += h * dmemory;
      const Eigen::VectorXd u = t.u + h * du;
      const Params p = t.p + h * dp;
      return (t.model.remember({u, p, &step}) - now - h * change).norm();
    };
    expect_taylor_order(remainder, 2, 1e-12 * now.norm(), 0.5, 6, t.name);
  });
}

TEST(Memory, ARigidRotationDuringADwellChangesNothing) {
  for_each_relaxing([](const TermUnderTest& t) {
    const Mesh& mesh = t.model.mesh();
    const int d = mesh.dimension();
    Eigen::MatrixXd R = Eigen::MatrixXd::Identity(d, d);
    R.topLeftCorner(2, 2) = Eigen::Rotation2Dd(0.7).toRotationMatrix();
    Eigen::VectorXd turned(t.u.size()), force(t.u.size());
    const Eigen::VectorXd gradient = gradient_of(t.model, t.u, t.p, t.step.get());
    for (int i = 0; i < mesh.node_count(); ++i) {
      turned.segment(i * d, d) = R * (mesh.node(i) + t.u.segment(i * d, d)) - mesh.node(i);
      force.segment(i * d, d) = R * gradient.segment(i * d, d);
    }
    const Eigen::VectorXd before = t.model.remember(t.at()), after = t.model.remember({turned, t.p, t.step.get()});
    EXPECT_LT((before - after).norm(), 1e-11 * before.norm()) << t.name;
    EXPECT_LT((gradient_of(t.model, turned, t.p, t.step.get()) - force).norm(), 1e-11 * force.norm()) << t.name;
  });
}

/// A bar along x without Poisson effect; its end is pulled by "force" [N] or moved by "stretch" [m].
struct Bar {
  static constexpr double L = 0.1, E = 1e5, area = 0.02 * 0.02;
  Scene scene;
  int force = -1, stretch = -1;

  explicit Bar(bool moved, double share = g, double time = tau) {
    SceneBuilder builder(rectangle({0, 0.5 * L, L}, {0, 0.02}, 1, "bar"), Plane::strain, 0.02);
    builder.add_solid("bar", "neo_hookean", {{"E", E}, {"nu", 0}}, Formulation::standard, {{share, time}});
    builder.fix("xmin", {0, 1});
    builder.fix("xmax", {1});
    force = builder.declare({"force", "F", "N", -1e6, 1e6, "load"}, 0.0);
    stretch = builder.declare({"stretch", "u", "m", -1, 1, "motion"}, 0.0);
    builder.add_force("xmax", Eigen::Vector2d(1, 0), force);
    if (moved) builder.prescribe("xmax", 0, stretch);
    scene = builder.build();
  }
  int index(const char* id) const { return scene.model->parameters().index(id); }
  double tip(const Eigen::VectorXd& u) const {
    return mean_weights(scene.model->mesh(), scene.model->mesh().select("xmax"), Eigen::Vector2d(1, 0)).dot(u);
  }
  /// Force by which the end is held [N].
  double held(const QuasiStatics& statics, const Params& p) const {
    const Eigen::VectorXd gradient = gradient_of(*scene.model, statics.u(), p, &statics.step());
    double sum = 0;
    for (int node : scene.model->mesh().select("xmax").nodes()) sum += gradient[2 * node];
    return sum;
  }
};

TEST(Memory, AHeldStretchRelaxesAsOneStandardSolidInAnyNumberOfSteps) {
  const Bar bar(true);
  const Eigen::MatrixXd none(bar.scene.values.size(), 0);
  Params p = bar.scene.values;
  for (double stretch : {1e-3, 0.3}) {  // of the bar's length; the law's stress is any
    for (int steps : {1, 7}) {
      QuasiStatics statics(*bar.scene.model);
      p[bar.stretch] = 0;
      statics.start_at_rest(p);
      p[bar.stretch] = stretch * Bar::L;
      ASSERT_EQ(statics.advance(p, none, 0).status, SolveStatus::converged);
      const double at_once = bar.held(statics, p);
      for (int k = 0; k < steps; ++k) ASSERT_EQ(statics.advance(p, none, 100.0 / steps).status, SolveStatus::converged);
      EXPECT_NEAR(bar.held(statics, p) / at_once, 1 - g * (1 - std::exp(-100 / tau)), 1e-9) << stretch << " " << steps;
    }
  }
}

/// Tip after a small dead load has acted for `seconds`, over its tip at once.
double creep(const Bar& bar, double seconds, int steps) {
  const Eigen::MatrixXd none(bar.scene.values.size(), 0);
  EquilibriumOptions options;
  options.step_tolerance = 1e-14;
  QuasiStatics statics(*bar.scene.model, options);
  Params p = bar.scene.values;
  statics.start_at_rest(p);
  p[bar.force] = 1e-7 * Bar::E * Bar::area;
  statics.advance(p, none, 0);
  const double at_once = bar.tip(statics.u());
  if (steps == 0) statics.hold(p, none, seconds);
  for (int k = 0; k < steps; ++k) statics.advance(p, none, seconds / steps);
  return bar.tip(statics.u()) / at_once;
}

TEST(Memory, ADeadLoadCreepsAsOneStandardSolidAndToSecondOrderInTheSteps) {
  const Bar bar(false);
  const double exact = 1 + g / (1 - g) * (1 - std::exp(-(1 - g) * 180 / tau));
  EXPECT_NEAR(exact, 1.22732, 5e-6);
  const double coarse = creep(bar, 180, 50), fine = creep(bar, 180, 100);
  EXPECT_NEAR((coarse - exact) / (fine - exact), 4, 0.1);
  EXPECT_NEAR(fine + (fine - coarse) / 3, exact, 1e-6);
  EXPECT_NEAR(creep(bar, 180, 0), exact, 1e-3 * (exact - 1) * 5);
}

TEST(Memory, WhatIsLeftAfterARestIsThatOfTheKnownAnswers) {
  // After 60 s under load and 180 s of rest, in units of the deflection at once.
  for (auto [time, left] : {std::pair{10.0, 0.0}, {60.0, 0.0125}, {300.0, 0.0229}, {1000.0, 0.0101}}) {
    const Bar bar(false, g, time);
    const Eigen::MatrixXd none(bar.scene.values.size(), 0);
    EquilibriumOptions options;
    options.step_tolerance = 1e-14;
    QuasiStatics statics(*bar.scene.model, options);
    Params p = bar.scene.values, rest = p;
    statics.start_at_rest(p);
    p[bar.force] = 1e-7 * Bar::E * Bar::area;
    statics.advance(p, none, 0);
    const double at_once = bar.tip(statics.u());
    for (int k = 0; k < 60; ++k) statics.advance(p, none, 1);
    statics.advance(rest, none, 0);
    for (int k = 0; k < 180; ++k) statics.advance(rest, none, 1);
    EXPECT_NEAR(bar.tip(statics.u()) / at_once, left, 6e-5) << time;
  }
}

TEST(Memory, SensitivitiesGoThroughADwellAndARest) {
  // Large deflections of a short cantilever: load, dwell, rest, load again.
  SceneBuilder builder(rectangle(graded(0.06, 4), graded(0.02, 2), 2, "foam"), Plane::stress, 0.02);
  builder.add_solid("foam", "neo_hookean", {{"E", 5e4}, {"nu", 0.3}}, Formulation::standard, {{g, tau}});
  builder.fix("xmin", {0, 1});
  const int force = builder.declare({"force", "F", "N", -1e6, 1e6, "load"}, 0.0);
  builder.add_force("xmax", Eigen::Vector2d(0, -1), force);
  const Scene scene = builder.build();
  const ParameterTable& table = scene.model->parameters();
  const std::vector<int> tracked{table.index("E_foam"), table.index("g_foam"), table.index("tau_foam"),
                                 table.index("nu_foam"), table.index("thickness")};
  Eigen::MatrixXd dp = Eigen::MatrixXd::Zero(table.size(), static_cast<Eigen::Index>(tracked.size()));
  for (size_t j = 0; j < tracked.size(); ++j) dp(tracked[j], static_cast<Eigen::Index>(j)) = 1;
  EquilibriumOptions options;
  options.step_tolerance = 1e-13;
  QuasiStatics statics(*scene.model, options);
  const auto end = [&](Params p, int count) {
    const Eigen::MatrixXd columns = dp.leftCols(count);
    statics.start_at_rest(p, count);
    for (auto [load, seconds] : {std::pair{0.3, 40.0}, {0.0, 30.0}, {0.4, 20.0}}) {
      p[force] = load;
      EXPECT_EQ(statics.advance(p, columns, 0).status, SolveStatus::converged);
      EXPECT_EQ(statics.hold(p, columns, seconds).status, SolveStatus::converged);
    }
    return statics.u();
  };
  const Eigen::VectorXd u = end(scene.values, static_cast<int>(tracked.size()));
  EXPECT_GT(u.cwiseAbs().maxCoeff(), 0.01);
  const Eigen::MatrixXd du = statics.du();
  for (size_t j = 0; j < tracked.size(); ++j) {
    const auto remainder = [&](double h) {
      Params p = scene.values;
      p[tracked[j]] *= 1 + 0.1 * h;
      const double change = p[tracked[j]] - scene.values[tracked[j]];
      return (end(p, 0) - u - du.col(static_cast<Eigen::Index>(j)) * change).norm();
    };
    expect_taylor_order(remainder, 2, 1e-11, 1, 5, table[tracked[j]].id);
  }
}

/// The triangle of one degree of freedom of time_stepper_test.cpp: k = E t H / (2 L), m = rho t L H / 6.
struct Swing {
  static constexpr double L = 0.1, H = 0.05, t = 0.02, E = 1e5, rho = 1000, amplitude = 1e-9;
  Scene scene;
  double omega = std::sqrt((E * t * H / (2 * L)) / (rho * t * L * H / 6));

  explicit Swing(double time) {
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
    builder.add_solid("bar", "neo_hookean", {{"E", E}, {"nu", 0}}, Formulation::standard, {{g, time}});
    builder.add_inertia("bar", rho, MassForm::lumped);
    builder.fix("wall", {0, 1});
    builder.fix("corner", {1});
    scene = builder.build();
  }
  double after(double periods, int steps) const {
    TimeStepperOptions options;
    options.integrator = Integrator::bdf2;
    options.step = 2 * M_PI / omega / steps;
    options.equilibrium.step_tolerance = 1e-15;
    TimeStepper stepper(*scene.model, options);
    stepper.start(0, amplitude * Eigen::VectorXd::Unit(6, 2), Eigen::VectorXd::Zero(6),
                  [&](double) { return scene.values; });
    const double end = periods * 2 * M_PI / omega;
    while (stepper.t() < end) EXPECT_TRUE(stepper.advance(end));
    return stepper.u()[2] / amplitude;
  }
};

TEST(Memory, ASwingDecaysAsThatOfOneStandardSolid) {
  // m s^2 + k (1 - g + g s tau / (1 + s tau)) = 0; let go from u = 1 that was come to at once, so that the internal
  // stress begins with g k: three roots, of which two swing.
  for (double times : {0.3, 1.0, 5.0}) {  // omega tau
    const Swing swing(times / Swing(1).omega);
    const double w = swing.omega, T = times / w;
    // With y = (u, v, h): u' = v, v' = -w^2 ((1 - g) u + h), h' = -h / T + g v.
    Eigen::Matrix3d A;
    A << 0, 1, 0, -w * w * (1 - g), 0, -w * w, 0, g, -1 / T;
    const Eigen::EigenSolver<Eigen::Matrix3d> modes(A);
    const double end = 2.3 * 2 * M_PI / w;
    const Eigen::Vector3cd weights = modes.eigenvectors().inverse() * Eigen::Vector3cd(1, 0, g);
    std::complex<double> exact = 0;
    for (int i = 0; i < 3; ++i)
      exact += modes.eigenvectors()(0, i) * weights[i] * std::exp(modes.eigenvalues()[i] * end);
    const double coarse = swing.after(2.3, 400), fine = swing.after(2.3, 800);
    EXPECT_NEAR(fine + (fine - coarse) / 3, exact.real(), 2e-5) << times;
  }
}

TEST(Memory, SensitivitiesOfASwingThatRelaxesPassTheirTaylorTest) {
  const Swing swing(0.01);
  const ParameterTable& table = swing.scene.model->parameters();
  const std::vector<int> tracked{table.index("E_bar"), table.index("g_bar"), table.index("tau_bar")};
  const auto end = [&](const Params& p, Eigen::MatrixXd* du) {
    TimeStepperOptions options;
    options.integrator = Integrator::bdf2;
    options.step = 1e-3;
    options.equilibrium.step_tolerance = 1e-14;
    TimeStepper stepper(*swing.scene.model, options);
    if (du != nullptr) {
      Eigen::MatrixXd dp = Eigen::MatrixXd::Zero(table.size(), 3);
      for (int j = 0; j < 3; ++j) dp(tracked[static_cast<size_t>(j)], j) = 1;
      stepper.track(3, [dp](double) { return dp; });
    }
    stepper.start(0, 0.02 * Eigen::VectorXd::Unit(6, 2), Eigen::VectorXd::Zero(6), [&](double) { return p; });
    while (stepper.t() < 0.02) EXPECT_TRUE(stepper.advance(0.02));
    if (du != nullptr) *du = stepper.du();
    return stepper.u();
  };
  Eigen::MatrixXd du;
  const Eigen::VectorXd u = end(swing.scene.values, &du);
  for (int j = 0; j < 3; ++j) {
    const int k = tracked[static_cast<size_t>(j)];
    const auto remainder = [&](double h) {
      Params p = swing.scene.values;
      p[k] *= 1 + 0.1 * h;
      return (end(p, nullptr) - u - du.col(j) * (p[k] - swing.scene.values[k])).norm();
    };
    expect_taylor_order(remainder, 2, 1e-13, 1, 5, table[k].id);
  }
}

}  // namespace
}  // namespace taut

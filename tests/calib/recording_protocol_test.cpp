#include "calib/benches/recording_protocol.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "calib/fit/fit.hpp"
#include "sim/mesh/structured.hpp"
#include "sim/mesh/weights.hpp"
#include "tests/support/taylor.hpp"

namespace taut {
namespace {

using namespace test;

/// One linear triangle without Poisson effect, of which one corner moves along x at tiny amplitude: one degree of
/// freedom of stiffness k = E t H / (2 L), mass m = rho t L H / 6 and damping beta k, pulled by a force.
struct Oscillator {
  static constexpr double L = 0.1, H = 0.05, t = 0.02, rho = 1000, force = 5e-7, release = 0.0123;
  Scene scene;
  std::vector<NamedChannel> channels;
  int pull = -1, held_by = -1, released = -1;

  explicit Oscillator(double E, double beta) {
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
    builder.add_inertia("bar", rho, MassForm::lumped);
    builder.add_viscosity("bar", builder.declare({"beta", "beta", "s", 0, 1, "damping"}, beta));
    pull = builder.declare({"pull", "F", "N", -1, 1, "force"}, 0);
    held_by = builder.declare({"held_by", "F", "N", -1, 1, "force before the release"}, force);
    released = builder.declare({"release", "t0", "s", -1, 1, "time of the release"}, release);
    builder.add_force("corner", Eigen::Vector2d(1, 0), pull);
    builder.fix("wall", {0, 1});
    builder.fix("corner", {1});
    scene = builder.build();
    channels.push_back({"end", make_linear_channel(Eigen::VectorXd::Unit(6, 2))});
  }

  static double omega(double E) { return std::sqrt(E * t * H / (2 * L) / (rho * t * L * H / 6)); }
  /// u / (force / k) at a time after the release from the stretched state: 1 at first, 0 in the end.
  static double free(double E, double beta, double time) {
    if (time <= 0) return 1;
    const double w = omega(E), zeta = beta * w / 2, damped = w * std::sqrt(1 - zeta * zeta);
    return std::exp(-zeta * w * time) * (std::cos(damped * time) + zeta * w / damped * std::sin(damped * time));
  }
  static double stretch(double E) { return force / (E * t * H / (2 * L)); }

  static RecordingProtocol::Options options(int steps_per_period) {
    RecordingProtocol::Options options;
    options.step = 2 * M_PI / omega(1e5) / steps_per_period;
    options.equilibrium.step_tolerance = 1e-15;
    return options;
  }
  /// Let go from the stretched state.
  RecordingProtocol protocol(const std::vector<double>& times, int steps_per_period) {
    Recording recording{"ring", {}, {}, {{pull, held_by}}, released};
    std::vector<RecordingRow> rows;
    for (double time : times) rows.push_back({0, 0, time});
    return {std::move(scene), std::move(channels), {pull}, {recording}, rows, options(steps_per_period)};
  }
};

std::vector<double> even_times(double step, int count) {
  std::vector<double> times;
  for (int i = 0; i < count; ++i) times.push_back(step * i);
  return times;
}

TEST(RecordingProtocol, ARecordingOfADampedOscillatorGivesItsModulusAndDampingBack) {
  constexpr double E = 1e5, beta = 5e-4, sigma = 1e-12;
  const std::vector<double> times = even_times(2.7e-3, 40);
  Oscillator oscillator(1.3 * E, 2 * beta);
  RecordingProtocol protocol = oscillator.protocol(times, 400);
  std::vector<Measurement> measurements;
  for (size_t i = 0; i < times.size(); ++i) {
    const double exact = Oscillator::stretch(E) * Oscillator::free(E, beta, times[i] - Oscillator::release);
    measurements.push_back({static_cast<int>(i), exact, sigma, static_cast<int>(i)});
  }
  const ParameterTable& table = protocol.parameters();
  const std::vector<FreeParameter> free = {{table.index("E_bar"), 1.3 * E, 1e4, 1e6},
                                           {table.index("beta"), 2 * beta, 0, 0.1}};
  const FitResult result = fit(protocol, measurements, free);
  ASSERT_EQ(result.status, FitStatus::converged) << result.message;
  EXPECT_NEAR(result.parameters[0].value, E, 1e-3 * E);
  EXPECT_NEAR(result.parameters[1].value, beta, 1e-3 * beta);
}

TEST(RecordingProtocol, RowsBetweenStepsAreOfTheOrderOfBdf2) {
  constexpr double E = 1e5, beta = 2e-4;
  const std::vector<double> times = even_times(3.1e-3, 30);
  std::vector<double> errors;
  for (int steps : {100, 200, 400}) {
    Oscillator oscillator(E, beta);
    RecordingProtocol protocol = oscillator.protocol(times, steps);
    const Prediction prediction = protocol.predict(protocol.nominal(), {});
    double& worst = errors.emplace_back(0);
    for (size_t i = 0; i < times.size(); ++i) {
      const double exact = Oscillator::free(E, beta, times[i] - Oscillator::release);
      worst =
          std::max(worst, std::abs(prediction.values[static_cast<Eigen::Index>(i)] / Oscillator::stretch(E) - exact));
    }
  }
  EXPECT_NEAR(std::log2(errors[1] / errors[2]), 2, 0.1) << errors[0] << " " << errors[1] << " " << errors[2];
  EXPECT_LT(errors[2], 2e-3);
}

TEST(RecordingProtocol, ABodyHeldAtRestFallsAboutItsEquilibrium) {
  constexpr double E = 1e5, beta = 2e-4;
  Oscillator oscillator(E, beta);
  const Recording recording{"step", {{oscillator.pull, Oscillator::force}}, {}, {}, oscillator.released};
  const std::vector<double> times = even_times(3.1e-3, 20);
  std::vector<RecordingRow> rows;
  for (double time : times) rows.push_back({0, 0, time});
  RecordingProtocol protocol(std::move(oscillator.scene), std::move(oscillator.channels), {oscillator.pull},
                             {recording}, rows, Oscillator::options(400));
  const Prediction prediction = protocol.predict(protocol.nominal(), {});
  for (size_t i = 0; i < times.size(); ++i) {
    const double exact = 1 - Oscillator::free(E, beta, times[i] - Oscillator::release);
    EXPECT_NEAR(prediction.values[static_cast<Eigen::Index>(i)] / Oscillator::stretch(E), exact, 2e-3) << times[i];
  }
}

TEST(RecordingProtocol, RecordingsThatDifferInTheirReleaseOnlyShareATrajectory) {
  Oscillator oscillator(1e5, 2e-4);
  const Recording one{"a", {}, {}, {{oscillator.pull, oscillator.held_by}}, oscillator.released};
  const Recording other{"b", {}, {}, {{oscillator.pull, oscillator.held_by}}, -1};
  std::vector<RecordingRow> rows;
  for (double time : even_times(4e-3, 12)) {
    rows.push_back({0, 0, time + Oscillator::release});
    rows.push_back({1, 0, time});
  }
  RecordingProtocol protocol(std::move(oscillator.scene), std::move(oscillator.channels), {oscillator.pull},
                             {one, other}, rows, Oscillator::options(100));
  EXPECT_EQ(protocol.trajectories(), 1);
  const Prediction prediction = protocol.predict(protocol.nominal(), {});
  for (Eigen::Index i = 0; i < prediction.values.size(); i += 2)
    EXPECT_NEAR(prediction.values[i], prediction.values[i + 1], 1e-9 * Oscillator::stretch(1e5));
}

/// A soft cantilever that bends far, two cases with dampings of their own, each held by a force of its own.
RecordingProtocol cantilever(Integrator integrator, int threads, int max_iterations = 40) {
  SceneBuilder builder(rectangle(graded(0.1, 4), graded(0.02, 1), 2, "bar"), Plane::strain, 0.02);
  const int g = builder.declare({"g", "g", "m/s2", 0, 100, "gravity"}, 9.81);
  builder.add_solid("bar", "neo_hookean", {{"E", 2e5}, {"nu", 0.4}});
  builder.add_weight("bar", 1000, Eigen::Vector2d(0, -1), g);
  const int beta = builder.declare({"beta", "beta", "s", 0, 1, "damping"}, 1e-3);
  builder.add_inertia("bar", 1000);
  builder.add_viscosity("bar", beta);
  const int mass = builder.declare({"mass", "m", "kg", 0, 1, "hung mass"}, 0);
  const int hand = builder.declare({"hand", "F", "N", -10, 10, "force"}, 0);
  builder.add_force("xmax & ymax", Eigen::Vector2d(0, -1), mass, g);
  builder.add_point_mass("xmax & ymax", mass);
  builder.add_force("xmax & ymax", Eigen::Vector2d(0, -1), hand);
  builder.fix("xmin", {0, 1});
  std::vector<Recording> recordings;
  std::vector<RecordingRow> rows;
  for (int k = 0; k < 2; ++k) {
    const std::string name = std::to_string(k + 1);
    Recording& recording = recordings.emplace_back();
    recording.id = "case " + name;
    recording.set = {{mass, 0.01 * k}};
    recording.takes = {{beta, builder.declare({"beta_" + name, "beta", "s", 0, 1, "damping"}, 2e-3)}};
    recording.held = {{hand, builder.declare({"hand_" + name, "F", "N", -10, 10, "force"}, 0.1 + 0.05 * k)}};
    recording.release = builder.declare({"release_" + name, "t0", "s", -1, 1, "release"}, 0.0042);
    for (double time : {-0.01, 0.0031, 0.0117, 0.0253, 0.0391}) rows.push_back({k, 0, time});
  }
  std::vector<NamedChannel> channels;
  channels.push_back(
      {"marker", make_marker_channel(builder.mesh(), locate(builder.mesh(), Eigen::Vector2d(0.1, 0.02)),
                                     Eigen::Vector2d(0, 0.006), builder.mesh().select("xmax"), Eigen::Vector2d(0, 1))});
  RecordingProtocol::Options options;
  options.integrator = integrator;
  options.threads = threads;
  options.equilibrium.step_tolerance = 1e-12;
  options.equilibrium.max_iterations = max_iterations;
  options.equilibrium.max_halvings = max_iterations < 40 ? 0 : 10;
  return {builder.build(), std::move(channels), {g, mass, hand}, recordings, rows, options};
}

TEST(RecordingProtocol, DerivativesOfRowsAreThoseOfTheRows) {
  for (Integrator integrator : {Integrator::bdf2, Integrator::implicit_euler}) {
    RecordingProtocol protocol = cantilever(integrator, 1);
    const Params& p = protocol.nominal();
    std::vector<int> free;
    for (const char* id : {"E_bar", "nu_bar", "density_bar", "beta_1", "beta_2", "hand_1", "hand_2", "release_1",
                           "release_2", "beta", "hand"})
      free.push_back(protocol.parameters().index(id));
    const Prediction at = protocol.predict(p, free);
    ASSERT_TRUE(at.complete()) << at.failures.front();
    // What each case has for itself hides the common ones, and leaves the other case alone.
    EXPECT_EQ(at.derivatives.rightCols(2).norm(), 0);
    EXPECT_EQ(at.derivatives.col(3).tail(5).norm(), 0);
    EXPECT_EQ(at.derivatives.col(8).head(5).norm(), 0);
    EXPECT_GT(at.derivatives.col(3).head(5).norm(), 0);
    for (size_t j = 0; j + 2 < free.size(); ++j) {
      const double size = protocol.parameters()[free[j]].id.starts_with("release") ? 4e-4 : 0.05 * p[free[j]];
      expect_taylor_order(
          [&](double h) {
            Params q = p;
            q[free[j]] += h * size;
            const Prediction there = protocol.predict(q, {});
            return (there.values - at.values - h * size * at.derivatives.col(static_cast<Eigen::Index>(j))).norm();
          },
          2, 1e-12, 1.0, 6, protocol.parameters()[free[j]].id);
    }
  }
}

TEST(RecordingProtocol, AStepFromRestThatFailsIsHalved) {
  // Under a load that bends the bar by a sixth of its length at once: three iterations are too few for a step of 1 ms.
  const auto falling = [](double step, int max_iterations) {
    SceneBuilder builder(rectangle(graded(0.1, 4), graded(0.01, 1), 2, "bar"), Plane::strain, 0.02);
    builder.add_solid("bar", "neo_hookean", {{"E", 2e5}, {"nu", 0.3}});
    builder.add_inertia("bar", 1000);
    builder.fix("xmin", {0, 1});
    const int pull = builder.declare({"pull", "F", "N", -10, 10, "force"}, 0);
    builder.add_force("xmax", Eigen::Vector2d(0, -1), pull);
    const int release = builder.declare({"release", "t0", "s", -1, 1, "release"}, 0);
    std::vector<NamedChannel> channels;
    channels.push_back({"tip", make_linear_channel(mean_weights(builder.mesh(), builder.mesh().select("xmax"),
                                                                Eigen::Vector2d(0, -1)))});
    RecordingProtocol::Options options;
    options.integrator = Integrator::implicit_euler;
    options.step = step;
    options.equilibrium.max_iterations = max_iterations;
    options.equilibrium.max_halvings = 0;
    return RecordingProtocol(builder.build(), std::move(channels), {pull}, {{"fall", {{pull, 1.0}}, {}, {}, release}},
                             {{0, 0, 0.004}, {0, 0, 0.008}}, options);
  };
  const auto predict = [](RecordingProtocol protocol) { return protocol.predict(protocol.nominal(), {}); };
  const Prediction exact = predict(falling(5e-5, 40)), whole = predict(falling(1e-3, 40));
  const Prediction halved = predict(falling(1e-3, 3));
  ASSERT_TRUE(halved.complete()) << halved.failures.front();
  for (int i : {0, 1}) {  // shorter steps come nearer
    EXPECT_GT(whole.values[i], 1.03 * exact.values[i]);
    EXPECT_LT(std::abs(halved.values[i] - exact.values[i]), 0.6 * std::abs(whole.values[i] - exact.values[i]));
  }
}

TEST(RecordingProtocol, TheNumberOfThreadsDoesNotChangeABit) {
  RecordingProtocol one = cantilever(Integrator::bdf2, 1), two = cantilever(Integrator::bdf2, 2);
  const std::vector<int> free = {one.parameters().index("E_bar"), one.parameters().index("hand_2")};
  const Prediction a = one.predict(one.nominal(), free), b = two.predict(two.nominal(), free);
  EXPECT_EQ(a.values, b.values);
  EXPECT_EQ(a.derivatives, b.derivatives);
}

TEST(RecordingProtocol, ATrajectoryThatFailsLeavesNaNAndASentence) {
  RecordingProtocol protocol = cantilever(Integrator::bdf2, 1, 1);
  const Prediction prediction = protocol.predict(protocol.nominal(), {protocol.parameters().index("E_bar")});
  ASSERT_EQ(prediction.failures.size(), 2u);
  EXPECT_TRUE(prediction.values.array().isNaN().all());
  EXPECT_TRUE(prediction.derivatives.array().isNaN().all());
  EXPECT_NE(prediction.failures[0].find("case 1"), std::string::npos) << prediction.failures[0];
  EXPECT_NE(prediction.failures[0].find("E_bar = 200 kPa"), std::string::npos) << prediction.failures[0];
}

}  // namespace
}  // namespace taut

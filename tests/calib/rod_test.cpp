#include "calib/models/rod.hpp"

#include <cmath>
#include <map>
#include <numbers>
#include <random>

#include "calib/files/experiment.hpp"
#include "calib/models/rod_model.hpp"
#include "sim/scene/channel_kinds.hpp"
#include "sim/shapes/grid.hpp"
#include "sim/shapes/outlines.hpp"
#include "tests/support/message.hpp"
#include "tests/support/taylor.hpp"

namespace taut::test {
namespace {

constexpr double rod_pi = std::numbers::pi;

std::function<CrossSection(double)> rod_circle(double radius) {
  const double A = rod_pi * radius * radius, I = A * radius * radius / 4;
  return [=](double) { return CrossSection{A, I, I, 2 * I}; };
}

std::function<CrossSection(double)> rod_rectangle(double first, double second) {
  const CrossSection section{first * second, first * std::pow(second, 3) / 12, second * std::pow(first, 3) / 12,
                             0.2 * first * second * (first * first + second * second)};
  return [=](double) { return section; };
}

/// E, nu, weight, and then as the rod has them; friction comes last.
Rod::Values rod_values(std::initializer_list<double> values, double friction = 0) {
  Rod::Values all(static_cast<Eigen::Index>(values.size()) + 1);
  std::copy(values.begin(), values.end(), all.begin());
  all[all.size() - 1] = friction;
  return all;
}

RodState equilibrium_of(const Rod& rod, const Rod::Values& values) {
  RodState x;
  int factorisations = 0;
  EXPECT_EQ(rod.solve_from_rest(x, values, factorisations), "");
  return x;
}

Eigen::Vector3d rod_tip(const Rod& rod, const RodState& x) {
  return rod.position(x, {rod.shape().length, Eigen::Vector3d::Zero()}).value;
}

RodForce on_rod_tip(const RodShape& shape, const Eigen::Vector3d& direction,
                    const Eigen::Vector3d& offset = Eigen::Vector3d::Zero()) {
  return {{shape.length, offset}, direction};
}

TEST(Rod, ASmallLoadBendsItAsATimoshenkoBeam) {
  for (SectionLaw law : {SectionLaw::linear, SectionLaw::neo_hookean}) {
    for (bool round : {true, false}) {
      RodShape shape;
      shape.length = 0.1;
      shape.round = round;
      shape.section = round ? rod_circle(0.01) : rod_rectangle(0.012, 0.02);
      shape.shear_factor = round ? 0.9 : 5.0 / 6;
      shape.law = law;
      for (int axis = 0; axis < 2; ++axis) {
        shape.forces = {on_rod_tip(shape, Eigen::Vector3d::Unit(axis))};
        const Rod rod(shape);
        const double E = 1e5, nu = 0.3, G = E / (2 * (1 + nu)), F = 1e-6, L = shape.length;
        const auto [A, first, second, torsion] = shape.section(0);
        const double I = axis == 0 ? second : first;
        const double expected = F * L * L * L / (3 * E * I) + F * L / (shape.shear_factor * G * A);
        EXPECT_NEAR(rod_tip(rod, equilibrium_of(rod, rod_values({E, nu, 0, F})))[axis] / expected, 1, 1e-4)
            << round << axis;
      }
    }
  }
}

TEST(Rod, ARingShearsAsCowperHasIt) {
  const double R = 0.01, r = 0.008, A = rod_pi * (R * R - r * r), I = rod_pi / 4 * (std::pow(R, 4) - std::pow(r, 4));
  RodShape shape;
  shape.length = 0.05;
  shape.section = [=](double) { return CrossSection{A, I, I, 2 * I}; };
  shape.forces = {on_rod_tip(shape, {1, 0, 0})};
  const Rod rod(shape);
  // Cowper 1966, table 1, a hollow circle at nu = 1/2.
  const double m2 = r * r / (R * R), nu = 0.5;
  const double kappa = 6 * (1 + nu) * std::pow(1 + m2, 2) / ((7 + 6 * nu) * std::pow(1 + m2, 2) + (20 + 12 * nu) * m2);
  const double E = 1e6, F = 1e-6, L = shape.length, G = E / 3;
  EXPECT_NEAR(rod_tip(rod, equilibrium_of(rod, rod_values({E, nu, 0, F})))[0] /
                  (F * L * L * L / (3 * E * I) + F * L / (kappa * G * A)),
              1, 1e-4);
}

TEST(Rod, AnEndLoadBendsItAsMattiassonsElastica) {
  // K. Mattiasson, Int. J. Numer. Methods Engrg. 17 (1981) 145-153, table I: P L^2/(E I), w/L, u/L.
  struct Row {
    double load, across, along;
  };
  RodShape shape;
  shape.length = 1;
  shape.section = rod_circle(1e-3);
  shape.forces = {on_rod_tip(shape, {1, 0, 0})};
  const Rod rod(shape);
  const double E = 1e9, EI = E * shape.section(0).first;
  for (const Row& row :
       {Row{1, 0.30172, 0.05643}, {2, 0.49346, 0.16064}, {5, 0.71379, 0.38763}, {10, 0.81061, 0.55500}}) {
    const Eigen::Vector3d end = rod_tip(rod, equilibrium_of(rod, rod_values({E, 0.3, 0, row.load * EI})));
    EXPECT_NEAR(end[0], row.across, 2e-4) << row.load;
    EXPECT_NEAR(1 - end[2], row.along, 2e-4) << row.load;
    EXPECT_NEAR(end[1], 0, 1e-9);
  }
}

/// A round rod, and a tendon at a distance from its axis all along it.
RodShape rod_with_tendon(double length, double distance, int elements = 72) {
  RodShape shape;
  shape.length = length;
  shape.section = rod_circle(8e-3);
  shape.tendons = {{0, length, [=](double) { return Eigen::Vector2d(0.6 * distance, 0.8 * distance); }}};
  for (int i = 0; i <= elements; ++i) shape.nodes.push_back(length * i / elements);
  return shape;
}

TEST(Rod, ATendonBesideTheAxisMakesAnArcOfACircle) {
  const double L = 0.2, d = 5e-3, E = 1e6;
  const Rod rod(rod_with_tendon(L, d, 200));
  const auto [A, I, second, torsion] = rod.shape().section(0);
  for (double T : {1.0, 5.0, 15.0}) {
    // N = -T and M = T d all along: E A (v - 1) = -T, E I k = T d, a circle of radius v/k.
    const double v = 1 - T / (E * A), k = T * d / (E * I);
    const RodState x = equilibrium_of(rod, rod_values({E, 0.3, 0, T}));
    const Eigen::Vector3d end = rod_tip(rod, x);
    EXPECT_NEAR(end[2], v / k * std::sin(k * L), 1e-4 * L) << T;
    EXPECT_NEAR(end[0], 0.6 * v / k * (1 - std::cos(k * L)), 1e-4 * L) << T;
    EXPECT_NEAR(end[1], 0.8 * v / k * (1 - std::cos(k * L)), 1e-4 * L) << T;
    EXPECT_NEAR((rod.end_rotation(x).trace() - 1) / 2, std::cos(k * L), 1e-9) << T;
  }
  EXPECT_GT(15.0 * d * L / (E * I), rod_pi / 2) << "it curls beyond a right angle";
}

double rod_end_turn(const Rod& rod, const RodState& x) {
  return std::acos((rod.end_rotation(x).trace() - 1) / 2);
}

TEST(Rod, FrictionLeavesTheTensionOfACapstanAlongAnArc) {
  const double L = 0.2, d = 5e-3, E = 1e6, mu = 0.2, theta = rod_pi / 3;
  const Rod rod(rod_with_tendon(L, d));
  const double T = theta / L * E * rod.shape().section(0).first / d;
  const RodState x = equilibrium_of(rod, rod_values({E, 0.3, 0, T}));
  EXPECT_NEAR(rod_end_turn(rod, x), theta, 1e-9);
  EXPECT_EQ(x.left.size(), 0);
  const Eigen::VectorXd left = rod.tension_left(x, mu);
  ASSERT_EQ(left.size(), 72);
  // In the middles of elements; the last of them is half an element before the end.
  EXPECT_NEAR(left[71] * std::sqrt(left[71] / left[70]), std::exp(-mu * theta), 1e-9);
  EXPECT_NEAR(left[71] * std::sqrt(left[71] / left[70]), 0.81104, 5e-6);
  EXPECT_NEAR(left.mean(), 0.90222, 5e-6);
  EXPECT_LT((rod.tension_left(x, 0).array() - 1).abs().maxCoeff(), 1e-15);
}

TEST(Rod, WithFrictionATendonBendsItLessAndLess) {
  // E I theta' = T_0 d exp(-mu theta), so theta = ln(1 + mu T_0 d s/(E I))/mu, however it shortens.
  const double L = 0.2, d = 5e-3, E = 1e6;
  for (double mu : {0.2, 1.0}) {
    for (double T : {1.0, 5.0, 8.0}) {
      double error[2];
      for (int fine = 0; fine < 2; ++fine) {
        const Rod rod(rod_with_tendon(L, d, fine == 0 ? 72 : 144));
        const double reach = T * d * L / (E * rod.shape().section(0).first), theta = std::log(1 + mu * reach) / mu;
        const RodState x = equilibrium_of(rod, rod_values({E, 0.3, 0, T}, mu));
        error[fine] = std::abs(rod_end_turn(rod, x) / theta - 1);
        EXPECT_LT(error[fine], 2e-4) << mu << " " << T;
        EXPECT_LT((x.left - rod.tension_left(x, mu)).cwiseAbs().maxCoeff(), 1e-11);
        EXPECT_GT(reach - theta, 0.004);
      }
      EXPECT_NEAR(error[0] / error[1], 4, 0.3) << mu << " " << T << ": of second order";
    }
  }
}

TEST(Rod, FrictionThatRemovesNearlyAllTensionIsFoundToo) {
  const double L = 0.2, d = 5e-3, E = 1e6, T = 40, mu = 2;
  const Rod rod(rod_with_tendon(L, d));
  const double reach = T * d * L / (E * rod.shape().section(0).first);
  EXPECT_GT(reach, 12);  // two turns without friction
  EXPECT_NEAR(rod_end_turn(rod, equilibrium_of(rod, rod_values({E, 0.3, 0, T}, mu))), std::log(1 + mu * reach) / mu,
              0.01);
}

TEST(Rod, ATendonThatEndsOnTheWayBendsNoFurther) {
  const double L = 0.2, end = 0.1237, d = 4e-3, E = 1e6, T = 3;
  RodShape shape;
  shape.length = L;
  shape.section = rod_circle(8e-3);
  shape.tendons = {{0, end, [=](double) { return Eigen::Vector2d(d, 0); }}};
  const Rod rod(shape);
  const auto [A, I, second, torsion] = shape.section(0);
  const double v = 1 - T / (E * A), k = T * d / (E * I), angle = k * end;
  const Eigen::Vector3d at = rod_tip(rod, equilibrium_of(rod, rod_values({E, 0.3, 0, T})));
  EXPECT_NEAR(at[2], v / k * std::sin(angle) + (L - end) * std::cos(angle), 1e-4 * L);
  EXPECT_NEAR(at[0], v / k * (1 - std::cos(angle)) + (L - end) * std::sin(angle), 1e-4 * L);
}

TEST(Rod, ItsOwnWeightStretchesABarThatHangs) {
  RodShape shape;
  shape.length = 0.5;
  shape.section = rod_circle(0.01);
  shape.down = {0, 0, 1};
  const double E = 1e6, weight = 1e4;
  const Rod rod(shape);
  EXPECT_NEAR(rod_tip(rod, equilibrium_of(rod, rod_values({E, 0.3, weight})))[2] - 0.5, weight * 0.25 / (2 * E),
              1e-6 * 0.5);
  // A cone, whose point hangs down: a third of what a bar of its base weighs.
  shape.section = [](double s) { return rod_circle(0.01 * (1 - s / 0.5) + 1e-6)(0); };
  const Rod cone(shape);
  EXPECT_NEAR(rod_tip(cone, equilibrium_of(cone, rod_values({E, 0.3, weight})))[2] - 0.5, weight * 0.25 / (6 * E),
              1e-3 * weight * 0.25 / (6 * E));
}

TEST(Rod, ItsOwnWeightBendsItAsABeam) {
  RodShape shape;
  shape.length = 0.2;
  shape.section = rod_circle(0.005);
  shape.down = {0, 1, 0};
  const double E = 1e6, nu = 0.3, weight = 1, L = shape.length;
  const auto [A, I, second, torsion] = shape.section(0);
  const double expected =
      weight * A * std::pow(L, 4) / (8 * E * I) + weight * A * L * L / (2 * 0.9 * E / (2 * (1 + nu)) * A);
  const Rod rod(shape);
  EXPECT_NEAR(rod_tip(rod, equilibrium_of(rod, rod_values({E, nu, weight})))[1] / expected, 1, 2e-4);
}

TEST(Rod, ACoupleTwistsItByMomentTimesLengthOverStiffness) {
  RodShape shape;
  shape.length = 0.1;
  shape.section = rod_circle(0.005);
  shape.forces = {on_rod_tip(shape, {0, 1, 0}, {0.01, 0, 0}), on_rod_tip(shape, {0, -1, 0}, {-0.01, 0, 0})};
  const double E = 1e6, nu = 0.25, G = E / (2 * (1 + nu)), J = shape.section(0).torsion;
  const Rod rod(shape);
  const double F = 2e-2, expected = 2 * F * 0.01 * shape.length / (G * J);
  const RodState x = equilibrium_of(rod, rod_values({E, nu, 0, F, F}));
  // Dead forces turn less as their arms turn: M cos(angle).
  const Eigen::Matrix3d R = rod.end_rotation(x);
  const double angle = std::atan2(R(1, 0), R(0, 0));
  EXPECT_NEAR(angle, expected * std::cos(angle), 1e-6 * expected);
  EXPECT_GT(angle, 0.05);
}

TEST(Rod, PulledAndPressedANeoHookeanOneStretchesAsABarDoes) {
  RodShape shape;
  shape.length = 0.01;  // pressed, a long one would buckle
  shape.law = SectionLaw::neo_hookean;
  for (bool round : {true, false}) {
    shape.round = round;
    shape.section = round ? rod_circle(0.01) : rod_rectangle(0.01, 0.02);
    shape.forces = {on_rod_tip(shape, {0, 0, 1})};
    const Rod rod(shape);
    for (double stretch : {0.95, 1.2, 1.6}) {
      // nu = 0: no lateral motion is asked for, mu (l - 1/l) per area.
      const double force = shape.section(0).area * 1e5 / 2 * (stretch - 1 / stretch);
      EXPECT_NEAR(rod_tip(rod, equilibrium_of(rod, rod_values({1e5, 0, 0, force})))[2], 0.01 * stretch, 1e-10);
    }
  }
}

/// By a rule of many points: the moment of a neo-Hookean section with nu = 0 at mean stretch v and curvature k.
TEST(Rod, ANeoHookeanSectionBendsByTheIntegralOfItsFibres) {
  const double R = 0.01, r = 0.006, d = 4e-3, L = 0.05, E = 1e5;
  for (const bool hollow : {false, true}) {
    RodShape shape;
    shape.length = L;
    shape.law = SectionLaw::neo_hookean;
    const double inner = hollow ? r : 0, A = rod_pi * (R * R - inner * inner),
                 I = rod_pi / 4 * (std::pow(R, 4) - std::pow(inner, 4));
    shape.section = [=](double) { return CrossSection{A, I, I, 2 * I}; };
    shape.tendons = {{0, L, [=](double) { return Eigen::Vector2d(d, 0); }}};
    const Rod rod(shape);
    const double T = 3;
    // The circle's radius of the tip gives v and k; then N = -T and M = T d must hold.
    const RodState x = equilibrium_of(rod, rod_values({E, 0, 0, T}));
    const double angle = std::acos((rod.end_rotation(x).trace() - 1) / 2), k = angle / L;
    const double v = (x.r[1] - x.r[0]).norm() / (L / rod.elements());
    double N = 0, M = 0;
    const int rings = 400, rays = 400;
    for (int i = 0; i < rings; ++i) {
      const double rho = inner + (R - inner) * (i + 0.5) / rings;
      for (int j = 0; j < rays; ++j) {
        const double y = rho * std::cos(2 * rod_pi * (j + 0.5) / rays), stretch = v - k * y;
        const double force = rho * (R - inner) / rings * 2 * rod_pi / rays * E / 2 * (stretch - 1 / stretch);
        N += force;
        M -= force * y;
      }
    }
    EXPECT_NEAR(N, -T, 2e-4 * T) << hollow;
    EXPECT_NEAR(M, T * d, 2e-4 * T * d) << hollow;
    EXPECT_GT(k * R, 0.1);
  }
}

/// A rod with everything: a twisted tendon, a tapered section, weight and a load beside its axis.
RodShape rod_with_everything(SectionLaw law, bool round) {
  RodShape shape;
  shape.length = 0.3;
  for (int i = 0; i <= 12; ++i) shape.nodes.push_back(0.3 * i / 12);
  shape.law = law;
  shape.round = round;
  shape.section = [=](double s) {
    return round ? rod_circle(0.012 - 0.02 * s)(0) : rod_rectangle(0.02 - 0.03 * s, 0.016 - 0.02 * s)(0);
  };
  shape.down = Eigen::Vector3d(0.3, -0.2, 0.9).normalized();
  shape.tendons = {{0, 0.28, [](double s) { return Eigen::Vector2d(6e-3 * std::cos(4 * s), 6e-3 * std::sin(4 * s)); }},
                   {0.05, 0.21, [](double s) { return Eigen::Vector2d(-5e-3 + 0.01 * s, 2e-3); }}};
  shape.forces = {{{0.19, {4e-3, 3e-3, 0}}, Eigen::Vector3d(1, 2, -1).normalized()}};
  return shape;
}

TEST(Rod, GradientsAndSensitivitiesAreThoseOfTheEnergyAndTheState) {
  for (SectionLaw law : {SectionLaw::linear, SectionLaw::neo_hookean}) {
    for (const auto& [round, friction] : {std::pair{true, 0.0}, {true, 0.3}, {false, 0.0}, {false, 0.3}}) {
      SCOPED_TRACE(friction);
      const Rod rod(rod_with_everything(law, round));
      const Rod::Values values = rod_values({3e5, 0.4, 9e3, 2.5, 1.5, 0.08}, friction);
      const RodState x = equilibrium_of(rod, values);
      EXPECT_LT(rod.gradient(x, values).cwiseAbs().maxCoeff(), 1e-9);
      const std::optional<Eigen::MatrixXd> dx = rod.solve_linear(x, values, -rod.gradient_by_values(x, values, true));
      ASSERT_TRUE(dx);
      const RodPoint marker{0.271, {0.01, -0.004, 0.002}};
      const RodReading at = rod.position(x, marker);
      const Eigen::MatrixXd slopes = at.change(*dx);
      for (Eigen::Index k = 0; k < values.size(); ++k) {
        expect_taylor_order(
            [&](double h) {
              Rod::Values moved = values;
              moved[k] += h;
              return (rod.position(equilibrium_of(rod, moved), marker).value - at.value - h * slopes.col(k)).norm();
            },
            // Without friction by its derivative from the right: there is none below.
            2, 1e-11, k == rod.friction() ? 0.05 : 0.1 * values[k], 6, std::to_string(k));
        EXPECT_GT(slopes.col(k).norm() * (k == rod.friction() ? 0.1 : values[k]), 1e-6) << k;
      }
      if (friction > 0) continue;
      // The gradient in between, by the energy, which is stationary in the state.
      double stored[2];
      for (int side = 0; side < 2; ++side) {
        Rod::Values moved = values;
        moved[Rod::first_tension] += side == 0 ? -1e-4 : 1e-4;
        stored[side] = rod.energy(equilibrium_of(rod, moved), moved);
      }
      const auto length = [&](double T) {
        Rod::Values pulled = values;
        pulled[Rod::first_tension] = T;
        return rod.energy(x, pulled);
      };
      EXPECT_NEAR((stored[1] - stored[0]) / 2e-4, length(1) - length(0), 1e-6);
    }
  }
}

TEST(Rod, NewtonsMethodConvergesQuadratically) {
  const Rod rod(rod_with_everything(SectionLaw::neo_hookean, true));
  const Rod::Values values = rod_values({3e5, 0.4, 9e3, 2.5, 1.5, 0.08});
  RodState x = equilibrium_of(rod, values);
  Rod::Values next = values;
  next[Rod::first_tension] *= 1.02;
  int factorisations = 0;
  EXPECT_EQ(rod.solve(x, next, factorisations), "");
  EXPECT_LE(factorisations, 6);
}

TEST(Rod, RodsWithoutLengthOrAreaAreRefused) {
  RodShape shape;
  shape.section = rod_circle(0.01);
  expect_input_error([&] { Rod rod(shape); }, {"positive length"});
  shape.length = 1;
  shape.nodes = {0, 0.5, 0.5, 1};
  expect_input_error([&] { Rod rod(shape); }, {"nodes", "ascend"});
  shape.nodes.clear();
  shape.section = rod_circle(0);
  expect_input_error([&] { Rod rod(shape); }, {"area"});
}

// The measured tentacle, and the predictions of an independent rod for it: see data/tentacle/README.md.

const char* const tentacle_file = TAUT_SOURCE_DIR "/experiments/tentacle/experiment.toml";

struct Tentacle {
  Experiment experiment = read_experiment(tentacle_file);
  Trials trials = read_trials(experiment.bench);
};

/// The independent rod's predictions as readings: its file is the bench's with other columns.
Trials rod_reference(const Experiment& experiment) {
  BenchFormat format = experiment.bench;
  format.path = TAUT_SOURCE_DIR "/data/tentacle/rod_reference.csv";
  format.controls.clear();
  format.ignored = {"setting"};
  for (BenchFormat::Channel& channel : format.channels) channel.column.insert(1, "2");
  return read_trials(format);
}

TEST(RodModel, TheTentacleIsWithinHalfAMillimetreOfAnIndependentRod) {
  Tentacle tentacle;
  tentacle.experiment.rod_section = SectionLaw::linear;
  tentacle.experiment.materials[0].constants["nu"] = 0.499999;
  RodBench bench = make_rod_bench(tentacle.experiment, tentacle.trials);
  RodProtocol& rod = *bench.protocol;
  Params p = rod.nominal();
  p[rod.parameters().index("E_arm")] = 376.66e3;
  p[rod.parameters().index("density_arm")] = 1136.4;
  const Prediction prediction = rod.predict(p, {});
  for (const std::string& failure : prediction.failures) ADD_FAILURE() << failure;
  const Trials expected = rod_reference(tentacle.experiment);
  ASSERT_EQ(expected.readings.size(), 192u);
  ASSERT_EQ(tentacle.trials.readings.size(), 192u);
  double worst = 0, sum = 0;
  for (size_t i = 0; i < expected.readings.size(); ++i) {
    ASSERT_EQ(expected.readings[i].channel, tentacle.trials.readings[i].channel);
    const double value = prediction.values[bench.row_of_reading[i]];
    worst = std::max(worst, std::abs(value - expected.readings[i].value));
    sum += std::pow(value - tentacle.trials.readings[i].value, 2);
  }
  EXPECT_LT(worst, 0.5e-3);
  EXPECT_NEAR(std::sqrt(sum / 64), 12.0e-3, 0.05e-3);
  for (int row = 0; row < rod.row_count(); ++row) {
    EXPECT_GT(rod.stated_error(row), 0.01);
    EXPECT_LT(rod.stated_error(row), 0.6);
  }
}

TEST(RodModel, DerivativesByParametersAndDimensionsAreThoseOfThePrediction) {
  Tentacle tentacle;
  // Between nodes, where a reading is smooth in its place.
  for (ChannelSettings& channel : tentacle.experiment.channels) channel.foot = *channel.foot - 2.3e-3;
  const std::vector<Dimension> dimensions = dimensions_of(tentacle.experiment);
  ASSERT_GT(dimensions.size(), 10u);
  for (const auto& [law, friction] :
       {std::pair{SectionLaw::linear, 0.0}, {SectionLaw::neo_hookean, 0.0}, {SectionLaw::linear, 0.3}}) {
    tentacle.experiment.rod_section = law;
    tentacle.experiment.cables.friction = friction;
    std::erase_if(tentacle.trials.readings, [&](const Reading& reading) {
      return reading.controls != tentacle.trials.readings.front().controls;
    });
    RodBench bench = make_rod_bench(tentacle.experiment, tentacle.trials, dimensions);
    RodProtocol& rod = *bench.protocol;
    const Params p = rod.nominal();
    std::vector<int> free;
    for (const char* id : {"E_arm", "nu_arm", "density_arm", "g", "tension_scale", "cable_friction"})
      free.push_back(rod.parameters().index(id));
    const size_t own = free.size();
    for (const Dimension& dimension : dimensions) free.push_back(rod.parameters().index(dimension.spec.id));
    const Prediction at = rod.predict(p, free);
    for (const std::string& failure : at.failures) FAIL() << failure;
    for (size_t k = 0; k < free.size(); ++k) {
      const ParameterSpec& spec = rod.parameters()[free[k]];
      const Eigen::VectorXd slopes = at.derivatives.col(static_cast<Eigen::Index>(k));
      // Dimensions by differences: what is left of those falls no further.
      const double step = spec.id == "cable_friction" ? 0.04
                          : k < own                   ? 0.04 * p[free[k]]
                          : spec.unit == "rad"        ? 0.04
                                                      : 4e-4;
      const auto remainder = [&](double h) {
        Params moved = p;
        moved[free[k]] += h;
        return (rod.predict(moved, {}).values - at.values - h * slopes).norm();
      };
      if (remainder(step) < 1e-8) continue;  // readings are linear in it
      expect_taylor_order(remainder, 2, 3e-10, step, 5, spec.id);
    }
  }
}

TEST(RodModel, FrictionIsFoundWhereTensionsTakenFromTheStateBeforeWouldNotSettle) {
  // Less tension lets the tip hang, a straighter tendon has more of it: each repetition overshoots by as much.
  Tentacle tentacle;
  tentacle.experiment.cables.friction = 0.2;
  tentacle.experiment.materials[0].constants["E"] = 262e3;
  tentacle.experiment.materials[0].density = 1331;
  std::erase_if(tentacle.trials.readings, [](const Reading& reading) {
    return reading.controls[1] != 0 || std::abs(reading.controls[0] - 7.692) > 1e-3;
  });
  ASSERT_EQ(tentacle.trials.readings.size(), 12u);
  RodBench bench = make_rod_bench(tentacle.experiment, tentacle.trials);
  RodProtocol& rod = *bench.protocol;
  const Params p = rod.nominal();
  const std::vector<int> free{rod.parameters().index("E_arm"), rod.parameters().index("cable_friction")};
  const Prediction at = rod.predict(p, free);
  for (const std::string& failure : at.failures) FAIL() << failure;
  for (size_t k = 0; k < free.size(); ++k) {
    expect_taylor_order(
        [&](double h) {
          Params moved = p;
          moved[free[k]] += h;
          return (rod.predict(moved, {}).values - at.values - h * at.derivatives.col(static_cast<Eigen::Index>(k)))
              .norm();
        },
        2, 1e-9, 0.01 * p[free[k]], 5, std::to_string(k));
  }
}

/// Parameters by their ids, friction from its lower bound.
std::vector<FreeParameter> free_rod(const RodProtocol& rod, const std::vector<std::string>& ids) {
  std::vector<FreeParameter> free;
  for (const std::string& id : ids) {
    const int index = rod.parameters().index(id);
    const ParameterSpec& spec = rod.parameters()[index];
    free.push_back({index, id == "cable_friction" ? 0 : 0.9 * rod.nominal()[index], spec.lower, spec.upper});
  }
  return free;
}

/// What readings of the tentacle that the rod itself makes with this friction, and noise of a millimetre, say of it.
FitResult fit_planted_friction(double friction, const std::vector<std::string>& ids, bool profiles = true) {
  const Tentacle tentacle;
  RodBench bench = make_rod_bench(tentacle.experiment, tentacle.trials);
  RodProtocol& rod = *bench.protocol;
  Params truth = rod.nominal();
  truth[rod.parameters().index("cable_friction")] = friction;
  const Prediction readings = rod.predict(truth, {});
  EXPECT_TRUE(readings.complete());
  std::mt19937 random(5);
  std::normal_distribution<double> noise(0, 1e-3);
  for (Measurement& measurement : bench.measurements) {
    measurement.sigma = 1e-3;
    measurement.value = readings.values[measurement.row] + noise(random);
  }
  FitOptions options;
  options.profiles = profiles;
  return fit(rod, bench.measurements, free_rod(rod, ids), options);
}

TEST(SlowRodModel, APlantedFrictionIsFound) {
  for (const std::vector<std::string>& ids : {std::vector<std::string>{"cable_friction", "density_arm"},
                                              {"cable_friction", "E_arm"},
                                              {"cable_friction", "E_arm", "density_arm"},
                                              {"cable_friction", "E_arm", "tension_scale"}}) {
    SCOPED_TRACE(ids.back());
    const FitResult result = fit_planted_friction(0.2, ids);
    ASSERT_EQ(result.status, FitStatus::converged) << result.message;
    EXPECT_GT(result.chi_squared_p, 0.01);
    const std::map<std::string, double> truths{
        {"cable_friction", 0.2}, {"density_arm", 1500}, {"E_arm", 505e3}, {"tension_scale", 1}};
    for (const ParameterEstimate& estimate : result.parameters) {
      EXPECT_EQ(estimate.verdict, Verdict::well_determined) << estimate.spec.id;
      ASSERT_TRUE(estimate.lower95 && estimate.upper95);
      EXPECT_LT(*estimate.lower95, truths.at(estimate.spec.id)) << estimate.spec.id;
      EXPECT_GT(*estimate.upper95, truths.at(estimate.spec.id)) << estimate.spec.id;
    }
    EXPECT_LT(result.parameters[0].standard_error, 0.015);
  }
}

TEST(SlowRodModel, AFactorOfAllTensionsIsTiedToStiffnessAndWeightAndNotToFriction) {
  const FitResult result =
      fit_planted_friction(0.2, {"cable_friction", "E_arm", "density_arm", "tension_scale"}, false);
  EXPECT_EQ(result.parameters[0].verdict, Verdict::well_determined);
  EXPECT_NEAR(result.parameters[0].value, 0.2, 2 * result.parameters[0].standard_error);
  for (size_t k = 1; k < 4; ++k) EXPECT_EQ(result.parameters[k].verdict, Verdict::tied) << result.parameters[k].spec.id;
}

TEST(SlowRodModel, FrictionThatIsNotThereIsBoundedFromAbove) {
  const FitResult result = fit_planted_friction(0, {"cable_friction", "E_arm", "density_arm"}),
                  without = fit_planted_friction(0, {"E_arm", "density_arm"});
  const ParameterEstimate& friction = result.parameters[0];
  EXPECT_EQ(friction.verdict, Verdict::bounded_from_one_side) << friction.explanation;
  EXPECT_FALSE(friction.lower95);
  ASSERT_TRUE(friction.upper95);
  EXPECT_LT(*friction.upper95, 0.05);
  EXPECT_LT(without.chi_squared - result.chi_squared, 2);  // what Akaike's criterion asks for
}

TEST(SlowRodModel, TheTentacleAsksForNoFriction) {
  const Tentacle tentacle;
  RodBench bench = make_rod_bench(tentacle.experiment, tentacle.trials);
  FitOptions options;
  options.profiles = options.recover = false;
  const auto fitted = [&](const std::vector<std::string>& ids) {
    return fit(*bench.protocol, bench.measurements, free_rod(*bench.protocol, ids), options);
  };
  const FitResult with = fitted({"cable_friction", "E_arm", "density_arm"}), without = fitted({"E_arm", "density_arm"});
  EXPECT_EQ(with.status, FitStatus::converged) << with.message;
  EXPECT_NEAR(without.chi_squared, 451.5, 0.5);
  EXPECT_LT(without.chi_squared - with.chi_squared, 2);
  EXPECT_LT(with.parameters[0].value, with.parameters[0].standard_error);
}

TEST(RodModel, ATurnedAndShiftedBaseMovesEverythingWithIt) {
  Tentacle tentacle;
  // About the vertical, weight does the same.
  tentacle.experiment.base_turn = {0, 0, 0.3};
  tentacle.experiment.base_at = {0.01, -0.02, 0.03};
  const RodBench turned = make_rod_bench(tentacle.experiment, tentacle.trials);
  tentacle.experiment.base_turn.clear();
  tentacle.experiment.base_at.clear();
  const RodBench straight = make_rod_bench(tentacle.experiment, tentacle.trials);
  const Eigen::VectorXd one = straight.protocol->predict(straight.protocol->nominal(), {}).values,
                        other = turned.protocol->predict(turned.protocol->nominal(), {}).values;
  const auto& channels = tentacle.experiment.channels;
  ASSERT_EQ(channels[0].direction, (std::vector<double>{1, 0, 0}));
  std::map<std::pair<std::vector<double>, std::string>, std::array<Eigen::Vector3d, 2>> places;
  for (size_t i = 0; i < tentacle.trials.readings.size(); ++i) {
    const Reading& reading = tentacle.trials.readings[i];
    const ChannelSettings& channel = channels[static_cast<size_t>(reading.channel)];
    for (int c = 0; c < 3; ++c) {
      if (channel.direction[static_cast<size_t>(c)] != 1) continue;
      auto& place = places[{reading.controls, channel.marker}];
      place[0][c] = one[straight.row_of_reading[i]];
      place[1][c] = other[turned.row_of_reading[i]];
    }
  }
  ASSERT_EQ(places.size(), 64u);
  const Eigen::Matrix3d R{{std::cos(0.3), -std::sin(0.3), 0}, {std::sin(0.3), std::cos(0.3), 0}, {0, 0, 1}};
  for (const auto& [key, place] : places)
    EXPECT_LT((place[1] - R * place[0] - Eigen::Vector3d(0.01, -0.02, 0.03)).norm(), 1e-8);
}

/// A bar of 120 x 12 x 10 mm that stands out of a wall, a mass at its end beside the axis, its own weight downwards.
Experiment rod_bar() {
  Experiment e = read_experiment(tentacle_file);
  auto box = std::make_shared<Box>();
  box->size = {0.12, 0.012, 0.01};
  box->region = "arm";
  e.geometry.shape = box;
  e.mesh = {};
  e.mesh.cells = {24, 3, 3};
  e.mesh.formulation = Formulation::locking_free;
  e.cables = {};
  e.supports[0].on = "xmin";
  e.loads.push_back({"mass", "", {0.12, 0.012, 0.005}, {0, 0, -1}, Quantity::mass, "mass", 0, "mass_g"});
  e.bench.controls = {{"mass", "mass_g", {Quantity::mass}}};
  e.channels.clear();
  e.bench.channels.clear();
  e.free.clear();
  const auto add = [&](const std::string& id, std::string_view kind, const std::vector<double>& direction,
                       const std::vector<double>& point) {
    ChannelSettings channel;
    channel.id = id;
    channel.kind = &*std::ranges::find(channel_kinds(), kind, &ChannelKind::name);
    channel.on = point.empty() ? "xmax" : "";
    channel.point = point;
    channel.direction = direction;
    e.channels.push_back(channel);
  };
  add("drop", "displacement", {0, 0, -1}, {});
  add("back", "displacement", {-1, 0, 0}, {});
  add("corner", "position", {0, 0, 1}, {0.12, 0.012, 0.01});
  add("halfway", "displacement", {0, 0, -1}, {0.06, 0.006, 0.005});
  add("turn", "rotation", {0, 1, 0}, {});
  add("twist", "rotation", {1, 0, 0}, {});
  return e;
}

Trials rod_masses(const Experiment& experiment, const std::vector<double>& kilograms) {
  Trials trials;
  trials.control_ids = {"mass"};
  trials.control_quantities = {Quantity::mass};
  trials.control_values = {{kilograms.begin(), kilograms.end()}};
  for (const ChannelSettings& channel : experiment.channels) trials.channel_ids.push_back(channel.id);
  for (double mass : kilograms) {
    for (size_t channel = 0; channel < experiment.channels.size(); ++channel) {
      Reading reading;
      reading.controls = {mass};
      reading.channel = static_cast<int>(channel);
      reading.sigma = 1;
      trials.readings.push_back(reading);
    }
  }
  return trials;
}

TEST(SlowRodModel, ABarWithAMassBesideItsAxisIsWithinTheStatedErrorOfSolidElements) {
  for (bool from_unloaded : {false, true}) {
    Experiment e = rod_bar();
    e.from_unloaded = from_unloaded;
    e.rod_section = SectionLaw::neo_hookean;
    const Trials trials = rod_masses(e, {0.01});
    const RodBench bench = make_rod_bench(e, trials);
    const StaticReplay full = make_static_replay(e, e.mesh, trials);
    EXPECT_EQ(bench.protocol->parameters().ids(), full.protocol->parameters().ids());
    const Prediction rod = bench.protocol->predict(bench.protocol->nominal(), {}),
                     solid = full.protocol->predict(full.protocol->nominal(), {});
    ASSERT_TRUE(rod.complete() && solid.complete());
    for (Eigen::Index row = 0; row < rod.values.size(); ++row) {
      const std::string& channel = e.channels[static_cast<size_t>(bench.rows[static_cast<size_t>(row)].channel)].id;
      const double stated = bench.protocol->stated_error(static_cast<int>(row)), value = solid.values[row];
      EXPECT_LT(stated, 0.2);
      const double moved = channel == "corner" && !from_unloaded ? value - 0.01 : value;
      EXPECT_NEAR(rod.values[row], value, std::max(stated * std::abs(moved), 1e-5)) << channel;
    }
  }
}

TEST(RodModel, ItSaysWhatARodTakes) {
  Tentacle tentacle;
  const auto refused = [&](const std::function<void(Experiment&)>& change, const std::vector<std::string>& parts) {
    Experiment changed = tentacle.experiment;
    change(changed);
    expect_input_error([&] { make_rod_bench(changed, tentacle.trials); }, parts);
  };
  refused([](Experiment& e) { e.supports[0].fix = {0, 1}; }, {"[[support]]", "'base'", "fix"});
  refused([](Experiment& e) { e.supports[0].on = "tip"; }, {"[[support]]", "'base'"});
  refused([](Experiment& e) { e.contact.on = true; }, {"[contact]", "touches nothing"});
  refused([](Experiment& e) { e.cables.cables[0].held = false; }, {"cable 'tendon_1'", "held"});
  refused([](Experiment& e) { e.cables.cables[0].line.reset(); }, {"cable 'tendon_1'", "axis"});
  refused(
      [](Experiment& e) {
        e.rod_section = SectionLaw::neo_hookean;
        e.materials[0].law = "ogden";
      },
      {"[materials.arm]", "neo_hookean", "rod_section"});
  refused([](Experiment& e) { e.materials.push_back(e.materials[0]); }, {"[materials]", "one material"});
  refused(
      [](Experiment& e) {
        e.channels[0].foot.reset();
        e.channels[0].point = {0, 0, -0.1};
      },
      {"[[channel]]", "[[marker]]"});
  refused(
      [](Experiment& e) {
        auto box = std::make_shared<Boxes>();
        e.geometry.shape = box;
      },
      {"[geometry]", "revolved", "'boxes'"});
  refused(
      [](Experiment& e) {
        e.loads.push_back({"push", "side", {}, {1, 0, 0}, Quantity::force, "", 1, ""});
      },
      {"[[load]] 'push'", "'tip'"});
}

}  // namespace
}  // namespace taut::test

#include "sim/terms/cable_friction.hpp"

#include "tests/support/term_battery.hpp"

namespace taut {
namespace {

using namespace test;

enum { of_k, of_slack, of_retraction, of_friction, of_misalignment, first_state };
constexpr double spring = 700;

/// A rubbing cable with the values of its parameters.
struct Rubbing {
  Mesh mesh;
  Cable cable;
  Params p;
  Eigen::VectorXd u;

  Rubbing(Mesh body, std::vector<CablePoint> points, double mu) : mesh(std::move(body)) {
    cable.points = std::move(points);
    cable.stiffness = of_k;
    cable.slack = of_slack;
    cable.retraction = of_retraction;
    cable.friction = of_friction;
    cable.misalignment = of_misalignment;
    for (int i = 0; i < eyelets(); ++i) cable.eyelets.push_back({first_state + 2 * i, first_state + 2 * i + 1});
    p = Params::Zero(first_state + 2 * eyelets());
    p[of_k] = spring;
    p[of_friction] = mu;
    u = Eigen::VectorXd::Zero(mesh.X.size());
  }

  int eyelets() const { return static_cast<int>(cable.points.size()) - 2; }
  double& bound(int i) { return p[first_state + 2 * i]; }
  double& slip(int i) { return p[first_state + 2 * i + 1]; }
  ParameterTable table() const {
    ParameterTable table;
    for (int index = 0; index < p.size(); ++index)
      table.declare({"p" + std::to_string(index), "p", "1", -1e9, 1e9, "a number", false});
    return table;
  }
  TermUnderTest term(const std::string& name) const {
    return term_under_test(mesh, table(), make_cable(mesh, cable), p, u, name);
  }
  double tension(Eigen::Index segment) const { return make_segment_tension(mesh, cable, segment)->value({u, p}); }
  double slipped(int i) const { return make_eyelet_slip(mesh, cable, i)->value({u, p}); }
  double bearable(int i) const { return make_eyelet_bound(mesh, cable, i)->value({u, p}); }

  /// Bounds of their own state, at fixed displacements.
  void settle() {
    for (int round = 0; round < 300; ++round) {
      const Params now = p;
      Params next = p;
      for (int i = 0; i < eyelets(); ++i) next[first_state + 2 * i] = bearable(i);
      p = next;
      if (next == now) return;
    }
  }
  /// Takes this state as that of the past.
  void remember() {
    Params next = p;
    for (int i = 0; i < eyelets(); ++i) next[first_state + 2 * i + 1] = slipped(i);
    p = next;
  }
  void retract(double to) {
    p[of_retraction] = to;
    settle();
  }
};

CablePoint at_place(std::vector<double> place) {
  return {{}, Eigen::Map<Eigen::VectorXd>(place.data(), static_cast<Eigen::Index>(place.size()))};
}

/// From a fixed point around fixed pins to the first node of a body, which does not move.
Rubbing around_pins(const std::vector<std::vector<double>>& places, double mu) {
  std::vector<CablePoint> points;
  for (const std::vector<double>& place : places) points.push_back(at_place(place));
  points.push_back({{{0}, {1.0}}, {}});
  return {rectangle({0, 1}, {0, 1}, 1, "body"), points, mu};
}

/// Two segments of a metre, square to each other.
Rubbing around_one_pin(double mu) {
  return around_pins({{-1, 1}, {0, 1}}, mu);
}

// T_(i-1)/T_i = exp(mu beta) exactly (Euler, Eytelwein).
TEST(CableFriction, TheRatioOfTensionsIsTheCapstansInBothDirections) {
  for (const double mu : {0.05, 0.2, 0.4, 1.5}) {
    Rubbing rubbing = around_one_pin(mu);
    const double ratio = std::exp(mu * M_PI / 2);
    rubbing.retract(0.02);
    EXPECT_NEAR(rubbing.tension(0) / rubbing.tension(1), ratio, 1e-12 * ratio);
    rubbing.remember();
    rubbing.retract(0.2 * 0.02 / ratio);
    EXPECT_NEAR(rubbing.tension(1) / rubbing.tension(0), ratio, 1e-12 * ratio);
    EXPECT_GT(rubbing.tension(0), 0);
  }
}

TEST(CableFriction, AMisalignmentTurnsACableThatRunsStraight) {
  Rubbing rubbing = around_pins({{-2, 0}, {-1, 0}}, 0.3);
  rubbing.retract(0.01);
  EXPECT_EQ(rubbing.tension(0), rubbing.tension(1));
  rubbing.p[of_misalignment] = 0.1;
  rubbing.settle();
  EXPECT_NEAR(rubbing.tension(0) / rubbing.tension(1), std::exp(0.03), 1e-12);
}

// |T' - T| <= tanh(mu beta/2) (T + T') and exp(-mu beta) <= T'/T <= exp(mu beta) are the same.
TEST(CableFriction, TheBoundIsThatOfTheRatioExactly) {
  Rubbing rubbing = around_one_pin(0.3);
  rubbing.retract(0.01);
  const double lower = rubbing.tension(1), upper = rubbing.tension(0);
  EXPECT_NEAR(upper - lower, std::tanh(0.3 * M_PI / 4) * (upper + lower), 1e-13 * upper);
  EXPECT_NEAR(rubbing.bearable(0), upper - lower, 1e-13 * upper);
}

// Along an arc of 60 degrees with mu = 0.2 the tension at the end is exp(-mu theta) = 0.81104 of the one at its
// beginning, the mean (1 - exp(-mu theta))/(mu theta) = 0.90222.
TEST(CableFriction, AlongAnArcOf60DegreesTheTensionFallsAsAroundACapstan) {
  constexpr int pins = 80;
  const double theta = M_PI / 3, step = theta / pins, mu = 0.2;
  std::vector<std::vector<double>> places;
  // Straight into the arc and out of it, which turns by `step` at each pin; it ends at the origin.
  Eigen::Vector2d at(0, 0);
  std::vector<Eigen::Vector2d> back{{0, 0}};
  double heading = 0;
  for (int i = 0; i <= pins; ++i) {
    at -= (i == 0 || i == pins ? 1.0 : 0.01) * Eigen::Vector2d(std::cos(heading), std::sin(heading));
    back.push_back(at);
    heading += step;
  }
  for (size_t i = back.size(); i-- > 1;) places.push_back({back[i][0], back[i][1]});
  Rubbing rubbing = around_pins(places, mu);
  ASSERT_EQ(rubbing.eyelets(), pins);
  rubbing.retract(0.05);
  const double first = rubbing.tension(0);
  EXPECT_NEAR(rubbing.tension(pins) / first, 0.81104, 5e-6);
  double mean = 0;
  for (int i = 1; i < pins; ++i) mean += rubbing.tension(i) / (pins - 1);
  EXPECT_NEAR(mean / first, 0.90222, 5e-5);
}

// With r = exp(-mu beta) and two equal segments: loading T_0 = 2 k u/(1 + r), T_1 = r T_0. Back from U nothing slips
// until u = r U: T_0 = 2 k (u - r U/(1 + r)), T_1 = 2 k r U/(1 + r). From there on T_0 = 2 k u r/(1 + r), T_1 = T_0/r.
TEST(CableFriction, TwoSegmentsAroundAPinGoRoundTheirLoopInClosedForm) {
  const double mu = 0.25, r = std::exp(-mu * M_PI / 2), U = 0.03;
  Rubbing rubbing = around_one_pin(mu);
  const auto expect = [&](double u, double first, double second) {
    rubbing.retract(u);
    EXPECT_NEAR(rubbing.tension(0), first, 1e-11 * spring * U) << u;
    EXPECT_NEAR(rubbing.tension(1), second, 1e-11 * spring * U) << u;
    rubbing.remember();
  };
  for (const double u : {0.01, 0.02, U}) expect(u, 2 * spring * u / (1 + r), 2 * spring * u * r / (1 + r));
  for (const double u : {0.95 * U, (0.2 + 0.8 * r) * U, 1.0001 * r * U})
    expect(u, 2 * spring * (u - r * U / (1 + r)), 2 * spring * r * U / (1 + r));
  for (const double u : {0.8 * r * U, 0.3 * r * U, 0.01 * r * U})
    expect(u, 2 * spring * u * r / (1 + r), 2 * spring * u / (1 + r));
  // In one step from the top, too.
  rubbing.slip(0) = r * U / (1 + r);
  expect(0.5 * r * U, spring * r * U * r / (1 + r), spring * r * U / (1 + r));
}

TEST(CableFriction, EyeletsThatStickDoSoExactlyHoweverOftenTheyAreSolvedAgain) {
  std::mt19937 random(3);
  Rubbing rubbing = around_pins({{-3, 0}, {-2, 0.4}, {-1.2, -0.3}, {-0.5, 0.2}}, 0.3);
  rubbing.retract(0.03);
  rubbing.remember();
  const Params before = rubbing.p;
  for (int again = 0; again < 1000; ++again) {
    rubbing.p[of_retraction] = 0.03 * (1 - 0.02 * random_vector(1, random).cwiseAbs().cwiseMin(1)[0]);
    rubbing.settle();
    rubbing.remember();
  }
  EXPECT_EQ(rubbing.slip(0), before[first_state + 1]);
  // The others are at their limit, on which rounding decides.
  for (int i = 1; i < rubbing.eyelets(); ++i) EXPECT_NEAR(rubbing.slip(i), before[first_state + 2 * i + 1], 1e-16) << i;
}

TEST(CableFriction, ASlackCableHasNoTensionAndPullsOnceItIsTaut) {
  Rubbing rubbing = around_pins({{-3, 0}, {-2, 0.4}, {-1.2, -0.3}, {-0.5, 0.2}}, 0.3);
  rubbing.p[of_slack] = 0.01;
  rubbing.retract(0.004);
  for (int j = 0; j < 4; ++j) EXPECT_LT(rubbing.tension(j), 1e-30);
  rubbing.remember();
  rubbing.retract(0.03);
  Rubbing straight = around_pins({{-3, 0}, {-2, 0.4}, {-1.2, -0.3}, {-0.5, 0.2}}, 0.3);
  straight.retract(0.02);
  for (int j = 0; j < 4; ++j) EXPECT_NEAR(rubbing.tension(j), straight.tension(j), 1e-10);
}

/// Through an irregular body and strained, its bounds a part of what makes it slip and its slips from elsewhere: some
/// eyelets slip one way, some the other, some stick.
Rubbing through_a_body(ElementShape shape, double smoothing, double bounds) {
  Mesh mesh = irregular_mesh(shape);
  const int d = mesh.dimension();
  const auto place = [&](double a, double b, double c) {
    return d == 2 ? Eigen::VectorXd(Eigen::Vector2d(a, b)) : Eigen::VectorXd(Eigen::Vector3d(a, b, c));
  };
  std::vector<CablePoint> points{{{}, place(-0.05, 0.02, 0.01)}};
  for (const Eigen::VectorXd& at : {place(0.03, 0.03, 0.03), place(0.05, 0.04, 0.03), place(0.09, 0.035, 0.04),
                                    place(0.13, 0.06, 0.05), place(0.16, 0.05, 0.05)})
    points.push_back({locate(mesh, at), {}});
  Rubbing rubbing(std::move(mesh), std::move(points), 0.3);
  rubbing.cable.smoothing = smoothing;
  rubbing.u = random_state(rubbing.mesh, 0.1, 0.01, 5);
  rubbing.p[of_misalignment] = 0.05;
  rubbing.p[of_slack] = 0.004;
  rubbing.p[of_retraction] = 0.03;
  const double slips[] = {24e-3, 14e-3, 20e-3, 6e-3};
  for (int i = 0; i < rubbing.eyelets(); ++i) {
    rubbing.bound(i) = bounds;
    rubbing.slip(i) = slips[i];
  }
  return rubbing;
}

template <class Action>
void for_each_rubbing_cable(Action&& action) {
  for (ElementShape shape : all_shapes) {
    for (const double smoothing : {0.0, 2e-6, 0.2}) {
      for (const double bounds : {0.5, 8.0}) action(through_a_body(shape, smoothing, bounds));
    }
  }
}

TEST(CableFriction, GradientHessianAndParameterDerivativesAreThoseOfTheEnergy) {
  int sticks = 0, forth = 0, back = 0;
  for_each_rubbing_cable([&](Rubbing rubbing) {
    const TermUnderTest t = rubbing.term(std::string(name_of(rubbing.mesh.shape)));
    expect_derivatives(t, 1e-4);
    expect_parameter_derivatives(t, 1e-3);
    expect_symmetric_hessian(t);
    expect_projection_is_semidefinite(t);
    for (int i = 0; i < rubbing.eyelets(); ++i) {
      const double slip = rubbing.slipped(i) - rubbing.slip(i);
      ++(slip == 0 ? sticks : slip > 0 ? forth : back);
    }
  });
  EXPECT_GT(std::min({sticks, forth, back}), 5) << sticks << ", " << forth << ", " << back;
}

TEST(CableFriction, WithoutBoundsTheEnergyIsThatOfACableThatDoesNotRub) {
  for_each_rubbing_cable([&](Rubbing rubbing) {
    for (const double retracted : {0.03, -0.0139}) {
      rubbing.p[of_retraction] = retracted;
      for (int i = 0; i < rubbing.eyelets(); ++i) rubbing.bound(i) = 0;
      const TermUnderTest t = rubbing.term("rubs");
      rubbing.cable.eyelets.clear();
      const TermUnderTest smooth = rubbing.term("does not");
      EXPECT_NEAR(energy_of(t.model, t.u, t.p), energy_of(smooth.model, t.u, t.p), 1e-13);
      EXPECT_LT((gradient_of(t.model, t.u, t.p) - gradient_of(smooth.model, t.u, t.p)).norm(), 1e-11);
      const Eigen::MatrixXd H = hessian_of(smooth.model, t.u, t.p);
      EXPECT_LT((hessian_of(t.model, t.u, t.p) - H).norm(), 1e-9 * (1 + H.norm()));
      for (int i = 0; i + 2 < static_cast<int>(rubbing.cable.points.size()); ++i)
        rubbing.cable.eyelets.push_back({first_state + 2 * i, first_state + 2 * i + 1});
    }
  });
}

TEST(CableFriction, ChannelsHaveTheDerivativesOfTheirValues) {
  const double sizes[] = {20, 2e-5, 2e-5, 1e-2, 1e-2, 2e-5};
  for_each_rubbing_cable([&](const Rubbing& rubbing) {
    std::vector<std::unique_ptr<Channel>> channels;
    channels.push_back(make_cable_tension(rubbing.mesh, rubbing.cable));
    channels.push_back(make_cable_end_tension(rubbing.mesh, rubbing.cable));
    for (int i = 0; i < rubbing.eyelets(); ++i) {
      channels.push_back(make_eyelet_bound(rubbing.mesh, rubbing.cable, i));
      channels.push_back(make_eyelet_slip(rubbing.mesh, rubbing.cable, i));
    }
    std::mt19937 random(4);
    const Eigen::VectorXd v = random_vector(rubbing.u.size(), random);
    for (const auto& channel : channels) {
      const double value = channel->value({rubbing.u, rubbing.p}),
                   slope = channel->gradient({rubbing.u, rubbing.p}).dot(v);
      expect_taylor_order(
          [&](double h) {
            return std::abs(channel->value({rubbing.u + h * v, rubbing.p}) - value - h * slope);
          },
          2, 1e-13 * (1e-3 + std::abs(value)), 1e-5);
      for (int index = 0; index < rubbing.p.size(); ++index) {
        const double by = channel->parameter_derivative({rubbing.u, rubbing.p}, index);
        expect_taylor_order(
            [&](double h) {
              Params p = rubbing.p;
              p[index] += h;
              return std::abs(channel->value({rubbing.u, p}) - value - h * by);
            },
            2, 1e-12 * (1e-2 + std::abs(value)), sizes[std::min<int>(index, first_state)], 6, std::to_string(index));
      }
    }
  });
}

TEST(CableFriction, AShareScalesTheEnergyButNotTheTension) {
  Rubbing rubbing = through_a_body(ElementShape::tri6, 2e-6, 1.0);
  const TermUnderTest whole = rubbing.term("whole");
  const double tension = rubbing.tension(0);
  rubbing.cable.share = 0.5;
  const TermUnderTest half = rubbing.term("half");
  EXPECT_EQ(rubbing.tension(0), tension);
  EXPECT_EQ(energy_of(half.model, half.u, half.p), 0.5 * energy_of(whole.model, whole.u, whole.p));
  expect_derivatives(half, 1e-4);
}

}  // namespace
}  // namespace taut

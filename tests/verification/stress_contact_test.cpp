#include <gtest/gtest.h>

#include <cmath>

#include "sim/solve/equilibrium.hpp"
#include "tests/support/kinsol_equilibrium.hpp"
#include "tests/support/problems.hpp"

// Where naive ways to treat contact fail: penalties and steps that nothing stops, sums over pairs, barriers of the
// wrong stiffness.
namespace taut::test {
namespace {

bool crosses(const Model& model, const Eigen::VectorXd& u) {
  ContactSettings settings;
  settings.edges = contact_edges(model.mesh());
  settings.stiffness.assign(settings.edges.size(), 0);
  settings.gap = 0;
  return Contact(model.mesh(), settings).intersects(u);
}

/// Two blocks 20 x 10 mm, 1 mm apart, between walls without friction; the upper one is pushed down by "push" [m].
/// nu = 0, so both are bars.
struct Pressed {
  Scene scene;
  int push = -1;
  std::vector<int> bottom;

  double force(const Eigen::VectorXd& u, const Params& p) const {
    Eigen::VectorXd gradient;
    Assembly out;
    out.gradient = &gradient;
    scene.model->evaluate({u, p}, out);
    double sum = 0;
    for (int node : bottom) sum += gradient[2 * node + 1];
    return sum;
  }
};

constexpr double block_modulus = 1e5, block_height = 0.01, block_width = 0.02, block_thickness = 0.03;

Pressed pressed(int lower_cells, int upper_cells, double dhat, double kappa,
                ContactForm form = ContactForm::length_weighted) {
  Mesh lower = rectangle(graded(block_width, lower_cells), graded(block_height, 3), 1, "soft");
  Mesh upper = rectangle(graded(block_width, upper_cells), graded(block_height, 3), 1, "soft");
  place(upper, Eigen::Matrix2d::Identity(), Eigen::Vector2d(0, block_height + 1e-3));
  SceneBuilder builder(merge({{"lower", lower}, {"upper", upper}}), Plane::strain, block_thickness);
  builder.add_solid("soft", "neo_hookean", {{"E", block_modulus}, {"nu", 0.0}});
  Pressed result;
  result.push = builder.declare({"push", "u", "m", -1, 1, "push"}, 0.0);
  builder.fix("lower.ymin", {0, 1});
  builder.fix("upper.ymax", {0});
  builder.prescribe("upper.ymax", 1, result.push);
  for (const char* side : {"lower.xmin", "lower.xmax", "upper.xmin", "upper.xmax"}) builder.fix(side, {0});
  builder.add_contact(dhat, {{"soft", kappa}}, {}, {}, form);
  result.bottom = builder.mesh().select("lower.ymin").nodes();
  result.scene = builder.build();
  return result;
}

/// The force of the closed form: neo-Hookean bars of nu = 0, stress E / 2 (l - 1/l), in series with the barrier's
/// pressure over the distance that is left; dhat = 0: bare bars.
double exact_force(double push, double dhat, double kappa) {
  const auto stress = [](double l) { return block_modulus / 2 * (1 / l - l); };
  double low = 0.5, high = 1;
  for (int i = 0; i < 200; ++i) {
    const double l = 0.5 * (low + high), left = std::max(0.0, 1e-3 - push + 2 * block_height * (1 - l));
    const double s = dhat > 0 ? left / dhat : (left > 0 ? 1 : 0);
    const double carried = s >= 1 ? 0 : s <= 0 ? INFINITY : kappa * (2 * (s - 1) * std::log(s) + (s - 1) * (s - 1) / s);
    (carried > stress(l) ? high : low) = l;
  }
  return stress(low) * block_width * block_thickness;
}

struct Ended {
  SolveReport report;
  Eigen::VectorXd u;
  Params p;
};

Ended pushed(const Pressed& blocks, double push, const EquilibriumOptions& options = {}) {
  Equilibrium equilibrium(*blocks.scene.model, options);
  equilibrium.start_at_rest(blocks.scene.values);
  Params p = blocks.scene.values;
  p[blocks.push] = -push;
  const SolveReport report = equilibrium.solve(p);
  return {report, equilibrium.u(), p};
}

TEST(StressContact, APenaltyLetsABlockIntoAnotherWithoutAWordAndTheBarrierPressesIt) {
  const Pressed barrier = pressed(6, 7, 1e-4, 1e5), penalty = pressed(6, 7, 1e-4, 1e5, ContactForm::penalty);
  const double exact = exact_force(3e-3, 1e-4, 1e5);
  EXPECT_GT(exact, 6);
  const Ended sound = pushed(barrier, 3e-3), sunk = pushed(penalty, 3e-3);
  ASSERT_EQ(sound.report.status, SolveStatus::converged) << sound.report.message();
  EXPECT_FALSE(crosses(*barrier.scene.model, sound.u));
  EXPECT_NEAR(barrier.force(sound.u, sound.p) / exact, 1, 2e-3);
  EXPECT_EQ(sunk.report.status, SolveStatus::converged) << "it says nothing";
  EXPECT_TRUE(crosses(*penalty.scene.model, sunk.u));
  EXPECT_LT(penalty.force(sunk.u, sunk.p), 1e-6) << "and presses nothing";
}

TEST(StressContact, APenaltyInSmallStepsHoldsButLetsFacesSinkInWhereTheBarrierKeepsThemApart) {
  const double dhat = 1e-4, kappa = 1e3;
  const Pressed barrier = pressed(6, 6, dhat, kappa), penalty = pressed(6, 6, dhat, kappa, ContactForm::penalty);
  EquilibriumOptions small;
  small.load_steps = 200;
  small.max_total_iterations = 4000;
  const Ended sound = pushed(barrier, 1.5e-3), sunk = pushed(penalty, 1.5e-3, small);
  ASSERT_EQ(sound.report.status, SolveStatus::converged);
  EXPECT_NEAR(barrier.force(sound.u, sound.p) / exact_force(1.5e-3, dhat, kappa), 1, 5e-3);
  // The penalty carries at most kappa, a hundredth of the modulus: 2.6 % of strain ask for more, and it lets go.
  EXPECT_LT(penalty.force(sunk.u, sunk.p), 0.5 * exact_force(1.5e-3, dhat, kappa));
  EXPECT_TRUE(sunk.report.status != SolveStatus::converged || crosses(*penalty.scene.model, sunk.u));
}

TEST(StressContact, ASumOverPairsDependsOnTheNodesOfTheFacesAndWeightsByLengthDoNot) {
  // A wide gap, so that the contact's own stiffness shows.
  const double dhat = 8e-4, kappa = 1e4, exact = exact_force(2e-3, dhat, kappa);
  std::vector<double> weighted, summed;
  for (const auto& [lower, upper] : {std::pair{4, 5}, {8, 10}, {16, 20}}) {
    const Pressed by_length = pressed(lower, upper, dhat, kappa);
    // As stiff as the other one at 4 and 5 nodes: kappa in N/m times dhat^2 against kappa in Pa times length and dhat.
    const Pressed by_pair = pressed(lower, upper, dhat, kappa * block_thickness * 0.005 / dhat, ContactForm::pair_sum);
    const Ended one = pushed(by_length, 2e-3), two = pushed(by_pair, 2e-3);
    ASSERT_EQ(one.report.status, SolveStatus::converged) << one.report.message();
    ASSERT_EQ(two.report.status, SolveStatus::converged) << two.report.message();
    weighted.push_back(by_length.force(one.u, one.p) / exact);
    summed.push_back(by_pair.force(two.u, two.p) / exact);
  }
  for (double force : weighted) EXPECT_NEAR(force, 1, 0.015);
  EXPECT_GT(std::abs(summed[2] / summed[0] - 1), 0.05);
}

TEST(StressContact, ABarrierAHundredThousandTimesStifferThanTheBodiesIsFoundAndLostAgain) {
  for (double dhat : {1e-5, 1e-4, 5e-4}) {
    const EquilibriumOptions options{.max_iterations = 200, .max_halvings = 0};
    const Pressed fitting = pressed(6, 7, dhat, block_modulus), hard = pressed(6, 7, dhat, 1e5 * block_modulus);
    const Ended sound = pushed(fitting, 3e-3, options), skin = pushed(hard, 3e-3, options);
    ASSERT_EQ(sound.report.status, SolveStatus::converged) << sound.report.message();
    EXPECT_LE(sound.report.iterations, 14);
    EXPECT_NEAR(fitting.force(sound.u, sound.p) / exact_force(3e-3, dhat, block_modulus), 1, 0.01) << dhat;
    EXPECT_GT(skin.report.iterations, 1.4 * sound.report.iterations) << dhat;
    if (dhat == 5e-4) {
      EXPECT_EQ(skin.report.status, SolveStatus::load_step_limit) << "200 iterations, and no end";
    }
  }
}

/// A soft block with a V notch, and a stiff spike above it that is pushed into it by "push".
Pressed spike(double dhat, double kappa, ContactForm form) {
  Mesh soft = rectangle(graded(0.02, 10), graded(0.01, 5), 1, "soft"),
       tip = rectangle(graded(0.004, 4), graded(0.01, 5), 1, "hard");
  map_vertices(soft, [](const Eigen::VectorXd& x) {
    const double depth = 0.005 * std::max(0.0, 1 - std::abs(x[0] / 0.02 - 0.5) / 0.15);
    return Eigen::VectorXd(Eigen::Vector2d(x[0], x[1] / 0.01 * (0.01 - depth)));
  });
  map_vertices(tip, [](const Eigen::VectorXd& x) {
    const double width = 0.1 + 0.9 * std::min(1.0, x[1] / 0.006);
    return Eigen::VectorXd(Eigen::Vector2d(0.01 + (x[0] - 0.002) * width, 0.0085 + x[1]));
  });
  SceneBuilder builder(merge({{"block", soft}, {"spike", tip}}), Plane::strain, 0.03);
  builder.add_solid("soft", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
  builder.add_solid("hard", "neo_hookean", {{"E", 1e9}, {"nu", 0.3}});
  Pressed result;
  result.push = builder.declare({"push", "u", "m", -1, 1, "push"}, 0.0);
  builder.fix("block.ymin", {0, 1});
  builder.fix("spike.ymax", {0});
  builder.prescribe("spike.ymax", 1, result.push);
  builder.add_contact(dhat, {{"soft", kappa}, {"hard", kappa}}, {}, {}, form);
  result.bottom = builder.mesh().select("block.ymin").nodes();
  result.scene = builder.build();
  return result;
}

TEST(StressContact, ASpikeDrivenIntoANotchPassesThroughNothingByDefaultAndThroughTheBlockWithoutStops) {
  const Pressed barrier = spike(2e-5, 1e5, ContactForm::length_weighted),
                penalty = spike(2e-5, 1e5, ContactForm::penalty);
  for (double push : {4.5e-3, 6e-3}) {
    const Ended sound = pushed(barrier, push), soft = pushed(penalty, push),
                blind = pushed(barrier, push, {.comparison = {.ignore_contact = true}});
    ASSERT_EQ(sound.report.status, SolveStatus::converged) << sound.report.message();
    EXPECT_FALSE(crosses(*barrier.scene.model, sound.u));
    EXPECT_GT(barrier.force(sound.u, sound.p), 0.1);
    for (const Ended* naive : {&soft, &blind}) {
      EXPECT_EQ(naive->report.status, SolveStatus::converged) << "it says nothing";
      EXPECT_TRUE(crosses(*barrier.scene.model, naive->u));
    }
    // Forces balance: what the notch takes is what the spike is pushed with, nodes of the supports only.
    Eigen::VectorXd gradient;
    Assembly out;
    out.gradient = &gradient;
    barrier.scene.model->evaluate({sound.u, sound.p}, out);
    double sum = 0, free = 0;
    for (Eigen::Index i = 1; i < gradient.size(); i += 2) sum += gradient[i];
    free = barrier.scene.model->restrict_to_free(gradient).cwiseAbs().maxCoeff();
    EXPECT_LT(std::abs(sum), 1e-9 * barrier.force(sound.u, sound.p) + 1e-9);
    EXPECT_LT(free, 1e-5 * barrier.force(sound.u, sound.p));
  }
}

TEST(StressContact, SawTeethInterlockWithoutCrossingWhereUncheckedStepsCross) {
  // Two rows of teeth, the upper one half a tooth aside: vertices slide from edge to edge into each other's grooves.
  const int teeth = 6;
  const double width = 0.024, tooth = width / teeth;
  const auto row = [&](bool lower) {
    Mesh mesh = rectangle(graded(width, 2 * teeth), graded(0.008, 4), 1, "soft");
    map_vertices(mesh, [&](const Eigen::VectorXd& x) {
      const double phase = x[0] / tooth - std::floor(x[0] / tooth + 1e-9);
      const double rise = 0.003 * (1 - std::abs(2 * phase - 1)), y = x[1] / 0.008;
      return Eigen::VectorXd(lower ? Eigen::Vector2d(x[0], x[1] + rise * y)
                                   : Eigen::Vector2d(x[0] + 0.35 * tooth, 0.0125 + x[1] - rise * (1 - y)));
    });
    return mesh;
  };
  SceneBuilder builder(merge({{"lower", row(true)}, {"upper", row(false)}}), Plane::strain, 0.03);
  builder.add_solid("soft", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
  Pressed saws;
  saws.push = builder.declare({"push", "u", "m", -1, 1, "push"}, 0.0);
  builder.fix("lower.ymin", {0, 1});
  builder.prescribe("upper.ymax", 1, saws.push);
  builder.fix("upper.ymax & upper.xmin", {0});
  builder.add_contact(1e-5, {{"soft", 1e5}});
  saws.bottom = builder.mesh().select("lower.ymin").nodes();
  saws.scene = builder.build();
  for (double push : {1e-3, 2e-3}) {
    const Ended sound = pushed(saws, push), blind = pushed(saws, push, {.comparison = {.ignore_contact = true}});
    ASSERT_EQ(sound.report.status, SolveStatus::converged) << sound.report.message();
    EXPECT_FALSE(crosses(*saws.scene.model, sound.u));
    EXPECT_GT(saws.force(sound.u, sound.p), 0.01);
    EXPECT_TRUE(blind.report.status != SolveStatus::converged || crosses(*saws.scene.model, blind.u));
  }
}

}  // namespace
}  // namespace taut::test

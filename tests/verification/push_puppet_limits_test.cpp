#include <gtest/gtest.h>

#include "tests/support/message.hpp"
#include "tests/support/push_puppet.hpp"

// Where methods for this module fail: each case ends in the right answer or in a sentence that says why not.
namespace taut::test {
namespace {

struct Outcome {
  StaticReplay bench;
  Prediction prediction;

  /// No two edges cross and no element is folded in any state that was reached.
  void expect_sound() const {
    const Model& model = *bench.protocol->scene().model;
    ContactSettings settings;
    settings.edges = contact_edges(model.mesh());
    settings.stiffness.assign(settings.edges.size(), 0);
    settings.gap = 0;
    const Contact contact(model.mesh(), settings);
    for (const StaticProtocol::Condition& condition : bench.protocol->conditions()) {
      if (condition.report.status != SolveStatus::converged) continue;
      EXPECT_FALSE(contact.intersects(condition.u));
      EXPECT_GT(condition.smallest_jacobian, 0);
    }
  }
};

Outcome replay(const Experiment& experiment, const Trials& trials) {
  Outcome outcome{make_static_replay(experiment, experiment.mesh, trials), {}};
  outcome.prediction = outcome.bench.protocol->predict(outcome.bench.protocol->nominal(), {});
  outcome.expect_sound();
  return outcome;
}

/// Symmetric under y -> -y at zero load: the tip does not move sideways.
double tip_sideways(const Outcome& outcome, size_t condition) {
  const StaticProtocol& protocol = *outcome.bench.protocol;
  const StaticProtocol::Condition& state = protocol.conditions()[condition];
  return protocol.channels()[0].channel->value({state.u, state.p});
}

TEST(SlowPushPuppetLimits, EqualLipsCloseWithoutIntersection) {
  Experiment e = reference_module();
  e.geometry.edit<PushPuppet>().lip_relief = 0;
  const Outcome outcome = replay(e, conditions_of({11.79e-3, 17.68e-3}, {0.05, 0.5}));
  EXPECT_TRUE(outcome.prediction.complete());
  for (double drop : outcome.prediction.values) EXPECT_GT(drop, 0);
}

/// Three foam cells of 25 x 25 mm without retraction: the lips of the first gap meet at 150 g, and from 120 g on there
/// is another equilibrium beside the path.
Experiment three_cells() {
  PushPuppet module;
  module.cells = 3;
  module.cell_length = 13.33e-3;
  module.core_height = 25e-3;
  module.web_thickness = 2.5e-3;
  module.plate_thickness = 4e-3;
  module.clearance = 2e-3;
  module.lip_thickness = 3e-3;
  module.gap_total = 11e-3;
  module.cable_offset = 16e-3;
  Experiment e = reference_module();
  set_module(e, module);
  e.geometry.thickness = 25e-3;
  e.cables.k = 12e3;
  e.cables.slack = 0.4e-3;
  for (MaterialSettings& material : e.materials) {
    const bool foam = material.region == "foam";
    material.constants["E"] = foam ? 46.8e3 : 2.3e9;
    material.constants["nu"] = foam ? 0.25 : 0.36;
  }
  e.mesh.size = 2.5e-3;
  return e;
}

TEST(PushPuppetLimits, AHeavyMassHungAtOnceEndsWhereManySmallOnesLead) {
  std::vector<double> dense{0.02, 0.06, 0.12};
  for (double mass = 0.13; mass < 0.245; mass += 0.01) dense.push_back(mass);
  dense.push_back(0.25);
  const Outcome at_once = replay(three_cells(), conditions_of({0}, {0.02, 0.06, 0.12, 0.25}));
  const Outcome slowly = replay(three_cells(), conditions_of({0}, dense));
  ASSERT_TRUE(at_once.prediction.complete() && slowly.prediction.complete());
  const double drop = at_once.prediction.values[3];
  EXPECT_NEAR(drop, slowly.prediction.values[slowly.prediction.values.size() - 1], 1e-6);
  EXPECT_LT(drop, 14e-3) << "the other equilibrium lies at 15.0 mm";
}

/// Studs longer than a cell's gap stand in their grooves from the start: they locate the plates before anything closes.
/// How far a tongue and the lip around it have moved apart, across, is bounded by the play.
TEST(PushPuppetLimits, StudsThatReachIntoTheirGroovesAtRestBoundTheShearOfOpenJoints) {
  PushPuppet module;
  module.gap_total = 8e-3;
  std::vector<double> drops;
  for (const double stud_length : {0.0, 2.5e-3}) {
    module.stud_length = stud_length;
    const PushPuppetLayout at(module);
    ASSERT_LT(at.gap, 2.5e-3);
    Experiment e = reference_module();
    set_module(e, module);
    e.mesh.size = 4e-3;
    const Outcome outcome = replay(e, conditions_of({0}, {0.2}));
    ASSERT_TRUE(outcome.prediction.complete());
    drops.push_back(outcome.prediction.values[0]);
    if (stud_length == 0) continue;
    const Mesh& mesh = outcome.bench.protocol->scene().model->mesh();
    const Eigen::VectorXd& u = outcome.bench.protocol->conditions().front().u;
    const auto now = [&](double x, double y) {
      const MaterialPoint point = locate(mesh, Eigen::Vector2d(x, y));
      Eigen::Vector2d place(x, y);
      for (size_t i = 0; i < point.nodes.size(); ++i) place += point.weights[i] * u.segment<2>(2 * point.nodes[i]);
      return place;
    };
    double largest = 0;
    for (int joint = 0; joint < module.cells; ++joint) {
      const double face = joint * at.pitch + at.lip_length + at.gap;
      const double off = 0.5 * module.stud_thickness + module.stud_play + 0.2e-3;  // into the groove's wall
      for (const double side : {1.0, -1.0}) {
        // How far the tongue is from a line in the wall, which turns with its lip.
        const Eigen::Vector2d mouth = now(face + 0.2e-3, side * (at.middle + off)),
                              along = (now(face + 2e-3, side * (at.middle + off)) - mouth).normalized(),
                              to = now(face + 0.4e-3, side * at.middle) - mouth;
        largest = std::max(largest, std::abs(std::abs(along[0] * to[1] - along[1] * to[0]) - off));
      }
    }
    EXPECT_LT(largest, 1.1 * module.stud_play);
    EXPECT_GT(largest, 0.7 * module.stud_play) << "one of them is at the end of its play";
  }
  EXPECT_LT(drops[1], 0.9 * drops[0]);
}

TEST(SlowPushPuppetLimits, AKilogramOnTheSoftModuleIsSaidToBeBeyondTheEndOfThePath) {
  const Outcome outcome = replay(reference_module(1), conditions_of({0}, {0.5, 1.0}));
  ASSERT_EQ(outcome.prediction.failures.size(), 1u);
  const std::string& failure = outcome.prediction.failures.front();
  EXPECT_TRUE(failure.find("mass = 1 kg, retraction = 0 m") != std::string::npos) << failure;
  EXPECT_TRUE(failure.find("the path may end there") != std::string::npos) << failure;
  EXPECT_NEAR(0.5 * 9.81 / outcome.prediction.values[0], 261.3, 2) << "the row before it stands";
}

TEST(SlowPushPuppetLimits, PlasticAHundredTimesStifferChangesOpenRetractionsHardly) {
  Experiment e = reference_module(), stiff = e;
  stiff.materials[1].constants["E"] = 2.3e11;
  const Trials trials = conditions_of({0, 11.79e-3}, {0.05, 0.5});
  const Outcome usual = replay(e, trials), hard = replay(stiff, trials);
  ASSERT_TRUE(hard.prediction.complete());
  for (Eigen::Index i = 0; i < 4; ++i) EXPECT_NEAR(hard.prediction.values[i] / usual.prediction.values[i], 1, 0.01);
}

TEST(SlowPushPuppetLimits, NearlyIncompressibleFoamIsReplayed) {
  Experiment e = reference_module();
  e.materials[0].constants["nu"] = 0.49;
  e.mesh.formulation = Formulation::locking_free;
  const Outcome outcome = replay(e, conditions_of({0, 5.89e-3}, {0.05, 0.2}));
  EXPECT_TRUE(outcome.prediction.complete());
}

TEST(SlowPushPuppetLimits, RetractionBeyondClosureTightensTheCableBySpringAlone) {
  Experiment e = reference_module();
  const Outcome outcome = replay(e, conditions_of({17.68e-3, 21e-3, 23e-3}, {0.0}));
  ASSERT_TRUE(outcome.prediction.complete());
  const auto tension = make_cable_tension(outcome.bench.protocol->scene().model->mesh(), outcome.bench.cables[0]);
  const auto& conditions = outcome.bench.protocol->conditions();
  const double at21 = tension->value({conditions[1].u, conditions[1].p});
  const double at23 = tension->value({conditions[2].u, conditions[2].p});
  // Closed lips are some thousand times stiffer than the cable.
  EXPECT_NEAR((at23 - at21) / 2e-3, 20e3, 0.01 * 20e3);
  EXPECT_NEAR(at21, 20e3 * (21e-3 - 17.2e-3), 0.02 * at21);
  EXPECT_NEAR(tip_sideways(outcome, 2), 0, 1e-9);
}

TEST(SlowPushPuppetLimits, SlackBeyondTheRetractionLeavesTheCablesLoose) {
  Experiment e = reference_module(), without = e;
  e.cables.slack = 20e-3;
  without.cables.cables.clear();
  without.cables.columns.clear();
  std::erase_if(without.bench.controls, [](const BenchFormat::Control& control) { return control.id == "retraction"; });
  Trials trials = conditions_of({0}, {0.05, 0.2});
  const Outcome loose = replay(e, conditions_of({5.89e-3}, {0.05, 0.1}));
  for (Reading& reading : trials.readings) reading.controls.pop_back();
  trials.control_ids.pop_back();
  trials.control_quantities.pop_back();
  trials.control_values.pop_back();
  const Outcome none = replay(without, trials);
  EXPECT_NEAR(loose.prediction.values[0], none.prediction.values[0], 1e-9) << "50 g";
}

TEST(PushPuppetLimits, AContactGapLargerThanTheGapAtRestIsRefused) {
  Experiment e = reference_module();
  e.mesh.contact_gap = 3e-3;
  expect_input_error([&] { make_static_replay(e, e.mesh, conditions_of()); },
                     {"the contact gap of 3 mm is too large for the module", "below 0.5 mm"});
}

}  // namespace
}  // namespace taut::test

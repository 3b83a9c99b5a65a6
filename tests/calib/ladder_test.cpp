#include "calib/models/ladder.hpp"

#include <gtest/gtest.h>

#include "calib/files/experiment.hpp"
#include "calib/fit/fit.hpp"
#include "sim/shapes/grid.hpp"
#include "tests/support/push_puppet.hpp"

// The selector on problems made so that one rung is the right one, and on the module's bench, against the full model.
namespace taut::test {
namespace {

/// A clamped foam beam under four forces on its end face; one reading each.
struct Beam {
  Experiment experiment;
  Trials trials;
};

Beam beam(double length, double height, double thickness, double nu, const std::vector<int>& cells) {
  Beam made{read_experiment(TAUT_SOURCE_DIR "/experiments/foam_cantilever/experiment.toml"), {}};
  Experiment& e = made.experiment;
  e.geometry.edit<Rectangle>().size = {length, height};
  e.geometry.thickness = thickness;
  e.mesh.cells = cells;
  e.materials[0].constants["nu"] = nu;
  made.trials.control_ids = {"tip_load"};
  made.trials.control_quantities = {Quantity::force};
  made.trials.channel_ids = {"tip"};
  made.trials.control_values.resize(1);
  const double unit = 80e3 * thickness * std::pow(height / length, 3);  // bends by about a tenth of its length
  for (double factor : {0.0025, 0.005, 0.0075, 0.01}) {
    Reading reading;
    reading.controls = {factor * unit * length};
    reading.sigma = 1;
    made.trials.readings.push_back(reading);
    made.trials.control_values[0].insert(reading.controls[0]);
  }
  return made;
}

struct Climbed {
  StaticReplay full;
  Ladder ladder;
};

Climbed climbed(const Experiment& experiment, const Trials& trials) {
  Climbed made{make_static_replay(experiment, experiment.mesh, trials), {}};
  made.ladder = climb(experiment, trials, made.full);
  std::printf("%s\n", made.ladder.sentence.c_str());
  return made;
}

void expect_all(const Ladder& ladder, Rung rung) {
  for (const RowChoice& row : ladder.rows) EXPECT_EQ(name_of(row.rung), name_of(rung)) << ladder.sentence;
}

/// Largest relative distance of the chosen models from other values.
double distance(const Climbed& made, const Eigen::VectorXd& values) {
  const Prediction chosen = made.ladder.protocol->predict(made.ladder.protocol->nominal(), {});
  return (chosen.values.array() / values.array() - 1).abs().maxCoeff();
}

TEST(Ladder, ASlenderBeamNeedsNoMoreThanBeams) {
  Beam made = beam(0.12, 0.01, 0.03, 0.0, {36, 3});
  made.experiment.tolerance = 0.03;
  const Climbed result = climbed(made.experiment, made.trials);
  expect_all(result.ladder, Rung::beam);
  EXPECT_LE(distance(result, result.full.protocol->predict(result.full.protocol->nominal(), {}).values), 0.03);
  for (const RungTrial& trial : result.ladder.trials) EXPECT_EQ(trial.rung, Rung::beam) << "nothing else was solved";
}

/// The module without Poisson's effect, so that the kind of plane does not matter.
Experiment module(double E_plastic, double tolerance) {
  Experiment e = reference_module();
  for (MaterialSettings& material : e.materials) material.constants["nu"] = 0;
  e.materials[1].constants["E"] = E_plastic;
  e.tolerance = tolerance;
  return e;
}

TEST(Ladder, AnOpenModuleOfStiffPlasticNeedsRigidSegments) {
  const Experiment e = module(2.3e9, 0.005);
  const Climbed result = climbed(e, conditions_of({5.89e-3}, {0.05, 0.1}));
  expect_all(result.ladder, Rung::rigid_segments);
  for (const RowChoice& row : result.ladder.rows) EXPECT_FALSE(row.closed);
  EXPECT_LE(distance(result, result.full.protocol->predict(result.full.protocol->nominal(), {}).values), 0.005);
}

TEST(Ladder, AnOpenModuleOfSoftPlasticNeedsTheFullModel) {
  const Experiment e = module(2e7, 0.005);
  const Climbed result = climbed(e, conditions_of({5.89e-3}, {0.05, 0.1}));
  expect_all(result.ladder, Rung::full);
  for (const RowChoice& row : result.ladder.rows) {
    EXPECT_GT(row.compliance, 0.0025);
    EXPECT_LE(row.change, 0.005) << "known, of a section whose plane does not matter";
  }
  EXPECT_NE(result.ladder.sentence.find("compliance changes them by up to"), std::string::npos);
}

TEST(Ladder, AWidePlateOfRubberNeedsTheSolid) {
  Beam made = beam(0.06, 0.01, 0.06, 0.45, {8, 1});
  made.experiment.tolerance = 0.02;
  const Climbed result = climbed(made.experiment, made.trials);
  expect_all(result.ladder, Rung::solid);
  for (const RowChoice& row : result.ladder.rows) EXPECT_EQ(row.change, 0) << "nothing is above";
  EXPECT_NE(result.ladder.sentence.find("although the file says plane strain: no plane section is assumed"),
            std::string::npos);
  // Between the two kinds of plane, both of them further away than the tolerance.
  const Prediction solid = result.ladder.protocol->predict(result.ladder.protocol->nominal(), {});
  Experiment stress = made.experiment;
  stress.geometry.plane = Plane::stress;
  const StaticReplay soft = make_static_replay(stress, stress.mesh, made.trials);
  const Prediction strain = result.full.protocol->predict(result.full.protocol->nominal(), {}),
                   thin = soft.protocol->predict(soft.protocol->nominal(), {});
  for (Eigen::Index r = 0; r < 4; ++r) {
    EXPECT_GT(solid.values[r], 1.02 * strain.values[r]);
    EXPECT_LT(solid.values[r], 0.98 * thin.values[r]);
  }
}

TEST(SlowLadder, OnTheBenchRigidSegmentsAreTakenWhereTheyAgreeWithinOnePerCentAndRefusedWhereLipsClose) {
  Experiment e = read_experiment(TAUT_SOURCE_DIR "/experiments/push_puppet/experiment.toml");
  for (MaterialSettings& material : e.materials)
    material.constants["nu"] = 0;  // leaves the question of the plane aside
  const Trials trials = read_trials(e.bench);
  const Climbed result = climbed(e, trials);
  const Prediction full = result.full.protocol->predict(result.full.protocol->nominal(), {});
  const Prediction chosen = result.ladder.protocol->predict(result.ladder.protocol->nominal(), {});
  int rigid = 0;
  for (Eigen::Index r = 0; r < full.values.size(); ++r) {
    const RowChoice& row = result.ladder.rows[static_cast<size_t>(r)];
    const double retraction = result.full.protocol->rows()[static_cast<size_t>(r)].controls[1];
    EXPECT_EQ(row.closed, row.closed || retraction > 17e-3);
    if (row.rung == Rung::rigid_segments) {
      ++rigid;
      EXPECT_NEAR(chosen.values[r] / full.values[r], 1, 0.01);
    }
    if (retraction > 17e-3) {
      EXPECT_EQ(row.rung, Rung::full);
      EXPECT_TRUE(row.closed);
    }
  }
  EXPECT_GE(rigid, 8);
  EXPECT_NE(result.ladder.sentence.find("gaps are closed"), std::string::npos);
}

TEST(SlowLadder, AStuddedClosedModuleIsRefusedForItsCompliance) {
  Experiment e = module(2.3e9, 0.02);
  PushPuppet studded;
  studded.stud_length = 2e-3;
  set_module(e, studded);
  const Climbed result = climbed(e, conditions_of({20e-3}, {0.1}));
  expect_all(result.ladder, Rung::full);
  // What the estimate says of the plastic, its sensitivity says too: dy / d ln E by the implicit function theorem.
  const int E = result.full.protocol->parameters().index("E_plastic");
  const Prediction full = result.full.protocol->predict(result.full.protocol->nominal(), {E});
  for (size_t r = 0; r < result.ladder.rows.size(); ++r) {
    const Eigen::Index k = static_cast<Eigen::Index>(r);
    const double sensitivity = full.derivatives(k, 0) * result.full.protocol->nominal()[E] / full.values[k];
    EXPECT_TRUE(result.ladder.rows[r].closed);
    EXPECT_GT(result.ladder.rows[r].compliance, 0.01);
    EXPECT_GT(std::abs(sensitivity), 0.01);
  }
}

TEST(Ladder, ContactIsLookedForOnlyOnceAGapCloses) {
  Experiment e = module(2.3e9, 0.005);
  const Trials trials = conditions_of({5.89e-3}, {0.05});
  const Climbed result = climbed(e, trials);
  expect_all(result.ladder, Rung::rigid_segments);
  e.model = Rung::rigid_segments;
  const StaticReplay with = make_static_replay(e, e.mesh, trials);
  const ParameterTable& table = result.full.protocol->parameters();
  Params open = result.full.protocol->nominal(), closed = open;
  closed[table.index("slack")] = -13e-3;  // as much as further retraction
  EXPECT_EQ(result.ladder.protocol->idle_parts(), 1);
  for (const Params& p : {open, closed, open}) {
    const Prediction expected = with.protocol->predict(p, {}), found = result.ladder.protocol->predict(p, {});
    ASSERT_TRUE(found.complete());
    EXPECT_NEAR(found.values[0] / expected.values[0], 1, 1e-6);
  }
  const double gap = with.protocol->nominal()[with.protocol->parameters().index("contact_gap")];
  with.protocol->predict(closed, {});
  EXPECT_EQ(result.ladder.protocol->idle_parts(), 0);
  EXPECT_LT(with.contact->smallest_distance(with.protocol->conditions()[0].u, gap), gap) << "lips do meet";
}

TEST(Ladder, AFitOnItsProtocolGivesTheParametersBack) {
  Experiment e = module(2.3e9, 0.005);
  const Trials trials = conditions_of({0, 5.89e-3}, {0.05, 0.1});
  Climbed result = climbed(e, trials);
  const ParameterTable& table = result.full.protocol->parameters();
  Params truth = result.full.protocol->nominal();
  truth[table.index("E_foam")] = 60e3;
  truth[table.index("k_cable")] = 14e3;
  const Prediction made = result.full.protocol->predict(truth, {});
  std::vector<Measurement> measurements = result.full.measurements;
  for (Measurement& m : measurements) {
    m.value = made.values[m.row];
    m.sigma = 0.01 * std::abs(m.value);
  }
  const FitResult found = fit(*result.ladder.protocol, measurements,
                              {{table.index("E_foam"), 50e3, 1e3, 1e6}, {table.index("k_cable"), 2e4, 1e3, 1e6}});
  ASSERT_EQ(found.status, FitStatus::converged) << found.message;
  EXPECT_NEAR(found.parameters[0].value / 60e3, 1, 0.01);
  EXPECT_NEAR(found.parameters[1].value / 14e3, 1, 0.05) << "what rigid segments lack, the cables take over";
}

}  // namespace
}  // namespace taut::test

#include "calib/benches/assumptions.hpp"
#include "calib/files/experiment.hpp"
#include "sim/shapes/grid.hpp"
#include "tests/support/message.hpp"
#include "tests/support/push_puppet.hpp"

// Plane experiments as solids of half their thickness, with a plane of symmetry.
namespace taut::test {
namespace {

Experiment cantilever(double thickness, Plane plane) {
  Experiment e = read_experiment(TAUT_SOURCE_DIR "/experiments/foam_cantilever/experiment.toml");
  e.geometry.edit<Rectangle>().size = {0.08, 0.01};
  e.geometry.thickness = thickness;
  e.geometry.plane = plane;
  e.mesh.cells = {16, 2};
  e.mesh.order = 2;
  return e;
}

Trials one_load(double force) {
  Trials trials;
  trials.control_ids = {"tip_load"};
  trials.control_quantities = {Quantity::force};
  trials.control_values = {{force}};
  trials.channel_ids = {"tip"};
  trials.readings.emplace_back().controls = {force};
  trials.readings.back().sigma = 1;
  return trials;
}

Eigen::VectorXd displacements(const Experiment& experiment, const Trials& trials) {
  const StaticReplay bench = make_static_replay(experiment, experiment.mesh, trials);
  const Prediction prediction = bench.protocol->predict(bench.protocol->nominal(), {});
  for (const std::string& failure : prediction.failures) ADD_FAILURE() << failure;
  return prediction.values;
}

TEST(Solid, AWideCantileverLiesBetweenPlaneStressAndPlaneStrainWhereTheFullBodyDoes) {
  const double thickness = 0.03, force = 2e-3;
  const double stress = displacements(cantilever(thickness, Plane::stress), one_load(force))[0];
  const double strain = displacements(cantilever(thickness, Plane::strain), one_load(force))[0];
  Experiment solid = cantilever(thickness, Plane::strain);
  solid.mesh.depth_cells = 3;
  const double half = displacements(solid, one_load(force))[0];
  EXPECT_GT(half, strain + 0.1 * (stress - strain));
  EXPECT_LT(half, stress - 0.1 * (stress - strain));

  Experiment box = solid;
  box.mesh.depth_cells = 0;
  Box body;
  body.size = {0.08, 0.01, thickness};
  body.origin = {0, 0, -thickness / 2};
  body.region = solid.geometry.as<Rectangle>().region;
  box.geometry.shape = std::make_shared<Box>(body);
  box.geometry.dimension = 3;
  box.mesh.cells = {16, 2, 6};
  box.supports[0].fix = {0, 1, 2};
  box.loads[0].direction = box.channels[0].direction = {0, -1, 0};
  EXPECT_NEAR(half / displacements(box, one_load(force))[0], 1, 2e-3);
}

TEST(Solid, StartsWhereItsSectionIsAndComesToTheEquilibriaOfThePathFromRest) {
  const Experiment module = read_experiment(TAUT_SOURCE_DIR "/experiments/push_puppet/experiment.toml");
  const Trials trials = read_trials(module.bench);
  MeshSettings mesh = module.mesh;
  mesh.size = 6e-3;
  mesh.order = 1;
  mesh.depth_cells = 2;
  const auto solve = [&](bool guided) {
    StaticReplay bench = make_static_replay(module, mesh, trials);
    if (!guided) bench.protocol->follow_guide(nullptr, {});
    const Prediction prediction = bench.protocol->predict(bench.protocol->nominal(), {});
    for (const std::string& failure : prediction.failures) ADD_FAILURE() << failure;
    return std::pair(prediction.values, bench.protocol->factorisations());
  };
  const auto [here, few] = solve(true);
  const auto [there, many] = solve(false);
  ASSERT_EQ(here.size(), 16);
  for (Eigen::Index r = 0; r < here.size(); ++r) EXPECT_NEAR(here[r] / there[r], 1, 1e-6) << "row " << r;
  EXPECT_LT(few, 0.6 * many);
}

TEST(Solid, ANarrowCantileverIsInPlaneStress) {
  Experiment solid = cantilever(2e-3, Plane::strain);
  solid.mesh.depth_cells = 1;
  const double stress = displacements(cantilever(2e-3, Plane::stress), one_load(1e-4))[0];
  EXPECT_NEAR(displacements(solid, one_load(1e-4))[0] / stress, 1, 0.01);
}

TEST(Solid, WithItsSideHeldItIsInPlaneStrainWhateverTheLoad) {
  struct Case {
    Quantity quantity;
    double value;
    std::string on;
    std::vector<double> point;
  };
  for (const Case& c : {Case{Quantity::force, 2e-3, "xmax", {}}, Case{Quantity::mass, 2e-4, "xmax", {}},
                        Case{Quantity::pressure, 5, "xmax", {}}, Case{Quantity::line_load, 0.06, "xmax & ymax", {}},
                        Case{Quantity::force, 2e-3, "", {0.06, 0.01}}}) {
    Experiment plane = cantilever(0.03, Plane::strain);
    plane.loads[0].quantity = c.quantity;
    plane.loads[0].on = c.on;
    plane.loads[0].point = c.point;
    plane.gravity_direction = {0, -1};
    plane.materials[0].density = 20;
    Trials trials = one_load(c.value);
    trials.control_quantities = {c.quantity};
    Experiment solid = as_solid(plane, 2);
    SupportSettings side;
    side.on = "side";
    side.fix = {2};
    solid.supports.push_back(side);
    const double expected = displacements(plane, trials)[0];
    EXPECT_NEAR(displacements(solid, trials)[0] / expected, 1, 3e-3) << c.value << c.on;
    EXPECT_GT(expected, 1e-3);
  }
}

/// A coarse module with quadratic elements, or linear ones.
Experiment coarse_module(int order) {
  Experiment e = reference_module(order);
  e.mesh.size = 5e-3;
  e.mesh.counts["lip_cells"] = 1;
  return e;
}

TEST(SlowSolid, AModuleWithItsSideHeldIsThePlaneOne) {
  const Experiment plane = coarse_module(2);
  Experiment solid = as_solid(plane, 1);
  SupportSettings side;
  side.on = "side";
  side.fix = {2};
  solid.supports.push_back(side);
  const Trials trials = conditions_of({5.89e-3}, {0.1});
  EXPECT_NEAR(displacements(solid, trials)[0] / displacements(plane, trials)[0], 1, 0.01);
}

TEST(SlowSolid, AClosedModuleWithLinearElementsCarriesALoad) {
  Experiment e = coarse_module(1);
  e.mesh.depth_cells = 2;
  const Trials trials = conditions_of({18e-3}, {0.1});
  const StaticReplay bench = make_static_replay(e, e.mesh, trials);
  const StaticProtocol& protocol = *bench.protocol;
  const Prediction prediction = bench.protocol->predict(protocol.nominal(), {});
  ASSERT_TRUE(prediction.complete()) << prediction.failures.front();
  // Linear elements are too stiff, by a factor at most; and the lips do carry.
  const double plane = displacements(coarse_module(1), trials)[0];
  EXPECT_GT(prediction.values[0], 0.3 * plane);
  EXPECT_LT(prediction.values[0], 3 * plane);
  // Half of the cables pull, with their whole tension.
  const auto& condition = protocol.conditions()[0];
  const Point at{condition.u, condition.p};
  EXPECT_EQ(bench.cables[0].share, 0.5);
  EXPECT_GT(make_cable_tension(protocol.scene().model->mesh(), bench.cables[0])->value(at), 10);
}

/// Where a plane section has a parameter, it is a dimension.
TEST(Solid, TheThicknessOfASolidIsADimensionOfItsMesh) {
  Experiment e = cantilever(0.01, Plane::strain);
  e.mesh.depth_cells = 1;
  const Trials trials = one_load(1e-3);
  EXPECT_FALSE(make_static_replay(e, e.mesh, trials).protocol->parameters().contains("thickness"));
  FreeSettings thickness;
  thickness.id = "thickness";
  e.free = {thickness};
  DimensionedProtocol protocol(e, trials, free_dimensions(e));
  ASSERT_TRUE(protocol.parameters().contains("thickness"));
  Params p = protocol.nominal();
  const double thin = protocol.predict(p, {}).values[0];
  p[protocol.parameters().index("thickness")] *= 1.1;
  Experiment thicker = e;
  thicker.geometry.thickness *= 1.1;
  EXPECT_NEAR(protocol.predict(p, {}).values[0], displacements(thicker, trials)[0], 1e-6 * thin);
}

TEST(Solid, WhatHasNoHalfInSpaceIsRefused) {
  const Experiment plane = cantilever(0.01, Plane::strain);
  const auto refused = [&](auto&& change, const std::vector<std::string>& parts) {
    Experiment e = plane;
    change(e);
    expect_input_error([&] { as_solid(e, 1); }, parts);
  };
  refused([](Experiment& e) { e.geometry.dimension = 3; }, {"experiment.toml", "plane"});
  refused([](Experiment& e) { e.supports[0].rotation_stiffness = 1.0; }, {"rotation_stiffness"});
  refused([](Experiment& e) { e.contact.obstacles.push_back({{0, 0}, {1, 0}}); }, {"obstacles"});
  expect_input_error([&] { as_solid(plane, 0); }, {"at least one layer"});
}

}  // namespace
}  // namespace taut::test

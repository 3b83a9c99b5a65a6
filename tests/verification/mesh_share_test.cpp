#include <gtest/gtest.h>

#include "calib/files/experiment.hpp"
#include "calib/studies/discretisation.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/push_puppet.hpp"

// What a coarse mesh, or a wide contact gap, does to a fitted modulus: the share that a fit predicts for itself against
// the difference to the modulus that was planted in readings from a much finer model.
namespace taut::test {
namespace {

/// Problem A1 of the plane benchmarks as a bench: cantilever 55 x 30 x 30 mm, three loads.
Experiment cantilever_bench(double nu) {
  const TemporaryFolder folder;
  const std::string text = replaced(replaced(beam_toml, "[\"60 mm\", \"12 mm\"]", "[\"55 mm\", \"30 mm\"]"),
                                    "thickness = \"20 mm\"", "thickness = \"30 mm\"");
  folder.write("bench.csv", beam_csv);
  Experiment e = read_experiment(folder.write("beam.toml", text));
  e.materials[0].constants = {{"E", 1e5}, {"nu", nu}};
  return e;
}

/// A beam of two regions, the left half five times as stiff as the right one, watched in the middle and at the tip.
Experiment two_regions() {
  const TemporaryFolder folder;
  folder.write("bench.csv", "pull_N,tip_mm,middle_mm\n0.05,1,1\n");
  Experiment e = read_experiment(folder.write("beam.toml", R"(title = "Two regions"
data = "simulated"
[geometry]
kind = "polygons"
thickness = "20 mm"
plane = "strain"
[[geometry.polygon]]
region = "left"
x = ["0 mm", "30 mm", "30 mm", "0 mm"]
y = ["0 mm", "0 mm", "15 mm", "15 mm"]
edges = ["", "", "", "clamp"]
[[geometry.polygon]]
region = "right"
x = ["30 mm", "60 mm", "60 mm", "30 mm"]
y = ["0 mm", "0 mm", "15 mm", "15 mm"]
edges = ["", "end", "", ""]
[mesh]
size = "4 mm"
[materials.left]
law = "neo_hookean"
E = "500 kPa"
nu = 0.3
[materials.right]
law = "neo_hookean"
E = "100 kPa"
nu = 0.3
[[support]]
on = "clamp"
fix = ["x", "y"]
[[load]]
id = "pull"
on = "end"
direction = [0, -1]
column = "pull_N"
[[channel]]
id = "tip"
on = "end"
direction = [0, -1]
column = "tip_mm"
noise = { relative = "1 %" }
[[channel]]
id = "middle"
point = ["30 mm", "7.5 mm"]
direction = [0, -1]
column = "middle_mm"
noise = { relative = "1 %" }
[bench]
file = "bench.csv"
[fit.free]
E_left = { start = "400 kPa", lower = "1 kPa", upper = "10 MPa" }
E_right = { start = "150 kPa", lower = "1 kPa", upper = "10 MPa" }
)"));
  return e;
}

/// Readings under these loads as `settings` predict them at the experiment's own constants, without noise.
Trials readings_of(const Experiment& experiment, const MeshSettings& settings, const std::vector<double>& loads) {
  Trials trials;
  trials.control_ids = {"pull"};
  trials.control_quantities = {Quantity::force};
  trials.control_values = {{loads.begin(), loads.end()}};
  for (const ChannelSettings& channel : experiment.channels) trials.channel_ids.push_back(channel.id);
  for (double load : loads) {
    for (size_t channel = 0; channel < trials.channel_ids.size(); ++channel) {
      Reading& reading = trials.readings.emplace_back();
      reading.controls = {load};
      reading.channel = static_cast<int>(channel);
      reading.sigma = 1;
    }
  }
  const StaticReplay bench = make_static_replay(experiment, settings, trials);
  const Prediction exact = bench.protocol->predict(bench.protocol->nominal(), {});
  EXPECT_TRUE(exact.complete());
  for (size_t i = 0; i < trials.readings.size(); ++i) {
    trials.readings[i].value = exact.values[bench.row_of_reading[i]];
    trials.readings[i].sigma = 0.01 * std::abs(trials.readings[i].value);
  }
  return trials;
}

struct Fitted {
  FitResult fit;
  std::vector<Share> shares;
};

Fitted fitted(const Experiment& experiment, const Trials& trials) {
  const StaticReplay bench = make_static_replay(experiment, experiment.mesh, trials);
  FitOptions options;
  options.profiles = false;
  options.tolerance = 1e-10;
  Fitted result{fit(*bench.protocol, bench.measurements, free_parameters(experiment, *bench.protocol), options), {}};
  EXPECT_EQ(result.fit.status, FitStatus::converged) << result.fit.message;
  result.shares = discretisation_shares(experiment, trials, result.fit);
  return result;
}

void print(const std::string& what, const Fitted& f, size_t share, size_t j, double shift) {
  const ParameterEstimate& e = f.fit.parameters[j];
  std::printf("%s: %s = %.5g, off by %+.4g, predicted %+.4g +- %.2g (%.2f s; %s)\n", what.c_str(), e.spec.id.c_str(),
              e.value, shift, f.shares[share].bias[j], f.shares[share].error[j], f.shares[share].seconds,
              f.shares[share].how.c_str());
}

TEST(SlowMeshShare, OfCoarseLinearElementsIsPredictedWithinAThird) {
  Experiment e = cantilever_bench(0.3);
  e.mesh.order = 2;
  e.mesh.cells = {37, 20};
  const Trials trials = readings_of(e, e.mesh, {0.5, 1});
  e.mesh.order = 1;
  for (const std::vector<int>& cells : {std::vector{4, 2}, {7, 4}, {11, 6}}) {
    e.mesh.cells = cells;
    const Fitted f = fitted(e, trials);
    ASSERT_EQ(f.shares.size(), 1u);
    const double shift = f.fit.parameters[0].value - 1e5;
    print(e.mesh.describe(), f, 0, 0, shift);
    EXPECT_LT(shift, -0.02 * 1e5) << "linear elements bend too stiffly, so less modulus does";
    EXPECT_NEAR(f.shares[0].bias[0], shift, std::abs(shift) / 3);
    EXPECT_NEAR(f.shares[0].bias[0], shift, f.shares[0].error[0] + 0.02 * std::abs(shift));
  }
}

TEST(SlowMeshShare, OfLockingElementsIsPredictedWithinAThird) {
  Experiment e = cantilever_bench(0.499);
  e.mesh.order = 2;
  e.mesh.formulation = Formulation::locking_free;
  e.mesh.cells = {37, 20};
  const Trials trials = readings_of(e, e.mesh, {0.5, 1});
  e.mesh.formulation = Formulation::standard;
  for (int order : {1, 2}) {
    e.mesh.order = order;
    e.mesh.cells = {11, 6};
    const Fitted f = fitted(e, trials);
    const double shift = f.fit.parameters[0].value - 1e5;
    print(e.mesh.describe(), f, 0, 0, shift);
    EXPECT_LT(shift, order == 1 ? -0.05 * 1e5 : -0.01 * 1e5);
    EXPECT_NEAR(f.shares[0].bias[0], shift, std::abs(shift) / 3);
  }
}

TEST(SlowMeshShare, OfQuadraticElementsIsSmallAndCoversTheTruth) {
  Experiment e = cantilever_bench(0.3);
  e.mesh.order = 2;
  e.mesh.cells = {55, 30};
  const Trials trials = readings_of(e, e.mesh, {0.5, 1});
  for (const std::vector<int>& cells : {std::vector{4, 2}, {7, 4}, {11, 6}}) {
    e.mesh.cells = cells;
    const Fitted f = fitted(e, trials);
    const double shift = f.fit.parameters[0].value - 1e5, finest = 4e-4 * 1e5;
    print(e.mesh.describe(), f, 0, 0, shift);
    EXPECT_LT(std::abs(f.shares[0].bias[0]), 0.02 * 1e5);
    EXPECT_NEAR(f.shares[0].bias[0], shift, f.shares[0].error[0] + finest) << "the readings' own mesh is off by 0.03 %";
    EXPECT_LT(f.shares[0].error[0], std::abs(f.shares[0].bias[0]) + finest);
  }
}

TEST(SlowMeshShare, DoesNotCountHowFarAFitStoppedFromItsOwnOptimum) {
  Experiment e = cantilever_bench(0.3);
  e.mesh.order = 2;
  e.mesh.cells = {22, 12};
  const Trials trials = readings_of(e, e.mesh, {0.5, 1});
  e.mesh.cells = {7, 4};
  Fitted f = fitted(e, trials);
  const double bias = f.shares[0].bias[0] / f.fit.parameters[0].value;
  const int E = make_static_replay(e, e.mesh, trials).protocol->parameters().index("E_foam");
  f.fit.p[E] = f.fit.parameters[0].value *= 1.01;
  const double there = discretisation_shares(e, trials, f.fit)[0].bias[0] / f.fit.parameters[0].value;
  EXPECT_LT(bias, -0.003);
  EXPECT_NEAR(there, bias, 0.05 * std::abs(bias)) << "twice the bias away";
}

TEST(SlowMeshShare, OfTwoModuliIsPredictedForEach) {
  if (!has_gmsh()) GTEST_SKIP() << "built without Gmsh";
  Experiment e = two_regions();
  e.mesh.size = 0.75e-3;
  const Trials trials = readings_of(e, e.mesh, {0.1, 0.2});
  e.mesh.order = 1;
  e.mesh.size = 3e-3;
  const Fitted f = fitted(e, trials);
  const double planted[2] = {5e5, 1e5};
  for (size_t j = 0; j < 2; ++j) {
    const double shift = f.fit.parameters[j].value - planted[j];
    print(e.mesh.describe(), f, 0, j, shift);
    EXPECT_LT(shift, -0.03 * planted[j]);
    EXPECT_NEAR(f.shares[0].bias[j], shift, std::abs(shift) / 3);
  }
}

TEST(SlowMeshShare, OfTheContactGapAgreesWithFitsWithSmallerGaps) {
  Experiment e = read_experiment(TAUT_SOURCE_DIR "/experiments/push_puppet/experiment.toml");
  std::erase_if(e.free, [](const FreeSettings& free) { return free.id != "E_foam"; });
  e.contact.compensate = false;  // so that the gap shows
  e.mesh.order = 1;
  Trials trials = conditions_of({17.68e-3}, {0.05, 0.1, 0.2});
  MeshSettings fine = e.mesh;
  fine.contact_gap = 1e-6;
  const StaticReplay bench = make_static_replay(e, fine, trials);
  const Prediction exact = bench.protocol->predict(bench.protocol->nominal(), {});
  ASSERT_TRUE(exact.complete());
  for (size_t i = 0; i < trials.readings.size(); ++i) {
    trials.readings[i].value = exact.values[bench.row_of_reading[i]];
    trials.readings[i].sigma = 0.01 * trials.readings[i].value;
  }
  for (double gap : {40e-6, 20e-6}) {
    e.mesh.contact_gap = gap;
    const Fitted f = fitted(e, trials);
    ASSERT_EQ(f.shares.size(), 2u);
    ASSERT_EQ(f.shares[1].source, "contact gap");
    const double shift = f.fit.parameters[0].value - 50e3;
    print(e.mesh.describe(), f, 1, 0, shift);
    EXPECT_NEAR(f.shares[1].bias[0], shift, f.shares[1].error[0]) << "half of it is admitted";
    EXPECT_NEAR(f.shares[1].bias[0], shift, std::abs(shift) / 3);
    EXPECT_GT(shift, 0.05 * 50e3) << "faces that rest apart close early, which looks like stiffer foam";
  }
}

TEST(MeshShare, ParametersThatTheReadingsDoNotSeeStay) {
  // The second parameter changes nothing; the first one makes all predictions 10 % too large.
  ParameterTable table;
  table.declare({"E", "E", "Pa", 1, 1e9, "", true});
  table.declare({"unseen", "U", "Pa", 1, 1e9, "", true});
  Params p(2);
  p << 1000, 5000;
  Prediction prediction;
  prediction.values = Eigen::Vector2d(1.1, 2.2);
  prediction.derivatives.resize(2, 2);
  prediction.derivatives << -1.1e-3, 0, -2.2e-3, 0;
  const std::vector<Measurement> measurements{{0, 1, 0.01, 0}, {1, 2, 0.01, 1}};
  const std::vector<FreeParameter> free{{0, 1000, 10, 1e5}, {1, 5000, 10, 1e5}};
  const Eigen::VectorXd step = gauss_newton_step(prediction, measurements, table, p, free);
  EXPECT_NEAR(step[0], std::log(1.1), 1e-12) << "y = c / E: a stiffness 10 % larger, exactly";
  EXPECT_EQ(step[1], 0);
}

TEST(MeshShare, AStepEndsAtItsBoundAndTheOthersMakeUpForIt) {
  // Two straight lines through one reading each, tied: y = a + b and y = a - b + 1.
  ParameterTable table;
  table.declare({"a", "a", "m", -100, 100, ""});
  table.declare({"b", "b", "m", -100, 100, ""});
  const Params p = Eigen::Vector2d(0, 0);
  Prediction prediction;
  prediction.values = Eigen::Vector2d(0, 0);
  prediction.derivatives.resize(2, 2);
  prediction.derivatives << 1, 1, 1, -1;
  const std::vector<Measurement> measurements{{0, 4, 1, 0}, {1, 2, 1, 1}};
  const Eigen::VectorXd open =
      gauss_newton_step(prediction, measurements, table, p, {{0, 0, -10, 10}, {1, 0, -10, 10}});
  EXPECT_NEAR(open[0], 3, 1e-12);
  EXPECT_NEAR(open[1], 1, 1e-12);
  const Eigen::VectorXd held = gauss_newton_step(prediction, measurements, table, p, {{0, 0, -10, 2}, {1, 0, -10, 10}});
  EXPECT_NEAR(held[0], 2, 1e-12);
  EXPECT_NEAR(held[1], 1, 1e-12);
}

TEST(MeshShare, AStepThatABoundStopsDragsNobodyAlong) {
  // y = a + b and y = a + 1.01 b: 1 and 0 ask for a = 101 and b = -100; with a at 0, b = 1 / (1 + 1.01^2).
  ParameterTable table;
  table.declare({"a", "a", "m", -100, 100, ""});
  table.declare({"b", "b", "m", -100, 100, ""});
  Prediction prediction;
  prediction.values = Eigen::Vector2d(0, 0);
  prediction.derivatives.resize(2, 2);
  prediction.derivatives << 1, 1, 1, 1.01;
  const std::vector<Measurement> measurements{{0, 1, 1e-3, 0}, {1, 0, 1e-3, 1}};
  const Eigen::VectorXd step =
      gauss_newton_step(prediction, measurements, table, Eigen::Vector2d(0, 0), {{0, 0, -10, 0}, {1, 0, -10, 10}});
  EXPECT_NEAR(step[0], 0, 1e-12);
  EXPECT_NEAR(step[1], 1 / (1 + 1.01 * 1.01), 1e-6);
}

TEST(MeshShare, ExtrapolationFindsLimitAndOrderOfPowersOfTheElementSize) {
  for (double order : {0.7, 1.4, 2.0, 3.5}) {
    const std::vector<double> h{0.4, 0.25, 0.18};
    Eigen::MatrixXd values(2, 3);
    for (Eigen::Index k = 0; k < 3; ++k)
      values.col(k) << 3 + 2 * std::pow(h[static_cast<size_t>(k)], order), -std::pow(h[static_cast<size_t>(k)], order);
    const Extrapolation e = extrapolate(h, values, 4);
    EXPECT_TRUE(e.measured);
    EXPECT_NEAR(e.order, order, 1e-9);
    EXPECT_NEAR(e.limit[0], 3, 1e-9);
    EXPECT_NEAR(e.limit[1], 0, 1e-9);
    EXPECT_NEAR(e.error[0], 1.25 * 2 * std::pow(0.18, order), 1e-9);
  }
}

TEST(MeshShare, DifferencesThatTurnAreNotExtrapolated) {
  const Extrapolation e = extrapolate({4, 2, 1}, Eigen::RowVector3d(1.0, 1.2, 1.1), 4);
  EXPECT_FALSE(e.measured);
  EXPECT_EQ(e.limit[0], 1.1);
  EXPECT_NEAR(e.error[0], 0.3, 1e-12);
  EXPECT_FALSE(extrapolate({4, 2, 1}, Eigen::RowVector3d(1.0, 1.2, 1.35), 4).measured) << "as if with order 0.4";
  const Extrapolation two = extrapolate({2, 1}, Eigen::RowVector2d(1.2, 1.1), 4);
  EXPECT_NEAR(two.limit[0], 1.0, 1e-12) << "order 1";
  EXPECT_TRUE(std::isnan(extrapolate({1}, Eigen::MatrixXd::Ones(1, 1), 4).error[0]));
}

TEST(MeshShare, RefinedMeshesHaveMoreOfEverythingThatMakesThem) {
  GeometrySettings geometry;
  geometry.shape = make_shape("push_puppet");
  MeshSettings settings;
  settings.size = 2.6e-3;
  settings.cells = {3, 1};
  const MeshSettings finer = refined(settings, geometry, 2), coarser = refined(settings, geometry, 0.5);
  EXPECT_EQ(finer.cells, (std::vector{6, 2}));
  EXPECT_EQ(finer.size, 1.3e-3);
  EXPECT_EQ(finer.counts.at("lip_cells"), 4);
  EXPECT_EQ(coarser.cells, (std::vector{2, 1}));
  EXPECT_EQ(coarser.counts.at("lip_cells"), 1);
  geometry.shape = make_shape("msh");
  EXPECT_EQ(refined(settings, geometry, 2).size, settings.size) << "a mesh from a file stays";
}

}  // namespace
}  // namespace taut::test

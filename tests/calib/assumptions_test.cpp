#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <tuple>

#include "calib/benches/specimens.hpp"
#include "calib/benches/static_bench.hpp"
#include "calib/fit/fit.hpp"
#include "calib/runs/open_bench.hpp"
#include "calib/runs/run_fit.hpp"
#include "calib/studies/assumption_shares.hpp"
#include "sim/mesh/gmsh.hpp"
#include "sim/mesh/weights.hpp"
#include "tests/support/message.hpp"
#include "tests/support/push_puppet.hpp"
#include "tests/support/static_bench.hpp"

namespace taut::test {
namespace {

/// A bar of 60 x 12 x 20 mm in tension, plane stress without cross contraction: delta = F L / (E t h), exactly linear
/// in small strains.
std::string bar() {
  std::string toml = beam_toml;
  for (const char* column : {"pull_N", "tip_mm"}) {
    const std::string end = std::string("\ncolumn = \"") + column + "\"";
    toml = replaced(toml, "direction = [0, -1]" + end, "direction = [1, 0]" + end);
  }
  toml = replaced(toml, "absolute = \"0.1 mm\"", "absolute = \"0.000001 mm\"");
  return replaced(replaced(toml, "plane = \"strain\"", "plane = \"stress\""), "nu = 0.3", "nu = 0");
}
const std::string bar_csv =
    "trial,pull_N,tip_mm\na,0.0001,0.00025\na,0.0002,0.0005\nb,0.0001,0.00025\nb,0.0002,0.0005\n";

class Assumptions : public testing::Test {
 protected:
  /// Fitted, with its shares by their sources.
  std::map<std::string, Share> shares_of(const std::string& toml, double* modulus = nullptr) const {
    const Experiment experiment = experiment_in(folder_, toml, bar_csv);
    const Trials trials = read_trials(experiment.bench);
    const StaticReplay replay = make_static_replay(experiment, experiment.mesh, trials);
    FitOptions options;
    options.profiles = false;
    const FitResult result =
        fit(*replay.protocol, replay.measurements, free_parameters(experiment, *replay.protocol), options);
    EXPECT_EQ(result.status, FitStatus::converged);
    if (modulus != nullptr) *modulus = result.parameters[0].value;
    std::map<std::string, Share> found;
    for (const Share& share :
         assumption_shares(experiment, full_model(experiment, trials, dimensions_of(experiment)), result))
      found[share.source] = share;
    return found;
  }
  TemporaryFolder folder_;
};

TEST_F(Assumptions, ABarsModulusGoesWithItsLengthAndItsLoadAndAgainstItsCrossSection) {
  double E = 0;
  const auto shares = shares_of(bar(), &E);
  EXPECT_NEAR(E, 0.0001 * 0.06 / (0.02 * 0.012 * 0.25e-6), 1e-3 * E);
  for (const char* source : {"size_x", "size_y", "thickness", "scale of pull"}) {
    ASSERT_TRUE(shares.contains(source)) << source;
    EXPECT_NEAR(shares.at(source).error[0], 0.01 * E, 1e-4 * E) << source;
    EXPECT_FALSE(shares.at(source).counted) << "nobody stated a tolerance";
  }
  EXPECT_FALSE(shares.contains("E_foam"));
  EXPECT_FALSE(shares.contains("nu_foam")) << "it is zero";
}

TEST_F(Assumptions, TolerancesOfTheFileCountAndAreThoseOfTheShares) {
  std::string toml =
      replaced(bar(), "size = [\"60 mm\", \"12 mm\"]", "size = [\"60 mm +- 0.3 mm\", \"12 mm \u00b1 2 %\"]");
  toml = replaced(toml, "thickness = \"20 mm\"", "thickness = \"20 mm +- 0.1 mm\"");
  toml = replaced(toml, "nu = 0\n", "nu = \"0 +- 0.02\"\n");
  toml = replaced(toml, "trial = \"trial\"", "trial = \"trial\"\ntolerance = { pull = \"0.5 %\" }");
  double E = 0;
  const auto shares = shares_of(toml, &E);
  EXPECT_NEAR(shares.at("size_x").error[0], 0.005 * E, 1e-4 * E);
  EXPECT_NEAR(shares.at("size_y").error[0], 0.02 * E, 1e-3 * E);
  EXPECT_NEAR(shares.at("thickness").error[0], 0.005 * E, 1e-4 * E);
  EXPECT_NEAR(shares.at("scale of pull").error[0], 0.005 * E, 1e-4 * E);
  // E = F L / (h t delta): too long a bar, or too large a force, is made up for by a larger modulus.
  EXPECT_NEAR(shares.at("size_x").moves[0], 0.005 * E, 1e-4 * E);
  EXPECT_NEAR(shares.at("size_y").moves[0], -0.02 * E, 1e-3 * E);
  EXPECT_NEAR(shares.at("thickness").moves[0], -0.005 * E, 1e-4 * E);
  EXPECT_NEAR(shares.at("scale of pull").moves[0], 0.005 * E, 1e-4 * E);
  EXPECT_TRUE(shares.contains("nu_foam")) << "zero, but with a tolerance";
  for (const auto& [source, share] : shares) EXPECT_TRUE(share.counted) << source;
}

TEST_F(Assumptions, PerCentAreOfTheValueOfPureNumbersToo) {
  const Experiment e = experiment_in(folder_, replaced(bar(), "nu = 0\n", "nu = \"0.3 +- 10 %\"\n"), bar_csv);
  EXPECT_NEAR(e.tolerances.at("materials.foam.nu").half_width, 0.03, 1e-12);
}

TEST_F(Assumptions, AnErrorOfAZeroIsAConstantOfTheLoad) {
  const std::string toml =
      replaced(bar(), "trial = \"trial\"", "trial = \"trial\"\ntolerance = { pull = \"0.00001 N\" }");
  double E = 0;
  const auto shares = shares_of(toml, &E);
  // delta_i = (F_i + f) c / E with equal sigmas: dE/E = f sum F / sum F^2.
  EXPECT_NEAR(shares.at("zero of pull").error[0] / E, 1e-5 * 3e-4 / 5e-8, 1e-3);
}

TEST_F(Assumptions, TolerancesThatMeanNothingAreRefusedWithTheirPlace) {
  const auto refused = [&](const std::string& toml, const std::vector<std::string>& parts) {
    expect_input_error(
        [&] {
          const Experiment e = experiment_in(folder_, toml, bar_csv);
          const StaticReplay replay = bench_of(e);
          assumptions_of(e, replay.protocol->parameters(), replay.protocol->nominal(), dimensions_of(e));
        },
        parts);
  };
  refused(replaced(bar(), "E = \"100 kPa\"", "E = \"100 kPa +- 5 kPa\""), {"E_foam is fitted"});
  refused(replaced(bar(), "absolute = \"0.000001 mm\"", "absolute = \"0.1 mm +- 1 mm\""),
          {"noise", "a tolerance has no effect"});
  refused(replaced(bar(), "thickness = \"20 mm\"", "thickness = \"20 mm +- 0 mm\""), {"thickness", "must be positive"});
  refused(replaced(bar(), "thickness = \"20 mm\"", "thickness = \"20 mm +- 1 kg\""), {"thickness", "not a unit of"});
  refused(replaced(bar(), "trial = \"trial\"", "trial = \"trial\"\ntolerance = { pull = \"1 mm\" }"),
          {"not a unit of force"});
  refused(replaced(bar(), "trial = \"trial\"", "trial = \"trial\"\ntolerance = { push = \"1 %\" }"), {"push"});
}

TEST_F(Assumptions, EveryDimensionHasTheToleranceOfItsPlace) {
  for (Experiment e : {reference_module(1), experiment_in(folder_, bar(), bar_csv)}) {
    const StaticReplay replay = bench_of(e);
    e.mesh.depth_cells = 1;  // the thickness is a dimension too
    const std::vector<Dimension> dimensions = dimensions_of(e);
    const auto tolerance_of = [&](const Dimension& d) { return 1e-6 * static_cast<double>(&d - &dimensions[0] + 1); };
    for (const Dimension& d : dimensions) e.tolerances[d.place] = {tolerance_of(d), d.place};
    const auto all = assumptions_of(e, replay.protocol->parameters(), replay.protocol->nominal(), dimensions);
    for (const Dimension& d : dimensions) {
      const auto found = std::ranges::find(all, d.spec.id, &Assumption::id);
      ASSERT_NE(found, all.end()) << d.place;
      EXPECT_EQ(found->tolerance, tolerance_of(d)) << d.place;
    }
  }
}

/// Derivatives against differences of whole predictions, with cables, contact and a module that is nearly closed.
TEST(SlowAssumptions, DerivativesWithRespectToDimensionsAreThoseOfWholePredictions) {
  Experiment e = reference_module(1);
  const Trials trials = conditions_of({0, 8e-3, 17.68e-3}, {0.05, 0.2});
  DimensionedProtocol protocol(e, trials, dimensions_of(e));
  EXPECT_TRUE(protocol.left_out().empty());
  std::vector<int> asked;
  for (const Dimension& d : protocol.dimensions()) asked.push_back(protocol.parameters().index(d.spec.id));
  const Prediction at = protocol.predict(protocol.nominal(), asked);
  ASSERT_TRUE(at.complete());
  for (const char* id : {"gap_total", "core_height", "via_inset", "cable_offset", "web_thickness"}) {
    const auto d = std::ranges::find(protocol.dimensions(), id, [](const Dimension& one) { return one.spec.id; });
    ASSERT_NE(d, protocol.dimensions().end()) << id;
    const double h = 2e-6;
    Eigen::VectorXd sides[2];
    for (size_t k : {0u, 1u}) {
      Experiment other = e;
      d->set(other, d->value + (k == 0 ? -h : h));
      const StaticReplay replay = make_static_replay(other, other.mesh, trials);
      sides[k] = replay.protocol->predict(replay.protocol->nominal(), {}).values;
    }
    const Eigen::VectorXd differences = (sides[1] - sides[0]) / (2 * h);
    const Eigen::VectorXd exact = at.derivatives.col(d - protocol.dimensions().begin());
    EXPECT_LT((differences - exact).cwiseAbs().maxCoeff(), 0.01 * exact.cwiseAbs().maxCoeff())
        << id << "\n"
        << differences.transpose() << "\n"
        << exact.transpose();
  }
}

/// The bar is 60 mm long, and its file says something else.
TEST_F(Assumptions, AFreeLengthIsFoundFromABarsStretchAndTiedToItsModulus) {
  std::string toml = replaced(bar(), "\"60 mm\"", "\"50 mm\"");
  const double E = 0.0001 * 0.06 / (0.02 * 0.012 * 0.25e-6);
  toml = replaced(toml, "E = \"100 kPa\"", fmt::format("E = \"{} kPa\"", E / 1e3));
  const auto fitted = [&](const std::string& text) {
    const Experiment experiment = experiment_in(folder_, text, bar_csv);
    StaticBench bench(experiment, read_trials(experiment.bench));
    return fit(bench.protocol(), bench.measurements(), bench.free(), {});
  };
  const std::string modulus_alone = toml.substr(toml.find("[fit.free.E_foam]"));
  const std::string rest = toml.substr(0, toml.find("[fit.free.E_foam]"));
  const FitResult length = fitted(rest + "[fit.free.size_x]\n");
  ASSERT_EQ(length.status, FitStatus::converged) << length.message;
  EXPECT_EQ(length.parameters[0].spec.id, "size_x");
  EXPECT_NEAR(length.parameters[0].value, 0.06, 1e-4);
  EXPECT_EQ(length.parameters[0].verdict, Verdict::well_determined);
  // sigma 1 nm of readings of 0.25 and 0.5 um, twice each: dL/L = sigma / sqrt(sum y^2).
  EXPECT_NEAR(length.parameters[0].standard_error, 0.06 * 1e-9 / std::sqrt(2 * (0.25e-6 * 0.25e-6 + 0.5e-6 * 0.5e-6)),
              0.01 * length.parameters[0].standard_error);
  const FitResult both = fitted(rest + "[fit.free.size_x]\n" + modulus_alone);
  for (const ParameterEstimate& estimate : both.parameters)
    EXPECT_NE(estimate.verdict, Verdict::well_determined) << "only E / L is seen";
}

TEST_F(Assumptions, DimensionsThatAreNoneCostThePrediction) {
  const Experiment e = experiment_in(folder_, replaced(bar(), "[fit.free.E_foam]", "[fit.free.size_y]"), bar_csv);
  DimensionedProtocol protocol(e, read_trials(e.bench), free_dimensions(e));
  Params p = protocol.nominal();
  const int height = protocol.parameters().index("size_y");
  p[height] = 0;
  EXPECT_FALSE(protocol.predict(p, {height}).complete());
  p[height] = 0.012;
  EXPECT_TRUE(protocol.predict(p, {height}).complete()) << "the next one is as good as any";
}

/// Areas of the regions: of the mesh that moved, and of the shape's own.
TEST(FreeDimensions, AMovedMeshHasTheShapesRegionsAndPlaces) {
  const Experiment e = reference_module(1);
  DimensionedProtocol protocol(e, conditions_of({0}, {0.05}), dimensions_of(e));
  const auto areas_of = [](const Mesh& mesh) {
    Eigen::VectorXd areas = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(mesh.region_names.size()));
    const std::vector<double> measures = element_measures(mesh);
    for (size_t i = 0; i < measures.size(); ++i) areas[mesh.region[i]] += measures[i];
    return areas;
  };
  for (const Dimension& dimension : protocol.dimensions()) {
    Params p = protocol.nominal();
    const double length = 1.03 * dimension.value;
    p[protocol.parameters().index(dimension.spec.id)] = length;
    ASSERT_TRUE(protocol.predict(p, {}).complete()) << dimension.spec.id;
    Experiment own = e;
    dimension.set(own, length);
    const Mesh expected = make_mesh(own, own.mesh), &mesh = protocol.replay().protocol->scene().model->mesh();
    EXPECT_NEAR(mesh.diagonal(), expected.diagonal(), 1e-7 * expected.diagonal()) << dimension.spec.id;
    EXPECT_LT((areas_of(mesh) - areas_of(expected)).norm(), 1e-5 * areas_of(expected).norm()) << dimension.spec.id;
  }
}

/// A module whose gaps are not what its file says, from readings of a mesh of its own.
TEST(SlowFreeDimensions, TheGapsOfAModuleAreFoundFromItsReadings) {
  Experiment e = reference_module(1);
  Trials trials = conditions_of({0, 8e-3, 17.68e-3}, {0.05, 0.2});
  const StaticReplay truth = make_static_replay(e, e.mesh, trials);
  const Prediction readings = truth.protocol->predict(truth.protocol->nominal(), {});
  ASSERT_TRUE(readings.complete());
  for (size_t i = 0; i < trials.readings.size(); ++i) {
    trials.readings[i].value = readings.values[truth.row_of_reading[i]];
    trials.readings[i].sigma = 1e-5;
  }
  const double gaps = e.geometry.as<PushPuppet>().gap_total;
  PushPuppet said = e.geometry.as<PushPuppet>();
  said.gap_total = 1.05 * gaps;
  set_module(e, said);
  e.free.clear();
  for (const char* id : {"E_foam", "gap_total"}) e.free.emplace_back().id = id;
  e.materials[0].constants["E"] *= 1.1;
  DimensionedProtocol protocol(e, trials, free_dimensions(e));
  FitOptions options;
  options.profiles = false;
  const FitResult result = fit(protocol, protocol.replay().measurements, free_parameters(e, protocol), options);
  ASSERT_EQ(result.status, FitStatus::converged) << result.message;
  EXPECT_NEAR(result.parameters[0].value, 50e3, 25);
  EXPECT_NEAR(result.parameters[1].value, gaps, 5e-4 * gaps);
  EXPECT_LT(result.chi_squared, 0.1);
}

TEST(TotalInterval, AddsWhatCountsAsRootOfSquaresAndSaysWhatIsNotKnown) {
  ParameterEstimate e;
  e.value = 100;
  e.lower95 = 97;
  std::vector<Share> shares(3);
  shares[0] = {"mesh", {-3}, {1}, "", 0, true};
  shares[1] = {"gap_total", {0}, {50}, "", 0, false};
  shares[2] = {"plane section", {NAN}, {NAN}, "", 0, true};
  const TotalInterval total = total_interval(e, shares, 0);
  EXPECT_DOUBLE_EQ(*total.lower, 95);
  EXPECT_FALSE(total.upper.has_value()) << "open, as the noise leaves it";
  EXPECT_EQ(total.without, std::vector<std::string>{"plane section"});
}

FitResult fitted(const Bench& bench) {
  FitOptions options;
  options.profiles = false;
  const FitResult result = fit(bench.protocol(), bench.measurements(), bench.free(), options);
  EXPECT_EQ(result.status, FitStatus::converged);
  return result;
}

// A small deflection is proportional to 1/E: what the beams state of it is what they state of E.
TEST_F(Assumptions, WhatBeamsStateOfTheirRowsIsTheModelsShare) {
  folder_.write("bench.csv", "trial,pull_N,tip_mm\na,0.001,0.2\nb,0.002,0.4\n");
  const auto bench = open_bench(
      folder_.write("e.toml", replaced(beam_toml, "data = \"simulated\"", "data = \"simulated\"\nmodel = \"beam\"")));
  const FitResult result = fitted(*bench);
  const double stated = bench->model_of(0)->error;
  EXPECT_GT(stated, 0.001);
  EXPECT_NEAR(bench->model_of(1)->error, stated, 1e-3 * stated);
  const Share share = model_share(*bench, result);
  EXPECT_TRUE(share.counted);
  EXPECT_EQ(share.bias[0], 0);
  EXPECT_NEAR(share.error[0] / result.parameters[0].value, stated, 0.02 * stated);
}

TEST_F(Assumptions, WhereAModelStatesNoErrorItsShareIsNotKnown) {
  Experiment closing = read_experiment(TAUT_SOURCE_DIR "/experiments/push_puppet/experiment.toml");
  closing.model = Rung::beam;
  const auto bench = open_bench(std::move(closing));
  FitResult at_start;
  at_start.p = bench->protocol().nominal();
  for (const FreeParameter& free : bench->free()) {
    ParameterEstimate& estimate = at_start.parameters.emplace_back();
    estimate.spec = bench->protocol().parameters()[free.index];
    std::tie(estimate.value, estimate.lower, estimate.upper) = std::tie(free.start, free.lower, free.upper);
  }
  at_start.p[bench->protocol().parameters().index("slack")] = -3e-3;  // as much as further retraction: all lips closed
  const Share share = model_share(*bench, at_start);
  EXPECT_TRUE(share.how.starts_with("the models state no error for ")) << share.how;
  for (size_t j = 0; j < share.bias.size(); ++j) EXPECT_TRUE(std::isnan(share.bias[j]) && std::isnan(share.error[j]));
}

/// A bar of 10 mm of foam at "left" and 50 mm of plastic, 120 times as stiff, up to "right"; they meet at "middle".
std::string bar_of_two(const TemporaryFolder& folder) {
  folder.write("bar.msh",
               "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n5\n1 1 \"left\"\n1 2 \"right\"\n2 3 \"foam\"\n"
               "2 4 \"plastic\"\n1 5 \"middle\"\n$EndPhysicalNames\n$Nodes\n6\n1 0 0 0\n2 10 0 0\n3 60 0 0\n4 0 12 0\n"
               "5 10 12 0\n6 60 12 0\n$EndNodes\n$Elements\n7\n1 1 2 1 1 1 4\n2 1 2 2 2 3 6\n3 2 2 3 3 1 2 5\n"
               "4 2 2 3 3 1 5 4\n5 2 2 4 4 2 3 6\n6 2 2 4 4 2 6 5\n7 1 2 5 5 2 5\n$EndElements\n");
  std::string toml = replaced(bar(), "kind = \"rectangle\"\nsize = [\"60 mm\", \"12 mm\"]\nregion = \"foam\"",
                              "kind = \"msh\"\nfile = \"bar.msh\"\nunit = \"mm\"\ndimension = 2");
  toml = replaced(toml, "[mesh]\ncells = [10, 4]\nelement = \"quadratic\"\n", "");
  toml = replaced(toml, "[[support]]",
                  "[materials.plastic]\nlaw = \"neo_hookean\"\nE = \"12 MPa\"\nnu = 0\n\n[[support]]");
  toml = replaced(toml, "on = \"xmin\"", "on = \"left\"");
  for (const char* entry : {"[[load]]\nid = \"pull\"", "[[channel]]\nid = \"tip\""})
    toml = replaced(toml, entry + std::string("\non = \"xmax\""), entry + std::string("\non = \"right\""));
  return toml;
}
std::string with_rigid_segments(const std::string& toml) {
  return replaced(toml, "data = \"simulated\"", "data = \"simulated\"\nmodel = \"rigid_segments\"");
}

// In series u = F/A (l/E + L/E'): without the second a fit finds l/E + L/E' for its l/E.
TEST_F(Assumptions, WhatRigidSegmentsLeaveOutIsTheComplianceInSeries) {
  const double E = 100e3, stiff = 120 * E, compliance = 0.01 / E + 0.05 / stiff;
  const double force = 1e-4, area = 0.012 * 0.02;
  folder_.write("bench.csv",
                fmt::format("trial,pull_N,tip_mm\na,{0},{1}\nb,{0},{1}\n", force, 1e3 * force / area * compliance));
  const auto bench = open_bench(folder_.write("e.toml", with_rigid_segments(bar_of_two(folder_))));
  const FitResult result = fitted(*bench);
  EXPECT_NEAR(result.parameters[0].value, 0.01 / compliance, 1e-3 * E);
  const std::vector<Share> shares = discretisation_shares(bench->experiment(), *bench->trials_at_rest(), result);
  ASSERT_EQ(shares.back().source, "rigidity");
  const double bias = 0.01 / compliance - E;
  EXPECT_LT(bias, -0.03 * E);
  EXPECT_NEAR(shares.back().bias[0], bias, 0.03 * std::abs(bias)) << shares.back().how;
}

TEST_F(Assumptions, AConstantOfARigidRegionIsNotFitted) {
  folder_.write("bench.csv", bar_csv);
  const std::string toml = bar_of_two(folder_) + "\n[fit.free.E_plastic]\n";
  EXPECT_NO_THROW(open_bench(folder_.write("full.toml", toml))->free());
  const auto bench = open_bench(folder_.write("e.toml", with_rigid_segments(toml)));
  expect_input_error([&] { bench->free(); },
                     {"e.toml: [fit.free.E_plastic]: model = \"rigid_segments\" takes 'plastic'",
                      "no reading depends on E_plastic", "model = \"full\""});
}

// Held where the foam ends, the bar pulls at nothing of it.
TEST_F(Assumptions, AConstantOnWhichNoReadingDependsEndsTheFitBeforeItBegins) {
  folder_.write("bench.csv", bar_csv);
  const std::string toml = replaced(bar_of_two(folder_), "on = \"left\"", "on = \"middle\"");
  const auto bench = open_bench(folder_.write("e.toml", toml));
  EvaluationLog log(folder_ / "log", "test");
  expect_input_error([&] { run_fit(*bench, start_record(*bench), log, {}, {}); },
                     {"e.toml: [fit.free.E_foam]: no reading depends on it at the start", "nothing strains", "'foam'"});
}

// Free to bulge and to shrink across its thickness, a body in tension is in plane stress; one as deep as this is in
// plane strain, E / (1 - nu^2) of which plane stress takes for E.
TEST_F(Assumptions, ASectionInPlaneStressHasItsShareToo) {
  const auto share_with = [&](std::string toml, const std::string& csv) {
    folder_.write("bench.csv", csv);
    const auto bench = open_bench(folder_.write("e.toml", toml));
    const FitResult result = fitted(*bench);
    const auto share = section_share(bench->experiment(), *bench->trials_at_rest(), result);
    EXPECT_TRUE(share.has_value());
    return share ? share->bias[0] / result.parameters[0].value : NAN;
  };
  std::string toml = replaced(bar(), "nu = 0", "nu = 0.4");
  toml = replaced(toml, "fix = [\"x\", \"y\"]", "fix = [\"x\"]\n[[support]]\non = \"xmin & ymin\"\nfix = [\"y\"]");
  EXPECT_NEAR(share_with(toml, bar_csv), 0, 1e-3);
  std::string deep = replaced(replaced(beam_toml, "plane = \"strain\"", "plane = \"stress\""), "nu = 0.3", "nu = 0.4");
  deep = replaced(deep, "thickness = \"20 mm\"", "thickness = \"600 mm\"");
  EXPECT_NEAR(share_with(deep, "trial,pull_N,tip_mm\na,0.1,0.7\nb,0.1,0.7\n"), 0.16, 0.03);
}

/// The bar as `geometry` of Gmsh, with elements of 5 mm.
std::string bar_as(const std::string& geometry) {
  const std::string old = "kind = \"rectangle\"\nsize = [\"60 mm\", \"12 mm\"]\nregion = \"foam\"\n";
  return replaced(replaced(bar(), old, ""), "[mesh]\ncells = [10, 4]", geometry + "\n[mesh]\nsize = \"5 mm\"");
}

// With one corner of an end the mean of that face moves by half as much: dE/E = (1/2) dL/L, and (1/2) dh/h of a side
// that turns about its other end.
TEST_F(Assumptions, ACornerOfAPolygonCountsForHalfOfItsSide) {
  if (!has_gmsh()) GTEST_SKIP() << "meshes polygons";
  std::string toml = replaced(bar_as(R"([[geometry.polygon]]
region = "foam"
x = ["0 mm", "60 mm +- 0.3 mm", "60 mm", "0 mm +- 0.3 mm"]
y = ["0 mm", "0 mm", "12 mm +- 2 %", "12 mm"]
edges = ["", "xmax", "", "xmin"]
)"),
                              "[geometry]\n", "[geometry]\nkind = \"polygons\"\n");
  double E = 0;
  const auto shares = shares_of(toml, &E);
  EXPECT_NEAR(E, 0.0001 * 0.06 / (0.02 * 0.012 * 0.25e-6), 1e-3 * E);
  for (const auto& [source, part] :
       {std::pair("polygon_1_x_2", 0.0025), {"polygon_1_x_4", 0.0025}, {"polygon_1_y_3", 0.01}}) {
    ASSERT_TRUE(shares.contains(source)) << source;
    EXPECT_NEAR(shares.at(source).error[0] / E, part, 0.03 * part) << source;
    EXPECT_TRUE(shares.at(source).counted) << source;
  }
  EXPECT_FALSE(shares.contains("polygon_1_x_3")) << "nobody says anything of it";
}

TEST_F(Assumptions, APlaneOfABoxIsItsLength) {
  if (!has_gmsh()) GTEST_SKIP() << "meshes boxes";
  std::string toml = replaced(bar_as(R"([[geometry.box]]
region = "foam"
lower = ["0 mm", "0 mm", "0 mm"]
upper = ["60 mm +- 0.3 mm", "12 mm", "20 mm +- 0.1 mm"]
)"),
                              "[geometry]\n", "[geometry]\nkind = \"boxes\"\n");
  toml = replaced(replaced(toml, "thickness = \"20 mm\"\n", ""), "plane = \"stress\"\n", "");
  toml = replaced(toml, "fix = [\"x\", \"y\"]", "fix = [\"x\", \"y\", \"z\"]");
  for (const char* column : {"pull_N", "tip_mm"}) {
    const std::string end = std::string("\ncolumn = \"") + column + "\"";
    toml = replaced(toml, "direction = [1, 0]" + end, "direction = [1, 0, 0]" + end);
  }
  double E = 0;
  const auto shares = shares_of(toml, &E);
  EXPECT_NEAR(shares.at("box_1_upper_x").error[0], 0.005 * E, 1e-4 * E);
  EXPECT_NEAR(shares.at("box_1_upper_z").error[0], 0.005 * E, 1e-4 * E);
}

}  // namespace
}  // namespace taut::test

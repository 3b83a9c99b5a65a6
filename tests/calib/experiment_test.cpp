#include "calib/files/experiment.hpp"

#include <gtest/gtest.h>

#include <filesystem>

#include "sim/mesh/gmsh.hpp"
#include "sim/shapes/grid.hpp"
#include "sim/shapes/mesh_file.hpp"
#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"
#include "tests/support/static_bench.hpp"

namespace taut {
namespace {

using namespace test;

/// Predictions of an experiment file for its bench.
class ExperimentFile : public testing::Test {
 protected:
  StaticReplay bench_of(const std::string& toml, const std::string& csv) const {
    return test::bench_of(experiment_in(folder_, toml, csv));
  }

  /// Predicted readings, in the order of the file.
  std::vector<double> predictions(const std::string& toml, const std::string& csv) const {
    const StaticReplay bench = bench_of(toml, csv);
    const Prediction prediction = predicted(bench);
    std::vector<double> values;
    for (const int row : bench.row_of_reading) values.push_back(prediction.values[row]);
    return values;
  }

  /// Two descriptions of the same thing predict the same, and something.
  void expect_equal(const std::string& a, const std::string& a_csv, const std::string& b,
                    const std::string& b_csv) const {
    const std::vector<double> x = predictions(a, a_csv), y = predictions(b, b_csv);
    ASSERT_EQ(x.size(), y.size());
    for (size_t i = 0; i < x.size(); ++i) {
      EXPECT_GT(std::abs(x[i]), 1e-5);
      EXPECT_NEAR(x[i], y[i], 1e-8 * std::abs(x[i]));
    }
  }

  TemporaryFolder folder_;
};

TEST_F(ExperimentFile, TheSiliconeBlockIsReadInSiUnits) {
  const Experiment e = read_experiment(TAUT_SOURCE_DIR "/experiments/silicone_block/experiment.toml");
  EXPECT_FALSE(e.simulated);
  EXPECT_EQ(e.geometry.kind(), "box");
  EXPECT_EQ(e.geometry.as<Box>().size, (std::vector{0.1, 0.03, 0.03}));
  EXPECT_EQ(e.geometry.as<Box>().origin, (std::vector{-0.1, 0.0, 0.0}));
  EXPECT_EQ(e.mesh.cells, (std::vector{14, 5, 5}));
  EXPECT_EQ(e.mesh.order, 2);
  EXPECT_EQ(e.mesh.formulation, Formulation::locking_free);
  EXPECT_EQ(e.mesh.describe(), "quadratic, locking-free, 14 x 5 x 5 cells");
  ASSERT_EQ(e.materials.size(), 1u);
  EXPECT_EQ(e.materials[0].constants.at("E"), 2e5);
  EXPECT_EQ(e.materials[0].constants.at("nu"), 0.499);
  EXPECT_EQ(*e.materials[0].density, 1070);
  EXPECT_EQ(e.gravity, 9.80709);
  EXPECT_EQ(e.gravity_direction, (std::vector{0.0, 0.0, -1.0}));
  EXPECT_EQ(e.supports[0].fix, (std::vector{0, 1, 2}));
  EXPECT_EQ(e.loads[0].on, "xmax & zmax");
  EXPECT_EQ(e.loads[0].quantity, Quantity::force);
  ASSERT_EQ(e.channels.size(), 3u);
  EXPECT_EQ(e.channels[1].point, (std::vector{0.0, 0.0, 0.024}));
  EXPECT_EQ(e.channels[1].standoff, (std::vector{0.0, -0.006, 0.0}));
  EXPECT_EQ(e.channels[1].turns_with, "xmax");
  EXPECT_FALSE(e.from_unloaded);
  ASSERT_EQ(e.variants.size(), 6u);
  EXPECT_EQ(e.variants[0].mesh.order, 1);
  EXPECT_EQ(e.variants[0].mesh.formulation, Formulation::standard);
  EXPECT_EQ(e.variants[5].mesh.formulation, Formulation::locking_free) << "what a variant does not say stays";
  EXPECT_EQ(e.variants[5].mesh.cells, (std::vector{20, 7, 7}));
  EXPECT_EQ(e.references.size(), 2u);

  const Trials trials = read_trials(e.bench);
  ASSERT_EQ(trials.readings.size(), 18u);
  EXPECT_DOUBLE_EQ(trials.readings[6].controls[0], 0.51012);
  EXPECT_DOUBLE_EQ(trials.readings[6].value, -0.017147);
  EXPECT_DOUBLE_EQ(trials.readings[6].sigma, 0.0003);

  MeshSettings coarse = e.mesh;
  coarse.cells = {4, 1, 1};
  const StaticReplay bench = make_static_replay(e, coarse, trials);
  EXPECT_EQ(bench.protocol->row_count(), 9) << "repeats share their row";
  EXPECT_EQ(bench.protocol->conditions().size(), 3u);
  const std::vector<FreeParameter> free = free_parameters(e, *bench.protocol);
  ASSERT_EQ(free.size(), 1u);
  EXPECT_EQ(free[0].start, 1e5);
  EXPECT_EQ(free[0].lower, 1e4);
  EXPECT_EQ(free[0].upper, 1e7);
}

TEST_F(ExperimentFile, RepeatsShareARowAndFormAGroup) {
  const StaticReplay bench = bench_of(beam_toml, beam_csv);
  EXPECT_EQ(bench.row_of_reading, (std::vector{0, 1, 0, 1}));
  ASSERT_EQ(bench.measurements.size(), 4u);
  EXPECT_EQ(bench.measurements[0].group, bench.measurements[2].group);
  EXPECT_NE(bench.measurements[0].group, bench.measurements[1].group);
  EXPECT_DOUBLE_EQ(bench.measurements[1].value, 0.002);
  EXPECT_DOUBLE_EQ(bench.measurements[1].sigma, 1e-4);
}

TEST_F(ExperimentFile, StartAndBoundsThatAreNotGivenComeFromTheModel) {
  folder_.write("bench.csv", beam_csv);
  const std::string toml =
      replaced(beam_toml, "start = \"50 kPa\"\nlower = \"1 kPa\"\nupper = \"10 MPa\"\n", "[fit.free.nu_foam]\n");
  const Experiment e = read_experiment(folder_.write("experiment.toml", toml));
  const StaticReplay bench = make_static_replay(e, e.mesh, read_trials(e.bench));
  const std::vector<FreeParameter> free = free_parameters(e, *bench.protocol);
  ASSERT_EQ(free.size(), 2u);
  for (const FreeParameter& parameter : free) {
    const ParameterSpec& spec = bench.protocol->parameters()[parameter.index];
    EXPECT_EQ(parameter.start, spec.id == "E_foam" ? 1e5 : 0.3);
    EXPECT_EQ(parameter.lower, spec.id == "E_foam" ? 100 : spec.lower);  // of soft materials, where they start as one
    EXPECT_EQ(parameter.upper, spec.id == "E_foam" ? 1e9 : spec.upper);
  }
}

// ---- loads, each against another way to say the same

TEST_F(ExperimentFile, ARobustFitIsMadeWhereTheFileAsksForIt) {
  const auto asked = [&](const std::string& toml) {
    return read_experiment(folder_.write("experiment.toml", toml)).robust;
  };
  EXPECT_FALSE(asked(beam_toml));
  EXPECT_TRUE(asked(beam_toml + "\n[fit]\nrobust = \"student\"\n"));
}

TEST_F(ExperimentFile, AnExcludedReadingWithoutRepeatsCostsNoSimulation) {
  folder_.write("bench.csv", beam_csv + "b,7,3\n");
  const std::string toml = replaced(beam_toml, "trial = \"trial\"", "trial = \"trial\"\nexclude = [4, 6]");
  const Experiment e = read_experiment(folder_.write("experiment.toml", toml));
  const StaticReplay bench = make_static_replay(e, e.mesh, read_trials(e.bench));
  EXPECT_EQ(bench.protocol->row_count(), 2);
  EXPECT_EQ(bench.measurements.size(), 3u);
  EXPECT_EQ(bench.row_of_reading, (std::vector<int>{0, 1, 0, 1, -1}));
}

TEST_F(ExperimentFile, TheMeshsShareIsAskedForUnlessTheFileSaysNo) {
  const auto asked = [&](const std::string& toml) {
    return read_experiment(folder_.write("experiment.toml", toml)).mesh_share;
  };
  EXPECT_TRUE(asked(beam_toml));
  EXPECT_FALSE(asked(beam_toml + "\n[fit]\nmesh_share = false\n"));
}

TEST_F(ExperimentFile, AHungMassIsItsWeight) {
  expect_equal(beam_toml, "trial,pull_N,tip_mm\na,0.0981,1\nb,0.04905,1\n", replaced(beam_toml, "pull_N", "mass_g"),
               "trial,mass_g,tip_mm\na,10,1\nb,5,1\n");
  expect_equal(beam_toml, "trial,pull_N,tip_mm\na,0.02,1\n",
               replaced(beam_toml, "pull_N", "mass_kg") + "[gravity]\nacceleration = \"2 m/s2\"\nself_weight = false\n",
               "trial,mass_kg,tip_mm\na,0.01,1\n");
}

TEST_F(ExperimentFile, ATractionIsAForceOverTheRestArea) {
  // 12 mm x 20 mm = 240 mm^2
  expect_equal(beam_toml, "trial,pull_N,tip_mm\na,0.048,1\n", replaced(beam_toml, "pull_N", "pull_Pa"),
               "trial,pull_Pa,tip_mm\na,200,1\n");
}

TEST_F(ExperimentFile, ALineLoadOnACornerIsAForceOverTheThickness) {
  const std::string corner = replaced(beam_toml, "on = \"xmax\"\ndirection = [0, -1]\ncolumn = \"pull_N\"",
                                      "on = \"xmax & ymax\"\ndirection = [0, -1]\ncolumn = \"pull_N\"");
  const std::string point = replaced(corner, "on = \"xmax & ymax\"", "point = [\"60 mm\", \"12 mm\"]");
  expect_equal(corner, "trial,pull_N,tip_mm\na,0.05,1\n", point, "trial,pull_N,tip_mm\na,0.05,1\n");
  expect_equal(corner, "trial,pull_N,tip_mm\na,0.05,1\n", replaced(corner, "pull_N", "pull_N_per_m"),
               "trial,pull_N_per_m,tip_mm\na,2.5,1\n");
}

TEST_F(ExperimentFile, AConstantLoadIsAColumnWithTheSameValue) {
  const std::string constant = replaced(beam_toml, "column = \"pull_N\"", "value = \"50 mN\"");
  const std::string idle = "\n[[load]]\nid = \"idle\"\non = \"ymax\"\ndirection = [0, -1]\ncolumn = \"idle_N\"\n";
  expect_equal(beam_toml, "trial,pull_N,tip_mm\na,0.05,1\n", constant + idle, "trial,idle_N,tip_mm\na,0,1\n");
  const StaticReplay bench = bench_of(constant + idle, "trial,idle_N,tip_mm\na,0,1\n");
  EXPECT_EQ(bench.protocol->controls().size(), 1u) << "a constant load is not a control";
}

TEST_F(ExperimentFile, MeasuredFromUnloadedLeavesOutWhatConstantLoadsDo) {
  const std::string constant =
      beam_toml + "[[load]]\nid = \"dead\"\non = \"ymax\"\ndirection = [0, -1]\nvalue = \"4 g\"\n";
  const std::string csv = "trial,pull_N,tip_mm\na,0,1\na,0.05,1\n";
  const std::vector<double> rest = predictions(constant, csv);
  const std::vector<double> unloaded =
      predictions(replaced(constant, "trial = \"trial\"", "trial = \"trial\"\nmeasured_from = \"unloaded\""), csv);
  EXPECT_GT(rest[0], 1e-4);
  EXPECT_EQ(unloaded[0], 0);
  EXPECT_NEAR(unloaded[1], rest[1] - rest[0], 1e-9);
}

TEST_F(ExperimentFile, APrescribedDisplacementIsReached) {
  const std::string toml = replaced(beam_toml, "[[load]]",
                                    "[[support]]\non = \"xmax\"\nmove = \"y\"\nid = \"travel\"\n"
                                    "column = \"travel_mm\"\n\n[[load]]");
  const std::vector<double> tip = predictions(toml, "trial,pull_N,travel_mm,tip_mm\na,0,-3,1\na,0.1,2,1\n");
  EXPECT_NEAR(tip[0], 0.003, 1e-12) << "the channel looks down";
  EXPECT_NEAR(tip[1], -0.002, 1e-12);
}

// ---- geometries, each against the bar: u = F L / (E A) + rho g L^2 / (2 E) at small strain

/// A bar 60 mm long, 12 x 20 mm^2, E = 100 kPa, nu = 0 unless said, pulled in x by 1 mN; supports and tags are the
/// caller's.
std::string bar(const std::string& geometry, const std::string& mesh, const std::string& supports, bool solid = false) {
  const std::string direction = solid ? "[1, 0, 0]" : "[1, 0]";
  return "title = \"A bar\"\ndata = \"simulated\"\n" + geometry + "[mesh]\n" + mesh + supports +
         "[[load]]\nid = \"pull\"\non = \"xmax\"\ndirection = " + direction + "\ncolumn = \"pull_N\"\n" +
         "[[channel]]\nid = \"end\"\non = \"xmax\"\ndirection = " + direction +
         "\ncolumn = \"end_um\"\nnoise = { absolute = \"1 um\" }\n[bench]\nfile = \"bench.csv\"\n";
}
std::string material(const std::string& region, const std::string& E, const std::string& nu) {
  return "[materials." + region + "]\nE = \"" + E + "\"\nnu = " + nu + "\ndensity = \"1000 kg/m3\"\n";
}
const std::string plane_supports =
    "[[support]]\non = \"xmin\"\nfix = [\"x\"]\n[[support]]\non = \"xmin & ymin\"\nfix = [\"y\"]\n";
const std::string solid_supports =
    "[[support]]\non = \"xmin\"\nfix = [\"x\"]\n[[support]]\non = \"xmin & ymin\"\nfix = [\"y\"]\n"
    "[[support]]\non = \"xmin & zmin\"\nfix = [\"z\"]\n";
const std::string bar_csv = "pull_N,end_um\n0.001,1\n";
constexpr double kStretch = 0.001 * 0.06 / (1e5 * 0.012 * 0.020);  ///< F L / (E A) [m]

std::string plane_bar(const std::string& plane) {
  return "[geometry]\nkind = \"rectangle\"\nsize = [\"60 mm\", \"12 mm\"]\nregion = \"bar\"\nthickness = \"2 cm\"\n"
         "plane = \"" +
         plane + "\"\n";
}

TEST_F(ExperimentFile, ARectangleInPlaneStressStretchesByItsYoungsModulus) {
  const std::string toml =
      bar(plane_bar("stress"), "cells = [4, 2]\n", material("bar", "100 kPa", "0.4") + plane_supports);
  EXPECT_NEAR(predictions(toml, bar_csv)[0], kStretch, 1e-3 * kStretch);
}

TEST_F(ExperimentFile, ARectangleInPlaneStrainIsStifferByOneMinusNuSquared) {
  const std::string toml =
      bar(plane_bar("strain"), "cells = [4, 2]\n", material("bar", "100 kPa", "0.4") + plane_supports);
  EXPECT_NEAR(predictions(toml, bar_csv)[0], (1 - 0.16) * kStretch, 1e-3 * kStretch);
}

TEST_F(ExperimentFile, ABoxStretchesByItsYoungsModulus) {
  const std::string toml =
      bar("[geometry]\nkind = \"box\"\nsize = [\"60 mm\", \"12 mm\", \"20 mm\"]\n"
          "origin = [\"1 m\", \"0 mm\", \"-2 cm\"]\nregion = \"bar\"\n",
          "cells = [3, 1, 1]\n", material("bar", "100 kPa", "0.4") + solid_supports, true);
  EXPECT_NEAR(predictions(toml, bar_csv)[0], kStretch, 1e-3 * kStretch);
}

TEST_F(ExperimentFile, SelfWeightStretchesAHangingBar) {
  const std::string toml =
      bar(plane_bar("stress"), "cells = [8, 2]\n", material("bar", "100 kPa", "0.0") + plane_supports) +
      "[gravity]\ndirection = [2, 0]\nacceleration = \"0.1 m/s2\"\n";
  const double weight = 1000 * 0.1 * 0.06 * 0.06 / (2 * 1e5);
  EXPECT_NEAR(predictions(toml, "pull_N,end_um\n0,1\n")[0], weight, 1e-3 * weight);
  EXPECT_NEAR(predictions(toml, bar_csv)[0], weight + kStretch, 1e-3 * weight);
}

TEST_F(ExperimentFile, ALineLoadOnAnEdgeOfABoxIsAForceOverItsLength) {
  const std::string box = bar(
      "[geometry]\nkind = \"box\"\nsize = [\"60 mm\", \"12 mm\", \"20 mm\"]\nregion = \"bar\"\n", "cells = [3, 1, 1]\n",
      material("bar", "100 kPa", "0.3") + "[[support]]\non = \"xmin\"\nfix = [\"x\", \"y\", \"z\"]\n", true);
  const std::string edge = replaced(box, "on = \"xmax\"\ndirection = [1, 0, 0]\ncolumn = \"pull_N\"",
                                    "on = \"xmax & zmax\"\ndirection = [1, 0, 0]\ncolumn = \"pull_N\"");
  expect_equal(edge, "pull_N,end_um\n0.012,1\n", replaced(edge, "pull_N", "pull_N_per_m"),
               "pull_N_per_m,end_um\n1,1\n");
}

TEST_F(ExperimentFile, PolygonsWithNamedEdgesAreBondedWhereTheyTouch) {
  if (!has_gmsh()) GTEST_SKIP() << "built without Gmsh";
  const std::string toml =
      bar("[geometry]\nkind = \"polygons\"\nthickness = \"20 mm\"\nplane = \"stress\"\n"
          "[[geometry.polygon]]\nregion = \"left\"\nx = [\"0 mm\", \"30 mm\", \"30 mm\", \"0 mm\"]\n"
          "y = [\"0 mm\", \"0 mm\", \"12 mm\", \"12 mm\"]\nedges = [\"bottom\", \"\", \"\", \"wall\"]\n"
          "[[geometry.polygon]]\nregion = \"right\"\nx = [\"30 mm\", \"60 mm\", \"60 mm\", \"30 mm\"]\n"
          "y = [\"0 mm\", \"0 mm\", \"12 mm\", \"12 mm\"]\nedges = [\"bottom\", \"end\", \"\", \"\"]\n",
          "size = \"6 mm\"\nelement = \"linear\"\n",
          material("left", "100 kPa", "0.0") + material("right", "300 kPa", "0.0") +
              "[[support]]\non = \"wall\"\nfix = [\"x\"]\n[[support]]\non = \"wall & bottom\"\nfix = [\"y\"]\n");
  std::string named = toml;
  for (size_t at; (at = named.find("\"xmax\"")) != std::string::npos;) named.replace(at, 6, "\"end\"");
  const double stretch = 0.5 * kStretch * (1 + 1.0 / 3);
  EXPECT_NEAR(predictions(named, bar_csv)[0], stretch, 1e-3 * stretch);
}

TEST_F(ExperimentFile, TouchingBoxesAreBonded) {
  if (!has_gmsh()) GTEST_SKIP() << "built without Gmsh";
  const std::string toml =
      bar("[geometry]\nkind = \"boxes\"\n"
          "[[geometry.box]]\nregion = \"left\"\nlower = [\"0 mm\", \"0 mm\", \"0 mm\"]\nupper = [\"30 mm\", \"12 mm\", "
          "\"20 mm\"]\n"
          "[[geometry.box]]\nregion = \"right\"\nlower = [\"30 mm\", \"0 mm\", \"0 mm\"]\nupper = [\"60 mm\", \"12 "
          "mm\", \"20 mm\"]\n",
          "size = \"10 mm\"\n",
          material("left", "100 kPa", "0.0") + material("right", "300 kPa", "0.0") + solid_supports, true);
  const double stretch = 0.5 * kStretch * (1 + 1.0 / 3);
  EXPECT_NEAR(predictions(toml, bar_csv)[0], stretch, 1e-3 * stretch);
}

const std::string bar_msh = R"($MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
3
1 1 "xmin"
1 2 "xmax"
2 3 "bar"
$EndPhysicalNames
$Nodes
4
1 0 0 0
2 60 0 0
3 60 12 0
4 0 12 0
$EndNodes
$Elements
4
1 1 2 1 1 1 4
2 1 2 2 2 2 3
3 2 2 3 1 1 2 3
4 2 2 3 1 1 3 4
$EndElements
)";

TEST_F(ExperimentFile, AMeshFileIsReadBesideTheExperimentInItsUnit) {
  folder_.write("bar.msh", bar_msh);
  const std::string geometry =
      "[geometry]\nkind = \"msh\"\nfile = \"bar.msh\"\nunit = \"mm\"\ndimension = 2\nthickness = \"20 mm\"\nplane = "
      "\"stress\"\n";
  const std::string rest = material("bar", "100 kPa", "0.0") + "[[support]]\non = \"xmin\"\nfix = [\"x\", \"y\"]\n";
  for (const std::string element : {"linear", "quadratic"}) {
    const StaticReplay bench = bench_of(bar(geometry, "element = \"" + element + "\"\n", rest), bar_csv);
    EXPECT_EQ(bench.protocol->scene().model->mesh().node_count(), element == "linear" ? 4 : 9);
    EXPECT_NEAR(bench.protocol->predict(bench.protocol->nominal(), {}).values[0], kStretch, 1e-3 * kStretch);
  }
  const auto refuse = [&](const std::string& from, const std::string& to, const std::vector<std::string>& parts) {
    SCOPED_TRACE(to);
    expect_input_error([&] { bench_of(replaced(bar(geometry, "", rest), from, to), bar_csv); }, parts);
  };
  std::string solid = bar(geometry, "", rest, true);
  solid = replaced(solid, "dimension = 2\nthickness = \"20 mm\"\nplane = \"stress\"\n", "dimension = 3\n");
  expect_input_error([&] { bench_of(solid, bar_csv); }, {"[geometry]", "bar.msh is a 2D mesh", "dimension = 2"});
  refuse("unit = \"mm\"", "unit = \"mN\"", {"[geometry] unit", "'mN' is not a unit of length"});
  refuse("unit = \"mm\"\n", "", {"[geometry]", "'unit' is missing"});
  refuse("bar.msh", "bra.msh", {"[geometry]", "bra.msh"});
}

/// Two halves in a row; the end and an element are listed twice.
const std::string halves_msh = R"($MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
4
1 1 "xmin"
1 2 "xmax"
2 3 "left"
2 4 "right"
$EndPhysicalNames
$Nodes
8
1 0 0 0
2 30 0 0
3 60 0 0
4 0 12 0
5 30 12 0
6 60 12 0
7 30 0 0
8 30 12 0
$EndNodes
$Elements
8
1 1 2 1 1 1 4
2 1 2 2 2 3 6
3 1 2 2 2 6 3
4 2 2 3 1 1 2 5
5 2 2 3 1 1 5 4
6 2 2 4 1 2 3 6
7 2 2 4 1 2 6 5
8 2 2 4 1 6 5 2
$EndElements
)";

TEST_F(ExperimentFile, AMeshFileCountsOnceWhatItListsTwiceAndIsOneBody) {
  folder_.write("bar.msh", halves_msh);
  const std::string toml = replaced(bar("[geometry]\nkind = \"msh\"\nfile = \"bar.msh\"\nunit = \"mm\"\ndimension = "
                                        "2\nthickness = \"20 mm\"\nplane = "
                                        "\"stress\"\n",
                                        "",
                                        material("left", "100 kPa", "0.0") + material("right", "300 kPa", "0.0") +
                                            "[[support]]\non = \"xmin\"\nfix = [\"x\", \"y\"]\n"),
                                    "pull_N", "pull_kPa");
  const std::string csv = "pull_kPa,end_um\n0.01,1\n";
  const double stretch = 10 * 0.03 * (1 / 1e5 + 1 / 3e5);  // traction times length over E, of each half
  EXPECT_NEAR(predictions(toml, csv)[0], stretch, 1e-3 * stretch);
  // The right half with nodes of its own would hang on nothing.
  folder_.write("bar.msh", replaced(replaced(replaced(halves_msh, "2 3 6\n7", "7 3 6\n7"), "2 6 5\n8", "7 6 8\n8"),
                                    "6 5 2\n$", "6 8 7\n$"));
  expect_input_error([&] { bench_of(toml, csv); },
                     {"[geometry]", "two nodes coincide at (30, 0) mm, and 1 pair elsewhere", "Coherence"});
}

TEST_F(ExperimentFile, AMeshOfQuadraticElementsCannotBeUsedAsLinear) {
  folder_.write("bar.msh", R"($MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
1
2 3 "bar"
$EndPhysicalNames
$Nodes
6
1 0 0 0
2 1 0 0
3 0 1 0
4 0.5 0 0
5 0.5 0.5 0
6 0 0.5 0
$EndNodes
$Elements
1
1 9 2 3 1 1 2 3 4 5 6
$EndElements
)");
  Experiment experiment;
  experiment.path = "experiment.toml";
  MeshFile bar;
  bar.file.path = folder_ / "bar.msh";
  bar.axes = 2;
  experiment.geometry.shape = std::make_shared<MeshFile>(bar);
  experiment.geometry.dimension = 2;
  experiment.mesh.order = 1;
  expect_input_error([&] { make_mesh(experiment, experiment.mesh); },
                     {"experiment.toml", "quadratic elements", "element = \"quadratic\""});
  experiment.mesh.order = 2;
  EXPECT_EQ(make_mesh(experiment, experiment.mesh).node_count(), 6);
}

TEST_F(ExperimentFile, ARunsCopyOfItsGeometryKeepsTheEndingThatTellsWhatItIs) {
  folder_.write("bar.msh", halves_msh);
  Experiment experiment = experiment_in(
      folder_,
      replaced(
          bar("[geometry]\nkind = \"msh\"\nfile = \"bar.msh\"\nunit = \"mm\"\ndimension = 2\nthickness = \"20 mm\"\n"
              "plane = \"stress\"\n",
              "",
              material("left", "100 kPa", "0.0") + material("right", "300 kPa", "0.0") +
                  "[[support]]\non = \"xmin\"\nfix = [\"x\", \"y\"]\n"),
          "pull_N", "pull_kPa"),
      "pull_kPa,end_um\n0.01,1\n");
  EXPECT_EQ(inputs_of(experiment).back().copy, "mesh.msh");
  set_input_file(experiment.geometry, "part.step");
  EXPECT_EQ(inputs_of(experiment).back().copy, "mesh.step");
}

TEST_F(ExperimentFile, ARunsCopyOfAGeometryBringsWhatThatTakesIn) {
  if (!has_gmsh()) GTEST_SKIP() << "reads a .geo";
  namespace fs = std::filesystem;
  fs::create_directories(folder_ / "parts");
  fs::create_directories(folder_ / "run");
  folder_.write("parts/bar.geo",
                "SetFactory(\"OpenCASCADE\");\nRectangle(1) = {0, 0, 0, 60, 12};\nMesh.MeshSizeMax = 6;\n"
                "Physical Surface(\"bar\") = {1};\nPhysical Curve(\"xmin\") = {4};\nPhysical Curve(\"xmax\") = {2};\n");
  folder_.write("outline.geo", "Merge \"parts/bar.geo\";\n");
  const std::string toml =
      bar("[geometry]\nkind = \"msh\"\nfile = \"outline.geo\"\nunit = \"mm\"\ndimension = 2\nthickness = \"20 mm\"\n",
          "", material("bar", "100 kPa", "0.0") + "[[support]]\non = \"xmin\"\nfix = [\"x\", \"y\"]\n");
  const Experiment experiment = experiment_in(folder_, toml, bar_csv);
  const std::vector<RunInput> inputs = inputs_of(experiment);
  EXPECT_EQ(inputs.back().copy, "parts/bar.geo");
  for (const RunInput& input : inputs) {
    const fs::path copy = fs::path(folder_ / "run") / input.copy;
    fs::create_directories(copy.parent_path());
    fs::copy_file(input.path, copy);
  }
  fs::remove_all(folder_ / "parts");
  fs::remove(folder_ / "outline.geo");
  const Experiment later = read_copies(folder_ / "run");
  EXPECT_NEAR(total_measure(make_mesh(later, later.mesh)), 0.06 * 0.012, 1e-12);

  fs::create_directories(folder_ / "sub");
  folder_.write("sub/outline.geo", "Merge \"../run/parts/bar.geo\";\n");
  expect_input_error(
      [&] { inputs_of(experiment_in(folder_, replaced(toml, "outline.geo", "sub/outline.geo"), bar_csv)); },
      {"sub/outline.geo: it takes in '../run/parts/bar.geo', which does not lie beside or below it", ".msh"});
}
TEST_F(ExperimentFile, LoadsForFiguresAreInNewtons) {
  Experiment experiment;
  experiment.gravity = 10;
  EXPECT_EQ(load_in_newtons(experiment, Quantity::mass, 0.1), 1);
  EXPECT_EQ(load_in_newtons(experiment, Quantity::force, 0.1), 0.1);
}

}  // namespace
}  // namespace taut

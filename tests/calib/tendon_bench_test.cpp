#include <gtest/gtest.h>

#include <algorithm>

#include "calib/benches/assumptions.hpp"
#include "calib/runs/open_bench.hpp"
#include "tests/support/message.hpp"
#include "tests/support/static_bench.hpp"

// Benches whose cables are held at tensions and whose markers stand off a body's axis: their files.
namespace taut {
namespace {

using namespace test;

const std::string tendons_toml = text_of(TAUT_SOURCE_DIR "/tests/support/tendons.toml");
const std::string tendons_csv =
    "left_N,right_N,marker,x_mm,y_mm,z_mm\n1,0,tip,0,20,-100\n1,0,side,12,5,-50\n0,2,tip,0,-40,-90\n0,2,side,12,-9,-"
    "48\n";

class TendonBench : public testing::Test {
 protected:
  std::unique_ptr<Bench> open(const std::string& toml) const {
    folder_.write("bench.csv", csv_);
    std::unique_ptr<Bench> bench = open_bench(folder_.write("arm.toml", toml));
    bench->free();
    return bench;
  }
  /// Opening it with `from` replaced by `to` fails with a message that names the file and holds all `parts`.
  void refuses(const std::string& from, const std::string& to, std::vector<std::string> parts) const {
    SCOPED_TRACE(to);
    parts.emplace_back("arm.toml");
    expect_input_error([&] { open(replaced(tendons_toml, from, to)); }, parts);
  }

  TemporaryFolder folder_;
  std::string csv_ = tendons_csv;
};

TEST_F(TendonBench, HasAChannelForEachCoordinateAndAControlForEachTendon) {
  const std::unique_ptr<Bench> bench = open(tendons_toml);
  std::vector<std::string> ids;
  for (const AxisRecord& channel : bench->channels()) ids.push_back(channel.id);
  EXPECT_EQ(ids, (std::vector<std::string>{"tip_x", "tip_y", "tip_z", "side_x", "side_y", "side_z"}));
  ASSERT_EQ(bench->controls().size(), 2u);
  EXPECT_EQ(bench->controls()[0].id, "left");
  EXPECT_EQ(bench->controls()[0].unit, "N");
  EXPECT_EQ(bench->readings().size(), 12u);
  EXPECT_TRUE(bench->protocol().parameters().contains("tension_scale"));
  EXPECT_FALSE(bench->protocol().parameters().contains("k_cable"));
}

TEST_F(TendonBench, AtNoTensionAMarkerIsWhereItHangs) {
  // Own weight alone stretches the arm: u(s) = int_s' (weight below)/(E A), far below a millimetre for a stiff one.
  csv_ = "left_N,right_N,marker,x_mm,y_mm,z_mm\n0,0,tip,0,0,-104\n0,0,side,12,0,-50\n";
  const std::unique_ptr<Bench> bench = open(replaced(tendons_toml, "E = \"300 kPa\"", "E = \"300 GPa\""));
  const Prediction there = bench->protocol().predict(bench->protocol().nominal(), {});
  ASSERT_TRUE(there.complete());
  for (const BenchReading& reading : bench->readings()) EXPECT_NEAR(there.values[reading.row], reading.value, 1e-8);
}

TEST_F(TendonBench, ATorqueOnASpoolIsATension) {
  const std::unique_ptr<Bench> by_force = open(tendons_toml);
  csv_ = replaced(tendons_csv, "left_N,right_N", "left_mNm,right_N");
  csv_ = replaced(replaced(csv_, "\n1,0,tip", "\n32.5,0,tip"), "\n1,0,side", "\n32.5,0,side");
  const std::unique_ptr<Bench> by_torque =
      open(replaced(tendons_toml, "tension = \"left_N\"", "tension = \"left_mNm\"\nspool = \"32.5 mm\""));
  const Prediction force = by_force->protocol().predict(by_force->protocol().nominal(), {}),
                   torque = by_torque->protocol().predict(by_torque->protocol().nominal(), {});
  ASSERT_TRUE(force.complete() && torque.complete());
  EXPECT_LT((force.values - torque.values).cwiseAbs().maxCoeff(), 1e-9);
}

TEST_F(TendonBench, APullOnOneSideMirrorsThatOnTheOther) {
  csv_ = "left_N,right_N,marker,x_mm,y_mm,z_mm\n1,0,tip,0,0,0\n0,1,tip,0,0,0\n";
  const std::unique_ptr<Bench> bench = open(tendons_toml);
  const Eigen::VectorXd values = bench->protocol().predict(bench->protocol().nominal(), {}).values;
  ASSERT_EQ(values.size(), 6);
  EXPECT_GT(values[1], 5e-3);  // towards the tendon that pulls
  EXPECT_NEAR(values[4], -values[1], 1e-9);
  EXPECT_NEAR(values[5], values[2], 1e-9);
  EXPECT_NEAR(values[0], 0, 1e-9);
}

TEST_F(TendonBench, ATurnedBaseTurnsWhatIsWithoutWeight) {
  const std::string light =
      replaced(replaced(tendons_toml, "[gravity]\ndirection = [0, 0, -1]\n", ""), "[fit.free.density_arm]\n", "");
  const std::unique_ptr<Bench> level = open(light);
  const std::unique_ptr<Bench> turned = open(replaced(
      light, "[[support]]",
      "[base]\nturn = [\"30 deg\", \"0 deg\", \"0 deg\"]\nat = [\"0 mm\", \"1 mm\", \"0 mm\"]\n\n[[support]]"));
  const Eigen::VectorXd a = level->protocol().predict(level->protocol().nominal(), {}).values,
                        b = turned->protocol().predict(turned->protocol().nominal(), {}).values;
  ASSERT_EQ(a.size(), b.size());
  for (Eigen::Index i = 0; i < a.size(); i += 3) {
    const double c = std::cos(M_PI / 6), s = std::sin(M_PI / 6);
    EXPECT_NEAR(b[i], a[i], 1e-7);
    EXPECT_NEAR(b[i + 1], c * a[i + 1] - s * a[i + 2] + 1e-3, 1e-7);
    EXPECT_NEAR(b[i + 2], s * a[i + 1] + c * a[i + 2], 1e-7);
  }
}

// What an independent rod found in the same readings (data/tentacle/README.md): E and density with their errors, and
// how far it stays from the measured places.
TEST_F(TendonBench, TheMeasuredArmHasTheModulusAndDensityThatAnIndependentRodFinds) {
  const std::unique_ptr<Bench> bench = open_bench(TAUT_SOURCE_DIR "/experiments/tentacle/experiment.toml");
  const FitResult result = fit(bench->protocol(), bench->measurements(), bench->free());
  ASSERT_EQ(result.status, FitStatus::converged);
  EXPECT_NEAR(result.parameters[0].value, 376.7e3, 15e3);
  EXPECT_NEAR(result.parameters[1].value, 1136, 90);
  double squares = 0;
  for (const BenchReading& reading : bench->readings())
    squares += std::pow(result.predicted[reading.row] - reading.value, 2);
  EXPECT_LT(std::sqrt(squares / 64), 13e-3);
  // Statics know forces up to a common factor only.
  for (const VariantSettings& variant : bench->experiment().variants) {
    if (variant.free.size() != 1 || variant.free.front().id != "tension_scale") continue;
    const std::unique_ptr<Bench> scaled = bench->with(variant);
    FitOptions how;
    how.profiles = how.recover = false;
    const FitResult of_scaled = fit(scaled->protocol(), scaled->measurements(), scaled->starts_after(result), how);
    ASSERT_EQ(of_scaled.parameters.size(), 3u);
    for (const ParameterEstimate& e : of_scaled.parameters) EXPECT_EQ(e.verdict, Verdict::tied) << e.spec.id;
    return;
  }
  ADD_FAILURE() << "no variant frees the factor of all tensions";
}

TEST_F(TendonBench, DrivesThatContradictThemselvesAreRefused) {
  refuses("tension = \"left_N\"", "tension = \"left_N\"\nretraction = \"left_mm\"",
          {"[cables.cable] tension", "by its retraction or by its tension"});
  refuses("tension = \"left_N\"", "tension = \"-5 N\"", {"[cables.cable] tension", "cannot push"});
  refuses("tension = \"left_N\"", "tension = \"5 mm\"", {"[cables.cable] tension", "neither a force", "nor a torque"});
  refuses("tension = \"left_N\"", "tension = \"0.2 Nm\"", {"[cables.cable] tension", "a torque pulls by a spool"});
  refuses("tension = \"left_N\"", "tension = \"left_N\"\nspool = \"30 mm\"", {"spool", "a force already"});
  refuses("tension = \"left_N\"", "spool = \"30 mm\"", {"spool", "add 'tension'"});
  refuses("tension = \"left_N\"", "tension = \"left_N\"\nk = \"2 kN/m\"", {"[cables.cable] k", "has no law"});
  refuses("tension = \"left_N\"", "tension = \"left_N\"\nslack = \"1 mm\"", {"[cables.cable] slack", "has no law"});
  refuses("pieces = 8", "pieces = 8\nk = \"2 kN/m\"", {"[cables] k", "no cable is governed by it"});
  refuses("pieces = 8", "pieces = 8\ntension = \"all_N\"", {"[cables] tension", "every cable has a drive of its own"});
  refuses("tension = \"right_N\"", "tension = \"left_mN\"",
          {"'left_N' and 'left_mN' are the same tension in two units"});
  refuses("tension = \"right_N\"", "retraction = \"right_mm\"", {"[cables]", "cable 'right' has no 'tension'"});
}

TEST_F(TendonBench, WhatStandsWithACableIsItsOwnWhateverItsValue) {
  const std::string own = replaced(tendons_toml, "id = \"left\"\n", "id = \"left\"\noffset = [\"5 mm\", \"2 mm\"]\n");
  std::vector<std::string> ids;
  for (const Dimension& dimension : dimensions_of(open(own)->experiment())) ids.push_back(dimension.spec.id);
  for (const char* id : {"offset_left", "end_offset_left", "cable_offset", "cable_end_offset", "angle_right"})
    EXPECT_EQ(std::ranges::count(ids, id), 1) << id;
  EXPECT_EQ(std::ranges::count(ids, "offset_right"), 0);
  const std::unique_ptr<Bench> bench = open(own);
  Experiment changed = bench->experiment();
  for (const Dimension& dimension : dimensions_of(changed)) {
    if (dimension.spec.id == "cable_offset") dimension.set(changed, 0.004);
  }
  EXPECT_EQ(changed.cables.cables[0].line->offset, 0.005);  // its own stays
  EXPECT_EQ(changed.cables.cables[1].line->offset, 0.004);
}

TEST_F(TendonBench, AVariantForgetsTheTolerancesOfWhatItFrees) {
  const std::unique_ptr<Bench> bench =
      open(replaced(tendons_toml, "standoff = \"12 mm\"", "standoff = \"12 mm +- 0.5 mm\"") +
           "\n[[fit.variant]]\nname = \"stand-off\"\nfree = [\"standoff_side\"]\n");
  const std::unique_ptr<Bench> variant = bench->with(bench->experiment().variants.front());
  EXPECT_EQ(variant->free().size(), bench->free().size() + 1);
}

TEST_F(TendonBench, AFootAtTheEndOfABoxStaysThereWhileTheBoxIsMadeShorter) {
  const std::string box =
      replaced(replaced(replaced(tendons_toml, "model = \"rod\"\nrod_section = \"linear\"\n", ""),
                        "kind = \"revolved\"\naxis = \"-z\"\ns = [\"0 mm\", \"100 mm\"]\nradius = [\"8 mm\", \"6 mm\"]",
                        "kind = \"box\"\nsize = [\"100 mm\", \"12 mm\", \"12 mm\"]"),
               "layers = 10\nrings = 1", "cells = [6, 1, 1]");
  const std::unique_ptr<Bench> bench = open(replaced(box, "on = \"base\"", "on = \"xmin\""));
  const DimensionedModel model = bench->with_dimensions();
  const int size = model.protocol->parameters().index("size_x");
  EXPECT_TRUE(model.protocol->predict(model.protocol->nominal(), {size}).complete());
}

TEST_F(TendonBench, FrictionOfTendonsIsThatOfARodAlone) {
  const std::string rubbing = replaced(tendons_toml, "pieces = 8", "pieces = 8\nfriction = \"0.2 +- 0.05\"");
  const std::unique_ptr<Bench> bench = open(rubbing), without = open(tendons_toml);
  const ParameterTable& table = bench->protocol().parameters();
  EXPECT_EQ(bench->protocol().nominal()[table.index("cable_friction")], 0.2);
  EXPECT_EQ(without->protocol().nominal()[table.index("cable_friction")], 0);
  const Eigen::VectorXd rubs = bench->protocol().predict(bench->protocol().nominal(), {}).values,
                        slides = without->protocol().predict(without->protocol().nominal(), {}).values;
  EXPECT_LT(rubs[1], slides[1] - 1e-4);  // the tip moves less far sideways
  EXPECT_GT(rubs[1], 0.8 * slides[1]);

  refuses("pieces = 8", "pieces = 8\nfriction = -0.1", {"[cables] friction", "from 0 (none) to 2"});
  refuses("pieces = 8", "pieces = 8\nfriction = \"0.2 mm\"", {"[cables] friction"});
  const std::string full = replaced(tendons_toml, "model = \"rod\"\nrod_section = \"linear\"\n", "");
  const auto refused = [&](const std::string& toml) {
    SCOPED_TRACE(toml);
    expect_input_error([&] { open(toml); }, {"arm.toml", "[cables] friction", "\"full\"", "model = \"rod\""});
  };
  refused(replaced(full, "pieces = 8", "pieces = 8\nfriction = 0.2"));
  refused(full + "\n[fit.free.cable_friction]\n");
  refused(full + "\n[[fit.variant]]\nname = \"friction\"\nfree = [\"cable_friction\"]\n");
  EXPECT_NO_THROW(open(replaced(full, "pieces = 8", "pieces = 8\nfriction = 0")));
  const std::string retracted = replaced(replaced(tendons_toml, "tension = \"left_N\"", "retraction = \"left_mm\""),
                                         "tension = \"right_N\"", "retraction = \"right_mm\"");
  expect_input_error([&] { open(replaced(retracted, "pieces = 8", "pieces = 8\nk = \"2 kN/m\"\nfriction = 0.2")); },
                     {"[cables] friction", "whose tension is held, and none is"});
}

TEST_F(TendonBench, EyeletsAndMarkersThatAreNotOnTheBodyAreRefused) {
  refuses("along = [\"0 mm\", \"80 mm\"]", "along = [\"0 mm\", \"120 mm\"]", {"[cables] along", "from 0 to 100 mm"});
  refuses("along = [\"0 mm\", \"80 mm\"]", "along = [\"80 mm\", \"0 mm\"]", {"[cables] along", "in their order"});
  refuses("offset = [\"5 mm\", \"4 mm\"]", "offset = [\"9 mm\", \"4 mm\"]", {"cable 'left'", "outside the mesh"});
  refuses("pieces = 8", "pieces = 0", {"[cables] pieces", "1"});
  refuses("s = \"50 mm\"", "s = \"110 mm\"", {"[marker] s", "from 0 to 100 mm"});
  refuses("s = \"50 mm\"", "s = \"-1 mm\"", {"[marker] s", "from 0 to 100 mm"});
  refuses("s = \"50 mm\"\nstandoff = \"12 mm\"\nx = \"x_mm\"\ny = \"y_mm\"\nz = \"z_mm\"", "s = \"50 mm\"",
          {"[marker]", "the column of at least one coordinate"});
  refuses("ahead = \"4 mm\"\nx = \"x_mm\"", "ahead = \"4 mm\"\nnoise_x = { absolute = \"1 mm\" }",
          {"noise_x", "'x' is not measured"});
  refuses("id = \"side\"", "id = \"tip\"", {"'tip_x' is used twice"});
  refuses("standoff = \"12 mm\"", "standof = \"12 mm\"", {"standof", "did you mean 'standoff'?"});
}

TEST_F(TendonBench, GeometriesWithoutAnAxisHaveNeither) {
  const std::string geometry = tendons_toml.substr(tendons_toml.find("[geometry]"),
                                                   tendons_toml.find("[materials") - tendons_toml.find("[geometry]"));
  const std::string boxes =
      "[geometry]\nkind = \"boxes\"\n[[geometry.box]]\nregion = \"arm\"\nlower = [\"0 mm\", \"0 mm\", \"0 mm\"]\nupper "
      "= "
      "[\"9 mm\", \"9 mm\", \"90 mm\"]\n[mesh]\nsize = \"9 mm\"\n\n";
  refuses(geometry, boxes, {"[cables] along", "\"boxes\" has none"});
  const size_t from = tendons_toml.find("[cables]"), to = tendons_toml.find("[[marker]]");
  const std::string without = replaced(tendons_toml, tendons_toml.substr(from, to - from), "");
  expect_input_error([&] { open(replaced(without, geometry, boxes)); }, {"[marker]", "\"boxes\" has none", "arm.toml"});
}

TEST_F(TendonBench, RoundBodiesThatAreNoneAreRefused) {
  refuses("radius = [\"8 mm\", \"6 mm\"]", "radius = [\"8 mm\"]", {"[geometry]", "1 radii for 2 places"});
  refuses("radius = [\"8 mm\", \"6 mm\"]", "radius = [\"8 mm\", \"0 mm\"]", {"[geometry]", "radius"});
  refuses("s = [\"0 mm\", \"100 mm\"]", "s = [\"10 mm\", \"100 mm\"]", {"[geometry]", "s"});
  refuses("s = [\"0 mm\", \"100 mm\"]", "s = [\"0 mm\", \"0 mm\"]", {"[geometry]", "s"});
  refuses("axis = \"-z\"", "axis = \"w\"", {"[geometry]", "-z"});
  refuses("axis = \"-z\"", "axis = \"-z\"\nbore = [\"7 mm\", \"7 mm\"]", {"[geometry]", "bore"});
}

TEST_F(TendonBench, RodsAndVariantsThatThereAreNotAreRefused) {
  refuses("model = \"rod\"\n", "", {"rod_section", "set model = \"rod\""});
  refuses("rod_section = \"linear\"", "rod_section = \"stiff\"", {"rod_section", "neo_hookean, linear"});
  refuses("fix = [\"x\", \"y\", \"z\"]", "fix = [\"x\", \"y\"]", {"rigid motions free"});
  refuses("[[support]]", "[base]\nturn = [\"3 deg\"]\n[[support]]", {"[base] turn", "3"});
  const auto variant = [](const std::string& ids) {
    return "[fit.free.density_arm]\n[[fit.variant]]\nname = \"more\"\nfree = [" + ids + "]\n";
  };
  refuses("[fit.free.density_arm]\n", variant("\"E_arm\""), {"[fit.variant] free", "'E_arm' is free in every fit"});
  refuses("[fit.free.density_arm]\n", variant("\"turnx\""), {"[[fit.variant]] 'more'", "turnx", "turn_x"});
  refuses("[fit.free.E_arm]", "[fit.free.foot_top]", {"foot_top", "foot_tip"});
}

}  // namespace
}  // namespace taut

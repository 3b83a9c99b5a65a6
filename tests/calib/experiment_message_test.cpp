#include <gtest/gtest.h>

#include <algorithm>

#include "calib/benches/static_replay.hpp"
#include "calib/files/experiment.hpp"
#include "calib/runs/open_bench.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"

// Each way of getting an experiment file wrong, with the message a person gets.
namespace taut {
namespace {

using namespace test;

class WrongExperiment : public testing::Test {
 protected:
  /// Everything up to a fit that could begin.
  static void open(const std::string& path) {
    const Experiment experiment = read_experiment(path);
    const Trials trials = read_trials(experiment.bench);
    const StaticReplay bench = make_static_replay(experiment, experiment.mesh, trials);
    free_parameters(experiment, *bench.protocol);
  }

  /// Opening the beam with `from` replaced by `to` fails; the message names the file (or bench.csv) and holds all
  /// `parts`. A part "@x" is the file and the line of the first x in it.
  void refuses(const std::string& from, const std::string& to, std::vector<std::string> parts) const {
    const std::string text = replaced(beam_toml, from, to), path = folder_.write("beam.toml", text);
    folder_.write("bench.csv", csv_);
    for (std::string& part : parts) {
      if (!part.starts_with('@')) continue;
      const size_t at = text.find(part.substr(1));
      ASSERT_NE(at, std::string::npos) << part;
      part = "beam.toml:" + std::to_string(1 + std::count(text.begin(), text.begin() + static_cast<long>(at), '\n'));
    }
    SCOPED_TRACE(to);
    if (std::find(parts.begin(), parts.end(), "bench.csv") == parts.end()) parts.emplace_back("beam.toml");
    expect_input_error([&] { open(path); }, parts);
  }

  TemporaryFolder folder_;
  std::string csv_ = beam_csv;
};

TEST_F(WrongExperiment, TheBeamItselfIsRight) {
  folder_.write("bench.csv", csv_);
  EXPECT_NO_THROW(open(folder_.write("beam.toml", beam_toml)));
}

TEST_F(WrongExperiment, FilesThatCannotBeRead) {
  expect_input_error([&] { open(folder_ / "nowhere.toml"); }, {"nowhere.toml", "cannot be read", "check the path"});
  refuses("nu = 0.3", "nu = = 0.3", {"@nu = =", "not valid TOML"});
  refuses("[bench]", "[bench", {"@[bench", "not valid TOML"});
  refuses("nu = 0.3", "nu = 0.3\nnu = 0.4", {"@nu = 0.4", "not valid TOML"});
  std::filesystem::remove(folder_ / "bench.csv");
  const std::string path = folder_.write("beam.toml", beam_toml);
  expect_input_error([&] { open(path); }, {"bench.csv"});
}

TEST_F(WrongExperiment, ModelsThatThereAreNot) {
  const auto with = [](const std::string& keys) { return "data = \"simulated\"\n" + keys; };
  refuses("data = \"simulated\"", with("model = \"beams\""), {"@model", "beams", "beam", "rigid_segments", "auto"});
  refuses("data = \"simulated\"", with("tolerance = \"2 %\""), {"@tolerance", "model = \"auto\""});
  refuses("data = \"simulated\"", with("model = \"auto\"\ntolerance = \"80 %\""), {"@tolerance", "50 %"});
  refuses("data = \"simulated\"", with("model = \"rigid_segments\""), {"model", "100 times as stiff", "\"full\""});
}

TEST_F(WrongExperiment, UnknownKeysGetTheirLineAndTheNearestName) {
  refuses("thickness =", "thikness =", {"[geometry]", "thickness"});
  refuses("plane = \"strain\"", "plane = \"strain\"\norigine = [\"0 mm\", \"0 mm\"]",
          {"@origine", "[geometry]", "unknown key 'origine'", "did you mean 'origin'", "allowed:"});
  refuses("start = \"50 kPa\"", "star = \"50 kPa\"",
          {"@star =", "[fit.free.E_foam]", "unknown key 'star'", "did you mean 'start'"});
  refuses("data = \"simulated\"", "data = \"simulated\"\nauthor = \"me\"", {"@author", "unknown key 'author'"});
  refuses("direction = [0, -1]\ncolumn = \"pull_N\"", "direction = [0, -1]\ncolumn = \"pull_N\"\ncolum = 1",
          {"@colum = 1", "[load]", "did you mean 'column'"});
}

TEST_F(WrongExperiment, UnknownTables) {
  refuses("[bench]", "[solve]\nthreads = 1\n[bench]", {"@[solve]", "unknown key 'solve'", "did you mean 'solver'"});
  refuses("[[channel]]", "[[chanel]]", {"channel"});
  refuses("[fit.free.E_foam]", "[fit.freed.E_foam]", {"[fit]", "unknown key 'freed'", "did you mean 'free'"});
}

TEST_F(WrongExperiment, UnitsThatAreMissingOrWrong) {
  refuses("E = \"100 kPa\"", "E = 100000",
          {"@E = 100000", "[materials.foam] E", "pressure", "in quotes with its unit", "kPa"});
  refuses("E = \"100 kPa\"", "E = \"100000\"", {"@E = ", "has no unit", "kPa"});
  refuses("E = \"100 kPa\"", "E = \"100 kN\"", {"@E = ", "'kN' is not a unit of pressure", "Pa"});
  refuses("E = \"100 kPa\"", "E = \"100kPa\"", {"@E = ", "blank between number and unit", "'100 kPa'"});
  refuses("E = \"100 kPa\"", "E = \"1,5 kPa\"", {"@E = ", "decimal point"});
  refuses("[\"60 mm\", \"12 mm\"]", "[\"60 mm\", \"12 kg\"]", {"@size", "'kg' is not a unit of length"});
  refuses("[\"60 mm\", \"12 mm\"]", "[60, 12]", {"@size", "length", "in quotes with its unit"});
  refuses("column = \"pull_N\"", "column = \"tug\"", {"@column = \"tug\"", "[load] column", "unit"});
  refuses("column = \"pull_N\"", "column = \"pull_mm\"", {"pull_mm", "length", "force"});
  refuses("start = \"50 kPa\"", "start = \"50 N\"", {"@start", "'N' is not a unit of pressure"});
  refuses("start = \"50 kPa\"", "start = 50000", {"@start", "has no unit"});
  refuses("absolute = \"0.1 mm\"", "absolute = 0.1", {"absolute", "length"});
}

TEST_F(WrongExperiment, KeysThatAreMissing) {
  // What is misspelt comes before what is missing for it.
  refuses("thickness = \"20 mm\"", "thicknes = \"20 mm\"", {"unknown key 'thicknes'", "did you mean 'thickness'?"});
  refuses("[bench]", "[bensh]", {"unknown key 'bensh'", "did you mean 'bench'?"});
  refuses("[[channel]]", "[[chanel]]", {"unknown key 'chanel'", "did you mean 'channel'?"});
  refuses("title = \"A small beam\"\n", "", {"'title' is missing"});
  refuses("data = \"simulated\"\n", "", {"'data' is missing"});
  refuses("region = \"foam\"\n", "", {"@[geometry]", "[geometry]", "'region' is missing"});
  refuses("size = [\"60 mm\", \"12 mm\"]\n", "", {"[geometry]", "'size' is missing"});
  refuses("thickness = \"20 mm\"\n", "", {"[geometry]", "'thickness' is missing"});
  refuses("cells = [10, 4]\n", "", {"[mesh]", "'cells' is missing", "cells = ["});
  refuses("nu = 0.3\n", "", {"[materials.foam]", "'nu' is missing"});
  refuses("file = \"bench.csv\"\n", "", {"[bench]", "'file' is missing"});
  refuses("[bench]\nfile = \"bench.csv\"\ntrial = \"trial\"\n", "", {"[bench] is missing"});
  refuses("[mesh]\ncells = [10, 4]\nelement = \"quadratic\"\n", "", {"[mesh] is missing"});
  refuses("column = \"tip_mm\"\n", "", {"channel 'tip'", "column", "missing"});
  refuses("noise = { absolute = \"0.1 mm\" }\n", "", {"channel 'tip'", "no noise"});
}

TEST_F(WrongExperiment, ValuesOfTheWrongType) {
  refuses("title = \"A small beam\"", "title = 3", {"@title", "a text in quotes"});
  refuses("title = \"A small beam\"", "title = \"\"", {"@title", "empty"});
  refuses("nu = 0.3", "nu = \"much\"", {"@nu", "finite number"});
  refuses("nu = 0.3", "nu = true", {"@nu", "a number belongs here"});
  refuses("nu = 0.3", "nu = nan", {"@nu", "must be finite"});
  refuses("cells = [10, 4]", "cells = 10", {"@cells", "a list in square brackets"});
  refuses("cells = [10, 4]", "cells = [10, 4, 4]", {"@cells", "3 entries", "2 belong here"});
  refuses("cells = [10, 4]", "cells = [10, 0]", {"@cells", "whole numbers from 1"});
  refuses("cells = [10, 4]", "cells = [10, 2.5]", {"@cells", "whole numbers from 1"});
  refuses("fix = [\"x\", \"y\"]", "fix = \"x\"", {"@fix", "a list"});
  refuses("fix = [\"x\", \"y\"]", "fix = [\"x\", 1]", {"@fix", "texts in quotes"});
  refuses("[[load]]", "[load]", {"load", "write [[load]]"});
  refuses("[materials.foam]", "[[materials]]", {"materials", "[materials]"});
  refuses("[bench]", "[solver]\nthreads = -1\n[bench]", {"@threads", "at least 0"});
  refuses("[bench]", "[solver]\nstep_tolerance = 1\n[bench]", {"@step_tolerance", "between 1e-14 and 1e-2"});
  refuses("[bench]", "[figures]\ntrend_degree = 6\n[bench]",
          {"@trend_degree", "[figures]", "6 is too high", "0 (none) to 5"});
  refuses("[bench]", "[figures]\ntrend_degree = -1\n[bench]", {"@trend_degree", "at least 0"});
  refuses("[bench]", "[figures]\ntrend_degree = \"2\"\n[bench]", {"@trend_degree", "a whole number"});
  refuses("[bench]", "[figures]\ntrend_degre = 2\n[bench]",
          {"@trend_degre", "unknown key 'trend_degre'", "did you mean 'trend_degree'"});
}

TEST_F(WrongExperiment, NumbersThatAreNotPhysical) {
  refuses("[\"60 mm\", \"12 mm\"]", "[\"-60 mm\", \"12 mm\"]", {"@size", "must be positive"});
  refuses("thickness = \"20 mm\"", "thickness = \"0 mm\"", {"@thickness", "must be positive"});
  refuses("nu = 0.3", "nu = 0.5", {"@nu", "0.5 is outside", "Poisson's ratio", "0.4999999"});
  refuses("nu = 0.3", "nu = -1.2", {"@nu", "outside the physical range"});
  refuses("E = \"100 kPa\"", "E = \"-1 kPa\"", {"@E =", "outside the physical range", "Young's modulus"});
  refuses("nu = 0.3", "nu = 0.3\ndensity = \"-3 kg/m3\"", {"@density", "must be positive"});
  refuses("[[support]]", "[gravity]\nacceleration = \"-9.81 m/s2\"\ndirection = [0, -1]\n[[support]]",
          {"@acceleration", "must be positive", "direction"});
  refuses("[[support]]", "[gravity]\ndirection = [0, -1]\n[[support]]", {"[gravity]", "needs a density", "kg/m3"});
  refuses("absolute = \"0.1 mm\"", "absolute = \"-0.1 mm\"", {"noise", "must not be negative"});
}

TEST_F(WrongExperiment, NamesThatAreNotKnown) {
  refuses("data = \"simulated\"", "data = \"simulatd\"",
          {"@data", "'simulatd'", "did you mean 'simulated'", "measured"});
  refuses("law = \"neo_hookean\"", "law = \"neo_hokean\"", {"@law", "did you mean 'neo_hookean'", "allowed:"});
  refuses("kind = \"rectangle\"", "kind = \"rectangel\"", {"@kind", "did you mean 'rectangle'", "polygons"});
  refuses("plane = \"strain\"", "plane = \"stres\"", {"@plane", "did you mean 'stress'"});
  refuses("element = \"quadratic\"", "element = \"cubic\"", {"@element", "'cubic' is not known", "quadratic, linear"});
  refuses("fix = [\"x\", \"y\"]", "fix = [\"x\", \"z\"]", {"@fix", "'z' is not a component of a 2D model", "x, y"});
  refuses("on = \"xmin\"", "on = \"xmim\"", {"[[support]]", "xmim", "xmin"});
  refuses("on = \"xmax\"\ndirection = [0, -1]\ncolumn = \"pull_N\"",
          "on = \"top\"\ndirection = [0, -1]\ncolumn = \"pull_N\"", {"[[load]] 'pull'", "top", "ymax"});
  refuses("on = \"xmax\"\ndirection = [0, -1]\ncolumn = \"tip_mm\"",
          "on = \"xmax & ymiddle\"\ndirection = [0, -1]\ncolumn = \"tip_mm\"", {"[[channel]] 'tip'", "ymiddle"});
  refuses("[fit.free.E_foam]", "[fit.free.E_foma]",
          {"[fit.free.E_foma]", "unknown parameter", "did you mean 'E_foam'"});
}

TEST_F(WrongExperiment, RegionsAndMaterialsThatDoNotMatch) {
  refuses("region = \"foam\"", "region = \"core\"", {"[materials.foam]", "foam", "core"});
  refuses("[[support]]", "[materials.skin]\nlaw = \"neo_hookean\"\nE = \"1 MPa\"\nnu = 0.3\n[[support]]",
          {"[materials.skin]", "skin", "foam"});
  refuses("[materials.foam]\nlaw = \"neo_hookean\"\nE = \"100 kPa\"\nnu = 0.3\n", "", {"no material", "[materials."});
}

TEST_F(WrongExperiment, PlacesThatAreNotOnTheBody) {
  const std::string load = "on = \"xmax\"\ndirection = [0, -1]\ncolumn = \"pull_N\"";
  const std::string channel = "on = \"xmax\"\ndirection = [0, -1]\ncolumn = \"tip_mm\"";
  refuses(load, "point = [\"70 mm\", \"6 mm\"]\ndirection = [0, -1]\ncolumn = \"pull_N\"",
          {"[[load]] 'pull'", "10 mm"});
  refuses(channel, "point = [\"30 mm\", \"20 mm\"]\ndirection = [0, -1]\ncolumn = \"tip_mm\"",
          {"[[channel]] 'tip'", "8 mm"});
  refuses(channel, "point = [\"30 mm\"]\ndirection = [0, -1]\ncolumn = \"tip_mm\"",
          {"@point", "1 entries", "2 belong"});
  refuses(load, "on = \"xmax\"\npoint = [\"60 mm\", \"6 mm\"]\ndirection = [0, -1]\ncolumn = \"pull_N\"",
          {"[load]", "either 'on'", "or 'point'"});
  refuses(load, "direction = [0, -1]\ncolumn = \"pull_N\"", {"[load]", "either 'on'", "or 'point'"});
  refuses(channel, "direction = [0, -1]\ncolumn = \"tip_mm\"", {"[channel]", "either 'point'", "or 'on'"});
  refuses(channel, channel + "\nstandoff = [\"0 mm\", \"6 mm\"]\nturns_with = \"xmax\"",
          {"@standoff", "needs 'point'"});
}

TEST_F(WrongExperiment, LoadsThatAreNotDefined) {
  const std::string load = "on = \"xmax\"\ndirection = [0, -1]\ncolumn = \"pull_N\"";
  refuses(load, "on = \"xmax\"\ndirection = [0, -1]", {"[load]", "either 'column'", "or 'value'"});
  refuses(load, load + "\nvalue = \"2 N\"", {"[load]", "either 'column'", "or 'value'"});
  refuses(load, "on = \"xmax\"\ndirection = [0, -1]\nvalue = \"2 mm\"", {"@value = ", "'2 mm' is not a load", "100 g"});
  refuses(load, "on = \"xmax\"\ndirection = [0, -1]\nvalue = \"2\"", {"@value = ", "is not a load"});
  refuses(load, "on = \"xmax\"\ndirection = [0, 0]\ncolumn = \"pull_N\"", {"@direction = [0, 0]", "all zeros"});
  refuses(load, "on = \"xmax\"\ndirection = [0, 0, -1]\ncolumn = \"pull_N\"", {"@direction", "3 entries", "2 belong"});
  refuses(load, "on = \"xmax\"\ndirection = [0, \"down\"]\ncolumn = \"pull_N\"", {"@direction", "number"});
  refuses(load, "point = [\"60 mm\", \"6 mm\"]\ndirection = [0, -1]\nvalue = \"2 kPa\"", {"@point", "face"});
  refuses(load, "point = [\"60 mm\", \"6 mm\"]\ndirection = [0, -1]\nvalue = \"2 N/m\"", {"@point", "line load"});
  csv_ = "trial,tip_mm\na,1\n";
  refuses(load, "on = \"xmax & ymax\"\ndirection = [0, -1]\nvalue = \"2 kPa\"", {"[[load]] 'pull'", "acts on an edge"});
  refuses(load, "on = \"xmax\"\ndirection = [0, -1]\nvalue = \"2 N/m\"", {"[[load]] 'pull'", "acts on a point"});
}

TEST_F(WrongExperiment, SupportsThatDoNotHold) {
  const std::string support = "[[support]]\non = \"xmin\"\nfix = [\"x\", \"y\"]\n";
  refuses(support, "", {"no support", "[[support]]"});
  refuses("fix = [\"x\", \"y\"]", "fix = [\"x\"]", {"the model", "1 of 3 rigid motions free"});
  refuses("fix = [\"x\", \"y\"]\n", "", {"[support]", "needs 'fix'", "'move'"});
  refuses("fix = [\"x\", \"y\"]", "fix = [\"x\", \"y\"]\nmove = \"x\"\nid = \"travel\"\ncolumn = \"travel_mm\"",
          {"bench.csv", "travel_mm"});
  refuses("fix = [\"x\", \"y\"]", "fix = [\"x\", \"y\"]\nmove = \"x\"\nid = \"travel\"",
          {"[support]", "'column' is missing"});
  csv_ = "trial,pull_N,tip_mm,travel_mm\na,0.05,1,0\n";
  refuses("fix = [\"x\", \"y\"]", "fix = [\"x\", \"y\"]\nmove = \"x\"\nid = \"travel\"\ncolumn = \"travel_mm\"",
          {"[[support]] on 'xmin'", "already prescribed"});
}

TEST_F(WrongExperiment, ElementsThatCannotBeCombined) {
  refuses("element = \"quadratic\"", "element = \"linear\"\nformulation = \"locking_free\"",
          {"@formulation", "needs quadratic elements", "element = \"quadratic\""});
  refuses("[fit.free.E_foam]",
          "[[fit.variant]]\nname = \"a\"\nformulation = \"locking_free\"\nelement = \"linear\"\n"
          "[fit.free.E_foam]",
          {"@formulation", "[fit.variant]", "needs quadratic elements"});
  refuses("cells = [10, 4]", "size = \"2 mm\"\ncells = [10, 4]", {"@size = \"2 mm\"", "unknown key 'size'"});
}

TEST_F(WrongExperiment, IdsThatStandTwice) {
  refuses("id = \"tip\"", "id = \"pull\"", {"'pull' is used twice", "must differ"});
  refuses("[[channel]]", "[[load]]\nid = \"pull\"\non = \"ymax\"\ndirection = [0, -1]\nvalue = \"1 N\"\n[[channel]]",
          {"'pull' is used twice"});
  // Loads become parameters beside the model's own.
  for (const std::string taken : {"g", "thickness", "E_foam"}) {
    refuses("id = \"pull\"", "id = \"" + taken + "\"", {"'" + taken + "'", "another id"});
  }
}

TEST_F(WrongExperiment, BenchesThatDoNotMatch) {
  const std::string path = folder_.write("beam.toml", beam_toml);
  folder_.write("bench.csv", "trial,tip_mm\na,1\n");
  expect_input_error([&] { open(path); }, {"bench.csv, line 1", "'pull_N'", "tip_mm"});
  folder_.write("bench.csv", "trial,pull_N,tip_mm,extra\na,1,1,1\n");
  expect_input_error([&] { open(path); }, {"bench.csv, line 1", "'extra'"});
}

TEST_F(WrongExperiment, FreeParametersWithWrongBounds) {
  refuses("start = \"50 kPa\"", "start = \"50 MPa\"",
          {"[fit.free.E_foam]", "start 50 MPa", "between the bounds 1 kPa and 10 MPa"});
  refuses("lower = \"1 kPa\"", "lower = \"60 kPa\"", {"[fit.free.E_foam]", "start 50 kPa", "60 kPa"});
  refuses("lower = \"1 kPa\"\nupper = \"10 MPa\"", "lower = \"50 kPa\"\nupper = \"50 kPa\"",
          {"[fit.free.E_foam]", "bounds"});
  refuses("lower = \"1 kPa\"", "lower = \"-1 kPa\"", {"[fit.free.E_foam]", "outside its physical range"});
  refuses("[fit.free.E_foam]", "[fit.free.nu_foam]\nupper = 0.6\n[fit.free.E_foam]",
          {"[fit.free.nu_foam]", "0.6", "outside its physical range"});
  refuses("[fit.free.E_foam]", "[fit.free.pull]\n[fit.free.E_foam]", {"[fit.free.pull]", "bench", "cannot be fitted"});
}

TEST_F(WrongExperiment, ReferencesWithoutAValue) {
  refuses("[bench]", "[[fit.reference]]\nparameter = \"E_foam\"\nsource = \"book\"\n[bench]",
          {"[fit.reference]", "'value' is missing"});
}

TEST_F(WrongExperiment, ChannelsAndLoadsThatASupportHolds) {
  folder_.write("bench.csv", csv_);
  const auto opened = [&](const std::string& toml) { return open_bench(folder_.write("beam.toml", toml)); };
  const std::string channel = "id = \"tip\"\non = \"", load = "id = \"pull\"\non = \"";
  expect_input_error([&] { opened(replaced(beam_toml, channel + "xmax", channel + "xmin")); },
                     {"beam.toml: [[channel]] 'tip': the mean displacement of xmin never changes", "on 'xmin' fixes it",
                      "measure where"});
  // Fixed in x alone it slides.
  const std::string sliding =
      replaced(beam_toml, "fix = [\"x\", \"y\"]", "fix = [\"x\"]\n[[support]]\non = \"xmax\"\nfix = [\"y\"]");
  EXPECT_NO_THROW(opened(replaced(sliding, channel + "xmax", channel + "xmin")));
  const auto warned = [&](const std::string& toml) {
    const std::vector<std::string> warnings = opened(toml)->warnings_before();
    return std::ranges::any_of(warnings, [](const std::string& one) {
      return one.find("[[load]] 'pull' strains nothing: the support on 'xmin' fixes") != std::string::npos;
    });
  };
  EXPECT_TRUE(warned(replaced(beam_toml, load + "xmax", load + "xmin")));
  EXPECT_FALSE(warned(beam_toml));
  const std::string slides =
      replaced(replaced(sliding, channel + "xmax", channel + "xmin"), load + "xmax", load + "xmin");
  EXPECT_FALSE(warned(slides)) << "along the load";
  // A displacement that is set is one to compare with.
  folder_.write("bench.csv", "trial,pull_N,lift_mm,tip_mm\na,0.05,1,1\n");
  EXPECT_NO_THROW(
      opened(replaced(beam_toml, "[[load]]",
                      "[[support]]\non = \"xmax\"\nmove = \"y\"\nid = \"lift\"\ncolumn = \"lift_mm\"\n[[load]]")));
}

}  // namespace
}  // namespace taut

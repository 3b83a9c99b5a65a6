#include <fmt/format.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <csignal>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "tests/support/command.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/small_robot.hpp"

// The command `taut` as its users meet it: arguments, exit codes, what goes to stdout, to stderr and to disk.
namespace taut {
namespace {

using namespace test;
using nlohmann::json;
namespace fs = std::filesystem;

/// The small beam with readings that the program itself made: E = 80 kPa, rounded to 10 um.
class Command : public testing::Test {
 protected:
  Command() : here_(folder_ / "") {
    fs::create_directory(folder_ / "beam");
    experiment_ = folder_ / "beam/experiment.toml";
    folder_.write("beam/experiment.toml", beam_toml);
    folder_.write("beam/bench.csv", beam_csv);
  }

  Outcome taut(const std::vector<std::string>& arguments) const { return run_in(here_, arguments); }

  /// Replaces the bench by a replay with E = 80 kPa.
  void simulate_readings() const {
    const Outcome replay =
        taut({"replay", experiment_, "--set", "E_foam=80 kPa", "--json", "--quiet", "--out", folder_ / "synthetic"});
    ASSERT_EQ(replay.code, 0) << replay.err;
    const json result = json::parse(replay.out);
    std::string csv = "trial,pull_N,tip_mm\n";
    char line[100];
    for (const json& row : result.at("rows")) {
      std::snprintf(line, sizeof line, "%s,%.6g,%.2f\n", row.at("trial").get<std::string>().c_str(),
                    row.at("controls")[0].get<double>(), 1e3 * row.at("predicted_m").get<double>());
      csv += line;
    }
    folder_.write("beam/bench.csv", csv);
  }

  TemporaryFolder folder_;
  std::string here_, experiment_;
};

std::vector<std::string> names_in(const std::string& folder) {
  std::vector<std::string> names;
  if (!fs::exists(folder)) return names;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder))
    names.push_back(entry.path().filename().string());
  return names;
}

// ---- help and usage

TEST_F(Command, HelpHasExamplesAndExitCodes) {
  const Outcome help = taut({"--help"});
  EXPECT_EQ(help.code, 0);
  EXPECT_EQ(help.err, "");
  expect_holds(help.out,
               {"examples:", "taut fit experiments/silicone_block/experiment.toml", "commands:", "exit codes:", "130"});
  for (const std::string command :
       {"check", "replay", "fit", "predict", "tune", "plan", "compare", "recheck", "chart", "report"}) {
    const Outcome own = taut({command, "--help"});
    EXPECT_EQ(own.code, 0) << command;
    EXPECT_EQ(own.err, "") << command;
    expect_holds(own.out, {"examples:", "taut " + command + " ", "usage: taut " + command, "--json", "--quiet"});
  }
}

TEST_F(Command, TheVersionIsToldWithItsCommit) {
  const Outcome version = taut({"--version"});
  EXPECT_EQ(version.code, 0);
  expect_holds(version.out, {"taut ", "(", ")"});
}

TEST_F(Command, WrongUsageIsExitCodeTwoWithASentenceOnStderr) {
  const auto refuses = [&](const std::vector<std::string>& arguments, const std::vector<std::string>& parts) {
    const Outcome outcome = taut(arguments);
    EXPECT_EQ(outcome.code, 2) << outcome.err;
    EXPECT_EQ(outcome.out, "");
    expect_holds(outcome.err, parts);
    EXPECT_EQ(std::count(outcome.err.begin(), outcome.err.end(), '\n'), 1) << outcome.err;
  };
  refuses({"fti", experiment_},
          {"unknown command 'fti'", "did you mean 'fit'",
           "check, draw, replay, fit, simulate, ik, optimise, predict, tune, plan, export, score, "
           "compare, recheck, ensemble, chart, report"});
  refuses({"check"}, {"EXPERIMENT is missing", "usage: taut check"});
  refuses({"check", experiment_, "--jsn"}, {"--jsn"});
  refuses({"check", experiment_, "another.toml"}, {"taut --help"});
  refuses({"check", folder_ / "nowhere.toml"}, {"nowhere.toml", "check the path"});
  refuses({"predict", folder_ / "beam"}, {"--rows FILE is missing"});
  refuses({"predict", folder_ / "beam", "--rows", "x.csv"}, {"beam"});
  refuses({"report", folder_ / "nowhere"}, {"nowhere"});
  refuses({"replay", experiment_, "--set", "80 kPa"}, {"--set 80 kPa", "ID=VALUE"});
  refuses({"replay", experiment_, "--set", "E_foma=80 kPa"}, {"E_foma", "did you mean 'E_foam'"});
  refuses({"replay", experiment_, "--set", "E_foam=80 N"}, {"--set E_foam", "not a unit of pressure"});
  refuses({"replay", experiment_, "--set", "nu_foam=0.7"}, {"nu_foam", "outside its physical range"});
  refuses({"replay", experiment_, "--set", "pull=2 N"}, {"pull", "bench"});
  refuses({"replay", experiment_, "--threads", "-1"}, {"threads"});
  refuses({"replay", experiment_, "--threads", "many"}, {"threads", "many"});
  refuses({"chart", experiment_}, {"accuracy|stability|planted|sbc FILE is missing"});
  refuses({"chart", "accurracy", experiment_}, {"'accurracy' is no chart", "did you mean 'accuracy'", "stability"});
  refuses({"chart", "accuracy", experiment_, "--budget", "-1"}, {"--budget", "seconds"});
  refuses({"chart", "accuracy", TAUT_SOURCE_DIR "/experiments/foam_point/experiment.toml"},
          {"material point has no mesh", "a specimen or a simulation"});
  refuses({"chart", "accuracy", TAUT_SOURCE_DIR "/experiments/finger_bend/experiment.toml"},
          {"through equilibria", "experiment with a bench"});
  EXPECT_EQ(taut({}).code, 2);
}

TEST_F(Command, AMessageIsOneLineWhateverTheFileHolds) {
  for (const std::string wrong : {"\"a\\nb\\u001b[2J\" = 1\n", "title = t\n", "model = \"be\\nam\"\n"}) {
    folder_.write("beam/experiment.toml", wrong + beam_toml);
    const Outcome outcome = taut({"check", experiment_});
    EXPECT_EQ(outcome.code, 2);
    EXPECT_EQ(outcome.err.find('\n'), outcome.err.size() - 1) << outcome.err;
    EXPECT_EQ(outcome.err.find('\x1b'), std::string::npos);
    EXPECT_NE(outcome.err.find("\\n"), std::string::npos) << outcome.err;
  }
}

TEST_F(Command, WrongInputLeavesNothingBehind) {
  folder_.write("beam/experiment.toml", replaced(beam_toml, "nu = 0.3", "nu = 0.7"));
  for (const std::string command : {"check", "replay", "fit"}) {
    std::vector<std::string> arguments{command, experiment_};
    if (command != "check") arguments.insert(arguments.end(), {"--out", folder_ / "run"});
    const Outcome outcome = taut(arguments);
    EXPECT_EQ(outcome.code, 2);
    expect_holds(outcome.err, {"experiment.toml:", "nu", "outside the physical range"});
    EXPECT_FALSE(fs::exists(folder_ / "run")) << command;
    EXPECT_FALSE(fs::exists(folder_ / "runs")) << command;
  }
  // Too few readings, nothing free: known only once the model is there.
  folder_.write("beam/experiment.toml", beam_toml + "[fit.free.nu_foam]\n");
  folder_.write("beam/bench.csv", "trial,pull_N,tip_mm\na,0.05,1\n");
  EXPECT_EQ(taut({"fit", experiment_, "--out", folder_ / "run"}).code, 2);
  folder_.write("beam/experiment.toml", beam_toml.substr(0, beam_toml.find("[fit.free")));
  const Outcome outcome = taut({"fit", experiment_, "--out", folder_ / "run"});
  EXPECT_EQ(outcome.code, 2);
  expect_holds(outcome.err, {"no free parameter", "[fit.free]"});
  EXPECT_FALSE(fs::exists(folder_ / "run"));
}

// ---- check

TEST_F(Command, CheckOfTheSiliconeBlockSaysWhatItUnderstood) {
  const std::string block = TAUT_SOURCE_DIR "/experiments/silicone_block/experiment.toml";
  const Outcome text = taut({"check", block});
  EXPECT_EQ(text.code, 0) << text.err;
  expect_holds(text.out, {"measured", "box of 100 mm, 30 mm, 30 mm", "locking-free, 14 x 5 x 5 cells", "E = 200 kPa",
                          "nu = 0.499", "density = 1070 kg/m3", "fixed in x, y, z", "column 'tip_load_N'", "tip_left",
                          "18 readings", "3 conditions x 3 channels x 2 trials",
                          "start 100 kPa, bounds 10 kPa to 10 MPa", "no problems found"});
  const Outcome data = taut({"check", block, "--json"});
  EXPECT_EQ(data.code, 0);
  const json result = json::parse(data.out);
  EXPECT_EQ(result.at("data"), "measured");
  EXPECT_EQ(result.at("free")[0].at("id"), "E_silicone");
  EXPECT_EQ(result.at("free")[0].at("start"), 1e5);
  EXPECT_TRUE(result.at("warnings").empty());
}

TEST_F(Command, CheckSaysWhereTheTagsAreAndWhichModelIsInUse) {
  const Outcome plain = taut({"check", experiment_});
  expect_holds(plain.out, {"model                  \"full\": finite elements", "tag xmax ",
                           " 4 facets, x 60 to 60, y 0 to 12 mm, centre (60, 6) mm\n",
                           " 10 facets, x 0 to 60, y 12 to 12 mm, centre (30, 12) mm\n"});
  folder_.write("beam/experiment.toml",
                replaced(beam_toml, "data = \"simulated\"", "data = \"simulated\"\nmodel = \"beam\""));
  expect_holds(taut({"check", experiment_}).out, {"\"beam\": a chain of Timoshenko beams"});
}

TEST_F(Command, CheckWarnsAboutElementsThatLock) {
  folder_.write("beam/experiment.toml",
                replaced(replaced(beam_toml, "nu = 0.3", "nu = 0.49"), "\"quadratic\"", "\"linear\""));
  const Outcome outcome = taut({"check", experiment_});
  EXPECT_EQ(outcome.code, 0);
  expect_holds(outcome.out, {"warning:", "locks", "locking_free", "linear elements bend too stiffly"});
  folder_.write("beam/experiment.toml", beam_toml.substr(0, beam_toml.find("[fit.free")));
  const Outcome nothing_free = taut({"check", experiment_, "--json"});
  EXPECT_EQ(json::parse(nothing_free.out).at("free"), json::array());
}

TEST_F(Command, WhatIsImplausibleIsAWarningOfCheckAndFitAndAnErrorWithStrict) {
  simulate_readings();
  EXPECT_EQ(taut({"check", experiment_, "--strict"}).code, 0);
  std::string csv = text_of(folder_ / "beam/bench.csv");
  folder_.write("beam/bench.csv", csv.insert(csv.rfind('.') + 3, "0"));  // one more digit is no other number
  EXPECT_EQ(taut({"check", experiment_, "--strict"}).code, 0);
  folder_.write("beam/bench.csv", csv.erase(csv.rfind('.'), 1));  // the last reading without its point
  const Outcome warned = taut({"check", experiment_}), strict = taut({"check", experiment_, "--strict"});
  EXPECT_EQ(warned.code, 0);
  expect_holds(warned.out, {"warning: line 3", "where its repeat says", "smaller by 1000"});
  EXPECT_EQ(strict.code, 2);
  EXPECT_EQ(strict.out, warned.out);
  expect_holds(json::parse(taut({"check", experiment_, "--json"}).out).at("warnings").dump(), {"line 3"});
  const Outcome fit = taut({"fit", experiment_, "--out", folder_ / "run"});
  const size_t warning = fit.err.find("warning: line 3"), begin = fit.err.find("fitting ");
  EXPECT_LT(warning, begin) << fit.err;
  EXPECT_NE(begin, std::string::npos) << fit.err;
}

// ---- draw

TEST_F(Command, DrawNeedsNoBenchAndNamesItsFiles) {
  fs::remove(folder_ / "beam/bench.csv");
  const Outcome outcome = taut({"draw", experiment_, "--out", folder_ / "drawn"});
  EXPECT_EQ(outcome.code, 0) << outcome.err;
  for (const char* format : {"svg", "pdf", "png", "csv"}) {
    const std::string file = folder_ / (std::string("drawn/figures/drawing.") + format);
    expect_holds(outcome.out, {file});
    EXPECT_TRUE(fs::exists(file)) << file;
  }
  const Outcome as_json = taut({"draw", experiment_, "--out", folder_ / "drawn", "--json"});
  EXPECT_EQ(json::parse(as_json.out).at("files").size(), 4u);
}

// ---- replay

TEST_F(Command, ReplayWritesItsTableToStdoutAndItsProgressToStderr) {
  const Outcome outcome = taut({"replay", experiment_, "--out", folder_ / "replay"});
  EXPECT_EQ(outcome.code, 0) << outcome.err;
  expect_holds(outcome.out, {"SIMULATED DATA", "measured", "predicted", "50 mN"});
  expect_holds(outcome.err, {"in 2 conditions", "factorisations"});
  EXPECT_EQ(outcome.out.find("factorisations"), std::string::npos);
  const std::string csv = text_of(folder_ / "replay/predictions.csv");
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 5) << csv;
  for (const std::string file : {"states/states.pvd", "states/state_000.vtu", "states/state_001.vtu"}) {
    EXPECT_TRUE(fs::exists(folder_ / ("replay/" + file))) << file;
  }

  const Outcome quiet = taut({"replay", experiment_, "--out", folder_ / "replay", "--quiet", "--json"});
  EXPECT_EQ(quiet.err, "");
  const json result = json::parse(quiet.out);
  ASSERT_EQ(result.at("rows").size(), 4u);
  EXPECT_EQ(result.at("rows")[0].at("controls")[0], 0.05);
  EXPECT_GT(result.at("rows")[1].at("predicted_m"), result.at("rows")[0].at("predicted_m"));
  EXPECT_TRUE(result.at("failures").empty());
}

TEST_F(Command, AReplayThatFailsForOneLoadTellsTheOthersAndExitsWithThree) {
  folder_.write("beam/experiment.toml", beam_toml + "[solver]\nmax_iterations = 10\nmax_halvings = 2\n");
  folder_.write("beam/bench.csv", "trial,pull_N,tip_mm\na,0.05,1\na,1e6,2\n");
  const Outcome outcome = taut({"replay", experiment_, "--out", folder_ / "replay", "--json", "--quiet"});
  EXPECT_EQ(outcome.code, 3) << outcome.err;
  const json result = json::parse(outcome.out);
  EXPECT_TRUE(result.at("rows")[0].at("predicted_m").is_number());
  EXPECT_TRUE(result.at("rows")[1].at("predicted_m").is_null());
  EXPECT_EQ(result.at("failures").size(), 1u);
  expect_holds(outcome.err, {"no equilibrium at pull = 1000 kN", "E_foam = 100 kPa"});
}

// ---- fit, predict, report

TEST_F(Command, AFitWritesARunFolderThatPredictAndReportWorkFrom) {
  simulate_readings();
  const std::string run = folder_ / "run";
  const Outcome fit = taut({"fit", experiment_, "--out", run, "--json"});
  ASSERT_EQ(fit.code, 0) << fit.err;
  expect_holds(fit.err, {"fitting 4 readings in 2 conditions", "report: ", "report.html"});
  const json result = json::parse(fit.out);
  EXPECT_EQ(result, json::parse(text_of(run + "/fit.json"))) << "stdout holds what the file holds";
  const json& E = result.at("parameters").at(0);
  EXPECT_EQ(E.at("id"), "E_foam");
  EXPECT_EQ(E.at("unit"), "Pa");
  EXPECT_EQ(E.at("verdict"), "well determined");
  const double value = E.at("value"), error = E.at("standard_error"), lower = E.at("interval95")[0],
               upper = E.at("interval95")[1];
  EXPECT_NEAR(value, 8e4, 3 * error);
  EXPECT_LT(lower, value);
  EXPECT_GT(upper, value);
  EXPECT_NEAR(upper - lower, 2 * 1.96 * error, 0.05 * error);
  for (const std::string file :
       {"report.html", "predictions.csv", "experiment.toml", "data.csv", "states/states.pvd"}) {
    EXPECT_TRUE(fs::exists(run + "/" + file)) << file;
  }
  for (const std::string extension : {".svg", ".pdf", ".png", ".csv"}) {
    int count = 0;
    for (const std::string& name : names_in(run + "/figures")) count += name.ends_with(extension);
    EXPECT_GE(count, 2) << extension;
  }
  expect_holds(text_of(run + "/report.html"), {"E_foam", "<svg", "</html>"});
  EXPECT_EQ(text_of(run + "/data.csv"), text_of(folder_ / "beam/bench.csv"));

  // At a fitted load predict tells what the fit told.
  const std::string loads = folder_.write("loads.csv", "pull_N\n0\n0.1\n0.08\n");
  const Outcome predict = taut({"predict", run, "--rows", loads, "--json", "--quiet"});
  ASSERT_EQ(predict.code, 0) << predict.err;
  EXPECT_EQ(predict.err, "");
  const json rows = json::parse(predict.out).at("rows");
  ASSERT_EQ(rows.size(), 3u);
  EXPECT_NEAR(rows[0].at("predicted_m"), 0, 1e-12);
  const json& fitted = result.at("readings").at(1);
  EXPECT_NEAR(rows[1].at("predicted_m"), fitted.at("predicted").get<double>(), 1e-9);
  EXPECT_NEAR(rows[1].at("standard_error_m"), fitted.at("prediction_se").get<double>(), 1e-8);
  EXPECT_GT(rows[1].at("interval95_m")[1], rows[2].at("predicted_m"));
  const Outcome table = taut({"predict", run, "--rows", loads});
  expect_holds(table.out, {"line,channel,pull_N,predicted_m", "\n2,tip,0,", "\n3,tip,0.1,", "\n4,tip,0.08,"});
  const std::string misnamed = folder_.write("wrong.csv", "pul_N\n0\n");
  const Outcome wrong = taut({"predict", run, "--rows", misnamed});
  EXPECT_EQ(wrong.code, 2);
  expect_holds(wrong.err, {"wrong.csv", "pull_N"});

  // The report comes back from fit.json alone, without the experiment's own files and without solving.
  fs::remove_all(folder_ / "beam");
  fs::remove_all(run + "/figures");
  fs::remove(run + "/report.html");
  const std::string before = text_of(run + "/fit.json");
  const Outcome report = taut({"report", run});
  EXPECT_EQ(report.code, 0) << report.err;
  expect_holds(report.out, {"report.html"});
  expect_holds(text_of(run + "/report.html"), {"E_foam", "<svg", "</html>"});
  EXPECT_FALSE(names_in(run + "/figures").empty());
  EXPECT_EQ(json::parse(text_of(run + "/fit.json")), json::parse(before));
  // And predict still works: the folder explains itself.
  EXPECT_EQ(taut({"predict", run, "--rows", loads, "--quiet"}).out, table.out);
}

TEST_F(Command, AFitTellsPeopleItsResultOnStdout) {
  simulate_readings();
  const Outcome fit = taut({"fit", experiment_, "--out", folder_ / "run", "--quiet"});
  EXPECT_EQ(fit.code, 0) << fit.err;
  EXPECT_EQ(fit.err, "");
  expect_holds(fit.out, {"SIMULATED DATA", "E_foam = ", "95 % interval", "well determined", "chi squared"});
  expect_holds(fit.out,
               {", standard error ", " (noise); may be off by ", " (mesh)", " in all, ", "  the mesh makes it "});
  EXPECT_EQ(fit.out.find("+- "), fit.out.find("+- ", fit.out.find("the mesh makes it"))) << "no limit beside a sigma";
}

TEST_F(Command, AnExcludedLineIsCountedByCheckSaidByTheFitAndStruckOutInTheReport) {
  simulate_readings();
  folder_.write("beam/bench.csv", text_of(folder_ / "beam/bench.csv") + "b,0.07,55\n");
  const auto exclude = [&](const std::string& lines) {
    folder_.write("beam/experiment.toml",
                  replaced(beam_toml, "trial = \"trial\"", "trial = \"trial\"\nexclude = [" + lines + "]"));
  };
  exclude("6");
  expect_holds(taut({"check", experiment_}).out, {"not fitted (exclude): 1 reading in line 6"});
  const std::string run = folder_ / "run";
  const Outcome fit = taut({"fit", experiment_, "--out", run});
  ASSERT_EQ(fit.code, 0) << fit.err;
  expect_holds(fit.err, {"fitting 4 readings in 2 conditions"});
  expect_holds(fit.out, {"Not fitted: line 6 (1 reading).", "for 3 degrees of freedom"});
  const json readings = json::parse(text_of(run + "/fit.json")).at("readings");
  EXPECT_EQ(readings.at(4).at("excluded"), true);
  EXPECT_FALSE(readings.at(3).contains("excluded"));
  EXPECT_TRUE(readings.at(4).at("predicted").is_null()) << "nothing is solved for it";
  expect_holds(text_of(run + "/report.html"), {"<s>55.000</s>", "not fitted", "Not fitted: line 6 (1 reading)."});
  expect_holds(text_of(run + "/predictions.csv"), {"normalised_residual,excluded,"});
  expect_holds(text_of(run + "/figures/force_displacement.csv"), {"excluded,tip,"});
  expect_holds(taut({"replay", experiment_, "--quiet"}).out, {"  not fitted\n"});
  EXPECT_EQ(taut({"replay", experiment_, "--quiet", "--json", "--sensitivities"}).code, 0);
  EXPECT_EQ(taut({"report", run}).code, 0);
  exclude("7");
  const Outcome wrong = taut({"check", experiment_});
  EXPECT_EQ(wrong.code, 2);
  expect_holds(wrong.err, {"line 7", "holds no reading", "lines 2 to 6"});
}

TEST_F(Command, WhatWouldExplainTheMisfitAndTheRobustFitAreTold) {
  std::string csv = "trial,pull_N,tip_mm\n";
  for (const char* trial : {"a", "b", "c", "d"}) csv += fmt::format("{0},0.05,2\n{0},0.1,3.94\n{0},0.15,5.75\n", trial);
  folder_.write("beam/bench.csv", replaced(csv, "c,0.1,3.94", "c,0.1,39.4"));
  folder_.write("beam/experiment.toml", beam_toml + "\n[fit]\nrobust = \"student\"\n");
  const std::string run = folder_ / "run";
  const Outcome fit = taut({"fit", experiment_, "--out", run, "--quiet"});
  ASSERT_EQ(fit.code, 0) << fit.err;
  expect_holds(fit.out, {"What would explain the misfit: line 9 alone being off: +35.",
                         "larger by 10: a slipped decimal", "what would explain that, best first", "then E_foam = ",
                         "exclude = [9]", "  robust fit: ", "all but sets aside line 9 (tip): 39.4 mm"});
  expect_holds(text_of(run + "/report.html"), {"What would explain the misfit", "line 9 alone being off", "Robust fit",
                                               "It all but sets aside: line 9"});
  const json result = json::parse(text_of(run + "/fit.json"));
  EXPECT_EQ(result.at("explanations").at(0).at("lines"), json({9}));
  EXPECT_EQ(result.at("robust").at("outliers").at(0).at("line"), 9);
  EXPECT_NEAR(result.at("robust").at("values").at(0).get<double>() -
                  result.at("parameters").at(0).at("value").get<double>() -
                  result.at("explanations").at(0).at("shifts").at(0).get<double>(),
              0, 0.2 * result.at("robust").at("values").at(0).get<double>());
}

TEST_F(Command, AnAccuracyChartGoesOnWhereTheLastOneEnded) {
  const std::string charts = folder_ / "charts";
  const Outcome first = taut({"chart", "accuracy", experiment_, "--budget", "0", "--out", charts});
  EXPECT_EQ(first.code, 0) << first.err;
  expect_holds(first.out, {"SIMULATED DATA", "quadratic, 10 x 4 cells", "nothing finer was run"});
  expect_holds(first.err, {"settings are missing"});
  const Outcome rest = taut({"chart", "accuracy", experiment_, "--out", charts, "--json", "--quiet"});
  EXPECT_EQ(rest.code, 0) << rest.err;
  EXPECT_EQ(rest.err, "");
  const json result = json::parse(rest.out);
  EXPECT_EQ(result.at("missing"), 0);
  const json& settings = result.at("settings");
  const auto error_of = [&](const std::string& name) -> double {
    for (const json& setting : settings) {
      if (setting.at("setting") == name) return setting.at("error");
    }
    return -1;
  };
  EXPECT_GT(error_of("linear, 10 x 4 cells"), 10 * error_of("quadratic, 10 x 4 cells"));
  EXPECT_GT(error_of("quadratic, 10 x 4 cells"), result.at("uncertainty"));
  EXPECT_GT(error_of("as a solid, 2 cells across half of it"), 0);
  EXPECT_GT(error_of("model \"beam\""), 0);
  EXPECT_EQ(error_of("model \"rod\""), -1) << "it does not describe this bench";
  const std::string table = text_of(charts + "/accuracy.csv");
  EXPECT_EQ(static_cast<size_t>(std::count(table.begin(), table.end(), '\n')), settings.size() + 1);
  for (const std::string file :
       {"accuracy_cost.png", "accuracy_parameters.svg", "accuracy_models.svg", "accuracy_cost.csv"})
    EXPECT_TRUE(fs::exists(charts + "/figures/" + file)) << file;
  taut({"chart", "accuracy", experiment_, "--out", charts});
  EXPECT_EQ(text_of(charts + "/accuracy.csv"), table) << "nothing is run twice";
}

TEST_F(Command, AStabilityChartGoesOnWhereItsBudgetEnded) {
  const std::string charts = folder_ / "charts";
  const Outcome none = taut({"chart", "stability", experiment_, "--budget", "0", "--out", charts});
  EXPECT_EQ(none.code, 0) << none.err;
  const Outcome whole = taut({"chart", "stability", experiment_, "--out", charts});
  ASSERT_EQ(whole.code, 0) << whole.err;
  const std::string table = text_of(charts + "/stability.csv");
  EXPECT_GT(std::count(table.begin(), table.end(), '\n'), 50);
  EXPECT_TRUE(fs::exists(charts + "/figures/stability_poisson_element.svg"));
  taut({"chart", "stability", experiment_, "--out", charts});
  EXPECT_EQ(text_of(charts + "/stability.csv"), table) << "nothing is run twice";
}

TEST_F(Command, AFitToPartsOfTheReadingsIsToldWithWhatItMeansAndATrendIsHandedToTheFigures) {
  simulate_readings();
  folder_.write("beam/experiment.toml",
                std::string(beam_toml) +
                    "\n[fit.diagnostic]\nparameter = \"E_foam\"\nper = \"pull\"\n[figures]\ntrend_degree = 2\n");
  const Outcome fit = taut({"fit", experiment_, "--out", folder_ / "run", "--quiet"});
  EXPECT_EQ(fit.code, 0) << fit.err;
  expect_holds(fit.out,
               {"from pull = ", "All agree with the whole fit within 2 standard errors: one law serves every pull."});
  EXPECT_EQ(json::parse(text_of(folder_ / "run/fit.json")).at("trend_degree"), 2);
  EXPECT_TRUE(fs::exists(folder_ / "run/figures/diagnostic.svg"));
}

TEST_F(Command, TheRunFolderIsNamedAfterTheExperiment) {
  simulate_readings();
  EXPECT_EQ(taut({"replay", experiment_, "--quiet"}).code, 0);
  EXPECT_TRUE(fs::exists(folder_ / "runs/beam/predictions.csv"));
}

TEST_F(Command, AFitWhoseStartCannotBeSimulatedExitsWithThreeAndSaysWhy) {
  folder_.write("beam/experiment.toml", beam_toml + "[solver]\nmax_iterations = 10\nmax_halvings = 2\n");
  folder_.write("beam/bench.csv", "trial,pull_N,tip_mm\na,1e6,1\n");
  const Outcome fit = taut({"fit", experiment_, "--out", folder_ / "run", "--quiet"});
  EXPECT_EQ(fit.code, 3) << fit.err;
  expect_holds(fit.err, {"no equilibrium at pull = 1000 kN", "start of the fit", "taut replay"});
  EXPECT_FALSE(fs::exists(folder_ / "run/fit.json"));
}

TEST_F(Command, AFitInterruptedBeforeItHasAResultEndsSoonWithCode130AndLeavesNoRun) {
  // Fine enough to last for minutes.
  folder_.write("beam/experiment.toml", replaced(beam_toml, "cells = [10, 4]", "cells = [400, 80]"));
  const pid_t child = start({"fit", experiment_, "--out", folder_ / "run"}, here_);
  wait_until_said(child, here_, "fitting ");
  kill(child, SIGINT);
  const auto asked = std::chrono::steady_clock::now();
  const Outcome fit = finish(child, here_);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - asked).count();
  EXPECT_EQ(fit.code, 130) << fit.err;
  EXPECT_LT(seconds, 30) << "the machine may be busy";
  std::printf("ended %.1f s after the interrupt\n", seconds);
  expect_holds(fit.err, {"interrupted before the fit had a result"});
  EXPECT_FALSE(fs::exists(folder_ / "run/fit.json"));
}

// ---- the measured block, coarsely

class SlowSiliconeBlock : public Command {};

TEST_F(SlowSiliconeBlock, ItsModulusIsThatOfTheReadmeForItsMesh) {
  std::string toml = text_of(TAUT_SOURCE_DIR "/experiments/silicone_block/experiment.toml");
  const size_t variants = toml.find("[[fit.variant]]"), references = toml.find("[[fit.reference]]");
  ASSERT_TRUE(variants != std::string::npos && references != std::string::npos && variants < references);
  toml.erase(toml.rfind("\n\n", variants) + 1, references - toml.rfind("\n\n", variants) - 1);
  const size_t cells = toml.find("cells = [14, 5, 5]");
  ASSERT_NE(cells, std::string::npos);
  toml.replace(cells, 18, "cells = [8, 3, 3]");
  const std::string csv = "../../data/silicone_block/static_tip_displacement.csv";
  folder_.write("block.toml", replaced(toml, csv, TAUT_SOURCE_DIR "/data/silicone_block/static_tip_displacement.csv"));
  const Outcome fit = taut({"fit", folder_ / "block.toml", "--out", folder_ / "run", "--json"});
  ASSERT_EQ(fit.code, 0) << fit.err;
  const json result = json::parse(fit.out);
  EXPECT_EQ(result.at("parameters")[0].at("id"), "E_silicone");
  // README.md's table for these cells; finer ones tend to 271 kPa.
  EXPECT_NEAR(result.at("parameters")[0].at("value"), 270.6e3, 0.001 * 270.6e3);
  EXPECT_TRUE(result.at("variants").empty());
  EXPECT_EQ(result.at("readings").size(), 18u);
}

TEST(SimulateCommand, WritesTheRunAndSaysWhatTheTestsAfterwardsSaw) {
  const TemporaryFolder folder;
  folder.write("robot.toml", robot_toml);
  const Outcome run = run_in(folder / "", {"simulate", "robot.toml", "--json", "-q"});
  ASSERT_EQ(run.code, 0) << run.err;
  const json result = json::parse(run.out);
  EXPECT_TRUE(result["simulated"]);
  expect_holds(result["facts"]["intersections"], {"none in 21 states"});
  expect_holds(result["facts"]["inverted elements"], {"none in 21 states"});
  EXPECT_NEAR(result["channels"]["shoulder_angle"]["end"], 20 * M_PI / 180, 0.01);
  for (const char* file : {"report.html", "animation.html", "channels.csv", "robot.pvd", "figures/strip.svg"})
    EXPECT_TRUE(fs::exists(folder / (std::string("runs/robot/") + file))) << file;
  expect_holds(text_of(folder / "runs/robot/channels.csv"), {"time_s,pull_mm,motor_deg,tip_y_mm"});
  expect_holds(text_of(folder / "runs/robot/report.html"), {"A small robot", "simulation"});
}

/// A square of 8 mm whose right side is listed twice, with a node that nothing uses.
const std::string mended_msh = R"($MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
3
1 1 "xmin"
1 2 "xmax"
2 3 "rubber"
$EndPhysicalNames
$Nodes
5
1 0 0 0
2 8 0 0
3 8 8 0
4 0 8 0
5 4 4 0
$EndNodes
$Elements
5
1 1 2 1 1 1 4
2 1 2 2 2 2 3
3 1 2 2 2 2 3
4 2 2 3 1 1 2 3
5 2 2 3 1 1 3 4
$EndElements
)";

TEST_F(Command, WhatWasMendedInAMeshIsSaidOnceByEveryCommand) {
  for (const char* folder : {"beam/", ""}) folder_.write(folder + std::string("square.msh"), mended_msh);
  const std::string geometry = "kind = \"msh\"\nfile = \"square.msh\"\nunit = \"mm\"\ndimension = 2\n";
  std::string toml =
      replaced(beam_toml, "kind = \"rectangle\"\nsize = [\"60 mm\", \"12 mm\"]\nregion = \"foam\"\n", geometry);
  toml = replaced(replaced(toml, "cells = [10, 4]\n", ""), "[materials.foam]", "[materials.rubber]");
  folder_.write("beam/experiment.toml", replaced(toml, "E_foam", "E_rubber"));
  folder_.write("robot.toml",
                replaced(robot_toml,
                         "{ kind = \"rectangle\", size = [\"8 mm\", \"8 mm\"], region = \"rubber\" }\n"
                         "mesh = { cells = [2, 2], element",
                         "{ kind = \"msh\", file = \"square.msh\", unit = \"mm\", dimension = 2 }\nmesh = { element"));
  const std::string out = folder_ / "out", robot = folder_ / "robot.toml";
  for (const std::vector<std::string>& arguments :
       std::vector<std::vector<std::string>>{{"check", experiment_},
                                             {"replay", experiment_, "--out", out + "/replay"},
                                             {"fit", experiment_, "--out", out + "/fit"},
                                             {"check", robot},
                                             {"simulate", robot, "--out", out + "/robot"}}) {
    SCOPED_TRACE(arguments[0] + " " + arguments[1]);
    const Outcome outcome = taut(arguments);
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    const std::string said = outcome.out + outcome.err;
    for (const std::string remark : {"'xmax' lists 1 of its entities twice; each counts once",
                                     "1 node is in no triangle, at (4, 4) mm; left out"}) {
      const size_t first = said.find(remark);
      EXPECT_NE(first, std::string::npos) << remark << said;
      EXPECT_EQ(said.find(remark, first + 1), std::string::npos) << remark << said;
    }
  }
}

TEST(SimulateCommand, CheckUnderstandsAndOtherCommandsSendASimulationThere) {
  const TemporaryFolder folder;
  folder.write("robot.toml", robot_toml);
  folder.write("beam.toml", beam_toml);
  folder.write("bench.csv", beam_csv);
  const Outcome checked = run_in(folder / "", {"check", "robot.toml"});
  EXPECT_EQ(checked.code, 0) << checked.err;
  expect_holds(checked.out, {"body arm", "control pull", "channel tension", "implicit Euler"});
  for (const char* command : {"fit", "replay", "draw"}) {
    const Outcome sent = run_in(folder / "", {command, "robot.toml"});
    EXPECT_EQ(sent.code, 2) << command;
    expect_holds(sent.err, {"taut simulate robot.toml"});
  }
  const Outcome wrong = run_in(folder / "", {"simulate", "beam.toml"});
  EXPECT_EQ(wrong.code, 2);
  expect_holds(wrong.err, {"beam.toml", "not a simulation"});
}

TEST(SimulateCommand, AnInterruptedOrFailedRunKeepsWhatWasFinished) {
  const TemporaryFolder folder;
  folder.write("robot.toml", replaced(robot_toml, "duration = \"40 ms\"", "duration = \"500 s\""));
  const pid_t child = start({"simulate", "robot.toml"}, folder / "");
  wait_until_said(child, folder / "", " of 500 s, ");
  kill(child, SIGINT);
  const Outcome stopped = finish(child, folder / "");
  EXPECT_EQ(stopped.code, 130) << stopped.err;
  EXPECT_TRUE(fs::exists(folder / "runs/robot/channels.csv"));
  expect_holds(stopped.out, {"ended early"});

  // A first equilibrium that Newton's method may not look for long enough.
  std::string toml = replaced(robot_toml, "integrator = \"implicit_euler\"",
                              "integrator = \"static\"\nmax_iterations = 1\nstart = \"rest\"");
  toml = replaced(
      toml, "[[channel]]\nid = \"block_force\"\nkind = \"net_force\"\nof = \"block\"\ndirection = [0, 1]\n\n", "");
  toml = replaced(toml, "velocity = [\"0 m/s\", \"-0.5 m/s\"]", "clamped = [\"ymin\"]");
  folder.write("hopeless.toml", toml);
  const Outcome failed = run_in(folder / "", {"simulate", "hopeless.toml", "-q"});
  EXPECT_EQ(failed.code, 3) << failed.out << failed.err;
  expect_holds(failed.err, {"hopeless.toml", "stopped at 0 s"});
}

TEST(IkCommand, SaysWhichTargetsWereReachedAndByWhichControls) {
  const TemporaryFolder folder;
  folder.write("robot.toml", posed_robot_toml);
  const Outcome run = run_in(folder / "", {"ik", "robot.toml", "-q"});
  EXPECT_EQ(run.code, 0) << run.err;
  expect_holds(run.out, {"up: reached", "wanted 20 mm", "far: out of reach", "motor", "40 deg"});
  const Outcome none = run_in(folder / "", {"ik", "robot.toml", "--target", "dwon"});
  EXPECT_EQ(none.code, 2);
  expect_holds(none.err, {"dwon"});
  for (const char* file : {"ik.csv", "channels.csv", "report.html", "animation.html", "robot_ik.pvd", ".files"})
    EXPECT_TRUE(fs::exists(folder / (std::string("runs/robot/") + file))) << file;
}

/// `taut ik --stream` with these lines on its stdin; its answers.
std::vector<nlohmann::json> streamed(const std::string& lines, const std::string& toml = posed_robot_toml) {
  const TemporaryFolder folder;
  folder.write("robot.toml", toml);
  folder.write("lines", lines);
  const std::string command =
      std::string("cd '") + (folder / "") + "' && '" TAUT_BINARY "' ik robot.toml --stream < lines > out";
  EXPECT_EQ(std::system(command.c_str()), 0);
  EXPECT_FALSE(fs::exists(folder / "runs")) << "no folder is written";
  std::vector<nlohmann::json> answers;
  std::istringstream out(text_of(folder / "out"));
  for (std::string line; std::getline(out, line);) answers.push_back(nlohmann::json::parse(line));
  return answers;
}

TEST(IkCommand, AnswersTargetsFromAStreamOneByOne) {
  const std::vector<nlohmann::json> answers = streamed(R"({"tip_y": "20 mm", "name": "a"}
{"tip_y": 0.021}

{"tip_y": "200 mm"})");
  ASSERT_EQ(answers.size(), 3u);
  EXPECT_EQ(answers[0].at("name"), "a");
  EXPECT_EQ(answers[0].at("status"), "reached");
  EXPECT_EQ(answers[1].at("status"), "reached");
  EXPECT_NEAR(answers[1].at("channels").at("tip_y").at("achieved").get<double>(), 0.021, 1e-4);
  EXPECT_EQ(answers[1].at("channels").at("tip_y").at("unit"), "m");
  EXPECT_EQ(answers[1].at("controls").at("motor").at("unit"), "rad");
  EXPECT_GT(answers[1].at("controls").at("motor").at("value"), answers[0].at("controls").at("motor").at("value"));
  EXPECT_LT(answers[1].at("factorisations"), answers[0].at("factorisations")) << "each starts from the last one";
  EXPECT_GT(answers[1].at("milliseconds"), 0);
  EXPECT_EQ(answers[2].at("status"), "unreachable");
  EXPECT_GT(answers[2].at("error_m"), 0.05);
}

TEST(IkCommand, WhatIsWrongWithALineIsSaidAndTheStreamGoesOn) {
  const std::vector<nlohmann::json> answers = streamed(R"(nonsense
{"tip_y": "20 N", "name": 7}
{"tip_z": 0.02}
{"tip_y": [1]}
{}
{"tip_y": 0.02, "hold": {"motr": 0}}
{"tip_y": 0.02, "hold": {"motor": 0}}
{"tip_y": 0.02, "hold": 3}
{"tip_y": 0.02, "stiffness": {"tip_y": "-1 N/m"}}
{"tip_y": 0.02}
)");
  const std::vector<std::vector<std::string>> parts{{"line 1", "no JSON object"},
                                                    {"line 2", "tip_y", "force"},
                                                    {"line 3", "tip_z", "did you mean 'tip_y'"},
                                                    {"line 4", "tip_y", "a number in m"},
                                                    {"line 5", "needs the value of a channel"},
                                                    {"line 6", "did you mean 'motor'"},
                                                    {"line 7", "all controls are held"},
                                                    {"line 8", "an object belongs here"},
                                                    {"line 9", "stiffness", "positive"}};
  ASSERT_EQ(answers.size(), parts.size() + 1);
  for (size_t k = 0; k < parts.size(); ++k) expect_holds(answers[k].at("error").get<std::string>(), parts[k]);
  EXPECT_EQ(answers[1].at("name"), 7);
  EXPECT_EQ(answers.back().at("status"), "reached");
}

TEST(IkCommand, AStreamTakesNeitherTargetNorFolder) {
  const TemporaryFolder folder;
  folder.write("robot.toml", posed_robot_toml);
  const Outcome outcome = run_in(folder / "", {"ik", "robot.toml", "--stream", "--out", "there"});
  EXPECT_EQ(outcome.code, 2);
  expect_holds(outcome.err, {"--stream", "--out"});
}

}  // namespace
}  // namespace taut

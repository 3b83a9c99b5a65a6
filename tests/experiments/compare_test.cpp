#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "tests/support/command.hpp"
#include "tests/support/experiment_files.hpp"

// `taut compare` and `taut recheck`: two benches of the small beam, the second one softer.
namespace taut {
namespace {

using namespace test;
using nlohmann::json;

class Compare : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new TemporaryFolder;
    fit("first", beam_toml, "trial,pull_N,tip_mm\na,0.05,1\na,0.1,2.05\nb,0.05,1.05\nb,0.1,2\n");
    fit("again", replaced(beam_toml, "\"60 mm\"", "\"6 cm\"") + "# the same bench, in other words\n",
        "trial,pull_N,tip_mm\na,0.05,1\na,0.1,2.05\nb,0.05,1.05\nb,0.1,2\n");
    fit("softer", replaced(beam_toml, "nu = 0.3", "nu = 0.25"),
        "trial,pull_N,tip_mm\na,0.05,2\na,0.1,4.05\nb,0.05,2.05\nb,0.1,2.0\nc,0.1,4.1\n");
    fit("near", beam_toml, "trial,pull_N,tip_mm\na,0.05,1.01\na,0.1,2.05\nb,0.05,1.05\nb,0.1,2.01\n");
  }
  static void TearDownTestSuite() { delete folder_; }

  static void fit(const std::string& name, const std::string& toml, const std::string& csv) {
    std::filesystem::create_directory(*folder_ / name);
    folder_->write(name + "/experiment.toml", toml);
    folder_->write(name + "/bench.csv", csv);
    run_in(*folder_ / "", {"fit", name + "/experiment.toml", "--quiet", "--no-variants", "--out", "runs/" + name});
  }
  static Outcome taut(const std::vector<std::string>& arguments) { return run_in(*folder_ / "", arguments); }
  static json record(const std::string& run) { return json::parse(text_of(*folder_ / ("runs/" + run + "/fit.json"))); }

  static TemporaryFolder* folder_;
};
TemporaryFolder* Compare::folder_ = nullptr;

TEST_F(Compare, ARunInOtherWordsIsTheSame) {
  const Outcome outcome = taut({"compare", "runs/first", "runs/again", "--json"});
  EXPECT_EQ(outcome.code, 0) << outcome.err;
  const json found = json::parse(outcome.out).at("comparisons")[0];
  EXPECT_FALSE(found.at("differs").get<bool>());
  EXPECT_TRUE(found.at("same_readings").get<bool>());
  EXPECT_TRUE(found.at("inputs").empty()) << found.at("inputs");
  expect_holds(taut({"compare", "runs/first", "runs/again"}).out,
               {"agree", "the experiment files say the same", "the same 4 readings"});
}

TEST_F(Compare, ParametersAreApartByTheirCombinedSigmas) {
  // Both moduli are fitted as logarithms, and the shares of both, 95 % half widths, are in common: mesh and section
  // move both alike, by their value, so that next to nothing of them is left.
  const json found =
      json::parse(taut({"compare", "runs/first", "runs/near", "--json"}).out).at("comparisons")[0].at("parameters")[0];
  const json a = record("first").at("parameters")[0], b = record("near").at("parameters")[0];
  const auto number = [](const json& of, const char* key) { return of.at(key).get<double>(); };
  const double va = std::pow(number(a, "standard_error") / number(a, "value"), 2);
  const double vb = std::pow(number(b, "standard_error") / number(b, "value"), 2);
  const double expected = std::log(number(b, "value") / number(a, "value")) / std::sqrt(va + vb);
  EXPECT_NEAR(number(found, "in_sigmas"), expected, 0.02 * std::abs(expected));
  EXPECT_LT(std::abs(expected), 3);
  EXPECT_NE(found.at("in_common").dump().find("mesh"), std::string::npos);
}

TEST_F(Compare, WhatDiffersIsExitCodeFiveAndSaysWhere) {
  const Outcome outcome = taut({"compare", "runs/first", "runs/softer", "--out", "figures", "--quiet"});
  EXPECT_EQ(outcome.code, 5) << outcome.err;
  expect_holds(outcome.out, {"runs/softer against runs/first: the calibrations differ", "E_foam",
                             "readings: 4 in both, 1 of them equal", "trial a, tip at pull 100 mN: 2.05 mm and 4.05 mm",
                             "trial c, tip at pull 100 mN: not there and 4.1 mm", "materials.foam.nu: 0.3 and 0.25"});
  for (const std::string name : {"compare_parameters", "compare_curves"})
    expect_holds(text_of(*folder_ / ("figures/figures/" + name + ".svg")), {"SIMULATED DATA", "runs/softer"});
  EXPECT_EQ(taut({"compare", "runs/first", "runs/again", "runs/softer", "--quiet"}).code, 5);
}

TEST_F(Compare, WrongInputIsOneSentence) {
  const auto refuses = [&](const std::vector<std::string>& arguments, const std::vector<std::string>& parts) {
    const Outcome outcome = taut(arguments);
    EXPECT_EQ(outcome.code, 2) << outcome.err;
    expect_holds(outcome.err, parts);
    EXPECT_EQ(std::count(outcome.err.begin(), outcome.err.end(), '\n'), 1) << outcome.err;
  };
  refuses({"compare"}, {"RUN_FOLDER", "is missing"});
  refuses({"compare", "runs/first"}, {"name two run folders or more"});
  refuses({"compare", "runs/first", "runs/nowhere"}, {"runs/nowhere"});
  refuses({"compare", "runs/first", "runs/again", "--sigmas", "0"}, {"--sigmas", "larger than zero"});
  refuses({"recheck"}, {"RUN_FOLDER is missing"});
  refuses({"recheck", "runs/nowhere"}, {"runs/nowhere"});
}

TEST_F(Compare, ARunThatIsDoneAgainIsTheSameAtEveryStage) {
  const Outcome outcome = taut({"recheck", "runs/first", "--quiet"});
  EXPECT_EQ(outcome.code, 0) << outcome.out << outcome.err;
  expect_holds(outcome.out, {"inputs: same", "replay at the same parameters: same", "fit: same", "checked by taut"});
}

TEST_F(Compare, ARunThatDiffersSaysAtWhichStage) {
  fit("changed", beam_toml, "trial,pull_N,tip_mm\na,0.05,1\na,0.1,2.05\nb,0.05,1.05\nb,0.1,2\n");
  const std::string path = *folder_ / "runs/changed/fit.json";
  const json whole = json::parse(text_of(path));
  const auto stage_of = [&](const json& record) {
    std::ofstream(path) << record.dump(1);
    const Outcome outcome = taut({"recheck", "runs/changed", "--json", "--quiet"});
    EXPECT_EQ(outcome.code, 5) << outcome.err;
    return json::parse(outcome.out).at("differs_at").get<std::string>();
  };
  json record = whole;
  record["parameters"][0]["standard_error"] = 2 * whole["parameters"][0]["standard_error"].get<double>();
  EXPECT_EQ(stage_of(record), "fit");
  record = whole;
  const double predicted = whole["readings"][2]["predicted"].get<double>();
  record["readings"][2]["predicted"] = 1.05 * predicted;
  EXPECT_EQ(stage_of(record), "replay at the same parameters");
  const std::string copy = *folder_ / ("runs/changed/" + whole["provenance"]["inputs"][1]["copy"].get<std::string>());
  std::ofstream(copy, std::ios::app) << "c,0.1,2\n";
  EXPECT_EQ(stage_of(whole), "inputs");
}

}  // namespace
}  // namespace taut

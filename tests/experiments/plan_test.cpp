#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "tests/support/cable_bar.hpp"
#include "tests/support/command.hpp"
#include "tests/support/experiment_files.hpp"

// `taut plan`, on a bar whose cable pulls from a retraction of 3 mm on.
namespace taut {
namespace {

using namespace test;
using nlohmann::json;

constexpr double kNormal95 = 1.959963984540054;

class Plan : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new TemporaryFolder;
    fit_own_readings(*folder_, "run", bar_toml, {0, 5, 10}, 0.1);
    fit_own_readings(*folder_, "open", bar_toml, {0, 1, 2}, 0.1);  // where the cable is slack
    folder_->write("blank.toml", replaced(bar_toml, "bench.csv", "blank.csv"));
    folder_->write("blank.csv", "retraction_mm,pull_N,tip_mm\n0,0.1,\n0,0.2,\n10,0.1,\n10,0.2,\n");
  }
  static void TearDownTestSuite() { delete folder_; }

  static Outcome plan(std::vector<std::string> arguments, const std::string& of = "run") {
    arguments.insert(arguments.begin(), {"plan", of, "--quiet"});
    return run_in(*folder_ / "", arguments);
  }
  static json planned(std::vector<std::string> arguments, const std::string& of = "run") {
    arguments.emplace_back("--json");
    const Outcome outcome = plan(std::move(arguments), of);
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    return json::parse(outcome.out);
  }
  static json fit(const std::string& run = "run") { return json::parse(text_of(*folder_ / (run + "/fit.json"))); }
  static double value(const std::string& id, const std::string& run = "run") {
    const json all = fit(run);
    for (const json& one : all.at("parameters")) {
      if (one.at("id") == id) return one.at("value").get<double>();
    }
    ADD_FAILURE() << id;
    return 0;
  }

  /// The tip at the rows of a file [m] by their controls in the order of the bench, with these E [Pa] and k [N/m].
  using Tips = std::map<std::vector<double>, double>;
  static Tips tips(const std::string& rows, double E, double k) {
    const std::string out = done_in(*folder_ / "", {"replay", "of_run/bar.toml", "--rows", rows, "--json", "--quiet",
                                                    "--out", "replay", "--set", fmt::format("E_foam={:.12g} Pa", E),
                                                    "--set", fmt::format("k_cable={:.12g} N/m", k)})
                                .out;
    Tips values;
    const json replay = json::parse(out);
    for (const json& row : replay.at("rows"))
      values[row.at("controls").get<std::vector<double>>()] = row.at("predicted_m").get<double>();
    return values;
  }

  static TemporaryFolder* folder_;
};
TemporaryFolder* Plan::folder_ = nullptr;

/// sqrt of the variance of the second of two parameters with this information.
double deviation_of_second(const std::array<std::array<double, 2>, 2>& information) {
  const double det = information[0][0] * information[1][1] - information[0][1] * information[1][0];
  return std::sqrt(information[0][0] / det);
}

TEST_F(Plan, WidthsAreThoseOfTheFitAndOfSlopesByDifferences) {
  std::filesystem::remove(*folder_ / "next.csv");
  const json found = planned({"--parameter", "k_cable", "--count", "3", "--draws", "1", "--out", "next.csv"});
  const double E = value("E_foam"), k = value("k_cable");
  // What the fit says and the prior: a quarter of the bounds' range each.
  const json covariance = fit().at("fit").at("covariance");
  const double a = covariance[0][0], b = covariance[0][1], d = covariance[1][1], det = a * d - b * b;
  std::array<std::array<double, 2>, 2> information{{{d / det, -b / det}, {-b / det, a / det}}};
  information[0][0] += std::pow(4 / std::log(10e6 / 1e3), 2);
  information[1][1] += std::pow(4 / std::log(1e3 / 0.1), 2);
  const double before = found.at("goal").at("before").at("noise_half95").get<double>();
  EXPECT_NEAR(before, kNormal95 * k * deviation_of_second(information), 1e-3 * before);
  // Each row adds its slopes by ln E and ln k, over 1 um.
  const Tips by_E[] = {tips("next.csv", E * 0.999, k), tips("next.csv", E * 1.001, k)},
             by_k[] = {tips("next.csv", E, k * 0.999), tips("next.csv", E, k * 1.001)};
  for (const json& row : found.at("rows")) {
    EXPECT_EQ(row.at("fails"), 0);
    EXPECT_GE(row.at("controls")[1].get<double>(), 3e-3) << "the cable is slack before";
  }
  std::istringstream csv(text_of(*folder_ / "next.csv"));
  std::string line;
  std::getline(csv, line);
  EXPECT_EQ(line, "retraction_mm,pull_N,tip_mm");  // as the bench file has them
  std::vector<std::pair<double, double>> written;
  while (std::getline(csv, line)) {
    double retraction = 0, pull = 0;
    ASSERT_EQ(std::sscanf(line.c_str(), "%lf,%lf,", &retraction, &pull), 2) << line;
    EXPECT_EQ(line.back(), ',');
    written.emplace_back(1e-3 * retraction, pull);
  }
  ASSERT_EQ(written.size(), 3u);
  for (size_t i = 0; i < 3; ++i) {
    EXPECT_NEAR(found.at("rows")[i].at("controls")[1].get<double>(), written[i].first, 1e-9);
    EXPECT_NEAR(found.at("rows")[i].at("controls")[0].get<double>(), written[i].second, 1e-9);
    const auto slope = [&](const Tips(&tips)[2]) {
      const auto there = [&](const Tips& side) {
        const auto tip = std::ranges::find_if(side, [&](const auto& one) {
          return std::abs(one.first[0] - written[i].second) < 1e-9 && std::abs(one.first[1] - written[i].first) < 1e-9;
        });
        return tip == side.end() ? NAN : tip->second;
      };
      return (there(tips[1]) - there(tips[0])) / 0.002 / 1e-6;
    };
    const double slope_E = slope(by_E), slope_k = slope(by_k);
    information[0][0] += slope_E * slope_E;
    information[0][1] += slope_E * slope_k;
    information[1][0] += slope_E * slope_k;
    information[1][1] += slope_k * slope_k;
    const double after = found.at("rows")[i].at("after").at("noise_half95").get<double>();
    EXPECT_NEAR(after, kNormal95 * k * deviation_of_second(information), 2e-3 * after) << i;
  }
  EXPECT_EQ(found.at("goal").at("after"), found.at("rows")[2].at("after"));
  // The cheapest rows are those without a retraction, which say nothing of the cable.
  const json& cheapest = found.at("instead")[0];
  EXPECT_NE(cheapest.at("what").get<std::string>().find("retraction = 0 mm"), std::string::npos);
  EXPECT_GT(cheapest.at("after").at("noise_half95").get<double>(), found.at("goal").at("after").at("noise_half95"));
}

TEST_F(Plan, TheRowsAreABenchToFillIn) {
  std::filesystem::remove(*folder_ / "fill.csv");
  const json found = planned({"--parameter", "k_cable", "--count", "5", "--out", "fill.csv"});
  folder_->write("fill.toml", replaced(bar_toml, "bench.csv", "fill.csv"));
  const Outcome check = done_in(*folder_ / "", {"check", "fill.toml", "--quiet"});
  expect_holds(check.out, {"planned, without readings: 5 readings"});
  const json replay =
      json::parse(done_in(*folder_ / "", {"replay", "fill.toml", "--json", "--quiet", "--out", "replay"}).out);
  ASSERT_EQ(replay.at("rows").size(), 5u);
  for (size_t i = 0; i < 5; ++i) {
    for (int k : {0, 1})
      EXPECT_NEAR(replay.at("rows")[i].at("controls")[k].get<double>(),
                  found.at("rows")[i].at("controls")[k].get<double>(), 1e-9);
  }
  const Outcome again = plan({"--parameter", "k_cable", "--out", "fill.csv"});
  EXPECT_EQ(again.code, 2);
  expect_holds(again.err, {"fill.csv", "not overwritten"});
}

TEST_F(Plan, TrialsGoOnFromThoseOfTheBench) {
  folder_->write("beam.toml", replaced(beam_toml, "bench.csv", "beam.csv"));
  folder_->write("beam.csv", "trial,pull_N,tip_mm\n2,0.05,1.55\n2,0.1,3.1\n7,0.05,1.52\n7,0.1,3.05\n");
  done_in(*folder_ / "", {"fit", "beam.toml", "--quiet", "--out", "beam", "--no-variants"});
  planned({"--count", "2", "--try", "pull=0.1 N", "--out", "trials.csv"}, "beam");
  EXPECT_EQ(text_of(*folder_ / "trials.csv"), "trial,pull_N,tip_mm\n8,0.1,\n9,0.1,\n");
}

TEST_F(Plan, APredictionIsNarrowedFromWhatPredictSays) {
  folder_->write("at.csv", "retraction_mm,pull_N\n8,0.15\n");
  const json predicted =
      json::parse(done_in(*folder_ / "", {"predict", "run", "--rows", "at.csv", "--json", "-q"}).out).at("rows")[0];
  const json found =
      planned({"--predict", "tip", "--at", "retraction=8mm, pull=0.15 N", "--draws", "1", "--minutes", "22"});
  const json& goal = found.at("goal");
  EXPECT_EQ(goal.at("id"), "tip at pull = 150 mN, retraction = 8 mm");
  EXPECT_NEAR(goal.at("value").get<double>(), predicted.at("predicted_m").get<double>(), 1e-8);
  const double half = kNormal95 * predicted.at("standard_error_m").get<double>();
  EXPECT_NEAR(goal.at("before").at("noise_half95").get<double>(), half, 5e-3 * half);
  EXPECT_LT(goal.at("after").at("noise_half95").get<double>(), half);
  // A running total: never less than before, and with the last row all that the plan takes.
  double before = 0;
  for (const json& row : found.at("rows")) {
    EXPECT_GT(row.at("minutes_so_far").get<double>(), before);
    before = row.at("minutes_so_far").get<double>();
  }
  EXPECT_LE(before, 22);
  EXPECT_GE(before, 21);
}

TEST_F(Plan, TheTextHasCostsRowsAndWhatElseTheTimeWouldGive) {
  const Outcome outcome = plan({"--parameter", "k_cable", "--setup", "3min", "--rest", "90 s"});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  expect_holds(outcome.out, {"SIMULATED DATA", "goal: k_cable = ", "read in each row: tip",
                             "set-up 3 min for each retraction (--setup)", "rest 1.5 min (--rest)",
                             "reading 1 min (--reading)", "4 rows in 13 min", "retraction", "in all", "fails",
                             "k_cable (goal)", "E_foam", "instead, for the same time:",
                             "the bench's cheapest rows again", "the best of the bench's own rows again"});
}

TEST_F(Plan, BeforeAnyReadingThePriorIsSaid) {
  const Outcome outcome = plan({}, "blank.toml");
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  expect_holds(outcome.out,
               {"known before any reading (prior, one standard deviation): E_foam 80 kPa within a factor of 10",
                "k_cable 5 N/m within a factor of 10", "4 rows in "});
  EXPECT_EQ(outcome.out.find("SIMULATED"), std::string::npos);
  EXPECT_EQ(outcome.out.find("instead"), std::string::npos);
  const json found = planned({}, "blank.toml");
  EXPECT_EQ(found.at("data"), "none");
  // Quarters of ln 10^4 about the starts: both factors of 10.
  for (const json& one : found.at("prior")) EXPECT_NEAR(one.at("deviation").get<double>(), std::log(10), 1e-9);
  EXPECT_NEAR(found.at("goal").at("before").at("noise_half95").get<double>(),
              kNormal95 * std::log(10) * found.at("goal").at("value").get<double>(), 1e-6 * 80e3);
  // A header alone: the values have to be named.
  folder_->write("header.toml", replaced(bar_toml, "bench.csv", "header.csv"));
  folder_->write("header.csv", "retraction_mm,pull_N,tip_mm\n");
  const Outcome nothing = plan({}, "header.toml");
  EXPECT_EQ(nothing.code, 2);
  expect_holds(nothing.err, {"has no row yet", "--try \"pull=FROM..TO\""});
  planned({"--try", "pull=0.1 N..0.2 N", "--try", "retraction=0 mm..10 mm"}, "header.toml");
}

TEST_F(Plan, AFileWithReadingsIsFittedFirst) {
  const Outcome outcome = plan({}, "of_run/bar.toml");
  EXPECT_EQ(outcome.code, 2);
  expect_holds(outcome.err, {"has readings", "fit it first: taut fit of_run/bar.toml"});
}

TEST_F(Plan, WhereNothingReachableHelpsItSaysFromWhereOnSomethingDoes) {
  const Outcome outcome = plan({"--parameter", "k_cable", "--try", "retraction=0 mm..2 mm"}, "open");
  EXPECT_EQ(outcome.code, 4) << outcome.out;
  const std::string seen = "k_cable begins to be seen beyond the candidates: retraction ";
  expect_holds(outcome.out, {"no candidate narrows k_cable by 5 %", seen});
  // The cable's way from slack to taut begins at 5 - 4 / 2 mm, of which a pull of 0.2 N at 400 N/m is 0.5 mm.
  const double from = std::stod(outcome.out.substr(outcome.out.find(seen) + seen.size()));
  EXPECT_GT(from, 2.49);
  EXPECT_LT(from, 3);
  const Outcome slack = plan({"--parameter", "k_cable", "--try", "retraction=0 mm..1 mm"}, "open");
  EXPECT_EQ(slack.code, 4);
  expect_holds(slack.out, {"nor do rows with one control beyond the candidates"});
}

TEST_F(Plan, WhereSharesAreAllThatIsLeftMoreReadingsDoNotHelp) {
  fit_own_readings(*folder_, "thick", replaced(bar_toml, "thickness = \"20 mm\"", "thickness = \"20 mm +- 2 mm\""),
                   {0, 5, 10}, 0.1);
  const Outcome outcome = plan({"--parameter", "E_foam"}, "thick");
  expect_holds(outcome.out, {"more readings do not help", "thickness: measure it better"});
  const Outcome as_json = plan({"--parameter", "E_foam", "--json"}, "thick");
  const json goal = json::parse(as_json.out).at("goal");
  // A bar's stiffness is E times its thickness, so that 10 % of one are 10 % of the other.
  const double tenth = 0.1 * value("E_foam", "thick");
  EXPECT_NEAR(goal.at("before").at("total_half95").get<double>(), tenth, 0.02 * tenth);
}

TEST_F(Plan, CandidatesMayComeFromAFile) {
  folder_->write("rows.csv", "retraction_mm,pull_N\n4,0.1\n10,0.2\n4,0.1\n");
  const json found = planned({"--parameter", "k_cable", "--rows", "rows.csv", "--count", "2"});
  EXPECT_EQ(found.at("candidates"), 2);
  for (const json& row : found.at("rows")) {
    const double retraction = row.at("controls")[1].get<double>();
    EXPECT_TRUE(std::abs(retraction - 4e-3) < 1e-9 || std::abs(retraction - 10e-3) < 1e-9) << retraction;
  }
}

TEST_F(Plan, WithoutAGoalItIsTheParameterKnownWorst) {
  const json parameters = fit().at("parameters");
  const auto relative = [&](size_t j) {
    return parameters[j].at("standard_error").get<double>() / parameters[j].at("value").get<double>();
  };
  const std::string worst = relative(0) > relative(1) ? "E_foam" : "k_cable";
  EXPECT_EQ(planned({}).at("goal").at("id"), worst);
}

TEST_F(Plan, WrongInputIsOneSentenceOfPlan) {
  const auto refuses = [&](const std::vector<std::string>& arguments, const std::vector<std::string>& parts,
                           const std::string& of = "run") {
    const Outcome outcome = plan(arguments, of);
    EXPECT_EQ(outcome.code, 2) << outcome.err;
    EXPECT_EQ(outcome.out, "");
    expect_holds(outcome.err, parts);
    EXPECT_EQ(std::count(outcome.err.begin(), outcome.err.end(), '\n'), 1) << outcome.err;
  };
  refuses({"--parameter", "k_cabel"}, {"--parameter", "did you mean 'k_cable'"});
  refuses({"--parameter", "nu_foam"}, {"'nu_foam' is not among what was fitted"});
  refuses({"--predict", "tip"}, {"--predict", "--at", "belong together"});
  refuses({"--at", "pull=1 N"}, {"--predict", "belong together"});
  refuses({"--parameter", "k_cable", "--predict", "tip", "--at", "pull=1 N"}, {"leave one out"});
  refuses({"--predict", "tap", "--at", "pull=1 N"}, {"--predict", "did you mean 'tip'"});
  refuses({"--predict", "tip", "--at", "pull=0.1 N"}, {"--at", "retraction is missing"});
  refuses({"--predict", "tip", "--at", "pull=0.1 N, pull=0.1 N"}, {"--at", "twice"});
  refuses({"--predict", "tip", "--at", "pull=0.1 mm, retraction=2 mm"}, {"--at", "not a unit of force"});
  refuses({"--try", "retraction"}, {"--try retraction", "ID=VALUE"});
  refuses({"--try", "retracton=1 mm..2 mm"}, {"--try", "did you mean 'retraction'"});
  refuses({"--try", "retraction=2 mm..1 mm"}, {"begins at 2 mm and ends at 1 mm"});
  refuses({"--try", "retraction=1..2"}, {"--try", "unit"});
  refuses({"--try", "pull=0.1 N", "--rows", "rows.csv"}, {"--rows and --try"});
  refuses({"--rows", "nowhere.csv"}, {"nowhere.csv"});
  refuses({"--count", "0.5"}, {"count"});
  refuses({"--count", "-1"}, {"--count -1", "1 to 200"});
  refuses({"--minutes", "-3"}, {"--minutes -3"});
  refuses({"--setup", "5"}, {"--setup", "unit"});
  refuses({"--rest", "0 s", "--reading", "0 s"}, {"takes some time"});
  refuses({"--reading", "-1 s"}, {"--reading", "0 or more"});
  refuses({"--channels", "tap"}, {"--channels", "did you mean 'tip'"});
  refuses({"--levels", "1"}, {"--levels 1"});
  refuses({"--draws", "0"}, {"--draws 0"});
  refuses({}, {"nowhere"}, "nowhere");
  const Outcome short_of_time = plan({"--minutes", "6"});
  EXPECT_EQ(short_of_time.code, 4);
  expect_holds(short_of_time.out, {"one row takes 7 min already"});
}

}  // namespace
}  // namespace taut

#include "reports/report.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <numbers>
#include <set>
#include <sstream>

#include "reports/estimate_text.hpp"
#include "sim/core/units.hpp"
#include "tests/support/message.hpp"
#include "tests/support/run_records.hpp"

namespace taut {
namespace {

using test::contains;
using test::expect_input_error;

class ReportTest : public ::testing::Test {
 protected:
  void SetUp() override {
    // A name that a shell would trip over.
    folder_ = std::filesystem::temp_directory_path() /
              ("taut it's " + std::string(::testing::UnitTest::GetInstance()->current_test_info()->name()) +
               std::to_string(getpid()));
    std::filesystem::remove_all(folder_);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  std::string folder() const { return folder_.string(); }
  std::string file(const std::string& name) const { return (folder_ / name).string(); }

  /// Rows of a CSV file without quoted fields, by the names in its header.
  std::vector<std::map<std::string, std::string>> rows(const std::string& name) const {
    std::istringstream text(read_file(file(name)));
    std::string line;
    std::vector<std::string> header;
    std::vector<std::map<std::string, std::string>> all;
    while (std::getline(text, line)) {
      std::vector<std::string> cells(1);
      for (const char c : line) c == ',' ? cells.emplace_back() : cells.back() += c;
      if (header.empty()) {
        header = cells;
        continue;
      }
      EXPECT_EQ(cells.size(), header.size()) << line;
      std::map<std::string, std::string> row;
      for (size_t i = 0; i < std::min(cells.size(), header.size()); ++i) row[header[i]] = cells[i];
      all.push_back(row);
    }
    return all;
  }

  static int count(const std::vector<std::map<std::string, std::string>>& rows, const std::string& kind) {
    int n = 0;
    for (auto row : rows) n += row["kind"] == kind;
    return n;
  }

  std::filesystem::path folder_;
};

/// The values of an attribute wherever it stands, quotes taken off.
std::vector<std::string> attributes(const std::string& html, const std::string& name) {
  std::vector<std::string> values;
  for (const char quote : {'\'', '"'}) {
    const std::string begin = name + "=" + quote;
    for (size_t at = html.find(begin); at != std::string::npos; at = html.find(begin, at + 1)) {
      const size_t value = at + begin.size();
      values.push_back(html.substr(value, html.find(quote, value) - value));
    }
  }
  return values;
}

std::string html_of(const RunRecord& record) {
  return report_html(record);
}

TEST_F(ReportTest, EveryFigureExistsInThreeFormatsWithItsNumbersAndScript) {
  const std::vector<Figure> figures = write_report(test::hanging_block(), folder());
  std::vector<std::string> names;
  for (const Figure& figure : figures) {
    names.push_back(figure.name);
    EXPECT_FALSE(figure.title.empty() || figure.caption.empty());
    EXPECT_TRUE(contains(figure.svg, "<svg") && contains(figure.svg, "</svg>"));
    const std::string stem = "figures/" + figure.name;
    EXPECT_EQ(read_file(file(stem + ".pdf")).substr(0, 5), "%PDF-");
    EXPECT_EQ(read_file(file(stem + ".png")).substr(0, 4), "\x89PNG");
    for (const char* format : {".svg", ".pdf", ".png"}) {
      EXPECT_GT(std::filesystem::file_size(file(stem + format)), 4000u) << stem << format;
    }
    EXPECT_TRUE(std::filesystem::exists(file(stem + ".csv")));
    EXPECT_TRUE(contains(read_file(file(stem + ".gp")), "plot "));
  }
  EXPECT_EQ(names, (std::vector<std::string>{"force_displacement", "residuals", "effective_stiffness", "variants",
                                             "deformed_shapes"}));
  const auto force = rows("figures/force_displacement.csv");
  EXPECT_EQ(count(force, "reading"), 18);
  EXPECT_EQ(count(force, "curve"), 3 * 41);
  EXPECT_EQ(count(rows("figures/effective_stiffness.csv"), "reading"), 12) << "zero loads have no stiffness";
  EXPECT_EQ(rows("figures/residuals.csv").size(), 18u);
  EXPECT_EQ(rows("figures/deformed_shapes.csv").size(), 4 * 30u);
  auto first = force.front();
  EXPECT_EQ(first["displacement_mm"], "6.494") << "the magnitude, not the direction convention";
  EXPECT_EQ(first["sigma_mm"], "0.2");
}

TEST_F(ReportTest, ShapesOfSeveralMaterialsOrHeldValuesArePanelsWithFilledRegionsAndCables) {
  const RunRecord record = test::push_puppet_module();
  std::string svg;
  for (const Figure& figure : write_report(record, folder())) svg += figure.name == "deformed_shapes" ? figure.svg : "";
  for (const char* text : {"retraction 0 mm", "retraction 17.2 mm", "mass 0 g", "mass 500 g", "foam", "plastic",
                           "cable", "outline at rest", "SIMULATED DATA"}) {
    EXPECT_TRUE(contains(svg, text)) << text;
  }
  const auto all = rows("figures/deformed_shapes.csv");
  EXPECT_EQ(count(all, "cable"), 4 * 5 * 2 * 10);  // conditions, cables, points of each
  std::set<std::string> regions;
  for (auto row : all) regions.insert(row["name"]);
  EXPECT_EQ(regions, (std::set<std::string>{"", "foam", "plastic"}));
}

TEST_F(ReportTest, AReadingThatMakesMostOfChiSquaredIsNamedFirst) {
  RunRecord record = test::push_puppet_module();
  EXPECT_EQ(outlier_text(record), "");
  ReadingRecord& odd = record.readings.front();
  record.fit.chi_squared = 1e4;
  record.fit.chi_squared_p = 0;
  odd.measured = odd.predicted + 0.9 * std::sqrt(1e4) * odd.sigma;
  const std::string text = outlier_text(record);
  EXPECT_EQ(text.find("line " + std::to_string(odd.line) + " alone makes 81 % of chi squared"), 0u) << text;
  write_report(record, folder());
  EXPECT_TRUE(contains(read_file(file("report.html")), text));
  record.fit.status = FitStatus::not_converged;
  write_report(record, folder());
  const std::string page = read_file(file("report.html"));
  EXPECT_TRUE(contains(page, "No result (not converged)"));
  EXPECT_FALSE(contains(page, "class=\"number\"")) << "no large type for what is no result";
}

TEST_F(ReportTest, MoreConditionsThanFitArePickedAndTheCaptionSaysSo) {
  RunRecord record = test::push_puppet_module();
  const ShapeRecord shape = record.shapes.back();
  for (int i = 0; i < 20; ++i) {
    record.shapes.push_back(shape);
    record.shapes.back().column = "mass " + std::to_string(600 + i) + " g";
  }
  for (const Figure& figure : write_report(record, folder())) {
    if (figure.name != "deformed_shapes") continue;
    EXPECT_TRUE(contains(figure.caption, "24 of 100 conditions are shown")) << figure.caption;
    EXPECT_TRUE(contains(figure.svg, "mass 0 g"));
    EXPECT_TRUE(contains(figure.svg, "mass 619 g"));
  }
}

TEST_F(ReportTest, ProfilesAreDrawnAndAnOpenIntervalIsDrawnAndSaidAsOpen) {
  RunRecord record = test::push_puppet_module();
  const auto profiles = [&] {
    Figure found;
    for (const Figure& figure : write_report(record, folder())) {
      if (figure.name == "profiles") found = figure;
    }
    return found;
  };
  Figure figure = profiles();
  for (const char* text : {"3.84", "E_foam: 55.87 to 67.26 kPa", "E_foam [kPa], logarithmic", "mu_tendon: open to 0.46",
                           ">open<", "open: no limit", "SIMULATED DATA"}) {
    EXPECT_TRUE(contains(figure.svg, text)) << text;
  }
  EXPECT_TRUE(contains(figure.caption,
                       "mu_tendon is open below: chi squared rises by 2.9 only as far as 0, the bound of the fit"))
      << figure.caption;
  EXPECT_FALSE(contains(figure.caption, "E_foam is open"));
  const auto all = rows("figures/profiles.csv");
  EXPECT_EQ(count(all, "point"), 4 + 5) << "points too high to draw are here all the same";
  for (auto row : all) {
    if (row["kind"] == "lower95") {
      EXPECT_EQ(row["value"].empty(), row["parameter"] == "mu_tendon");
    }
    if (row["kind"] == "upper95") {
      EXPECT_NEAR(std::stod(row["rise_of_chi_squared"]), 3.8415, 1e-3);
    }
  }

  record.fit.parameters[1].profile.erase(
      record.fit.parameters[1].profile.begin());  // the search ended before the bound
  record.fit.parameters[1].profile.insert(record.fit.parameters[1].profile.begin(), {0.1, 0.8});
  EXPECT_TRUE(contains(profiles().caption, "only as far as 0.1, and no farther could be searched"));
  record.fit.parameters[1].profile.front().second = 5;
  EXPECT_TRUE(contains(profiles().caption, "only because another parameter meets its bound"));

  record.fit.parameters[1].profile.clear();  // its interval is the parabola's: no panel
  figure = profiles();
  EXPECT_FALSE(contains(figure.svg, "mu_tendon"));
  EXPECT_FALSE(contains(figure.svg, "open"));
  record.fit.parameters[0].profile = {{61.3e3, 0}};
  EXPECT_TRUE(profiles().name.empty());
}

TEST_F(ReportTest, DiagnosticsAreDrawnBesideTheWholeFit) {
  RunRecord record = test::push_puppet_module();
  record.diagnostics[2].value = record.diagnostics[2].standard_error = std::numeric_limits<double>::quiet_NaN();
  std::string svg;
  for (const Figure& figure : write_report(record, folder())) svg += figure.name == "diagnostic" ? figure.svg : "";
  for (const char* text : {"From each retraction alone", "retraction = 5.89 mm", "retraction = 11.79 mm (failed)",
                           "whole fit", "E_foam [kPa]", "SIMULATED DATA"}) {
    EXPECT_TRUE(contains(svg, text)) << text;
  }
  auto all = rows("figures/diagnostic.csv");
  ASSERT_EQ(all.size(), 5u);
  EXPECT_EQ(all[0]["part"], "all");
  EXPECT_EQ(all[0]["value"], "61300");
  EXPECT_NEAR(std::stod(all[1]["lower95"]), 61.9e3 - 1.959964 * 1.1e3, 0.1);
  EXPECT_EQ(all[3]["value"], "");
}

TEST_F(ReportTest, ATrendIsAPolynomialThroughEachSeriesOnRequest) {
  RunRecord record = test::empty_record("E", 1e5, 1e3);
  for (const double load : {1.0, 2.0, 3.0, 4.0}) {
    const double stiffness = 100 + 20 * load + 5 * load * load;  // which a parabola meets
    test::add_reading(record, "1", "tip", load, load / stiffness, 1e-4, load / stiffness);
  }
  write_report(record, folder());
  EXPECT_EQ(count(rows("figures/effective_stiffness.csv"), "trend"), 0);
  record.trend_degree = 2;
  write_report(record, folder());
  int points = 0;
  for (auto row : rows("figures/effective_stiffness.csv")) {
    if (row["kind"] != "trend") continue;
    ++points;
    const double load = std::stod(row["load_N"]);
    EXPECT_NEAR(std::stod(row["stiffness_N_per_m"]), 100 + 20 * load + 5 * load * load, 1e-6);
  }
  EXPECT_EQ(points, 41);
  record.trend_degree = 7;  // more than the four loads can tell: the cubic through them
  write_report(record, folder());
  for (auto row : rows("figures/effective_stiffness.csv")) {
    if (row["kind"] == "trend" && row["load_N"] == "2.5") {
      EXPECT_NEAR(std::stod(row["stiffness_N_per_m"]), 100 + 50 + 5 * 6.25, 1e-6);
    }
  }
}

TEST_F(ReportTest, FiguresWithNothingToShowAreLeftOut) {
  RunRecord record = test::tendon_finger();
  record.shapes.clear();
  record.variants.clear();
  record.references.clear();
  std::vector<std::string> names;
  for (const Figure& figure : write_report(record, folder())) names.push_back(figure.name);
  EXPECT_EQ(names, (std::vector<std::string>{"force_displacement", "residuals", "effective_stiffness"}));
  record.load_newtons.clear();
  names.clear();
  for (const Figure& figure : write_report(record, folder())) names.push_back(figure.name);
  EXPECT_EQ(names, (std::vector<std::string>{"residuals"}));
}

TEST_F(ReportTest, StiffnessIsForceOverDisplacementWithItsErrorCarriedOver) {
  RunRecord record = test::empty_record("E", 1e5, 1e3);
  // k = 2 / 0.004 = 500 N/m, sigma_k = F sigma / delta^2 = 2 * 1e-4 / 1.6e-5 = 12.5 N/m
  test::add_reading(record, "a", "tip", 2, -0.004, 1e-4, -0.004);
  // Within 2 sigma of none: at most 0.05 + 0.2 mm, at least 2 / 0.25e-3 = 8000 N/m; 2 / 0.2e-3 = 10000.
  test::add_reading(record, "b", "tip", 2, -0.00005, 1e-4, -0.004);
  test::add_reading(record, "c", "tip", 2, 0, 1e-4, -0.004);
  record.curves = {{"tip", "", {0, 2}, {0, -0.004}, {0, 4e-5}}};
  write_report(record, folder());
  auto all = rows("figures/effective_stiffness.csv");
  ASSERT_EQ(all.size(), 4u);
  EXPECT_EQ(all[0]["displacement_mm"], "4");
  EXPECT_EQ(all[0]["stiffness_N_per_m"], "500");
  EXPECT_EQ(all[0]["sigma_N_per_m"], "12.5");
  EXPECT_NEAR(std::stod(all[0]["band_lower_N_per_m"]), 2 / 4.1e-3, 1e-3);
  EXPECT_NEAR(std::stod(all[0]["band_upper_N_per_m"]), 2 / 3.9e-3, 1e-3);
  for (size_t i : {1u, 2u}) {
    EXPECT_EQ(all[i]["kind"], "at_least");
    EXPECT_EQ(all[i]["stiffness_N_per_m"], "");
    EXPECT_NEAR(std::stod(all[i]["band_lower_N_per_m"]), i == 1 ? 8000 : 10000, 1e-3);
  }
  all.erase(all.begin() + 1, all.begin() + 3);
  EXPECT_EQ(all[1]["kind"], "curve");
  EXPECT_EQ(all[1]["stiffness_N_per_m"], "500");
  EXPECT_NEAR(std::stod(all[1]["sigma_N_per_m"]), 5, 1e-9);
  EXPECT_NEAR(std::stod(all[1]["band_upper_N_per_m"]), 500 + 1.959964 * 5, 1e-5);
  EXPECT_NEAR(std::stod(all[1]["band_lower_N_per_m"]), 500 - 1.959964 * 5, 1e-5);
}

TEST_F(ReportTest, BarsOfStiffnessReachFartherUpThanDownNearNoDisplacement) {
  RunRecord record = test::empty_record("E", 1e5, 1e3);
  // 2.5 sigma off none: from 2 / 3.5e-4 to 2 / 1.5e-4, of either sign.
  test::add_reading(record, "a", "tip", 2, 2.5e-4, 1e-4, 3e-4);
  test::add_reading(record, "b", "tip", 2, -2.5e-4, 1e-4, 3e-4);
  test::add_reading(record, "c", "tip", 2, 4e-3, 1e-4, 4e-3);
  write_report(record, folder());
  auto all = rows("figures/effective_stiffness.csv");
  ASSERT_GE(all.size(), 3u);
  EXPECT_NEAR(std::stod(all[0]["stiffness_N_per_m"]), 8000, 1e-2);
  EXPECT_NEAR(std::stod(all[0]["band_lower_N_per_m"]), 2 / 3.5e-4, 1e-1);
  EXPECT_NEAR(std::stod(all[0]["band_upper_N_per_m"]), 2 / 1.5e-4, 1e-1);
  EXPECT_NEAR(std::stod(all[1]["band_lower_N_per_m"]), -2 / 1.5e-4, 1e-1);
  EXPECT_NEAR(std::stod(all[1]["band_upper_N_per_m"]), -2 / 3.5e-4, 1e-1);
}

TEST_F(ReportTest, WithReadingsAtZeroLoadStiffnessIsThatOfTheIncrement) {
  RunRecord record = test::empty_record("E", 1e5, 1e3);
  test::add_reading(record, "a", "tip", 0, -0.0060, 3e-4, -0.0070);
  test::add_reading(record, "b", "tip", 0, -0.0064, 4e-4, -0.0070);
  test::add_reading(record, "a", "tip", 1, -0.0262, 6e-4, -0.0270);
  record.curves = {{"tip", "", {0, 1}, {-0.007, -0.027}, {1e-4, 4e-4}, {0, 3e-4}}};
  record.readings[0].prediction_se = record.readings[1].prediction_se = 1e-4;
  const std::vector<Figure> figures = write_report(record, folder());
  ASSERT_EQ(figures[2].name, "effective_stiffness");
  EXPECT_TRUE(contains(figures[2].caption, "increment beyond self-weight"));
  auto all = rows("figures/effective_stiffness.csv");
  ASSERT_EQ(all.size(), 2u);
  // delta = 26.2 - 6.2 = 20 mm; its sigma^2 = 0.6^2 + (0.3^2 + 0.4^2) / 4 = 0.65^2 mm^2; k = 50; sigma_k = 0.65 / 0.4
  EXPECT_EQ(all[0]["displacement_mm"], "20");
  EXPECT_EQ(all[0]["stiffness_N_per_m"], "50");
  EXPECT_NEAR(std::stod(all[0]["sigma_N_per_m"]), 1.625, 1e-9);
  // the model: delta = 20 mm, standard error of the increment 0.3 mm
  EXPECT_NEAR(std::stod(all[1]["stiffness_N_per_m"]), 50, 1e-9);
  EXPECT_NEAR(std::stod(all[1]["sigma_N_per_m"]), 0.75, 1e-9);

  record.curves[0].increment_se.clear();  // correlation not known: at most 0.1 + 0.4 mm
  EXPECT_TRUE(contains(write_report(record, folder())[2].caption, "largest possible width"));
  all = rows("figures/effective_stiffness.csv");
  EXPECT_NEAR(std::stod(all[1]["sigma_N_per_m"]), 1.25, 1e-9);
}

TEST_F(ReportTest, NamesWithQuotesCommasAndMarkupAreDrawnAsText) {
  RunRecord record = test::hanging_block();
  record.title = "It's \"100 %\" <b>safe</b>; `ls` $x, {y} \\ \n\"; system(\"touch hacked\") #";
  record.load_label = "load 'P'";
  for (ReadingRecord& reading : record.readings) reading.trial = "first, \"good\" '" + reading.trial + "'";
  EXPECT_EQ(write_report(record, folder()).size(), 5u);
  EXPECT_FALSE(std::filesystem::exists(file("figures/hacked")));
  EXPECT_TRUE(contains(read_file(file("figures/residuals.csv")), "\"first, \"\"good\"\" 'a'\""));
}

TEST_F(ReportTest, ARecordWithoutResultsIsStillReported) {
  RunRecord record = test::hanging_block();
  const double nan = std::numeric_limits<double>::quiet_NaN();
  record.fit.status = FitStatus::start_failed;
  record.fit.message = "the first simulation failed.";
  record.curves.clear();
  record.shapes.clear();
  for (ReadingRecord& reading : record.readings) reading.predicted = reading.prediction_se = nan;
  for (ParameterEstimate& estimate : record.fit.parameters) {
    estimate.value = estimate.standard_error = nan;
    estimate.lower95 = estimate.upper95 = std::nullopt;
    estimate.upper = std::numeric_limits<double>::infinity();
  }
  record.fit.chi_squared = record.fit.chi_squared_p = nan;
  record.variants[0].values = {nan};
  write_run(record, folder());
  const std::string html = read_file(file("report.html"));
  EXPECT_TRUE(contains(html, "No result (start failed): the first simulation failed."));
  EXPECT_TRUE(contains(html, "open on both sides"));
  EXPECT_TRUE(contains(html, "no limit"));
  for (const char* bad : {">nan", " nan", ">inf<", " inf ", ">-nan", "inf Pa", "nan %"})
    EXPECT_FALSE(contains(html, bad)) << bad;
  write_run(RunRecord(), folder() + "/empty");
}

TEST_F(ReportTest, AMissingGnuplotIsNamedWithTheRemedyAndTheResultIsKept) {
  const std::string path = std::getenv("PATH");
  setenv("PATH", "/nonexistent", 1);
  write_run(test::hanging_block(), folder());
  const std::string why = undrawn_figures();
  for (const char* part : {"gnuplot was not found", "apt-get install gnuplot-nox", "taut report"})
    EXPECT_TRUE(contains(why, part)) << why;
  EXPECT_EQ(undrawn_figures(), "") << "said once";
  EXPECT_TRUE(std::filesystem::exists(file("report.html"))) << "the tables are there";
  setenv("PATH", path.c_str(), 1);
  EXPECT_EQ(to_json(read_run(folder())), to_json(test::hanging_block()));
  EXPECT_TRUE(std::filesystem::exists(file("predictions.csv")));
}

TEST_F(ReportTest, AFailingGnuplotIsQuoted) {
  write_file(file("bin/gnuplot"),
             "#!/bin/sh\necho '\"x.gp\" line 3: unknown or ambiguous terminal name' >&2\nexit 1\n");
  std::filesystem::permissions(file("bin/gnuplot"), std::filesystem::perms::owner_all);
  const std::string path = std::getenv("PATH");
  setenv("PATH", (file("bin") + ":" + path).c_str(), 1);
  write_report(test::hanging_block(), folder());
  const std::string why = undrawn_figures();
  for (const char* part : {"force_displacement.gp", "line 3: unknown or ambiguous terminal name", "pdfcairo"})
    EXPECT_TRUE(contains(why, part)) << why;
  setenv("PATH", path.c_str(), 1);
}

/// A program that is called gnuplot, for as long as this lives.
struct FakeGnuplot {
  FakeGnuplot(const std::string& folder, const std::string& script) : path(std::getenv("PATH")) {
    write_file(folder + "/gnuplot", "#!/bin/sh\n" + script);
    std::filesystem::permissions(folder + "/gnuplot", std::filesystem::perms::owner_all);
    setenv("PATH", (folder + ":" + path).c_str(), 1);
  }
  ~FakeGnuplot() { setenv("PATH", path.c_str(), 1); }
  std::string path;
};

TEST_F(ReportTest, AGnuplotThatHangsIsEndedTwiceAndThenShort) {
  const FakeGnuplot hangs(file("bin"), "echo started >> started.txt\nsleep 1000 &\nwait\n");
  write_file(file("figures/a.gp"), "");
  const auto begin = std::chrono::steady_clock::now();
  const auto draw = [&] { plot::run_gnuplot(file("figures"), "a", 0.3); };
  expect_input_error(draw, {"a.gp", "did not end within 0.3 s, twice", "TAUT_GNUPLOT_TIMEOUT"});
  EXPECT_EQ(read_file(file("figures/started.txt")), "started\nstarted\n");
  expect_input_error(draw, {"a.gp"});
  EXPECT_EQ(read_file(file("figures/started.txt")), "started\nstarted\nstarted\n") << "it was not waited for twice";
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(60));
}

TEST_F(ReportTest, AGnuplotThatFailsOnceIsAskedAgain) {
  const FakeGnuplot shaky(file("bin"),
                          "[ -e once ] || { touch once; exit 1; }\nfor f in svg pdf png; do echo x > a.$f; done\n");
  write_file(file("figures/a.gp"), "");
  plot::run_gnuplot(file("figures"), "a", 60);
  EXPECT_TRUE(std::filesystem::exists(file("figures/a.svg")));
}

TEST_F(ReportTest, ThePageLoadsNothingFromAnywhere) {
  write_run(test::hanging_block(), folder());
  const std::string html = read_file(file("report.html"));
  EXPECT_FALSE(contains(html, "<link"));
  EXPECT_FALSE(contains(html, "@import"));
  EXPECT_FALSE(contains(html, "http"));
  EXPECT_TRUE(attributes(html, "src").empty());
  for (const std::string& target : attributes(html, "href")) EXPECT_EQ(target[0], '#') << target;
  size_t figures = 0;
  for (size_t at = html.find("<figure "); at != std::string::npos; at = html.find("<figure ", at + 1)) ++figures;
  EXPECT_EQ(figures, 5u);
}

TEST_F(ReportTest, IdsAreUniqueAndReferencesFindThem) {
  write_run(test::tendon_finger(), folder());
  const std::string html = read_file(file("report.html"));
  std::set<std::string> ids;
  for (const std::string& id : attributes(html, " id")) EXPECT_TRUE(ids.insert(id).second) << id << " stands twice";
  EXPECT_GT(ids.size(), 20u);
  const std::vector<std::string> targets = attributes(html, "href");
  EXPECT_GT(targets.size(), 20u);
  for (const std::string& target : targets) EXPECT_TRUE(ids.contains(target.substr(1))) << target << " is not there";
}

TEST_F(ReportTest, SimulatedDataAreCalledSoEverywhere) {
  RunRecord record = test::tendon_finger();
  for (const Figure& figure : write_report(record, folder())) {
    EXPECT_TRUE(contains(figure.title, "SIMULATED DATA")) << figure.name;
    EXPECT_TRUE(contains(figure.svg, "SIMULATED DATA")) << figure.name;
  }
  EXPECT_TRUE(contains(html_of(record), "class=\"banner\">SIMULATED DATA"));
  record.simulated = false;
  EXPECT_FALSE(contains(html_of(record), "SIMULATED"));
}

TEST_F(ReportTest, TheFirstSentenceIsTheAnswer) {
  const std::string html = html_of(test::hanging_block());
  EXPECT_TRUE(
      contains(html, "E_silicone = 274.1 kPa, 95 % interval 271.4 to 276.9 kPa (noise alone), well determined."));
  EXPECT_TRUE(contains(html, "Other meshes move E_silicone by -8.4 % to +0.4 %."));
  EXPECT_TRUE(contains(html, "E_silicone differs by +3.9 % from 263.8 kPa"));
  EXPECT_TRUE(
      contains(html_of(test::tendon_finger()), "95 % interval open to 0.46 (noise alone), bounded from one side."));
  RunRecord weak = test::hanging_block();
  weak.fit.parameters[0].lower95 = 12;
  weak.fit.parameters[0].upper95.reset();
  EXPECT_TRUE(contains(html_of(weak), "95 % interval 12 Pa to open")) << "an end near zero keeps its own digits";
}

TEST_F(ReportTest, WhatWasAssumedStandsInATableAndInTheInterval) {
  RunRecord record = test::hanging_block();
  EXPECT_FALSE(contains(html_of(record), "What was assumed"));
  const std::string meshes =
      "one Gauss-Newton step at the optimum with two meshes, extrapolated with the order that they show";
  record.shares = {{"mesh", {-412.5}, {190}, meshes, 9.5},
                   {"contact gap", {NAN}, {NAN}, "", 1},
                   {"size_x", {0}, {9100}, "tolerance not stated", 1, false}};
  record.fit.parameters[0].total_lower95 = 271e3;
  record.fit.parameters[0].total_upper95 = 277.4e3;
  const std::string html = html_of(record);
  EXPECT_TRUE(
      contains(html, "95 % interval 271.0 to 277.4 kPa (in all but the contact gap: not known), well determined."));
  EXPECT_TRUE(contains(html, "What was assumed"));
  EXPECT_TRUE(contains(html, "-0.41 ± 0.19 kPa"));
  EXPECT_TRUE(contains(html, "What the mesh adds: " + meshes + " (9.5 s)."));
  EXPECT_TRUE(contains(html, "not known"));
  EXPECT_TRUE(contains(html, "± 9.1 kPa"));
  EXPECT_TRUE(contains(html, "1 % of size_x is worth 9.1 kPa, more than the noise"));
}

TEST_F(ReportTest, AMisfitIsExplained) {
  const std::string misfit = html_of(test::hanging_block());
  EXPECT_TRUE(contains(misfit, "does not fit within the declared noise"));
  EXPECT_TRUE(contains(misfit, "The intervals count the declared standard deviations only"));
  EXPECT_TRUE(contains(misfit, "F = 12.66 with 8 and 9 degrees of freedom, probability less than 0.001"));
  EXPECT_TRUE(contains(misfit, "More repeats will not help"));
  EXPECT_TRUE(contains(misfit, "The largest residual is 0.819 mm (line 18 of the data, channel tip_left)"));
  RunRecord good = test::hanging_block();
  good.fit.chi_squared = 16;
  good.fit.chi_squared_p = 0.52;
  good.fit.lack_of_fit = {true, 8, 9, 8, 9, 1, 0.5};
  EXPECT_TRUE(contains(html_of(good), "fits the readings within their declared noise"));
  EXPECT_TRUE(contains(html_of(good), "That is within chance"));
}

TEST_F(ReportTest, CorrelationsAreShownForSeveralParameters) {
  EXPECT_TRUE(contains(html_of(test::tendon_finger()), "-0.830"));
  EXPECT_FALSE(contains(html_of(test::hanging_block()), "Correlation of the estimates"));
}

TEST_F(ReportTest, TextIsEscaped) {
  RunRecord record = test::hanging_block();
  const std::string nasty = "<script>alert('x')</script> & \"more\"";
  record.title = record.fit.message = record.provenance.command_line = record.provenance.machine = nasty;
  record.fit.parameters[0].explanation = record.fit.parameters[0].spec.meaning = nasty;
  record.references[0].source = record.variants[0].name = record.variants[0].mesh = nasty;
  record.remarks = {nasty};
  record.setup = {{nasty, nasty}};
  record.readings[0].trial = record.readings[0].channel = nasty;
  record.channels.push_back(make_axis(nasty, Quantity::length, nasty));
  record.provenance.inputs = {{nasty, nasty, nasty}};
  const std::string html = html_of(record);
  // The data of the page's script: nothing in it is markup.
  const std::string begin = "<script type=\"application/json\" id=\"run-data\">";
  const size_t data = html.find(begin), end = html.find("</script>", data);
  ASSERT_NE(end, std::string::npos);
  EXPECT_FALSE(contains(html.substr(data + begin.size(), end - data - begin.size()), "<"));
  const std::string page = html.substr(0, data);
  EXPECT_FALSE(contains(page, "<script"));
  EXPECT_FALSE(contains(page, "alert('x')"));
  EXPECT_TRUE(contains(html, "&lt;script&gt;alert(&#39;x&#39;)&lt;/script&gt; &amp; &quot;more&quot;"));
}

TEST_F(ReportTest, ChannelsThatAreNoLengthsAreShownInTheirOwnUnits) {
  RunRecord record = test::empty_record("E", 1e5, 1e3);
  test::add_reading(record, "a", "reaction", 1, 0.25, 0.01, 0.24);
  test::add_reading(record, "a", "reaction", 2, 0.5, 0.01, 0.49);
  record.curves = {{"reaction", "", {0, 2}, {0, 0.49}, {0, 0.01}}};
  record.channels = {make_axis("reaction", Quantity::force, "reaction")};
  test::set_statistics(record, 0.5, {});
  std::vector<std::string> names;
  for (const Figure& figure : write_report(record, folder())) names.push_back(figure.name);
  EXPECT_EQ(names, (std::vector<std::string>{"force_displacement", "residuals"})) << "a stiffness needs a displacement";
  EXPECT_EQ(rows("figures/force_displacement.csv")[0]["reaction_N"], "0.25");
  EXPECT_EQ(rows("figures/residuals.csv")[0]["sigma_N"], "0.01");
  std::string html = read_file(file("report.html"));
  for (const char* text :
       {"The largest residual is 0.01 N", ">Measured [N]<", ">0.250<", "reaction [N]", "Above in N,"})
    EXPECT_TRUE(contains(html, text)) << text;
  EXPECT_FALSE(contains(html, "[mm]"));

  // With an angle beside it, numbers come with their units.
  record.channels.push_back(make_axis("tip_turn", Quantity::angle, "rotation"));
  test::add_reading(record, "a", "tip_turn", 2, 0.1, 0.01, 0.11);
  write_report(record, folder());
  html = read_file(file("report.html"));
  for (const char* text : {">Measured<", ">0.250 N<", ">5.730 deg<", "rotation [deg]", "measured in its own standard"})
    EXPECT_TRUE(contains(html, text)) << text;
  auto all = rows("figures/residuals.csv");
  ASSERT_EQ(all.size(), 3u);
  EXPECT_EQ(all[2]["unit"], "deg");
  EXPECT_NEAR(std::stod(all[2]["sigma"]), 0.5729578, 1e-6);
  write_file(file("predictions.csv"), predictions_csv(record));
  all = rows("predictions.csv");
  EXPECT_EQ(all[0]["measured"], "0.25");
  EXPECT_EQ(all[0]["unit"], "N");
  EXPECT_EQ(all[2]["measured"], "0.1");
  EXPECT_EQ(all[2]["unit"], "rad");
}

TEST_F(ReportTest, PredictionsStandInTheUnitsOfTheBenchFileBesideSi) {
  RunRecord record = test::tendon_finger();
  record.controls[0] = make_axis("mass", Quantity::mass, "mass");
  for (ReadingRecord& reading : record.readings) reading.controls[0] = 0.05;
  record.control_columns = {"mass_g", "Retraction (mm)"};
  record.channel_columns = {"tip_displacement_mm"};
  write_file(file("predictions.csv"), predictions_csv(record));
  const std::string text = read_file(file("predictions.csv"));
  EXPECT_EQ(
      text.substr(0, text.find('\n')),
      "line,trial,channel,mass_kg,retraction_m,measured_m,sigma_m,predicted_m,prediction_se_m,residual_m,"
      "normalised_residual,mass_g,Retraction (mm),measured_mm,sigma_mm,predicted_mm,prediction_se_mm,residual_mm");
  auto all = rows("predictions.csv");
  ASSERT_EQ(all.size(), 48u);
  EXPECT_EQ(all[12]["mass_g"], "50");
  EXPECT_EQ(all[12]["Retraction (mm)"], "5.89");
  EXPECT_EQ(all[12]["measured_mm"], "1.44") << "as it stands in the bench's file";
  for (const char* name : {"sigma", "predicted", "residual"})
    EXPECT_NEAR(std::stod(all[12][name + std::string("_mm")]), 1e3 * std::stod(all[12][name + std::string("_m")]),
                1e-7);
  // Channels of two units, of which one has no column in a unit.
  record.channels.push_back(make_axis("turn", Quantity::angle, "rotation"));
  record.channels.push_back(make_axis("other", Quantity::length, "displacement"));
  record.channel_columns = {"tip_displacement_mm", "turn_deg", "other"};
  test::add_reading(record, "a", "turn", 0.05, std::numbers::pi / 6, 0.01, 0.5);
  test::add_reading(record, "a", "other", 0.05, 0.003, 0.001, 0.002);
  for (size_t i = 48; i < 50; ++i) record.readings[i].controls.push_back(0);
  write_file(file("predictions.csv"), predictions_csv(record));
  all = rows("predictions.csv");
  EXPECT_EQ(all[12]["measured_in_file"], "1.44");
  EXPECT_EQ(all[12]["unit_in_file"], "mm");
  EXPECT_EQ(all[12]["unit"], "m");
  EXPECT_EQ(all[48]["measured_in_file"], "30");
  EXPECT_EQ(all[48]["unit_in_file"], "deg");
  EXPECT_EQ(all[49]["measured_in_file"], "");
  EXPECT_EQ(all[49]["unit_in_file"], "");
}

TEST_F(ReportTest, PredictionsCarryTheirUnitsInTheHeader) {
  RunRecord record = test::hanging_block();
  record.controls[0].unit = "N/m";
  write_file(file("predictions.csv"), predictions_csv(record));
  const std::string text = read_file(file("predictions.csv"));
  EXPECT_EQ(text.substr(0, text.find('\n')),
            "line,trial,channel,tip_load_N_per_m,measured_m,sigma_m,predicted_m,prediction_se_m,residual_m,"
            "normalised_residual");
  EXPECT_EQ(parse_header("tip_load_N_per_m", {Quantity::line_load}, "here").name, "tip_load");
  EXPECT_EQ(parse_header("prediction_se_m", {Quantity::length}, "here").name, "prediction_se");
  auto all = rows("predictions.csv");
  ASSERT_EQ(all.size(), 18u);
  EXPECT_EQ(all[0]["line"], "2");
  EXPECT_EQ(all[0]["trial"], "a");
  EXPECT_EQ(all[0]["measured_m"], "-0.006494");
  EXPECT_NEAR(std::stod(all[0]["residual_m"]), -0.006494 + 1.01 * 0.0069, 1e-12);
  EXPECT_NEAR(std::stod(all[0]["normalised_residual"]), 2.375, 1e-9);
  EXPECT_EQ(all[17]["tip_load_N_per_m"], "1.00062");
}

}  // namespace
}  // namespace taut

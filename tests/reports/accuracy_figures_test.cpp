#include "reports/accuracy_figures.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>

#include "calib/data/csv_table.hpp"
#include "tests/support/experiment_files.hpp"

namespace taut {
namespace {

using namespace test;

/// Three settings: one in use, a finer one, and one that failed; a fourth was not run.
struct Case {
  AccuracyStudy study;
  std::vector<std::optional<AccuracyRun>> runs;
  AccuracyChart chart;
};

Case made_up(bool with_parameters) {
  Case c;
  c.study.title = "A beam's \"tip\"";
  c.study.simulated = true;
  c.study.result = "displacements";
  for (const char* name : {"coarse, in use", "fine", "broken", "left out"}) {
    AccuracySetting setting;
    setting.axis = std::string(name) == "broken" ? "steps" : "mesh";
    setting.name = name;
    setting.in_use = c.study.settings.empty();
    c.study.settings.push_back(setting);
  }
  c.runs.resize(4);
  for (int i = 0; i < 3; ++i) {
    AccuracyRun run;
    run.unknowns = 100 * (i + 1);
    run.seconds = 0.5 * (i + 1);
    run.factorisations = 10 * (i + 1);
    c.runs[static_cast<size_t>(i)] = run;
  }
  c.runs[2]->failure = "elements have turned inside out";
  c.chart.points = {{0, 0.04, 0.08, 0, {}, NAN, true}, {1, 0.005, 0.01, 0.035, {}, NAN, true}};
  c.chart.uncertainty = 0.002;
  c.chart.reference = "mesh extrapolated";
  if (!with_parameters) return c;
  c.study.table.declare({"E_foam", "E", "Pa", 1, 1e9, "", true});
  c.study.nominal = Eigen::VectorXd::Constant(1, 1e5);
  c.study.free = {{0, 1e5, 1, 1e9}};
  c.chart.points[0].parameters = {-0.05};
  c.chart.points[1].parameters = {-0.006};
  c.chart.parameter_uncertainty = {0.003};
  c.chart.parameter_noise = {0.01};
  return c;
}

TEST(AccuracyFigures, TheTableHoldsEachSettingItsErrorAndWhyItFailed) {
  const Case c = made_up(true);
  const TemporaryFolder folder;
  const std::vector<Figure> figures = draw_accuracy(c.study, c.runs, c.chart, folder / "charts");
  ASSERT_EQ(figures.size(), 2u);
  const CsvTable table = read_csv(folder / "charts/figures/accuracy_cost.csv");
  EXPECT_EQ(table.header.cells,
            (std::vector<std::string>{"axis", "setting", "in_use", "unknowns", "seconds", "factorisations", "error_%",
                                      "largest_error_%", "from_setting_in_use_%", "on_front", "failure"}));
  check_cell_counts(table);
  ASSERT_EQ(table.rows.size(), 4u);
  EXPECT_EQ(table.rows[0].cells,
            (std::vector<std::string>{"mesh", "coarse, in use", "1", "100", "0.5", "10", "4", "8", "0", "1", ""}));
  EXPECT_EQ(table.rows[1].cells[6], "0.5");
  EXPECT_EQ(table.rows[1].cells[8], "3.5");
  EXPECT_EQ(table.rows[2].cells[0], "reference");
  EXPECT_EQ(table.rows[2].cells[6], "0.2");
  EXPECT_EQ(table.rows[3].cells[1], "broken");
  EXPECT_EQ(table.rows[3].cells[6], "");
  EXPECT_EQ(table.rows[3].cells[10], "elements have turned inside out");

  const CsvTable parameters = read_csv(folder / "charts/figures/accuracy_parameters.csv");
  check_cell_counts(parameters);
  ASSERT_EQ(parameters.rows.size(), 4u);
  EXPECT_EQ(parameters.rows[0].cells[1], "reference");
  EXPECT_EQ(parameters.rows[1].cells.back(), "1") << "the noise";
  EXPECT_EQ(parameters.rows[2].cells,
            (std::vector<std::string>{"E_foam", "mesh", "coarse, in use", "1", "0.5", "10", "-5"}));
}

TEST(AccuracyFigures, WhatFailedWhatIsMissingAndThatItIsSimulatedIsSaidInTheFigure) {
  const Case c = made_up(false);
  const TemporaryFolder folder;
  const std::vector<Figure> figures = draw_accuracy(c.study, c.runs, c.chart, folder / "charts");
  ASSERT_EQ(figures.size(), 1u) << "without parameters there is one figure";
  for (const char* format : {"svg", "pdf", "png"})
    EXPECT_TRUE(std::filesystem::exists(folder / (std::string("charts/figures/accuracy_cost.") + format)));
  const std::string script = text_of(folder / "charts/figures/accuracy_cost.gp");
  for (const char* part : {"SIMULATED DATA", "broken: elements have turned inside out", "1 of 4 settings are missing",
                           "In use: coarse, in use: 4 % in 0.5 s, 10 factorisations", "2  fine: 0.5 %"})
    EXPECT_NE(script.find(part), std::string::npos) << part;
}

TEST(AccuracyFigures, TimeStepsHaveAFigureOfTheirOwnWithoutOtherMeshes) {
  Case c = made_up(false);
  for (size_t i : {0, 1, 2}) c.study.settings[i].integrator = i == 2 ? "explicit" : "BDF2";
  c.chart.points[0].step_error = 0.03;
  c.chart.points[1].step_error = 0.002;
  c.chart.step_uncertainty = 0.001;
  c.chart.step_reference = "step extrapolated";
  const TemporaryFolder folder;
  ASSERT_EQ(draw_accuracy(c.study, c.runs, c.chart, folder / "charts").size(), 2u);
  const CsvTable table = read_csv(folder / "charts/figures/accuracy_steps.csv");
  check_cell_counts(table);
  ASSERT_EQ(table.rows.size(), 4u);
  EXPECT_EQ(table.rows[0].cells[5], "0.1");
  EXPECT_EQ(table.rows[1].cells, (std::vector<std::string>{"BDF2", "coarse, in use", "1", "0.5", "10", "3", ""}));
  EXPECT_EQ(table.rows[3].cells[6], "elements have turned inside out");
  EXPECT_EQ(text_of(folder / "charts/figures/accuracy_steps.gp").find("settings are missing"), std::string::npos)
      << "the one left out is of another mesh";
}

TEST(AccuracyFigures, AReferenceWithoutKnownUncertaintyHasNoBand) {
  Case c = made_up(false);
  c.chart.uncertainty = NAN;
  c.chart.points[1].error = 0;  // the reference itself: a logarithm has no place for it
  const TemporaryFolder folder;
  draw_accuracy(c.study, c.runs, c.chart, folder / "charts");
  EXPECT_EQ(text_of(folder / "charts/figures/accuracy_cost.gp").find("too near to tell"), std::string::npos);
}

}  // namespace
}  // namespace taut

#include <gtest/gtest.h>

#include <filesystem>
#include <nlohmann/json.hpp>

#include "tests/support/command.hpp"

// Recordings over time through the command `taut`.
namespace taut {
namespace {

using namespace test;
using nlohmann::json;
namespace fs = std::filesystem;

const std::string measured_toml = replaced(released_toml, "[4, 1]", "[3, 1]") + R"(
[bench]
kind = "recordings"
time = "time_s"
sigma = "0.01 mm"
[[bench.recording]]
file = "swing.csv"
case = "swing"
held = { hand = "0.1 N" }
[fit.free]
E_foam = {}
stiffness_damping_foam = {}
[[fit.reference]]
parameter = "E_foam"
value = "150 kPa"
source = "a rumour"
)";

TEST(SlowRecordingCommands, WhatReplaySimulatesIsFittedBack) {
  const TemporaryFolder folder;
  const std::string here = folder / "";
  folder.write("experiment.toml", measured_toml);
  std::string csv = "time_s,tip_mm\n";
  for (int i = 0; i <= 60; ++i) csv += std::to_string(2e-3 * i) + ",0\n";
  folder.write("swing.csv", csv);
  done_in(here, {"replay", "experiment.toml", "--out", "first"});

  // The readings become what was simulated; the fit starts elsewhere.
  csv = "time_s,tip_mm\n";
  std::istringstream lines(text_of(folder / "first/predictions.csv"));
  std::string line;
  std::getline(lines, line);
  EXPECT_TRUE(line.starts_with("line,trial,channel,time_s,measured_m,sigma_m,predicted_m,")) << line;
  while (std::getline(lines, line)) {
    std::vector<std::string> cells;
    std::istringstream row(line);
    for (std::string cell; std::getline(row, cell, ',');) cells.push_back(cell);
    ASSERT_GT(cells.size(), 6u);
    csv += cells[3] + "," + std::to_string(1e3 * std::stod(cells[6])) + "\n";
  }
  folder.write("swing.csv", csv);
  folder.write("experiment.toml", replaced(replaced(measured_toml, "\"200 kPa\"", "\"170 kPa\""),
                                           "stiffness = \"1 ms\"", "stiffness = \"2 ms\""));
  expect_holds(done_in(here, {"check", "experiment.toml"}).out, {"61 samples from 0 s to 120 ms"});
  ASSERT_EQ(done_in(here, {"fit", "--quiet", "experiment.toml", "--out", "run"}).code, 0);
  const json run = json::parse(text_of(folder / "run/fit.json"));
  EXPECT_EQ(run["kind"], "recordings");
  EXPECT_NEAR(run["parameters"][0]["value"].get<double>(), 200e3, 20);
  EXPECT_NEAR(run["parameters"][1]["value"].get<double>(), 1e-3, 2e-6);
  ASSERT_EQ(run["swings"].size(), 1u);
  EXPECT_NEAR(run["swings"][0]["predicted_frequency_Hz"].get<double>() / run["swings"][0]["frequency_Hz"].get<double>(),
              1, 1e-3);
  EXPECT_TRUE(fs::exists(folder / "run/figures/recordings.png"));
  EXPECT_TRUE(fs::exists(folder / "run/figures/swings.png"));
  EXPECT_FALSE(fs::exists(folder / "run/figures/residuals.png"));
  EXPECT_EQ(text_of(folder / "run/swing.csv"), csv);
  const std::string html = text_of(folder / "run/report.html");
  expect_holds(html, {"Frequency and decay", "a rumour", "residuals are not independent", "SIMULATED DATA"});

  // Figures and report come from fit.json alone.
  const std::string figure = text_of(folder / "run/figures/recordings.csv");
  fs::remove_all(folder / "run/figures");
  done_in(here, {"report", "run"});
  EXPECT_EQ(text_of(folder / "run/figures/recordings.csv"), figure);
  EXPECT_EQ(text_of(folder / "run/report.html"), html);

  folder.write("new.csv", "load_N\n1\n");
  const Outcome refused = run_in(here, {"predict", "run", "--rows", "new.csv"});
  EXPECT_EQ(refused.code, 2);
  expect_holds(refused.err, {"readings run over time"});
}

}  // namespace
}  // namespace taut

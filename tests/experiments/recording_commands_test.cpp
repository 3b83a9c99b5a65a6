#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "tests/support/experiment_files.hpp"

// Recordings over time through the command `taut`.
namespace taut {
namespace {

using namespace test;
using nlohmann::json;
namespace fs = std::filesystem;

int taut(const std::string& arguments, const TemporaryFolder& folder) {
  const std::string command = "cd '" + (folder / "") + "' && '" TAUT_BINARY "' " + arguments + " > out.txt 2> err.txt";
  const int status = std::system(command.c_str());
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

const std::string experiment = R"(title = "A beam lets go"
data = "simulated"
[geometry]
kind = "rectangle"
size = ["60 mm", "12 mm"]
region = "foam"
thickness = "20 mm"
[mesh]
cells = [3, 1]
[materials.foam]
law = "neo_hookean"
E = "200 kPa"
nu = 0.3
density = "500 kg/m3"
[damping.foam]
stiffness = "1 ms"
[[support]]
on = "xmin"
fix = ["x", "y"]
[[load]]
id = "hand"
on = "xmax & ymax"
direction = [0, -1]
value = "0 N"
[[channel]]
id = "tip"
on = "xmax"
direction = [0, 1]
column = "tip_mm"
[dynamics]
step = "1 ms"
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
  folder.write("experiment.toml", experiment);
  std::string csv = "time_s,tip_mm\n";
  for (int i = 0; i <= 60; ++i) csv += std::to_string(2e-3 * i) + ",0\n";
  folder.write("swing.csv", csv);
  ASSERT_EQ(taut("replay experiment.toml --out first", folder), 0) << text_of(folder / "err.txt");

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
  folder.write("experiment.toml", replaced(replaced(experiment, "\"200 kPa\"", "\"170 kPa\""), "\"1 ms\"\n[[support",
                                           "\"2 ms\"\n[[support"));
  ASSERT_EQ(taut("check experiment.toml", folder), 0) << text_of(folder / "err.txt");
  EXPECT_NE(text_of(folder / "out.txt").find("61 samples from 0 s to 120 ms"), std::string::npos);
  ASSERT_EQ(taut("fit --quiet experiment.toml --out run", folder), 0) << text_of(folder / "err.txt");
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
  for (const char* part : {"Frequency and decay", "a rumour", "residuals are not independent", "SIMULATED DATA"})
    EXPECT_NE(html.find(part), std::string::npos) << part;

  // Figures and report come from fit.json alone.
  const std::string figure = text_of(folder / "run/figures/recordings.csv");
  fs::remove_all(folder / "run/figures");
  ASSERT_EQ(taut("report run", folder), 0) << text_of(folder / "err.txt");
  EXPECT_EQ(text_of(folder / "run/figures/recordings.csv"), figure);
  EXPECT_EQ(text_of(folder / "run/report.html"), html);

  folder.write("new.csv", "load_N\n1\n");
  EXPECT_EQ(taut("predict run --rows new.csv", folder), 2);
  EXPECT_NE(text_of(folder / "err.txt").find("readings run over time"), std::string::npos);
}

}  // namespace
}  // namespace taut

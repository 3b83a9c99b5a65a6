#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>

#include "calib/benches/static_bench.hpp"
#include "calib/runs/open_bench.hpp"
#include "tests/support/message.hpp"
#include "tests/support/static_bench.hpp"

// Specimens whose equilibria are not a matter of course: columns that may buckle to either side, bodies that only
// cables hold.
namespace taut::test {
namespace {

/// A symmetric strut, 90 x 3 mm, clamped below, pressed at its upper end.
const std::string strut_toml = R"(
title = "A strut"
data = "simulated"
[geometry]
kind = "rectangle"
size = ["3 mm", "90 mm"]
region = "gum"
thickness = "12 mm"
plane = "stress"
[mesh]
cells = [2, 16]
[materials.gum]
E = "2 MPa"
nu = 0.3
[[support]]
on = "ymin"
fix = ["x", "y"]
[[load]]
id = "press"
on = "ymax"
direction = [0, -1]
column = "press_N"
[[channel]]
id = "side"
on = "ymax"
direction = [1, 0]
column = "side_mm"
noise = { absolute = "0.1 mm" }
[bench]
file = "bench.csv"
)";

double euler() {
  return 2e6 * 0.012 * std::pow(0.003, 3) / 12 * std::pow(M_PI / 0.18, 2);
}

std::string loads_csv(const std::vector<double>& multiples) {
  std::string text = "press_N,side_mm\n";
  for (double multiple : multiples) text += fmt::format("{:.10g},1\n", multiple * euler());
  return text;
}

const std::vector<double> multiples{0.5, 1.1, 2.5, 9, 26};

TEST(Statics, ASymmetricStrutGoesToTheSameSideInEveryRowOnAnyNumberOfThreads) {
  const TemporaryFolder folder;
  Experiment e = experiment_in(folder, strut_toml, loads_csv(multiples));
  Eigen::VectorXd first;
  for (int threads : {1, 3}) {
    e.threads = threads;
    const Eigen::VectorXd side = predicted(bench_of(e)).values;
    EXPECT_NEAR(side[0], 0, 1e-9) << "below the critical load it stays straight";
    for (Eigen::Index row = 1; row < side.size(); ++row)
      EXPECT_GT(side[row], 5e-3) << multiples[static_cast<size_t>(row)];
    if (first.size() == 0) first = side;
    EXPECT_EQ(side, first) << "to the bit, with " << threads << " threads";
  }
  // A small load towards that side leads along the same branch.
  const std::string seeded = replaced(strut_toml, "[[channel]]",
                                      "[[load]]\nid = \"seed\"\non = \"ymax\"\ndirection = [1, 0]\nvalue = \"2e-5 N\"\n"
                                      "[[channel]]");
  const Eigen::VectorXd led = predicted(bench_of(experiment_in(folder, seeded, loads_csv(multiples)))).values;
  for (Eigen::Index row = 2; row < led.size(); ++row) EXPECT_NEAR(led[row] / first[row], 1, 2e-3);
}

TEST(Statics, TheSideOfASymmetricBifurcationIsSaidWithItsRows) {
  const TemporaryFolder folder;
  const std::string path = experiment_in(folder, strut_toml, loads_csv(multiples)).path;
  const std::unique_ptr<Bench> bench = open_bench(path, {});
  bench->protocol().predict(bench->protocol().nominal(), {});
  const std::vector<std::string> warnings = bench->warnings_after();
  ASSERT_EQ(warnings.size(), 1u);
  for (const char* part : {"lines 3, 4, 5, 6:", "symmetric bifurcation", "the side was chosen", "+x"})
    EXPECT_NE(warnings[0].find(part), std::string::npos) << warnings[0];
}

/// A plate of 20 x 10 mm in three cables that meet outside it.
const std::string plate_toml = R"(
title = "A plate in cables"
data = "simulated"
[geometry]
kind = "rectangle"
size = ["20 mm", "10 mm"]
region = "steel"
thickness = "5 mm"
plane = "stress"
[mesh]
cells = [4, 2]
[materials.steel]
E = "200 GPa"
nu = 0.3
[cables]
k = "3 kN/m"
slack = "0 mm"
[[cables.cable]]
id = "left"
x = ["0 mm", "0 mm"]
y = ["110 mm", "10 mm"]
fixed = "start"
[[cables.cable]]
id = "right"
x = ["20 mm", "20 mm"]
y = ["110 mm", "10 mm"]
fixed = "start"
[[load]]
id = "pull"
on = "ymin"
direction = [0, -1]
column = "pull_N"
[[channel]]
id = "drop"
on = "ymin"
direction = [0, -1]
column = "drop_mm"
noise = { absolute = "0.01 mm" }
[bench]
file = "bench.csv"
)";

TEST(Statics, ABenchOfABodyThatCablesAloneHoldHasEquilibria) {
  const TemporaryFolder folder;
  const Eigen::VectorXd drop =
      predicted(bench_of(experiment_in(folder, plate_toml, "pull_N,drop_mm\n0.6,1\n6,1\n"))).values;
  EXPECT_NEAR(drop[0], 0.6 / 6e3, 1e-7) << "two cables side by side; steel adds a nanometre";
  EXPECT_NEAR(drop[1], 6 / 6e3, 1e-7);
}

TEST(Statics, ABodyThatNothingHoldsIsRefusedAndNamed) {
  const TemporaryFolder folder;
  std::string loose = plate_toml;
  loose.erase(loose.find("[cables]"), loose.find("[[load]]") - loose.find("[cables]"));
  expect_input_error([&] { experiment_in(folder, loose, "pull_N,drop_mm\n1,1\n"); },
                     {"there is no support", "[[support]]", "cables, studs or grounds"});
  // In slack cables nothing says where it is.
  const std::string slack = replaced(plate_toml, "slack = \"0 mm\"", "slack = \"1 mm\"");
  const StaticReplay bench = bench_of(experiment_in(folder, slack, "pull_N,drop_mm\n0,1\n"));
  const Prediction prediction = bench.protocol->predict(bench.protocol->nominal(), {});
  ASSERT_EQ(prediction.failures.size(), 1u);
  for (const char* part : {"the body with the node at (0, 0) mm", "rigid motions free", "add a support"})
    EXPECT_NE(prediction.failures[0].find(part), std::string::npos) << prediction.failures[0];
}

TEST(Statics, PredictionsAtNewLoadsComeFromTheModelsThatTheFileAsksFor) {
  const TemporaryFolder folder;
  for (const char* model : {"beam", "auto"}) {
    std::string toml = replaced(strut_toml, "title", fmt::format("model = \"{}\"\ntitle", model));
    toml = replaced(toml, "direction = [0, -1]\ncolumn = \"press_N\"", "direction = [1, 0]\ncolumn = \"press_N\"");
    toml = replaced(toml, "size = [\"3 mm\"", "size = [\"4 mm\"");
    const std::unique_ptr<Bench> bench = open_bench(experiment_in(folder, toml, "press_N,side_mm\n0.001,1\n").path, {});
    const std::string loads = folder.write("loads.csv", "press_N\n0.0005\n0.002\n");
    const std::unique_ptr<Bench> there = bench->at_loads(loads);
    const Prediction prediction = there->protocol().predict(there->protocol().nominal(), {});
    ASSERT_TRUE(prediction.complete());
    const double stiffness = 2e6 * 0.012 * std::pow(0.004, 3) / 12;
    for (int row : {0, 1}) {
      const double force = row == 0 ? 0.0005 : 0.002;
      EXPECT_NEAR(prediction.values[row] / (force * std::pow(0.09, 3) / (3 * stiffness)), 1, 0.02) << model;
      const std::optional<RowModel> from = there->model_of(row);
      ASSERT_TRUE(from);
      EXPECT_EQ(from->name, "beam");
      EXPECT_LT(from->error, 0.02);
      EXPECT_GT(from->error, 0);
    }
  }
}

}  // namespace
}  // namespace taut::test

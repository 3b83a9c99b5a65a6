#include <gtest/gtest.h>

#include "calib/benches/static_bench.hpp"
#include "calib/fit/fit.hpp"
#include "tests/support/message.hpp"
#include "tests/support/static_bench.hpp"

namespace taut::test {
namespace {

/// The small beam with a stud at its tip, in a hole that is fixed in space; a second load that is always the same gives
/// a common zero error its name.
std::string with_stud() {
  return replaced(replaced(beam_toml, "[[channel]]",
                           "[[load]]\nid = \"none\"\non = \"xmax\"\ndirection = [1, 0]\ncolumn = \"none_N\"\n"
                           "[studs]\nclearance = \"1.5 mm\"\nstiffness = \"40 N/m\"\n"
                           "[[stud]]\nid = \"tip\"\non = \"xmax\"\ndirection = [0, 1]\n[[channel]]"),
                  "[bench]",
                  "[fit.free.clearance]\nlower = \"0 mm\"\nupper = \"5 mm\"\n[fit.free.zero_1]\n"
                  "[bench]\nzero_offset_per = \"none\"");
}

/// A row per load, all read as 0.
std::string loads(const std::vector<double>& newtons) {
  std::string csv = "trial,pull_N,none_N,tip_mm\n";
  for (const double load : newtons) csv += fmt::format("1,{},0,0\n", load);
  return csv;
}
const std::vector<double> two_sided{0.005, 0.05, 0.08, 0.12, -0.005, -0.05, -0.08, -0.12};
const std::vector<double> one_sided{0.05, 0.07, 0.09, 0.12};

class StudBench : public testing::Test {
 protected:
  /// The fit of what a bench reads whose clearance is 2 mm and whose zero is off by 0.3 mm.
  FitResult fit_planted(const std::string& toml, const std::vector<double>& newtons) const {
    const Experiment experiment = experiment_in(folder_, toml, loads(newtons));
    StaticReplay replay = bench_of(experiment);
    const ParameterTable& table = replay.protocol->parameters();
    Params truth = replay.protocol->nominal();
    truth[table.index("clearance")] = 2e-3;
    if (table.contains("zero_1")) truth[table.index("zero_1")] = 0.3e-3;
    const Prediction readings = replay.protocol->predict(truth, {});
    EXPECT_TRUE(readings.complete());
    for (Measurement& m : replay.measurements) m.value = readings.values[m.row];
    replay.protocol->forget();
    return fit(*replay.protocol, replay.measurements, free_parameters(experiment, *replay.protocol), {});
  }
  const ParameterEstimate& estimate(const FitResult& result, const std::string& id) const {
    return *std::ranges::find(result.parameters, id, [](const ParameterEstimate& e) { return e.spec.id; });
  }
  TemporaryFolder folder_;
};

TEST_F(StudBench, APlantedClearanceIsFoundFromBothSidesAndToldFromAZeroError) {
  const FitResult result = fit_planted(with_stud(), two_sided);
  ASSERT_EQ(result.status, FitStatus::converged) << result.message;
  EXPECT_NEAR(estimate(result, "clearance").value, 2e-3, 1e-6);
  EXPECT_NEAR(estimate(result, "zero_1").value, 0.3e-3, 1e-6);
  EXPECT_NEAR(estimate(result, "E_foam").value, 1e5, 20);
  EXPECT_NE(estimate(result, "clearance").verdict, Verdict::tied);
  EXPECT_NE(estimate(result, "zero_1").verdict, Verdict::tied);
}

TEST_F(StudBench, RowsOfOneSideLeaveTheClearanceTiedToTheZeroError) {
  const FitResult result = fit_planted(with_stud(), one_sided);
  EXPECT_EQ(estimate(result, "clearance").verdict, Verdict::tied) << estimate(result, "clearance").explanation;
  EXPECT_NE(estimate(result, "clearance").explanation.find("zero_1"), std::string::npos);
  EXPECT_EQ(estimate(result, "zero_1").verdict, Verdict::tied);
}

TEST_F(StudBench, ClearancesAreSharedOrTheirOwnAndMayHaveTolerances) {
  const auto table_of = [&](const std::string& toml) {
    const Experiment e = experiment_in(folder_, toml, loads(one_sided));
    const StaticReplay replay = bench_of(e);
    return assumptions_of(e, replay.protocol->parameters(), replay.protocol->nominal(), dimensions_of(e));
  };
  const std::string second =
      "[[stud]]\nid = \"middle\"\npoint = [\"30 mm\", \"6 mm\"]\ndirection = [0, 1]\n"
      "hole_point = [\"50 mm\", \"6 mm\"]\nclearance = \"0.2 mm +- 0.05 mm\"\n[[channel]]";
  const std::string toml = replaced(replaced(with_stud(), "[[channel]]", second), "\"40 N/m\"", "\"40 N/m +- 2 N/m\"");
  double own = 0, shared = 0;
  for (const Assumption& one : table_of(toml)) {
    if (one.id == "clearance_middle") own = one.tolerance;
    if (one.id == "k_stud") shared = one.tolerance;
    EXPECT_NE(one.id, "clearance") << "it is fitted";
  }
  EXPECT_NEAR(own, 5e-5, 1e-12);
  EXPECT_NEAR(shared, 2, 1e-12);
}

TEST_F(StudBench, StudsGoWithTheBase) {
  const auto reading = [&](const std::string& base) {
    const std::string toml = replaced(with_stud(), "[[support]]", base + "[[support]]");
    return predicted(bench_of(experiment_in(folder_, toml, loads({0.0, 0.3}))));
  };
  const Prediction here = reading(""), there = reading("[base]\nat = [\"10 mm\", \"20 mm\"]\n");
  EXPECT_NEAR((here.values - there.values).norm(), 0, 1e-9);
  EXPECT_GT(here.values[1], 1.5e-3);
}

TEST_F(StudBench, WrongStudsAreRefused) {
  const auto refused = [&](const std::string& from, const std::string& to, const std::vector<std::string>& parts) {
    const std::string toml = replaced(with_stud(), from, to);
    expect_input_error([&] { bench_of(experiment_in(folder_, toml, loads(one_sided))); }, parts);
  };
  refused("clearance = \"1.5 mm\"\n", "", {"[stud]", "no clearance", "clearance = \"0.1 mm\"", "[studs]"});
  refused("clearance = \"1.5 mm\"", "clearance = \"-1 mm\"", {"[studs] clearance", "zero or more"});
  refused("stiffness = \"40 N/m\"\n", "", {"[stud]", "no stiffness", "\"200 kN/m\""});
  refused("stiffness = \"40 N/m\"", "stiffness = \"0 N/m\"", {"[studs] stiffness"});
  refused("on = \"xmax\"\ndirection = [0, 1]", "on = \"xmaxx\"\ndirection = [0, 1]", {"[[stud]] 'tip'", "xmaxx"});
  refused("on = \"xmax\"\ndirection = [0, 1]", "on = \"xmax\"\nhole_on = \"xmax\"\ndirection = [0, 1]",
          {"[[stud]] 'tip'", "one place"});
  refused("on = \"xmax\"\ndirection = [0, 1]", "on = \"xmax\"\npoint = [\"1 mm\", \"1 mm\"]\ndirection = [0, 1]",
          {"[stud]", "either 'on'"});
  refused("on = \"xmax\"\ndirection = [0, 1]", "on = \"xmax\"\ndirection = [0, 0]", {"[stud] direction"});
  refused("[[channel]]", "[[stud]]\nid = \"tip\"\non = \"xmax\"\ndirection = [0, 1]\n[[channel]]",
          {"the stud 'tip' is there already"});
  refused("direction = [0, 1]", "direction = [0, 1]\nclearance = \"1 mm\"\nstiffness = \"1 N/m\"",
          {"[studs]", "no [[stud]] is governed"});
  refused("data = \"simulated\"", "data = \"simulated\"\nmodel = \"beam\"", {"[[stud]] 'tip'", "\"beam\"", "\"full\""});
}

// A bar on one side of its stud, E 100 kPa, clearance 0.5 mm, k 2 N/mm, read to 3 um: the three are all but tied.
constexpr const char* bar_with_stud = R"(
title = "A bar with a stud"
data = "simulated"
[geometry]
kind = "rectangle"
size = ["100 mm", "20 mm"]
region = "foam"
thickness = "20 mm"
plane = "stress"
[mesh]
cells = [2, 1]
[materials.foam]
E = "70 kPa"
nu = 0
[[support]]
on = "xmin"
fix = ["x", "y"]
[[stud]]
id = "a"
on = "xmax"
direction = [1, 0]
[studs]
clearance = "0.2 mm"
stiffness = "5 kN/m"
[[load]]
id = "F"
on = "xmax"
direction = [1, 0]
column = "F_N"
[[channel]]
id = "tip"
on = "xmax"
direction = [1, 0]
column = "tip_mm"
noise = { absolute = "0.003 mm" }
[bench]
file = "bench.csv"
)";
constexpr const char* bar_readings =
    "F_N,tip_mm\n0.3,0.53932\n0.5,0.62445\n0.6,0.66733\n0.7,0.70959\n"
    "0.8,0.75152\n0.9,0.79837\n1,0.83592\n";

class BarWithStud : public testing::TestWithParam<const char*> {};

/// Along the tangent of the valley the modulus leaves it at once; and where the bound is low, it ends there, all but
/// without effect, while softer studs need it back.
TEST_P(BarWithStud, IntervalsHoldTheTruthWhateverTheModulusBounds) {
  const TemporaryFolder folder;
  const Experiment experiment = experiment_in(
      folder, bar_with_stud + fmt::format("[fit.free.E_foam]\n{}[fit.free.clearance]\n[fit.free.k_stud]\n", GetParam()),
      bar_readings);
  const StaticReplay replay = bench_of(experiment);
  const FitResult result = fit(*replay.protocol, replay.measurements, free_parameters(experiment, *replay.protocol));
  ASSERT_EQ(result.status, FitStatus::converged);
  for (const auto& [j, truth] : {std::pair(0, 1e5), {1, 5e-4}, {2, 2e3}}) {
    const ParameterEstimate& e = result.parameters[static_cast<size_t>(j)];  // an open end holds all
    EXPECT_LE(e.lower95.value_or(truth), truth) << e.spec.id << " = " << e.value;
    EXPECT_GE(e.upper95.value_or(truth), truth) << e.spec.id << " = " << e.value;
  }
}
INSTANTIATE_TEST_SUITE_P(Bounds, BarWithStud,
                         testing::Values("", "lower = \"1 Pa\"\n", "lower = \"100 Pa\"\n", "lower = \"3 kPa\"\n",
                                         "lower = \"10 kPa\"\nupper = \"1 MPa\"\n",
                                         "lower = \"100 Pa\"\nupper = \"1 GPa\"\n"));

}  // namespace
}  // namespace taut::test

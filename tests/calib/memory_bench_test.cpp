#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>

#include "calib/check/plausibility.hpp"
#include "calib/fit/fit.hpp"
#include "calib/runs/open_bench.hpp"
#include "sim/materials/prony.hpp"
#include "tests/support/message.hpp"
#include "tests/support/static_bench.hpp"

// Benches whose stresses relax: dwells, rests and times of their rows. Readings are those of one linear standard solid,
// which creeps under a load by J(t) = 1 + g / (1 - g) [1 - exp(-(1 - g) t / tau)], and superposes (Boltzmann).
namespace taut {
namespace {

using namespace test;

constexpr double E = 2e5, g = 0.2, tau = 60;  // planted
constexpr double length = 0.06, area = 0.012 * 0.02;

double J(double t) {
  return t <= 0 ? 0.0 : 1 - g / (1 - g) * std::expm1(-(1 - g) * t / tau);
}

/// A bar without Poisson effect that is pulled along its axis so little that all is linear: F L / (E A) at once.
std::string bar_toml(const std::string& bench, const std::string& fit = "") {
  return foam_piece("A bar that creeps", "[2, 1]",
                    "E = \"200 kPa\"\nnu = 0.0\nprony = [{ g = 0.2, tau = \"60 s\" }]\n") +
         R"(fix = ["x", "y"]

[[load]]
id = "pull"
on = "xmax"
direction = [1, 0]
column = "pull_mN"

[[channel]]
id = "tip"
on = "xmax"
direction = [1, 0]
column = "tip_um"
noise = { absolute = "0.0001 um" }

[bench]
file = "bench.csv"
)" + bench +
         "\n" + fit;
}

constexpr double pull = 1e-3;                             // [N]
const double at_once = 1e6 * pull * length / (E * area);  // [um]

const std::string shares_free = R"(
[fit.free.E_foam]
start = "150 kPa"
lower = "10 kPa"
upper = "5 MPa"
[fit.free.g_foam]
start = 0.4
lower = 0.0
upper = 0.9
)";
const std::string all_free = shares_free + R"(
[fit.free.tau_foam]
start = "150 s"
lower = "1 s"
upper = "10000 s"
)";

class MemoryBench : public testing::Test {
 protected:
  std::unique_ptr<Bench> open(const std::string& toml, const std::string& csv) const {
    folder_.write("bench.csv", csv);
    return open_bench(folder_.write("memory.toml", toml));
  }
  Eigen::VectorXd predicted(const std::string& toml, const std::string& csv) const {
    const std::unique_ptr<Bench> bench = open(toml, csv);
    const Prediction prediction = bench->protocol().predict(bench->protocol().nominal(), {});
    for (const std::string& failure : prediction.failures) ADD_FAILURE() << failure;
    return 1e6 * prediction.values;  // [um]
  }
  void refuses(const std::string& toml, const std::string& csv, const std::vector<std::string>& parts) const {
    expect_input_error([&] { open(toml, csv); }, parts);
  }
  static FitResult fitted(const Bench& bench) { return fit(bench.protocol(), bench.measurements(), bench.free()); }
  TemporaryFolder folder_;
};

// Sixteen steps of a hold leave less than this of what creeps.
constexpr double steps_error = 4e-3;

TEST_F(MemoryBench, RowsAreReplayedAlongTheBenchsOwnHistory) {
  // 10 s under one load, 100 s of rest, 60 s under two, directly 30 s under three.
  const std::string csv = "pull_mN,tip_um,dwell_s,rest_s\n1,1,10,0\n2,1,60,100\n3,1,30,0\n";
  const Eigen::VectorXd tips = predicted(bar_toml("dwell = \"dwell_s\"\nrest = \"rest_s\""), csv);
  const auto at = [&](double t) { return at_once * (J(t) - J(t - 10) + 2 * J(t - 110) + J(t - 170)); };
  const double read[] = {10, 170, 200};
  for (int r = 0; r < 3; ++r) EXPECT_NEAR(tips[r], at(read[r]), steps_error * 3 * at_once * g) << read[r];
  // The same by the times at which they were read; and of rows in another order.
  const Eigen::VectorXd by_time =
      predicted(bar_toml("time = \"time_min\"\nrest = \"rest_s\""),
                "pull_mN,tip_um,time_min,rest_s\n3,1," + fmt::format("{}", 200.0 / 60) + ",0\n1,1," +
                    fmt::format("{}", 10.0 / 60) + ",0\n2,1," + fmt::format("{}", 170.0 / 60) + ",100\n");
  EXPECT_NEAR(by_time[1], tips[0], 1e-9 * at_once);
  EXPECT_NEAR(by_time[2], tips[1], 1e-9 * at_once);
  EXPECT_NEAR(by_time[0], tips[2], 1e-9 * at_once);
  // From the unloaded state before each load, what is left of the past does not count at that time.
  const Eigen::VectorXd from =
      predicted(bar_toml("dwell = \"dwell_s\"\nrest = \"rest_s\"\nmeasured_from = \"unloaded\""), csv);
  EXPECT_NEAR(from[1], at(170) - at_once * (J(110) - J(100)), steps_error * 3 * at_once * g);
}

std::string creep_csv(const std::vector<double>& dwells) {
  // Rests of an hour leave nothing.
  std::string csv = "pull_mN,tip_um,dwell_s\n";
  for (double dwell : dwells) csv += fmt::format("1,{:.9g},{}\n", at_once * J(dwell), dwell);
  return csv;
}

TEST_F(MemoryBench, ALoadThatIsReadAgainHasActedAllTheWhile) {
  // A creep curve: one load, read after 10, 60 and 180 s, said by dwells or by times.
  const Eigen::VectorXd by_dwell =
      predicted(bar_toml("dwell = \"dwell_s\""), "pull_mN,tip_um,dwell_s\n1,1,10\n1,1,60\n1,1,180\n");
  const Eigen::VectorXd by_time =
      predicted(bar_toml("time = \"t_s\""), "pull_mN,tip_um,t_s\n1,1,10\n1,1,60\n1,1,180\n");
  const double read[] = {10, 60, 180};
  for (int r = 0; r < 3; ++r) {
    EXPECT_NEAR(by_dwell[r], at_once * J(read[r]), steps_error * at_once * g) << read[r];
    EXPECT_NEAR(by_time[r], by_dwell[r], 1e-12) << read[r];
  }
  refuses(bar_toml("dwell = \"dwell_s\""), "pull_mN,tip_um,dwell_s\n1,1,10\n1,1,10\n",
          {"line 3", "no longer than in line 2", "rest"});
  refuses(bar_toml("time = \"t_s\"\norder = \"n\""), "pull_mN,tip_um,t_s,n\n1,1,10,2\n2,1,60,1\n",
          {"line 2", "before line 3", "order"});
}

TEST_F(MemoryBench, OneModulusAndOnePairAreRecoveredFromDwellsOfTwoDecades) {
  const std::unique_ptr<Bench> bench =
      open(bar_toml("dwell = \"dwell_s\"\nrest = \"3600 s\"", all_free), creep_csv({2, 10, 30, 60, 120, 300}));
  const FitResult result = fitted(*bench);
  ASSERT_EQ(result.status, FitStatus::converged);
  EXPECT_NEAR(result.parameters[0].value, E, 5e-3 * E);
  EXPECT_NEAR(result.parameters[1].value, g, 5e-3);
  EXPECT_NEAR(result.parameters[2].value, tau, 0.04 * tau);
  for (const ParameterEstimate& e : result.parameters) EXPECT_EQ(e.verdict, Verdict::well_determined) << e.spec.id;
}

TEST_F(MemoryBench, OneDwellCannotTellAPairFromAModulus) {
  const std::string toml =
      replaced(bar_toml("dwell = \"dwell_s\"\nrest = \"3600 s\"", shares_free), "0.0001 um", "0.005 um");
  const std::unique_ptr<Bench> bench = open(toml, creep_csv({30, 30, 30, 30}));
  const FitResult result = fitted(*bench);
  ASSERT_EQ(result.status, FitStatus::converged);
  EXPECT_EQ(result.parameters[0].verdict, Verdict::tied);
  for (const ParameterEstimate& e : result.parameters) EXPECT_NE(e.verdict, Verdict::well_determined) << e.spec.id;
}

TEST_F(MemoryBench, WithoutCreepTheShareIsBoundedFromOneSide) {
  std::string csv = "pull_mN,tip_um,dwell_s\n";
  double sign = 1;
  for (double dwell : {2, 10, 30, 60, 120, 300})
    csv += fmt::format("1,{:.9g},{}\n", at_once + 1e-4 * (sign = -sign), dwell);
  const FitResult result = fitted(*open(bar_toml("dwell = \"dwell_s\"\nrest = \"3600 s\"", shares_free), csv));
  ASSERT_EQ(result.status, FitStatus::converged);
  EXPECT_EQ(result.parameters[1].verdict, Verdict::bounded_from_one_side);
  EXPECT_LT(result.parameters[1].value, 2e-4);
}

TEST_F(MemoryBench, AHeldStretchRelaxesInItsReaction) {
  std::string toml = bar_toml("dwell = \"dwell_s\"\nrest = \"3600 s\"", all_free);
  toml = replaced(toml, "[[load]]\nid = \"pull\"\non = \"xmax\"\ndirection = [1, 0]\ncolumn = \"pull_mN\"",
                  "[[support]]\non = \"xmax\"\nid = \"grip\"\nmove = \"x\"\ncolumn = \"grip_um\"");
  toml = replaced(
      toml,
      "id = \"tip\"\non = \"xmax\"\ndirection = [1, 0]\ncolumn = \"tip_um\"\nnoise = { absolute = \"0.0001 um\" }",
      "id = \"cell\"\nkind = \"reaction\"\non = \"xmax\"\ndirection = [1, 0]\ncolumn = \"cell_mN\"\nnoise = { absolute "
      "= \"0.0000001 mN\" }");
  std::string csv = "grip_um,cell_mN,dwell_s\n";
  const double held = 1e3 * E * area * 1e-6 / length;  // [mN]
  for (double t : {0.0, 2.0, 10.0, 30.0, 60.0, 120.0, 300.0})
    csv += fmt::format("1,{:.12g},{}\n", held * (1 + g * std::expm1(-t / tau)), t);
  const std::unique_ptr<Bench> bench = open(toml, csv);
  const Prediction prediction = bench->protocol().predict(bench->protocol().nominal(), {});
  ASSERT_TRUE(prediction.complete());
  // Against the first, which is read at once: strains are finite.
  const std::vector<Measurement>& readings = bench->measurements();
  for (const Measurement& m : readings)
    EXPECT_NEAR(prediction.values[m.row] / prediction.values[0], m.value / readings[0].value, 1e-9) << m.row;
  const FitResult result = fitted(*bench);
  ASSERT_EQ(result.status, FitStatus::converged);
  EXPECT_NEAR(result.parameters[0].value, E, 1e-4 * E);
  EXPECT_NEAR(result.parameters[1].value, g, 1e-4);
  EXPECT_NEAR(result.parameters[2].value, tau, 1e-3 * tau);
}

TEST_F(MemoryBench, DerivativesThroughTheHistoryPassTheirTaylorTest) {
  const std::unique_ptr<Bench> bench =
      open(bar_toml("dwell = \"dwell_s\"\nrest = \"rest_s\"\nmeasured_from = \"unloaded\"", all_free),
           "pull_mN,tip_um,dwell_s,rest_s\n800,1,10,0\n1600,1,60,100\n2400,1,30,0\n");
  Protocol& protocol = bench->protocol();
  std::vector<int> free;
  for (const FreeParameter& one : bench->free()) free.push_back(one.index);
  const Params p = protocol.nominal();
  const Prediction here = protocol.predict(p, free);
  for (size_t j = 0; j < free.size(); ++j) {
    std::vector<double> left;
    for (double h : {0.04, 0.02, 0.01}) {
      Params q = p;
      q[free[j]] *= 1 + h;
      const Eigen::VectorXd change = protocol.predict(q, {}).values - here.values;
      left.push_back((change - here.derivatives.col(static_cast<Eigen::Index>(j)) * (q[free[j]] - p[free[j]])).norm());
    }
    EXPECT_NEAR(left[0] / left[1], 4, 0.4) << j;
    EXPECT_NEAR(left[1] / left[2], 4, 0.2) << j;
  }
}

TEST(Memory, UnequalDwellsMayDifferAsTheKnownAnswerSays) {
  EXPECT_NEAR(largest_creep_between(0.2, 10, 60), 0.14, 0.005);
  EXPECT_NEAR(largest_creep_between(0.4, 10, 60), 0.33, 0.01);
}

TEST_F(MemoryBench, WhatHeldABodyCountsWhereItComesToRest) {
  // Held under one load for a second, then under another for five: J superposes.
  const std::string toml =
      foam_piece("A bar lets go", "[2, 1]",
                 "E = \"200 kPa\"\nnu = 0.0\ndensity = \"100 kg/m3\"\nprony = [{ g = 0.2, tau = \"2 s\" }]\n") +
      R"(fix = ["x", "y"]

[[load]]
id = "hand"
on = "xmax"
direction = [1, 0]
value = "0 mN"

[[load]]
id = "hung"
on = "xmax"
direction = [1, 0]
value = "0 mN"

[[channel]]
id = "tip"
on = "xmax"
direction = [1, 0]
column = "tip_um"

[dynamics]
step = "1 ms"

[bench]
kind = "recordings"
time = "time_s"
sigma = "0.001 um"

[[bench.recording]]
file = "bench.csv"
case = "a"
loads = { hung = "2 mN" }
held = { hand = "1 mN" }
held_for = "1 s"
rest = { after = "5 s", sigma = "0.001 um", tip = "1 um" }

[fit.free.E_foam]
)";
  const Eigen::VectorXd tips = predicted(toml, "time_s,tip_um\n-0.1,1\n");
  const auto creep = [](double t) { return 1 - g / (1 - g) * std::expm1(-(1 - g) * t / 2); };
  // The hung load is on from the beginning, the hand for the first second of six.
  EXPECT_NEAR(tips[0], at_once * 3 * creep(1), 3 * steps_error * at_once * g);
  EXPECT_NEAR(tips[1], at_once * (3 * creep(6) - creep(5)), 3 * steps_error * at_once * g);
}

TEST_F(MemoryBench, ReadingsWithAnotherPastAreNoRepeats) {
  const std::unique_ptr<Bench> bench =
      open(bar_toml("dwell = \"dwell_s\"\nrest = \"3600 s\"", all_free), creep_csv({2, 10, 30, 60, 120, 300}));
  for (const Finding& finding : implausible(*bench)) {
    EXPECT_EQ(finding.sentence.find("repeats"), std::string::npos) << finding.sentence;
    EXPECT_EQ(finding.sentence.find("different readings"), std::string::npos) << finding.sentence;
  }
}

TEST_F(MemoryBench, ANewTrialSaysForHowLongItRested) {
  const std::string toml = bar_toml("dwell = \"dwell_s\"\ntrial = \"trial\""),
                    csv = "trial,pull_mN,tip_um,dwell_s\na,1,1,10\na,1,1,60\nb,1,1,10\n";
  refuses(toml, csv, {"line 4", "trial 'b'", "rest"});
  const Eigen::VectorXd tips = predicted(bar_toml("dwell = \"dwell_s\"\ntrial = \"trial\"\nrest = \"0 s\""), csv);
  EXPECT_GT(tips[2], tips[1]) << "without a rest the load has acted on";
}

TEST_F(MemoryBench, SpecimensThatRelaxHaveStatesWithNames) {
  const std::string toml = bar_toml("dwell = \"dwell_s\"\nrest = \"100 s\"\nspecimen = \"which\"") +
                           "[[specimen]]\nid = \"A\"\nset = { size_x = \"60 mm\" }\n"
                           "[[specimen]]\nid = \"B\"\nset = { size_x = \"120 mm\" }\n";
  const std::unique_ptr<Bench> bench =
      open(toml, "which,pull_mN,tip_um,dwell_s\nA,1,1,10\nA,1,1,60\nB,1,1,10\nB,1,1,60\n");
  const Prediction prediction = bench->protocol().predict(bench->protocol().nominal(), {});
  ASSERT_TRUE(prediction.complete());
  EXPECT_NEAR(prediction.values[2] / prediction.values[0], 2, 1e-6);
  EXPECT_GE(bench->states().states.size(), 2u);
}

TEST_F(MemoryBench, WrongTimesAreRefusedWithOneSentence) {
  const std::string csv = "pull_mN,tip_um,dwell_s,rest_s\n1,1,10,0\n2,1,60,100\n";
  const std::string keys = "dwell = \"dwell_s\"\nrest = \"rest_s\"";
  refuses(bar_toml("ignore = [\"dwell_s\", \"rest_s\"]"), csv, {"memory.toml", "prony", "'dwell'"});
  refuses(bar_toml(keys), "pull_mN,tip_um,dwell_s,rest_s\n1,1,-10,0\n", {"bench.csv, line 2", "negative"});
  refuses(bar_toml(keys), "pull_mN,tip_um,dwell_s,rest_s\n1,1,10,-5\n", {"bench.csv, line 2", "negative"});
  refuses(bar_toml(keys), "pull_mN,tip_um,dwell_mm,rest_s\n1,1,10,5\n", {"bench.csv, line 1", "dwell"});
  refuses(bar_toml("dwell = \"-3 s\"\nrest = \"rest_s\"\nignore = [\"dwell_s\"]"), csv, {"dwell", "zero or more"});
  refuses(bar_toml("dwell = \"3 mm\"\nrest = \"rest_s\"\nignore = [\"dwell_s\"]"), csv, {"dwell", "mm"});
  refuses(bar_toml("time = \"time_s\"\n" + keys), "pull_mN,tip_um,dwell_s,rest_s,time_s\n1,1,10,0,10\n2,1,60,100,100\n",
          {"bench.csv, line 3", "90 s after line 2", "160 s"});
  refuses("model = \"beam\"\n" + bar_toml(keys), csv, {"memory.toml", "prony", "\"full\""});
  refuses(replaced(bar_toml(keys), "g = 0.2", "g = -0.2"), csv, {"prony", "g is a share"});
  refuses(replaced(bar_toml(keys), "\"60 s\"", "\"0 s\""), csv, {"prony", "positive time"});
  refuses(
      replaced(bar_toml(keys), "g = 0.2, tau = \"60 s\" }", "g = 0.6, tau = \"60 s\" }, { g = 0.5, tau = \"6 s\" }"),
      csv, {"prony", "1.1 in all"});
  refuses(replaced(bar_toml(keys), "tau = \"60 s\"", "tua = \"60 s\""), csv, {"prony", "tau"});
}

}  // namespace
}  // namespace taut

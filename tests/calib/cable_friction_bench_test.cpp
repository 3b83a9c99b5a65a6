#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <sstream>

#include "calib/runs/open_bench.hpp"
#include "tests/support/message.hpp"
#include "tests/support/static_bench.hpp"
#include "tests/support/taylor.hpp"

// Benches whose cables rub at their eyelets: rows in both directions, derivatives along the way, what readings say of
// mu.
namespace taut {
namespace {

using namespace test;

/// A beam of foam with a cable in a zigzag above its middle.
const std::string module_toml = R"(
title = "A beam with a cable"
data = "simulated"

[geometry]
kind = "rectangle"
size = ["60 mm", "12 mm"]
origin = ["0 mm", "0 mm"]
region = "foam"
thickness = "20 mm"

[mesh]
cells = [6, 2]

[materials.foam]
E = "100 kPa"
nu = 0.2

[[support]]
on = "xmin"
fix = ["x", "y"]

[cables]
k = "2 kN/m"
retraction = "retraction_mm"
friction = 0.2

[[cables.cable]]
id = "upper"
x = ["-20 mm", "5 mm", "20 mm", "35 mm", "50 mm"]
y = ["2 mm", "10 mm", "7 mm", "11 mm", "9 mm"]

[[load]]
id = "pull"
on = "xmax"
direction = [0, -1]
column = "pull_N"

[[channel]]
id = "tip"
on = "xmax"
direction = [0, 1]
column = "tip_mm"
noise = { absolute = "0.02 mm" }

[[channel]]
id = "force"
kind = "tension"
of = "upper"
column = "force_N"
noise = { absolute = "0.02 N" }

[bench]
file = "bench.csv"
)";

const std::vector<double> kPulled{2, 4}, kHung{0, 0.1, 0.2};

/// Without readings: at each retraction the loads up and, where asked for, down again.
std::string rows(bool down, const std::vector<double>& retractions = kPulled,
                 const std::vector<double>& loads = kHung) {
  std::string csv = "retraction_mm,pull_N,way,tip_mm,force_N\n";
  for (const double r : retractions) {
    for (const double f : loads) csv += fmt::format("{},{},loading,0,0\n", r, f);
    for (size_t i = loads.size(); down && i-- > 0;) csv += fmt::format("{},{},unloading,0,0\n", r, loads[i]);
  }
  return csv;
}

/// The same with the sequence in which they were measured.
std::string ordered_rows(const std::string& csv) {
  std::string ordered;
  int line = 0;
  std::istringstream lines(csv);
  for (std::string text; std::getline(lines, text); ++line)
    ordered += text + (line == 0 ? ",order" : fmt::format(",{}", line)) + "\n";
  return ordered;
}

const std::string both_ways = module_toml + "direction = \"way\"\n";
const std::string no_friction = replaced(both_ways, "friction = 0.2\n", "");

class CableFrictionBench : public testing::Test {
 protected:
  StaticReplay open(const std::string& toml, const std::string& csv) const {
    return bench_of(experiment_in(folder_, toml, csv));
  }
  TemporaryFolder folder_;
};

void expect_derivatives(StaticProtocol& protocol, const std::vector<std::string>& ids) {
  std::vector<int> free;
  for (const std::string& id : ids) free.push_back(protocol.parameters().index(id));
  const Params p = protocol.nominal();
  const Prediction at = protocol.predict(p, free);
  ASSERT_TRUE(at.complete()) << at.failures.front();
  for (size_t k = 0; k < free.size(); ++k) {
    const double size = 0.02 * (p[free[k]] == 0 ? 0.05 : p[free[k]]);
    expect_taylor_order(
        [&](double h) {
          Params q = p;
          q[free[k]] += h;
          const Prediction there = protocol.predict(q, {});
          EXPECT_TRUE(there.complete());
          return (there.values - at.values - h * at.derivatives.col(static_cast<Eigen::Index>(k))).norm();
        },
        2, 1e-9, size, 5, ids[k]);
    EXPECT_GT(at.derivatives.col(static_cast<Eigen::Index>(k)).norm() * size, 1e-6) << ids[k];
  }
}

TEST_F(CableFrictionBench, DerivativesAreThoseOfTheWholePath) {
  const std::vector<std::string> ids{"E_foam", "k_cable", "slack", "cable_friction", "cable_misalignment"};
  expect_derivatives(*open(both_ways, rows(true)).protocol, ids);
  expect_derivatives(*open(both_ways + "order = \"order\"\n", ordered_rows(rows(true))).protocol, ids);
  expect_derivatives(*open(both_ways + "measured_from = \"unloaded\"\n", rows(true)).protocol,
                     {"cable_friction", "E_foam"});
}

TEST_F(CableFrictionBench, UnloadingRowsReadOtherThanLoadingOnesOnlyWhereCablesRub) {
  const StaticReplay rubs = open(both_ways, rows(true)), slides = open(no_friction, rows(true)),
                     plain = open(replaced(no_friction, "direction = \"way\"\n", "ignore = [\"way\"]\n"), rows(false));
  const Eigen::VectorXd with = predicted(rubs).values, without = predicted(slides).values,
                        one = predicted(plain).values;
  ASSERT_EQ(with.size(), 24);
  ASSERT_EQ(one.size(), 12);
  for (Eigen::Index r = 0; r < 2; ++r) {
    for (Eigen::Index load = 0; load < 3; ++load) {
      for (Eigen::Index channel = 0; channel < 2; ++channel) {
        const Eigen::Index up = 12 * r + 2 * load + channel, down = 12 * r + 10 - 2 * load + channel;
        EXPECT_EQ(without[up], without[down]);
        EXPECT_EQ(without[up], one[6 * r + 2 * load + channel]);
        if (load == 2)
          EXPECT_NEAR(with[up], with[down], 1e-9);  // the same state
        else
          EXPECT_GT(std::abs(with[up] - with[down]), 1e-2 * std::abs(with[up] - without[up])) << up;
      }
    }
  }
  // Off costs nothing.
  EXPECT_EQ(slides.protocol->factorisations(), plain.protocol->factorisations());
  EXPECT_EQ(slides.protocol->parameters().size(), plain.protocol->parameters().size() + 1);  // the direction
  EXPECT_FALSE(plain.protocol->parameters().contains("cable_friction"));
}

TEST_F(CableFrictionBench, WithAFrictionOfZeroAllIsAsWithout) {
  const std::string zero = replaced(both_ways, "friction = 0.2", "friction = \"0 +- 0.1\"");
  const StaticReplay rubs = open(zero, rows(true)), slides = open(no_friction, rows(true));
  ASSERT_TRUE(rubs.protocol->parameters().contains("cable_friction"));
  EXPECT_LT((predicted(rubs).values - predicted(slides).values).cwiseAbs().maxCoeff(), 1e-9);
  EXPECT_LE(rubs.protocol->factorisations(), 2 * slides.protocol->factorisations() + 12);
}

TEST_F(CableFrictionBench, TheOrderOfTheRowsIsTheirPath) {
  // One retraction, so that the sequence is the one of the directions; then one that turns back half way.
  const std::vector<double> one{3};
  const StaticReplay by_way = open(both_ways, rows(true, one)),
                     by_order = open(both_ways + "order = \"order\"\n", ordered_rows(rows(true, one)));
  EXPECT_LT((predicted(by_way).values - predicted(by_order).values).cwiseAbs().maxCoeff(), 1e-9);
  const std::string turns =
      "retraction_mm,pull_N,tip_mm,force_N,order\n3,0.2,0,0,10\n3,0.05,0,0,11.5\n3,0.1,0,0,12\n3,0.1,0,0,9\n";
  const Eigen::VectorXd values = predicted(open(module_toml + "order = \"order\"\n", turns)).values;
  ASSERT_EQ(values.size(), 8);
  EXPECT_GT(std::abs(values[4] - values[6]), 1e-5);  // at 0.1 N after 0.05 N, and on the way up
}

TEST_F(CableFrictionBench, WhereRetractionsAloneAreSetTheyAreTheWay) {
  const size_t load = module_toml.find("[[load]]");
  const std::string toml = replaced(module_toml, module_toml.substr(load, module_toml.find("[[channel]]") - load), "");
  const std::string header = "retraction_mm,way,tip_mm,force_N\n";
  const std::string csv = header + "2,loading,0,0\n4,loading,0,0\n2,unloading,0,0\n0.5,unloading,0,0\n";
  const StaticReplay by_way = open(toml + "direction = \"way\"\n", csv);
  const StaticReplay by_order = open(toml + "ignore = [\"way\"]\norder = \"order\"\n", ordered_rows(csv));
  const Eigen::VectorXd values = predicted(by_way).values;
  ASSERT_EQ(values.size(), 8);
  EXPECT_LT((values - predicted(by_order).values).cwiseAbs().maxCoeff(), 1e-9);
  EXPECT_LT(values[5], 0.8 * values[1]) << "a cable gives way at less tension than it was drawn in with";
}

TEST_F(CableFrictionBench, AStateThatSticksIsThatStateHoweverOftenItIsSolvedAgain) {
  std::string csv = "retraction_mm,pull_N,tip_mm,force_N,order\n3,0.2,0,0,1\n3,0.15,0,0,2\n";
  for (int again = 0; again < 1000; ++again)
    csv += fmt::format("3,{},0,0,{}\n", again % 2 == 0 ? 0.14 : 0.15, again + 3);
  const StaticReplay bench = open(module_toml + "order = \"order\"\n", csv);
  const Eigen::VectorXd values = predicted(bench).values;
  EXPECT_NEAR(values[42], values[2002], 1e-12);
  EXPECT_NEAR(values[43], values[2003], 1e-10);
  const auto& conditions = bench.protocol->conditions();
  int stick = 0;
  const auto& states = bench.protocol->scene().states;
  for (size_t s = 0; s < states.size(); ++s) {
    if (!states[s].past) continue;
    const auto slip = [&](size_t row) { return conditions[row].leaves[static_cast<Eigen::Index>(s)]; };
    stick += slip(21) == slip(1001) && slip(21) == slip(1000);
    EXPECT_NEAR(slip(21), slip(1001), 1e-12);
  }
  EXPECT_GT(stick, 0);
}

/// What readings that a friction makes, with these ids free, say of them.
FitResult fit_planted(const StaticReplay& bench, double friction, const std::vector<std::string>& ids) {
  StaticProtocol& protocol = *bench.protocol;
  Params truth = protocol.nominal();
  const int mu = protocol.parameters().index("cable_friction");
  truth[mu] = friction;
  std::mt19937 random(7);
  std::normal_distribution<double> noise;
  const Prediction made = protocol.predict(truth, {});
  EXPECT_TRUE(made.complete());
  std::vector<Measurement> measurements = bench.measurements;
  for (Measurement& one : measurements) one.value = made.values[one.row] + one.sigma * noise(random);
  std::vector<FreeParameter> free;
  for (const std::string& id : ids) {
    const int index = protocol.parameters().index(id);
    const ParameterSpec& spec = protocol.parameters()[index];
    free.push_back(
        {index, id == "cable_friction" ? 0.1 : truth[index] * (spec.logarithmic ? 1.1 : 1), spec.lower, spec.upper});
  }
  protocol.forget();
  return fit(protocol, measurements, free);
}

TEST_F(CableFrictionBench, APlantedFrictionIsFoundFromBothDirectionsAndHardlyFromOne) {
  // Readings of the tip alone.
  const size_t force = both_ways.find("[[channel]]\nid = \"force\"");
  const std::string toml = replaced(replaced(both_ways, both_ways.substr(force, both_ways.find("[bench]") - force), ""),
                                    "direction = \"way\"\n", "direction = \"way\"\nignore = [\"force_N\"]\n");
  const std::vector<std::string> ids{"cable_friction", "k_cable", "slack", "E_foam"};
  const ParameterEstimate both = fit_planted(open(toml, rows(true)), 0.2, ids).parameters[0],
                          loading = fit_planted(open(toml, rows(false)), 0.2, ids).parameters[0],
                          none = fit_planted(open(toml, rows(true)), 0, ids).parameters[0];
  EXPECT_EQ(both.verdict, Verdict::well_determined) << both.explanation;
  ASSERT_TRUE(both.lower95 && both.upper95);
  EXPECT_LT(*both.lower95, 0.2);
  EXPECT_GT(*both.upper95, 0.2);
  EXPECT_LT(both.standard_error, 0.012);
  EXPECT_NE(loading.verdict, Verdict::well_determined);
  EXPECT_GT(loading.standard_error, 4 * both.standard_error);
  EXPECT_EQ(none.verdict, Verdict::bounded_from_one_side) << none.explanation;
  EXPECT_FALSE(none.lower95);
  ASSERT_TRUE(none.upper95);
  EXPECT_LT(*none.upper95, 0.02);
}

TEST_F(CableFrictionBench, FrictionAndWaysThatContradictThemselvesAreRefused) {
  const auto refuses = [&](const std::string& toml, const std::string& csv, const std::vector<std::string>& parts) {
    SCOPED_TRACE(parts.front());
    expect_input_error([&] { open(toml, csv); }, parts);
  };
  const std::string csv = rows(true, {3});
  refuses(replaced(both_ways, "friction = 0.2", "friction = -0.1"), csv, {"[cables] friction", "from 0 (none) to 2"});
  refuses(replaced(both_ways, "friction = 0.2", "friction = 2.1"), csv, {"[cables] friction", "from 0 (none) to 2"});
  refuses(replaced(both_ways, "friction = 0.2", "misalignment = \"2 deg\""), csv,
          {"[cables] misalignment", "without friction"});
  refuses(replaced(both_ways, "friction = 0.2", "friction = 0.2\nmisalignment = \"80 deg\""), csv,
          {"[cables] misalignment", "from 0 to 1 rad"});
  refuses("model = \"auto\"" + both_ways, csv, {"[cables] friction", "\"auto\"", "model = \"full\""});
  refuses("model = \"beam\"" + no_friction + "[fit.free.cable_friction]\n", csv, {"[cables] friction", "\"beam\""});
  refuses(both_ways, replaced(csv, "3,0.2,unloading", "3,0.2,down"),
          {"line 5", "'down' is not a direction", "unloading"});
  const std::string ordered = both_ways + "order = \"order\"\n";
  refuses(ordered, replaced(ordered_rows(csv), "3,0.1,loading,0,0,2", "3,0.1,unloading,0,0,2"),
          {"bench.csv", "line 3", "'unloading'", "line 2", "larger"});
  refuses(ordered, replaced(ordered_rows(csv), "3,0.1,loading,0,0,2", "3,0.1,loading,0,0,1"),
          {"bench.csv", "lines 2 and 3", "order 1", "'pull'"});
  refuses(ordered, replaced(ordered_rows(csv), "3,0.1,loading,0,0,2", "3,0.1,loading,0,0,first"), {"line 3", "first"});
  refuses(ordered, csv, {"column 'order'", "missing"});
}

}  // namespace
}  // namespace taut

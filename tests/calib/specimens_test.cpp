#include <gtest/gtest.h>

#include <cmath>

#include "calib/benches/specimens_bench.hpp"
#include "calib/fit/fit.hpp"
#include "calib/runs/open_bench.hpp"
#include "calib/runs/run_fit.hpp"
#include "calib/studies/planning.hpp"
#include "tests/support/message.hpp"
#include "tests/support/static_bench.hpp"

// Several specimens in one bench: columns that set a dimension, and columns that name specimens.
namespace taut {
namespace {

using namespace test;

constexpr double boom_E = 3e6, boom_height = 0.012, boom_thickness = 0.02, boom_k = 2.0;

/// A boom of any length, clamped by a root that gives way by turning.
const std::string boom_toml = R"(
title = "A boom at several extensions"
data = "simulated"
model = "beam"

[geometry]
kind = "rectangle"
size = ["100 mm", "12 mm"]
region = "boom"
thickness = "20 mm"
plane = "stress"

[mesh]
cells = [20, 2]

[materials.boom]
law = "neo_hookean"
E = "2 MPa"
nu = 0.3

[[support]]
on = "xmin"
rotation_stiffness = "1 Nm/rad"

[[load]]
id = "pull"
on = "xmax"
direction = [0, -1]
column = "pull_N"

[[channel]]
id = "tip"
on = "xmax"
direction = [0, -1]
column = "tip_um"
noise = { absolute = "0.2 um" }

[bench]
file = "bench.csv"
set = { size_x = "length_mm" }

[fit.free.E_boom]
lower = "100 kPa"
upper = "100 MPa"

[fit.free.k_base]
lower = "0.01 Nm/rad"
upper = "100 Nm/rad"
)";

/// Timoshenko's cantilever on a root spring: F (L^3/(3 E I) + L/(kappa G A) + L^2/k) [m], kappa = 5/6.
double boom_tip(double length, double force, double E = boom_E, double k = boom_k) {
  const double I = boom_thickness * std::pow(boom_height, 3) / 12, A = boom_thickness * boom_height;
  return force * (std::pow(length, 3) / (3 * E * I) + length / (5.0 / 6 * E / 2.6 * A) + length * length / k);
}

std::string boom_csv(const std::vector<double>& lengths) {
  std::string csv = "length_mm,pull_N,tip_um\n";
  for (double length : lengths) {
    for (double force : {0.0005, 0.001})
      csv += fmt::format("{},{},{:.9g}\n", 1e3 * length, force, 1e6 * boom_tip(length, force));
  }
  return csv;
}

class Specimens : public testing::Test {
 protected:
  std::unique_ptr<Bench> open(const std::string& toml, const std::string& csv) const {
    folder_.write("bench.csv", csv);
    return open_bench(folder_.write("specimens.toml", toml));
  }
  static FitResult fitted(const Bench& bench) { return fit(bench.protocol(), bench.measurements(), bench.free()); }
  TemporaryFolder folder_;
};

TEST_F(Specimens, ABoomAtEightExtensionsTellsItsRootFromItsModulus) {
  const std::unique_ptr<Bench> bench = open(boom_toml, boom_csv({0.07, 0.08, 0.09, 0.1, 0.11, 0.12, 0.13, 0.14}));
  EXPECT_EQ(bench->readings().size(), 16u);
  expect_input_error([&] { check_can_be_planned(*bench); }, {"specimens.toml", "several specimens"});
  const FitResult result = fitted(*bench);
  ASSERT_EQ(result.status, FitStatus::converged);
  EXPECT_NEAR(result.parameters[0].value, boom_E, 5e-3 * boom_E);
  EXPECT_NEAR(result.parameters[1].value, boom_k, 5e-3 * boom_k);
  EXPECT_EQ(result.parameters[0].verdict, Verdict::well_determined);
  EXPECT_EQ(result.parameters[1].verdict, Verdict::well_determined);
}

TEST_F(Specimens, TwoLengthsSeparateTheRootFromTheModulusAndOneSaysTied) {
  const FitResult two = fitted(*open(boom_toml, boom_csv({0.07, 0.14})));
  ASSERT_EQ(two.status, FitStatus::converged);
  EXPECT_NEAR(two.parameters[0].value, boom_E, 0.02 * boom_E);
  EXPECT_NEAR(two.parameters[1].value, boom_k, 0.02 * boom_k);
  const FitResult one = fitted(*open(boom_toml, boom_csv({0.1})));
  ASSERT_EQ(one.status, FitStatus::converged);
  EXPECT_EQ(one.parameters[0].verdict, Verdict::tied);
  EXPECT_EQ(one.parameters[1].verdict, Verdict::tied);
}

TEST_F(Specimens, FiniteElementsOfEachLengthAreThoseOfABenchOfThatLengthAlone) {
  const std::string full = replaced(boom_toml, "model = \"beam\"\n", "");
  const std::unique_ptr<Bench> both = open(full, boom_csv({0.08, 0.1}));
  Protocol& protocol = both->protocol();
  const std::vector<int> free = indices_of(both->free());
  const Prediction together = protocol.predict(protocol.nominal(), free);
  ASSERT_TRUE(together.complete());
  for (double length : {0.08, 0.1}) {
    const std::string alone_toml =
        replaced(replaced(full, "set = { size_x = \"length_mm\" }\n", "ignore = [\"length_mm\"]\n"),
                 "size = [\"100 mm\"", fmt::format("size = [\"{} mm\"", 1e3 * length));
    const std::unique_ptr<Bench> alone = open(alone_toml, boom_csv({length}));
    const Prediction prediction = alone->protocol().predict(alone->protocol().nominal(), indices_of(alone->free()));
    const Eigen::Index first = length < 0.09 ? 0 : 2;
    EXPECT_EQ(together.values.segment(first, 2), prediction.values);
    EXPECT_EQ(together.derivatives.middleRows(first, 2), prediction.derivatives);
  }
}

/// Three booms whose modulus is their own.
const std::string three_booms =
    replaced(replaced(replaced(boom_toml, "set = { size_x = \"length_mm\" }\n", "specimen = \"boom\"\n"),
                      "[fit.free.E_boom]\n", "[fit.free.E_boom]\nper = \"specimen\"\n"),
             "[bench]",
             "[[specimen]]\nid = \"A\"\nset = { size_x = \"80 mm\" }\n[[specimen]]\nid = \"B\"\nset = { size_x = \"100 "
             "mm\" }\n[[specimen]]\nid = \"C\"\nset = { size_x = \"120 mm\" }\n\n[bench]");

std::string three_csv() {
  std::string csv = "boom,pull_N,tip_um\n";
  const std::pair<const char*, std::pair<double, double>> booms[] = {
      {"A", {0.08, 2.5e6}}, {"B", {0.1, 3e6}}, {"C", {0.12, 4e6}}};
  for (const auto& [id, boom] : booms) {
    for (double force : {0.0005, 0.001})
      csv += fmt::format("{},{},{:.9g}\n", id, force, 1e6 * boom_tip(boom.first, force, boom.second));
  }
  return csv;
}

TEST_F(Specimens, EachHasItsOwnModulusAndAllShareTheRoot) {
  const std::string held =
      replaced(replaced(three_booms, "rotation_stiffness = \"1 Nm/rad\"", "rotation_stiffness = \"2 Nm/rad\""),
               "[fit.free.k_base]\nlower = \"0.01 Nm/rad\"\nupper = \"100 Nm/rad\"\n", "");
  const std::unique_ptr<Bench> bench = open(held, three_csv());
  const FitResult result = fitted(*bench);
  ASSERT_EQ(result.status, FitStatus::converged);
  ASSERT_EQ(result.parameters.size(), 3u);
  const double truth[] = {2.5e6, 3e6, 4e6};
  for (size_t k = 0; k < 3; ++k) {
    EXPECT_EQ(result.parameters[k].spec.id, std::string("E_boom_") + "ABC"[k]);
    EXPECT_NEAR(result.parameters[k].value, truth[k], 5e-3 * truth[k]);
  }
}

TEST_F(Specimens, DerivativesByOwnAndSharedParametersAreThoseOfThePrediction) {
  const std::unique_ptr<Bench> bench = open(three_booms, three_csv());
  Protocol& protocol = bench->protocol();
  const std::vector<int> free = indices_of(bench->free());
  const Params p = protocol.nominal();
  const Prediction here = protocol.predict(p, free);
  for (size_t k = 0; k < free.size(); ++k) {
    Params more = p, less = p;
    const double step = 1e-5 * p[free[k]];
    more[free[k]] += step;
    less[free[k]] -= step;
    const Eigen::VectorXd slope = (protocol.predict(more, {}).values - protocol.predict(less, {}).values) / (2 * step);
    const Eigen::VectorXd exact = here.derivatives.col(static_cast<Eigen::Index>(k));
    EXPECT_LT((slope - exact).norm(), 1e-6 * exact.norm()) << protocol.parameters()[free[k]].id;
  }
}

TEST_F(Specimens, SettingsOfSomeOfThemArePredictedWithTheParametersOfAll) {
  const std::unique_ptr<Bench> bench = open(three_booms, three_csv());
  const std::unique_ptr<Bench> some = bench->at_loads(folder_.write("rows.csv", "boom,pull_N\nC,0.0005\nA,0.001\n"));
  EXPECT_EQ(some->protocol().parameters().ids(), bench->protocol().parameters().ids());
  const Params p = bench->protocol().nominal();
  const Eigen::VectorXd all = bench->protocol().predict(p, {}).values, two = some->protocol().predict(p, {}).values;
  EXPECT_NEAR(two[some->readings()[0].row], all[bench->readings()[4].row], 1e-12);
  EXPECT_NEAR(two[some->readings()[1].row], all[bench->readings()[1].row], 1e-12);
  const std::string by_length = replaced(boom_toml, "[fit.free.E_boom]\n", "[fit.free.E_boom]\nper = \"specimen\"\n");
  const std::unique_ptr<Bench> lengths = open(by_length, boom_csv({0.08, 0.1}));
  EXPECT_TRUE(lengths->protocol().parameters().contains("E_boom_2"));
  expect_input_error([&] { lengths->at_loads(folder_.write("rows.csv", "length_mm,pull_N\n90,0.001\n")); },
                     {"length 90 mm", "no such specimen"});
}

TEST_F(Specimens, AWholeRunDrawsACurveOfEachAndFitsItsVariantsToAll) {
  const std::string toml = replaced(boom_toml, "model = \"beam\"\n", "") +
                           "\n[fit]\nmesh_share = false\n\n[[fit.variant]]\nname = \"coarse\"\ncells = [8, 1]\n";
  const std::unique_ptr<Bench> bench = open(toml, boom_csv({0.08, 0.12}));
  EvaluationLog log(folder_ / "log", "test");
  const RunRecord record = run_fit(*bench, start_record(*bench), log);
  EXPECT_TRUE(record.failed_stages.empty());
  ASSERT_EQ(record.fit.status, FitStatus::converged) << record.fit.message;
  EXPECT_NEAR(record.fit.parameters[0].value, boom_E, 0.02 * boom_E);
  ASSERT_EQ(record.curves.size(), 2u);
  for (size_t k : {0, 1}) {
    const CurveRecord& curve = record.curves[k];
    const double length = k == 0 ? 0.08 : 0.12;
    EXPECT_NE(curve.series.find(k == 0 ? "80 mm" : "120 mm"), std::string::npos) << curve.series;
    ASSERT_GE(curve.load.size(), 2u);
    EXPECT_GE(curve.load.back(), 0.001);
    for (size_t i = 0; i < curve.load.size(); ++i)
      EXPECT_NEAR(curve.value[i], boom_tip(length, curve.load[i]), 0.005 * boom_tip(length, 0.001)) << curve.load[i];
  }
  ASSERT_EQ(record.variants.size(), 1u);
  EXPECT_EQ(record.variants[0].status, "converged");
  EXPECT_NEAR(record.variants[0].values[0], boom_E, 0.03 * boom_E);
  // Where the warm starts are is kept for all of them.
  const std::unique_ptr<Bench> again = open(toml, boom_csv({0.08, 0.12}));
  again->protocol().restore(bench->protocol().state());
  EXPECT_EQ(again->protocol().state(), bench->protocol().state());
}

TEST_F(Specimens, WhatContradictsItselfIsRefused) {
  const auto refuses = [&](const std::string& toml, const std::string& csv, std::vector<std::string> parts) {
    expect_input_error([&] { open(toml, csv)->free(); }, parts);
  };
  const std::string csv = boom_csv({0.08});
  refuses(replaced(boom_toml, "size_x = \"length_mm\"", "size_q = \"length_mm\""), csv, {"size_q", "[bench.set]"});
  refuses(replaced(boom_toml, "size_x = \"length_mm\"", "size_x = \"pull_N\""), csv, {"[bench.set] size_x", "unit"});
  refuses(replaced(boom_toml, "[fit.free.E_boom]", "[fit.free.size_x]"), csv, {"'size_x' is set by a column"});
  refuses(replaced(replaced(boom_toml, "set = { size_x = \"length_mm\" }\n", "ignore = [\"length_mm\"]\n"),
                   "[fit.free.E_boom]\n", "[fit.free.E_boom]\nper = \"specimen\"\n"),
          csv, {"[fit.free.E_boom] per", "has one specimen"});
  refuses(replaced(three_booms, "specimen = \"boom\"\n", ""), three_csv(), {"[bench]", "belong together"});
  refuses(replaced(three_booms, "set = { size_x = \"80 mm\" }\n", ""), three_csv(),
          {"[[specimen]] 'A' does not set size_x"});
  refuses(replaced(three_booms, "id = \"B\"", "id = \"A\""), three_csv(), {"'A' is used twice"});
  refuses(three_booms, replaced(three_csv(), "C,0.0005", "D,0.0005"), {"'D' is not a [[specimen]]", "A, B, C"});
}

/// A specimen's protocol in closed form: rows r give E k + w + r d. It notes what it is asked for.
class Spring final : public Protocol {
 public:
  Spring(int rows, double w) : rows_(rows) {
    for (const char* id : {"E", "k", "w", "d"}) table_.declare({id, id, "1", -1e9, 1e9, std::string("number ") + id});
    nominal_ = Eigen::Vector4d(2, 3, w, 11);
  }
  const ParameterTable& parameters() const override { return table_; }
  const Params& nominal() const override { return nominal_; }
  int row_count() const override { return rows_; }
  Prediction predict(const Params& p, const std::vector<int>& free) override {
    Prediction prediction;
    prediction.values = p[0] * p[1] + p[2] + p[3] * Eigen::VectorXd::LinSpaced(rows_, 0, rows_ - 1).array();
    Eigen::MatrixXd all(rows_, 4);
    for (int r = 0; r < rows_; ++r) all.row(r) << p[1], p[0], 1, r;
    prediction.derivatives.resize(rows_, static_cast<Eigen::Index>(free.size()));
    for (size_t j = 0; j < free.size(); ++j)
      prediction.derivatives.col(static_cast<Eigen::Index>(j)) = all.col(free[j]);
    if (p[0] < 0) prediction.failures.emplace_back("a negative modulus");
    return prediction;
  }
  void forget() override { said += "f"; }
  void begin_search() override { said += "b"; }
  void end_search() override { said += "e"; }
  std::string state() const override { return kept; }
  void restore(const std::string& state) override { kept = state; }
  std::vector<Alternative> alternatives(const Params& p) override {
    Alternative one;
    one.rows = {rows_ - 1};
    one.path = Eigen::VectorXd::Constant(1, p[0]);
    return {one};
  }
  void follow(const Params& at, const std::vector<int>& rows) override {
    followed_at = at;
    followed = rows;
  }
  int factorisations() const override { return 10 * rows_; }

  std::string said, kept;
  Params followed_at;
  std::vector<int> followed;

 private:
  int rows_;
  ParameterTable table_;
  Params nominal_;
};

struct TwoSprings {
  Spring a{2, 5}, b{3, 7};
  SpecimensProtocol both;
  TwoSprings() : both(parts(), {{"E"}, {"A", "B"}}, {"w"}, 1) {}
  std::vector<SpecimensProtocol::Part> parts() {
    std::vector<SpecimensProtocol::Part> made;
    made.push_back({&a, nullptr, "specimen A", "A"});
    made.push_back({&b, nullptr, "specimen B", "B"});
    return made;
  }
  int index(const char* id) const { return both.parameters().index(id); }
  /// E_A = 20, E_B = 30, k = 4, d = 0.5; what changes nothing is 99.
  Params values() const {
    Params p = Params::Constant(both.parameters().size(), 99);
    p[index("E_A")] = 20;
    p[index("E_B")] = 30;
    p[index("k")] = 4;
    p[index("d")] = 0.5;
    return p;
  }
};

TEST(SpecimensProtocol, RowsFollowOneAnotherEachWithWhatIsItsOwn) {
  TwoSprings springs;
  EXPECT_EQ(springs.both.parameters().ids(), (std::vector<std::string>{"E", "k", "w", "E_A", "E_B", "d"}));
  EXPECT_EQ(springs.both.nominal(), (Eigen::VectorXd(6) << 2, 3, 5, 2, 2, 11).finished());
  ASSERT_EQ(springs.both.row_count(), 5);
  EXPECT_EQ(springs.both.part_of(1), 0u);
  EXPECT_EQ(springs.both.part_of(2), 1u);
  const std::vector<int> free{springs.index("E_B"), springs.index("d"), springs.index("k"), springs.index("w")};
  const Prediction prediction = springs.both.predict(springs.values(), free);
  EXPECT_EQ(prediction.values, (Eigen::VectorXd(5) << 85, 85.5, 127, 127.5, 128).finished());
  Eigen::MatrixXd derivatives(5, 4);
  derivatives << 0, 0, 20, 0,  //
      0, 1, 20, 0,             //
      4, 0, 30, 0,             //
      4, 1, 30, 0,             //
      4, 2, 30, 0;
  EXPECT_EQ(prediction.derivatives, derivatives);
  Params broken = springs.values();
  broken[springs.index("E_B")] = -1;
  EXPECT_EQ(springs.both.predict(broken, {}).failures, std::vector<std::string>{"specimen B: a negative modulus"});
}

TEST(SpecimensProtocol, OtherEquilibriaAreAskedOfTheirOwnSpecimen) {
  TwoSprings springs;
  const std::vector<Alternative> found = springs.both.alternatives(springs.values());
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(found[0].rows, std::vector{1});
  EXPECT_EQ(found[0].path[0], 20);
  EXPECT_EQ(found[1].rows, std::vector{4});
  EXPECT_EQ(found[1].path[0], 30);
  springs.both.follow(springs.values(), {1, 2, 4});
  EXPECT_EQ(springs.a.followed, std::vector{1});
  EXPECT_EQ(springs.b.followed, (std::vector{0, 2}));
  EXPECT_EQ(springs.b.followed_at, Eigen::Vector4d(30, 4, 7, 0.5)) << "with its own w";
  springs.both.follow({}, {});
  EXPECT_TRUE(springs.a.followed.empty() && springs.b.followed.empty()) << "as ever";
}

TEST(SpecimensProtocol, SearchesStatesAndCostsAreThoseOfAll) {
  TwoSprings springs, others;
  springs.both.forget();
  springs.both.begin_search();
  springs.both.end_search();
  EXPECT_EQ(springs.a.said, "fbe");
  EXPECT_EQ(springs.b.said, "fbe");
  EXPECT_EQ(springs.both.factorisations(), 50);
  springs.a.kept = "one";
  springs.b.kept = std::string("t\0wo", 4);
  others.both.restore(springs.both.state());
  EXPECT_EQ(others.a.kept, springs.a.kept);
  EXPECT_EQ(others.b.kept, springs.b.kept);
}

TEST_F(Specimens, ReadingsInAnyOrderHaveTheirOwnRowsAndExcludedOnesAreNotFitted) {
  const std::string toml = replaced(replaced(three_booms, "model = \"beam\"\n", ""), "specimen = \"boom\"\n",
                                    "specimen = \"boom\"\nexclude = [3]\n");
  const std::string csv = "boom,pull_N,tip_um\nC,0.001,1\nA,0.001,2\nC,0.0005,3\nB,0.001,4\nA,0.0005,5\nB,0.0005,6\n";
  folder_.write("bench.csv", csv);
  const Experiment experiment = read_experiment(folder_.write("booms.toml", toml));
  const Trials trials = read_trials(experiment.bench);
  const DimensionedModel model = full_model(experiment, trials, {});
  ASSERT_EQ(model.row_of_reading.size(), 6u);
  EXPECT_EQ(model.row_of_reading[1], -1) << "line 3: nothing is solved for it";
  const std::vector<double> fitted{1e-6, 3e-6, 4e-6, 5e-6, 6e-6};
  ASSERT_EQ(model.measurements.size(), fitted.size());
  const Prediction prediction = model.protocol->predict(model.protocol->nominal(), {});
  const std::vector<std::pair<double, double>> settings{
      {0.12, 0.001}, {0.12, 0.0005}, {0.1, 0.001}, {0.08, 0.0005}, {0.1, 0.0005}};
  for (size_t i = 0; i < fitted.size(); ++i) {
    const Measurement& one = model.measurements[i];
    EXPECT_NEAR(one.value, fitted[i], 1e-15);
    const double exact = boom_tip(settings[i].first, settings[i].second, 2e6, 1);
    EXPECT_NEAR(prediction.values[one.row], exact, 0.01 * exact) << i;
  }
}

}  // namespace
}  // namespace taut

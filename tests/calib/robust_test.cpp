#include "calib/fit/robust.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "calib/runs/open_bench.hpp"
#include "calib/runs/run_fit.hpp"
#include "sim/core/error.hpp"
#include "tests/support/closed_form_protocol.hpp"
#include "tests/support/experiment_files.hpp"

namespace taut::test {
namespace {

/// 48 readings of y = b x with unit sigma; `off` is added to one of them.
struct NoisyLine {
  Eigen::VectorXd x = Eigen::VectorXd::LinSpaced(48, 1, 10);
  ClosedFormProtocol protocol{{{modulus("b"), 3}},
                              [this](const Params& p) -> Eigen::VectorXd { return p[0] * x; },
                              [this](const Params&) -> Eigen::MatrixXd { return x; }};
  std::vector<Measurement> measurements;
  std::vector<FreeParameter> free{{0, 3, 1, 1e3}};

  NoisyLine() {
    std::mt19937 random(1);
    std::normal_distribution<double> normal;
    for (int i = 0; i < x.size(); ++i) measurements.push_back({i, 300 * x[i] + normal(random), 1, i});
  }
  FitResult least_squares() { return fit(protocol, measurements, free); }
  RobustFit robust() { return robust_fit(protocol, measurements, free, least_squares()); }
};

TEST(RobustFit, OneReadingTenSigmasOffMovesItByLessThanAThirdOfAStandardError) {
  const RobustFit clean = NoisyLine().robust();
  for (size_t i = 0; i < 48; i += 7) {
    NoisyLine line;
    line.measurements[i].value += 10;
    const RobustFit found = line.robust();
    EXPECT_LT(std::abs(found.values[0] - clean.values[0]), 0.3 * clean.standard_errors[0]) << i;
    for (Eigen::Index k = 0; k < 48; ++k)
      EXPECT_EQ(std::abs(found.residuals[k]) > outlier_from, k == static_cast<Eigen::Index>(i)) << k;
  }
}

TEST(RobustFit, MinimisesStudentsDevianceWithTheStandardErrorsOfItsInformation) {
  NoisyLine line;
  for (size_t i = 0; i < 48; i += 5) line.measurements[i].value += 4;
  const RobustFit found = line.robust();
  double gradient = 0, information = 0;
  for (int i = 0; i < 48; ++i) {
    const double r = line.measurements[static_cast<size_t>(i)].value - found.values[0] * line.x[i];
    gradient += 5 * r / (4 + r * r) * line.x[i];
    information += 5.0 / 7.0 * line.x[i] * line.x[i];
  }
  EXPECT_NEAR(gradient / information, 0, 0.03 * found.standard_errors[0]);
  EXPECT_NEAR(found.standard_errors[0] * std::sqrt(information), 1, 1e-3);
  EXPECT_LE(found.evaluations, 5);
}

TEST(RobustFit, AStepIsTakenWhereStudentsDevianceFallsWhateverANarrowerOneDoes) {
  // One number, least squares at 0. Student's deviance falls towards the 20 readings at 1, one of 1/4 degree of freedom
  // towards the 40 at -0.25.
  std::vector<Measurement> measurements;
  const auto add = [&](int count, double value) {
    for (int i = 0; i < count; ++i) measurements.push_back({0, value, 1, static_cast<int>(measurements.size())});
  };
  add(20, 1);
  add(40, -0.25);
  add(5, -2);
  ClosedFormProtocol number{{{plain("a"), 0}},
                            [](const Params& p) -> Eigen::VectorXd { return p; },
                            [](const Params&) -> Eigen::MatrixXd { return Eigen::MatrixXd::Ones(1, 1); }};
  const std::vector<FreeParameter> free{{0, 0, -10, 10}};
  const auto slope = [&](double a) {  // of the deviance, but for a factor; 0 where it is least
    double sum = 0;
    for (const Measurement& one : measurements) sum += (a - one.value) / (4 + (a - one.value) * (a - one.value));
    return sum;
  };
  double lower = 0, upper = 0.1;
  ASSERT_LT(slope(lower), 0);
  ASSERT_GT(slope(upper), 0);
  for (int i = 0; i < 50; ++i) (slope((lower + upper) / 2) < 0 ? lower : upper) = (lower + upper) / 2;
  const RobustFit found = robust_fit(number, measurements, free, fit(number, measurements, free));
  EXPECT_NEAR(found.values[0], lower, 0.03 / std::sqrt(65)) << "to the tolerance of its search";
  EXPECT_GT(lower, 0.15 / std::sqrt(65)) << "that far from least squares";
}

TEST(RobustFit, ASimulationThatFailsIsSaid) {
  NoisyLine line;
  const FitResult fitted = line.least_squares();
  line.protocol.fails = [](const Params&) { return "no equilibrium"; };
  EXPECT_THROW(robust_fit(line.protocol, line.measurements, line.free, fitted), InputError);
}

/// A bench of the small beam: 8 loads, 6 trials.
TEST(RobustFit, OfABenchIsInTheRecordWithTheLineThatItSetsAside) {
  TemporaryFolder folder;
  const std::string toml = "model = \"beam\"\n" + beam_toml;
  const auto csv = [&](const std::vector<double>& values, int odd) {
    std::string text = "trial,pull_N,tip_mm\n";
    for (int i = 0; i < 48; ++i)
      text += fmt::format("{},{},{:.4f}\n", 1 + i / 8, 0.01 * (1 + i % 8),
                          values[static_cast<size_t>(i)] + (i == odd ? 1 : 0));
    return text;
  };
  const auto record_of = [&](const std::string& table, const std::string& more) {
    folder.write("bench.csv", table);
    const auto bench = open_bench(folder.write("experiment.toml", toml + more));
    EvaluationLog log(folder / ("log" + std::to_string(std::hash<std::string>()(table + more))), "test");
    return run_fit(*bench, start_record(*bench), log);
  };
  folder.write("bench.csv", csv(std::vector<double>(48, 1), -1));
  const auto model = open_bench(folder.write("experiment.toml", toml));
  const Prediction exact = model->protocol().predict(model->protocol().nominal(), {});
  std::mt19937 random(2);
  std::normal_distribution<double> normal;
  std::vector<double> values;
  for (const BenchReading& reading : model->readings())
    values.push_back(1e3 * exact.values[reading.row] + 0.1 * normal(random));
  const std::string quick = "\n[fit]\nmesh_share = false\n", robust = quick + "robust = \"student\"\n";
  const RunRecord clean = record_of(csv(values, -1), robust), off = record_of(csv(values, 17), robust);
  EXPECT_TRUE(clean.failed_stages.empty() && off.failed_stages.empty());
  EXPECT_TRUE(clean.robust.outliers.empty());
  ASSERT_EQ(off.robust.outliers.size(), 1u);
  EXPECT_EQ(off.robust.outliers[0].line, 19);
  EXPECT_NEAR(off.robust.outliers[0].measured - off.robust.outliers[0].expected, 1e-3, 0.3e-3);
  const double error = clean.robust.standard_errors[0];
  EXPECT_LT(std::abs(off.robust.values[0] - clean.robust.values[0]), 0.3 * error);
  EXPECT_GT(std::abs(off.fit.parameters[0].value - clean.fit.parameters[0].value), 0.3 * error) << "least squares";
  ASSERT_FALSE(telling(off.explanations).empty());
  EXPECT_EQ(telling(off.explanations)[0].name, "line 19 alone being off");
  EXPECT_TRUE(telling(clean.explanations).empty());
  EXPECT_EQ(record_of(csv(values, 17), quick).robust.method, "") << "only where it is asked for";

  // Left out, the line is there and changes nothing: the fit is that of the file without it.
  const std::string without = replaced(csv(values, 17), fmt::format("3,0.02,{:.4f}\n", values[17] + 1), "");
  folder.write("bench.csv", csv(values, 17));
  const auto bench = open_bench(folder.write(
      "experiment.toml", replaced(toml, "trial = \"trial\"", "trial = \"trial\"\nexclude = [19]") + quick));
  EvaluationLog log(folder / "excluded", "test");
  const RunRecord excluded = run_fit(*bench, start_record(*bench), log), shorter = record_of(without, quick);
  EXPECT_EQ(excluded.fit.parameters[0].value, shorter.fit.parameters[0].value);
  EXPECT_EQ(excluded.fit.dof, 46);
  ASSERT_EQ(excluded.readings.size(), 48u);
  EXPECT_TRUE(excluded.readings[17].excluded);
  EXPECT_EQ(excluded.readings[17].predicted, excluded.readings[17 - 8].predicted) << "its repeats are predicted";
}

}  // namespace
}  // namespace taut::test

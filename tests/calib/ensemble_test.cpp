#include "calib/studies/ensemble.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

#include "calib/fit/distributions.hpp"
#include "calib/fit/posterior.hpp"
#include "calib/runs/open_bench.hpp"
#include "calib/studies/sbc.hpp"
#include "sim/core/error.hpp"
#include "tests/support/experiment_files.hpp"

namespace taut::test {
namespace {

/// A beam that one modulus bends, fitted; bending by so little goes with 1/E.
class Ensemble : public testing::Test {
 protected:
  void open(const std::string& csv, const std::string& sigma = "0.5 mm") {
    folder_.write("bench.csv", csv);
    const std::string toml =
        "model = \"beam\"\n" + replaced(beam_toml, "absolute = \"0.1 mm\"", "absolute = \"" + sigma + "\"");
    bench_ = open_bench(folder_.write("experiment.toml", toml));
    fit_ = fit(bench_->protocol(), bench_->measurements(), bench_->free());
    ASSERT_EQ(fit_.status, FitStatus::converged);
  }
  StudyOptions options(const std::string& file) const {
    return {std::numeric_limits<double>::infinity(), folder_ / file, "f", nullptr, {}};
  }
  std::vector<std::optional<EnsembleMember>> members(EnsembleKind kind, unsigned count, const std::string& file) const {
    return run_ensemble(*bench_, fit_, {kind, count, 1}, options(file));
  }
  EnsembleRecord summed(EnsembleKind kind, unsigned count) const {
    return summed_up(members(kind, count, std::string(name_of(kind)) + ".csv"), *bench_, fit_, {}, {kind, count, 1});
  }
  TemporaryFolder folder_;
  std::unique_ptr<Bench> bench_;
  FitResult fit_;
};

const std::string four_readings = "trial,pull_N,tip_mm\na,0.05,1\na,0.1,2\nb,0.05,1\nb,0.1,2\n";

TEST_F(Ensemble, ThePosteriorOfAComplianceIsItsDensity) {
  open(four_readings);
  const EnsembleRecord record = summed(EnsembleKind::posterior, 1500);
  ASSERT_EQ(record.parameters.size(), 1U);
  EXPECT_EQ(record.finished, 1500);
  EXPECT_EQ(record.failed, 0);
  EXPECT_GT(record.effective, 700);
  // chi^2(E) = sum ((c / E - y) / sigma)^2 with c = prediction E at the optimum; a flat prior of ln E.
  const double E = fit_.parameters[0].value;
  std::vector<double> values, weights;
  for (double q = std::log(1e3); q < std::log(1e7); q += 1e-4) {
    double chi_squared = 0;
    for (const Measurement& one : bench_->measurements())
      chi_squared += std::pow((fit_.predicted[one.row] * E * std::exp(-q) - one.value) / one.sigma, 2);
    values.push_back(std::exp(q));
    weights.push_back(std::exp(-chi_squared / 2));
  }
  const WeightedValues exact{values, weights};
  const auto share_below = [&](double value) {
    double below = 0, all = 0;
    for (size_t i = 0; i < values.size(); ++i) {
      all += weights[i];
      below += values[i] < value ? weights[i] : 0;
    }
    return below / all;
  };
  const EnsembleMarginal& marginal = record.parameters[0];
  const auto near = [&](double share, double p) {
    EXPECT_NEAR(share, p, 4 * std::sqrt(p * (1 - p) / record.effective) + 2e-3);
  };
  near(share_below(marginal.lower95), 0.025);
  near(share_below(marginal.median), 0.5);
  near(share_below(marginal.upper95), 0.975);
  EXPECT_NEAR(marginal.mean, exact.mean(), 4 * exact.deviation() / std::sqrt(record.effective));
  // Bands are those of c / E.
  ASSERT_EQ(record.bands.size(), 4U);
  EXPECT_NEAR(record.bands[1][0] * marginal.upper95, fit_.predicted[bench_->readings()[1].row] * E, 2e-3 * 2e-3 * E);
  EXPECT_LT(record.bands[1][0], record.bands[1][1]);
}

TEST_F(Ensemble, BootstrapScattersAsTheStandardErrorSays) {
  open(four_readings, "0.1 mm");
  const EnsembleRecord record = summed(EnsembleKind::bootstrap, 300);
  EXPECT_NE(record.how.find("new noise"), std::string::npos) << "two trials";
  EXPECT_EQ(record.effective, 300);
  ASSERT_EQ(record.parameters.size(), 1U);
  EXPECT_NEAR(record.parameters[0].deviation / fit_.parameters[0].standard_error, 1, 4 / std::sqrt(600.0) + 0.02);
  EXPECT_TRUE(record.parameters[0].verdict.starts_with("good")) << record.parameters[0].verdict;
}

/// Trials that differ from each other by more than the declared noise scatter more when they are drawn anew: by the
/// deviation of their mean.
TEST_F(Ensemble, BootstrapOfManyTrialsDrawsTrials) {
  std::string csv = "trial,pull_N,tip_mm\n";
  const double tips[] = {0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 0.7, 1.0};
  double mean = 0, squares = 0;
  for (size_t i = 0; i < 8; ++i) {
    csv += fmt::format("t{},0.05,{}\n", i, tips[i]);
    mean += tips[i] / 8;
  }
  for (double tip : tips) squares += (tip - mean) * (tip - mean) / 8;
  open(csv, "0.01 mm");
  const EnsembleRecord record = summed(EnsembleKind::bootstrap, 400);
  EXPECT_NE(record.how.find("8 trials"), std::string::npos) << record.how;
  const double of_mean = std::sqrt(squares / 8) / mean;  // of ln E, as E goes with the inverse of the mean
  EXPECT_NEAR(record.parameters[0].deviation / fit_.parameters[0].value / of_mean, 1, 0.2);
  EXPECT_TRUE(record.parameters[0].verdict.starts_with("too narrow")) << record.parameters[0].verdict;
}

TEST_F(Ensemble, AllStartsOfOneValleyEndInIt) {
  open(four_readings, "0.1 mm");
  const EnsembleRecord record = summed(EnsembleKind::starts, 12);
  ASSERT_EQ(record.minima.size(), 1U) << record.verdict;
  EXPECT_EQ(record.minima[0].starts + record.failed, 12);
  EXPECT_GE(record.minima[0].starts, 10);
  EXPECT_NEAR(record.minima[0].chi_squared, fit_.chi_squared, 1e-4);
  EXPECT_NEAR(record.minima[0].values[0] / fit_.parameters[0].value, 1, 1e-3);
}

/// chi^2 = a / E^2 - 2 b / E + c.
TEST_F(Ensemble, TheProfileOfAComplianceHasTheEndsOfItsParabola) {
  open(four_readings);
  const EnsembleRecord record = summed(EnsembleKind::profiles, 33);
  const double E = fit_.parameters[0].value;
  double a = 0;
  for (const Measurement& one : bench_->measurements()) a += std::pow(fit_.predicted[one.row] * E / one.sigma, 2);
  ASSERT_EQ(record.profiles.size(), 1U);
  EXPECT_EQ(record.profiles[0].size(), 34U);  // and the optimum
  for (const auto& [value, rise] : record.profiles[0])
    EXPECT_NEAR(rise, a * std::pow(1 / value - 1 / E, 2), 0.01 * rise + 1e-6) << value;
  ASSERT_EQ(record.parameters.size(), 1U);
  EXPECT_NEAR(record.parameters[0].lower95 * (1 / E + z95 / std::sqrt(a)), 1, 2e-3);
  EXPECT_NEAR(record.parameters[0].upper95 * (1 / E - z95 / std::sqrt(a)), 1, 2e-3);
  EXPECT_NEAR(record.parameters[0].median, E, 1e-9 * E);
  EXPECT_EQ(record.evaluations, 1) << "nothing else is free";
}

/// Readings y = c / E + zero: chi^2 rises by (1/E - 1/E')^2 / C along E, with C from the normal equations of both.
TEST_F(Ensemble, AProfileLetsTheOtherParametersFollow) {
  folder_.write("bench.csv",
                "trial,pull_N,none_N,tip_mm\n1,0.002,0,0.042\n1,0.006,0,0.091\n1,0.01,0,0.155\n1,0.014,0,0.201\n");
  const std::string toml = replaced(
      replaced(replaced(beam_toml, "[[channel]]",
                        "[[load]]\nid = \"none\"\non = \"xmax\"\ndirection = [1, 0]\ncolumn = \"none_N\"\n[[channel]]"),
               "[bench]",
               "[fit.free.zero_1]\nlower = \"-1 mm\"\nupper = \"1 mm\"\n[bench]\nzero_offset_per = \"none\""),
      "absolute = \"0.1 mm\"", "absolute = \"0.01 mm\"");
  bench_ = open_bench(folder_.write("experiment.toml", toml));
  fit_ = fit(bench_->protocol(), bench_->measurements(), bench_->free());
  ASSERT_EQ(fit_.status, FitStatus::converged);
  const EnsembleRecord record = summed(EnsembleKind::profiles, 66);
  const bool first = fit_.parameters[0].spec.id == "E_foam";
  const size_t of_E = first ? 0 : 1, of_zero = first ? 1 : 0;
  const double E = fit_.parameters[of_E].value, zero = fit_.parameters[of_zero].value;
  Eigen::Matrix2d N = Eigen::Matrix2d::Zero();
  for (const Measurement& one : bench_->measurements()) {
    const Eigen::Vector2d row((fit_.predicted[one.row] - zero) * E, 1);
    N += row * row.transpose() / (one.sigma * one.sigma);
  }
  const Eigen::Matrix2d C = N.inverse();
  ASSERT_EQ(record.parameters.size(), 2U);
  ASSERT_EQ(record.failed, 0);
  EXPECT_NEAR(record.parameters[of_E].lower95 * (1 / E + z95 * std::sqrt(C(0, 0))), 1, 5e-3);
  EXPECT_NEAR(record.parameters[of_E].upper95 * (1 / E - z95 * std::sqrt(C(0, 0))), 1, 5e-3);
  const double half = z95 * std::sqrt(C(1, 1));
  EXPECT_NEAR(record.parameters[of_zero].lower95, zero - half, 5e-3 * half);
  EXPECT_NEAR(record.parameters[of_zero].upper95, zero + half, 5e-3 * half);
  EXPECT_TRUE(record.parameters[of_zero].verdict.starts_with("good")) << record.parameters[of_zero].verdict;
}

/// A bound that is met before chi squared has risen by 3.84.
TEST_F(Ensemble, AProfileIsOpenWhereItsBoundComesFirst) {
  folder_.write("bench.csv", four_readings);
  const std::string toml = "model = \"beam\"\n" + replaced(beam_toml, "absolute = \"0.1 mm\"", "absolute = \"10 mm\"");
  bench_ = open_bench(folder_.write("experiment.toml", toml));
  fit_ = fit(bench_->protocol(), bench_->measurements(), bench_->free());
  ASSERT_EQ(fit_.status, FitStatus::converged);
  const EnsembleRecord record = summed(EnsembleKind::profiles, 20);
  ASSERT_EQ(record.parameters.size(), 1U);
  EXPECT_TRUE(std::isfinite(record.parameters[0].lower95));
  EXPECT_TRUE(std::isnan(record.parameters[0].upper95));
  EXPECT_NE(record.parameters[0].verdict.find("open above"), std::string::npos) << record.parameters[0].verdict;
  EXPECT_NEAR(record.profiles[0].back().first, 10e6, 1);
}

/// More members lie between those that are there.
TEST_F(Ensemble, ALargerNumberAddsToAProfile) {
  open(four_readings);
  const auto few = members(EnsembleKind::profiles, 9, "grid.csv"),
             many = members(EnsembleKind::profiles, 17, "grid.csv");
  for (size_t k = 0; k < few.size(); ++k) EXPECT_EQ(few[k]->values, many[k]->values);
  std::vector<double> places;
  for (const auto& member : many) places.push_back(std::log(member->values[0]));
  std::ranges::sort(places);
  for (size_t k = 2; k < places.size(); ++k)
    EXPECT_NEAR(places[k] - places[k - 1], places[1] - places[0], 1e-9) << "seventeen divide the range evenly";
}

TEST_F(Ensemble, IsTheSameInOnePieceAndInParts) {
  open(four_readings);
  for (const EnsembleKind kind :
       {EnsembleKind::posterior, EnsembleKind::bootstrap, EnsembleKind::starts, EnsembleKind::profiles}) {
    const std::string whole = ensemble_csv(members(kind, 9, "whole" + std::string(name_of(kind)) + ".csv"), fit_);
    const std::string parts = "parts" + std::string(name_of(kind)) + ".csv";
    for (const size_t index : {1, 2, 0}) {
      StudyOptions part = options(parts);
      part.shard = {index, 3};
      const auto own = run_ensemble(*bench_, fit_, {kind, 9, 1}, part);
      EXPECT_TRUE(own[index].has_value());
    }
    EXPECT_EQ(ensemble_csv(members(kind, 9, parts), fit_), whole) << name_of(kind);
    if (kind == EnsembleKind::profiles) continue;  // nothing is drawn
    EXPECT_NE(ensemble_csv(run_ensemble(*bench_, fit_, {kind, 9, 2}, options(parts)), fit_), whole) << "another seed";
  }
}

TEST_F(Ensemble, ARunThatTheBenchDoesNotReproduceIsRefused) {
  open(four_readings);
  FitResult other = fit_;
  other.chi_squared += 3;
  for (const EnsembleKind kind : {EnsembleKind::posterior, EnsembleKind::bootstrap}) {
    try {
      run_ensemble(*bench_, other, {kind, 2, 1}, options("other.csv"));
      FAIL();
    } catch (const InputError& error) {
      EXPECT_NE(std::string(error.what()).find("fit it again"), std::string::npos) << error.what();
    }
  }
  other = fit_;
  other.status = FitStatus::not_converged;
  EXPECT_THROW(run_ensemble(*bench_, other, {EnsembleKind::posterior, 2, 1}, options("other.csv")), InputError);
}

TEST_F(Ensemble, TooFewMembersDescribeNoDistribution) {
  open(four_readings);
  const EnsembleRecord record = summed(EnsembleKind::posterior, 10);
  EXPECT_TRUE(record.parameters.empty());
  EXPECT_NE(record.verdict.find("too few"), std::string::npos) << record.verdict;
}

TEST_F(Ensemble, RanksOfTruthsFromThePriorAreUniform) {
  folder_.write("bench.csv", four_readings);
  std::string toml = "model = \"beam\"\n" + replaced(beam_toml, "absolute = \"0.1 mm\"", "absolute = \"0.5 mm\"");
  toml =
      replaced(replaced(toml, "lower = \"1 kPa\"", "lower = \"600 kPa\""), "upper = \"10 MPa\"", "upper = \"3 MPa\"");
  bench_ = open_bench(folder_.write("experiment.toml", replaced(toml, "start = \"50 kPa\"", "start = \"1 MPa\"")));
  StudyOptions how = options("sbc.csv");
  const auto results = run_sbc(*bench_, 60, 60, how);
  const std::vector<SbcVerdict> verdicts = judge_sbc(*bench_, results);
  ASSERT_EQ(verdicts.size(), 1U);
  EXPECT_EQ(verdicts[0].count, 60);
  EXPECT_GT(verdicts[0].p, 0.01) << "distance " << verdicts[0].distance;
  // Ranks of a posterior that is far too narrow gather at the ends.
  auto narrow = results;
  for (auto& result : narrow) result->ranks[0] = std::clamp(0.5 + 5 * (result->ranks[0] - 0.5), 0.0, 1.0);
  EXPECT_LT(judge_sbc(*bench_, narrow)[0].p, 1e-4);
}

}  // namespace
}  // namespace taut::test

#include "calib/benches/assumptions.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "calib/fit/fit.hpp"
#include "calib/studies/assumption_shares.hpp"
#include "tests/support/message.hpp"
#include "tests/support/push_puppet.hpp"
#include "tests/support/static_bench.hpp"

namespace taut::test {
namespace {

/// A bar of 60 x 12 x 20 mm in tension, plane stress without cross contraction: delta = F L / (E t h), exactly linear
/// in small strains.
std::string bar() {
  std::string toml = beam_toml;
  for (const char* column : {"pull_N", "tip_mm"}) {
    const std::string end = std::string("\ncolumn = \"") + column + "\"";
    toml = replaced(toml, "direction = [0, -1]" + end, "direction = [1, 0]" + end);
  }
  toml = replaced(toml, "absolute = \"0.1 mm\"", "absolute = \"0.000001 mm\"");
  return replaced(replaced(toml, "plane = \"strain\"", "plane = \"stress\""), "nu = 0.3", "nu = 0");
}
const std::string bar_csv =
    "trial,pull_N,tip_mm\na,0.0001,0.00025\na,0.0002,0.0005\nb,0.0001,0.00025\nb,0.0002,0.0005\n";

class Assumptions : public testing::Test {
 protected:
  /// Fitted, with its shares by their sources.
  std::map<std::string, Share> shares_of(const std::string& toml, double* modulus = nullptr) const {
    const Experiment experiment = experiment_in(folder_, toml, bar_csv);
    const Trials trials = read_trials(experiment.bench);
    const StaticReplay replay = make_static_replay(experiment, experiment.mesh, trials);
    FitOptions options;
    options.profiles = false;
    const FitResult result =
        fit(*replay.protocol, replay.measurements, free_parameters(experiment, *replay.protocol), options);
    EXPECT_EQ(result.status, FitStatus::converged);
    if (modulus != nullptr) *modulus = result.parameters[0].value;
    std::map<std::string, Share> found;
    for (const Share& share : assumption_shares(experiment, trials, result)) found[share.source] = share;
    return found;
  }
  TemporaryFolder folder_;
};

TEST_F(Assumptions, ABarsModulusGoesWithItsLengthAndItsLoadAndAgainstItsCrossSection) {
  double E = 0;
  const auto shares = shares_of(bar(), &E);
  EXPECT_NEAR(E, 0.0001 * 0.06 / (0.02 * 0.012 * 0.25e-6), 1e-3 * E);
  for (const char* source : {"size_x", "size_y", "thickness", "scale of pull"}) {
    ASSERT_TRUE(shares.contains(source)) << source;
    EXPECT_NEAR(shares.at(source).error[0], 0.01 * E, 1e-4 * E) << source;
    EXPECT_FALSE(shares.at(source).counted) << "nobody stated a tolerance";
  }
  EXPECT_FALSE(shares.contains("E_foam"));
  EXPECT_FALSE(shares.contains("nu_foam")) << "it is zero";
}

TEST_F(Assumptions, TolerancesOfTheFileCountAndAreThoseOfTheShares) {
  std::string toml =
      replaced(bar(), "size = [\"60 mm\", \"12 mm\"]", "size = [\"60 mm +- 0.3 mm\", \"12 mm \u00b1 2 %\"]");
  toml = replaced(toml, "thickness = \"20 mm\"", "thickness = \"20 mm +- 0.1 mm\"");
  toml = replaced(toml, "nu = 0\n", "nu = \"0 +- 0.02\"\n");
  toml = replaced(toml, "trial = \"trial\"", "trial = \"trial\"\ntolerance = { pull = \"0.5 %\" }");
  double E = 0;
  const auto shares = shares_of(toml, &E);
  EXPECT_NEAR(shares.at("size_x").error[0], 0.005 * E, 1e-4 * E);
  EXPECT_NEAR(shares.at("size_y").error[0], 0.02 * E, 1e-3 * E);
  EXPECT_NEAR(shares.at("thickness").error[0], 0.005 * E, 1e-4 * E);
  EXPECT_NEAR(shares.at("scale of pull").error[0], 0.005 * E, 1e-4 * E);
  EXPECT_TRUE(shares.contains("nu_foam")) << "zero, but with a tolerance";
  for (const auto& [source, share] : shares) EXPECT_TRUE(share.counted) << source;
}

TEST_F(Assumptions, PerCentAreOfTheValueOfPureNumbersToo) {
  const Experiment e = experiment_in(folder_, replaced(bar(), "nu = 0\n", "nu = \"0.3 +- 10 %\"\n"), bar_csv);
  EXPECT_NEAR(e.tolerances.at("materials.foam.nu").half_width, 0.03, 1e-12);
}

TEST_F(Assumptions, AnErrorOfAZeroIsAConstantOfTheLoad) {
  const std::string toml =
      replaced(bar(), "trial = \"trial\"", "trial = \"trial\"\ntolerance = { pull = \"0.00001 N\" }");
  double E = 0;
  const auto shares = shares_of(toml, &E);
  // delta_i = (F_i + f) c / E with equal sigmas: dE/E = f sum F / sum F^2.
  EXPECT_NEAR(shares.at("zero of pull").error[0] / E, 1e-5 * 3e-4 / 5e-8, 1e-3);
}

TEST_F(Assumptions, TolerancesThatMeanNothingAreRefusedWithTheirPlace) {
  const auto refused = [&](const std::string& toml, const std::vector<std::string>& parts) {
    expect_input_error(
        [&] {
          const Experiment e = experiment_in(folder_, toml, bar_csv);
          const StaticReplay replay = bench_of(e);
          assumptions_of(e, replay.protocol->parameters(), replay.protocol->nominal(), dimensions_of(e));
        },
        parts);
  };
  refused(replaced(bar(), "E = \"100 kPa\"", "E = \"100 kPa +- 5 kPa\""), {"E_foam is fitted"});
  refused(replaced(bar(), "absolute = \"0.000001 mm\"", "absolute = \"0.1 mm +- 1 mm\""),
          {"noise", "a tolerance has no effect"});
  refused(replaced(bar(), "thickness = \"20 mm\"", "thickness = \"20 mm +- 0 mm\""), {"thickness", "must be positive"});
  refused(replaced(bar(), "thickness = \"20 mm\"", "thickness = \"20 mm +- 1 kg\""), {"thickness", "not a unit of"});
  refused(replaced(bar(), "trial = \"trial\"", "trial = \"trial\"\ntolerance = { pull = \"1 mm\" }"),
          {"not a unit of force"});
  refused(replaced(bar(), "trial = \"trial\"", "trial = \"trial\"\ntolerance = { push = \"1 %\" }"), {"push"});
}

/// Derivatives against differences of whole predictions, with cables, contact and a module that is nearly closed.
TEST(SlowAssumptions, DerivativesWithRespectToDimensionsAreThoseOfWholePredictions) {
  Experiment e = reference_module(1);
  const Trials trials = conditions_of({0, 8e-3, 17.68e-3}, {0.05, 0.2});
  DimensionedProtocol protocol(e, trials);
  EXPECT_TRUE(protocol.left_out().empty());
  std::vector<int> asked;
  for (const Dimension& d : protocol.dimensions()) asked.push_back(protocol.parameters().index(d.spec.id));
  const Prediction at = protocol.predict(protocol.nominal(), asked);
  ASSERT_TRUE(at.complete());
  for (const char* id : {"gap_total", "core_height", "via_inset", "cable_offset", "web_thickness"}) {
    const auto d = std::ranges::find(protocol.dimensions(), id, [](const Dimension& one) { return one.spec.id; });
    ASSERT_NE(d, protocol.dimensions().end()) << id;
    const double h = 2e-6;
    Eigen::VectorXd sides[2];
    for (size_t k : {0u, 1u}) {
      Experiment other = e;
      d->set(other, d->value + (k == 0 ? -h : h));
      const StaticReplay replay = make_static_replay(other, other.mesh, trials);
      sides[k] = replay.protocol->predict(replay.protocol->nominal(), {}).values;
    }
    const Eigen::VectorXd differences = (sides[1] - sides[0]) / (2 * h);
    const Eigen::VectorXd exact = at.derivatives.col(d - protocol.dimensions().begin());
    EXPECT_LT((differences - exact).cwiseAbs().maxCoeff(), 0.01 * exact.cwiseAbs().maxCoeff())
        << id << "\n"
        << differences.transpose() << "\n"
        << exact.transpose();
  }
}

TEST(TotalInterval, AddsWhatCountsAsRootOfSquaresAndSaysWhatIsNotKnown) {
  ParameterEstimate e;
  e.value = 100;
  e.lower95 = 97;
  std::vector<Share> shares(3);
  shares[0] = {"mesh", {-3}, {1}, "", 0, true};
  shares[1] = {"gap_total", {0}, {50}, "", 0, false};
  shares[2] = {"plane section", {NAN}, {NAN}, "", 0, true};
  const TotalInterval total = total_interval(e, shares, 0);
  EXPECT_DOUBLE_EQ(*total.lower, 95);
  EXPECT_FALSE(total.upper.has_value()) << "open, as the noise leaves it";
  EXPECT_EQ(total.without, std::vector<std::string>{"plane section"});
}

}  // namespace
}  // namespace taut::test

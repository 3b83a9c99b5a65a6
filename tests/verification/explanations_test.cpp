#include "calib/fit/explanations.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>

#include "calib/benches/static_bench.hpp"
#include "calib/files/experiment.hpp"
#include "calib/runs/run_fit.hpp"
#include "tests/support/push_puppet.hpp"

// Faults put into the push-puppet module's readings, which the explanations of its misfit have to name.
namespace taut::test {
namespace {

/// The module with its foam, cables and slack free, on a coarse mesh.
class SlowExplanations : public testing::Test {
 protected:
  SlowExplanations() : experiment_(read_experiment(TAUT_SOURCE_DIR "/experiments/push_puppet/experiment.toml")) {
    experiment_.mesh.size = 5.2e-3;
    trials_ = read_trials(experiment_.bench);
  }

  Reading& line(int number) { return *std::ranges::find(trials_.readings, number, &Reading::line); }

  /// Sigmas follow the readings, as when they are read.
  std::vector<Explanation> explanations() {
    for (Reading& reading : trials_.readings)
      reading.sigma = experiment_.bench.channels.front().noise.sigma(reading.value);
    const StaticBench bench(experiment_, trials_);
    FitOptions options;
    options.profiles = false;
    fit_ = fit(bench.protocol(), bench.measurements(), bench.free(), options);
    EXPECT_EQ(fit_.status, FitStatus::converged) << fit_.message;
    const auto all = explanations_of(
        bench, fit_,
        [](Protocol& protocol, const Params& p, const std::vector<int>& free) { return protocol.predict(p, free); });
    std::printf("chi squared %.4g for %d\n", fit_.chi_squared, fit_.dof);
    for (const Explanation& e : telling(all))
      std::printf("  %8.4g for %d  p = %.1g  %s\n", e.chi_squared, e.dof, e.p_value, e.what.c_str());
    return all;
  }

  Experiment experiment_;
  Trials trials_;
  FitResult fit_;
};

TEST_F(SlowExplanations, NothingIsToldOfTheReadingsAsTheyAre) {
  const std::vector<Explanation> all = explanations();
  EXPECT_TRUE(telling(all).empty());
  const auto mass = std::ranges::find(all, "a scale error of 'mass' (or another g)", &Explanation::name);
  ASSERT_NE(mass, all.end());
  EXPECT_FALSE(mass->like_parameters.empty()) << "every stiffness grows with the loads";
  EXPECT_EQ(mass->like_parameters.front(), "E_foam");
}

TEST_F(SlowExplanations, AZeroErrorIsNamedFirstWithItsValue) {
  for (Reading& reading : trials_.readings) reading.value += 0.2e-3;
  const std::vector<Explanation> told = telling(explanations());
  ASSERT_FALSE(told.empty());
  EXPECT_EQ(told.front().name, "a zero error of 'tip'");
  EXPECT_NEAR(told.front().values.front(), 0.2e-3, 2 * told.front().standard_errors.front());
}

TEST_F(SlowExplanations, ADriftFromTrialToTrialIsNamedFirst) {
  for (Reading& reading : trials_.readings) reading.value *= 1 + 0.03 * (std::stoi(reading.trial) - 1);
  const std::vector<Explanation> told = telling(explanations());
  ASSERT_FALSE(told.empty());
  EXPECT_EQ(told.front().name, "a drift from trial to trial");
  EXPECT_NEAR(told.front().values.front(), 0.03, 2.5 * told.front().standard_errors.front());
}

TEST_F(SlowExplanations, ExchangedLinesAreNamedFirst) {
  std::swap(line(9).value, line(21).value);
  const std::vector<Explanation> told = telling(explanations());
  ASSERT_FALSE(told.empty());
  EXPECT_EQ(told.front().name, "lines 9 and 21 exchanged");
}

TEST_F(SlowExplanations, ASlippedDecimalIsNamedFirst) {
  line(30).value *= 10;
  const std::vector<Explanation> told = telling(explanations());
  ASSERT_FALSE(told.empty());
  EXPECT_EQ(told.front().lines, (std::vector<int>{30}));
  EXPECT_NE(told.front().what.find("a slipped decimal point"), std::string::npos) << told.front().what;
}

TEST_F(SlowExplanations, AWrongDimensionIsNamedFirstWithWhatItWas) {
  PushPuppet module = experiment_.geometry.as<PushPuppet>();
  module.via_inset = 0.9e-3;  // 0.5 mm made the readings
  set_module(experiment_, module);
  const std::vector<Explanation> told = telling(explanations());
  ASSERT_FALSE(told.empty());
  EXPECT_EQ(told.front().name, "another via_inset");
  EXPECT_NEAR(told.front().values.front(), -0.4e-3, 0.1e-3) << "to first order";
}

}  // namespace
}  // namespace taut::test

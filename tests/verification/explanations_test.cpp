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
    options.profiles = options.recover = false;  // the optimum of readings that are wrong, as it is
    fit_ = fit(bench.protocol(), bench.measurements(), bench.free(), options);
    EXPECT_EQ(fit_.status, FitStatus::converged) << fit_.message;
    RunRecord record;
    record.fit = fit_;
    explain(
        bench,
        [](Protocol& protocol, const Params& p, const std::vector<int>& free) { return protocol.predict(p, free); },
        record);
    const std::vector<Explanation>& all = record.explanations;
    held_out_ = record.held_out;
    std::printf("chi squared %.4g for %d\n", fit_.chi_squared, fit_.dof);
    for (const Explanation& e : telling(all))
      std::printf("  %8.4g for %d  p = %.1g  %s\n", e.chi_squared, e.dof, e.p_value, e.what.c_str());
    return all;
  }

  Experiment experiment_;
  Trials trials_;
  FitResult fit_;
  std::vector<HeldOut> held_out_;
};

TEST_F(SlowExplanations, NothingIsToldOfTheReadingsAsTheyAre) {
  const std::vector<Explanation> all = explanations();
  EXPECT_TRUE(telling(all).empty());
  ASSERT_EQ(held_out_.size(), 4u) << "retractions";
  for (const HeldOut& part : held_out_) EXPECT_GT(part.p_value, telling_held_out(4)) << part.part;
  EXPECT_EQ(held_out_[0].dof, 12) << "the others have foam enough";
  EXPECT_EQ(held_out_[3].part, "retraction = 17.68 mm");
  EXPECT_LT(held_out_[3].dof, 12) << "what the plastic does";
  EXPECT_EQ(held_out_[3].own, std::vector<std::string>{"E_plastic"}) << "which bends where the lips are closed";
  EXPECT_TRUE(held_out_[2].own.empty());
  const auto mass = std::ranges::find(all, "a scale error of 'mass' (or another g)", &Explanation::name);
  ASSERT_NE(mass, all.end());
  EXPECT_FALSE(mass->like_parameters.empty()) << "every stiffness grows with the loads";
  EXPECT_EQ(mass->like_parameters.front(), "E_foam");
}

TEST_F(SlowExplanations, ARetractionWhoseReadingsAreStifferIsNotWhatTheOthersPredict) {
  for (Reading& reading : trials_.readings) {
    if (reading.controls[1] > 5e-3 && reading.controls[1] < 6e-3) reading.value *= 0.95;
  }
  explanations();
  for (const HeldOut& part : held_out_) std::printf("%s: %.3g for %d\n", part.part.c_str(), part.chi_squared, part.dof);
  const auto worst = std::ranges::min_element(held_out_, {}, &HeldOut::p_value);
  EXPECT_EQ(worst->part, "retraction = 5.89 mm");
  EXPECT_LT(worst->p_value, telling_held_out(4));
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

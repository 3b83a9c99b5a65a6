#include "calib/data/plausibility.hpp"

#include <gtest/gtest.h>

namespace taut::test {
namespace {

/// Readings of one channel [m] with sigma 0.02 mm, one condition per list, from line 2 on.
Trials bench_of(const std::vector<std::vector<double>>& conditions) {
  Trials trials;
  trials.control_ids = {"retraction"};
  trials.control_values.resize(1);
  trials.channel_ids = {"tip"};
  int line = 2;
  for (size_t c = 0; c < conditions.size(); ++c) {
    trials.control_values[0].insert(1e-3 * static_cast<double>(c));
    for (double value : conditions[c])
      trials.readings.push_back({line++, "", {1e-3 * static_cast<double>(c)}, 0, value, 2e-5});
  }
  return trials;
}

std::vector<std::string> odd(const std::vector<std::vector<double>>& conditions) {
  return odd_repeats(bench_of(conditions), {"m"});
}

void expect_one(const std::vector<std::string>& found, const std::vector<std::string>& parts) {
  ASSERT_EQ(found.size(), 1u);
  for (const std::string& part : parts) EXPECT_NE(found[0].find(part), std::string::npos) << part << ": " << found[0];
}

TEST(Plausibility, RepeatsThatScatterAsDeclaredAreNoFinding) {
  EXPECT_TRUE(odd({{3.85e-3, 3.86e-3, 3.84e-3}, {1e-3}, {2e-3, 2.03e-3}}).empty());
  EXPECT_TRUE(odd({{1e-3, 1.4e-3, 0.7e-3, 1.2e-3}}).empty()) << "they all scatter: no one of them is odd";
}

TEST(Plausibility, ASlippedDecimalIsNamedWithItsLine) {
  expect_one(odd({{1e-3, 1.01e-3, 1e-3}, {3.85e-3, 38.5e-3, 3.86e-3}}),
             {"line 6: 38.5 mm where 2 repeats say 3.855 mm", "larger by 10", "tip"});
  expect_one(odd({{3.85e-3, 0.385e-3, 3.86e-3, 3.83e-3}}), {"line 3", "smaller by 10"});
}

TEST(Plausibility, OtherSlipsOfOneReadingAreNamed) {
  expect_one(odd({{3e-3, -3.01e-3, 3e-3}}), {"line 3", "other sign"});
  expect_one(odd({{1e-3, 25.4e-3, 1e-3}}), {"line 3", "inches"});
  expect_one(odd({{3e-3, 5e-3, 3e-3}}), {"line 3: 5 mm where 2 repeats say 3 mm (tip"});
  expect_one(odd({{3e-3, 5e-3}}), {"line 2: 3 mm where its repeat says 5 mm"});
}

TEST(Plausibility, FactorsAreToldApart) {
  EXPECT_NE(slip_of(9.84, 0.05).find("9.81"), std::string::npos);
  EXPECT_NE(slip_of(10.01, 0.05).find("10:"), std::string::npos);
  EXPECT_NE(slip_of(1.0 / 1000, 0.01).find("smaller by 1000"), std::string::npos);
  EXPECT_EQ(slip_of(3, 0.05), "");
}

TEST(Plausibility, RetractionsAndReadingsBeyondTheSpecimenAreNamed) {
  Trials trials = bench_of({{1e-3}, {2e-3}});
  EXPECT_TRUE(out_of_proportion(trials, {"retraction"}, {"m"}, 0.06).empty());
  trials.control_values[0].insert(0.12);
  expect_one(out_of_proportion(trials, {"retraction"}, {"m"}, 0.06), {"'retraction' goes to 120 mm", "unit"});
  EXPECT_TRUE(out_of_proportion(trials, {}, {"m"}, 0.06).empty()) << "no retraction, no limit";
  trials.readings[1].value = 2;
  expect_one(out_of_proportion(trials, {}, {"m"}, 0.06), {"line 3: 'tip' reads 2 m on a specimen of 60 mm"});
  EXPECT_TRUE(out_of_proportion(trials, {}, {"rad"}, 0.06).empty());
}

}  // namespace
}  // namespace taut::test

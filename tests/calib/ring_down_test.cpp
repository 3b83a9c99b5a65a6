#include "calib/data/ring_down.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/support/message.hpp"

namespace taut {
namespace {

TEST(RingDown, FrequencyDecayAndDriftOfAClosedFormComeBack) {
  for (const double frequency : {3.34, 7.72}) {
    std::vector<double> times, values;
    for (int i = 0; i < 42; ++i) {
      const double t = 0.03 * i;
      times.push_back(0.06 + t);
      values.push_back(-6.2 - 0.3 * t + 4.5 * std::exp(-2.6 * t) * std::cos(2 * M_PI * frequency * t + 0.7));
    }
    const RingDown found = ring_down(times, values);
    EXPECT_NEAR(found.frequency, frequency, 1e-5);
    EXPECT_NEAR(found.decay, 2.6, 1e-4);
    EXPECT_NEAR(found.amplitude, 4.5, 1e-4);
    EXPECT_NEAR(found.offset, -6.2, 1e-4);
    EXPECT_NEAR(found.drift, -0.3, 1e-4);
    EXPECT_LT(found.rms, 1e-6);
    EXPECT_NEAR(found.damping_ratio(), 2.6 / std::hypot(2.6, 2 * M_PI * frequency), 1e-5);
  }
}

TEST(RingDown, WrongSamplesAreRefused) {
  const std::vector<double> few(7, 0.0);
  test::expect_input_error([&] { ring_down(few, few); }, {"8 samples or more", "7"});
  std::vector<double> times = {0, 1, 2, 3, 4, 5, 5, 7}, values(8, 1.0);
  test::expect_input_error([&] { ring_down(times, values); }, {"ascending", "sample 7"});
  times[6] = 6;
  values[2] = NAN;
  test::expect_input_error([&] { ring_down(times, values); }, {"finite", "sample 3"});
}

}  // namespace
}  // namespace taut

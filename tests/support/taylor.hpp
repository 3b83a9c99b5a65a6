#pragma once
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

namespace taut::test {

/// Slope of log y over log x by least squares.
inline double log_slope(const std::vector<double>& x, const std::vector<double>& y) {
  const double n = static_cast<double>(x.size());
  double sx = 0, sy = 0, sxx = 0, sxy = 0;
  for (size_t i = 0; i < x.size(); ++i) {
    const double a = std::log(x[i]), b = std::log(y[i]);
    sx += a;
    sy += b;
    sxx += a * a;
    sxy += a * b;
  }
  return (n * sxy - sx * sy) / (n * sxx - sx * sx);
}

/// Expects remainder(h) = O(h^order) on the steps `first` / 2^k, k < `steps`: the sign of a right derivative, where a
/// wrong one leaves a part of lower order. Steps whose remainder is below `noise` (rounding) are left out; a function
/// that is polynomial enough leaves nothing else, and is then exact. A remainder that falls faster is right too.
template <class Remainder>
void expect_taylor_order(Remainder&& remainder, double order, double noise, double first = 1.0, int steps = 6,
                         const std::string& what = "") {
  std::vector<double> h, r;
  for (int k = 0; k < steps; ++k) {
    const double step = std::ldexp(first, -k), value = remainder(step);
    ASSERT_TRUE(std::isfinite(value)) << what << ", step " << step;
    if (value <= noise) continue;
    h.push_back(step);
    r.push_back(value);
  }
  if (h.empty()) return;
  ASSERT_GE(h.size(), 4u) << what << ": rounding leaves too few steps, first remainder " << r.front() << ", noise "
                          << noise;
  EXPECT_GT(log_slope(h, r), order - 0.15) << what << ": remainders from " << r.front() << " to " << r.back();
}

}  // namespace taut::test

#pragma once
#include <algorithm>
#include <cmath>
#include <vector>

namespace taut::test {

/// Coordinates 0..length in `cells` steps, refined towards both ends: the middle cell is `ratio` times the first and
/// the last one.
inline std::vector<double> graded_both(double length, int cells, double ratio) {
  const int half = (cells - 1) / 2;  // steps from the first cell to the (first) middle cell
  std::vector<double> sums{0.0}, x;
  for (int i = 0; i < cells; ++i) {
    const int from_end = std::min(i, cells - 1 - i);
    sums.push_back(sums.back() + (half == 0 ? 1.0 : std::pow(ratio, static_cast<double>(from_end) / half)));
  }
  for (double sum : sums) x.push_back(length * (sum / sums.back()));
  for (int i = 0; 2 * i < cells; ++i) x[cells - i] = length - x[i];  // symmetric to the last digit
  if (cells % 2 == 0) x[cells / 2] = 0.5 * length;
  return x;
}

}  // namespace taut::test

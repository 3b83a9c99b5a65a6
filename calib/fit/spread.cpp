#include "calib/fit/spread.hpp"

#include <algorithm>
#include <cmath>

#include "calib/fit/distributions.hpp"

namespace taut {
namespace {

struct Weighted {
  double mean = 0, squares = 0, weights = 0;
};

Weighted weighted(const std::vector<double>& x, const std::vector<double>& s, double omega_squared) {
  Weighted sums;
  for (size_t u = 0; u < x.size(); ++u) {
    const double w = 1 / (s[u] * s[u] + omega_squared);
    sums.weights += w;
    sums.mean += w * x[u];
  }
  sums.mean /= sums.weights;
  for (size_t u = 0; u < x.size(); ++u) {
    const double apart = x[u] - sums.mean;
    sums.squares += apart * apart / (s[u] * s[u] + omega_squared);
  }
  return sums;
}

}  // namespace

Spread spread_of(const std::vector<double>& values, const std::vector<double>& standard_errors) {
  const auto n = static_cast<double>(values.size());
  const auto [least, most] = std::ranges::minmax(values);
  double low = 0, high = std::pow(most - least, 2) * n;
  if (weighted(values, standard_errors, 0).squares <= n - 1) high = 0;
  for (int i = 0; i < 200 && high > 0; ++i) {
    const double middle = 0.5 * (low + high);
    (weighted(values, standard_errors, middle).squares > n - 1 ? low : high) = middle;
  }
  const Weighted sums = weighted(values, standard_errors, high);
  double weights = 0, squared_weights = 0, errors = 0;
  for (double s : standard_errors) {
    weights += 1 / (s * s);
    squared_weights += 1 / std::pow(s, 4);
    errors += s * s / n;
  }
  const double typical = (n - 1) * weights / (weights * weights - squared_weights);  // an error's square
  const double t = t_quantile(0.975, n - 1);
  const double variance = sums.squares / ((n - 1) * sums.weights);
  Spread spread;
  spread.mean = sums.mean;
  spread.omega = std::sqrt(high);
  spread.resolved = high >= typical;
  spread.half_width = t * std::sqrt(variance);
  spread.next_half_width = t * std::sqrt(variance + high + errors);
  return spread;
}

}  // namespace taut

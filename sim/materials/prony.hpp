#pragma once
#include <algorithm>
#include <cmath>

namespace taut {

/// One pair (g, tau) of a Prony series over a step of length h, in which the elastic stress S_e goes evenly from S_0 to
/// S_1: the internal stress, dh/dt = -h/tau + g dS_e/dt, goes from h_0 to
///
///     h_1 = decay h_0 + g gain (S_1 - S_0),   decay = exp(-x),   gain = (1 - exp(-x)) / x,   x = h / tau   [-],
///
/// exactly; gain is 1 for a step that takes no time and goes to 0 for one that is long. See SolidDefinition::prony.
struct PronyStep {
  double decay = 1, gain = 1;
  double decay_by_tau = 0, gain_by_tau = 0;  ///< derivatives [1/s]

  /// `length` h >= 0 [s], `tau` > 0 [s].
  PronyStep(double length, double tau) {
    const double x = length / tau;
    if (x == 0) return;
    decay = std::exp(-x);
    gain = -std::expm1(-x) / x;
    decay_by_tau = decay * x / tau;
    // (decay - gain) / x without its cancellation.
    const double gain_by_x = x < 1e-3 ? -0.5 + x * (1.0 / 3 - x / 8) : (decay - gain) / x;
    gain_by_tau = -gain_by_x * x / tau;
  }
};

/// By how much two readings under one dead load may differ, as a fraction of the first, that are taken `first` and
/// `second` seconds after it was hung, if a share g of the stiffness relaxes in some time or other: the largest over
/// tau of what creep, 1 + g / (1 - g) [1 - exp(-(1 - g) t / tau)], adds between them. 0 <= g < 1, 0 < first < second.
inline double largest_creep_between(double g, double first, double second) {
  double largest = 0;
  for (double tau = 1e-2 * first; tau < 1e2 * second; tau *= 1.02) {
    const auto creep = [&](double t) { return 1 - g / (1 - g) * std::expm1(-(1 - g) * t / tau); };
    largest = std::max(largest, creep(second) / creep(first) - 1);
  }
  return largest;
}

}  // namespace taut

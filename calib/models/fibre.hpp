#pragma once
#include <algorithm>
#include <cmath>
#include <limits>

#include "sim/core/jet.hpp"

namespace taut {

/// Neo-Hookean energy per volume [Pa] of a fibre while `free` of its two lateral directions move as they like, by a
/// common stretch l that minimises it, mu (l^2 - 1) + lambda (ln stretch + free ln l) = 0, and the others not at all;
/// +inf where the stretch is not positive. Jets have right first and second derivatives.
template <class T, class P>
T fibre_energy(const T& stretch, int free, const P& mu, const P& lambda) {
  using std::log;
  if (!(value_of(stretch) > 0)) return T(std::numeric_limits<double>::infinity());
  const T axial = log(stretch);
  if (free == 0) return 0.5 * mu * (stretch * stretch - 1.0) - mu * axial + 0.5 * lambda * axial * axial;
  const double m = value_of(mu), c = value_of(lambda), n = free;
  const auto slope = [&](double l) { return 2 * m * l + c * n / l; };
  double l = 1;
  for (int i = 0; i < 50; ++i) {
    const double step = -(m * (l * l - 1) + c * (value_of(axial) + n * std::log(l))) / slope(l);
    l = std::max(l + step, 0.1 * l);
    if (std::abs(step) < 1e-15 * l) break;
  }
  // One more step with derivatives makes those of l right to first order: enough, where l minimises, for two of the
  // energy.
  const T lateral = l - (mu * (l * l - 1) + lambda * (axial + n * std::log(l))) / slope(l);
  const T volume = axial + n * log(lateral);
  return 0.5 * mu * (stretch * stretch - 1.0 + n * (lateral * lateral - 1.0)) - mu * volume +
         0.5 * lambda * volume * volume;
}

}  // namespace taut

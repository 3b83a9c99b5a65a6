#pragma once

namespace taut {

/// An energy per stiffness of what resists one way only, and its derivatives with respect to the elongation e:
///
///   phi = 0                          for e <= -eps/2
///       = (e + eps/2)^3 / (6 eps)    in between            (phi'' rises linearly from 0 to 1)
///       = e^2/2 + eps^2/24           for e >= eps/2        (phi' = e, as if there were no transition)
///
/// C2 in e; for eps = 0 it is max(0, e)^2 / 2, and C1.
struct OneSided {
  double energy = 0;   ///< phi [m^2]
  double tension = 0;  ///< phi' [m]
  double rate = 0;     ///< phi''

  OneSided() = default;
  /// At the elongation e, with the width eps [m] of the transition.
  OneSided(double e, double eps) {
    const double z = e + 0.5 * eps;
    if (z <= 0) return;
    if (z < eps)
      *this = {z * z * z / (6 * eps), z * z / (2 * eps), z / eps};
    else
      *this = {0.5 * e * e + eps * eps / 24, e, 1};
  }
  /// From its three numbers.
  OneSided(double energy_, double tension_, double rate_) : energy(energy_), tension(tension_), rate(rate_) {}
  /// All of it times a stiffness.
  OneSided operator*(double factor) const { return {factor * energy, factor * tension, factor * rate}; }
};

}  // namespace taut

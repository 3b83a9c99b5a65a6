#pragma once
#include <array>
#include <optional>

#include "calib/benches/experiment.hpp"

namespace taut {

/// Softening by the first loading: values of its three parameters.
struct Mullins {
  double r = 2;     ///< > 1 [-]: at most 1 / r of the stress is lost
  double m = 0;     ///< > 0 [J/m^3]: how much energy it takes
  double beta = 0;  ///< >= 0 [-]: by how much m grows with the largest energy
};

/// What is left of the stress, P = eta P_0, where the energy density W stands below the largest that was there before:
///
///   eta = 1 - (1/r) erf(x),   x = (W_max - W) / (m + beta W_max),
///
/// with its derivatives. 1 at W = W_max: on first loading nothing is lost. Valid for W <= W_max, r > 1, m > 0, beta >=
/// 0. After Ogden and Roxburgh, Proc. R. Soc. A 455 (1999), doi 10.1098/rspa.1999.0431.
struct Softening {
  double eta = 1;
  double by_energy = 0;                                          ///< d eta / dW [m^3/J]
  double by_largest = 0;                                         ///< d eta / dW_max [m^3/J]
  std::array<double, 3> by_parameter = {};                       ///< d eta / d(r, m, beta)
  Softening(const Mullins& law, double energy, double largest);  ///< at W and W_max [J/m^3]
};

/// What a file of a material point says besides its law; kept in Experiment::own.
struct PointSettings {
  std::optional<Mullins> mullins;  ///< [materials.NAME] mullins; none: off
};
/// That of an experiment whose kind is a material point.
const PointSettings& point_settings(const Experiment& experiment);

}  // namespace taut

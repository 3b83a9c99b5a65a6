#pragma once
#include <algorithm>
#include <cmath>

#include "tests/support/experiment_files.hpp"

// A mass on a bar that weighs nothing, along which gravity acts: an oscillator, recorded in an experiment file.
namespace taut::test {

/// One element of a bar, 60 x 12 x 20 mm, without Poisson effect and with strains of 3e-5: a spring of k = E A / L.
inline const std::string hung_mass_toml =
    foam_piece("A mass on a bar", "[1, 1]", "E = \"20 MPa\"\nnu = 0\ndensity = \"0.001 kg/m3\"\n") +
    R"(fix = ["x", "y"]

[gravity]
acceleration = "1 m/s2"
direction = [1, 0]

[[load]]
id = "mass"
on = "xmax"
direction = [1, 0]
value = "50 g"

[[load]]
id = "hand"
on = "xmax"
direction = [1, 0]
value = "0 N"

[[channel]]
id = "end"
on = "xmax"
direction = [1, 0]
column = "end_um"

[[channel]]
id = "side"
on = "xmax"
direction = [0, 1]
column = "side_um"

[dynamics]
step = "0.025 ms"

[bench]
kind = "recordings"
time = "time_ms"
sigma = "0.2 um"

[[bench.recording]]
file = "ring.csv"
case = "ring"
held = { hand = "0.1 N" }
release = "0.5 ms"

[fit.free.E_foam]
)";

inline constexpr double hung_k = 20e6 * 0.012 * 0.020 / 0.060, hung_m = 0.050, hung_F = 0.1;

/// u(t) = m g / k + F / k cos w (t - t0), w^2 = k / m, g = 1 m/s2: held by F = 0.1 N until t0 = 0.5 ms.
inline double hung_mass_at(double time) {
  const double since = std::max(0.0, time - 0.5e-3);
  return (hung_m * 1.0 + hung_F * std::cos(std::sqrt(hung_k / hung_m) * since)) / hung_k;
}

/// Readings of it every 0.05 ms from 0 on.
inline std::string hung_mass_csv(int count) {
  std::string csv = "time_ms,end_um,side_um\n";
  for (int i = 0; i < count; ++i) {
    const double ms = 0.05 * i;
    csv += std::to_string(ms) + "," + std::to_string(1e6 * hung_mass_at(1e-3 * ms)) + ",0\n";
  }
  return csv;
}

}  // namespace taut::test

#pragma once
#include <cmath>
#include <random>

namespace taut {

/// Random numbers, the same everywhere from the same seed: distributions of the standard library differ from one to
/// the next.
class Draws {
 public:
  explicit Draws(unsigned seed) : engine_(seed) {}  ///< the same seed, the same numbers
  /// Between two ends, all alike.
  double uniform(double low, double high) {
    return low + (high - low) * (static_cast<double>(engine_()) + 0.5) / 4294967296.0;
  }
  /// Its logarithm is uniform.
  double logarithmic(double low, double high) { return low * std::pow(high / low, uniform(0, 1)); }
  /// Normal with mean 0 and deviation 1 (Box and Muller, Ann. Math. Statist. 29, 1958).
  double normal() {
    const double radius = std::sqrt(-2 * std::log(uniform(0, 1)));
    return radius * std::cos(2 * M_PI * uniform(0, 1));
  }

 private:
  std::mt19937 engine_;
};

}  // namespace taut

#include "calib/benches/mullins.hpp"

#include <cmath>
#include <numbers>

namespace taut {

Softening::Softening(const Mullins& law, double energy, double largest) {
  const double width = law.m + law.beta * largest, x = (largest - energy) / width;
  const double slope = -2 * std::numbers::inv_sqrtpi * std::exp(-x * x) / law.r;  // d eta / dx
  eta = 1 - std::erf(x) / law.r;
  by_energy = -slope / width;
  by_largest = slope * (1 - law.beta * x) / width;
  by_parameter = {std::erf(x) / (law.r * law.r), -slope * x / width, -slope * x * largest / width};
}

const PointSettings& point_settings(const Experiment& experiment) {
  return std::any_cast<const PointSettings&>(experiment.own);
}

}  // namespace taut

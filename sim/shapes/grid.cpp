#include "sim/shapes/grid.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sim/mesh/mesh_budget.hpp"
#include "sim/mesh/structured.hpp"

namespace taut {
namespace {

template <class Kind>
std::vector<double> lines(const Kind& block, const MeshSettings& settings, size_t axis) {
  std::vector<double> coordinates = graded(block.size[axis], settings.cells[axis]);
  for (double& x : coordinates) x += block.origin[axis];
  return coordinates;
}

}  // namespace

Mesh Box::mesh(const MeshSettings& settings, bool, bool) const {
  require_mesh(6.0 * settings.cells[0] * settings.cells[1] * settings.cells[2], 3, settings.order);
  return box(lines(*this, settings, 0), lines(*this, settings, 1), lines(*this, settings, 2), settings.order, region);
}

std::optional<BodyAxis> Box::axis() const {
  const double b = size[1], h = size[2];
  const Eigen::Vector3d middle(origin[0], origin[1] + 0.5 * b, origin[2] + 0.5 * h);
  BodyAxis axis = coordinate_axis(middle, 0, true, size[0]);
  const CrossSection section{b * h, b * h * h * h / 12, h * b * b * b / 12, torsion_of_rectangle(b, h)};
  axis.section = [section](double) { return section; };
  return axis;
}

Mesh Rectangle::mesh(const MeshSettings& settings, bool, bool) const {
  return rectangle(lines(*this, settings, 0), lines(*this, settings, 1), settings.order, region);
}

std::vector<Spine> Rectangle::spines() const {
  std::vector<Spine> spines;
  const Eigen::Vector2d middle(origin[0] + 0.5 * size[0], origin[1] + 0.5 * size[1]);
  for (size_t axis : {0u, 1u}) {
    for (bool forwards : {true, false}) {
      const std::string name(1, "xy"[axis]);
      Spine& spine = spines.emplace_back();
      spine.clamped = name + (forwards ? "min" : "max");
      spine.loaded = name + (forwards ? "max" : "min");
      spine.along = (forwards ? 1.0 : -1.0) * Eigen::Vector2d::Unit(axis);
      spine.origin = middle - 0.5 * size[axis] * spine.along;
      spine.end = size[axis];
      spine.soft = region;
      spine.spans.push_back({0, size[axis], size[1 - axis]});
    }
  }
  return spines;
}

std::optional<BodyAxis> Rectangle::axis() const {
  const double h = size[1];
  BodyAxis axis = coordinate_axis(Eigen::Vector2d(origin[0], origin[1] + 0.5 * h), 0, true, size[0]);
  axis.section = [h](double) { return CrossSection{.area = h, .second = h * h * h / 12}; };
  return axis;
}

double torsion_of_rectangle(double width, double height) {
  constexpr double pi = std::numbers::pi;
  const double a = std::max(width, height), b = std::min(width, height);
  // sum of tanh(n pi a / 2b) / n^5 over odd n = that of 1 / n^5, which is 31/32 zeta(5), less what falls exponentially.
  double sum = 31.0 / 32 * 1.0369277551433699263;
  for (int n = 1; n < 16; n += 2) sum -= (1 - std::tanh(0.5 * n * pi * a / b)) / std::pow(n, 5);
  return a * b * b * b * (1.0 / 3 - 64 / std::pow(pi, 5) * b / a * sum);
}

}  // namespace taut

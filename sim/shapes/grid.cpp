#include "sim/shapes/grid.hpp"

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
  return box(lines(*this, settings, 0), lines(*this, settings, 1), lines(*this, settings, 2), settings.order, region);
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

}  // namespace taut

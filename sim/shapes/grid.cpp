#include "sim/shapes/grid.hpp"

#include "sim/mesh/structured.hpp"

namespace taut {
namespace {

std::vector<ShapeKey> block_keys(std::vector<double>& size, std::vector<double>& origin, std::string& region) {
  return {
      {"size", &size, Allowed::positive(), "lengths along the axes", Quantity::length, true},
      {"origin", &origin, Allowed::any(), "corner with the lowest coordinates"},
      {"region", &region, Allowed::any(), "name of its material", Quantity::pure, true},
  };
}

std::vector<MeshKey> block_mesh_keys() {
  return {{MeshKey::cells, "cells", "cells along each axis"}};
}

template <class Block>
std::vector<double> lines(const Block& block, const MeshSettings& settings, size_t axis) {
  std::vector<double> coordinates = graded(block.size[axis], settings.cells[axis]);
  for (double& x : coordinates) x += block.origin[axis];
  return coordinates;
}

}  // namespace

std::vector<ShapeKey> Box::keys() {
  return block_keys(size, origin, region);
}
std::vector<MeshKey> Box::mesh_keys() const {
  return block_mesh_keys();
}
Mesh Box::mesh(const MeshSettings& settings, bool, bool) const {
  return box(lines(*this, settings, 0), lines(*this, settings, 1), lines(*this, settings, 2), settings.order, region);
}

std::vector<ShapeKey> Rectangle::keys() {
  return block_keys(size, origin, region);
}
std::vector<MeshKey> Rectangle::mesh_keys() const {
  return block_mesh_keys();
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
      spine.along = (forwards ? 1.0 : -1.0) * Eigen::Vector2d::Unit(static_cast<Eigen::Index>(axis));
      spine.origin = middle - 0.5 * size[axis] * spine.along;
      spine.end = size[axis];
      spine.soft = region;
      spine.spans.push_back({0, size[axis], size[1 - axis]});
    }
  }
  return spines;
}

}  // namespace taut

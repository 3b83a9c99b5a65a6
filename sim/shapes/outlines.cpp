#include "sim/shapes/outlines.hpp"

#include <algorithm>
#include <cmath>

#include "sim/mesh/mesh_budget.hpp"

namespace taut {

std::vector<ShapeKey> Boxes::keys() {
  return {{"box", &boxes, Allowed::any(), "region, lower and upper corner of each", Quantity::length, true}};
}
Mesh Boxes::mesh(const MeshSettings& settings, bool, bool) const {
  return mesh_boxes(boxes, settings.size, settings.order);
}

std::vector<ShapeKey> Polygons::keys() {
  return {{"polygon", &polygons, Allowed::any(), "region, corners and names of edges of each", Quantity::length, true}};
}
Mesh Polygons::mesh(const MeshSettings& settings, bool, bool) const {
  return mesh_polygons(polygons, settings.size, settings.order);
}

std::vector<ShapeKey> Disc::keys() {
  return {{"radius", &radius, Allowed::positive(), "of the disc", Quantity::length, true},
          {"region", &region, Allowed::any(), "name of its material", Quantity::pure, true}};
}
Mesh Disc::mesh(const MeshSettings& settings, bool, bool) const {
  PolygonRegion circle{region, {}, {}};
  require_mesh(4 * radius * radius / (settings.size * settings.size), 2, settings.order);
  const int corners = std::max(12, static_cast<int>(std::ceil(2 * M_PI * radius / settings.size)));
  for (int i = 0; i < corners; ++i) {
    const double angle = 2 * M_PI * i / corners;
    circle.vertices.push_back({radius * std::cos(angle), radius * std::sin(angle)});
  }
  return mesh_polygons({circle}, settings.size, settings.order);
}

}  // namespace taut

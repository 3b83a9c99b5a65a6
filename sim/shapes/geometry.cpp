#include "sim/shapes/geometry.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "sim/core/error.hpp"
#include "sim/core/units.hpp"
#include "sim/mesh/extrude.hpp"
#include "sim/mesh/msh_file.hpp"
#include "sim/mesh/structured.hpp"

namespace taut {
namespace {

/// Fraction of the contact gap that faces rest apart at about half the pressure that the barrier is made for.
constexpr double resting_distance = 0.65;

std::vector<double> shifted(std::vector<double> coordinates, double origin) {
  for (double& x : coordinates) x += origin;
  return coordinates;
}

/// The body, or its plane section.
Mesh make_section(const GeometrySettings& g, const MeshSettings& settings, bool contact, bool compensate) {
  auto axis = [&](size_t i) { return shifted(graded(g.size[i], settings.cells[i]), g.origin[i]); };
  if (g.kind == "box") return box(axis(0), axis(1), axis(2), settings.order, g.region);
  if (g.kind == "rectangle") return rectangle(axis(0), axis(1), settings.order, g.region);
  if (g.kind == "boxes") return mesh_boxes(g.boxes, settings.size, settings.order);
  if (g.kind == "polygons") return mesh_polygons(g.polygons, settings.size, settings.order);
  if (g.kind == "disc") {
    PolygonRegion circle{g.region, {}, {}};
    const int corners = std::max(12, static_cast<int>(std::ceil(2 * M_PI * g.radius / settings.size)));
    for (int i = 0; i < corners; ++i) {
      const double angle = 2 * M_PI * i / corners;
      circle.vertices.push_back({g.radius * std::cos(angle), g.radius * std::sin(angle)});
    }
    return mesh_polygons({circle}, settings.size, settings.order);
  }
  if (g.kind == "finger") {
    if (!contact) return mesh_finger(g.finger, settings.size, settings.order);
    const double gap = contact_gap(settings, 0.1);
    return mesh_finger(g.finger, settings.size, settings.order, compensate ? 0.5 * resting_distance * gap : 0.0);
  }
  if (g.kind == "twist") return mesh_twist_module(g.twist, {settings.core_cells, settings.layers, settings.order});
  if (g.kind == "sheet")
    return mesh_sheet(g.sheet, {settings.tile_cells, settings.strip_cells, settings.layers, settings.order});
  if (g.kind == "push_puppet") {
    // Closed lips rest about this far apart: taken off their faces, so that they close where the specimen's own do.
    const PushPuppetMesh resolution{settings.size, settings.lip_cells, settings.order};
    if (!contact) return mesh_push_puppet(g.puppet, resolution);
    const double gap = contact_gap(settings, mesh_push_puppet(g.puppet, resolution).diagonal());
    const double largest = std::min(0.5 * g.puppet.gap_total / g.puppet.cells, g.puppet.via_inset);
    if (gap > largest) {
      throw InputError(fmt::format(
          "the contact gap of {:.4g} mm is too large for the module: faces would push each other at rest or lose "
          "their via points; set contact_gap below {:.4g} mm (half a gap between lips, and via_inset), or leave it out",
          1e3 * gap, 1e3 * largest));
    }
    return mesh_push_puppet(g.puppet, resolution, compensate ? 0.5 * resting_distance * gap : 0.0);
  }
  Mesh mesh = read_msh(g.file, g.unit);
  if (mesh.dimension() != (settings.depth_cells > 0 ? 2 : g.dimension))
    throw InputError(fmt::format("{} is a {}D mesh; set dimension = {}", g.file, mesh.dimension(), mesh.dimension()));
  if (settings.order == 2 && order_of(mesh.shape) == 1) return to_quadratic(mesh);
  if (settings.order == 1 && order_of(mesh.shape) == 2)
    throw InputError(fmt::format("{} has quadratic elements; set element = \"quadratic\"", g.file));
  return mesh;
}

}  // namespace

std::string MeshSettings::describe() const {
  std::string text = fmt::format("{}{}", order == 1 ? "linear" : "quadratic",
                                 formulation == Formulation::locking_free ? ", locking-free" : "");
  if (!cells.empty()) {
    text += ", ";
    for (size_t i = 0; i < cells.size(); ++i) text += fmt::format("{}{}", i == 0 ? "" : " x ", cells[i]);
    text += " cells";
  } else if (size > 0) {
    text += fmt::format(", elements of {}", with_unit(size, "m"));
  }
  if (contact_gap > 0) text += fmt::format(", contact gap {}", with_unit(contact_gap, "m"));
  return text;
}

double contact_gap(const MeshSettings& settings, double diagonal) {
  return settings.contact_gap > 0 ? settings.contact_gap : 2e-5 * diagonal;
}

Mesh make_mesh(const GeometrySettings& geometry, const MeshSettings& settings, bool contact, bool compensate) {
  Mesh section = make_section(geometry, settings, contact, compensate);
  return settings.depth_cells > 0 ? extrude(section, 0.5 * geometry.thickness, settings.depth_cells) : section;
}

MeshSettings refined(const MeshSettings& settings, const GeometrySettings& geometry, double factor) {
  MeshSettings result = settings;
  if (geometry.kind == "msh") return result;
  auto scale = [&](int& count) { count = std::max(1, static_cast<int>(std::lround(count * factor))); };
  for (int& count : result.cells) scale(count);
  result.size /= factor;
  for (int* count : {&result.lip_cells, &result.core_cells, &result.tile_cells, &result.strip_cells, &result.layers})
    scale(*count);
  if (result.depth_cells > 0) scale(result.depth_cells);
  return result;
}

std::vector<Eigen::VectorXd> own_cable(const GeometrySettings& geometry, const std::string& name) {
  const auto place_of = [&](const std::vector<std::string>& names) {
    const auto found = std::find(names.begin(), names.end(), name);
    if (found == names.end())
      throw InputError(fmt::format("'{}' is not a cable of a {}{}; allowed: {}", name, geometry.kind,
                                   did_you_mean(name, names), join(names)));
    return static_cast<int>(found - names.begin());
  };
  const auto points = [](const auto& path) { return std::vector<Eigen::VectorXd>(path.begin(), path.end()); };
  if (geometry.kind == "finger") {
    place_of({"cable"});
    return points(cable_path(geometry.finger));
  }
  if (geometry.kind == "push_puppet")
    return points(cable_path(geometry.puppet, place_of({"upper", "lower"}) == 0 ? 1 : -1));
  std::vector<std::string> names;
  if (geometry.kind == "twist") {
    for (const char* hand : {"right", "left"}) {
      for (int i = 1; i <= geometry.twist.cables; ++i) names.push_back(fmt::format("{}_{}", hand, i));
    }
    const int place = place_of(names), cables = geometry.twist.cables;
    return points(cable_path(geometry.twist, place % cables, place < cables ? 1 : -1));
  }
  if (geometry.kind == "sheet") {
    for (int i = 1; i <= geometry.sheet.rows; ++i) names.push_back(fmt::format("row_{}", i));
    return points(cable_path(geometry.sheet, place_of(names), geometry.cable_height));
  }
  throw InputError(fmt::format("a {} has no cables of its own; give the points of the cable", geometry.kind));
}

}  // namespace taut

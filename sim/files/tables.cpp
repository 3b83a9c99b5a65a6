#include "sim/files/tables.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>

#include "sim/core/error.hpp"
#include "sim/files/shape_tables.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view components = "xyz";

}  // namespace

std::string path_beside(const std::string& experiment_path, const std::string& path) {
  const fs::path given(path);
  return given.is_absolute() ? path : (fs::path(experiment_path).parent_path() / given).lexically_normal().string();
}

int component_of(const TableReader& table, std::string_view key, const std::string& name, int dimension) {
  const size_t position = components.find(name);
  if (name.size() != 1 || position == std::string::npos || static_cast<int>(position) >= dimension) {
    table.fail(key, fmt::format("'{}' is not a component of a {}D model; allowed: {}", name, dimension,
                                dimension == 2 ? "x, y" : "x, y, z"));
  }
  return static_cast<int>(position);
}

std::vector<double> direction_of(TableReader& table, int dimension) {
  const std::vector<double> direction = table.numbers("direction", static_cast<size_t>(dimension));
  if (std::all_of(direction.begin(), direction.end(), [](double d) { return d == 0; }))
    table.fail("direction", "a direction must not be all zeros");
  return direction;
}

std::vector<std::vector<double>> read_points(TableReader& table, int dimension) {
  std::vector<std::vector<double>> points;
  for (int axis = 0; axis < dimension; ++axis) {
    const std::vector<double> values =
        table.quantities(components.substr(static_cast<size_t>(axis), 1), Quantity::length, points.size());
    if (values.empty())
      table.fail(components.substr(static_cast<size_t>(axis), 1),
                 "the list is empty; give the coordinates of the points");
    points.resize(values.size());
    for (size_t i = 0; i < values.size(); ++i) points[i].push_back(values[i]);
  }
  return points;
}

void read_mesh(TableReader& table, const GeometrySettings& geometry, MeshSettings& settings) {
  const bool structured = geometry.kind == "box" || geometry.kind == "rectangle";
  if (structured) {
    if (table.has("cells")) {
      settings.cells.clear();
      for (double value : table.numbers("cells", static_cast<size_t>(geometry.dimension))) {
        if (value < 1 || value > 1000 || value != std::floor(value))
          table.fail("cells", "whole numbers from 1 to 1000 belong here");
        settings.cells.push_back(static_cast<int>(value));
      }
    }
    if (settings.cells.empty()) table.fail("", "'cells' is missing; add for example cells = [14, 5, 5]");
  } else if (geometry.kind == "twist" || geometry.kind == "sheet") {
    if (geometry.kind == "twist") {
      settings.core_cells = table.integer("core_cells", settings.core_cells, 1);
    } else {
      settings.tile_cells = table.integer("tile_cells", settings.tile_cells, 1);
      settings.strip_cells = table.integer("strip_cells", settings.strip_cells, 1);
    }
    settings.layers = table.integer("layers", settings.layers, 1);
  } else if (geometry.kind != "msh") {
    if (const auto size = table.optional_quantity("size", Quantity::length)) settings.size = *size;
    if (!(settings.size > 0)) table.fail("", "'size' is missing or not positive; add for example size = \"2 mm\"");
  }
  if (geometry.kind == "push_puppet") settings.lip_cells = table.integer("lip_cells", settings.lip_cells, 1);
  if (geometry.dimension == 2) {
    if (const auto gap = table.optional_quantity("contact_gap", Quantity::length)) {
      settings.contact_gap = *gap;
      if (!(*gap > 0)) table.fail("contact_gap", "the contact gap must be positive");
    }
  }
  if (table.has("element")) settings.order = table.choice("element", {"quadratic", "linear"}) == "linear" ? 1 : 2;
  if (table.has("formulation")) {
    settings.formulation = table.choice("formulation", {"standard", "locking_free"}) == "standard"
                               ? Formulation::standard
                               : Formulation::locking_free;
  }
  if (settings.formulation == Formulation::locking_free && settings.order == 1) {
    table.fail(table.has("formulation") ? "formulation" : "element",
               "locking_free needs quadratic elements; set element = \"quadratic\" or formulation = \"standard\"");
  }
}

void read_plane(TableReader& table, double& thickness, Plane& plane) {
  thickness = table.quantity("thickness", Quantity::length);
  if (!(thickness > 0)) table.fail("thickness", "the thickness must be positive");
  plane = table.choice("plane", {"strain", "stress"}) == "strain" ? Plane::strain : Plane::stress;
}

GeometrySettings read_geometry(TableReader table, const std::string& path, bool own_plane) {
  GeometrySettings geometry;
  geometry.kind = table.choice("kind", {"box", "rectangle", "boxes", "polygons", "disc", "push_puppet", "finger",
                                        "twist", "sheet", "msh", "uniaxial"});
  if (geometry.kind == "uniaxial") {
    table.fail("kind",
               "a uniaxial experiment has no mesh and no states to show; use `taut check` and `taut fit` on it");
  }
  geometry.dimension = geometry.kind == "rectangle" || geometry.kind == "polygons" || geometry.kind == "disc" ||
                               geometry.kind == "push_puppet" || geometry.kind == "finger"
                           ? 2
                           : 3;
  const size_t d = static_cast<size_t>(geometry.dimension);
  if (geometry.kind == "box" || geometry.kind == "rectangle") {
    geometry.size = table.quantities("size", Quantity::length, d);
    if (std::any_of(geometry.size.begin(), geometry.size.end(), [](double s) { return !(s > 0); }))
      table.fail("size", "all lengths must be positive");
    geometry.origin =
        table.has("origin") ? table.quantities("origin", Quantity::length, d) : std::vector<double>(d, 0.0);
    geometry.region = table.text("region");
  } else if (geometry.kind == "boxes") {
    for (TableReader& box : table.tables("box")) {
      BoxRegion region;
      region.region = box.text("region");
      const std::vector<double> lower = box.quantities("lower", Quantity::length, 3),
                                upper = box.quantities("upper", Quantity::length, 3);
      std::copy(lower.begin(), lower.end(), region.lower.begin());
      std::copy(upper.begin(), upper.end(), region.upper.begin());
      box.finish();
      geometry.boxes.push_back(region);
    }
    if (geometry.boxes.empty()) table.fail("", "there is no box; add [[geometry.box]] with region, lower and upper");
  } else if (geometry.kind == "polygons") {
    for (TableReader& polygon : table.tables("polygon")) {
      PolygonRegion region;
      region.region = polygon.text("region");
      const std::vector<double> x = polygon.quantities("x", Quantity::length, 0);
      const std::vector<double> y = polygon.quantities("y", Quantity::length, x.size());
      for (size_t i = 0; i < x.size(); ++i) region.vertices.push_back({x[i], y[i]});
      if (polygon.has("edges")) region.edge_tags = polygon.texts("edges");
      if (!region.edge_tags.empty() && region.edge_tags.size() != x.size()) {
        polygon.fail(
            "edges",
            fmt::format(
                "{} names for {} edges; give one per edge, edge i running from vertex i to the next, \"\" for none",
                region.edge_tags.size(), x.size()));
      }
      polygon.finish();
      geometry.polygons.push_back(region);
    }
    if (geometry.polygons.empty()) table.fail("", "there is no polygon; add [[geometry.polygon]] with region, x and y");
  } else if (geometry.kind == "disc") {
    geometry.radius = table.quantity("radius", Quantity::length);
    if (!(geometry.radius > 0)) table.fail("radius", "the radius must be positive");
    geometry.region = table.text("region");
  } else if (geometry.kind == "push_puppet") {
    geometry.puppet = read_push_puppet(table);
  } else if (geometry.kind == "finger") {
    geometry.finger = read_finger(table);
  } else if (geometry.kind == "twist") {
    geometry.twist = read_twist_module(table);
  } else if (geometry.kind == "sheet") {
    geometry.sheet = read_sheet(table);
    geometry.cable_height = table.optional_quantity("cable_height", Quantity::length).value_or(0);
  } else {
    geometry.file = path_beside(path, table.text("file"));
    geometry.unit = unit_factor(table.text("unit"), Quantity::length, table.where("unit"));
    geometry.dimension = table.integer("dimension", 3, 2);
    if (geometry.dimension > 3) table.fail("dimension", "2 or 3 belongs here");
  }
  if (geometry.dimension == 2 && own_plane) read_plane(table, geometry.thickness, geometry.plane);
  table.finish();
  return geometry;
}

std::vector<MaterialSettings> read_materials(TableReader& root) {
  std::vector<MaterialSettings> materials;
  for (auto& [region, table] : root.named_tables("materials")) {
    MaterialSettings material;
    material.region = region;
    material.law = table.choice("law", material_laws());
    for (const ParameterSpec& spec : material_parameters(material.law)) {
      const double value = table.quantity(spec.id, spec.unit == "Pa" ? Quantity::pressure : Quantity::pure);
      if (!(value >= spec.lower && value <= spec.upper)) {
        table.fail(spec.id, fmt::format("{:.6g} is outside the physical range of {}, {:.6g} to {:.7g} {}", value,
                                        spec.meaning, spec.lower, spec.upper, spec.unit));
      }
      material.constants[spec.id] = value;
    }
    material.density = table.optional_quantity("density", Quantity::density);
    if (material.density && !(*material.density > 0)) table.fail("density", "the density must be positive");
    table.finish();
    materials.push_back(material);
  }
  if (materials.empty())
    root.fail("", "there is no material; add [materials.NAME] for each region NAME of the geometry");
  return materials;
}

}  // namespace taut

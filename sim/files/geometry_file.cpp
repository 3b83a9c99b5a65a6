#include "sim/files/geometry_file.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "sim/core/error.hpp"
#include "sim/files/tables.hpp"

namespace taut {
namespace {

/// Reads one key of [geometry] into its place.
struct KeyReader {
  TableReader& table;
  const ShapeKey& key;
  const std::string& path;
  size_t dimension;

  void operator()(int* count) const {
    const int least = static_cast<int>(key.allowed.least);
    const bool either = key.allowed.most == least + 1;
    *count = table.integer(key.key, *count, least,
                           either ? 1'000'000'000 : static_cast<int>(std::min(1e9, key.allowed.most)));
    if (*count > key.allowed.most) table.fail(key.key, fmt::format("{} or {} belongs here", least, key.allowed.most));
  }
  void operator()(double* value) const {
    if (!key.required) {
      *value = table.optional_quantity(key.key, key.quantity).value_or(*value);
      return;
    }
    *value = table.quantity(key.key, key.quantity);
    if (!key.allowed.holds(*value)) table.fail(key.key, fmt::format("the {} must be positive", key.key));
  }
  void operator()(std::string* text) const { *text = text->empty() ? table.text(key.key) : table.text(key.key, *text); }
  void operator()(std::vector<double>* values) const {
    if (!key.required && !table.has(key.key)) return;
    *values = table.quantities(key.key, key.quantity, dimension);
    if (std::any_of(values->begin(), values->end(), [&](double value) { return !key.allowed.holds(value); }))
      table.fail(key.key, "all lengths must be positive");
  }
  void operator()(LengthList* list) const {
    if (!key.required && !table.has(key.key)) return;
    list->values = table.quantities(key.key, key.quantity, 0);
    if (list->values.empty()) table.fail(key.key, "the list is empty; give at least one length");
    if (std::any_of(list->values.begin(), list->values.end(), [&](double value) { return !key.allowed.holds(value); }))
      table.fail(key.key, key.allowed.open ? "all lengths must be positive" : "all lengths must be zero or more");
  }
  void operator()(InputFile* file) const { file->path = path_beside(path, table.text(key.key)); }
  void operator()(LengthUnit* unit) const {
    unit->metres = unit_factor(table.text(key.key), Quantity::length, table.where(key.key));
  }

  void operator()(std::vector<BoxRegion>* boxes) const {
    for (TableReader& box : table.tables(key.key)) {
      BoxRegion region;
      region.region = box.text("region");
      const std::vector<double> lower = box.quantities("lower", Quantity::length, 3),
                                upper = box.quantities("upper", Quantity::length, 3);
      std::copy(lower.begin(), lower.end(), region.lower.begin());
      std::copy(upper.begin(), upper.end(), region.upper.begin());
      box.finish();
      boxes->push_back(region);
    }
    if (boxes->empty()) table.fail("", "there is no box; add [[geometry.box]] with region, lower and upper");
  }
  void operator()(std::vector<PolygonRegion>* polygons) const {
    for (TableReader& polygon : table.tables(key.key)) {
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
      polygons->push_back(region);
    }
    if (polygons->empty()) table.fail("", "there is no polygon; add [[geometry.polygon]] with region, x and y");
  }
};

void read_mesh_key(TableReader& table, const MeshKey& key, int dimension, MeshSettings& settings) {
  switch (key.kind) {
    case MeshKey::cells:
      if (table.has(key.key)) {
        settings.cells.clear();
        for (double value : table.numbers(key.key, static_cast<size_t>(dimension))) {
          if (value < 1 || value > 1000 || value != std::floor(value))
            table.fail(key.key, "whole numbers from 1 to 1000 belong here");
          settings.cells.push_back(static_cast<int>(value));
        }
      }
      if (settings.cells.empty())
        table.fail("", fmt::format("'{}' is missing; add for example {} = [14, 5, 5]", key.key, key.key));
      return;
    case MeshKey::size:
      if (const auto size = table.optional_quantity(key.key, Quantity::length)) settings.size = *size;
      if (!(settings.size > 0)) {
        table.fail("", fmt::format("'{}' is missing or not positive; add for example {} = \"2 mm\"", key.key, key.key));
      }
      return;
    case MeshKey::count:
      int& count = settings.counts.try_emplace(std::string(key.key), key.fallback).first->second;
      count = table.integer(key.key, count, 1);
  }
}

}  // namespace

GeometrySettings read_geometry(TableReader table, const std::string& path, const std::vector<std::string>& others,
                               bool own_plane) {
  std::vector<std::string> kinds = shape_kinds();
  kinds.insert(kinds.end(), others.begin(), others.end());
  const std::string kind = table.choice("kind", kinds);
  std::shared_ptr<Shape> shape = make_shape(kind);
  GeometrySettings geometry;
  for (const ShapeKey& key : shape->keys()) {
    std::visit(KeyReader{table, key, path, static_cast<size_t>(shape->dimension())}, key.value);
    if (std::holds_alternative<double*>(key.value) && !table.has(key.key)) geometry.left_out.emplace_back(key.key);
  }
  try {
    shape->check();
  } catch (const InputError& error) {
    table.fail("", error.what());
  }
  geometry.dimension = shape->dimension();
  geometry.shape = std::move(shape);
  if (geometry.dimension == 2 && own_plane) read_plane(table, geometry.thickness, geometry.plane);
  table.finish();
  return geometry;
}

void read_mesh(TableReader& table, const GeometrySettings& geometry, MeshSettings& settings) {
  for (const MeshKey& key : geometry.shape->mesh_keys()) read_mesh_key(table, key, geometry.dimension, settings);
  if (geometry.dimension == 2 || geometry.shape->defaults().contact) {
    if (const auto gap = table.optional_positive("contact_gap", Quantity::length, "contact gap"))
      settings.contact_gap = *gap;
  }
  if (table.has("element")) settings.order = table.choice<int>("element", {{"quadratic", 2}, {"linear", 1}});
  if (table.has("formulation"))
    settings.formulation = table.choice<Formulation>(
        "formulation", {{"standard", Formulation::standard}, {"locking_free", Formulation::locking_free}});
  if (settings.formulation == Formulation::locking_free && settings.order == 1) {
    table.fail(table.has("formulation") ? "formulation" : "element",
               "locking_free needs quadratic elements; set element = \"quadratic\" or formulation = \"standard\"");
  }
}

}  // namespace taut

#include "sim/shapes/geometry.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "sim/core/error.hpp"
#include "sim/mesh/extrude.hpp"

namespace taut {
namespace {

InputFile* input_of(Shape& shape) {
  for (const ShapeKey& key : shape.keys()) {
    if (InputFile* const* file = std::get_if<InputFile*>(&key.value)) return *file;
  }
  return nullptr;
}

}  // namespace

Mesh make_mesh(const GeometrySettings& geometry, const MeshSettings& settings, bool contact, bool compensate) {
  if (geometry.mesh) {
    geometry.shape->check();
    return *geometry.mesh;
  }
  Mesh section = geometry.shape->mesh(settings, contact, compensate);
  return settings.depth_cells > 0 ? extrude(section, 0.5 * geometry.thickness, settings.depth_cells) : section;
}

bool refinable(const GeometrySettings& geometry) {
  return !geometry.shape->mesh_keys().empty();
}

MeshSettings refined(const MeshSettings& settings, const GeometrySettings& geometry, double factor) {
  MeshSettings result = settings;
  if (!refinable(geometry)) return result;
  const auto scaled = [&](int count) { return static_cast<int>(std::clamp(std::round(count * factor), 1.0, 1e9)); };
  for (const MeshKey& key : geometry.shape->mesh_keys()) {
    if (key.kind != MeshKey::count) continue;
    const auto given = settings.counts.find(key.key);
    result.counts[std::string(key.key)] = scaled(given != settings.counts.end() ? given->second : key.fallback);
  }
  for (int& count : result.cells) count = scaled(count);
  result.size /= factor;
  if (result.depth_cells > 0) result.depth_cells = scaled(result.depth_cells);
  return result;
}

std::vector<Eigen::VectorXd> own_cable(const GeometrySettings& geometry, const std::string& name) {
  const std::vector<std::string> names = geometry.shape->cable_names();
  if (names.empty())
    throw InputError(fmt::format("a {} has no cables of its own; give the points of the cable", geometry.kind()));
  const auto found = std::find(names.begin(), names.end(), name);
  if (found == names.end()) {
    throw InputError(fmt::format("'{}' is not a cable of a {}{}; allowed: {}", name, geometry.kind(),
                                 did_you_mean(name, names), join(names)));
  }
  return geometry.shape->cable(found - names.begin());
}

std::string input_file(const GeometrySettings& geometry) {
  if (!geometry.shape) return "";
  const std::unique_ptr<Shape> own = geometry.shape->clone();
  const InputFile* file = input_of(*own);
  return file != nullptr ? file->path : "";
}

void set_input_file(GeometrySettings& geometry, const std::string& path) {
  std::shared_ptr<Shape> own = geometry.shape->clone();
  if (InputFile* file = input_of(*own)) file->path = path;
  geometry.shape = own;
}

}  // namespace taut

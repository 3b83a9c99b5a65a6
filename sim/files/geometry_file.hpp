#pragma once
#include <string>
#include <vector>

#include "sim/files/toml_reader.hpp"
#include "sim/shapes/geometry.hpp"

// What files say of bodies and their meshes. All functions throw InputError with file and line.
namespace taut {

/// [geometry], to its end: `kind`, and the keys of that shape. What is left out is the shape's own. `path` is that of
/// the file; `others` are kinds that such a file may have and that are no shapes. In 2D with `own_plane` it has
/// thickness and plane too.
GeometrySettings read_geometry(TableReader table, const std::string& path, const std::vector<std::string>& others = {},
                               bool own_plane = true);

/// Keys of [mesh] and of a [[fit.variant]]; what is missing stays as it is in `settings`.
void read_mesh(TableReader& table, const GeometrySettings& geometry, MeshSettings& settings);

}  // namespace taut

#pragma once
#include <string>
#include <vector>

#include "sim/files/toml_reader.hpp"
#include "sim/scene/setup.hpp"

// The tables that kinds of experiment files have in common. All functions throw InputError with file and line.
namespace taut {

/// A path in an experiment file, relative to that file.
std::string path_beside(const std::string& experiment_path, const std::string& path);

/// "x" to 0; `name` is the value of `key`.
int component_of(const TableReader& table, std::string_view key, const std::string& name, int dimension);
/// The key "direction": `dimension` numbers, not all zero.
std::vector<double> direction_of(TableReader& table, int dimension);
/// Points of a polyline from lists of coordinates x, y(, z).
std::vector<std::vector<double>> read_points(TableReader& table, int dimension);

/// Keys of [mesh] and of a [[fit.variant]]; what is missing stays as it is in `settings`.
void read_mesh(TableReader& table, const GeometrySettings& geometry, MeshSettings& settings);
/// [geometry], to its end; `path` is that of the file. In 2D with `own_plane` it has thickness and plane too.
GeometrySettings read_geometry(TableReader table, const std::string& path, bool own_plane = true);
/// The keys thickness and plane of 2D models.
void read_plane(TableReader& table, double& thickness, Plane& plane);
/// All [materials.REGION].
std::vector<MaterialSettings> read_materials(TableReader& root);

}  // namespace taut

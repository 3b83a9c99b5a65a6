#pragma once
#include <optional>
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

/// The keys thickness and plane of 2D models.
void read_plane(TableReader& table, double& thickness, Plane& plane);
/// All [materials.REGION].
std::vector<MaterialSettings> read_materials(TableReader& root);
/// All [damping.REGION], after the materials.
void read_damping(TableReader& root, Setup& setup);
/// The key "mass".
MassForm read_mass_form(TableReader& table);

template <class Container>
std::vector<std::string> ids_of(const Container& items) {
  std::vector<std::string> ids;
  for (const auto& item : items) ids.push_back(item.id);
  return ids;
}
/// The text of a key, which has to be one of `ids`; `what` says what they are.
std::string known_id(TableReader& table, std::string_view key, const std::vector<std::string>& ids,
                     std::string_view what);
/// That of `allowed` whose unit ends the text ("2 N": a force).
std::optional<Quantity> quantity_of_text(const std::string& text, const std::vector<Quantity>& allowed);

/// Keys x, y(, z) and fixed of a cable; `fixed` are the words for the latter, the first is the fallback.
void read_cable_points(TableReader& table, int dimension, const std::vector<std::string>& fixed, CableSettings& cable);
/// Tables obstacle and ground of [contact].
void read_surroundings(TableReader& table, int dimension, SurfaceSettings& contact);
/// Keys of a [[channel]] that do not depend on where it is: id, kind (one of `kinds`, the first is the fallback), "of"
/// when that is of a cable or a joint, and direction when it has one.
ChannelSettings read_channel(TableReader& table, const Setup& setup, int dimension,
                             const std::vector<ChannelSettings::Kind>& kinds);

}  // namespace taut

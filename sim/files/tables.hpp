#pragma once
#include <map>
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

/// The languages of files, which call some things by other keys.
enum class Language { bench, simulation };

/// The keys thickness and plane of 2D models.
void read_plane(TableReader& table, double& thickness, Plane& plane);
/// The constants of a law; those that are not in the table are taken from `otherwise`.
std::map<std::string, double> read_constants(TableReader& table, const std::string& law,
                                             const std::map<std::string, double>& otherwise = {});
/// All [materials.REGION].
std::vector<MaterialSettings> read_materials(TableReader& root);
/// All [damping.REGION], after the materials.
void read_damping(TableReader& root, Setup& setup);
/// The key "mass".
MassForm read_mass_form(TableReader& table);

/// The ids of things that have one, in their order.
template <class Container>
std::vector<std::string> ids_of(const Container& items) {
  std::vector<std::string> ids;
  for (const auto& item : items) ids.push_back(item.id);
  return ids;
}
std::vector<std::string> body_names(const Setup& setup);  ///< in their order
/// Throws InputError when `id` is not one of `ids`; `what` says what they are.
void check_id(const TableReader& table, std::string_view key, const std::string& id,
              const std::vector<std::string>& ids, std::string_view what);
/// The text of a key, which has to be one of them.
std::string known_id(TableReader& table, std::string_view key, const std::vector<std::string>& ids,
                     std::string_view what);
/// Throws InputError when an id stands twice in these lists; `what` says of what they are.
void refuse_repeated(const std::string& path, const std::vector<std::vector<std::string>>& lists,
                     std::string_view what);
/// That of `allowed` whose unit ends the text of a key ("2 N": a force); `otherwise` is said after the text when there
/// is none.
Quantity quantity_of(const TableReader& table, std::string_view key, const std::string& text,
                     const std::vector<Quantity>& allowed, std::string_view otherwise = "");
/// That of a control of a setup; pure when there is none of this id.
Quantity control_quantity(const Setup& setup, const std::string& id);

/// Unit and name of a bench column, from its name or, where the bench file says it elsewhere, from `setup.titles`.
HeaderUnit column_unit(const Setup& setup, const std::string& column, const std::vector<Quantity>& allowed,
                       std::string_view where);
/// [[load]] to its end. At a bench it may be at a point, and its value may be a column's; in a simulation a control's.
LoadSettings read_load(TableReader& table, const Setup& setup, Language language);

/// [studs] and all [[stud]]. At a bench a place may be a point; in a simulation it is a tag.
void read_studs(TableReader& root, Setup& setup, Language language);

/// Keys k or EA, slack and smoothing.
void read_cable_law(TableReader& table, CableLaw& law, bool takes_EA);
/// Keys x, y(, z) and fixed of a cable; `fixed` are the words for the latter, the first is the fallback.
void read_cable_points(TableReader& table, int dimension, const std::vector<std::string>& fixed, CableSettings& cable);
/// The keys along, offset, angle and pieces of eyelets beside the axis of a body; what is not there is as `line` has
/// it.
EyeletLine read_eyelets(TableReader& table, const GeometrySettings& geometry, EyeletLine line);
/// Whether a text is a number with a unit: "5 N" is, "tension_1_N" is a name.
bool is_quantity(const std::string& text);
/// Tables obstacle and ground of [contact], after the controls. At a bench grounds are planes that stay, without names.
void read_surroundings(TableReader& table, const Setup& setup, Language language, SurfaceSettings& contact);
/// Keys of a [[channel]]: id, kind (those that files of this language have), direction when it has one, and what it
/// is on.
ChannelSettings read_channel(TableReader& table, const Setup& setup, Language language);

}  // namespace taut

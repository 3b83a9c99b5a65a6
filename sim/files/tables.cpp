#include "sim/files/tables.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>

#include "sim/core/error.hpp"

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

void read_plane(TableReader& table, double& thickness, Plane& plane) {
  thickness = table.quantity("thickness", Quantity::length);
  if (!(thickness > 0)) table.fail("thickness", "the thickness must be positive");
  plane = table.choice("plane", {"strain", "stress"}) == "strain" ? Plane::strain : Plane::stress;
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

void read_damping(TableReader& root, Setup& setup) {
  std::vector<std::string> regions;
  for (const MaterialSettings& material : setup.materials) regions.push_back(material.region);
  for (auto& [region, table] : root.named_tables("damping")) {
    if (std::find(regions.begin(), regions.end(), region) == regions.end())
      table.fail("", fmt::format("there is no material '{}'{}; allowed: {}", region, did_you_mean(region, regions),
                                 join(regions)));
    const auto read = [&, &region = region, &table = table](std::string_view key, Quantity quantity, auto& values) {
      const auto value = table.optional_quantity(key, quantity);
      if (!value) return;
      if (*value < 0) table.fail("", "damping must not be negative");
      values[region] = *value;
    };
    read("mass", Quantity::frequency, setup.mass_damping);
    read("stiffness", Quantity::time, setup.stiffness_damping);
    table.finish();
  }
}

MassForm read_mass_form(TableReader& table) {
  return table.choice("mass", {"consistent", "lumped"}) == "lumped" ? MassForm::lumped : MassForm::consistent;
}

std::string known_id(TableReader& table, std::string_view key, const std::vector<std::string>& ids,
                     std::string_view what) {
  const std::string id = table.text(key);
  if (std::find(ids.begin(), ids.end(), id) == ids.end())
    table.fail(key, fmt::format("'{}' is not {}{}; allowed: {}", id, what, did_you_mean(id, ids),
                                ids.empty() ? "none is there" : join(ids)));
  return id;
}

std::optional<Quantity> quantity_of_text(const std::string& text, const std::vector<Quantity>& allowed) {
  const size_t blank = text.rfind(' ');
  const std::string unit = blank == std::string::npos ? "" : text.substr(blank + 1);
  for (Quantity quantity : allowed) {
    const std::vector<std::string> units = units_of(quantity);
    if (std::find(units.begin(), units.end(), unit) != units.end()) return quantity;
  }
  return std::nullopt;
}

void read_cable_points(TableReader& table, int dimension, const std::vector<std::string>& fixed, CableSettings& cable) {
  cable.points = read_points(table, dimension);
  if (cable.points.size() < 2) table.fail("x", "a cable needs at least two points");
  const std::string ends = table.choice("fixed", fixed);
  cable.start_fixed = ends == "start" || ends == "both";
  cable.end_fixed = ends == "end" || ends == "both";
}

void read_surroundings(TableReader& table, int dimension, SurfaceSettings& contact) {
  for (TableReader& one : table.tables("obstacle")) {
    if (dimension == 3) one.fail("", "obstacles are for 2D simulations; use a ground or a clamped body");
    std::vector<Eigen::Vector2d>& line = contact.obstacles.emplace_back();
    for (const std::vector<double>& point : read_points(one, 2)) line.emplace_back(point[0], point[1]);
    if (line.size() < 2) one.fail("x", "an obstacle needs at least two points");
    one.finish();
  }
  const auto vector = [](const std::vector<double>& values) {
    return Eigen::VectorXd(Eigen::Map<const Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size())));
  };
  for (TableReader& one : table.tables("ground")) {
    const size_t d = static_cast<size_t>(dimension);
    const Eigen::VectorXd point = vector(one.quantities("point", Quantity::length, d)),
                          normal = vector(one.numbers("normal", d));
    if (!(normal.norm() > 0)) one.fail("normal", "the normal must not be all zeros; it points to where things may be");
    contact.grounds.push_back({point, normal.normalized()});
    one.finish();
  }
}

ChannelSettings read_channel(TableReader& table, const Setup& setup, int dimension,
                             const std::vector<ChannelSettings::Kind>& kinds) {
  using Kind = ChannelSettings::Kind;
  ChannelSettings channel;
  channel.id = table.text("id");
  std::vector<std::string> names;
  for (Kind kind : kinds) names.emplace_back(name_of(kind));
  const std::string name = table.choice("kind", names);
  channel.kind = kinds[static_cast<size_t>(std::find(names.begin(), names.end(), name) - names.begin())];
  if (channel.of_cable()) channel.on = known_id(table, "of", ids_of(setup.cables.cables), "a [[cable]]");
  if (channel.of_joint()) channel.on = known_id(table, "of", ids_of(setup.joints), "a [[joint]]");
  const bool directed = channel.of_place() || channel.kind == Kind::reaction || channel.kind == Kind::net_force ||
                        (channel.kind == Kind::rotation && dimension == 3);
  if (directed) channel.direction = direction_of(table, dimension);
  return channel;
}

}  // namespace taut

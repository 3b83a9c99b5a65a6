#include "sim/files/tables.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <set>

#include "sim/core/error.hpp"
#include "sim/scene/channel_kinds.hpp"

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
  const double largest = std::abs(*std::ranges::max_element(direction, {}, [](double d) { return std::abs(d); }));
  if (largest < 1e-6 || largest > 1e6)
    table.fail("direction",
               fmt::format("{:g} is no component of a direction; write numbers of ordinary size, such as 1", largest));
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
  thickness = table.positive("thickness", Quantity::length, "thickness");
  plane = table.choice<Plane>("plane", {{"strain", Plane::strain}, {"stress", Plane::stress}});
}

std::map<std::string, double> read_constants(TableReader& table, const std::string& law,
                                             const std::map<std::string, double>& otherwise) {
  std::map<std::string, double> constants;
  for (const ParameterSpec& spec : material_parameters(law)) {
    const auto before = otherwise.find(spec.id);
    const double value = before != otherwise.end() && !table.has(spec.id)
                             ? before->second
                             : table.quantity(spec.id, quantity_of_si_unit(spec.unit));
    if (!(value >= spec.lower && value <= spec.upper)) {
      table.fail(spec.id, fmt::format("{:.6g} is outside the physical range of {}, {:.6g} to {:.7g} {}", value,
                                      spec.meaning, spec.lower, spec.upper, spec.unit));
    }
    constants[spec.id] = value;
  }
  return constants;
}

std::vector<MaterialSettings> read_materials(TableReader& root) {
  std::vector<MaterialSettings> materials;
  for (auto& [region, table] : root.named_tables("materials")) {
    MaterialSettings& material = materials.emplace_back();
    material.region = region;
    material.law = table.choice("law", material_laws());
    material.constants = read_constants(table, material.law);
    material.density = table.optional_positive("density", Quantity::density, "density");
    double sum = 0;
    for (TableReader& pair : table.tables("prony")) {
      const double g = pair.number("g"), tau = pair.quantity("tau", Quantity::time);
      if (!(g >= 0) || !(tau > 0)) pair.fail("", "g is a share of 0 or more that relaxes, and tau a positive time");
      material.prony.emplace_back(g, tau);
      sum += g;
      pair.finish();
    }
    if (!(sum < 0.99))
      table.fail("prony", fmt::format("g is {:.4g} in all, but less than 0.99 of the stiffness may relax", sum));
    table.finish();
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
    const auto mass = table.optional_quantity("mass", Quantity::frequency);
    const auto stiffness = table.optional_quantity("stiffness", Quantity::time);
    if (mass.value_or(0) < 0 || stiffness.value_or(0) < 0) table.fail("", "damping must not be negative");
    if (mass) setup.mass_damping[region] = *mass;
    if (stiffness) setup.stiffness_damping[region] = *stiffness;
    table.finish();
  }
}

MassForm read_mass_form(TableReader& table) {
  return table.choice<MassForm>("mass", {{"consistent", MassForm::consistent}, {"lumped", MassForm::lumped}});
}

std::vector<std::string> body_names(const Setup& setup) {
  std::vector<std::string> names;
  for (const BodySettings& body : setup.bodies) names.push_back(body.name);
  return names;
}

void check_id(const TableReader& table, std::string_view key, const std::string& id,
              const std::vector<std::string>& ids, std::string_view what) {
  if (std::find(ids.begin(), ids.end(), id) == ids.end())
    table.fail(key, fmt::format("'{}' is not {}{}; allowed: {}", id, what, did_you_mean(id, ids),
                                ids.empty() ? "none is there" : join(ids)));
}

std::string known_id(TableReader& table, std::string_view key, const std::vector<std::string>& ids,
                     std::string_view what) {
  std::string id = table.text(key);
  check_id(table, key, id, ids, what);
  return id;
}

void refuse_repeated(const std::string& path, const std::vector<std::vector<std::string>>& lists,
                     std::string_view what) {
  std::set<std::string> seen;
  for (const std::vector<std::string>& ids : lists) {
    for (const std::string& id : ids) {
      if (!seen.insert(id).second)
        throw InputError(fmt::format("{}: the id '{}' is used twice; ids of {} must differ", path, id, what));
    }
  }
}

Quantity quantity_of(const TableReader& table, std::string_view key, const std::string& text,
                     const std::vector<Quantity>& allowed, std::string_view otherwise) {
  const size_t blank = text.rfind(' ');
  const std::string unit = blank == std::string::npos ? "" : text.substr(blank + 1);
  std::vector<std::string> names;
  for (Quantity quantity : allowed) {
    const std::vector<std::string> units = units_of(quantity);
    if (std::find(units.begin(), units.end(), unit) != units.end()) return quantity;
    names.emplace_back(name_of(quantity));
  }
  table.fail(key, fmt::format("'{}' {}", text,
                              otherwise.empty() ? "has not a unit that fits; allowed: " + join(names) : otherwise));
}

Quantity control_quantity(const Setup& setup, const std::string& id) {
  for (const ControlSettings& control : setup.controls) {
    if (control.id == id) return control.quantity;
  }
  return Quantity::pure;
}

HeaderUnit column_unit(const Setup& setup, const std::string& column, const std::vector<Quantity>& allowed,
                       std::string_view where) {
  const auto title = setup.titles.find(column);
  return parse_header(title == setup.titles.end() ? column : title->second, allowed, where);
}

LoadSettings read_load(TableReader& table, const Setup& setup, Language language) {
  const bool bench = language == Language::bench;
  // The unit of the column or of the value says what kind of load it is.
  const std::vector<Quantity> quantities{Quantity::force, Quantity::mass, Quantity::pressure, Quantity::line_load};
  LoadSettings load;
  load.id = table.text("id");
  if (bench && table.has("point") == table.has("on"))
    table.fail("", "give either 'on' (a tag, or \"a & b\") or 'point' as the place of the load");
  if (bench && table.has("point"))
    load.point = table.quantities("point", Quantity::length, static_cast<size_t>(setup.dimension));
  else
    load.on = table.text("on");
  load.direction = direction_of(table, setup.dimension);
  if (bench && table.has("column") == table.has("value"))
    table.fail("", "give either 'column' (of the bench file) or 'value' (a constant load)");
  if (bench && table.has("column")) {
    load.control = load.id;
    load.column = table.text("column");
    load.quantity = column_unit(setup, load.column, quantities, table.where("column")).quantity;
  } else if (!bench && table.has("control")) {
    load.control = known_id(table, "control", ids_of(setup.controls), "a [[control]]");
    load.quantity = control_quantity(setup, load.control);
    if (std::find(quantities.begin(), quantities.end(), load.quantity) == quantities.end())
      table.fail("control", "a load is a force, a hung mass, a traction (\"3 kPa\") or a line load (\"5 N/m\")");
  } else {
    const std::string value = table.text("value");
    load.quantity =
        quantity_of(table, "value", value, quantities,
                    "is not a load; give a force (\"2 N\"), a mass (\"100 g\"), a traction (\"3 kPa\") or a "
                    "line load (\"5 N/m\")");
    load.value = parse_quantity(value, load.quantity, table.where("value"));
    if (!bench && load.quantity == Quantity::mass && load.value < 0)
      table.fail("value", fmt::format("a mass of {} is negative; give zero or more", value));
  }
  if (load.quantity == Quantity::pressure && !load.point.empty())
    table.fail("point", "a traction acts on a face; use 'on'");
  if (load.quantity == Quantity::line_load && !load.point.empty())
    table.fail("point", "a line load acts on an edge, in 2D on a corner; use 'on'");
  table.finish();
  return load;
}

void read_studs(TableReader& root, Setup& setup, Language language) {
  StudsSettings& all = setup.studs;
  if (auto shared = root.optional_table("studs")) {
    all.clearance = shared->optional_quantity("clearance", Quantity::length);
    if (all.clearance.value_or(0) < 0) shared->fail("clearance", "a clearance is a length of zero or more");
    all.stiffness = shared->optional_positive("stiffness", Quantity::stiffness, "stiffness");
    all.smoothing = shared->optional_quantity("smoothing", Quantity::length).value_or(all.smoothing);
    if (all.smoothing < 0) shared->fail("smoothing", "a length of zero or more belongs here");
    shared->finish();
  }
  const bool bench = language == Language::bench;
  const auto read_place = [&](TableReader& table, std::string_view tag, std::string_view point, std::string& on,
                              std::vector<double>& at) {
    if (bench && table.has(tag) && table.has(point))
      table.fail(point, fmt::format("give either '{}' (a tag) or '{}' as the place", tag, point));
    if (bench && table.has(point))
      at = table.quantities(point, Quantity::length, static_cast<size_t>(setup.dimension));
    else
      on = table.text(tag);
  };
  for (TableReader& table : root.tables("stud")) {
    StudSettings stud;
    stud.id = table.text("id");
    for (const StudSettings& other : all.studs) {
      if (other.id == stud.id)
        table.fail("id", fmt::format("the stud '{}' is there already; choose another id", stud.id));
    }
    read_place(table, "on", "point", stud.on, stud.point);
    if (table.has("hole_on") || (bench && table.has("hole_point")))
      read_place(table, "hole_on", "hole_point", stud.hole_on, stud.hole_point);
    stud.direction = direction_of(table, setup.dimension);
    stud.clearance = table.optional_quantity("clearance", Quantity::length);
    if (stud.clearance.value_or(0) < 0) table.fail("clearance", "a clearance is a length of zero or more");
    stud.stiffness = table.optional_positive("stiffness", Quantity::stiffness, "stiffness");
    if (!stud.clearance && !all.clearance)
      table.fail("", "it has no clearance; add clearance = \"0.1 mm\" to it, or to [studs] for all");
    if (!stud.stiffness && !all.stiffness)
      table.fail("", "it has no stiffness; add stiffness = \"200 kN/m\" to it, or to [studs] for all");
    table.finish();
    all.studs.push_back(std::move(stud));
  }
  const auto has_none = [&](auto member) {
    return std::ranges::any_of(all.studs, [&](const StudSettings& stud) { return !(stud.*member).has_value(); });
  };
  if ((all.clearance && !has_none(&StudSettings::clearance)) || (all.stiffness && !has_none(&StudSettings::stiffness)))
    throw InputError(fmt::format(
        "{}: [studs]: no [[stud]] is governed by what stands there; add one without its own, or leave it out",
        setup.path));
}

void read_cable_law(TableReader& table, CableLaw& law, bool takes_EA) {
  if (takes_EA) law.EA = table.optional_positive("EA", Quantity::force, "stiffness");
  if (takes_EA && law.EA.has_value() == table.has("k"))
    table.fail("", "give either k (the stiffness of a whole cable, \"20 kN/m\") or EA (\"1.2 kN\"; k = EA / length)");
  if (!law.EA) law.k = table.positive("k", Quantity::stiffness, "stiffness");
  law.slack = table.optional_quantity("slack", Quantity::length).value_or(0);
  law.smoothing = table.optional_quantity("smoothing", Quantity::length).value_or(law.smoothing);
  if (law.smoothing < 0) table.fail("smoothing", "a length of zero or more belongs here");
}

void read_cable_points(TableReader& table, int dimension, const std::vector<std::string>& fixed, CableSettings& cable) {
  cable.points = read_points(table, dimension);
  if (cable.points.size() < 2) table.fail("x", "a cable needs at least two points");
  const std::string ends = table.choice("fixed", fixed);
  cable.start_fixed = ends == "start" || ends == "both";
  cable.end_fixed = ends == "end" || ends == "both";
}

EyeletLine read_eyelets(TableReader& table, const GeometrySettings& geometry, EyeletLine line) {
  const std::optional<BodyAxis> axis = geometry.shape->axis();
  if (!axis)
    table.fail("along", fmt::format("eyelets stand along the axis of a body, and \"{}\" has none; give their x and y",
                                    geometry.kind()));
  if (line.end == 0) line.end = axis->length;
  if (table.has("along")) {
    const std::vector<double> ends = table.quantities("along", Quantity::length, 2);
    std::tie(line.start, line.end) = std::pair(ends[0], ends[1]);
  }
  if (!(line.start >= 0 && line.end > line.start && line.end <= axis->length * (1 + 1e-12)))
    table.fail("along",
               fmt::format("it has two places on the body in their order, from 0 to {}", with_unit(axis->length, "m")));
  if (table.has("offset")) {
    const std::vector<double> offsets = table.quantities("offset", Quantity::length, 2);
    std::tie(line.offset, line.end_offset) = std::pair(offsets[0], offsets[1]);
  }
  line.angle = table.optional_quantity("angle", Quantity::angle).value_or(line.angle);
  line.pieces = table.integer("pieces", line.pieces, 1, 10000);
  return line;
}

bool is_quantity(const std::string& text) {
  const size_t blank = text.rfind(' ');
  return blank != std::string::npos && parse_number(text.substr(0, blank));
}

namespace {

/// The keys of a simulation's ground that a bench's has not.
void read_shape(TableReader& one, const Setup& setup, GroundSettings& ground) {
  const int dimension = setup.dimension;
  const std::string round = dimension == 2 ? "disc" : "sphere";
  std::vector<std::pair<std::string, GroundKind>> kinds{{"plane", GroundKind::plane}, {round, GroundKind::sphere}};
  if (dimension == 3) kinds.emplace_back("cylinder", GroundKind::cylinder);
  ground.kind = one.choice("kind", kinds);
  ground.name = one.text("name", "");
  if (ground.kind != GroundKind::plane) ground.radius = one.positive("radius", Quantity::length, "radius");
}

void read_motion(TableReader& one, const Setup& setup, GroundSettings& ground) {
  if (one.has("move") != one.has("control"))
    one.fail("", "a ground that moves needs both 'move' (a component, or \"normal\") and 'control'");
  if (!one.has("move")) return;
  const std::string way = one.text("move");
  if (way == "normal" && ground.kind != GroundKind::plane)
    one.fail("move", fmt::format("only a plane moves along its normal; allowed: {}",
                                 setup.dimension == 2 ? "x, y" : "x, y, z"));
  ground.move = way == "normal"
                    ? ground.normal
                    : Eigen::VectorXd::Unit(setup.dimension, component_of(one, "move", way, setup.dimension)).eval();
  ground.control = known_id(one, "control", ids_of(setup.controls), "a [[control]]");
  if (control_quantity(setup, ground.control) != Quantity::length)
    one.fail("control", fmt::format("control '{}' is not a length; its start says what it is", ground.control));
}

}  // namespace

void read_surroundings(TableReader& table, const Setup& setup, Language language, SurfaceSettings& contact) {
  const int dimension = setup.dimension;
  const bool bench = language == Language::bench;
  for (TableReader& one : table.tables("obstacle")) {
    if (dimension == 3)
      one.fail("", "obstacles are for 2D simulations; use a ground (a plane, sphere or cylinder) or a clamped body");
    contact.obstacle_names.push_back(bench ? "" : one.text("name", ""));
    std::vector<Eigen::Vector2d>& line = contact.obstacles.emplace_back();
    for (const std::vector<double>& point : read_points(one, 2)) line.emplace_back(point[0], point[1]);
    if (line.size() < 2) one.fail("x", "an obstacle needs at least two points");
    one.finish();
  }
  for (TableReader& one : table.tables("ground")) {
    const size_t d = static_cast<size_t>(dimension);
    GroundSettings& ground = contact.grounds.emplace_back();
    if (!bench) read_shape(one, setup, ground);
    ground.point = vector_of(one.quantities("point", Quantity::length, d));
    ground.normal = Eigen::VectorXd::Unit(dimension, dimension - 1);
    if (ground.kind != GroundKind::sphere) {
      const bool plane = ground.kind == GroundKind::plane;
      const std::string key = plane ? "normal" : "axis";
      const Eigen::VectorXd normal = vector_of(one.numbers(key, d));
      if (!(normal.norm() > 0))
        one.fail(key, plane ? "the normal must not be all zeros; it points to where things may be"
                            : "the axis must not be all zeros");
      ground.normal = normal.normalized();
    }
    if (!bench) read_motion(one, setup, ground);
    one.finish();
  }
}

namespace {

/// Where a displacement or a position is measured at a bench.
void read_place(TableReader& table, size_t dimension, ChannelSettings& channel) {
  if (table.has("point") == table.has("on"))
    table.fail("",
               "give either 'point' (a material point) or 'on' (the mean over a tag) as the place that is measured");
  if (table.has("point")) channel.point = table.quantities("point", Quantity::length, dimension);
  if (table.has("on")) channel.on = table.text("on");
  if (!table.has("standoff")) return;
  if (channel.point.empty()) table.fail("standoff", "a stand-off needs 'point', the foot it stands on");
  channel.standoff = table.quantities("standoff", Quantity::length, dimension);
  channel.turns_with = table.text("turns_with");
}

/// The key "by" of a contact force.
void read_who_presses(TableReader& table, const Setup& setup, ChannelSettings& channel) {
  if (!setup.contact.on)
    table.fail("kind", "without [contact] bodies pass through each other; add it, with gap = \"0.1 mm\" for example");
  std::vector<std::string> names = body_names(setup);
  for (const std::string& name : setup.contact.obstacle_names) {
    if (!name.empty()) names.push_back(name);
  }
  for (const GroundSettings& ground : setup.contact.grounds) {
    if (!ground.name.empty()) names.push_back(ground.name);
  }
  channel.by = known_id(table, "by", names, "the name of a [[body]], a [[contact.ground]] or a [[contact.obstacle]]");
  if (channel.by == channel.on) table.fail("by", "a body exerts no net force on itself; name another one");
}

/// The key "kind"; the first of the names is the fallback.
const ChannelKind& read_kind(TableReader& table, Language language) {
  std::vector<std::string> names;
  for (const ChannelKind& kind : channel_kinds()) {
    if (language == Language::simulation || kind.at_bench()) names.emplace_back(kind.name);
  }
  const auto usual = std::find(names.begin(), names.end(), language == Language::bench ? "displacement" : "position");
  std::rotate(names.begin(), usual, usual + 1);
  const std::string name = table.choice("kind", names);
  return *std::find_if(channel_kinds().begin(), channel_kinds().end(),
                       [&](const ChannelKind& kind) { return kind.name == name; });
}

}  // namespace

ChannelSettings read_channel(TableReader& table, const Setup& setup, Language language) {
  using On = ChannelKind::On;
  using Directed = ChannelKind::Directed;
  const bool bench = language == Language::bench;
  ChannelSettings channel;
  channel.id = table.text("id");
  const ChannelKind& kind = read_kind(table, language);
  channel.kind = &kind;
  if (kind.directed == Directed::always || (kind.directed == Directed::in_space && setup.dimension == 3))
    channel.direction = direction_of(table, setup.dimension);
  if (kind.on == On::place && bench)
    read_place(table, static_cast<size_t>(setup.dimension), channel);
  else if (kind.on == On::place || kind.on == On::tag)
    channel.on = table.text(bench ? "on" : "of");  // of a simulation: a tag or a body, which the mesh knows
  else if (kind.on == On::cable)
    channel.on = known_id(table, "of", ids_of(setup.cables.cables), "a [[cable]]");
  else if (kind.on == On::joint)
    channel.on = known_id(table, "of", ids_of(setup.joints), "a [[joint]]");
  else if (kind.on == On::body)
    channel.on = known_id(table, "of", body_names(setup), "a [[body]]");
  else
    channel.on = "the model";
  if (kind.name == "contact_force") read_who_presses(table, setup, channel);
  return channel;
}

}  // namespace taut

#include "calib/experiment.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <set>

#include "calib/toml_reader.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;

std::string beside(const std::string& experiment_path, const std::string& path) {
  const fs::path given(path);
  return given.is_absolute() ? path : (fs::path(experiment_path).parent_path() / given).lexically_normal().string();
}

constexpr std::string_view components = "xyz";

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

/// Keys of [mesh] and of a [[fit.variant]]; what is missing stays as it is in `settings`.
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
  } else if (geometry.kind != "msh") {
    if (const auto size = table.optional_quantity("size", Quantity::length)) settings.size = *size;
    if (!(settings.size > 0)) table.fail("", "'size' is missing or not positive; add for example size = \"2 mm\"");
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

GeometrySettings read_geometry(TableReader table, const std::string& path) {
  GeometrySettings geometry;
  geometry.kind = table.choice("kind", {"box", "rectangle", "boxes", "polygons", "msh"});
  geometry.dimension = geometry.kind == "rectangle" || geometry.kind == "polygons" ? 2 : 3;
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
  } else {
    geometry.file = beside(path, table.text("file"));
    geometry.unit = unit_factor(table.text("unit"), Quantity::length, table.where("unit"));
    geometry.dimension = table.integer("dimension", 3, 2);
    if (geometry.dimension > 3) table.fail("dimension", "2 or 3 belongs here");
  }
  if (geometry.dimension == 2) {
    geometry.thickness = table.quantity("thickness", Quantity::length);
    if (!(geometry.thickness > 0)) table.fail("thickness", "the thickness must be positive");
    geometry.plane = table.choice("plane", {"strain", "stress"}) == "strain" ? Plane::strain : Plane::stress;
  }
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

/// Loads name their unit by their column or value; the unit says what kind of load it is.
const std::vector<Quantity> load_quantities{Quantity::force, Quantity::mass, Quantity::pressure, Quantity::line_load};

LoadSettings read_load(TableReader& table, const GeometrySettings& geometry) {
  const size_t d = static_cast<size_t>(geometry.dimension);
  LoadSettings load;
  load.id = table.text("id");
  if (table.has("point") == table.has("on"))
    table.fail("", "give either 'on' (a tag, or \"a & b\") or 'point' as the place of the load");
  if (table.has("point")) load.point = table.quantities("point", Quantity::length, d);
  if (table.has("on")) load.on = table.text("on");
  load.direction = direction_of(table, geometry.dimension);
  if (table.has("column") == table.has("value"))
    table.fail("", "give either 'column' (of the bench file) or 'value' (a constant load)");
  if (table.has("column")) {
    load.column = table.text("column");
    load.quantity = parse_header(load.column, load_quantities, table.where("column")).quantity;
  } else {
    const std::string value = table.text("value");
    const size_t blank = value.rfind(' ');
    const std::string unit = blank == std::string::npos ? "" : value.substr(blank + 1);
    const auto found = std::find_if(load_quantities.begin(), load_quantities.end(), [&](Quantity quantity) {
      const std::vector<std::string> units = units_of(quantity);
      return std::find(units.begin(), units.end(), unit) != units.end();
    });
    if (found == load_quantities.end())
      table.fail("value", fmt::format("'{}' is not a load; give a force (\"2 N\"), a mass (\"100 g\"), a traction (\"3 "
                                      "kPa\") or a line load (\"5 N/m\")",
                                      value));
    load.quantity = *found;
    load.value = parse_quantity(value, load.quantity, table.where("value"));
  }
  if (load.quantity == Quantity::pressure && !load.point.empty())
    table.fail("point", "a traction acts on a face; use 'on'");
  if (load.quantity == Quantity::line_load && !load.point.empty())
    table.fail("point", "a line load acts on an edge, in 2D on a corner; use 'on'");
  table.finish();
  return load;
}

ChannelSettings read_channel(TableReader& table, const GeometrySettings& geometry, BenchFormat::Channel& bench) {
  const size_t d = static_cast<size_t>(geometry.dimension);
  ChannelSettings channel;
  bench.id = channel.id = table.text("id");
  if (table.has("point") == table.has("on"))
    table.fail("",
               "give either 'point' (a material point) or 'on' (the mean over a tag) as the place that is measured");
  if (table.has("point")) channel.point = table.quantities("point", Quantity::length, d);
  if (table.has("on")) channel.on = table.text("on");
  if (table.has("standoff")) {
    if (channel.point.empty()) table.fail("standoff", "a stand-off needs 'point', the foot it stands on");
    channel.standoff = table.quantities("standoff", Quantity::length, d);
    channel.turns_with = table.text("turns_with");
  }
  channel.direction = direction_of(table, geometry.dimension);
  bench.column = table.text("column", "");
  if (auto noise = table.optional_table("noise")) {
    bench.noise.absolute = noise->optional_quantity("absolute", Quantity::length).value_or(0);
    bench.noise.relative = noise->optional_quantity("relative", Quantity::pure).value_or(0);
    bench.noise.resolution = noise->optional_quantity("resolution", Quantity::length).value_or(0);
    if (bench.noise.absolute < 0 || bench.noise.relative < 0 || bench.noise.resolution < 0)
      noise->fail("", "noise must not be negative");
    noise->finish();
  }
  table.finish();
  return channel;
}

void read_bench(TableReader table, Experiment& experiment) {
  BenchFormat& bench = experiment.bench;
  bench.path = beside(experiment.path, table.text("file"));
  bench.trial_column = table.text("trial", "");
  bench.channel_column = table.text("channel", "");
  bench.value_column = table.text("value", "");
  bench.sigma_column = table.text("sigma", "");
  bench.ignored = table.texts_or_none("ignore");
  if (bench.channel_column.empty() != bench.value_column.empty())
    table.fail("", "'channel' and 'value' belong together: the columns that hold a channel's id and its reading");
  experiment.from_unloaded = table.choice("measured_from", {"rest", "unloaded"}) == "unloaded";
  table.finish();
  for (const BenchFormat::Channel& channel : bench.channels) {
    if (channel.column.empty() == bench.channel_column.empty()) {
      throw InputError(fmt::format(
          "{}: channel '{}': {}", experiment.path, channel.id,
          channel.column.empty() ? "its bench column is missing; add column = \"NAME_mm\", or name the [bench] columns "
                                   "'channel' and 'value'"
                                 : "[bench] names a 'channel' column, so channels must not name columns of their own"));
    }
    const InstrumentNoise& noise = channel.noise;
    if (bench.sigma_column.empty() && noise.absolute == 0 && noise.relative == 0 && noise.resolution == 0) {
      throw InputError(
          fmt::format("{}: channel '{}' has no noise; add for example noise = {{ absolute = \"0.1 mm\" }} to its "
                      "[[channel]], or name a 'sigma' column in [bench]",
                      experiment.path, channel.id));
    }
  }
}

void read_fit(TableReader table, Experiment& experiment) {
  for (auto& [id, free] : table.named_tables("free")) {
    FreeSettings settings;
    settings.id = id;
    settings.start = free.optional_given("start");
    settings.lower = free.optional_given("lower");
    settings.upper = free.optional_given("upper");
    free.finish();
    experiment.free.push_back(settings);
  }
  for (TableReader& variant : table.tables("variant")) {
    VariantSettings settings{variant.text("name"), experiment.mesh};
    read_mesh(variant, experiment.geometry, settings.mesh);
    variant.finish();
    experiment.variants.push_back(settings);
  }
  for (TableReader& reference : table.tables("reference")) {
    ReferenceValue value;
    value.parameter = reference.text("parameter");
    if (!reference.has("value")) reference.fail("", "'value' is missing; add the published value with its unit");
    value.value = *reference.optional_given("value");
    value.source = reference.text("source");
    reference.finish();
    experiment.references.push_back(value);
  }
  table.finish();
}

void read_solver(TableReader table, Experiment& experiment) {
  EquilibriumOptions& options = experiment.equilibrium;
  options.max_iterations = table.integer("max_iterations", options.max_iterations, 1);
  options.max_halvings = table.integer("max_halvings", options.max_halvings, 0);
  if (table.has("step_tolerance")) options.step_tolerance = table.quantity("step_tolerance", Quantity::pure);
  if (!(options.step_tolerance > 1e-14 && options.step_tolerance < 1e-2))
    table.fail("step_tolerance", "a number between 1e-14 and 1e-2 belongs here");
  experiment.threads = table.integer("threads", 0, 0);
  table.finish();
}

void refuse_repeated_ids(const Experiment& experiment) {
  std::set<std::string> seen;
  auto check = [&](const std::string& id) {
    if (!seen.insert(id).second)
      throw InputError(fmt::format("{}: the id '{}' is used twice; ids of loads, supports and channels must differ",
                                   experiment.path, id));
  };
  for (const LoadSettings& load : experiment.loads) check(load.id);
  for (const SupportSettings& support : experiment.supports) {
    if (!support.control.empty()) check(support.control);
  }
  for (const ChannelSettings& channel : experiment.channels) check(channel.id);
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
  return text;
}

Experiment read_experiment(const std::string& path) {
  toml::table file;
  try {
    file = toml::parse_file(path);
  } catch (const toml::parse_error& error) {
    const auto line = error.source().begin.line;
    if (line == 0 || !fs::exists(path))
      throw InputError(
          fmt::format("{}: cannot be read as an experiment file: {}; check the path", path, error.description()));
    throw InputError(fmt::format("{}:{}: not valid TOML: {}", path, line, error.description()));
  }
  TableReader root(file, path, "");
  Experiment experiment;
  experiment.path = path;
  experiment.title = root.text("title");
  const std::string data = root.text("data");
  if (data != "measured" && data != "simulated")
    root.fail("data", fmt::format("'{}' is not known{}; allowed: measured, simulated", data,
                                  did_you_mean(data, {"measured", "simulated"})));
  experiment.simulated = data == "simulated";

  experiment.geometry = read_geometry(root.table("geometry"), path);
  const int d = experiment.geometry.dimension;
  if (auto mesh = root.optional_table("mesh")) {
    read_mesh(*mesh, experiment.geometry, experiment.mesh);
    mesh->finish();
  } else if (experiment.geometry.kind != "msh") {
    root.table("mesh");  // says that it is missing
  }
  experiment.materials = read_materials(root);

  if (auto gravity = root.optional_table("gravity")) {
    experiment.gravity = gravity->optional_quantity("acceleration", Quantity::acceleration).value_or(9.81);
    if (!(experiment.gravity > 0))
      gravity->fail("acceleration", "the acceleration must be positive; its direction is given by 'direction'");
    if (gravity->boolean("self_weight", true)) {
      experiment.gravity_direction = direction_of(*gravity, d);
      if (std::none_of(experiment.materials.begin(), experiment.materials.end(),
                       [](const MaterialSettings& m) { return m.density.has_value(); })) {
        gravity->fail("",
                      "self-weight needs a density; add density = \"1070 kg/m3\" to the materials that have weight, or "
                      "set self_weight = false");
      }
    } else if (gravity->has("direction")) {
      direction_of(*gravity, d);
    }
    gravity->finish();
  }

  for (TableReader& table : root.tables("support")) {
    SupportSettings support;
    support.on = table.text("on");
    for (const std::string& name : table.texts_or_none("fix"))
      support.fix.push_back(component_of(table, "fix", name, d));
    if (table.has("move")) {
      support.component = component_of(table, "move", table.text("move"), d);
      support.control = table.text("id");
      support.column = table.text("column");
    }
    if (support.fix.empty() && support.control.empty())
      table.fail("", "a support needs 'fix' (a list of components) or 'move' with 'id' and 'column'");
    table.finish();
    experiment.supports.push_back(support);
  }
  if (experiment.supports.empty())
    root.fail("", "there is no support; add [[support]] with on = \"TAG\" and fix = [\"x\", \"y\"]");

  for (TableReader& table : root.tables("load")) experiment.loads.push_back(read_load(table, experiment.geometry));
  for (const LoadSettings& load : experiment.loads) {
    if (!load.column.empty()) experiment.bench.controls.push_back({load.id, load.column, {load.quantity}});
  }
  for (const SupportSettings& support : experiment.supports) {
    if (!support.control.empty())
      experiment.bench.controls.push_back({support.control, support.column, {Quantity::length}});
  }

  for (TableReader& table : root.tables("channel")) {
    BenchFormat::Channel& bench = experiment.bench.channels.emplace_back();
    experiment.channels.push_back(read_channel(table, experiment.geometry, bench));
  }
  if (experiment.channels.empty())
    root.fail("", "there is no channel; add [[channel]] for what is measured, with id, point or on, and direction");
  refuse_repeated_ids(experiment);

  read_bench(root.table("bench"), experiment);
  if (auto fit = root.optional_table("fit")) read_fit(*fit, experiment);
  if (auto solver = root.optional_table("solver")) read_solver(*solver, experiment);
  root.finish();
  return experiment;
}

}  // namespace taut

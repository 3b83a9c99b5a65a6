#include "calib/files/experiment.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <set>

#include "calib/files/fit_tables.hpp"
#include "calib/files/recordings_file.hpp"
#include "calib/files/uniaxial_file.hpp"
#include "sim/core/error.hpp"
#include "sim/files/geometry_file.hpp"
#include "sim/files/tables.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;

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
    load.control = load.id;
    load.column = table.text("column");
    load.quantity = parse_header(load.column, load_quantities, table.where("column")).quantity;
  } else {
    const std::string value = table.text("value");
    const auto quantity = quantity_of_text(value, load_quantities);
    if (!quantity)
      table.fail("value", fmt::format("'{}' is not a load; give a force (\"2 N\"), a mass (\"100 g\"), a traction (\"3 "
                                      "kPa\") or a line load (\"5 N/m\")",
                                      value));
    load.quantity = *quantity;
    load.value = parse_quantity(value, load.quantity, table.where("value"));
  }
  if (load.quantity == Quantity::pressure && !load.point.empty())
    table.fail("point", "a traction acts on a face; use 'on'");
  if (load.quantity == Quantity::line_load && !load.point.empty())
    table.fail("point", "a line load acts on an edge, in 2D on a corner; use 'on'");
  table.finish();
  return load;
}

/// Where a displacement or a position is measured.
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

void read_channel(TableReader& table, Experiment& experiment) {
  using Kind = ChannelSettings::Kind;
  const int d = experiment.geometry.dimension;
  ChannelSettings channel =
      read_channel(table, experiment, d,
                   {Kind::displacement, Kind::position, Kind::rotation, Kind::tension, Kind::length, Kind::reaction});
  if (channel.of_place()) read_place(table, static_cast<size_t>(d), channel);
  if (channel.kind == Kind::rotation || channel.kind == Kind::reaction) channel.on = table.text("on");
  BenchFormat::Channel& bench = experiment.bench.channels.emplace_back();
  bench.id = channel.id;
  bench.quantity = quantity_of_si_unit(unit_of(channel.kind));
  bench.column = table.text("column", "");
  if (auto noise = table.optional_table("noise")) {
    bench.noise.absolute = noise->optional_quantity("absolute", bench.quantity).value_or(0);
    bench.noise.relative = noise->optional_quantity("relative", Quantity::pure).value_or(0);
    bench.noise.resolution = noise->optional_quantity("resolution", bench.quantity).value_or(0);
    if (bench.noise.absolute < 0 || bench.noise.relative < 0 || bench.noise.resolution < 0)
      noise->fail("", "noise must not be negative");
    noise->finish();
  }
  table.finish();
  experiment.channels.push_back(std::move(channel));
}

/// The control id of a retraction's column; the same column retracts several cables.
std::string retraction_control(TableReader& table, CablesSettings& cables) {
  const std::string column = table.text("retraction");
  const std::string id = parse_header(column, {Quantity::length}, table.where("retraction")).name;
  const std::string known = cables.columns.try_emplace(id, column).first->second;
  if (known != column)
    table.fail("retraction",
               fmt::format("'{}' and '{}' are the same retraction in two units; name one column", known, column));
  return id;
}

void read_gravity(TableReader table, Experiment& experiment) {
  experiment.gravity = table.optional_quantity("acceleration", Quantity::acceleration).value_or(9.81);
  if (!(experiment.gravity > 0))
    table.fail("acceleration", "the acceleration must be positive; its direction is given by 'direction'");
  if (table.boolean("self_weight", true)) {
    experiment.gravity_direction = direction_of(table, experiment.geometry.dimension);
    if (std::none_of(experiment.materials.begin(), experiment.materials.end(),
                     [](const MaterialSettings& m) { return m.density.has_value(); })) {
      table.fail("",
                 "self-weight needs a density; add density = \"1070 kg/m3\" to the materials that have weight, or "
                 "set self_weight = false");
    }
  } else if (table.has("direction")) {
    direction_of(table, experiment.geometry.dimension);
  }
  table.finish();
}

void read_support(TableReader& table, Experiment& experiment) {
  const int d = experiment.geometry.dimension;
  SupportSettings support;
  support.on = table.text("on");
  for (const std::string& name : table.texts_or_none("fix")) support.fix.push_back(component_of(table, "fix", name, d));
  if (table.has("move")) {
    support.component = component_of(table, "move", table.text("move"), d);
    support.control = table.text("id");
    support.column = table.text("column");
  }
  support.rotation_stiffness = table.optional_quantity("rotation_stiffness", Quantity::rotation_stiffness);
  if (support.rotation_stiffness && (!(*support.rotation_stiffness > 0) || d != 2 || !support.fix.empty()))
    table.fail("rotation_stiffness", "an elastic clamp is positive, stands in a 2D model and takes the place of 'fix'");
  if (support.fix.empty() && support.control.empty() && !support.rotation_stiffness)
    table.fail("",
               "a support needs 'fix' (a list of components), 'move' with 'id' and 'column', or 'rotation_stiffness'");
  table.finish();
  experiment.supports.push_back(support);
}

void read_cables(TableReader table, Experiment& experiment) {
  CablesSettings& cables = experiment.cables;
  const GeometrySettings& geometry = experiment.geometry;
  cables.k = table.optional_quantity("k", Quantity::stiffness);
  cables.EA = table.optional_quantity("EA", Quantity::force);
  if (cables.k.has_value() == cables.EA.has_value())
    table.fail("", "give either k (the stiffness of a whole cable, \"20 kN/m\") or EA (\"1.2 kN\"; k = EA / length)");
  if (!(cables.k.value_or(1) > 0 && cables.EA.value_or(1) > 0))
    table.fail(cables.k ? "k" : "EA", "the stiffness must be positive");
  cables.slack = table.optional_quantity("slack", Quantity::length).value_or(0);
  cables.smoothing = table.optional_quantity("smoothing", Quantity::length).value_or(cables.smoothing);
  if (cables.smoothing < 0) table.fail("smoothing", "a length of zero or more belongs here");
  const std::vector<std::string> own =
      geometry.shape->defaults().cables ? geometry.shape->cable_names() : std::vector<std::string>{};
  const std::string common = table.has("retraction") ? retraction_control(table, cables) : "";
  for (TableReader& one : table.tables("cable")) {
    CableSettings cable;
    cable.id = one.text("id");
    for (const CableSettings& other : cables.cables) {
      if (other.id == cable.id)
        one.fail("id", fmt::format("the cable '{}' is there already; choose another id", cable.id));
    }
    cable.control = one.has("retraction") ? retraction_control(one, cables) : common;
    if (!own.empty() && !one.has("x")) {
      if (std::find(own.begin(), own.end(), cable.id) == own.end())
        one.fail("id", fmt::format("'{}' has no points; the module's own cables are {}, others need x and y", cable.id,
                                   join(own, " and ")));
      for (const Eigen::VectorXd& point : own_cable(geometry, cable.id))
        cable.points.emplace_back(point.begin(), point.end());
    } else {
      read_cable_points(one, geometry.dimension, {"start", "end", "both", "none"}, cable);
    }
    one.finish();
    cables.cables.push_back(cable);
  }
  if (cables.cables.empty()) {
    for (const std::string& id : own) {
      CableSettings& cable = cables.cables.emplace_back();
      cable.id = id;
      cable.control = common;
      for (const Eigen::VectorXd& point : own_cable(geometry, id))
        cable.points.emplace_back(point.begin(), point.end());
    }
  }
  if (!common.empty() && std::none_of(cables.cables.begin(), cables.cables.end(),
                                      [&](const CableSettings& cable) { return cable.control == common; }))
    table.fail("retraction", "every cable has a retraction of its own, so this one moves nothing; remove it");
  if (cables.cables.empty()) table.fail("", "there is no cable; add [[cables.cable]] with id, x and y");
  table.finish();
}

void read_contact(TableReader table, Experiment& experiment) {
  SurfaceSettings& contact = experiment.contact;
  contact.on = table.boolean("on", true);
  if (!contact.on) return table.finish();  // keys that would have no effect are refused
  if (experiment.geometry.dimension != 2) table.fail("", "contact is for 2D geometries; remove [contact]");
  if (experiment.geometry.shape->defaults().contact) contact.compensate = table.boolean("compensate", true);
  const std::string form = table.choice("form", {"length_weighted", "pair_sum", "pair_sum_dedup"});
  if (form != "length_weighted") {
    contact.form = form == "pair_sum" ? ContactForm::pair_sum : ContactForm::pair_sum_dedup;
    contact.stiffness = table.quantity("stiffness", Quantity::stiffness);
    if (!(*contact.stiffness > 0)) table.fail("stiffness", "the stiffness must be positive");
  } else if (table.has("stiffness")) {
    table.fail("stiffness", "the barrier's stiffness is set from materials and loads; only the pair sums take one");
  }
  read_surroundings(table, 2, contact);
  table.finish();
}

void read_bench(TableReader table, Experiment& experiment) {
  BenchFormat& bench = experiment.bench;
  bench.path = path_beside(experiment.path, table.text("file"));
  bench.trial_column = table.text("trial", "");
  bench.channel_column = table.text("channel", "");
  bench.value_column = table.text("value", "");
  bench.sigma_column = table.text("sigma", "");
  bench.ignored = table.texts_or_none("ignore");
  if (bench.channel_column.empty() != bench.value_column.empty())
    table.fail("", "'channel' and 'value' belong together: the columns that hold a channel's id and its reading");
  experiment.zero_offset_per = table.text("zero_offset_per", "");
  if (!experiment.zero_offset_per.empty()) {
    std::vector<std::string> ids;
    for (const BenchFormat::Control& control : bench.controls) ids.push_back(control.id);
    known_id(table, "zero_offset_per", ids, "set by the bench");
    for (const BenchFormat::Channel& channel : bench.channels) {
      if (channel.quantity != Quantity::length)
        table.fail("zero_offset_per",
                   fmt::format("a zero error is a length that all channels share, and '{}' is none", channel.id));
    }
  }
  experiment.from_unloaded = table.choice("measured_from", {"rest", "unloaded"}) == "unloaded";
  for (const ChannelSettings& channel : experiment.channels) {
    if (experiment.from_unloaded && channel.kind == ChannelSettings::Kind::position)
      table.fail("measured_from", fmt::format("'{}' is a position, which is measured from nowhere; make its kind "
                                              "\"displacement\", or leave this out",
                                              channel.id));
  }
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
  read_free(table, experiment);
  experiment.all_profiles = table.choice("profiles", {"doubtful", "all"}) == "all";
  if (!experiment.recordings) experiment.mesh_share = table.boolean("mesh_share", true);
  if (auto diagnostic = table.optional_table("diagnostic")) {
    std::vector<std::string> free, controls;
    for (const FreeSettings& settings : experiment.free) free.push_back(settings.id);
    for (const BenchFormat::Control& control : experiment.bench.controls) controls.push_back(control.id);
    experiment.diagnostic = DiagnosticSettings{known_id(*diagnostic, "parameter", free, "a free parameter of the fit"),
                                               known_id(*diagnostic, "per", controls, "set by the bench")};
    diagnostic->finish();
  }
  for (TableReader& variant : table.tables("variant")) {
    VariantSettings settings;
    settings.name = variant.text("name");
    settings.mesh = experiment.mesh;
    read_mesh(variant, experiment.geometry, settings.mesh);
    variant.finish();
    experiment.variants.push_back(settings);
  }
  read_references(table, experiment);
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

void read_model(TableReader& root, Experiment& experiment) {
  const std::vector<std::string> names{"full", "beam", "rigid_segments", "solid", "auto"};
  const std::string name = root.choice("model", names);
  experiment.model = name == "beam"             ? Rung::beam
                     : name == "rigid_segments" ? Rung::rigid_segments
                     : name == "solid"          ? Rung::solid
                     : name == "auto"           ? Rung::automatic
                                                : Rung::full;
  if (!root.has("tolerance")) return;
  if (experiment.model != Rung::automatic)
    root.fail("tolerance", "it says when model = \"auto\" stops climbing; set that, or leave it out");
  experiment.tolerance = root.quantity("tolerance", Quantity::pure);
  if (!(experiment.tolerance >= 1e-4 && experiment.tolerance <= 0.5))
    root.fail("tolerance", "a number between 0.01 % and 50 % belongs here");
}

void read_figures(TableReader table, Experiment& experiment) {
  experiment.trend_degree = table.integer("trend_degree", 0, 0);
  if (experiment.trend_degree > 5) {
    table.fail("trend_degree",
               fmt::format("{} is too high for a trend; allowed: 0 (none) to 5", experiment.trend_degree));
  }
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
  for (const auto& [id, column] : experiment.cables.columns) check(id);
}

/// Settings that are right in themselves but change nothing here.
void refuse_without_effect(const Experiment& experiment) {
  const bool gap = experiment.mesh.contact_gap > 0 ||
                   std::any_of(experiment.variants.begin(), experiment.variants.end(),
                               [](const VariantSettings& variant) { return variant.mesh.contact_gap > 0; });
  if (gap && !experiment.contact.on)
    throw InputError(
        fmt::format("{}: contact_gap has no effect without contact; add [contact] or remove it", experiment.path));
  const bool zero = std::any_of(experiment.free.begin(), experiment.free.end(),
                                [](const FreeSettings& free) { return free.id.starts_with("zero_"); });
  if (!experiment.zero_offset_per.empty() && !zero) {
    throw InputError(
        fmt::format("{}: [bench] zero_offset_per: all zero errors stay 0; free some of them, for example "
                    "[fit.free.zero_1], or remove the key",
                    experiment.path));
  }
}

}  // namespace

std::string_view name_of(Rung rung) {
  switch (rung) {
    case Rung::beam:
      return "beam";
    case Rung::rigid_segments:
      return "rigid_segments";
    case Rung::full:
      return "full";
    case Rung::solid:
      return "solid";
    case Rung::automatic:
      return "auto";
  }
  return "";
}

Experiment read_experiment(const std::string& path) {
  const TomlFile file(path);
  if (file.has("simulation"))
    throw InputError(
        fmt::format("{0}: this file describes a simulation, without a bench; run `taut simulate {0}`", path));
  if (file.text_at("geometry", "kind") == "uniaxial") return read_uniaxial(file, path);
  TableReader root = file.root();
  Experiment experiment;
  experiment.path = path;
  read_head(root, experiment);
  read_model(root, experiment);

  experiment.geometry = read_geometry(root.table("geometry"), path);
  if (auto mesh = root.optional_table("mesh")) {
    read_mesh(*mesh, experiment.geometry, experiment.mesh);
    mesh->finish();
  } else if (refinable(experiment.geometry)) {
    root.table("mesh");  // says that it is missing
  }
  experiment.materials = read_materials(root);

  if (auto gravity = root.optional_table("gravity")) read_gravity(*gravity, experiment);
  for (TableReader& table : root.tables("support")) read_support(table, experiment);
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

  if (auto cables = root.optional_table("cables")) read_cables(*cables, experiment);
  for (const auto& [id, column] : experiment.cables.columns)
    experiment.bench.controls.push_back({id, column, {Quantity::length}});
  experiment.contact.on = experiment.geometry.shape->defaults().contact;
  if (auto contact = root.optional_table("contact")) read_contact(*contact, experiment);

  for (TableReader& table : root.tables("channel")) read_channel(table, experiment);
  if (experiment.channels.empty())
    root.fail("", "there is no channel; add [[channel]] for what is measured, with id, point or on, and direction");
  refuse_repeated_ids(experiment);

  TableReader bench = root.table("bench");
  if (bench.choice("kind", {"readings", "recordings"}) == "recordings") {
    if (experiment.model != Rung::full)
      root.fail("model", "recordings over time are replayed by the full model; leave 'model' out");
    read_recordings(std::move(bench), root, experiment);
  } else {
    read_bench(std::move(bench), experiment);
  }
  if (auto fit = root.optional_table("fit")) read_fit(*fit, experiment);
  if (auto solver = root.optional_table("solver")) read_solver(*solver, experiment);
  if (auto figures = root.optional_table("figures")) read_figures(*figures, experiment);
  refuse_without_effect(experiment);
  root.finish();
  return experiment;
}

std::vector<RunInput> inputs_of(const Experiment& experiment) {
  std::vector<RunInput> files{{experiment.path, "experiment.toml"}};
  if (experiment.recordings) {
    for (const RecordingSettings& recording : experiment.recordings->recordings)
      files.push_back({recording.path, recording.id + ".csv"});
  } else {
    files.push_back({experiment.bench.path, "data.csv"});
  }
  if (const std::string mesh = input_file(experiment.geometry); !mesh.empty()) files.push_back({mesh, "mesh.msh"});
  return files;
}

Experiment read_copies(const std::string& folder) {
  const auto in_folder = [&](const std::string& name) { return (fs::path(folder) / name).string(); };
  Experiment experiment = read_experiment(in_folder("experiment.toml"));
  experiment.bench.path = in_folder("data.csv");
  if (!input_file(experiment.geometry).empty()) set_input_file(experiment.geometry, in_folder("mesh.msh"));
  if (experiment.recordings) {
    for (RecordingSettings& recording : experiment.recordings->recordings)
      recording.path = in_folder(recording.id + ".csv");
  }
  return experiment;
}

}  // namespace taut

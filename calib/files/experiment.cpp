#include "calib/files/experiment.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <tuple>

#include "calib/benches/control_name.hpp"
#include "calib/data/trials.hpp"
#include "calib/files/bench_kinds.hpp"
#include "sim/core/error.hpp"
#include "sim/files/geometry_file.hpp"
#include "sim/files/tables.hpp"
#include "sim/mesh/geo_file.hpp"
#include "sim/scene/channel_kinds.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;

void read_channel(TableReader& table, Experiment& experiment) {
  ChannelSettings channel = read_channel(table, experiment, Language::bench);
  BenchFormat::Channel& bench = experiment.bench.channels.emplace_back();
  bench.id = channel.id;
  bench.quantity = quantity_of_si_unit(channel.kind->unit);
  bench.column = table.text("column", "");
  bench.noise = read_noise(table, bench.quantity);
  table.finish();
  experiment.channels.push_back(std::move(channel));
}

/// A [[marker]]: a channel for each coordinate that it names a column of.
void read_marker(TableReader& table, Experiment& experiment) {
  const std::optional<BodyAxis> axis = experiment.geometry.shape->axis();
  if (!axis)
    table.fail("", fmt::format(
                       "a marker stands on the axis of a body, and \"{}\" has none; measure a 'point' by a [[channel]]",
                       experiment.geometry.kind()));
  const int d = experiment.geometry.dimension;
  ChannelSettings marker;
  marker.marker = table.text("id");
  marker.foot = table.quantity("s", Quantity::length);
  if (!(*marker.foot >= 0 && *marker.foot <= axis->length * (1 + 1e-12)))
    table.fail(
        "s", fmt::format("the body reaches from 0 to {}, and the foot has to be on it", with_unit(axis->length, "m")));
  const double standoff = table.optional_quantity("standoff", Quantity::length).value_or(0),
               angle = table.optional_quantity("angle", Quantity::angle).value_or(0),
               ahead = table.optional_quantity("ahead", Quantity::length).value_or(0);
  if (standoff != 0 || ahead != 0) {
    const Eigen::VectorXd offset = axis->offset(standoff, angle, ahead);
    marker.standoff.assign(offset.begin(), offset.end());
  }
  const std::string kind = table.choice("kind", {"position", "displacement"});
  marker.kind = &*std::ranges::find(channel_kinds(), kind, &ChannelKind::name);
  const InstrumentNoise noise = read_noise(table, Quantity::length);
  for (int component = 0; component < d; ++component) {
    const std::string name(1, "xyz"[component]);
    const std::string column = table.text(name, "");
    const InstrumentNoise own = read_noise(table, Quantity::length, "noise_" + name);
    if (column.empty()) {
      if (own.given())
        table.fail("noise_" + name, fmt::format("'{}' is not measured; name its column, or leave this out", name));
      continue;
    }
    ChannelSettings& channel = experiment.channels.emplace_back(marker);
    channel.id = marker.marker + "_" + name;
    channel.direction.assign(static_cast<size_t>(d), 0.0);
    channel.direction[static_cast<size_t>(component)] = 1;
    experiment.bench.channels.push_back(
        {channel.id, column, Quantity::length, own.given() ? own : noise, marker.marker});
  }
  if (experiment.channels.empty() || experiment.channels.back().marker != marker.marker)
    table.fail("", "a marker needs the column of at least one coordinate; add for example x = \"x_mm\"");
  table.finish();
}

/// The control id of a column that drives cables; the same column may drive several.
std::string cable_control(TableReader& table, std::string_view key, const std::vector<Quantity>& quantities,
                          Experiment& experiment, std::map<std::string, std::string>& columns) {
  const std::string column = table.text(key);
  const std::string id = column_unit(experiment, column, quantities, table.where(key)).name;
  const std::string known = columns.try_emplace(id, column).first->second;
  if (known != column)
    table.fail(key, fmt::format("'{}' and '{}' are the same {} in two units; name one column", known, column, key));
  return id;
}

/// What drives a cable: the keys retraction or tension, the latter with spool.
struct Drive {
  std::string control;
  bool held = false;
  double tension = 0, spool = 0;
};

Drive read_drive(TableReader& table, Experiment& experiment, std::optional<double> common_spool = {}) {
  Drive drive;
  CablesSettings& cables = experiment.cables;
  if (table.has("retraction") && table.has("tension"))
    table.fail("tension", "a cable is driven by its retraction or by its tension; give one of them");
  if (table.has("retraction"))
    drive.control = cable_control(table, "retraction", {Quantity::length}, experiment, cables.columns);
  drive.held = table.has("tension");
  if (!drive.held) {
    if (table.has("spool"))
      table.fail("spool", "the spool's radius turns a torque into a tension; add 'tension', or leave it out");
    return drive;
  }
  const std::string given = table.text("tension");
  Quantity quantity = Quantity::force;
  if (is_quantity(given)) {
    const std::vector<Quantity> either{Quantity::force, Quantity::torque};
    quantity = quantity_of(table, "tension", given, either, "is neither a force (\"5 N\") nor a torque (\"0.2 Nm\")");
    drive.tension = parse_quantity(given, quantity, table.where("tension"));
    if (drive.tension < 0) table.fail("tension", "a cable cannot push; a tension is zero or more");
  } else {
    const std::vector<Quantity> either{Quantity::force, Quantity::torque};
    drive.control = cable_control(table, "tension", either, experiment, cables.tension_columns);
    quantity = column_unit(experiment, given, either, table.where("tension")).quantity;
  }
  if (quantity == Quantity::torque && !table.has("spool") && !common_spool)
    table.fail("tension", "a torque pulls by a spool; add its radius, for example spool = \"30 mm\"");
  if (quantity == Quantity::torque)
    drive.spool = table.has("spool") ? table.positive("spool", Quantity::length, "radius of the spool") : *common_spool;
  else if (table.has("spool"))
    table.fail("spool", "the tension is a force already; leave 'spool' out, or give a torque (Nm)");
  if (drive.spool > 0) drive.tension /= drive.spool;
  return drive;
}

void drive_by(const Drive& drive, CableSettings& cable) {
  std::tie(cable.control, cable.held, cable.tension, cable.spool) =
      std::tie(drive.control, drive.held, drive.tension, drive.spool);
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

/// What governs the cables together, after each has been read: the shared law where one needs it, the tendons'
/// friction.
void read_laws(TableReader& table, CablesSettings& cables) {
  const bool elastic =
      std::ranges::any_of(cables.cables, [](const CableSettings& cable) { return !cable.held && !cable.own; });
  const bool held = std::ranges::any_of(cables.cables, &CableSettings::held);
  if (elastic && held && !cables.k && !cables.EA) {
    const auto other =
        std::ranges::find_if(cables.cables, [](const CableSettings& cable) { return !cable.held && !cable.own; });
    table.fail("",
               fmt::format("cable '{}' has no 'tension', so that it is elastic; give that, or k (the stiffness of a "
                           "whole cable, \"20 kN/m\")",
                           other->id));
  }
  if (elastic && !cables.k && !cables.EA) read_cable_law(table, cables, true);  // says what is missing
  if (table.has("friction")) {
    cables.friction = table.quantity("friction", Quantity::pure);
    if (!(cables.friction >= 0 && cables.friction <= 2))
      table.fail("friction", "a coefficient of friction from 0 (none) to 2 belongs here");
  }
  if (table.has("misalignment")) {
    cables.misalignment = table.quantity("misalignment", Quantity::angle);
    if (!(cables.misalignment >= 0 && cables.misalignment <= 1))
      table.fail("misalignment", "the angle by which each eyelet turns a cable besides, from 0 to 1 rad, belongs here");
  }
  if (!elastic && (cables.k || cables.EA))
    table.fail(cables.k ? "k" : "EA", "no cable is governed by it: each is held at a tension or has a k of its own");
}

void read_cables(TableReader table, Experiment& experiment) {
  CablesSettings& cables = experiment.cables;
  const GeometrySettings& geometry = experiment.geometry;
  if (table.has("k") || table.has("EA")) read_cable_law(table, cables, true);
  const std::vector<std::string> own =
      geometry.shape->defaults().cables ? geometry.shape->cable_names() : std::vector<std::string>{};
  std::optional<double> spool;  // of all whose tension is a torque
  if (!table.has("tension")) spool = table.optional_positive("spool", Quantity::length, "radius of the spool");
  const Drive common = spool ? Drive{} : read_drive(table, experiment);
  const bool along = table.has("along") || table.has("offset");
  if (along) cables.line = read_eyelets(table, geometry, {});
  const auto add_own = [&](const std::string& id) -> CableSettings& {
    CableSettings& cable = cables.cables.emplace_back();
    cable.id = id;
    for (const Eigen::VectorXd& point : own_cable(geometry, id)) cable.points.emplace_back(point.begin(), point.end());
    return cable;
  };
  for (TableReader& one : table.tables("cable")) {
    const std::string id = one.text("id");
    for (const CableSettings& other : cables.cables) {
      if (other.id == id) one.fail("id", fmt::format("the cable '{}' is there already; choose another id", id));
    }
    const bool driven = one.has("retraction") || one.has("tension") || one.has("spool");
    const Drive drive = driven ? read_drive(one, experiment, spool) : common;
    CableSettings* cable = nullptr;
    if (along || one.has("along") || one.has("offset")) {
      cable = &cables.cables.emplace_back();
      cable->id = id;
      cable->line = read_eyelets(one, geometry, cables.line.value_or(EyeletLine{}));
      cable->start_fixed = false;
      for (const char* key : {"along", "offset", "angle"}) {
        if (one.has(key) || !cables.line) cable->own_line.emplace_back(key);
      }
    } else if (!own.empty() && !one.has("x")) {
      if (std::find(own.begin(), own.end(), id) == own.end())
        one.fail("id", fmt::format("'{}' has no points; the module's own cables are {}, others need x and y", id,
                                   join(own, " and ")));
      cable = &add_own(id);
    } else {
      cable = &cables.cables.emplace_back();
      cable->id = id;
      read_cable_points(one, geometry.dimension, {"start", "end", "both", "none"}, *cable);
    }
    drive_by(drive, *cable);
    if (one.has("k") || one.has("slack")) {
      if (cable->held) one.fail(one.has("k") ? "k" : "slack", "a cable whose tension is held has no law; leave it out");
      CableLaw law;
      law.slack = cables.slack;
      law.smoothing = cables.smoothing;
      cable->own = law;
      read_cable_law(one, *cable->own, false);
    }
    one.finish();
  }
  if (cables.cables.empty()) {
    for (const std::string& id : own) drive_by(common, add_own(id));
  }
  const auto takes_common = [&](const CableSettings& cable) { return cable.control == common.control; };
  if (!common.control.empty() && std::ranges::none_of(cables.cables, takes_common))
    table.fail(common.held ? "tension" : "retraction",
               fmt::format("every cable has a {} of its own, so this one moves nothing; remove it",
                           common.held ? "drive" : "retraction"));
  if (cables.cables.empty()) table.fail("", "there is no cable; add [[cables.cable]] with id, x and y");
  read_laws(table, cables);
  table.finish();
}

/// [base]: how the body stands at the bench, turned and shifted.
void read_base(TableReader table, Experiment& experiment) {
  const size_t d = static_cast<size_t>(experiment.geometry.dimension);
  if (table.has("turn")) experiment.base_turn = table.quantities("turn", Quantity::angle, d == 2 ? 1 : 3);
  if (table.has("at")) experiment.base_at = table.quantities("at", Quantity::length, d);
  table.finish();
}

void read_contact(TableReader table, Experiment& experiment) {
  SurfaceSettings& contact = experiment.contact;
  contact.on = table.boolean("on", true);
  if (!contact.on) return table.finish();  // keys that would have no effect are refused
  const int dimension = experiment.geometry.dimension;
  const bool closes = experiment.geometry.shape->defaults().contact;
  if (dimension != 2 && !closes)
    table.fail("", "contact is for 2D geometries, and modules whose lips close; remove [contact]");
  if (closes) contact.compensate = table.boolean("compensate", true);
  if (dimension == 3) {
    read_surroundings(table, experiment, Language::bench, contact);
    return table.finish();
  }
  contact.form = table.choice<ContactForm>("form", {{"length_weighted", ContactForm::length_weighted},
                                                    {"pair_sum", ContactForm::pair_sum},
                                                    {"pair_sum_dedup", ContactForm::pair_sum_dedup}});
  if (contact.form != ContactForm::length_weighted) {
    contact.stiffness = table.positive("stiffness", Quantity::stiffness, "stiffness");
  } else if (table.has("stiffness")) {
    table.fail("stiffness", "the barrier's stiffness is set from materials and loads; only the pair sums take one");
  }
  contact.bracketed = table.choice<bool>("friction", {{"none", false}, {"bracket", true}});
  read_surroundings(table, experiment, Language::bench, contact);
  table.finish();
}

void read_fit(TableReader table, Experiment& experiment) {
  const BenchKind& kind = *experiment.kind;
  for (auto& [id, free] : table.named_tables("free")) {
    experiment.free.push_back(
        {id, free.optional_given("start"), free.optional_given("lower"), free.optional_given("upper")});
    if (free.has("per")) {
      experiment.free.back().per_specimen = free.choice<bool>("per", {{"specimen", true}});
      if (experiment.specimens.empty() && experiment.set_by.size() != 1)
        free.fail("per",
                  experiment.set_by.empty()
                      ? "the bench has one specimen; name what sets others ([bench] set or specimen), or leave this out"
                      : "several columns set dimensions; name the specimens in one column ([bench] specimen) instead");
    }
    const std::vector<std::string> set = ids_set_by_columns(experiment);
    if (std::ranges::find(set, id) != set.end())
      free.fail("", fmt::format("'{}' is set by a column of the bench; take this table out", id));
    free.finish();
  }
  if (kind.specimen) experiment.all_profiles = table.choice<bool>("profiles", {{"doubtful", false}, {"all", true}});
  experiment.robust = table.choice<bool>("robust", {{"none", false}, {"student", true}});
  if (kind.at_rest) experiment.mesh_share = table.boolean("mesh_share", true);
  if (auto diagnostic = kind.specimen ? table.optional_table("diagnostic") : std::nullopt) {
    experiment.diagnostic =
        DiagnosticSettings{known_id(*diagnostic, "parameter", ids_of(experiment.free), "a free parameter of the fit"),
                           control_named(*diagnostic, "per", experiment)};
    diagnostic->finish();
  }
  for (TableReader& one : table.tables("variant")) {
    VariantSettings& variant = experiment.variants.emplace_back();
    variant.name = one.text("name");
    if (std::ranges::count(experiment.variants, variant.name, &VariantSettings::name) > 1)
      one.fail("name", fmt::format("the variant '{}' is there already; choose another name", variant.name));
    variant.mesh = experiment.mesh;
    if (kind.read_variant != nullptr)
      kind.read_variant(one, experiment, variant);
    else
      read_mesh(one, experiment.geometry, variant.mesh);
    if (experiment.model == Rung::rod && one.has("rod_section")) {
      one.choice("rod_section", section_laws());
      variant.law = one.text("rod_section");
    }
    if (kind.at_rest) {
      for (const std::string& id : one.texts_or_none("free")) {
        if (std::ranges::find(experiment.free, id, &FreeSettings::id) != experiment.free.end())
          one.fail("free", fmt::format("'{}' is free in every fit; name further parameters", id));
        if (std::ranges::find(variant.free, id, &FreeSettings::id) != variant.free.end())
          one.fail("free", fmt::format("'{}' stands twice; name it once", id));
        variant.free.push_back({id, {}, {}, {}});
      }
    }
    one.finish();
  }
  for (TableReader& one : table.tables("reference")) {
    ReferenceValue reference;
    reference.parameter = one.text("parameter");
    if (!one.has("value")) one.fail("", "'value' is missing; add the published value with its unit");
    reference.value = *one.optional_given("value");
    reference.source = one.text("source");
    one.finish();
    experiment.references.push_back(reference);
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
  experiment.threads = table.integer("threads", 0, 0, 1024);
  table.finish();
}

void read_model(TableReader& root, Experiment& experiment) {
  experiment.model = root.choice("model", rungs());
  if (root.has("rod_section")) {
    if (experiment.model != Rung::rod)
      root.fail("rod_section", "it is what a rod's section resists with; set model = \"rod\", or leave it out");
    experiment.rod_section = root.choice("rod_section", section_laws());
  }
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

/// Whether cables rub, and in a model that knows how. Where nothing says so they do not, and cost nothing.
void read_friction(Experiment& experiment) {
  CablesSettings& cables = experiment.cables;
  const auto frees = [](const std::vector<FreeSettings>& free) {
    return std::ranges::any_of(
        free, [](const FreeSettings& one) { return one.id == "cable_friction" || one.id == "cable_misalignment"; });
  };
  const bool asked = cables.friction != 0 || frees(experiment.free) ||
                     std::ranges::any_of(experiment.variants, frees, &VariantSettings::free) ||
                     experiment.tolerances.contains("cables.friction");
  const auto refuse = [&](std::string_view key, const std::string& why) {
    throw InputError(fmt::format("{}: [cables] {}: {}", experiment.path, key, why));
  };
  const auto held = std::ranges::find_if(cables.cables, &CableSettings::held);
  const bool rod = experiment.model == Rung::rod;
  if (cables.misalignment != 0 && (rod || !asked))
    refuse("misalignment", rod ? "a rod's tendons have eyelets all along and know no such angle; leave it out"
                               : "it has no effect without friction; add 'friction', or leave it out");
  if (!asked) return;
  if (rod && held == cables.cables.end())
    refuse("friction",
           "it is that of cables whose tension is held, and none is; give them a 'tension', or leave it out");
  if (rod) return;
  if (experiment.model == Rung::beam || experiment.model == Rung::automatic)
    refuse("friction", fmt::format("the model \"{}\" has no friction of cables; set model = \"full\", or leave "
                                   "'friction' and the free parameter 'cable_friction' out",
                                   name_of(experiment.model)));
  if (held != cables.cables.end())
    refuse("friction", fmt::format("the model \"{}\" has friction of cables that are retracted, and '{}' is held at a "
                                   "tension; set model = \"rod\", or leave 'friction' and the free parameter "
                                   "'cable_friction' out",
                                   name_of(experiment.model), held->id));
  if (!experiment.kind->at_rest) refuse("friction", "recordings over time have no friction of cables; leave it out");
  if (cables.cables.empty())
    refuse("friction", "there is no cable that could rub; leave the free parameter 'cable_friction' out");
  if (experiment.remembers())
    refuse("friction", "stresses relax (prony), and what both do together is not known here; take one of them out");
  cables.rub = true;
}

/// Settings that are right in themselves but change nothing here.
void refuse_without_effect(const Experiment& experiment) {
  const bool gap = experiment.mesh.contact_gap > 0 ||
                   std::any_of(experiment.variants.begin(), experiment.variants.end(),
                               [](const VariantSettings& variant) { return variant.mesh.contact_gap > 0; });
  if (gap && !experiment.contact.on)
    throw InputError(
        fmt::format("{}: contact_gap has no effect without contact; add [contact] or remove it", experiment.path));
  const bool elements =
      experiment.model != Rung::beam && experiment.model != Rung::rod && experiment.model != Rung::automatic;
  if (experiment.contact.bracketed) {
    const std::string where = experiment.path + ": [contact] friction = \"bracket\": ";
    if (experiment.model != Rung::full && experiment.model != Rung::rigid_segments)
      throw InputError(where + fmt::format("the model \"{}\" has no lips that could stick; set model = \"full\" or "
                                           "\"rigid_segments\", or leave it out",
                                           name_of(experiment.model)));
    if (!experiment.kind->at_rest || experiment.cables.columns.empty() || experiment.has_specimens())
      throw InputError(where +
                       "it compares readings at rest of one specimen that is closed by a 'retraction' of its "
                       "cables before loads hang; leave it out");
  }
  if (!experiment.studs.studs.empty() && !elements)
    throw InputError(fmt::format(
        "{}: [[stud]] '{}': the model \"{}\" has no play of studs; set model = \"full\", or leave the studs out",
        experiment.path, experiment.studs.studs.front().id, name_of(experiment.model)));
  const bool zero = std::any_of(experiment.free.begin(), experiment.free.end(),
                                [](const FreeSettings& free) { return free.id.starts_with("zero_"); });
  if (!experiment.zero_offset_per.empty() && !zero) {
    throw InputError(
        fmt::format("{}: [bench] zero_offset_per: all zero errors stay 0; free some of them, for example "
                    "[fit.free.zero_1], or remove the key",
                    experiment.path));
  }
}

/// What stands in files of all benches with a specimen, but for [bench] and [fit].
void read_specimen(TableReader& root, Experiment& experiment) {
  read_model(root, experiment);
  std::vector<std::string> others;
  for (const BenchKind* kind : bench_kinds) {
    if (!kind->specimen) others.emplace_back(kind->name);
  }
  experiment.geometry = read_geometry(root.table("geometry"), experiment.path, others);
  experiment.dimension = experiment.geometry.dimension;
  if (auto mesh = root.optional_table("mesh")) {
    read_mesh(*mesh, experiment.geometry, experiment.mesh);
    mesh->finish();
  } else if (refinable(experiment.geometry)) {
    root.table("mesh");  // says that it is missing
  }
  experiment.materials = read_materials(root);
  if (auto base = root.optional_table("base")) read_base(*base, experiment);
  if (auto gravity = root.optional_table("gravity")) read_gravity(*gravity, experiment);
  for (TableReader& table : root.tables("support")) read_support(table, experiment);
  for (TableReader& table : root.tables("load"))
    experiment.loads.push_back(read_load(table, experiment, Language::bench));
  if (auto cables = root.optional_table("cables")) read_cables(*cables, experiment);
  read_studs(root, experiment, Language::bench);
  std::vector<BenchFormat::Control>& controls = experiment.bench.controls;
  for (const LoadSettings& load : experiment.loads) {
    if (!load.column.empty()) controls.push_back({load.id, load.column, {load.quantity}});
  }
  for (const SupportSettings& support : experiment.supports) {
    if (!support.control.empty()) controls.push_back({support.control, support.column, {Quantity::length}});
  }
  for (const auto& [id, column] : experiment.cables.columns) controls.push_back({id, column, {Quantity::length}});
  for (const auto& [id, column] : experiment.cables.tension_columns)
    controls.push_back({id, column, {Quantity::force, Quantity::torque}, true});
  experiment.contact.on = experiment.geometry.shape->defaults().contact;
  if (auto contact = root.optional_table("contact")) read_contact(*contact, experiment);
  const bool may_be_held = !experiment.cables.cables.empty() || !experiment.studs.studs.empty() ||
                           !experiment.contact.grounds.empty() || !experiment.contact.obstacles.empty();
  if (experiment.supports.empty() && !may_be_held) {
    root.fail("",
              "there is no support; add [[support]] with on = \"TAG\" and fix = [\"x\", \"y\"], or cables, studs or "
              "grounds that hold the body");
  }
  for (TableReader& table : root.tables("channel")) read_channel(table, experiment);
  for (TableReader& table : root.tables("marker")) read_marker(table, experiment);
  if (experiment.channels.empty())
    root.fail("", "there is no channel; add [[channel]] for what is measured, with id, point or on, and direction");
  // Loads without a column are no controls; a retraction may have several cables.
  std::vector<std::string> held;
  for (const LoadSettings& load : experiment.loads) {
    if (load.column.empty()) held.push_back(load.id);
  }
  refuse_repeated(experiment.path, {ids_of(controls), held, ids_of(experiment.channels)},
                  "loads, supports and channels");
}

/// The kind that a file names: in [geometry] where there is no specimen, else in [bench].
const BenchKind& kind_of(const TomlFile& file) {
  std::vector<std::pair<std::string, const BenchKind*>> kinds;
  for (const BenchKind* kind : bench_kinds) {
    if (kind->specimen) kinds.emplace_back(kind->name, kind);
    if (!kind->specimen && file.text_at("geometry", "kind") == kind->name) return *kind;
  }
  return file.has("bench") ? *file.root().table("bench").choice("kind", kinds) : *kinds.front().second;
}

/// The files of readings, with the names of their copies in a run folder; the paths may be changed.
std::vector<std::pair<std::string*, std::string>> readings_of(Experiment& experiment) {
  if (experiment.kind->readings != nullptr) return experiment.kind->readings(experiment);
  return {{&experiment.bench.path, "data.csv"}};
}

}  // namespace

namespace {

/// Columns whose unit decides what the model is (a force or a mass, say) and is not in their names.
std::vector<std::string> columns_without_unit(TableReader root) {
  std::vector<std::string> columns;
  const auto add = [&](TableReader& table, std::string_view key) {
    const std::string column = table.text(key, "");
    if (!column.empty() && !unit_in_header(column)) columns.push_back(column);
  };
  for (TableReader& load : root.tables("load")) add(load, "column");
  if (auto cables = root.optional_table("cables")) {
    std::vector<TableReader> drives = cables->tables("cable");
    drives.push_back(*cables);
    for (TableReader& drive : drives) {
      add(drive, "retraction");
      if (!is_quantity(drive.text("tension", ""))) add(drive, "tension");
    }
  }
  return columns;
}

void read_tables(TableReader& root, Experiment& experiment) {
  experiment.title = root.text("title");
  root.text("data");
  experiment.simulated = root.choice<bool>("data", {{"measured", false}, {"simulated", true}});
  if (experiment.kind->specimen) read_specimen(root, experiment);
  experiment.kind->read(root, experiment);
  if (auto fit = root.optional_table("fit")) read_fit(*fit, experiment);
  if (experiment.kind->specimen) {
    if (auto solver = root.optional_table("solver")) read_solver(*solver, experiment);
    if (auto figures = root.optional_table("figures")) read_figures(*figures, experiment);
    refuse_without_effect(experiment);
  }
}

/// The experiment in a file at `path`. `readings`: the bench file; "": where the experiment's file says.
Experiment read_with_readings(const TomlFile& file, const std::string& path, std::string readings) {
  if (file.has("simulation"))
    throw InputError(
        fmt::format("{0}: this file describes a simulation, without a bench; run `taut simulate {0}`", path));
  TableReader root = file.root();
  Experiment experiment;
  experiment.path = path;
  experiment.encoding = file.remark();
  experiment.kind = &kind_of(file);
  if (const std::string named = file.text_at("bench", "file"); readings.empty() && !named.empty())
    readings = path_beside(path, named);
  const std::vector<std::string> columns = columns_without_unit(file.root());
  if (experiment.kind->at_rest && !columns.empty() && fs::is_regular_file(readings))
    experiment.titles = titles_in_file(readings, columns);
  try {
    read_tables(root, experiment);
  } catch (const InputError&) {
    root.refuse_misspelt();
    throw;
  }
  root.finish();
  experiment.tolerances = file.tolerances();
  if (experiment.kind->specimen) read_friction(experiment);
  if (!experiment.kind->at_rest && !experiment.tolerances.empty())
    throw InputError(experiment.tolerances.begin()->second.where +
                     ": a tolerance counts in fits of readings at rest only; give the value alone");
  return experiment;
}

/// What a mesh or geometry is called in a run's folder: its ending tells what it is.
std::string mesh_copy(const std::string& mesh) {
  return "mesh" + fs::path(mesh).extension().string();
}

}  // namespace

Experiment read_experiment(const std::string& path) {
  return read_with_readings(TomlFile(path), path, "");
}

Experiment read_experiment_text(const std::string& path, std::string_view text) {
  Experiment experiment = read_with_readings(TomlFile(path, text), path, "");
  experiment.text = text;
  return experiment;
}

std::vector<RunInput> inputs_of(const Experiment& experiment) {
  std::vector<RunInput> files{{experiment.path, "experiment.toml", experiment.text}};
  Experiment own = experiment;
  for (const auto& [path, copy] : readings_of(own)) files.push_back({*path, copy});
  const std::string mesh = input_file(experiment.geometry);
  if (mesh.empty()) return files;
  files.push_back({mesh, mesh_copy(mesh)});
  // What it takes in lies beside the copy as it lies beside the file.
  for (const std::string& merged : merged_files(mesh)) {
    if (fs::path(merged).is_absolute()) continue;  // is found from anywhere
    const bool below = *fs::path(merged).begin() != "..";
    const bool free = std::ranges::find(files, merged, &RunInput::copy) == files.end();
    if (!below || !free)
      throw InputError(fmt::format(
          "{}: it takes in '{}', which {}, so that the run could not be predicted from later; {}, or save the mesh as "
          ".msh and fit with that",
          mesh, merged, below ? "has the name of another copy in the run's folder" : "does not lie beside or below it",
          below ? "rename it" : "put it there, name it by its whole path"));
    files.push_back({(fs::path(mesh).parent_path() / merged).string(), merged});
  }
  return files;
}

Experiment read_copies(const std::string& folder) {
  const auto in_folder = [&](const std::string& name) { return (fs::path(folder) / name).string(); };
  const std::string file = in_folder("experiment.toml");
  Experiment experiment = read_with_readings(TomlFile(file), file, in_folder("data.csv"));
  for (const auto& [path, copy] : readings_of(experiment)) *path = in_folder(copy);
  if (const std::string mesh = input_file(experiment.geometry); !mesh.empty())
    set_input_file(experiment.geometry, in_folder(mesh_copy(mesh)));
  return experiment;
}

}  // namespace taut

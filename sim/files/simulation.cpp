#include "sim/files/simulation.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "sim/core/error.hpp"
#include "sim/files/geometry_file.hpp"
#include "sim/files/tables.hpp"
#include "sim/robots/robot_ik.hpp"
#include "sim/scene/channel_kinds.hpp"

namespace taut {
namespace {

constexpr double max_steps = 1e6;  // all states are kept
/// What every simulation records.
const std::vector<std::string> own_series{"time", "kinetic_energy", "potential_energy"};

/// The id of a control of the given quantity.
std::string control_of(TableReader& table, std::string_view key, const Simulation& simulation, Quantity quantity) {
  const std::string id = known_id(table, key, ids_of(simulation.controls), "a [[control]]");
  if (control_quantity(simulation, id) != quantity)
    table.fail(key, fmt::format("control '{}' is not {} {}; its start says what it is", id,
                                quantity == Quantity::angle ? "an" : "a", name_of(quantity)));
  return id;
}

void read_method(TableReader table, Simulation& simulation) {
  using Method = SimulationMethod;
  simulation.method = table.choice<Method>("integrator", {{"implicit_euler", Method::implicit_euler},
                                                          {"bdf2", Method::bdf2},
                                                          {"static", Method::quasi_static},
                                                          {"cvode", Method::cvode},
                                                          {"arkode_implicit", Method::arkode_implicit},
                                                          {"arkode_explicit", Method::arkode_explicit}});
  simulation.duration = table.positive("duration", Quantity::time, "duration");
  simulation.step = table.quantity("step", Quantity::time);
  if (!(simulation.step > 0 && simulation.step <= simulation.duration))
    table.fail("step", "the step must be positive and not longer than the duration");
  if (simulation.duration / simulation.step > max_steps)
    table.fail("duration", fmt::format("{:.3g} steps are too many; at most {:.0e} are allowed",
                                       simulation.duration / simulation.step, max_steps));
  simulation.tolerance = table.optional_quantity("tolerance", Quantity::pure).value_or(0);
  if (simulation.tolerance < 0 || simulation.tolerance > 0.1)
    table.fail("tolerance", "a number from 0 (fixed steps) to 0.1 belongs here, relative to the size of the scene");
  simulation.from_equilibrium = table.choice("start", {"rest", "equilibrium"}) == "equilibrium";
  simulation.frames = table.integer("frames", simulation.frames, 2);
  simulation.rigid_segments = table.choice("model", {"full", "rigid_segments"}) == "rigid_segments";
  simulation.mass = read_mass_form(table);
  simulation.dimension = table.integer("dimension", 2, 2);
  if (simulation.dimension > 3) table.fail("dimension", "2 or 3 belongs here");
  if (simulation.dimension == 2) read_plane(table, simulation.thickness, simulation.plane);
  if (auto gravity = table.optional_quantity("gravity", Quantity::acceleration)) {
    simulation.gravity = *gravity;
    if (!(*gravity > 0)) table.fail("gravity", "the acceleration must be positive; 'direction' says where to");
    simulation.gravity_direction = direction_of(table, simulation.dimension);
  }
  if (simulation.rigid_segments &&
      (simulation.method == Method::cvode || simulation.method == Method::arkode_implicit ||
       simulation.method == Method::arkode_explicit))
    table.fail("model",
               "SUNDIALS' integrators know no rigid segments; set integrator = \"implicit_euler\" or \"bdf2\"");
  EquilibriumOptions& options = simulation.equilibrium;
  options.max_iterations = table.integer("max_iterations", 60, 1);
  table.finish();
}

void read_body(TableReader& table, Simulation& simulation) {
  BodySettings body;
  body.name = table.text("name");
  if (body.name == "world" || body.name.find('.') != std::string::npos)
    table.fail("name", "a body must not be called 'world', and names have no dots");
  for (const BodySettings& other : simulation.bodies) {
    if (other.name == body.name)
      table.fail("name", fmt::format("the body '{}' is there already; choose another name", body.name));
  }
  const size_t d = static_cast<size_t>(simulation.dimension);
  body.geometry = read_geometry(table.table("geometry"), simulation.path, {}, false);
  if (body.geometry.dimension != simulation.dimension)
    table.fail("geometry", fmt::format("a {}D body in a {}D simulation; set dimension in [simulation]",
                                       body.geometry.dimension, simulation.dimension));
  TableReader mesh = table.table("mesh");
  read_mesh(mesh, body.geometry, body.mesh);
  mesh.finish();
  if (!simulation.bodies.empty() && simulation.bodies[0].mesh.formulation != body.mesh.formulation)
    table.fail("mesh", "all bodies have one formulation, since they may share materials; give them the same");
  body.at = table.has("at") ? table.quantities("at", Quantity::length, d) : std::vector<double>(d, 0.0);
  if (table.has("mirror")) body.mirrored = component_of(table, "mirror", table.text("mirror"), simulation.dimension);
  body.angle = table.optional_quantity("turned", Quantity::angle).value_or(0);
  if (d == 3 && table.has("turn")) body.turn = table.quantities("turn", Quantity::angle, 3);
  if (table.has("velocity")) body.velocity = table.quantities("velocity", Quantity::speed, d);
  for (const std::string& tag : table.texts_or_none("clamped"))
    body.fixed.emplace_back(tag, d == 2 ? std::vector<int>{0, 1} : std::vector<int>{0, 1, 2});
  table.finish();
  simulation.bodies.push_back(std::move(body));
}

void read_control(TableReader& table, Simulation& simulation) {
  ControlSettings control;
  control.id = table.text("id");
  const std::string start = table.text("start");
  control.quantity = quantity_of(
      table, "start", start,
      {Quantity::length, Quantity::angle, Quantity::force, Quantity::mass, Quantity::pressure, Quantity::line_load});
  ControlSchedule schedule(parse_quantity(start, control.quantity, table.where("start")));
  for (TableReader& one : table.tables("piece")) {
    ControlSchedule::Piece piece;
    piece.until = one.quantity("until", Quantity::time);
    const std::string kind = one.choice("kind", {"smooth", "linear", "hold", "sine"});
    if (kind == "sine") {
      piece.kind = ControlSchedule::Kind::sine;
      piece.amplitude = one.quantity("amplitude", control.quantity);
      piece.frequency = 1 / one.positive("period", Quantity::time, "period");
      piece.phase = one.optional_quantity("phase", Quantity::angle).value_or(0);
    } else if (kind != "hold") {
      piece.kind = kind == "linear" ? ControlSchedule::Kind::linear : ControlSchedule::Kind::smooth;
      piece.target = one.quantity("to", control.quantity);
    }
    try {
      schedule.add(piece);
    } catch (const InputError& error) {
      one.fail("until", error.what());
    }
    one.finish();
  }
  table.finish();
  if (control.quantity == Quantity::mass) {
    // Between the ends of its pieces only a sine can go below them.
    for (int i = 0; i <= 1000; ++i) {
      if (schedule.at(simulation.duration * i / 1000) < 0)
        table.fail("", fmt::format("the mass '{}' becomes negative; give zero or more", control.id));
    }
  }
  simulation.controls.push_back(std::move(control));
  simulation.schedules.push_back(std::move(schedule));
}

/// A roller, or a face that a control moves.
void read_support(TableReader& table, Simulation& simulation) {
  const int d = simulation.dimension;
  SupportSettings support;
  support.on = table.text("on");
  for (const std::string& name : table.texts_or_none("fix")) support.fix.push_back(component_of(table, "fix", name, d));
  if (table.has("move")) {
    support.component = component_of(table, "move", table.text("move"), d);
    support.control = control_of(table, "control", simulation, Quantity::length);
  }
  if (support.fix.empty() && support.control.empty())
    table.fail("", "a support needs 'fix' (a list of components) or 'move' (one of them) with 'control'");
  table.finish();
  simulation.supports.push_back(std::move(support));
}

void read_cable(TableReader& table, Simulation& simulation) {
  CableSettings cable;
  cable.id = table.text("id");
  cable.body = known_id(table, "body", body_names(simulation), "a [[body]]");
  if (table.has("x")) {
    read_cable_points(table, simulation.dimension, {"none", "start", "end", "both"}, cable);
  } else if (table.has("along")) {
    const auto body = std::ranges::find(simulation.bodies, cable.body, &BodySettings::name);
    cable.line = read_eyelets(table, body->geometry, {});
    cable.start_fixed = false;
  } else {
    cable.path = table.text("path");  // one of the geometry's own
    cable.start_fixed = table.boolean("anchored", false);
  }
  cable.held = table.has("tension");
  if (cable.held) {
    if (table.has("retraction"))
      table.fail("tension", "a cable is driven by its retraction or by its tension; give one of them");
    const std::string given = table.text("tension");
    if (is_quantity(given)) {
      cable.tension = parse_quantity(given, Quantity::force, table.where("tension"));
      if (cable.tension < 0) table.fail("tension", "a cable cannot push; a tension is zero or more");
    } else {
      cable.control = control_of(table, "tension", simulation, Quantity::force);
    }
  } else {
    read_cable_law(table, cable.own.emplace(), false);
    if (table.has("retraction")) cable.control = control_of(table, "retraction", simulation, Quantity::length);
  }
  table.finish();
  simulation.cables.cables.push_back(std::move(cable));
}

void read_joint(TableReader& table, Simulation& simulation) {
  JointSettings joint;
  const size_t d = static_cast<size_t>(simulation.dimension);
  joint.id = table.text("id");
  const std::vector<std::string> between = table.texts("between");
  std::vector<std::string> bodies = body_names(simulation);
  bodies.emplace_back("world");
  if (between.size() != 2 || between[0] == between[1])
    table.fail("between", "two different bodies belong here, the first of which may be \"world\"");
  for (const std::string& body : between) check_id(table, "between", body, bodies, "a [[body]]");
  if (between[1] == "world") table.fail("between", "the world comes first");
  joint.part_a = between[0];
  joint.part_b = between[1];
  const auto point = [&](std::string_view key) { return vector_of(table.quantities(key, Quantity::length, d)); };
  joint.pivot = point("at");
  if (d == 3) joint.axis_end = point("axis_end");
  joint.radius = table.optional_quantity("radius", Quantity::length).value_or(0);
  joint.stiffness = table.optional_quantity("stiffness", Quantity::stiffness).value_or(0);
  if (table.has("angle")) {
    joint.control = control_of(table, "angle", simulation, Quantity::angle);
    joint.motor = point("motor_at");
  }
  table.finish();
  simulation.joints.push_back(std::move(joint));
}

void read_contact(TableReader table, Simulation& simulation) {
  SurfaceSettings& contact = simulation.contact;
  contact.on = true;
  contact.gap = table.positive("gap", Quantity::length, "contact gap");
  contact.friction = table.optional_quantity("friction", Quantity::pure);
  if (contact.friction && !(*contact.friction >= 0 && *contact.friction <= 10))
    table.fail("friction",
               "a coefficient of friction from 0 (which can be changed as contact_friction) to 10 belongs here");
  if (auto pressures = table.optional_table("pressure")) {
    pressures->keys_are_ids();
    for (const MaterialSettings& material : simulation.materials) {
      if (const auto value = pressures->optional_positive(material.region, Quantity::pressure, "pressure"))
        contact.pressure[material.region] = *value;
    }
    pressures->finish();
  }
  read_surroundings(table, simulation, Language::simulation, contact);
  std::vector<std::string> names = body_names(simulation);
  const auto take = [&](const std::string& name) {
    if (name.empty()) return;
    if (std::ranges::find(names, name) != names.end())
      table.fail("",
                 fmt::format("two bodies, grounds or obstacles are called '{}'; give each a name of its own", name));
    names.push_back(name);
  };
  for (const GroundSettings& ground : contact.grounds) take(ground.name);
  for (const std::string& name : contact.obstacle_names) take(name);
  table.finish();
}

void read_channel(TableReader& table, Simulation& simulation) {
  ChannelSettings channel = read_channel(table, simulation, Language::simulation);
  const ChannelKind& kind = *channel.kind;
  const SimulationMethod method = simulation.method;
  if (kind.known == ChannelKind::Known::at_rest && method != SimulationMethod::quasi_static)
    table.fail("kind", fmt::format("a {} {}; set integrator = \"static\", or take a net_force", kind.name, kind.why));
  if (kind.known == ChannelKind::Known::in_steps && method != SimulationMethod::implicit_euler &&
      method != SimulationMethod::bdf2)
    table.fail("kind", fmt::format("a {} {}, which only implicit_euler and bdf2 hand out", kind.name, kind.why));
  table.finish();
  simulation.channels.push_back(std::move(channel));
}

void read_workspace(TableReader table, Simulation& simulation) {
  WorkspaceSettings workspace;
  workspace.x = known_id(table, "x", ids_of(simulation.channels), "a [[channel]]");
  workspace.y = known_id(table, "y", ids_of(simulation.channels), "a [[channel]]");
  for (const ChannelSettings& channel : simulation.channels) {
    if ((channel.id == workspace.x || channel.id == workspace.y) && !channel.kind->is_place())
      table.fail("x", fmt::format("'{}' is not a position or displacement, which span a workspace", channel.id));
  }
  workspace.samples = table.integer("samples", 200, 3, 1'000'000);
  for (TableReader& one : table.tables("mode")) {
    WorkspaceMode mode;
    mode.name = one.text("name");
    one.keys_are_ids();
    for (const ControlSettings& control : simulation.controls) {
      if (!one.has(control.id)) continue;
      const std::vector<double> range = one.quantities(control.id, control.quantity, 2);
      mode.ranges[control.id] = {range[0], range[1]};
    }
    if (mode.ranges.empty())
      one.fail("", "no control moves in this mode; add for example left1 = [\"0 mm\", \"5 mm\"]");
    one.finish();
    workspace.modes.push_back(std::move(mode));
  }
  if (workspace.modes.empty()) table.fail("", "there is no mode; add [[workspace.mode]] with name and ranges");
  table.finish();
  simulation.workspace = std::move(workspace);
}

/// One target, or a path: lists of values, through which the controls go from point to point.
IkTarget read_ik_target(TableReader& one, const Simulation& simulation, const IkSettings& ik, bool path) {
  IkTarget target;
  target.name = one.text("name");
  one.keys_are_ids();
  for (const ChannelSettings& channel : simulation.channels) {
    const std::optional<Quantity> quantity = target_quantity(channel);
    if (!quantity) continue;
    if (one.has(channel.id))
      target.values[channel.id] =
          path ? one.quantities(channel.id, *quantity, 0) : std::vector<double>{one.quantity(channel.id, *quantity)};
    if (quantity != Quantity::length) continue;
    const std::string key = "stiffness_" + channel.id;
    if (const auto value = one.optional_positive(key, Quantity::stiffness, "stiffness")) {
      if (!target.stiffness_of.empty()) one.fail(key, "one stiffness per target is allowed; leave the other one out");
      target.stiffness_of = channel.id;
      target.stiffness = *value;
    }
  }
  for (const IkRange& control : ik.controls) {
    if (const auto value = one.optional_quantity("hold_" + control.id, control_quantity(simulation, control.id)))
      target.hold[control.id] = *value;
  }
  if (target.hold.size() == ik.controls.size()) one.fail("", "all controls are held; leave one free at least");
  if (target.values.empty()) one.fail("", "a target needs the value of a channel, for example tip_x = \"150 mm\"");
  for (const auto& [id, values] : target.values) {
    if (values.size() != target.values.begin()->second.size() || values.empty())
      one.fail(id, "all channels of a path need as many values, one at least");
  }
  one.finish();
  return target;
}

void read_ik(TableReader table, Simulation& simulation) {
  IkSettings ik;
  for (auto& [id, one] : table.named_tables("control")) {
    const std::vector<std::string> ids = ids_of(simulation.controls);
    check_id(one, "", id, ids, "a [[control]]");
    const Quantity quantity = control_quantity(simulation, id);
    IkRange control{id, one.quantity("lower", quantity), one.quantity("upper", quantity), 0};
    if (!(control.lower < control.upper)) one.fail("upper", "the upper bound must be above the lower one");
    const auto place = static_cast<size_t>(std::find(ids.begin(), ids.end(), id) - ids.begin());
    control.nominal = one.optional_quantity("nominal", quantity)
                          .value_or(std::clamp(simulation.schedules[place].at(0), control.lower, control.upper));
    if (!(control.nominal >= control.lower && control.nominal <= control.upper))
      one.fail("nominal", "the nominal value must be within the bounds");
    one.finish();
    ik.controls.push_back(control);
  }
  if (ik.controls.empty()) table.fail("", "no control is free; add [ik.control.ID] with lower and upper");
  ik.tolerance = table.optional_quantity("tolerance", Quantity::length).value_or(ik.tolerance);
  for (TableReader& one : table.tables("target")) ik.targets.push_back(read_ik_target(one, simulation, ik, false));
  for (TableReader& one : table.tables("path")) ik.targets.push_back(read_ik_target(one, simulation, ik, true));
  if (ik.targets.empty()) table.fail("", "there is no target; add [[ik.target]] with name and the value of a channel");
  table.finish();
  simulation.ik = std::move(ik);
}

OptimiseRange read_optimise_range(TableReader& one, const std::string& id, const Simulation& simulation) {
  const std::vector<std::string> ids = ids_of(simulation.controls);
  check_id(one, "", id, ids, "a [[control]]");
  const Quantity quantity = control_quantity(simulation, id);
  OptimiseRange range{id, one.quantity("lower", quantity), one.quantity("upper", quantity),
                      one.optional_positive("change", quantity, "change that costs 1")};
  if (!(range.lower < range.upper)) one.fail("upper", "the upper bound must be above the lower one");
  if (quantity == Quantity::mass && range.lower < 0) one.fail("lower", "a mass is zero or more");
  for (const CableSettings& cable : simulation.cables.cables) {
    if (cable.held && cable.control == id && range.lower < 0)
      one.fail("lower", "a cable cannot push; a tension is zero or more");
  }
  const auto place = static_cast<size_t>(std::ranges::find(ids, id) - ids.begin());
  int free = 0;
  for (const ControlSchedule::Piece& piece : simulation.schedules[place].pieces()) {
    if (piece.kind == ControlSchedule::Kind::sine)
      one.fail("", fmt::format("control '{}' has a sine, which would leave the bounds; free controls have pieces of "
                               "kind \"smooth\", \"linear\" and \"hold\"",
                               id));
    if (!ControlSchedule::has_target(piece)) continue;
    ++free;
    if (!(piece.target >= range.lower && piece.target <= range.upper))
      one.fail("", fmt::format("control '{}' goes to {} in its piece that ends at {}, which is not within the bounds; "
                               "widen them, or let the search start within them",
                               id, with_unit(piece.target, units_of(quantity).front()), with_unit(piece.until, "s")));
  }
  if (free == 0)
    one.fail("", fmt::format("control '{}' has no piece with 'to', and so nothing that is free; add "
                             "[[control.piece]] with until and to",
                             id));
  one.finish();
  return range;
}

OptimiseGoal read_optimise_goal(TableReader& one, const Simulation& simulation) {
  using Aim = OptimiseGoal::Aim;
  OptimiseGoal goal;
  goal.channel = known_id(one, "channel", ids_of(simulation.channels), "a [[channel]]");
  const ChannelKind& kind = *std::ranges::find(simulation.channels, goal.channel, &ChannelSettings::id)->kind;
  if (kind.known == ChannelKind::Known::in_steps)
    one.fail("channel", fmt::format("'{}' is a {}, which depends on several states and can be no goal; take a channel "
                                    "of another kind",
                                    goal.channel, kind.name));
  const Quantity quantity = quantity_of_si_unit(kind.unit);
  goal.time = one.optional_quantity("time", Quantity::time).value_or(simulation.duration);
  if (!(goal.time > 0 && goal.time <= simulation.duration))
    one.fail("time", fmt::format("{} is not within the simulation; give a time after its start and up to its end at {}",
                                 with_unit(goal.time, "s"), with_unit(simulation.duration, "s")));
  goal.aim = one.choice<Aim>("aim", {{"maximise", Aim::maximise}, {"minimise", Aim::minimise}, {"reach", Aim::reach}});
  if (goal.aim == Aim::reach) goal.value = one.quantity("value", quantity);
  goal.scale = one.optional_positive("scale", quantity, "scale").value_or(goal.scale);
  one.finish();
  return goal;
}

void read_optimise(TableReader table, Simulation& simulation) {
  OptimiseSettings optimise;
  for (auto& [id, one] : table.named_tables("control"))
    optimise.controls.push_back(read_optimise_range(one, id, simulation));
  if (optimise.controls.empty()) table.fail("", "no control is free; add [optimise.control.ID] with lower and upper");
  for (TableReader& one : table.tables("goal")) optimise.goals.push_back(read_optimise_goal(one, simulation));
  if (optimise.goals.empty()) table.fail("", "there is no goal; add [[optimise.goal]] with channel and aim");
  optimise.iterations = table.integer("iterations", optimise.iterations, 1);
  optimise.tolerance = table.optional_positive("tolerance", Quantity::pure, "tolerance").value_or(optimise.tolerance);
  if (optimise.tolerance > 0.1) table.fail("tolerance", "a number above 0, up to 0.1, belongs here");
  table.finish();
  using enum SimulationMethod;
  const SimulationMethod method = simulation.method;
  if (method != quasi_static && method != implicit_euler && method != bdf2)
    table.fail("",
               "SUNDIALS' integrators give no gradients here; choose integrator = \"implicit_euler\", \"bdf2\" or "
               "\"static\"");
  if (simulation.remembers())
    table.fail("",
               "states depend on those before them (prony, friction), which the gradient of a goal does not "
               "follow; take them out to optimise");
  simulation.optimise = std::move(optimise);
}

/// Plots of series that will not be there, and controls that nothing listens to.
void refuse_without_effect(const Simulation& simulation) {
  std::vector<std::string> series = own_series;
  for (const std::vector<std::string>& ids : {ids_of(simulation.controls), ids_of(simulation.channels)})
    series.insert(series.end(), ids.begin(), ids.end());
  for (const RobotPlot& plot : simulation.plots) {
    std::vector<std::string> ids = plot.y;
    if (!plot.x.empty()) ids.push_back(plot.x);
    for (const std::string& id : ids) {
      if (std::find(series.begin(), series.end(), id) == series.end())
        throw InputError(fmt::format("{}: [plot] '{}': '{}' is neither a control nor a channel{}; allowed: {}",
                                     simulation.path, plot.id, id, did_you_mean(id, series), join(series)));
    }
  }
  std::vector<std::string> used;
  const auto use = [&](const auto& items) {
    for (const auto& item : items) used.push_back(item.control);
  };
  use(simulation.cables.cables);
  use(simulation.joints);
  use(simulation.loads);
  use(simulation.supports);
  use(simulation.contact.grounds);
  for (const ControlSettings& control : simulation.controls) {
    if (std::find(used.begin(), used.end(), control.id) == used.end())
      throw InputError(
          fmt::format("{}: the control '{}' moves nothing; name it as the retraction of a cable, the angle of a "
                      "joint or the control of a load, a support or a ground, or remove it",
                      simulation.path, control.id));
  }
}

}  // namespace

namespace {

void read_tables(TableReader& root, Simulation& simulation) {
  simulation.title = root.text("title");
  simulation.description = root.text("description", "");
  read_method(root.table("simulation"), simulation);
  for (TableReader& table : root.tables("body")) read_body(table, simulation);
  if (simulation.bodies.empty()) root.fail("", "there is no body; add [[body]] with name, geometry and mesh");
  simulation.materials = read_materials(root);
  const bool dynamic = simulation.method != SimulationMethod::quasi_static;
  for (const MaterialSettings& material : simulation.materials) {
    if ((dynamic || !simulation.gravity_direction.empty()) && !material.density)
      throw InputError(fmt::format(
          "{}: [materials.{}]: gravity, and a simulation over time, need a density; add for example density = "
          "\"30 kg/m3\", or set integrator = \"static\" without gravity",
          simulation.path, material.region));
  }
  read_damping(root, simulation);
  for (TableReader& table : root.tables("control")) read_control(table, simulation);
  for (TableReader& table : root.tables("support")) read_support(table, simulation);
  for (TableReader& table : root.tables("cable")) read_cable(table, simulation);
  for (TableReader& table : root.tables("joint")) read_joint(table, simulation);
  read_studs(root, simulation, Language::simulation);
  for (TableReader& table : root.tables("load"))
    simulation.loads.push_back(read_load(table, simulation, Language::simulation));
  if (auto contact = root.optional_table("contact")) read_contact(*contact, simulation);
  for (TableReader& table : root.tables("channel")) read_channel(table, simulation);
  for (TableReader& table : root.tables("plot")) {
    RobotPlot plot{table.text("id"), table.text("title"), table.text("x", ""), table.texts("y")};
    table.finish();
    simulation.plots.push_back(std::move(plot));
  }
  if (auto workspace = root.optional_table("workspace")) read_workspace(*workspace, simulation);
  if (auto ik = root.optional_table("ik")) read_ik(*ik, simulation);
  if (auto optimise = root.optional_table("optimise")) read_optimise(*optimise, simulation);
  refuse_repeated(simulation.path,
                  {ids_of(simulation.controls), ids_of(simulation.cables.cables), ids_of(simulation.joints),
                   ids_of(simulation.studs.studs), ids_of(simulation.loads), ids_of(simulation.channels), own_series},
                  "controls, cables, joints, studs, loads and channels");
  refuse_without_effect(simulation);
}

}  // namespace

bool is_simulation(const std::string& path) {
  return TomlFile(path).has("simulation");
}

namespace {

Simulation simulation_in(const TomlFile& file, const std::string& path) {
  TableReader root = file.root();
  Simulation simulation;
  simulation.path = path;
  simulation.encoding = file.remark();
  try {
    read_tables(root, simulation);
  } catch (const InputError&) {
    root.refuse_misspelt();
    throw;
  }
  root.finish();
  if (!file.tolerances().empty())
    throw InputError(file.tolerances().begin()->second.where +
                     ": a tolerance counts in the fit of a bench only; give the value alone");
  return simulation;
}

}  // namespace

Simulation read_simulation(const std::string& path) {
  return simulation_in(TomlFile(path), path);
}

Simulation read_simulation_text(const std::string& path, std::string_view text) {
  Simulation simulation = simulation_in(TomlFile(path, text), path);
  simulation.text = text;
  return simulation;
}

}  // namespace taut

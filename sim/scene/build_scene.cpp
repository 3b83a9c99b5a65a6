#include "sim/scene/build_scene.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include "sim/mesh/mesh_budget.hpp"
#include "sim/mesh/weights.hpp"

namespace taut {
namespace {

const BodySettings& body_called(const Setup& setup, const std::string& name) {
  return *std::find_if(setup.bodies.begin(), setup.bodies.end(),
                       [&](const BodySettings& body) { return body.name == name; });
}

int depth_cells(const Setup& setup) {
  return setup.bodies.front().mesh.depth_cells;
}

double modulus_of(const MaterialSettings& material) {
  return youngs_modulus(material.law, material.constants);
}

double softest(const Setup& setup) {
  double least = 1e300;
  for (const MaterialSettings& material : setup.materials) least = std::min(least, modulus_of(material));
  return least;
}

bool may_be_rigid(const Setup& setup, const MaterialSettings& material) {
  return modulus_of(material) > 100 * softest(setup);
}

Mesh make_whole(const Setup& setup) {
  std::vector<std::pair<std::string, Mesh>> parts;
  for (const BodySettings& body : setup.bodies) {
    at(setup, body.name.empty() ? "[geometry]" : fmt::format("[[body]] '{}'", body.name), [&] {
      MeshSettings settings = body.mesh;
      if (settings.contact_gap == 0) settings.contact_gap = setup.contact.gap;
      Mesh mesh = make_mesh(body.geometry, settings, setup.contact.on, setup.contact.compensate);
      if (!body.at.empty() || body.mirrored >= 0 || body.angle != 0 || !body.turn.empty()) {
        const int d = mesh.dimension();
        place(mesh, rotation_of(body, d), body.at.empty() ? Eigen::VectorXd::Zero(d).eval() : vector_of(body.at));
      }
      parts.emplace_back(body.name, std::move(mesh));
    });
  }
  double elements = 0, nodes = 0;
  for (const auto& [name, mesh] : parts) {
    elements += mesh.element_count();
    nodes += mesh.node_count();
  }
  const Mesh& first = parts.front().second;
  at(setup, "the mesh", [&] { require_equations(elements, nodes, first.dimension(), order_of(first.shape)); });
  if (parts.size() == 1 && parts[0].first.empty()) return std::move(parts[0].second);
  return at(setup, "the bodies", [&] { return merge(parts); });
}

ParameterSpec control_spec(const std::string& id, Quantity quantity) {
  switch (quantity) {
    case Quantity::mass:
      return {id, "m", "kg", -1e6, 1e6, "hung mass"};
    case Quantity::pressure:
      return {id, "p", "Pa", -1e12, 1e12, "traction"};
    case Quantity::line_load:
      return {id, "q", "N/m", -1e9, 1e9, "line load"};
    case Quantity::length:
      return {id, "u", "m", -1e3, 1e3, "prescribed displacement or retraction"};
    case Quantity::angle:
      return {id, "theta", "rad", -1e9, 1e9, "angle of a motor"};
    case Quantity::pure:
      return {id, id, "1", 0, 1e6, "number of a specimen"};
    case Quantity::torque:
      return {id, "tau", "Nm", -1e9, 1e9, "torque of a spool"};
    default:
      return {id, "F", "N", -1e9, 1e9, "force"};
  }
}

bool moves(const GroundSettings& ground) {
  return !ground.control.empty();
}

/// With a node of no element at the end for each ground that moves, which carries it.
Mesh with_carriers(Mesh mesh, const SurfaceSettings& contact) {
  if (!contact.on || contact.idle) return mesh;
  const Eigen::VectorXd place = mesh.node(0);  // where its box is not made larger
  for (int left = static_cast<int>(std::ranges::count_if(contact.grounds, moves)); left > 0; --left) {
    mesh.X.conservativeResize(mesh.X.size() + place.size());
    mesh.X.tail(place.size()) = place;
  }
  return mesh;
}

/// One build: what is under construction, and the steps.
class Assembler {
 public:
  Assembler(const Setup& setup, const SceneOptions& options)
      : setup_(setup),
        options_(options),
        builder_(with_carriers(make_whole(setup), setup.contact), setup.plane, setup.thickness) {}

  BuiltScene build() {
    built_.gravity = builder_.declare({"g", "g", "m/s2", 0, 1000, "acceleration of gravity"}, setup_.gravity);
    if (!setup_.gravity_direction.empty()) built_.off_at_rest.push_back(built_.gravity);
    add_materials();
    declare_controls();
    add_symmetry();
    add_supports();
    for (const LoadSettings& load : setup_.loads)
      at(setup_, fmt::format("[[load]] '{}'", load.id), [&] { add_load(load); });
    if (!setup_.cables.cables.empty()) add_cables();
    for (const JointSettings& joint : setup_.joints) {
      const int angle = joint.control.empty() ? -1 : index_of(joint.control);
      built_.joints.push_back(
          at(setup_, fmt::format("[[joint]] '{}'", joint.id), [&] { return builder_.add_joint(joint, angle); }));
    }
    for (const StudSettings& stud : setup_.studs.studs)
      at(setup_, fmt::format("[[stud]] '{}'", stud.id), [&] { add_stud(stud); });
    if (setup_.contact.on && !setup_.contact.idle) at(setup_, "[contact]", [&] { add_contact(); });
    if (options_.declare) options_.declare(builder_);
    add_rubbing_cables();
    built_.joined = builder_.joined();
    built_.scene = at(setup_, "the model", [&] { return builder_.build(options_.free_bodies); });
    for (const ChannelSettings& channel : setup_.channels) {
      built_.readings.push_back(
          at(setup_, fmt::format("[[channel]] '{}'", channel.id), [&] { return make_reading(channel); }));
    }
    return std::move(built_);
  }

 private:
  bool rigid(const MaterialSettings& material) const {
    return options_.rigid_segments && may_be_rigid(setup_, material);
  }
  int index_of(const std::string& control) const { return builder_.parameters().index(control); }

  void add_materials() {
    const auto& materials = setup_.materials;
    if (options_.rigid_segments && std::none_of(materials.begin(), materials.end(),
                                                [&](const MaterialSettings& material) { return rigid(material); })) {
      throw FileError(setup_.path,
                      "model: no region is more than 100 times as stiff as the softest one, so that none can be rigid; "
                      "use \"full\"");
    }
    if (options_.rigid_segments && !symmetry_of(setup_.bodies.front()).empty())
      throw FileError(setup_.path,
                      "model: a rigid region is held as a whole or not at all, and planes of symmetry hold it in part; "
                      "take the whole body, or use \"full\"");
    for (const MaterialSettings& material : materials) {
      at(setup_, fmt::format("[materials.{}]", material.region), [&] {
        add_material(material);
        if (!material.density) return;
        if (!setup_.gravity_direction.empty())
          builder_.add_weight(material.region, *material.density, vector_of(setup_.gravity_direction), built_.gravity);
        if (options_.over_time) add_inertia(material);
      });
    }
  }

  /// The constants of a rigid region are declared, and change nothing.
  void add_material(const MaterialSettings& material) {
    if (!rigid(material)) {
      return builder_.add_solid(material.region, material.law, material.constants,
                                setup_.bodies.front().mesh.formulation, material.prony);
    }
    if (!material.prony.empty())
      throw InputError("what cannot deform has no 'prony'; take it out, or set model = \"full\"");
    builder_.add_rigid(material.region, modulus_of(material));
    for (auto& [spec, value] : region_parameters(material.region, material.law, material.constants))
      builder_.declare(std::move(spec), value);
  }

  /// Declares "mass_damping_<region>" [1/s] and "stiffness_damping_<region>" [s] where the file has them.
  void add_inertia(const MaterialSettings& material) {
    const std::string& region = material.region;
    int mass_damping = -1;
    if (setup_.mass_damping.count(region) > 0)
      mass_damping = builder_.declare(
          {"mass_damping_" + region, "alpha", "1/s", 0, 1e6, "damping of " + region + " in proportion to its mass"},
          setup_.mass_damping.at(region));
    builder_.add_inertia(region, *material.density, setup_.mass, mass_damping);
    if (setup_.stiffness_damping.count(region) == 0) return;
    builder_.add_viscosity(region, builder_.declare({"stiffness_damping_" + region, "beta", "s", 0, 1e3,
                                                     "damping of " + region + " in proportion to its stiffness"},
                                                    setup_.stiffness_damping.at(region)));
  }

  /// Controls are parameters beside the model's own, whose names they must not take.
  void declare_controls() {
    for (const ControlSettings& control : setup_.controls) {
      built_.controls.push_back(at(setup_, fmt::format("id '{}'", control.id),
                                   [&] { return builder_.declare(control_spec(control.id, control.quantity), 0.0); }));
    }
  }

  /// A part of a body is held in its planes of symmetry, and all else has to be its own mirror image.
  void add_symmetry() {
    for (const BodySettings& body : setup_.bodies) {
      for (const SymmetryPlane& plane : symmetry_of(body)) {
        const std::string where = body.name.empty() ? "[geometry]" : fmt::format("[[body]] '{}'", body.name);
        at(setup_, where, [&] { add_plane(body, plane); });
      }
    }
    if (planes_.empty()) return;
    const auto check = [&](const std::string& where, const std::vector<double>& direction) {
      for (size_t c = 0; c < direction.size(); ++c) {
        if (planes_.contains(static_cast<int>(c)) && direction[c] != 0)
          at(setup_, where, [&] { refuse_asymmetric(static_cast<int>(c), "its direction leaves"); });
      }
    };
    check("[gravity]", setup_.gravity_direction);
    for (const StudSettings& stud : setup_.studs.studs) check(fmt::format("[[stud]] '{}'", stud.id), stud.direction);
    for (const GroundSettings& ground : setup_.contact.grounds)
      check("[[contact.ground]]", {ground.normal.begin(), ground.normal.end()});
    for (const LoadSettings& load : setup_.loads) {
      const std::string where = fmt::format("[[load]] '{}'", load.id);
      check(where, load.direction);
      at(setup_, where, [&] {
        for (const auto& [component, plane] : planes_) {
          if (!meets(component, load.on, load.point)) refuse_asymmetric(component, "its place does not reach");
        }
      });
    }
    for (const ChannelSettings& channel : setup_.channels)
      at(setup_, fmt::format("[[channel]] '{}'", channel.id), [&] { check_symmetric(channel); });
  }

  void add_plane(const BodySettings& body, const SymmetryPlane& plane) {
    if (setup_.bodies.size() > 1)
      throw InputError("a part of a body stands for all of it where it is alone; take the whole body beside others");
    const int d = builder_.mesh().dimension();
    const Eigen::VectorXd normal = rotation_of(body, d).col(plane.component).cwiseAbs();
    int component = 0;
    if (normal.maxCoeff(&component) < 1 - 1e-12)
      throw InputError(
          fmt::format("its plane of symmetry '{}' is turned out of the planes of coordinates; take the "
                      "whole body, or do not turn it about an axis in that plane",
                      plane.tag));
    const std::string tag = body.name.empty() ? plane.tag : body.name + "." + plane.tag;
    planes_[component] = {tag, placed(body, Eigen::VectorXd::Zero(d))[component]};
    builder_.fix(tag, {component});
  }

  [[noreturn]] void refuse_asymmetric(int component, const std::string& why) const {
    throw InputError(
        fmt::format("{} the plane of symmetry '{}', where {} is constant, and the other half would have "
                    "the mirror image; take the whole body",
                    why, planes_.at(component).tag, "xyz"[component]));
  }

  /// A mean over what a plane of symmetry cuts is that of the whole body along the plane only, and a turn about its
  /// normal only.
  void check_symmetric(const ChannelSettings& channel) const {
    if (!planes_.empty() && channel.kind->on == ChannelKind::On::body)
      throw InputError(fmt::format("a {} is that on a whole body; take it", channel.kind->name));
    for (const auto& [component, plane] : planes_) {
      for (int c = 0; c < static_cast<int>(channel.direction.size()); ++c) {
        const bool turns = channel.kind->directed == ChannelKind::Directed::in_space;
        if (channel.direction[static_cast<size_t>(c)] == 0 || (c == component) == turns || !channel.point.empty())
          continue;
        const bool is_body =
            std::ranges::any_of(builder_.mesh().parts, [&](const Part& part) { return part.name == channel.on; });
        if (turns || is_body || meets(component, channel.on, {}))
          refuse_asymmetric(component, turns ? "it turns about an axis that is not across" : "its direction leaves");
      }
    }
  }

  /// Whether a point, or a tag, has a part in the plane of symmetry across a coordinate.
  bool meets(int component, const std::string& tag, const std::vector<double>& point) const {
    const Mesh& mesh = builder_.mesh();
    const auto on_plane = [&](const Eigen::VectorXd& place) {
      return std::abs(place[component] - planes_.at(component).at) < 1e-9 * mesh.diagonal();
    };
    if (!point.empty()) return on_plane(vector_of(point));
    const std::vector<int> nodes = mesh.select(tag).nodes();
    return std::any_of(nodes.begin(), nodes.end(), [&](int node) { return on_plane(mesh.node(node)); });
  }

  /// Of what passes these points, the share that is in the model: all of it beside a plane of symmetry, half in it.
  double share_at(const std::vector<Eigen::VectorXd>& points) const {
    double share = 1;
    for (const auto& [component, plane] : planes_) {
      const auto is_in = [&, c = component](const Eigen::VectorXd& point) {
        return meets(c, "", {point.begin(), point.end()});
      };
      const auto in_plane = std::ranges::count_if(points, is_in);
      if (in_plane == std::ssize(points))
        share *= 0.5;
      else if (in_plane > 0)
        refuse_asymmetric(component, "it begins or ends in");
    }
    return share;
  }

  void add_supports() {
    for (const BodySettings& body : setup_.bodies) {
      for (const auto& [tag, components] : body.fixed)
        at(setup_, fmt::format("[[body]] '{}'", body.name), [&] { builder_.fix(body.name + "." + tag, components); });
    }
    for (const SupportSettings& support : setup_.supports) {
      at(setup_, fmt::format("[[support]] on '{}'", support.on), [&] {
        builder_.fix(support.on, support.fix);
        if (support.rotation_stiffness) builder_.add_elastic_clamp(support.on, *support.rotation_stiffness);
        if (!support.control.empty()) builder_.prescribe(support.on, support.component, index_of(support.control));
      });
    }
  }

  /// Its share of a force or a hung mass on a part of a body.
  void add_shared_load(const LoadSettings& load, int control, int times) {
    const Mesh& mesh = builder_.mesh();
    const int cells = depth_cells(setup_);
    const Eigen::VectorXd direction = vector_of(load.direction);
    Eigen::VectorXd weights = Eigen::VectorXd::Zero(mesh.X.size());
    if (load.point.empty()) {
      weights = mean_weights(mesh, mesh.select(load.on), direction);
    } else if (cells == 0) {
      weights = point_weights(mesh, locate(mesh, vector_of(load.point)), direction.normalized());
    } else {
      // Simpson's rule over each layer: exact for what elements up to quadratic ones interpolate.
      double depth = 0;
      for (int i = 0; i < mesh.node_count(); ++i) depth = std::max(depth, mesh.node(i)[2]);
      for (int i = 0; i <= 2 * cells; ++i) {
        Eigen::VectorXd point = vector_of(load.point);
        point[2] = depth * i / (2 * cells);
        const double weight = (i == 0 || i == 2 * cells ? 1 : i % 2 == 0 ? 2 : 4) / (6.0 * cells);
        weights += weight * point_weights(mesh, locate(mesh, point), direction);
      }
    }
    builder_.add_load(setup_.share() * weights, {control, times});
  }

  void add_load(const LoadSettings& load) {
    int control;
    if (load.control.empty()) {
      control = builder_.declare(control_spec(load.id, load.quantity), load.value);
      built_.off_at_rest.push_back(control);
    } else {
      control = index_of(load.control);
    }
    const Eigen::VectorXd direction = vector_of(load.direction);
    const bool mass = load.quantity == Quantity::mass;
    const int times = mass ? built_.gravity : -1;
    if (!planes_.empty() && (mass || load.quantity == Quantity::force)) {
      add_shared_load(load, control, times);
    } else if (!load.point.empty()) {
      builder_.add_point_force(vector_of(load.point), direction, control, times);
    } else if (load.quantity == Quantity::pressure) {
      builder_.add_traction(load.on, direction, control);
    } else if (load.quantity == Quantity::line_load) {
      builder_.add_line_load(load.on, direction, control);
    } else {
      builder_.add_force(load.on, direction, control, times);
    }
    if (!mass || !options_.over_time) return;
    if (!planes_.empty())
      throw InputError("a mass that moves has inertia across a plane of symmetry too; take the whole body");
    builder_.add_point_mass(load.on, control);
  }

  static bool shares_law(const CableSettings& cable) { return !cable.own && !cable.held; }

  /// k_cable and slack. EA means one stiffness for all only where all have one length.
  void declare_shared_law(int& k, int& slack) {
    const CablesSettings& settings = setup_.cables;
    const auto length_of = [&](const CableSettings& cable) {
      const std::vector<Eigen::VectorXd> points = points_of(cable);
      double length = 0;
      for (size_t i = 1; i < points.size(); ++i) length += (points[i] - points[i - 1]).norm();
      return length;
    };
    const CableSettings& first = *std::find_if(settings.cables.begin(), settings.cables.end(), shares_law);
    const double length = length_of(first);
    for (const CableSettings& cable : settings.cables) {
      if (settings.EA && shares_law(cable) && std::abs(length_of(cable) - length) > 1e-9 * length) {
        throw InputError(
            fmt::format("EA gives cables of different lengths different stiffnesses, but all share k_cable: '{}' is "
                        "{:.4g} mm long and "
                        "'{}' {:.4g} mm; give k",
                        first.id, 1e3 * length, cable.id, 1e3 * length_of(cable)));
      }
    }
    k = builder_.declare({"k_cable", "k", "N/m", 1e-3, 1e12, "stiffness of a whole cable", true},
                         settings.k ? *settings.k : *settings.EA / length);
    slack = builder_.declare(
        {"slack", "s", "m", -0.5 * length, 0.5 * length, "length by which a cable exceeds its path at rest"},
        settings.slack);
  }

  /// Points along a row of eyelets in the world at rest.
  std::vector<Eigen::VectorXd> points_along(const EyeletLine& line, const BodySettings& body) const {
    const BodyAxis axis = axis_of(body);
    if (line.pieces < 1)
      throw InputError(fmt::format("a row of eyelets has {} pieces of cable; at least 1 is needed", line.pieces));
    std::vector<Eigen::VectorXd> points;
    for (int i = 0; i <= line.pieces; ++i) {
      const double t = static_cast<double>(i) / line.pieces;
      points.push_back(
          axis.point(std::lerp(line.start, line.end, t), std::lerp(line.offset, line.end_offset, t), line.angle));
      // On the plane of symmetry of a solid that is swept from a section.
      if (depth_cells(setup_) > 0) points.back() = Eigen::Vector3d(points.back()[0], points.back()[1], 0);
    }
    return points;
  }

  /// Points of a cable in the world at rest: its own, or one of those that its body's geometry has.
  std::vector<Eigen::VectorXd> points_of(const CableSettings& cable) const {
    const BodySettings& body = body_called(setup_, cable.body);
    if (cable.line) return points_along(*cable.line, body);
    std::vector<Eigen::VectorXd> points;
    for (const std::vector<double>& point : cable.points) points.push_back(vector_of(point));
    if (points.empty()) points = own_cable(body.geometry, cable.path);
    for (Eigen::VectorXd& point : points) point = placed(body, point);
    return points;
  }

  /// The tension of a cable that has no law: a control, or a constant that does not pull at rest.
  void declare_tension(const CableSettings& cable, Cable& made) {
    if (cable.control.empty()) {
      made.tension = builder_.declare({"tension_" + cable.id, "T", "N", 0, 1e9, "held tension of cable " + cable.id},
                                      cable.tension);
      built_.off_at_rest.push_back(made.tension);
    } else {
      made.tension = index_of(cable.control);
      if (cable.spool > 0) made.per_control = 1 / cable.spool;
    }
    const ParameterTable& parameters = builder_.parameters();
    if (!parameters.contains("tension_scale")) {
      builder_.declare({"tension_scale", "c_T", "1", 0, 10, "factor of all held tensions"}, 1);
      declare_friction();
    }
    made.tension_scale = parameters.index("tension_scale");
  }

  int declare_friction() {
    return builder_.declare({"cable_friction", "mu", "1", 0, 2, "friction of cables at their eyelets"},
                            setup_.cables.friction);
  }

  /// What the states of their eyelets are comes after all that is declared.
  void add_rubbing_cables() {
    for (Cable& cable : built_.cables) {
      if (cable.friction >= 0) builder_.add_rubbing_cable(cable);
    }
  }

  void add_cables() {
    int shared_k = -1, shared_slack = -1, friction = -1, misalignment = -1;
    const auto add = [&](const CableSettings& cable) {
      const std::string& id = cable.id;
      Cable made;
      if (cable.held) {
        declare_tension(cable, made);
      } else if (cable.own) {
        made.stiffness = builder_.declare({"k_" + id, "k", "N/m", 1e-3, 1e12, "stiffness of cable " + id, true},
                                          cable.own->k.value());
        made.slack = builder_.declare({"slack_" + id, "s", "m", -10, 10, "slack of cable " + id}, cable.own->slack);
        made.smoothing = cable.own->smoothing;
      } else {
        made.stiffness = shared_k;
        made.slack = shared_slack;
        made.smoothing = setup_.cables.smoothing;
      }
      if (!cable.control.empty() && !cable.held) made.retraction = index_of(cable.control);
      const std::vector<Eigen::VectorXd> points = points_of(cable);
      made.share = share_at(points);
      const Mesh& mesh = builder_.mesh();
      for (size_t i = 0; i < points.size(); ++i) {
        const bool fixed =
            !cable.line && ((i == 0 && cable.start_fixed) || (i + 1 == points.size() && cable.end_fixed));
        const auto inside = [&] {
          return cable.body.empty() ? locate(mesh, points[i]) : locate(mesh, points[i], mesh.part(cable.body));
        };
        made.points.push_back({fixed ? MaterialPoint{} : inside(), points[i]});
      }
      if (setup_.cables.rub && !cable.held && made.points.size() > 2) {
        made.friction = friction;
        made.misalignment = misalignment;
      } else {
        builder_.add_cable(made);
      }
      built_.cables.push_back(std::move(made));
    };
    if (std::any_of(setup_.cables.cables.begin(), setup_.cables.cables.end(), shares_law))
      at(setup_, "[cables]", [&] { declare_shared_law(shared_k, shared_slack); });
    if (setup_.cables.rub) {
      friction = declare_friction();
      misalignment = builder_.declare(
          {"cable_misalignment", "beta_0", "rad", 0, 1, "angle by which each eyelet turns a cable besides"},
          setup_.cables.misalignment);
    }
    for (const CableSettings& cable : setup_.cables.cables)
      at(setup_, fmt::format("{} '{}'", cable.own ? "[[cable]]" : "cable", cable.id), [&] { add(cable); });
  }

  /// Weights of the displacement of a tag or a point along a direction; none of either: fixed in space.
  Eigen::VectorXd place_weights(const std::string& tag, const std::vector<double>& point,
                                const Eigen::VectorXd& direction) const {
    const Mesh& mesh = builder_.mesh();
    if (!tag.empty()) return mean_weights(mesh, mesh.select(tag), direction);
    if (point.empty()) return Eigen::VectorXd::Zero(mesh.X.size());
    return point_weights(mesh, locate(mesh, vector_of(point)), direction.normalized());
  }

  /// The parameter of all studs, declared with the first one that has none of its own, or that one's own.
  int stud_parameter(const std::optional<double>& own, const std::optional<double>& shared, ParameterSpec spec,
                     const std::string& own_id, const std::string& id) {
    if (!own && builder_.parameters().contains(spec.id)) return index_of(spec.id);
    if (own) {
      spec.id = own_id;
      spec.meaning += " of " + id;
    }
    return builder_.declare(std::move(spec), own ? *own : shared.value());
  }

  void add_stud(const StudSettings& stud) {
    const StudsSettings& all = setup_.studs;
    const Eigen::VectorXd direction = vector_of(stud.direction);
    Play play;
    play.apart =
        place_weights(stud.on, stud.point, direction) - place_weights(stud.hole_on, stud.hole_point, direction);
    play.stiffness = stud_parameter(stud.stiffness, all.stiffness,
                                    {"k_stud", "k", "N/m", 1e-3, 1e12, "stiffness of studs in their holes", true},
                                    "k_" + stud.id, stud.id);
    play.clearance = stud_parameter(stud.clearance, all.clearance,
                                    {"clearance", "c", "m", 0, 0.1, "clearance of studs in their holes"},
                                    "clearance_" + stud.id, stud.id);
    play.smoothing = all.smoothing;
    play.share = setup_.share();
    builder_.add_play(play);
  }

  /// Of the whole body along the axes [m].
  Eigen::VectorXd whole_extent() const {
    const Mesh& mesh = builder_.mesh();
    const int d = mesh.dimension();
    const auto places = mesh.X.reshaped(d, mesh.node_count());
    Eigen::VectorXd extent = places.rowwise().maxCoeff() - places.rowwise().minCoeff();
    for (const auto& [component, plane] : planes_) extent[component] *= 2;
    return extent;
  }

  /// The pressure at which two faces rest half a contact gap apart, region by region; fixed for a run. Too small, and
  /// faces come so near that the Hessian is ill-conditioned; too large, and the barrier acts within a sliver of its gap
  /// that Newton's method finds and loses again. Soft bodies bear pressures of about their modulus; what presses stiff
  /// ones together are the forces that the soft ones, the cables against them, and the loads bring.
  std::map<std::string, double> contact_pressures() const {
    const bool swept = builder_.mesh().dimension() == 2 || depth_cells(setup_) > 0;
    const double area =
        swept ? builder_.mesh().diagonal() * setup_.thickness : whole_extent().norm() * whole_extent().minCoeff();
    const double load = options_.largest_force / (0.05 * area);
    std::map<std::string, double> pressures;
    for (const MaterialSettings& material : setup_.materials) {
      double& pressure = pressures[material.region];
      const auto given = setup_.contact.pressure.find(material.region);
      pressure = given != setup_.contact.pressure.end() ? given->second
                                                        : std::min(modulus_of(material), 10 * softest(setup_) + load);
      if (setup_.contact.stiffness) pressure = *setup_.contact.stiffness;
    }
    return pressures;
  }

  /// Boundaries that do not cross may still be one inside the other.
  void refuse_nested_bodies() const {
    const Mesh& mesh = builder_.mesh();
    for (const Part& outer : mesh.parts) {
      for (const Part& inner : mesh.parts) {
        const auto joins = [&](const JointSettings& joint) {
          return (joint.part_a == outer.name && joint.part_b == inner.name) ||
                 (joint.part_a == inner.name && joint.part_b == outer.name);
        };
        if (&outer == &inner || std::any_of(setup_.joints.begin(), setup_.joints.end(), joins)) continue;
        if (!lies_in(outer, mesh, mesh.node(inner.first_node))) continue;
        throw InputError(
            fmt::format("body '{}' lies inside body '{}' at rest; move one of them", inner.name, outer.name));
      }
    }
  }

  template <class AnyGround>
  std::vector<AnyGround> grounds() {
    std::vector<AnyGround> made;
    const auto& all = setup_.contact.grounds;
    int next = builder_.mesh().node_count() - static_cast<int>(std::ranges::count_if(all, moves));
    for (const GroundSettings& ground : all) {
      made.push_back({ground.point, ground.normal, ground.kind, ground.radius});
      if (!moves(ground)) continue;
      builder_.carry(next, ground.move, index_of(ground.control));
      made.back().node = next++;
    }
    return made;
  }

  void add_contact() {
    refuse_nested_bodies();
    const std::map<std::string, double> pressures = contact_pressures();
    const auto watch = [&](const auto& contact) {
      built_.intersects = [&contact](const Eigen::VectorXd& u) { return contact.intersects(u); };
      built_.smallest_distance = [&contact](const Eigen::VectorXd& u, double horizon) {
        return contact.smallest_distance(u, horizon);
      };
      built_.touching.terms.push_back(&contact);
      if (setup_.contact.friction)
        built_.touching.terms.push_back(&builder_.add_contact_friction(contact, *setup_.contact.friction));
      const SurfaceSettings& settings = setup_.contact;
      for (size_t k = 0; k < settings.obstacle_names.size(); ++k)
        built_.touching.side_called[settings.obstacle_names[k]] = contact.side_of_obstacle(static_cast<int>(k));
      for (size_t k = 0; k < settings.grounds.size(); ++k)
        built_.touching.side_called[settings.grounds[k].name] = contact.side_of_ground(static_cast<int>(k));
    };
    const SurfaceSettings& settings = setup_.contact;
    double diagonal = builder_.mesh().diagonal();
    if (depth_cells(setup_) > 0)  // that of the section
      diagonal = std::sqrt(std::pow(diagonal, 2) - std::pow(setup_.thickness / 2, 2));
    else if (!planes_.empty())
      diagonal = whole_extent().norm();
    const double gap = settings.gap > 0 ? settings.gap : contact_gap(setup_.bodies.front().mesh, diagonal);
    if (builder_.mesh().dimension() == 2) {
      built_.contact = &builder_.add_contact(gap, pressures, settings.obstacles, grounds<GroundLine>(), settings.form);
      return watch(*built_.contact);
    }
    watch(builder_.add_contact_3d(gap, pressures, grounds<GroundPlane>()));
  }

  SceneReading make_reading(const ChannelSettings& channel) const {
    SceneReading reading;
    reading.id = channel.id;
    reading.unit = channel.kind->unit;
    std::string of = channel.marker.empty() ? channel.on : "marker " + channel.marker;
    if (!channel.by.empty()) of += " by " + channel.by;
    reading.meaning = fmt::format("{} {}", channel.kind->meaning, of.empty() ? "a point" : of);
    reading.channel = channel.kind->make({channel, setup_, *built_.scene.model, built_.cables, built_.joints,
                                          built_.touching, options_.rigid_segments, reading});
    return reading;
  }

  /// A plane of symmetry of the only body there is.
  struct Plane {
    std::string tag;
    double at;  ///< its coordinate [m]
  };

  const Setup& setup_;
  const SceneOptions& options_;
  std::map<int, Plane> planes_;  ///< by the component that is constant
  SceneBuilder builder_;
  BuiltScene built_;
};

}  // namespace

std::vector<std::string> rigid_regions(const Setup& setup) {
  std::vector<std::string> regions;
  for (const MaterialSettings& material : setup.materials) {
    if (may_be_rigid(setup, material)) regions.push_back(material.region);
  }
  return regions;
}

BuiltScene build_scene(const Setup& setup, const SceneOptions& options) {
  return Assembler(setup, options).build();
}

}  // namespace taut

#include "sim/robots/robot.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "sim/core/error.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/shapes/geometry.hpp"

namespace taut {
namespace {

Eigen::VectorXd vector_of(const std::vector<double>& values) {
  return Eigen::Map<const Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
}

/// Runs `action` and puts file and table in front of what goes wrong.
template <class Action>
auto at(const Simulation& simulation, const std::string& table, Action&& action) {
  try {
    return action();
  } catch (const InputError& error) {
    if (std::string_view(error.what()).starts_with(simulation.path + ":")) throw;
    throw InputError(fmt::format("{}: {}: {}", simulation.path, table, error.what()));
  }
}

const BodySettings& body_called(const Simulation& simulation, const std::string& name) {
  return *std::find_if(simulation.bodies.begin(), simulation.bodies.end(),
                       [&](const BodySettings& body) { return body.name == name; });
}

/// A point of a body's own frame in the world at rest.
Eigen::VectorXd placed(const BodySettings& body, const Eigen::VectorXd& point) {
  Eigen::VectorXd x = point;
  x[0] = std::cos(body.angle) * point[0] - std::sin(body.angle) * point[1];
  x[1] = std::sin(body.angle) * point[0] + std::cos(body.angle) * point[1];
  return x + vector_of(body.at);
}

Mesh make_whole(const Simulation& simulation) {
  std::vector<std::pair<std::string, Mesh>> parts;
  for (const BodySettings& body : simulation.bodies) {
    at(simulation, fmt::format("[[body]] '{}'", body.name), [&] {
      MeshSettings settings = body.mesh;
      if (settings.contact_gap == 0) settings.contact_gap = simulation.contact_gap;
      Mesh mesh = make_mesh(body.geometry, settings, simulation.contact, true);
      place(mesh, body.angle, vector_of(body.at));
      parts.emplace_back(body.name, std::move(mesh));
    });
  }
  return at(simulation, "the bodies", [&] { return merge(parts); });
}

/// Points of a cable in the world: its own, or one of those that its geometry has.
std::vector<Eigen::VectorXd> cable_points(const Simulation& simulation, const RobotCable& cable) {
  const BodySettings& body = body_called(simulation, cable.body);
  std::vector<Eigen::VectorXd> points;
  if (!cable.path.points.empty()) {
    for (const std::vector<double>& point : cable.path.points) points.push_back(vector_of(point));
  } else {
    points = own_cable(body.geometry, cable.path.id);
  }
  for (Eigen::VectorXd& point : points) point = placed(body, point);
  return points;
}

Cable make_cable_of(const Simulation& simulation, const RobotCable& cable, SceneBuilder& builder,
                    const std::map<std::string, int>& controls) {
  Cable made;
  made.stiffness =
      builder.declare({"k_" + cable.id, "k", "N/m", 1e-3, 1e12, "stiffness of cable " + cable.id, true}, cable.k);
  made.slack = builder.declare({"slack_" + cable.id, "s", "m", -10, 10, "slack of cable " + cable.id}, cable.slack);
  made.smoothing = cable.smoothing;
  if (!cable.path.control.empty()) made.retraction = controls.at(cable.path.control);
  const std::vector<Eigen::VectorXd> points = cable_points(simulation, cable);
  const Part& part = builder.mesh().part(cable.body);
  for (size_t i = 0; i < points.size(); ++i) {
    const bool fixed = (i == 0 && cable.path.start_fixed) || (i + 1 == points.size() && cable.path.end_fixed);
    made.points.push_back(fixed ? CablePoint{{}, points[i]}
                                : CablePoint{locate(builder.mesh(), points[i], part), points[i]});
  }
  builder.add_cable(made);
  return made;
}

/// The pressure at which two faces rest half a gap apart, region by region: about what the soft bodies bear, which is
/// also what presses stiff ones together.
std::map<std::string, double> contact_pressures(const Simulation& simulation) {
  double softest = 1e300;
  for (const MaterialSettings& material : simulation.materials) softest = std::min(softest, material.constants.at("E"));
  std::map<std::string, double> pressures;
  for (const MaterialSettings& material : simulation.materials) {
    const auto given = simulation.contact_pressure.find(material.region);
    pressures[material.region] =
        given != simulation.contact_pressure.end() ? given->second : std::min(material.constants.at("E"), 10 * softest);
  }
  return pressures;
}

/// Boundaries that do not cross may still be one inside the other.
void refuse_nested_bodies(const Simulation& simulation, const Mesh& mesh) {
  for (const Part& outer : mesh.parts) {
    for (const Part& inner : mesh.parts) {
      const bool joined = std::any_of(simulation.joints.begin(), simulation.joints.end(), [&](const RobotJoint& joint) {
        return (joint.first == outer.name && joint.second == inner.name) ||
               (joint.first == inner.name && joint.second == outer.name);
      });
      if (&outer == &inner || joined) continue;
      try {
        locate(mesh, mesh.node(inner.first_node), outer);
      } catch (const InputError&) {
        continue;
      }
      throw InputError(
          fmt::format("body '{}' lies inside body '{}' at rest; move one of them", inner.name, outer.name));
    }
  }
}

void add_contact(const Simulation& simulation, SceneBuilder& builder, Robot& robot) {
  refuse_nested_bodies(simulation, builder.mesh());
  const std::map<std::string, double> pressures = contact_pressures(simulation);
  const auto watch = [&](const auto& contact) {
    robot.intersects = [&contact](const Eigen::VectorXd& u) { return contact.intersects(u); };
    robot.smallest_distance = [&contact](const Eigen::VectorXd& u, double horizon) {
      return contact.smallest_distance(u, horizon);
    };
  };
  if (simulation.dimension == 2) {
    std::vector<GroundLine> grounds;
    for (const auto& [point, normal] : simulation.grounds) grounds.push_back({point, normal});
    return watch(builder.add_contact(simulation.contact_gap, pressures, simulation.obstacles, grounds));
  }
  std::vector<GroundPlane> grounds;
  for (const auto& [point, normal] : simulation.grounds) grounds.push_back({point, normal});
  watch(builder.add_contact_3d(simulation.contact_gap, pressures, grounds));
}

/// Displacement weights of a tag's mean, or of a body's centre of mass.
Eigen::VectorXd place_weights(const Simulation& simulation, const Mesh& mesh, const std::string& of,
                              const Eigen::VectorXd& direction) {
  const bool body =
      std::any_of(mesh.parts.begin(), mesh.parts.end(), [&](const Part& part) { return part.name == of; });
  if (!body) return mean_weights(mesh, mesh.select(of), direction);
  const Part& part = mesh.part(of);
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(mesh.X.size());
  double mass = 0;
  const bool known = std::all_of(simulation.materials.begin(), simulation.materials.end(),
                                 [](const MaterialSettings& material) { return material.density.has_value(); });
  const std::vector<double> measures = element_measures(mesh);
  for (const MaterialSettings& material : simulation.materials) {
    const int region = mesh.region_index(material.region);
    const double density = known ? *material.density : 1.0;
    Eigen::VectorXd all = body_weights(mesh, region, direction.normalized());
    // Only this part's nodes: parts share no nodes.
    const int d = mesh.dimension();
    weights.segment(static_cast<Eigen::Index>(part.first_node) * d, static_cast<Eigen::Index>(part.node_count) * d) +=
        density *
        all.segment(static_cast<Eigen::Index>(part.first_node) * d, static_cast<Eigen::Index>(part.node_count) * d);
    for (int e = part.first_element; e < part.first_element + part.element_count; ++e) {
      if (mesh.region[static_cast<size_t>(e)] == region) mass += density * measures[static_cast<size_t>(e)];
    }
  }
  return weights / mass;
}

RobotReading make_reading(const Simulation& simulation, const RobotChannel& settings, const Mesh& mesh,
                          const Robot& robot) {
  using Kind = RobotChannel::Kind;
  RobotReading reading;
  reading.id = settings.id;
  const auto index_of = [&](const auto& items) {
    return static_cast<size_t>(
        std::find_if(items.begin(), items.end(), [&](const auto& item) { return item.id == settings.of; }) -
        items.begin());
  };
  switch (settings.kind) {
    case Kind::position:
    case Kind::displacement: {
      const Eigen::VectorXd weights = place_weights(simulation, mesh, settings.of, vector_of(settings.direction));
      reading.unit = "m";
      reading.meaning =
          fmt::format("{} of {}", settings.kind == Kind::position ? "position" : "displacement", settings.of);
      if (settings.kind == Kind::position) reading.rest = weights.dot(mesh.X);
      reading.channel = make_linear_channel(weights);
      break;
    }
    case Kind::rotation:
      reading.unit = "rad";
      reading.meaning = "rotation of " + settings.of;
      reading.channel =
          make_rotation_channel(mesh, mesh.select(settings.of),
                                settings.direction.empty() ? Eigen::VectorXd() : vector_of(settings.direction));
      break;
    case Kind::tension:
      reading.unit = "N";
      reading.meaning = "tension of cable " + settings.of;
      reading.channel = make_cable_tension(mesh, robot.cables[index_of(simulation.cables)]);
      break;
    case Kind::joint_gap:
      reading.unit = "m";
      reading.meaning = "gap of joint " + settings.of;
      reading.channel = make_joint_gap(mesh, robot.joints[index_of(simulation.joints)]);
      break;
    case Kind::joint_angle:
      reading.unit = "rad";
      reading.meaning = "angle of joint " + settings.of;
      reading.channel = make_joint_angle(mesh, robot.joints[index_of(simulation.joints)]);
      break;
    case Kind::joint_torque:
      reading.unit = "Nm";
      reading.meaning = "torque of joint " + settings.of;
      reading.channel = make_joint_torque(mesh, robot.joints[index_of(simulation.joints)]);
      break;
    case Kind::net_force:
      reading.unit = "N";
      reading.meaning = "force on " + settings.of;
      reading.part = static_cast<int>(&mesh.part(settings.of) - mesh.parts.data());
      reading.direction = vector_of(settings.direction).normalized();
      break;
  }
  return reading;
}

}  // namespace

Params Robot::at(const Simulation& simulation, double t) const {
  Params p = scene.values;
  for (size_t k = 0; k < controls.size(); ++k) p[controls[k]] = simulation.controls[k].schedule.at(t);
  return p;
}

Robot make_robot(const Simulation& simulation) {
  Robot robot;
  SceneBuilder builder(make_whole(simulation), simulation.plane, simulation.thickness);
  const bool dynamic = simulation.method != SimulationMethod::quasi_static;
  robot.gravity = builder.declare({"g", "g", "m/s2", 0, 1000, "acceleration of gravity"}, simulation.gravity);
  for (const MaterialSettings& material : simulation.materials) {
    at(simulation, fmt::format("[materials.{}]", material.region), [&] {
      builder.add_solid(material.region, material.law, material.constants, simulation.bodies[0].mesh.formulation);
      if (!material.density) return;
      if (!simulation.gravity_direction.empty())
        builder.add_weight(material.region, *material.density, vector_of(simulation.gravity_direction), robot.gravity);
      if (!dynamic) return;
      const auto damping = [&](const std::map<std::string, double>& values, const char* name, const char* unit) {
        const auto found = values.find(material.region);
        if (found == values.end() || found->second == 0) return -1;
        return builder.declare(
            {fmt::format("{}_{}", name, material.region), name, unit, 0, 1e9, "damping of " + material.region},
            found->second);
      };
      builder.add_inertia(material.region, *material.density, simulation.mass,
                          damping(simulation.mass_damping, "alpha", "1/s"));
      const int beta = damping(simulation.stiffness_damping, "beta", "s");
      if (beta >= 0) builder.add_viscosity(material.region, beta);
    });
  }
  std::map<std::string, int> control_index;
  for (const ControlSettings& control : simulation.controls) {
    at(simulation, fmt::format("[[control]] '{}'", control.id), [&] {
      const Quantity q = control.quantity;
      const ParameterSpec spec{control.id,
                               q == Quantity::angle    ? "theta"
                               : q == Quantity::length ? "u"
                               : q == Quantity::mass   ? "m"
                                                       : "F",
                               units_of(q).front(),
                               -1e9,
                               1e9,
                               "control"};
      control_index[control.id] = builder.declare(spec, control.schedule.at(0));
    });
    robot.controls.push_back(control_index[control.id]);
  }
  for (const BodySettings& body : simulation.bodies) {
    for (const auto& [tag, components] : body.fixed)
      at(simulation, fmt::format("[[body]] '{}'", body.name), [&] { builder.fix(body.name + "." + tag, components); });
  }
  for (const RobotCable& cable : simulation.cables) {
    robot.cables.push_back(at(simulation, fmt::format("[[cable]] '{}'", cable.id),
                              [&] { return make_cable_of(simulation, cable, builder, control_index); }));
  }
  for (const RobotJoint& joint : simulation.joints) {
    robot.joints.push_back(at(simulation, fmt::format("[[joint]] '{}'", joint.id), [&] {
      JointSettings settings;
      settings.name = joint.id;
      settings.part_a = joint.first;
      settings.part_b = joint.second;
      settings.pivot = vector_of(joint.at);
      settings.axis_end = vector_of(joint.axis_end);
      settings.motor = vector_of(joint.motor_at);
      settings.radius = joint.radius;
      settings.angle = joint.control.empty() ? -1 : control_index.at(joint.control);
      settings.stiffness = joint.stiffness.value_or(0);
      return builder.add_joint(settings);
    }));
  }
  for (const RobotLoad& load : simulation.loads) {
    at(simulation, fmt::format("[[load]] '{}'", load.id), [&] {
      const bool mass = load.quantity == Quantity::mass;
      const int control =
          !load.control.empty()
              ? control_index.at(load.control)
              : builder.declare({load.id, mass ? "m" : "F", mass ? "kg" : "N", mass ? 0 : -1e9, 1e9, "load"},
                                load.value);
      builder.add_force(load.on, vector_of(load.direction), control, mass ? robot.gravity : -1);
      if (mass && dynamic) builder.add_point_mass(load.on, control);
    });
  }
  if (simulation.contact) at(simulation, "[contact]", [&] { add_contact(simulation, builder, robot); });
  for (const RobotChannel& channel : simulation.channels) {
    robot.readings.push_back(at(simulation, fmt::format("[[channel]] '{}'", channel.id),
                                [&] { return make_reading(simulation, channel, builder.mesh(), robot); }));
  }
  const Mesh& mesh = builder.mesh();
  const int d = mesh.dimension();
  robot.velocity = Eigen::VectorXd::Zero(mesh.X.size());
  for (const BodySettings& body : simulation.bodies) {
    if (body.velocity.empty()) continue;
    const Part& part = mesh.part(body.name);
    for (int node = part.first_node; node < part.first_node + part.node_count; ++node)
      robot.velocity.segment(static_cast<Eigen::Index>(node) * d, d) = vector_of(body.velocity);
  }
  robot.scene = at(simulation, "the model", [&] { return builder.build(dynamic); });
  const Model& model = *robot.scene.model;
  robot.velocity = model.extend_from_free(model.restrict_to_free(robot.velocity));
  return robot;
}

}  // namespace taut

#include "calib/benches/model.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "calib/benches/recordings.hpp"
#include "sim/core/error.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/shapes/geometry.hpp"
#include "sim/terms/load.hpp"

namespace taut {
namespace {

Eigen::VectorXd vector_of(const std::vector<double>& values) {
  return Eigen::Map<const Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
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
    default:
      return {id, "F", "N", -1e9, 1e9, "force"};
  }
}

/// Loads and prescribed displacements are parameters beside the model's own, whose names they must not take.
int declare_control(SceneBuilder& builder, const std::string& id, Quantity quantity, double value) {
  return builder.declare(control_spec(id, quantity), value);
}

/// Half of a force or a hung mass on one half of a solid.
void add_half_load(SceneBuilder& builder, const LoadSettings& load, int control, int times, int depth_cells) {
  const Mesh& mesh = builder.mesh();
  const Eigen::VectorXd direction = vector_of(load.direction);
  Eigen::VectorXd weights = Eigen::VectorXd::Zero(mesh.X.size());
  if (load.point.empty()) {
    weights = mean_weights(mesh, mesh.select(load.on), direction);
  } else {
    // Simpson's rule over each layer: exact for what elements up to quadratic ones interpolate.
    double depth = 0;
    for (int i = 0; i < mesh.node_count(); ++i) depth = std::max(depth, mesh.node(i)[2]);
    for (int i = 0; i <= 2 * depth_cells; ++i) {
      Eigen::VectorXd point = vector_of(load.point);
      point[2] = depth * i / (2 * depth_cells);
      const double weight = (i == 0 || i == 2 * depth_cells ? 1 : i % 2 == 0 ? 2 : 4) / (6.0 * depth_cells);
      weights += weight * point_weights(mesh, locate(mesh, point), direction);
    }
  }
  std::vector<int> factors{control};
  if (times >= 0) factors.push_back(times);
  builder.add_term(make_load(0.5 * weights, factors));
}

void add_load(SceneBuilder& builder, const LoadSettings& load, int control, int gravity, int depth_cells) {
  const Eigen::VectorXd direction = vector_of(load.direction);
  const int times = load.quantity == Quantity::mass ? gravity : -1;
  if (depth_cells > 0 && (load.quantity == Quantity::force || load.quantity == Quantity::mass))
    return add_half_load(builder, load, control, times, depth_cells);
  if (!load.point.empty()) return builder.add_point_force(vector_of(load.point), direction, control, times);
  if (load.quantity == Quantity::pressure) return builder.add_traction(load.on, direction, control);
  if (load.quantity == Quantity::line_load) return builder.add_line_load(load.on, direction, control);
  builder.add_force(load.on, direction, control, times);
}

std::unique_ptr<Channel> make_channel(const Mesh& mesh, const ChannelSettings& settings) {
  const Eigen::VectorXd direction = vector_of(settings.direction);
  if (!settings.on.empty()) return make_linear_channel(mean_weights(mesh, mesh.select(settings.on), direction));
  const MaterialPoint point = locate(mesh, vector_of(settings.point));
  if (settings.standoff.empty()) return make_linear_channel(point_weights(mesh, point, direction));
  return make_marker_channel(mesh, point, vector_of(settings.standoff), mesh.select(settings.turns_with), direction);
}

/// The cables, and what they share: k_cable and slack.
void add_cables(const Experiment& experiment, double share, SceneBuilder& builder,
                const std::map<std::string, int>& controls, BenchModel& model) {
  const CablesSettings& settings = experiment.cables;
  auto length_of = [](const CableSettings& cable) {
    double length = 0;
    for (size_t i = 1; i < cable.points.size(); ++i)
      length += (vector_of(cable.points[i]) - vector_of(cable.points[i - 1])).norm();
    return length;
  };
  const double length = length_of(settings.cables.front());
  for (const CableSettings& cable : settings.cables) {
    if (settings.EA && std::abs(length_of(cable) - length) > 1e-9 * length) {
      throw InputError(
          fmt::format("EA gives cables of different lengths different stiffnesses, but all share k_cable: '{}' is "
                      "{:.4g} mm long and "
                      "'{}' {:.4g} mm; give k",
                      settings.cables.front().id, 1e3 * length, cable.id, 1e3 * length_of(cable)));
    }
  }
  const int k = builder.declare({"k_cable", "k", "N/m", 1e-3, 1e12, "stiffness of a whole cable", true},
                                settings.k ? *settings.k : *settings.EA / length);
  const int slack = builder.declare(
      {"slack", "s", "m", -0.5 * length, 0.5 * length, "length by which a cable exceeds its path at rest"},
      settings.slack);
  for (const CableSettings& cable : settings.cables) {
    Cable made;
    made.stiffness = k;
    made.slack = slack;
    made.smoothing = settings.smoothing;
    made.share = share;
    if (!cable.control.empty()) made.retraction = controls.at(cable.control);
    for (size_t i = 0; i < cable.points.size(); ++i) {
      const Eigen::VectorXd point = vector_of(cable.points[i]);
      const bool fixed = (i == 0 && cable.start_fixed) || (i + 1 == cable.points.size() && cable.end_fixed);
      made.points.push_back(fixed ? CablePoint{{}, point} : CablePoint{locate(builder.mesh(), point), point});
    }
    at(experiment, fmt::format("cable '{}'", cable.id), [&] { builder.add_cable(made); });
    model.cables.push_back(std::move(made));
  }
}

/// The pressure at which two faces rest half a contact gap apart, region by region; fixed for a run. Too small, and
/// faces come so near that the Hessian is ill-conditioned; too large, and the barrier acts within a sliver of its gap
/// that Newton's method finds and loses again. Soft bodies bear pressures of about their modulus; what presses stiff
/// ones together are the forces that the soft ones, the cables against them, and the loads bring.
std::map<std::string, double> contact_pressures(const Experiment& experiment, const Trials& trials,
                                                const SceneBuilder& builder) {
  double softest = 1e300, force = 0;
  for (const MaterialSettings& material : experiment.materials) softest = std::min(softest, material.constants.at("E"));
  for (size_t k = 0; k < trials.control_values.size(); ++k) {
    double largest = 0;
    for (double value : trials.control_values[k]) largest = std::max(largest, std::abs(value));
    if (trials.control_quantities[k] == Quantity::mass) force += largest * experiment.gravity;
    if (trials.control_quantities[k] == Quantity::force) force += largest;
  }
  const double load = force / (0.05 * builder.mesh().diagonal() * experiment.geometry.thickness);
  std::map<std::string, double> pressures;
  for (const MaterialSettings& material : experiment.materials)
    pressures[material.region] = std::min(material.constants.at("E"), 10 * softest + load);
  return pressures;
}

/// Whether a region moves as rigid bodies: more than 100 times as stiff as the softest one.
bool rigid(const Experiment& experiment, const MaterialSettings& material) {
  if (experiment.model != Rung::rigid_segments) return false;
  double softest = material.constants.at("E");
  for (const MaterialSettings& other : experiment.materials) softest = std::min(softest, other.constants.at("E"));
  return material.constants.at("E") > 100 * softest;
}

/// The material of a region. The constants of a rigid one are declared, and change nothing.
void add_material(const Experiment& experiment, const MaterialSettings& material, Formulation formulation,
                  SceneBuilder& builder) {
  if (!rigid(experiment, material))
    return builder.add_solid(material.region, material.law, material.constants, formulation);
  builder.add_rigid(material.region);
  for (ParameterSpec spec : material_parameters(material.law)) {
    const double value = material.constants.at(spec.id);
    spec.id += "_" + material.region;
    builder.declare(std::move(spec), value);
  }
}

/// Null in 3D.
const Contact* add_contact(const Experiment& experiment, const MeshSettings& settings, const Trials& trials,
                           SceneBuilder& builder) {
  std::map<std::string, double> pressures = contact_pressures(experiment, trials, builder);
  if (experiment.contact.stiffness) {
    for (auto& [region, value] : pressures) value = *experiment.contact.stiffness;
  }
  if (settings.depth_cells == 0) {
    return &builder.add_contact(contact_gap(settings, builder.mesh().diagonal()), pressures,
                                experiment.contact.obstacles, experiment.contact.grounds, experiment.contact.form);
  }
  std::vector<GroundPlane> grounds;
  for (const GroundLine& line : experiment.contact.grounds)
    grounds.push_back({{line.point[0], line.point[1], 0}, {line.normal[0], line.normal[1], 0}});
  const double section =
      std::sqrt(std::pow(builder.mesh().diagonal(), 2) - std::pow(experiment.geometry.thickness / 2, 2));
  builder.add_contact_3d(contact_gap(settings, section), pressures, grounds);
  return nullptr;
}

}  // namespace

Mesh make_mesh(const Experiment& experiment, const MeshSettings& settings) {
  return at(experiment, "[geometry]", [&] {
    return make_mesh(experiment.geometry, settings, experiment.contact.on, experiment.contact.compensate);
  });
}

Experiment as_solid(const Experiment& experiment, int depth_cells) {
  const auto refuse = [&](const std::string& what) {
    throw InputError(fmt::format("{}: as a solid, {}", experiment.path, what));
  };
  if (experiment.geometry.dimension != 2) refuse("an experiment has to be plane, and this one is in space already");
  if (depth_cells < 1) refuse("a body needs at least one layer of elements across half of its thickness");
  if (experiment.recordings) refuse("an experiment has readings at rest; recordings are replayed by the plane model");
  if (!experiment.contact.obstacles.empty()) refuse("a body meets grounds, but no obstacles; leave those out");
  if (experiment.contact.form != ContactForm::length_weighted)
    refuse("a body has the contact of the default form; leave 'form' out");
  Experiment solid = experiment;
  solid.geometry.dimension = 3;
  solid.geometry.plane = Plane::strain;  // of no meaning in space
  solid.mesh.depth_cells = depth_cells;
  const auto deepen = [](std::vector<double>& values) {
    if (!values.empty()) values.push_back(0);
  };
  for (SupportSettings& support : solid.supports) {
    if (support.rotation_stiffness) refuse("a face is fixed or free; take 'rotation_stiffness' out");
    if (support.fix.size() == 2) support.fix.push_back(2);
  }
  SupportSettings symmetry;
  symmetry.on = "symmetry";
  symmetry.fix = {2};
  solid.supports.push_back(symmetry);
  for (LoadSettings& load : solid.loads) {
    deepen(load.point);
    deepen(load.direction);
  }
  for (ChannelSettings& channel : solid.channels) {
    deepen(channel.point);
    deepen(channel.standoff);
    deepen(channel.direction);
  }
  deepen(solid.gravity_direction);
  for (CableSettings& cable : solid.cables.cables) {
    for (std::vector<double>& point : cable.points) deepen(point);
  }
  return solid;
}

BenchModel make_model(const Experiment& experiment, const MeshSettings& settings, const Trials& trials) {
  const bool half = settings.depth_cells > 0;
  if (half && experiment.geometry.dimension == 2)
    return make_model(as_solid(experiment, settings.depth_cells), settings, trials);
  BenchModel result;
  SceneBuilder builder(make_mesh(experiment, settings), experiment.geometry.plane, experiment.geometry.thickness);
  const int gravity = builder.declare({"g", "g", "m/s2", 0, 1000, "acceleration of gravity"}, experiment.gravity);
  if (!experiment.gravity_direction.empty()) result.switched_off_at_rest.push_back(gravity);
  if (experiment.model == Rung::rigid_segments &&
      std::none_of(experiment.materials.begin(), experiment.materials.end(),
                   [&](const MaterialSettings& material) { return rigid(experiment, material); })) {
    throw InputError(
        fmt::format("{}: model: no region is more than 100 times as stiff as the softest one, so that none "
                    "can be rigid; use \"full\"",
                    experiment.path));
  }
  for (const MaterialSettings& material : experiment.materials) {
    at(experiment, fmt::format("[materials.{}]", material.region), [&] {
      add_material(experiment, material, settings.formulation, builder);
      if (material.density && !experiment.gravity_direction.empty())
        builder.add_weight(material.region, *material.density, vector_of(experiment.gravity_direction), gravity);
      if (experiment.recordings) add_dynamics(experiment.dynamics, material, builder);
    });
  }
  std::map<std::string, int> control_index;
  for (size_t k = 0; k < experiment.bench.controls.size(); ++k) {
    const BenchFormat::Control& control = experiment.bench.controls[k];
    at(experiment, fmt::format("id '{}'", control.id),
       [&] { result.controls.push_back(declare_control(builder, control.id, trials.control_quantities[k], 0.0)); });
    control_index[control.id] = result.controls.back();
  }
  for (const SupportSettings& support : experiment.supports) {
    at(experiment, fmt::format("[[support]] on '{}'", support.on), [&] {
      builder.fix(support.on, support.fix);
      if (support.rotation_stiffness) builder.add_elastic_clamp(support.on, *support.rotation_stiffness);
      if (!support.control.empty()) builder.prescribe(support.on, support.component, control_index.at(support.control));
    });
  }
  for (const LoadSettings& load : experiment.loads) {
    at(experiment, fmt::format("[[load]] '{}'", load.id), [&] {
      int control;
      if (load.column.empty()) {
        control = declare_control(builder, load.id, load.quantity, load.value);
        result.switched_off_at_rest.push_back(control);
      } else {
        control = control_index.at(load.id);
      }
      add_load(builder, load, control, gravity, settings.depth_cells);
      if (experiment.recordings && load.quantity == Quantity::mass) builder.add_point_mass(load.on, control);
    });
  }
  if (!experiment.cables.cables.empty())
    at(experiment, "[cables]", [&] { add_cables(experiment, half ? 0.5 : 1.0, builder, control_index, result); });
  if (experiment.contact.on && !experiment.contact.idle)
    at(experiment, "[contact]", [&] { result.contact = add_contact(experiment, settings, trials, builder); });
  for (const ChannelSettings& channel : experiment.channels) {
    result.channels.push_back({channel.id, at(experiment, fmt::format("[[channel]] '{}'", channel.id),
                                              [&] { return make_channel(builder.mesh(), channel); })});
  }
  if (!experiment.zero_offset_per.empty()) {
    const size_t k = position_of_control(experiment, experiment.zero_offset_per);
    const double diagonal = builder.mesh().diagonal();
    for (double value : trials.control_values[k]) {
      const std::string id = fmt::format("zero_{}", result.zero_offsets.size() + 1);
      const std::string meaning = fmt::format("zero error of the readings at {} = {}", experiment.zero_offset_per,
                                              with_unit(value, builder.parameters()[result.controls[k]].unit));
      result.zero_offsets[value] = builder.declare({id, id, "m", -0.1 * diagonal, 0.1 * diagonal, meaning}, 0.0);
    }
  }
  if (experiment.recordings)
    at(experiment, "[bench]", [&] { result.recordings = declare_recordings(experiment, builder); });
  result.scene = at(experiment, "the model", [&] { return builder.build(); });
  return result;
}

size_t position_of_control(const Experiment& experiment, const std::string& id) {
  const auto found = std::find_if(experiment.bench.controls.begin(), experiment.bench.controls.end(),
                                  [&](const BenchFormat::Control& control) { return control.id == id; });
  return static_cast<size_t>(found - experiment.bench.controls.begin());
}

}  // namespace taut

#include "calib/benches/model.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "sim/core/error.hpp"
#include "sim/shapes/geometry.hpp"

namespace taut {
namespace {

/// A position: rest and displacement.
class FromOrigin final : public Channel {
 public:
  FromOrigin(std::unique_ptr<Channel> displacement, double rest)
      : displacement_(std::move(displacement)), rest_(rest) {}
  double value(const Point& at) const override { return rest_ + displacement_->value(at); }
  Eigen::VectorXd gradient(const Point& at) const override { return displacement_->gradient(at); }

 private:
  std::unique_ptr<Channel> displacement_;
  double rest_;
};

NamedChannel named(SceneReading reading) {
  if (reading.rest == 0) return {reading.id, std::move(reading.channel)};
  return {reading.id, std::make_unique<FromOrigin>(std::move(reading.channel), reading.rest)};
}

/// The largest forces and weights of a bench together [N].
double largest_force(const Experiment& experiment, const Trials& trials) {
  double force = 0;
  for (size_t k = 0; k < trials.control_values.size(); ++k) {
    double largest = 0;
    for (double value : trials.control_values[k]) largest = std::max(largest, std::abs(value));
    if (trials.control_quantities[k] == Quantity::mass) force += largest * experiment.gravity;
    if (trials.control_quantities[k] == Quantity::force) force += largest;
  }
  return force;
}

/// A zero error for each value of the control that they go with.
std::map<double, int> declare_zero_offsets(const Experiment& experiment, const Trials& trials, SceneBuilder& builder) {
  const std::string& control = experiment.zero_offset_per;
  const ParameterTable& table = builder.parameters();
  const std::string unit = table[table.index(control)].unit;
  const double diagonal = builder.mesh().diagonal();
  std::map<double, int> offsets;
  for (double value : trials.control_values[position_of_control(experiment, control)]) {
    const std::string id = fmt::format("zero_{}", offsets.size() + 1);
    const std::string meaning = fmt::format("zero error of the readings at {} = {}", control, with_unit(value, unit));
    offsets[value] = builder.declare({id, id, "m", -0.1 * diagonal, 0.1 * diagonal, meaning}, 0.0);
  }
  return offsets;
}

}  // namespace

Mesh make_mesh(const Experiment& experiment, const MeshSettings& settings) {
  return at(experiment, "[geometry]", [&] {
    return make_mesh(experiment.geometry, settings, experiment.contact.on, experiment.contact.compensate);
  });
}

Experiment as_solid(const Experiment& experiment, int depth_cells) {
  const auto refuse = [&](const std::string& what) { throw FileError(experiment.path, "as a solid, " + what); };
  if (experiment.geometry.dimension != 2) refuse("an experiment has to be plane, and this one is in space already");
  if (depth_cells < 1) refuse("a body needs at least one layer of elements across half of its thickness");
  if (!experiment.kind->at_rest)
    refuse("an experiment has readings at rest; recordings are replayed by the plane model");
  if (!experiment.contact.obstacles.empty()) refuse("a body meets grounds, but no obstacles; leave those out");
  if (experiment.contact.form != ContactForm::length_weighted)
    refuse("a body has the contact of the default form; leave 'form' out");
  const auto on_axis = [](const CableSettings& cable) { return cable.line.has_value(); };
  if (std::ranges::any_of(experiment.cables.cables, on_axis))
    refuse("a cable has points; give its x and y instead of 'along'");
  if (std::ranges::any_of(experiment.channels, [](const ChannelSettings& channel) { return !channel.marker.empty(); }))
    refuse("what is measured has points; make each [[marker]] a [[channel]]");
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
  for (LoadSettings& load : solid.loads) {
    deepen(load.point);
    deepen(load.direction);
  }
  for (ChannelSettings& channel : solid.channels) {
    deepen(channel.point);
    deepen(channel.standoff);
    deepen(channel.direction);
    if (channel.kind->directed == ChannelKind::Directed::in_space) channel.direction = {0, 0, 1};
  }
  deepen(solid.gravity_direction);
  deepen(solid.base_at);
  if (!solid.base_turn.empty()) solid.base_turn.insert(solid.base_turn.begin(), {0, 0});
  for (GroundSettings& ground : solid.contact.grounds) {
    ground.point = Eigen::Vector3d(ground.point[0], ground.point[1], 0);
    ground.normal = Eigen::Vector3d(ground.normal[0], ground.normal[1], 0);
  }
  for (CableSettings& cable : solid.cables.cables) {
    for (std::vector<double>& point : cable.points) deepen(point);
  }
  for (StudSettings& stud : solid.studs.studs) {
    for (std::vector<double>* place : {&stud.point, &stud.hole_point, &stud.direction}) deepen(*place);
  }
  return solid;
}

MeshSettings deepened(const Experiment& experiment, MeshSettings mesh) {
  const GeometrySettings& geometry = experiment.geometry;
  if (geometry.dimension != 2 || (mesh.size <= 0 && mesh.cells.empty())) {
    throw InputError(
        fmt::format("{}: model: a solid is swept from a plane section whose mesh has a size or cells, and a {} "
                    "in {}D is none; use \"full\"",
                    experiment.path, geometry.kind(), geometry.dimension));
  }
  const double along = mesh.size > 0 ? mesh.size : geometry.shape->extent()[0] / mesh.cells[0];
  mesh.depth_cells = std::clamp(static_cast<int>(std::ceil(0.5 * geometry.thickness / along)), 2, 8);
  return mesh;
}

Setup setup_of(const Experiment& experiment, const MeshSettings& settings, const Trials& trials) {
  Setup setup = experiment;
  setup.dimension = experiment.geometry.dimension;
  setup.thickness = experiment.geometry.thickness;
  setup.plane = experiment.geometry.plane;
  BodySettings& body = setup.bodies.emplace_back();
  body.geometry = experiment.geometry;
  body.mesh = settings;
  body.at = experiment.base_at;
  if (setup.dimension == 3)
    body.turn = experiment.base_turn;
  else if (!experiment.base_turn.empty())
    body.angle = experiment.base_turn.front();
  if (!body.at.empty() || !body.turn.empty() || body.angle != 0) {  // what is said of the body goes with it
    const auto move = [&](std::vector<double>& point) {
      const Eigen::VectorXd there = point.empty() ? Eigen::VectorXd() : placed(body, vector_of(point));
      point.assign(there.begin(), there.end());
    };
    const Eigen::MatrixXd rotation = rotation_of(body, setup.dimension);
    for (StudSettings& stud : setup.studs.studs) {
      move(stud.point);
      move(stud.hole_point);
      const Eigen::VectorXd turned = rotation * vector_of(stud.direction);
      stud.direction.assign(turned.begin(), turned.end());
    }
    for (LoadSettings& load : setup.loads) move(load.point);
    for (ChannelSettings& channel : setup.channels) {
      move(channel.point);
      if (channel.foot || channel.standoff.empty()) continue;  // in the frame of the body already
      const Eigen::VectorXd turned = rotation * vector_of(channel.standoff);
      channel.standoff.assign(turned.begin(), turned.end());
    }
  }
  for (size_t k = 0; k < experiment.bench.controls.size(); ++k)
    setup.controls.push_back({experiment.bench.controls[k].id, trials.control_quantities[k]});
  return setup;
}

BenchModel make_model(const Experiment& experiment, const MeshSettings& settings, const Trials& trials,
                      const std::function<void(SceneBuilder&)>& over_time) {
  if (settings.depth_cells > 0 && experiment.geometry.dimension == 2)
    return make_model(as_solid(experiment, settings.depth_cells), settings, trials);
  BenchModel model;
  SceneOptions options;
  options.over_time = over_time != nullptr;
  options.rigid_segments = experiment.model == Rung::rigid_segments;
  options.largest_force = largest_force(experiment, trials);
  options.declare = [&](SceneBuilder& builder) {
    if (!experiment.zero_offset_per.empty()) model.zero_offsets = declare_zero_offsets(experiment, trials, builder);
    if (over_time) over_time(builder);
  };
  static_cast<BuiltScene&>(model) = build_scene(setup_of(experiment, settings, trials), options);
  for (SceneReading& reading : model.readings) model.channels.push_back(named(std::move(reading)));
  return model;
}

size_t position_of_control(const Experiment& experiment, const std::string& id) {
  const auto found = std::find_if(experiment.bench.controls.begin(), experiment.bench.controls.end(),
                                  [&](const BenchFormat::Control& control) { return control.id == id; });
  return static_cast<size_t>(found - experiment.bench.controls.begin());
}

}  // namespace taut

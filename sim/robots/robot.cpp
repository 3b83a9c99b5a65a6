#include "sim/robots/robot.hpp"

#include <algorithm>

namespace taut {
namespace {

Eigen::VectorXd start_velocity(const Simulation& simulation, const Model& model) {
  const Mesh& mesh = model.mesh();
  const int d = mesh.dimension();
  Eigen::VectorXd velocity = Eigen::VectorXd::Zero(mesh.X.size());
  for (const BodySettings& body : simulation.bodies) {
    if (body.velocity.empty()) continue;
    const Part& part = mesh.part(body.name);
    for (int node = part.first_node; node < part.first_node + part.node_count; ++node)
      velocity.segment(static_cast<Eigen::Index>(node) * d, d) = vector_of(body.velocity);
  }
  return model.extend_from_free(model.restrict_to_free(velocity));
}

}  // namespace

Params Robot::at(const Simulation& simulation, double t) const {
  Params p = scene.values;
  for (size_t k = 0; k < controls.size(); ++k) p[controls[k]] = simulation.schedules[k].at(t);
  return p;
}

const SceneReading& Robot::reading(const std::string& id) const {
  return *std::ranges::find(readings, id, &SceneReading::id);
}

Robot make_robot(const Simulation& simulation) {
  SceneOptions options;
  options.over_time = simulation.method != SimulationMethod::quasi_static;
  options.rigid_segments = simulation.rigid_segments;
  options.free_bodies = options.over_time ? FreeBodies::move : FreeBodies::none;
  Robot robot{build_scene(simulation, options), {}};
  robot.scene.values = robot.at(simulation, 0);
  robot.velocity = start_velocity(simulation, *robot.scene.model);
  return robot;
}

}  // namespace taut

#pragma once
#include "sim/robots/simulation.hpp"
#include "sim/scene/build_scene.hpp"

namespace taut {

/// The model of a simulation, and how it starts.
struct Robot : BuiltScene {
  Eigen::VectorXd velocity;  ///< of all nodes at the start [m/s]

  /// All parameters at time t.
  Params at(const Simulation& simulation, double t) const;
  /// The reading of a channel that is there.
  const SceneReading& reading(const std::string& id) const;
};

/// Builds the model, controls as their schedules begin. Throws InputError as build_scene() does.
Robot make_robot(const Simulation& simulation);

}  // namespace taut

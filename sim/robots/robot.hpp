#pragma once
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "sim/model/channel.hpp"
#include "sim/robots/simulation.hpp"
#include "sim/scene/scene.hpp"
#include "sim/solve/time_stepper.hpp"

namespace taut {

/// A channel of a simulation: of the state, or where `part` >= 0 the net force on a part, which needs a time step.
struct RobotReading {
  std::string id, unit, meaning;
  std::unique_ptr<Channel> channel;  ///< y(u; p)
  double rest = 0;                   ///< added to it: a position is rest and displacement
  int part = -1;                     ///< of a net force
  Eigen::VectorXd direction;         ///< of a net force, unit length
};

/// The model of a simulation, and what its file's names mean in it.
struct Robot {
  Scene scene;
  std::vector<RobotReading> readings;                        ///< as simulation.channels has them
  std::vector<int> controls;                                 ///< table index per control
  int gravity = -1;                                          ///< table index
  std::vector<Cable> cables;                                 ///< as simulation.cables has them
  std::vector<Joint> joints;                                 ///< as simulation.joints has them
  Eigen::VectorXd velocity;                                  ///< of all nodes at the start [m/s]
  std::function<bool(const Eigen::VectorXd& u)> intersects;  ///< exact test of a state; empty: there is no contact
  std::function<double(const Eigen::VectorXd& u, double horizon)> smallest_distance;  ///< [m], looked for up to horizon

  /// All parameters at time t.
  Params at(const Simulation& simulation, double t) const;
};

/// Builds the model. Throws InputError with the file's name and the table for what does not fit: points outside their
/// body, cables through no body, bodies that overlap at rest.
Robot make_robot(const Simulation& simulation);

}  // namespace taut

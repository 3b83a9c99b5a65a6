#pragma once
#include <atomic>
#include <string>
#include <vector>

#include "sim/robots/robot.hpp"
#include "sim/robots/soft_ik.hpp"

namespace taut {

/// What was found for one target of [ik], or for one point of a path.
struct IkAnswer {
  IkResult result;                       ///< `achieved` is what SoftIk's channels say; see below
  std::vector<size_t> free;              ///< places of result.controls in simulation.controls
  std::vector<std::string> channels;     ///< ids of the channels with a value
  std::vector<double> wanted, achieved;  ///< of these, SI; places, not displacements, where the channels are such
  Eigen::VectorXd u;                     ///< the state [m]; empty when no equilibrium was found
  Params p;
};

/// Finds controls for a target by SoftIk, statically: without inertia, with contact. From rest the held controls go to
/// their values first, the others staying nominal. The points of a path are then followed, each from the last one.
/// Errors of angles count as 1 m per radian. Ends early when `stop` is raised.
std::vector<IkAnswer> solve_target(const Simulation& simulation, const Robot& robot, const IkTarget& target,
                                   const std::atomic<bool>* stop = nullptr);

}  // namespace taut

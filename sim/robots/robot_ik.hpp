#pragma once
#include <atomic>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "sim/core/units.hpp"
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

/// What the values of a target are on a channel: a length for a place, an angle; nullopt: it cannot have one.
std::optional<Quantity> target_quantity(const ChannelSettings& channel);

/// Finds controls for one target after another by SoftIk, statically: without inertia, with contact; what drives a
/// robot along targets that come as it goes. The first one starts at rest, where held controls go to their values
/// first, the others staying nominal; each further one at the answer before it, whatever is held or asked for. After an
/// answer without a state the next one starts at rest again. Errors of angles count as 1 m per radian.
class RobotIk {
 public:
  /// For a simulation with [ik]; it, the robot and `stop`, which ends a search early, have to outlive this.
  RobotIk(const Simulation& simulation, const Robot& robot, const std::atomic<bool>* stop = nullptr);

  /// For a target, or for one `point` of a path. Ids of channels and controls are there, and one control is free.
  IkAnswer solve(const IkTarget& target, size_t point = 0);

  /// The next target starts at this equilibrium, wherever it came from: such as the pose that rigid kinematics has.
  void start_at(const Eigen::VectorXd& u, const Params& p);

 private:
  void ask_for(const IkTarget& target);

  const Simulation* simulation_;
  const Robot* robot_;
  const std::atomic<bool>* stop_;
  std::unique_ptr<SoftIk> ik_;  ///< for targets of the kind below
  std::map<std::string, double> hold_;
  std::string stiffness_of_;
  IkAnswer blank_;                            ///< what all their answers have in common
  std::vector<double> rest_;                  ///< added to the value of each channel
  std::pair<Eigen::VectorXd, Params> start_;  ///< of the first target; empty: at rest
};

/// All points of a target or path of [ik], from rest, each from the last one. Ends early when `stop` is raised.
std::vector<IkAnswer> solve_target(const Simulation& simulation, const Robot& robot, const IkTarget& target,
                                   const std::atomic<bool>* stop = nullptr);

/// Which of such answers, by their places, a slow and straight motion of the controls from the one before (of the
/// first, from rest) does not come to: its path of equilibria ends on the way, and the scene jumps or goes elsewhere
/// (by more than a hundredth of its size). Answers without a state are left out.
std::vector<size_t> jumps_to(const Simulation& simulation, const Robot& robot, const std::vector<IkAnswer>& answers,
                             const std::atomic<bool>* stop = nullptr);

}  // namespace taut

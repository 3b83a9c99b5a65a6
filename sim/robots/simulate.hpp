#pragma once
#include <atomic>
#include <functional>
#include <string>
#include <vector>

#include "sim/robots/robot.hpp"

namespace taut {

/// What a simulation found: every accepted step, and what an independent test says of it afterwards.
struct SimulationResult {
  std::vector<double> times;                  ///< [s], the start included
  std::vector<Eigen::VectorXd> states;        ///< u of each [m]
  std::vector<std::vector<double>> controls;  ///< per control, over the times, SI
  std::vector<std::vector<double>> readings;  ///< per channel
  std::vector<double> kinetic, potential;     ///< energies [J]; with all terms, without inertia and damping
  std::string failure;                        ///< why it ended early; "": it did not
  bool interrupted = false;
  int steps = 0, repeated = 0;  ///< accepted; solved again with a shorter step
  int iterations = 0, factorisations = 0;
  int saddles_left = 0;  ///< static: equilibria on whose way an unstable one was left (buckling)
  double seconds = 0;
  // Of all accepted states, tested after the run.
  double smallest_jacobian = 0;    ///< over quadrature points and nodes; <= 0: an element has folded
  int intersecting = 0;            ///< states in which boundaries cross, exactly
  double smallest_distance = 0;    ///< between boundaries that may touch [m]; +inf without contact
  double largest_joint_gap = 0;    ///< [m]
  double largest_motor_error = 0;  ///< actual less commanded angle [rad]
};

struct SimulateOptions {
  const std::atomic<bool>* stop = nullptr;
  std::function<void(double t, const SimulationResult& so_far)> progress;
};

/// Runs a simulation from its start to its end, or as far as it goes: what was finished is kept.
SimulationResult simulate(const Simulation& simulation, const Robot& robot, const SimulateOptions& options = {});

/// All parameters at rest: gravity and all controls that load or move zero.
Params at_rest(const Simulation& simulation, const Robot& robot);

/// Places that can be reached in one mode of actuation.
struct WorkspaceResult {
  std::string mode;
  std::vector<Eigen::Vector2d> points;   ///< [m]
  std::vector<Eigen::Vector2d> outline;  ///< of what they cover, see reach_of() [m]
  double area = 0;                       ///< of what they cover [m^2]
  int failures = 0;                      ///< samples without an equilibrium
};

/// Samples a mode of [workspace]: equilibria at the ends of its ranges and along a curve through them, each from the
/// last one, so that each is where a robot would get to. Along the curve control k goes to and fro in a time of its
/// own, in proportion to 1/sqrt of the k-th prime, and dwells at its ends, where the border is made; a sample moves no
/// control by more than an eighth of its range. What they cover is drawn with a disc of a sixth of the scene's
/// diagonal.
WorkspaceResult sample_workspace(const Simulation& simulation, const Robot& robot, const WorkspaceMode& mode,
                                 const std::atomic<bool>* stop = nullptr);

}  // namespace taut

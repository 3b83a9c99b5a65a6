#pragma once
#include <Eigen/Core>
#include <atomic>
#include <functional>
#include <string>
#include <vector>

#include "sim/robots/simulate.hpp"

namespace taut {

/// What a search over controls in time makes small: a pure number J of the values x that the pieces of the free
/// controls of [optimise] end at,
///
///   J(x) = sum over goals  -y/scale (maximise), y/scale (minimise), ((y - value)/scale)^2 (reach)
///        + sum over free controls and their pieces  ((x_k - x_(k-1))/change)^2      where a `change` is given,
///
/// y the channel of a goal at its time, x_0 what the control starts with.
class ControlObjective {
 public:
  /// A value that is free: where one piece of a control ends, SI.
  struct Target {
    size_t control = 0, piece = 0;  ///< places in Simulation::controls and in ControlSchedule::pieces()
    double lower = 0, upper = 0;
  };
  /// J and what it was made of.
  struct Value {
    double objective = 0;       ///< J; +inf where the simulation ended early, folded or crossed itself
    double effort = 0;          ///< the second sum
    std::vector<double> goals;  ///< y of each goal, SI
    Eigen::VectorXd gradient;   ///< dJ/dx, per SI unit of each target
    /// Of the goals alone, dJ/dx without effort.
    Eigen::VectorXd goal_gradient;
    SimulationResult run;
  };

  /// For a simulation with [optimise] and its robot; both, and `stop`, which interrupts a run, outlive it.
  ControlObjective(const Simulation& simulation, const Robot& robot, const std::atomic<bool>* stop = nullptr);

  const std::vector<Target>& targets() const { return targets_; }  ///< control by control, in time
  Eigen::VectorXd start() const;                                   ///< as the file has them, SI
  /// All controls of the simulation, the free ones with these targets, SI.
  std::vector<ControlSchedule> schedules(const Eigen::VectorXd& targets) const;
  /// J and its gradient, by one simulation and one backward pass of the discrete adjoint method (through equilibria:
  /// one solve per goal), whatever the number of targets.
  Value at(const Eigen::VectorXd& targets) const;

 private:
  double add_effort(const Eigen::VectorXd& targets, Eigen::VectorXd& gradient) const;

  const Simulation* simulation_;
  const Robot* robot_;
  const std::atomic<bool>* stop_;
  std::vector<Target> targets_;
  std::vector<double> change_;  ///< per target; 0: costs nothing
  SimulationSensitivities wanted_;
  std::vector<size_t> row_;  ///< of each target's control in the gradient over time
};

/// How a search ended.
enum class OptimiseStatus {
  converged,
  stalled,        ///< nothing much lower was found, though the gradient is over a twentieth of its largest
  not_converged,  ///< iterations used up
  interrupted,    ///< the best so far is kept
  failed          ///< the simulation of the file's own controls fails
};
/// "converged", "not converged".
std::string_view name_of(OptimiseStatus status);

/// One iteration of the search.
struct OptimiseIteration {
  int iteration = 0;         ///< 0: where it begins
  double objective = 0;      ///< J
  double gradient_norm = 0;  ///< of J by q, see optimise()
  int simulations = 0;       ///< so far
};

/// What was found.
struct OptimiseResult {
  OptimiseStatus status = OptimiseStatus::converged;
  std::string message;                          ///< a sentence
  Eigen::VectorXd before, found;                ///< targets as the file has them, and as they were found, SI
  std::vector<int> bound;                       ///< of each found one: -1 or +1 within a thousandth of a bound, else 0
  ControlObjective::Value before_value, value;  ///< of both, with their simulations
  std::vector<OptimiseIteration> iterations;
  int simulations = 0, failed = 0;  ///< in all; of these the ones that ended early, folded or crossed themselves
  double seconds = 0;
};

/// Looks for the controls that make J of ControlObjective small, from those of the file, by L-BFGS with a Wolfe line
/// search (Ceres, GradientProblemSolver). Bounds hold by a change of variables, x = (lower + upper)/2 + (upper -
/// lower)/2 sin q, the search being over q; targets within a fortieth of their range of a bound start that far inside,
/// as at a bound dx/dq = 0. It ends where an iteration lowers J by less than `tolerance` of it, or where the gradient
/// by q has fallen to `tolerance` of where it began: at a local minimum at best. A simulation that fails costs that
/// point, not the search. `told` hears of every iteration. Throws InputError where no target moves a goal at the start.
OptimiseResult optimise(const Simulation& simulation, const Robot& robot, const std::atomic<bool>* stop = nullptr,
                        const std::function<void(const OptimiseIteration&)>& told = {});

}  // namespace taut

#pragma once
#include <atomic>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "sim/robots/robot.hpp"
#include "sim/solve/equilibrium.hpp"

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
  std::string side;      ///< of the first of two alike sides, see SolveReport::side
  /// Static: where a path of equilibria ended and the scene went over to another one, as it would by a jump.
  struct Slip {
    double t = 0;     ///< [s], of the schedule
    double jump = 0;  ///< largest displacement of a node in the step in which that happened [m]
  };
  std::vector<Slip> slips;
  double seconds = 0;
  // Of all accepted states, tested after the run.
  double smallest_jacobian = 0;    ///< over quadrature points and nodes; <= 0: an element has folded
  int intersecting = 0;            ///< states in which boundaries cross, exactly
  double smallest_distance = 0;    ///< between boundaries that may touch [m]; +inf without contact
  double largest_joint_gap = 0;    ///< [m]
  double largest_motor_error = 0;  ///< actual less commanded angle [rad]
  // As SimulateOptions::sensitivities asks for them, per unit of each parameter, SI.
  std::vector<Eigen::MatrixXd> derivatives;  ///< of all readings, (readings x parameters), over the times
  std::vector<size_t> goal_samples;  ///< which of the times each goal is at; empty: the run ended before one of them
  std::vector<double> goal_values;   ///< of the goals, SI
  /// Of what the goals make up, by what each parameter is at each time alone, (parameters x times).
  Eigen::MatrixXd goal_gradient_over_time;
  Eigen::VectorXd goal_gradient;  ///< the same by parameters that are offset alike at all times, (parameters)
};

/// Which derivatives a run follows. They are exact ones of what the run computed: of its equilibria, or of its time
/// steps, whose lengths count as given (so do the contact's pressures, which a file without them derives from its
/// moduli). A control counts as the offset of its whole schedule, a start in equilibrium moves with the parameters. A
/// kink (a cable that goes taut) has one-sided derivatives only, of the side on which the state is.
struct SimulationSensitivities {
  std::vector<int> parameters;  ///< table indices
  bool all_readings = false;    ///< of all readings at every time, forward: one linear solve per time and parameter
  /// One reading at one time: at the accepted state nearest to `time` [s]. No net force, which depends on several
  /// states.
  struct Goal {
    size_t reading = 0;
    double time = 0;
  };
  /// Derivatives of one number that is a function of goals, by the adjoint method: one linear solve per time.
  std::vector<Goal> goals;
  /// That number's derivatives by the goals' values; empty: it is their sum.
  std::function<std::vector<double>(const std::vector<double>& values)> slopes;
  bool any() const { return all_readings || !goals.empty(); }  ///< something is asked for
};

/// Who may end a simulation, who is told, and which derivatives are wanted.
struct SimulateOptions {
  const std::atomic<bool>* stop = nullptr;
  std::function<void(double t, const SimulationResult& so_far)> progress;
  SimulationSensitivities sensitivities;
};

/// Runs a simulation from its start to its end, or as far as it goes: what was finished is kept. Throws InputError when
/// sensitivities are asked of an integrator that has none (SUNDIALS'), or a goal of a net force.
SimulationResult simulate(const Simulation& simulation, const Robot& robot, const SimulateOptions& options = {});

/// All parameters at rest: gravity and all controls that load or move zero.
Params at_rest(const Simulation& simulation, const Robot& robot);

/// The solver of a simulation's equilibria, at rest, that looks for slips. `model` has the unknowns and parameters of
/// the robot's own, which it is as a rule, and outlives it.
Equilibrium equilibrium_at_rest(const Simulation& simulation, const Robot& robot, const Model& model,
                                const std::atomic<bool>* stop = nullptr);

}  // namespace taut

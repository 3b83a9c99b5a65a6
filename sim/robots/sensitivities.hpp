#pragma once
#include <Eigen/Core>
#include <vector>

#include "sim/robots/robot.hpp"
#include "sim/solve/time_stepper.hpp"

namespace taut {

/// dy/dp = dy/du du/dp + dy/dp at fixed u of a channel, one per index; `du` (unknowns x indices).
Eigen::RowVectorXd channel_derivatives(const Channel& channel, const Point& at, const Eigen::MatrixXd& du,
                                       const std::vector<int>& indices);

/// What the derivatives of a state are: of u, and in a time step of its step.reference, (unknowns x numbers), and of
/// its step.memory.
struct StateDerivatives {
  const Eigen::MatrixXd& du;
  const Eigen::MatrixXd& dreference;
  const Eigen::MatrixXd& dmemory;
};

/// Where a channel is read: within the step where it had one.
inline Point point_of(const AcceptedStep& step) {
  const bool has_past = step.h > 0 || step.step.memory.size() > 0;
  return {step.u, step.p, has_past ? &step.step : nullptr};
}

/// Force of a reading of kind net_force, by all others but gravity: mass times acceleration less weight [N]. Zero at
/// the start, where there is no step yet.
double net_force(const Robot& robot, const SceneReading& reading, const AcceptedStep& step);

/// dy/dp of all readings in a state, (readings x indices), per unit of each parameter; of a net force by its inertia
/// and weight, which are linear in every density, mass and thickness.
Eigen::MatrixXd reading_derivatives(const Robot& robot, const AcceptedStep& step, const StateDerivatives& state,
                                    const std::vector<int>& indices);

/// A reading in one state of a trajectory, with what it counts.
struct WeightedReading {
  size_t reading = 0, state = 0;
  double weight = 1;
};

/// The derivatives of a weighted sum of readings with respect to what each parameter is in each state alone, (indices x
/// states), by the adjoint method: one linear solve per state, whatever the number of parameters, readings and states.
/// Their sum over a row is the derivative by a parameter that is the same in all states, or is offset alike. `states`
/// are all accepted steps of a trajectory, its start included; `du_start` (unknowns x indices) the derivatives of that
/// start by the parameters in it. The readings have channels (they are no net forces).
Eigen::MatrixXd reading_gradient(const Robot& robot, std::vector<AcceptedStep> states,
                                 const std::vector<WeightedReading>& sum, const Eigen::MatrixXd& du_start,
                                 const std::vector<int>& indices);

}  // namespace taut

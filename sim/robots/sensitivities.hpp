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

/// The derivatives of one reading in the last of `states` with respect to parameters that are the same in all of them,
/// or are all offset alike, by the adjoint method: one linear solve per state, whatever the number of parameters.
/// `states` are all accepted steps of a trajectory, its start included; `du_start` (unknowns x indices) the derivatives
/// of that start. The reading has a channel (it is no net force).
Eigen::VectorXd reading_gradient(const Robot& robot, std::vector<AcceptedStep> states, const SceneReading& reading,
                                 const Eigen::MatrixXd& du_start, const std::vector<int>& indices);

}  // namespace taut

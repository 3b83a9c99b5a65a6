#include "sim/robots/sensitivities.hpp"

namespace taut {
namespace {

/// M (u - reference) times step.inertia, without damping: gravity excepted, what a part feels [N], all unknowns.
Eigen::VectorXd inertia_force(const Model& model, const AcceptedStep& step, const Params& p) {
  Eigen::VectorXd force;
  Assembly out;
  out.gradient = &force;
  TimeStep undamped = step.step;  // rates zero: mass-proportional damping is a force like others
  undamped.rate = {undamped.rate[0], -undamped.rate[0], 0};
  undamped.previous = step.u;
  model.evaluate_inertia({step.u, p, &undamped}, out);
  return force;
}

/// Minus the weight [N], all unknowns.
Eigen::VectorXd lift(const Robot& robot, const AcceptedStep& step, const Params& p) {
  return p[robot.gravity] * robot.scene.model->parameter_gradient({step.u, p}, robot.gravity);
}

/// Sum over the reading's part of its direction times `forces`.
double along(const Robot& robot, const SceneReading& reading, const Eigen::VectorXd& forces) {
  const Mesh& mesh = robot.scene.model->mesh();
  const Part& part = mesh.parts[static_cast<size_t>(reading.part)];
  const int d = mesh.dimension();
  double sum = 0;
  for (int node = part.first_node; node < part.first_node + part.node_count; ++node)
    sum += reading.direction.dot(forces.segment(static_cast<Eigen::Index>(node) * d, d));
  return sum;
}

Eigen::RowVectorXd net_force_derivatives(const Robot& robot, const SceneReading& reading, const AcceptedStep& step,
                                         const StateDerivatives& state, const std::vector<int>& indices) {
  const Model& model = *robot.scene.model;
  Eigen::RowVectorXd result = Eigen::RowVectorXd::Zero(static_cast<Eigen::Index>(indices.size()));
  if (step.h == 0) return result;
  for (size_t j = 0; j < indices.size(); ++j) {
    const auto column = static_cast<Eigen::Index>(j);
    AcceptedStep change = step;  // the force is linear in u - reference
    change.u = state.du.col(column);
    change.step.reference = state.dreference.col(column);
    Params with = step.p, without = step.p;  // ... and in each parameter
    with[indices[j]] = 1;
    without[indices[j]] = 0;
    result[column] =
        along(robot, reading,
              inertia_force(model, change, step.p) + inertia_force(model, step, with) -
                  inertia_force(model, step, without) + lift(robot, step, with) - lift(robot, step, without));
  }
  return result;
}

}  // namespace

Eigen::RowVectorXd channel_derivatives(const Channel& channel, const Point& at, const Eigen::MatrixXd& du,
                                       const std::vector<int>& indices) {
  Eigen::RowVectorXd row = channel.gradient(at).transpose() * du;
  for (Eigen::Index j = 0; j < row.size(); ++j)
    row[j] += channel.parameter_derivative(at, indices[static_cast<size_t>(j)]);
  return row;
}

double net_force(const Robot& robot, const SceneReading& reading, const AcceptedStep& step) {
  if (step.h == 0) return 0;
  return along(robot, reading, inertia_force(*robot.scene.model, step, step.p) + lift(robot, step, step.p));
}

Eigen::MatrixXd reading_derivatives(const Robot& robot, const AcceptedStep& step, const StateDerivatives& state,
                                    const std::vector<int>& indices) {
  Eigen::MatrixXd result(static_cast<Eigen::Index>(robot.readings.size()), static_cast<Eigen::Index>(indices.size()));
  Eigen::Index row = 0;
  const Point at = point_of(step);
  for (const SceneReading& reading : robot.readings) {
    auto to = result.row(row++);
    if (!reading.channel) {
      to = net_force_derivatives(robot, reading, step, state, indices);
      continue;
    }
    to = channel_derivatives(*reading.channel, at, state.du, indices);
    if (at.step == nullptr || at.step->memory.size() == 0 || state.dmemory.size() == 0) continue;
    for (Eigen::Index j = 0; j < to.size(); ++j) to[j] += reading.channel->memory_derivative(at, state.dmemory.col(j));
  }
  return result;
}

Eigen::MatrixXd reading_gradient(const Robot& robot, std::vector<AcceptedStep> states,
                                 const std::vector<WeightedReading>& sum, const Eigen::MatrixXd& du_start,
                                 const std::vector<int>& indices) {
  const auto count = static_cast<Eigen::Index>(indices.size());
  Eigen::MatrixXd result = Eigen::MatrixXd::Zero(count, static_cast<Eigen::Index>(states.size()));
  std::vector<Eigen::VectorXd> by_state(states.size());  // empty: zero
  for (const WeightedReading& one : sum) {
    const Channel& channel = *robot.readings[one.reading].channel;
    const Point at = point_of(states[one.state]);
    Eigen::VectorXd& gradient = by_state[one.state];
    if (gradient.size() == 0) gradient = Eigen::VectorXd::Zero(at.u.size());
    gradient += one.weight * channel.gradient(at);
    for (Eigen::Index j = 0; j < count; ++j)
      result(j, static_cast<Eigen::Index>(one.state)) +=
          one.weight * channel.parameter_derivative(at, indices[static_cast<size_t>(j)]);
  }
  Eigen::VectorXd by_start = std::move(by_state.front());
  states.erase(states.begin());
  by_state.erase(by_state.begin());
  if (!states.empty()) {
    const TrajectoryGradient trajectory = adjoint_gradient(*robot.scene.model, states, by_state, indices);
    result.rightCols(trajectory.parameters.cols()) += trajectory.parameters;
    if (by_start.size() == 0) by_start = Eigen::VectorXd::Zero(trajectory.start.size());
    by_start += trajectory.start;
  }
  if (by_start.size() > 0) result.col(0) += du_start.transpose() * by_start;
  return result;
}

}  // namespace taut

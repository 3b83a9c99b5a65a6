#include "sim/robots/optimise.hpp"

#include <ceres/first_order_function.h>
#include <ceres/gradient_problem.h>
#include <ceres/gradient_problem_solver.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "sim/core/error.hpp"
#include "sim/core/stopwatch.hpp"

namespace taut {
namespace {

using Aim = OptimiseGoal::Aim;

double part_of(const OptimiseGoal& goal, double y) {
  const double miss = (y - goal.value) / goal.scale;
  return goal.aim == Aim::reach ? miss * miss : (goal.aim == Aim::maximise ? -1 : 1) * y / goal.scale;
}

double slope_of(const OptimiseGoal& goal, double y) {
  if (goal.aim == Aim::reach) return 2 * (y - goal.value) / (goal.scale * goal.scale);
  return (goal.aim == Aim::maximise ? -1 : 1) / goal.scale;
}

/// Why a run is no point of the search; "": it is one.
std::string fault_of(const SimulationResult& run) {
  if (!run.failure.empty()) return run.failure;
  if (run.smallest_jacobian <= 0) return "elements fold";
  if (run.intersecting > 0) return "boundaries cross";
  return "";
}

constexpr double kInside = 0.95;  ///< largest |sin q| at the start

/// J over q, for Ceres; keeps the best that it has seen.
class SearchFunction final : public ceres::FirstOrderFunction {
 public:
  SearchFunction(const ControlObjective& objective, OptimiseResult& result, const std::atomic<bool>* stop)
      : objective_(objective), result_(result), stop_(stop) {}

  int NumParameters() const override { return static_cast<int>(objective_.targets().size()); }

  bool Evaluate(const double* parameters, double* cost, double* gradient) const override {
    const Eigen::VectorXd q = Eigen::Map<const Eigen::VectorXd>(parameters, NumParameters());
    if (last_q_.size() == 0 || last_q_ != q) {
      if (stop_ != nullptr && stop_->load()) return false;
      look_at(q);
    }
    *cost = scale_ * last_objective_;
    if (gradient != nullptr && std::isfinite(*cost))
      Eigen::Map<Eigen::VectorXd>(gradient, NumParameters()) = scale_ * last_gradient_;
    return std::isfinite(*cost);
  }

  Eigen::VectorXd q_of(const Eigen::VectorXd& x) const {
    Eigen::VectorXd q(x.size());
    for (Eigen::Index j = 0; j < q.size(); ++j) {
      const ControlObjective::Target& target = objective_.targets()[static_cast<size_t>(j)];
      const double sine = (2 * x[j] - target.lower - target.upper) / (target.upper - target.lower);
      q[j] = std::asin(std::clamp(sine, -kInside, kInside));
    }
    return q;
  }

  /// J times a number, so that the first step does not depend on the units of goals.
  void begin_at(const Eigen::VectorXd& q) {
    look_at(q);
    const double steepest = last_gradient_.size() > 0 ? last_gradient_.cwiseAbs().maxCoeff() : 0;
    if (steepest > 0) scale_ = kFirstStep / steepest;
  }

  double unscaled(double cost) const { return cost / scale_; }
  double gradient_norm() const { return best_norm_; }  ///< at the best point
  static constexpr double kFirstStep = 0.3;            ///< of the steepest q

 private:
  void look_at(const Eigen::VectorXd& q) const {
    Eigen::VectorXd x(q.size()), slope(q.size());
    for (Eigen::Index j = 0; j < q.size(); ++j) {
      const ControlObjective::Target& target = objective_.targets()[static_cast<size_t>(j)];
      const double half = 0.5 * (target.upper - target.lower);
      x[j] = std::clamp(0.5 * (target.lower + target.upper) + half * std::sin(q[j]), target.lower, target.upper);
      slope[j] = half * std::cos(q[j]);
    }
    ControlObjective::Value value = objective_.at(x);
    ++result_.simulations;
    last_q_ = q;
    last_objective_ = value.objective;
    if (!std::isfinite(value.objective)) {
      if (!value.run.interrupted) ++result_.failed;
      return;
    }
    last_gradient_ = value.gradient.cwiseProduct(slope);
    if (!(value.objective < result_.value.objective)) return;
    best_norm_ = last_gradient_.norm();
    result_.found = x;
    result_.value = std::move(value);
  }

  const ControlObjective& objective_;
  OptimiseResult& result_;
  const std::atomic<bool>* stop_;
  double scale_ = 1;
  mutable Eigen::VectorXd last_q_, last_gradient_;  ///< Ceres' functions are const
  mutable double last_objective_ = 0, best_norm_ = 0;
};

/// Tells of iterations, and ends a search that is interrupted.
class TellIteration final : public ceres::IterationCallback {
 public:
  TellIteration(const SearchFunction& function, OptimiseResult& result, const std::atomic<bool>* stop,
                const std::function<void(const OptimiseIteration&)>& told)
      : function_(function), result_(result), stop_(stop), told_(told) {}

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override {
    add({summary.iteration, function_.unscaled(summary.cost), function_.unscaled(summary.gradient_norm),
         result_.simulations});
    return stop_ != nullptr && stop_->load() ? ceres::SOLVER_ABORT : ceres::SOLVER_CONTINUE;
  }

  void add(const OptimiseIteration& iteration) {
    result_.iterations.push_back(iteration);
    if (told_) told_(iteration);
  }

 private:
  const SearchFunction& function_;
  OptimiseResult& result_;
  const std::atomic<bool>* stop_;
  const std::function<void(const OptimiseIteration&)>& told_;
};

void refuse_goals_that_nothing_moves(const Simulation& simulation, const Robot& robot,
                                     const ControlObjective& objective, const ControlObjective::Value& start) {
  double size = 0;  // what rounding of the gradient is measured against
  bool pulls = false;
  for (size_t g = 0; g < start.goals.size(); ++g) {
    const OptimiseGoal& goal = simulation.optimise->goals[g];
    const double slope = std::abs(slope_of(goal, start.goals[g]));
    const SceneReading& reading = robot.reading(goal.channel);
    size += slope * std::max(std::abs(start.goals[g]), std::abs(reading.rest));
    pulls = pulls || slope > 0;
  }
  double most = 0;
  for (size_t j = 0; j < objective.targets().size(); ++j)
    most = std::max(most, (objective.targets()[j].upper - objective.targets()[j].lower) *
                              std::abs(start.goal_gradient[static_cast<Eigen::Index>(j)]));
  if (!pulls || most > 1e-12 * size) return;
  throw InputError(
      fmt::format("{}: [optimise]: no free control moves a goal (the gradient at the start is zero); free other "
                  "controls, choose a goal at a later time, or start from controls that act on it",
                  simulation.path));
}

/// Whether the gradient has fallen with J: at a kink only J's changes become small.
bool is_flat(const std::vector<OptimiseIteration>& iterations) {
  const double steepest = std::ranges::max_element(iterations, {}, &OptimiseIteration::gradient_norm)->gradient_norm;
  return iterations.back().gradient_norm <= 0.05 * steepest;
}

void conclude(const ceres::GradientProblemSolver::Summary& summary, bool stopped, OptimiseResult& result) {
  using enum OptimiseStatus;
  const int iterations = result.iterations.empty() ? 0 : result.iterations.back().iteration;
  const std::string lost =
      result.failed == 0 ? "" : fmt::format("; {} of {} simulations failed", result.failed, result.simulations);
  if (stopped) {
    result.status = interrupted;
    result.message = fmt::format("interrupted after {} iterations; the best so far is kept", iterations);
  } else if (summary.termination_type == ceres::CONVERGENCE && is_flat(result.iterations)) {
    result.status = converged;
    result.message = fmt::format("converged after {} iterations, to a local optimum", iterations);
  } else if (summary.termination_type == ceres::NO_CONVERGENCE) {
    result.status = not_converged;
    result.message = fmt::format(
        "not converged: {} iterations were not enough; give more as iterations of [optimise], or go on from "
        "the controls that were found",
        iterations);
  } else {
    result.status = stalled;
    result.message = fmt::format(
        "stalled after {} iterations: nothing much lower is found, though the gradient is not small, as at a "
        "kink (contact, a cable that goes taut) or at the accuracy of the simulation",
        iterations);
  }
  result.message += lost;
}

}  // namespace

ControlObjective::ControlObjective(const Simulation& simulation, const Robot& robot, const std::atomic<bool>* stop)
    : simulation_(&simulation), robot_(&robot), stop_(stop) {
  const OptimiseSettings& settings = *simulation.optimise;
  for (const OptimiseRange& range : settings.controls) {
    const auto control = static_cast<size_t>(std::ranges::find(simulation.controls, range.id, &ControlSettings::id) -
                                             simulation.controls.begin());
    const std::vector<ControlSchedule::Piece>& pieces = simulation.schedules[control].pieces();
    for (size_t piece = 0; piece < pieces.size(); ++piece) {
      if (!ControlSchedule::has_target(pieces[piece])) continue;
      targets_.push_back({control, piece, range.lower, range.upper});
      change_.push_back(range.change.value_or(0));
      row_.push_back(wanted_.parameters.size());
    }
    wanted_.parameters.push_back(robot.controls[control]);
  }
  for (const OptimiseGoal& goal : settings.goals) {
    const auto reading = std::ranges::find(robot.readings, goal.channel, &SceneReading::id) - robot.readings.begin();
    wanted_.goals.push_back({static_cast<size_t>(reading), goal.time});
  }
  wanted_.slopes = [&settings](const std::vector<double>& values) {
    std::vector<double> slopes;
    for (size_t g = 0; g < values.size(); ++g) slopes.push_back(slope_of(settings.goals[g], values[g]));
    return slopes;
  };
}

Eigen::VectorXd ControlObjective::start() const {
  Eigen::VectorXd x(static_cast<Eigen::Index>(targets_.size()));
  for (size_t j = 0; j < targets_.size(); ++j)
    x[static_cast<Eigen::Index>(j)] = simulation_->schedules[targets_[j].control].pieces()[targets_[j].piece].target;
  return x;
}

std::vector<ControlSchedule> ControlObjective::schedules(const Eigen::VectorXd& targets) const {
  std::vector<ControlSchedule> schedules = simulation_->schedules;
  for (size_t j = 0; j < targets_.size(); ++j)
    schedules[targets_[j].control].set_target(targets_[j].piece, targets[static_cast<Eigen::Index>(j)]);
  return schedules;
}

double ControlObjective::add_effort(const Eigen::VectorXd& targets, Eigen::VectorXd& gradient) const {
  double effort = 0;
  for (size_t j = 0; j < targets_.size(); ++j) {
    if (change_[j] == 0) continue;
    const auto here = static_cast<Eigen::Index>(j);
    const bool first = j == 0 || targets_[j - 1].control != targets_[j].control;
    const double from = first ? simulation_->schedules[targets_[j].control].start() : targets[here - 1];
    const double change = (targets[here] - from) / change_[j];
    effort += change * change;
    gradient[here] += 2 * change / change_[j];
    if (!first) gradient[here - 1] -= 2 * change / change_[j];
  }
  return effort;
}

ControlObjective::Value ControlObjective::at(const Eigen::VectorXd& targets) const {
  Simulation moved = *simulation_;
  moved.schedules = schedules(targets);
  Value value;
  SimulateOptions options;
  options.stop = stop_;
  options.sensitivities = wanted_;
  value.run = simulate(moved, *robot_, options);
  value.objective = std::numeric_limits<double>::infinity();
  if (!fault_of(value.run).empty() || value.run.goal_samples.empty()) return value;
  value.goals = value.run.goal_values;
  value.goal_gradient = Eigen::VectorXd::Zero(targets.size());
  for (size_t j = 0; j < targets_.size(); ++j) {
    const ControlSchedule weight = moved.schedules[targets_[j].control].by_target(targets_[j].piece);
    double sum = 0;
    for (size_t k = 0; k < value.run.times.size(); ++k)
      sum += weight.at(value.run.times[k]) *
             value.run.goal_gradient_over_time(static_cast<Eigen::Index>(row_[j]), static_cast<Eigen::Index>(k));
    value.goal_gradient[static_cast<Eigen::Index>(j)] = sum;
  }
  value.gradient = value.goal_gradient;
  value.effort = add_effort(targets, value.gradient);
  value.objective = value.effort;
  for (size_t g = 0; g < value.goals.size(); ++g)
    value.objective += part_of(simulation_->optimise->goals[g], value.goals[g]);
  return value;
}

std::string_view name_of(OptimiseStatus status) {
  switch (status) {
    case OptimiseStatus::converged:
      return "converged";
    case OptimiseStatus::stalled:
      return "stalled";
    case OptimiseStatus::not_converged:
      return "not converged";
    case OptimiseStatus::interrupted:
      return "interrupted";
    case OptimiseStatus::failed:
      break;
  }
  return "failed";
}

OptimiseResult optimise(const Simulation& simulation, const Robot& robot, const std::atomic<bool>* stop,
                        const std::function<void(const OptimiseIteration&)>& told) {
  const Stopwatch stopwatch;
  const ControlObjective objective(simulation, robot, stop);
  const auto stopped = [&] { return stop != nullptr && stop->load(); };
  OptimiseResult result;
  result.before = result.found = objective.start();
  result.bound.assign(objective.targets().size(), 0);
  result.before_value = objective.at(result.before);
  ++result.simulations;
  result.value = result.before_value;
  if (!std::isfinite(result.value.objective)) {
    result.status = stopped() ? OptimiseStatus::interrupted : OptimiseStatus::failed;
    result.message = stopped() ? "interrupted before there was anything to keep"
                               : fmt::format(
                                     "the simulation of the file's own controls fails: {}; start from controls "
                                     "that can be simulated",
                                     fault_of(result.value.run));
    return result;
  }
  refuse_goals_that_nothing_moves(simulation, robot, objective, result.value);

  auto* function = new SearchFunction(objective, result, stop);
  const ceres::GradientProblem problem(function);  // owns it
  TellIteration tell(*function, result, stop, told);
  Eigen::VectorXd q = function->q_of(result.before);
  function->begin_at(q);
  ceres::GradientProblemSolver::Options options;
  options.line_search_direction_type = ceres::LBFGS;
  options.line_search_type = ceres::WOLFE;
  options.max_num_iterations = simulation.optimise->iterations;
  options.function_tolerance = simulation.optimise->tolerance;
  options.gradient_tolerance = simulation.optimise->tolerance * SearchFunction::kFirstStep;
  options.parameter_tolerance = 1e-3 * simulation.optimise->tolerance;
  options.logging_type = ceres::SILENT;
  options.callbacks.push_back(&tell);
  ceres::GradientProblemSolver::Summary summary;
  ceres::Solve(options, problem, q.data(), &summary);
  if (summary.termination_type == ceres::CONVERGENCE && result.value.objective < result.iterations.back().objective)
    tell.add({result.iterations.back().iteration + 1, result.value.objective, function->gradient_norm(),
              result.simulations});  // Ceres does not tell of the last one
  conclude(summary, stopped(), result);
  for (size_t j = 0; j < result.bound.size(); ++j) {
    const ControlObjective::Target& target = objective.targets()[j];
    const double x = result.found[static_cast<Eigen::Index>(j)], near = 1e-3 * (target.upper - target.lower);
    result.bound[j] = x < target.lower + near ? -1 : x > target.upper - near ? 1 : 0;
  }
  result.seconds = stopwatch.seconds();
  return result;
}

}  // namespace taut

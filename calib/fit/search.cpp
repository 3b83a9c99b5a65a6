#include "calib/fit/search.hpp"

#include <ceres/ceres.h>

#include "calib/fit/goodness_of_fit.hpp"
#include "sim/core/dense.hpp"

namespace taut {
namespace {

/// All residuals as one block, because one simulation yields them all.
class ResidualBlock final : public ceres::CostFunction {
 public:
  explicit ResidualBlock(Evaluator& evaluator) : evaluator_(evaluator) {
    set_num_residuals(evaluator.residual_count());
    mutable_parameter_block_sizes()->assign(static_cast<size_t>(evaluator.count()), 1);
  }
  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    Eigen::VectorXd q(evaluator_.count());
    for (Eigen::Index j = 0; j < q.size(); ++j) q[j] = blocks[j][0];
    if (!evaluator_.evaluate(q)) return false;
    Eigen::Map<Eigen::VectorXd>(residuals, num_residuals()) = evaluator_.residuals();
    if (jacobians == nullptr) return true;
    const Eigen::MatrixXd J = evaluator_.jacobian();
    for (Eigen::Index j = 0; j < q.size(); ++j) {
      if (jacobians[j] != nullptr) Eigen::Map<Eigen::VectorXd>(jacobians[j], num_residuals()) = J.col(j);
    }
    return true;
  }

 private:
  Evaluator& evaluator_;
};

/// A Gauss-Newton step that minds the bounds, and how much it promises that chi squared falls.
struct BoundedStep {
  Eigen::VectorXd step;
  double decrease;
};

/// From `from`, with all that are in `held` where they are.
BoundedStep step_within_bounds(const Evaluator& evaluator, const Linearised& from,
                               const std::vector<Eigen::Index>& held) {
  Eigen::VectorXd lower(from.q.size()), upper = lower;
  for (Eigen::Index j = 0; j < from.q.size(); ++j) {
    const bool stays = std::ranges::find(held, j) != held.end();
    lower[j] = stays ? 0 : std::min(0.0, evaluator.scale(j).lower - from.q[j]);
    upper[j] = stays ? 0 : std::max(0.0, evaluator.scale(j).upper - from.q[j]);
  }
  const Eigen::VectorXd step = bounded_least_squares(from.jacobian, -from.residuals, lower, upper);
  return {step, from.residuals.squaredNorm() - (from.residuals + from.jacobian * step).squaredNorm()};
}

/// Ends a search that is interrupted, or that has nothing more to gain: that saves the evaluation which would show it.
class StopCallback final : public ceres::IterationCallback {
 public:
  StopCallback(const Evaluator& evaluator, const std::vector<Eigen::Index>& held, double tolerance)
      : evaluator_(evaluator), held_(held), tolerance_(tolerance) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override {
    if (evaluator_.halted()) return ceres::SOLVER_TERMINATE_SUCCESSFULLY;  // the best values so far are kept
    if (!summary.step_is_successful) return ceres::SOLVER_CONTINUE;
    const Linearised here{evaluator_.point(), evaluator_.residuals(), evaluator_.jacobian()};
    return step_within_bounds(evaluator_, here, held_).decrease <= 0.1 * tolerance_ * evaluator_.chi_squared()
               ? ceres::SOLVER_TERMINATE_SUCCESSFULLY
               : ceres::SOLVER_CONTINUE;
  }

 private:
  const Evaluator& evaluator_;
  const std::vector<Eigen::Index>& held_;
  double tolerance_;
};

/// Ceres's search from `q`, with all that are in `held` where they are.
Minimum descend(Evaluator& evaluator, const Eigen::VectorXd& q, const std::vector<Eigen::Index>& held, double radius,
                const FitOptions& options) {
  Minimum minimum;
  minimum.q = q;
  if (!evaluator.evaluate(q)) {  // Ceres would say so on stderr
    minimum.message = "the simulation failed at the start";
    return minimum;
  }
  ceres::Problem::Options problem_options;
  problem_options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ResidualBlock block(evaluator);
  ceres::Problem problem(problem_options);
  std::vector<double*> blocks;
  for (double& value : minimum.q) blocks.push_back(&value);
  problem.AddResidualBlock(&block, nullptr, blocks);
  for (Eigen::Index j = 0; j < q.size(); ++j) {
    const Scale& scale = evaluator.scale(j);
    double* const value = &minimum.q[j];
    if (std::ranges::find(held, j) != held.end()) {
      problem.SetParameterBlockConstant(value);
      continue;
    }
    if (std::isfinite(scale.lower)) problem.SetParameterLowerBound(value, 0, scale.lower);
    if (std::isfinite(scale.upper)) problem.SetParameterUpperBound(value, 0, scale.upper);
  }
  StopCallback stop(evaluator, held, options.tolerance);
  ceres::Solver::Options solver;
  solver.linear_solver_type = ceres::DENSE_QR;
  solver.max_num_iterations = options.max_iterations;
  solver.function_tolerance = options.tolerance;
  solver.parameter_tolerance = 1e-10;
  solver.gradient_tolerance = 1e-12;
  solver.initial_trust_region_radius = radius;
  solver.max_num_consecutive_invalid_steps = 20;  // failed simulations shorten the step, they do not end the fit
  solver.logging_type = ceres::SILENT;
  solver.callbacks.push_back(&stop);
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &problem, &summary);
  const bool nothing_more = summary.termination_type == ceres::USER_SUCCESS;
  minimum.failed = summary.termination_type == ceres::FAILURE;
  minimum.converged = nothing_more || summary.termination_type == ceres::CONVERGENCE;
  minimum.iterations = std::max(0, static_cast<int>(summary.iterations.size()) - 1);
  minimum.message = nothing_more ? "a further step promises nothing more" : summary.message;
  minimum.chi_squared = 2 * summary.final_cost;
  return minimum;
}

}  // namespace

Evaluator::Evaluator(Protocol& protocol, const std::vector<Measurement>& measurements,
                     const std::vector<FreeParameter>& free, const FitOptions& options)
    : protocol_(protocol), measurements_(measurements), free_(free), options_(options) {
  for (const FreeParameter& parameter : free) {
    indices_.push_back(parameter.index);
    Scale& scale = scales_.emplace_back(Scale{protocol.parameters()[parameter.index].logarithmic});
    scale.lower = scale.inside(parameter.lower);
    scale.upper = scale.inside(parameter.upper);
  }
}

std::vector<double> Evaluator::values(const Eigen::VectorXd& q) const {
  std::vector<double> si;
  for (Eigen::Index j = 0; j < count(); ++j) si.push_back(scale(j).outside(q[j]));
  return si;
}

Params Evaluator::params(const Eigen::VectorXd& q) const {
  Params p = options_.held.size() > 0 ? options_.held : protocol_.nominal();
  const std::vector<double> si = values(q);
  for (size_t j = 0; j < si.size(); ++j) p[indices_[j]] = std::clamp(si[j], free_[j].lower, free_[j].upper);
  return p;
}

bool Evaluator::evaluate(const Eigen::VectorXd& q) {
  if (point_.size() > 0 && point_ == q) return ok_;
  point_ = q;
  ++evaluations;
  if (cold_) protocol_.forget();
  prediction_ = protocol_.predict(params(q), indices_);
  ok_ = prediction_.complete();
  if (history != nullptr && !stopped()) history->push_back({phase_, ok_ ? chi_squared() : not_a_number, values(q)});
  if (!ok_) {
    ++failed;
    last_failure = q;
    for (const std::string& failure : prediction_.failures) {
      if (failures.size() < 5) failures.push_back(failure);
    }
    return false;
  }
  const std::vector<double> si = values(q);
  for (Eigen::Index j = 0; j < count(); ++j)
    prediction_.derivatives.col(j) *= scale(j).slope(si[static_cast<size_t>(j)]);
  if (options_.progress)
    options_.progress({phase_, evaluations, std::max(0, phase_end_ - evaluations), chi_squared(), si});
  return true;
}

double Evaluator::cost() const {
  return by_calls_ ? evaluations : protocol_.factorisations();
}

void Evaluator::allow(double replays, int replay) {
  by_calls_ = replay == 0;
  allowed_ = cost() + replays * std::max(replay, 1);
}

bool Evaluator::spent() const {
  return allowed_ && cost() >= *allowed_;
}

Eigen::VectorXd Evaluator::residuals() const {
  return noise_scaled(prediction_, measurements_).residuals;
}

Eigen::MatrixXd Evaluator::jacobian() const {
  return noise_scaled(prediction_, measurements_).jacobian;
}

double promised_decrease(const Evaluator& at, const Eigen::VectorXd& q) {
  return step_within_bounds(at, {q, at.residuals(), at.jacobian()}, {}).decrease;
}

Promise promised_minimum(const Evaluator& evaluator, Linearised from, Eigen::Index held, double value) {
  if (held >= 0) {
    from.residuals += from.jacobian.col(held) * (value - from.q[held]);
    from.q[held] = value;
  }
  const BoundedStep way = step_within_bounds(evaluator, from, {held});
  Promise promise{from.q + way.step, from.residuals.squaredNorm() - way.decrease};
  for (Eigen::Index j = 0; j < promise.q.size(); ++j) promise.q[j] = evaluator.scale(j).clamped(promise.q[j]);
  return promise;
}

Minimum minimise(Evaluator& evaluator, const Eigen::VectorXd& q, Eigen::Index held, double radius,
                 const FitOptions& options) {
  Minimum minimum = descend(evaluator, q, {held}, radius, options);
  // Ceres shortens a step that meets a bound as a whole, and may end where those that are free have still far to go.
  // What a step within the bounds leaves at one waits there.
  for (Eigen::Index round = 0; round < 2 * q.size() && !minimum.failed && !evaluator.halted(); ++round) {
    if (!evaluator.evaluate(minimum.q)) break;
    const BoundedStep way =
        step_within_bounds(evaluator, {minimum.q, evaluator.residuals(), evaluator.jacobian()}, {held});
    if (way.decrease <= options.tolerance * minimum.chi_squared) break;
    std::vector<Eigen::Index> waiting{held};
    Eigen::VectorXd start = minimum.q;
    for (Eigen::Index j = 0; j < q.size(); ++j) {
      const Scale& scale = evaluator.scale(j);
      if (j == held || scale.room(minimum.q[j] + way.step[j]) > 1e-12 * scale.range(q[j])) continue;
      waiting.push_back(j);
      start[j] = scale.clamped(minimum.q[j] + way.step[j]);
    }
    if (round == 0 && waiting.size() == 1) break;  // no bound is in the way
    Minimum lower = descend(evaluator, start, waiting, undamped, options);
    if (lower.failed || !(lower.chi_squared < minimum.chi_squared)) break;
    lower.iterations += minimum.iterations;
    minimum = std::move(lower);
  }
  return minimum;
}

bool step_in_compliance(Evaluator& evaluator, Eigen::VectorXd& q) {
  if (!evaluator.evaluate(q) || evaluator.stopped()) return false;
  const Eigen::VectorXd r = evaluator.residuals();
  // A least-squares step of minimum norm: parameters that the readings do not see stay where they are.
  const Eigen::VectorXd step = -minimum_norm_solution(evaluator.jacobian(), r);
  Eigen::VectorXd trial = q;
  for (Eigen::Index j = 0; j < q.size(); ++j) {
    const Scale& scale = evaluator.scale(j);
    trial[j] += scale.logarithmic ? -std::log1p(-std::clamp(step[j], -2.0, 2.0 / 3.0)) : step[j];
    trial[j] = scale.clamped(trial[j]);
  }
  if (trial == q || !evaluator.evaluate(trial) || !(evaluator.chi_squared() < r.squaredNorm())) return false;
  q = trial;
  return true;
}

std::vector<Eigen::VectorXd> designed_starts(const Evaluator& evaluator, const Eigen::VectorXd& q) {
  std::vector<Eigen::VectorXd> starts;
  for (int k = 0; k < 4; ++k) {
    Eigen::VectorXd& start = starts.emplace_back(q);
    for (Eigen::Index j = 0; j < q.size(); ++j) {
      const bool up = j % 3 == 0 ? k % 2 == 0 : j % 3 == 1 ? k / 2 == 0 : (k == 0 || k == 3);
      const Scale& scale = evaluator.scale(j);
      const double reach = scale.logarithmic ? 0.5 * std::log(10.0) : 0.25 * scale.range(q[j]);
      start[j] = scale.clamped(q[j] + (up ? reach : -reach));
    }
  }
  return starts;
}

}  // namespace taut

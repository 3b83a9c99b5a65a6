#include "sim/solve/time_stepper.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "sim/solve/hessian.hpp"
#include "sim/solve/motion.hpp"

namespace taut {
namespace {

/// Rates of the two-step formula for a step h after a step h_before; of implicit Euler when that is 0.
std::array<double, 3> rates(double h, double h_before) {
  if (h_before == 0) return {1 / h, -1 / h, 0};
  const double w = h / h_before;
  return {(1 + 2 * w) / ((1 + w) * h), -(1 + w) / h, w * w / ((1 + w) * h)};
}

/// The state from which inertia counts: a = rate (rate u + past rates of u) + past rates of v = rate^2 (u - reference).
/// `u2` and `v2` are only read when rate[2] is not zero.
template <class Derived>
Derived reference_of(const std::array<double, 3>& rate, const Derived& u1, const Derived& v1, const Derived* u2,
                     const Derived* v2) {
  const double a0 = rate[0];
  Derived reference = -(rate[1] / a0) * u1 - (rate[1] / (a0 * a0)) * v1;
  if (rate[2] != 0) reference -= (rate[2] / a0) * *u2 + (rate[2] / (a0 * a0)) * *v2;
  return reference;
}

/// The step of length h from `now` to t, yet to be solved: what its potential knows of the past. Implicit Euler without
/// a step `before`.
AcceptedStep step_from(const AcceptedStep& now, const AcceptedStep* before, const Eigen::VectorXd& memory, double t,
                       double h, Params p) {
  AcceptedStep next;
  next.t = t;
  next.h = h;
  next.p = std::move(p);
  const std::array<double, 3> rate = rates(h, before != nullptr ? now.h : 0.0);
  if (before != nullptr) next.step.before = before->u;
  next.step.inertia = rate[0] * rate[0];
  next.step.rate = rate;
  next.step.reference = reference_of(rate, now.u, now.v, before != nullptr ? &before->u : nullptr,
                                     before != nullptr ? &before->v : nullptr);
  next.step.previous = now.u;
  next.step.length = h;
  next.step.memory = memory;
  return next;
}

/// Largest difference of a solved step from the trapezoidal rule with the same velocities [m], which is one order
/// better than implicit Euler and has another error constant than BDF2.
double error_of(const AcceptedStep& now, const AcceptedStep& next) {
  return (next.u - now.u - 0.5 * next.h * (now.v + next.v)).cwiseAbs().maxCoeff();
}

}  // namespace

TimeStepper::TimeStepper(const Model& model, TimeStepperOptions options)
    : model_(&model), options_(options), minimiser_(model, options.equilibrium), next_step_(options.step) {
  if (!(options.step > 0) || options.tolerance < 0 || !(options.shortest > 0))
    throw std::logic_error("a time stepper needs a positive step, and a tolerance of zero or more");
}

void TimeStepper::start(double t, const Eigen::VectorXd& u, const Eigen::VectorXd& v, const Schedule& schedule,
                        const Eigen::MatrixXd& du) {
  schedule_ = schedule;
  now_ = {t, 0, u, v, schedule(t), {}};
  model_->impose_supports(now_.p, now_.u);
  before_.clear();
  next_step_ = options_.step;
  report_ = {};
  minimiser_.start_at_rest(now_.p);  // forgets the contacts of earlier runs
  forget_derivatives();
  if (du.size() > 0) du_ = du;
  remember_start();
}

void TimeStepper::track(int count, std::function<Eigen::MatrixXd(double t)> derivative) {
  tracked_ = count;
  derivative_ = std::move(derivative);
  forget_derivatives();
}

/// As if it had come from rest all at once.
void TimeStepper::remember_start() {
  const Eigen::VectorXd nothing = Eigen::VectorXd::Zero(model_->memory_size());
  TimeStep at_once;
  at_once.memory = nothing;
  const Point at{now_.u, now_.p, &at_once};
  memory_ = model_->remember(at);
  if (tracked_ == 0 || nothing.size() == 0) return;
  dmemory_ = model_->remember_change(at, du_, derivative_(now_.t), dmemory_);
}

void TimeStepper::forget_derivatives() {
  du_ = dv_ = dreference_ = Eigen::MatrixXd::Zero(model_->unknowns(), tracked_);
  dmemory_ = Eigen::MatrixXd::Zero(model_->memory_size(), tracked_);
  dmemory_before_.resize(0, 0);
}

/// Where the search begins: moved on with the present velocity, as far as nothing is in the way and elements bear it.
Eigen::VectorXd TimeStepper::predicted(double h, const Params& p, const TimeStep& step) const {
  double fraction = 1;
  Eigen::VectorXd u = Motion(*model_, p).admissible(now_.u, h * now_.v, p, fraction);
  Eigen::VectorXd plain = now_.u;
  for (Eigen::VectorXd* candidate : {&u, &plain}) model_->impose_supports(p, *candidate);
  Assembly moved, stayed;
  model_->evaluate({u, p, &step}, moved);
  model_->evaluate({plain, p, &step}, stayed);
  return moved.energy <= stayed.energy ? u : plain;
}

bool TimeStepper::advance(double until) {
  const int order = options_.integrator == Integrator::bdf2 ? 2 : 1;
  const double shortest = options_.shortest * options_.step;
  double h = next_step_;
  bool shortened = false;
  while (true) {
    const double left = until - now_.t;
    if (h >= left * (1 - 1e-9)) h = left;
    const AcceptedStep* before = before_.empty() || order == 1 ? nullptr : &before_.front();
    const double t = h == left ? until : now_.t + h;
    AcceptedStep next = step_from(now_, before, memory_, t, h, schedule_(t));
    const Eigen::VectorXd first = predicted(h, next.p, next.step);
    const bool passes = model_->step_limit({now_.u, next.p, &next.step}, first - now_.u) < 1;
    const SolveReport& solve = minimiser_.solve_step(first, next.p, next.step);
    report_.iterations += solve.iterations;
    report_.factorisations += solve.factorisations;
    report_.status = passes ? SolveStatus::infeasible_start : solve.status;
    if (report_.status == SolveStatus::interrupted) return false;
    if (report_.status != SolveStatus::converged) {
      ++report_.failures;
      h *= 0.5;
      shortened = true;
      before_.clear();  // what made it fail is likely to be a kink
      if (h < shortest) return false;
      continue;
    }
    next.u = minimiser_.u();
    const std::array<double, 3>& rate = next.step.rate;
    next.v = rate[0] * next.u + rate[1] * now_.u;
    if (before != nullptr) next.v += rate[2] * before->u;

    if (options_.tolerance > 0) {
      const double error = error_of(now_, next) / (options_.tolerance * model_->length_scale());
      const double factor = 0.9 * std::pow(std::max(error, 1e-12), -1.0 / ((before == nullptr ? 1 : order) + 1));
      if (error > 1 && h > shortest) {
        ++report_.rejections;
        h *= std::max(0.2, factor);
        shortened = true;
        continue;
      }
      if (error > 1) {  // not even the shortest step is good enough
        report_.status = SolveStatus::stalled;
        return false;
      }
      next_step_ = std::min(options_.step, h * std::clamp(factor, 0.5, 2.0));
    } else {
      next_step_ = shortened || h < next_step_ ? std::min(options_.step, 2 * h) : options_.step;
    }
    const bool two_steps = before != nullptr;
    before_.clear();
    before_.push_back(std::move(now_));
    now_ = std::move(next);
    minimiser_.step_moved_to(now_.step);
    if (tracked_ > 0) follow_derivatives(two_steps);
    memory_ = model_->remember({now_.u, now_.p, &now_.step});
    ++report_.steps;
    return true;
  }
}

/// H du = -(dg/dp dp/dtheta + dg/d(past) d(past)/dtheta), on top of what the supports move.
void TimeStepper::follow_derivatives(bool two_steps) {
  const Point at{now_.u, now_.p, &now_.step};
  const std::array<double, 3>& rate = now_.step.rate;
  dreference_ = reference_of(rate, du_, dv_, &du_before_, &dv_before_);
  const Eigen::MatrixXd dp = derivative_(now_.t);
  Eigen::MatrixXd force = Eigen::MatrixXd::Zero(du_.rows(), tracked_);
  for (int j = 0; j < tracked_; ++j) {
    force.col(j) += model_->history_product(at, History::reference, dreference_.col(j), false) +
                    model_->history_product(at, History::previous, du_.col(j), false);
    if (two_steps) force.col(j) += model_->history_product(at, History::before, du_before_.col(j), false);
    force.col(j) += model_->memory_product(at, dmemory_.col(j));
  }
  if (!minimiser_.refactorise())
    throw std::logic_error("a time step's Hessian is not positive definite at its minimum");
  Eigen::MatrixXd du = minimiser_.response(dp, std::move(force));
  Eigen::MatrixXd dv = rate[0] * du + rate[1] * du_;
  if (two_steps) dv += rate[2] * du_before_;
  dmemory_before_ = std::exchange(dmemory_, model_->remember_change(at, du, dp, dmemory_));
  du_before_ = std::exchange(du_, std::move(du));
  dv_before_ = std::exchange(dv_, std::move(dv));
}

TrajectoryGradient adjoint_gradient(const Model& model, const std::vector<AcceptedStep>& steps,
                                    const std::vector<Eigen::VectorXd>& gradients, const std::vector<int>& indices) {
  if (model.memory_size() > 0) throw std::logic_error("the adjoint method knows no memory; track() does");
  const Eigen::VectorXd zero = Eigen::VectorXd::Zero(model.unknowns());
  Eigen::MatrixXd result(indices.size(), steps.size());
  // Derivatives of Q with respect to the state at the end of this step and of the two before it.
  std::array<Eigen::VectorXd, 3> u{zero, zero, zero}, v{zero, zero, zero};
  Hessian hessian(model);
  const Reduction& unknowns = hessian.reduction();
  for (size_t k = steps.size(); k-- > 0;) {
    const AcceptedStep& step = steps[k];
    const std::array<double, 3>& rate = step.step.rate;
    const Point at{step.u, step.p, &step.step};
    if (k < gradients.size() && gradients[k].size() > 0) u[0] += gradients[k];
    for (size_t i = 0; i < 3; ++i) u[i] += rate[i] * v[0];  // v = sum of rate * u
    hessian.assemble(at, Curvature::exact, nullptr);
    if (!hessian.factorise()) throw std::logic_error("a time step's Hessian is not positive definite at its minimum");
    const Eigen::VectorXd lambda =
        unknowns.extend_from_free(at.u, hessian.solve(unknowns.restrict_to_free(at.u, u[0])));
    const Eigen::VectorXd at_supports = u[0] - model.hessian_times(at, lambda);
    for (size_t i = 0; i < indices.size(); ++i) {
      result(i, k) =
          at_supports.dot(model.support_derivative(indices[i])) - lambda.dot(model.parameter_gradient(at, indices[i]));
    }
    const Eigen::VectorXd reference = -model.history_product(at, History::reference, lambda, true);
    const double a0 = rate[0];
    u[1] -= model.history_product(at, History::previous, lambda, true) + (rate[1] / a0) * reference;
    v[1] -= (rate[1] / (a0 * a0)) * reference;
    if (rate[2] != 0) {
      u[2] -= model.history_product(at, History::before, lambda, true) + (rate[2] / a0) * reference;
      v[2] -= (rate[2] / (a0 * a0)) * reference;
    }
    u = {std::move(u[1]), std::move(u[2]), zero};
    v = {std::move(v[1]), std::move(v[2]), zero};
  }
  return {std::move(result), std::move(u[0])};
}

}  // namespace taut

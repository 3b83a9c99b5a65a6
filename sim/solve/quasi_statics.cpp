#include "sim/solve/quasi_statics.hpp"

#include <cmath>
#include <stdexcept>
#include <utility>

namespace taut {

void QuasiStatics::start_at_rest(const Params& p, int tracked) {
  equilibrium_.start_at_rest(p);
  memory_ = Eigen::VectorXd::Zero(equilibrium_.model().memory_size());
  du_ = Eigen::MatrixXd::Zero(equilibrium_.model().unknowns(), tracked);
  dmemory_ = Eigen::MatrixXd::Zero(memory_.size(), tracked);
}

const SolveReport& QuasiStatics::advance(const Params& p, const Eigen::MatrixXd& dp, double length) {
  const Model& model = equilibrium_.model();
  step_ = {};
  step_.length = length;
  step_.memory = memory_;
  const SolveReport& report = equilibrium_.solve(p, Polish::full, &step_);
  if (report.status != SolveStatus::converged) return report;
  const Point at{equilibrium_.u(), p, &step_};
  if (du_.cols() > 0) {
    Eigen::MatrixXd force(du_.rows(), du_.cols());
    for (Eigen::Index j = 0; j < force.cols(); ++j) force.col(j) = model.memory_product(at, dmemory_.col(j));
    if (!equilibrium_.refactorise()) throw std::logic_error("an equilibrium's Hessian is not positive definite");
    du_ = equilibrium_.response(dp, std::move(force));
    dmemory_before_ = std::exchange(dmemory_, model.remember_change(at, du_, dp, dmemory_));
  }
  memory_ = model.remember(at);
  return report;
}

SolveReport QuasiStatics::hold(const Params& p, const Eigen::MatrixXd& dp, double duration) {
  constexpr int steps = 16;
  SolveReport sum;
  double before = 0;
  for (int k = 1; k <= steps && duration > 0; ++k) {
    const double now = duration * std::pow(1.5, k - steps);
    const SolveReport& one = advance(p, dp, now - before);
    sum.status = one.status;
    sum.iterations += one.iterations;
    sum.factorisations += one.factorisations;
    sum.slipped |= one.slipped;
    sum.left_saddle |= one.left_saddle;
    if (one.status != SolveStatus::converged) {
      sum.gradient = one.gradient;
      sum.reached = before / duration;
      break;
    }
    before = now;
  }
  return sum;
}

}  // namespace taut

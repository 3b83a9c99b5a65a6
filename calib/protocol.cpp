#include "calib/protocol.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <exception>
#include <limits>
#include <mutex>
#include <thread>

#include "sim/terms/solid.hpp"

namespace taut {

StaticProtocol::StaticProtocol(Scene scene, std::vector<NamedChannel> channels, std::vector<int> controls,
                               std::vector<int> switched_off_at_rest, std::vector<StaticRow> rows, Options options)
    : scene_(std::move(scene)),
      channels_(std::move(channels)),
      controls_(std::move(controls)),
      off_at_rest_(std::move(switched_off_at_rest)),
      rows_(std::move(rows)),
      options_(options) {
  auto condition_with = [&](const std::vector<double>& values) {
    for (size_t c = 0; c < conditions_.size(); ++c) {
      if (conditions_[c].controls == values) return static_cast<int>(c);
    }
    conditions_.emplace_back().controls = values;
    return static_cast<int>(conditions_.size()) - 1;
  };
  for (size_t r = 0; r < rows_.size(); ++r) {
    condition_of_row_.push_back(condition_with(rows_[r].controls));
    conditions_[static_cast<size_t>(condition_of_row_.back())].rows.push_back(static_cast<int>(r));
  }
  if (options_.from_unloaded) unloaded_ = condition_with(std::vector<double>(controls_.size(), 0.0));
  const int cores = options_.threads > 0 ? options_.threads : static_cast<int>(std::thread::hardware_concurrency());
  const int count = std::clamp(cores, 1, std::max(1, static_cast<int>(conditions_.size())));
  for (int i = 0; i < count; ++i)
    workspaces_.push_back(std::make_unique<Equilibrium>(*scene_.model, options_.equilibrium));
}

void StaticProtocol::forget() {
  for (Condition& condition : conditions_) condition.solved = false;
}

std::string StaticProtocol::describe(const Condition& condition, const Params& p) const {
  std::string text;
  for (size_t k = 0; k < controls_.size(); ++k) {
    const ParameterSpec& spec = parameters()[controls_[k]];
    text += fmt::format("{}{} = {:.6g} {}", k == 0 ? "" : ", ", spec.id, condition.controls[k], spec.unit);
  }
  text += " with";
  for (int i = 0; i < parameters().size(); ++i) {
    if (std::find(controls_.begin(), controls_.end(), i) != controls_.end()) continue;
    text += fmt::format(" {} = {:.6g}", parameters()[i].id, p[i]);
  }
  return text;
}

/// Whether an equilibrium at `from` is a better start for `to` than the rest shape is: stiffnesses within a factor
/// of 1.5.
bool StaticProtocol::near(const Params& from, const Params& to) const {
  for (int i = 0; i < parameters().size(); ++i) {
    if (parameters()[i].logarithmic && !(from[i] < 1.5 * to[i] && to[i] < 1.5 * from[i])) return false;
  }
  return true;
}

void StaticProtocol::solve_condition(Condition& condition, const Params& p, const std::vector<int>& free,
                                     Equilibrium& equilibrium) const {
  Params target = p;
  for (size_t k = 0; k < controls_.size(); ++k) target[controls_[k]] = condition.controls[k];
  SolveReport total;
  bool done = false;
  if (condition.solved && near(condition.p, target)) {
    // Predict from the last equilibrium; a stiffness by its reciprocal, in which displacements of a linear solid are
    // linear.
    Eigen::VectorXd u = condition.u;
    for (size_t k = 0; k < condition.sensitivity_of.size(); ++k) {
      const int index = condition.sensitivity_of[k];
      const double from = condition.p[index], to = target[index];
      u += (parameters()[index].logarithmic ? from * (1 - from / to) : to - from) *
           condition.sensitivities.col(static_cast<Eigen::Index>(k));
    }
    equilibrium.start_at(u, target);
    total = equilibrium.solve(target);
    // A start that is not on the protocol's path may end in a spurious equilibrium with folded elements.
    done = total.status == SolveStatus::converged && smallest_jacobian(scene_.model->mesh(), equilibrium.u()) > 0;
  }
  if (!done && total.status != SolveStatus::interrupted) {
    Params rest = target;
    for (int index : controls_) rest[index] = 0;
    for (int index : off_at_rest_) rest[index] = 0;
    equilibrium.start_at_rest(rest);
    SolveReport report = equilibrium.solve(target);
    report.factorisations += total.factorisations;
    report.iterations += total.iterations;
    total = report;
  }
  condition.report = total;
  if (total.status != SolveStatus::converged) return;  // what was solved before stays as a start for the next try
  condition.p = target;
  condition.u = equilibrium.u();
  condition.smallest_jacobian = smallest_jacobian(scene_.model->mesh(), condition.u);
  condition.solved = condition.smallest_jacobian > 0;  // a folded state is no start for others
  condition.sensitivity_of = free;
  condition.sensitivities = free.empty() ? Eigen::MatrixXd() : equilibrium.sensitivities(free);
}

Prediction StaticProtocol::predict(const Params& p, const std::vector<int>& free) {
  // Each condition depends on its own past only, so which thread solves it, and when, does not matter.
  std::atomic<size_t> next{0};
  std::vector<std::exception_ptr> errors(workspaces_.size());
  auto work = [&](size_t thread) {
    try {
      for (size_t c = next++; c < conditions_.size(); c = next++)
        solve_condition(conditions_[c], p, free, *workspaces_[thread]);
    } catch (...) {
      errors[thread] = std::current_exception();
    }
  };
  std::vector<std::thread> threads;
  for (size_t i = 1; i < workspaces_.size(); ++i) threads.emplace_back(work, i);
  work(0);
  for (std::thread& thread : threads) thread.join();
  for (const std::exception_ptr& error : errors) {
    if (error) std::rethrow_exception(error);
  }

  Prediction prediction;
  for (const Condition& condition : conditions_) {
    factorisations_ += condition.report.factorisations;
    newton_iterations_ += condition.report.iterations;
    if (condition.report.status != SolveStatus::converged) {
      prediction.failures.push_back(
          fmt::format("no equilibrium at {}: {}", describe(condition, p), condition.report.message()));
    }
  }
  const Eigen::Index count = row_count(), k = static_cast<Eigen::Index>(free.size());
  prediction.values = Eigen::VectorXd::Constant(count, std::numeric_limits<double>::quiet_NaN());
  if (k > 0) prediction.derivatives = Eigen::MatrixXd::Constant(count, k, std::numeric_limits<double>::quiet_NaN());
  auto converged = [](const Condition& c) { return c.report.status == SolveStatus::converged; };
  for (Eigen::Index r = 0; r < count; ++r) {
    const Condition& condition = conditions_[static_cast<size_t>(condition_of_row_[static_cast<size_t>(r)])];
    const Channel& channel = *channels_[static_cast<size_t>(rows_[static_cast<size_t>(r)].channel)].channel;
    const Condition* unloaded = unloaded_ < 0 ? nullptr : &conditions_[static_cast<size_t>(unloaded_)];
    if (!converged(condition) || (unloaded != nullptr && !converged(*unloaded))) continue;
    prediction.values[r] = channel.value(condition.u) - (unloaded != nullptr ? channel.value(unloaded->u) : 0.0);
    if (k == 0) continue;
    prediction.derivatives.row(r) = channel.gradient(condition.u).transpose() * condition.sensitivities;
    if (unloaded != nullptr)
      prediction.derivatives.row(r) -= channel.gradient(unloaded->u).transpose() * unloaded->sensitivities;
  }
  return prediction;
}

}  // namespace taut

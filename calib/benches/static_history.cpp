#include <algorithm>
#include <numeric>

#include "calib/benches/static_protocol.hpp"
#include "sim/terms/solid.hpp"

// Rows along a bench's own history, where stresses relax (StaticProtocol::Options::history).
namespace taut {

/// A condition at the end of a path.
int StaticProtocol::append(Path& path, std::vector<double> controls, int parent, double seconds) {
  const int index = static_cast<int>(conditions_.size());
  Condition& condition = conditions_.emplace_back();
  condition.controls = std::move(controls);
  condition.parent = parent;
  condition.seconds = seconds;
  path.conditions.push_back(index);
  return index;
}

void StaticProtocol::make_histories() {
  std::vector<size_t> order(rows_.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::ranges::stable_sort(order, {}, [&](size_t r) { return rows_[r].turn.place; });
  condition_of_row_.resize(rows_.size());
  int last = -1, unloaded = -1;  // conditions
  int place = -1;                // in the history, of the last row
  for (size_t r : order) {
    const StaticRow& row = rows_[r];
    const Turn& turn = row.turn;
    if (turn.place < 0 || turn.place != place) {
      if (place < 0) {
        paths_.emplace_back();
        last = unloaded = -1;
      }
      const std::vector<double> zero = before_loads(row.controls);
      const bool needed = options_.from_unloaded || !options_.set_first.empty();
      const bool moved = last >= 0 && before_loads(conditions_[static_cast<size_t>(last)].controls) != zero;
      if (last < 0 ? needed : turn.rest > 0 || (needed && moved))
        last = unloaded = append(paths_.back(), zero, last, last < 0 ? 0 : turn.rest);
      last = append(paths_.back(), row.controls, last, turn.dwell - turn.read);
      if (options_.from_unloaded) conditions_[static_cast<size_t>(last)].unloaded = unloaded;
    }
    condition_of_row_[r] = last;
    conditions_[static_cast<size_t>(last)].rows.push_back(static_cast<int>(r));
    place = turn.place;
  }
  for (Path& path : paths_) path.cost = static_cast<double>(path.conditions.size());
}

/// What the rows of a condition read at the end of its step.
void StaticProtocol::read_along(Condition& condition, const QuasiStatics& statics) const {
  const Point at{statics.u(), condition.p, &statics.step()};
  const auto rows = static_cast<Eigen::Index>(condition.rows.size()), k = statics.du().cols();
  condition.read.clear();
  condition.read_by = Eigen::MatrixXd::Zero(rows, k);
  for (Eigen::Index i = 0; i < rows; ++i) {
    const StaticRow& row = rows_[static_cast<size_t>(condition.rows[static_cast<size_t>(i)])];
    const Channel& channel = *channels_[static_cast<size_t>(row.channel)].channel;
    condition.read.push_back(channel.value(at));
    if (k == 0) continue;
    condition.read_by.row(i) = channel.gradient(at).transpose() * statics.du();
    for (Eigen::Index j = 0; j < k; ++j)
      condition.read_by(i, j) += channel.parameter_derivative(at, condition.sensitivity_of[static_cast<size_t>(j)]) +
                                 channel.memory_derivative(at, statics.dmemory().col(j));
  }
}

void StaticProtocol::solve_history(Path& path, const Params& p, const std::vector<int>& free) {
  QuasiStatics statics(*scene_.model, options_.equilibrium);
  Params rest = p;
  for (int index : controls_) rest[index] = 0;
  for (int index : off_at_rest_) rest[index] = 0;
  statics.start_at_rest(rest, static_cast<int>(free.size()));
  path.cost = 0;
  SolveReport last;
  for (int c : path.conditions) {
    Condition& condition = conditions_[static_cast<size_t>(c)];
    condition.solved = false;
    if (last.status != SolveStatus::converged) {
      condition.report = {};
      condition.report.status = last.status;
      condition.report.not_tried = true;
      continue;
    }
    const Params target = with_controls(p, condition.controls);
    Eigen::MatrixXd dp = Eigen::MatrixXd::Zero(p.size(), static_cast<Eigen::Index>(free.size()));
    for (size_t j = 0; j < free.size(); ++j) {
      if (!condition.rows.empty() || !held_when_unloaded(free[j])) dp(free[j], static_cast<Eigen::Index>(j)) = 1;
    }
    last = statics.advance(target, dp, 0);
    if (last.status == SolveStatus::converged && condition.seconds > 0) {
      const SolveReport held = statics.hold(target, dp, condition.seconds);
      last.status = held.status;
      last.iterations += held.iterations;
      last.factorisations += held.factorisations;
      last.slipped |= held.slipped;
    }
    condition.report = last;
    path.cost += last.factorisations;
    if (last.status != SolveStatus::converged) continue;
    condition.p = target;
    condition.u = statics.u();
    condition.smallest_jacobian = smallest_jacobian(scene_.model->mesh(), condition.u);
    condition.solved = condition.smallest_jacobian > 0;
    condition.sensitivity_of = free;
    condition.sensitivities = statics.du();
    read_along(condition, statics);
  }
}

}  // namespace taut

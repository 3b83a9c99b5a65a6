#include "calib/benches/recording_protocol.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "calib/benches/parallel.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"
#include "sim/solve/quasi_statics.hpp"

namespace taut {
namespace {

/// A step so long that nothing of the past counts: it ends in equilibrium, and carries its derivatives.
constexpr double kQuasiStatic = 1e6;  // [s]
/// In which all relaxes that may.
constexpr double kForEver = 1e15;  // [s]

/// State, velocity and their derivatives with respect to what is tracked, at a time.
struct Instant {
  double t = 0;
  Eigen::VectorXd u, v;
  Eigen::MatrixXd du, dv;
};

Instant now(const TimeStepper& stepper) {
  return {stepper.t(), stepper.u(), stepper.v(), stepper.du(), stepper.dv()};
}

/// The cubic polynomial through both ends, at s in [0, 1] of the way of length h.
template <class Values>
Values between(double s, double h, const Values& y0, const Values& v0, const Values& y1, const Values& v1) {
  return (1 + 2 * s) * (1 - s) * (1 - s) * y0 + s * s * (3 - 2 * s) * y1 + h * s * (1 - s) * ((1 - s) * v0 - s * v1);
}

/// Its rate.
Eigen::VectorXd rate_between(double s, double h, const Instant& a, const Instant& b) {
  return 6 * s * (1 - s) / h * (b.u - a.u) + (1 - s) * (1 - 3 * s) * a.v + s * (3 * s - 2) * b.v;
}

bool holds(const std::vector<std::pair<int, int>>& pairs, int second) {
  return std::any_of(pairs.begin(), pairs.end(), [&](const auto& pair) { return pair.second == second; });
}

}  // namespace

RecordingProtocol::RecordingProtocol(Scene scene, std::vector<NamedChannel> channels, std::vector<int> off_at_rest,
                                     std::vector<Recording> recordings, std::vector<RecordingRow> rows, Options options)
    : scene_(std::move(scene)),
      channels_(std::move(channels)),
      off_at_rest_(std::move(off_at_rest)),
      recordings_(std::move(recordings)),
      rows_(std::move(rows)),
      options_(options) {
  for (size_t r = 0; r < recordings_.size(); ++r) {
    const Recording& recording = recordings_[r];
    const auto same = [&](const Trajectory& trajectory) {
      const Recording& other = recordings_[static_cast<size_t>(trajectory.recordings.front())];
      return other.set == recording.set && other.takes == recording.takes && other.held == recording.held &&
             other.held_for == recording.held_for;
    };
    auto found = std::find_if(trajectories_.begin(), trajectories_.end(), same);
    if (found == trajectories_.end()) found = trajectories_.emplace(trajectories_.end());
    found->recordings.push_back(static_cast<int>(r));
    for (size_t i = 0; i < rows_.size(); ++i) {
      if (rows_[i].recording != static_cast<int>(r)) continue;
      found->rows.push_back(static_cast<int>(i));
      found->length = std::max(found->length, rows_[i].time);
    }
  }
  // The longest first, so that threads end together.
  std::stable_sort(trajectories_.begin(), trajectories_.end(),
                   [](const Trajectory& a, const Trajectory& b) { return a.length > b.length; });
}

Params RecordingProtocol::parameters_of(const Trajectory& trajectory, const Params& p, bool held) const {
  const Recording& recording = recordings_[static_cast<size_t>(trajectory.recordings.front())];
  Params q = p;
  for (const auto& [index, value] : recording.set) q[index] = value;
  for (const auto& [index, other] : recording.takes) q[index] = p[other];
  for (const auto& [index, other] : recording.held) q[index] = held ? p[other] : scene_.values[index];
  return q;
}

/// d parameters_of() / d p[tracked], shape (parameters x tracked).
Eigen::MatrixXd RecordingProtocol::derivatives_of(const Trajectory& trajectory, const std::vector<int>& tracked,
                                                  bool held) const {
  const Recording& recording = recordings_[static_cast<size_t>(trajectory.recordings.front())];
  Eigen::MatrixXd result = Eigen::MatrixXd::Zero(parameters().size(), static_cast<Eigen::Index>(tracked.size()));
  for (size_t j = 0; j < tracked.size(); ++j) {
    const auto column = static_cast<Eigen::Index>(j);
    result(tracked[j], column) = 1;
    for (const auto& [index, other] : recording.takes) {
      if (other == tracked[j]) result(index, column) = 1;
    }
    for (const auto& [index, other] : recording.held) {
      if (other == tracked[j] && held) result(index, column) = 1;
    }
  }
  return result;
}

/// Those of the free parameters on which the trajectory depends.
std::vector<int> RecordingProtocol::tracked_by(const Trajectory& trajectory, const std::vector<int>& free) const {
  const Recording& own = recordings_[static_cast<size_t>(trajectory.recordings.front())];
  std::vector<int> tracked;
  for (int index : free) {
    const auto is_index = [&](const auto& pair) { return pair.first == index; };
    const bool replaced = std::any_of(own.set.begin(), own.set.end(), is_index) ||
                          std::any_of(own.takes.begin(), own.takes.end(), is_index) ||
                          std::any_of(own.held.begin(), own.held.end(), is_index);
    const bool of_others = std::any_of(recordings_.begin(), recordings_.end(), [&](const Recording& r) {
      return r.release == index || holds(r.takes, index) || holds(r.held, index);
    });
    if (!replaced && (!of_others || holds(own.takes, index) || holds(own.held, index))) tracked.push_back(index);
  }
  return tracked;
}

/// One trajectory on its way: what it depends on, and the rows that it comes to in order of the time since their
/// release.
class RecordingProtocol::Run {
 public:
  Run(const RecordingProtocol& of, Trajectory& trajectory, const Params& p, const std::vector<int>& free,
      Prediction& prediction)
      : of_(of),
        trajectory_(trajectory),
        p_(p),
        free_(free),
        prediction_(prediction),
        tracked_(of.tracked_by(trajectory, free)),
        held_(of.parameters_of(trajectory, p, true)),
        moving_(of.parameters_of(trajectory, p, false)),
        held_derivative_(of.derivatives_of(trajectory, tracked_, true)),
        moving_derivative_(of.derivatives_of(trajectory, tracked_, false)),
        order_(trajectory.rows) {
    trajectory.factorisations = trajectory.steps = 0;
    trajectory.failure.clear();
    std::erase_if(order_, [&](int r) { return row(r).still; });
    std::stable_sort(order_.begin(), order_.end(), [&](int a, int b) { return since_release(a) < since_release(b); });
  }

  void go() {
    for (int r : trajectory_.rows) {
      if (row(r).still) creep_to(r);
    }
    if (!order_.empty() && trajectory_.failure.empty()) move();
  }

 private:
  void move() {
    const bool from_rest = recording(trajectory_.recordings.front()).held.empty();
    TimeStepperOptions options;
    options.integrator = of_.options_.integrator;
    options.equilibrium = of_.options_.equilibrium;
    const bool relaxes = of_.scene_.model->memory_size() > 0;
    options.step = from_rest || relaxes ? of_.options_.step : kQuasiStatic;  // the longest; each is ended below
    options.shortest = 1e-6 * of_.options_.step / options.step;
    TimeStepper stepper(*of_.scene_.model, options);
    released_ = from_rest;
    if (!tracked_.empty()) {
      stepper.track(static_cast<int>(tracked_.size()),
                    [&](double) { return released_ ? moving_derivative_ : held_derivative_; });
    }
    const Eigen::VectorXd zero = Eigen::VectorXd::Zero(of_.scene_.model->unknowns());
    if (from_rest)
      stepper.start(0, zero, zero, [&](double) { return moving_; });
    else if (!release_from_equilibrium(stepper, zero))
      return;
    const Instant start = now(stepper);
    while (next_ < order_.size() && since_release(order_[next_]) <= 0)
      read(order_[next_++], start.u, zero, start.du, held_, held_derivative_);
    follow(stepper, start);
  }

  void creep_to(int r) {
    QuasiStatics statics(*of_.scene_.model, of_.options_.equilibrium);
    Params rest = moving_;
    for (int index : of_.off_at_rest_) rest[index] = 0;
    statics.start_at_rest(rest, static_cast<int>(tracked_.size()));
    SolveReport end;
    if (!recording(trajectory_.recordings.front()).held.empty()) end = hold(statics);
    if (end.status == SolveStatus::converged) {
      end = statics.advance(moving_, moving_derivative_, 0);
      trajectory_.factorisations += end.factorisations;
    }
    if (end.status == SolveStatus::converged) {
      end = statics.hold(moving_, moving_derivative_, since_release(r));
      trajectory_.factorisations += end.factorisations;
    }
    if (end.status != SolveStatus::converged) {
      trajectory_.failure = "no equilibrium to come to rest in: " + end.message();
      return;
    }
    read(r, statics.u(), Eigen::VectorXd::Zero(statics.u().size()), statics.du(), moving_, moving_derivative_);
  }

  const Recording& recording(int r) const { return of_.recordings_[static_cast<size_t>(r)]; }
  const RecordingRow& row(int r) const { return of_.rows_[static_cast<size_t>(r)]; }
  double since_release(int r) const {
    const int release = recording(row(r).recording).release;
    return row(r).time - (release < 0 ? 0.0 : p_[release]);
  }

  void read(int r, const Eigen::VectorXd& u, const Eigen::VectorXd& rate, const Eigen::MatrixXd& du, const Params& q,
            const Eigen::MatrixXd& dq) {
    const Channel& channel = *of_.channels_[static_cast<size_t>(row(r).channel)].channel;
    const Point at{u, q};
    prediction_.values[r] = channel.value(at);
    if (free_.empty()) return;
    const Eigen::VectorXd gradient = channel.gradient(at);
    prediction_.derivatives.row(r).setZero();
    for (size_t j = 0; j < free_.size(); ++j) {
      double& out = prediction_.derivatives(r, static_cast<Eigen::Index>(j));
      if (recording(row(r).recording).release == free_[j]) out = -gradient.dot(rate);
      const auto found = std::find(tracked_.begin(), tracked_.end(), free_[j]);
      if (found == tracked_.end()) continue;
      const Eigen::Index column = found - tracked_.begin();
      out = gradient.dot(du.col(column));
      for (int k = 0; k < dq.rows(); ++k) {
        if (dq(k, column) != 0) out += dq(k, column) * channel.parameter_derivative(at, k);
      }
    }
  }

  /// False when there is no equilibrium to be let go from.
  bool release_from_equilibrium(TimeStepper& stepper, const Eigen::VectorXd& zero) {
    Params rest = held_;
    for (int index : of_.off_at_rest_) rest[index] = 0;
    if (of_.scene_.model->memory_size() > 0) return release_what_relaxes(stepper, zero, rest);
    Equilibrium equilibrium(*of_.scene_.model, of_.options_.equilibrium);
    equilibrium.start_at_rest(rest);
    const SolveReport& solve = equilibrium.solve(held_);
    trajectory_.factorisations += solve.factorisations;
    if (solve.status != SolveStatus::converged) {
      trajectory_.failure = "no equilibrium while it is held: " + solve.message();
      return false;
    }
    stepper.start(-kQuasiStatic, equilibrium.u(), zero, [&](double) { return released_ ? moving_ : held_; });
    if (!stepper.advance(0)) {
      trajectory_.failure = fmt::format("no equilibrium while it is held: {}", name_of(stepper.report().status));
      return false;
    }
    stepper.restart();
    released_ = true;
    return true;
  }

  /// From rest into what holds it, for as long as it does.
  SolveReport hold(QuasiStatics& statics) {
    const double seconds = recording(trajectory_.recordings.front()).held_for;
    SolveReport held = statics.advance(held_, held_derivative_, 0);
    trajectory_.factorisations += held.factorisations;
    if (held.status == SolveStatus::converged && seconds > 0) {
      held = std::isfinite(seconds) ? statics.hold(held_, held_derivative_, seconds)
                                    : statics.advance(held_, held_derivative_, kForEver);
      trajectory_.factorisations += held.factorisations;
    }
    return held;
  }

  bool release_what_relaxes(TimeStepper& stepper, const Eigen::VectorXd& zero, const Params& rest) {
    QuasiStatics statics(*of_.scene_.model, of_.options_.equilibrium);
    statics.start_at_rest(rest, static_cast<int>(tracked_.size()));
    const SolveReport held = hold(statics);
    if (held.status != SolveStatus::converged) {
      trajectory_.failure = "no equilibrium while it is held: " + held.message();
      return false;
    }
    released_ = true;
    stepper.start(
        0, statics.u(), zero, [&](double) { return moving_; }, statics.du());
    stepper.remember(statics.memory(), statics.dmemory_after());
    return true;
  }

  void follow(TimeStepper& stepper, Instant before) {
    for (int n = 1; next_ < order_.size(); ++n) {
      const double end = n * of_.options_.step;
      while (next_ < order_.size() && stepper.t() < end) {
        if (!stepper.advance(end)) {
          trajectory_.factorisations += stepper.report().factorisations;
          trajectory_.failure = fmt::format("the step at {} after the release failed: {}", with_unit(stepper.t(), "s"),
                                            name_of(stepper.report().status));
          return;
        }
        Instant after = now(stepper);
        const double h = after.t - before.t;
        for (; next_ < order_.size() && since_release(order_[next_]) <= after.t; ++next_) {
          const double s = (since_release(order_[next_]) - before.t) / h;
          const Eigen::MatrixXd du =
              tracked_.empty() ? Eigen::MatrixXd() : between(s, h, before.du, before.dv, after.du, after.dv);
          read(order_[next_], between(s, h, before.u, before.v, after.u, after.v), rate_between(s, h, before, after),
               du, moving_, moving_derivative_);
        }
        before = std::move(after);
      }
    }
    trajectory_.factorisations += stepper.report().factorisations;
    trajectory_.steps = stepper.report().steps;
  }

  const RecordingProtocol& of_;
  Trajectory& trajectory_;
  const Params& p_;
  const std::vector<int>& free_;
  Prediction& prediction_;
  std::vector<int> tracked_;
  Params held_, moving_;
  Eigen::MatrixXd held_derivative_, moving_derivative_;
  std::vector<int> order_;
  size_t next_ = 0;
  bool released_ = false;
};

Prediction RecordingProtocol::predict(const Params& p, const std::vector<int>& free) {
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  Prediction prediction;
  prediction.values = Eigen::VectorXd::Constant(row_count(), nan);
  if (!free.empty())
    prediction.derivatives = Eigen::MatrixXd::Constant(row_count(), static_cast<Eigen::Index>(free.size()), nan);

  // Trajectories have rows of their own, so which thread runs one, and when, does not matter.
  in_parallel(trajectories_.size(), options_.threads,
              [&](size_t i) { Run(*this, trajectories_[i], p, free, prediction).go(); });
  for (const Trajectory& trajectory : trajectories_) {
    factorisations_ += trajectory.factorisations;
    steps_ += trajectory.steps;
    if (trajectory.failure.empty()) continue;
    std::vector<std::string> ids, values;
    for (int r : trajectory.recordings) ids.push_back(recordings_[static_cast<size_t>(r)].id);
    for (int index : free)
      values.push_back(parameters()[index].id + " = " + with_unit(p[index], parameters()[index].unit));
    prediction.failures.push_back(fmt::format("no trajectory for {}{}: {}", join(ids),
                                              values.empty() ? "" : " (with " + join(values) + ")",
                                              trajectory.failure));
    for (int row : trajectory.rows) {
      prediction.values[row] = nan;
      if (!free.empty()) prediction.derivatives.row(row).setConstant(nan);
    }
  }
  return prediction;
}

}  // namespace taut

#include "calib/benches/recording_protocol.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <thread>

#include "sim/core/error.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

/// A step so long that nothing of the past counts: it ends in equilibrium, and carries its derivatives.
constexpr double kQuasiStatic = 1e6;  // [s]

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
      return other.set == recording.set && other.takes == recording.takes && other.held == recording.held;
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

void RecordingProtocol::run(Trajectory& trajectory, const Params& p, const std::vector<int>& free,
                            Prediction& prediction) const {
  const Recording& first = recordings_[static_cast<size_t>(trajectory.recordings.front())];
  trajectory.factorisations = trajectory.steps = 0;
  trajectory.failure.clear();
  const std::vector<int> tracked = tracked_by(trajectory, free);
  const Params held = parameters_of(trajectory, p, true), moving = parameters_of(trajectory, p, false);
  const Eigen::MatrixXd held_derivative = derivatives_of(trajectory, tracked, true),
                        moving_derivative = derivatives_of(trajectory, tracked, false);

  // Rows in order of the time since their release.
  const auto since_release = [&](int row) {
    const RecordingRow& r = rows_[static_cast<size_t>(row)];
    const int release = recordings_[static_cast<size_t>(r.recording)].release;
    return r.time - (release < 0 ? 0.0 : p[release]);
  };
  std::vector<int> order = trajectory.rows;
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return since_release(a) < since_release(b); });
  size_t next = 0;

  const auto read = [&](int row, const Eigen::VectorXd& u, const Eigen::VectorXd& rate, const Eigen::MatrixXd& du,
                        const Params& q, const Eigen::MatrixXd& dq) {
    const RecordingRow& r = rows_[static_cast<size_t>(row)];
    const Channel& channel = *channels_[static_cast<size_t>(r.channel)].channel;
    const Point at{u, q};
    prediction.values[row] = channel.value(at);
    if (free.empty()) return;
    const Eigen::VectorXd gradient = channel.gradient(at);
    prediction.derivatives.row(row).setZero();
    for (size_t j = 0; j < free.size(); ++j) {
      double& out = prediction.derivatives(row, static_cast<Eigen::Index>(j));
      if (recordings_[static_cast<size_t>(r.recording)].release == free[j]) out = -gradient.dot(rate);
      const auto found = std::find(tracked.begin(), tracked.end(), free[j]);
      if (found == tracked.end()) continue;
      const Eigen::Index column = found - tracked.begin();
      out = gradient.dot(du.col(column));
      for (int k = 0; k < dq.rows(); ++k) {
        if (dq(k, column) != 0) out += dq(k, column) * channel.parameter_derivative(at, k);
      }
    }
  };

  const Eigen::VectorXd zero = Eigen::VectorXd::Zero(scene_.model->unknowns());
  TimeStepperOptions options;
  options.integrator = options_.integrator;
  options.equilibrium = options_.equilibrium;
  options.step = first.held.empty() ? options_.step : kQuasiStatic;  // the longest; each is ended below
  options.shortest = 1e-6 * options_.step / options.step;
  TimeStepper stepper(*scene_.model, options);
  bool released = first.held.empty();
  if (!tracked.empty()) {
    stepper.track(static_cast<int>(tracked.size()),
                  [&](double) { return released ? moving_derivative : held_derivative; });
  }
  if (released) {
    stepper.start(0, zero, zero, [&](double) { return moving; });
  } else {
    Params rest = held;
    for (int index : off_at_rest_) rest[index] = 0;
    Equilibrium equilibrium(*scene_.model, options_.equilibrium);
    equilibrium.start_at_rest(rest);
    const SolveReport& solve = equilibrium.solve(held);
    trajectory.factorisations += solve.factorisations;
    if (solve.status != SolveStatus::converged) {
      trajectory.failure = "no equilibrium while it is held: " + solve.message();
      return;
    }
    stepper.start(-kQuasiStatic, equilibrium.u(), zero, [&](double) { return released ? moving : held; });
    if (!stepper.advance(0)) {
      trajectory.failure = fmt::format("no equilibrium while it is held: {}", name_of(stepper.report().status));
      return;
    }
    stepper.restart();
    released = true;
  }
  Instant before = now(stepper);
  while (next < order.size() && since_release(order[next]) <= 0)
    read(order[next++], before.u, zero, before.du, held, held_derivative);

  for (int n = 1; next < order.size(); ++n) {
    const double end = n * options_.step;
    while (next < order.size() && stepper.t() < end) {
      if (!stepper.advance(end)) {
        trajectory.factorisations += stepper.report().factorisations;
        trajectory.failure = fmt::format("the step at {} after the release failed: {}", with_unit(stepper.t(), "s"),
                                         name_of(stepper.report().status));
        return;
      }
      Instant after = now(stepper);
      const double h = after.t - before.t;
      for (; next < order.size() && since_release(order[next]) <= after.t; ++next) {
        const double s = (since_release(order[next]) - before.t) / h;
        const Eigen::MatrixXd du =
            tracked.empty() ? Eigen::MatrixXd() : between(s, h, before.du, before.dv, after.du, after.dv);
        read(order[next], between(s, h, before.u, before.v, after.u, after.v), rate_between(s, h, before, after), du,
             moving, moving_derivative);
      }
      before = std::move(after);
    }
  }
  trajectory.factorisations += stepper.report().factorisations;
  trajectory.steps = stepper.report().steps;
}

Prediction RecordingProtocol::predict(const Params& p, const std::vector<int>& free) {
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  Prediction prediction;
  prediction.values = Eigen::VectorXd::Constant(row_count(), nan);
  if (!free.empty())
    prediction.derivatives = Eigen::MatrixXd::Constant(row_count(), static_cast<Eigen::Index>(free.size()), nan);

  // Trajectories have rows of their own, so which thread runs one, and when, does not matter.
  const int cores = options_.threads > 0 ? options_.threads : static_cast<int>(std::thread::hardware_concurrency());
  const size_t count = static_cast<size_t>(std::clamp(cores, 1, std::max(1, trajectories())));
  std::atomic<size_t> next{0};
  std::vector<std::exception_ptr> errors(count);
  auto work = [&](size_t thread) {
    try {
      for (size_t i = next++; i < trajectories_.size(); i = next++) run(trajectories_[i], p, free, prediction);
    } catch (...) {
      errors[thread] = std::current_exception();
    }
  };
  std::vector<std::thread> threads;
  for (size_t i = 1; i < count; ++i) threads.emplace_back(work, i);
  work(0);
  for (std::thread& thread : threads) thread.join();
  for (const std::exception_ptr& error : errors) {
    if (error) std::rethrow_exception(error);
  }

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

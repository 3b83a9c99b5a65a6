#include "calib/studies/tuning.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "calib/fit/distributions.hpp"
#include "calib/fit/gauss_newton.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

constexpr double stiffness_step = 1e-3;  ///< of central differences, on the scale of scale_of()
constexpr size_t scan_steps = 24;

/// dx / d(fitted scale): of logarithmic parameters their value.
double fitted_scale(const ParameterEstimate& estimate) {
  return estimate.spec.logarithmic ? estimate.value : 1;
}

/// ln(k / wanted), whose zeros are sought; stiffnesses are positive at minima of the energy.
double excess(const TunedState& state, double wanted) {
  return std::log(state.stiffness / wanted);
}

std::vector<double> with(std::vector<double> controls, size_t control, double value) {
  controls[control] = value;
  return controls;
}

bool is_solved(const TunedState& state) {
  return state.stiffness > 0;  // not NaN
}

/// The value with four digits, as one would set it.
double as_settable(double value) {
  return std::stod(fmt::format("{:.3e}", value));
}

/// Where a parabola through three points has its extremum; NaN: none between the outer ones.
double vertex(const std::array<double, 3>& x, const std::array<double, 3>& y) {
  const double left = (y[1] - y[0]) / (x[1] - x[0]), right = (y[2] - y[1]) / (x[2] - x[1]);
  if (!(left * right < 0)) return not_a_number;
  const double curvature = (right - left) / (x[2] - x[0]);
  return 0.5 * (x[0] + x[1]) - left / (2 * curvature);
}

}  // namespace

double part_of(const Share& share, const FitResult& fit, const Eigen::VectorXd& gradient) {
  double bias = 0, error = 0, together = 0;
  for (size_t j = 0; j < fit.parameters.size(); ++j) {
    const double g = gradient[static_cast<Eigen::Index>(j)] / fitted_scale(fit.parameters[j]);
    bias += g * share.bias[j];
    if (!share.moves.empty()) together += g * share.moves[j];
    if (share.moves.empty() && std::isfinite(share.error[j])) error += std::abs(g) * share.error[j];
  }
  return std::abs(bias) + std::abs(together) + error;
}

HalfWidths half_widths(const FitResult& fit, const std::vector<Share>& shares, const Eigen::VectorXd& gradient) {
  HalfWidths half;
  half.noise = z95 * std::sqrt(std::max(0.0, gradient.dot(fit.covariance * gradient)));
  double squares = 0;
  for (const Share& share : shares) {
    if (!share.counted || std::ranges::any_of(share.bias, [](double bias) { return !std::isfinite(bias); })) continue;
    squares += std::pow(part_of(share, fit, gradient), 2);
  }
  half.shares = std::sqrt(squares);
  half.total = std::hypot(half.noise, half.shares);
  return half;
}

StiffnessReplay::StiffnessReplay(const Bench& bench, const FitResult& fit, size_t load)
    : bench_(bench), fit_(fit), load_(load) {
  const Experiment& experiment = bench.experiment();
  const auto fail = [&](const std::string& why) { throw InputError(experiment.path + ": " + why); };
  if (bench.trials_at_rest() == nullptr)
    fail(fmt::format("its readings are those of {}, which have no stiffness to tune; a run of readings at rest has",
                     experiment.kind->about));
  if (experiment.has_specimens()) fail("its bench has several specimens; tune that of a fit of one of them");
  if (experiment.model != Rung::full && experiment.model != Rung::rigid_segments)
    fail(fmt::format("model = \"{}\" has no tangent stiffness; fit with model = \"full\" or \"rigid_segments\"",
                     name_of(experiment.model)));
  if (fit.covariance.size() == 0) fail("its fit has no result to tune by; run the fit again");
  const std::string& quantity = bench.controls()[load].quantity;
  if (quantity != name_of(Quantity::force) && quantity != name_of(Quantity::mass))
    fail(fmt::format("'{}' is a {}, and stiffness is that against a force or a mass", bench.controls()[load].id,
                     quantity));
}

Params StiffnessReplay::fitted(const Protocol& protocol) const {
  Params p = protocol.nominal();
  for (const ParameterEstimate& e : fit_.parameters) p[protocol.parameters().index(e.spec.id)] = e.value;
  return p;
}

std::unique_ptr<Bench> StiffnessReplay::at_rows(const std::vector<std::vector<double>>& controls) const {
  std::vector<LoadRow> rows;
  for (const std::vector<double>& one : controls) rows.push_back({static_cast<int>(rows.size()) + 1, one});
  return bench_.at_rows(rows);
}

std::vector<TunedState> StiffnessReplay::read(const Bench& there, const Params& p, bool with_slopes) const {
  Protocol& protocol = there.protocol();
  std::vector<int> asked;
  if (with_slopes) asked = indices_of(free_at(fit_, protocol.parameters()));
  const Eigen::Index fitted_count = static_cast<Eigen::Index>(asked.size());
  asked.push_back(protocol.parameters().index(there.controls()[load_].id));
  const Prediction prediction = protocol.predict(p, asked);
  for (const std::string& failure : prediction.failures) {
    if (std::ranges::find(failures_, failure) == failures_.end()) failures_.push_back(failure);
  }
  std::map<std::vector<double>, TangentStiffness> found;
  for (TangentStiffness& one : there.tangent_stiffness()) {
    if (one.load == there.controls()[load_].id) found.insert_or_assign(one.controls, one);
  }
  const size_t channels = there.channels().size();
  std::vector<TunedState> states;
  for (const BenchReading& reading : there.readings()) {
    if (static_cast<size_t>(reading.line) > states.size()) {
      TunedState& state = states.emplace_back();
      state.controls = reading.controls;
      state.readings.assign(channels, not_a_number);
      if (with_slopes) state.reading_slopes.setZero(static_cast<Eigen::Index>(channels), fitted_count);
      if (const auto one = found.find(reading.controls); one != found.end()) {
        state.stiffness = one->second.value;
        state.touching = one->second.touching;
        state.slipped = one->second.slipped;
      }
    }
    TunedState& state = states.back();
    state.readings[static_cast<size_t>(reading.channel)] = prediction.values[reading.row];
    for (Eigen::Index j = 0; j < fitted_count; ++j)
      state.reading_slopes(reading.channel, j) =
          prediction.derivatives(reading.row, j) * fitted_scale(fit_.parameters[static_cast<size_t>(j)]);
  }
  return states;
}

std::vector<TunedState> StiffnessReplay::at(const std::vector<std::vector<double>>& controls, bool with_slopes) const {
  const std::unique_ptr<Bench> there = at_rows(controls);
  return read(*there, fitted(there->protocol()), with_slopes);
}

StiffnessReplay::Solved StiffnessReplay::solved(const std::vector<std::vector<double>>& controls) const {
  Solved all;
  all.bench = at_rows(controls);
  all.states = read(*all.bench, fitted(all.bench->protocol()), false);
  return all;
}

Eigen::MatrixXd StiffnessReplay::stiffness_slopes(const std::vector<std::vector<double>>& controls) const {
  const std::unique_ptr<Bench> there = at_rows(controls);
  Protocol& protocol = there->protocol();
  const Params p = fitted(protocol);
  Eigen::MatrixXd slopes(static_cast<Eigen::Index>(controls.size()), static_cast<Eigen::Index>(fit_.parameters.size()));
  const std::vector<FreeParameter> free = free_at(fit_, protocol.parameters());
  for (size_t j = 0; j < free.size(); ++j) {
    const double step = stiffness_step * scale_of(free[j], protocol.parameters(), p);
    const auto stiffness_at = [&](double change) {
      Params moved = p;
      moved[free[j].index] += change;
      return read(*there, moved, false);
    };
    const std::vector<TunedState> less = stiffness_at(-step), more = stiffness_at(step);
    for (size_t i = 0; i < controls.size(); ++i)
      slopes(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)) =
          (more[i].stiffness - less[i].stiffness) / (2 * step) * fitted_scale(fit_.parameters[j]);
  }
  return slopes;
}

namespace {

/// The search for one question.
class TuneSearch {
 public:
  TuneSearch(const StiffnessReplay& replay, const std::vector<Share>& shares, const TuneQuestion& question,
             const std::function<void(const std::string&)>& progress)
      : replay_(replay), shares_(shares), question_(question), progress_(progress) {}

  Tuned go() {
    say("looking along the whole range");
    scan();
    for (size_t i = 0; i + 1 < tuned_.scan.size(); ++i) narrow(tuned_.scan[i], tuned_.scan[i + 1]);
    if (!tuned_.scan.empty() && excess(tuned_.scan.back(), question_.stiffness) == 0) add(tuned_.scan.back());
    find_reachable();
    return std::move(tuned_);
  }

 private:
  void say(const std::string& text) const {
    if (progress_) progress_(text);
  }
  double value_of(const TunedState& state) const { return state.controls[question_.control]; }
  std::vector<double> controls_at(double value) const { return with(question_.controls, question_.control, value); }
  TunedState state_at(double value) const { return replay_.at({controls_at(value)}).front(); }

  void scan() {
    std::vector<std::vector<double>> rows;
    for (size_t i = 0; i <= scan_steps; ++i) {
      const double t = static_cast<double>(i) / static_cast<double>(scan_steps);
      rows.push_back(controls_at((1 - t) * question_.lower + t * question_.upper));
    }
    std::vector<TunedState> states = replay_.at(rows);
    std::vector<std::vector<double>> extrema;
    for (size_t i = 1; i + 1 < states.size(); ++i) {
      const double at = vertex({value_of(states[i - 1]), value_of(states[i]), value_of(states[i + 1])},
                               {states[i - 1].stiffness, states[i].stiffness, states[i + 1].stiffness});
      if (std::isfinite(at) && at != value_of(states[i])) extrema.push_back(controls_at(at));
    }
    if (!extrema.empty()) {
      for (TunedState& state : replay_.at(extrema)) states.push_back(std::move(state));
    }
    std::erase_if(states, [](const TunedState& state) { return !is_solved(state); });
    std::ranges::sort(states, {}, [&](const TunedState& state) { return value_of(state); });
    if (states.empty())
      throw InputError(fmt::format("no value of {} has an equilibrium at these loads{}",
                                   replay_.bench().controls()[question_.control].id,
                                   replay_.failures().empty() ? "" : ": " + replay_.failures().front()));
    tuned_.scan = std::move(states);
  }

  /// The zero of excess() between two neighbours of the scan, where its sign changes; one at `a` counts, at `b` not.
  void narrow(TunedState a, TunedState b) {
    double fa = excess(a, question_.stiffness), fb = excess(b, question_.stiffness);
    if (fa == 0) return add(a);
    if (!(fa * fb < 0)) return;
    say(fmt::format("between {} and {}", text_of(value_of(a)), text_of(value_of(b))));
    const double smallest = 1e-9 * (question_.upper - question_.lower);
    double wa = fa, wb = fb;  // halved where one end stays (Illinois)
    int kept = 0;
    for (int k = 0; k < 100 && value_of(b) - value_of(a) > smallest; ++k) {
      // Every fourth step halves: a jump has no slope to follow.
      const double t = k % 4 == 3 ? 0.5 : std::clamp(wa / (wa - wb), 1e-3, 1 - 1e-3);
      TunedState middle = state_at(value_of(a) + t * (value_of(b) - value_of(a)));
      if (!is_solved(middle)) break;
      const double f = excess(middle, question_.stiffness);
      if (std::abs(f) < 1e-6) return add(middle);
      if ((f > 0) == (fa > 0)) {
        a = std::move(middle);
        wa = fa = f;
        wb = kept == -1 ? wb / 2 : fb;
        kept = -1;
      } else {
        b = std::move(middle);
        wb = fb = f;
        wa = kept == 1 ? wa / 2 : fa;
        kept = 1;
      }
    }
    const double at = value_of(a);  // before `a` moves on
    add_jump(at, std::move(a), std::move(b));
  }

  /// Steps to either side of where the stiffness jumps that one could set; the nearest states where there is none.
  double settable_step() const { return 1e-3 * (question_.upper - question_.lower); }
  void add_jump(double at, TunedState before, TunedState after) {
    TunedState further_before = state_at(std::max(question_.lower, at - settable_step()));
    TunedState further_after = state_at(std::min(question_.upper, at + settable_step()));
    if (is_solved(further_before)) before = std::move(further_before);
    if (is_solved(further_after)) after = std::move(further_after);
    tuned_.jumps.emplace_back(std::move(before), std::move(after));
  }

  std::string text_of(double value) const {
    return with_unit(value, replay_.bench().controls()[question_.control].unit);
  }

  void add(const TunedState& at) {
    TunedControl found;
    found.value = value_of(at);
    say(fmt::format("the interval at {}", text_of(found.value)));
    const double step = settable_step();
    const double below = std::max(question_.lower, found.value - step);
    const double above = std::min(question_.upper, found.value + step);
    const std::vector<TunedState> near = replay_.at({controls_at(below), controls_at(above)});
    found.slope = (near[1].stiffness - near[0].stiffness) / (above - below);
    found.state = replay_.at({controls_at(found.value)}, true).front();
    const Eigen::VectorXd gradient = replay_.stiffness_slopes({controls_at(found.value)}).row(0);
    const HalfWidths half = half_widths(replay_.fit(), shares_, gradient);
    const double slope = std::abs(found.slope);
    found.half = {half.noise / slope, half.shares / slope, half.total / slope};
    if (found.value - found.half.total >= question_.lower) found.lower95 = found.value - found.half.total;
    if (found.value + found.half.total <= question_.upper) found.upper95 = found.value + found.half.total;
    for (const auto& row : found.state.reading_slopes.rowwise())
      found.reading_half95.push_back(half_widths(replay_.fit(), shares_, row.transpose()).total);
    replay_again(found);
    // A cliff that the value of four digits falls off is none that one could set.
    if (!(std::abs(found.replayed / question_.stiffness - 1) < 0.1)) return add_jump(found.value, near[0], near[1]);
    tuned_.solutions.push_back(std::move(found));
  }

  /// The inverse of the inverse, by a bench of its own.
  void replay_again(TunedControl& found) const {
    found.settable = as_settable(found.value);
    const std::vector<double> controls = controls_at(found.settable);
    const StiffnessReplay::Solved there = replay_.solved({controls});
    found.replayed = there.states.front().stiffness;
    Protocol& protocol = there.bench->protocol();
    for (const Alternative& other : protocol.alternatives(replay_.fitted(protocol))) {
      found.two_equilibria |= other.other.size() > 0;
      found.near_jump |= other.near_jump();
    }
  }

  void find_reachable() {
    std::vector<std::pair<double, double>>& ranges = tuned_.reachable;
    for (const TunedState& state : tuned_.scan) {
      const double k = state.stiffness;
      const bool jumped = !ranges.empty() && std::ranges::any_of(tuned_.jumps, [&](const auto& jump) {
        return value_of(jump.second) <= value_of(state) && value_of(jump.first) >= last_;
      });
      if (ranges.empty() || jumped) {
        ranges.emplace_back(k, k);
      } else {
        ranges.back().first = std::min(ranges.back().first, k);
        ranges.back().second = std::max(ranges.back().second, k);
      }
      last_ = value_of(state);
    }
  }

  const StiffnessReplay& replay_;
  const std::vector<Share>& shares_;
  const TuneQuestion& question_;
  const std::function<void(const std::string&)>& progress_;
  Tuned tuned_;
  double last_ = not_a_number;
};

}  // namespace

Tuned tune(const StiffnessReplay& replay, const std::vector<Share>& shares, const TuneQuestion& question,
           const std::function<void(const std::string&)>& progress) {
  return TuneSearch(replay, shares, question, progress).go();
}

}  // namespace taut

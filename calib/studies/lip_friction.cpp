#include "calib/studies/lip_friction.hpp"

#include <algorithm>
#include <cmath>

#include "calib/benches/assumptions.hpp"
#include "calib/fit/gauss_newton.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/stopwatch.hpp"

namespace taut {
namespace {

/// What a channel reads before the loads that a condition has; 0 where it is measured from there.
double unloaded_reading(const StaticProtocol& protocol, const StaticProtocol::Condition& condition, int channel) {
  if (condition.unloaded >= 0) return 0;
  const StaticProtocol::Condition* before = &condition;
  while (before->parent >= 0) before = &protocol.conditions()[static_cast<size_t>(before->parent)];
  return protocol.channels()[static_cast<size_t>(channel)].channel->value({before->u, before->p});
}

/// Load over displacement [N/m]; NaN where it is no stiffness.
double stiffness_of(double force, double displacement) {
  return force != 0 && displacement != 0 ? std::abs(force / displacement) : not_a_number;
}

/// Whether surfaces touch in any state of the last replay, seen by the same model at rest in the same shape.
bool touches_somewhere(const Bench& bench, const StaticReplay& replay, const Params& p) {
  return std::ranges::any_of(bench.states().states, [&](const SolvedState& state) {
    return !replay.contact->active_pairs({state.u, p}).empty();
  });
}

/// Half of the way from the fit to that of lips that stick, as bias and as error.
void take_half(const FitResult& fit, const Eigen::VectorXd& step, Share& share) {
  for (size_t j = 0; j < fit.parameters.size(); ++j) {
    const ParameterEstimate& e = fit.parameters[j];
    const double shift = step[static_cast<Eigen::Index>(j)];
    const double whole = e.spec.logarithmic ? -e.value * std::expm1(shift) : -shift;
    share.bias.push_back(0.5 * whole);
    share.error.push_back(0.5 * std::abs(whole));
  }
}

}  // namespace

std::optional<LipFriction> lip_friction(const Bench& bench, const FitResult& fit, const Ask& ask) {
  const Stopwatch watch;
  Experiment stuck = bench.experiment();
  stuck.contact.sticks = true;
  DimensionedProtocol with_grip(stuck, *bench.trials_at_rest(), free_dimensions(stuck));
  Params p = with_grip.nominal();
  for (const ParameterEstimate& e : fit.parameters) p[with_grip.parameters().index(e.spec.id)] = e.value;
  const StaticReplay& replay = with_grip.replay();
  if (replay.contact == nullptr) return std::nullopt;
  if (with_grip.dimensions().empty() && !touches_somewhere(bench, replay, p)) return std::nullopt;
  const Prediction sticking = with_grip.predict(p, {});
  const StaticProtocol& solved = *with_grip.replay().protocol;
  if (std::ranges::none_of(solved.conditions(), &StaticProtocol::Condition::held)) return std::nullopt;

  const ParameterTable& table = bench.protocol().parameters();
  const std::vector<FreeParameter> free = free_beyond_bounds(fit, table);
  const std::vector<int> columns = indices_of(free);
  const Prediction own = ask ? ask(bench.protocol(), fit.p, columns) : bench.protocol().predict(fit.p, columns);

  LipFriction found;
  const int load = bench.drawn_control();
  for (const StaticProtocol::Condition& condition : solved.conditions()) {
    if (!condition.held || condition.report.status != SolveStatus::converged) continue;
    for (const int r : condition.rows) {
      const StaticRow& row = solved.rows()[static_cast<size_t>(r)];
      const AxisRecord& channel = bench.channels()[static_cast<size_t>(row.channel)];
      FrictionRow& at = found.rows.emplace_back();
      at.channel = channel.id;
      at.controls = row.controls;
      at.sliding = own.values[r];
      at.sticking = sticking.values[r];
      const bool has_stiffness = load >= 0 && channel.unit == "m";
      const double force =
          has_stiffness ? bench.as_force(static_cast<size_t>(load), row.controls[static_cast<size_t>(load)]) : 0;
      double before = unloaded_reading(solved, condition, row.channel);
      if (row.offset >= 0) before += p[row.offset];
      at.sliding_stiffness = stiffness_of(force, at.sliding - before);
      at.sticking_stiffness = stiffness_of(force, at.sticking - before);
    }
  }
  Share& share = found.share;
  share.source = "friction of the lips";
  if (sticking.complete() && own.complete()) {
    Prediction changed = own;
    changed.values = sticking.values;
    const auto step = [&](const Prediction& of) {
      return gauss_newton_step(of, bench.measurements(), table, fit.p, free);
    };
    take_half(fit, step(changed) - step(own), share);
    share.how = "between lips that slide and lips that cannot, one Gauss-Newton step at the optimum";
  } else {
    share.bias.assign(free.size(), not_a_number);
    share.error = share.bias;
    share.how = (sticking.complete() ? own : sticking).failures.front();
  }
  share.seconds = watch.seconds();
  return found;
}

}  // namespace taut

#include "calib/studies/assumption_shares.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "calib/benches/assumptions.hpp"
#include "calib/benches/bench.hpp"
#include "calib/benches/model.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

constexpr double unstated = 0.01;  ///< of a number without a tolerance: what its share is shown for

/// How far the fitted parameters go where all values of `own` are off by `change`, on the fitted scale. Half of the way
/// from one side to the other: what a step that is not linear does to one side alone goes out.
Eigen::VectorXd shift_by(const Prediction& own, const Eigen::VectorXd& change,
                         const std::vector<Measurement>& measurements, const ParameterTable& table, const Params& p,
                         const std::vector<FreeParameter>& free) {
  const auto step = [&](double side) {
    Prediction changed = own;
    changed.values += side * change;
    return gauss_newton_step(changed, measurements, table, p, free);
  };
  return 0.5 * (step(1) - step(-1));
}

/// That shift as how each parameter moves, and how far.
void set_moves(Share& share, const Eigen::VectorXd& shift, const FitResult& fit) {
  share.error.clear();
  for (const ParameterEstimate& e : fit.parameters) {
    share.moves.push_back((e.spec.logarithmic ? e.value : 1) * shift[static_cast<Eigen::Index>(share.moves.size())]);
    share.error.push_back(std::abs(share.moves.back()));
  }
}

}  // namespace

std::vector<Share> assumption_shares(const Experiment& experiment, const DimensionedModel& model, const FitResult& fit,
                                     const std::function<void(const std::string&)>& progress, const Ask& ask) {
  std::vector<Share> shares;
  if (fit.covariance.size() == 0) return shares;
  const Stopwatch watch;
  if (progress) progress("the shares of what was assumed");
  Protocol& protocol = *model.protocol;
  const ParameterTable& table = protocol.parameters();
  const Params p = model.values_of(fit);
  const std::vector<Assumption> assumptions = assumptions_of(experiment, table, p, model.dimensions);
  const std::vector<FreeParameter> free = free_beyond_bounds(fit, table);
  std::vector<int> asked = indices_of(free);
  for (const Assumption& assumption : assumptions) asked.push_back(table.index(assumption.id));
  const Prediction whole = ask ? ask(protocol, p, asked) : protocol.predict(p, asked);
  const auto unknown = [&](const std::string& source, const std::string& why) {
    const std::vector<double> none(free.size(), not_a_number);
    shares.push_back({source, none, none, why});
    shares.back().counted = false;
  };
  for (const std::string& sentence : model.left_out) unknown(sentence.substr(0, sentence.find(':')), sentence);
  if (!whole.complete()) {
    unknown("what was assumed", whole.failures.front());
    return shares;
  }
  const Eigen::Index n = static_cast<Eigen::Index>(free.size());
  Prediction own{whole.values, whole.derivatives.leftCols(n), {}};
  for (size_t a = 0; a < assumptions.size(); ++a) {
    const Assumption& assumption = assumptions[a];
    if (std::ranges::any_of(fit.parameters, [&](const ParameterEstimate& e) { return e.spec.id == assumption.id; }))
      continue;  // a specimen's own
    Eigen::VectorXd column = whole.derivatives.col(n + static_cast<Eigen::Index>(a));
    const double change = assumption.tolerance > 0 ? assumption.tolerance : unstated * std::abs(assumption.value);
    if (assumption.scale) {
      const size_t control = position_of_control(experiment, assumption.id);
      for (size_t r = 0; r < model.rows.size(); ++r)
        column[static_cast<Eigen::Index>(r)] *= model.rows[r].controls[control];
    }
    if (column.isZero(0)) continue;  // gravity without a weight, say
    Share& share = shares.emplace_back();
    share.source = assumption.scale ? "scale of " + assumption.id : assumption.id;
    if (!assumption.scale && experiment.control_tolerances.contains(assumption.id))
      share.source = "zero of " + assumption.id;
    share.counted = assumption.tolerance > 0;
    share.bias.assign(free.size(), 0.0);
    set_moves(share, shift_by(own, change * column, model.measurements, table, p, free), fit);
    const std::string size =
        assumption.scale ? fmt::format("{:.3g} %", 100 * change) : with_unit(change, assumption.unit);
    share.how = share.counted
                    ? fmt::format("+- {}, one Gauss-Newton step", size)
                    : fmt::format("tolerance not stated; shown for {}", assumption.scale ? size : "1 %, " + size);
  }
  if (!shares.empty()) shares.front().seconds = watch.seconds();
  return shares;
}

Share model_share(const Bench& bench, const FitResult& fit, const Ask& ask) {
  const Stopwatch watch;
  const ParameterTable& table = bench.protocol().parameters();
  const std::vector<FreeParameter> free = free_beyond_bounds(fit, table);
  const std::vector<int> columns = indices_of(free);
  const Prediction own = ask ? ask(bench.protocol(), fit.p, columns) : bench.protocol().predict(fit.p, columns);
  Share share;
  share.source = "model";
  share.bias.assign(free.size(), not_a_number);
  share.error = share.bias;
  Eigen::VectorXd change = own.values;
  double largest = 0;
  int unknown = 0;
  for (Eigen::Index row = 0; row < change.size(); ++row) {
    const RowModel model = bench.model_of(static_cast<int>(row)).value_or(RowModel{});
    change[row] = model.error * model.of.value_or(change[row]);
    largest = std::max(largest, std::abs(model.error));  // leaves NaN out
    if (!std::isfinite(model.error)) ++unknown;
  }
  if (!own.complete()) {
    share.how = own.failures.front();
  } else if (unknown > 0) {
    share.how = fmt::format("the models state no error for {} of {} rows", unknown, change.size());
  } else {
    share.bias.assign(free.size(), 0.0);
    set_moves(share, shift_by(own, change, bench.measurements(), table, fit.p, free), fit);
    share.how = fmt::format("rows off by what their models state, up to {:.2g} %{}, all to one side", 100 * largest,
                            bench.model_of(0)->of ? " of what they have moved" : "");
  }
  share.seconds = watch.seconds();
  return share;
}

std::optional<Share> law_share(const Bench& bench, const FitResult& fit, const Ask& ask) {
  const Experiment& experiment = bench.experiment();
  if (experiment.model != Rung::rod) return std::nullopt;
  const Stopwatch watch;
  VariantSettings other;
  other.mesh = experiment.mesh;
  for (const auto& [name, law] : section_laws()) {
    if (law != experiment.rod_section) other.law = name;
  }
  const std::unique_ptr<Bench> there = bench.with(other);
  const ParameterTable& table = bench.protocol().parameters();
  const std::vector<FreeParameter> free = free_beyond_bounds(fit, table);
  const auto step = [&](const Bench& of) {
    const std::vector<int> columns = indices_of(free);
    const Prediction own = ask ? ask(of.protocol(), fit.p, columns) : of.protocol().predict(fit.p, columns);
    if (!own.complete()) throw InputError(own.failures.front());
    return gauss_newton_step(own, bench.measurements(), table, fit.p, free);
  };
  Share share;
  share.source = "section law";
  share.bias.assign(free.size(), 0.0);
  try {
    set_moves(share, step(*there) - step(bench), fit);
    share.how = fmt::format("one Gauss-Newton step at the optimum with rod_section = \"{}\"", other.law);
  } catch (const InputError& error) {
    share.bias.assign(free.size(), not_a_number);
    share.error = share.bias;
    share.how = fmt::format("rod_section = \"{}\": {}", other.law, error.what());
  }
  share.seconds = watch.seconds();
  return share;
}

TotalInterval total_interval(const ParameterEstimate& estimate, const std::vector<Share>& shares, size_t j) {
  TotalInterval total;
  double squares = 0;
  for (const Share& share : shares) {
    if (!std::isfinite(share.bias[j])) {
      total.without.push_back(share.source);
    } else if (share.counted) {
      const double most = std::abs(share.bias[j]) + (std::isfinite(share.error[j]) ? share.error[j] : 0);
      squares += most * most;
    }
  }
  if (estimate.lower95)
    total.lower = estimate.value - std::hypot(estimate.value - *estimate.lower95, std::sqrt(squares));
  if (estimate.upper95)
    total.upper = estimate.value + std::hypot(*estimate.upper95 - estimate.value, std::sqrt(squares));
  if (total.lower) total.lower = std::max(*total.lower, estimate.spec.logarithmic ? 0.0 : estimate.spec.lower);
  return total;
}

}  // namespace taut

#include "calib/studies/assumption_shares.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "calib/benches/assumptions.hpp"
#include "calib/benches/bench.hpp"
#include "calib/benches/model.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

constexpr double unstated = 0.01;  ///< of a number without a tolerance: what its share is shown for

}  // namespace

std::vector<Share> assumption_shares(const Experiment& experiment, const Trials& trials, const FitResult& fit,
                                     const std::function<void(const std::string&)>& progress, const Ask& ask) {
  std::vector<Share> shares;
  if (fit.covariance.size() == 0) return shares;
  const Stopwatch watch;
  if (progress) progress("the shares of what was assumed");
  DimensionedProtocol protocol(experiment, trials, dimensions_of(experiment));
  const ParameterTable& table = protocol.parameters();
  const Params p = protocol.values_of(fit);
  const std::vector<Assumption> assumptions = assumptions_of(experiment, table, p, protocol.dimensions());
  std::vector<FreeParameter> free;
  for (const ParameterEstimate& e : fit.parameters) free.push_back({table.index(e.spec.id), e.value, e.lower, e.upper});
  std::vector<int> asked = indices_of(free);
  for (const Assumption& assumption : assumptions) asked.push_back(table.index(assumption.id));
  const Prediction whole = ask ? ask(protocol, p, asked) : protocol.predict(p, asked);
  const auto unknown = [&](const std::string& source, const std::string& why) {
    const std::vector<double> none(free.size(), not_a_number);
    shares.push_back({source, none, none, why});
    shares.back().counted = false;
  };
  for (const std::string& sentence : protocol.left_out()) unknown(sentence.substr(0, sentence.find(':')), sentence);
  if (!whole.complete()) {
    unknown("what was assumed", whole.failures.front());
    return shares;
  }
  const Eigen::Index n = static_cast<Eigen::Index>(free.size());
  Prediction own{whole.values, whole.derivatives.leftCols(n), {}};
  const std::vector<StaticRow>& rows = protocol.replay().protocol->rows();
  for (size_t a = 0; a < assumptions.size(); ++a) {
    const Assumption& assumption = assumptions[a];
    Eigen::VectorXd column = whole.derivatives.col(n + static_cast<Eigen::Index>(a));
    const double change = assumption.tolerance > 0 ? assumption.tolerance : unstated * std::abs(assumption.value);
    if (assumption.scale) {
      const size_t control = position_of_control(experiment, assumption.id);
      for (size_t r = 0; r < rows.size(); ++r) column[static_cast<Eigen::Index>(r)] *= rows[r].controls[control];
    }
    // Half of the way from one side to the other: what a step that is not linear does to one side alone goes out.
    const auto step = [&](double by) {
      Prediction changed = own;
      changed.values = whole.values + by * column;
      return gauss_newton_step(changed, protocol.replay().measurements, table, p, free);
    };
    const Eigen::VectorXd shift = 0.5 * (step(change) - step(-change));
    if (column.isZero(0)) continue;  // gravity without a weight, say
    Share& share = shares.emplace_back();
    share.source = assumption.scale ? "scale of " + assumption.id : assumption.id;
    if (!assumption.scale && experiment.control_tolerances.contains(assumption.id))
      share.source = "zero of " + assumption.id;
    share.counted = assumption.tolerance > 0;
    for (size_t j = 0; j < free.size(); ++j) {
      const ParameterEstimate& e = fit.parameters[j];
      const double by = std::abs(shift[static_cast<Eigen::Index>(j)]);
      share.bias.push_back(0);
      share.error.push_back(e.spec.logarithmic ? e.value * by : by);
    }
    const std::string size =
        assumption.scale ? fmt::format("{:.3g} %", 100 * change) : with_unit(change, assumption.unit);
    share.how = share.counted
                    ? fmt::format("+- {}, one Gauss-Newton step", size)
                    : fmt::format("tolerance not stated; shown for {}", assumption.scale ? size : "1 %, " + size);
  }
  if (!shares.empty()) shares.front().seconds = watch.seconds();
  return shares;
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
  if (total.lower && estimate.spec.logarithmic) total.lower = std::max(*total.lower, 0.0);
  return total;
}

}  // namespace taut

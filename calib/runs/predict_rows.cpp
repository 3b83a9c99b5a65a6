#include "calib/runs/predict_rows.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"

namespace taut {
namespace {

/// Standard deviation that a new reading of a channel would have at this load when the bench lists them row by row:
/// that of the run's readings, interpolated over the load and constant beyond them.
double sigma_at(const RunRecord& record, const std::string& channel, double load) {
  std::map<double, std::pair<double, int>> by_load;  // load to sum of sigma^2 and count
  for (size_t i = 0; i < record.readings.size(); ++i) {
    if (record.readings[i].channel != channel || record.readings[i].excluded) continue;
    auto& [sum, count] = by_load[record.load_newtons[i]];
    sum += record.readings[i].sigma * record.readings[i].sigma;
    ++count;
  }
  auto sigma = [](const auto& entry) { return std::sqrt(entry->second.first / entry->second.second); };
  if (by_load.empty()) return 0;
  const auto above = by_load.lower_bound(load);
  if (above == by_load.begin()) return sigma(above);
  if (above == by_load.end()) return sigma(std::prev(above));
  const auto below = std::prev(above);
  const double t = (load - below->first) / (above->first - below->first);
  return (1 - t) * sigma(below) + t * sigma(above);
}

std::vector<PredictedRow> predicted_rows(const RunRecord& record, const Bench& bench, const Prediction& prediction,
                                         const Eigen::VectorXd& se, const std::vector<EquilibriaRecord>& equilibria) {
  std::vector<PredictedRow> rows;
  for (const BenchReading& reading : bench.readings()) {
    PredictedRow& row = rows.emplace_back();
    row.line = reading.line;
    row.channel = bench.channels()[static_cast<size_t>(reading.channel)].id;
    row.controls = reading.controls;
    row.value = prediction.values[reading.row];
    row.error = se[reading.row];
    const size_t k = static_cast<size_t>(std::max(0, record.load_control));
    const double load = record.load_control < 0 ? 0.0 : bench.as_force(k, reading.controls[k]);
    const double sigma = bench.declared_sigma(reading.channel, row.value).value_or(sigma_at(record, row.channel, load));
    row.curve = 1.96 * row.error;
    row.reading = 1.96 * std::hypot(row.error, sigma);
    for (const EquilibriaRecord& rows_there : equilibria) {
      if (std::ranges::count(rows_there.lines, row.line) > 0) row.equilibria = mark_of(rows_there);
    }
  }
  return rows;
}

}  // namespace

void refuse_without_result(const RunRecord& record, const std::string& run, bool anyway) {
  if (record.fit.covariance.size() > 0 || anyway) return;
  throw InputError(fmt::format(
      "{}: its fit has no result to predict from ({}: {}); run the fit again, or see what it would be with --anyway",
      run, name_of(record.fit.status), record.fit.message));
}

RowsPrediction predict_rows(const RunRecord& record, const Bench& bench) {
  Protocol& protocol = bench.protocol();
  Params p = protocol.nominal();
  std::vector<FreeParameter> free;
  for (const ParameterEstimate& e : record.fit.parameters) {
    FreeParameter& parameter = free.emplace_back();
    parameter.index = protocol.parameters().index(e.spec.id);
    p[parameter.index] = e.value;
  }
  const Prediction prediction = protocol.predict(p, indices_of(free));
  Eigen::VectorXd se = standard_errors(prediction, protocol.parameters(), p, free, record.fit.covariance);
  if (record.fit.covariance.size() == 0) se.setConstant(not_a_number);
  const std::vector<EquilibriaRecord> equilibria = equilibria_of(bench, protocol.alternatives(p), {}, {});
  RowsPrediction predicted;
  predicted.rows = predicted_rows(record, bench, prediction, se, equilibria);
  predicted.warnings = bench.warnings_after();
  for (const EquilibriaRecord& rows_there : equilibria) predicted.warnings.push_back(rows_there.text);
  predicted.failures = prediction.failures;
  return predicted;
}

}  // namespace taut

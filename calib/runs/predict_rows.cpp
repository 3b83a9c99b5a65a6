#include "calib/runs/predict_rows.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "calib/fit/distributions.hpp"
#include "calib/runs/new_reading.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"

namespace taut {
namespace {

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
    const double sigma = sigma_of_new_reading(record, bench, reading, row.value);
    row.curve = z95 * row.error;
    row.reading = z95 * std::hypot(row.error, sigma);
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
    if (!std::isfinite(e.value))
      throw InputError(fmt::format("'{}' has no value in fit.json; run the fit again", e.spec.id));
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

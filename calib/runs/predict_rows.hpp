#pragma once
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"
#include "calib/runs/run_record.hpp"

namespace taut {

/// A value at a new load, with the 95 % bands of the curve (what the noise leaves open in the fit) and of a new
/// reading, which scatters by its own noise on top: half widths 1.96 s and 1.96 sqrt(s^2 + sigma^2).
struct PredictedRow {
  int line = 0;                   ///< of the rows' file
  std::string channel;            ///< its id
  std::vector<double> controls;   ///< SI
  double value = 0;               ///< SI
  double error = 0;               ///< s, standard error of the curve, SI; NaN: the fit has no result
  double curve = 0, reading = 0;  ///< half widths of the bands, SI
  std::string equilibria = {};    ///< mark_of() those of its row; "": there is one
};

/// What a calibrated bench says of rows that nobody has measured.
struct RowsPrediction {
  std::vector<PredictedRow> rows;     ///< channels within rows
  std::vector<std::string> warnings;  ///< folded states, other equilibria: sentences
  std::vector<std::string> failures;  ///< of simulations; their rows are NaN
};

/// Throws InputError where a run has no result to predict from, unless `anyway`; `run` starts the message.
void refuse_without_result(const RunRecord& record, const std::string& run, bool anyway);

/// Predicts the rows of `bench` (Bench::at_rows(), Bench::at_loads() of the run's own) at the fitted values, first
/// order in the covariance of the fit.
RowsPrediction predict_rows(const RunRecord& record, const Bench& bench);

}  // namespace taut

#pragma once
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"
#include "calib/runs/run_record.hpp"

namespace taut {

/// What a replay found, with derivatives where they were asked for.
struct Replay {
  RunRecord record;
  Prediction prediction;
  std::vector<int> with_respect_to;              ///< all parameters and controls; empty: not asked for
  std::vector<std::vector<double>> derivatives;  ///< of each reading, SI, one per parameter and control
  std::vector<TangentStiffness> stiffness;
};

/// Puts a value instead of the file's into `p`: a number with a unit of the parameter's quantity, "47.3 kPa" or
/// "47.3kPa". Throws InputError, which begins with `where`, for unknown ids, controls that the bench sets row by row,
/// wrong units, and values out of the physical range.
void set_parameter(const Bench& bench, const std::string& id, const std::string& value, const std::string& where,
                   Params& p);
/// The same of a value in SI.
void set_parameter(const Bench& bench, const std::string& id, double value, const std::string& where, Params& p);

/// Predicts every reading of a bench at `p`, cold. With `sensitivities` dy/dp of every reading with respect to all
/// parameters and controls, everything else held, and the tangent stiffness at each load. Failures are sentences in
/// `prediction`, their rows NaN.
Replay replay_bench(const Bench& bench, const Params& p, bool sensitivities);

}  // namespace taut

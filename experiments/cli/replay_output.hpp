#pragma once
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"
#include "calib/runs/run_record.hpp"

// What `taut replay` found, as JSON, CSV and lines for people.
namespace taut {

/// What a replay found, with derivatives where they were asked for.
struct Replay {
  RunRecord record;
  Prediction prediction;
  std::vector<int> with_respect_to;              ///< all parameters and controls; empty: not asked for
  std::vector<std::vector<double>> derivatives;  ///< of each reading
  std::vector<TangentStiffness> stiffness;
};

/// What `--json` prints.
nlohmann::ordered_json replay_json(const Replay& replay, const Bench& bench);
/// Derivatives of each reading, a row each.
std::string sensitivities_csv(const Replay& replay, const Bench& bench);
/// The same, for people, with tangent stiffnesses.
void print_sensitivities(const Replay& replay, const Bench& bench);

}  // namespace taut

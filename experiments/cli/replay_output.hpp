#pragma once
#include <nlohmann/json_fwd.hpp>
#include <string>

#include "calib/runs/replay.hpp"

// What `taut replay` found, as JSON, CSV and lines for people.
namespace taut {

/// What `--json` prints.
nlohmann::ordered_json replay_json(const Replay& replay, const Bench& bench);
/// Derivatives of each reading, a row each.
std::string sensitivities_csv(const Replay& replay, const Bench& bench);
/// The same, for people, with tangent stiffnesses.
void print_sensitivities(const Replay& replay, const Bench& bench);

}  // namespace taut

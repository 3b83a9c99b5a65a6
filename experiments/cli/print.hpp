#pragma once
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"
#include "calib/runs/run_record.hpp"

// What commands say, for people.
namespace taut {

/// Sentences about simulations that failed, on stderr.
void print_failures(const std::vector<std::string>& failures);
/// "measured_m": a key of JSON with the SI unit of a channel.
std::string key(const std::string& name, const RunRecord& record, const std::string& channel);
/// Readings beside predictions.
void print_readings(const RunRecord& record);
/// Frequencies and decays of recordings.
void print_swings(const RunRecord& record);
/// Tensions and lengths of cables.
void print_cables(const std::vector<CableState>& states);
/// What a fit found.
void print_fit(const RunRecord& record);
/// In UTF-8 always: paths may be in another encoding. `indent`: -1 for one line.
void print_json(const nlohmann::ordered_json& json, int indent = 2);
/// What was understood of an experiment, its free parameters, problems.
void print_check(const RunRecord& record, const ParameterTable& table, const std::vector<FreeParameter>& free);

}  // namespace taut

#pragma once
#include <vector>

#include "calib/benches/bench.hpp"
#include "calib/runs/run_record.hpp"

// What commands say on stdout, for people.
namespace taut {

/// Readings beside predictions.
void print_readings(const RunRecord& record);
/// Frequencies and decays of recordings.
void print_swings(const RunRecord& record);
/// Tensions and lengths of cables.
void print_cables(const std::vector<CableState>& states);
/// What a fit found.
void print_fit(const RunRecord& record);
/// What was understood of an experiment, its free parameters, problems.
void print_check(const RunRecord& record, const ParameterTable& table, const std::vector<FreeParameter>& free);

}  // namespace taut

#pragma once
#include <string>

#include "calib/benches/bench.hpp"
#include "calib/runs/run_record.hpp"

// The files that a run was made from, and their copies in its folder.
namespace taut {

/// Records the inputs of a bench with their hashes.
std::vector<InputRecord> inputs_of(const Bench& bench);
/// Copies them into `folder`, so that a run explains itself. Throws InputError when one has changed since inputs_of().
void copy_inputs(const std::vector<InputRecord>& inputs, const std::string& folder);
/// Throws InputError when a copy in the run folder is not the one that its fit.json belongs to.
void check_inputs(const RunRecord& record, const std::string& folder);
/// The experiment of a run folder, reading its copies. Throws as check_inputs() does.
Experiment experiment_of_run(const RunRecord& record, const std::string& folder);
/// Tells runs with the same inputs by the same program from others.
std::string fingerprint_of(const std::vector<InputRecord>& inputs);

}  // namespace taut

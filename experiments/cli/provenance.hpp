#pragma once
#include <string>
#include <vector>

// What a result was made by and from: this program, and the files that are copied into a run's folder.
namespace taut {

class Bench;
struct CommandOptions;
struct Experiment;
struct InputRecord;
struct Provenance;
struct RunRecord;

std::string version();
/// Commit that this binary was built from, "unknown" outside a repository.
std::string commit();
/// Of a run that begins now.
Provenance provenance_of(const CommandOptions& options, const Bench& bench);

/// Copies inputs into `folder`, so that a run explains itself. Throws InputError when one has changed since
/// provenance_of().
void copy_inputs(const std::vector<InputRecord>& inputs, const std::string& folder);
/// Throws InputError when a copy in the run folder is not the one that its fit.json belongs to.
void check_inputs(const RunRecord& record, const std::string& folder);
/// The experiment of a run folder, reading its copies. Throws as check_inputs() does.
Experiment experiment_of_run(const RunRecord& record, const std::string& folder);
/// Tells runs with the same inputs by the same program from others.
std::string fingerprint_of(const std::vector<InputRecord>& inputs);

}  // namespace taut

#pragma once
#include <string>
#include <vector>

#include "calib/runs/run_record.hpp"

// What a result was made by and from: a program, and the files that are copied into a run's folder.
namespace taut {

/// The program that makes results: the command, or another language's module.
struct Program {
  std::string version, commit;          ///< of taut
  std::string command_line;             ///< how it was called
  std::string file = "/proc/self/exe";  ///< its binary: what it evaluated goes on in the same one only
};

/// Of a run that begins now. Throws InputError where an input cannot be read.
Provenance provenance_of(const Program& program, const Bench& bench);

/// Copies inputs into `folder`, so that a run explains itself. Throws InputError when one has changed since
/// provenance_of().
void copy_inputs(const std::vector<InputRecord>& inputs, const std::string& folder);
/// Throws InputError when a copy in the run folder is not the one that its fit.json belongs to.
void check_inputs(const RunRecord& record, const std::string& folder);
/// The experiment of a run folder, reading its copies. Throws as check_inputs() does.
Experiment experiment_of_run(const RunRecord& record, const std::string& folder);
/// Tells runs with the same inputs by the same program from others.
std::string fingerprint_of(const Program& program, const std::vector<InputRecord>& inputs);

}  // namespace taut

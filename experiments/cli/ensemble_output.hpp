#pragma once
#include <string>

#include "calib/studies/study_store.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/progress.hpp"
#include "reports/ensemble_run.hpp"

namespace taut {

/// How many members an option asks for; 0 stands for `otherwise`. Throws InputError for less than 1 or over a million.
unsigned members_asked(int number, const std::string& option, unsigned otherwise);

/// What an ensemble may take and whom it tells, without a store.
StudyOptions ensemble_options(const CommandOptions& options, Progress& progress);

/// Says which members are missing, and prints what the others say.
void print_ensemble(const EnsembleRun& run, const EnsembleTask& task, Progress& progress, bool as_text);

/// The same of a command that does nothing else; returns the exit code.
int end_ensemble(const CommandOptions& options, const EnsembleRun& run, const EnsembleTask& task, Progress& progress);

/// --shard I/N, of commands whose work can be split.
void add_shard(AddOption add, CommandOptions& options);
/// The part of the work that --shard asks for. Throws InputError for anything but I/N with 1 <= I <= N.
Shard shard_of(const CommandOptions& options);

}  // namespace taut

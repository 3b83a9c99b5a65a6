#pragma once
#include "experiments/cli/commands.hpp"

namespace taut {

/// Solves the targets and paths of [ik], one after the other: a table on stdout; ik.csv, states, a strip of the poses
/// and report.html in a run folder. Exit code 3 when a search failed; a target out of reach is an answer.
int ik_command(const CommandOptions& options);

}  // namespace taut

#pragma once
#include "experiments/cli/commands.hpp"

namespace taut {

/// Runs an experiment (readings at rest, recordings, or a simulation) with other meshes, elements and solver settings
/// and charts the error of its result against the time and the matrix factorisations it took: accuracy.csv, figures as
/// SVG, PDF and PNG in the folder that --out names. Each finished setting is kept at once, and the next run goes on
/// from there; settings that do not fit into --budget are left out and counted. Exit code 130 when interrupted.
int chart_accuracy(const CommandOptions& options);

}  // namespace taut

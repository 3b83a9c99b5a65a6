#pragma once
#include "experiments/commands.hpp"

namespace taut {

/// Runs a simulation file: states as VTU, channels as CSV, figures, a strip, an animation and report.html in a run
/// folder; a summary on stdout.
int simulate_command(const CommandOptions& options);

/// Reads a simulation file and builds its scene, says what it understood; solves nothing.
int check_simulation(const CommandOptions& options);

}  // namespace taut

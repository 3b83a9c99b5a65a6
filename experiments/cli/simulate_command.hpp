#pragma once
#include "experiments/cli/commands.hpp"

namespace taut {

/// Reads a simulation file and builds its scene, says what it understood; solves nothing.
int check_simulation(const CommandOptions& options);

}  // namespace taut

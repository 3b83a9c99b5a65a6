#pragma once
#include "experiments/cli/commands.hpp"
#include "reports/simulation_record.hpp"
#include "sim/robots/robot.hpp"

namespace taut {

/// Runs a simulation file: states as VTU, channels as CSV, figures, a strip, an animation and report.html in a run
/// folder; a summary on stdout.
int simulate_command(const CommandOptions& options);

/// What a record knows before anything is solved: mesh, cables, obstacles, where it comes from.
SimulationRecord start_simulation_record(const Simulation& simulation, const Robot& robot,
                                         const CommandOptions& options);

/// Reads a simulation file and builds its scene, says what it understood; solves nothing.
int check_simulation(const CommandOptions& options);

}  // namespace taut

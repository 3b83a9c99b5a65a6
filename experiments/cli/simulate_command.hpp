#pragma once
#include "calib/data/run_folder.hpp"
#include "experiments/cli/commands.hpp"
#include "reports/simulation_record.hpp"
#include "sim/robots/simulate.hpp"

// What commands on simulations share.
namespace taut {

/// What a record knows before anything is solved: mesh, cables, obstacles, controls and channels without values, where
/// it comes from.
SimulationRecord start_simulation_record(const Simulation& simulation, const Robot& robot,
                                         const CommandOptions& options);

/// How many nodes of no element, the mesh's last, carry grounds that move.
int carriers_of(const Simulation& simulation);
/// Appends a state of the robot's: the bodies' nodes, and where grounds are.
void add_state(const Simulation& simulation, const Eigen::VectorXd& u, SimulationRecord& record);

/// All that a run found, with what an independent test says of its states.
SimulationRecord make_simulation_record(const Simulation& simulation, const Robot& robot,
                                        const SimulationResult& result, const CommandOptions& options);

/// Writes a record, and puts it with what else stands in folder.next() in the old run's place; where its figures fail,
/// all else takes its place first. `stopped`: parts are missing.
void publish(const SimulationRecord& record, RunFolder& folder, bool stopped);

/// Reads a simulation file and builds its scene, says what it understood; solves nothing.
int check_simulation(const CommandOptions& options);

}  // namespace taut

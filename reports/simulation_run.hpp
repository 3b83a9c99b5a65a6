#pragma once
#include <atomic>
#include <functional>
#include <string>

#include "calib/data/run_folder.hpp"
#include "calib/runs/provenance.hpp"
#include "reports/simulation_record.hpp"
#include "sim/robots/simulate.hpp"

// From a simulation to its record and its run folder.
namespace taut {

/// Name of the folder of an experiment.toml, or of another file without its extension.
std::string experiment_name(const std::string& path);

/// "BDF2 (order 2), steps of 1 ms": how a simulation goes from state to state, for people.
std::string integrator_text(const Simulation& simulation);
/// Where joined bodies do not see each other; "": there is no such place.
std::string blind_patches(const Robot& robot);

/// What a record knows before anything is solved: mesh, cables, obstacles, controls and channels without values, where
/// it comes from. Throws InputError when the simulation's file cannot be read any more.
SimulationRecord start_simulation_record(const Simulation& simulation, const Robot& robot, const Program& program);

/// How many nodes of no element, the mesh's last, carry grounds that move.
int carriers_of(const Simulation& simulation);
/// Appends a state of the robot's: the bodies' nodes, and where grounds are.
void add_state(const Simulation& simulation, const Eigen::VectorXd& u, SimulationRecord& record);

/// All that a run found, with what an independent test says of its states.
SimulationRecord make_simulation_record(const Simulation& simulation, const Robot& robot,
                                        const SimulationResult& result, const Program& program);

/// Samples the workspaces that the file asks for, if it does, into the record; `say` is told of each mode.
void add_workspaces(const Simulation& simulation, const Robot& robot,
                    const std::function<void(const std::string&)>& say, const std::atomic<bool>* stop,
                    SimulationRecord& record);

/// Writes a record, and puts it with what else stands in folder.next() in the old run's place; where its figures fail,
/// all else takes its place first. `stopped`: parts are missing. Throws as write_simulation() does.
void publish(const SimulationRecord& record, RunFolder& folder, bool stopped);

}  // namespace taut

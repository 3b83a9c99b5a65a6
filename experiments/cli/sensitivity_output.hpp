#pragma once
#include <nlohmann/json_fwd.hpp>
#include <string>

#include "experiments/cli/commands.hpp"
#include "sim/robots/simulate.hpp"

namespace taut {

/// What --sensitivities, --goal CHANNEL[@TIME] and --wrt ID,ID,... ask for; without --wrt all parameters of the model.
/// Throws InputError for unknown channels and parameters, for times outside the simulation, and for --wrt alone.
SimulationSensitivities read_sensitivities(const CommandOptions& options, const Simulation& simulation,
                                           const Robot& robot);

/// One line per time: time_s, then d_CHANNEL_d_PARAMETER of each channel with respect to each parameter, in SI; the
/// unit ends the header, as parse_header() reads it ("m_per_Pa").
std::string sensitivities_csv(const Robot& robot, const SimulationSensitivities& wanted,
                              const SimulationResult& result);

/// Adds the keys `sensitivities` and `goal` as far as they were asked for and found, SI.
void add_sensitivities(const Simulation& simulation, const Robot& robot, const SimulationSensitivities& wanted,
                       const SimulationResult& result, nlohmann::ordered_json& json);

/// The goal's gradient as a table for people, "" without a goal.
std::string goal_table(const Simulation& simulation, const Robot& robot, const SimulationSensitivities& wanted,
                       const SimulationResult& result);

}  // namespace taut

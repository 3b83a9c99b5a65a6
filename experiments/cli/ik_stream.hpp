#pragma once
#include <nlohmann/json_fwd.hpp>
#include <string>

#include "experiments/cli/commands.hpp"
#include "sim/robots/robot_ik.hpp"

namespace taut {

/// SI.
std::string unit_of(const ControlSettings& control);
/// What was found for a target: status, controls, channels, what it took.
nlohmann::ordered_json json_of(const Simulation& simulation, const Robot& robot, const IkAnswer& answer);

/// Targets from stdin, each from the answer to the last one: a JSON object a line, in which keys are ids of channels,
/// or "hold" and "stiffness" with an object of ids each; "name" is handed through. Values are numbers in SI or strings
/// with units. For each a line of JSON on stdout, sent at once; {"error": "..."} for a line that is wrong. Returns at
/// the end of the input.
int stream_targets(const Simulation& simulation, const CommandOptions& options);

}  // namespace taut

#pragma once
#include <string>

#include "sim/robots/simulation.hpp"

namespace taut {

/// A target of inverse kinematics in JSON: an object in which keys are ids of channels of places or angles, or "hold"
/// and "stiffness" with an object of ids each; "name" is not read. Values are numbers in SI or strings with units. For
/// a simulation with [ik]. Throws InputError, which begins with `where`, for text that is no object, unknown ids, wrong
/// units, and a target without a channel or without a free control.
IkTarget read_ik_target(const std::string& text, const Simulation& simulation, const std::string& where);

}  // namespace taut

#pragma once
#include <string>

#include "sim/robots/simulation.hpp"

namespace taut {

/// The text of a simulation's file, UTF-8, whose controls move as simulation.schedules say, which differ from those of
/// the file in targets of pieces only: read again, the text gives these to the last bit. Values keep their units where
/// that is possible. All else stays as it stands, comments too, but paths of meshes become absolute, so that the text
/// may lie in any folder. Throws InputError when the file cannot be read.
std::string text_with_schedules(const Simulation& simulation);

}  // namespace taut

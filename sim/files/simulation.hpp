#pragma once
#include <string>

#include "sim/robots/simulation.hpp"

namespace taut {

/// Whether a TOML file describes a simulation (it has a table [simulation]) and not an experiment with a bench.
bool is_simulation(const std::string& path);

/// Reads and checks a simulation file. Throws InputError with file, line, what is wrong and what is allowed.
Simulation read_simulation(const std::string& path);

}  // namespace taut

#pragma once
#include <string>
#include <string_view>

#include "sim/robots/simulation.hpp"

namespace taut {

/// Whether a TOML file describes a simulation (it has a table [simulation]) and not an experiment with a bench.
bool is_simulation(const std::string& path);

/// Reads and checks a simulation file. Throws InputError with file, line, what is wrong and what is allowed.
Simulation read_simulation(const std::string& path);
/// The same of a text that need not be a file; `path` is what messages call it.
Simulation read_simulation_text(const std::string& path, std::string_view text);

}  // namespace taut

#pragma once
#include <string>
#include <vector>

namespace taut {

/// The files that a .geo takes in (Merge, Include, Open, ShapeFromFile), and those that these take in, each once: paths
/// as seen from its folder, where Gmsh looks for them. None of files with another ending, and none that do not exist:
/// their branch was not taken. Throws InputError with file and line where such a name is computed.
std::vector<std::string> merged_files(const std::string& path);

}  // namespace taut

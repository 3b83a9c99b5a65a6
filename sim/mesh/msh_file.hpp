#pragma once
#include <string>

#include "sim/mesh/mesh.hpp"

namespace taut {

/// Reads a Gmsh .msh file, format 4.1 or 2.2, ASCII; anything else by way of msh_text(), with `dimension`. Physical
/// groups of the highest dimension become regions, those of lower dimension become tags (unnamed groups are called
/// "physical_<number>"). Coordinates times `unit` are metres. A mesh whose third coordinates are all equal and that has
/// triangles only is 2D. Nodes of no element are dropped, elements and entities that are there twice count once, both
/// with a remark. Throws InputError with file and line for anything that is not understood, for mixed or unsupported
/// element types and for elements without a region.
Mesh read_msh(const std::string& path, double unit = 1.0, int dimension = 3);

}  // namespace taut

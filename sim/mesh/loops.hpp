#pragma once
#include <vector>

#include "sim/mesh/mesh.hpp"

namespace taut {

/// The outlines of one region of a 2D mesh as closed lines of node numbers (mid-nodes of quadratic elements included,
/// the first node not repeated): anticlockwise around the region, clockwise around its holes. Throws InputError for 3D
/// meshes.
std::vector<std::vector<int>> region_loops(const Mesh& mesh, int region);

}  // namespace taut

#pragma once
#include <array>
#include <vector>

#include "sim/mesh/mesh.hpp"

namespace taut {

/// The outlines of one region of a 2D mesh as closed lines of node numbers (mid-nodes of quadratic elements included,
/// the first node not repeated): anticlockwise around the region, clockwise around its holes. Throws InputError for 3D
/// meshes.
std::vector<std::vector<int>> region_loops(const Mesh& mesh, int region);

/// What is seen of a mesh from outside: in 2D closed lines around its regions (mid-nodes included), in 3D the triangles
/// of its boundary, outward oriented; facets of quadratic elements are four of them. Both count in `nodes`.
struct BoundarySurface {
  std::vector<int> nodes;  ///< of the mesh, ascending
  /// A closed line around a region.
  struct Loop {
    int region;
    std::vector<int> points;  ///< anticlockwise around the region, clockwise around its holes
  };
  std::vector<Loop> loops;
  /// A piece of the boundary in space.
  struct Triangle {
    int region;
    std::array<int, 3> points;
  };
  std::vector<Triangle> triangles;
};
BoundarySurface boundary_surface(const Mesh& mesh);  ///< of all elements

}  // namespace taut

#pragma once
#include <string>
#include <vector>

#include "sim/mesh/mesh.hpp"

namespace taut {

/// True when this build can mesh through Gmsh.
bool has_gmsh();

/// A closed polygon [m] that is one region of a 2D domain; edge i runs from vertex i to vertex i + 1 and may carry a
/// tag name (empty: untagged). Polygons may share edges, which are then meshed conformingly: regions are bonded there.
struct PolygonRegion {
  std::string region;
  std::vector<std::array<double, 2>> vertices;  ///< [m]
  std::vector<std::string> edge_tags;           ///< empty, or one per edge
};

/// An axis-aligned box [m] that is one region of a 3D domain; touching boxes are meshed conformingly.
struct BoxRegion {
  std::string region;
  std::array<double, 3> lower;  ///< [m]
  std::array<double, 3> upper;  ///< [m]
};

/// Meshes polygons with triangles of about `size` [m]; polygon edges shorter than that keep their length, so an outline
/// sampled much finer than `size` gets flat triangles along it. Throws InputError for self-crossing or degenerate
/// polygons and when this build has no Gmsh.
Mesh mesh_polygons(const std::vector<PolygonRegion>& polygons, double size, int order);

/// Meshes boxes with tetrahedra of about `size` [m]. Tags xmin ... zmax are the faces of the whole domain's bounding
/// box. Errors as above.
Mesh mesh_boxes(const std::vector<BoxRegion>& boxes, double size, int order);

/// What is in a file of any format that Gmsh reads, as text of its format 4.1 for read_msh(): meshes (.msh of other
/// versions, binary ones, .inp, .vtk, ...) as they are, geometry (.geo, .step, .brep) meshed in `dimension` (2 or 3)
/// with the sizes that it has, a closed triangulated surface (.stl) filled. Without physical groups each volume and
/// face becomes one of its own: its name in the file, else "volume_1", "surface_2" ("surface_1", "curve_2" in 2D).
/// Throws InputError with the path for what Gmsh cannot do, and in a build without it.
std::string msh_text(const std::string& path, int dimension);

}  // namespace taut

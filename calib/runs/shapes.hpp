#pragma once
#include <array>
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"

namespace taut {

/// What presses on a piece of the specimen's boundary, see ContactPatch; coordinates are those of space, three in 3D.
struct ContactRecord {
  std::vector<double> centre;  ///< where the force is drawn [m]
  std::vector<double> force;   ///< on the patch, net [N]
  std::vector<double> places;  ///< of its nodes, one after the other [m]
};

/// The boundary of a specimen in space, the same in all conditions.
struct SurfaceRecord {
  std::vector<std::string> regions;   ///< names
  std::vector<int> triangles;         ///< three of the shapes' points each, outward oriented; none in 2D
  std::vector<int> triangle_regions;  ///< index of each triangle's region
};

/// Side view of the deformed specimen in one condition; in 3D also its surface.
struct ShapeRecord {
  std::string label;                            ///< "0.51 N"
  std::vector<std::array<double, 4>> segments;  ///< boundary lines x0 y0 x1 y1 in the drawing plane [m]
  // In 2D also, for panels beside each other:
  using Line = std::vector<std::array<double, 2>>;  ///< points in the drawing plane [m]
  /// A filled part of the picture.
  struct Area {
    std::string region;
    std::vector<Line> loops;  ///< closed, anticlockwise around the region, clockwise around its holes
  };
  std::vector<Area> areas = {};
  std::vector<Line> cables = {};
  std::string row = {}, column = {};  ///< what is held ("retraction 5.89 mm") and the load ("50 g")
  // In 3D also, in space:
  std::vector<double> points = {};                     ///< of the surface, x y z each [m]
  std::vector<std::vector<double>> space_cables = {};  ///< x y z each [m]
  std::vector<ContactRecord> contacts = {};  ///< the hardest pressed first; none: not known, or nothing touches
};

/// Axes of the drawing plane, 0 = x: in 2D x and y; in 3D the vertical one is where `down` points, the horizontal one
/// the longest of the others.
std::array<int, 2> drawing_plane(const SolvedStates& states);

/// What the points of shapes in 3D are part of; without triangles in 2D.
SurfaceRecord surface_record(const Mesh& mesh);

/// The rest shape and all states. None without a mesh.
std::vector<ShapeRecord> draw_shapes(const SolvedStates& states);

}  // namespace taut

#pragma once
#include <array>
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"

namespace taut {

/// Side view of the deformed specimen in one condition.
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
};

/// Axes of the drawing plane, 0 = x: in 2D x and y; in 3D the vertical one is where `down` points, the horizontal one
/// the longest of the others.
std::array<int, 2> drawing_plane(const SolvedStates& states);

/// Side views of the rest shape and of all states. None without a mesh.
std::vector<ShapeRecord> draw_shapes(const SolvedStates& states);

}  // namespace taut

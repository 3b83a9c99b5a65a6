#pragma once
#include <array>
#include <map>
#include <string>
#include <vector>

#include "sim/mesh/gmsh.hpp"

namespace taut {

/// The outlines of all polygons as one graph of points and straight lines. What polygons share occurs once, and a
/// vertex on another polygon's edge splits that edge, so that a mesh of the graph conforms.
struct Outline {
  std::vector<std::array<double, 2>> points;  ///< [m]
  std::vector<std::array<int, 2>> lines;      ///< point numbers
  std::vector<std::vector<int>> loops;        ///< per polygon, anticlockwise: l + 1 along line l, -(l + 1) against it
  std::map<std::string, std::vector<int>> tags;  ///< line numbers of each tag name
  std::array<double, 2> lower;                   ///< of the bounding box [m]
  double diagonal;                               ///< of the bounding box [m]
  double area;                                   ///< of all polygons [m^2]
};

/// Joins points closer than 1e-9 of the bounding box. Throws InputError naming polygon, region and vertices for
/// polygons that are degenerate, cross or touch themselves, or overlap each other.
Outline outline_of(const std::vector<PolygonRegion>& polygons);

}  // namespace taut

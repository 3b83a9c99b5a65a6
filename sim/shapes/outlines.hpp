#pragma once
#include "sim/shapes/shape.hpp"

namespace taut {

/// Bodies whose outlines are given, meshed by Gmsh with elements of about a size.

/// Axis-aligned boxes, bonded where they touch. Tags xmin ... zmax of the whole.
struct Boxes final : ShapeOf<Boxes, 3> {
  static constexpr auto kind_name = "boxes";
  std::vector<BoxRegion> boxes;

  std::vector<ShapeKey> keys() override;
  std::vector<MeshKey> mesh_keys() const override { return {size_of_elements}; }
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
};

/// Polygons, bonded along the edges that they share. Tags as their edges say.
struct Polygons final : ShapeOf<Polygons, 2> {
  static constexpr auto kind_name = "polygons";
  std::vector<PolygonRegion> polygons;

  std::vector<ShapeKey> keys() override;
  std::vector<MeshKey> mesh_keys() const override { return {size_of_elements}; }
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
};

/// A disc around the origin, of at least twelve corners.
struct Disc final : ShapeOf<Disc, 2> {
  static constexpr auto kind_name = "disc";
  double radius = 0;  ///< [m]
  std::string region;

  std::vector<ShapeKey> keys() override;
  std::vector<MeshKey> mesh_keys() const override { return {size_of_elements}; }
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
};

}  // namespace taut

#pragma once
#include "sim/shapes/shape.hpp"

namespace taut {

/// Bodies whose outlines are given, meshed by Gmsh with elements of about a size.

/// Axis-aligned boxes, bonded where they touch. Tags xmin ... zmax of the whole.
struct Boxes final : Shape {
  std::vector<BoxRegion> boxes;

  std::unique_ptr<Shape> clone() const override { return std::make_unique<Boxes>(*this); }
  std::string kind() const override { return "boxes"; }
  int dimension() const override { return 3; }
  std::vector<ShapeKey> keys() override;
  std::vector<MeshKey> mesh_keys() const override;
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
};

/// Polygons, bonded along the edges that they share. Tags as their edges say.
struct Polygons final : Shape {
  std::vector<PolygonRegion> polygons;

  std::unique_ptr<Shape> clone() const override { return std::make_unique<Polygons>(*this); }
  std::string kind() const override { return "polygons"; }
  int dimension() const override { return 2; }
  std::vector<ShapeKey> keys() override;
  std::vector<MeshKey> mesh_keys() const override;
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
};

/// A disc around the origin, of at least twelve corners.
struct Disc final : Shape {
  double radius = 0;  ///< [m]
  std::string region;

  std::unique_ptr<Shape> clone() const override { return std::make_unique<Disc>(*this); }
  std::string kind() const override { return "disc"; }
  int dimension() const override { return 2; }
  std::vector<ShapeKey> keys() override;
  std::vector<MeshKey> mesh_keys() const override;
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
};

}  // namespace taut

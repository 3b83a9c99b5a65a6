#pragma once
#include "sim/shapes/shape.hpp"

namespace taut {

/// A block on a grid of cells. Tags xmin ... zmax.
struct Box final : Shape {
  std::vector<double> size;                ///< [m]
  std::vector<double> origin = {0, 0, 0};  ///< its lower corner [m]
  std::string region;

  std::unique_ptr<Shape> clone() const override { return std::make_unique<Box>(*this); }
  std::string kind() const override { return "box"; }
  int dimension() const override { return 3; }
  std::vector<ShapeKey> keys() override;
  std::vector<MeshKey> mesh_keys() const override;
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
  std::vector<double> extent() const override { return size; }
};

/// The same in the plane. Tags xmin ... ymax; any of them may be the clamped end of a beam.
struct Rectangle final : Shape {
  std::vector<double> size;             ///< [m]
  std::vector<double> origin = {0, 0};  ///< its lower left corner [m]
  std::string region;

  std::unique_ptr<Shape> clone() const override { return std::make_unique<Rectangle>(*this); }
  std::string kind() const override { return "rectangle"; }
  int dimension() const override { return 2; }
  std::vector<ShapeKey> keys() override;
  std::vector<MeshKey> mesh_keys() const override;
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
  std::vector<double> extent() const override { return size; }
  std::vector<Spine> spines() const override;
};

}  // namespace taut

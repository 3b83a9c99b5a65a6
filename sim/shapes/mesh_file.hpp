#pragma once
#include "sim/shapes/shape.hpp"

namespace taut {

/// A mesh from a file in Gmsh's format: its physical groups are regions and tags. Linear elements become quadratic
/// where the settings say so, not the other way round.
struct MeshFile final : Shape {
  InputFile file;
  LengthUnit unit;                ///< of its coordinates
  int axes = 3;                   ///< that its nodes have
  std::string bodies = "joined";  ///< or "separate": parts that share no node are meant

  std::unique_ptr<Shape> clone() const override { return std::make_unique<MeshFile>(*this); }
  std::string kind() const override { return "msh"; }
  int dimension() const override { return axes; }
  std::vector<ShapeKey> keys() override;
  void check() const override;
  std::vector<MeshKey> mesh_keys() const override { return {}; }
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
};

}  // namespace taut

#pragma once
#include "sim/shapes/shape.hpp"

namespace taut {

/// A block on a grid of cells.
template <class Own, int D>
struct Block : ShapeOf<Own, D> {
  std::vector<double> size;                          ///< [m]
  std::vector<double> origin = std::vector(D, 0.0);  ///< its lower corner [m]
  std::string region;

  /// See Shape::keys().
  std::vector<ShapeKey> keys() override {
    return {{"size", &size, Allowed::positive(), "lengths along the axes", Quantity::length, true},
            {"origin", &origin, Allowed::any(), "corner with the lowest coordinates"},
            {"region", &region, Allowed::any(), "name of its material", Quantity::pure, true}};
  }
  /// See Shape::mesh_keys().
  std::vector<MeshKey> mesh_keys() const override { return {{MeshKey::cells, "cells", "cells along each axis"}}; }
  std::vector<double> extent() const override { return size; }  ///< see Shape::extent()
};

/// In space. Tags xmin ... zmax. Its axis runs along x.
struct Box final : Block<Box, 3> {
  static constexpr auto kind_name = "box";
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
  std::optional<BodyAxis> axis() const override;
};

/// In the plane. Tags xmin ... ymax; any of them may be the clamped end of a beam. Its axis runs along x.
struct Rectangle final : Block<Rectangle, 2> {
  static constexpr auto kind_name = "rectangle";
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
  std::vector<Spine> spines() const override;
  std::optional<BodyAxis> axis() const override;
};

/// J [m4] of a rectangular section by Saint-Venant's series (Timoshenko and Goodier, Theory of Elasticity, art. 109),
/// to rounding.
double torsion_of_rectangle(double width, double height);

}  // namespace taut

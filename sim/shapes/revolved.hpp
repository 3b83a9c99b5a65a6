#pragma once
#include "sim/shapes/shape.hpp"

namespace taut {

/// A round body around a straight axis, solid or with a bore; its outline is straight between given points. It begins
/// at the origin and runs along a coordinate axis, forwards or backwards. Tags "base" (s = 0), "tip" (the other end),
/// "side", and "bore" of a hollow one.
///
/// Tetrahedra on rings around the axis. Boundaries between layers of elements fall on the outline's points. Quadratic
/// elements have the mid-nodes of their round edges on the circle; linear ones are on polygons of the circles' area,
/// whose corners stand a little off the circle.
struct Revolved final : ShapeOf<Revolved, 3> {
  static constexpr auto kind_name = "revolved";
  LengthList s{{0, 0.1}};           ///< along the axis, from 0 on
  LengthList radius{{0.01, 0.01}};  ///< there
  LengthList bore;                  ///< inner radius there, or one of all; none: the body is solid
  std::string along = "x";          ///< "-x": towards smaller x
  std::string region;

  double length() const { return s.values.back(); }     ///< [m]
  bool hollow() const { return !bore.values.empty(); }  ///< has a bore
  double radius_at(double at) const;                    ///< at arc length `at` [m]
  double bore_at(double at) const;                      ///< 0: the body is solid

  std::vector<ShapeKey> keys() override;
  void check() const override;
  std::vector<MeshKey> mesh_keys() const override;
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
  std::vector<double> extent() const override;
  std::optional<BodyAxis> axis() const override;
};

}  // namespace taut

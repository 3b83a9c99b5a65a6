#pragma once
#include <Eigen/Core>
#include <vector>

#include "sim/shapes/shape.hpp"

namespace taut {

/// A finger in 2D: plastic segments in a row, between two of them a triangle of foam that opens upwards from a hinge at
/// the lower side, and above the foam plastic lips that meet when a cable through them closes the joint. It turns
/// upwards by `closing` at each joint as it stiffens. With `rest_turn` = 0 it is straight at rest and bends; with
/// `rest_turn` = `closing` it is curled downwards at rest and straightens. Figs. 12 and 13 of the push-puppet paper.
/// Lengths in metres, angles in radians. Meshed by Gmsh; regions "foam" and "plastic", tags "base" (left face of the
/// first segment) and "tip" (right face of the last one). The first segment's lower left corner is the origin.
struct Finger final : ShapeOf<Finger, 2> {
  static constexpr auto kind_name = "finger";
  int segments = 6;
  double segment_length = 10e-3;  ///< along the lower side
  double height = 16e-3;
  double hinge = 1e-3;  ///< width of the foam at the lower side
  double foam_height = 11e-3;
  double opening = 0.35;        ///< angle of the foam's triangle
  double closing = 0.2;         ///< angle between two lips; less than the opening
  double lip_height = 12.5e-3;  ///< lips reach from here to the upper side
  double rest_turn = 0;         ///< each segment is turned downwards by this against the one before
  double cable_depth = 1.5e-3;  ///< the cable runs that far below the upper side
  double via_inset = 0.5e-3;    ///< via points lie that far inside every lip's face

  std::vector<ShapeKey> keys() override;
  void check() const override;
  std::vector<MeshKey> mesh_keys() const override { return {size_of_elements}; }
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
  std::vector<std::string> cable_names() const override { return {"cable"}; }
  std::vector<Eigen::VectorXd> cable(size_t index) const override;
};

/// Rest positions [m] of the cable's points in order: base face, the via points, tip face.
std::vector<Eigen::Vector2d> cable_path(const Finger& finger);

}  // namespace taut

#pragma once
#include <Eigen/Core>
#include <vector>

#include "sim/shapes/shape.hpp"

namespace taut {

/// A module that twists (Fig. 14 of the push-puppet paper, which gives no dimensions) as its cables
/// shorten it: a square foam core between wider plastic plates with rims, and cables that pass the plates along a
/// helix. The axis is z, the base plate's lower face at z = 0. Lengths in metres. Tetrahedra on a grid; regions "foam"
/// and "plastic", tags "base" (lower face of the lowest plate) and "tip" (upper face of the highest). Foam is bonded to
/// the plates, and free of the rims.
struct TwistModule final : ShapeOf<TwistModule, 3> {
  static constexpr auto kind_name = "twist";
  int cells = 4;
  double cell_length = 10e-3;  ///< foam between two plates
  double core_width = 30e-3;
  double plate_width = 42e-3;
  double plate_thickness = 3e-3;
  double rim_width = 4e-3;  ///< of the frame along the plates' edges
  double rim_gap = 4e-3;    ///< between the rims of two plates; they reach half of what is left of a cell
  int cables = 4;
  double cable_radius = 19e-3;  ///< distance of the cables from the axis where they pass a plate
  double cable_turn = 0.21;     ///< angle from plate to plate [rad]

  double height() const { return cells * cell_length + (cells + 1) * plate_thickness; }  ///< along z [m]

  std::vector<ShapeKey> keys() override;
  void check() const override;
  std::vector<MeshKey> mesh_keys() const override;
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
  std::vector<std::string> cable_names() const override;
  std::vector<Eigen::VectorXd> cable(size_t index) const override;
};

/// Rest positions [m] of the points of cable `cable` (from 0): where it enters and leaves each plate, parallel to the
/// axis, at angle 2 pi cable / cables + handedness cable_turn (plate - cells / 2) from x. Handedness +1 is a
/// right-handed helix, -1 a left-handed one. Throws InputError for a cable that leaves the plates or cuts through the
/// core.
std::vector<Eigen::Vector3d> cable_path(const TwistModule& module, int cable, int handedness);

}  // namespace taut

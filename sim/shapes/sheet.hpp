#pragma once
#include <Eigen/Core>
#include <vector>

#include "sim/shapes/shape.hpp"

namespace taut {

/// A sheet of square stiff tiles in a foam grid (Fig. 15 of the push-puppet paper, which gives no dimensions), with
/// cables through the rows of tiles off the middle plane, so that their retraction curls it. x along the rows, z across
/// the sheet; middle plane z = 0, first corner at x = y = 0. Tetrahedra on a grid; regions "foam" and "plastic", tags
/// "base" (x = 0), "tip" (x = length), "lower" and "upper" faces.
///
/// With a `lip_gap` the tiles carry lips all around at their upper side, which meet when the sheet has curled so far
/// and make it stiff; the foam then fills the strips from below up to `foam_thickness` only.
struct Sheet final : ShapeOf<Sheet, 3> {
  static constexpr auto kind_name = "sheet";
  int columns = 5, rows = 3;
  double tile = 20e-3;
  double strip = 5e-3;  ///< foam between tiles
  double thickness = 4e-3;
  double cable_height = 0;  ///< of its own cables above the middle plane
  double lip_gap = 0;       ///< between the lips of two tiles; 0: there are none
  double lip_thickness = 1e-3;
  double lip_angle = 0;          ///< between two lips' faces, which meet flat once the joint has turned by it [rad]
  double foam_thickness = 2e-3;  ///< with lips

  double length() const { return columns * tile + (columns - 1) * strip; }  ///< along x [m]
  double lip() const { return lip_gap > 0 ? 0.5 * (strip - lip_gap) : 0; }  ///< how far lips reach over a strip [m]
  double width() const { return rows * tile + (rows - 1) * strip; }         ///< along y [m]

  std::vector<ShapeKey> keys() override;
  void check() const override;
  std::vector<MeshKey> mesh_keys() const override;
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
  std::vector<std::string> cable_names() const override;
  std::vector<Eigen::VectorXd> cable(size_t index) const override;
};

/// Rest positions [m] of the points of the cable through the middle of row `row` (from 0) at height `z`: where it
/// enters and leaves each tile. Throws InputError outside of the sheet.
std::vector<Eigen::Vector3d> cable_path(const Sheet& sheet, int row, double z);

}  // namespace taut

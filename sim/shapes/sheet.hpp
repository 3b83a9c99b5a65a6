#pragma once
#include <Eigen/Core>
#include <vector>

#include "sim/shapes/shape.hpp"

namespace taut {

/// A sheet of square stiff tiles in a foam grid (Fig. 15 of the push-puppet paper, which gives no dimensions), with
/// cables through the rows of tiles off the middle plane, so that their retraction curls it. x along the rows, z across
/// the sheet; middle plane z = 0, first corner at x = y = 0.
struct Sheet final : Shape {
  int columns = 5, rows = 3;
  double tile = 20e-3;
  double strip = 5e-3;  ///< foam between tiles
  double thickness = 4e-3;
  double cable_height = 0;  ///< of its own cables above the middle plane

  double length() const { return columns * tile + (columns - 1) * strip; }
  double width() const { return rows * tile + (rows - 1) * strip; }

  std::unique_ptr<Shape> clone() const override { return std::make_unique<Sheet>(*this); }
  std::string kind() const override { return "sheet"; }
  int dimension() const override { return 3; }
  std::vector<ShapeKey> keys() override;
  void check() const override;
  std::vector<MeshKey> mesh_keys() const override;
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
  std::vector<std::string> cable_names() const override;
  std::vector<Eigen::VectorXd> cable(size_t index) const override;
};

/// Cells of the grid along a tile, across a strip and through the thickness.
struct SheetMesh {
  int tile_cells = 1;
  int strip_cells = 2;
  int layers = 1;
  int order = 2;
};

/// Tetrahedra on a grid. Regions "foam" and "plastic"; tags "base" (x = 0), "tip" (x = length), "lower" and "upper"
/// faces. Throws InputError for lengths and counts that make no sheet.
Mesh mesh_sheet(const Sheet& sheet, const SheetMesh& mesh = {});

/// Rest positions [m] of the points of the cable through the middle of row `row` (from 0) at height `z`: where it
/// enters and leaves each tile. Throws InputError outside of the sheet.
std::vector<Eigen::Vector3d> cable_path(const Sheet& sheet, int row, double z);

}  // namespace taut

#pragma once
#include <Eigen/Core>
#include <vector>

#include "sim/mesh/mesh.hpp"

// Two robots of stiff segments in soft foam that are not plane, after Figs. 14 and 15 of the push-puppet paper, which
// gives no dimensions: these are our own.
namespace taut {

/// A module that twists as its cables shorten it: a square foam core between wider plastic plates with rims, and cables
/// that pass the plates along a helix. The axis is z, the base plate's lower face at z = 0. Lengths in metres.
struct TwistModule {
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

  double height() const { return cells * cell_length + (cells + 1) * plate_thickness; }
};
/// Throws InputError for lengths and counts that make no module.
void check(const TwistModule& module);

/// How finely: cells of the grid across the core and along the foam within a rim, a gap and a rim.
struct TwistModuleMesh {
  int core_cells = 4;
  int layers = 1;
  int order = 1;
};

/// Tetrahedra on a grid. Regions "foam" and "plastic"; tags "base" (lower face of the lowest plate) and "tip" (upper
/// face of the highest). Foam is bonded to the plates, and free of the rims. Throws InputError for lengths and counts
/// that make no module.
Mesh mesh_twist_module(const TwistModule& module, const TwistModuleMesh& mesh = {});

/// Rest positions [m] of the points of cable `cable` (from 0): where it enters and leaves each plate, parallel to the
/// axis, at angle 2 pi cable / cables + handedness cable_turn (plate - cells / 2) from x. Handedness +1 is a
/// right-handed helix, -1 a left-handed one. Throws InputError for a cable that leaves the plates or cuts through the
/// core.
std::vector<Eigen::Vector3d> cable_path(const TwistModule& module, int cable, int handedness);

/// A sheet of square stiff tiles in a foam grid, with cables through the rows of tiles off the middle plane, so that
/// their retraction curls it. x along the rows, z across the sheet; middle plane z = 0, first corner at x = y = 0.
struct Sheet {
  int columns = 5, rows = 3;
  double tile = 20e-3;
  double strip = 5e-3;  ///< foam between tiles
  double thickness = 4e-3;

  double length() const { return columns * tile + (columns - 1) * strip; }
  double width() const { return rows * tile + (rows - 1) * strip; }
};
/// Throws InputError for lengths and counts that make no sheet.
void check(const Sheet& sheet);

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

#pragma once
#include <Eigen/Core>
#include <string>
#include <vector>

#include "sim/mesh/gmsh.hpp"
#include "sim/shapes/finger.hpp"
#include "sim/shapes/push_puppet.hpp"
#include "sim/shapes/segmented_3d.hpp"
#include "sim/terms/solid.hpp"

namespace taut {

/// How finely and with which elements the geometry is resolved; [mesh], and what a [[fit.variant]] changes.
struct MeshSettings {
  std::vector<int> cells;                         ///< structured: cells along x, y(, z)
  double size = 0;                                ///< Gmsh, push_puppet: element size [m]
  int lip_cells = 2;                              ///< push_puppet: elements through a lip
  int core_cells = TwistModuleMesh().core_cells;  ///< twist: across the core
  int tile_cells = SheetMesh().tile_cells;        ///< sheet: along a tile
  int strip_cells = SheetMesh().strip_cells;      ///< sheet: across a strip of foam
  int depth_cells = 0;  ///< a 2D kind as a solid: elements across half of its thickness; 0: it is plane
  int layers = 1;       ///< twist: in each rim and gap; sheet: through the thickness
  int order = 2;
  Formulation formulation = Formulation::standard;
  double contact_gap = 0;        ///< distance at which contact sets in [m]; 0: 2e-5 of the specimen's diagonal
  std::string describe() const;  ///< "quadratic, locking-free, 14 x 5 x 5 cells"
};

struct GeometrySettings {
  std::string kind;                  ///< box, rectangle, boxes, polygons, disc, push_puppet, finger, twist, sheet, msh
  std::vector<double> size, origin;  ///< box and rectangle [m]
  std::string region;
  double radius = 0;  ///< disc [m]
  std::vector<PolygonRegion> polygons;
  std::vector<BoxRegion> boxes;
  PushPuppet puppet;
  Finger finger;
  TwistModule twist;
  Sheet sheet;
  double cable_height = 0;  ///< sheet: of the cables above the middle plane [m]
  std::string file;         ///< msh
  double unit = 1;          ///< msh: metres per unit of the file
  double thickness = 1;     ///< 2D [m]
  Plane plane = Plane::strain;
  int dimension = 3;
};

/// The mesh of a geometry. A push_puppet in `contact` must have room for the contact gap; with `compensate` the
/// distance at which closed lips rest is taken off their faces, so that they close where the specimen's own do. With
/// settings.depth_cells the plane section becomes a solid of half its thickness, with a plane of symmetry at z = 0.
/// Throws InputError.
Mesh make_mesh(const GeometrySettings& geometry, const MeshSettings& settings, bool contact, bool compensate);

/// Distance at which contact sets in [m]: the file's, or 2e-5 of a specimen's diagonal.
double contact_gap(const MeshSettings& settings, double diagonal);

/// The settings of a mesh with elements `factor` times as small: cells per direction, element sizes, elements through
/// lips, cores, strips, layers and depth, rounded and at least one. A mesh that is read from a file stays as it is.
MeshSettings refined(const MeshSettings& settings, const GeometrySettings& geometry, double factor);

/// Rest points [m] of the cable called `name` that a geometry brings along ("upper" and "lower" of a push_puppet), in
/// its own frame. Throws InputError when it has none of that name.
std::vector<Eigen::VectorXd> own_cable(const GeometrySettings& geometry, const std::string& name);

}  // namespace taut

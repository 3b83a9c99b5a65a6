#pragma once
#include <string>
#include <vector>

#include "sim/shapes/push_puppet.hpp"

namespace taut {

/// The push-puppet module as a body in space. Along x it is what its section says: foam cells between webs, lips on
/// either side of a gap in each cell. Across, the foam is core_height (y) by core_depth (z); webs and plates are wider
/// by clearance and lips on all four sides, and lips are frames all around. Four cables run through the frames'
/// corners, cable_offset from the middle along y and as far from the rim along z. With studs there is one at each
/// corner of every left lip, square and of stud_thickness, with a hole in the right lip. Both are hollow for the cable,
/// which is not meshed. Without brackets.
///
/// Regions "foam" and "plastic"; tags "base" and "tip" as in the plane; "upper" and "lower" (y), "front" and "back"
/// (z), the outer sides of webs, plates and right lips, so that "tip & upper" is an edge. Foam is bonded to the webs
/// only.
///
/// Of a "half", z >= 0, and a "quarter", y >= 0 too, the planes of symmetry are the tags "symmetry_z" and "symmetry_y".
struct PushPuppet3d final : ShapeOf<PushPuppet3d, 3> {
  static constexpr auto kind_name = "push_puppet_3d";
  PushPuppet section;          ///< in the plane z = 0
  double core_depth = 30e-3;   ///< of the foam along z
  std::string part = "whole";  ///< "whole", "half" or "quarter"

  std::vector<ShapeKey> keys() override;
  void check() const override;
  std::vector<MeshKey> mesh_keys() const override;
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
  /// Those of the part: "upper_front", "lower_front", "upper_back", "lower_back".
  std::vector<std::string> cable_names() const override;
  std::vector<Eigen::VectorXd> cable(size_t index) const override;
  ShapeDefaults defaults() const override { return section.defaults(); }
  std::vector<SymmetryPlane> symmetry() const override;
};

/// Tetrahedra on a grid, the halves of a quarter's mesh being mirror images to the last digit, and so are y and z where
/// core_height and core_depth are equal. Nodes of faces that meet do not coincide. `inset` [m] as mesh_push_puppet()
/// has it. Throws InputError for dimensions that put two planes of the grid nearer than a 500th of an element.
Mesh mesh_push_puppet_3d(const PushPuppet3d& module, const PushPuppetMesh& mesh, double inset = 0);

}  // namespace taut

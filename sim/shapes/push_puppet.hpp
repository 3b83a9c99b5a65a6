#pragma once
#include <string>
#include <vector>

#include "sim/shapes/shape.hpp"

namespace taut {

/// A push-puppet module in 2D: foam cells between plastic webs, plastic lips that meet when the cables are retracted.
/// Axis x, up y, symmetric about y = 0; the foam starts at x = 0. Lengths in metres. The defaults are the reference
/// module.
struct PushPuppet final : ShapeOf<PushPuppet, 2> {
  static constexpr auto kind_name = "push_puppet";
  int cells = 4;
  double cell_length = 11.5e-3;  ///< foam between two webs
  double core_height = 30e-3;    ///< of the foam
  double web_thickness = 3e-3;
  double plate_thickness = 3e-3;  ///< base and tip plates
  double clearance = 2e-3;        ///< between foam and lips
  double lip_thickness = 4e-3;    ///< the right lip of each gap
  double lip_relief = 0.5e-3;     ///< the left lip of each gap is that much thinner on both of its long sides
  double gap_total = 17.2e-3;     ///< of all gaps of one side
  double cable_offset = 19e-3;    ///< |y| of the cables
  double via_inset = 0.5e-3;      ///< via points lie that far inside every lip's end
  double stud_length = 0;         ///< tongue on the left lip's end; 0: no studs
  double stud_thickness = 1.5e-3;
  double stud_play = 0.2e-3;      ///< between the tongue and each side of its groove
  double base_bracket = 0;        ///< how far a bracket reaches out of the base plate, to hold a joint; 0: none
  double tip_bracket = 0;         ///< the same at the tip plate
  double bracket_height = 10e-3;  ///< of both, across the axis, up to the next line of the mesh

  std::vector<ShapeKey> keys() override;
  /// With studs the play must be positive; a tongue longer than the gap at rest starts inside its groove. Without
  /// relief the faces' corners meet corner on corner: allowed, not advised.
  void check() const override;
  std::vector<MeshKey> mesh_keys() const override;
  Mesh mesh(const MeshSettings& settings, bool contact, bool compensate) const override;
  std::vector<std::string> cable_names() const override { return {"upper", "lower"}; }
  std::vector<Eigen::VectorXd> cable(size_t index) const override;
  ShapeDefaults defaults() const override { return {.cables = true, .contact = true}; }
  std::vector<Spine> spines() const override;
  std::optional<ShapeDrawing> drawing() const override;
};

/// What follows from a module's numbers; heights are those of the upper side. [m]
struct PushPuppetLayout {
  explicit PushPuppetLayout(const PushPuppet& module);  ///< of a module that was checked

  double gap;           ///< between the two lips of a cell at rest
  double lip_length;    ///< from the web to the end face
  double lip_low;       ///< of right lips
  double lip_high;      ///< of right lips, webs and plates
  double thin_low;      ///< of left lips
  double thin_high;     ///< of left lips
  double middle;        ///< of lips, tongues and grooves
  double groove_depth;  ///< 0 without studs
  double pitch;         ///< from one cell to the next
  double tip;           ///< right face of the tip plate
};

/// How finely a module is meshed.
struct PushPuppetMesh {
  double size = 1.3e-3;  ///< elements of about this edge length
  int lip_cells = 2;     ///< elements through a lip's thickness at least
  int order = 2;
};

/// Throws InputError about a mesh that cannot be, and about an `inset` [m] (see mesh_push_puppet()) that takes too much
/// off.
void check_resolution(const PushPuppet& module, const PushPuppetMesh& mesh, double inset);

/// The inset [m] with which closed lips rest where the module's own do, under a contact that sets in at `contact_gap`
/// [m]. Throws InputError for a contact gap of more than half a gap between lips, or than via_inset.
double closing_inset(const PushPuppet& module, double contact_gap);

/// Regions "foam" and "plastic"; tags "base" (left face of the base plate) and "tip" (right face of the tip plate).
/// Symmetric about y = 0 to the last digit; foam is bonded to the webs only; nodes of faces that meet are not aligned.
/// `inset` [m], less than via_inset, is taken off every lip's end face and off the sides of studs and grooves: a
/// contact that holds faces a fraction of its gap apart then closes where the module's own lips do.
Mesh mesh_push_puppet(const PushPuppet& module, const PushPuppetMesh& mesh, double inset = 0);

/// Rest positions [m] of the points of one cable in order, `side` +1 upper, -1 lower: the anchor at the base plate's
/// left face (fixed in space), the via points, the tip plate's right face. In a grooved lip the via point lies behind
/// the groove's bottom, in a lip with a stud behind its end face.
std::vector<Eigen::Vector2d> cable_path(const PushPuppet& module, int side);

/// Throws InputError about a module that cannot be. Every refusal starts with the same words, so that a reader of
/// experiment files can put file and line before them.
[[noreturn]] void refuse_module(const std::string& what);

}  // namespace taut

#pragma once
#include <Eigen/Core>
#include <algorithm>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "sim/contact/contact.hpp"
#include "sim/core/units.hpp"
#include "sim/shapes/geometry.hpp"
#include "sim/terms/inertia.hpp"

namespace taut {

struct ChannelKind;

/// One body: its geometry about its own origin, and where it is put. Its tags are "NAME.TAG", or "TAG" in a setup of
/// one body without a name.
struct BodySettings {
  std::string name;
  GeometrySettings geometry;
  MeshSettings mesh;
  std::vector<double> at;        ///< [m]; empty: where its geometry is
  int mirrored = -1;             ///< the coordinate of its own that changes sign, before all else; -1: none
  double angle = 0;              ///< about z, counter-clockwise, before it is put there [rad]
  std::vector<double> turn;      ///< in 3D, after that: about x, then y, then z, all fixed in space [rad]; empty: none
  std::vector<double> velocity;  ///< at the start [m/s]; empty: none
  std::vector<std::pair<std::string, std::vector<int>>> fixed;  ///< tags of the body and their clamped components
};

/// [materials.REGION].
struct MaterialSettings {
  std::string region, law;
  std::map<std::string, double> constants;            ///< SI
  std::optional<double> density;                      ///< [kg/m3]
  std::vector<std::pair<double, double>> prony = {};  ///< pairs of g [1] and tau [s]
};

/// What is set from outside: a load, a retraction, a prescribed displacement, the angle of a motor. It becomes a
/// parameter with this id.
struct ControlSettings {
  std::string id;
  Quantity quantity = Quantity::length;
};

/// [[support]]: a clamp, a prescribed displacement or a clamp that gives way.
struct SupportSettings {
  std::string on;
  std::vector<int> fix;                      ///< components
  std::string control;                       ///< a prescribed displacement: id of the control
  int component = 0;                         ///< of the prescribed displacement
  std::string column;                        ///< bench column of the control
  std::optional<double> rotation_stiffness;  ///< an elastic clamp instead [N m/rad]
};

/// What a cable resists with.
struct CableLaw {
  std::optional<double> k, EA;         ///< [N/m] of the whole cable, or [N]
  double slack = 0, smoothing = 2e-6;  ///< [m]
};

/// A straight row of eyelets beside the axis of a body that has one (Shape::axis()).
struct EyeletLine {
  double start = 0, end = 0;          ///< arc lengths of its ends [m]
  double offset = 0, end_offset = 0;  ///< distances of its ends from the axis [m]
  double angle = 0;                   ///< about the axis, from the section's first direction to the second [rad]
  int pieces = 20;                    ///< straight pieces of cable between the ends
};

/// A cable: its points, ends and law.
struct CableSettings {
  std::string id, body;                        ///< the body whose material it passes, "" in a setup of one
  std::string path;                            ///< one of those that the body's geometry brings along, or
  std::vector<std::vector<double>> points;     ///< rest positions along it, in the body's own frame [m], or
  std::optional<EyeletLine> line;              ///< a row of eyelets; its ends are in the material
  std::vector<std::string> own_line = {};      ///< keys of the line that are its own, not shared by all
  bool start_fixed = true, end_fixed = false;  ///< ends that are fixed in space, not in the material
  std::string control;                         ///< id of the control that retracts or pulls it; "": none
  std::optional<CableLaw> own;                 ///< with parameters "k_<id>" and "slack_<id>"; none: the shared law
  bool held = false;                           ///< its tension is held, whatever its length: it has no law
  double tension = 0;                          ///< held, without a control: "tension_<id>" [N]
  double spool = 0;                            ///< radius by which a control that is a torque pulls [m]
};

/// All cables, and the law of those that have none of their own: its parameters are "k_cable" and "slack". The
/// tensions of all that are held are those that were set times "tension_scale". Friction is "cable_friction" and
/// "cable_misalignment": of held ones in a rod, of elastic ones where they rub.
struct CablesSettings : CableLaw {
  double friction = 0;      ///< coefficient at the eyelets
  double misalignment = 0;  ///< angle by which each eyelet turns a cable besides [rad]
  bool rub = false;         ///< elastic ones have friction at their eyelets, were it 0 to begin with
  std::vector<CableSettings> cables;
  std::map<std::string, std::string> columns;          ///< control id to bench column of the retractions
  std::map<std::string, std::string> tension_columns;  ///< and of the tensions
  std::optional<EyeletLine> line;                      ///< where cables begin that have a line of their own
};

/// A stud and its hole, between which there is play along one direction.
struct StudSettings {
  std::string id;
  std::string on;                  ///< tag that the stud is on, or
  std::vector<double> point;       ///< its rest position [m]
  std::string hole_on;             ///< tag that the hole is in, or
  std::vector<double> hole_point;  ///< its rest position [m]; without both it is fixed in space
  std::vector<double> direction;
  std::optional<double> clearance, stiffness;  ///< of its own, as "clearance_<id>" [m] and "k_<id>" [N/m]
};

/// All studs, and the "clearance" and "k_stud" of those that have none of their own.
struct StudsSettings {
  std::optional<double> clearance, stiffness;  ///< [m], [N/m]
  double smoothing = 2e-6;                     ///< [m]
  std::vector<StudSettings> studs;
};

/// A revolute joint between two bodies. Points are in the rest configuration [m] and on both bodies.
struct JointSettings {
  std::string id;            ///< of the angle and, as "k_<id>", of the stiffness in the parameter table
  std::string part_a;        ///< body; "world": fixed in space
  std::string part_b;        ///< body; "" in a mesh that is one piece
  Eigen::VectorXd pivot;     ///< [m]
  Eigen::VectorXd axis_end;  ///< 3D: a second point of the axis [m]
  Eigen::VectorXd motor;     ///< a point that turns with the motor [m]; empty: a free pin
  double radius = 0;         ///< of the patches by which the bodies are held [m], see make_attachment()
  double stiffness = 0;      ///< of each spring [N/m]; 0: from the bodies
  std::string control;       ///< id of the control that is the angle; "": none
};

/// [[load]]: a dead force, a mass, a traction or a line load.
struct LoadSettings {
  std::string id;
  std::string on;             ///< tag, or
  std::vector<double> point;  ///< rest position [m]
  std::vector<double> direction;
  Quantity quantity = Quantity::force;  ///< force, mass (weight, and inertia over time), pressure (traction), line_load
  std::string control;                  ///< id of the control that is its value, or
  double value = 0;                     ///< a constant one, SI
  std::string column;                   ///< bench column of the control
};

/// [[contact.ground]]: a rigid surface without a mesh, see Ground.
struct GroundSettings {
  Eigen::VectorXd point;   ///< [m]
  Eigen::VectorXd normal;  ///< unit length; of a cylinder its axis, of a sphere nothing
  GroundKind kind = GroundKind::plane;
  double radius = 0;          ///< of what is round [m]
  std::string name = {};      ///< for channels; "": none
  std::string control = {};   ///< id of the control that moves it; "": it stays
  Eigen::VectorXd move = {};  ///< its displacement per unit of that control
};

/// [contact]: on for push_puppet, elsewhere when the table is there.
struct SurfaceSettings {
  bool on = false;
  bool idle = false;               ///< nothing touches: the mesh is made for contact, but none is looked for
  bool bracketed = false;          ///< a fit says what friction, of which there is none, could change at most
  std::optional<double> friction;  ///< coefficient mu, over time and in simulations; none: nothing rubs
  bool sticks = false;             ///< a bench's points that touch cannot slide when more load is hung, see Grip
  ContactForm form = ContactForm::length_weighted;
  double gap = 0;                          ///< distance at which it sets in [m]; 0: that of the mesh's settings
  std::map<std::string, double> pressure;  ///< region to barrier stiffness [Pa]; missing: from materials and loads
  std::optional<double> stiffness;         ///< pair sums only [N/m]
  bool compensate = true;  ///< take the distance at which closed lips rest off their faces (push_puppet)
  std::vector<std::vector<Eigen::Vector2d>> obstacles;  ///< points of each line [m]
  std::vector<std::string> obstacle_names;              ///< of each, for channels; "": none
  std::vector<GroundSettings> grounds;
};

/// What is measured at a bench, or recorded at every step of a simulation.
struct ChannelSettings {
  std::string id;
  const ChannelKind* kind = nullptr;  ///< a row of channel_kinds()
  std::string on;                     ///< tag, body, cable or joint, or
  std::vector<double> point;          ///< a material point [m]
  std::vector<double> standoff;       ///< marker off the surface [m], empty: none
  std::string turns_with;             ///< tag that the stand-off turns with
  std::vector<double> direction;
  std::optional<double> foot = {};  ///< arc length of a marker's foot on the axis [m]; it turns with the section there
  std::string marker = {};          ///< the marker whose coordinate it is
  std::string by = {};              ///< of a contact force: what exerts it, a body, an obstacle or a ground
};

/// Everything physical that a file describes, as plain data in SI units: what build_scene() makes a model of.
struct Setup {
  std::string path;                           ///< of the file, for messages
  std::optional<std::string> text;            ///< what was read, where that is no file
  std::string encoding;                       ///< a remark on bytes that are not UTF-8; "": there are none
  std::map<std::string, std::string> titles;  ///< bench columns with their units, where only the bench file has those
  int dimension = 2;
  double thickness = 1;  ///< 2D [m]
  Plane plane = Plane::strain;
  std::vector<BodySettings> bodies;
  std::vector<MaterialSettings> materials;
  MassForm mass = MassForm::consistent;                           ///< over time
  std::map<std::string, double> mass_damping, stiffness_damping;  ///< region to alpha [1/s], beta [s]; over time
  double gravity = 9.81;                                          ///< [m/s2]
  std::vector<double> gravity_direction;                          ///< empty: no self-weight
  std::vector<ControlSettings> controls;
  std::vector<SupportSettings> supports;
  std::vector<LoadSettings> loads;
  CablesSettings cables;
  std::vector<JointSettings> joints;
  StudsSettings studs;
  SurfaceSettings contact;
  std::vector<ChannelSettings> channels;

  /// Whether states depend on those before them.
  bool remembers() const {
    return contact.friction || std::any_of(materials.begin(), materials.end(),
                                           [](const MaterialSettings& material) { return !material.prony.empty(); });
  }

  /// Of the whole body in the model: every plane of symmetry halves it.
  double share() const;
};

/// The planes of symmetry of what a body's mesh is: a part of a shape, or one half of a solid (mesh.depth_cells).
std::vector<SymmetryPlane> symmetry_of(const BodySettings& body);

/// How a body is mirrored and turned before it is shifted, an orthogonal matrix.
Eigen::MatrixXd rotation_of(const BodySettings& body, int dimension);
/// A point of a body's own frame in the world at rest [m].
Eigen::VectorXd placed(const BodySettings& body, const Eigen::VectorXd& point);
/// The axis of a body in the world at rest. Throws InputError when its geometry has none.
BodyAxis axis_of(const BodySettings& body);

/// As Eigen has it.
inline Eigen::VectorXd vector_of(const std::vector<double>& values) {
  return Eigen::Map<const Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
}

}  // namespace taut

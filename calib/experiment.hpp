#pragma once
#include <array>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "calib/fit.hpp"
#include "calib/trials.hpp"
#include "sim/mesh/finger.hpp"
#include "sim/mesh/gmsh.hpp"
#include "sim/mesh/push_puppet.hpp"
#include "sim/mesh/segmented_3d.hpp"
#include "sim/solve/time_stepper.hpp"
#include "sim/terms/contact.hpp"
#include "sim/terms/inertia.hpp"
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

struct MaterialSettings {
  std::string region, law;
  std::map<std::string, double> constants;  ///< SI
  std::optional<double> density;
};

struct SupportSettings {
  std::string on;
  std::vector<int> fix;                      ///< components
  std::string control;                       ///< a prescribed displacement: id of the control
  int component = 0;                         ///< of the prescribed displacement
  std::string column;                        ///< bench column of the control
  std::optional<double> rotation_stiffness;  ///< an elastic clamp instead [N m/rad]
};

/// One cable of [cables].
struct CableSettings {
  std::string id;
  std::vector<std::vector<double>> points;     ///< rest positions along it [m]
  bool start_fixed = true, end_fixed = false;  ///< ends that are fixed in space, not in the material
  std::string control;                         ///< id of the control that retracts it; "": none
};

/// What all cables have in common, and each of them.
struct CablesSettings {
  std::optional<double> k, EA;         ///< [N/m] of the whole cable, or [N]
  double slack = 0, smoothing = 2e-6;  ///< [m]
  std::vector<CableSettings> cables;
  std::map<std::string, std::string> columns;  ///< control id to bench column of the retractions
};

/// [contact]: on for push_puppet, elsewhere when the table is there.
struct SurfaceSettings {
  bool on = false;
  bool idle = false;  ///< nothing touches: the mesh is made for contact, but none is looked for
  ContactForm form = ContactForm::length_weighted;
  std::optional<double> stiffness;  ///< pair sums only [N/m]
  bool compensate = true;           ///< take the distance at which closed lips rest off their faces (push_puppet)
  std::vector<std::vector<Eigen::Vector2d>> obstacles;
  std::vector<GroundLine> grounds;
};

struct LoadSettings {
  std::string id;
  std::string on;             ///< tag, or
  std::vector<double> point;  ///< rest position [m]
  std::vector<double> direction;
  std::string column;                   ///< bench column that holds its value, or
  double value = 0;                     ///< a constant one, SI
  Quantity quantity = Quantity::force;  ///< force, mass, pressure (traction) or line_load
};

struct ChannelSettings {
  std::string id;
  std::string on;                ///< mean over a tag, or
  std::vector<double> point;     ///< a material point [m]
  std::vector<double> standoff;  ///< marker off the surface [m], empty: none
  std::string turns_with;        ///< tag that the stand-off turns with
  std::vector<double> direction;
};

/// A value as it stands in the file, and where: its quantity depends on the parameter, which only the model knows.
struct GivenValue {
  std::string text;
  std::string where;
};

struct FreeSettings {
  std::string id;
  std::optional<GivenValue> start, lower, upper;
};

struct VariantSettings {
  std::string name;
  MeshSettings mesh;
};

/// [fit.diagnostic]: the parameter fitted to the readings of each value of a control alone, the others held.
struct DiagnosticSettings {
  std::string parameter, per;
};

struct ReferenceValue {
  std::string parameter;
  GivenValue value;
  std::string source;
};

/// One [[bench.recording]]: a file with a motion, and how that came about.
struct RecordingSettings {
  std::string id;  ///< "load52_a": case and trial
  std::string path, case_id, trial;
  std::map<std::string, double> loads;  ///< load id to its value in this recording, SI
  std::map<std::string, double> held;   ///< loads that act until the release only
  double release = 0;                   ///< [s] on the recording's clock
  double from = -std::numeric_limits<double>::infinity(), until = std::numeric_limits<double>::infinity();  ///< [s]
  int every = 1;
  double sigma = 0;  ///< [m]; 0: the channels' noise
};

/// [bench] with kind = "recordings".
struct RecordingsSettings {
  std::string time_column;
  bool from_mean_before = false;      ///< displacements are measured from the mean before time zero
  std::vector<std::string> per_case;  ///< parameters that each case has for itself
  std::vector<RecordingSettings> recordings;
};

/// [dynamics] and [damping.REGION].
struct DynamicsSettings {
  Integrator integrator = Integrator::bdf2;
  double step = 0;  ///< [s]
  MassForm mass = MassForm::consistent;
  std::map<std::string, double> mass_damping, stiffness_damping;  ///< region to alpha [1/s], beta [s]
};

/// `model`: how much of an experiment is modelled. From cheap to full; see calib/ladder.hpp.
enum class Rung {
  beam,            ///< a chain of Timoshenko beams, in closed form
  rigid_segments,  ///< finite elements, in which stiff regions are rigid
  full,            ///< as the file says
  solid,           ///< a plane section as a solid of its thickness
  automatic        ///< the first of these that is good enough, row by row
};

/// One experiment as its TOML file describes it, checked key by key; SI units inside.
struct Experiment {
  std::string path;  ///< of the TOML file
  std::string title;
  Rung model = Rung::full;
  double tolerance = 0.02;  ///< of model = "auto": the largest relative change by the next rung that is left aside
  bool simulated = false;   ///< data = "simulated": said wherever the data are shown
  GeometrySettings geometry;
  MeshSettings mesh;
  std::vector<MaterialSettings> materials;
  std::vector<SupportSettings> supports;
  std::vector<LoadSettings> loads;
  std::vector<ChannelSettings> channels;
  double gravity = 9.81;
  std::vector<double> gravity_direction;  ///< empty: no self-weight
  CablesSettings cables;
  SurfaceSettings contact;
  BenchFormat bench;
  std::optional<RecordingsSettings> recordings;  ///< instead of a bench file of readings at rest
  DynamicsSettings dynamics;                     ///< of recordings
  std::string zero_offset_per;  ///< control id: the readings at each of its values share a zero error; "": none
  bool from_unloaded = false;
  bool all_profiles = false;  ///< profile likelihood for every free parameter, not only where the parabola fails
  bool mesh_share = true;     ///< a fit says what the mesh and the contact gap add to each parameter; readings at rest
  std::optional<DiagnosticSettings> diagnostic;
  std::vector<FreeSettings> free;
  std::vector<VariantSettings> variants;
  std::vector<ReferenceValue> references;
  EquilibriumOptions equilibrium;
  int threads = 0;
  int trend_degree = 0;  ///< of the polynomials in the figure of the effective stiffness; 0: none
};

/// Reads and checks an experiment file. Paths in it are relative to it. Throws InputError with file, line, what is
/// wrong, what is allowed and the nearest known name.
Experiment read_experiment(const std::string& path);

}  // namespace taut

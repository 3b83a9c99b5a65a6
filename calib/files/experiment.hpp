#pragma once
#include <limits>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "calib/data/trials.hpp"
#include "sim/scene/setup.hpp"
#include "sim/solve/equilibrium.hpp"
#include "sim/solve/time_stepper.hpp"

namespace taut {

struct FreeSettings {
  std::string id;
  std::optional<GivenValue> start, lower, upper;
};

/// A [[fit.variant]]: the same fit with another mesh; of a material point with another law, or with the readings of
/// some modes only.
struct VariantSettings {
  std::string name;
  MeshSettings mesh;
  std::string law;                          ///< of a material point
  std::map<std::string, double> constants;  ///< its constants, SI
  std::vector<std::string> modes;           ///< "tension", "compression", "shear"
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
  double sigma = 0;  ///< SI unit of the channels; 0: their noise
};

/// [bench] with kind = "recordings".
struct RecordingsSettings {
  std::string time_column;
  bool from_mean_before = false;      ///< displacements are measured from the mean before time zero
  std::vector<std::string> per_case;  ///< parameters that each case has for itself
  std::vector<RecordingSettings> recordings;
};

/// [dynamics]: how recordings are replayed.
struct DynamicsSettings {
  Integrator integrator = Integrator::bdf2;
  double step = 0;  ///< [s]
};

/// `model`: how much of an experiment is modelled. From cheap to full; see calib/ladder.hpp.
enum class Rung {
  beam,            ///< a chain of Timoshenko beams, in closed form
  rigid_segments,  ///< finite elements, in which stiff regions are rigid
  full,            ///< as the file says
  solid,           ///< a plane section as a solid of its thickness
  automatic        ///< the first of these that is good enough, row by row
};

/// "beam", "rigid_segments", "full", "solid", "auto": as experiment files spell them.
std::string_view name_of(Rung rung);

/// One experiment as its TOML file describes it, checked key by key; SI units inside. Its body and its controls become
/// part of the setup when a model is made: with which mesh, and what the bench file's columns hold, is known only then
/// (setup_of() in calib/benches/model.hpp).
struct Experiment : Setup {
  std::string title;
  Rung model = Rung::full;
  double tolerance = 0.02;      ///< of model = "auto": the largest relative change by the next rung that is left aside
  bool simulated = false;       ///< data = "simulated": said wherever the data are shown
  bool material_point = false;  ///< geometry kind "uniaxial": homogeneous tests, without a mesh
  GeometrySettings geometry;
  MeshSettings mesh;
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

/// A file that an experiment is read from, and the name of its copy in a run folder.
struct RunInput {
  std::string path, copy;
};
/// The experiment's own file first, then readings and mesh.
std::vector<RunInput> inputs_of(const Experiment& experiment);
/// The experiment with its inputs taken from the copies in `folder`.
Experiment read_copies(const std::string& folder);

}  // namespace taut

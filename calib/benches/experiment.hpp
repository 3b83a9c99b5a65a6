#pragma once
#include <any>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "calib/benches/section_law.hpp"
#include "calib/data/trials.hpp"
#include "sim/files/toml_reader.hpp"
#include "sim/scene/setup.hpp"
#include "sim/solve/equilibrium.hpp"

namespace taut {

class Bench;
struct Experiment;

/// [fit.free.ID]: start and bounds as the file has them; what is left out comes from the model.
struct FreeSettings {
  std::string id;
  std::optional<GivenValue> start, lower, upper;
  bool per_specimen = false;  ///< each specimen has its own
};

/// A [[specimen]] of several in one bench: what is unlike in it.
struct SpecimenSettings {
  std::string id;
  std::map<std::string, double> set;  ///< dimension, or thickness, to its value [m], [rad]
};

/// A [[fit.variant]]: the same fit with another mesh or with further free parameters; of a material point with another
/// law, or with the readings of some modes only.
struct VariantSettings {
  std::string name;
  MeshSettings mesh;
  std::string law;                          ///< of a material point; of a rod's sections, as experiment files spell it
  std::map<std::string, double> constants;  ///< its constants, SI
  std::vector<std::string> modes;           ///< "tension", "compression", "shear"
  std::vector<FreeSettings> free = {};      ///< free besides those of [fit.free]
};

/// [fit.diagnostic]: the parameter fitted to the readings of each value of a control alone, the others held.
struct DiagnosticSettings {
  std::string parameter, per;
};

/// A [[fit.reference]]: a published value.
struct ReferenceValue {
  std::string parameter;
  GivenValue value;
  std::string source;
};

/// `model`: how much of an experiment is modelled. From cheap to full; see calib/models/ladder.hpp.
enum class Rung {
  beam,            ///< a chain of Timoshenko beams, in closed form
  rod,             ///< a long body in space as a Cosserat rod; never chosen by itself
  rigid_segments,  ///< finite elements, in which stiff regions are rigid
  full,            ///< as the file says
  solid,           ///< a plane section as a solid of its thickness
  automatic        ///< the first of these that is good enough, row by row
};

/// Both laws of a rod's sections with their names in files; the first is that of files that name none.
const std::vector<std::pair<std::string, SectionLaw>>& section_laws();

/// All with their names as experiment files spell them; the first is that of files that name none.
const std::vector<std::pair<std::string, Rung>>& rungs();
std::string_view name_of(Rung rung);  ///< as experiment files spell it

/// A kind of bench. A new one is a file pair with what its files say, its Bench and its row, and the row's name in
/// calib/files/bench_kinds.hpp: files, commands and messages follow.
struct BenchKind {
  std::string_view name;   ///< in files: the kind in [bench]; in [geometry] where there is no specimen
  std::string_view about;  ///< in sentences: "a material point"
  bool specimen = true;    ///< whether there is a body with a mesh, supports, loads and channels, which all kinds share
  bool at_rest = false;    ///< whether its readings are those of a specimen's equilibria
  /// Reads [bench] and tables that no other kind has, after the specimen. Throws InputError with file and line.
  void (*read)(TableReader& root, Experiment& experiment) = nullptr;
  /// Reads the keys of a [[fit.variant]] but its name; null: those of its mesh.
  void (*read_variant)(TableReader& table, const Experiment& experiment, VariantSettings& variant) = nullptr;
  /// Its files of readings, the paths to be changed in place; null: experiment.bench.path.
  std::vector<std::pair<std::string*, std::string>> (*readings)(Experiment& experiment) = nullptr;
  /// Reads them and makes the model. Throws InputError.
  std::unique_ptr<Bench> (*open)(Experiment experiment) = nullptr;
};

/// The id of the control that says which way a row was reached: 1 loading, 2 unloading.
inline constexpr std::string_view direction_control = "direction";

/// One experiment as its TOML file describes it, checked key by key; SI units inside. Its body and its controls become
/// part of the setup when a model is made: with which mesh, and what the bench file's columns hold, is known only then
/// (setup_of() in calib/benches/model.hpp).
struct Experiment : Setup {
  const BenchKind* kind = nullptr;
  std::any own;  ///< settings that only its kind of bench has
  std::string title;
  Rung model = Rung::full;
  double tolerance = 0.02;  ///< of model = "auto": the largest relative change by the next rung that is left aside
  SectionLaw rod_section = SectionLaw::neo_hookean;  ///< of model = "rod"
  bool simulated = false;                            ///< data = "simulated": said wherever the data are shown
  GeometrySettings geometry;
  std::vector<double> base_at, base_turn;  ///< BodySettings::at and turn of the body; empty: as its geometry has it
  MeshSettings mesh;
  BenchFormat bench;
  std::string zero_offset_per;  ///< control id: the readings at each of its values share a zero error; "": none
  std::map<std::string, std::string> set_by;  ///< control id to the dimension that it sets, row by row
  std::string specimen_control;               ///< control id whose values are numbers of `specimens` from 1; "": none
  std::vector<SpecimenSettings> specimens;
  /// Whether columns of the readings say what the specimen is.
  bool has_specimens() const { return !specimen_control.empty() || !set_by.empty(); }
  bool from_unloaded = false;
  bool all_profiles = false;  ///< profile likelihood for every free parameter, not only where the parabola fails
  bool robust = false;        ///< a robust fit beside the least squares
  bool mesh_share = true;  ///< a fit says what each assumption adds to each parameter, mesh included; readings at rest
  Tolerances tolerances;   ///< of dimensions and constants that are not fitted, by their places in the file
  std::map<std::string, GivenValue>
      control_tolerances;  ///< by the control's id: "0.5 %" of it, or an error of its zero
  std::optional<DiagnosticSettings> diagnostic;
  std::vector<FreeSettings> free;
  std::vector<VariantSettings> variants;
  std::vector<ReferenceValue> references;
  EquilibriumOptions equilibrium;
  int threads = 0;
  int trend_degree = 0;  ///< of the polynomials in the figure of the effective stiffness; 0: none
};

/// Ids of dimensions (or the thickness) that columns of the readings set.
std::vector<std::string> ids_set_by_columns(const Experiment& experiment);

/// The table noise (or `key`) of readings of this quantity; without it there is none. Throws InputError with file and
/// line.
InstrumentNoise read_noise(TableReader& table, Quantity quantity, std::string_view key = "noise");

}  // namespace taut

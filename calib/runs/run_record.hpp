#pragma once
#include <array>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "calib/benches/bench.hpp"
#include "calib/fit/explanations.hpp"
#include "calib/fit/fit.hpp"
#include "calib/fit/held_out.hpp"
#include "calib/runs/equilibria.hpp"
#include "calib/runs/shapes.hpp"
#include "calib/studies/assumption_shares.hpp"
#include "calib/studies/ensemble.hpp"
#include "calib/studies/lip_friction.hpp"

namespace taut {

/// A file that a run was made from.
struct InputRecord {
  std::string path;                      ///< as given
  std::string copy;                      ///< its name in the run folder
  std::string sha256;                    ///< of both
  std::optional<std::string> text = {};  ///< what it holds, where it is no file; not written to fit.json
};

/// Where a result comes from, so that it can be made again.
struct Provenance {
  std::string version, commit;                                 ///< of taut
  std::vector<std::pair<std::string, std::string>> libraries;  ///< name, version
  std::string command_line;
  std::vector<InputRecord> inputs;
  std::string started;  ///< UTC, ISO 8601
  std::string machine;  ///< processor, cores, system
  unsigned seed = 0;    ///< nothing in a fit is random; 0 says so
  double wall_seconds = 0;
};

/// One measured number beside what the fitted model says.
struct ReadingRecord {
  int line = 0;
  std::string trial, channel;
  std::vector<double> controls;                                      ///< SI
  double measured = 0, sigma = 0, predicted = 0, prediction_se = 0;  ///< SI
  bool excluded = false;                                             ///< not fitted; predicted where repeats of it are
  std::string equilibria = {};  ///< mark_of() its EquilibriaRecord; "": one equilibrium, and no jump near it
};

/// A parameter of a refit that the main fit holds.
struct FurtherRecord {
  std::string id, unit;
  double value = 0, standard_error = 0;  ///< SI
  std::string verdict;                   ///< name_of() its
};

/// How far predictions are from a marker's measured places: root of the mean squared distance [m].
struct MarkerMisfit {
  std::string marker;
  double rms = 0;
};

/// A refit with another element or mesh, or with further free parameters.
struct VariantRecord {
  std::string name, mesh;  ///< its name, "quadratic, locking-free, 14 x 5 x 5 cells"; of a material point its law
  int unknowns = 0;        ///< of a material point: readings
  std::string status;      ///< of its fit
  std::vector<double> values, standard_errors;  ///< per free parameter, SI
  double chi_squared = 0, seconds = 0;
  std::vector<FurtherRecord> further = {};
  std::string law = {};                    ///< of a rod's sections, where that is what was changed
  std::vector<MarkerMisfit> markers = {};  ///< of benches with markers; the last one, "all", of all together

  /// Whether it is another model of the same mesh: what it buys is compared, not what a mesh does.
  bool other_model() const { return !further.empty() || !law.empty(); }
  /// Akaike's criterion up to a constant, for known sigmas: chi squared + 2 (free parameters).
  double aic() const { return chi_squared + 2 * static_cast<double>(values.size() + further.size()); }
};

/// One parameter fitted to a part of the readings alone, everything else held.
struct DiagnosticRecord {
  std::string parameter;
  std::string part;                      ///< "retraction = 5.89 mm"
  double value = 0, standard_error = 0;  ///< SI; NaN where that fit failed
  double chi_squared = 0;
  int readings = 0;
};

/// A reading that a robust fit gives next to no weight.
struct OutlierRecord {
  int line = 0;
  std::string channel;
  double measured = 0, expected = 0;  ///< SI; what the robust fit says
  double off = 0;                     ///< measured - expected, over sigma
};

/// The robust fit beside the main one.
struct RobustRecord {
  std::string method;                           ///< "" when it was not asked for
  std::vector<double> values, standard_errors;  ///< per free parameter, SI
  std::vector<OutlierRecord> outliers;
};

/// A published value beside the fitted one.
struct ReferenceRecord {
  std::string parameter;
  double value = 0;  ///< SI
  std::string source;
};

/// Everything that a run found, as plain data: written to fit.json (reports/run_record.hpp), read back by `taut report`
/// and `taut predict`. Figures and report.html are functions of this record alone.
struct RunRecord {
  std::string title;
  bool simulated = false;                  ///< the readings were simulated, not measured
  bool interrupted = false;                ///< parts of the run are missing
  std::vector<std::string> failed_stages;  ///< those of the remarks that say which stage failed, and why
  std::vector<std::pair<std::string, std::string>> setup;  ///< "mesh", "quadratic ..." lines for the report
  std::vector<AxisRecord> controls;                        ///< in the order of ReadingRecord::controls
  std::vector<AxisRecord> channels;                        ///< all that readings and curves name
  /// Columns of the bench's own file, with their units: "mass_g". One per control and channel, "" where there is none;
  /// or none at all.
  std::vector<std::string> control_columns, channel_columns;
  std::string load_label;                  ///< "load", for axes
  int load_control = -1;                   ///< index among the controls of the load that the figures are drawn over
  bool by_tension = false;                 ///< that is a cable's tension, which is no load on what is measured
  std::vector<double> load_newtons;        ///< per reading: the load as a force [N]
  std::vector<std::string> series;         ///< per reading: as CurveRecord::series
  std::vector<std::string> parameter_ids;  ///< of fit.p, in its order
  FitResult fit;  ///< fit.parameters, statistics; fit.predicted etc. are per protocol row and not stored
  std::vector<Explanation> explanations;  ///< of the misfit, best first; most are none (telling())
  std::vector<HeldOut> held_out;          ///< each value of a held control; none where there is no such
  RobustRecord robust;
  std::vector<Share> shares;              ///< of what was assumed in fit.parameters; empty: not asked for
  std::vector<FrictionRow> lip_friction;  ///< rows of closed modules; empty: not asked for, or none closes
  std::vector<ReadingRecord> readings;
  std::vector<CurveRecord> curves;
  std::vector<CurveRecord> start_curves;  ///< with the starts of the parameters, standard errors 0; of benches at rest
  std::vector<ShapeRecord> shapes;
  SurfaceRecord surface;                  ///< of the shapes in 3D
  std::array<std::string, 2> shape_axes;  ///< "x", "z"
  int trend_degree = 0;                   ///< of the polynomial through each series of the effective stiffness; 0: none
  VariantRecord main;                     ///< the fit itself, as a row of the table of variants
  std::vector<VariantRecord> variants;
  std::vector<DiagnosticRecord> diagnostics;
  std::vector<SwingRecord> swings;
  std::vector<ReferenceRecord> references;
  std::vector<EnsembleRecord> ensembles;     ///< of each kind at most one; empty: not asked for
  std::vector<EquilibriaRecord> equilibria;  ///< rows that have two, or are near where one ends
  std::vector<std::string> remarks;          ///< what a reader must know: data recognised, folded elements, failures
  double replay_seconds = 0;                 ///< one cold replay of all rows
  int replay_factorisations = 0;
  Provenance provenance;
};

}  // namespace taut

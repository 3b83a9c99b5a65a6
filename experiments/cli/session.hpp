#pragma once
#include <string>
#include <vector>

#include "calib/benches/static_bench.hpp"
#include "experiments/cli/commands.hpp"
#include "reports/run_record.hpp"

namespace taut {

/// What a command works on: the experiment, its readings, its model.
struct Session {
  Experiment experiment;
  Trials trials;
  StaticBench bench;  ///< of the full model, unless the file asks for rigid segments or a solid
  /// What predicts instead where the file has model = "beam" or "auto"; null elsewhere.
  std::unique_ptr<Protocol> rungs;
  std::string choice;  ///< what model = "auto" chose, one sentence; else ""
  Protocol& model() const { return rungs ? *rungs : *bench.protocol; }
};
Session open_session(const CommandOptions& options);

/// Progress on stderr: one animated line on a terminal, plain lines otherwise, nothing when quiet.
class Progress {
 public:
  explicit Progress(bool quiet);
  ~Progress();
  void say(const std::string& line);   ///< a step that stays
  void show(const std::string& line);  ///< a state that is replaced by the next; skipped when not on a terminal
 private:
  void clear();
  bool quiet_, terminal_, shown_ = false;
};

/// Name of the folder of an experiment.toml, or of another file without its extension.
std::string experiment_name(const std::string& path);
/// runs/<name of the experiment>, or what --out says.
std::string run_folder(const CommandOptions& options);

/// Mesh, unknowns, materials, supports, loads, channels as label and text, for `check` and the report.
std::vector<std::pair<std::string, std::string>> describe_setup(const Session& session);

/// What a reader must know before trusting a prediction: locking elements, failed or folded states.
std::vector<std::string> warnings_before(const Session& session);
std::vector<std::string> warnings_after(const StaticProtocol& protocol);

/// Where another model predicts: replays the bench's own one at `p` too, in which pictures are drawn, and says how far
/// they are apart and what that took, one sentence. "" where there is one model only.
std::string compare_models(const Session& session, const Params& p, const Eigen::VectorXd& values, double seconds);

/// "0.51012 N" or "retraction = 5.89 mm, mass = 50 g".
/// "retraction = 5.89 mm".
std::string describe_control(const Session& session, size_t control, double value);

/// Tension [N] and length [m] of a cable in one solved state.
struct CableState {
  std::string where, cable;
  double tension = 0, length = 0;
};
std::vector<CableState> cable_states(const Session& session);

/// Position among the controls of [fit.diagnostic]'s `per`.
size_t diagnostic_control(const Session& session);

std::string describe_controls(const Session& session, const std::vector<double>& controls);

/// Index of the control over which figures are drawn: the load with most different values; -1 without loads.
int load_control(const Session& session);
/// What is held besides the load, as a label; "" when nothing else varies.
std::string series_of(const Session& session, const std::vector<double>& controls);

/// How a fit is to run: with the experiment's profiles, the command's stop flag, and progress that names `what` is
/// fitted. The references have to outlive the fit.
FitOptions fit_options(const CommandOptions& options, const Experiment& experiment, const ParameterTable& table,
                       const std::vector<FreeParameter>& free, Progress& progress, const std::string& what);

/// A fit as a row of the table of variants.
VariantRecord as_variant(const std::string& name, const MeshSettings& mesh, const Model& model, const FitResult& fit,
                         double seconds);

/// What a fit found, for people, on stdout.
void print_fit(const RunRecord& record);

/// What `taut check` says of an experiment: its setting, the free parameters, problems.
void print_check(const RunRecord& record, const ParameterTable& table, const std::vector<FreeParameter>& free,
                 bool as_json);

/// The parts of a run record that do not come from a fit: title, set-up, readings (predictions NaN), references.
RunRecord start_record(const Session& session, const CommandOptions& options);

/// Curves of all channels and series over the load, from zero to its largest value, with the fit's covariance.
/// `free` and `covariance` may be empty (no band).
std::vector<CurveRecord> make_curves(const Session& session, const Params& p, const std::vector<FreeParameter>& free,
                                     const Eigen::MatrixXd& covariance);

/// Side views of all solved conditions, and writes their states as VTU and PVD into `folder`/states.
std::vector<ShapeRecord> make_shapes(const Session& session, const std::string& folder, std::string axes[2]);

/// Copies experiment file, data (and mesh file) into the run folder, so that a run explains itself.
void copy_inputs(const Session& session, const std::string& folder, RunRecord& record);

/// The experiment of a run folder, reading the copies made by copy_inputs().
Experiment experiment_of_run(const RunRecord& record, const std::string& folder);

}  // namespace taut

#pragma once
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "calib/benches/dimension.hpp"
#include "calib/benches/experiment.hpp"
#include "calib/data/trials.hpp"
#include "calib/fit/fit.hpp"
#include "sim/mesh/mesh.hpp"
#include "sim/terms/cable.hpp"

namespace taut {

/// What a control is, or what a channel measures: tables and figures ask it for unit and words.
struct AxisRecord {
  std::string id;                        ///< as in the readings: "tip_load"
  std::string quantity;                  ///< name_of(Quantity): "length"
  std::string unit;                      ///< SI: "m"
  std::string label;                     ///< at the axis of a figure, the unit left out: "displacement"
  std::vector<std::string> labels = {};  ///< what the numbers 1, 2, ... stand for, where they are names
};
AxisRecord make_axis(std::string id, Quantity quantity, std::string label);  ///< the axis of a control
/// The axis of a channel of an experiment: "displacement", "tension", ...
AxisRecord make_axis(const ChannelSettings& channel);

/// One measured number of a bench (of a recording, its trial), and the row of its protocol that predicts it.
struct BenchReading : Reading {
  int row = 0;                         ///< -1: nothing predicts it, as it is excluded
  std::string series;                  ///< what is held besides the drawn control: "retraction 5.89 mm"; "": nothing
  std::optional<double> load_newtons;  ///< of a specimen at rest: the drawn control, a load as a force [N]
};

/// A curve of one channel over the drawn control, everything else held.
struct CurveRecord {
  std::string channel;
  std::string series;                     ///< as BenchReading::series
  std::vector<double> load;               ///< the drawn control; a load as a force [N]
  std::vector<double> value, se;          ///< prediction and standard error of the curve, SI
  std::vector<double> increment_se = {};  ///< standard error of value - value at zero load, SI; empty: not known
};

/// Frequency and decay of one channel of one recording, by ring_down() of the readings and of the predictions at their
/// times.
struct SwingRecord {
  std::string recording, channel;
  double frequency = 0, decay = 0;                      ///< measured [Hz], [1/s]
  double predicted_frequency = 0, predicted_decay = 0;  ///< [Hz], [1/s]
};

/// An equilibrium that the last replay found, for drawings.
struct SolvedState {
  std::string label;                  ///< "retraction = 5.89 mm, mass = 50 g"
  std::string row, column;            ///< what is held, and the load ("mass 50 g"): its place in a table of pictures
  Eigen::VectorXd u;                  ///< [m], all unknowns
  std::vector<double> controls = {};  ///< SI, in the order of Bench::controls()
  Eigen::VectorXd contact = {};       ///< contact_forces() [N], all unknowns; empty: nothing touches, or not known
};

/// The equilibria of a replay, held controls first and loads second. No mesh: the bench has none.
struct SolvedStates {
  const Mesh* mesh = nullptr;
  std::vector<Cable> cables;
  std::vector<double> down;  ///< direction of gravity, else of the first load; empty: neither
  std::vector<SolvedState> states;
};

/// Tension [N] and length [m] of a cable in one solved state.
struct CableState {
  std::string where, cable;
  double tension = 0, length = 0;
};

/// How hard a specimen is to deflect at a loaded point beyond where it is: k = dF/dx [N/m] along the load, everything
/// else held, where x is the displacement of the load's own place.
struct TangentStiffness {
  std::string where, load;
  double value = 0;              ///< k [N/m]
  std::vector<double> controls;  ///< of that state, SI, in the order of Bench::controls()
  bool touching = false;         ///< surfaces of the specimen touch there: the lips of a module are closed
  bool slipped = false;          ///< the way to it jumped from one equilibrium to another
};

using Lines = std::vector<std::pair<std::string, std::string>>;  ///< label and text, for people

std::vector<int> indices_of(const std::vector<FreeParameter>& free);  ///< their indices in the table

struct StaticReplay;
struct DimensionedModel;

/// Which model predicts a row, and how far its value may be off, relative to `of`: as the model states or as the next
/// dearer one changed it; NaN: not known.
struct RowModel {
  std::string name;  ///< as experiment files spell it
  double error = 0;
  std::optional<double> of = {};  ///< SI; nothing: the value itself. Of a position: how far its point has moved
};

/// What predicts the rows of a bench at rest instead of the full model: cheaper ones, row by row.
struct ModelChoice {
  std::unique_ptr<Protocol> protocol;  ///< null: the full model
  std::string sentence;                ///< what was chosen and why; "": the file asked for it
  std::function<std::string()> doubt;  ///< what is doubtful of the last prediction, as the end of a sentence, or ""
  std::function<RowModel(int row)> model_of = {};  ///< of the last prediction
  bool one_model = false;                          ///< predicts all rows
  std::string text = {};                           ///< "rod of 72 elements"; "": the full model's
  int unknowns = 0;                                ///< of a row; 0: the full model's
  std::vector<Dimension> dimensions = {};          ///< parameters behind those of the full model
  /// Displacements of the full model's mesh at these controls [m], as the last prediction has them, for drawings;
  /// empty: not known.
  std::function<Eigen::VectorXd(const std::vector<double>& controls)> state = {};
  /// Whether a replay is compared with the full model's, which takes that one's time.
  bool compared = true;
};

/// Cheaper models of specimens at rest.
struct CheaperModels {
  /// Starts from which a fit is cheaper.
  std::function<std::vector<FreeParameter>(const Experiment&, const Trials&, const std::vector<FreeParameter>&)> starts;
  /// What predicts, as the experiment's `model` asks for, with these dimensions as parameters where it can.
  std::function<ModelChoice(const Experiment&, const Trials&, const StaticReplay&, const std::vector<Dimension>&)>
      choose;
};

/// The readings of an experiment, the model that replays them, and what is said of both: what the commands work on,
/// whatever kind of bench it is. Readings keep the order of their files.
class Bench {
 public:
  /// Kinds of benches add readings, controls and channels.
  explicit Bench(Experiment experiment) : experiment_(std::move(experiment)) {}
  virtual ~Bench() = default;
  Bench(const Bench&) = delete;
  Bench& operator=(const Bench&) = delete;

  const Experiment& experiment() const { return experiment_; }                    ///< as its file has it
  const std::vector<BenchReading>& readings() const { return readings_; }         ///< in the order of their files
  const std::vector<Measurement>& measurements() const { return measurements_; }  ///< one per fitted reading
  const std::vector<AxisRecord>& controls() const { return controls_; }           ///< what was set
  const std::vector<AxisRecord>& channels() const { return channels_; }           ///< what was measured
  int drawn_control() const { return drawn_control_; }             ///< over which figures are drawn; -1: none
  const std::string& drawn_label() const { return drawn_label_; }  ///< at the axis of that control

  /// Has cheaper models in its service, where there are such of its kind.
  virtual void use(const CheaperModels& /*models*/) {}
  /// What predicts the rows.
  virtual Protocol& protocol() const = 0;
  /// The free parameters with starts and bounds. Throws InputError as free_parameters() does.
  virtual std::vector<FreeParameter> free() const;
  /// The same with starts from which a fit is cheaper, where there are such.
  virtual std::vector<FreeParameter> better_starts(const std::vector<FreeParameter>& free) const { return free; }
  /// The same for the fit of a variant: by default where the main fit ended.
  virtual std::vector<FreeParameter> starts_after(const FitResult& main) const;

  /// Curves of all channels and series at `p`, with bands from the covariance of a fit (empty: no bands).
  virtual std::vector<CurveRecord> curves(const Params& p, const std::vector<FreeParameter>& free,
                                          const Eigen::MatrixXd& covariance, const Ask& ask) const = 0;
  virtual bool draws_variants() const { return false; }  ///< whether variants have curves of their own
  /// Of recordings; else none.
  virtual std::vector<SwingRecord> swings(const Eigen::VectorXd& /*predicted*/) const { return {}; }

  /// The same readings with what a [[fit.variant]] changes. Throws InputError.
  virtual std::unique_ptr<Bench> with(const VariantSettings& variant) const = 0;
  /// The readings at one value of a control alone; benches that have no such parts throw InputError.
  virtual std::unique_ptr<Bench> part(size_t control, double held) const;
  /// The same model at these controls, all channels of each row, without readings; benches without a table of loads
  /// throw InputError.
  virtual std::unique_ptr<Bench> at_rows(const std::vector<LoadRow>& rows) const;
  /// at_rows() of a file of loads. Throws InputError as read_load_rows() does.
  std::unique_ptr<Bench> at_loads(const std::string& path) const;
  virtual std::vector<double> values_of(size_t control) const;  ///< distinct ones, ascending [SI]

  virtual std::string fit_name() const { return "this fit"; }  ///< beside its variants
  virtual std::string model_text() const = 0;                  ///< "quadratic, locking-free, 14 x 5 x 5 cells"
  virtual int unknowns() const = 0;                            ///< of a material point: readings
  virtual std::string size_text() const = 0;                   ///< "16 readings in 8 conditions with 2400 unknowns"
  virtual Lines describe() const = 0;                          ///< mesh, materials, supports, loads, channels
  /// What a reader must know before trusting a prediction (elements that lock), and after it (folded states, slips).
  virtual std::vector<std::string> warnings_before() const { return {}; }
  virtual std::vector<std::string> warnings_after() const { return {}; }  ///< after a prediction: see warnings_before()
  virtual std::string choice() const { return ""; }  ///< what model = "auto" chose, one sentence; else ""
  /// Whether one model predicts all rows; only then there are curves, variants and parts.
  virtual bool one_model() const { return true; }
  /// Which model predicted a row, where cheaper ones do; else nullopt.
  virtual std::optional<RowModel> model_of(int /*row*/) const { return std::nullopt; }
  /// Where cheaper models predict some rows: how far their `values` are from the full one's at `p`, one sentence.
  virtual std::string compare_models(const Params&, const Eigen::VectorXd& /*values*/, double /*seconds*/) const {
    return "";
  }
  /// The model with all dimensions as parameters; where it has none of them (beams), or several predict rows, the full
  /// one, which has every number that is taken for granted near enough. Of readings at rest.
  virtual DimensionedModel with_dimensions() const;
  /// The readings as their file has them, for who replays them with other meshes; null where that is not done.
  virtual const Trials* trials_at_rest() const { return nullptr; }
  virtual SolvedStates states() const { return {}; }                   ///< of the last replay; none without a mesh
  virtual std::vector<CableState> cable_states() const { return {}; }  ///< of the last replay; none without cables
  /// Rows of the protocol to whose states the path of the last prediction jumped from another equilibrium. Of the full
  /// model at rest.
  virtual std::vector<int> slipped_rows() const { return {}; }
  /// Of every load and state of the last prediction, which has to have asked for derivatives with respect to the loads.
  virtual std::vector<TangentStiffness> tangent_stiffness() const { return {}; }
  /// A control as a force [N], where it is a load: a mass times gravity; else as it is.
  virtual double as_force(size_t /*control*/, double value) const { return value; }
  virtual std::string effort()
      const = 0;  ///< what the replays so far took, "124 Newton iterations, 130 factorisations"
  /// Whether a parameter is set by the bench, row by row.
  bool sets(const std::string& id) const;
  /// Standard deviation that the file declares for a new reading of a channel; nullopt: sigmas stand row by row.
  std::optional<double> declared_sigma(int channel, double value) const;

  /// "retraction = 5.89 mm".
  std::string describe_control(size_t control, double value) const;

 protected:
  /// "5.89 mm"; zero in the unit of the control's other values.
  std::string control_text(size_t control, double value) const;

  Experiment experiment_;
  std::vector<BenchReading> readings_;
  std::vector<Measurement> measurements_;
  std::vector<AxisRecord> controls_, channels_;
  int drawn_control_ = -1;
  std::string drawn_label_;
};

/// A line for each material.
void add_material_lines(const Experiment& experiment, Lines& lines);

}  // namespace taut

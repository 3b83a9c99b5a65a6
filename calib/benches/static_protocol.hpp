#pragma once
#include <Eigen/Core>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "calib/data/trials.hpp"
#include "calib/fit/protocol.hpp"
#include "sim/contact/grip.hpp"
#include "sim/model/channel.hpp"
#include "sim/scene/scene.hpp"
#include "sim/solve/quasi_statics.hpp"

namespace taut {

/// One row of a static bench: the controls that were set, and the channel that was read.
struct StaticRow {
  std::vector<double> controls;  ///< SI, in the order of StaticProtocol's control parameters
  int channel = 0;
  int offset = -1;              ///< table index of a parameter that is added to the reading (a zero error); -1: none
  double order = not_a_number;  ///< its place in the sequence of all rows, where states know their past; NaN: see below
  Turn turn = {};               ///< when it was read, along a history
};

/// A channel with its name.
struct NamedChannel {
  std::string id;
  std::unique_ptr<Channel> channel;
};

/// Equilibria under controls: dead loads, prescribed displacements, cable retractions. A path starts at rest (all
/// controls and gravity zero). Controls named in Options::set_first (retractions) are brought to their values first,
/// with all others zero; from that state the others follow, from small to large, each from the last one's equilibrium.
/// Rows that share set_first share the path up to there; without set_first each distinct set of controls has a path of
/// its own. Rows that share all their controls share the solve. Paths run on all threads, and the number of threads
/// does not change a bit of the result.
///
/// With Options::history rows are replayed along the bench's own history (QuasiStatics): those with a place in it one
/// after the other, with what each leaves behind for the next ones; a row without has a path from rest of its own. A
/// row whose load was preceded by a rest, or whose retraction is another one, comes from the unloaded state at its own
/// retraction, which lasts as long as that rest; another one directly from the row before it. Then its load acts for
/// its dwell.
///
/// Where states know their past (Scene::states, cables that rub), the way to a row counts. After what is set first,
/// rows that load follow from small to large, then those that unload (Options::direction) from large to small, from the
/// largest load of both; where all controls are set first, they are what loads and unloads. Rows with an order follow
/// each other as it says, on one path; between two that are set first unlike the others are zero. Each such state is
/// one step from the one before: parameters that follow from the state itself are found by Newton's method around the
/// equilibrium, and derivatives are those of both together and of the whole path.
class StaticProtocol final : public Protocol {
 public:
  /// How equilibria are found.
  struct Options {
    EquilibriumOptions equilibrium;
    int threads = 0;             ///< 0: as many as there are cores
    std::vector<int> set_first;  ///< positions among `controls` of those that a path sets before the others
    bool from_unloaded = false;  ///< displacements are measured from the state before the loads, not from rest
    bool history = false;        ///< the model remembers: rows are replayed along the bench's own history
    /// Of the scene: what touches in a state cannot slide in those that start from it, by a Grip, until it opens; null:
    /// it slides freely. Derivatives leave out how the former states depend on parameters.
    const Contact* sticks = nullptr;
    int direction = -1;  ///< position among `controls` of the one that is 1 in rows that load, 2 in those that unload
  };

  /// `controls` are table indices of the loads that rows set, `switched_off_at_rest` further ones (gravity) that the
  /// rest shape knows nothing of. Rows hold finite numbers.
  StaticProtocol(Scene scene, std::vector<NamedChannel> channels, std::vector<int> controls,
                 std::vector<int> switched_off_at_rest, std::vector<StaticRow> rows, Options options);

  const ParameterTable& parameters() const override { return table_; }
  const Params& nominal() const override { return nominal_; }
  int row_count() const override { return static_cast<int>(rows_.size()); }
  Prediction predict(const Params& p, const std::vector<int>& free) override;
  void forget() override;
  std::string state() const override;
  void restore(const std::string& state) override;
  std::vector<Alternative> alternatives(const Params& p) override;
  void follow(const Params& at, const std::vector<int>& rows) override;
  void begin_search() override { polish_ = Polish::search; }
  void end_search() override { polish_ = Polish::full; }

  /// A cheaper model of the same rows, and what its displacements are in this one: a condition that would follow
  /// its path from rest starts from what the guide finds there, as far as that came to it without a slip, a saddle
  /// or a choice of sides. Where this model finds no equilibrium from there, it follows its own path from rest. For
  /// benches without history, friction and what sticks. Parameters of the guide are found here by their ids; what it
  /// factorises does not count here.
  void follow_guide(std::unique_ptr<StaticProtocol> guide,
                    std::function<Eigen::VectorXd(const Eigen::VectorXd& u)> as_here);

  /// The same rows with a number that is no parameter of the model (a dimension) on either side of its value here. The
  /// models have the same unknowns and parameters.
  struct Neighbours {
    StaticProtocol *less, *more;
    double apart = 0;  ///< of that number, SI
  };
  /// Derivatives of all rows with respect to such numbers, at the states of the last prediction, which was complete:
  /// with g the gradient of the energy and c a channel, dc/du (-H^-1 dg) + dc, where dg and dc are central differences
  /// at fixed u; along a history, central differences of whole replays. Shape (rows, neighbours).
  Eigen::MatrixXd derivatives_between(const std::vector<Neighbours>& neighbours);

  const Scene& scene() const { return scene_; }                            ///< the model with its nominal values
  const std::vector<StaticRow>& rows() const { return rows_; }             ///< as they were given
  const std::vector<int>& controls() const { return controls_; }           ///< table indices of what rows set
  const std::vector<NamedChannel>& channels() const { return channels_; }  ///< that rows read

  /// A distinct set of controls, its last equilibrium and what it took.
  struct Condition {
    std::vector<double> controls;  ///< SI
    double order = not_a_number;   ///< as StaticRow::order
    std::vector<int> rows;         ///< none: a state that others start or are measured from
    int parent = -1;               ///< the condition that its path comes from; -1: rest
    int unloaded = -1;             ///< the condition that its displacements are measured from; -1: rest
    bool solved = false;           ///< u is an equilibrium at p, fit to start the next solve from
    Params p;                      ///< of the model, with those that follow from states
    Params other_p;           ///< where a path in another equilibrium starts that is followed instead; empty: none is
    Eigen::VectorXd other_u;  ///< the state there [m]
    Eigen::VectorXd u;        ///< [m], all unknowns
    Eigen::MatrixXd sensitivities;         ///< du/dp of the parameters that were asked for last
    std::vector<int> sensitivity_of;       ///< which those are
    Eigen::VectorXd leaves;                ///< what the next state's parameters of the past are; as Scene::states
    Eigen::MatrixXd state_sensitivities;   ///< of p's parameters that follow from states, as Scene::states
    Eigen::MatrixXd leaves_sensitivities;  ///< of `leaves`
    SolveReport report;
    bool held = false;  ///< something touches in the state that it starts from, and cannot slide (Options::sticks)
    double smallest_jacobian = 0;  ///< over quadrature points and nodes, after the last solve
    double seconds = 0;            ///< along a history: for how long it lasts before it is read
    std::vector<double> read;      ///< along a history: what each of `rows` reads there,
    Eigen::MatrixXd read_by;       ///< and its derivatives, (rows x sensitivity_of)
  };
  /// That rows need, or that others start from.
  const std::vector<Condition>& conditions() const { return conditions_; }
  /// "mass = 0.5 kg, retraction = 17.68 mm".
  std::string describe(const Condition& condition) const;
  int factorisations() const override { return factorisations_; }
  int newton_iterations() const { return newton_iterations_; }  ///< since construction

 private:
  struct Path {
    std::vector<int> conditions;  ///< in the order in which they are solved
    double cost = 0;              ///< factorisations of its last solve, before the first one a guess
    std::unique_ptr<Equilibrium> equilibrium;
    /// While the loads hang on what sticks: the model with a Grip.
    std::unique_ptr<Model> held_model = {};
    std::unique_ptr<Equilibrium> held_equilibrium = {};
  };
  /// Another equilibrium of a condition, and where loads that grow make the state jump.
  struct Other {
    Eigen::VectorXd u;  ///< [m]; empty: none was found
    double jump;        ///< as Alternative::jump
  };
  class LoadWalk;
  /// Derivatives of a state by some numbers, a column each: of u, of the parameters that follow from states, and of
  /// what it leaves for those of the next one.
  struct Slopes {
    Eigen::MatrixXd u, states, leaves;
  };
  bool knows_past() const { return !scene_.states.empty(); }
  bool unloads(const Condition& condition) const;
  int condition_with(std::vector<double> controls, double order = not_a_number);
  double load_of(int condition) const;
  bool adds_to(int more, int less) const;
  std::vector<std::vector<int>> growing_loads() const;
  Params with_controls(const Params& p, const std::vector<double>& controls) const;
  std::vector<Condition> solved_afresh(const Params& p);
  std::vector<Other> others(const Params& p, const std::vector<Condition>& own);
  bool same_state(const Eigen::VectorXd& a, const Eigen::VectorXd& b) const;
  void find_followed();
  std::vector<double> before_loads(std::vector<double> controls) const;
  void make_paths();
  void make_histories();
  int append(Path& path, std::vector<double> controls, int parent, double seconds);
  void solve_history(Path& path, const Params& p, const std::vector<int>& free);
  void read_along(Condition& condition, const QuasiStatics& statics) const;
  void make_paths_of_loads();
  bool all_set_first() const;
  int root_of(int condition);
  void make_paths_of_directions();
  void make_measured_path();
  std::vector<int> own_states() const;
  Params start_of_states(const Condition& condition, Params target) const;
  void settle_states(Equilibrium& equilibrium, SolveReport& report) const;
  Slopes slopes_of(const Condition& condition, const Slopes& held, const Eigen::MatrixXd& inherited,
                   const std::function<Eigen::RowVectorXd(size_t state)>& partial) const;
  Eigen::MatrixXd inherited(const Condition& condition, const Eigen::MatrixXd& leaves,
                            const std::vector<int>& of) const;
  void find_sensitivities(Condition& condition, const std::vector<int>& free, Equilibrium& equilibrium) const;
  Eigen::RowVectorXd by_states(const Channel& channel, const Point& at) const;
  bool held_when_unloaded(int index) const;
  void solve_path(Path& path, const Params& p, const std::vector<int>& free);
  void solve_held(Path& path, Condition& condition, const Params& p, const std::vector<int>& free, Grip& grip) const;
  void solve_condition(Condition& condition, const Params& p, const std::vector<int>& free,
                       Equilibrium& equilibrium) const;
  Eigen::VectorXd predicted_change(const Condition& condition, const Params& to) const;
  void ask_guide(const Params& p);
  bool start_as_guided(const Condition& condition, const Params& target, Equilibrium& equilibrium) const;
  void read_row(Eigen::Index r, const Params& p, const std::vector<int>& free, Prediction& prediction) const;
  std::string describe_parameters(const Params& p) const;
  Slopes change_between(const std::vector<Neighbours>& neighbours, const Condition& condition,
                        const Eigen::MatrixXd& leaves_before, Equilibrium& equilibrium) const;

  Scene scene_;
  ParameterTable table_;  ///< without parameters that follow from states
  Params nominal_;
  std::vector<NamedChannel> channels_;
  std::vector<int> controls_, off_at_rest_;
  std::vector<StaticRow> rows_;
  Options options_;
  std::vector<Condition> conditions_;
  std::vector<int> condition_of_row_;
  std::vector<Path> paths_;
  Polish polish_ = Polish::full;
  Params follow_at_;  ///< where the other equilibria of `follow_rows_` are to be found yet; else empty
  std::vector<int> follow_rows_;
  Params at_;  ///< of the last prediction
  std::unique_ptr<StaticProtocol> guide_;
  std::function<Eigen::VectorXd(const Eigen::VectorXd&)> from_guide_;
  bool guided_ = false;  ///< the guide has found the conditions of the prediction that is made
  int factorisations_ = 0, newton_iterations_ = 0;
};

}  // namespace taut

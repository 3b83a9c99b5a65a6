#pragma once
#include <Eigen/Core>
#include <memory>
#include <string>
#include <vector>

#include "sim/core/channel.hpp"
#include "sim/core/scene.hpp"
#include "sim/solve/equilibrium.hpp"

namespace taut {

/// What a protocol says about its rows at one set of parameters.
struct Prediction {
  Eigen::VectorXd values;       ///< one per row, SI; NaN where the simulation failed
  Eigen::MatrixXd derivatives;  ///< rows x free parameters, SI; empty when not asked for
  std::vector<std::string>
      failures;  ///< one sentence per failed condition: which rows, what happened, at which parameters
  bool complete() const { return failures.empty(); }
};

/// How an experiment is replayed: turns parameters into a prediction for each row of a bench, with derivatives.
class Protocol {
 public:
  virtual ~Protocol() = default;
  virtual const ParameterTable& parameters() const = 0;
  /// Nominal values of all parameters.
  virtual const Params& nominal() const = 0;
  virtual int row_count() const = 0;
  /// Predicts all rows at `p`, with derivatives with respect to the parameters `free` (table indices) when that is not
  /// empty. May start from what earlier calls found: that changes the time, not the answer.
  virtual Prediction predict(const Params& p, const std::vector<int>& free) = 0;
  /// Forgets what earlier calls found: the next prediction goes the protocol's own path from the start.
  virtual void forget() {}
};

/// One row of a static bench: the controls that were set, and the channel that was read.
struct StaticRow {
  std::vector<double> controls;  ///< SI, in the order of StaticProtocol's control parameters
  int channel = 0;
};

/// A channel with its name.
struct NamedChannel {
  std::string id;
  std::unique_ptr<Channel> channel;
};

/// Equilibria under dead loads and prescribed displacements, one per distinct set of controls, each on its own path
/// from the rest shape (all controls and gravity zero). Rows that share their controls share the solve; different
/// controls run on all threads, and the number of threads does not change a bit of the result.
class StaticProtocol final : public Protocol {
 public:
  struct Options {
    EquilibriumOptions equilibrium;
    int threads = 0;  ///< 0: as many as there are cores
    bool from_unloaded =
        false;  ///< displacements are measured from the state in which all controls are zero, not from rest
  };

  /// `controls` are table indices of the loads that rows set, `switched_off_at_rest` further ones (gravity) that the
  /// rest shape knows nothing of. Rows hold finite numbers.
  StaticProtocol(Scene scene, std::vector<NamedChannel> channels, std::vector<int> controls,
                 std::vector<int> switched_off_at_rest, std::vector<StaticRow> rows, Options options);

  const ParameterTable& parameters() const override { return scene_.model->parameters(); }
  const Params& nominal() const override { return scene_.values; }
  int row_count() const override { return static_cast<int>(rows_.size()); }
  Prediction predict(const Params& p, const std::vector<int>& free) override;
  void forget() override;

  const Scene& scene() const { return scene_; }
  const std::vector<StaticRow>& rows() const { return rows_; }
  const std::vector<int>& controls() const { return controls_; }  ///< table indices of what rows set

  /// A distinct set of controls, its last equilibrium and what it took.
  struct Condition {
    std::vector<double> controls;
    std::vector<int> rows;
    bool solved = false;  ///< u is an equilibrium at p, fit to start the next solve from
    Params p;
    Eigen::VectorXd u;                ///< [m], all unknowns
    Eigen::MatrixXd sensitivities;    ///< du/dp of the parameters that were asked for last
    std::vector<int> sensitivity_of;  ///< which those are
    SolveReport report;
    double smallest_jacobian = 0;  ///< over quadrature points and nodes, after the last solve
  };
  const std::vector<Condition>& conditions() const { return conditions_; }
  int factorisations() const { return factorisations_; }  ///< since construction
  int newton_iterations() const { return newton_iterations_; }

 private:
  void solve_condition(Condition& condition, const Params& p, const std::vector<int>& free,
                       Equilibrium& equilibrium) const;
  bool near(const Params& from, const Params& to) const;
  std::string describe(const Condition& condition, const Params& p) const;

  Scene scene_;
  std::vector<NamedChannel> channels_;
  std::vector<int> controls_, off_at_rest_;
  std::vector<StaticRow> rows_;
  Options options_;
  std::vector<Condition> conditions_;
  std::vector<int> condition_of_row_;
  int unloaded_ = -1;  ///< condition with all controls zero, when displacements are measured from it
  std::vector<std::unique_ptr<Equilibrium>> workspaces_;  ///< one per thread, kept for their symbolic analyses
  int factorisations_ = 0, newton_iterations_ = 0;
};

}  // namespace taut

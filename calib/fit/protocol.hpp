#pragma once
#include <Eigen/Core>
#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include "sim/core/numbers.hpp"
#include "sim/core/parameters.hpp"

namespace taut {

/// What a protocol says about its rows at one set of parameters.
struct Prediction {
  Eigen::VectorXd values;       ///< one per row, SI; NaN where the simulation failed
  Eigen::MatrixXd derivatives;  ///< rows x free parameters, SI; empty when not asked for
  /// One sentence per failed condition: which rows, what happened, at which parameters.
  std::vector<std::string> failures;
  bool complete() const { return failures.empty(); }  ///< no simulation failed
};

/// Rows with the same controls that may be in another equilibrium than the one a prediction is of.
struct Alternative {
  std::vector<int> rows;  ///< of the prediction
  Eigen::VectorXd path;   ///< their values in its equilibrium, SI
  Eigen::VectorXd other;  ///< in the other one, SI; empty: none was found at these controls
  double jump =
      not_a_number;  ///< where loads that grow make the state jump, as a multiple of the rows' own; NaN: nowhere
  /// So near a jump that small errors of model or bench decide on which side of it the rows are.
  bool near_jump() const { return std::abs(jump - 1) <= 0.05; }
};

/// How an experiment is replayed: turns parameters into a prediction for each row of a bench, with derivatives.
class Protocol {
 public:
  virtual ~Protocol() = default;
  virtual const ParameterTable& parameters() const = 0;  ///< the table that `p` and `free` refer to
  /// Nominal values of all parameters.
  virtual const Params& nominal() const = 0;
  virtual int row_count() const = 0;  ///< rows of a prediction
  /// Predicts all rows at `p`, with derivatives with respect to the parameters `free` (table indices) when that is not
  /// empty. May start from what earlier calls found: that changes the time, not the answer.
  virtual Prediction predict(const Params& p, const std::vector<int>& free) = 0;
  /// Forgets what earlier calls found: the next prediction goes the protocol's own path from the start.
  virtual void forget() {}
  /// Between begin_search() and end_search() derivatives may be off by some per cent: good enough to search by.
  virtual void begin_search() {}
  virtual void end_search() {}  ///< from here on derivatives are exact again
  /// What the next prediction starts from besides its parameters, as bytes; "": nothing. A protocol of the same rows
  /// that restores them predicts the same to the bit.
  virtual std::string state() const { return ""; }
  virtual void restore(const std::string& /*state*/) {}  ///< takes what state() gave
  /// Looks for other equilibria of the rows at `p`: loads grow beyond the rows' own, and where the state jumps, the
  /// loads are taken back from there. What predictions start from stays as it was.
  virtual std::vector<Alternative> alternatives(const Params& /*p*/) { return {}; }
  /// From here on rows are predicted in the other equilibrium that alternatives() finds at `at`, and those that come
  /// from them after them; all others, and with an empty list all rows, as ever.
  virtual void follow(const Params& /*at*/, const std::vector<int>& /*rows*/) {}
  /// Matrix factorisations since construction: what predictions cost, whatever the machine. 0 for closed forms.
  virtual int factorisations() const { return 0; }
};

/// How a prediction is had: from the protocol, or from what is known of it already.
using Ask = std::function<Prediction(Protocol&, const Params&, const std::vector<int>& free)>;

}  // namespace taut

#pragma once
#include <Eigen/Core>
#include <vector>

#include "sim/model/model.hpp"
#include "sim/solve/equilibrium.hpp"

namespace taut {

/// Equilibria one after the other in time, of a model whose stresses relax (Model::memory_size()): what each depends
/// on besides its own parameters is what was done before it. With their derivatives, through the whole history.
class QuasiStatics {
 public:
  /// The model has to outlive it; start_at_rest() comes first.
  explicit QuasiStatics(const Model& model, EquilibriumOptions options = {}) : equilibrium_(model, options) {}

  /// At rest with nothing remembered, where loads and prescribed displacements are zero. Derivatives with respect to
  /// `tracked` numbers are followed.
  void start_at_rest(const Params& p, int tracked = 0);
  /// Goes to `p` within `length` seconds; 0: at once. `dp` are the derivatives of p with respect to what is tracked,
  /// shape (parameters x tracked). On failure the state stays where it was.
  const SolveReport& advance(const Params& p, const Eigen::MatrixXd& dp, double length);
  /// Stays at `p` for `duration` seconds, in 16 steps of which each is half as long as all before it together, whatever
  /// the times in which stresses relax. The report sums up.
  SolveReport hold(const Params& p, const Eigen::MatrixXd& dp, double duration);

  const Equilibrium& equilibrium() const { return equilibrium_; }     ///< the last one, with its factor
  const Eigen::VectorXd& u() const { return equilibrium_.u(); }       ///< [m], all unknowns
  const Eigen::MatrixXd& du() const { return du_; }                   ///< with respect to what is tracked
  const TimeStep& step() const { return step_; }                      ///< that ended in this state
  const Eigen::MatrixXd& dmemory() const { return dmemory_before_; }  ///< of step().memory
  const Eigen::VectorXd& memory() const { return memory_; }           ///< Model::remember() at its end
  const Eigen::MatrixXd& dmemory_after() const { return dmemory_; }   ///< of memory()

 private:
  Equilibrium equilibrium_;
  TimeStep step_;
  Eigen::VectorXd memory_;
  Eigen::MatrixXd du_, dmemory_, dmemory_before_;
};

}  // namespace taut

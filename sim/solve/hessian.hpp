#pragma once
#include <Eigen/Core>
#include <memory>
#include <vector>

#include "sim/core/model.hpp"
#include "sim/solve/cholesky.hpp"

namespace taut {

/// The Hessian of a model at one state, on its free unknowns, with its Cholesky factor. Its pattern is the model's,
/// and grows by the couplings that states bring along (contact); the symbolic analysis is made again only then. One
/// object per thread.
class Hessian {
 public:
  explicit Hessian(const Model& model);

  /// Evaluates energy, gradient (all unknowns) and Hessian at a state. Returns the assembly with its energy.
  Assembly assemble(const Point& at, Curvature curvature, Eigen::VectorXd* gradient);
  /// Factorises what was assembled, plus shift * I. False when it is not positive definite.
  bool factorise(double shift = 0);
  /// Solves with the last factor, on the free unknowns; shape (n) or (n x k).
  Eigen::MatrixXd solve(const Eigen::MatrixXd& b) const { return cholesky_.solve(b); }
  /// Mean absolute diagonal entry [N/m].
  double mean_diagonal() const;
  int factorisations() const { return factorisations_ + cholesky_.factorisations(); }
  /// Back to the model's own pattern, so that what follows does not depend on what was solved before.
  void forget_couplings();

 private:
  struct Place {
    int column, row;
    auto operator<=>(const Place&) const = default;
  };
  void set_pattern(std::vector<Place> extra);
  int slot_of(int row, int column) const;

  const Model* model_;
  std::unique_ptr<SparsePattern> pattern_;  ///< the model's and the couplings'
  std::vector<Place> extra_;    ///< free unknowns of the couplings that are not in the model's pattern; sorted
  std::vector<int> slots_;      ///< of the model's entries in pattern_; empty when they are the same
  std::vector<double> own_;     ///< values of the model's pattern and one extra slot
  std::vector<double> values_;  ///< values of pattern_, when it has more
  std::vector<Coupling> couplings_;
  Cholesky cholesky_;
  int factorisations_ = 0;  ///< by factors of earlier patterns
};

}  // namespace taut

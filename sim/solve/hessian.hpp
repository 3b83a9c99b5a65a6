#pragma once
#include <Eigen/Core>
#include <array>
#include <memory>
#include <optional>
#include <vector>

#include "sim/model/model.hpp"
#include "sim/solve/cholesky.hpp"
#include "sim/solve/reduction.hpp"

namespace taut {

/// The Hessian of a model at one state, on the unknowns of its Reduction, with its Cholesky factor. Its pattern is the
/// model's, and grows by the couplings that states bring along (contact); the symbolic analysis is made again only
/// then. One object per thread.
class Hessian {
 public:
  explicit Hessian(const Model& model);  ///< the model has to outlive it

  /// Evaluates energy, gradient (all unknowns) and Hessian at a state. Returns the assembly with its energy.
  Assembly assemble(const Point& at, Curvature curvature, Eigen::VectorXd* gradient);
  /// Factorises what was assembled, plus shift * I. False when it is not positive definite.
  bool factorise(double shift = 0);
  /// Solves with the last factor; shape (n) or (n x k).
  Eigen::MatrixXd solve(const Eigen::MatrixXd& b) const { return cholesky().solve(b); }
  /// Solves with what was assembled last by conjugate gradients, preconditioned by the last factor, which may be of a
  /// state before or of a shifted Hessian, until the residual has fallen to `tolerance` in the norm of that factor's
  /// inverse. Empty without a factor, where negative curvature shows on the way, where it comes to cost as much as a
  /// factorisation, and where the factor is quite another Hessian's (turned stiff directions): then the residual is all
  /// of the stiffest, and what is solved for in the soft ones does not show in it.
  std::optional<Eigen::VectorXd> iterate(const Eigen::VectorXd& b, double tolerance) const;
  double price() const { return cholesky().price(); }  ///< of a factorisation, in solves
  void drop_factor() { factorised_ = false; }          ///< iterate() waits for another one
  /// What was assembled times q.
  Eigen::VectorXd times(const Eigen::VectorXd& q) const { return pattern_->times(values(), q); }
  const Reduction& reduction() const { return reduction_; }  ///< the unknowns that it stands on
  /// Mean absolute diagonal entry [N/m].
  double mean_diagonal() const;
  /// Since construction.
  int factorisations() const {
    return factorisations_ + own_cholesky_.factorisations() + (grown_ ? grown_->factorisations() : 0);
  }
  /// Back to the model's own pattern, so that what follows does not depend on what was solved before.
  void forget_couplings();
  /// Couplings (row, column) beyond the model's own pattern that have come so far; and to start with those of another
  /// object, so that elimination goes in the same order.
  std::vector<std::array<int, 2>> couplings() const;
  void expect(const std::vector<std::array<int, 2>>& couplings);  ///< see couplings()

 private:
  struct Place {
    int column, row;
    auto operator<=>(const Place&) const = default;
  };
  struct Spread {
    int entry, slot, left, right;
    double factor;
  };
  const SparsePattern& base() const { return reduction_.identity() ? model_->pattern() : reduction_.pattern(); }
  const Cholesky& cholesky() const { return grown_ ? *grown_ : own_cholesky_; }
  Cholesky& cholesky() { return grown_ ? *grown_ : own_cholesky_; }
  const std::vector<double>& values() const;
  void reduce(const Point& at, Curvature curvature, const Eigen::VectorXd& gradient,
              const std::vector<double>& weights);
  void set_pattern(std::vector<Place> extra);

  const Model* model_;
  Reduction reduction_;
  std::unique_ptr<SparsePattern> pattern_;  ///< base() and the couplings'
  std::vector<Place> extra_;                ///< couplings that are not in base(); sorted
  std::vector<int> slots_;                  ///< of base()'s entries in pattern_; empty when they are the same
  std::vector<double> own_;                 ///< values of the model's pattern and one extra slot
  std::vector<Spread> spreads_;             ///< from own_ to reduced_
  std::vector<double> reduced_;             ///< values of base(), where that is not the model's pattern
  std::vector<double> values_;              ///< values of pattern_, where that is not base()
  std::vector<Coupling> couplings_;
  Cholesky own_cholesky_;          ///< of base()
  std::optional<Cholesky> grown_;  ///< of pattern_, where that is not base() and was factorised
  bool analysed_ = true;           ///< pattern_ has not grown since cholesky() took it
  bool factorised_ = false;        ///< cholesky() has a factor, of whatever state
  int factorisations_ = 0;         ///< by factors of patterns in between
};

}  // namespace taut

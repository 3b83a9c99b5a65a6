#pragma once
#include <Eigen/Core>
#include <string>

#include "sim/model/model.hpp"
#include "sim/solve/equilibrium.hpp"

namespace taut {

struct KinsolOptions {
  int max_iterations = 200;
  double tolerance = 1e-9;  ///< largest out-of-balance nodal force relative to that of the start
};

struct KinsolResult {
  SolveStatus status = SolveStatus::converged;
  Eigen::VectorXd u;       ///< last iterate, all unknowns [m]
  bool minimum = false;    ///< the exact Hessian at u is positive definite
  int iterations = 0;      ///< Newton iterations
  int evaluations = 0;     ///< gradients
  int factorisations = 0;  ///< Cholesky factorisations, failed ones included
  int projections = 0;     ///< iterations that needed a projected Hessian
  double gradient = 0;     ///< largest out-of-balance nodal force [N]
  std::string words;       ///< SUNDIALS' reason where it gave up
};

/// Static equilibrium as a root of the gradient, dPi/du(u; p) = 0, by KINSOL (SUNDIALS): Newton's method with a line
/// search on |dPi/du|^2, from u_start in one go (supports imposed here, no load stepping). Our gradient, and our sparse
/// Cholesky of the exact Hessian in every iteration, of the projected one where that is indefinite. No step is longer
/// than L per node in the mean square, L the bounding-box diagonal.
///
/// A comparison for Equilibrium, not a replacement. A root of the gradient need not be a minimum: saddles (a straight
/// column past its buckling load) are as good to it, so look at `minimum`. It does not see barriers: infeasible states
/// are rejected, but a step may end on the far side of an obstacle.
KinsolResult kinsol_equilibrium(const Model& model, const Params& p, const Eigen::VectorXd& u_start,
                                const KinsolOptions& options = {});

}  // namespace taut

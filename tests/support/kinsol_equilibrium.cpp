#include "tests/support/kinsol_equilibrium.hpp"

#include <kinsol/kinsol.h>

#include <algorithm>
#include <cmath>

#include "sim/solve/sundials_support.hpp"

namespace taut {
namespace {

double largest(const Eigen::VectorXd& v) {
  return v.size() == 0 ? 0.0 : v.cwiseAbs().maxCoeff();
}

/// The problem as KINSOL's callbacks see it.
struct Root {
  const Model& model;
  const Params& p;
  Eigen::VectorXd supported;  ///< displacements of the supports, zero elsewhere
  Hessian hessian;
  int projections = 0;

  Eigen::VectorXd state(N_Vector free) const { return supported + model.extend_from_free(view(free)); }

  /// False for an infeasible state.
  bool gradient(const Eigen::VectorXd& u, Eigen::VectorXd& free) const {
    Eigen::VectorXd all;
    Assembly out;
    out.gradient = &all;
    model.evaluate({u, p}, out);
    if (!std::isfinite(out.energy)) return false;
    free = model.restrict_to_free(all);
    return free.allFinite();
  }

  bool factorise(const Eigen::VectorXd& u) {
    if (!std::isfinite(hessian.assemble({u, p}, Curvature::exact, nullptr).energy)) return false;
    if (hessian.factorise()) return true;
    ++projections;
    hessian.assemble({u, p}, Curvature::projected, nullptr);
    const double scale = hessian.mean_diagonal();
    for (double shift = 0; shift < scale; shift = std::max(10 * shift, 1e-8 * scale)) {
      if (hessian.factorise(shift)) return true;
    }
    return false;
  }
};

int system_function(N_Vector u, N_Vector f, void* root) {
  const Root& self = *static_cast<Root*>(root);
  Eigen::VectorXd free;
  if (!self.gradient(self.state(u), free)) return 1;  // recoverable: a shorter step is tried
  view(f) = free;
  return 0;
}

int jacobian(N_Vector u, N_Vector, SUNMatrix, void* root, N_Vector, N_Vector) {
  Root& self = *static_cast<Root*>(root);
  return self.factorise(self.state(u)) ? 0 : 1;
}

struct Memory {
  void* pointer;
  ~Memory() { KINFree(&pointer); }
};

SolveStatus status_of(int flag) {
  if (flag == KIN_SUCCESS || flag == KIN_INITIAL_GUESS_OK) return SolveStatus::converged;
  return flag == KIN_MAXITER_REACHED ? SolveStatus::iteration_limit : SolveStatus::stalled;
}

}  // namespace

KinsolResult kinsol_equilibrium(const Model& model, const Params& p, const Eigen::VectorXd& u_start,
                                const KinsolOptions& options) {
  KinsolResult result;
  result.u = u_start;
  model.impose_supports(p, result.u);
  Root root{model, p, Eigen::VectorXd::Zero(model.unknowns()), Hessian(model)};
  model.impose_supports(p, root.supported);
  const double L = model.length_scale();

  Eigen::VectorXd force;
  if (!root.gradient(result.u, force) || !root.factorise(result.u)) {
    result.status = SolveStatus::infeasible_start;
    return result;
  }
  // Relative to the start's force; one that is small beside what moves nodes by 1e-6 L is none to be relative to.
  const double typical = std::max(largest(force), 1e-6 * root.hessian.mean_diagonal() * L);

  const SundialsContext context;
  SundialsWords words;
  const Eigen::Index n = model.free_unknowns();
  const NVector u = context.vector(n), u_scale = context.vector(n), f_scale = context.vector(n);
  view(u.get()) = model.restrict_to_free(result.u);
  view(u_scale.get()).setConstant(1 / L);
  view(f_scale.get()).setConstant(1 / typical);
  const CallbackSolver solver(context, [&](const VectorView& b, VectorView x) { x = root.hessian.solve(b); });

  const Memory memory{KINCreate(context)};
  auto require = [&](int flag) { require_success(flag, words.text); };
  require(KINSetErrHandlerFn(memory.pointer, SundialsWords::keep, &words));
  require(KINInit(memory.pointer, system_function, u.get()));
  require(KINSetUserData(memory.pointer, &root));
  require(KINSetLinearSolver(memory.pointer, solver.solver(), solver.matrix()));
  require(KINSetJacFn(memory.pointer, jacobian));
  require(KINSetMaxSetupCalls(memory.pointer, 1));
  require(KINSetNumMaxIters(memory.pointer, options.max_iterations));
  require(KINSetFuncNormTol(memory.pointer, options.tolerance));
  require(KINSetScaledStepTol(memory.pointer, 1e-15));
  // The default, 1000 times the length of the start, is nothing at all from rest.
  require(KINSetMaxNewtonStep(memory.pointer, std::sqrt(static_cast<double>(n))));

  const int flag = KINSol(memory.pointer, u.get(), KIN_LINESEARCH, u_scale.get(), f_scale.get());
  long iterations = 0, evaluations = 0;
  KINGetNumNonlinSolvIters(memory.pointer, &iterations);
  KINGetNumFuncEvals(memory.pointer, &evaluations);
  result.status = status_of(flag);
  result.words = words.text;
  result.iterations = static_cast<int>(iterations);
  result.evaluations = static_cast<int>(evaluations) + 1;  // and the one for `typical`
  result.projections = root.projections;
  result.u = root.state(u.get());
  if (root.gradient(result.u, force)) {
    result.gradient = largest(force);
    root.hessian.assemble({result.u, p}, Curvature::exact, nullptr);
    result.minimum = root.hessian.factorise();
  }
  result.factorisations = root.hessian.factorisations();
  return result;
}

}  // namespace taut

#pragma once
#include <nvector/nvector_serial.h>
#include <sundials/sundials_linearsolver.h>
#include <sundials/sundials_matrix.h>

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>

// What the two users of SUNDIALS share: owners of its objects, and its linear solver interface on our own factors.
// Included by their .cpp files only.
namespace taut {

using NVector = std::unique_ptr<_generic_N_Vector, decltype(&N_VDestroy)>;  ///< a vector of the library's
using VectorView = Eigen::Map<Eigen::VectorXd>;                             ///< its numbers as Eigen has them

/// What it holds.
inline VectorView view(N_Vector v) {
  return {N_VGetArrayPointer(v), static_cast<Eigen::Index>(N_VGetLength(v))};
}

/// Settings of ours that the library refuses are mistakes of the program.
inline void require_success(int flag, const std::string& error) {
  if (flag < 0) throw std::logic_error("SUNDIALS: " + error);
}

/// Owns a SUNContext.
class SundialsContext {
 public:
  SundialsContext() {
    if (SUNContext_Create(nullptr, &context_) != 0) throw std::runtime_error("SUNDIALS: no context could be created");
  }
  ~SundialsContext() { SUNContext_Free(&context_); }
  SundialsContext(const SundialsContext&) = delete;
  SundialsContext& operator=(const SundialsContext&) = delete;
  operator SUNContext() const { return context_; }  ///< for calls of the library
  NVector vector(Eigen::Index size) const { return {N_VNew_Serial(size, context_), &N_VDestroy}; }  ///< of this length

 private:
  SUNContext context_ = nullptr;
};

/// The last error in the library's words, instead of on the console.
struct SundialsWords {
  std::string text;
  /// An error handler of the library: keeps the message of a negative code.
  static void keep(int code, const char*, const char*, char* message, void* self) {
    if (code < 0) static_cast<SundialsWords*>(self)->text = message;
  }
};

/// A direct linear solver whose matrix is a factor kept by the caller: the caller's callback for the matrix factorises,
/// `solve` (b, x) applies the factor. The integrator then decides when to factorise again.
class CallbackSolver {
 public:
  using Solve = std::function<void(const VectorView& b, VectorView x)>;  ///< x from b
  /// `solve` applies the factor that the caller keeps.
  CallbackSolver(SUNContext context, Solve solve)
      : matrix_(SUNMatNewEmpty(context)), solver_(SUNLinSolNewEmpty(context)), solve_(std::move(solve)) {
    matrix_->ops->getid = [](SUNMatrix) { return SUNMATRIX_CUSTOM; };
    matrix_->ops->zero = [](SUNMatrix) { return 0; };
    solver_->content = this;
    solver_->ops->gettype = [](SUNLinearSolver) { return SUNLINEARSOLVER_DIRECT; };
    solver_->ops->getid = [](SUNLinearSolver) { return SUNLINEARSOLVER_CUSTOM; };
    solver_->ops->setup = [](SUNLinearSolver, SUNMatrix) { return 0; };
    solver_->ops->solve = [](SUNLinearSolver self, SUNMatrix, N_Vector x, N_Vector b, realtype) {
      static_cast<CallbackSolver*>(self->content)->solve_(view(b), view(x));
      return view(x).allFinite() ? 0 : 1;  // 1: recoverable
    };
  }
  ~CallbackSolver() {
    SUNLinSolFreeEmpty(solver_);
    SUNMatFreeEmpty(matrix_);
  }
  CallbackSolver(const CallbackSolver&) = delete;
  CallbackSolver& operator=(const CallbackSolver&) = delete;
  SUNMatrix matrix() const { return matrix_; }        ///< for the integrator
  SUNLinearSolver solver() const { return solver_; }  ///< for the integrator

 private:
  SUNMatrix matrix_;
  SUNLinearSolver solver_;
  Solve solve_;
};

}  // namespace taut

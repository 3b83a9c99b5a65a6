#include "sim/solve/sundials_integrator.hpp"

#include <arkode/arkode_arkstep.h>
#include <cvodes/cvodes.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "sim/core/error.hpp"
#include "sim/solve/sundials_support.hpp"

namespace taut {
namespace {

/// Terms see a velocity as the difference to the state this long ago [s]: its error is tau/2 |grad v| relative to the
/// rate of strain, its rounding 1e-16 |u| / tau.
constexpr double tau = 1e-8;
/// Distance in time of the central differences of supports [s].
constexpr double support_step = 1e-4;

/// A symmetric matrix on the free unknowns, as the terms assemble it.
struct SymmetricMatrix {
  std::vector<double> values;  ///< of the model's pattern, and one more for the supports
  std::vector<Coupling> couplings;

  Eigen::VectorXd times(const Model& model, const Eigen::VectorXd& x) const {
    Eigen::VectorXd y = model.pattern().times(values, x);
    for (const Coupling& coupling : couplings) {
      const int row = model.free_index(coupling.row), column = model.free_index(coupling.column);
      if (row < 0 || column < 0) continue;
      y[row] += coupling.value * x[column];
      if (row != column) y[column] += coupling.value * x[row];
    }
    return y;
  }

  /// Where the terms are to put it.
  Assembly target(const Model& model, Curvature curvature) {
    values.resize(model.pattern().entries() + 1);
    Assembly out;
    out.hessian = values.data();
    out.couplings = &couplings;
    out.curvature = curvature;
    return out;
  }
};

/// Displacements and velocities of all unknowns, and the accelerations of the supports (zero elsewhere).
struct FullState {
  Params p;
  Eigen::VectorXd u, v, a;

  /// Accelerations `acceleration`, and velocities as the difference to a state `ago` seconds before.
  TimeStep time_step(double inertia, const Eigen::VectorXd& acceleration, double ago) const {
    TimeStep step;
    step.inertia = inertia;
    step.reference = u - acceleration / (inertia == 0 ? 1.0 : inertia);
    step.rate = {1 / ago, -1 / ago, 0};
    step.previous = u - ago * v;
    return step;
  }
};

ARKODE_DIRKTableID implicit_table(int order) {
  constexpr ARKODE_DIRKTableID tables[] = {ARKODE_TRBDF2_3_3_2, ARKODE_ESDIRK324L2SA_4_2_3, ARKODE_ESDIRK436L2SA_6_3_4,
                                           ARKODE_ESDIRK547L2SA2_7_4_5};
  return tables[order == 0 ? 1 : order - 2];
}

}  // namespace

std::string_view name_of(OdeStatus status) {
  constexpr std::string_view names[] = {"going", "infeasible start", "passed through", "step limit", "failed"};
  return names[static_cast<size_t>(status)];
}

std::string OdeReport::message() const {
  std::string text = fmt::format(
      "{}: {} steps, {} right-hand sides, {} Newton iterations, {} factorisations; repeated: {} steps for their error, "
      "{} for convergence",
      name_of(status), steps, evaluations, newton_iterations, factorisations, error_test_failures,
      convergence_failures);
  if (!words.empty()) text += "; " + words;
  return text;
}

struct OdeIntegrator::Implementation {
  Implementation(const Model& m, OdeOptions o)
      : model(&m),
        options(o),
        n(m.free_unknowns()),
        y(context.vector(2 * n)),
        absolute(context.vector(2 * n)),
        mass_factor(m.pattern()),
        hessian(m),
        solver(context, [this](const VectorView& b, VectorView x) { solve(b, x); }) {
    view(absolute.get()).head(n).setConstant(1e-2 * options.tolerance * m.length_scale());
    view(absolute.get()).tail(n).setConstant(options.tolerance * m.length_scale());
  }
  ~Implementation() { free_memory(); }
  Implementation(const Implementation&) = delete;
  Implementation& operator=(const Implementation&) = delete;

  void free_memory() {
    if (memory != nullptr) bdf() ? CVodeFree(&memory) : ARKStepFree(&memory);
    memory = nullptr;
  }
  bool bdf() const { return options.method == OdeMethod::bdf; }
  void require(int flag) const { require_success(flag, words.text); }

  FullState full_state(double time, const VectorView& state) const {
    FullState full{schedule(time), model->extend_from_free(state.head(n)), model->extend_from_free(state.tail(n)),
                   Eigen::VectorXd::Zero(model->unknowns())};
    model->impose_supports(full.p, full.u);
    const Params before = schedule(time - support_step), after = schedule(time + support_step);
    if (model->support_moves(before, full.p) || model->support_moves(full.p, after)) {
      Eigen::VectorXd past = full.a, now = full.a, next = full.a;
      model->impose_supports(before, past);
      model->impose_supports(full.p, now);
      model->impose_supports(after, next);
      full.v += (next - past) / (2 * support_step);
      full.a = ((next - now) - (now - past)) / (support_step * support_step);
    }
    return full;
  }

  Eigen::VectorXd accelerate(const Eigen::VectorXd& out_of_balance) const {
    return -mass_factor.solve(model->restrict_to_free(out_of_balance));
  }

  /// (v, -M^-1 (dPi/du + damping + M_fs a_s)); false for infeasible states.
  bool right_hand_side(double time, const VectorView& state, VectorView rate) const {
    const FullState full = full_state(time, state);
    const TimeStep step = full.time_step(1, full.a, tau);
    Eigen::VectorXd gradient;
    Assembly out;
    out.gradient = &gradient;
    model->evaluate({full.u, full.p, &step}, out);
    if (!std::isfinite(out.energy)) return false;
    rate.head(n) = state.tail(n);
    rate.tail(n) = accelerate(gradient);
    return rate.allFinite();
  }

  /// The derivative of R = M a + dPi/du + damping with respect to p_index, with du and dv following:
  /// du' = dv, M dv' = -(dM/dp a + d2Pi/dudp + K du + C dv).
  void sensitivity_rates(double time, const VectorView& state, const VectorView& rate, N_Vector* s,
                         N_Vector* s_rate) const {
    const FullState full = full_state(time, state);
    const TimeStep accelerated = full.time_step(1, full.a + model->extend_from_free(rate.tail(n)), tau);
    const TimeStep damped = full.time_step(0, full.a, tau);
    const Point point{full.u, full.p, &damped};
    for (size_t k = 0; k < tracked.size(); ++k) {
      const VectorView derivative = view(s[k]);
      const Eigen::VectorXd su = model->extend_from_free(derivative.head(n)) + model->support_derivative(tracked[k]);
      const Eigen::VectorXd sv = model->extend_from_free(derivative.tail(n));
      const Eigen::VectorXd residual = model->parameter_gradient({full.u, full.p, &accelerated}, tracked[k]) +
                                       model->hessian_times(point, su) +
                                       model->history_product(point, History::previous, su - tau * sv, false);
      view(s_rate[k]).head(n) = derivative.tail(n);
      view(s_rate[k]).tail(n) = accelerate(residual);
    }
  }

  /// Factorises M / gamma^2 + C / gamma + K: what an implicit Euler step of length gamma minimises.
  bool factorise(double time, const VectorView& state, double step_gamma) {
    gamma = step_gamma;
    const FullState full = full_state(time, state);
    const TimeStep step = full.time_step(1 / (gamma * gamma), Eigen::VectorXd::Zero(full.u.size()), gamma);
    for (Curvature curvature : {Curvature::exact, Curvature::projected}) {
      if (!std::isfinite(hessian.assemble({full.u, full.p, &step}, curvature, nullptr).energy)) return false;
      if (!hessian.factorise()) continue;
      Assembly out = stiffness.target(*model, curvature);
      model->evaluate({full.u, full.p}, out);
      return true;
    }
    return false;
  }

  /// (I - gamma J) x = b with b = (bu, bv), x = (xu, xv): from xu = bu + gamma xv there remains
  /// (M + gamma C + gamma^2 K) xv = M bv - gamma K bu.
  void solve(const VectorView& b, VectorView x) const {
    const Eigen::VectorXd w = hessian.solve(mass.times(*model, b.tail(n)) / gamma - stiffness.times(*model, b.head(n)));
    x.head(n) = b.head(n) + w;
    x.tail(n) = w / gamma;
  }

  static int rhs_callback(realtype t, N_Vector y, N_Vector rate, void* self) {
    return static_cast<Implementation*>(self)->right_hand_side(t, view(y), view(rate)) ? 0 : 1;  // 1: recoverable
  }
  static int sensitivity_callback(int, realtype t, N_Vector y, N_Vector rate, N_Vector* s, N_Vector* s_rate, void* self,
                                  N_Vector, N_Vector) {
    static_cast<Implementation*>(self)->sensitivity_rates(t, view(y), view(rate), s, s_rate);
    return 0;
  }
  static int bdf_system(realtype t, N_Vector y, N_Vector, SUNMatrix, booleantype, booleantype* current, realtype gamma,
                        void* self, N_Vector, N_Vector, N_Vector) {
    *current = SUNTRUE;
    return static_cast<Implementation*>(self)->factorise(t, view(y), gamma) ? 0 : 1;
  }
  static int runge_kutta_system(realtype t, N_Vector y, N_Vector, SUNMatrix, SUNMatrix, booleantype,
                                booleantype* current, realtype gamma, void* self, N_Vector, N_Vector, N_Vector) {
    *current = SUNTRUE;
    return static_cast<Implementation*>(self)->factorise(t, view(y), gamma) ? 0 : 1;
  }

  void factorise_mass() {
    // The share of mass-proportional damping is rate[0] times that of inertia: nothing at all.
    FullState still{p, Eigen::VectorXd::Zero(model->unknowns()), Eigen::VectorXd::Zero(model->unknowns()), {}};
    const TimeStep step = still.time_step(1, still.v, 1e200);
    Assembly out = mass.target(*model, Curvature::exact);
    model->evaluate_inertia({still.u, p, &step}, out);
    if (!mass_factor.factorise(mass.values))
      throw InputError(
          "dynamics: the mass matrix is singular, but every free displacement needs a mass; add inertia to all "
          "regions");
  }

  void create_bdf() {
    memory = CVodeCreate(CV_BDF, context);
    require(CVodeSetErrHandlerFn(memory, SundialsWords::keep, &words));
    require(CVodeInit(memory, rhs_callback, t, y.get()));
    require(CVodeSVtolerances(memory, options.tolerance, absolute.get()));
    require(CVodeSetUserData(memory, this));
    require(CVodeSetMaxOrd(memory, options.order == 0 ? 2 : options.order));
    require(CVodeSetMaxStep(memory, options.longest_step));
    require(CVodeSetLinearSolver(memory, solver.solver(), solver.matrix()));
    require(CVodeSetLinSysFn(memory, bdf_system));
    sensitivities.clear();
    if (tracked.empty()) return;
    std::vector<N_Vector> s;
    for (size_t k = 0; k < tracked.size(); ++k) {
      sensitivities.push_back(context.vector(2 * n));
      s.push_back(sensitivities.back().get());
      view(s.back()).setZero();
    }
    scales.clear();
    for (int index : tracked) scales.push_back(p[index] == 0 ? 1.0 : std::abs(p[index]));
    const int count = static_cast<int>(tracked.size());
    require(CVodeSensInit(memory, count, CV_STAGGERED, sensitivity_callback, s.data()));
    require(CVodeSetSensParams(memory, nullptr, scales.data(), nullptr));
    require(CVodeSensEEtolerances(memory));
    require(CVodeSetSensErrCon(memory, SUNTRUE));
  }

  void create_runge_kutta() {
    const bool implicit = options.method == OdeMethod::implicit_runge_kutta;
    memory = ARKStepCreate(implicit ? nullptr : rhs_callback, implicit ? rhs_callback : nullptr, t, y.get(), context);
    require(ARKStepSetErrHandlerFn(memory, SundialsWords::keep, &words));
    require(ARKStepSVtolerances(memory, options.tolerance, absolute.get()));
    require(ARKStepSetUserData(memory, this));
    require(ARKStepSetMaxStep(memory, options.longest_step));
    if (!implicit) {
      require(ARKStepSetOrder(memory, options.order == 0 ? 4 : options.order));
      return;
    }
    require(ARKStepSetTableNum(memory, implicit_table(options.order), ARKODE_ERK_NONE));
    require(ARKStepSetLinearSolver(memory, solver.solver(), solver.matrix()));
    require(ARKStepSetLinSysFn(memory, runge_kutta_system));
    // A stiff body that turns defeats the defaults (stage values predicted by the last state, old factors, and stage
    // derivatives that carry Newton's error times the stiffness): five times the steps at a stiffness ratio of 1e4, and
    // now and then a wrong result that is taken for converged.
    require(ARKStepSetPredictorMethod(memory, 1));
    require(ARKStepSetLSetupFrequency(memory, 1));
    require(ARKStepSetDeduceImplicitRhs(memory, SUNTRUE));
  }

  /// Latest time at which the next step may end: what the method wants, at most four times the last step, and no
  /// further than half the way to a contact at the present velocity and acceleration.
  double latest_end(double until) const {
    double next = until - t;
    if (report.steps > 0) {
      double wanted = 0;
      bdf() ? CVodeGetCurrentStep(memory, &wanted) : ARKStepGetCurrentStep(memory, &wanted);
      next = std::min(next, std::max(wanted, 4 * last_step));
    }
    const double reach = 2 * next;
    const double limit = model->step_limit({u, p}, reach * v + 0.5 * reach * reach * acceleration);
    // Within a millionth of the step nothing is gained: the barrier decides then.
    if (limit < 1) next = std::max(0.5 * limit * reach, 1e-6 * next);
    return std::min(until, t + next);
  }

  bool stop(OdeStatus status, std::string why) {
    report.status = status;
    report.words = std::move(why);
    return false;
  }

  bool stop_short_of(double end) {
    return stop(OdeStatus::passed_through,
                fmt::format("between t = {:.6g} s and {:.6g} s something may have been passed through; use a shorter "
                            "longest step or a smaller tolerance",
                            t, end));
  }

  bool advance_to(double until) {
    if (memory == nullptr) throw std::logic_error("advance_to() needs a start()");
    for (int taken = 0; report.status == OdeStatus::going && t < until; ++taken) {
      if (taken == options.max_steps)
        return stop(OdeStatus::step_limit, fmt::format("t = {:.6g} s after {} steps", t, taken));
      const double end = latest_end(until);
      double reached = t;
      int flag;
      if (bdf()) {
        require(CVodeSetStopTime(memory, end));
        flag = CVode(memory, until, y.get(), &reached, CV_ONE_STEP);
      } else {
        require(ARKStepSetStopTime(memory, end));
        flag = ARKStepEvolve(memory, until, y.get(), &reached, ARK_ONE_STEP);
      }
      count();
      // The new state itself may turn out to be inadmissible, when it is too late for a shorter step.
      static_assert(CV_UNREC_RHSFUNC_ERR == ARK_UNREC_RHSFUNC_ERR);
      if (flag == CV_UNREC_RHSFUNC_ERR) return stop_short_of(end);
      if (flag < 0) return stop(OdeStatus::failed, words.text);
      if (!accept(reached)) return stop_short_of(reached);
    }
    if (!tracked.empty() && report.status == OdeStatus::going) read_sensitivities();
    return report.status == OdeStatus::going;
  }

  /// Makes the integrator's state ours, unless it is inadmissible or beyond something.
  bool accept(double reached) {
    FullState full = full_state(reached, view(y.get()));
    Assembly out;
    model->evaluate({full.u, full.p}, out);
    if (!std::isfinite(out.energy) || model->step_limit({u, p}, full.u - u) < 1) return false;
    if (reached > t) {
      last_step = reached - t;
      acceleration = (full.v - v) / last_step;
    }
    t = reached;
    p = std::move(full.p);
    u = std::move(full.u);
    v = std::move(full.v);
    return true;
  }

  void count() {
    const auto number = [&](auto of_cvode, auto of_arkode) {
      long count = 0;
      bdf() ? of_cvode(memory, &count) : of_arkode(memory, &count);
      return static_cast<int>(count);
    };
    report.steps = number(CVodeGetNumSteps, ARKStepGetNumSteps);
    report.evaluations = number(CVodeGetNumRhsEvals, [](void* arkode, long* all) {
      long of_explicit = 0, of_implicit = 0;
      const int flag = ARKStepGetNumRhsEvals(arkode, &of_explicit, &of_implicit);
      *all = of_explicit + of_implicit;
      return flag;
    });
    report.newton_iterations = number(CVodeGetNumNonlinSolvIters, ARKStepGetNumNonlinSolvIters);
    report.factorisations = hessian.factorisations() - factorisations_before;
    report.error_test_failures = number(CVodeGetNumErrTestFails, ARKStepGetNumErrTestFails);
    report.convergence_failures = number(CVodeGetNumStepSolveFails, ARKStepGetNumStepSolveFails);
    if (!tracked.empty()) report.sensitivity_evaluations = number(CVodeGetSensNumRhsEvals, CVodeGetSensNumRhsEvals);
  }

  void read_sensitivities() {
    std::vector<N_Vector> s;
    for (const NVector& one : sensitivities) s.push_back(one.get());
    double time = 0;
    if (report.steps > 0) require(CVodeGetSens(memory, &time, s.data()));
    du.resize(model->unknowns(), s.size());
    dv.resize(model->unknowns(), s.size());
    for (size_t k = 0; k < s.size(); ++k) {
      du.col(k) = model->extend_from_free(view(s[k]).head(n)) + model->support_derivative(tracked[k]);
      dv.col(k) = model->extend_from_free(view(s[k]).tail(n));
    }
  }

  const Model* model;
  OdeOptions options;
  Eigen::Index n;
  SundialsContext context;
  SundialsWords words;
  NVector y, absolute;
  std::vector<NVector> sensitivities;
  std::vector<double> scales;  ///< of the tracked parameters; CVODES keeps a pointer to them
  Cholesky mass_factor;
  SymmetricMatrix mass, stiffness;
  Hessian hessian;  ///< factor of M / gamma^2 + C / gamma + K
  double gamma = 0;
  CallbackSolver solver;
  void* memory = nullptr;
  Schedule schedule;
  std::vector<int> tracked, to_track;  ///< since start(), and from the next one on

  double t = 0, last_step = 0;
  Params p;
  Eigen::VectorXd u, v, acceleration;
  Eigen::MatrixXd du, dv;
  OdeReport report;
  int factorisations_before = 0;
};

OdeIntegrator::OdeIntegrator(const Model& model, OdeOptions options) {
  const auto [lowest, highest] = options.method == OdeMethod::bdf                    ? std::pair(1, 5)
                                 : options.method == OdeMethod::explicit_runge_kutta ? std::pair(2, 8)
                                                                                     : std::pair(2, 5);
  if (options.order != 0 && (options.order < lowest || options.order > highest))
    throw InputError(
        fmt::format("dynamics: order {} is not one of the method's; allowed are {} to {}, and 0 for the "
                    "default",
                    options.order, lowest, highest));
  if (!(options.tolerance > 0))
    throw InputError(fmt::format("dynamics: tolerance {} is not positive; 1e-4 is usual", options.tolerance));
  implementation_ = std::make_unique<Implementation>(model, options);
}

OdeIntegrator::~OdeIntegrator() = default;
OdeIntegrator::OdeIntegrator(OdeIntegrator&&) noexcept = default;
OdeIntegrator& OdeIntegrator::operator=(OdeIntegrator&&) noexcept = default;

void OdeIntegrator::track(std::vector<int> indices) {
  if (!implementation_->bdf() && !indices.empty())
    throw InputError("dynamics: only the method bdf follows derivatives; choose it, or track nothing");
  const int size = implementation_->model->parameters().size();
  for (int index : indices) {
    if (index < 0 || index >= size)
      throw InputError(fmt::format("dynamics: parameter {} cannot be tracked; allowed are 0 to {}", index, size - 1));
  }
  implementation_->to_track = std::move(indices);
}

void OdeIntegrator::start(double t, const Eigen::VectorXd& u, const Eigen::VectorXd& v, Schedule schedule) {
  Implementation& self = *implementation_;
  self.free_memory();
  self.schedule = std::move(schedule);
  self.tracked = self.to_track;
  self.report = {};
  self.words.text.clear();
  self.hessian.forget_couplings();
  self.factorisations_before = self.hessian.factorisations();
  VectorView state = view(self.y.get());
  state << self.model->restrict_to_free(u), self.model->restrict_to_free(v);
  const FullState full = self.full_state(t, state);
  self.t = t;
  self.p = full.p;
  self.u = full.u;
  self.v = full.v;
  self.acceleration = Eigen::VectorXd::Zero(u.size());
  self.factorise_mass();
  self.bdf() ? self.create_bdf() : self.create_runge_kutta();
  if (!self.tracked.empty()) self.read_sensitivities();
  Assembly out;
  self.model->evaluate({self.u, self.p}, out);
  if (!std::isfinite(out.energy)) self.stop(OdeStatus::infeasible_start, "the start has energy +inf");
}

bool OdeIntegrator::advance_to(double t) {
  return implementation_->advance_to(t);
}

double OdeIntegrator::t() const {
  return implementation_->t;
}
const Eigen::VectorXd& OdeIntegrator::u() const {
  return implementation_->u;
}
const Eigen::VectorXd& OdeIntegrator::v() const {
  return implementation_->v;
}
const Eigen::MatrixXd& OdeIntegrator::du() const {
  return implementation_->du;
}
const Eigen::MatrixXd& OdeIntegrator::dv() const {
  return implementation_->dv;
}
const OdeReport& OdeIntegrator::report() const {
  return implementation_->report;
}

}  // namespace taut

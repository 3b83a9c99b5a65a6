#pragma once
#include <Eigen/Core>
#include <functional>
#include <vector>

#include "sim/model/model.hpp"
#include "sim/solve/equilibrium.hpp"

namespace taut {

/// All parameters as functions of time [s]: material constants stay, controls (retractions, joint angles, loads) move.
using Schedule = std::function<Params(double t)>;

/// Implicit one- and two-step methods, written as the minimisation of a potential. Numerical damping ratio of a mode
/// with angular frequency w: about w h / 2 for implicit Euler, (w h)^3 / 4 for BDF2, for small w h.
enum class Integrator {
  implicit_euler,  ///< order 1, Eq. 2 of the push-puppet paper
  bdf2             ///< order 2, variable steps; its first step, and those after restart(), are implicit Euler
};

/// Method, steps and errors.
struct TimeStepperOptions {
  Integrator integrator = Integrator::implicit_euler;
  double step = 1e-3;      ///< [s]; with a tolerance the first one and the longest
  double tolerance = 0;    ///< estimated error of a step relative to the bounding-box diagonal; 0: fixed steps
  double shortest = 1e-6;  ///< a failed step is halved down to this fraction of `step`
  EquilibriumOptions equilibrium;
};

/// What was done since start().
struct TimeStepperReport {
  int steps = 0;       ///< accepted
  int failures = 0;    ///< solves that failed and were repeated with half the step
  int rejections = 0;  ///< steps repeated because their estimated error was too large
  int iterations = 0, factorisations = 0;
  SolveStatus status = SolveStatus::converged;  ///< of the last solve
};

/// One accepted step: the state at its end, and what the potential that it minimises knew of the past.
struct AcceptedStep {
  double t = 0, h = 0;   ///< its end and its length [s]
  Eigen::VectorXd u, v;  ///< [m], [m/s], all unknowns
  Params p;
  TimeStep step;
};

/// Implicit dynamics by minimisation: M a = -dPi/du in each step, as u_(n+1) = argmin of
/// rate^2/2 |u - reference|_M^2 + Pi(u; p(t_(n+1))) + damping, by the minimiser of Equilibrium, so contact limits each
/// Newton step and nothing passes through anything. A start is taken for one that was come to at once, from rest.
/// Supports move as p(t) says. A step whose solve fails is halved, never accepted. One object per thread.
class TimeStepper {
 public:
  /// The model has to outlive it; start() comes first.
  explicit TimeStepper(const Model& model, TimeStepperOptions options = {});

  /// Begins at time t with displacements u and velocities v; supports are imposed. `du` are the derivatives of u that
  /// track() goes on from, (unknowns x count); empty: zero.
  void start(double t, const Eigen::VectorXd& u, const Eigen::VectorXd& v, const Schedule& schedule,
             const Eigen::MatrixXd& du = {});
  /// What is remembered there, with its derivatives, where that was not come to at once from rest: as of QuasiStatics.
  void remember(const Eigen::VectorXd& memory, const Eigen::MatrixXd& dmemory) {
    memory_ = memory;
    dmemory_ = dmemory;
  }
  /// One accepted step, not beyond `until`. False when even the shortest step fails, or on interruption: the state
  /// stays.
  bool advance(double until);
  /// Takes the next BDF2 step as implicit Euler: after an impact or a kink of the schedule.
  void restart() { before_.clear(); }

  double t() const { return now_.t; }                          ///< present time [s]
  const Eigen::VectorXd& u() const { return now_.u; }          ///< [m], all unknowns
  const Eigen::VectorXd& v() const { return now_.v; }          ///< [m/s], all unknowns
  const Params& p() const { return now_.p; }                   ///< parameters and controls at t()
  const AcceptedStep& last() const { return now_; }            ///< what the last step came to
  const TimeStepperReport& report() const { return report_; }  ///< since start()

  /// Follows the derivatives of the state with respect to `count` numbers theta on which the schedule depends, from
  /// those given to start() (velocities: from zero); `derivative` gives dp/dtheta (parameters x count) at a time. They
  /// are those of the accepted steps, whose lengths count as given.
  void track(int count, std::function<Eigen::MatrixXd(double t)> derivative);
  const Eigen::MatrixXd& du() const { return du_; }                   ///< du/dtheta, (unknowns x count)
  const Eigen::MatrixXd& dv() const { return dv_; }                   ///< dv/dtheta, (unknowns x count)
  const Eigen::MatrixXd& dreference() const { return dreference_; }   ///< of last().step.reference; zero at the start
  const Eigen::MatrixXd& dmemory() const { return dmemory_before_; }  ///< of last().step.memory; empty at the start

 private:
  Eigen::VectorXd predicted(double h, const Params& p, const TimeStep& step) const;
  void forget_derivatives();
  void remember_start();
  void follow_derivatives(bool two_steps);

  const Model* model_;
  TimeStepperOptions options_;
  Equilibrium minimiser_;
  Schedule schedule_;
  AcceptedStep now_;
  std::vector<AcceptedStep> before_;  ///< the one before, for BDF2; empty after a restart
  double next_step_ = 0;
  TimeStepperReport report_;
  std::function<Eigen::MatrixXd(double)> derivative_;
  int tracked_ = 0;
  Eigen::MatrixXd du_, dv_, du_before_, dv_before_, dreference_;
  Eigen::VectorXd memory_;  ///< Model::remember() at now_
  Eigen::MatrixXd dmemory_, dmemory_before_;
};

/// Derivatives of a number of a trajectory.
struct TrajectoryGradient {
  Eigen::MatrixXd parameters;  ///< dQ/dp_index at each step, (indices x steps)
  Eigen::VectorXd start;       ///< dQ/du at the start, all unknowns
};

/// Derivatives of a number Q(u_1, ..., u_n) of a trajectory with respect to parameters in every step, and to where it
/// started, by the discrete adjoint method: one backward pass of linear solves whatever the number of controls. For
/// models without memory. `steps` are the accepted steps in order (all of one start, whose state is not among them),
/// `gradients` dQ/du_k of each (empty: zero). Throws std::logic_error when a step's exact Hessian is not positive
/// definite.
TrajectoryGradient adjoint_gradient(const Model& model, const std::vector<AcceptedStep>& steps,
                                    const std::vector<Eigen::VectorXd>& gradients, const std::vector<int>& indices);

}  // namespace taut

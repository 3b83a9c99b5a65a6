#pragma once
#include <Eigen/Core>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "sim/model/model.hpp"
#include "sim/solve/time_stepper.hpp"

namespace taut {

/// Methods of SUNDIALS with error control and steps of their own choice.
enum class OdeMethod {
  bdf,                   ///< CVODE, backward differentiation, orders 1 to 5
  explicit_runge_kutta,  ///< ARKODE, steps bound by 2.8 / (highest angular frequency of the mesh) or so
  implicit_runge_kutta   ///< ARKODE, singly diagonally implicit, L-stable and stiffly accurate
};

/// Method, errors and steps.
struct OdeOptions {
  OdeMethod method = OdeMethod::bdf;
  /// Estimated error of a step, relative; absolute it is this x 1e-2 L for displacements and this x L/s for velocities,
  /// L the bounding-box diagonal. Both matter: with one number for both, the velocities of stiff nodes would rule.
  double tolerance = 1e-4;
  /// bdf: the highest one, 1 to 5 (0: 2). Orders above 2 are not stable for undamped ringing, whose modes sit on the
  /// imaginary axis: their steps shrink to its period. Explicit: 2 to 8 (0: 4). Implicit Runge-Kutta: 2 TRBDF2,
  /// 3 ESDIRK324L2SA, 4 ESDIRK436L2SA, 5 ESDIRK547L2SA2 (0: 3).
  int order = 0;
  double longest_step = 0;    ///< [s]; 0: no limit
  int max_steps = 1'000'000;  ///< accepted steps in one advance_to()
};

/// How an integration stands.
enum class OdeStatus {
  going,             ///< all asked for was reached
  infeasible_start,  ///< the start has energy +inf
  passed_through,    ///< in one step something may have been passed through, or an inadmissible state was accepted
  step_limit,        ///< max_steps were not enough
  failed             ///< SUNDIALS gave up: `words`
};
std::string_view name_of(OdeStatus status);  ///< "passed through"

/// What was done since start().
struct OdeReport {
  OdeStatus status = OdeStatus::going;
  int steps = 0;                    ///< accepted
  int evaluations = 0;              ///< right-hand sides
  int newton_iterations = 0;        ///< of the implicit methods
  int factorisations = 0;           ///< of M + gamma C + gamma^2 K
  int error_test_failures = 0;      ///< steps repeated because their estimated error was too large
  int convergence_failures = 0;     ///< steps repeated because Newton's method failed or met infeasible states
  int sensitivity_evaluations = 0;  ///< right-hand sides of all tracked derivatives
  std::string words;                ///< why it stopped, empty while it is going
  std::string message() const;      ///< one phrase for people
};

/// The dynamics of a model as an ordinary differential equation, by SUNDIALS (Hindmarsh et al. 2005):
///
///     u' = v,   M v' = -dPi/du(u; p(t)) - damping(u, v)      on the free unknowns,
///
/// for comparison with TimeStepper: another formulation, other methods, errors under control. Newton's matrix of all
/// implicit methods comes down to the symmetric M + gamma C + gamma^2 K, factorised by Cholesky; where K makes it
/// indefinite, K is projected.
///
/// Supports move as the schedule says: their velocities and accelerations are central differences of it over 1e-4 s, so
/// it is asked that much before and after any time too. A jump of a support's velocity is smeared over that time.
/// Masses stay those of the start.
///
/// Infeasible states (an element inside out, a node on an edge) make a step be repeated shorter. But these methods know
/// no contact: a step may end, feasible, on the far side of an obstacle. So no step is longer than half the time to the
/// next contact at the present velocity and acceleration, and after each step the straight way from the last state is
/// checked: where Model::step_limit is below 1 the integration stops with `passed_through`. Forces that come up within
/// a step can do that; so can a step in which a distance falls below a fifth without harm, as step_limit is cautious. A
/// shorter longest_step or a smaller tolerance is the remedy. TimeStepper has no such limit.
///
/// One object per thread; the model has to outlive it.
class OdeIntegrator {
 public:
  /// Throws InputError for a tolerance that is not positive and for orders that the method does not have.
  explicit OdeIntegrator(const Model& model, OdeOptions options = {});
  ~OdeIntegrator();
  OdeIntegrator(OdeIntegrator&&) noexcept;             ///< takes over the integration
  OdeIntegrator& operator=(OdeIntegrator&&) noexcept;  ///< takes over the integration

  /// Follows du/dp_index and dv/dp_index of these parameters from the next start() on, from zero on the free unknowns;
  /// the schedule must not change them in time. By the staggered corrector of CVODES, the derivatives under error
  /// control as well (at scale p_index, or 1 where that is zero): independent of the derivatives of TimeStepper. A
  /// parameter may be one of the mass. Throws InputError when the method is not bdf or an index is not in the table.
  void track(std::vector<int> indices);
  /// Begins at time t with displacements u and velocities v, all unknowns; supports are imposed. Throws InputError when
  /// a free displacement has no mass.
  void start(double t, const Eigen::VectorXd& u, const Eigen::VectorXd& v, Schedule schedule);
  /// Goes to time t, as many steps as it takes, the last one ending there. False when it stopped before, for the reason
  /// in report(); the state is then the last sound one, and start() the only way on.
  bool advance_to(double t);

  double t() const;                   ///< present time [s]
  const Eigen::VectorXd& u() const;   ///< [m], all unknowns
  const Eigen::VectorXd& v() const;   ///< [m/s]
  const Eigen::MatrixXd& du() const;  ///< du/dp, (unknowns x tracked), at t()
  const Eigen::MatrixXd& dv() const;  ///< dv/dp, at t()
  const OdeReport& report() const;    ///< since start()

 private:
  struct Implementation;
  std::unique_ptr<Implementation> implementation_;
};

}  // namespace taut

#pragma once
#include <Eigen/Core>
#include <array>
#include <atomic>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "sim/model/model.hpp"
#include "sim/solve/hessian.hpp"
#include "sim/solve/motion.hpp"

namespace taut {

/// How a solve ended.
enum class SolveStatus {
  converged,
  infeasible_start,  ///< the start has energy +inf (inverted elements)
  iteration_limit,   ///< Newton's method did not meet the tolerances in the iterations allowed
  stalled,           ///< no acceptable step although the tolerances are not met
  not_a_minimum,     ///< a stationary point that is a saddle, and no minimum was found by leaving it
  not_held,          ///< a body without supports moves as a whole, and no force holds it back
  load_step_limit,   ///< load steps were halved until the smallest one failed too
  interrupted        ///< the caller's stop flag was raised
};
std::string_view name_of(SolveStatus status);  ///< "stalled"

/// Which trial steps a line search takes.
enum class LineSearch {
  watchdog,  ///< sufficient decrease, a full step on trust once, gradients where energies drown in rounding
  armijo,    ///< sufficient decrease of the energy alone; for comparison
  none       ///< every step in full, whatever the energy does; for comparison
};

/// How an equilibrium is searched. The defaults serve statics with stiffness ratios up to 1e6.
struct EquilibriumOptions {
  int max_iterations = 40;         ///< Newton iterations per load step before it is halved; after buckling 4 times this
  double step_tolerance = 1e-9;    ///< largest component of the last Newton step, relative to the bounding-box diagonal
  double rough_tolerance = 1e-6;   ///< the same for Polish::rough
  int max_halvings = 10;           ///< smallest load step is 2^-max_halvings of the whole
  int max_total_iterations = 400;  ///< over all load steps of one solve
  int load_steps = 1;              ///< equal steps to begin with; failed ones are halved, as max_halvings allows
  bool check_minimum = true;       ///< leave saddle points (buckling) and say so
  double dear = 8;                 ///< price of a factorisation, in solves, from which Newton's steps are iterated
  bool check_path = false;         ///< look for slips to another equilibrium between load steps, and shorten them there
  const std::atomic<bool>* stop = nullptr;  ///< raised by another thread or a signal handler: end soon
  /// What other solvers do, for comparison only: nothing but the stability chart (calib/studies/stability.cpp) and the
  /// tests that show where each of them fails (tests/verification/stress_*_test.cpp) sets these.
  struct Comparison {
    bool always_project = false;  ///< project the Hessian in every iteration
    LineSearch line_search = LineSearch::watchdog;
    bool straight_steps = false;  ///< stiff bodies do not turn with the step
    bool ignore_contact = false;  ///< steps are not cut where something would be passed through
    double stop_at_force = 0;     ///< converged when the largest out-of-balance force [N] is below this; 0: by the step
  };
  Comparison comparison = {};
};

/// What a solve took and how it ended.
struct SolveReport {
  SolveStatus status = SolveStatus::converged;
  int iterations = 0;        ///< Newton iterations, all load steps
  int factorisations = 0;    ///< Cholesky factorisations, failed ones included
  int projections = 0;       ///< iterations that needed a projected Hessian
  int load_steps = 0;        ///< load steps taken; 1 means that the whole load was taken at once
  bool left_saddle = false;  ///< the path met an unstable equilibrium and left it
  /// Where both sides of that were alike (a symmetric bifurcation): the direction, "+y", in which the side that was
  /// taken goes; which one that is follows from the mode's shape alone. "": no such choice was made.
  std::string side;
  bool not_tried = false;               ///< the state that it starts from failed
  bool slipped = false;                 ///< the path went to another equilibrium, not to the next one of its own
  double slipped_after = 0;             ///< fraction of the load change at which that happened
  double reached = 0;                   ///< fraction of the load change that was reached
  double gradient = 0;                  ///< largest out-of-balance nodal force at the end [N]
  std::string loose;                    ///< not_held: which body it is, "body 'platform'"
  std::string message() const;          ///< one phrase for people
  std::string held_by_nothing() const;  ///< not_held: which body, and what to do
};

/// How far an equilibrium is polished.
enum class Polish {
  full,    ///< to step_tolerance, and the kept factor is of a state within that
  search,  ///< to step_tolerance, but the last steps go with the factor before them as long as that has changed by a
           ///< tenth at most; one correction leaves the square of that in sensitivities. For searches whose end is
           ///< computed again
  rough    ///< the same to rough_tolerance, and the first steps go with the factor of the last equilibrium as long as
           ///< each is a tenth of the one before it: near that one no factorisation at all, and no proof of a minimum
};

/// Static equilibrium u* = argmin_u Pi(u; p): Newton's method on the exact Hessian, projected or shifted only when its
/// Cholesky factorisation fails (where factorisations are dear, steps to 3 % by conjugate gradients with the last
/// factor, and one factorisation at the end, which shows that it is a minimum), with a line search that survives the
/// rounding floor; load stepping from the last equilibrium when the whole change is too much at once.
///
/// An unstable equilibrium on the way (buckling) is left along its lowest mode, to the side of lower energy. Where both
/// sides are alike the sign of a fixed average of the mode decides, so that all solves of a model fall to the same
/// side. Where several modes are unstable, or the way from there leads to the other side, or rounding alone decided
/// where a search ended (a push of 1e-7 of the size leads elsewhere), the load step is halved until the path meets the
/// first one alone.
///
/// Bodies that no support holds (Model::loose_bodies()) have an equilibrium where cables or contact hold them in every
/// direction: the Hessian is positive definite, rigid motions included. Keeps the last equilibrium, its factorised
/// exact Hessian and the symbolic analysis: the next solve starts from there. One object per thread.
class Equilibrium {
 public:
  /// The model has to outlive it; one of the starts comes before the first solve.
  explicit Equilibrium(const Model& model, EquilibriumOptions options = {});

  const Model& model() const { return *model_; }         ///< as it was given
  const Eigen::VectorXd& u() const { return u_; }        ///< last equilibrium, all unknowns [m]
  const Params& p() const { return p_; }                 ///< its parameters
  bool has_factor() const { return has_factor_; }        ///< the exact Hessian at u() is factorised
  const SolveReport& report() const { return report_; }  ///< of the last solve
  /// Solves H x = b with the kept factor of the exact Hessian, on all unknowns, zero at the supports; shape (n x k).
  /// Throws std::logic_error without a factor.
  Eigen::MatrixXd solve_linear(const Eigen::MatrixXd& b) const;
  /// Factorises the exact Hessian at u() if that is not what is kept; false when it is not positive definite.
  bool refactorise();

  /// Forgets the past: rest shape at `p`, in which loads and prescribed displacements are expected to be zero.
  void start_at_rest(const Params& p);
  /// What was factorised before has no part in what follows.
  void drop_factor() { has_factor_ = false, hessian_.drop_factor(); }
  /// Couplings (row, column) that the Hessian has room for besides the model's own, since the last start at rest; with
  /// the same ones another object solves the same to the bit.
  std::vector<std::array<int, 2>> couplings() const { return hessian_.couplings(); }
  void expect(const std::vector<std::array<int, 2>>& couplings) { hessian_.expect(couplings); }  ///< see couplings()
  /// Sets a known state as the start of the next solve.
  void start_at(const Eigen::VectorXd& u, const Params& p);
  /// Sets u + step as the start, or as much of that step as is admissible.
  void start_beyond(const Eigen::VectorXd& u, const Eigen::VectorXd& step, const Params& p);

  /// Moves from the current state to the equilibrium at `p`. On failure the state stays at the last equilibrium that
  /// was reached on the way (report().reached of the change). Within a `step` without inertia stresses relax as it
  /// says; it has to live on as that of solve_step().
  const SolveReport& solve(const Params& p, Polish polish = Polish::full, const TimeStep* step = nullptr);

  /// Minimises the potential of one time step at `p` from `start` (supports imposed), without load stepping: the new
  /// state is u() when the report says converged; otherwise the last one stays. `step` has to live on, there or
  /// where step_moved_to() says, while this state is looked at.
  const SolveReport& solve_step(const Eigen::VectorXd& start, const Params& p, const TimeStep& step);
  void step_moved_to(const TimeStep& step) { step_ = &step; }  ///< see solve_step()

  /// du/dp_index for each of `indices`, shape (unknowns x indices), at the last equilibrium by the implicit function
  /// theorem, H du/dp = - d2Pi/du dp, from the kept factorisation. Throws std::logic_error without a factor.
  Eigen::MatrixXd sensitivities(const std::vector<int>& indices) const;
  /// How the last equilibrium, or the end of the last time step, changes where the parameters do like columns of `dp`
  /// and what else the gradient depends on changes that by columns of `force` [N]; shape (unknowns x columns). Throws
  /// std::logic_error without a factor.
  Eigen::MatrixXd response(const Eigen::MatrixXd& dp, Eigen::MatrixXd force) const;

 private:
  struct NewtonResult {
    SolveStatus status;
    bool exact_factor;  ///< the kept factor is of the exact Hessian, one last step within the tolerance before the
                        ///< final u
  };
  /// Newton's step on the free unknowns.
  struct Direction {
    bool exact_factor = false;  ///< the factor of the exact Hessian there is kept
    Eigen::VectorXd gradient, step;
    double slope = 0;  ///< < 0, twice the predicted decrease
  };
  /// A step that was tried: where it began, and how far it went.
  struct Step {
    Eigen::VectorXd u, step;
    Assembly energy;
    double slope = 0, fraction = 1;
  };
  bool find_direction(const Eigen::VectorXd& u, const Params& p, Direction& to);
  bool better_by_gradient(const Eigen::VectorXd& trial, const Params& p, const Direction& way) const;
  bool shorten(const Step& from, const Params& p, Eigen::VectorXd& u, Assembly& energy) const;
  NewtonResult minimise(Eigen::VectorXd& u, const Params& p);
  double tolerance() const;
  std::optional<double> refine(Eigen::VectorXd& u, const Params& p, double before);
  Eigen::VectorXd lowest_mode(const Eigen::VectorXd& besides) const;
  std::string heading(const Eigen::VectorXd& direction) const;
  bool leave_saddle(Eigen::VectorXd& u, const Params& p);
  bool lost_its_way(const Eigen::VectorXd& u) const;
  bool factorise_shifted(const Eigen::VectorXd& u, const Params& p, Assembly& out);
  Eigen::VectorXd push() const;
  double first_step() const;
  bool search(Eigen::VectorXd& u, const Params& p);
  bool accept(const Eigen::VectorXd& u, const Params& p, const Eigen::VectorXd& predicted, bool checked,
              bool can_be_shorter);
  bool goes_on_shorter(const Params& next, bool allowed);
  bool goes_on_patiently(double& step, int& most_iterations);
  bool drifted(const Eigen::VectorXd& u, const Eigen::VectorXd& start, const Params& p);
  bool is_held(const Eigen::VectorXd& u, const Params& p);
  SolveStatus settle(Eigen::VectorXd& u, const Params& p);
  bool follow(Eigen::VectorXd& u, const Params& p);
  Eigen::VectorXd predicted_step(const Params& p, bool stiffness_by_reciprocal) const;
  Eigen::VectorXd predict(const Params& p) const;
  bool passes_through(const Params& p, const Eigen::VectorXd& u) const;
  bool slipped(const Eigen::VectorXd& u_before, const Params& p_before, const Eigen::VectorXd& predicted) const;
  void advance(const Params& p, bool check_path);
  Eigen::VectorXd right_hand_side(int index) const;
  bool factorise(bool& exact, const Eigen::VectorXd& u, const Params& p);
  Motion motion(const Params& p) const {
    return {*model_, p, options_.comparison.straight_steps, options_.comparison.ignore_contact};
  }
  Eigen::VectorXd free_gradient_at(const Eigen::VectorXd& u, const Params& p) const;
  Point at(const Eigen::VectorXd& u, const Params& p) const { return {u, p, step_}; }
  bool moves() const { return at(u_, p_).moves(); }
  bool stopped() const { return options_.stop != nullptr && options_.stop->load(); }

  const Model* model_;
  EquilibriumOptions options_;
  Hessian hessian_;
  Eigen::VectorXd u_;
  Params p_;
  const TimeStep* step_ = nullptr;  ///< the time step at work, if any
  bool has_factor_ = false;
  double hessian_changed_ = 0;  ///< in a search: by which part, since the kept factor was made
  Polish polish_ = Polish::full;
  bool buckling_ = false;  ///< a saddle was left on the way to the equilibrium that is searched now
  /// The saddle that was left last.
  struct Saddle {
    Eigen::VectorXd u, direction;  ///< where it was, and which way it was left
    bool several = false;          ///< more than one mode was unstable
  } saddle_;
  int indefinite_ = 0;    ///< states of the last search whose Hessian was indefinite
  double calmest_ = 0;    ///< the least out-of-balance force in one of those [N]
  double loudest_ = 0;    ///< the largest in all of them
  bool patient_ = false;  ///< short load steps have failed where Hessians were indefinite
  int probed_ = 0;        ///< factorisations that drifted() took since the last solve began
  SolveReport report_;
};

}  // namespace taut

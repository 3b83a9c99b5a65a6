#pragma once
#include <Eigen/Core>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "sim/model/channel.hpp"
#include "sim/scene/scene.hpp"
#include "sim/solve/equilibrium.hpp"
#include "sim/solve/tangent_stiffness.hpp"

namespace taut {

/// A control that the search may change: a cable's retraction, a joint's angle; SI.
struct IkControl {
  int index = 0;                ///< in the model's table
  double lower = 0, upper = 0;  ///< SI
  double nominal = 0;           ///< where it stays when the targets leave a choice
  double largest_step = 0;  ///< largest change in one equilibrium solve; 0: 30 degrees for angles, no limit for others
};

/// A quantity that is to take a value: a displacement, as a rule. Others go as well when the tolerance is meant for
/// them.
struct IkChannel {
  std::shared_ptr<const Channel> channel;
  double weight = 1;  ///< of its error, where not all targets can be met
};

/// How targets are searched for.
struct IkOptions {
  double tolerance = 1e-4;              ///< [m] of the error at which targets count as reached, and the search ends
  double stiffness_tolerance = 0.01;    ///< relative
  int max_iterations = 60;              ///< Levenberg-Marquardt steps of one search
  int restarts = 3;                     ///< other starts that are tried before a target counts as unreachable
  Eigen::VectorXd stiffness_direction;  ///< displacement weights c (mean_weights(), say) along which the end effector's
                                        ///< stiffness 1/(c^T H^-1 c) is meant; empty: stiffness is not controlled
  Params held;                          ///< values of the parameters that are no controls; empty: the scene's
  Params rest;                          ///< parameters of the shape at rest, without loads; empty: the scene's
  EquilibriumOptions equilibrium;
};

/// What a search came to.
enum class IkStatus {
  reached,
  unreachable,  ///< no controls within bounds were found that reach the targets; the result is the nearest point found
  failed        ///< no equilibrium was found at the start, or the search did not end
};
std::string_view name_of(IkStatus status);  ///< "reached"

/// What a search found.
struct IkResult {
  IkStatus status = IkStatus::failed;
  std::string message;                 ///< one sentence
  Eigen::VectorXd controls;            ///< SI, in the order of the controls
  Eigen::VectorXd achieved;            ///< values of the channels there
  double error = 0;                    ///< |achieved - targets|, without weights [m]
  double stiffness = 0;                ///< [N/m] along the direction in the options; 0 without one
  std::vector<int> bound;              ///< per control: -1 at its lower bound, 1 at its upper one, 0 between
  int iterations = 0;                  ///< Levenberg-Marquardt steps, all starts
  int solves = 0, factorisations = 0;  ///< of equilibria
  double seconds = 0;
};

/// Soft inverse kinematics: controls c within bounds whose static equilibrium u*(c) brings channels to targets and that
/// are as near to the nominal ones as that allows,
///
///   min_c  1/2 sum_j ((c_j - nominal_j)/(upper_j - lower_j))^2   with   |y(u*(c), c) - target| <= tolerance
///   [ and |ln k - ln k_target| <= stiffness tolerance ],
///
/// or, where nothing does, the least error of the weighted channels. By Levenberg-Marquardt within the bounds, du*/dc
/// by the implicit function theorem from the kept factor (Bern et al. 2019). Each step minimises the linear errors and,
/// among controls that do equally well, the distance to the nominal ones, whatever the tolerance is; the search ends
/// where the targets are met and no step would bring the controls nearer by 2 % of that distance. The first step
/// towards a target is thus along the tangent of the last one's answer. Equilibria on the way are solved to a
/// thousandth of the tolerance. Without a choice of controls, warm and cold searches end within the tolerance of each
/// other.
///
/// Where a trial shows that the effect of a control jumps on the way (a link comes to touch another one, a cable goes
/// slack), and the step does not keep its promise, that control is held at the jump, as at a bound, until going on to
/// one of its sides would bring the controls nearer to the nominal ones, or the targets are not reached with it.
///
/// A control that has no effect at the start (a slack cable) is moved towards its upper bound until it has one. Where
/// the targets are not reached, the search is repeated from other starts (nominal, mirrored, middle), which together
/// may take three times the factorisations of the first, and the best end counts. That guards against local minima
/// without excluding them. After a target that was out of reach the nearest point is followed from it without other
/// starts.
///
/// The stiffness of the end effector takes one back-solve (stiffness_along()), its slopes no solve of an equilibrium
/// (log_stiffness_slopes()).
///
/// Keeps its last equilibrium: targets on a path are followed from one to the next. Not for several threads at once.
class SoftIk {
 public:
  /// Throws InputError for no controls or channels, bounds that are not lower < upper with the nominal value between.
  SoftIk(const Scene& scene, std::vector<IkChannel> channels, std::vector<IkControl> controls, IkOptions options = {});

  /// `targets`: one per channel, SI. `stiffness` [N/m], if it is to be met as well. Throws InputError for the wrong
  /// number of targets, numbers that are not finite, or a stiffness that is not positive, without a direction, or of a
  /// model with rigid bodies.
  IkResult solve(const Eigen::VectorXd& targets, std::optional<double> stiffness = {});

  /// The state at the end of the last solve; at rest before the first one.
  const Equilibrium& equilibrium() const { return equilibrium_; }
  /// Forgets the past: the next solve starts at rest.
  void forget();
  /// The next solve starts at this equilibrium, of another search on the same scene.
  void start_at(const Eigen::VectorXd& u, const Params& p);

 private:
  class Search;
  /// Where the effect of a control jumps: there a motor's link comes to touch another one, or a cable goes slack.
  struct Kink {
    Eigen::Index control;
    double at;                     ///< fraction of the control's range
    Eigen::VectorXd below, above;  ///< the control's column of the errors' Jacobian to either side
  };
  bool move_to(const Eigen::VectorXd& controls, Polish polish);
  Eigen::VectorXd values() const;
  Eigen::MatrixXd derivatives() const;
  std::string bounds_text(const IkResult& result) const;
  Eigen::VectorXd from_range(const Eigen::VectorXd& q) const;
  Eigen::VectorXd to_range(const Eigen::VectorXd& c) const;

  const Scene* scene_;
  std::vector<IkChannel> channels_;
  std::vector<IkControl> controls_;
  IkOptions options_;
  std::vector<int> indices_;
  Eigen::VectorXd lower_, range_;
  Equilibrium equilibrium_;
  bool at_rest_ = true;
  bool lost_ = false;          ///< the last target was out of reach
  std::vector<Kink> kinks_;    ///< at which the last search held controls
  Eigen::MatrixXd curvature_;  ///< what the last search learnt of the errors' second derivatives
  int solves_ = 0, factorisations_ = 0;
};

}  // namespace taut

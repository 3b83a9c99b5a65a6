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
  double tolerance = 1e-4;              ///< [m] of the error at which targets count as reached
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

/// Soft inverse kinematics: controls c within bounds whose static equilibrium u*(c) brings channels to targets,
///
///   min_c  1/2 sum_i (w_i (y_i(u*(c), c) - target_i) / tolerance)^2  [ + 1/2 ((ln k - ln k_target) / stiffness
///   tolerance)^2 ]
///
/// by Levenberg-Marquardt within the bounds, du*/dc by the implicit function theorem from the kept factor (Bern et
/// al. 2019). A first search adds 1/2 sum_j ((c_j - nominal_j)/(upper_j - lower_j))^2, which chooses among controls
/// that do equally well; the second one goes on from there without it, so that it costs no accuracy. A control that has
/// no effect at the start (a slack cable) is moved towards its upper bound until it has one. Where the targets are not
/// reached, the search is repeated from other starts (nominal, mirrored, middle) and the best end counts. That guards
/// against local minima without excluding them.
///
/// The stiffness k = 1/(c^T H^-1 c) of the end effector along a direction c takes one back-solve; its derivatives are
/// differences between equilibria solved again with each control moved by 1e-3 of its range, so they cost a solve per
/// control and step.
///
/// Keeps its last equilibrium: targets on a path are followed from one to the next. Not for several threads at once.
class SoftIk {
 public:
  /// Throws InputError for no controls or channels, bounds that are not lower < upper with the nominal value between.
  SoftIk(const Scene& scene, std::vector<IkChannel> channels, std::vector<IkControl> controls, IkOptions options = {});

  /// `targets`: one per channel, SI. `stiffness` [N/m], if it is to be met as well. Throws InputError for the wrong
  /// number of targets, numbers that are not finite, or a stiffness that is not positive or without a direction.
  IkResult solve(const Eigen::VectorXd& targets, std::optional<double> stiffness = {});

  /// The state at the end of the last solve; at rest before the first one.
  const Equilibrium& equilibrium() const { return equilibrium_; }
  /// Forgets the past: the next solve starts at rest.
  void forget();

 private:
  class Search;
  bool move_to(const Eigen::VectorXd& controls);
  Eigen::VectorXd values() const;
  Eigen::MatrixXd derivatives() const;
  double stiffness() const;
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
  int solves_ = 0, factorisations_ = 0;
};

}  // namespace taut

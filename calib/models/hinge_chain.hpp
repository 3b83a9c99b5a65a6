#pragma once
#include <Eigen/Core>
#include <vector>

// What rigid-body simulators make of a module or a beam: rigid segments on hinges with springs, in a plane.
namespace taut {

/// Segment 0 is held; hinge i - 1 carries segment i, for i = 1 ... n. All places are those of the chain at rest.
struct HingeChain {
  std::vector<Eigen::Vector2d> hinges;  ///< [m], from the held end on
  /// A point of a segment.
  struct Place {
    int segment = 0;
    Eigen::Vector2d at{0, 0};  ///< at rest [m]
  };
  /// A dead force.
  struct Force {
    Place on;
    Eigen::Vector2d newtons{0, 0};
  };
  int size() const { return static_cast<int>(hinges.size()); }  ///< hinges

  /// Where a point is when segment i has turned by turns[i - 1] from rest, counter-clockwise [rad]: with v_1, v_2, ...
  /// the vectors from hinge to hinge and at last to the point, hinge 1 + sum R(turn_i) v_i.
  Eigen::Vector2d where(const Place& place, const Eigen::VectorXd& turns) const;
};

/// Equilibrium of a chain whose hinges all have the stiffness k [N m/rad]: the turns of its segments that minimise
///
///   Pi = k/2 sum (turn_i - turn_(i-1))^2 - sum F . where(place of F),   turn_0 = 0,
///
/// by Newton's method with the exact Hessian from `start` (zero where it is empty), large rotations included. NaN where
/// it comes to none in 200 steps.
Eigen::VectorXd hinge_chain_equilibrium(const HingeChain& chain, double k, const std::vector<HingeChain::Force>& forces,
                                        const Eigen::VectorXd& start = {});

/// A curve that a chain is to follow: displacements of a point along a direction, under loads along another one.
struct HingeCurve {
  HingeChain::Place load, watched;
  Eigen::Vector2d load_direction{0, -1}, watched_direction{0, -1};  ///< unit length
  std::vector<double> forces, displacements;                        ///< [N], [m]; from the unloaded state
  std::vector<HingeChain::Force> always = {};                       ///< weights, which act in the unloaded state too
};

/// The stiffness of a chain's hinges, and how well the chain follows the curve with it.
struct HingeFit {
  double stiffness = 0;               ///< of each hinge [N m/rad]
  std::vector<double> displacements;  ///< of the chain [m], as HingeCurve::forces
  double largest = 0;                 ///< of |displacement / curve - 1|
  double at = 0;                      ///< the force at which that is [N]
};

/// Displacements of the chain under the forces of a curve.
std::vector<double> hinge_chain_curve(const HingeChain& chain, double k, const HingeCurve& curve);

/// The one stiffness of all hinges that minimises sum (displacement / curve - 1)^2 over the forces of the curve, which
/// are the chain's own statics: what is fitted is this discretisation, not a beam. Throws InputError where the chain
/// cannot follow: a load along its axis, displacements against the load, none at all.
HingeFit fit_hinges(const HingeChain& chain, const HingeCurve& curve);

}  // namespace taut

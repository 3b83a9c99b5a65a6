#pragma once
#include <Eigen/Core>
#include <memory>
#include <vector>

#include "sim/mesh/mesh.hpp"
#include "sim/model/channel.hpp"
#include "sim/model/term.hpp"

namespace taut {

/// A point that a cable passes: a material point (its nodes and weights), or fixed in space.
struct CablePoint {
  MaterialPoint material;  ///< no nodes: fixed
  Eigen::VectorXd fixed;   ///< [m]
};

/// What friction at an inner point of a cable knows of other states, as table indices; see make_rubbing_cable().
struct CableEyelet {
  int bound = -1;  ///< b [N], the difference of tensions that it bears
  int slip = -1;   ///< s' [m], what had slipped through it in the state before
};

/// A cable: its points in order, and the table indices of what governs it.
struct Cable {
  std::vector<CablePoint> points;         ///< at least two
  int stiffness = -1;                     ///< k [N/m], of the whole cable
  int slack = -1;                         ///< [m]; the cable is that much longer than its path at rest; -1: none
  int retraction = -1;                    ///< u [m]; -1: none
  int tension = -1;                       ///< held tension, or torque of a spool; -1: the cable is elastic
  int tension_scale = -1;                 ///< factor of the held tension [-]; -1: 1
  double per_control = 1;                 ///< tension per unit of p[tension]: 1, or 1 / radius of the spool [1/m]
  double smoothing = 2e-6;                ///< eps [m], width of the transition from slack to taut; 0: none
  double share = 1;                       ///< of the cable's energy; 0.5 in a model of one half of a symmetric body
  std::vector<CableEyelet> eyelets = {};  ///< all inner points, where an elastic cable rubs there; empty: none does
  int friction = -1;                      ///< mu [-] at its eyelets
  int misalignment = -1;                  ///< beta_0 [rad], what each turns it by besides; -1: 0
};

/// Energy of an elastic cable that runs through its points and cannot push; without friction, but where it has eyelets
/// (make_rubbing_cable()):
///
///   E = phi(e) [J],   e = L(x) - (L0 + slack - u) [m],   T = phi'(e) [N],
///   L(x) = sum over its segments of sqrt(|d|^2 + (1e-9 L0)^2),   L0 = L at rest,
///
///   phi = 0                            for e <= -eps/2              (slack)
///       = k (e + eps/2)^3 / (6 eps)    in between                   (phi'' rises linearly from 0 to k)
///       = k e^2/2 + k eps^2/24         for e >= eps/2               (taut: T = k e)
///
/// phi is C2, or C1 for eps = 0, where phi = k/2 max(0, e)^2. The transition is centred on e = 0, so a taut cable pulls
/// with k e as if it were not there (one that begins at e = 0 is a slack of eps/2 in disguise); the price is a tension
/// of k eps/8 at e = 0. k is that of the whole cable, free length outside the module and winch included: k = EA /
/// length for a bare cable, so EA / L0 when nothing is outside. The Hessian phi'' grad L grad L^T + phi' Hess L is
/// positive semi-definite as it is; Hess L (tension over length) is what a straight cable resists a sideways push with.
/// The length (1e-9 L0) keeps a segment whose ends meet differentiable and changes others by less than rounding.
///
/// Where the tension is held (a hung mass over a pulley, a motor that holds a torque) there is no law:
///
///   E = T (L(x) - L0) [J],   T = tension per_control tension_scale [N], whatever its sign.
///
/// It is a sum over the segments, so make_held_cable() makes one term of each: cliques stay small. Where T < 0, T Hess
/// L is negative semi-definite, and left out of the projected Hessian.
///
/// The clique holds all nodes of all points. Static, without mass, for segments that stay clear of everything between
/// their points. Throws InputError for fewer than two points, no material point among them, a path
/// without length, a fixed point that has not the mesh's dimension, or a negative smoothing.
std::unique_ptr<Term> make_cable(const Mesh& mesh, Cable cable);

/// A cable whose tension is held, one term per segment that material points govern. Throws as make_cable() does.
std::vector<std::unique_ptr<Term>> make_held_cable(const Mesh& mesh, const Cable& cable);

/// Length L(x) [m] of the path from its first point to its last. Throws as make_cable() does.
std::unique_ptr<Channel> make_cable_length(const Mesh& mesh, const Cable& cable);

/// Tension T = phi'(e) [N], or the held one, the same all along the cable unless it rubs; then that of its first
/// segment, where it is pulled. It depends on k, slack and u, or on what the held one is made of, at fixed
/// displacements too. Throws as make_cable() does.
std::unique_ptr<Channel> make_cable_tension(const Mesh& mesh, const Cable& cable);

/// The same of its last segment, away from where it is pulled.
std::unique_ptr<Channel> make_cable_end_tension(const Mesh& mesh, const Cable& cable);

}  // namespace taut

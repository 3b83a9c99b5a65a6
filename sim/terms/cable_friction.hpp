#pragma once
#include <Eigen/Core>
#include <memory>

#include "sim/mesh/mesh.hpp"
#include "sim/model/channel.hpp"
#include "sim/model/term.hpp"
#include "sim/terms/cable.hpp"

// Elastic cables that rub at their eyelets. make_cable() and make_cable_tension() come here for cables with eyelets.
namespace taut {

/// Energy of an elastic cable that rubs at its inner points, the eyelets i = 1 ... n - 1 between its segments j = 0 ...
/// n - 1; it is pulled at its first point. With l_j the lengths of the segments, l0_j those at rest, L0 their sum, and
/// s_i [m] the length of cable that has passed eyelet i towards the pulled end,
///
///   V(x) = min over s of  sum_j w_j phi(e_j / w_j) + sum_i b_i |s_i - s_i'| [J],
///   e_j = l_j(x) - l0_j + s_j - s_(j+1) [m],   w_j = l0_j / L0,   s_0 = u - slack,   s_n = 0,
///   T_j = phi'(e_j / w_j) [N],
///
/// phi the law of the whole cable (make_cable()): k is its stiffness, what is outside the module included, and its
/// compliance is spread over the segments in proportion to their lengths at rest. Without friction (b = 0) V is the
/// energy of make_cable() exactly, smoothing included. The bounds b_i [N] and the slips s_i' before are parameters of
/// the model, so that V is a function of u and p like every energy, with s eliminated: it is C1 and convex in the l_j,
/// its gradient is sum_j T_j dl_j/du, and eyelets that stick keep s_i = s_i' to the bit.
///
/// Tensions are found by their own problem, which is strictly convex: min over T of sum_j (w_j phi*(T_j) - E_j T_j)
/// with |T_(i-1) - T_i| <= b_i, E_j the elongations that all sticking eyelets would leave. It is solved segment by
/// segment, each minimum as a function of the next one's tension: no iteration over which eyelets slip.
///
/// Friction is Coulomb's where the bounds are those of their own state (make_eyelet_bound()): T_(i-1) / T_i is then
/// exp(+-mu (beta_i + beta_0)) at an eyelet that slips, towards the pulled end or away from it, and between these at
/// one that sticks. What takes a state to the next one is one step: between the two an eyelet slips one way or not at
/// all. A slack cable is not held by its eyelets, and lies with even slack in all segments.
///
/// Throws InputError as make_cable() does.
std::unique_ptr<Term> make_rubbing_cable(const Mesh& mesh, const Cable& cable);

/// Tension T_j [N] of segment `segment`. Throws as above.
std::unique_ptr<Channel> make_segment_tension(const Mesh& mesh, const Cable& cable, Eigen::Index segment);

/// What friction at eyelet `eyelet` (from 0 on) can bear [N],
///
///   b_i = tanh(mu (beta_i + beta_0) / 2) (T_(i-1) + T_i),
///
/// with beta_i(x) [rad] the angle by which the cable turns there and beta_0 the misalignment: |T_(i-1) - T_i| <= b_i
/// says the same as exp(-mu (beta_i + beta_0)) <= T_(i-1)/T_i <= exp(mu (beta_i + beta_0)), whichever way it slips. A
/// state whose parameter b_i is this has Coulomb's friction. Its derivative at a straight cable (beta_i = 0, a kink) is
/// that without turning. Throws as above.
std::unique_ptr<Channel> make_eyelet_bound(const Mesh& mesh, const Cable& cable, Eigen::Index eyelet);

/// The slip s_i [m] at eyelet `eyelet` (from 0 on): what the next state has for s_i'. Throws as above.
std::unique_ptr<Channel> make_eyelet_slip(const Mesh& mesh, const Cable& cable, Eigen::Index eyelet);

}  // namespace taut

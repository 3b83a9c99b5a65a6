#pragma once
#include <Eigen/Core>
#include <array>
#include <vector>

#include "sim/contact/contact_term.hpp"

namespace taut {

/// How the barrier of the single node-edge pairs is summed.
enum class ContactForm {
  length_weighted,  ///< weighted by rest length: kappa is a pressure, the answer does not depend on the number of nodes
  pair_sum,         ///< the paper's plain sum over all pairs, kappa in N/m; for comparison
  pair_sum_dedup,   ///< the same, a vertex shared by several edges counted once
  penalty           ///< length-weighted, but a spring instead of the barrier, and nothing stops a step; for comparison
};

using GroundLine = Ground<2>;  ///< A straight line that bodies stay on one side of

/// What may touch what, and by which numbers of the parameter table.
struct ContactSettings : ContactSides<2> {
  ContactForm form = ContactForm::length_weighted;
  /// Mesh nodes of straight boundary edges, outward oriented (body on their left), each once.
  std::vector<std::array<int, 2>> edges;
  /// Fixed polylines [m]; first = last point closes one. Both sides of a contact are sampled at their points and carry
  /// half of the pressure each, so an obstacle needs points as close as those of what touches it.
  std::vector<std::vector<Eigen::Vector2d>> obstacles;
  int thickness = -1;  ///< table index of the thickness [m]; -1: 1 m. The pair sums have none
};

/// Straight edges of a 2D mesh's boundary, outward oriented; a quadratic edge gives two, split at its mid-node.
std::vector<std::array<int, 2>> contact_edges(const Mesh& mesh);

/// A node and an edge closer than dhat.
struct ContactPair {
  int node = 0;         ///< vertex of the contact surface: a mesh node, or node_count + i for the i-th obstacle point
  int edge = 0;         ///< into settings.edges, then the obstacles' segments in their order, then the grounds
  double distance = 0;  ///< [m]
};

struct PlaneSurface;

/// Incremental potential contact in 2D: a barrier between the nodes and edges of a boundary, obstacles and grounds that
/// grows without bound as their distance d goes to zero, without friction.
///
///     length_weighted   E = t/2 sum_i w_i [ sum_e kappa b1(d(i,e)) - sum_v (m_v - 1) kappa b1(|x_i - x_v|) ]
///                         + t sum_i w_i sum_grounds kappa b1(d)
///     pair_sum          E = sum_i sum_e kappa b2(d(i,e)) + sum_i sum_grounds kappa b2(d)
///     pair_sum_dedup    the same - sum_i sum_v (m_v - 1) kappa b2(|x_i - x_v|)
///     penalty           as length_weighted, with the spring (dhat - d)^2 / (2 dhat) below dhat in place of b1
///
/// b1 and b2 are the Barrier with q = 1 and 2, d the distance of node i to the closed segment e, i no end of e; w_i is
/// half of the rest length of the edges at node i and m_v the number of edges at vertex v that do not contain i. The
/// sum over v takes back what a node near the vertex of two edges would count twice; where edges of different kappa
/// meet, the smallest one stays. Between two faces at distance d the pressure is p = kappa (2 (s - 1) ln s + (s - 1)^2
/// / s), s = d / dhat. Where the faces are straight it does not depend on the meshes; only the ends of a face see them,
/// within an edge. Half of it comes from the nodes of either side.
///
/// Valid for dhat below half of the smallest rest distance between a node and an edge that it does not belong to
/// (`smallest_distance` at rest); pairs closer than dhat at rest push from the start. Bodies stand s dhat apart:
/// results are biased by that and want a second dhat. Curved quadratic edges are seen as their two chords.
///
/// The energy is +inf for a node on an edge or behind a ground. That edges have crossed is not seen: `step_limit`
/// prevents it and `intersects` proves it.
///
/// The penalty is what many solvers use: its pressure kappa (1 - s) ends at kappa, its energy is finite everywhere and
/// only C1 at dhat, and it limits no step. A node that has passed an edge is pushed on, out at the far side; behind a
/// ground, where s < 0, it is pushed back. A node right on an edge feels no force, having no direction.
///
/// After Li et al. 2020 (Incremental Potential Contact) and, for weights and vertices, Li et al. 2023 (Convergent
/// Incremental Potential Contact); pair_sum is Eq. 4 of the push-puppet paper, its section III-B.
using Contact = SurfaceContact<PlaneSurface, ContactSettings, ContactPair>;

}  // namespace taut

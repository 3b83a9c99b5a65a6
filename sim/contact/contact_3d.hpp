#pragma once
#include <array>
#include <vector>

#include "sim/contact/contact_term.hpp"

namespace taut {

using GroundPlane = Ground<3>;  ///< A plane that bodies stay on one side of

/// What may touch what in space, and by which numbers of the parameter table.
struct Contact3dSettings : ContactSides<3> {
  /// Mesh nodes of flat boundary triangles, outward oriented, each once.
  std::vector<std::array<int, 3>> triangles;
};

/// Flat triangles of a 3D mesh's boundary, outward oriented; a quadratic facet gives four, split at its mid-nodes.
std::vector<std::array<int, 3>> contact_triangles(const Mesh& mesh);

/// Two features that may touch, closer than dhat.
struct ContactPair3 {
  /// Which features; see first and second.
  enum class Kind { point_triangle, edges, ground };
  Kind kind;
  /// Mesh node and triangle (into settings.triangles), two edges (numbers of the surface's own), or mesh node and
  /// ground.
  int first = 0, second = 0;
  double distance = 0;  ///< [m]
};

struct SpaceSurface;

/// Incremental potential contact in 3D: a barrier between the nodes and triangles of a boundary, its edges among each
/// other, and nodes and ground planes, that grows without bound as their distance d goes to zero; without friction.
///
///     E = 1/2 sum_i w_i [ sum_T kappa b(d(i,T)) - sum_e (m_e - 1) kappa b(d(i,e)) + sum_v c_v kappa b(|x_i - x_v|) ]
///       + sum_i w_i sum_grounds kappa b(d)
///       + sum_(e,f) (w_e + w_f)/2 kappa m(e,f) b_edge(d(e,f))
///
/// b is the Barrier with q = 1 at dhat, and b_edge the same at a quarter of dhat; d(i,T) is the distance of node i to
/// the closed triangle T that it does not belong to, m_e the number of triangles at edge e that do not contain i, m_v
/// that at vertex v, and c_v = 1 - m_v + sum_(e at v) (m_e - 1). Edges and vertices take back what a node near them
/// would count twice, so that over a flat or convex face each node counts once; where triangles of different kappa
/// meet, the smallest one stays. w_e is a third of the rest area of the triangles at an edge. w_i is a third of the
/// projected area of the triangles at node i, seen from the front of the one from which it is largest: on a face right
/// up to its rim that face's own share, without the walls beside it.
///
/// Between two flat faces at distance d the pressure is that of the plane case, p = kappa (2 (s - 1) ln s + (s - 1)^2 /
/// s), s = d / dhat, whatever the meshes: half of it from the nodes of either side. The pairs of edges take no part in
/// that. How many edges cross between two faces depends on the meshes, so their barrier begins only where s < 1/4 and
/// p > 4.3 kappa: it serves edges that cross without a node near (bars, rims of plates) and keeps coarse faces from
/// cutting into each other. m is the Mollifier for parallel edges.
///
/// Valid for dhat below half of the smallest rest distance between a node and a triangle, or two edges, that share no
/// node (`smallest_distance` at rest); pairs closer than dhat at rest push from the start. Bodies stand s dhat apart.
/// Curved quadratic facets are seen as their four flat triangles.
///
/// The Hessian takes edges and vertices between facets that are flat to a hundredth for planes.
///
/// The energy is +inf for a node on a triangle or behind a ground, and for edges that meet. That surfaces have crossed
/// is not seen: `step_limit` prevents it and `intersects` proves it.
///
/// After Li et al. 2020 (Incremental Potential Contact) and, for weights, edges and vertices, Li et al. 2023
/// (Convergent Incremental Potential Contact); that the edges' barrier is shorter and w_i a projection is our own.
using Contact3d = SurfaceContact<SpaceSurface, Contact3dSettings, ContactPair3>;

}  // namespace taut

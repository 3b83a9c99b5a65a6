#pragma once
#include <Eigen/Core>
#include <array>
#include <memory>
#include <vector>

#include "sim/mesh/mesh.hpp"
#include "sim/model/term.hpp"

namespace taut {

/// A fixed plane with its admissible side: x is admissible when (x - point) . normal > 0.
struct GroundPlane {
  Eigen::Vector3d point;   ///< [m]
  Eigen::Vector3d normal;  ///< unit length
};

/// What may touch what in space, and by which numbers of the parameter table.
struct Contact3dSettings {
  /// Mesh nodes of flat boundary triangles, outward oriented, each once.
  std::vector<std::array<int, 3>> triangles;
  /// Per triangle: table index of kappa > 0 [Pa]. A pair takes the smaller of its two sides' values; a node or an edge
  /// has the smallest of its triangles'.
  std::vector<int> stiffness;
  std::vector<GroundPlane> grounds;       ///< fixed half-spaces
  int ground_stiffness = -1;              ///< table index of kappa of the grounds; -1: they take the body's
  int gap = -1;                           ///< table index of dhat > 0 [m]: the distance at which the barrier sets in
  std::vector<int> part;                  ///< per mesh node: the part of the mesh it is of; empty: there is one
  std::vector<std::array<int, 2>> apart;  ///< pairs of parts that do not see each other: what a joint connects
};

/// Flat triangles of a 3D mesh's boundary, outward oriented; a quadratic facet gives four, split at its mid-nodes.
std::vector<std::array<int, 3>> contact_triangles(const Mesh& mesh);

/// Two features that may touch, closer than dhat.
struct ContactPair3 {
  enum class Kind { point_triangle, edges, ground };
  Kind kind;
  /// Mesh node and triangle (into settings.triangles), two edges (numbers of the surface's own), or mesh node and
  /// ground.
  int first = 0, second = 0;
  double distance = 0;  ///< [m]
};

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
/// The energy is +inf for a node on a triangle or behind a ground, and for edges that meet. That surfaces have crossed
/// is not seen: `step_limit` prevents it and `intersects` proves it.
///
/// After Li et al. 2020 (Incremental Potential Contact) and, for weights, edges and vertices, Li et al. 2023
/// (Convergent Incremental Potential Contact); that the edges' barrier is shorter and w_i a projection is our own.
class Contact3d : public Term {
 public:
  static constexpr double edge_reach = 0.25;  ///< of the gap: where the barrier of two edges begins

  /// Throws std::logic_error for a plane mesh, triangles outside the mesh or without area, or missing parameters;
  /// InputError for grounds without direction.
  Contact3d(const Mesh& mesh, Contact3dSettings settings);
  ~Contact3d() override;

  /// Pairs vary with the state: Hessian entries are couplings. Curvature::projected makes each pair's Hessian positive
  /// semi-definite.
  void assemble(const Point& at, Assembly& out) const override;
  /// True for dhat and every kappa.
  bool depends_on(int index) const override;
  /// Where two kappas are equal, the derivative is that of the one with the lower index.
  void add_parameter_gradient(const Point& at, int index, Eigen::VectorXd& out) const override;
  /// At every time on the way the distance of a node and a triangle, or of two edges, stays above a tenth of the
  /// clearance at the start: the smallest distance to anything in its way that one of the pair's nodes, or a triangle
  /// or edge at it, has. The limit is below 1 only where some pair comes down to two tenths of its own distance. 0 for
  /// steps that are not finite and from states that touch.
  double step_limit(const Point& at, const Eigen::VectorXd& step) const override;

  /// Pairs closer than dhat, sorted by kind, first and second. `brute_force` looks at all pairs (for tests).
  std::vector<ContactPair3> active_pairs(const Point& at, bool brute_force = false) const;
  /// Smallest distance [m] between a node and a triangle, or two edges, that share no node, or a node and a ground
  /// (negative behind it), looked for up to `horizon`; +inf when nothing is nearer than that.
  double smallest_distance(const Eigen::VectorXd& u, double horizon) const;
  /// Whether an edge meets a triangle with which it shares no node, or a node lies on or behind a ground. Exact for the
  /// positions X + u as rounded, and independent of the distances.
  bool intersects(const Eigen::VectorXd& u) const;

 private:
  struct Surface;
  std::unique_ptr<const Surface> surface_;
};

}  // namespace taut

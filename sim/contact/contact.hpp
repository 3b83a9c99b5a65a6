#pragma once
#include <Eigen/Core>
#include <array>
#include <memory>
#include <vector>

#include "sim/mesh/mesh.hpp"
#include "sim/model/term.hpp"

namespace taut {

/// How the barrier of the single node-edge pairs is summed.
enum class ContactForm {
  length_weighted,  ///< weighted by rest length: kappa is a pressure, the answer does not depend on the number of nodes
  pair_sum,         ///< the paper's plain sum over all pairs, kappa in N/m; for comparison
  pair_sum_dedup,   ///< the same, a vertex shared by several edges counted once
  penalty           ///< length-weighted, but a spring instead of the barrier, and nothing stops a step; for comparison
};

/// A fixed straight line with its admissible side: x is admissible when (x - point) . normal > 0.
struct GroundLine {
  Eigen::Vector2d point;   ///< [m]
  Eigen::Vector2d normal;  ///< unit length
};

/// What may touch what, and by which numbers of the parameter table.
struct ContactSettings {
  ContactForm form = ContactForm::length_weighted;
  /// Mesh nodes of straight boundary edges, outward oriented (body on their left), each once.
  std::vector<std::array<int, 2>> edges;
  /// Per edge: table index of kappa > 0 [Pa]; [N/m] in the pair sums. A pair takes the smaller of its two sides'
  /// values, and a node has the smallest of its edges'.
  std::vector<int> stiffness;
  /// Fixed polylines [m]; first = last point closes one. Both sides of a contact are sampled at their points and carry
  /// half of the pressure each, so an obstacle needs points as close as those of what touches it.
  std::vector<std::vector<Eigen::Vector2d>> obstacles;
  std::vector<GroundLine> grounds;        ///< fixed half-planes; they carry their whole pressure at the bodies' nodes
  std::vector<int> part;                  ///< per mesh node: the part of the mesh it is of; empty: there is one
  std::vector<std::array<int, 2>> apart;  ///< pairs of parts that do not see each other: what a joint connects
  int obstacle_stiffness = -1;            ///< table index of kappa of obstacles and grounds; -1: they take the body's
  int gap = -1;                           ///< table index of dhat > 0 [m]: the distance at which the barrier sets in
  int thickness = -1;                     ///< table index of the thickness [m]; -1: 1 m. The pair sums have none
};

/// Straight edges of a 2D mesh's boundary, outward oriented; a quadratic edge gives two, split at its mid-node.
std::vector<std::array<int, 2>> contact_edges(const Mesh& mesh);

/// A node and an edge closer than dhat.
struct ContactPair {
  int node = 0;         ///< vertex of the contact surface: a mesh node, or node_count + i for the i-th obstacle point
  int edge = 0;         ///< into settings.edges, then the obstacles' segments in their order, then the grounds
  double distance = 0;  ///< [m]
};

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
class Contact : public Term {
 public:
  /// Throws std::logic_error for a 3D mesh, edges outside the mesh or of length zero, or missing parameters; InputError
  /// for obstacles with repeated or too few points and grounds without direction.
  Contact(const Mesh& mesh, ContactSettings settings);
  ~Contact() override;

  /// Node pairs vary with the state: Hessian entries are couplings. Curvature::projected makes each pair's Hessian
  /// positive semi-definite.
  void assemble(const Point& at, Assembly& out) const override;
  /// True for dhat, every kappa and, length-weighted or penalty, the thickness.
  bool depends_on(int index) const override;
  /// Where two kappas are equal, the derivative is that of the one with the lower index.
  void add_parameter_gradient(const Point& at, int index, Eigen::VectorXd& out) const override;
  /// At every time on the way the distance of a node and an edge stays above a tenth of the clearance at the start: the
  /// distance of the node, or of an end of the edge, to the nearest edge (or ground). The limit is below 1 only where
  /// some pair comes down to two tenths of its own distance. 0 for steps that are not finite and from states that
  /// touch. Always 1 for the penalty.
  double step_limit(const Point& at, const Eigen::VectorXd& step) const override;

  /// Pairs closer than dhat, sorted by node and edge. `brute_force` looks at all pairs (for tests).
  std::vector<ContactPair> active_pairs(const Point& at, bool brute_force = false) const;
  /// Smallest distance [m] between a node and an edge that it does not belong to, or a ground (negative behind it),
  /// looked for up to `horizon`; +inf when nothing is nearer than that.
  double smallest_distance(const Eigen::VectorXd& u, double horizon) const;
  /// Whether any two edges meet (other than neighbours in their common node) or a node lies on or behind a ground.
  /// Exact for the positions X + u as rounded; O(n log n). Obstacles may cross each other.
  bool intersects(const Eigen::VectorXd& u) const;

 private:
  struct Surface;
  std::unique_ptr<const Surface> surface_;
};

}  // namespace taut

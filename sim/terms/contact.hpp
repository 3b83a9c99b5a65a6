#pragma once
#include <Eigen/Core>
#include <array>
#include <memory>
#include <vector>

#include "sim/core/term.hpp"
#include "sim/mesh/mesh.hpp"

namespace taut {

/// How the barrier of the single node-edge pairs is summed.
enum class ContactForm {
  length_weighted,   ///< weighted by rest length: kappa is a pressure, the answer does not depend on the number of nodes
  pair_sum,          ///< the paper's plain sum over all pairs, kappa in N/m; for comparison
  pair_sum_dedup     ///< the same, a vertex shared by several edges counted once
};

/// A fixed straight line with its admissible side: x is admissible when (x - point) . normal > 0.
struct GroundLine {
  Eigen::Vector2d point;   ///< [m]
  Eigen::Vector2d normal;  ///< unit length
};

/// What may touch what, and by which numbers of the parameter table.
struct ContactSettings {
  ContactForm form = ContactForm::length_weighted;
  std::vector<std::array<int, 2>> edges;       ///< mesh nodes of straight boundary edges, outward oriented (body on their left)
  std::vector<int> stiffness;                  ///< per edge: table index of kappa [Pa]; [N/m] in the pair sums. A pair takes the smaller of its two sides' values
  std::vector<std::vector<Eigen::Vector2d>> obstacles;  ///< fixed polylines [m]; first = last point closes one. Sampled at their points: as fine as what touches them
  std::vector<GroundLine> grounds;             ///< fixed half-planes
  int obstacle_stiffness = -1;                 ///< table index of kappa of obstacles and grounds; -1: they take the body's
  int gap = -1;                                ///< table index of dhat [m]: the distance at which the barrier sets in
  int thickness = -1;                          ///< table index of the thickness [m]; -1: 1 m. The pair sums have none
};

/// Straight edges of a 2D mesh's boundary, outward oriented; a quadratic edge gives two, split at its mid-node.
std::vector<std::array<int, 2>> contact_edges(const Mesh& mesh);

/// A node and an edge closer than dhat.
struct ContactPair {
  int node = 0;  ///< vertex of the contact surface: a mesh node, or node_count + i for the i-th obstacle point
  int edge = 0;  ///< into settings.edges, then the obstacles' segments in their order
  double distance = 0;  ///< [m]
};

/// 2D incremental potential contact between boundary edges, obstacles and grounds (Li et al. 2020; the paper, III-B).
class Contact : public Term {
 public:
  Contact(const Mesh& mesh, ContactSettings settings);
  ~Contact() override;

  void assemble(const Point& at, Assembly& out) const override;
  bool depends_on(int index) const override;
  void add_parameter_gradient(const Point& at, int index, Eigen::VectorXd& out) const override;
  double step_limit(const Point& at, const Eigen::VectorXd& step) const override;

  /// Pairs closer than dhat, sorted by node and edge. `brute_force` looks at all pairs (for tests).
  std::vector<ContactPair> active_pairs(const Point& at, bool brute_force = false) const;
  /// Smallest distance between a node and an edge that it does not belong to, or a ground [m], looked for up to `horizon`.
  double smallest_distance(const Eigen::VectorXd& u, double horizon) const;
  /// Whether any two edges cross or a node lies behind a ground: exact test, all pairs in O(n log n).
  bool intersects(const Eigen::VectorXd& u) const;

 private:
  struct Surface;
  std::unique_ptr<const Surface> surface_;
};

}  // namespace taut

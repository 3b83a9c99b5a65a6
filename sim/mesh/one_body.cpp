#include "sim/mesh/one_body.hpp"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <optional>
#include <set>

#include "sim/core/box_tree.hpp"
#include "sim/core/error.hpp"
#include "sim/core/sorted.hpp"
#include "sim/mesh/topology.hpp"

namespace taut {
namespace {

using Place3 = Eigen::Vector3d;  ///< in the plane z = 0
using Tree = BoxTree<3>;

constexpr std::string_view join_them =
    "join them where the mesh is made (in Gmsh: Coherence before meshing, or 'Coherence Mesh' after it), or set "
    "bodies = \"separate\" under [geometry] if they are not bonded";

/// Of the shortest edge: what is nearer than that is meant to be one place.
constexpr double near = 1e-3;
/// Of an element's height: sides of a curved seam that are meshed differently may lie this deep in one another.
constexpr double shallow = 0.1;

/// Of `count` such things one has been named.
std::string and_more(size_t count, std::string_view what) {
  return count < 2 ? "" : fmt::format(", and {} {}{} elsewhere", count - 1, what, count == 2 ? "" : "s");
}

/// Sets that are joined step by step.
class Sets {
 public:
  explicit Sets(int count) : parent_(static_cast<size_t>(count)) { std::iota(parent_.begin(), parent_.end(), 0); }
  int root(int i) {
    while (parent(i) != i) i = parent(i) = parent(parent(i));
    return i;
  }
  void join(int a, int b) { parent(root(a)) = root(b); }

 private:
  int& parent(int i) { return parent_[static_cast<size_t>(i)]; }
  std::vector<int> parent_;
};

Place3 place_of(const Mesh& mesh, int node) {
  Place3 x = Place3::Zero();
  x.head(mesh.dimension()) = mesh.X.segment(node * mesh.dimension(), mesh.dimension());
  return x;
}

/// One straight simplex between vertices.
class Simplex {
 public:
  Simplex(const Mesh& mesh, int e) : d_(mesh.dimension()), corners_(3, d_ + 1), gradients_(d_ + 1, 3) {
    for (int a = 0; a <= d_; ++a) corners_.col(a) = place_of(mesh, mesh.element(e)[a]);
    const Small edges = corners_.topRightCorner(d_, d_).colwise() - corners_.col(0).head(d_);
    // Round-off decides where a point lies in a flat element: it is said to be outside.
    flat_ = !(std::abs(edges.determinant()) > 1e-8 * std::pow(edges.colwise().norm().maxCoeff(), d_));
    if (flat_) return;
    gradients_.setZero();
    gradients_.bottomLeftCorner(d_, d_) = edges.inverse();
    gradients_.row(0) = -gradients_.bottomRows(d_).colwise().sum();
    height_ = 1 / gradients_.rowwise().norm().maxCoeff();
  }

  /// Whether a point lies inside, or no farther outside than `near` of the heights and of `size` [m].
  bool holds(const Place3& x, double size) const {
    if (flat_) return false;
    for (int a = 0; a <= d_; ++a) {
      const double weight = gradients_.row(a).dot(x - corners_.col(a)) + 1;
      if (weight < -near * std::min(1.0, size * gradients_.row(a).norm())) return false;
    }
    return true;
  }

  /// Whether two simplices have more in common than `shallow` of the smaller height: no axis parts them.
  bool overlaps(const Simplex& other) const {
    if (flat_ || other.flat_) return false;
    const double most = shallow * std::min(height_, other.height_);
    for (int a = 0; a <= d_; ++a) {
      if (common(other, gradients_.row(a)) <= most || common(other, other.gradients_.row(a)) <= most) return false;
    }
    if (d_ == 2) return true;
    for (const auto& [a, b] : edges_of(ElementShape::tet4)) {
      const Place3 edge = corners_.col(b) - corners_.col(a);
      for (const auto& [c, d] : edges_of(ElementShape::tet4)) {
        const Place3 across = other.corners_.col(d) - other.corners_.col(c);
        const Place3 axis = edge.cross(across);
        if (axis.norm() > 1e-6 * edge.norm() * across.norm() && common(other, axis) <= most) return false;
      }
    }
    return true;
  }

 private:
  using Small = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 4, 4>;

  /// Length [m] that both cover on an axis; negative: the distance.
  double common(const Simplex& other, const Place3& axis) const {
    const auto [low, high] = covered(axis);
    const auto [other_low, other_high] = other.covered(axis);
    return (std::min(high, other_high) - std::max(low, other_low)) / axis.norm();
  }

  std::pair<double, double> covered(const Place3& axis) const {
    double low = axis.dot(corners_.col(0)), high = low;
    for (int a = 1; a <= d_; ++a) {
      const double x = axis.dot(corners_.col(a));
      low = std::min(low, x);
      high = std::max(high, x);
    }
    return {low, high};
  }

  int d_;
  bool flat_ = false;
  Eigen::Matrix<double, 3, Eigen::Dynamic, 0, 3, 4> corners_;
  Eigen::Matrix<double, Eigen::Dynamic, 3, 0, 4, 3> gradients_;  ///< of the barycentric coordinates: one over heights
  double height_ = 0;                                            ///< the smallest [m]
};

/// What of a mesh meets without being joined.
class Meetings {
 public:
  explicit Meetings(const Mesh& mesh) : mesh_(mesh), corners_(mesh.dimension() + 1) {
    measure_vertices();
    enclose_elements();
    for (int i = 0; i < mesh.node_count(); ++i) {
      if (std::isfinite(size(i))) meet(i);
    }
    for (int e = 0; e < mesh.element_count(); ++e) meet_elements(e);
    compare_mid_nodes();
    sort_unique(coincident_);
  }

  void refuse_overlaps(std::string_view where) const {
    if (overlaps_.empty()) return;
    throw InputError(fmt::format(
        "{}: elements overlap at {}{}; cut one of the bodies out of the other where the mesh is made (in Gmsh: "
        "BooleanFragments), or delete what is there twice",
        where, in_millimetres(mesh_.centroid(overlaps_[0])), and_more(overlaps_.size(), "place")));
  }

  void refuse_coincident(std::string_view where) const {
    if (coincident_.empty()) return;
    throw InputError(fmt::format(
        "{}: two nodes coincide at {}{}: the elements that meet there have nodes of their own and are not joined; {}",
        where, in_millimetres(mesh_.node(coincident_[0].first)), and_more(coincident_.size(), "pair"), join_them));
  }

  void refuse_hanging(std::string_view where) const {
    if (hanging_.empty()) return;
    const auto [node, e] = hanging_[0];
    throw InputError(
        fmt::format("{}: a hanging node at {} lies on the side of the element around {} without being one of its "
                    "nodes{}: the elements on either side are not joined there; mesh both sides with the same nodes",
                    where, in_millimetres(mesh_.node(node)), in_millimetres(mesh_.centroid(e)),
                    and_more(hanging_.size(), "such node")));
  }

 private:
  double size(int node) const { return sizes_[static_cast<size_t>(node)]; }

  void measure_vertices() {
    sizes_.assign(static_cast<size_t>(mesh_.node_count()), std::numeric_limits<double>::infinity());
    for (int e = 0; e < mesh_.element_count(); ++e) {
      for (const auto& [a, b] : edges_of(mesh_.shape)) {
        const int from = mesh_.element(e)[a], to = mesh_.element(e)[b];
        const double length = (place_of(mesh_, from) - place_of(mesh_, to)).norm();
        for (int node : {from, to}) sizes_[static_cast<size_t>(node)] = std::min(size(node), length);
      }
    }
  }

  void enclose_elements() {
    std::vector<Tree::Place> centroids;
    for (int e = 0; e < mesh_.element_count(); ++e) {
      Tree::Box box;
      for (int a = 0; a < corners_; ++a) box.extend(place_of(mesh_, mesh_.element(e)[a]));
      const Place3 margin = Place3::Constant(near * box.sizes().maxCoeff());
      centroids.push_back(box.center());
      leaves_.emplace_back(box.min() - margin, box.max() + margin);
      simplices_.emplace_back(mesh_, e);
    }
    tree_ = Tree(centroids);
    boxes_ = tree_.enclose(leaves_);
  }

  /// A vertex against the elements that it does not belong to.
  void meet(int node) {
    const Place3 x = place_of(mesh_, node);
    std::optional<int> hangs_on;
    bool at_vertex = false;
    tree_.visit(boxes_, Tree::Box(x), [&](int e) {
      const int* nodes = mesh_.element(e);
      if (std::find(nodes, nodes + corners_, node) != nodes + corners_) return;
      for (int a = 0; a < corners_; ++a) {
        if ((x - place_of(mesh_, nodes[a])).norm() > near * std::min(size(node), size(nodes[a]))) continue;
        coincident_.emplace_back(std::minmax(node, nodes[a]));
        at_vertex = true;
        return;
      }
      if (!hangs_on && simplices_[static_cast<size_t>(e)].holds(x, size(node))) hangs_on = e;
    });
    if (hangs_on && !at_vertex) hanging_.emplace_back(node, *hangs_on);
  }

  void meet_elements(int e) {
    bool overlap = false;
    tree_.visit(boxes_, leaves_[static_cast<size_t>(e)], [&](int other) {
      overlap = overlap ||
                (other != e && simplices_[static_cast<size_t>(e)].overlaps(simplices_[static_cast<size_t>(other)]));
    });
    if (overlap) overlaps_.push_back(e);
  }

  void compare_mid_nodes() {
    if (order_of(mesh_.shape) == 1) return;
    std::map<std::pair<int, int>, int> mid_nodes;
    const auto edges = edges_of(mesh_.shape);
    for (int e = 0; e < mesh_.element_count(); ++e) {
      const int* nodes = mesh_.element(e);
      for (size_t k = 0; k < edges.size(); ++k) {
        const int mid = nodes[corners_ + static_cast<int>(k)];
        const int known =
            mid_nodes.try_emplace(std::minmax({nodes[edges[k][0]], nodes[edges[k][1]]}), mid).first->second;
        if (known != mid) coincident_.emplace_back(std::minmax(known, mid));
      }
    }
  }

  const Mesh& mesh_;
  int corners_;
  std::vector<double> sizes_;  ///< of each vertex, its shortest edge [m]; infinite for mid-nodes
  std::vector<Simplex> simplices_;
  Tree tree_;
  std::vector<Tree::Box> leaves_, boxes_;        ///< of elements, of all nodes of the tree
  std::vector<std::pair<int, int>> coincident_;  ///< nodes
  std::vector<std::pair<int, int>> hanging_;     ///< node and element
  std::vector<int> overlaps_;                    ///< elements
};

/// The first element and the number of elements of each part: what shares vertices.
std::vector<std::pair<int, int>> parts_of(const Mesh& mesh) {
  Sets nodes(mesh.node_count());
  for (int e = 0; e < mesh.element_count(); ++e) {
    for (int a = 1; a <= mesh.dimension(); ++a) nodes.join(mesh.element(e)[a], mesh.element(e)[0]);
  }
  std::vector<int> part(static_cast<size_t>(mesh.node_count()), -1);
  std::vector<std::pair<int, int>> parts;
  for (int e = 0; e < mesh.element_count(); ++e) {
    int& number = part[static_cast<size_t>(nodes.root(mesh.element(e)[0]))];
    if (number < 0) {
      number = static_cast<int>(parts.size());
      parts.emplace_back(e, 0);
    }
    ++parts[static_cast<size_t>(number)].second;
  }
  return parts;
}

void refuse_parts(const Mesh& mesh, std::string_view where) {
  const auto parts = parts_of(mesh);
  if (parts.size() < 2) return;
  const auto text = [&](const std::pair<int, int>& part) {
    return fmt::format("{} ({})", in_millimetres(mesh.centroid(part.first)),
                       part.second == 1 ? "1 element" : fmt::format("{} elements", part.second));
  };
  throw InputError(fmt::format("{}: the mesh has {} parts that share no node, one of them at {}, another at {}; {}",
                               where, parts.size(), text(parts[0]), text(parts[1]), join_them));
}

/// A vertex where elements meet that no chain of common sides connects; -1 for none. The mesh is one part.
int hinge(const Mesh& mesh) {
  const ReferenceFacets reference = facets_of(mesh.shape);
  const int d = mesh.dimension();
  std::vector<std::pair<std::array<int, 3>, int>> facets;
  for (int e = 0; e < mesh.element_count(); ++e) {
    for (int f = 0; f < reference.count; ++f) {
      std::array<int, 3> vertices{-1, -1, -1};
      for (int i = 0; i < d; ++i)
        vertices[static_cast<size_t>(i)] =
            mesh.element(e)[reference.nodes[static_cast<size_t>(f * reference.nodes_per_facet + i)]];
      std::ranges::sort(vertices);
      facets.emplace_back(vertices, e);
    }
  }
  std::ranges::sort(facets);
  Sets elements(mesh.element_count());
  for (size_t k = 1; k < facets.size(); ++k) {
    if (facets[k].first == facets[k - 1].first) elements.join(facets[k].second, facets[k - 1].second);
  }
  std::vector<int> owner(static_cast<size_t>(mesh.node_count()), -1);
  for (int e = 0; e < mesh.element_count(); ++e) {
    for (int a = 0; a <= d; ++a) {
      int& root = owner[static_cast<size_t>(mesh.element(e)[a])];
      if (root >= 0 && root != elements.root(e)) return mesh.element(e)[a];
      root = elements.root(e);
    }
  }
  return -1;
}

/// 1 for equilateral simplices, 0 for flat ones: measure against the squares of the edges.
double quality(const Mesh& mesh, int e) {
  double squares = 0;
  for (const auto& [a, b] : edges_of(mesh.shape))
    squares += (place_of(mesh, mesh.element(e)[a]) - place_of(mesh, mesh.element(e)[b])).squaredNorm();
  const double determinant = std::abs(vertex_determinant(mesh, e));
  return mesh.dimension() == 2 ? 2 * std::sqrt(3.0) * determinant / squares
                               : 12 * std::pow(determinant / 2, 2.0 / 3) / squares;
}

}  // namespace

void check_one_body(const Mesh& mesh, std::string_view where, bool separate) {
  const Meetings meetings(mesh);
  meetings.refuse_overlaps(where);
  if (separate) return;
  meetings.refuse_coincident(where);
  meetings.refuse_hanging(where);
  refuse_parts(mesh, where);
}

std::vector<std::string> oddities(const Mesh& mesh, std::string_view where) {
  std::vector<std::string> found;
  constexpr double needle = 1e-3;
  int needles = 0, worst = 0;
  for (int e = 0; e < mesh.element_count(); ++e) {
    if (quality(mesh, e) < needle) ++needles;
    if (quality(mesh, e) < quality(mesh, worst)) worst = e;
  }
  if (needles > 0)
    found.push_back(
        fmt::format("{}: {} of {} elements are needles (quality below {}; an equilateral one has 1), the worst around "
                    "{}: the answer is poor near them; mesh that place anew, or remove the short edge that forces them",
                    where, needles, mesh.element_count(), needle, in_millimetres(mesh.centroid(worst))));
  if (const int node = hinge(mesh); node >= 0)
    found.push_back(
        fmt::format("{}: elements meet at {} in a {} only: a hinge, whose compliance depends on the mesh; let them "
                    "share whole sides where they are bonded",
                    where, in_millimetres(mesh.node(node)), mesh.dimension() == 2 ? "point" : "point or a line"));
  const double size = mesh.diagonal();
  if (size > 10 || size < 1e-4)
    found.push_back(
        fmt::format("{}: the mesh is {:.3g} mm from corner to corner: is `unit` right?", where, 1e3 * size));
  return found;
}

namespace {

/// Unit normal of a straight facet.
Place3 normal_of(const Mesh& mesh, const int* facet) {
  const Place3 along = place_of(mesh, facet[1]) - place_of(mesh, facet[0]);
  if (mesh.dimension() == 2) return Place3(along[1], -along[0], 0).normalized();
  return along.cross(place_of(mesh, facet[2]) - place_of(mesh, facet[0])).normalized();
}

/// Where two boundary facets meet, and by how much the surface turns there [rad].
struct Turn {
  int a, b, node;
  double angle;
};

std::vector<Turn> turns_of(const Mesh& mesh, const Tag& outside) {
  std::map<std::vector<int>, std::vector<int>> meeting;  // ends or edges of facets
  const int corners = mesh.dimension();
  for (int f = 0; f < outside.count(); ++f) {
    for (int left_out = 0; left_out < corners; ++left_out) {
      std::vector<int> shared;
      for (int i = 0; i < corners; ++i) {
        if (i != left_out) shared.push_back(outside.entity(f)[i]);
      }
      std::ranges::sort(shared);
      meeting[shared].push_back(f);
    }
  }
  std::vector<Turn> turns;
  for (const auto& [shared, facets] : meeting) {
    if (facets.size() != 2) continue;
    const Place3 a = normal_of(mesh, outside.entity(facets[0])), b = normal_of(mesh, outside.entity(facets[1]));
    turns.push_back({facets[0], facets[1], shared.front(), std::atan2(a.cross(b).norm(), a.dot(b))});
  }
  return turns;
}

}  // namespace

std::string straight_chords(const Mesh& linear, std::string_view where) {
  constexpr double degree = M_PI / 180, straight = 3 * degree, corner = 44.5 * degree;
  const Tag outside = boundary(linear);
  const std::vector<Turn> turns = turns_of(linear, outside);
  Sets sides(outside.count());  // facets in one plane, or nearly
  for (const Turn& turn : turns) {
    if (turn.angle < straight) sides.join(turn.a, turn.b);
  }
  std::map<int, std::set<int>> beside;  // by small turns
  const auto small = [&](const Turn& turn) { return turn.angle >= straight && turn.angle < corner; };
  for (const Turn& turn : turns) {
    const int a = sides.root(turn.a), b = sides.root(turn.b);
    if (!small(turn) || a == b) continue;
    beside[a].insert(b);
    beside[b].insert(a);
  }
  // A chamfer is one side between two small turns; a curve has several in a row.
  const auto of_curve = [&](int side) { return beside.contains(side) && beside.at(side).size() > 1; };
  const auto count = std::ranges::count_if(beside, [&](const auto& entry) { return of_curve(entry.first); });
  if (count < 2) return "";
  const Turn* widest = nullptr;
  for (const Turn& turn : turns) {
    const bool counts = small(turn) && of_curve(sides.root(turn.a)) && of_curve(sides.root(turn.b));
    if (counts && (widest == nullptr || turn.angle > widest->angle)) widest = &turn;
  }
  if (widest == nullptr) return "";
  return fmt::format(
      "{}: its linear elements become quadratic ones with straight sides, and {} flat pieces of its boundary turn by "
      "up "
      "to {:.0f} degrees from one to the next (at {}), as chords of a curve do; where the specimen is round there, "
      "save "
      "the mesh with elements of second order (Mesh.ElementOrder = 2 in the .geo)",
      where, count, widest->angle / degree, in_millimetres(linear.node(widest->node)));
}

}  // namespace taut

#include "sim/mesh/one_body.hpp"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <numeric>
#include <unordered_map>

#include "sim/core/error.hpp"
#include "sim/mesh/topology.hpp"

namespace taut {
namespace {

using Place3 = Eigen::Vector3d;

constexpr std::string_view join =
    "join them where the mesh is made (in Gmsh: Coherence before meshing, or 'Coherence Mesh' after it), or set bodies "
    "= "
    "\"separate\" under [geometry] if they are not bonded";

/// Things by the cells of a regular grid that they lie in.
class Grid {
 public:
  explicit Grid(double size) : size_(size) {}
  void add(const Place3& low, const Place3& high, int thing) {
    each_cell(low, high, [&](std::size_t cell) { things_[cell].push_back(thing); });
  }
  /// Calls `action` with all that may lie in the box; some more than once.
  template <class Action>
  void visit(const Place3& low, const Place3& high, Action&& action) const {
    each_cell(low, high, [&](std::size_t cell) {
      const auto found = things_.find(cell);
      if (found == things_.end()) return;
      for (int thing : found->second) action(thing);
    });
  }

 private:
  template <class Action>
  void each_cell(const Place3& low, const Place3& high, Action&& action) const {
    const auto cell = [&](double x) { return static_cast<long>(std::floor(x / size_)); };
    for (long i = cell(low[0]); i <= cell(high[0]); ++i) {
      for (long j = cell(low[1]); j <= cell(high[1]); ++j) {
        for (long k = cell(low[2]); k <= cell(high[2]); ++k)
          action((static_cast<std::size_t>(i) * 73856093u) ^ (static_cast<std::size_t>(j) * 19349663u) ^
                 (static_cast<std::size_t>(k) * 83492791u));
      }
    }
  }
  double size_;
  std::unordered_map<std::size_t, std::vector<int>> things_;
};

/// The straight simplices between the vertices of a mesh.
class Simplices {
 public:
  explicit Simplices(const Mesh& mesh) : mesh_(mesh), corners_(mesh.dimension() + 1) {
    std::vector<bool> vertex(static_cast<size_t>(mesh.node_count()), false);
    double sum = 0;
    int edges = 0;
    for (int e = 0; e < mesh.element_count(); ++e) {
      for (int a = 0; a < corners_; ++a) {
        vertex[static_cast<size_t>(mesh.element(e)[a])] = true;
        const double length = (at(mesh.element(e)[a]) - at(mesh.element(e)[(a + 1) % corners_])).norm();
        sum += length;
        ++edges;
      }
    }
    for (int i = 0; i < mesh.node_count(); ++i) {
      if (vertex[static_cast<size_t>(i)]) vertices_.push_back(i);
    }
    mean_edge_ = sum / std::max(edges, 1);
  }

  void refuse_coincident(std::string_view where) const {
    const double near = 1e-3 * mean_edge_;
    const Place3 reach = Place3::Constant(near);
    Grid grid(0.5 * mean_edge_);
    int pairs = 0, first = -1, second = -1;
    for (int i : vertices_) {
      grid.visit(at(i) - reach, at(i) + reach, [&](int other) {
        if (other == i || (at(i) - at(other)).norm() > near) return;
        if (pairs++ == 0) {
          first = other;
          second = i;
        }
      });
      grid.add(at(i), at(i), i);
    }
    if (pairs == 0) return;
    throw InputError(fmt::format(
        "{}: two nodes coincide at {}{}: the elements that meet there have nodes of their own and are not joined; {}",
        where, in_millimetres(mesh_.node(first)), pairs == 1 ? "" : fmt::format(", and {} pairs elsewhere", pairs - 1),
        join));
  }

  void refuse_parts(std::string_view where) const {
    std::vector<int> root(static_cast<size_t>(mesh_.node_count()));
    std::iota(root.begin(), root.end(), 0);
    const auto find = [&](int i) {
      while (root[static_cast<size_t>(i)] != i)
        i = root[static_cast<size_t>(i)] = root[static_cast<size_t>(root[static_cast<size_t>(i)])];
      return i;
    };
    for (int e = 0; e < mesh_.element_count(); ++e) {
      for (int a = 1; a < corners_; ++a)
        root[static_cast<size_t>(find(mesh_.element(e)[a]))] = find(mesh_.element(e)[0]);
    }
    std::vector<int> elements;  // the first of each part
    std::vector<int> roots;
    for (int e = 0; e < mesh_.element_count(); ++e) {
      const int r = find(mesh_.element(e)[0]);
      if (std::ranges::find(roots, r) != roots.end()) continue;
      roots.push_back(r);
      elements.push_back(e);
      if (roots.size() == 100) break;
    }
    if (roots.size() < 2) return;
    throw InputError(fmt::format("{}: the mesh has {} parts that share no node, one of them at {}, another at {}; {}",
                                 where, roots.size() == 100 ? "100 or more" : std::to_string(roots.size()),
                                 in_millimetres(mesh_.centroid(elements[0])),
                                 in_millimetres(mesh_.centroid(elements[1])), join));
  }

  void refuse_overlaps(std::string_view where, bool separate) const {
    Grid grid(mean_edge_);
    for (int i : vertices_) grid.add(at(i), at(i), i);
    for (int e = 0; e < mesh_.element_count(); ++e) {
      Place3 low = at(mesh_.element(e)[0]), high = low;
      for (int a = 1; a < corners_; ++a) {
        low = low.cwiseMin(at(mesh_.element(e)[a]));
        high = high.cwiseMax(at(mesh_.element(e)[a]));
      }
      grid.visit(low, high, [&](int i) {
        const double depth = depth_of(i, e);
        if (depth > 1e-3) {
          throw InputError(
              fmt::format("{}: elements overlap at {}: a node lies inside the element around {}; cut one of the bodies "
                          "out of the other where the mesh is made (in Gmsh: BooleanFragments)",
                          where, in_millimetres(mesh_.node(i)), in_millimetres(mesh_.centroid(e))));
        }
        if (depth > -1e-6 && !separate) {
          throw InputError(fmt::format(
              "{}: a hanging node at {} lies on the side of the element around {} without being one of its nodes: the "
              "elements on either side are not joined there; mesh both sides with the same nodes",
              where, in_millimetres(mesh_.node(i)), in_millimetres(mesh_.centroid(e))));
        }
      });
    }
  }

 private:
  Place3 at(int node) const {
    Place3 x = Place3::Zero();
    x.head(mesh_.dimension()) = mesh_.X.segment(node * mesh_.dimension(), mesh_.dimension());
    return x;
  }

  /// The smallest barycentric coordinate of a vertex in an element: negative outside. -1 for the element's own.
  double depth_of(int node, int e) const {
    const int* nodes = mesh_.element(e);
    if (std::find(nodes, nodes + corners_, node) != nodes + corners_) return -1;
    const int d = mesh_.dimension();
    Eigen::MatrixXd edges(d, d);
    for (int a = 0; a < d; ++a) edges.col(a) = (at(nodes[a + 1]) - at(nodes[0])).head(d);
    const Eigen::VectorXd weights = edges.partialPivLu().solve((at(node) - at(nodes[0])).head(d));
    const double depth = std::min(weights.minCoeff(), 1 - weights.sum());
    // What coincides with one of its vertices lies beside the element, not on its side.
    const bool at_vertex = std::max(weights.maxCoeff(), 1 - weights.sum()) > 1 - 1e-3;
    return at_vertex ? -1 : depth;
  }

  const Mesh& mesh_;
  int corners_;
  std::vector<int> vertices_;
  double mean_edge_ = 0;
};

}  // namespace

void check_one_body(const Mesh& mesh, std::string_view where, bool separate) {
  const Simplices simplices(mesh);
  if (!separate) simplices.refuse_coincident(where);
  simplices.refuse_overlaps(where, separate);
  if (!separate) simplices.refuse_parts(where);
}

}  // namespace taut

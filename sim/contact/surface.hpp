#pragma once
#include <fmt/format.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <limits>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "sim/core/error.hpp"
#include "sim/core/parameters.hpp"
#include "sim/mesh/mesh.hpp"

// What the surfaces of contact in the plane and in space have in common; kinds of features, their distances and their
// derivatives stand with each.
namespace taut {

/// The kappa of a pair: the smaller value, and between equals the lower index; -1 stands for "the other's".
inline int softer(const Params& p, int one, int two) {
  if (one < 0 || two < 0) return std::max(one, two);
  if (p[one] != p[two]) return p[one] < p[two] ? one : two;
  return std::min(one, two);
}

/// A list of numbers per feature.
struct IndexLists {
  std::vector<size_t> offsets{0};
  std::vector<int> items;
  std::pair<const int*, const int*> operator[](int i) const {
    return {items.data() + offsets[static_cast<size_t>(i)], items.data() + offsets[static_cast<size_t>(i) + 1]};
  }
  void add(const std::vector<int>& list) {
    items.insert(items.end(), list.begin(), list.end());
    offsets.push_back(items.size());
  }
  void assign(const std::vector<std::vector<int>>& lists) {
    for (const std::vector<int>& list : lists) add(list);
  }
};

/// Vertices of a boundary in D dimensions: the nodes of its features in ascending order, then others that stay where
/// they are. Grounds are half-spaces {x: (x - point) . normal > 0}. Settings are ContactSettings or Contact3dSettings.
template <int D, class Settings>
struct ContactSurface {
  using Place = Eigen::Matrix<double, D, 1>;
  using Places = Eigen::Matrix<double, D, Eigen::Dynamic>;
  using Box = Eigen::AlignedBox<double, D>;

  /// Displacements of the vertices; relative positions without the digits that positions share.
  struct State {
    const ContactSurface& surface;
    Places u;
    Place from(int b, int a) const { return (surface.X.col(a) - surface.X.col(b)) + (u.col(a) - u.col(b)); }
    double height(int ground, int v) const {
      const auto& plane = surface.settings.grounds[static_cast<size_t>(ground)];
      return (surface.X.col(v) - plane.point).dot(plane.normal) + u.col(v).dot(plane.normal);
    }
    Places positions() const { return surface.X + u; }
    /// By how much positions may be rounded [m].
    double rounding() const { return 1e-15 * (surface.X.cwiseAbs().maxCoeff() + u.cwiseAbs().maxCoeff()); }
  };

  Settings settings;
  std::vector<int> nodes;  ///< mesh node of each vertex that moves
  Places X;                ///< all vertices [m]

  explicit ContactSurface(Settings given) : settings(std::move(given)) {}

  int vertices() const { return static_cast<int>(X.cols()); }
  int moving() const { return static_cast<int>(nodes.size()); }
  int ground_count() const { return static_cast<int>(settings.grounds.size()); }

  /// The features of the mesh by vertices, which are made here. `what` names one in messages, "an edge".
  template <size_t N>
  std::vector<std::array<int, N>> number_vertices(const Mesh& mesh, const std::vector<std::array<int, N>>& features,
                                                  std::string_view what) {
    if (mesh.dimension() != D) throw std::logic_error("contact: the mesh has another dimension");
    if (settings.gap < 0) throw std::logic_error("contact: no parameter for the gap");
    if (settings.stiffness.size() != features.size())
      throw std::logic_error(fmt::format("contact: each feature ({}) needs a stiffness", what));
    if (!settings.apart.empty() && settings.part.size() != static_cast<size_t>(mesh.node_count()))
      throw std::logic_error("contact: parts that do not see each other need the part of each node");
    for (const auto& feature : features) {
      for (int node : feature) {
        if (node < 0 || node >= mesh.node_count())
          throw std::logic_error(fmt::format("contact: {} has a node outside the mesh", what));
        nodes.push_back(node);
      }
    }
    if (std::any_of(settings.stiffness.begin(), settings.stiffness.end(), [](int index) { return index < 0; }))
      throw std::logic_error(fmt::format("contact: {} has no stiffness", what));
    std::sort(nodes.begin(), nodes.end());
    nodes.erase(std::unique(nodes.begin(), nodes.end()), nodes.end());
    X.resize(D, moving());
    for (int v = 0; v < moving(); ++v) X.col(v) = mesh.node(nodes[static_cast<size_t>(v)]);
    std::vector<std::array<int, N>> numbered = features;
    for (auto& feature : numbered) {
      for (int& v : feature) v = static_cast<int>(std::lower_bound(nodes.begin(), nodes.end(), v) - nodes.begin());
    }
    return numbered;
  }

  /// Makes the grounds' normals unit vectors; throws InputError for those without direction.
  void normalise_grounds() {
    for (size_t g = 0; g < settings.grounds.size(); ++g) {
      auto& ground = settings.grounds[g];
      if (!ground.point.allFinite() || !ground.normal.allFinite() || !(ground.normal.norm() > 0))
        throw InputError(fmt::format("contact: ground {} needs a finite point and a normal of unit length", g + 1));
      ground.normal.normalize();
    }
  }

  /// Two vertices of parts that do not see each other.
  bool apart(int v, int w) const {
    if (settings.apart.empty() || v >= moving() || w >= moving()) return false;
    const auto part_of = [&](int vertex) {
      return settings.part[static_cast<size_t>(nodes[static_cast<size_t>(vertex)])];
    };
    const int one = part_of(v), two = part_of(w);
    return one != two && std::any_of(settings.apart.begin(), settings.apart.end(), [&](const auto& pair) {
             return (pair[0] == one && pair[1] == two) || (pair[0] == two && pair[1] == one);
           });
  }

  State state(const Eigen::VectorXd& all) const {
    State s{*this, Places::Zero(D, vertices())};
    for (int v = 0; v < moving(); ++v)
      s.u.col(v) = all.template segment<D>(D * Eigen::Index(nodes[static_cast<size_t>(v)]));
    return s;
  }

  /// Boxes of the features from `begin` to `end` around those that box_of(vertex) gives.
  template <class BoxOf, class Iterator>
  static std::vector<Box> boxes_of(Iterator begin, Iterator end, BoxOf&& box_of) {
    std::vector<Box> boxes;
    boxes.reserve(static_cast<size_t>(end - begin));
    for (; begin != end; ++begin) {
      Box box;
      for (int v : *begin) box.extend(box_of(v));
      boxes.push_back(box);
    }
    return boxes;
  }

  /// Boxes of the ways of the vertices. A pair that comes down to a tenth of its distance d moves by 0.9 d: boxes that
  /// much wider see all of them.
  struct Sweep {
    Places x, y;
    double margin;
    Sweep(const State& s, const State& change)
        : x(s.positions()),
          y(x + change.u),
          margin(1e-15 * std::max(x.cwiseAbs().maxCoeff(), y.cwiseAbs().maxCoeff()) +
                 0.12 * change.u.colwise().norm().maxCoeff()) {}
    Box operator()(int v) const {
      return Box(x.col(v).cwiseMin(y.col(v)).array() - margin, x.col(v).cwiseMax(y.col(v)).array() + margin);
    }
  };

  /// Largest fraction of a step, at most 1, on which every vertex keeps a tenth of its height over the grounds.
  double ground_limit(const State& s, const State& change) const {
    double limit = 1;
    for (int g = 0; g < ground_count(); ++g) {
      for (int v = 0; v < moving(); ++v) {
        const double height = s.height(g, v);
        const double fall = -change.u.col(v).dot(settings.grounds[static_cast<size_t>(g)].normal);
        if (fall > 0 && 0.9 * height < limit * fall) limit = std::max(0.0, 0.9 * height / fall);
      }
    }
    return limit;
  }

  /// Smallest height of a vertex over a ground (negative behind it); +inf when none is below `horizon`.
  double lowest(const State& s, double horizon) const {
    double lowest = std::numeric_limits<double>::infinity();
    for (int g = 0; g < ground_count(); ++g) {
      for (int v = 0; v < moving(); ++v) {
        const double height = s.height(g, v);
        if (height < horizon) lowest = std::min(lowest, height);
      }
    }
    return lowest;
  }

  /// Whether a vertex lies on or behind a ground, or nowhere.
  bool behind_a_ground(const State& s) const {
    for (int g = 0; g < ground_count(); ++g) {
      for (int v = 0; v < moving(); ++v) {
        if (!(s.height(g, v) > 0)) return true;
      }
    }
    return false;
  }
};

}  // namespace taut

#pragma once
#include <fmt/format.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <initializer_list>
#include <limits>
#include <map>
#include <span>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "sim/contact/contact_geometry.hpp"
#include "sim/contact/contact_geometry_3d.hpp"
#include "sim/contact/contact_term.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/parameters.hpp"
#include "sim/core/sorted.hpp"
#include "sim/mesh/mesh.hpp"

// What contact in the plane and in space have in common; kinds of features, their distances and their derivatives stand
// with each.
namespace taut {

/// The kappa of a pair: the smaller value, and between equals the lower index; -1 stands for "the other's".
inline int softer(const Params& p, int one, int two) {
  if (one < 0 || two < 0) return std::max(one, two);
  if (p[one] != p[two]) return p[one] < p[two] ? one : two;
  return std::min(one, two);
}

/// The kappa of a feature that belongs to these others.
inline int softest(const Params& p, std::span<const int> features, const std::vector<int>& stiffness) {
  int least = -1;
  for (int feature : features) least = softer(p, least, stiffness[feature]);
  return least;
}

/// A list of numbers per feature.
struct IndexLists {
  std::vector<size_t> offsets{0};
  std::vector<int> items;
  /// Those of feature i.
  std::span<const int> operator[](int i) const { return {items.data() + offsets[i], items.data() + offsets[i + 1]}; }
  /// Puts these lists after what it has.
  void assign(const std::vector<std::vector<int>>& lists) {
    for (const std::vector<int>& list : lists) {
      items.insert(items.end(), list.begin(), list.end());
      offsets.push_back(items.size());
    }
  }
};

/// Whether two short lists have a number in common.
inline bool have_common(std::span<const int> one, std::span<const int> two) {
  return std::ranges::any_of(one, [&](int item) { return std::ranges::find(two, item) != two.end(); });
}

/// weight * kappa * b(distance) of a vertex and another vertex, an edge, a triangle or a ground, or of two edges.
struct Interaction {
  /// What meets a vertex; or two edges.
  enum class Kind { vertex, edge, triangle, edges, ground };
  Kind kind;
  int first, second;  ///< vertex and other feature, or edges
  int stiffness;      ///< table index
  double weight;      ///< without kappa; negative where a feature is taken back
  double distance;    ///< [m]
};

/// What is asked of a pair's energy f: f, f' and f'' by its distance, and which Hessian.
struct OfDistance {
  double value = 0, first = 0, second = 0;
  bool wants_hessian = false;
  Curvature curvature = Curvature::exact;
};

/// Gradient of a pair's energy and, where asked for, its Hessian, on the nodes that take part.
template <int D, int most>
struct Local {
  int count = 0;
  std::array<int, most> nodes{};
  Eigen::Matrix<double, Eigen::Dynamic, 1, 0, D * most, 1> gradient;
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor, D * most, D * most> hessian;

  /// Begins anew, with zeros, on these vertices.
  void use(const std::vector<int>& mesh_nodes, std::initializer_list<int> vertices) {
    count = 0;
    for (int v : vertices) nodes[count++] = mesh_nodes[v];
  }
};

/// Two features that come nearer than some reach: a vertex and an edge or a triangle, or two edges.
template <class Closest>
struct Near {
  int first, second;
  Closest closest;
  /// By first, then second.
  bool operator<(const Near& other) const { return std::pair(first, second) < std::pair(other.first, other.second); }
};

/// How near the points, or the segment or triangle between them, come to a pin in the plane across its axis [m].
template <int D, size_t N>
double distance_to(const PinPatch<D>& pin, const std::array<Eigen::Matrix<double, D, 1>, N>& points) {
  Eigen::Matrix<double, 2, D> across = Eigen::Matrix<double, 2, D>::Identity();
  if constexpr (D == 3)
    across << pin.axis.unitOrthogonal().transpose(), pin.axis.cross(pin.axis.unitOrthogonal()).transpose();
  std::array<Eigen::Vector2d, N> r;
  for (size_t i = 0; i < N; ++i) r[i] = across * (pin.point - points[i]);
  if constexpr (N == 1) return r[0].norm();
  double least = std::numeric_limits<double>::infinity(), turns[N];
  for (size_t i = 0; i < N; ++i) {
    const Eigen::Vector2d &a = r[i], &b = r[(i + 1) % N];
    least = std::min(least, closest_on_segment(a, a - b).distance);
    turns[i] = a[0] * b[1] - a[1] * b[0];
  }
  if constexpr (N == 3) {
    const auto [low, high] = std::minmax_element(turns, turns + 3);
    if (*low > 0 || *high < 0) return 0;
  }
  return least;
}

/// action(span) for the runs of pairs, which are sorted, with one vertex.
template <class Pair, class Action>
void each_vertex(const std::vector<Pair>& pairs, Action&& action) {
  for (size_t begin = 0, end = 0; begin < pairs.size(); begin = end) {
    while (end < pairs.size() && pairs[end].first == pairs[begin].first) ++end;
    action(std::span(pairs).subspan(begin, end - begin));
  }
}

/// The facets of a mesh's boundary, each cut into pieces of these nodes of its own.
template <size_t N>
std::vector<std::array<int, N>> pieces_of_boundary(const Mesh& mesh, const std::vector<std::array<int, N>>& pieces) {
  const Tag facets = boundary(mesh);
  std::vector<std::array<int, N>> all;
  for (int f = 0; f < facets.count(); ++f) {
    for (std::array<int, N> piece : pieces) {
      for (int& node : piece) node = facets.entity(f)[node];
      all.push_back(piece);
    }
  }
  return all;
}

/// Vertices of a boundary in D dimensions: the nodes of its features in ascending order, then others that stay where
/// they are. Settings are ContactSettings or Contact3dSettings.
template <int D, class Settings>
struct ContactSurface {
  static constexpr int dimension = D;
  using Place = Eigen::Matrix<double, D, 1>;                ///< a point [m]
  using Places = Eigen::Matrix<double, D, Eigen::Dynamic>;  ///< a column per vertex [m]
  using Box = Eigen::AlignedBox<double, D>;                 ///< along the axes

  /// Displacements of the vertices; relative positions without the digits that positions share.
  struct State {
    const ContactSurface& surface;
    Places u;
    Places ground_u;  ///< a column per ground
    /// From vertex a to vertex b [m].
    Place from(int b, int a) const { return (surface.X.col(a) - surface.X.col(b)) + (u.col(a) - u.col(b)); }
    /// Of vertex v over a ground [m].
    double height(int ground, int v) const {
      const auto& of = surface.settings.grounds[ground];
      if (of.is_round()) return of.height(from_ground(ground, v));
      return (surface.X.col(v) - of.point).dot(of.normal) + (u.col(v) - ground_u.col(ground)).dot(of.normal);
    }
    /// From a ground's point to vertex v [m].
    Place from_ground(int ground, int v) const {
      return (surface.X.col(v) - surface.settings.grounds[ground].point) + (u.col(v) - ground_u.col(ground));
    }
    Places positions() const { return surface.X + u; }  ///< x = X + u [m]
    /// By how much positions may be rounded [m].
    double rounding() const { return 1e-15 * (surface.X.cwiseAbs().maxCoeff() + u.cwiseAbs().maxCoeff()); }
  };

  Settings settings;
  std::vector<int> nodes;  ///< mesh node of each vertex that moves
  Places X;                ///< all vertices [m]

  explicit ContactSurface(Settings given) : settings(std::move(given)) {}  ///< without vertices yet

  int vertices() const { return static_cast<int>(X.cols()); }    ///< all of them
  int moving() const { return static_cast<int>(nodes.size()); }  ///< those of the mesh, which come first
  int ground_count() const { return static_cast<int>(settings.grounds.size()); }  ///< see ContactSides

  /// The features of the mesh by vertices, which are made here. `what` names one in messages, "an edge".
  template <size_t N>
  std::vector<std::array<int, N>> number_vertices(const Mesh& mesh, const std::vector<std::array<int, N>>& features,
                                                  std::string_view what) {
    if (mesh.dimension() != D) throw std::logic_error("contact: the mesh has another dimension");
    if (settings.gap < 0) throw std::logic_error("contact: no parameter for the gap");
    if (settings.stiffness.size() != features.size())
      throw std::logic_error(fmt::format("contact: each feature ({}) needs a stiffness", what));
    if (!settings.patches.empty() && static_cast<int>(settings.part.size()) != mesh.node_count())
      throw std::logic_error("contact: patches where parts do not see each other need the part of each node");
    for (const auto& feature : features) {
      for (int node : feature) {
        if (node < 0 || node >= mesh.node_count())
          throw std::logic_error(fmt::format("contact: {} has a node outside the mesh", what));
        nodes.push_back(node);
      }
    }
    if (std::any_of(settings.stiffness.begin(), settings.stiffness.end(), [](int index) { return index < 0; }))
      throw std::logic_error(fmt::format("contact: {} has no stiffness", what));
    sort_unique(nodes);
    X.resize(D, moving());
    for (int v = 0; v < moving(); ++v) X.col(v) = mesh.node(nodes[v]);
    std::vector<std::array<int, N>> numbered = features;
    for (auto& feature : numbered) {
      for (int& v : feature) v = static_cast<int>(std::lower_bound(nodes.begin(), nodes.end(), v) - nodes.begin());
    }
    return numbered;
  }

  /// Makes the grounds' normals unit vectors; throws InputError for those without direction or radius.
  void normalise_grounds() {
    for (size_t g = 0; g < settings.grounds.size(); ++g) {
      auto& ground = settings.grounds[g];
      if (ground.kind == GroundKind::cylinder && D == 2)
        throw InputError(
            fmt::format("contact: ground {} is a cylinder in the plane; take a sphere, a disc there", g + 1));
      if (ground.is_round() && !(std::isfinite(ground.radius) && ground.radius > 0))
        throw InputError(fmt::format("contact: ground {} is round and needs a positive radius", g + 1));
      if (ground.kind == GroundKind::sphere) ground.normal = Place::Unit(D - 1);  // it has none
      if (!ground.point.allFinite() || !ground.normal.allFinite() || !(ground.normal.norm() > 0))
        throw InputError(fmt::format("contact: ground {} needs a finite point and a normal of unit length", g + 1));
      ground.normal.normalize();
    }
  }
  /// The gradient and the Hessian of f(h) of a vertex over a ground, on it and, where that moves, the ground's node.
  template <class Local>
  void differentiate_height(const State& s, const Interaction& i, const OfDistance& f, Local& out) const {
    const Ground<D>& ground = settings.grounds[i.second];
    const Place r = s.from_ground(i.second, i.first), up = ground.up(r);
    const int count = ground.node < 0 ? 1 : 2;
    out.count = count;
    out.nodes[0] = nodes[i.first];
    out.gradient.resize(D * count);
    out.gradient.template head<D>() = f.first * up;
    if (count == 2) {
      out.nodes[1] = ground.node;
      out.gradient.template tail<D>() = -f.first * up;
    }
    if (!f.wants_hessian) return;
    Eigen::Matrix<double, D, D> own = f.second * up * up.transpose();
    // The barrier falls with the height, so that what is round adds a negative part.
    if (ground.is_round() && (f.curvature == Curvature::exact || f.first > 0)) own += f.first * ground.curvature(r);
    out.hessian.resize(D * count, D * count);
    for (int a = 0; a < count; ++a) {
      for (int b = 0; b < count; ++b) out.hessian.template block<D, D>(D * a, D * b) = a == b ? own : -own;
    }
  }
  /// Whether a facet comes nearer to the middle of a round ground than half of its radius.
  template <size_t N>
  bool cuts_ground(const State& s, const std::vector<std::array<int, N>>& facets) const {
    for (int g = 0; g < ground_count(); ++g) {
      const Ground<D>& ground = settings.grounds[g];
      if (!ground.is_round()) continue;
      PinPatch<D> middle{{}, Place::Zero(), Place::Zero(), 0};
      if constexpr (D == 3) middle.axis = ground.normal;
      for (const auto& facet : facets) {
        std::array<Place, N> r;
        for (size_t k = 0; k < N; ++k) r[k] = s.from_ground(g, facet[k]);
        double distance = infinity;
        if constexpr (D == 3) {
          distance = ground.kind == GroundKind::cylinder
                         ? distance_to<D, N>(middle, r)
                         : closest_on_triangle(-r[0], r[1] - r[0], r[2] - r[0]).distance;
        } else {
          distance = distance_to<D, N>(middle, r);
        }
        if (distance < 0.5 * ground.radius) return true;
      }
    }
    return false;
  }

  /// The part that a vertex of the mesh is of.
  int part_of(int v) const { return settings.part.empty() ? 0 : settings.part[nodes[v]]; }

  /// How near a feature at rest comes to a pin; infinitely far where it is of neither of its parts [m].
  template <size_t N>
  double from_pin(const PinPatch<D>& pin, const std::array<int, N>& feature) const {
    if (feature[0] >= moving()) return std::numeric_limits<double>::infinity();
    const int part = settings.part[nodes[feature[0]]];
    if (part != pin.parts[0] && part != pin.parts[1]) return std::numeric_limits<double>::infinity();
    std::array<Place, N> points;
    for (size_t i = 0; i < N; ++i) points[i] = X.col(feature[i]);
    return distance_to<D, N>(pin, points);
  }
  /// The patches that each of the features reaches into.
  template <size_t N>
  IndexLists patches_of(const std::vector<std::array<int, N>>& features) const {
    std::vector<std::vector<int>> lists(features.size());
    for (size_t k = 0; k < settings.patches.size(); ++k) {
      for (size_t f = 0; f < features.size(); ++f) {
        if (from_pin(settings.patches[k], features[f]) <= settings.patches[k].radius)
          lists[f].push_back(static_cast<int>(k));
      }
    }
    IndexLists patches;
    patches.assign(lists);
    return patches;
  }
  /// The same of each vertex.
  IndexLists patches_of_vertices() const {
    std::vector<std::array<int, 1>> single;
    for (int v = 0; v < vertices(); ++v) single.push_back({v});
    return patches_of(single);
  }
  /// Whether two vertices are of different parts.
  bool of_two_parts(int v, int w) const {
    return v < moving() && w < moving() && settings.part[nodes[v]] != settings.part[nodes[w]];
  }
  /// The farther of two features that meet about a pin; nothing where it does not join their parts [m].
  template <size_t N, size_t M>
  void extend_overlap(const PinPatch<D>& pin, const std::array<int, N>& one, const std::array<int, M>& two,
                      double& farthest) const {
    const double distance = std::max(from_pin(pin, one), from_pin(pin, two));
    if (of_two_parts(one[0], two[0]) && std::isfinite(distance)) farthest = std::max(farthest, distance);
  }

  /// That of a vector of all unknowns.
  State state(const Eigen::VectorXd& all) const {
    State s{*this, Places::Zero(D, vertices()), Places::Zero(D, ground_count())};
    for (int v = 0; v < moving(); ++v) s.u.col(v) = all.template segment<D>(D * nodes[v]);
    for (int g = 0; g < ground_count(); ++g) {
      if (settings.grounds[g].node >= 0) s.ground_u.col(g) = all.template segment<D>(D * settings.grounds[g].node);
    }
    return s;
  }

  /// Boxes of the features from `begin` to `end` around those that box_of(vertex) gives.
  template <class BoxOf, class Iterator>
  static std::vector<Box> boxes_of(Iterator begin, Iterator end, BoxOf&& box_of) {
    std::vector<Box> boxes;
    boxes.reserve(end - begin);
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
    double margin;  ///< [m]
    /// Of a step `change` from `s`.
    Sweep(const State& s, const State& change)
        : x(s.positions()),
          y(x + change.u),
          margin(1e-15 * std::max(x.cwiseAbs().maxCoeff(), y.cwiseAbs().maxCoeff()) +
                 0.12 * change.u.colwise().norm().maxCoeff()) {}
    /// Around the way of vertex v.
    Box operator()(int v) const {
      return Box(x.col(v).cwiseMin(y.col(v)).array() - margin, x.col(v).cwiseMax(y.col(v)).array() + margin);
    }
  };

  /// Largest fraction of a step, at most 1, on which every vertex keeps a tenth of its height over the grounds.
  double ground_limit(const State& s, const State& change) const {
    double limit = 1;
    each_height(s, [&](int g, int v, double height) {
      const Place dr = change.u.col(v) - change.ground_u.col(g);
      limit = settings.grounds[g].free_motion(s.from_ground(g, v), dr, height, limit);
    });
    return limit;
  }

  /// action(ground, vertex, height) for all that could meet.
  template <class Action>
  void each_height(const State& s, Action&& action) const {
    for (int g = 0; g < ground_count(); ++g) {
      for (int v = 0; v < moving(); ++v) action(g, v, s.height(g, v));
    }
  }
};

template <int D>
double Ground<D>::free_motion(const Vector& r, const Vector& dr, double h, double limit) const {
  if (!is_round()) {
    const double fall = -dr.dot(normal);
    return fall > 0 && 0.9 * h < limit * fall ? std::max(0.0, 0.9 * h / fall) : limit;
  }
  if (!(h > 0)) return 0;
  // |r + t dr|^2 = (radius + h/10)^2, whose constant is written without the squares that cancel.
  const Vector from = across(r), way = across(dr);
  const double a = way.squaredNorm(), b = from.dot(way), c = 0.9 * h * (2 * radius + 1.1 * h);
  const double discriminant = b * b - a * c;
  if (!(b < 0) || !(discriminant >= 0)) return limit;
  return std::min(limit, c / (-b + std::sqrt(discriminant)));
}

template <class Surface, class Settings, class Pair>
SurfaceContact<Surface, Settings, Pair>::SurfaceContact(const Mesh& mesh, Settings settings)
    : surface_(std::make_unique<const Surface>(mesh, std::move(settings))) {}
template <class Surface, class Settings, class Pair>
SurfaceContact<Surface, Settings, Pair>::~SurfaceContact() = default;

/// What two sides have with each other.
template <class Surface, class Settings, class Pair>
class SurfaceContact<Surface, Settings, Pair>::Between final : public Term {
 public:
  /// Of a contact that outlives it.
  Between(const SurfaceContact& contact, Sides sides) : contact_(&contact), sides_(sides) {}
  void assemble(const Point& at, Assembly& out) const override { contact_->assemble(at, &sides_, out); }
  bool depends_on(int index) const override { return contact_->depends_on(index); }
  void add_parameter_gradient(const Point& at, int index, Eigen::VectorXd& out) const override {
    contact_->add_parameter_gradient(at, index, &sides_, out);
  }

 private:
  const SurfaceContact* contact_;
  Sides sides_;
};

template <class Surface, class Settings, class Pair>
std::unique_ptr<Term> SurfaceContact<Surface, Settings, Pair>::between(Sides sides) const {
  return std::make_unique<Between>(*this, sides);
}
template <class Surface, class Settings, class Pair>
int SurfaceContact<Surface, Settings, Pair>::side_of_obstacle(int number) const {
  return -1 - number;
}
template <class Surface, class Settings, class Pair>
int SurfaceContact<Surface, Settings, Pair>::side_of_ground(int number) const {
  return surface_->side_of(surface_->feature_count() + number);
}

/// action(state, interaction) for all, or for those of two sides.
template <class Surface, class Settings, class Pair>
template <class Action>
void SurfaceContact<Surface, Settings, Pair>::each_interaction(const Point& at, const Sides* between,
                                                               Action&& action) const {
  const typename Surface::State s = surface_->state(at.u);
  for (const Interaction& i : surface_->interactions(s, at.p)) {
    if (between != nullptr) {
      const Sides sides{surface_->side_of_vertex(surface_->vertex_of(i)), surface_->other_side(i)};
      if (sides != *between && sides != Sides{(*between)[1], (*between)[0]}) continue;
    }
    if (!action(s, i)) return;
  }
}

template <class Surface, class Settings, class Pair>
void SurfaceContact<Surface, Settings, Pair>::assemble(const Point& at, Assembly& out) const {
  assemble(at, nullptr, out);
}

template <class Surface, class Settings, class Pair>
void SurfaceContact<Surface, Settings, Pair>::assemble(const Point& at, const Sides* between, Assembly& out) const {
  const double scale = surface_->scale(at.p);
  typename Surface::Local local;
  each_interaction(at, between, [&](const typename Surface::State& s, const Interaction& i) {
    if (!(i.distance > 0) && !surface_->penalty()) {
      out.add_energy(infinity);
      return false;
    }
    const auto law = surface_->law(i, at.p);
    const double factor = scale * at.p[i.stiffness] * i.weight, mollified = surface_->mollified(s, i);
    OfDistance f{factor * law.value(i.distance), 0, 0, out.wants_hessian(), out.curvature};
    out.add_energy(factor * mollified * law.value(i.distance));
    if (i.distance == 0 && i.kind != Interaction::Kind::ground) return true;  // a spring of no direction
    f.first = factor * law.slope(i.distance);
    // Displacements are rounded, and with them the distance.
    out.magnitude += std::abs(mollified * f.first) * s.u.col(surface_->vertex_of(i)).cwiseAbs().maxCoeff();
    if (out.gradient == nullptr && !f.wants_hessian) return true;
    if (f.wants_hessian) f.second = factor * law.curvature(i.distance);
    surface_->differentiate(s, i, f, local);
    constexpr int D = Surface::dimension;
    if (out.gradient != nullptr) out.add_gradient(local.nodes.data(), local.count, D, local.gradient.data());
    if (f.wants_hessian) out.add_coupling(local.nodes.data(), local.count, D, local.hessian.data());
    return true;
  });
}

template <class Surface, class Settings, class Pair>
int SurfaceContact<Surface, Settings, Pair>::vertices() const {
  return surface_->vertices();
}

template <class Surface, class Settings, class Pair>
auto SurfaceContact<Surface, Settings, Pair>::touches(const Point& at, const Eigen::VectorXd* du,
                                                      const Params* dp) const -> std::vector<Touch<dimension>> {
  constexpr int D = dimension;
  using Vector = Eigen::Matrix<double, D, 1>;
  const typename Surface::State s = surface_->state(at.u);
  std::map<std::array<int, 2>, std::pair<double, Touch<D>>> found;  // by vertex and side, with the smallest distance
  const auto meet = [&](int vertex, int feature, double distance) {
    auto& [nearest, touch] =
        found.try_emplace({vertex, surface_->side_of(feature)}, infinity, Touch<D>()).first->second;
    if (!(distance < nearest)) return;
    nearest = distance;
    touch.vertex = vertex;
    touch.feature = feature;
  };
  const double gap = at.p[surface_->settings.gap];
  surface_->each_point_pair(s, gap, meet);
  surface_->each_height(s, [&](int g, int v, double height) {
    if (height < gap) meet(v, surface_->feature_count() + g, height);
  });
  typename Surface::Local local;
  // What a vertex that is fixed feels is what the others do, the other way round.
  const auto on_vertex = [&](int vertex, const auto& on_places) {
    Vector others = Vector::Zero();
    for (int k = 0; k < local.count; ++k) {
      const Vector own = on_places.template segment<D>(D * k);
      if (vertex < surface_->moving() && local.nodes[k] == surface_->nodes[vertex]) return own;
      others -= own;
    }
    return others;
  };
  const double scale = surface_->scale(at.p);
  for (const Interaction& i : surface_->interactions(s, at.p)) {
    if (i.kind == Interaction::Kind::edges || i.distance == 0) continue;
    Touch<D>& touch = found.at({i.first, surface_->other_side(i)}).second;
    const auto law = surface_->law(i, at.p);
    const double factor = scale * at.p[i.stiffness] * i.weight;
    const OfDistance f{0, factor * law.slope(i.distance), factor * law.curvature(i.distance), du != nullptr};
    surface_->differentiate(s, i, f, local);
    touch.force -= on_vertex(i.first, local.gradient);
    if (du != nullptr) {
      Eigen::Matrix<double, Eigen::Dynamic, 1> moved(D * local.count);
      for (int k = 0; k < local.count; ++k)
        moved.template segment<D>(D * k) = du->template segment<D>(D * local.nodes[k]);
      touch.change -= on_vertex(i.first, Eigen::VectorXd(local.hessian * moved));
    }
    for (Eigen::Index index = 0; dp != nullptr && index < dp->size(); ++index) {
      if ((*dp)[index] == 0 || !depends_on(static_cast<int>(index))) continue;
      surface_->differentiate(s, i, surface_->parameter_derivative(i, at.p, static_cast<int>(index)), local);
      touch.change -= (*dp)[index] * on_vertex(i.first, local.gradient);
    }
  }
  std::vector<Touch<D>> touches;
  for (const auto& [where, one] : found) touches.push_back(one.second);
  return touches;
}

template <class Surface, class Settings, class Pair>
auto SurfaceContact<Surface, Settings, Pair>::meeting(int vertex, int feature, const Params& p) const
    -> Meeting<dimension> {
  Meeting<dimension> meeting;
  meeting.side = surface_->side_of(feature);
  meeting.own_side = surface_->side_of_vertex(vertex);
  meeting.nodes.fill(-1);
  meeting.X.col(0) = surface_->X.col(vertex);
  if (vertex < surface_->moving()) meeting.nodes[0] = surface_->nodes[vertex];
  const int own = surface_->stiffness_of(p, vertex), ground = feature - surface_->feature_count();
  if (ground >= 0) {
    meeting.ground = &surface_->settings.grounds[static_cast<size_t>(ground)];
    meeting.nodes[1] = meeting.ground->node;
    meeting.X.template rightCols<dimension>().colwise() = meeting.ground->point;
    meeting.stiffness = softer(p, own, surface_->settings.obstacle_stiffness);
    meeting.area = 2 * surface_->share_of(vertex);  // all of it is at the body's nodes
    return meeting;
  }
  const auto& corners = surface_->corners_of(feature);
  for (size_t k = 0; k < corners.size(); ++k) {
    meeting.X.col(static_cast<Eigen::Index>(k) + 1) = surface_->X.col(corners[k]);
    if (corners[k] < surface_->moving()) meeting.nodes[k + 1] = surface_->nodes[corners[k]];
  }
  meeting.stiffness = softer(p, own, surface_->stiffness_of_feature(feature));
  meeting.area = surface_->share_of(vertex);
  return meeting;
}

template <class Surface, class Settings, class Pair>
bool SurfaceContact<Surface, Settings, Pair>::depends_on(int index) const {
  const Settings& settings = surface_->settings;
  if (index < 0) return false;
  return index == settings.gap || index == settings.obstacle_stiffness || index == surface_->thickness() ||
         std::find(settings.stiffness.begin(), settings.stiffness.end(), index) != settings.stiffness.end();
}

template <class Surface, class Settings, class Pair>
void SurfaceContact<Surface, Settings, Pair>::add_parameter_gradient(const Point& at, int index,
                                                                     Eigen::VectorXd& out) const {
  add_parameter_gradient(at, index, nullptr, out);
}

template <class Surface, class Settings, class Pair>
void SurfaceContact<Surface, Settings, Pair>::add_parameter_gradient(const Point& at, int index, const Sides* between,
                                                                     Eigen::VectorXd& out) const {
  if (!depends_on(index)) return;
  typename Surface::Local local;
  each_interaction(at, between, [&](const typename Surface::State& s, const Interaction& i) {
    const OfDistance f = surface_->parameter_derivative(i, at.p, index);
    if (f.value == 0 && f.first == 0) return true;
    if (i.distance == 0 && i.kind != Interaction::Kind::ground) return true;
    surface_->differentiate(s, i, f, local);
    constexpr int D = Surface::dimension;
    for (int k = 0; k < local.count; ++k)
      out.segment<D>(D * local.nodes[k]) += local.gradient.template segment<D>(D * k);
    return true;
  });
}

template <class Surface, class Settings, class Pair>
double SurfaceContact<Surface, Settings, Pair>::step_limit(const Point& at, const Eigen::VectorXd& step) const {
  if (surface_->penalty()) return 1;
  if (!step.allFinite() || !at.u.allFinite()) return 0;
  const typename Surface::State s = surface_->state(at.u), change = surface_->state(step);
  return surface_->step_limit(s, change, surface_->ground_limit(s, change));
}

template <class Surface, class Settings, class Pair>
const Settings& SurfaceContact<Surface, Settings, Pair>::settings() const {
  return surface_->settings;
}

template <class Surface, class Settings, class Pair>
std::vector<Pair> SurfaceContact<Surface, Settings, Pair>::active_pairs(const Point& at, bool brute_force) const {
  return surface_->active_pairs(surface_->state(at.u), at.p[surface_->settings.gap], brute_force);
}

template <class Surface, class Settings, class Pair>
double SurfaceContact<Surface, Settings, Pair>::smallest_distance(const Eigen::VectorXd& u, double horizon) const {
  const typename Surface::State s = surface_->state(u);
  double smallest = std::numeric_limits<double>::infinity();
  const auto consider = [&](double distance) {
    if (distance < horizon) smallest = std::min(smallest, distance);
  };
  surface_->each_height(s, [&](int, int, double height) { consider(height); });
  surface_->each_distance(s, horizon, consider);
  return smallest;
}

template <class Surface, class Settings, class Pair>
double SurfaceContact<Surface, Settings, Pair>::overlap_about(
    const typename decltype(Settings::patches)::value_type& pin, double reach) const {
  return surface_->overlap_about(pin, reach);
}

template <class Surface, class Settings, class Pair>
bool SurfaceContact<Surface, Settings, Pair>::intersects(const Eigen::VectorXd& u) const {
  const typename Surface::State s = surface_->state(u);
  bool behind = false;
  surface_->each_height(s, [&](int, int, double height) { behind = behind || !(height > 0); });
  if (behind || surface_->cuts_ground(s, surface_->facets())) return true;
  bool found = false;
  surface_->each_crossing(s.positions(), [&](int, int) { return found = true; });
  return found;
}

}  // namespace taut

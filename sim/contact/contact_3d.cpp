#include "sim/contact/contact_3d.hpp"

#include <algorithm>
#include <limits>
#include <map>
#include <stdexcept>
#include <tuple>

#include "sim/contact/contact_geometry.hpp"
#include "sim/contact/contact_geometry_3d.hpp"
#include "sim/contact/surface.hpp"
#include "sim/core/dense.hpp"

namespace taut {
namespace {

using Eigen::Vector3d;
constexpr double edge_reach = 0.25;  ///< of the gap: where the barrier of two edges begins
/// [rad] Between facets as flat as this a vertex is over an edge or a vertex within d times as much only, and by
/// symmetry or rounding alone. Their curvature 1/d, which pushes it aside, ends with that; a state that is held by all
/// else would count as unstable.
constexpr double blunt = 0.01;

}  // namespace

/// Vertices are the nodes of the triangles in ascending order.
struct SpaceSurface : ContactSurface<3, Contact3dSettings> {
  using Local = taut::Local<3, 4>;
  using Near = taut::Near<Closest3>;

  std::vector<std::array<int, 3>> triangles;
  std::vector<std::array<int, 2>> edges;           ///< each once, lower vertex first
  std::vector<std::array<int, 3>> triangle_edges;  ///< from each of its vertices to the next
  std::vector<double> area, edge_area;             ///< w_i and w_e [m2]
  std::vector<double> edge_length;                 ///< at rest [m]
  IndexLists triangles_at, edges_at, triangles_at_edge;
  IndexLists vertex_patches, edge_patches, triangle_patches;
  BoxTree<3> triangle_tree, edge_tree;

  SpaceSurface(const Mesh& mesh, Contact3dSettings given);
  void find_edges();

  int triangle_count() const { return static_cast<int>(triangles.size()); }
  int edge_count() const { return static_cast<int>(edges.size()); }
  bool contains(int triangle, int vertex) const {
    const auto& t = triangles[triangle];
    return t[0] == vertex || t[1] == vertex || t[2] == vertex;
  }
  bool may_touch(int vertex, int triangle) const {
    return !contains(triangle, vertex) && !(have_common(vertex_patches[vertex], triangle_patches[triangle]) &&
                                            of_two_parts(vertex, triangles[triangle][0]));
  }
  bool edges_may_touch(int one, int two) const {
    const auto& [a, b] = edges[one];
    const auto& [c, d] = edges[two];
    return a != c && a != d && b != c && b != d &&
           !(have_common(edge_patches[one], edge_patches[two]) && of_two_parts(a, c));
  }

  Closest3 vertex_edge(const State& s, int v, int edge) const {
    const auto& [a, b] = edges[edge];
    return closest_on_segment(s.from(a, v), s.from(a, b));
  }
  Closest3 vertex_triangle(const State& s, int v, int triangle) const {
    const auto& [a, b, c] = triangles[triangle];
    return closest_on_triangle(s.from(a, v), s.from(a, b), s.from(a, c));
  }
  Closest3 closest_of_edges(const State& s, int one, int two) const {
    const auto& [a, b] = edges[one];
    const auto& [c, d] = edges[two];
    return closest_of_segments(s.from(c, a), s.from(a, b), s.from(c, d));
  }
  /// Whether they need no closer look: they surely are farther apart than `reach`.
  bool surely_apart(const State& s, int v, int triangle, double reach) const {
    const auto& [a, b, c] = triangles[triangle];
    return surely_apart_from_triangle(s.from(a, v), s.from(a, b), s.from(a, c), reach);
  }
  bool edges_surely_apart(const State& s, int one, int two, double reach) const {
    const auto& [a, b] = edges[one];
    const auto& [c, d] = edges[two];
    return surely_apart_segments(s.from(c, a), s.from(a, b), s.from(c, d), reach);
  }
  /// visit(vertex, triangle) and visit_edges(edge, edge) for all that could touch and whose boxes meet.
  template <class BoxOf, class Visit, class VisitEdges>
  void visit_pairs(BoxOf&& box_of, Visit&& visit, VisitEdges&& visit_edges) const;
  /// Pairs nearer than `reach`, and edges nearer than `reach_of_edges`, both sorted.
  std::pair<std::vector<Near>, std::vector<Near>> pairs_within(const State& s, double reach, double reach_of_edges,
                                                               bool brute_force = false) const;
  int stiffness_at(const Params& p, const IndexLists& features, int feature) const {
    return softest(p, features[feature], settings.stiffness);
  }
  std::vector<Interaction> interactions(const State& s, const Params& p) const;
  void add_point_interactions(const State& s, const Params& p, std::span<const Near> near,
                              std::vector<Interaction>& all) const;
  bool penalty() const { return false; }
  int thickness() const { return -1; }
  double scale(const Params&) const { return 1; }
  static double reach_of(const Interaction& i) { return i.kind == Interaction::Kind::edges ? edge_reach : 1.0; }
  Barrier law(const Interaction& i, const Params& p) const { return {reach_of(i) * p[settings.gap]}; }
  int feature_count() const { return triangle_count(); }
  const std::vector<std::array<int, 3>>& facets() const { return triangles; }
  const std::array<int, 3>& corners_of(int triangle) const { return triangles[triangle]; }
  int stiffness_of(const Params& p, int vertex) const { return stiffness_at(p, triangles_at, vertex); }
  int stiffness_of_feature(int triangle) const { return settings.stiffness[triangle]; }
  double share_of(int vertex) const { return 0.5 * area[vertex]; }
  int side_of_vertex(int v) const { return part_of(v); }
  int side_of(int feature) const {
    return feature < triangle_count() ? part_of(triangles[feature][0]) : -1 - (feature - triangle_count());
  }
  /// Of what an interaction's first vertex meets.
  int other_side(const Interaction& i) const {
    using Kind = Interaction::Kind;
    if (i.kind == Kind::ground) return side_of(triangle_count() + i.second);
    if (i.kind == Kind::vertex) return side_of_vertex(i.second);
    return part_of(i.kind == Kind::triangle ? triangles[i.second][0] : edges[i.second][0]);
  }
  template <class Meet>
  void each_point_pair(const State& s, double reach, Meet&& meet) const {
    for (const Near& near : pairs_within(s, reach, 0).first) meet(near.first, near.second, near.closest.distance);
  }
  int vertex_of(const Interaction& i) const { return i.kind == Interaction::Kind::edges ? edges[i.first][0] : i.first; }
  double mollified(const State& s, const Interaction& i) const {
    return i.kind == Interaction::Kind::edges ? mollifier(s, i).value : 1;
  }
  Mollifier mollifier(const State& s, const Interaction& i) const {
    const auto& [a, b] = edges[i.first];
    const auto& [c, d] = edges[i.second];
    const double one = edge_length[i.first], two = edge_length[i.second];
    return {s.from(a, b), s.from(c, d), 1e-3 * one * one * two * two};
  }
  void differentiate(const State& s, const Interaction& i, const OfDistance& f, Local& out) const;
  /// Whether the triangles around an edge or a vertex all face along `normal`, to a hundredth.
  bool is_blunt(const State& s, std::span<const int> around, const Vector3d& normal) const {
    return !around.empty() && std::all_of(around.begin(), around.end(), [&](int t) {
      const auto& [a, b, c] = triangles[t];
      return s.from(a, b).cross(s.from(a, c)).normalized().cross(normal).norm() < blunt;
    });
  }
  struct EdgesDistance {
    FeatureDistance distance;
    std::array<int, 4> position{};  ///< of the distance's vertices among the four of the edges
  };
  EdgesDistance distance_of_edges(const State& s, const Interaction& i) const;
  void differentiate_edges(const State& s, const Interaction& i, const OfDistance& f, Local& out) const;
  OfDistance parameter_derivative(const Interaction& i, const Params& p, int index) const;
  double step_limit(const State& s, const State& change, double limit) const;
  std::vector<ContactPair3> active_pairs(const State& s, double gap, bool brute_force) const;
  template <class Consider>
  void each_distance(const State& s, double horizon, Consider&& consider) const {
    const auto [points, lines] = pairs_within(s, horizon, horizon);
    for (const std::vector<Near>* list : {&points, &lines}) {
      for (const Near& near : *list) consider(near.closest.distance);
    }
  }
  /// found(edge, triangle) for those that meet in the places x, until it says true.
  template <class Found>
  void each_crossing(const Places& x, Found&& found) const;
  double overlap_about(const PinPatch<3>& pin, double reach) const;
};

SpaceSurface::SpaceSurface(const Mesh& mesh, Contact3dSettings given) : ContactSurface(std::move(given)) {
  triangles = number_vertices(mesh, settings.triangles, "a triangle");
  normalise_grounds();
  find_edges();
  vertex_patches = patches_of_vertices();
  edge_patches = patches_of(edges);
  triangle_patches = patches_of(triangles);
}

void SpaceSurface::find_edges() {
  std::map<std::array<int, 2>, int> number;
  std::vector<std::vector<int>> at_vertex(vertices()), at_edge, edges_of(at_vertex.size());
  std::vector<Vector3d> centres, middles, thirds;
  for (int t = 0; t < triangle_count(); ++t) {
    const std::array<int, 3>& corner = triangles[t];
    const Vector3d a = X.col(corner[0]), b = X.col(corner[1]), c = X.col(corner[2]);
    thirds.push_back((b - a).cross(c - a) / 6);
    const double third = thirds.back().norm();
    if (!(third > 0)) throw std::logic_error("contact: a triangle has no area");
    centres.push_back((a + b + c) / 3);
    std::array<int, 3>& own = triangle_edges.emplace_back();
    for (size_t k = 0; k < 3; ++k) {
      const auto [low, high] = std::minmax(corner[k], corner[(k + 1) % 3]);
      const std::array<int, 2> ends{low, high};
      const auto [position, inserted] = number.try_emplace(ends, edge_count());
      const int e = own[k] = position->second;
      if (inserted) {
        for (int v : ends) edges_of[v].push_back(e);
        edges.push_back(ends);
        edge_area.push_back(0);
        edge_length.push_back((X.col(ends[1]) - X.col(ends[0])).norm());
        at_edge.emplace_back();
        middles.push_back(0.5 * (X.col(ends[0]) + X.col(ends[1])));
      }
      at_edge[e].push_back(t);
      edge_area[e] += third;
      at_vertex[corner[k]].push_back(t);
    }
  }
  for (const std::vector<int>& around : at_vertex) {
    double& most = area.emplace_back(0.0);
    for (int t : around) {
      const Vector3d normal = thirds[t].normalized();
      double seen = 0;
      for (int other : around) seen += std::max(0.0, normal.dot(thirds[other]));
      most = std::max(most, seen);
    }
  }
  triangles_at.assign(at_vertex);
  triangles_at_edge.assign(at_edge);
  edges_at.assign(edges_of);
  triangle_tree = BoxTree<3>(centres);
  edge_tree = BoxTree<3>(middles);
}

template <class BoxOf, class Visit, class VisitEdges>
void SpaceSurface::visit_pairs(BoxOf&& box_of, Visit&& visit, VisitEdges&& visit_edges) const {
  const std::vector<Box3> triangle_boxes = triangle_tree.enclose(boxes_of(triangles.begin(), triangles.end(), box_of));
  for (int v = 0; v < vertices(); ++v) {
    triangle_tree.visit(triangle_boxes, box_of(v), [&](int t) {
      if (may_touch(v, t)) visit(v, t);
    });
  }
  const std::vector<Box3> own = boxes_of(edges.begin(), edges.end(), box_of), edge_boxes = edge_tree.enclose(own);
  for (int e = 0; e < edge_count(); ++e) {
    edge_tree.visit(edge_boxes, own[e], [&](int f) {
      if (e < f && edges_may_touch(e, f)) visit_edges(e, f);
    });
  }
}

std::pair<std::vector<SpaceSurface::Near>, std::vector<SpaceSurface::Near>> SpaceSurface::pairs_within(
    const State& s, double reach, double reach_of_edges, bool brute_force) const {
  std::vector<Near> points, lines;
  const auto look = [&](int v, int t) {
    const Closest3 closest = vertex_triangle(s, v, t);
    if (closest.distance < reach) points.push_back({v, t, closest});
  };
  const auto look_at_edges = [&](int e, int f) {
    const Closest3 closest = closest_of_edges(s, e, f);
    if (closest.distance < reach_of_edges) lines.push_back({e, f, closest});
  };
  if (brute_force) {
    for (int v = 0; v < vertices(); ++v) {
      for (int t = 0; t < triangle_count(); ++t) {
        if (may_touch(v, t)) look(v, t);
      }
    }
    for (int e = 0; e < edge_count(); ++e) {
      for (int f = e + 1; f < edge_count(); ++f) {
        if (edges_may_touch(e, f)) look_at_edges(e, f);
      }
    }
    return {points, lines};
  }
  // Half of the reach around both sides. Positions are rounded, relative positions less so: a little more loses no
  // pair.
  const double margin = 0.5 * std::max(reach, reach_of_edges) * (1 + 1e-6) + s.rounding();
  const Places x = s.positions();
  visit_pairs([&](int v) { return Box3(x.col(v).array() - margin, x.col(v).array() + margin); },
              [&](int v, int t) {
                if (!surely_apart(s, v, t, reach)) look(v, t);
              },
              [&](int e, int f) {
                if (!edges_surely_apart(s, e, f, reach_of_edges)) look_at_edges(e, f);
              });
  std::sort(points.begin(), points.end());
  std::sort(lines.begin(), lines.end());
  return {points, lines};
}

/// What one vertex feels: the triangles near it, less what their edges and vertices count twice.
void SpaceSurface::add_point_interactions(const State& s, const Params& p, std::span<const Near> all_near,
                                          std::vector<Interaction>& all) const {
  using Kind = Interaction::Kind;
  const int i = all_near.front().first, own = stiffness_at(p, triangles_at, i);
  const double gap = p[settings.gap], weight = 0.5 * area[i];
  const auto stiffness = [&](int t) { return softer(p, own, settings.stiffness[t]); };
  // Most of these cancel: how often each feature counts, and with which kappa.
  std::map<std::tuple<Kind, int, int>, std::pair<int, double>> counts;
  const auto add = [&](Kind kind, int feature, int kappa, int count, double distance) {
    auto& [total, at] = counts[{kind, feature, kappa}];
    total += count;
    at = distance;
  };
  const auto add_edge = [&](int e, int kappa, int count) {
    const Closest3 closest = vertex_edge(s, i, e);
    const bool inside = closest.part == Closest3::Part::vertex_edge;
    add(inside ? Kind::edge : Kind::vertex, inside ? e : edges[e][closest.second], kappa, count, closest.distance);
  };
  /// -1 times all kappas at a feature and +1 times the smallest one, handed to `give` with their counts.
  const auto take_back = [&](std::span<const int> list, auto&& give) {
    int least = -1;
    for (int t : list) {
      if (!may_touch(i, t)) continue;
      give(stiffness(t), -1);
      least = softer(p, least, stiffness(t));
    }
    if (least >= 0) give(least, 1);
  };
  std::vector<int> near_edges, near_vertices;
  for (const auto& [vertex, t, closest] : all_near) {
    const auto &own_edges = triangle_edges[t], &corners = triangles[t];
    if (closest.part == Closest3::Part::interior)
      add(Kind::triangle, t, stiffness(t), 1, closest.distance);
    else if (closest.part == Closest3::Part::vertex_edge)
      add_edge(own_edges[closest.second], stiffness(t), 1);
    else
      add(Kind::vertex, corners[closest.second], stiffness(t), 1, closest.distance);
    near_edges.insert(near_edges.end(), own_edges.begin(), own_edges.end());
    near_vertices.insert(near_vertices.end(), corners.begin(), corners.end());
  }
  sort_unique(near_edges);
  sort_unique(near_vertices);
  for (int e : near_edges) {
    if (!(vertex_edge(s, i, e).distance < gap)) continue;
    take_back(triangles_at_edge[e], [&](int kappa, int count) { add_edge(e, kappa, count); });
  }
  for (int v : near_vertices) {
    const double distance = s.from(v, i).norm();
    if (!(distance < gap)) continue;
    const auto give = [&](int kappa, int count) { add(Kind::vertex, v, kappa, count, distance); };
    take_back(triangles_at[v], give);
    for (int e : edges_at[v]) take_back(triangles_at_edge[e], [&](int kappa, int count) { give(kappa, -count); });
  }
  for (const auto& [key, value] : counts) {
    const auto& [kind, feature, kappa] = key;
    const auto& [count, distance] = value;
    if (count != 0) all.push_back({kind, i, feature, kappa, count * weight, distance});
  }
}

std::vector<Interaction> SpaceSurface::interactions(const State& s, const Params& p) const {
  const double gap = p[settings.gap];
  const auto [points, lines] = pairs_within(s, gap, edge_reach * gap);
  std::vector<Interaction> all;
  each_vertex(points, [&](std::span<const Near> near) { add_point_interactions(s, p, near, all); });
  for (const Near& near : lines) {
    const int kappa =
        softer(p, stiffness_at(p, triangles_at_edge, near.first), stiffness_at(p, triangles_at_edge, near.second));
    const double weight = 0.5 * (edge_area[near.first] + edge_area[near.second]);
    all.push_back({Interaction::Kind::edges, near.first, near.second, kappa, weight, near.closest.distance});
  }
  each_height(s, [&](int g, int v, double height) {
    if (!(height < gap)) return;
    const int kappa = softer(p, stiffness_at(p, triangles_at, v), settings.obstacle_stiffness);
    all.push_back({Interaction::Kind::ground, v, g, kappa, area[v], height});
  });
  return all;
}

void SpaceSurface::differentiate(const State& s, const Interaction& i, const OfDistance& f, Local& out) const {
  using Kind = Interaction::Kind;
  const auto take = [&](std::initializer_list<int> vertices, FeatureDistance distance,
                        std::span<const int> around = {}) {
    if (f.wants_hessian && i.weight > 0 && is_blunt(s, around, distance.normal)) distance.round = false;
    out.use(nodes, vertices);
    out.gradient = f.first * distance.gradient();
    if (f.wants_hessian) out.hessian = distance.hessian(f.first, f.second);
  };
  if (i.kind == Kind::vertex) {
    take({i.first, i.second}, FeatureDistance::point_point(s.from(i.second, i.first)), triangles_at[i.second]);
  } else if (i.kind == Kind::edge) {
    const auto& [c, d] = edges[i.second];
    take({i.first, c, d}, FeatureDistance::point_line(s.from(c, i.first), s.from(c, d)), triangles_at_edge[i.second]);
  } else if (i.kind == Kind::triangle) {
    const auto& [c, d, e] = triangles[i.second];
    take({i.first, c, d, e}, FeatureDistance::point_plane(s.from(c, i.first), s.from(c, d), s.from(c, e)));
  } else if (i.kind == Kind::ground) {
    differentiate_height(s, i, f, out);
  } else {
    differentiate_edges(s, i, f, out);
  }
  if (f.wants_hessian && f.curvature == Curvature::projected) out.hessian = positive_part(out.hessian);
}

/// The distance of two edges is that of the features where they come closest, of some of the four vertices.
SpaceSurface::EdgesDistance SpaceSurface::distance_of_edges(const State& s, const Interaction& i) const {
  const std::array<int, 2>& one = edges[i.first];
  const std::array<int, 2>& two = edges[i.second];
  const Vector3d e = s.from(one[0], one[1]), f = s.from(two[0], two[1]);
  const Closest3 closest = closest_of_edges(s, i.first, i.second);
  const size_t first = static_cast<size_t>(closest.first), second = static_cast<size_t>(closest.second);
  switch (closest.part) {
    case Closest3::Part::vertices:
      return {FeatureDistance::point_point(s.from(two[second], one[first])), {closest.first, 2 + closest.second}};
    case Closest3::Part::vertex_edge:
      return {FeatureDistance::point_line(s.from(two[0], one[first]), f), {closest.first, 2, 3}};
    case Closest3::Part::edge_vertex:
      return {FeatureDistance::point_line(s.from(one[0], two[second]), e), {2 + closest.second, 0, 1}};
    case Closest3::Part::interior:
      return {FeatureDistance::line_line(s.from(two[0], one[0]), e, f), {0, 1, 2, 3}};
  }
  return {};
}

void SpaceSurface::differentiate_edges(const State& s, const Interaction& i, const OfDistance& f, Local& out) const {
  out.use(nodes, {edges[i.first][0], edges[i.first][1], edges[i.second][0], edges[i.second][1]});
  const auto [distance, position] = distance_of_edges(s, i);
  const Mollifier m = mollifier(s, i);
  const FeatureDistance::Vector part = distance.gradient();
  FeatureDistance::Vector gradient = FeatureDistance::Vector::Zero(12);
  for (int k = 0; k < distance.vertices; ++k) gradient.segment<3>(3 * position[k]) = part.segment<3>(3 * k);
  out.gradient = m.value * f.first * gradient;
  if (m.first != 0) out.gradient += m.first * f.value * m.gradient;
  if (!f.wants_hessian) return;
  out.hessian.setZero(12, 12);
  const FeatureDistance::Matrix hessian = distance.hessian(m.value * f.first, m.value * f.second);
  for (int k = 0; k < distance.vertices; ++k) {
    for (int l = 0; l < distance.vertices; ++l)
      out.hessian.block<3, 3>(3 * position[k], 3 * position[l]) = hessian.block<3, 3>(3 * k, 3 * l);
  }
  if (m.first == 0) return;
  const FeatureDistance::Matrix mixed = m.gradient * gradient.transpose();
  out.hessian += m.first * f.value * m.hessian + m.second * f.value * m.gradient * m.gradient.transpose() +
                 m.first * f.first * (mixed + mixed.transpose());
}

OfDistance SpaceSurface::parameter_derivative(const Interaction& i, const Params& p, int index) const {
  const Barrier barrier = law(i, p);
  const double d = i.distance, value = barrier.value(d), slope = barrier.slope(d), kappa = p[i.stiffness];
  // b is homogeneous of degree one in d and its gap: b = d b' + gap db/dgap.
  if (index == settings.gap)
    return {kappa * (value - d * slope) / p[settings.gap] * i.weight,
            kappa * reach_of(i) * barrier.slope_by_gap(d) * i.weight};
  if (index == i.stiffness) return {value * i.weight, slope * i.weight};
  return {};
}

std::vector<std::array<int, 3>> contact_triangles(const Mesh& mesh) {
  if (mesh.dimension() != 3) throw std::logic_error("contact: the mesh is plane");
  return order_of(mesh.shape) == 1 ? pieces_of_boundary<3>(mesh, {{0, 1, 2}})
                                   : pieces_of_boundary<3>(mesh, {{0, 3, 5}, {1, 4, 3}, {2, 5, 4}, {3, 4, 5}});
}

double SpaceSurface::step_limit(const State& s, const State& change, double limit) const {
  const Sweep swept(s, change);
  // Pairs that may come down to two tenths of their distance, and for each vertex the smallest distance of those that
  // it belongs to: what slides along a face comes as near to what is ahead as it is to the face.
  struct Candidate {
    MovingPair3::Kind kind;
    std::array<int, 4> vertex;
    double distance;
    double motion;  ///< the most by which two of its vertices approach
  };
  std::vector<Candidate> candidates;
  std::vector<double> clearance(vertices(), std::numeric_limits<double>::infinity());
  constexpr double most = 0.8;  // of its distance that a pair may approach without being looked at
  const auto consider = [&](MovingPair3::Kind kind, const std::array<int, 4>& vertex, auto&& apart,
                            auto&& distance_of) {
    const size_t split = kind == MovingPair3::Kind::segments ? 2 : 1;
    double motion = 0;
    for (size_t i = 0; i < split; ++i) {
      for (size_t j = split; j < 4; ++j)
        motion = std::max(motion, (change.u.col(vertex[i]) - change.u.col(vertex[j])).squaredNorm());
    }
    if (motion == 0) return;
    motion = std::sqrt(motion);
    if (apart(motion / most)) return;
    const double distance = distance_of();
    if (!(motion > most * distance)) return;
    candidates.push_back({kind, vertex, distance, motion});
    for (int v : vertex) clearance[v] = std::min(clearance[v], distance);
  };
  visit_pairs(
      swept,
      [&](int v, int t) {
        const auto& [a, b, c] = triangles[t];
        consider(
            MovingPair3::Kind::point_triangle, {v, a, b, c}, [&](double reach) { return surely_apart(s, v, t, reach); },
            [&] { return vertex_triangle(s, v, t).distance; });
      },
      [&](int e, int f) {
        const auto& [a, b] = edges[e];
        const auto& [c, d] = edges[f];
        consider(
            MovingPair3::Kind::segments, {a, b, c, d}, [&](double reach) { return edges_surely_apart(s, e, f, reach); },
            [&] { return closest_of_edges(s, e, f).distance; });
      });
  for (const Candidate& candidate : candidates) {
    if (!(limit > 0)) break;
    if (limit * candidate.motion < most * candidate.distance) continue;
    MovingPair3 pair{candidate.kind, {}, {}};
    double nearest = candidate.distance;
    for (size_t k = 0; k < 4; ++k) {
      pair.x[k] = s.from(candidate.vertex[0], candidate.vertex[k]);
      pair.dx[k] = change.u.col(candidate.vertex[k]) - change.u.col(candidate.vertex[0]);
      nearest = std::min(nearest, clearance[candidate.vertex[k]]);
    }
    limit = free_motion(pair, 0.1 * nearest, limit);
  }
  return limit;
}

std::vector<ContactPair3> SpaceSurface::active_pairs(const State& s, double gap, bool brute_force) const {
  using Kind = ContactPair3::Kind;
  const auto [points, lines] = pairs_within(s, gap, gap, brute_force);
  std::vector<ContactPair3> pairs;
  for (const Near& near : points)
    pairs.push_back({Kind::point_triangle, nodes[near.first], near.second, near.closest.distance});
  for (const Near& near : lines) pairs.push_back({Kind::edges, near.first, near.second, near.closest.distance});
  each_height(s, [&](int g, int v, double height) {
    if (height < gap) pairs.push_back({Kind::ground, nodes[v], g, height});
  });
  std::ranges::sort(pairs, {}, [](const ContactPair3& pair) { return std::tuple(pair.kind, pair.first, pair.second); });
  return pairs;
}

template <class Found>
void SpaceSurface::each_crossing(const Places& x, Found&& found) const {
  const auto place = [&](int v) { return Box3(Vector3d(x.col(v))); };
  const std::vector<Box3> boxes = triangle_tree.enclose(boxes_of(triangles.begin(), triangles.end(), place));
  bool enough = false;
  for (int e = 0; e < edge_count() && !enough; ++e) {
    const auto [a, b] = edges[e];
    triangle_tree.visit(boxes, place(a).merged(place(b)), [&, a, b](int t) {
      if (enough || contains(t, a) || contains(t, b)) return;
      const auto& [c, d, f] = triangles[t];
      if (have_common(edge_patches[e], triangle_patches[t]) && of_two_parts(a, c)) return;
      if (segment_meets_triangle(x.col(a), x.col(b), {x.col(c), x.col(d), x.col(f)})) enough = found(e, t);
    });
  }
}

double SpaceSurface::overlap_about(const PinPatch<3>& pin, double reach) const {
  double farthest = -1;
  const State rest{*this, Places::Zero(3, vertices()), Places::Zero(3, ground_count())};
  const auto [points, lines] = pairs_within(rest, reach, reach);
  for (const Near& near : points) extend_overlap(pin, std::array{near.first}, triangles[near.second], farthest);
  for (const Near& near : lines) extend_overlap(pin, edges[near.first], edges[near.second], farthest);
  each_crossing(X, [&](int e, int t) {
    extend_overlap(pin, edges[e], triangles[t], farthest);
    return false;
  });
  return farthest;
}

template struct Ground<3>;
template class SurfaceContact<SpaceSurface, Contact3dSettings, ContactPair3>;

}  // namespace taut

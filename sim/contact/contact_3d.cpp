#include "sim/contact/contact_3d.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <limits>
#include <map>
#include <stdexcept>
#include <tuple>

#include "sim/contact/contact_geometry.hpp"
#include "sim/contact/contact_geometry_3d.hpp"
#include "sim/contact/surface.hpp"

namespace taut {
namespace {

using Eigen::Vector3d;
constexpr double infinity = std::numeric_limits<double>::infinity();

/// weight * kappa * b(distance) of a vertex and another vertex, an edge, a triangle or a ground, or of two edges.
struct Interaction {
  enum class Kind { vertex, edge, triangle, edges, ground };
  Kind kind;
  int first, second;  ///< vertex and other feature, or edges
  int stiffness;      ///< table index
  double weight;      ///< [m2] without kappa; negative where a feature is taken back
  double distance;    ///< [m]
};

/// Gradient of m(q) b(d) and, where asked for, its Hessian, on the vertices that take part.
struct Local {
  int count = 0;
  std::array<int, 4> nodes{};
  FeatureDistance::Vector gradient;
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor, 12, 12> hessian;

  void use(const std::vector<int>& mesh_nodes, std::initializer_list<int> vertices) {
    count = 0;
    for (int v : vertices) nodes[static_cast<size_t>(count++)] = mesh_nodes[static_cast<size_t>(v)];
  }
};

}  // namespace

/// Vertices are the nodes of the triangles in ascending order.
struct Contact3d::Surface : ContactSurface<3, Contact3dSettings> {
  /// What comes nearer than some reach: a vertex and a triangle, or two edges.
  struct Near {
    int first, second;
    Closest3 closest;
  };

  std::vector<std::array<int, 3>> triangles;
  std::vector<std::array<int, 2>> edges;           ///< each once, lower vertex first
  std::vector<std::array<int, 3>> triangle_edges;  ///< from each of its vertices to the next
  std::vector<double> area, edge_area;             ///< w_i and w_e [m2]
  std::vector<double> edge_length;                 ///< at rest [m]
  IndexLists triangles_at, edges_at, triangles_at_edge;
  BoxTree<3> triangle_tree, edge_tree;

  Surface(const Mesh& mesh, Contact3dSettings given);
  void find_edges();

  int triangle_count() const { return static_cast<int>(triangles.size()); }
  int edge_count() const { return static_cast<int>(edges.size()); }
  bool contains(int triangle, int vertex) const {
    const auto& t = triangles[static_cast<size_t>(triangle)];
    return t[0] == vertex || t[1] == vertex || t[2] == vertex;
  }
  bool may_touch(int vertex, int triangle) const {
    return !contains(triangle, vertex) && !apart(vertex, triangles[static_cast<size_t>(triangle)][0]);
  }
  bool edges_may_touch(int one, int two) const {
    const auto& [a, b] = edges[static_cast<size_t>(one)];
    const auto& [c, d] = edges[static_cast<size_t>(two)];
    return a != c && a != d && b != c && b != d && !apart(a, c);
  }

  Closest3 vertex_edge(const State& s, int v, int edge) const {
    const auto& [a, b] = edges[static_cast<size_t>(edge)];
    return closest_on_segment(s.from(a, v), s.from(a, b));
  }
  Closest3 vertex_triangle(const State& s, int v, int triangle) const {
    const auto& [a, b, c] = triangles[static_cast<size_t>(triangle)];
    return closest_on_triangle(s.from(a, v), s.from(a, b), s.from(a, c));
  }
  Closest3 closest_of_edges(const State& s, int one, int two) const {
    const auto& [a, b] = edges[static_cast<size_t>(one)];
    const auto& [c, d] = edges[static_cast<size_t>(two)];
    return closest_of_segments(s.from(c, a), s.from(a, b), s.from(c, d));
  }
  /// visit(vertex, triangle) and visit_edges(edge, edge) for all that could touch and whose boxes meet.
  template <class BoxOf, class Visit, class VisitEdges>
  void visit_pairs(BoxOf&& box_of, Visit&& visit, VisitEdges&& visit_edges) const;
  /// Pairs nearer than `reach`, and edges nearer than `edge_reach`, both sorted.
  std::pair<std::vector<Near>, std::vector<Near>> pairs_within(const State& s, double reach, double edge_reach,
                                                               bool brute_force = false) const;
  int stiffness_at(const Params& p, const IndexLists& features, int feature) const {
    int least = -1;
    const auto [begin, end] = features[feature];
    for (const int* t = begin; t != end; ++t) least = softer(p, least, settings.stiffness[static_cast<size_t>(*t)]);
    return least;
  }
  std::vector<Interaction> interactions(const State& s, const Params& p) const;
  void add_point_interactions(const State& s, const Params& p, const Near* begin, const Near* end,
                              std::vector<Interaction>& all) const;
  double threshold(const Interaction& i) const {
    const double one = edge_length[static_cast<size_t>(i.first)], two = edge_length[static_cast<size_t>(i.second)];
    return 1e-3 * one * one * two * two;
  }
  void differentiate(const State& s, const Interaction& i, const std::array<double, 3>& b, bool wants_hessian,
                     Local& out) const;
  struct EdgesDistance {
    FeatureDistance distance;
    std::array<int, 4> position{};  ///< of the distance's vertices among the four of the edges
  };
  EdgesDistance distance_of_edges(const State& s, const Interaction& i) const;
  void differentiate_edges(const State& s, const Interaction& i, const std::array<double, 3>& b, bool wants_hessian,
                           Local& out) const;
};

Contact3d::Surface::Surface(const Mesh& mesh, Contact3dSettings given) : ContactSurface(std::move(given)) {
  triangles = number_vertices(mesh, settings.triangles, "a triangle");
  normalise_grounds();
  find_edges();
}

void Contact3d::Surface::find_edges() {
  std::map<std::array<int, 2>, int> number;
  std::vector<std::vector<int>> at_vertex(static_cast<size_t>(vertices())), at_edge, edges_of(at_vertex.size());
  std::vector<Vector3d> centres, middles, thirds;
  for (int t = 0; t < triangle_count(); ++t) {
    const std::array<int, 3>& corner = triangles[static_cast<size_t>(t)];
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
        for (int v : ends) edges_of[static_cast<size_t>(v)].push_back(e);
        edges.push_back(ends);
        edge_area.push_back(0);
        edge_length.push_back((X.col(ends[1]) - X.col(ends[0])).norm());
        at_edge.emplace_back();
        middles.push_back(0.5 * (X.col(ends[0]) + X.col(ends[1])));
      }
      at_edge[static_cast<size_t>(e)].push_back(t);
      edge_area[static_cast<size_t>(e)] += third;
      at_vertex[static_cast<size_t>(corner[k])].push_back(t);
    }
  }
  for (const std::vector<int>& around : at_vertex) {
    double& most = area.emplace_back(0.0);
    for (int t : around) {
      const Vector3d normal = thirds[static_cast<size_t>(t)].normalized();
      double seen = 0;
      for (int other : around) seen += std::max(0.0, normal.dot(thirds[static_cast<size_t>(other)]));
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
void Contact3d::Surface::visit_pairs(BoxOf&& box_of, Visit&& visit, VisitEdges&& visit_edges) const {
  const std::vector<Box3> triangle_boxes = triangle_tree.enclose(boxes_of(triangles.begin(), triangles.end(), box_of));
  for (int v = 0; v < vertices(); ++v) {
    triangle_tree.visit(triangle_boxes, box_of(v), [&](int t) {
      if (may_touch(v, t)) visit(v, t);
    });
  }
  const std::vector<Box3> own = boxes_of(edges.begin(), edges.end(), box_of), edge_boxes = edge_tree.enclose(own);
  for (int e = 0; e < edge_count(); ++e) {
    edge_tree.visit(edge_boxes, own[static_cast<size_t>(e)], [&](int f) {
      if (e < f && edges_may_touch(e, f)) visit_edges(e, f);
    });
  }
}

std::pair<std::vector<Contact3d::Surface::Near>, std::vector<Contact3d::Surface::Near>>
Contact3d::Surface::pairs_within(const State& s, double reach, double edge_reach, bool brute_force) const {
  std::vector<Near> points, lines;
  const auto look = [&](int v, int t) {
    const Closest3 closest = vertex_triangle(s, v, t);
    if (closest.distance < reach) points.push_back({v, t, closest});
  };
  const auto look_at_edges = [&](int e, int f) {
    const Closest3 closest = closest_of_edges(s, e, f);
    if (closest.distance < edge_reach) lines.push_back({e, f, closest});
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
  const double margin = 0.5 * std::max(reach, edge_reach) * (1 + 1e-6) + s.rounding();
  const Places x = s.positions();
  visit_pairs([&](int v) { return Box3(x.col(v).array() - margin, x.col(v).array() + margin); }, look, look_at_edges);
  const auto before = [](const Near& one, const Near& two) {
    return std::tie(one.first, one.second) < std::tie(two.first, two.second);
  };
  std::sort(points.begin(), points.end(), before);
  std::sort(lines.begin(), lines.end(), before);
  return {points, lines};
}

/// What one vertex feels: the triangles near it, less what their edges and vertices count twice.
void Contact3d::Surface::add_point_interactions(const State& s, const Params& p, const Near* begin, const Near* end,
                                                std::vector<Interaction>& all) const {
  using Kind = Interaction::Kind;
  const int i = begin->first, own = stiffness_at(p, triangles_at, i);
  const double gap = p[settings.gap], weight = 0.5 * area[static_cast<size_t>(i)];
  const auto stiffness = [&](int t) { return softer(p, own, settings.stiffness[static_cast<size_t>(t)]); };
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
    const int feature = inside ? e : edges[static_cast<size_t>(e)][static_cast<size_t>(closest.second)];
    add(inside ? Kind::edge : Kind::vertex, feature, kappa, count, closest.distance);
  };
  /// -1 times all kappas at a feature and +1 times the smallest one, handed to `give` with their counts.
  const auto take_back = [&](std::pair<const int*, const int*> list, auto&& give) {
    int softest = -1;
    for (const int* t = list.first; t != list.second; ++t) {
      if (!may_touch(i, *t)) continue;
      give(stiffness(*t), -1);
      softest = softer(p, softest, stiffness(*t));
    }
    if (softest >= 0) give(softest, 1);
  };
  std::vector<int> near_edges, near_vertices;
  for (const Near* near = begin; near != end; ++near) {
    const auto& own_edges = triangle_edges[static_cast<size_t>(near->second)];
    const auto& corners = triangles[static_cast<size_t>(near->second)];
    if (near->closest.part == Closest3::Part::interior)
      add(Kind::triangle, near->second, stiffness(near->second), 1, near->closest.distance);
    else if (near->closest.part == Closest3::Part::vertex_edge)
      add_edge(own_edges[static_cast<size_t>(near->closest.second)], stiffness(near->second), 1);
    else
      add(Kind::vertex, corners[static_cast<size_t>(near->closest.second)], stiffness(near->second), 1,
          near->closest.distance);
    near_edges.insert(near_edges.end(), own_edges.begin(), own_edges.end());
    near_vertices.insert(near_vertices.end(), corners.begin(), corners.end());
  }
  for (std::vector<int>* list : {&near_edges, &near_vertices}) {
    std::sort(list->begin(), list->end());
    list->erase(std::unique(list->begin(), list->end()), list->end());
  }
  for (int e : near_edges) {
    if (!(vertex_edge(s, i, e).distance < gap)) continue;
    take_back(triangles_at_edge[e], [&](int kappa, int count) { add_edge(e, kappa, count); });
  }
  for (int v : near_vertices) {
    const double distance = s.from(v, i).norm();
    if (!(distance < gap)) continue;
    const auto give = [&](int kappa, int count) { add(Kind::vertex, v, kappa, count, distance); };
    take_back(triangles_at[v], give);
    const auto [first, last] = edges_at[v];
    for (const int* e = first; e != last; ++e)
      take_back(triangles_at_edge[*e], [&](int kappa, int count) { give(kappa, -count); });
  }
  for (const auto& [key, value] : counts) {
    const auto& [kind, feature, kappa] = key;
    const auto& [count, distance] = value;
    if (count != 0) all.push_back({kind, i, feature, kappa, count * weight, distance});
  }
}

std::vector<Interaction> Contact3d::Surface::interactions(const State& s, const Params& p) const {
  const double gap = p[settings.gap];
  const auto [points, lines] = pairs_within(s, gap, edge_reach * gap);
  std::vector<Interaction> all;
  for (size_t begin = 0, end = 0; begin < points.size(); begin = end) {
    while (end < points.size() && points[end].first == points[begin].first) ++end;
    add_point_interactions(s, p, points.data() + begin, points.data() + end, all);
  }
  for (const Near& near : lines) {
    const int kappa =
        softer(p, stiffness_at(p, triangles_at_edge, near.first), stiffness_at(p, triangles_at_edge, near.second));
    const double weight =
        0.5 * (edge_area[static_cast<size_t>(near.first)] + edge_area[static_cast<size_t>(near.second)]);
    all.push_back({Interaction::Kind::edges, near.first, near.second, kappa, weight, near.closest.distance});
  }
  for (int g = 0; g < ground_count(); ++g) {
    for (int v = 0; v < vertices(); ++v) {
      const double height = s.height(g, v);
      if (!(height < gap)) continue;
      const int kappa = softer(p, stiffness_at(p, triangles_at, v), settings.ground_stiffness);
      all.push_back({Interaction::Kind::ground, v, g, kappa, area[static_cast<size_t>(v)], height});
    }
  }
  return all;
}

/// Derivatives of m b by those of b by the distance, {b, b', b''}.
void Contact3d::Surface::differentiate(const State& s, const Interaction& i, const std::array<double, 3>& b,
                                       bool wants_hessian, Local& out) const {
  using Kind = Interaction::Kind;
  const auto use = [&](std::initializer_list<int> vertices) { out.use(nodes, vertices); };
  const auto take = [&](const FeatureDistance& distance) {
    out.gradient = b[1] * distance.gradient();
    if (wants_hessian) out.hessian = distance.hessian(b[1], b[2]);
  };
  switch (i.kind) {
    case Kind::vertex:
      use({i.first, i.second});
      return take(FeatureDistance::point_point(s.from(i.second, i.first)));
    case Kind::edge: {
      const auto& [c, d] = edges[static_cast<size_t>(i.second)];
      use({i.first, c, d});
      return take(FeatureDistance::point_line(s.from(c, i.first), s.from(c, d)));
    }
    case Kind::triangle: {
      const auto& [c, d, e] = triangles[static_cast<size_t>(i.second)];
      use({i.first, c, d, e});
      return take(FeatureDistance::point_plane(s.from(c, i.first), s.from(c, d), s.from(c, e)));
    }
    case Kind::ground: {
      const Vector3d& normal = settings.grounds[static_cast<size_t>(i.second)].normal;
      use({i.first});
      out.gradient = b[1] * normal;
      if (wants_hessian) out.hessian = b[2] * normal * normal.transpose();
      return;
    }
    case Kind::edges:
      break;
  }
  differentiate_edges(s, i, b, wants_hessian, out);
}

/// The distance of two edges is that of the features where they come closest, of some of the four vertices.
Contact3d::Surface::EdgesDistance Contact3d::Surface::distance_of_edges(const State& s, const Interaction& i) const {
  const std::array<int, 2>& one = edges[static_cast<size_t>(i.first)];
  const std::array<int, 2>& two = edges[static_cast<size_t>(i.second)];
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

void Contact3d::Surface::differentiate_edges(const State& s, const Interaction& i, const std::array<double, 3>& b,
                                             bool wants_hessian, Local& out) const {
  const std::array<int, 2>& one = edges[static_cast<size_t>(i.first)];
  const std::array<int, 2>& two = edges[static_cast<size_t>(i.second)];
  out.use(nodes, {one[0], one[1], two[0], two[1]});
  const auto [distance, position] = distance_of_edges(s, i);
  const Mollifier m(s.from(one[0], one[1]), s.from(two[0], two[1]), threshold(i));
  const FeatureDistance::Vector part = distance.gradient();
  FeatureDistance::Vector gradient = FeatureDistance::Vector::Zero(12);
  for (int k = 0; k < distance.vertices; ++k)
    gradient.segment<3>(3 * position[static_cast<size_t>(k)]) = part.segment<3>(3 * k);
  out.gradient = m.value * b[1] * gradient;
  if (m.first != 0) out.gradient += m.first * b[0] * m.gradient;
  if (!wants_hessian) return;
  out.hessian.setZero(12, 12);
  const FeatureDistance::Matrix hessian = distance.hessian(m.value * b[1], m.value * b[2]);
  for (int k = 0; k < distance.vertices; ++k) {
    for (int l = 0; l < distance.vertices; ++l)
      out.hessian.block<3, 3>(3 * position[static_cast<size_t>(k)], 3 * position[static_cast<size_t>(l)]) =
          hessian.block<3, 3>(3 * k, 3 * l);
  }
  if (m.first == 0) return;
  const FeatureDistance::Matrix mixed = m.gradient * gradient.transpose();
  out.hessian += m.first * b[0] * m.hessian + m.second * b[0] * m.gradient * m.gradient.transpose() +
                 m.first * b[1] * (mixed + mixed.transpose());
}

Contact3d::Contact3d(const Mesh& mesh, Contact3dSettings settings)
    : surface_(std::make_unique<const Surface>(mesh, std::move(settings))) {}
Contact3d::~Contact3d() = default;

std::vector<std::array<int, 3>> contact_triangles(const Mesh& mesh) {
  if (mesh.dimension() != 3) throw std::logic_error("contact: the mesh is plane");
  const Tag facets = boundary(mesh);
  std::vector<std::array<int, 3>> triangles;
  for (int f = 0; f < facets.count(); ++f) {
    const int* n = facets.entities.data() + static_cast<size_t>(f) * facets.nodes_per_entity;
    if (facets.nodes_per_entity == 3) {
      triangles.push_back({n[0], n[1], n[2]});
    } else {
      triangles.push_back({n[0], n[3], n[5]});
      triangles.push_back({n[1], n[4], n[3]});
      triangles.push_back({n[2], n[5], n[4]});
      triangles.push_back({n[3], n[4], n[5]});
    }
  }
  return triangles;
}

void Contact3d::assemble(const Point& at, Assembly& out) const {
  const Surface& surface = *surface_;
  const Surface::State s = surface.state(at.u);
  const double gap = at.p[surface.settings.gap];
  const Barrier whole{gap}, small{edge_reach * gap};
  Local local;
  for (const Interaction& i : surface.interactions(s, at.p)) {
    if (!(i.distance > 0)) {
      out.add_energy(infinity);
      return;
    }
    const bool edges = i.kind == Interaction::Kind::edges;
    const Barrier& barrier = edges ? small : whole;
    const double factor = at.p[i.stiffness] * i.weight, slope = factor * barrier.slope(i.distance);
    double mollified = 1;
    int vertex = i.first;
    if (edges) {
      const auto& [a, b] = surface.edges[static_cast<size_t>(i.first)];
      const auto& [c, d] = surface.edges[static_cast<size_t>(i.second)];
      mollified = Mollifier(s.from(a, b), s.from(c, d), surface.threshold(i)).value;
      vertex = a;
    }
    out.add_energy(factor * mollified * barrier.value(i.distance));
    // Displacements are rounded, and with them the distance.
    out.magnitude += std::abs(mollified * slope) * s.u.col(vertex).cwiseAbs().maxCoeff();
    if (out.gradient == nullptr && !out.wants_hessian()) continue;
    const double curvature = out.wants_hessian() ? factor * barrier.curvature(i.distance) : 0;
    surface.differentiate(s, i, {factor * barrier.value(i.distance), slope, curvature}, out.wants_hessian(), local);
    if (out.gradient != nullptr) out.add_gradient(local.nodes.data(), local.count, 3, local.gradient.data());
    if (out.wants_hessian()) {
      if (out.curvature == Curvature::projected) local.hessian = positive_part(local.hessian);
      out.add_coupling(local.nodes.data(), local.count, 3, local.hessian.data());
    }
  }
}

bool Contact3d::depends_on(int index) const {
  const Contact3dSettings& settings = surface_->settings;
  if (index < 0) return false;
  if (index == settings.gap || index == settings.ground_stiffness) return true;
  return std::find(settings.stiffness.begin(), settings.stiffness.end(), index) != settings.stiffness.end();
}

void Contact3d::add_parameter_gradient(const Point& at, int index, Eigen::VectorXd& out) const {
  if (!depends_on(index)) return;
  const Surface& surface = *surface_;
  const Surface::State s = surface.state(at.u);
  const double gap = at.p[surface.settings.gap];
  const bool by_gap = index == surface.settings.gap;
  Local local;
  for (const Interaction& i : surface.interactions(s, at.p)) {
    if (!by_gap && index != i.stiffness) continue;
    const double reach = i.kind == Interaction::Kind::edges ? edge_reach : 1.0, d = i.distance;
    const Barrier barrier{reach * gap};
    std::array<double, 3> b{barrier.value(d), barrier.slope(d), 0};
    if (by_gap) {
      // b is homogeneous of degree one in d and its gap: b = d b' + gap db/dgap.
      const double kappa = at.p[i.stiffness];
      b = {kappa * (b[0] - d * b[1]) / gap, kappa * reach * barrier.slope_by_gap(d), 0};
    }
    for (double& factor : b) factor *= i.weight;
    surface.differentiate(s, i, b, false, local);
    for (int k = 0; k < local.count; ++k)
      out.segment<3>(3 * Eigen::Index(local.nodes[static_cast<size_t>(k)])) += local.gradient.segment<3>(3 * k);
  }
}

double Contact3d::step_limit(const Point& at, const Eigen::VectorXd& step) const {
  if (!step.allFinite() || !at.u.allFinite()) return 0;
  const Surface& surface = *surface_;
  const Surface::State s = surface.state(at.u), change = surface.state(step);
  double limit = surface.ground_limit(s, change);
  const Surface::Sweep swept(s, change);
  // Pairs that may come down to two tenths of their distance, and for each vertex the smallest distance of those that
  // it belongs to: what slides along a face comes as near to what is ahead as it is to the face.
  struct Candidate {
    MovingPair3::Kind kind;
    std::array<int, 4> vertex;
    double distance;
    double motion;  ///< the most by which two of its vertices approach
  };
  std::vector<Candidate> candidates;
  std::vector<double> clearance(static_cast<size_t>(surface.vertices()), infinity);
  const auto consider = [&](MovingPair3::Kind kind, const std::array<int, 4>& vertex, auto&& distance_of) {
    const size_t split = kind == MovingPair3::Kind::segments ? 2 : 1;
    double motion = 0;
    for (size_t i = 0; i < split; ++i) {
      for (size_t j = split; j < 4; ++j)
        motion = std::max(motion, (change.u.col(vertex[i]) - change.u.col(vertex[j])).squaredNorm());
    }
    if (motion == 0) return;
    motion = std::sqrt(motion);
    const double distance = distance_of();
    if (!(motion > 0.8 * distance)) return;
    candidates.push_back({kind, vertex, distance, motion});
    for (int v : vertex) clearance[static_cast<size_t>(v)] = std::min(clearance[static_cast<size_t>(v)], distance);
  };
  surface.visit_pairs(
      swept,
      [&](int v, int t) {
        const auto& [a, b, c] = surface.triangles[static_cast<size_t>(t)];
        consider(MovingPair3::Kind::point_triangle, {v, a, b, c},
                 [&] { return surface.vertex_triangle(s, v, t).distance; });
      },
      [&](int e, int f) {
        const auto& [a, b] = surface.edges[static_cast<size_t>(e)];
        const auto& [c, d] = surface.edges[static_cast<size_t>(f)];
        consider(MovingPair3::Kind::segments, {a, b, c, d}, [&] { return surface.closest_of_edges(s, e, f).distance; });
      });
  for (const Candidate& candidate : candidates) {
    if (!(limit > 0)) break;
    if (limit * candidate.motion < 0.8 * candidate.distance) continue;
    MovingPair3 pair{candidate.kind, {}, {}};
    double nearest = candidate.distance;
    for (size_t k = 0; k < 4; ++k) {
      pair.x[k] = s.from(candidate.vertex[0], candidate.vertex[k]);
      pair.dx[k] = change.u.col(candidate.vertex[k]) - change.u.col(candidate.vertex[0]);
      nearest = std::min(nearest, clearance[static_cast<size_t>(candidate.vertex[k])]);
    }
    limit = free_motion(pair, 0.1 * nearest, limit);
  }
  return limit;
}

std::vector<ContactPair3> Contact3d::active_pairs(const Point& at, bool brute_force) const {
  const Surface& surface = *surface_;
  const Surface::State s = surface.state(at.u);
  const double gap = at.p[surface.settings.gap];
  const auto [points, lines] = surface.pairs_within(s, gap, gap, brute_force);
  std::vector<ContactPair3> pairs;
  const auto node = [&](int v) { return surface.nodes[static_cast<size_t>(v)]; };
  for (const Surface::Near& near : points)
    pairs.push_back({ContactPair3::Kind::point_triangle, node(near.first), near.second, near.closest.distance});
  for (const Surface::Near& near : lines)
    pairs.push_back({ContactPair3::Kind::edges, near.first, near.second, near.closest.distance});
  for (int v = 0; v < surface.vertices(); ++v) {
    for (int g = 0; g < surface.ground_count(); ++g) {
      const double height = s.height(g, v);
      if (height < gap) pairs.push_back({ContactPair3::Kind::ground, node(v), g, height});
    }
  }
  return pairs;
}

double Contact3d::smallest_distance(const Eigen::VectorXd& u, double horizon) const {
  const Surface& surface = *surface_;
  const Surface::State s = surface.state(u);
  double smallest = surface.lowest(s, horizon);
  const auto [points, lines] = surface.pairs_within(s, horizon, horizon);
  for (const std::vector<Surface::Near>* list : {&points, &lines}) {
    for (const Surface::Near& near : *list) smallest = std::min(smallest, near.closest.distance);
  }
  return smallest;
}

bool Contact3d::intersects(const Eigen::VectorXd& u) const {
  const Surface& surface = *surface_;
  const Surface::State s = surface.state(u);
  if (surface.behind_a_ground(s)) return true;
  const Surface::Places x = s.positions();
  const auto place = [&](int v) { return Box3(Vector3d(x.col(v))); };
  const std::vector<Box3> boxes =
      surface.triangle_tree.enclose(Surface::boxes_of(surface.triangles.begin(), surface.triangles.end(), place));
  bool found = false;
  for (int e = 0; e < surface.edge_count() && !found; ++e) {
    const auto [a, b] = surface.edges[static_cast<size_t>(e)];
    surface.triangle_tree.visit(boxes, place(a).merged(place(b)), [&, a, b](int t) {
      if (found || surface.contains(t, a) || surface.contains(t, b)) return;
      const auto& [c, d, f] = surface.triangles[static_cast<size_t>(t)];
      if (surface.apart(a, c)) return;
      found = segment_meets_triangle(x.col(a), x.col(b), {x.col(c), x.col(d), x.col(f)});
    });
  }
  return found;
}

}  // namespace taut

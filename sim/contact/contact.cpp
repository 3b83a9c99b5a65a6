#include "sim/contact/contact.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>

#include "sim/contact/contact_geometry.hpp"
#include "sim/contact/surface.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

/// The energy of a pair as a function of its distance, without weights: the barrier, or the spring of a penalty.
struct PairLaw {
  Barrier barrier;
  bool penalty;

  double value(double d) const {
    if (!penalty) return barrier.value(d);
    return d < barrier.gap ? 0.5 * (barrier.gap - d) * (1 - d / barrier.gap) : 0;
  }
  double slope(double d) const { return !penalty ? barrier.slope(d) : d < barrier.gap ? d / barrier.gap - 1 : 0; }
  double curvature(double d) const { return !penalty ? barrier.curvature(d) : d < barrier.gap ? 1 / barrier.gap : 0; }
  double slope_by_gap(double d) const {
    return !penalty ? barrier.slope_by_gap(d) : d < barrier.gap ? -d / (barrier.gap * barrier.gap) : 0;
  }
};

}  // namespace

/// Vertices: the nodes of the edges in ascending order, then the obstacles' points. Edges: those of the settings, then
/// the obstacles' segments.
struct PlaneSurface : ContactSurface<2, ContactSettings> {
  using Local = taut::Local<2, 3>;
  using Near = taut::Near<Closest>;

  int mesh_nodes = 0, body_edges = 0;
  std::vector<std::array<int, 2>> edges;
  std::vector<int> edge_stiffness;  ///< -1: the other side's
  std::vector<double> length;       ///< of rest boundary per vertex [m]
  std::vector<int> obstacle_of;     ///< of each vertex of one
  IndexLists edges_at;              ///< per vertex
  IndexLists vertex_patches, edge_patches;
  BoxTree<2> body_tree, obstacle_tree;

  Closest closest(const State& s, int vertex, int edge) const {
    const auto& [a, b] = edges[edge];
    return closest_on_segment(s.from(a, vertex), s.from(a, b));
  }
  bool contains(int edge, int vertex) const {
    const auto& [a, b] = edges[edge];
    return a == vertex || b == vertex;
  }
  bool ignores(int edge, int vertex) const {
    return contains(edge, vertex) ||
           (have_common(vertex_patches[vertex], edge_patches[edge]) && of_two_parts(vertex, edges[edge][0]));
  }
  int edge_count() const { return static_cast<int>(edges.size()); }

  PlaneSurface(const Mesh& mesh, ContactSettings given);
  void add_obstacles();
  void find_neighbours();

  /// Boxes of all nodes of the two trees, by those that box_of(vertex) gives.
  struct Boxes {
    std::vector<Box> body, obstacles;
  };
  template <class BoxOf>
  Boxes enclose(BoxOf&& box_of) const {
    const auto middle = edges.begin() + body_edges;
    return {body_tree.enclose(boxes_of(edges.begin(), middle, box_of)),
            obstacle_tree.enclose(boxes_of(middle, edges.end(), box_of))};
  }
  /// visit(edge) for the edges that a vertex could touch and of which the boxes meet `box`.
  template <class Visit>
  void visit_edges(const Boxes& boxes, int vertex, const Box& box, Visit&& visit) const;
  std::vector<Near> pairs_within(const State& s, double reach, bool brute_force = false) const;
  int stiffness_of(const Params& p, int vertex) const { return softest(p, edges_at[vertex], edge_stiffness); }
  bool penalty() const { return settings.form == ContactForm::penalty; }
  bool weighted() const { return penalty() || settings.form == ContactForm::length_weighted; }
  PairLaw law(const Interaction&, const Params& p) const { return {{p[settings.gap], weighted() ? 1 : 2}, penalty()}; }
  int thickness() const { return weighted() ? settings.thickness : -1; }
  double scale(const Params& p) const { return thickness() >= 0 ? p[thickness()] : 1.0; }
  double mollified(const State&, const Interaction&) const { return 1; }
  int feature_count() const { return edge_count(); }
  std::vector<std::array<int, 2>> facets() const { return {edges.begin(), edges.begin() + body_edges}; }
  const std::array<int, 2>& corners_of(int edge) const { return edges[edge]; }
  int stiffness_of_feature(int edge) const { return edge_stiffness[edge]; }
  double share_of(int vertex) const { return 0.5 * length[vertex]; }
  int side_of_vertex(int v) const { return v < moving() ? part_of(v) : -1 - obstacle_of[v - moving()]; }
  int side_of(int feature) const {
    if (feature < edge_count()) return side_of_vertex(edges[feature][0]);
    return -1 - static_cast<int>(settings.obstacles.size()) - (feature - edge_count());
  }
  /// Of what an interaction's vertex meets.
  int other_side(const Interaction& i) const {
    if (i.kind == Interaction::Kind::ground) return side_of(edge_count() + i.second);
    return i.kind == Interaction::Kind::vertex ? side_of_vertex(i.second) : side_of(i.second);
  }
  template <class Meet>
  void each_point_pair(const State& s, double reach, Meet&& meet) const {
    for (const Near& near : pairs_within(s, reach)) meet(near.first, near.second, near.closest.distance);
  }
  int vertex_of(const Interaction& i) const { return i.first; }
  std::vector<Interaction> interactions(const State& s, const Params& p) const;
  void add_vertex_interactions(const State& s, const Params& p, std::span<const Near> near,
                               std::vector<Interaction>& all) const;
  void differentiate(const State& s, const Interaction& i, const OfDistance& f, Local& out) const;
  OfDistance parameter_derivative(const Interaction& i, const Params& p, int index) const;
  double step_limit(const State& s, const State& change, double limit) const;
  std::vector<ContactPair> active_pairs(const State& s, double gap, bool brute_force) const;
  template <class Consider>
  void each_distance(const State& s, double horizon, Consider&& consider) const {
    for (const Near& near : pairs_within(s, horizon)) consider(near.closest.distance);
  }
  /// found(edge, edge) for those that meet in the places x, until it says true.
  template <class Found>
  void each_crossing(const Places& x, Found&& found) const;
  double overlap_about(const PinPatch<2>& pin, double reach) const;
};

PlaneSurface::PlaneSurface(const Mesh& mesh, ContactSettings given) : ContactSurface(std::move(given)) {
  mesh_nodes = mesh.node_count();
  edges = number_vertices(mesh, settings.edges, "an edge");
  body_edges = edge_count();
  edge_stiffness = settings.stiffness;
  add_obstacles();
  normalise_grounds();
  find_neighbours();
  vertex_patches = patches_of_vertices();
  edge_patches = patches_of(edges);
}

void PlaneSurface::add_obstacles() {
  for (size_t o = 0; o < settings.obstacles.size(); ++o) {
    const auto& line = settings.obstacles[o];
    if (line.size() < 2)
      throw InputError(fmt::format("contact: obstacle {} has {} points; at least 2 are needed", o + 1, line.size()));
    for (size_t k = 1; k < line.size(); ++k) {
      if (!line[k].allFinite() || !line[k - 1].allFinite() || line[k] == line[k - 1]) {
        throw InputError(fmt::format(
            "contact: points {} and {} of obstacle {} are equal or not finite; remove one of them", k, k + 1, o + 1));
      }
    }
    const bool closed = line.size() > 3 && line.front() == line.back();
    const int first = vertices(), count = static_cast<int>(line.size()) - (closed ? 1 : 0);
    X.conservativeResize(2, first + count);
    for (int k = 0; k < count; ++k) X.col(first + k) = line[k];
    obstacle_of.resize(static_cast<size_t>(vertices() - moving()), static_cast<int>(o));
    for (int k = 0; k + 1 < static_cast<int>(line.size()); ++k) {
      edges.push_back({first + k, first + (k + 1) % count});
      edge_stiffness.push_back(settings.obstacle_stiffness);
    }
  }
}

void PlaneSurface::find_neighbours() {
  std::vector<std::vector<int>> at(vertices());
  length.assign(at.size(), 0.0);
  std::vector<Eigen::Vector2d> body, obstacles;
  for (int e = 0; e < edge_count(); ++e) {
    const auto& [a, b] = edges[e];
    const double half = 0.5 * (X.col(b) - X.col(a)).norm();
    if (!(half > 0)) throw std::logic_error("contact: an edge has no length");
    for (int v : {a, b}) {
      at[v].push_back(e);
      length[v] += half;
    }
    (e < body_edges ? body : obstacles).emplace_back(0.5 * (X.col(a) + X.col(b)));
  }
  edges_at.assign(at);
  body_tree = BoxTree<2>(body);
  obstacle_tree = BoxTree<2>(obstacles);
}

template <class Visit>
void PlaneSurface::visit_edges(const Boxes& boxes, int vertex, const Box& box, Visit&& visit) const {
  body_tree.visit(boxes.body, box, [&](int e) {
    if (!ignores(e, vertex)) visit(e);
  });
  if (vertex < moving()) obstacle_tree.visit(boxes.obstacles, box, [&](int e) { visit(body_edges + e); });
}

std::vector<PlaneSurface::Near> PlaneSurface::pairs_within(const State& s, double reach, bool brute_force) const {
  std::vector<Near> pairs;
  const auto look = [&](int vertex, int edge) {
    const Closest near = closest(s, vertex, edge);
    if (near.distance < reach) pairs.push_back({vertex, edge, near});
  };
  if (brute_force) {
    for (int v = 0; v < vertices(); ++v) {
      for (int e = 0; e < (v < moving() ? edge_count() : body_edges); ++e) {
        if (!ignores(e, v)) look(v, e);
      }
    }
    return pairs;
  }
  // Positions are rounded, relative positions less so: a little more than the reach loses no pair.
  const double margin = reach * (1 + 1e-6) + s.rounding();
  const Places x = s.positions();
  const Boxes boxes = enclose([&](int v) { return Box(x.col(v).array() - margin, x.col(v).array() + margin); });
  for (int v = 0; v < vertices(); ++v) visit_edges(boxes, v, Box(Place(x.col(v))), [&](int e) { look(v, e); });
  std::sort(pairs.begin(), pairs.end());
  return pairs;
}

/// What one vertex feels: the edges near it, less what their vertices count twice.
void PlaneSurface::add_vertex_interactions(const State& s, const Params& p, std::span<const Near> near,
                                           std::vector<Interaction>& all) const {
  using Kind = Interaction::Kind;
  const int i = near.front().first, own = stiffness_of(p, i);
  const double gap = p[settings.gap], weight = weighted() ? 0.5 * length[i] : 1.0;
  const size_t first_of_vertex = all.size();
  const auto add_vertex = [&](int v, int stiffness, double w) {
    // Edges that end in v and the vertex taken back are the same function: what remains is often nothing.
    for (size_t k = first_of_vertex; k < all.size(); ++k) {
      if (all[k].kind == Kind::vertex && all[k].second == v && all[k].stiffness == stiffness) {
        all[k].weight += w;
        return;
      }
    }
    all.push_back({Kind::vertex, i, v, stiffness, w, s.from(v, i).norm()});
  };
  for (const auto& [vertex, e, closest] : near) {
    const auto& [a, b] = edges[e];
    const int stiffness = softer(p, own, edge_stiffness[e]);
    if (closest.part == Closest::Part::inside)
      all.push_back({Kind::edge, i, e, stiffness, weight, closest.distance});
    else
      add_vertex(closest.part == Closest::Part::first_end ? a : b, stiffness, weight);
    if (settings.form == ContactForm::pair_sum) continue;
    for (int v : {a, b}) {
      // Once per vertex: with the first of its edges that does not contain i.
      const auto around = edges_at[v];
      const auto lead = std::ranges::find_if(around, [&](int other) { return !ignores(other, i); });
      if (*lead != e || around.end() - lead < 2 || !(s.from(v, i).norm() < gap)) continue;
      int least = -1;
      for (auto other = lead; other != around.end(); ++other) {
        if (ignores(*other, i)) continue;
        const int here = softer(p, own, edge_stiffness[*other]);
        add_vertex(v, here, -weight);
        least = softer(p, least, here);
      }
      add_vertex(v, least, weight);
    }
  }
}

std::vector<Interaction> PlaneSurface::interactions(const State& s, const Params& p) const {
  const double gap = p[settings.gap];
  const std::vector<Near> pairs = pairs_within(s, gap);
  std::vector<Interaction> all;
  each_vertex(pairs, [&](std::span<const Near> near) { add_vertex_interactions(s, p, near, all); });
  std::erase_if(all, [](const Interaction& i) { return i.weight == 0; });
  each_height(s, [&](int g, int v, double height) {
    if (!(height < gap)) return;
    const int stiffness = softer(p, stiffness_of(p, v), settings.obstacle_stiffness);
    all.push_back({Interaction::Kind::ground, v, g, stiffness, weighted() ? length[v] : 1.0, height});
  });
  return all;
}

void PlaneSurface::differentiate(const State& s, const Interaction& i, const OfDistance& f, Local& out) const {
  // The vertices of obstacles cannot move: their rows are left out.
  const auto keep = [&](std::initializer_list<int> involved, const auto& gradient, const auto& hessian) {
    std::array<int, 6> row;
    int n = 0, position = 0;
    out.count = 0;
    for (int v : involved) {
      if (v < moving()) {
        out.nodes[out.count++] = nodes[v];
        for (int k = 0; k < 2; ++k) row[n++] = 2 * position + k;
      }
      ++position;
    }
    out.gradient.resize(n);
    if (f.wants_hessian) out.hessian.resize(n, n);
    for (int r = 0; r < n; ++r) {
      out.gradient[r] = f.first * gradient[row[r]];
      for (int c = 0; f.wants_hessian && c < n; ++c) out.hessian(r, c) = hessian(row[r], row[c]);
    }
  };
  const auto keep_distance = [&](std::initializer_list<int> involved, const auto& distance) {
    decltype(distance.hessian(0, 0)) hessian;
    if (f.wants_hessian) hessian = distance.hessian(f.first, f.second, f.curvature);
    keep(involved, distance.gradient(), hessian);
  };
  if (i.kind == Interaction::Kind::vertex) {
    keep_distance({i.first, i.second}, PointPointDistance(s.from(i.second, i.first)));
  } else if (i.kind == Interaction::Kind::edge) {
    const auto& [a, b] = edges[i.second];
    keep_distance({i.first, a, b}, PointLineDistance(s.from(a, i.first), s.from(a, b)));
  } else {
    differentiate_height(s, i, f, out);
  }
}

OfDistance PlaneSurface::parameter_derivative(const Interaction& i, const Params& p, int index) const {
  const PairLaw law = this->law(i, p);
  const double kappa = p[i.stiffness];
  double factor = 0;
  if (index == settings.gap) factor += scale(p) * kappa * law.slope_by_gap(i.distance);
  if (index == i.stiffness) factor += scale(p) * law.slope(i.distance);
  if (index == thickness()) factor += kappa * law.slope(i.distance);
  return {0, i.weight * factor};
}

std::vector<std::array<int, 2>> contact_edges(const Mesh& mesh) {
  if (mesh.dimension() != 2) throw std::logic_error("contact: the mesh is not plane");
  return order_of(mesh.shape) == 1 ? pieces_of_boundary<2>(mesh, {{0, 1}})
                                   : pieces_of_boundary<2>(mesh, {{0, 2}, {2, 1}});
}

double PlaneSurface::step_limit(const State& s, const State& change, double limit) const {
  const Sweep swept(s, change);
  const Boxes boxes = enclose(swept);
  // Distance to the nearest edge at the start, if that is below `radius`.
  const auto clearance = [&](int v, double radius) {
    double nearest = radius;
    const Box around(swept.x.col(v).array() - radius, swept.x.col(v).array() + radius);
    visit_edges(boxes, v, around, [&](int e) { nearest = std::min(nearest, closest(s, v, e).distance); });
    return nearest;
  };
  for (int v = 0; v < vertices() && limit > 0; ++v) {
    visit_edges(boxes, v, swept(v), [&](int e) {
      const auto& [a, b] = edges[e];
      const MovingPair pair{s.from(a, v), s.from(a, b), change.u.col(v) - change.u.col(a),
                            change.u.col(b) - change.u.col(a)};
      const double distance = closest_on_segment(pair.r, pair.e).distance;
      if (free_motion(pair, 0.1 * distance, limit) == limit) return;
      // What slides along a face comes as near to the vertices ahead as it is to the face.
      const double nearest = std::min({clearance(v, distance), clearance(a, distance), clearance(b, distance)});
      limit = free_motion(pair, 0.1 * nearest, limit);
    });
  }
  return limit;
}

std::vector<ContactPair> PlaneSurface::active_pairs(const State& s, double gap, bool brute_force) const {
  std::vector<ContactPair> pairs;
  const auto number = [&](int v) { return v < moving() ? nodes[v] : mesh_nodes + v - moving(); };
  for (const Near& near : pairs_within(s, gap, brute_force))
    pairs.push_back({number(near.first), near.second, near.closest.distance});
  each_height(s, [&](int g, int v, double height) {
    if (height < gap) pairs.push_back({number(v), edge_count() + g, height});
  });
  std::sort(pairs.begin(), pairs.end(), [](const ContactPair& one, const ContactPair& two) {
    return one.node < two.node || (one.node == two.node && one.edge < two.edge);
  });
  return pairs;
}

template <class Found>
void PlaneSurface::each_crossing(const Places& x, Found&& found) const {
  const auto place = [&](int v) { return Box(Place(x.col(v))); };
  const Boxes boxes = enclose(place);
  bool enough = false;
  const auto meet = [&](int e, int f) {
    auto [a, b] = edges[e];
    auto [c, d] = edges[f];
    if (b == c || b == d) std::swap(a, b);
    if (a == d) std::swap(c, d);
    if (have_common(edge_patches[e], edge_patches[f]) && of_two_parts(a, c)) return false;
    if (a != c) return segments_meet(x.col(a), x.col(b), x.col(c), x.col(d));
    // Neighbours may share their node only: they must not lie on each other.
    return b == d ||
           (orientation(x.col(a), x.col(b), x.col(d)) == 0 && (x.col(b) - x.col(a)).dot(x.col(d) - x.col(a)) > 0);
  };
  const auto look = [&](int e, int f) {
    if (!enough && e < f && meet(e, f)) enough = found(e, f);
  };
  for (int e = 0; e < body_edges && !enough; ++e) {
    const auto& [a, b] = edges[e];
    const Box box = place(a).merged(place(b));
    body_tree.visit(boxes.body, box, [&](int f) { look(e, f); });
    obstacle_tree.visit(boxes.obstacles, box, [&](int f) { look(e, body_edges + f); });
  }
}

double PlaneSurface::overlap_about(const PinPatch<2>& pin, double reach) const {
  double farthest = -1;
  const State rest{*this, Places::Zero(2, vertices()), Places::Zero(2, ground_count())};
  for (const Near& near : pairs_within(rest, reach))
    extend_overlap(pin, std::array{near.first}, edges[near.second], farthest);
  each_crossing(X, [&](int e, int f) {
    extend_overlap(pin, edges[e], edges[f], farthest);
    return false;
  });
  return farthest;
}

template struct Ground<2>;
template class SurfaceContact<PlaneSurface, ContactSettings, ContactPair>;

}  // namespace taut

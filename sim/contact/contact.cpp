#include "sim/contact/contact.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <limits>
#include <stdexcept>

#include "sim/contact/contact_geometry.hpp"
#include "sim/contact/surface.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

constexpr double infinity = std::numeric_limits<double>::infinity();

/// weight * kappa * b(distance) between a vertex and another vertex, the line through two, or a ground.
struct Interaction {
  enum class Kind { vertex, line, ground };
  Kind kind;
  int vertex;
  int first;      ///< other vertex, or first one of the line, or the ground
  int second;     ///< second vertex of the line
  int stiffness;  ///< table index
  double weight;  ///< without kappa and thickness; negative where a vertex is taken back
};

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

/// What is asked of the law f of a distance: f', f'' and which Hessian.
struct Derivatives {
  double first = 0, second = 0;
  bool wants_hessian = false;
  Curvature curvature = Curvature::exact;
};

/// The gradient of a distance and the Hessian of its barrier on the nodes that can move.
struct Local {
  int count = 0;  ///< of nodes
  std::array<int, 3> nodes;
  std::array<double, 6> gradient;
  std::array<double, 36> hessian;  ///< (2 count x 2 count)
};

}  // namespace

/// Vertices: the nodes of the edges in ascending order, then the obstacles' points. Edges: those of the settings, then
/// the obstacles' segments.
struct Contact::Surface : ContactSurface<2, ContactSettings> {
  struct Near {
    int vertex, edge;
    Closest closest;
  };

  int mesh_nodes = 0, body_edges = 0;
  std::vector<std::array<int, 2>> edges;
  std::vector<int> edge_stiffness;    ///< -1: the other side's
  std::vector<double> length;         ///< of rest boundary per vertex [m]
  IndexLists edges_at, stiffness_at;  ///< per vertex
  BoxTree<2> body_tree, obstacle_tree;

  Closest closest(const State& s, int vertex, int edge) const {
    const auto& [a, b] = edges[static_cast<size_t>(edge)];
    return closest_on_segment(s.from(a, vertex), s.from(a, b));
  }
  bool contains(int edge, int vertex) const {
    const auto& [a, b] = edges[static_cast<size_t>(edge)];
    return a == vertex || b == vertex;
  }
  bool ignores(int edge, int vertex) const {
    return contains(edge, vertex) || apart(vertex, edges[static_cast<size_t>(edge)][0]);
  }
  int edge_count() const { return static_cast<int>(edges.size()); }

  Surface(const Mesh& mesh, ContactSettings given);
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
  int stiffness_of(const Params& p, int vertex) const {
    const auto [begin, end] = stiffness_at[vertex];
    int least = -1;
    for (const int* k = begin; k != end; ++k) least = softer(p, least, *k);
    return least;
  }
  bool penalty() const { return settings.form == ContactForm::penalty; }
  bool weighted() const { return penalty() || settings.form == ContactForm::length_weighted; }
  PairLaw law(const Params& p) const { return {{p[settings.gap], weighted() ? 1 : 2}, penalty()}; }
  double scale(const Params& p) const { return weighted() && settings.thickness >= 0 ? p[settings.thickness] : 1.0; }
  std::vector<Interaction> interactions(const State& s, const Params& p) const;
  void add_vertex_interactions(const State& s, const Params& p, const Near* begin, const Near* end,
                               std::vector<Interaction>& all) const;
  double distance(const State& s, const Interaction& i) const;
  void differentiate(const State& s, const Interaction& i, const Derivatives& f, Local& out) const;
};

Contact::Surface::Surface(const Mesh& mesh, ContactSettings given) : ContactSurface(std::move(given)) {
  mesh_nodes = mesh.node_count();
  edges = number_vertices(mesh, settings.edges, "an edge");
  body_edges = edge_count();
  edge_stiffness = settings.stiffness;
  add_obstacles();
  normalise_grounds();
  find_neighbours();
}

void Contact::Surface::add_obstacles() {
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
    for (int k = 0; k < count; ++k) X.col(first + k) = line[static_cast<size_t>(k)];
    for (int k = 0; k + 1 < static_cast<int>(line.size()); ++k) {
      edges.push_back({first + k, first + (k + 1) % count});
      edge_stiffness.push_back(settings.obstacle_stiffness);
    }
  }
}

void Contact::Surface::find_neighbours() {
  std::vector<std::vector<int>> at(static_cast<size_t>(vertices()));
  length.assign(at.size(), 0.0);
  std::vector<Eigen::Vector2d> body, obstacles;
  for (int e = 0; e < edge_count(); ++e) {
    const auto& [a, b] = edges[static_cast<size_t>(e)];
    const double half = 0.5 * (X.col(b) - X.col(a)).norm();
    if (!(half > 0)) throw std::logic_error("contact: an edge has no length");
    for (int v : {a, b}) {
      at[static_cast<size_t>(v)].push_back(e);
      length[static_cast<size_t>(v)] += half;
    }
    (e < body_edges ? body : obstacles).emplace_back(0.5 * (X.col(a) + X.col(b)));
  }
  for (const auto& list : at) {
    edges_at.add(list);
    std::vector<int> kinds;
    for (int e : list) kinds.push_back(edge_stiffness[static_cast<size_t>(e)]);
    std::sort(kinds.begin(), kinds.end());
    kinds.erase(std::unique(kinds.begin(), kinds.end()), kinds.end());
    stiffness_at.add(kinds);
  }
  body_tree = BoxTree<2>(body);
  obstacle_tree = BoxTree<2>(obstacles);
}

template <class Visit>
void Contact::Surface::visit_edges(const Boxes& boxes, int vertex, const Box& box, Visit&& visit) const {
  body_tree.visit(boxes.body, box, [&](int e) {
    if (!ignores(e, vertex)) visit(e);
  });
  if (vertex < moving()) obstacle_tree.visit(boxes.obstacles, box, [&](int e) { visit(body_edges + e); });
}

std::vector<Contact::Surface::Near> Contact::Surface::pairs_within(const State& s, double reach,
                                                                   bool brute_force) const {
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
  std::sort(pairs.begin(), pairs.end(), [](const Near& one, const Near& two) {
    return one.vertex < two.vertex || (one.vertex == two.vertex && one.edge < two.edge);
  });
  return pairs;
}

/// What one vertex feels: the edges near it, less what their vertices count twice.
void Contact::Surface::add_vertex_interactions(const State& s, const Params& p, const Near* begin, const Near* end,
                                               std::vector<Interaction>& all) const {
  using Kind = Interaction::Kind;
  const int i = begin->vertex, own = stiffness_of(p, i);
  const double gap = p[settings.gap], weight = weighted() ? 0.5 * length[static_cast<size_t>(i)] : 1.0;
  const size_t first_of_vertex = all.size();
  const auto add_vertex = [&](int v, int stiffness, double w) {
    // Edges that end in v and the vertex taken back are the same function: what remains is often nothing.
    for (size_t k = first_of_vertex; k < all.size(); ++k) {
      if (all[k].kind == Kind::vertex && all[k].first == v && all[k].stiffness == stiffness) {
        all[k].weight += w;
        return;
      }
    }
    all.push_back({Kind::vertex, i, v, -1, stiffness, w});
  };
  for (const Near* near = begin; near != end; ++near) {
    const int e = near->edge;
    const auto& [a, b] = edges[static_cast<size_t>(e)];
    const int stiffness = softer(p, own, edge_stiffness[static_cast<size_t>(e)]);
    if (near->closest.part == Closest::Part::inside)
      all.push_back({Kind::line, i, a, b, stiffness, weight});
    else
      add_vertex(near->closest.part == Closest::Part::first_end ? a : b, stiffness, weight);
    if (settings.form == ContactForm::pair_sum) continue;
    for (int v : {a, b}) {
      // Once per vertex: with the first of its edges that does not contain i.
      const auto [first, last] = edges_at[v];
      const int* lead = std::find_if(first, last, [&](int other) { return !ignores(other, i); });
      if (*lead != e || last - lead < 2 || !(s.from(v, i).norm() < gap)) continue;
      int softest = -1;
      for (const int* other = lead; other != last; ++other) {
        if (ignores(*other, i)) continue;
        const int here = softer(p, own, edge_stiffness[static_cast<size_t>(*other)]);
        add_vertex(v, here, -weight);
        softest = softer(p, softest, here);
      }
      add_vertex(v, softest, weight);
    }
  }
}

std::vector<Interaction> Contact::Surface::interactions(const State& s, const Params& p) const {
  const double gap = p[settings.gap];
  const std::vector<Near> pairs = pairs_within(s, gap);
  std::vector<Interaction> all;
  for (size_t begin = 0, end = 0; begin < pairs.size(); begin = end) {
    while (end < pairs.size() && pairs[end].vertex == pairs[begin].vertex) ++end;
    add_vertex_interactions(s, p, pairs.data() + begin, pairs.data() + end, all);
  }
  all.erase(std::remove_if(all.begin(), all.end(), [](const Interaction& i) { return i.weight == 0; }), all.end());
  for (int g = 0; g < ground_count(); ++g) {
    for (int v = 0; v < moving(); ++v) {
      if (!(s.height(g, v) < gap)) continue;
      const int stiffness = softer(p, stiffness_of(p, v), settings.obstacle_stiffness);
      const double weight = weighted() ? length[static_cast<size_t>(v)] : 1.0;
      all.push_back({Interaction::Kind::ground, v, g, -1, stiffness, weight});
    }
  }
  return all;
}

double Contact::Surface::distance(const State& s, const Interaction& i) const {
  switch (i.kind) {
    case Interaction::Kind::vertex:
      return s.from(i.first, i.vertex).norm();
    case Interaction::Kind::line:
      return closest_on_segment(s.from(i.first, i.vertex), s.from(i.first, i.second)).distance;
    case Interaction::Kind::ground:
      break;
  }
  return s.height(i.first, i.vertex);
}

void Contact::Surface::differentiate(const State& s, const Interaction& i, const Derivatives& f, Local& out) const {
  // The vertices of obstacles cannot move: their rows are left out.
  const auto keep = [&](std::initializer_list<int> involved, const auto& gradient, const auto& hessian) {
    std::array<int, 6> row;
    int n = 0, position = 0;
    out.count = 0;
    for (int v : involved) {
      if (v < moving()) {
        out.nodes[static_cast<size_t>(out.count++)] = nodes[static_cast<size_t>(v)];
        for (int k = 0; k < 2; ++k) row[static_cast<size_t>(n++)] = 2 * position + k;
      }
      ++position;
    }
    for (int r = 0; r < n; ++r) {
      out.gradient[static_cast<size_t>(r)] = gradient[row[static_cast<size_t>(r)]];
      if (!f.wants_hessian) continue;
      for (int c = 0; c < n; ++c)
        out.hessian[static_cast<size_t>(r * n + c)] = hessian(row[static_cast<size_t>(r)], row[static_cast<size_t>(c)]);
    }
  };
  switch (i.kind) {
    case Interaction::Kind::vertex: {
      const PointPointDistance distance(s.from(i.first, i.vertex));
      const Eigen::Matrix4d hessian =
          f.wants_hessian ? distance.hessian(f.first, f.second, f.curvature) : Eigen::Matrix4d::Zero();
      return keep({i.vertex, i.first}, distance.gradient(), hessian);
    }
    case Interaction::Kind::line: {
      const PointLineDistance distance(s.from(i.first, i.vertex), s.from(i.first, i.second));
      PointLineDistance::Matrix6 hessian;
      if (f.wants_hessian) hessian = distance.hessian(f.first, f.second, f.curvature);
      return keep({i.vertex, i.first, i.second}, distance.gradient(), hessian);
    }
    case Interaction::Kind::ground: {
      const Eigen::Vector2d& normal = settings.grounds[static_cast<size_t>(i.first)].normal;
      return keep({i.vertex}, normal, Eigen::Matrix2d(f.second * normal * normal.transpose()));
    }
  }
}

Contact::Contact(const Mesh& mesh, ContactSettings settings)
    : surface_(std::make_unique<const Surface>(mesh, std::move(settings))) {}
Contact::~Contact() = default;

std::vector<std::array<int, 2>> contact_edges(const Mesh& mesh) {
  if (mesh.dimension() != 2) throw std::logic_error("contact: the mesh is not plane");
  const Tag facets = boundary(mesh);
  std::vector<std::array<int, 2>> edges;
  for (int f = 0; f < facets.count(); ++f) {
    const int* node = facets.entities.data() + static_cast<size_t>(f) * facets.nodes_per_entity;
    if (facets.nodes_per_entity == 2) {
      edges.push_back({node[0], node[1]});
    } else {
      edges.push_back({node[0], node[2]});
      edges.push_back({node[2], node[1]});
    }
  }
  return edges;
}

void Contact::assemble(const Point& at, Assembly& out) const {
  const Surface& surface = *surface_;
  const Surface::State s = surface.state(at.u);
  const PairLaw law = surface.law(at.p);
  const double scale = surface.scale(at.p);
  Local local;
  for (const Interaction& i : surface.interactions(s, at.p)) {
    const double factor = scale * at.p[i.stiffness] * i.weight;
    const double d = surface.distance(s, i);
    if (!(d > 0) && !law.penalty) {
      out.add_energy(infinity);
      return;
    }
    out.add_energy(factor * law.value(d));
    if (d == 0 && i.kind != Interaction::Kind::ground) continue;  // a spring of no direction
    Derivatives f{factor * law.slope(d), 0.0, out.wants_hessian(), out.curvature};
    // Displacements are rounded, and with them the distance.
    out.magnitude += std::abs(f.first) * s.u.col(i.vertex).cwiseAbs().maxCoeff();
    if (out.gradient == nullptr && !f.wants_hessian) continue;
    if (f.wants_hessian) f.second = factor * law.curvature(d);
    surface.differentiate(s, i, f, local);
    if (out.gradient != nullptr) {
      for (double& g : local.gradient) g *= f.first;
      out.add_gradient(local.nodes.data(), local.count, 2, local.gradient.data());
    }
    if (f.wants_hessian) out.add_coupling(local.nodes.data(), local.count, 2, local.hessian.data());
  }
}

bool Contact::depends_on(int index) const {
  const ContactSettings& settings = surface_->settings;
  if (index < 0) return false;
  if (index == settings.gap || index == settings.obstacle_stiffness) return true;
  if (index == settings.thickness) return surface_->weighted();
  return std::find(settings.stiffness.begin(), settings.stiffness.end(), index) != settings.stiffness.end();
}

void Contact::add_parameter_gradient(const Point& at, int index, Eigen::VectorXd& out) const {
  if (!depends_on(index)) return;
  const Surface& surface = *surface_;
  const ContactSettings& settings = surface.settings;
  const Surface::State s = surface.state(at.u);
  const PairLaw law = surface.law(at.p);
  const double scale = surface.scale(at.p);
  const bool is_thickness = index == settings.thickness && surface.weighted();
  Local local;
  for (const Interaction& i : surface.interactions(s, at.p)) {
    const double d = surface.distance(s, i), kappa = at.p[i.stiffness];
    double factor = 0;
    if (index == settings.gap) factor += scale * kappa * law.slope_by_gap(d);
    if (index == i.stiffness) factor += scale * law.slope(d);
    if (is_thickness) factor += kappa * law.slope(d);
    if (factor == 0 || (d == 0 && i.kind != Interaction::Kind::ground)) continue;
    surface.differentiate(s, i, {}, local);
    for (int k = 0; k < 2 * local.count; ++k) {
      out[2 * Eigen::Index(local.nodes[static_cast<size_t>(k / 2)]) + k % 2] +=
          i.weight * factor * local.gradient[static_cast<size_t>(k)];
    }
  }
}

double Contact::step_limit(const Point& at, const Eigen::VectorXd& step) const {
  if (surface_->penalty()) return 1;
  if (!step.allFinite() || !at.u.allFinite()) return 0;
  const Surface& surface = *surface_;
  const Surface::State s = surface.state(at.u), change = surface.state(step);
  double limit = surface.ground_limit(s, change);
  const Surface::Sweep swept(s, change);
  const Surface::Boxes boxes = surface.enclose(swept);
  // Distance to the nearest edge at the start, if that is below `radius`.
  const auto clearance = [&](int v, double radius) {
    double nearest = radius;
    const Surface::Box around(swept.x.col(v).array() - radius, swept.x.col(v).array() + radius);
    surface.visit_edges(boxes, v, around,
                        [&](int e) { nearest = std::min(nearest, surface.closest(s, v, e).distance); });
    return nearest;
  };
  for (int v = 0; v < surface.vertices() && limit > 0; ++v) {
    surface.visit_edges(boxes, v, swept(v), [&](int e) {
      const auto& [a, b] = surface.edges[static_cast<size_t>(e)];
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

std::vector<ContactPair> Contact::active_pairs(const Point& at, bool brute_force) const {
  const Surface& surface = *surface_;
  const Surface::State s = surface.state(at.u);
  const double gap = at.p[surface.settings.gap];
  std::vector<ContactPair> pairs;
  const auto number = [&](int v) {
    return v < surface.moving() ? surface.nodes[static_cast<size_t>(v)] : surface.mesh_nodes + v - surface.moving();
  };
  for (const Surface::Near& near : surface.pairs_within(s, gap, brute_force))
    pairs.push_back({number(near.vertex), near.edge, near.closest.distance});
  for (int g = 0; g < surface.ground_count(); ++g) {
    for (int v = 0; v < surface.moving(); ++v) {
      const double height = s.height(g, v);
      if (height < gap) pairs.push_back({number(v), surface.edge_count() + g, height});
    }
  }
  std::sort(pairs.begin(), pairs.end(), [](const ContactPair& one, const ContactPair& two) {
    return one.node < two.node || (one.node == two.node && one.edge < two.edge);
  });
  return pairs;
}

double Contact::smallest_distance(const Eigen::VectorXd& u, double horizon) const {
  const Surface& surface = *surface_;
  const Surface::State s = surface.state(u);
  double smallest = surface.lowest(s, horizon);
  for (const Surface::Near& near : surface.pairs_within(s, horizon))
    smallest = std::min(smallest, near.closest.distance);
  return smallest;
}

bool Contact::intersects(const Eigen::VectorXd& u) const {
  const Surface& surface = *surface_;
  const Surface::State s = surface.state(u);
  if (surface.behind_a_ground(s)) return true;
  const Surface::Places x = s.positions();
  const auto place = [&](int v) { return Surface::Box(Surface::Place(x.col(v))); };
  const Surface::Boxes boxes = surface.enclose(place);
  bool found = false;
  const auto look = [&](int e, int f) {
    if (found || e >= f) return;
    auto [a, b] = surface.edges[static_cast<size_t>(e)];
    auto [c, d] = surface.edges[static_cast<size_t>(f)];
    if (b == c || b == d) std::swap(a, b);
    if (a == d) std::swap(c, d);
    if (surface.apart(a, c)) return;
    if (a != c) {
      found = segments_meet(x.col(a), x.col(b), x.col(c), x.col(d));
    } else {
      // Neighbours may share their node only: they must not lie on each other.
      found = b == d ||
              (orientation(x.col(a), x.col(b), x.col(d)) == 0 && (x.col(b) - x.col(a)).dot(x.col(d) - x.col(a)) > 0);
    }
  };
  for (int e = 0; e < surface.body_edges && !found; ++e) {
    const auto& [a, b] = surface.edges[static_cast<size_t>(e)];
    const Surface::Box box = place(a).merged(place(b));
    surface.body_tree.visit(boxes.body, box, [&](int f) { look(e, f); });
    surface.obstacle_tree.visit(boxes.obstacles, box, [&](int f) { look(e, surface.body_edges + f); });
  }
  return found;
}

}  // namespace taut

#include "sim/contact/grip.hpp"

#include <algorithm>
#include <iterator>
#include <limits>
#include <stdexcept>

#include "sim/core/dense.hpp"
#include "sim/core/jet.hpp"

namespace taut {
namespace {

/// The ends of what has this number in a ContactPair, and its pressure's index; -1: the node's.
struct Edge {
  std::array<int, 2> node{-1, -1};
  Eigen::Matrix2d X;
  int pressure = -1;
  bool has_ends = true;  ///< else it is the line of a ground
};

Edge edge_of(const Mesh& mesh, const ContactSettings& settings, int number) {
  Edge edge;
  if (number < static_cast<int>(settings.edges.size())) {
    edge.node = settings.edges[static_cast<size_t>(number)];
    edge.X << mesh.node(edge.node[0]), mesh.node(edge.node[1]);
    edge.pressure = settings.stiffness[static_cast<size_t>(number)];
    return edge;
  }
  edge.pressure = settings.obstacle_stiffness;
  number -= static_cast<int>(settings.edges.size());
  for (const std::vector<Eigen::Vector2d>& line : settings.obstacles) {
    const int segments = static_cast<int>(line.size()) - 1;
    if (number < segments) {
      edge.X << line[static_cast<size_t>(number)], line[static_cast<size_t>(number) + 1];
      return edge;
    }
    number -= segments;
  }
  const GroundLine& ground = settings.grounds[static_cast<size_t>(number)];
  if (ground.is_round() || ground.node >= 0) throw std::logic_error("grip: grounds are lines that stay");
  const Eigen::Vector2d along(ground.normal[1], -ground.normal[0]);
  edge.has_ends = false;
  edge.X << ground.point, ground.point + mesh.diagonal() * along;
  return edge;
}

/// From one of a pair's vertices to another, as functions of the coordinates of all three.
struct Difference {
  Jet<6> x, y;
  Difference(const Eigen::Matrix<double, 2, 3>& X, const Eigen::Matrix<double, 2, 3>& u, int from, int to) {
    // Without the digits that positions share.
    const Eigen::Vector2d d = (X.col(to) - X.col(from)) + (u.col(to) - u.col(from));
    x = d[0];
    y = d[1];
    x.g[2 * to] = y.g[2 * to + 1] = 1;
    x.g[2 * from] = y.g[2 * from + 1] = -1;
  }
};

}  // namespace

Eigen::Matrix<double, 2, 3> Grip::Held::places(const Eigen::VectorXd& u) const {
  Eigen::Matrix<double, 2, 3> moved = Eigen::Matrix<double, 2, 3>::Zero();
  for (int v = 0; v < 3; ++v) {
    if (node[static_cast<size_t>(v)] >= 0) moved.col(v) = u.segment<2>(2 * node[static_cast<size_t>(v)]);
  }
  return moved;
}

std::vector<int> Grip::Held::moving() const {
  std::vector<int> nodes;
  std::ranges::copy_if(node, std::back_inserter(nodes), [](int one) { return one >= 0; });
  return nodes;
}

Grip::Grip(const Mesh& mesh, const Contact& contact, const Point& held, double stiffness) : stiffness_(stiffness) {
  add_touching(mesh, contact, held);
}

void Grip::add_touching(const Mesh& mesh, const Contact& contact, const Point& held) {
  const ContactSettings& settings = contact.settings();
  std::vector<double> length(static_cast<size_t>(mesh.node_count()), 0.0);
  std::vector<double> pressure(length.size(), std::numeric_limits<double>::infinity());
  for (size_t e = 0; e < settings.edges.size(); ++e) {
    const auto& [a, b] = settings.edges[e];
    for (const int v : {a, b}) {
      length[static_cast<size_t>(v)] += 0.25 * (mesh.node(a) - mesh.node(b)).norm();
      pressure[static_cast<size_t>(v)] = std::min(pressure[static_cast<size_t>(v)], held.p[settings.stiffness[e]]);
    }
  }
  gap_ = held.p[settings.gap];
  const double thickness = settings.thickness >= 0 ? held.p[settings.thickness] : 1;
  const bool pair_sum = settings.form == ContactForm::pair_sum || settings.form == ContactForm::pair_sum_dedup;
  for (const ContactPair& touch : contact.active_pairs(held)) {
    if (touch.node >= mesh.node_count()) continue;  // a point of an obstacle
    const auto i = static_cast<size_t>(touch.node);
    const Edge edge = edge_of(mesh, settings, touch.edge);
    const bool is_held = std::ranges::any_of(
        pairs_, [&](const Held& other) { return other.node[0] == touch.node && other.edge == touch.edge; });
    if (is_held) continue;
    Held pair{{touch.node, edge.node[0], edge.node[1]}, touch.edge, {}};
    pair.X << mesh.node(touch.node), edge.X;
    const Eigen::Matrix<double, 2, 3> x = pair.X + pair.places(held.u);
    const Eigen::Vector2d r = x.col(0) - x.col(1), e = x.col(2) - x.col(1);
    pair.parameter = r.dot(e) / e.squaredNorm();
    const double height = (e[0] * r[1] - e[1] * r[0]) / e.norm();
    const double beyond = std::max({-pair.parameter, pair.parameter - 1, 0.0}) * e.norm();
    if (edge.has_ends && beyond > std::abs(height)) continue;  // it faces the next edge
    pair.side = height < 0 ? -1 : 1;
    const double kappa = edge.pressure < 0 ? pressure[i] : std::min(pressure[i], held.p[edge.pressure]);
    pair.stiffness = stiffness_ * kappa * (pair_sum ? 1 : length[i] * thickness / gap_);
    pairs_.push_back(pair);
  }
}

Cliques Grip::cliques() const {
  Cliques list;
  for (const Held& pair : pairs_) list.add(pair.moving());
  return list;
}

void Grip::assemble(const Point& at, Assembly& out) const {
  for (size_t k = 0; k < pairs_.size(); ++k) {
    const Held& pair = pairs_[k];
    const Eigen::Matrix<double, 2, 3> u = pair.places(at.u);
    const Difference r(pair.X, u, 1, 0), e(pair.X, u, 1, 2);
    const Jet<6> length = sqrt(e.x * e.x + e.y * e.y);
    const Jet<6> slip = (r.x * e.x + r.y * e.y) / length - pair.parameter * length;
    const Jet<6> energy = 0.5 * pair.stiffness * (slip * slip);
    out.add_energy(energy.v);
    if (out.gradient == nullptr && !out.wants_hessian()) continue;
    const std::vector<int> nodes = pair.moving();
    const int count = static_cast<int>(nodes.size());
    std::vector<int> entry;  // of the six coordinates, those that move
    for (int v = 0; v < 3; ++v) {
      if (pair.node[static_cast<size_t>(v)] >= 0) entry.insert(entry.end(), {2 * v, 2 * v + 1});
    }
    const Eigen::VectorXd gradient = energy.g(entry);
    if (out.gradient != nullptr) out.add_gradient(nodes.data(), count, 2, gradient.data());
    if (!out.wants_hessian()) continue;
    Eigen::MatrixXd hessian = energy.H(entry, entry);
    if (out.curvature == Curvature::projected) hessian = positive_part(hessian);
    out.add_hessian(static_cast<int>(k), nodes.data(), count, 2, hessian.data());
  }
}

void Grip::drop_open(const Eigen::VectorXd& u) {
  std::erase_if(pairs_, [&](const Held& pair) {
    const Eigen::Matrix<double, 2, 3> x = pair.X + pair.places(u);
    const Eigen::Vector2d r = x.col(0) - x.col(1), e = x.col(2) - x.col(1);
    return pair.side * (e[0] * r[1] - e[1] * r[0]) >= gap_ * e.norm();
  });
}

}  // namespace taut

#include "reports/surface.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

namespace taut::plot {
namespace {

constexpr double kReach = 0.25;   // of obstacles and grounds that are shown, relative to the diagonal
constexpr double kEdgeOn = 0.01;  // cosine of the angle to the viewer below which a triangle is not seen

/// Two directions along a plane in space.
std::pair<Eigen::Vector3d, Eigen::Vector3d> along_plane(const Eigen::Vector3d& normal) {
  const Eigen::Vector3d other =
      std::abs(normal.x()) < 0.9 * normal.norm() ? Eigen::Vector3d::UnitX().eval() : Eigen::Vector3d::UnitY().eval();
  const Eigen::Vector3d first = (other - normal * (normal.dot(other) / normal.squaredNorm())).normalized();
  return {first, normal.normalized().cross(first)};
}

}  // namespace

Eigen::MatrixXd positions(const Surface& surface, const Mesh& mesh, const Eigen::VectorXd& u) {
  const Eigen::VectorXd x = mesh.X + u;
  return x.reshaped(mesh.dimension(), mesh.node_count())(Eigen::all, surface.nodes);
}

Eigen::MatrixXd positions(const DrawnLine& line, const Mesh& mesh, const Eigen::VectorXd& u) {
  const int d = mesh.dimension();
  Eigen::MatrixXd x = Eigen::MatrixXd::Zero(d, static_cast<Eigen::Index>(line.points.size()));
  Eigen::Index i = 0;
  for (const CablePoint& point : line.points) {
    auto at = x.col(i++);
    if (point.material.nodes.empty()) at = point.fixed;
    for (size_t k = 0; k < point.material.nodes.size(); ++k) {
      const Eigen::Index dof = static_cast<Eigen::Index>(point.material.nodes[k]) * d;
      at += point.material.weights[k] * (mesh.X.segment(dof, d) + u.segment(dof, d));
    }
  }
  return x;
}

void Bounds::include(const Eigen::VectorXd& point) {
  if (lower.size() == 0) lower = upper = point;
  lower = lower.cwiseMin(point);
  upper = upper.cwiseMax(point);
}

Bounds bounds_of(const SimulationRecord& record) {
  const int d = record.mesh.dimension();
  Bounds bounds;
  for (const Eigen::VectorXd& u : record.states) {
    for (int i = 0; i < record.mesh.node_count(); ++i) bounds.include(record.mesh.node(i) + u.segment(i * d, d));
    for (const DrawnLine& line : record.lines) {
      const Eigen::MatrixXd x = positions(line, record.mesh, u);
      for (const auto& point : x.colwise()) bounds.include(point);
    }
  }
  const Bounds bodies = bounds;
  const double reach = kReach * bodies.diagonal();
  const Eigen::VectorXd low = bodies.lower.array() - reach, high = bodies.upper.array() + reach;
  for (const std::vector<Eigen::VectorXd>& obstacle : record.obstacles) {
    for (size_t i = 0; i + 1 < obstacle.size(); ++i) {
      const auto near = clipped(obstacle[i], obstacle[i + 1], low, high);
      if (!near) continue;
      bounds.include(near->first);
      bounds.include(near->second);
    }
  }
  const auto include_near = [&](const Eigen::VectorXd& from, const Eigen::VectorXd& to) {
    if ((from.array() > high.array()).any() || (to.array() < low.array()).any()) return;
    bounds.include(from.cwiseMax(low));
    bounds.include(to.cwiseMin(high));
  };
  for (const DrawnGround& ground : record.grounds) {
    const Eigen::VectorXd n = ground.normal.normalized();
    for (size_t frame = 0; frame < std::max<size_t>(1, ground.moved.size()); ++frame) {
      const Eigen::VectorXd point = ground.at(frame);
      if (ground.kind == GroundKind::sphere) {
        include_near(point.array() - ground.radius, point.array() + ground.radius);
      } else if (ground.kind == GroundKind::cylinder) {
        const Eigen::VectorXd middle = (bodies.lower + bodies.upper) / 2, foot = point + (middle - point).dot(n) * n;
        include_near(foot.array() - ground.radius, foot.array() + ground.radius);
      } else {
        // The corner of the bodies' box that is nearest to the ground.
        const Eigen::VectorXd lowest = (n.array() > 0).select(bodies.lower, bodies.upper);
        const double height = (lowest - point).dot(n);
        if (height < reach) bounds.include(lowest - height * n);
      }
    }
  }
  return bounds;
}

namespace {

using Strokes = std::vector<std::pair<Eigen::VectorXd, Eigen::VectorXd>>;

/// A circle around `middle` through middle + radius a, towards b.
void add_circle(const Eigen::VectorXd& middle, const Eigen::VectorXd& a, const Eigen::VectorXd& b, double radius,
                Strokes& strokes) {
  constexpr int pieces = 36;
  const auto place = [&](int i) -> Eigen::VectorXd {
    const double angle = 2 * std::numbers::pi * i / pieces;
    return middle + radius * (std::cos(angle) * a + std::sin(angle) * b);
  };
  for (int i = 0; i < pieces; ++i) strokes.emplace_back(place(i), place(i + 1));
}

void add_round(const DrawnGround& ground, const Eigen::VectorXd& point, const Eigen::VectorXd& middle, double size,
               Strokes& strokes) {
  const double radius = ground.radius;
  if (point.size() == 2) {
    add_circle(point, Eigen::Vector2d::UnitX(), Eigen::Vector2d::UnitY(), radius, strokes);
    for (int i = 0; i < 24; ++i) {
      const double angle = 2 * std::numbers::pi * i / 24;
      const Eigen::Vector2d up(std::cos(angle), std::sin(angle)), along(-up[1], up[0]);
      strokes.emplace_back(point + radius * up, point + radius * up - 0.1 * radius * (up + along));
    }
    return;
  }
  const Eigen::Vector3d n = ground.normal.normalized();
  const auto [a, b] = along_plane(n);
  if (ground.kind == GroundKind::sphere) {
    for (int i = -2; i <= 2; ++i) {
      const double height = std::sin(std::numbers::pi * i / 6), across = std::cos(std::numbers::pi * i / 6);
      add_circle(point + radius * height * n, a, b, radius * across, strokes);
      const double turn = std::numbers::pi * (i + 2) / 5;
      add_circle(point, n, std::cos(turn) * a + std::sin(turn) * b, radius, strokes);
    }
    return;
  }
  const Eigen::Vector3d foot = point + (middle - point).dot(n) * n;
  const double reach = 0.5 * size;
  for (int i = -2; i <= 2; ++i) add_circle(foot + 0.5 * reach * i * n, a, b, radius, strokes);
  for (int i = 0; i < 12; ++i) {
    const double angle = std::numbers::pi * i / 6;
    const Eigen::Vector3d side = foot + radius * (std::cos(angle) * a + std::sin(angle) * b);
    strokes.emplace_back(side - reach * n, side + reach * n);
  }
}

}  // namespace

std::vector<std::pair<Eigen::VectorXd, Eigen::VectorXd>> ground_strokes(const SimulationRecord& record,
                                                                        const Bounds& bounds, size_t frame,
                                                                        GroundsDrawn which) {
  Strokes strokes;
  const double size = bounds.diagonal();
  const Eigen::VectorXd middle = (bounds.lower + bounds.upper) / 2;
  for (const DrawnGround& ground : record.grounds) {
    const Eigen::VectorXd n = ground.normal.normalized(), point = ground.at(frame);
    const bool round = ground.kind != GroundKind::plane;
    if (which != GroundsDrawn::all && round != (which == GroundsDrawn::round)) continue;
    if (round) {
      add_round(ground, point, middle, size, strokes);
      continue;
    }
    const Eigen::VectorXd foot = middle - (middle - point).dot(n) * n;
    if (record.mesh.dimension() == 2) {
      const Eigen::Vector2d along(n[1], -n[0]);
      const double reach = 1.5 * size, spacing = 0.025 * size;
      strokes.emplace_back(foot - reach * along, foot + reach * along);
      // A ground that moves along itself takes its hatching with it.
      const double shift = std::fmod(ground.at(frame).dot(along) - ground.point.dot(along), spacing);
      for (double s = -reach; s < reach; s += spacing) {
        const Eigen::VectorXd from = foot + (s + shift) * along;
        strokes.emplace_back(from, from - 0.7 * spacing * (along + n));
      }
    } else {
      const auto [a, b] = along_plane(n);
      const double reach = 0.5 * size;
      for (int i = -4; i <= 4; ++i) {
        const double s = reach * i / 4;
        strokes.emplace_back(foot + s * a - reach * b, foot + s * a + reach * b);
        strokes.emplace_back(foot + s * b - reach * a, foot + s * b + reach * a);
      }
    }
  }
  return strokes;
}

bool grounds_move(const SimulationRecord& record) {
  return std::ranges::any_of(record.grounds, [](const DrawnGround& ground) { return !ground.moved.empty(); });
}

View::View(double azimuth, double elevation)
    : right(-std::sin(azimuth), std::cos(azimuth), 0),
      up(-std::sin(elevation) * std::cos(azimuth), -std::sin(elevation) * std::sin(azimuth), std::cos(elevation)),
      toward(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth), std::sin(elevation)) {}

View isometric_view() {
  return {-std::numbers::pi / 4, std::atan(std::sqrt(0.5))};
}

std::vector<Painted> painted(const Surface& surface, const Eigen::MatrixXd& x, const View& view) {
  const Eigen::Vector3d light = (-0.4 * view.right + 0.7 * view.up + 0.6 * view.toward).normalized();
  std::vector<Painted> visible;
  std::vector<double> depth(surface.triangles.size());
  for (size_t i = 0; i < surface.triangles.size(); ++i) {
    const auto& [a, b, c] = surface.triangles[i].points;
    const Eigen::Vector3d xa = x.col(a), xb = x.col(b), xc = x.col(c);
    const Eigen::Vector3d normal = (xb - xa).cross(xc - xa).normalized();
    if (normal.dot(view.toward) <= kEdgeOn) continue;
    depth[i] = view.toward.dot(xa + xb + xc);
    visible.push_back({static_cast<int>(i), 0.75 + 0.25 * normal.dot(light)});
  }
  std::ranges::stable_sort(visible, {}, [&](const Painted& p) { return depth[static_cast<size_t>(p.triangle)]; });
  return visible;
}

std::string body_colour(const std::string& region, size_t i) {
  static const std::array<const char*, 5> others = {"#8fc1a9", "#c9a5c4", "#a8bcd8", "#d8b08c", "#b9b9a0"};
  return region == "foam" ? "#f2c84b" : region == "plastic" ? "#595f67" : others[i % others.size()];
}

bool lines_are_told_apart(size_t count) {
  return count <= 4;
}

std::string line_colour(size_t i, size_t count) {
  static const std::array<const char*, 4> own = {"#d55e00", "#0072b2", "#009e73", "#a0337e"};
  return lines_are_told_apart(count) ? own[i] : own[0];
}

}  // namespace taut::plot

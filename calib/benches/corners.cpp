#include "calib/benches/corners.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <set>

#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/mesh/topology.hpp"
#include "sim/shapes/outlines.hpp"

namespace taut {
namespace {

using Corner = std::array<double, 2>;

constexpr double same_place = 1e-9;  ///< of the largest coordinate

std::vector<std::vector<double>> own_points(const GeometrySettings& geometry, const std::string& cable) {
  std::vector<std::vector<double>> points;
  for (const Eigen::VectorXd& point : own_cable(geometry, cable)) points.emplace_back(point.begin(), point.end());
  return points;
}

/// How nodes go with the plane of box faces at `value`.
Eigen::VectorXd moves_of_plane(const Mesh& mesh, const std::vector<BoxRegion>& boxes, size_t axis, double value,
                               double near) {
  double before = -1e300, behind = 1e300;  // the next planes
  for (const BoxRegion& box : boxes) {
    for (double plane : {box.lower[axis], box.upper[axis]}) {
      if (plane < value - near) before = std::max(before, plane);
      if (plane > value + near) behind = std::min(behind, plane);
    }
  }
  Eigen::VectorXd moves = Eigen::VectorXd::Zero(mesh.X.size());
  for (Eigen::Index i = static_cast<Eigen::Index>(axis); i < moves.size(); i += mesh.dimension()) {
    const double x = mesh.X[i];
    const double part = x <= value ? (x - before) / (value - before) : (behind - x) / (behind - value);
    moves[i] = std::clamp(part, 0.0, 1.0);
  }
  return moves;
}

/// Where between `a` and `b` a point lies on their line, 0 to 1; NaN: beside it.
double place_on(const Corner& a, const Corner& b, const Corner& point, double near) {
  const Eigen::Vector2d along(b[0] - a[0], b[1] - a[1]), to(point[0] - a[0], point[1] - a[1]);
  const double length = along.norm(), at = along.dot(to) / length;
  const double off = std::abs(along[0] * to[1] - along[1] * to[0]) / length;
  return off > near || at < -near || at > length + near ? not_a_number : std::clamp(at / length, 0.0, 1.0);
}

bool at_one_place(const Corner& a, const Corner& b, double near) {
  return std::hypot(a[0] - b[0], a[1] - b[1]) <= near;
}

/// action(a, b) for all edges of all polygons.
template <class Action>
void each_edge(const std::vector<PolygonRegion>& polygons, Action&& action) {
  for (const PolygonRegion& polygon : polygons) {
    for (size_t i = 0; i < polygon.vertices.size(); ++i)
      action(polygon.vertices[i], polygon.vertices[(i + 1) % polygon.vertices.size()]);
  }
}

void refuse_corners_on_edges(const std::vector<PolygonRegion>& polygons, const Corner& moved, double near) {
  each_edge(polygons, [&](const Corner& a, const Corner& b) {
    const bool of_it = at_one_place(a, moved, near) || at_one_place(b, moved, near);
    if (!of_it && std::isfinite(place_on(a, b, moved, near)))
      throw InputError("it lies on the edge of another polygon, which would break there");
    if (!of_it) return;
    for (const PolygonRegion& polygon : polygons) {
      for (const Corner& corner : polygon.vertices) {
        if (!at_one_place(corner, a, near) && !at_one_place(corner, b, near) &&
            std::isfinite(place_on(a, b, corner, near)))
          throw InputError("a corner of another polygon lies on its edge, which would break there");
      }
    }
  });
}

/// By how much each node goes with a corner: what the outlines say, then the mean of the neighbours.
Eigen::VectorXd parts_of_corner(const Mesh& mesh, const std::vector<PolygonRegion>& polygons, const Corner& moved,
                                double near) {
  constexpr int vertices = 3;
  std::vector<std::set<int>> neighbours(static_cast<size_t>(mesh.node_count()));
  for (int e = 0; e < mesh.element_count(); ++e) {
    for (int a = 0; a < vertices; ++a) {
      for (int b = 0; b < vertices; ++b) {
        if (a != b) neighbours[static_cast<size_t>(mesh.element(e)[a])].insert(mesh.element(e)[b]);
      }
    }
  }
  Eigen::VectorXd part = Eigen::VectorXd::Zero(mesh.node_count());
  std::vector<int> inside;
  for (int node = 0; node < mesh.node_count(); ++node) {
    const Corner at{mesh.node(node)[0], mesh.node(node)[1]};
    bool on_outline = false;
    each_edge(polygons, [&](const Corner& a, const Corner& b) {
      const double place = place_on(a, b, at, near);
      if (!std::isfinite(place)) return;
      on_outline = true;
      if (at_one_place(a, moved, near)) part[node] = 1 - place;
      if (at_one_place(b, moved, near)) part[node] = place;
    });
    if (!on_outline && !neighbours[static_cast<size_t>(node)].empty()) inside.push_back(node);
  }
  // Which way the nodes inside go is of no matter to the shape, as long as elements stay sound.
  constexpr int most_sweeps = 2000;
  for (int sweep = 0; sweep < most_sweeps; ++sweep) {
    double change = 0;
    for (int node : inside) {
      double mean = 0;
      for (int other : neighbours[static_cast<size_t>(node)]) mean += part[other];
      mean /= static_cast<double>(neighbours[static_cast<size_t>(node)].size());
      change = std::max(change, std::abs(mean - part[node]));
      part[node] = mean;
    }
    if (change < 1e-5) break;
  }
  const auto edges = edges_of(mesh.shape);
  for (int e = 0; e < mesh.element_count() && order_of(mesh.shape) == 2; ++e) {
    for (size_t k = 0; k < edges.size(); ++k)
      part[mesh.element(e)[vertices + k]] =
          0.5 * (part[mesh.element(e)[edges[k][0]]] + part[mesh.element(e)[edges[k][1]]]);
  }
  return part;
}

/// Adds a corner's coordinate where somebody says something of it.
void add_if_named(const Experiment& experiment, Dimension dimension, double reach, std::vector<Dimension>& dimensions) {
  if (!experiment.tolerances.contains(dimension.place) && !is_fitted(experiment, dimension.spec.id)) return;
  dimension.spec.symbol = dimension.spec.id;
  dimension.spec.unit = "m";
  dimension.spec.lower = dimension.value - reach;
  dimension.spec.upper = dimension.value + reach;
  dimensions.push_back(std::move(dimension));
}

void add_boxes(const Experiment& experiment, size_t key, const std::vector<BoxRegion>& boxes,
               std::vector<Dimension>& dimensions) {
  double largest = 0;
  for (const BoxRegion& box : boxes) {
    for (double x : box.lower) largest = std::max(largest, std::abs(x));
    for (double x : box.upper) largest = std::max(largest, std::abs(x));
  }
  const double near = same_place * largest;
  for (size_t b = 0; b < boxes.size(); ++b) {
    for (const bool upper : {false, true}) {
      for (size_t axis = 0; axis < 3; ++axis) {
        const char* side = upper ? "upper" : "lower";
        Dimension one;
        one.value = (upper ? boxes[b].upper : boxes[b].lower)[axis];
        one.spec.id = fmt::format("box_{}_{}_{}", b + 1, side, "xyz"[axis]);
        one.spec.meaning = fmt::format("{} {} of box {}", side, "xyz"[axis], b + 1);
        one.place = fmt::format("geometry.box.{}.{}.{}", b + 1, side, axis + 1);
        one.set = [key, axis, from = one.value, near](Experiment& other, double value) {
          edit_key(other, key, [&](const ShapeKey& of) {
            for (BoxRegion& box : *std::get<std::vector<BoxRegion>*>(of.value)) {
              for (double* plane : {&box.lower[axis], &box.upper[axis]}) {
                if (std::abs(*plane - from) <= near) *plane = value;
              }
            }
          });
        };
        one.moves = [boxes, axis, from = one.value, near](const Mesh& mesh) {
          return moves_of_plane(mesh, boxes, axis, from, near);
        };
        add_if_named(experiment, std::move(one), largest, dimensions);
      }
    }
  }
}

void add_polygons(const Experiment& experiment, size_t key, const std::vector<PolygonRegion>& polygons,
                  std::vector<Dimension>& dimensions) {
  double largest = 0;
  each_edge(polygons, [&](const Corner& a, const Corner&) {
    largest = std::max({largest, std::abs(a[0]), std::abs(a[1])});
  });
  const double near = same_place * largest;
  for (size_t k = 0; k < polygons.size(); ++k) {
    for (size_t i = 0; i < polygons[k].vertices.size(); ++i) {
      for (size_t axis = 0; axis < 2; ++axis) {
        const Corner corner = polygons[k].vertices[i];
        Dimension one;
        one.value = corner[axis];
        one.spec.id = fmt::format("polygon_{}_{}_{}", k + 1, "xy"[axis], i + 1);
        one.spec.meaning = fmt::format("{} of corner {} of polygon {}", "xy"[axis], i + 1, k + 1);
        one.place = fmt::format("geometry.polygon.{}.{}.{}", k + 1, "xy"[axis], i + 1);
        one.set = [key, axis, corner, near](Experiment& other, double value) {
          edit_key(other, key, [&](const ShapeKey& of) {
            for (PolygonRegion& polygon : *std::get<std::vector<PolygonRegion>*>(of.value)) {
              for (Corner& at : polygon.vertices) {
                if (at_one_place(at, corner, near)) at[axis] = value;
              }
            }
          });
        };
        one.moves = [polygons, axis, corner, near](const Mesh& mesh) {
          if (mesh.dimension() != 2) throw InputError("a corner of a section that is swept to a solid does not move");
          refuse_corners_on_edges(polygons, corner, near);
          const Eigen::VectorXd part = parts_of_corner(mesh, polygons, corner, near);
          Eigen::VectorXd moves = Eigen::VectorXd::Zero(mesh.X.size());
          for (int node = 0; node < mesh.node_count(); ++node) moves[2 * node + static_cast<int>(axis)] = part[node];
          return moves;
        };
        add_if_named(experiment, std::move(one), largest, dimensions);
      }
    }
  }
}

}  // namespace

bool is_fitted(const Experiment& experiment, const std::string& id) {
  return std::ranges::find(experiment.free, id, &FreeSettings::id) != experiment.free.end();
}

void edit_key(Experiment& experiment, size_t key, const std::function<void(const ShapeKey& key)>& change) {
  const GeometrySettings before = experiment.geometry;
  std::shared_ptr<Shape> shape = before.shape->clone();
  const std::vector<ShapeKey> keys = shape->keys();
  change(keys[key]);
  experiment.geometry.shape = shape;
  const std::vector<std::string> names = shape->cable_names();
  for (CableSettings& cable : experiment.cables.cables) {
    if (std::ranges::find(names, cable.id) != names.end() && cable.points == own_points(before, cable.id))
      cable.points = own_points(experiment.geometry, cable.id);
  }
}

void add_corners(const Experiment& experiment, std::vector<Dimension>& dimensions) {
  const std::unique_ptr<Shape> shape = experiment.geometry.shape->clone();
  const std::vector<ShapeKey> keys = shape->keys();
  for (size_t k = 0; k < keys.size(); ++k) {
    if (const auto* boxes = std::get_if<std::vector<BoxRegion>*>(&keys[k].value))
      add_boxes(experiment, k, **boxes, dimensions);
    if (const auto* polygons = std::get_if<std::vector<PolygonRegion>*>(&keys[k].value))
      add_polygons(experiment, k, **polygons, dimensions);
  }
}

}  // namespace taut

#include <fmt/format.h>

#include <cmath>
#include <limits>

#include "sim/core/dense.hpp"
#include "sim/core/error.hpp"
#include "sim/mesh/mesh.hpp"
#include "sim/mesh/shape_functions.hpp"
#include "sim/mesh/topology.hpp"

namespace taut {
namespace {

template <ElementShape S>
struct ElementGeometry {
  using Reference = ReferenceElement<S>;
  static constexpr int D = Reference::D;
  static constexpr int N = Reference::N;
  using Point = Eigen::Matrix<double, D, 1>;
  Eigen::Matrix<double, D, N> X;

  /// Lower bound of the distance to `point`: the element lies in the convex hull of its Bezier control points.
  double distance_to_box(const Point& point) const {
    Eigen::Matrix<double, D, N> control = X;
    for (int k = D + 1; k < N; ++k) {
      const auto [a, b] = Reference::edges[k - D - 1];
      control.col(k) = 2.0 * X.col(k) - 0.5 * (X.col(a) + X.col(b));
    }
    const Point below = control.rowwise().minCoeff() - point;
    const Point above = point - control.rowwise().maxCoeff();
    return below.cwiseMax(above).cwiseMax(0.0).norm();
  }

  struct Closest {
    Point xi = Point::Zero();
    double distance = std::numeric_limits<double>::infinity();
  };

  /// The point nearest to `point` on the sub-simplex whose vertices are the set bits of `mask`, by Gauss-Newton from
  /// its centroid (one step on straight-sided elements). Infinite distance when that point is outside the sub-simplex.
  Closest closest_on(unsigned mask, const Point& point) const {
    std::vector<int> vertices;
    for (int a = 0; a <= D; ++a) {
      if ((mask >> a & 1u) != 0) vertices.push_back(a);
    }
    const auto corner = Reference::node;
    const int m = static_cast<int>(vertices.size()) - 1;
    using Free = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, D, 1>;
    Eigen::Matrix<double, D, Eigen::Dynamic, 0, D, D> directions(D, m);
    for (int i = 0; i < m; ++i) directions.col(i) = corner(vertices[i + 1]) - corner(vertices[0]);

    Free free = Free::Constant(m, 1.0 / (m + 1));
    Point xi = corner(vertices[0]) + directions * free;
    constexpr int most_steps = 40;
    for (int step = 0; m > 0; ++step) {
      if (step == most_steps || !free.allFinite()) return {};
      const Eigen::Matrix<double, D, Eigen::Dynamic, 0, D, D> J = X * Reference::gradients(xi).transpose() * directions;
      const Free change = least_squares(J, point - X * Reference::values(xi));
      free += change;
      xi = corner(vertices[0]) + directions * free;
      if (change.cwiseAbs().maxCoeff() < 1e-13) break;
    }
    // Round-off only: the tolerance for points outside the mesh is the caller's.
    constexpr double slack = 1e-12;
    if (m > 0 && (free.minCoeff() < -slack || free.sum() > 1.0 + slack)) return {};
    for (int i = 0; i < m; ++i) free[i] = std::abs(free[i]) < slack ? 0.0 : free[i];
    if (m > 0 && std::abs(1.0 - free.sum()) < slack) free /= free.sum();
    xi = corner(vertices[0]) + directions * free;
    return {xi, (X * Reference::values(xi) - point).norm()};
  }

  Closest closest(const Point& point) const {
    constexpr unsigned whole = (1u << (D + 1)) - 1u;
    Closest best = closest_on(whole, point);
    if (std::isfinite(best.distance)) return best;
    for (unsigned mask = 1; mask < whole; ++mask) {
      const Closest candidate = closest_on(mask, point);
      if (candidate.distance < best.distance) best = candidate;
    }
    return best;
  }
};

template <ElementShape S>
MaterialPoint locate_in(const Mesh& mesh, const Eigen::VectorXd& query, const Part& part) {
  using Geometry = ElementGeometry<S>;
  const typename Geometry::Point point = query;
  const auto positions = mesh.X.segment(part.first_node * Geometry::D, part.node_count * Geometry::D)
                             .reshaped(Geometry::D, part.node_count);
  Eigen::Index nearest = 0;
  // The nearest node bounds the distance to the mesh, which spares almost all elements the closer look.
  double bound = std::sqrt((positions.colwise() - query).colwise().squaredNorm().minCoeff(&nearest));
  const double round_off = 1e-12 * mesh.diagonal();

  typename Geometry::Closest best;
  int element = -1;
  for (int e = part.first_element; e < part.first_element + part.element_count; ++e) {
    const Geometry geometry{Geometry::Reference::positions(mesh, e)};
    if (geometry.distance_to_box(point) > bound + round_off) continue;
    const auto candidate = geometry.closest(point);
    if (candidate.distance >= best.distance) continue;
    best = candidate;
    element = e;
    bound = std::min(bound, best.distance);
    if (best.distance <= round_off) break;
  }
  if (element < 0 || !(best.distance <= 1e-6 * mesh.diagonal())) {
    const int node = part.first_node + static_cast<int>(nearest);
    throw InputError(fmt::format(
        "point {} lies {:.4g} mm outside {}; the nearest node is {} at {}", in_millimetres(query), 1e3 * best.distance,
        part.name.empty() ? "the mesh" : "'" + part.name + "'", node, in_millimetres(mesh.node(node))));
  }
  MaterialPoint result;
  const auto weights = ReferenceElement<S>::values(best.xi);
  for (int a = 0; a < Geometry::N; ++a) {
    if (std::abs(weights[a]) < 1e-14) continue;
    result.nodes.push_back(mesh.element(element)[a]);
    result.weights.push_back(weights[a]);
  }
  return result;
}

}  // namespace

MaterialPoint locate(const Mesh& mesh, const Eigen::VectorXd& point) {
  return locate(mesh, point, {"", 0, mesh.node_count(), 0, mesh.element_count()});
}

MaterialPoint locate(const Mesh& mesh, const Eigen::VectorXd& point, const Part& part) {
  if (point.size() != mesh.dimension() || !point.allFinite()) {
    throw InputError(fmt::format("point {} does not fit a {}D mesh; give {} finite coordinates", in_millimetres(point),
                                 mesh.dimension(), mesh.dimension()));
  }
  if (mesh.element_count() == 0) throw InputError("a point cannot be located in a mesh without elements");
  return with_shape(mesh.shape, [&](auto shape) { return locate_in<shape>(mesh, point, part); });
}

bool lies_in(const Part& part, const Mesh& mesh, const Eigen::VectorXd& point) {
  try {
    locate(mesh, point, part);
    return true;
  } catch (const InputError&) {
    return false;
  }
}

}  // namespace taut

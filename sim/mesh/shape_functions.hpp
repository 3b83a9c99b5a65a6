#pragma once
#include <Eigen/Core>
#include <array>
#include <type_traits>

#include "sim/mesh/mesh.hpp"

namespace taut {

/// A quadrature point of the reference simplex: natural coordinates and weight (weights sum to 1/2 or 1/6).
template <int D>
struct QuadraturePoint {
  Eigen::Matrix<double, D, 1> xi;
  double weight;
};

/// Lagrange simplices in the node order of mesh.hpp. Vertex 0 is at the origin of the natural coordinates, vertex i at
/// 1 on axis i - 1; L = (1 - sum xi, xi...) are the barycentric coordinates.
template <ElementShape S>
struct ReferenceElement {
  static constexpr int D = dimension_of(S);
  static constexpr int N = nodes_of(S);
  using Xi = Eigen::Matrix<double, D, 1>;  ///< natural coordinates
  static constexpr std::array<std::array<int, 2>, 6> edges{{{0, 1}, {1, 2}, {0, 2}, {0, 3}, {1, 3}, {2, 3}}};

  /// L, see above.
  static std::array<double, D + 1> barycentric(const Xi& xi) {
    std::array<double, D + 1> L;
    L[0] = 1.0 - xi.sum();
    for (int i = 0; i < D; ++i) L[i + 1] = xi[i];
    return L;
  }

  /// N_a at xi; their sum is 1.
  static Eigen::Matrix<double, N, 1> values(const Xi& xi) {
    const auto L = barycentric(xi);
    Eigen::Matrix<double, N, 1> n;
    for (int a = 0; a <= D; ++a) n[a] = order_of(S) == 1 ? L[a] : L[a] * (2.0 * L[a] - 1.0);
    for (int e = D + 1; e < N; ++e) n[e] = 4.0 * L[edges[e - D - 1][0]] * L[edges[e - D - 1][1]];
    return n;
  }

  /// Derivatives with respect to the natural coordinates, one column per node.
  static Eigen::Matrix<double, D, N> gradients(const Xi& xi) {
    const auto L = barycentric(xi);
    auto dL = [](int a) {
      Xi g = Xi::Zero();
      if (a == 0)
        g.setConstant(-1.0);
      else
        g[a - 1] = 1.0;
      return g;
    };
    Eigen::Matrix<double, D, N> g;
    for (int a = 0; a <= D; ++a) g.col(a) = (order_of(S) == 1 ? 1.0 : 4.0 * L[a] - 1.0) * dL(a);
    for (int e = D + 1; e < N; ++e) {
      const auto [i, j] = edges[e - D - 1];
      g.col(e) = 4.0 * (L[i] * dL(j) + L[j] * dL(i));
    }
    return g;
  }

  /// Natural coordinates of a node.
  static Xi node(int a) {
    Xi xi = Xi::Zero();
    if (a > D) return 0.5 * (node(edges[a - D - 1][0]) + node(edges[a - D - 1][1]));
    if (a > 0) xi[a - 1] = 1.0;
    return xi;
  }

  /// Rest positions of an element's nodes [m], one column each.
  static Eigen::Matrix<double, D, N> positions(const Mesh& mesh, int element) {
    Eigen::Matrix<double, D, N> X;
    for (int a = 0; a < N; ++a) X.col(a) = mesh.X.segment<D>(mesh.element(element)[a] * D);
    return X;
  }

  /// The rule that integrates the stiffness of the straight-sided element exactly: one point for linear, degree 2 (3
  /// points in 2D, 4 in 3D) for quadratic elements.
  static auto quadrature() {
    using Q = QuadraturePoint<D>;
    constexpr double measure = D == 2 ? 0.5 : 1.0 / 6.0;
    if constexpr (order_of(S) == 1) {
      return std::array<Q, 1>{Q{Xi::Constant(1.0 / (D + 1)), measure}};
    } else {
      // Points on the lines from the centroid to the vertices; in 2D at 1/6, 1/6, in 3D at (5 - sqrt 5)/20.
      constexpr double near = D == 2 ? 1.0 / 6.0 : 0.1381966011250105;
      std::array<Q, D + 1> points;
      for (int a = 0; a <= D; ++a) {
        points[a] = {Xi::Constant(near), measure / (D + 1)};
        if (a > 0) points[a].xi[a - 1] = 1.0 - D * near;
      }
      return points;
    }
  }
};

/// Calls `action` with the shape as a constant.
template <class Action>
auto with_shape(ElementShape shape, Action&& action) {
  switch (shape) {
    case ElementShape::tri3:
      return action(std::integral_constant<ElementShape, ElementShape::tri3>{});
    case ElementShape::tri6:
      return action(std::integral_constant<ElementShape, ElementShape::tri6>{});
    case ElementShape::tet4:
      return action(std::integral_constant<ElementShape, ElementShape::tet4>{});
    default:
      return action(std::integral_constant<ElementShape, ElementShape::tet10>{});
  }
}

}  // namespace taut

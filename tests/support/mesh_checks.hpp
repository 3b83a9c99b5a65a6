#pragma once
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <map>
#include <string>
#include <vector>

#include "sim/mesh/mesh.hpp"

namespace taut::test {

inline Eigen::VectorXd vec(std::initializer_list<double> values) {
  Eigen::VectorXd v(static_cast<Eigen::Index>(values.size()));
  std::copy(values.begin(), values.end(), v.data());
  return v;
}

/// Area or volume of one straight-sided element, signed.
inline double measure(const Mesh& mesh, int e) {
  const int d = mesh.dimension();
  Eigen::MatrixXd edges(d, d);
  for (int i = 0; i < d; ++i) edges.col(i) = mesh.node(mesh.element(e)[i + 1]) - mesh.node(mesh.element(e)[0]);
  return edges.determinant() / (d == 2 ? 2.0 : 6.0);
}

inline double total_measure(const Mesh& mesh, const std::string& region = "") {
  double sum = 0.0;
  for (int e = 0; e < mesh.element_count(); ++e) {
    EXPECT_GT(measure(mesh, e), 0.0) << "element " << e;
    if (region.empty() || mesh.region[e] == mesh.region_index(region)) sum += measure(mesh, e);
  }
  return sum;
}

/// Normal of a facet with the length of its size, by the orientation of its nodes.
inline Eigen::VectorXd facet_normal(const Mesh& mesh, const int* nodes) {
  if (mesh.dimension() == 2) {
    const Eigen::Vector2d t = mesh.node(nodes[1]) - mesh.node(nodes[0]);
    return vec({t[1], -t[0]});
  }
  const auto node = [&](int i) { return mesh.X.segment<3>(3 * nodes[i]); };
  return 0.5 * (node(1) - node(0)).cross(node(2) - node(0));
}

inline double size_of(const Mesh& mesh, const Tag& facets) {
  double sum = 0.0;
  for (int i = 0; i < facets.count(); ++i) {
    sum += facet_normal(mesh, &facets.entities[i * facets.nodes_per_entity]).norm();
  }
  return sum;
}

/// 1/d times the flux of the position through the facets: the enclosed measure if they are closed and outward.
inline double enclosed_measure(const Mesh& mesh, const Tag& facets) {
  double flux = 0.0;
  const int d = mesh.dimension();
  for (int i = 0; i < facets.count(); ++i) {
    const int* nodes = &facets.entities[i * facets.nodes_per_entity];
    Eigen::VectorXd centroid = Eigen::VectorXd::Zero(d);
    for (int a = 0; a < d; ++a) centroid += mesh.node(nodes[a]) / d;
    flux += centroid.dot(facet_normal(mesh, nodes));
  }
  return flux / d;
}

/// Number of owners of each facet, by sorted vertices.
inline std::map<std::vector<int>, int> facet_owners(const Mesh& mesh) {
  std::map<std::vector<int>, int> owners;
  const int d = mesh.dimension();
  for (int e = 0; e < mesh.element_count(); ++e) {
    for (int left_out = 0; left_out <= d; ++left_out) {
      std::vector<int> facet;
      for (int a = 0; a <= d; ++a) {
        if (a != left_out) facet.push_back(mesh.element(e)[a]);
      }
      std::sort(facet.begin(), facet.end());
      ++owners[facet];
    }
  }
  return owners;
}

/// Every facet has one or two owners, and those with one enclose exactly the mesh: no gaps, no hanging nodes.
inline void expect_conforming(const Mesh& mesh, double outer_size) {
  int single = 0;
  for (const auto& [facet, count] : facet_owners(mesh)) {
    EXPECT_LE(count, 2);
    single += count == 1 ? 1 : 0;
  }
  const Tag facets = boundary(mesh);
  EXPECT_EQ(facets.count(), single);
  EXPECT_NEAR(size_of(mesh, facets), outer_size, 1e-11 * outer_size);
  EXPECT_NEAR(enclosed_measure(mesh, facets), total_measure(mesh), 1e-11 * total_measure(mesh));
}

inline void expect_mid_nodes_halfway(const Mesh& mesh, double tolerance = 0.0) {
  const std::vector<std::array<int, 2>> edges =
      mesh.dimension() == 2 ? std::vector<std::array<int, 2>>{{0, 1}, {1, 2}, {2, 0}}
                            : std::vector<std::array<int, 2>>{{0, 1}, {1, 2}, {0, 2}, {0, 3}, {1, 3}, {2, 3}};
  const int vertices = mesh.dimension() + 1;
  for (int e = 0; e < mesh.element_count(); ++e) {
    const int* nodes = mesh.element(e);
    for (size_t k = 0; k < edges.size(); ++k) {
      const Eigen::VectorXd middle = 0.5 * (mesh.node(nodes[edges[k][0]]) + mesh.node(nodes[edges[k][1]]));
      EXPECT_LE((mesh.node(nodes[vertices + static_cast<int>(k)]) - middle).norm(), tolerance);
    }
  }
}

}  // namespace taut::test

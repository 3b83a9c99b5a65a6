#include "sim/mesh/topology.hpp"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <map>

#include "sim/core/error.hpp"
#include "sim/mesh/shape_functions.hpp"

namespace taut {
namespace {

// Facets in the order (vertices, mid-nodes); linear meshes use the vertices of each.
constexpr std::array<int, 6> tri3_facets{0, 1, 1, 2, 2, 0};
constexpr std::array<int, 9> tri6_facets{0, 1, 3, 1, 2, 4, 2, 0, 5};
constexpr std::array<int, 12> tet4_facets{0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3};
constexpr std::array<int, 24> tet10_facets{0, 2, 1, 6, 5, 4, 0, 1, 3, 4, 8, 7, 0, 3, 2, 7, 9, 6, 1, 2, 3, 5, 9, 8};

}  // namespace

std::span<const std::array<int, 2>> edges_of(ElementShape shape) {
  // The first three edges of the tetrahedron are those of the triangle.
  const std::span<const std::array<int, 2>> edges(ReferenceElement<ElementShape::tet10>::edges);
  return edges.first(dimension_of(shape) == 2 ? 3 : 6);
}

ReferenceFacets facets_of(ElementShape shape) {
  if (dimension_of(shape) == 2)
    return order_of(shape) == 1 ? ReferenceFacets{3, 2, tri3_facets} : ReferenceFacets{3, 3, tri6_facets};
  return order_of(shape) == 1 ? ReferenceFacets{4, 3, tet4_facets} : ReferenceFacets{4, 6, tet10_facets};
}

int nodes_per_entity(int dimension, int order) {
  return dimension == 0 ? 1 : dimension == 1 ? order + 1 : order == 1 ? 3 : 6;
}

double vertex_determinant(const Mesh& mesh, int element) {
  const int d = mesh.dimension();
  const int* nodes = mesh.element(element);
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, 3, 3> edges(d, d);
  for (int i = 0; i < d; ++i) edges.col(i) = mesh.X.segment(nodes[i + 1] * d, d) - mesh.X.segment(nodes[0] * d, d);
  return edges.determinant();
}

void flip_element(ElementShape shape, int* nodes) {
  std::swap(nodes[1], nodes[2]);
  if (shape == ElementShape::tri6) std::swap(nodes[3], nodes[5]);
  if (shape == ElementShape::tet10) {
    std::swap(nodes[4], nodes[6]);
    std::swap(nodes[8], nodes[9]);
  }
}

void orient_tags(Mesh& mesh, std::string_view where) {
  const ReferenceFacets facets = facets_of(mesh.shape);
  const int d = mesh.dimension();
  const auto sorted_vertices = [d](const int* nodes) {
    std::array<int, 3> key{-1, -1, -1};
    std::copy_n(nodes, d, key.begin());
    std::sort(key.begin(), key.end());
    return key;
  };
  // Only the tagged facets are looked up, so only they are stored: tagged surface is far smaller than the mesh.
  std::map<std::array<int, 3>, std::vector<int>> oriented;
  for (const auto& [name, tag] : mesh.tags) {
    if (tag.dimension != d - 1) continue;
    for (int i = 0; i < tag.count(); ++i) oriented[sorted_vertices(tag.entity(i))];
  }
  std::vector<int> facet(facets.nodes_per_facet);
  for (int e = 0; e < mesh.element_count(); ++e) {
    for (int f = 0; f < facets.count; ++f) {
      for (int i = 0; i < facets.nodes_per_facet; ++i) {
        facet[i] = mesh.element(e)[facets.nodes[f * facets.nodes_per_facet + i]];
      }
      const auto found = oriented.find(sorted_vertices(facet.data()));
      if (found != oriented.end() && found->second.empty()) found->second = facet;
    }
  }
  for (auto& [name, tag] : mesh.tags) {
    if (tag.dimension != d - 1) continue;
    for (int i = 0; i < tag.count(); ++i) {
      int* nodes = &tag.entities[i * tag.nodes_per_entity];
      const std::vector<int>& replacement = oriented[sorted_vertices(nodes)];
      if (!std::is_permutation(replacement.begin(), replacement.end(), nodes, nodes + tag.nodes_per_entity)) {
        throw InputError(
            fmt::format("{}: tag '{}' has a {} with its first vertex at {} that is no side of any element; tag only "
                        "parts of the mesh",
                        where, name, d == 2 ? "segment" : "triangle", in_millimetres(mesh.node(nodes[0]))));
      }
      std::copy(replacement.begin(), replacement.end(), nodes);
    }
  }
}

void tag_sides(Mesh& mesh, const std::function<bool(int node, int axis, bool upper)>& on_side) {
  const Tag facets = boundary(mesh);
  for (int axis = 0; axis < mesh.dimension(); ++axis) {
    for (bool upper : {false, true}) {
      mesh.tags[std::string(1, "xyz"[axis]) + (upper ? "max" : "min")] =
          facets.where([&](int node) { return on_side(node, axis, upper); });
    }
  }
}

void straighten(Mesh& mesh) {
  if (order_of(mesh.shape) == 1) return;
  const int d = mesh.dimension();
  const auto edges = edges_of(mesh.shape);
  for (int e = 0; e < mesh.element_count(); ++e) {
    const int* nodes = mesh.element(e);
    for (size_t k = 0; k < edges.size(); ++k) {
      const auto [a, b] = edges[k];
      mesh.X.segment(nodes[d + 1 + static_cast<int>(k)] * d, d) =
          0.5 * (mesh.X.segment(nodes[a] * d, d) + mesh.X.segment(nodes[b] * d, d));
    }
  }
}

std::string in_millimetres(const Eigen::VectorXd& position) {
  std::string text = "(";
  for (Eigen::Index i = 0; i < position.size(); ++i)
    text += fmt::format("{}{:.6g}", i > 0 ? ", " : "", 1e3 * position[i]);
  return text + ") mm";
}

}  // namespace taut

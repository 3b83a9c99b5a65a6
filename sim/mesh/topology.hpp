#pragma once
#include <array>
#include <functional>
#include <span>
#include <string>

#include "sim/mesh/mesh.hpp"

namespace taut {

/// End vertices of the reference simplex's edges, in the order of the mid-nodes that follow the vertices.
std::span<const std::array<int, 2>> edges_of(ElementShape shape);

/// Local nodes of the reference simplex's facets, vertices first, outward oriented: facet i is
/// nodes[i * nodes_per_facet] onwards.
struct ReferenceFacets {
  int count;
  int nodes_per_facet;
  std::span<const int> nodes;
};
ReferenceFacets facets_of(ElementShape shape);  ///< see ReferenceFacets

/// Nodes of a segment (dimension 1) or triangle (2) of the given order; 1 for a point.
int nodes_per_entity(int dimension, int order);

/// Determinant of the vertices' edge vectors: twice the area or six times the volume [m^2 or m^3], signed.
double vertex_determinant(const Mesh& mesh, int element);

/// Reverses the orientation of one element in place.
void flip_element(ElementShape shape, int* nodes);

/// Orients every tagged facet outward of the first element that owns it. Throws InputError naming the tag when a
/// tagged facet is no facet of any element; `where` starts the message.
void orient_tags(Mesh& mesh, std::string_view where);

/// Tags the sides xmin, xmax, ... of a mesh: the facets all of whose nodes are on_side(node, axis, upper).
void tag_sides(Mesh& mesh, const std::function<bool(int node, int axis, bool upper)>& on_side);

/// Moves the mid-nodes of quadratic elements to the middle of their edges.
void straighten(Mesh& mesh);

/// "(1.5, 2) mm" for messages; positions are in metres.
std::string in_millimetres(const Eigen::VectorXd& position);

}  // namespace taut

#pragma once
#include <Eigen/Core>
#include <array>
#include <functional>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace taut {

/// Simplices only; nodes are numbered vertices first, then edge mid-nodes.
/// tri6: 3 = mid(0,1), 4 = mid(1,2), 5 = mid(2,0).
/// tet10: 4 = mid(0,1), 5 = mid(1,2), 6 = mid(0,2), 7 = mid(0,3), 8 = mid(1,3), 9 = mid(2,3).
enum class ElementShape { tri3, tri6, tet4, tet10 };

/// Of space: 2 or 3.
constexpr int dimension_of(ElementShape s) {
  return s == ElementShape::tri3 || s == ElementShape::tri6 ? 2 : 3;
}
/// Of the polynomials: 1 or 2.
constexpr int order_of(ElementShape s) {
  return s == ElementShape::tri3 || s == ElementShape::tet4 ? 1 : 2;
}
/// Nodes of an element.
constexpr int nodes_of(ElementShape s) {
  return s == ElementShape::tri3 ? 3 : s == ElementShape::tri6 ? 6 : s == ElementShape::tet4 ? 4 : 10;
}
std::string_view name_of(ElementShape s);  ///< "tet10"

/// A named part of the mesh: points (dimension 0), line segments (1) or triangles (2), each of the mesh's own order
/// (a quadratic mesh has 3-node segments and 6-node triangles, vertices first).
struct Tag {
  int dimension = 0;
  int nodes_per_entity = 1;
  std::vector<int> entities;  ///< node numbers, nodes_per_entity per entity
  int count() const { return static_cast<int>(entities.size()) / nodes_per_entity; }  ///< number of entities
  /// Nodes of entity i.
  const int* entity(int i) const { return entities.data() + static_cast<size_t>(i) * nodes_per_entity; }
  std::vector<int> nodes() const;  ///< sorted, unique
  /// The entities all of whose nodes satisfy `holds`.
  Tag where(const std::function<bool(int node)>& holds) const;
};

/// A separate piece of a mesh that was put together from several: a link, a ball. Its nodes and elements stand in a
/// row.
struct Part {
  std::string name;
  int first_node = 0, node_count = 0;
  int first_element = 0, element_count = 0;
};

/// Rest geometry: nodes X [m], simplices with one region each, and named parts of the boundary.
struct Mesh {
  ElementShape shape = ElementShape::tri3;
  Eigen::VectorXd X;          ///< rest positions [m], stacked node by node: (dimension * node count)
  std::vector<int> elements;  ///< node numbers, nodes_of(shape) per element, positively oriented
  std::vector<int> region;    ///< region index of each element
  std::vector<std::string> region_names;
  std::map<std::string, Tag> tags;
  std::vector<Part> parts;           ///< empty: the mesh is one piece
  std::vector<std::string> remarks;  ///< what was mended when it was read, for people

  int dimension() const { return dimension_of(shape); }                                          ///< 2 or 3
  int nodes_per_element() const { return nodes_of(shape); }                                      ///< 3 to 10
  int node_count() const { return static_cast<int>(X.size()) / dimension(); }                    ///< of all parts
  int element_count() const { return static_cast<int>(elements.size()) / nodes_per_element(); }  ///< of all parts
  /// Nodes of element e.
  const int* element(int e) const { return elements.data() + static_cast<size_t>(e) * nodes_per_element(); }
  Eigen::VectorXd node(int i) const { return X.segment(i * dimension(), dimension()); }  ///< rest position [m]
  Eigen::VectorXd centroid(int e) const;  ///< mean of the element's vertices [m]
  /// Diagonal of the bounding box [m].
  double diagonal() const;

  /// The tag called `name`, or an intersection written "a & b": the boundary entities of the highest dimension whose
  /// nodes all lie in every named tag (two faces of a box meet in an edge, three in a corner). Throws InputError with
  /// the known tags when a name is unknown or the intersection is empty.
  Tag select(std::string_view name) const;

  /// Region index by name; throws InputError with the nearest name.
  int region_index(std::string_view name) const;
  /// The same, of a new region where there is none of that name.
  int add_region(const std::string& name);
  /// Part by name; throws InputError with the nearest name.
  const Part& part(std::string_view name) const;

  /// Throws InputError when an element is inverted or degenerate, a node belongs to no element, an index is out of
  /// range or a region is unnamed. `where` starts the message (a file name, say).
  void check(std::string_view where) const;
};

/// Facets (edges in 2D, triangles in 3D) that belong to one element only, in the mesh's order, outward oriented.
Tag boundary(const Mesh& mesh);

/// The same mesh with quadratic elements: mid-nodes on straight edges. Tags and regions are carried over.
Mesh to_quadratic(const Mesh& linear);

/// The element that contains rest point `point` [m] and the shape-function weights of its nodes there.
/// Throws InputError when the point is farther than 1e-6 diagonals outside the mesh; the message names the distance
/// and the nearest node.
struct MaterialPoint {
  std::vector<int> nodes;
  std::vector<double> weights;  ///< of the nodes; their sum is 1
};
MaterialPoint locate(const Mesh& mesh, const Eigen::VectorXd& point);  ///< see MaterialPoint
/// The same within one part, which others may overlap (brackets of a joint lie beside each other).
MaterialPoint locate(const Mesh& mesh, const Eigen::VectorXd& point, const Part& part);
/// Whether a point [m] lies in a part at rest, its boundary included.
bool lies_in(const Part& part, const Mesh& mesh, const Eigen::VectorXd& point);

/// One mesh of several, all of one element shape. Regions of the same name are one region (and share its material);
/// the tag "tip" of part "link1" becomes "link1.tip". Throws InputError for different shapes or a name that is there
/// twice.
Mesh merge(const std::vector<std::pair<std::string, Mesh>>& parts);

/// Moves a mesh: x = rotation X + shift [m], an orthogonal matrix of the mesh's dimension; it may mirror.
void place(Mesh& mesh, const Eigen::MatrixXd& rotation, const Eigen::VectorXd& shift);

}  // namespace taut

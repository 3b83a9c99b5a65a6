#include "sim/mesh/mesh.hpp"

#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <set>
#include <utility>

#include "sim/core/error.hpp"
#include "sim/core/sorted.hpp"
#include "sim/mesh/shape_functions.hpp"
#include "sim/mesh/topology.hpp"

namespace taut {
namespace {

std::vector<std::string> tag_names(const Mesh& mesh) {
  std::vector<std::string> names;
  for (const auto& [name, tag] : mesh.tags) names.push_back(name);
  return names;
}

std::string known_tags(const Mesh& mesh) {
  return mesh.tags.empty() ? "the mesh has no tags" : "known tags: " + join(tag_names(mesh));
}

const Tag& tag_called(const Mesh& mesh, std::string_view name) {
  const auto found = mesh.tags.find(std::string(name));
  if (found == mesh.tags.end()) {
    throw InputError(
        fmt::format("no tag '{}' in the mesh{}; {}", name, did_you_mean(name, tag_names(mesh)), known_tags(mesh)));
  }
  return found->second;
}

/// Edges of triangles, each once.
Tag edges_of_triangles(const Tag& triangles) {
  const ReferenceFacets edges = facets_of(triangles.nodes_per_entity == 3 ? ElementShape::tri3 : ElementShape::tri6);
  Tag result{1, edges.nodes_per_facet, {}};
  std::set<std::pair<int, int>> seen;
  for (int t = 0; t < triangles.count(); ++t) {
    const int* nodes = triangles.entity(t);
    for (int e = 0; e < edges.count; ++e) {
      const int* local = &edges.nodes[e * edges.nodes_per_facet];
      if (!seen.insert(std::minmax({nodes[local[0]], nodes[local[1]]})).second) continue;
      for (int i = 0; i < edges.nodes_per_facet; ++i) result.entities.push_back(nodes[local[i]]);
    }
  }
  return result;
}

double longest_edge(const Mesh& mesh, int element) {
  double longest = 0.0;
  for (const auto& [a, b] : edges_of(mesh.shape)) {
    const int* nodes = mesh.element(element);
    longest = std::max(longest, (mesh.node(nodes[a]) - mesh.node(nodes[b])).norm());
  }
  return longest;
}

/// Smallest Jacobian determinant over the element's nodes. On straight-sided elements it is the same everywhere.
template <ElementShape S>
double smallest_jacobian(const Mesh& mesh, int element) {
  using Reference = ReferenceElement<S>;
  static const auto gradients = [] {
    std::array<Eigen::Matrix<double, Reference::D, Reference::N>, Reference::N> at_nodes;
    for (int a = 0; a < Reference::N; ++a) at_nodes[a] = Reference::gradients(Reference::node(a));
    return at_nodes;
  }();
  const auto X = Reference::positions(mesh, element);
  double smallest = (X * gradients[0].transpose()).determinant();
  for (const auto& g : gradients) smallest = std::min(smallest, (X * g.transpose()).determinant());
  return smallest;
}

double smallest_jacobian(const Mesh& mesh, int element) {
  if (order_of(mesh.shape) == 1) return vertex_determinant(mesh, element);
  return with_shape(mesh.shape, [&](auto shape) { return smallest_jacobian<shape>(mesh, element); });
}

void check_sizes(const Mesh& mesh, std::string_view where) {
  const auto fail = [&](const std::string& what) { throw InputError(fmt::format("{}: {}", where, what)); };
  const int n = mesh.nodes_per_element();
  if (mesh.elements.empty()) fail("the mesh has no elements");
  if (mesh.X.size() % mesh.dimension() != 0 || mesh.elements.size() % n != 0) {
    fail(fmt::format("{} coordinates and {} element nodes do not make {}D nodes and {} elements", mesh.X.size(),
                     mesh.elements.size(), mesh.dimension(), name_of(mesh.shape)));
  }
  if (static_cast<int>(mesh.region.size()) != mesh.element_count()) {
    fail(fmt::format("{} region indices for {} elements; each element needs one", mesh.region.size(),
                     mesh.element_count()));
  }
  for (size_t r = 0; r < mesh.region_names.size(); ++r) {
    if (mesh.region_names[r].empty()) fail(fmt::format("region {} has no name", r));
  }
  for (int i = 0; i < mesh.node_count(); ++i) {
    if (!mesh.node(i).allFinite()) fail(fmt::format("node {} has a coordinate that is not finite", i));
  }
}

void check_indices(const Mesh& mesh, std::string_view where) {
  const int nodes = mesh.node_count();
  std::vector<bool> used(nodes, false);
  for (int e = 0; e < mesh.element_count(); ++e) {
    for (int a = 0; a < mesh.nodes_per_element(); ++a) {
      const int node = mesh.element(e)[a];
      if (node < 0 || node >= nodes) {
        throw InputError(
            fmt::format("{}: element {} refers to node {}, but nodes go from 0 to {}", where, e, node, nodes - 1));
      }
      used[node] = true;
    }
    if (mesh.region[e] < 0 || mesh.region[e] >= static_cast<int>(mesh.region_names.size())) {
      throw InputError(fmt::format("{}: element {} has region index {}, but {} regions are named", where, e,
                                   mesh.region[e], mesh.region_names.size()));
    }
  }
  for (const auto& [name, tag] : mesh.tags) {
    if (tag.dimension < 0 || tag.dimension >= mesh.dimension() ||
        tag.nodes_per_entity != nodes_per_entity(tag.dimension, order_of(mesh.shape)) ||
        tag.entities.size() % tag.nodes_per_entity != 0) {
      throw InputError(
          fmt::format("{}: tag '{}' has dimension {} and {} nodes per entity, which do not fit {} elements", where,
                      name, tag.dimension, tag.nodes_per_entity, name_of(mesh.shape)));
    }
    for (int node : tag.entities) {
      if (node < 0 || node >= nodes) {
        throw InputError(
            fmt::format("{}: tag '{}' refers to node {}, but nodes go from 0 to {}", where, name, node, nodes - 1));
      }
    }
  }
  const auto unused = std::find(used.begin(), used.end(), false);
  if (unused != used.end()) {
    const int node = static_cast<int>(unused - used.begin());
    throw InputError(fmt::format("{}: node {} at {} belongs to no element; remove it", where, node,
                                 in_millimetres(mesh.node(node))));
  }
}

}  // namespace

std::string_view name_of(ElementShape s) {
  constexpr std::string_view names[] = {"tri3", "tri6", "tet4", "tet10"};
  return names[static_cast<size_t>(s)];
}

std::vector<int> Tag::nodes() const {
  std::vector<int> sorted = entities;
  sort_unique(sorted);
  return sorted;
}

Tag Tag::where(const std::function<bool(int node)>& holds) const {
  Tag result{dimension, nodes_per_entity, {}};
  for (int i = 0; i < count(); ++i) {
    const int* first = entity(i);
    if (std::all_of(first, first + nodes_per_entity, holds))
      result.entities.insert(result.entities.end(), first, first + nodes_per_entity);
  }
  return result;
}

Eigen::VectorXd Mesh::centroid(int e) const {
  Eigen::VectorXd centroid = Eigen::VectorXd::Zero(dimension());
  for (int a = 0; a <= dimension(); ++a) centroid += node(element(e)[a]) / (dimension() + 1);
  return centroid;
}

double Mesh::diagonal() const {
  if (node_count() == 0) return 0.0;
  const auto positions = X.reshaped(dimension(), node_count());
  return (positions.rowwise().maxCoeff() - positions.rowwise().minCoeff()).norm();
}

Tag Mesh::select(std::string_view name) const {
  name = trimmed(name);
  if (name.find('&') == std::string_view::npos || tags.contains(std::string(name))) return tag_called(*this, name);
  // A node is common when every named tag holds it.
  std::vector<int> hits(node_count(), 0);
  int named = 0;
  for (std::string_view rest = name; named == 0 || !rest.empty(); ++named) {
    const size_t end = rest.find('&');
    const std::string_view part = trimmed(rest.substr(0, end));
    if (part.empty() || (end != std::string_view::npos && trimmed(rest.substr(end + 1)).empty())) {
      throw InputError(
          fmt::format("tag '{}' names nothing on one side of '&'; write 'a & b'; {}", name, known_tags(*this)));
    }
    for (int node : tag_called(*this, part).nodes()) ++hits[node];
    rest = end == std::string_view::npos ? std::string_view{} : rest.substr(end + 1);
  }
  const auto common = [&](int node) { return hits[node] == named; };
  const Tag facets = boundary(*this);
  Tag selected = facets.where(common);
  if (selected.entities.empty() && dimension() == 3) selected = edges_of_triangles(facets).where(common);
  if (selected.entities.empty()) selected = Tag{0, 1, facets.nodes()}.where(common);
  if (selected.entities.empty()) {
    throw InputError(
        fmt::format("'{}' is empty: these tags share no node of the boundary; {}", name, known_tags(*this)));
  }
  return selected;
}

int Mesh::region_index(std::string_view name) const {
  const auto found = std::find(region_names.begin(), region_names.end(), name);
  if (found == region_names.end()) {
    throw InputError(fmt::format("no region '{}' in the mesh{}; known regions: {}", name,
                                 did_you_mean(name, region_names), join(region_names)));
  }
  return static_cast<int>(found - region_names.begin());
}

int Mesh::add_region(const std::string& name) {
  const auto found = std::find(region_names.begin(), region_names.end(), name);
  const int index = static_cast<int>(found - region_names.begin());
  if (found == region_names.end()) region_names.push_back(name);
  return index;
}

const Part& Mesh::part(std::string_view name) const {
  for (const Part& part : parts) {
    if (part.name == name) return part;
  }
  std::vector<std::string> known;
  for (const Part& part : parts) known.push_back(part.name);
  throw InputError(fmt::format("no part '{}' in the mesh{}; known parts: {}", name, did_you_mean(name, known),
                               known.empty() ? "none, it is one piece" : join(known)));
}

Mesh merge(const std::vector<std::pair<std::string, Mesh>>& parts) {
  Mesh whole;
  if (parts.empty()) throw InputError("there is no part to put a mesh together from; give at least one");
  whole.shape = parts.front().second.shape;
  for (const auto& [name, mesh] : parts) {
    if (mesh.shape != whole.shape) {
      throw InputError(fmt::format("part '{}' has elements of another shape ({}) than '{}' ({}); use one for all", name,
                                   name_of(mesh.shape), parts.front().first, name_of(whole.shape)));
    }
    for (const Part& other : whole.parts) {
      if (other.name == name)
        throw InputError(fmt::format("the part '{}' is there twice; name each differently", name));
    }
    const int first = whole.node_count();
    whole.parts.push_back({name, first, mesh.node_count(), whole.element_count(), mesh.element_count()});
    Eigen::VectorXd X(whole.X.size() + mesh.X.size());
    X << whole.X, mesh.X;
    whole.X = std::move(X);
    for (int node : mesh.elements) whole.elements.push_back(first + node);
    std::vector<int> region_of;
    for (const std::string& region : mesh.region_names) region_of.push_back(whole.add_region(region));
    for (int region : mesh.region) whole.region.push_back(region_of[region]);
    for (auto [tag_name, tag] : mesh.tags) {
      for (int& node : tag.entities) node += first;
      whole.tags[name + "." + tag_name] = std::move(tag);
    }
    whole.remarks.insert(whole.remarks.end(), mesh.remarks.begin(), mesh.remarks.end());
  }
  return whole;
}

void place(Mesh& mesh, const Eigen::MatrixXd& rotation, const Eigen::VectorXd& shift) {
  const int d = mesh.dimension();
  for (int i = 0; i < mesh.node_count(); ++i) mesh.X.segment(i * d, d) = rotation * mesh.node(i) + shift;
  if (rotation.determinant() > 0) return;
  for (int e = 0; e < mesh.element_count(); ++e)
    flip_element(mesh.shape, mesh.elements.data() + static_cast<size_t>(e) * mesh.nodes_per_element());
  orient_tags(mesh, "a mirrored mesh");
}

void Mesh::check(std::string_view where) const {
  check_sizes(*this, where);
  check_indices(*this, where);
  // Relative to the longest edge's square or cube, a flat element has round-off (1e-16); a usable sliver is far above.
  constexpr double flat = 1e-13;
  for (int e = 0; e < element_count(); ++e) {
    const double jacobian = smallest_jacobian(*this, e);
    const double scale = std::pow(longest_edge(*this, e), dimension());
    if (jacobian > flat * scale) continue;
    const bool degenerate = jacobian >= -flat * scale;
    throw InputError(fmt::format(
        "{}: element {} with centroid at {} is {}; {}", where, e, in_millimetres(centroid(e)),
        degenerate ? "degenerate" : "inverted",
        degenerate ? "its nodes lie on one line or plane, or coincide" : "reverse its node order or unfold it"));
  }
}

Tag boundary(const Mesh& mesh) {
  const ReferenceFacets reference = facets_of(mesh.shape);
  const int d = mesh.dimension();
  struct Facet {
    std::array<int, 3> vertices;
    int number;  ///< element * facets per element + local facet
  };
  std::vector<Facet> facets;
  facets.reserve(mesh.element_count() * reference.count);
  for (int e = 0; e < mesh.element_count(); ++e) {
    for (int f = 0; f < reference.count; ++f) {
      Facet facet{{-1, -1, -1}, e * reference.count + f};
      for (int i = 0; i < d; ++i)
        facet.vertices[i] = mesh.element(e)[reference.nodes[f * reference.nodes_per_facet + i]];
      std::sort(facet.vertices.begin(), facet.vertices.end());
      facets.push_back(facet);
    }
  }
  std::sort(facets.begin(), facets.end(), [](const Facet& a, const Facet& b) { return a.vertices < b.vertices; });
  std::vector<int> single;
  for (size_t i = 0; i < facets.size();) {
    size_t next = i + 1;
    while (next < facets.size() && facets[next].vertices == facets[i].vertices) ++next;
    if (next == i + 1) single.push_back(facets[i].number);
    i = next;
  }
  std::sort(single.begin(), single.end());  // in element order, whatever the sort above did

  Tag result{d - 1, reference.nodes_per_facet, {}};
  for (int number : single) {
    const int* local = &reference.nodes[(number % reference.count) * reference.nodes_per_facet];
    for (int i = 0; i < reference.nodes_per_facet; ++i) {
      result.entities.push_back(mesh.element(number / reference.count)[local[i]]);
    }
  }
  return result;
}

Mesh to_quadratic(const Mesh& linear) {
  if (order_of(linear.shape) == 2) return linear;
  const int d = linear.dimension();
  Mesh mesh = linear;
  mesh.shape = d == 2 ? ElementShape::tri6 : ElementShape::tet10;
  mesh.elements.clear();

  std::map<std::pair<int, int>, int> mid_nodes;
  for (int e = 0; e < linear.element_count(); ++e) {
    const int* nodes = linear.element(e);
    mesh.elements.insert(mesh.elements.end(), nodes, nodes + d + 1);
    for (const auto& [a, b] : edges_of(linear.shape)) {
      const int next = linear.node_count() + static_cast<int>(mid_nodes.size());
      mesh.elements.push_back(mid_nodes.try_emplace(std::minmax({nodes[a], nodes[b]}), next).first->second);
    }
  }
  mesh.X.conservativeResize(linear.X.size() + mid_nodes.size() * d);
  straighten(mesh);

  for (auto& [name, tag] : mesh.tags) {
    if (tag.dimension == 0) continue;
    const int vertices = tag.dimension + 1;
    const Tag old = std::exchange(tag, Tag{tag.dimension, nodes_per_entity(tag.dimension, 2), {}});
    for (int i = 0; i < old.count(); ++i) {
      const int* nodes = old.entity(i);
      tag.entities.insert(tag.entities.end(), nodes, nodes + vertices);
      for (int edge = 0; edge < (tag.dimension == 1 ? 1 : 3); ++edge) {
        const auto found = mid_nodes.find(std::minmax({nodes[edge], nodes[(edge + 1) % vertices]}));
        if (found == mid_nodes.end()) {
          throw InputError(
              fmt::format("tag '{}' has an edge at {} that is no edge of any element; tag only parts of "
                          "the mesh",
                          name, in_millimetres(linear.node(nodes[edge]))));
        }
        tag.entities.push_back(found->second);
      }
    }
  }
  return mesh;
}

}  // namespace taut

#include "sim/mesh/extrude.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "sim/core/error.hpp"
#include "sim/mesh/mesh_budget.hpp"
#include "sim/mesh/topology.hpp"

namespace taut {
namespace {

/// Numbers nodes part by part, in the order that they have within each: mid-nodes of all parts came last.
void gather_parts(Mesh& mesh) {
  const int d = mesh.dimension();
  std::vector<int> part(mesh.node_count(), 0);
  for (size_t k = 0; k < mesh.parts.size(); ++k) {
    const int *first = mesh.element(mesh.parts[k].first_element),
              *last = first + mesh.parts[k].element_count * mesh.nodes_per_element();
    for (const int* node = first; node != last; ++node) part[*node] = static_cast<int>(k);
  }
  std::vector<int> order(part.size()), place(part.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return part[a] < part[b]; });
  const Eigen::VectorXd X = mesh.X;
  for (int i = 0; i < mesh.node_count(); ++i) {
    place[order[i]] = i;
    mesh.X.segment(i * d, d) = X.segment(order[i] * d, d);
  }
  for (int& node : mesh.elements) node = place[node];
  for (auto& [name, tag] : mesh.tags) {
    for (int& node : tag.entities) node = place[node];
  }
  int first = 0;
  for (size_t k = 0; k < mesh.parts.size(); ++k) {
    mesh.parts[k].first_node = first;
    mesh.parts[k].node_count = static_cast<int>(std::count(part.begin(), part.end(), static_cast<int>(k)));
    first += mesh.parts[k].node_count;
  }
}

void check_extrusion(const Mesh& plane, double depth, int layers) {
  if (plane.dimension() != 2) throw InputError("a solid is swept from a plane mesh, and this one is solid already");
  if (!(depth > 0) || !std::isfinite(depth) || layers < 1) {
    throw InputError(
        fmt::format("a solid {:.6g} mm deep in {} layers cannot be; make both positive", 1e3 * depth, layers));
  }
  for (const char* name : {"symmetry", "side"}) {
    if (plane.tags.count(name) > 0)
      throw InputError(
          fmt::format("the tag '{}' is the name of a face that a solid gets; rename the plane mesh's own", name));
  }
}

/// The columns of nodes above the vertices of a plane mesh, in its order.
struct Columns {
  std::vector<int> vertex;  ///< per plane node: which column, -1: none (a mid-node)
  int count = 0, layers;

  Columns(const Mesh& plane, int given_layers) : vertex(plane.node_count(), -1), layers(given_layers) {
    for (int e = 0; e < plane.element_count(); ++e) {
      for (int a = 0; a < 3; ++a) vertex[plane.element(e)[a]] = 0;
    }
    for (int& number : vertex) {
      if (number == 0) number = count++;
    }
  }
  bool has(int plane_node) const { return vertex[plane_node] >= 0; }
  int node(int plane_node, int level) const { return vertex[plane_node] * (layers + 1) + level; }
};

void place_columns(const Mesh& plane, const Columns& columns, double depth, Mesh& mesh) {
  mesh.X.resize(3 * columns.count * (columns.layers + 1));
  for (int i = 0; i < plane.node_count(); ++i) {
    if (!columns.has(i)) continue;
    for (int level = 0; level <= columns.layers; ++level) {
      mesh.X.segment<3>(3 * columns.node(i, level)) << plane.X[2 * i], plane.X[2 * i + 1],
          level == columns.layers ? depth : depth * level / columns.layers;
    }
  }
}

/// Three tetrahedra per prism, and the two faces that the sweep begins and ends with.
void sweep_elements(const Mesh& plane, const Columns& columns, Mesh& mesh) {
  Tag symmetry{2, 3, {}}, side{2, 3, {}};
  for (int e = 0; e < plane.element_count(); ++e) {
    std::array<int, 3> corners{plane.element(e)[0], plane.element(e)[1], plane.element(e)[2]};
    std::sort(corners.begin(), corners.end());
    for (int layer = 0; layer < columns.layers; ++layer) {
      // From the lowest number's vertex at one end of the prism to the highest one's at the other, up one edge a time.
      const int from = layer + layer % 2, to = layer + 1 - layer % 2;
      for (int risen = 0; risen < 3; ++risen) {
        std::array<int, 4> tetrahedron{};
        for (int a = 0; a <= 2 - risen; ++a) tetrahedron[a] = columns.node(corners[a], from);
        for (int a = 2 - risen; a < 3; ++a) tetrahedron[a + 1] = columns.node(corners[a], to);
        mesh.elements.insert(mesh.elements.end(), tetrahedron.begin(), tetrahedron.end());
        mesh.region.push_back(plane.region[e]);
        const int last = mesh.element_count() - 1;
        if (vertex_determinant(mesh, last) < 0) flip_element(mesh.shape, &mesh.elements[4 * last]);
      }
    }
    for (int corner : corners) {
      symmetry.entities.push_back(columns.node(corner, 0));
      side.entities.push_back(columns.node(corner, columns.layers));
    }
  }
  mesh.tags["symmetry"] = std::move(symmetry);
  mesh.tags["side"] = std::move(side);
}

/// Points become lines and lines faces.
void sweep_tag(const Mesh& plane, const std::string& name, const Tag& tag, const Columns& columns, Mesh& mesh) {
  Tag& swept = mesh.tags[name] = {tag.dimension + 1, tag.dimension + 2, {}};
  for (int i = 0; i < tag.count(); ++i) {
    const int* ends = &tag.entities[i * tag.nodes_per_entity];
    if (!columns.has(ends[0])) {
      throw InputError(
          fmt::format("the point at {} of tag '{}' is no corner of an element, so that no edge goes "
                      "through the solid there; tag a corner",
                      in_millimetres(plane.node(ends[0])), name));
    }
    for (int layer = 0; layer < columns.layers; ++layer) {
      if (tag.dimension == 0) {
        swept.entities.insert(swept.entities.end(), {columns.node(ends[0], layer), columns.node(ends[0], layer + 1)});
        continue;
      }
      const int low = std::min(ends[0], ends[1]), high = std::max(ends[0], ends[1]);
      const int from = layer + layer % 2, to = layer + 1 - layer % 2;
      const int a = columns.node(low, from), b = columns.node(high, from), c = columns.node(high, to);
      swept.entities.insert(swept.entities.end(), {a, b, c, a, c, columns.node(low, to)});
    }
  }
}

}  // namespace

Mesh extrude(const Mesh& plane, double depth, int layers) {
  check_extrusion(plane, depth, layers);
  require_mesh(3.0 * plane.element_count() * layers, 3, order_of(plane.shape));
  const Columns columns(plane, layers);
  Mesh mesh;
  mesh.shape = ElementShape::tet4;
  mesh.region_names = plane.region_names;
  mesh.remarks = plane.remarks;
  place_columns(plane, columns, depth, mesh);
  sweep_elements(plane, columns, mesh);
  for (const auto& [name, tag] : plane.tags) sweep_tag(plane, name, tag, columns, mesh);
  for (Part part : plane.parts) {
    part.first_element *= 3 * layers;
    part.element_count *= 3 * layers;
    mesh.parts.push_back(part);
  }
  orient_tags(mesh, "solid");
  if (order_of(plane.shape) == 2) mesh = to_quadratic(mesh);
  if (!mesh.parts.empty()) gather_parts(mesh);
  mesh.check("solid");
  return mesh;
}

}  // namespace taut

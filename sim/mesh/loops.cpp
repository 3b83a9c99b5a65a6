#include "sim/mesh/loops.hpp"

#include <algorithm>
#include <array>
#include <map>
#include <utility>

#include "sim/core/error.hpp"
#include "sim/mesh/topology.hpp"

namespace taut {
namespace {

std::array<int, 3> vertices_of(const int* nodes) {
  std::array<int, 3> vertices = {nodes[0], nodes[1], nodes[2]};
  std::ranges::sort(vertices);
  return vertices;
}

/// Triangles of the boundary in the mesh's own numbers.
std::vector<BoundarySurface::Triangle> boundary_triangles(const Mesh& mesh) {
  std::map<std::array<int, 3>, int> region_of;
  const ReferenceFacets facets = facets_of(mesh.shape);
  for (int e = 0; e < mesh.element_count(); ++e) {
    for (int f = 0; f < facets.count; ++f) {
      const int* local = &facets.nodes[f * facets.nodes_per_facet];
      const int* nodes = mesh.element(e);
      region_of[vertices_of(std::array{nodes[local[0]], nodes[local[1]], nodes[local[2]]}.data())] =
          mesh.region[static_cast<size_t>(e)];
    }
  }
  std::vector<BoundarySurface::Triangle> triangles;
  const Tag tag = boundary(mesh);
  for (int i = 0; i < tag.count(); ++i) {
    const int* n = &tag.entities[static_cast<size_t>(i) * tag.nodes_per_entity];
    const int region = region_of.at(vertices_of(n));
    if (tag.nodes_per_entity == 3) {
      triangles.push_back({region, {n[0], n[1], n[2]}});
    } else {
      for (const std::array<int, 3>& part :
           {std::array{n[0], n[3], n[5]}, {n[3], n[1], n[4]}, {n[5], n[4], n[2]}, {n[3], n[4], n[5]}}) {
        triangles.push_back({region, part});
      }
    }
  }
  return triangles;
}

}  // namespace

std::vector<std::vector<int>> region_loops(const Mesh& mesh, int region) {
  if (mesh.dimension() != 2) throw InputError("the outlines of a region are for 2D meshes; this one is 3D");
  const ReferenceFacets facets = facets_of(mesh.shape);
  std::map<std::pair<int, int>, int> uses;
  const auto each_edge = [&](auto&& action) {
    for (int e = 0; e < mesh.element_count(); ++e) {
      if (mesh.region[e] != region) continue;
      for (int f = 0; f < facets.count; ++f) {
        const int* local = &facets.nodes[f * facets.nodes_per_facet];
        const int* nodes = mesh.element(e);
        action(nodes[local[0]], nodes[local[1]], facets.nodes_per_facet > 2 ? nodes[local[2]] : -1);
      }
    }
  };
  each_edge([&](int a, int b, int) { ++uses[std::minmax(a, b)]; });
  std::multimap<int, std::array<int, 2>> next;  // node to the one after it and the mid-node between them
  each_edge([&](int a, int b, int middle) {
    if (uses[std::minmax(a, b)] == 1) next.insert({a, {b, middle}});
  });
  std::vector<std::vector<int>> loops;
  while (!next.empty()) {
    std::vector<int>& loop = loops.emplace_back();
    for (auto at = next.begin(); at != next.end();) {
      loop.push_back(at->first);
      const auto [to, middle] = at->second;
      if (middle >= 0) loop.push_back(middle);
      next.erase(at);
      if (to == loop.front()) break;  // also where two loops touch in a node
      at = next.find(to);
    }
  }
  return loops;
}

BoundarySurface boundary_surface(const Mesh& mesh) {
  BoundarySurface surface;
  if (mesh.dimension() == 2) {
    for (size_t r = 0; r < mesh.region_names.size(); ++r) {
      for (const std::vector<int>& loop : region_loops(mesh, static_cast<int>(r))) {
        surface.loops.push_back({static_cast<int>(r), loop});
      }
    }
  } else {
    surface.triangles = boundary_triangles(mesh);
  }
  std::vector<int> place(static_cast<size_t>(mesh.node_count()), -1);
  const auto each_point = [&](auto&& action) {
    for (BoundarySurface::Loop& loop : surface.loops) std::ranges::for_each(loop.points, action);
    for (BoundarySurface::Triangle& triangle : surface.triangles) std::ranges::for_each(triangle.points, action);
  };
  each_point([&](int node) { place[static_cast<size_t>(node)] = 0; });
  for (size_t node = 0; node < place.size(); ++node) {
    if (place[node] < 0) continue;
    place[node] = static_cast<int>(surface.nodes.size());
    surface.nodes.push_back(static_cast<int>(node));
  }
  each_point([&](int& node) { node = place[static_cast<size_t>(node)]; });
  return surface;
}

}  // namespace taut

#include "sim/mesh/loops.hpp"

#include <algorithm>
#include <array>
#include <map>
#include <utility>

#include "sim/core/error.hpp"
#include "sim/mesh/topology.hpp"

namespace taut {

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

}  // namespace taut

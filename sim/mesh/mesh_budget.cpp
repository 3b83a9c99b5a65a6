#include "sim/mesh/mesh_budget.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "sim/core/error.hpp"
#include "sim/core/memory_budget.hpp"

namespace taut {
namespace {

/// Nodes per element of large meshes: each vertex is shared by 6 triangles, or by about 24 tetrahedra of cut boxes.
double nodes_per_element_of(int dimension, int order) {
  if (dimension == 2) return order == 1 ? 0.5 : 2;
  return order == 1 ? 1.0 / 6 : 4.0 / 3;
}

/// Nonzero entries of half the Hessian, per node: nodes that share an element with it, itself, times d^2 components.
double entries_per_node(int dimension, int order) {
  const double neighbours = dimension == 2 ? (order == 1 ? 7 : 11.5) : (order == 1 ? 15 : 28);
  return 0.5 * (neighbours + 1) * dimension * dimension;
}

double entries_of_factor(double nodes, int dimension) {
  const double n = std::max(nodes, 2.0);
  return dimension == 2 ? 4 * 7.75 * n * std::log2(n) : 9 * 6 * std::pow(n, 4.0 / 3);
}

/// Whether indices, which are int, count all of it, and it fits into these bytes.
bool fits(double elements, double nodes, int dimension, int order, double bytes) {
  constexpr double most = std::numeric_limits<int>::max();
  return 10 * elements < most && entries_per_node(dimension, order) * nodes < most &&
         entries_of_factor(nodes, dimension) < most && memory_of_equations(nodes, dimension, order) <= bytes;
}

/// Two digits, written out where that is short.
std::string about(double count) {
  if (!(count < 1e7)) return fmt::format("{:.1e}", count);
  const double unit = std::pow(10, std::max(0.0, std::floor(std::log10(std::max(1.0, count))) - 1));
  return fmt::format("{:.0f}", unit * std::round(count / unit));
}

}  // namespace

double memory_of_equations(double nodes, int dimension, int order) {
  const double factors = dimension == 2 ? 1.3 : 2.7;  // that are held at a time, with the workspace of one
  return 8 * factors * entries_of_factor(nodes, dimension) + 300 * entries_per_node(dimension, order) * nodes +
         600 * nodes;
}

void require_mesh(double elements, int dimension, int order) {
  require_equations(elements, nodes_per_element_of(dimension, order) * elements, dimension, order);
}

void require_equations(double elements, double nodes, int dimension, int order) {
  const double left = 0.9 * available_memory();
  if (fits(elements, nodes, dimension, order, left)) return;
  const double per_element = nodes / std::max(1.0, elements);
  double fewest = 0, most = elements;  // of what fits
  for (int k = 0; k < 60; ++k) {
    const double middle = 0.5 * (fewest + most);
    (fits(middle, per_element * middle, dimension, order, left) ? fewest : most) = middle;
  }
  const char* kind = dimension == 2 ? "triangles" : "tetrahedra";
  throw InputError(
      fmt::format("the mesh would have about {} {} {}, whose equations take about {} of memory; {} are free, in which "
                  "about {} fit; "
                  "make the elements {:.2g} times as long or more",
                  about(elements), order == 1 ? "linear" : "quadratic", kind,
                  in_bytes(memory_of_equations(nodes, dimension, order)), in_bytes(left / 0.9), about(fewest),
                  std::ceil(10 * std::pow(elements / std::max(1.0, fewest), 1.0 / dimension)) / 10));
}

}  // namespace taut

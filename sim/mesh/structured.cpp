#include "sim/mesh/structured.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "sim/core/error.hpp"
#include "sim/mesh/topology.hpp"

namespace taut {
namespace {

void check_grading(double length, int cells, double ratio) {
  if (!(length > 0.0) || !std::isfinite(length)) {
    throw InputError(fmt::format("graded coordinates: length {} m must be positive", length));
  }
  if (cells < 1) throw InputError(fmt::format("graded coordinates: {} cells; at least 1 is needed", cells));
  if (!(ratio > 0.0) || !std::isfinite(ratio)) {
    throw InputError(fmt::format("graded coordinates: ratio {} of last to first cell must be positive", ratio));
  }
}

/// End points of cells with the given relative sizes; the last one is exactly `length`.
std::vector<double> accumulated(double length, const std::vector<double>& sizes) {
  std::vector<double> sums{0.0};
  for (double size : sizes) sums.push_back(sums.back() + size);
  std::vector<double> x;
  for (double sum : sums) x.push_back(length * (sum / sums.back()));
  return x;
}

void check_coordinates(char axis, const std::vector<double>& x) {
  if (x.size() < 2)
    throw InputError(fmt::format("grid: {} coordinates along {}; at least 2 are needed", x.size(), axis));
  for (size_t i = 0; i < x.size(); ++i) {
    if (!std::isfinite(x[i]) || (i > 0 && x[i] <= x[i - 1])) {
      throw InputError(
          fmt::format("grid: coordinate {} along {} is {} m; coordinates must be finite and increase", i, axis, x[i]));
    }
  }
}

void check_order(int order, const std::string& region) {
  if (order != 1 && order != 2) throw InputError(fmt::format("grid: element order {}; 1 and 2 are allowed", order));
  if (region.empty()) throw InputError("grid: the region has no name; give it one, e.g. 'body'");
}

/// Tags the sides of a grid. Nodes are numbered x fastest; `counts` are the grid points along each axis.
void tag_sides(Mesh& mesh, const std::vector<int>& counts) {
  const Tag facets = boundary(mesh);
  const int n = facets.nodes_per_entity;
  int stride = 1;
  for (size_t axis = 0; axis < counts.size(); ++axis) {
    for (const bool upper : {false, true}) {
      // By grid index rather than by coordinate: exact whatever the coordinates are.
      const auto on_side = [&](int node) { return node / stride % counts[axis] == (upper ? counts[axis] - 1 : 0); };
      Tag side{facets.dimension, n, {}};
      for (int f = 0; f < facets.count(); ++f) {
        const auto first = facets.entities.begin() + f * n;
        if (std::all_of(first, first + n, on_side)) side.entities.insert(side.entities.end(), first, first + n);
      }
      mesh.tags[std::string(1, "xyz"[axis]) + (upper ? "max" : "min")] = std::move(side);
    }
    stride *= counts[axis];
  }
}

Mesh with_order(Mesh mesh, int order) {
  return order == 1 ? std::move(mesh) : to_quadratic(mesh);
}

}  // namespace

std::vector<double> graded(double length, int cells, double ratio) {
  check_grading(length, cells, ratio);
  std::vector<double> sizes;
  for (int i = 0; i < cells; ++i)
    sizes.push_back(cells == 1 ? 1.0 : std::pow(ratio, static_cast<double>(i) / (cells - 1)));
  return accumulated(length, sizes);
}

std::vector<double> graded_both(double length, int cells, double ratio) {
  check_grading(length, cells, ratio);
  const int half = (cells - 1) / 2;  // steps from the first cell to the (first) middle cell
  std::vector<double> sizes;
  for (int i = 0; i < cells; ++i) {
    const int from_end = std::min(i, cells - 1 - i);
    sizes.push_back(half == 0 ? 1.0 : std::pow(ratio, static_cast<double>(from_end) / half));
  }
  std::vector<double> x = accumulated(length, sizes);
  for (int i = 0; 2 * i < cells; ++i) x[cells - i] = length - x[i];  // symmetric to the last digit
  if (cells % 2 == 0) x[cells / 2] = 0.5 * length;
  return x;
}

void step_to(std::vector<double>& x, double end, int cells) {
  const double begin = x.back();
  for (int k = 1; k < cells; ++k) x.push_back(begin + (end - begin) * k / cells);
  x.push_back(end);
}

Mesh rectangle(const std::vector<double>& x, const std::vector<double>& y, int order, const std::string& region,
               Diagonals diagonals) {
  check_coordinates('x', x);
  check_coordinates('y', y);
  check_order(order, region);
  const int nx = static_cast<int>(x.size());
  const int ny = static_cast<int>(y.size());
  Mesh mesh;
  mesh.shape = ElementShape::tri3;
  mesh.X.resize(2 * nx * ny);
  for (int j = 0; j < ny; ++j) {
    for (int i = 0; i < nx; ++i) mesh.X.segment<2>(2 * (i + nx * j)) << x[i], y[j];
  }
  for (int j = 0; j + 1 < ny; ++j) {
    for (int i = 0; i + 1 < nx; ++i) {
      const int a = i + nx * j;
      const int b = a + 1;
      const int c = b + nx;
      const int d = a + nx;
      if (diagonals == Diagonals::rising || (diagonals == Diagonals::alternating && (i + j) % 2 == 0)) {
        mesh.elements.insert(mesh.elements.end(), {a, b, c, a, c, d});
      } else {
        mesh.elements.insert(mesh.elements.end(), {a, b, d, b, c, d});
      }
    }
  }
  mesh.region_names = {region};
  mesh.region.assign(static_cast<size_t>(mesh.element_count()), 0);
  tag_sides(mesh, {nx, ny});
  return with_order(std::move(mesh), order);
}

Mesh box(const std::vector<double>& x, const std::vector<double>& y, const std::vector<double>& z, int order,
         const std::string& region) {
  check_coordinates('x', x);
  check_coordinates('y', y);
  check_coordinates('z', z);
  check_order(order, region);
  const int nx = static_cast<int>(x.size());
  const int ny = static_cast<int>(y.size());
  const int nz = static_cast<int>(z.size());
  Mesh mesh;
  mesh.shape = ElementShape::tet4;
  mesh.X.resize(3 * nx * ny * nz);
  for (int k = 0; k < nz; ++k) {
    for (int j = 0; j < ny; ++j) {
      for (int i = 0; i < nx; ++i) mesh.X.segment<3>(3 * (i + nx * (j + ny * k))) << x[i], y[j], z[k];
    }
  }
  // One tetrahedron per order in which a path along the cell's edges takes the three axes from corner to corner.
  constexpr int paths[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
  for (int k = 0; k + 1 < nz; ++k) {
    for (int j = 0; j + 1 < ny; ++j) {
      for (int i = 0; i + 1 < nx; ++i) {
        const int cell[3] = {i, j, k};
        const bool odd_mirrors = (i + j + k) % 2 != 0;
        for (int p = 0; p < 6; ++p) {
          // Mirrored along each axis in odd cells: neighbours then share the diagonals of their common face.
          int corner[3] = {i + i % 2, j + j % 2, k + k % 2};
          const auto number = [&] { return corner[0] + nx * (corner[1] + ny * corner[2]); };
          int nodes[4] = {number(), 0, 0, 0};
          for (int step = 0; step < 3; ++step) {
            const int axis = paths[p][step];
            corner[axis] += cell[axis] % 2 == 0 ? 1 : -1;
            nodes[step + 1] = number();
          }
          if (odd_mirrors != (p >= 3)) flip_element(ElementShape::tet4, nodes);
          mesh.elements.insert(mesh.elements.end(), nodes, nodes + 4);
        }
      }
    }
  }
  mesh.region_names = {region};
  mesh.region.assign(static_cast<size_t>(mesh.element_count()), 0);
  tag_sides(mesh, {nx, ny, nz});
  return with_order(std::move(mesh), order);
}

void map_vertices(Mesh& mesh, const std::function<Eigen::VectorXd(const Eigen::VectorXd&)>& map) {
  const int d = mesh.dimension();
  std::vector<bool> vertex(static_cast<size_t>(mesh.node_count()), false);
  for (int e = 0; e < mesh.element_count(); ++e) {
    for (int a = 0; a <= d; ++a) vertex[mesh.element(e)[a]] = true;
  }
  for (int i = 0; i < mesh.node_count(); ++i) {
    if (!vertex[i]) continue;
    const Eigen::VectorXd moved = map(mesh.node(i));
    if (moved.size() != d) {
      throw InputError(fmt::format("map_vertices: the map returns {} coordinates for a {}D mesh", moved.size(), d));
    }
    mesh.X.segment(i * d, d) = moved;
  }
  straighten(mesh);
  mesh.check("map_vertices");
}

void assign_regions(Mesh& mesh, const std::function<std::string(const Eigen::VectorXd&)>& name_at) {
  const int d = mesh.dimension();
  mesh.region_names.clear();
  mesh.region.clear();
  for (int e = 0; e < mesh.element_count(); ++e) {
    Eigen::VectorXd centroid = Eigen::VectorXd::Zero(d);
    for (int a = 0; a <= d; ++a) centroid += mesh.node(mesh.element(e)[a]) / (d + 1);
    const std::string name = name_at(centroid);
    if (name.empty()) {
      throw InputError(fmt::format("assign_regions: element {} with centroid at {} gets no region name", e,
                                   in_millimetres(centroid)));
    }
    const auto found = std::find(mesh.region_names.begin(), mesh.region_names.end(), name);
    mesh.region.push_back(static_cast<int>(found - mesh.region_names.begin()));
    if (found == mesh.region_names.end()) mesh.region_names.push_back(name);
  }
}

}  // namespace taut

#include "sim/mesh/structured.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "sim/core/error.hpp"
#include "sim/mesh/mesh_budget.hpp"
#include "sim/mesh/topology.hpp"

namespace taut {
namespace {

/// Lines of a grid along one axis: with more of them not even a strip of elements could be solved.
constexpr double most_lines = 2e6;

void check_lines(double lines) {
  if (!(lines <= most_lines))
    throw InputError(fmt::format("about {:.2g} elements in a row; at most {:.0e} are allowed, choose larger ones",
                                 lines, most_lines));
}

void check_grading(double length, int cells, double ratio) {
  if (!(length > 0.0) || !std::isfinite(length)) {
    throw InputError(fmt::format("graded coordinates: length {} m must be positive", length));
  }
  if (cells < 1) throw InputError(fmt::format("graded coordinates: {} cells; at least 1 is needed", cells));
  if (!(ratio > 0.0) || !std::isfinite(ratio)) {
    throw InputError(fmt::format("graded coordinates: ratio {} of last to first cell must be positive", ratio));
  }
}

void check_grid(const std::vector<std::vector<double>>& coordinates, int order, const std::string& region) {
  for (size_t axis = 0; axis < coordinates.size(); ++axis) {
    const std::vector<double>& x = coordinates[axis];
    const char name = "xyz"[axis];
    if (x.size() < 2)
      throw InputError(fmt::format("grid: {} coordinates along {}; at least 2 are needed", x.size(), name));
    for (size_t i = 0; i < x.size(); ++i) {
      if (!std::isfinite(x[i]) || (i > 0 && x[i] <= x[i - 1])) {
        throw InputError(fmt::format("grid: coordinate {} along {} is {} m; coordinates must be finite and increase", i,
                                     name, x[i]));
      }
    }
  }
  if (order != 1 && order != 2) throw InputError(fmt::format("grid: element order {}; 1 and 2 are allowed", order));
  if (region.empty()) throw InputError("grid: the region has no name; give it one, e.g. 'body'");
}

/// One region, tagged sides. Nodes are numbered x fastest; `counts` are the grid points along each axis.
Mesh finished(Mesh mesh, const std::array<int, 3>& counts, int order, const std::string& region) {
  mesh.region_names = {region};
  mesh.region.assign(mesh.element_count(), 0);
  const std::array<int, 3> stride{1, counts[0], counts[0] * counts[1]};
  // By grid index rather than by coordinate: exact whatever the coordinates are.
  tag_sides(mesh, [&](int node, int axis, bool upper) {
    return node / stride[axis] % counts[axis] == (upper ? counts[axis] - 1 : 0);
  });
  return order == 1 ? mesh : to_quadratic(mesh);
}

}  // namespace

std::vector<double> graded(double length, int cells, double ratio) {
  check_grading(length, cells, ratio);
  check_lines(cells);
  std::vector<double> sums{0.0}, x;
  for (int i = 0; i < cells; ++i)
    sums.push_back(sums.back() + (cells == 1 ? 1.0 : std::pow(ratio, static_cast<double>(i) / (cells - 1))));
  for (double sum : sums) x.push_back(length * (sum / sums.back()));
  return x;
}

int cells_along(double length, double size, int at_least) {
  const double cells = std::max<double>(at_least, std::round(length / size));
  check_lines(cells);
  return static_cast<int>(cells);
}

void step_to(std::vector<double>& x, double end, int cells) {
  const double begin = x.back();
  check_lines(static_cast<double>(x.size()) + cells);
  for (int k = 1; k < cells; ++k) x.push_back(begin + (end - begin) * k / cells);
  x.push_back(end);
}

Mesh rectangle(const std::vector<double>& x, const std::vector<double>& y, int order, const std::string& region,
               Diagonals diagonals) {
  check_grid({x, y}, order, region);
  require_mesh(2.0 * static_cast<double>(x.size() - 1) * static_cast<double>(y.size() - 1), 2, order);
  const int nx = static_cast<int>(x.size()), ny = static_cast<int>(y.size());
  Mesh mesh;
  mesh.shape = ElementShape::tri3;
  mesh.X.resize(2 * nx * ny);
  for (int j = 0; j < ny; ++j) {
    for (int i = 0; i < nx; ++i) mesh.X.segment<2>(2 * (i + nx * j)) << x[i], y[j];
  }
  for (int j = 0; j + 1 < ny; ++j) {
    for (int i = 0; i + 1 < nx; ++i) {
      const int a = i + nx * j, b = a + 1, c = b + nx, d = a + nx;
      if (diagonals == Diagonals::rising || (diagonals == Diagonals::alternating && (i + j) % 2 == 0)) {
        mesh.elements.insert(mesh.elements.end(), {a, b, c, a, c, d});
      } else {
        mesh.elements.insert(mesh.elements.end(), {a, b, d, b, c, d});
      }
    }
  }
  return finished(std::move(mesh), {nx, ny, 1}, order, region);
}

Mesh box(const std::vector<double>& x, const std::vector<double>& y, const std::vector<double>& z, int order,
         const std::string& region) {
  check_grid({x, y, z}, order, region);
  constexpr double kept = 0.125;  // at least, of a grid that a shape is cut out of
  require_mesh(kept * 6 * static_cast<double>(x.size() - 1) * static_cast<double>(y.size() - 1) *
                   static_cast<double>(z.size() - 1),
               3, order);
  const int nx = static_cast<int>(x.size()), ny = static_cast<int>(y.size()), nz = static_cast<int>(z.size());
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
  return finished(std::move(mesh), {nx, ny, nz}, order, region);
}

void map_vertices(Mesh& mesh, const std::function<Eigen::VectorXd(const Eigen::VectorXd&)>& map) {
  const int d = mesh.dimension();
  std::vector<bool> vertex(mesh.node_count(), false);
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

Mesh part_of(const Mesh& whole, const std::function<bool(const Eigen::VectorXd&)>& keep) {
  const int d = whole.dimension();
  Mesh part;
  part.shape = whole.shape;
  part.region_names = whole.region_names;
  std::vector<int> number(whole.node_count(), -1);
  for (int e = 0; e < whole.element_count(); ++e) {
    if (!keep(whole.centroid(e))) continue;
    part.elements.insert(part.elements.end(), whole.element(e), whole.element(e) + whole.nodes_per_element());
    part.region.push_back(whole.region[e]);
  }
  for (int node : part.elements) number[node] = 0;
  int count = 0;
  for (int& n : number) {
    if (n == 0) n = count++;
  }
  part.X.resize(d * count);
  for (int node = 0; node < whole.node_count(); ++node) {
    const int n = number[node];
    if (n >= 0) part.X.segment(d * n, d) = whole.node(node);
  }
  for (int& node : part.elements) node = number[node];
  for (const auto& [name, tag] : whole.tags) {
    Tag own{tag.dimension, tag.nodes_per_entity, {}};
    for (int k = 0; k < tag.count(); ++k) {
      const auto first = tag.entities.begin() + static_cast<std::ptrdiff_t>(k) * tag.nodes_per_entity;
      const auto is_gone = [&](int node) { return number[node] < 0; };
      if (std::any_of(first, first + tag.nodes_per_entity, is_gone)) continue;
      for (auto node = first; node != first + tag.nodes_per_entity; ++node) own.entities.push_back(number[*node]);
    }
    part.tags[name] = own;
  }
  return part;
}

void assign_regions(Mesh& mesh, const std::function<std::string(const Eigen::VectorXd&)>& name_at) {
  mesh.region_names.clear();
  mesh.region.clear();
  for (int e = 0; e < mesh.element_count(); ++e) {
    const Eigen::VectorXd centroid = mesh.centroid(e);
    const std::string name = name_at(centroid);
    if (name.empty()) {
      throw InputError(fmt::format("assign_regions: element {} with centroid at {} gets no region name", e,
                                   in_millimetres(centroid)));
    }
    mesh.region.push_back(mesh.add_region(name));
  }
}

}  // namespace taut

#include "sim/robots/reach.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "sim/core/error.hpp"

namespace taut {
namespace {

/// Yes or no for each of the cells of a rectangle; no outside it.
struct Cells {
  int columns, rows;
  std::vector<char> set;

  bool at(int i, int j) const {
    return i >= 0 && j >= 0 && i < columns && j < rows && set[static_cast<size_t>(j * columns + i)] != 0;
  }
  char& operator()(int i, int j) { return set[static_cast<size_t>(j * columns + i)]; }
};

/// Cells within `radius` cells of a set one.
Cells grown(const Cells& cells, double radius) {
  Cells out{cells.columns, cells.rows, std::vector<char>(cells.set.size(), 0)};
  const int reach = static_cast<int>(radius);
  for (int j = 0; j < cells.rows; ++j) {
    for (int i = 0; i < cells.columns; ++i) {
      if (!cells.at(i, j)) continue;
      for (int dj = -reach; dj <= reach; ++dj) {
        const int width = static_cast<int>(std::sqrt(radius * radius - dj * dj));
        if (j + dj < 0 || j + dj >= cells.rows) continue;
        for (int k = std::max(0, i - width); k <= std::min(cells.columns - 1, i + width); ++k) out(k, j + dj) = 1;
      }
    }
  }
  return out;
}

void invert(Cells& cells) {
  for (char& one : cells.set) one = one == 0;
}

/// The largest part whose cells share sides, and its number of cells.
int keep_largest(Cells& cells) {
  std::vector<int> part(cells.set.size(), 0), sizes{0};
  for (int start = 0; start < static_cast<int>(cells.set.size()); ++start) {
    if (cells.set[static_cast<size_t>(start)] == 0 || part[static_cast<size_t>(start)] != 0) continue;
    const int name = static_cast<int>(sizes.size());
    sizes.push_back(0);
    std::vector<int> open{start};
    part[static_cast<size_t>(start)] = name;
    while (!open.empty()) {
      const int cell = open.back(), i = cell % cells.columns, j = cell / cells.columns;
      open.pop_back();
      ++sizes.back();
      for (const auto& [k, l] : {std::pair(i + 1, j), std::pair(i - 1, j), std::pair(i, j + 1), std::pair(i, j - 1)}) {
        if (!cells.at(k, l) || part[static_cast<size_t>(l * cells.columns + k)] != 0) continue;
        part[static_cast<size_t>(l * cells.columns + k)] = name;
        open.push_back(l * cells.columns + k);
      }
    }
  }
  const auto largest = std::max_element(sizes.begin(), sizes.end());
  for (size_t cell = 0; cell < part.size(); ++cell) cells.set[cell] = part[cell] == largest - sizes.begin();
  return *largest;
}

/// Corners of the outer boundary of one part, in cells, the part on the left.
std::vector<std::array<int, 2>> outer_boundary(const Cells& cells) {
  int i = 0, j = 0;
  while (!cells.at(i, j)) {
    if (++i == cells.columns) {
      i = 0;
      ++j;
    }
  }
  // From the lower left corner of the lowest, leftmost cell along its lower side, the part always on the left.
  const std::array<int, 2> ways[] = {{1, 0}, {0, 1}, {-1, 0}, {0, -1}};
  const auto ahead = [&](int x, int y, int way, int side) {  // the cell beyond a corner, left (1) or right (-1)
    const auto [dx, dy] = ways[way];
    return cells.at(x - (dx - side * dy < 0), y - (dy + side * dx < 0));
  };
  std::vector<std::array<int, 2>> corners;
  int x = i, y = j, way = 0;
  do {
    corners.push_back({x, y});
    x += ways[way][0];
    y += ways[way][1];
    if (!ahead(x, y, way, 1)) {
      way = (way + 1) % 4;
    } else if (ahead(x, y, way, -1)) {
      way = (way + 3) % 4;
    }
  } while (x != i || y != j);
  return corners;
}

}  // namespace

Reach reach_of(const std::vector<Eigen::Vector2d>& points, double radius) {
  if (!(radius > 0)) throw InputError("the disc around which a reach is drawn needs a positive radius");
  Reach reach;
  if (points.empty()) return reach;
  constexpr double fineness = 24;  // cells per radius
  const double cell = radius / fineness;
  Eigen::Vector2d low = points[0], high = points[0];
  for (const Eigen::Vector2d& point : points) {
    low = low.cwiseMin(point);
    high = high.cwiseMax(point);
  }
  low.array() -= 2 * radius;
  high.array() += 2 * radius;
  Cells cells{static_cast<int>((high[0] - low[0]) / cell) + 1, static_cast<int>((high[1] - low[1]) / cell) + 1, {}};
  cells.set.assign(static_cast<size_t>(cells.columns) * static_cast<size_t>(cells.rows), 0);
  for (const Eigen::Vector2d& point : points)
    cells(static_cast<int>((point[0] - low[0]) / cell), static_cast<int>((point[1] - low[1]) / cell)) = 1;
  cells = grown(cells, fineness);
  invert(cells);  // where a disc's centre may be
  cells = grown(cells, fineness);
  invert(cells);
  reach.area = keep_largest(cells) * cell * cell;
  for (const auto& [x, y] : outer_boundary(cells)) reach.outline.emplace_back(low + cell * Eigen::Vector2d(x, y));
  return reach;
}

}  // namespace taut

#include "sim/robots/reach.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "sim/core/error.hpp"

namespace taut {
namespace {

/// Yes or no for each of the cells of a rectangle, (columns x rows).
using Cells = Eigen::Array<bool, Eigen::Dynamic, Eigen::Dynamic>;

/// No outside the rectangle.
bool at(const Cells& cells, int i, int j) {
  return i >= 0 && j >= 0 && i < cells.rows() && j < cells.cols() && cells(i, j);
}

/// Cells within `radius` cells of a set one.
Cells grown(const Cells& cells, double radius) {
  const int reach = static_cast<int>(radius), columns = static_cast<int>(cells.rows());
  Cells out = Cells::Constant(cells.rows(), cells.cols(), false);
  for (int j = 0; j < cells.cols(); ++j) {
    for (int i = 0; i < columns; ++i) {
      if (!cells(i, j)) continue;
      for (int l = std::max(0, j - reach); l <= j + reach && l < cells.cols(); ++l) {
        const int width = static_cast<int>(std::sqrt(radius * radius - (l - j) * (l - j)));
        const int first = std::max(0, i - width), last = std::min(columns - 1, i + width);
        out.col(l).segment(first, last - first + 1) = true;
      }
    }
  }
  return out;
}

/// The largest part whose cells share sides.
Cells largest_part(Cells cells) {
  Cells largest;
  Eigen::Index most = 0;
  for (int j = 0; j < cells.cols(); ++j) {
    for (int i = 0; i < cells.rows(); ++i) {
      if (!cells(i, j)) continue;
      Cells part = Cells::Constant(cells.rows(), cells.cols(), false);
      std::vector<std::array<int, 2>> open{{i, j}};
      while (!open.empty()) {
        const auto [k, l] = open.back();
        open.pop_back();
        if (!at(cells, k, l)) continue;
        cells(k, l) = false;
        part(k, l) = true;
        open.insert(open.end(), {{k + 1, l}, {k - 1, l}, {k, l + 1}, {k, l - 1}});
      }
      if (part.count() <= most) continue;
      most = part.count();
      largest = part;
    }
  }
  return largest;
}

/// Corners of the outer boundary of one part, in cells, the part on the left.
std::vector<std::array<int, 2>> outer_boundary(const Cells& cells) {
  int i = 0, j = 0;
  while (!cells(i, j)) {
    if (++i == cells.rows()) {
      i = 0;
      ++j;
    }
  }
  // From the lower left corner of the lowest, leftmost cell along its lower side, the part always on the left.
  const std::array<int, 2> ways[] = {{1, 0}, {0, 1}, {-1, 0}, {0, -1}};
  const auto ahead = [&](int x, int y, int way, int side) {  // the cell beyond a corner, left (1) or right (-1)
    const auto [dx, dy] = ways[way];
    return at(cells, x - (dx - side * dy < 0), y - (dy + side * dx < 0));
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
  const Eigen::Array2i size = ((high - low) / cell).cast<int>().array() + 1;
  Cells cells = Cells::Constant(size[0], size[1], false);
  for (const Eigen::Vector2d& point : points) {
    const Eigen::Vector2i place = ((point - low) / cell).cast<int>();
    cells(place[0], place[1]) = true;
  }
  cells = !grown(cells, fineness);  // where a disc's centre may be
  cells = largest_part(!grown(cells, fineness));
  reach.area = static_cast<double>(cells.count()) * cell * cell;
  for (const auto& [x, y] : outer_boundary(cells)) reach.outline.emplace_back(low + cell * Eigen::Vector2d(x, y));
  return reach;
}

}  // namespace taut

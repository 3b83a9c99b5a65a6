#include "sim/mesh/outline.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "sim/core/error.hpp"

namespace taut {
namespace {

using PlanePoint = std::array<double, 2>;

double cross(const PlanePoint& o, const PlanePoint& a, const PlanePoint& b) {
  return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]);
}

double distance(const PlanePoint& a, const PlanePoint& b) {
  return std::hypot(b[0] - a[0], b[1] - a[1]);
}

/// Position of `p` along segment ab in (0, 1) when it lies within `tolerance` of its interior, else -1.
double position_on(const PlanePoint& a, const PlanePoint& b, const PlanePoint& p, double tolerance) {
  const double length = distance(a, b);
  const double along = ((p[0] - a[0]) * (b[0] - a[0]) + (p[1] - a[1]) * (b[1] - a[1])) / (length * length);
  return along > 0.0 && along < 1.0 && std::abs(cross(a, b, p)) <= tolerance * length ? along : -1.0;
}

bool properly_cross(const PlanePoint& a, const PlanePoint& b, const PlanePoint& c, const PlanePoint& d) {
  const auto opposite = [](double s, double t) { return (s < 0.0 && t > 0.0) || (s > 0.0 && t < 0.0); };
  return opposite(cross(a, b, c), cross(a, b, d)) && opposite(cross(c, d, a), cross(c, d, b));
}

std::string in_mm(const PlanePoint& p) {
  return fmt::format("({:.6g}, {:.6g}) mm", 1e3 * p[0], 1e3 * p[1]);
}

class Builder {
 public:
  explicit Builder(const std::vector<PolygonRegion>& polygons) : polygons_(polygons) {}

  Outline build() {
    check_definitions();
    measure();
    join_points();
    for (size_t k = 0; k < polygons_.size(); ++k) check_simple(k);
    for (size_t k = 0; k < polygons_.size(); ++k) add_loop(k);
    check_overlaps();
    return std::move(outline_);
  }

 private:
  std::string name(size_t k) const { return fmt::format("polygon {} (region '{}')", k, polygons_[k].region); }
  int vertex(size_t k, size_t i) const { return vertices_[k][i % vertices_[k].size()]; }
  const PlanePoint& at(size_t k, size_t i) const { return outline_.points[vertex(k, i)]; }

  void check_definitions() const {
    if (polygons_.empty()) throw InputError("no polygons to mesh; give at least one");
    for (size_t k = 0; k < polygons_.size(); ++k) {
      const PolygonRegion& polygon = polygons_[k];
      if (polygon.region.empty()) throw InputError(fmt::format("polygon {} has no region name; give it one", k));
      if (polygon.vertices.size() < 3) {
        throw InputError(fmt::format("{} has {} vertices; at least 3 are needed", name(k), polygon.vertices.size()));
      }
      if (!polygon.edge_tags.empty() && polygon.edge_tags.size() != polygon.vertices.size()) {
        throw InputError(fmt::format("{} has {} edge tags for {} edges; give none or one per edge", name(k),
                                     polygon.edge_tags.size(), polygon.vertices.size()));
      }
      for (size_t i = 0; i < polygon.vertices.size(); ++i) {
        if (!std::isfinite(polygon.vertices[i][0]) || !std::isfinite(polygon.vertices[i][1])) {
          throw InputError(fmt::format("{}: vertex {} is not finite", name(k), i));
        }
      }
    }
  }

  void measure() {
    PlanePoint lower = polygons_[0].vertices[0];
    PlanePoint upper = lower;
    for (const PolygonRegion& polygon : polygons_) {
      for (const PlanePoint& p : polygon.vertices) {
        for (size_t i = 0; i < 2; ++i) {
          lower[i] = std::min(lower[i], p[i]);
          upper[i] = std::max(upper[i], p[i]);
        }
      }
    }
    outline_.lower = lower;
    outline_.diagonal = distance(lower, upper);
    outline_.area = 0.0;
    tolerance_ = 1e-9 * outline_.diagonal;
  }

  void join_points() {
    for (const PolygonRegion& polygon : polygons_) {
      vertices_.emplace_back();
      for (const PlanePoint& p : polygon.vertices) {
        const auto found = std::find_if(outline_.points.begin(), outline_.points.end(),
                                        [&](const PlanePoint& q) { return distance(p, q) <= tolerance_; });
        vertices_.back().push_back(static_cast<int>(found - outline_.points.begin()));
        if (found == outline_.points.end()) outline_.points.push_back(p);
      }
    }
  }

  void check_simple(size_t k) const {
    const size_t n = vertices_[k].size();
    for (size_t i = 0; i < n; ++i) {
      for (size_t j = i + 1; j < n; ++j) {
        if (vertex(k, i) != vertex(k, j)) continue;
        throw InputError(
            fmt::format("{}: vertices {} and {} coincide at {}; give each vertex once (the polygon closes "
                        "itself)",
                        name(k), i, j, in_mm(at(k, i))));
      }
    }
    size_t far = 1;
    for (size_t i = 2; i < n; ++i) {
      if (distance(at(k, 0), at(k, i)) > distance(at(k, 0), at(k, far))) far = i;
    }
    double width = 0.0;
    for (size_t i = 0; i < n; ++i) {
      width = std::max(width, std::abs(cross(at(k, 0), at(k, far), at(k, i))) / distance(at(k, 0), at(k, far)));
    }
    if (width <= tolerance_) {
      throw InputError(fmt::format("{} has zero area: vertices 0 to {} lie on one line", name(k), n - 1));
    }
    for (size_t i = 0; i < n; ++i) {
      for (size_t j = 0; j < n; ++j) {
        if (j == i || j == (i + 1) % n) continue;
        if (position_on(at(k, i), at(k, i + 1), at(k, j), tolerance_) >= 0.0) {
          throw InputError(fmt::format("{} touches itself: vertex {} lies on the edge from vertex {} to {}", name(k), j,
                                       i, (i + 1) % n));
        }
        if (j > i && properly_cross(at(k, i), at(k, i + 1), at(k, j), at(k, j + 1))) {
          throw InputError(
              fmt::format("{} crosses itself: the edge from vertex {} to {} and the edge from vertex {} to "
                          "{}; list the vertices in order around it",
                          name(k), i, (i + 1) % n, j, (j + 1) % n));
        }
      }
    }
  }

  void add_loop(size_t k) {
    const size_t n = vertices_[k].size();
    double area = 0.0;
    for (size_t i = 0; i < n; ++i) area += 0.5 * cross(at(k, 0), at(k, i), at(k, i + 1));
    outline_.area += std::abs(area);
    std::vector<int> loop;
    for (size_t i = 0; i < n; ++i) {
      std::vector<std::pair<double, int>> stops{{0.0, vertex(k, i)}, {1.0, vertex(k, i + 1)}};
      for (size_t p = 0; p < outline_.points.size(); ++p) {
        const int point = static_cast<int>(p);
        if (point == stops[0].second || point == stops[1].second) continue;
        const double along = position_on(at(k, i), at(k, i + 1), outline_.points[p], tolerance_);
        if (along >= 0.0) stops.emplace_back(along, point);
      }
      std::sort(stops.begin(), stops.end());
      for (size_t s = 0; s + 1 < stops.size(); ++s) {
        std::array<int, 2> ends{stops[s].second, stops[s + 1].second};
        if (area < 0.0) std::swap(ends[0], ends[1]);
        const int line = line_between(ends);
        loop.push_back(outline_.lines[line] == ends ? line + 1 : -(line + 1));
        if (!polygons_[k].edge_tags.empty()) add_tag(polygons_[k].edge_tags[i], line);
      }
    }
    if (area < 0.0) std::reverse(loop.begin(), loop.end());
    outline_.loops.push_back(std::move(loop));
  }

  int line_between(const std::array<int, 2>& ends) {
    const auto [found, added] = line_numbers_.try_emplace(std::minmax(ends[0], ends[1]), outline_.lines.size());
    if (added) outline_.lines.push_back(ends);
    return static_cast<int>(found->second);
  }

  void add_tag(const std::string& tag, int line) {
    if (tag.empty()) return;
    std::vector<int>& lines = outline_.tags[tag];
    // Both polygons of a shared edge may give it the same tag.
    if (std::find(lines.begin(), lines.end(), line) == lines.end()) lines.push_back(line);
  }

  const PlanePoint& end(int signed_line, size_t which) const {
    return outline_.points[outline_.lines[std::abs(signed_line) - 1][which]];
  }

  bool contains(size_t k, const PlanePoint& p) const {
    bool inside = false;
    for (size_t i = 0; i < vertices_[k].size(); ++i) {
      const PlanePoint& a = at(k, i);
      const PlanePoint& b = at(k, i + 1);
      if ((a[1] > p[1]) != (b[1] > p[1]) && p[0] < a[0] + (b[0] - a[0]) * (p[1] - a[1]) / (b[1] - a[1]))
        inside = !inside;
    }
    return inside;
  }

  [[noreturn]] void overlap(size_t k, size_t m, const PlanePoint& where) const {
    throw InputError(
        fmt::format("{} and {} overlap near {}; polygons may only share edges", name(k), name(m), in_mm(where)));
  }

  /// With lines split at every point on them, two polygons overlap exactly when lines cross, a line of one runs inside
  /// the other, or both lie on the same side of a shared line.
  void check_overlaps() const {
    for (size_t k = 0; k < outline_.loops.size(); ++k) {
      for (size_t m = 0; m < outline_.loops.size(); ++m) {
        if (k == m) continue;
        const std::vector<int>& other = outline_.loops[m];
        for (int line : outline_.loops[k]) {
          const PlanePoint& a = end(line, 0);
          const PlanePoint& b = end(line, 1);
          const PlanePoint middle{0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])};
          if (std::find(other.begin(), other.end(), line) != other.end()) overlap(k, m, middle);
          if (std::find(other.begin(), other.end(), -line) != other.end()) continue;
          for (int crossing : other) {
            if (properly_cross(a, b, end(crossing, 0), end(crossing, 1))) overlap(k, m, a);
          }
          if (contains(m, middle)) overlap(k, m, middle);
        }
      }
    }
  }

  const std::vector<PolygonRegion>& polygons_;
  Outline outline_{};
  double tolerance_ = 0.0;
  std::vector<std::vector<int>> vertices_;  ///< point numbers of each polygon's vertices
  std::map<std::pair<int, int>, size_t> line_numbers_;
};

}  // namespace

Outline outline_of(const std::vector<PolygonRegion>& polygons) {
  return Builder(polygons).build();
}

}  // namespace taut

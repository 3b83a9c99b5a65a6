#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "sim/core/error.hpp"
#include "sim/mesh/mesh_budget.hpp"
#include "sim/mesh/structured.hpp"
#include "sim/shapes/push_puppet.hpp"

namespace taut {
namespace {

/// End points of `cells` equal steps from `first` to `last`, both exact.
std::vector<double> spread(double first, double last, int cells) {
  std::vector<double> lines{first};
  step_to(lines, last, cells);
  return lines;
}

/// `cells` elements over segments between `breaks`: each more goes where elements are longest. Along a segment the
/// first element is longer than the mean by about the fraction `skew` and the last one shorter.
std::vector<double> spread_over(const std::vector<double>& breaks, int cells, double skew = 0) {
  const size_t segments = breaks.size() - 1;
  std::vector<int> counts(segments, 1);
  for (int left = cells - static_cast<int>(segments); left > 0; --left) {
    size_t longest = 0;
    for (size_t s = 1; s < segments; ++s) {
      // The margin keeps the choice between equal segments from hanging on rounding.
      const double mine = (breaks[s + 1] - breaks[s]) / counts[s];
      if (mine > (1.0 + 1e-9) * (breaks[longest + 1] - breaks[longest]) / counts[longest]) longest = s;
    }
    ++counts[longest];
  }
  std::vector<double> lines{breaks[0]};
  for (size_t s = 0; s < segments; ++s) {
    for (int i = 1; i < counts[s]; ++i) {
      const double t = static_cast<double>(i) / counts[s];
      lines.push_back(breaks[s] + (breaks[s + 1] - breaks[s]) * t * (1.0 + skew * (1.0 - t)));
    }
    lines.push_back(breaks[s + 1]);
  }
  return lines;
}

/// Heights of a face's nodes: with quadratic elements there is one halfway between its lines as well.
std::vector<double> nodes_of_face(const std::vector<double>& lines, int order) {
  std::vector<double> nodes{lines[0]};
  for (size_t i = 1; i < lines.size(); ++i) {
    if (order == 2) nodes.push_back(0.5 * (lines[i - 1] + lines[i]));
    nodes.push_back(lines[i]);
  }
  return nodes;
}

/// Smallest distance between a node of one face and a node of the other, in units of the smaller mean spacing.
double misalignment(const std::vector<double>& a, const std::vector<double>& b) {
  double nearest = std::abs(a.front() - b.front());
  for (size_t i = 0, j = 0; i < a.size() && j < b.size(); a[i] < b[j] ? ++i : ++j)  // both go upwards
    nearest = std::min(nearest, std::abs(a[i] - b[j]));
  const auto mean = [](const std::vector<double>& y) {
    return (y.back() - y.front()) / static_cast<double>(y.size() - 1);
  };
  return nearest / std::min(mean(a), mean(b));
}

struct FacingLines {
  std::vector<double> left, right;  ///< of the end faces of a left and a right lip
};

/// Lines of two faces that meet, whose nodes keep apart. The right one has twice as many cells and one more, so that
/// refining one refines the other; where nodes happen to align all the same (the middle ones of two quadratic faces
/// always do), a few more lines or somewhat uneven ones.
FacingLines lines_apart(const std::vector<double>& left_breaks, int left_cells, const std::vector<double>& right_breaks,
                        int order) {
  constexpr double enough = 0.05;  // of the spacing
  FacingLines chosen;
  double best = -1.0;
  for (const double left_skew : {0.0, -0.1, -0.2}) {
    const std::vector<double> left = spread_over(left_breaks, left_cells, left_skew);
    for (int skew = 0; skew <= 6; ++skew) {
      for (int more = 1; more <= 4; ++more) {
        std::vector<double> right = spread_over(right_breaks, 2 * left_cells + more, 0.05 * skew);
        const double apart = misalignment(nodes_of_face(left, order), nodes_of_face(right, order));
        if (apart > best) {
          best = apart;
          chosen = {left, std::move(right)};
        }
        if (best > enough) return chosen;
      }
    }
  }
  return chosen;
}

/// Heights of the nodes of the upper side: webs carry all of them, foam and lips a part each.
struct Lines {
  Lines(const PushPuppet& m, const PushPuppetMesh& mesh, double inset) {
    const PushPuppetLayout at(m);
    std::vector<double> thin_breaks{at.thin_low, at.thin_high};
    std::vector<double> thick_breaks{at.lip_low, at.lip_high};
    if (m.stud_length > 0.0) {
      const double tongue = 0.5 * m.stud_thickness - inset;
      const double groove = 0.5 * m.stud_thickness + m.stud_play + inset;
      thin_breaks.insert(thin_breaks.begin() + 1, {at.middle - tongue, at.middle + tongue});
      thick_breaks.insert(thick_breaks.begin() + 1, {at.middle - groove, at.middle + groove});
    }
    thin_cells = cells_along(at.thin_high - at.thin_low, mesh.size,
                             std::max(mesh.lip_cells, static_cast<int>(thin_breaks.size()) - 1));
    // Without relief both lips of a web have the same lines.
    FacingLines ends = m.lip_relief > 0.0
                           ? lines_apart(thin_breaks, thin_cells, thick_breaks, mesh.order)
                           : FacingLines{spread_over(thin_breaks, thin_cells), spread_over(thick_breaks, thin_cells)};
    thin_end = std::move(ends.left);
    thick_end = std::move(ends.right);
    const int relief_cells = static_cast<int>(thick_end.size()) - 1 - thin_cells;  // of both strips
    low_relief_cells = relief_cells / 2;

    web = spread(0.0, 0.5 * m.core_height, cells_along(0.5 * m.core_height, mesh.size));
    foam_cells = static_cast<int>(web.size()) - 1;
    step_to(web, at.lip_low, cells_along(m.clearance, mesh.size));
    lip_start = static_cast<int>(web.size()) - 1;
    if (relief_cells > 0) step_to(web, at.thin_low, low_relief_cells);
    step_to(web, at.thin_high, thin_cells);
    if (relief_cells > 0) step_to(web, at.lip_high, relief_cells - low_relief_cells);
  }

  std::vector<double> web;        ///< from the axis up
  std::vector<double> thin_end;   ///< end face of left lips
  std::vector<double> thick_end;  ///< end face of right lips (with a groove: where it begins)
  int foam_cells;
  int lip_start;  ///< index in `web` of the lower side of right lips
  int low_relief_cells;
  int thin_cells;
};

/// Puts the upper half together from blocks of columns and reflects it: the mesh is symmetric to the last digit.
class Builder {
 public:
  using Column = std::vector<int>;  ///< nodes, upwards

  Column column(double x, const std::vector<double>& heights) {
    Column nodes;
    for (double y : heights) {
      nodes.push_back(static_cast<int>(nodes_.size()));
      nodes_.emplace_back(x, y);
    }
    return nodes;
  }

  /// `count` more columns from `start` on to `end_x`, `end_heights`; lines move linearly. The last one is returned.
  Column extrude(Column start, double end_x, const std::vector<double>& end_heights, int count, int region) {
    const std::vector<double> xs = spread(nodes_[start[0]].x(), end_x, count);
    std::vector<double> start_heights;
    for (int node : start) start_heights.push_back(nodes_[node].y());
    std::vector<Column> columns{std::move(start)};
    for (int i = 1; i <= count; ++i) {
      std::vector<double> heights;
      for (size_t j = 0; j < end_heights.size(); ++j) {
        heights.push_back(i == count ? end_heights[j]
                                     : start_heights[j] + (end_heights[j] - start_heights[j]) * i / count);
      }
      columns.push_back(column(xs[i], heights));
    }
    fill(columns, region);
    return columns.back();
  }

  /// Quadrangles between neighbouring columns, each cut in two; diagonals alternate.
  void fill(const std::vector<Column>& columns, int region) {
    for (size_t i = 0; i + 1 < columns.size(); ++i) {
      // Lips may also be built from right to left.
      const bool rightwards = nodes_[columns[i][0]].x() < nodes_[columns[i + 1][0]].x();
      const Column& left = rightwards ? columns[i] : columns[i + 1];
      const Column& right = rightwards ? columns[i + 1] : columns[i];
      for (size_t j = 0; j + 1 < left.size(); ++j) {
        const int a = left[j];
        const int b = right[j];
        const int c = right[j + 1];
        const int d = left[j + 1];
        if ((i + j) % 2 == 0) {
          elements_.insert(elements_.end(), {a, b, c, a, c, d});
        } else {
          elements_.insert(elements_.end(), {a, b, d, b, c, d});
        }
        region_.insert(region_.end(), 2, region);
      }
    }
  }

  Mesh reflected() {
    std::vector<int> image;
    const size_t upper_nodes = nodes_.size();
    for (size_t i = 0; i < upper_nodes; ++i) {
      const Eigen::Vector2d p = nodes_[i];
      image.push_back(p.y() == 0.0 ? static_cast<int>(i) : static_cast<int>(nodes_.size()));
      if (p.y() != 0.0) nodes_.emplace_back(p.x(), -p.y());
    }
    const size_t upper_elements = elements_.size();
    for (size_t k = 0; k < upper_elements; k += 3) {
      const int a = image[elements_[k]];
      const int b = image[elements_[k + 1]];
      const int c = image[elements_[k + 2]];
      elements_.insert(elements_.end(), {a, c, b});
    }
    region_.insert(region_.end(), region_.begin(), region_.begin() + static_cast<long>(upper_elements / 3));
    Mesh mesh;
    mesh.shape = ElementShape::tri3;
    mesh.X.resize(2 * nodes_.size());
    for (size_t i = 0; i < nodes_.size(); ++i) mesh.X.segment<2>(2 * i) = nodes_[i];
    mesh.elements = std::move(elements_);
    mesh.region = std::move(region_);
    return mesh;
  }

 private:
  std::vector<Eigen::Vector2d> nodes_;
  std::vector<int> elements_;
  std::vector<int> region_;
};

constexpr int foam = 0;
constexpr int plastic = 1;

/// `count` entries of `column` from the `first` on.
Builder::Column slice(const Builder::Column& column, int first, int count) {
  return {column.begin() + first, column.begin() + first + count};
}

void add_foam(Builder& builder, const Builder::Column& left, const Builder::Column& right,
              const std::vector<double>& xs, const std::vector<double>& heights) {
  std::vector<Builder::Column> columns{left};
  for (size_t i = 1; i + 1 < xs.size(); ++i) columns.push_back(builder.column(xs[i], heights));
  columns.push_back(right);
  builder.fill(columns, foam);
}

/// A lip from the nodes of its web to its end face; `towards` is the sign of x in which it reaches.
class LipBuilder {
 public:
  LipBuilder(Builder& builder, const PushPuppet& module, const PushPuppetMesh& mesh, double inset, const Lines& lines)
      : builder_(builder), module_(module), mesh_(mesh), inset_(inset), lines_(lines), at_(module) {}

  void left(const Builder::Column& web, double web_x) {
    const double face = web_x + at_.lip_length - inset_;
    const int first = lines_.lip_start + lines_.low_relief_cells;
    const Builder::Column end = builder_.extrude(slice(web, first, lines_.thin_cells + 1), face, lines_.thin_end,
                                                 cells_along(face - web_x, mesh_.size), plastic);
    if (at_.groove_depth == 0.0) return;
    const double tongue = 0.5 * module_.stud_thickness - inset_;
    carry_on(end, lines_.thin_end, at_.middle - tongue, at_.middle + tongue, face + module_.stud_length);
  }

  void right(const Builder::Column& web, double web_x) {
    const double face = web_x - at_.lip_length + inset_;
    const double body = face + at_.groove_depth;  // the groove's bottom
    const int count = static_cast<int>(lines_.thick_end.size());
    const Builder::Column end = builder_.extrude(slice(web, lines_.lip_start, count), body, lines_.thick_end,
                                                 cells_along(web_x - body, mesh_.size), plastic);
    if (at_.groove_depth == 0.0) return;
    const double groove = 0.5 * module_.stud_thickness + module_.stud_play + inset_;
    carry_on(end, lines_.thick_end, at_.lip_low, at_.middle - groove, face);
    carry_on(end, lines_.thick_end, at_.middle + groove, at_.lip_high, face);
  }

 private:
  /// The part of `from` between two of its heights goes straight on to `to_x`.
  void carry_on(const Builder::Column& from, const std::vector<double>& heights, double low, double high, double to_x) {
    const auto nearest = [&](double y) {
      const auto nearer = [y](double a, double b) { return std::abs(a - y) < std::abs(b - y); };
      return static_cast<int>(std::min_element(heights.begin(), heights.end(), nearer) - heights.begin());
    };
    const int first = nearest(low);
    const int last = nearest(high);
    const double length = at_.groove_depth;
    builder_.extrude(slice(from, first, last - first + 1), to_x, {heights.begin() + first, heights.begin() + last + 1},
                     cells_along(length, mesh_.size, 2), plastic);
  }

  Builder& builder_;
  const PushPuppet& module_;
  const PushPuppetMesh& mesh_;
  double inset_;
  const Lines& lines_;
  PushPuppetLayout at_;
};

}  // namespace

void check_resolution(const PushPuppet& m, const PushPuppetMesh& mesh, double inset) {
  if (!(mesh.size > 0.0) || !std::isfinite(mesh.size)) {
    refuse_module(fmt::format("element size {}; a positive length is needed", in_mm(mesh.size)));
  }
  if (mesh.lip_cells < 1) refuse_module(fmt::format("{} elements through a lip; at least 1 is needed", mesh.lip_cells));
  if (mesh.order != 1 && mesh.order != 2)
    refuse_module(fmt::format("element order {}; 1 and 2 are allowed", mesh.order));
  if (!(inset >= 0.0) || inset >= m.via_inset) {
    refuse_module(
        fmt::format("the lips' ends are to be {} shorter, past the via points via_inset {} inside them; allowed are 0 "
                    "up to less than via_inset",
                    in_mm(inset), in_mm(m.via_inset)));
  }
  // At least so many in the lips, before any of them is placed.
  const double along = std::max(2.0, PushPuppetLayout(m).lip_length / mesh.size);
  require_mesh(4.0 * m.cells * mesh.lip_cells * along, 2, mesh.order);
  if (m.stud_length <= 0.0) return;
  const double groove = m.stud_thickness + 2.0 * (m.stud_play + inset);
  if (2.0 * inset >= m.stud_thickness || groove >= m.lip_thickness) {
    refuse_module(
        fmt::format("{} taken off every face leaves nothing of a stud of {} or beside a groove of {} in a lip of {}; "
                    "take less off",
                    in_mm(inset), in_mm(m.stud_thickness), in_mm(groove), in_mm(m.lip_thickness)));
  }
}

Mesh mesh_push_puppet(const PushPuppet& module, const PushPuppetMesh& settings, double inset) {
  module.check();
  check_resolution(module, settings, inset);
  const PushPuppetLayout at(module);
  const Lines lines(module, settings, inset);
  require_mesh(4.0 * module.cells *
                   (static_cast<double>(lines.foam_cells) * cells_along(module.cell_length, settings.size, 2) +
                    static_cast<double>(lines.thin_cells) * cells_along(0.5 * at.lip_length, settings.size) +
                    2.0 * static_cast<double>(lines.web.size() - 1)),
               2, settings.order);
  const std::vector<double> foam_lines(lines.web.begin(), lines.web.begin() + lines.foam_cells + 1);
  const int foam_columns = cells_along(module.cell_length, settings.size, 2);
  Builder builder;
  LipBuilder lips(builder, module, settings, inset, lines);

  const auto wall = [&](double left, double right) {  // a web or a plate: its two faces
    Builder::Column start = builder.column(left, lines.web);
    Builder::Column end =
        builder.extrude(start, right, lines.web, cells_along(right - left, settings.size, 2), plastic);
    return std::pair{std::move(start), std::move(end)};
  };
  auto [base, face] = wall(-module.plate_thickness, 0.0);
  const double tip_x = module.cells * at.pitch - module.web_thickness + module.plate_thickness;
  for (int k = 0; k < module.cells; ++k) {
    const double left = k * at.pitch;
    const double right = left + module.cell_length;
    const bool last = k + 1 == module.cells;
    auto [near, far] = wall(right, last ? tip_x : (k + 1) * at.pitch);
    add_foam(builder, slice(face, 0, lines.foam_cells + 1), slice(near, 0, lines.foam_cells + 1),
             spread(left, right, foam_columns), foam_lines);
    lips.left(face, left);
    lips.right(near, right);
    face = std::move(far);
  }

  // Brackets go on from the plates' outer faces, as far up as half their height.
  const auto bracket = [&](const Builder::Column& plate, double from, double to) {
    if (from == to) return;
    const auto above = std::lower_bound(lines.web.begin(), lines.web.end(), 0.5 * module.bracket_height - 1e-9);
    const int count = static_cast<int>(above - lines.web.begin()) + 1;
    builder.extrude(slice(plate, 0, count), to, {lines.web.begin(), lines.web.begin() + count},
                    cells_along(std::abs(to - from), settings.size, 2), plastic);
  };
  bracket(base, -module.plate_thickness, -module.plate_thickness - module.base_bracket);
  bracket(face, tip_x, tip_x + module.tip_bracket);

  Mesh mesh = builder.reflected();
  mesh.region_names = {"foam", "plastic"};
  const Tag outer = boundary(mesh);
  // Exact: a face is one column of nodes, all of which got the same number.
  for (const auto& [name, x] : {std::pair{"base", -module.plate_thickness}, std::pair{"tip", tip_x}})
    mesh.tags[name] = outer.where([&, at = x](int node) { return mesh.X[2 * node] == at; });
  mesh.check("push-puppet module");
  return settings.order == 1 ? mesh : to_quadratic(mesh);
}

}  // namespace taut

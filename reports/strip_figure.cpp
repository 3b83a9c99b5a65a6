#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "reports/simulation_figures.hpp"
#include "reports/surface.hpp"

namespace taut::plot {
namespace {

constexpr double kGap = 10, kHeading = 24, kTallest = 760;  // px
constexpr double kEdge = 16;                                // of the page, px
constexpr double kOverlap = 8e-4;                           // of the facets, relative to the window's diagonal
constexpr const char* kFaint = "#b0b0b0";

/// How many panels there are, and how large each is [px].
struct Layout {
  size_t count, columns;
  double across, tall;
};

/// As many columns as make the panels largest; `shape` is height over width of the window. Slender windows get eight
/// panels, others six.
Layout layout_of(size_t frames, double shape, double available) {
  Layout best{std::min<size_t>(frames, shape > 1.5 ? 8 : 6), 1, 0, 0};
  for (size_t columns = best.count; columns >= 1; --columns) {
    Layout layout{best.count, columns, 0, 0};
    const double n = static_cast<double>(columns), rows = static_cast<double>(row_count(best.count, columns));
    layout.across = (available - kGap * (n - 1)) / n;
    layout.across = std::min(layout.across, (kTallest - rows * kHeading) / (rows * shape));
    layout.tall = layout.across * shape;
    // A layout with fewer columns must be clearly larger: states beside each other are easier to compare.
    if (layout.across > 1.15 * best.across) best = layout;
  }
  return best;
}

/// What a panel shows, in the plane of the picture [m].
class Picture {
 public:
  explicit Picture(const SimulationRecord& record)
      : record_(record),
        surface_(boundary_surface(record.mesh)),
        view_(isometric_view()),
        flat_(record.mesh.dimension() == 2) {
    const Bounds bounds = bounds_of(record);
    bounds_ = bounds;
    if (flat_) {
      window_ = bounds;
    } else {
      for (const Eigen::VectorXd& u : record.states) include(record.mesh.X + u);
      for (const DrawnLine& line : record.lines) {
        for (const Eigen::VectorXd& u : record.states) include(positions(line, record.mesh, u).reshaped());
      }
      for (size_t frame = 0; frame < (grounds_move(record) ? record.states.size() : 1); ++frame) {
        for (const auto& [from, to] : ground_strokes(record, bounds, frame, GroundsDrawn::round)) {
          if (bounds.holds(from)) include(from);
        }
      }
    }
    const double room = 0.05 * window_.diagonal();
    window_.lower.array() -= room;
    window_.upper.array() += room;
  }

  const Bounds& window() const { return window_; }
  bool flat() const { return flat_; }

  /// Plots of one state in the order of painting; their numbers go to `csv` after `sample`.
  Plots plots(Page& page, size_t frame, double sample, std::string& csv) const {
    Plots list;
    const Eigen::VectorXd& u = record_.states[frame];
    const Eigen::MatrixXd x = positions(surface_, record_.mesh, u);
    const bool round_in_front = !flat_ && is_in_front(frame, x);
    if (!flat_) add_strokes(page, frame, round_in_front ? GroundsDrawn::planes : GroundsDrawn::all, list);
    flat_ ? add_areas(page, x, frame, sample, csv, list) : add_facets(page, x, sample, csv, list);
    for (size_t i = 0; i < record_.lines.size(); ++i) {
      const Eigen::MatrixXd points = seen(positions(record_.lines[i], record_.mesh, u));
      page.add(list, rows_of(points), "lines lw 1.6", line_colour(i, record_.lines.size()));
      add_lines("line", record_.lines[i].id, points, sample, csv);
    }
    if (flat_) add_strokes(page, frame, GroundsDrawn::all, list);
    if (round_in_front) add_strokes(page, frame, GroundsDrawn::round, list);
    for (const std::vector<Eigen::VectorXd>& obstacle : record_.obstacles) {
      Eigen::MatrixXd points(record_.mesh.dimension(), static_cast<Eigen::Index>(obstacle.size()));
      for (size_t i = 0; i < obstacle.size(); ++i) points.col(static_cast<Eigen::Index>(i)) = obstacle[i];
      page.add(list, rows_of(seen(points)), "lines lw 3", kObstacle);
    }
    return list;
  }

  std::vector<LegendEntry> legend() const {
    std::vector<LegendEntry> entries;
    for (size_t r = 0; r < record_.mesh.region_names.size(); ++r) {
      entries.push_back(
          {LegendEntry::area, record_.mesh.region_names[r], body_colour(record_.mesh.region_names[r], r)});
    }
    const size_t lines = record_.lines.size();
    for (size_t i = 0; i < lines; ++i) {
      if (!lines_are_told_apart(lines) && i > 0) break;
      entries.push_back(
          {LegendEntry::line, lines_are_told_apart(lines) ? record_.lines[i].id : "cables", line_colour(i, lines)});
    }
    if (flat_ && record_.states.size() > 1) entries.push_back({LegendEntry::line, "outline at the start", kFaint});
    if (!record_.grounds.empty())
      entries.push_back({flat_ ? LegendEntry::hatch : LegendEntry::line, "ground", kGround});
    if (!record_.obstacles.empty()) entries.push_back({LegendEntry::line, "obstacle", kObstacle});
    return entries;
  }

  /// The directions x, y, z at a place on the page [px] as gnuplot arrows and labels.
  std::string axes(double left, double up, double page_height) const {
    std::string text;
    const auto screen = [&](const Eigen::Vector3d& p) {
      return fmt::format("screen {:.5f},{:.5f}", (left + p.x()) / kPageWidth, (up + p.y()) / page_height);
    };
    for (int c = 0; c < 3; ++c) {
      const Eigen::Vector3d along = 26 * view_(Eigen::Vector3d::Unit(c));
      text += fmt::format("set arrow from {} to {} head filled size screen 0.006,20 lw 1.2 lc rgb '{}'\n",
                          screen(Eigen::Vector3d::Zero()), screen(along), kGrey);
      text += fmt::format("set label '{}' at {} center font ',12' tc rgb '{}'\n", "xyz"[c], screen(1.5 * along), kGrey);
    }
    return text;
  }

 private:
  void include(const Eigen::VectorXd& stacked) {
    for (Eigen::Index i = 0; i + 3 <= stacked.size(); i += 3) {
      window_.include(view_(Eigen::Vector3d(stacked.segment<3>(i))).head<2>());
    }
  }

  /// Columns as right, up and, in space, towards the viewer.
  Eigen::MatrixXd seen(const Eigen::MatrixXd& x) const {
    if (flat_) return x;
    Eigen::MatrixXd out(3, x.cols());
    for (Eigen::Index i = 0; i < x.cols(); ++i) out.col(i) = view_(Eigen::Vector3d(x.col(i)));
    return out;
  }

  void add_lines(const char* kind, const std::string& name, const Eigen::MatrixXd& points, double sample,
                 std::string& csv, int part = 0) const {
    for (const auto& p : points.colwise()) {
      const double right = p[0] / kMillimetre, up = p[1] / kMillimetre;
      csv += flat_ ? line(sample, kind, name, part, right, up)
                   : line(sample, kind, name, part, right, up, p[2] / kMillimetre);
    }
  }

  /// Whether what is round is nearer to the viewer than the bodies, by their middles.
  bool is_in_front(size_t frame, const Eigen::MatrixXd& x) const {
    double sum = 0;
    const auto strokes = ground_strokes(record_, bounds_, frame, GroundsDrawn::round);
    for (const auto& [from, to] : strokes) sum += view_.toward.dot(from);
    return !strokes.empty() && sum / static_cast<double>(strokes.size()) > view_.toward.dot(x.rowwise().mean());
  }

  void add_strokes(Page& page, size_t frame, GroundsDrawn which, Plots& list) const {
    Rows rows;
    for (const auto& [from, to] : ground_strokes(record_, bounds_, frame, which)) {
      Eigen::MatrixXd ends(from.size(), 2);
      ends << from, to;
      append(rows, rows_of(seen(ends)));
    }
    if (!rows.empty()) page.add(list, rows, flat_ ? "lines lw 1.2" : "lines lw 0.6", kGround);
  }

  static Rows rows_of(const Eigen::MatrixXd& x) { return rows_in(kMillimetre, x.colwise()); }

  Rows outlines(const Eigen::MatrixXd& x) const {
    Rows rows;
    for (const Surface::Loop& loop : surface_.loops) append(rows, closed(rows_of(x(Eigen::all, loop.points))));
    return rows;
  }

  /// Regions, each as one line through all of its loops: what leads from loop to loop and back encloses nothing, and
  /// holes run the other way around, so they stay open.
  void add_areas(Page& page, const Eigen::MatrixXd& x, size_t frame, double sample, std::string& csv,
                 Plots& list) const {
    if (frame > 0)
      page.add(list, outlines(positions(surface_, record_.mesh, record_.states.front())), "lines lw 1", kFaint);
    for (size_t r = 0; r < record_.mesh.region_names.size(); ++r) {
      const std::string& region = record_.mesh.region_names[r];
      std::vector<int> path;
      int part = 0;
      for (const Surface::Loop& loop : surface_.loops) {
        if (loop.region != static_cast<int>(r)) continue;
        path.insert(path.end(), loop.points.begin(), loop.points.end());
        path.push_back(loop.points.front());
        if (part > 0) path.push_back(path.front());
        add_lines("outline", region, x(Eigen::all, loop.points), sample, csv, ++part);
      }
      page.add(list, rows_of(x(Eigen::all, path)), kFilled, body_colour(region, r));
    }
    page.add(list, outlines(x), "lines lw 0.8", kBlack);
  }

  void add_facets(Page& page, const Eigen::MatrixXd& x, double sample, std::string& csv, Plots& list) const {
    const Eigen::MatrixXd plane = seen(x);
    Rows rows;
    int part = 0;
    for (const Painted& facet : painted(surface_, x, view_)) {
      const Surface::Triangle& triangle = surface_.triangles[static_cast<size_t>(facet.triangle)];
      const std::string& region = record_.mesh.region_names[static_cast<size_t>(triangle.region)];
      const std::string base = body_colour(region, static_cast<size_t>(triangle.region));
      int colour = 0;
      for (size_t c = 1; c < 7; c += 2) {
        const double channel = facet.brightness * std::stoi(base.substr(c, 2), nullptr, 16);
        colour = 256 * colour + static_cast<int>(std::lround(channel));
      }
      Eigen::MatrixXd corners = plane(Eigen::all, triangle.points);
      add_lines("facet", region, corners, sample, csv, ++part);
      // A little larger, or the background would shine through between neighbours.
      const Eigen::Vector3d middle = corners.rowwise().mean();
      for (int i = 0; i < 3; ++i) {
        const Eigen::Vector3d outward = corners.col(i) - middle;
        corners.col(i) += kOverlap * window_.diagonal() * outward.normalized();
      }
      append(rows, rows_of(corners));
      for (auto row = rows.rbegin() + 1; row != rows.rbegin() + 4; ++row) row->push_back(colour);
    }
    if (!rows.empty()) list.push_back(fmt::format("{} using 1:2:3 with {} fc rgb variable", page.data(rows), kFilled));
  }

  const SimulationRecord& record_;
  Surface surface_;
  View view_;
  bool flat_;
  Bounds window_;
  Bounds bounds_;
};

/// A legend along lines below the title.
class FlowingLegend {
 public:
  explicit FlowingLegend(std::vector<LegendEntry> entries) : entries_(std::move(entries)) {
    double at = kEdge, down = 8;
    for (const LegendEntry& entry : entries_) {
      const double needed = legend_width({entry});
      if (at + needed > kPageWidth - kEdge) {
        at = kEdge;
        down += kLegendRow;
      }
      places_.emplace_back(at, down);
      at += needed + 8;
    }
    height_ = down + 18;
  }

  double height() const { return height_; }

  /// Below `top`.
  void draw(Page& page, double top) const {
    for (size_t i = 0; i < entries_.size(); ++i) page.legend(places_[i].first, top - places_[i].second, {entries_[i]});
  }

 private:
  std::vector<LegendEntry> entries_;
  std::vector<std::pair<double, double>> places_;  ///< from the left and downwards [px]
  double height_;
};

/// A bar of a round length, `millimetres` or `pixels` long, at the lower edge of the page: all panels have its scale.
void add_scale_bar(Page& page, double millimetres, double pixels, const std::string& more) {
  page.panel(
      {kPageWidth - kEdge - pixels, 20, kPageWidth - kEdge, 21}, {"", 0, 1, 1}, {"", 0, 1, 1}, "", {},
      fmt::format("unset tics\nunset border\nset arrow from graph 0,0 to graph 1,0 heads size screen 0.004,90 lw "
                  "2 lc rgb '{0}'\nset label '{1:g} mm' at graph 0,0 right offset -1,0 font ',12' tc rgb '{0}'\n",
                  kGrey, millimetres) +
          more);
}

}  // namespace

Drawing strip(const SimulationRecord& record) {
  const Picture picture(record);
  const Eigen::VectorXd lower = picture.window().lower / kMillimetre, upper = picture.window().upper / kMillimetre;
  const double width = upper[0] - lower[0], left = picture.flat() ? 76 : kEdge;
  const Layout layout = layout_of(record.states.size(), (upper[1] - lower[1]) / width, kPageWidth - left - kEdge);
  const std::vector<size_t> chosen = evenly_chosen(record.states.size(), layout.count);
  const FlowingLegend legend(picture.legend());
  Grid grid({.left = left,
             .gap = kGap,
             .above = kHeading,
             .below = 0,
             .head = legend.height(),
             .foot = picture.flat() ? 58.0 : 74.0},
            {}, layout.columns);
  grid.across = layout.across;
  grid.panels(layout.count, layout.tall);
  Page page(kPageWidth, grid.height, "Simulation: states of the run, to one scale", record.title, false);
  legend.draw(page, grid.height - kTitle);

  Axis x{"", lower[0], upper[0]}, y{"", lower[1], upper[1]};
  x.step = y.step = std::max(axis_over({x.low, x.high}, "", static_cast<int>(layout.across / 70), false).step,
                             axis_over({y.low, y.high}, "", 4, false).step);
  const SampleLabel sample_label(record);
  const Series* driver = driver_of(record);
  const WrittenUnit written = written_unit(record.sample_unit);
  std::string csv = fmt::format("{},kind,name,part,{}\n", field(record.sample_name + "_" + written.suffix),
                                picture.flat() ? "x_mm,y_mm" : "right_mm,up_mm,toward_viewer_mm");
  for (size_t i = 0; i < chosen.size(); ++i) {
    const double sample = record.samples[static_cast<size_t>(record.frames[chosen[i]])];
    const Plots plots = picture.plots(page, chosen[i], sample / written.factor, csv);
    std::string extra = "unset grid\nset clip two\n";
    x.label = picture.flat() ? "x [mm]" : "";
    y.label = picture.flat() ? "y [mm]" : "";
    extra += picture.flat() ? outer_labels(x, y, i + layout.columns >= chosen.size(), grid.leftmost(i))
                            : "unset tics\nset border 15 lc rgb '#dddddd'\n";
    const std::string title =
        driver != nullptr
            ? label_of(*driver) + " " + shown_value(*driver, static_cast<size_t>(record.frames[chosen[i]]))
            : record.sample_name + " " + sample_label(sample);
    page.panel(grid.box(i), x, y, title, plots, extra);
  }
  if (!picture.flat()) add_scale_bar(page, x.step, x.step * layout.across / width, picture.axes(44, 26, grid.height));
  std::string caption = fmt::format(
      "{} of {} stored states from the start to the end of the run, in one window and at one scale; above each "
      "stands its {}.",
      chosen.size(), record.states.size(), driver != nullptr ? label_of(*driver) : record.sample_name);
  caption += picture.flat() ? "" : " Seen from above at a corner (isometric), without perspective.";
  return Drawing{{"strip", "states of the run, to one scale", caption}, csv, page};
}

}  // namespace taut::plot

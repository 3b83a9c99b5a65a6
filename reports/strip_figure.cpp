#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "reports/simulation_figures.hpp"
#include "reports/surface.hpp"

namespace taut::plot {
namespace {

constexpr double kGap = 10, kHeading = 24, kTallest = 760;  // px
constexpr double kOverlap = 8e-4;                           // of the facets, relative to the window's diagonal
constexpr const char* kFaint = "#b0b0b0";

/// Where the panels stand on the page.
struct Layout {
  size_t count, columns;
  double across, tall;  ///< of each panel, px
  size_t rows() const { return (count + columns - 1) / columns; }
};

/// As many columns as make the panels largest; `shape` is height over width of the window. Slender windows get eight
/// panels, others six.
Layout layout_of(size_t frames, double shape, double available) {
  Layout best{std::min<size_t>(frames, shape > 1.5 ? 8 : 6), 1, 0, 0};
  for (size_t columns = best.count; columns >= 1; --columns) {
    Layout layout{best.count, columns, 0, 0};
    const double n = static_cast<double>(columns), rows = static_cast<double>(layout.rows());
    layout.across = (available - kGap * (n - 1)) / n;
    layout.across = std::min(layout.across, (kTallest - rows * kHeading) / (rows * shape));
    layout.tall = layout.across * shape;
    // A layout with fewer columns must be clearly larger: states beside each other are easier to compare.
    if (layout.across > 1.15 * best.across) best = layout;
  }
  return best;
}

std::vector<std::vector<double>> millimetres_of(const Eigen::MatrixXd& x) {
  std::vector<std::vector<double>> rows;
  for (const auto& point : x.colwise()) rows.push_back({point[0] / kMillimetre, point[1] / kMillimetre});
  return rows;
}

/// What a panel shows, in the plane of the picture [m].
class Picture {
 public:
  explicit Picture(const SimulationRecord& record)
      : record_(record),
        surface_(surface_of(record.mesh)),
        view_(isometric_view()),
        flat_(record.mesh.dimension() == 2) {
    const Bounds bounds = bounds_of(record);
    strokes_ = ground_strokes(record, bounds);
    if (flat_) {
      window_ = bounds;
    } else {
      for (const Eigen::VectorXd& u : record.states) include(record.mesh.X + u);
      for (const DrawnLine& line : record.lines) {
        for (const Eigen::VectorXd& u : record.states) include(positions(line, record.mesh, u).reshaped());
      }
    }
    const double room = 0.05 * window_.diagonal();
    window_.lower.array() -= room;
    window_.upper.array() += room;
  }

  const Bounds& window() const { return window_; }
  bool flat() const { return flat_; }

  /// Plots of one state in the order of painting; their numbers go to `csv` after `sample`.
  std::vector<std::string> plots(Page& page, size_t frame, double sample, std::string& csv) const {
    std::vector<std::string> list;
    const Eigen::VectorXd& u = record_.states[frame];
    const Eigen::MatrixXd x = positions(surface_, record_.mesh, u);
    if (!flat_) add_strokes(page, list);
    flat_ ? add_areas(page, x, frame, sample, csv, list) : add_facets(page, x, sample, csv, list);
    for (size_t i = 0; i < record_.lines.size(); ++i) {
      const Eigen::MatrixXd points = seen(positions(record_.lines[i], record_.mesh, u));
      list.push_back(fmt::format("{} using 1:2 with lines lw 1.6 lc rgb '{}'", page.data(millimetres_of(points)),
                                 line_colour(i, record_.lines.size())));
      add_lines("line", record_.lines[i].id, points, sample, csv);
    }
    if (flat_) add_strokes(page, list);
    for (const std::vector<Eigen::VectorXd>& obstacle : record_.obstacles) {
      Eigen::MatrixXd points(record_.mesh.dimension(), static_cast<Eigen::Index>(obstacle.size()));
      for (size_t i = 0; i < obstacle.size(); ++i) points.col(static_cast<Eigen::Index>(i)) = obstacle[i];
      list.push_back(
          fmt::format("{} using 1:2 with lines lw 3 lc rgb '{}'", page.data(millimetres_of(seen(points))), kObstacle));
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
      text += fmt::format("set label '{}' at {} center font ',11' tc rgb '{}'\n", "xyz"[c], screen(1.5 * along), kGrey);
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
      csv += flat_ ? line(sample, std::string(kind), name, part, p[0] / kMillimetre, p[1] / kMillimetre)
                   : line(sample, std::string(kind), name, part, p[0] / kMillimetre, p[1] / kMillimetre,
                          p[2] / kMillimetre);
    }
  }

  void add_strokes(Page& page, std::vector<std::string>& list) const {
    if (strokes_.empty()) return;
    std::vector<std::vector<double>> rows;
    for (const auto& [from, to] : strokes_) {
      Eigen::MatrixXd ends(from.size(), 2);
      ends << from, to;
      for (std::vector<double>& row : millimetres_of(seen(ends))) rows.push_back(std::move(row));
      rows.push_back({});
    }
    list.push_back(
        fmt::format("{} using 1:2 with lines lw {} lc rgb '{}'", page.data(rows), flat_ ? 1.2 : 0.6, kGround));
  }

  std::vector<std::vector<double>> outlines(const Eigen::MatrixXd& x) const {
    std::vector<std::vector<double>> rows;
    for (const Surface::Loop& loop : surface_.loops) {
      for (size_t i = 0; i <= loop.points.size(); ++i) {
        const auto point = x.col(loop.points[i % loop.points.size()]);
        rows.push_back({point[0] / kMillimetre, point[1] / kMillimetre});
      }
      rows.push_back({});
    }
    return rows;
  }

  /// Regions, each as one line through all of its loops: what leads from loop to loop and back encloses nothing, and
  /// holes run the other way around, so they stay open.
  void add_areas(Page& page, const Eigen::MatrixXd& x, size_t frame, double sample, std::string& csv,
                 std::vector<std::string>& list) const {
    if (frame > 0) {
      const Eigen::MatrixXd first = positions(surface_, record_.mesh, record_.states.front());
      list.push_back(fmt::format("{} using 1:2 with lines lw 1 lc rgb '{}'", page.data(outlines(first)), kFaint));
    }
    for (size_t r = 0; r < record_.mesh.region_names.size(); ++r) {
      std::vector<int> path;
      int part = 0;
      for (const Surface::Loop& loop : surface_.loops) {
        if (loop.region != static_cast<int>(r)) continue;
        path.insert(path.end(), loop.points.begin(), loop.points.end());
        path.push_back(loop.points.front());
        if (part > 0) path.push_back(path.front());
        Eigen::MatrixXd points(2, static_cast<Eigen::Index>(loop.points.size()));
        for (size_t i = 0; i < loop.points.size(); ++i)
          points.col(static_cast<Eigen::Index>(i)) = x.col(loop.points[i]);
        add_lines("outline", record_.mesh.region_names[r], points, sample, csv, ++part);
      }
      if (path.empty()) continue;
      Eigen::MatrixXd points(2, static_cast<Eigen::Index>(path.size()));
      for (size_t i = 0; i < path.size(); ++i) points.col(static_cast<Eigen::Index>(i)) = x.col(path[i]);
      list.push_back(fmt::format("{} using 1:2 with filledcurves closed fs solid 1 noborder fc rgb '{}'",
                                 page.data(millimetres_of(points)), body_colour(record_.mesh.region_names[r], r)));
    }
    list.push_back(fmt::format("{} using 1:2 with lines lw 0.8 lc rgb '{}'", page.data(outlines(x)), kBlack));
  }

  void add_facets(Page& page, const Eigen::MatrixXd& x, double sample, std::string& csv,
                  std::vector<std::string>& list) const {
    const Eigen::MatrixXd plane = seen(x);
    std::vector<std::vector<double>> rows;
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
      Eigen::MatrixXd corners(3, 3);
      for (int i = 0; i < 3; ++i) corners.col(i) = plane.col(triangle.points[static_cast<size_t>(i)]);
      add_lines("facet", region, corners, sample, csv, ++part);
      // A little larger, or the background would shine through between neighbours.
      const Eigen::Vector3d middle = corners.rowwise().mean();
      for (int i = 0; i < 3; ++i) {
        const Eigen::Vector3d outward = corners.col(i) - middle;
        corners.col(i) += kOverlap * window_.diagonal() * outward.normalized();
      }
      for (std::vector<double>& row : millimetres_of(corners)) {
        row.push_back(colour);
        rows.push_back(std::move(row));
      }
      rows.push_back({});
    }
    if (rows.empty()) return;
    list.push_back(
        fmt::format("{} using 1:2:3 with filledcurves closed fs solid 1 noborder fc rgb variable", page.data(rows)));
  }

  const SimulationRecord& record_;
  Surface surface_;
  View view_;
  bool flat_;
  Bounds window_;
  std::vector<std::pair<Eigen::VectorXd, Eigen::VectorXd>> strokes_;
};

}  // namespace

Drawing strip(const SimulationRecord& record) {
  const Picture picture(record);
  const Bounds& window = picture.window();
  const double width = (window.upper - window.lower)[0] / kMillimetre,
               tall = (window.upper - window.lower)[1] / kMillimetre;
  const double left = picture.flat() ? 76 : 16, below = picture.flat() ? 58 : 74;
  const Layout layout = layout_of(record.states.size(), tall / width, kPageWidth - left - 16);
  const SampleLabel sample_label(record);

  // The legend runs along lines below the title.
  std::vector<std::pair<double, double>> places;  // of its entries, from the left and from the title down
  const std::vector<LegendEntry> legend = picture.legend();
  double at = 16, down = 8;
  for (const LegendEntry& entry : legend) {
    const double needed = legend_width({entry});
    if (at + needed > kPageWidth - 16) {
      at = 16;
      down += 19;
    }
    places.emplace_back(at, down);
    at += needed + 8;
  }
  const double above = down + 18;
  const double each = kHeading + layout.tall;
  const double height = kTitle + above + each * static_cast<double>(layout.rows()) + below;
  Page page(kPageWidth, height, "Simulation: states of the run, to one scale", record.title, false);
  for (size_t i = 0; i < legend.size(); ++i) {
    page.legend(places[i].first, height - kTitle - places[i].second, {legend[i]});
  }

  std::vector<double> xs = {window.lower[0] / kMillimetre, window.upper[0] / kMillimetre};
  std::vector<double> ys = {window.lower[1] / kMillimetre, window.upper[1] / kMillimetre};
  Axis x = axis_over(xs, "", static_cast<int>(layout.across / 70), false), y = axis_over(ys, "", 4, false);
  x.low = xs[0];
  x.high = xs[1];
  y.low = ys[0];
  y.high = ys[1];
  x.step = y.step = std::max(x.step, y.step);

  const WrittenUnit written = written_unit(record.sample_unit);
  std::string csv = fmt::format("{},kind,name,part,{}\n", field(record.sample_name + "_" + written.suffix),
                                picture.flat() ? "x_mm,y_mm" : "right_mm,up_mm,toward_viewer_mm");
  const std::vector<size_t> chosen = evenly_chosen(record.states.size(), layout.count);
  for (size_t i = 0; i < chosen.size(); ++i) {
    const size_t row = i / layout.columns, column = i % layout.columns;
    const double from = left + static_cast<double>(column) * (layout.across + kGap);
    const double top = height - kTitle - above - static_cast<double>(row) * each - kHeading;
    const double sample = record.samples[static_cast<size_t>(record.frames[chosen[i]])];
    const std::vector<std::string> plots = picture.plots(page, chosen[i], sample / written.factor, csv);
    std::string extra = "unset grid\nset clip two\n";
    Axis panel_x = x, panel_y = y;
    if (picture.flat()) {
      // Numbers and names of the axes at the outer panels only.
      const bool lowest = i + layout.columns >= chosen.size(), first = column == 0;
      if (lowest) panel_x.label = "x [mm]";
      if (first) panel_y.label = "y [mm]";
      extra += fmt::format("set format x '{}'\nset format y '{}'\n", lowest ? "%g" : "", first ? "%g" : "");
    } else {
      extra += "unset tics\nset border 15 lc rgb '#dddddd'\n";
    }
    page.panel({from, top - layout.tall, from + layout.across, top}, panel_x, panel_y,
               fmt::format("{} {}", record.sample_name, sample_label(sample)), plots, extra);
  }
  if (!picture.flat()) {
    // A bar of a round length: all panels have its scale.
    const double length = x.step, pixels = length * layout.across / width;
    page.panel(
        {kPageWidth - 16 - pixels, 20, kPageWidth - 16, 21}, {"", 0, 1, 1}, {"", 0, 1, 1}, "", {},
        fmt::format("unset tics\nunset border\nset arrow from graph 0,0 to graph 1,0 heads size screen 0.004,90 lw 2 "
                    "lc rgb '{0}'\nset label '{1:g} mm' at graph 0,0 right offset -1,0 font ',12' tc rgb '{0}'\n",
                    kGrey, length) +
            picture.axes(44, 26, height));
  }
  std::string caption = fmt::format(
      "{} of {} stored states from the start to the end of the run, in one window and at one scale; above each "
      "stands its {}.",
      chosen.size(), record.states.size(), record.sample_name);
  caption += picture.flat() ? "" : " Seen from above at a corner (isometric), without perspective.";
  return Drawing{{"strip", "states of the run, to one scale", caption, ""}, csv, page};
}

}  // namespace taut::plot

#include "reports/draw.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "reports/dimensions.hpp"
#include "reports/figures.hpp"
#include "sim/core/error.hpp"
#include "sim/mesh/loops.hpp"

namespace taut {
namespace plot {
namespace {

using Point = Eigen::Vector2d;  // [mm]

constexpr const char* kMeasured = "#009e73";

struct Window {
  Point lower, upper;  ///< [mm]
  bool contains(const Point& p) const {
    const double rounding = 1e-9 * (upper - lower).norm();
    return (p.array() >= lower.array() - rounding && p.array() <= upper.array() + rounding).all();
  }
  /// Adds the part of a line that lies inside, shifted.
  void add(Rows& lines, const Point& a, const Point& b, const Point& shift = Point::Zero()) const {
    if (const auto piece = clipped(a, b, lower, upper))
      append(lines, rows_in(1, std::array<Point, 2>{piece->first + shift, piece->second + shift}));
  }
};

struct Area {
  std::string region, colour;
  std::vector<Point> line;  ///< closed
  double size;              ///< signed [mm^2]; negative: a hole
};

/// Outlines of all regions without the points along straight lines, large ones first: what lies in a hole is painted
/// after it.
std::vector<Area> areas_of(const Mesh& mesh) {
  std::vector<Area> areas;
  for (size_t r = 0; r < mesh.region_names.size(); ++r) {
    for (const std::vector<int>& loop : region_loops(mesh, static_cast<int>(r))) {
      std::vector<Point> all;
      for (int node : loop) all.emplace_back(mesh.node(node) / kMillimetre);
      Area area{mesh.region_names[r], region_colour(mesh.region_names[r], r), {}, signed_area(all)};
      for (size_t i = 0; i < all.size(); ++i) {
        const Point before = all[i] - all[(i + all.size() - 1) % all.size()],
                    after = all[(i + 1) % all.size()] - all[i];
        const double turn = before.x() * after.y() - before.y() * after.x();
        if (std::abs(turn) > 1e-6 * before.norm() * after.norm()) area.line.push_back(all[i]);
      }
      areas.push_back(area);
    }
  }
  largest_first(areas);
  return areas;
}

/// The part of a polygon inside the window (Sutherland and Hodgman).
std::vector<Point> clipped(std::vector<Point> polygon, const Window& window) {
  for (int side = 0; side < 4; ++side) {
    const int axis = side / 2;
    const double sign = side % 2 == 0 ? 1 : -1, limit = side % 2 == 0 ? window.lower[axis] : window.upper[axis];
    std::vector<Point> kept;
    for (size_t i = 0; i < polygon.size(); ++i) {
      const Point &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
      const double da = sign * (a[axis] - limit), db = sign * (b[axis] - limit);
      if (da >= 0) kept.push_back(a);
      if ((da > 0 && db < 0) || (da < 0 && db > 0)) kept.push_back(a + (b - a) * da / (da - db));
    }
    polygon = std::move(kept);
  }
  return polygon;
}

struct Place {
  Point middle, outward;
};

/// Mean place and outward direction of a tag; without a direction for points.
Place place_of(const Mesh& mesh, const Tag& tag) {
  Place place{Point::Zero(), Point::Zero()};
  double length = 0;
  for (int i = 0; i < tag.count(); ++i) {
    const int* nodes = &tag.entities[static_cast<size_t>(i) * tag.nodes_per_entity];
    const Point a = mesh.node(nodes[0]) / kMillimetre;
    if (tag.dimension == 0) {
      place.middle += a;
      length += 1;
      continue;
    }
    const Point b = mesh.node(nodes[1]) / kMillimetre, along = b - a;
    place.middle += along.norm() * 0.5 * (a + b);
    place.outward += Point(along.y(), -along.x());
    length += along.norm();
  }
  place.middle /= length;
  if (place.outward.norm() > 1e-9 * length) place.outward.normalize();
  return place;
}

/// What is drawn of the body, of its surroundings and of the cables, in panels of any window and scale.
class Sheet {
 public:
  Sheet(const Experiment& experiment, const Mesh& mesh) : experiment_(experiment), mesh_(mesh), areas_(areas_of(mesh)) {
    body_ = {Point::Constant(INFINITY), Point::Constant(-INFINITY)};
    for (int i = 0; i < mesh.node_count(); ++i) {
      body_.lower = body_.lower.cwiseMin(mesh.node(i) / kMillimetre);
      body_.upper = body_.upper.cwiseMax(mesh.node(i) / kMillimetre);
    }
  }

  const Window& body() const { return body_; }

  Plots plots(Page& page, const Window& window, double scale) const {
    Plots plots;
    Rows outlines;
    for (const Area& area : areas_) {
      const std::vector<Point> inside = clipped(area.line, window);
      if (inside.size() > 2) page.add(plots, rows_in(1, inside), kFilled, area.size > 0 ? area.colour : "#ffffff");
      for (size_t i = 0; i < area.line.size(); ++i)
        window.add(outlines, area.line[i], area.line[(i + 1) % area.line.size()]);
    }
    page.add(plots, outlines, "lines lw 1.2", kBlack);
    page.add(plots, obstacles(window), "lines lw 2.5", kGrey);
    page.add(plots, supports(window, scale), "lines lw 1.6", kBlack);
    add_cables(page, window, plots);
    add_channels(page, window, plots);
    return plots;
  }

  /// Arrows of the loads and names of the tags.
  std::string marks(double scale) const {
    std::string out;
    const double px = 1 / scale;
    for (const LoadSettings& load : experiment_.loads) {
      const Place place = load.on.empty() ? Place{Point(load.point[0], load.point[1]) / kMillimetre, Point::Zero()}
                                          : place_of(mesh_, mesh_.select(load.on));
      const Point direction = Point(load.direction[0], load.direction[1]).normalized();
      const double along = direction.dot(place.outward);
      // A pull starts at the face, a push ends there, what acts along the face stands beside it.
      Point start = place.middle + px * (along > 0.3 ? 5.0 : along < -0.3 ? 50.0 : 14.0) * place.outward;
      if (along < -0.3) start = place.middle + px * 4 * place.outward - px * 46 * direction;
      const Point end = start + px * 46 * direction;
      out += fmt::format(
          "set arrow from first {:.8g},{:.8g} to first {:.8g},{:.8g} head filled size first {:.6g},18 front lw 3 lc "
          "rgb "
          "'{}'\n",
          start.x(), start.y(), end.x(), end.y(), 12 * px, kBlack);
    }
    for (const auto& [name, tag] : mesh_.tags) {
      if (tag.dimension != 1 || tag.count() == 0) continue;
      const Place place = place_of(mesh_, tag);
      const bool beside = std::abs(place.outward.x()) > 0.7;
      const Point at = place.middle + px * (beside ? tag_beside : 18.0) * place.outward;
      out += fmt::format("set label {} at first {:.8g},{:.8g} center {} front font ',12' tc rgb '{}'\n", literal(name),
                         at.x(), at.y(), beside ? "rotate by 90" : "", kGrey);
    }
    return out;
  }

  std::vector<LegendEntry> legend() const {
    std::vector<LegendEntry> entries{{LegendEntry::heading, "Material"}};
    for (size_t r = 0; r < mesh_.region_names.size(); ++r) {
      entries.push_back({LegendEntry::area, mesh_.region_names[r], region_colour(mesh_.region_names[r], r)});
    }
    if (!experiment_.cables.cables.empty()) {
      entries.push_back({LegendEntry::heading, "Cables"});
      std::string names;
      for (const CableSettings& cable : experiment_.cables.cables) names += (names.empty() ? "" : ", ") + cable.id;
      entries.push_back({LegendEntry::line, names, kCable});
      entries.push_back({LegendEntry::point, "via point, end in material", kCable, 7});
      entries.push_back({LegendEntry::point, "end fixed in space", kCable, 5});
    }
    entries.push_back({LegendEntry::heading, "Held"});
    for (const SupportSettings& support : experiment_.supports) {
      std::string text = support.on;
      for (size_t i = 0; i < support.fix.size(); ++i)
        text += fmt::format("{}{}", i == 0 ? ", fixed in " : ", ", "xyz"[support.fix[i]]);
      if (support.rotation_stiffness) text += ", elastic clamp";
      if (!support.control.empty()) text += fmt::format(", {} moved by {}", "xyz"[support.component], support.control);
      entries.push_back({LegendEntry::hatch, text, kBlack});
    }
    if (!experiment_.loads.empty()) {
      entries.push_back({LegendEntry::heading, "Loads"});
      for (const LoadSettings& load : experiment_.loads) {
        entries.push_back({LegendEntry::arrow, load.id + (load.on.empty() ? "" : " on " + load.on), kBlack});
      }
    }
    entries.push_back({LegendEntry::heading, "Measured"});
    for (const ChannelSettings& channel : experiment_.channels) {
      const ChannelKind& kind = *channel.kind;
      const std::string place = kind.on == ChannelKind::On::place ? ", mean of " : fmt::format(", {} of ", kind.name);
      entries.push_back(
          {LegendEntry::point, channel.id + (channel.on.empty() ? "" : place + channel.on), kMeasured, 13});
    }
    return entries;
  }

  std::string csv() const {
    std::string out = "kind,name,part,x_mm,y_mm,length_mm\n";
    int part = 0;
    for (const Area& area : areas_) {
      ++part;
      for (const Point& p : area.line) {
        out += line(area.size > 0 ? "outline" : "hole", area.region, part, p.x(), p.y(), "");
      }
    }
    for (const CableSettings& cable : experiment_.cables.cables) {
      for (const Point& p : points_of(cable)) out += line("cable", cable.id, ++part, p.x(), p.y(), "");
    }
    return out;
  }

  static constexpr double tag_beside = 74;  ///< from a face on the left or right to its name [px]

 private:
  Rows obstacles(const Window& window) const {
    Rows lines;
    for (const std::vector<Eigen::Vector2d>& line : experiment_.contact.obstacles) {
      for (size_t i = 1; i < line.size(); ++i) window.add(lines, line[i - 1] / kMillimetre, line[i] / kMillimetre);
    }
    for (const GroundSettings& ground : experiment_.contact.grounds) {
      const double reach = 2 * (window.upper - window.lower).norm();
      const Point middle = ground.point / kMillimetre, along(-ground.normal.y(), ground.normal.x());
      window.add(lines, middle - reach * along, middle + reach * along);
    }
    return lines;
  }

  /// [mm]
  std::vector<Point> points_of(const CableSettings& cable) const {
    std::vector<Point> points;
    for (const std::vector<double>& p : cable.points) points.emplace_back(Point(p[0], p[1]) / kMillimetre);
    if (cable.line) {
      const BodyAxis axis = *experiment_.geometry.shape->axis();
      for (const auto& [s, offset] :
           {std::pair(cable.line->start, cable.line->offset), std::pair(cable.line->end, cable.line->end_offset)})
        points.emplace_back(axis.point(s, offset, cable.line->angle).head<2>() / kMillimetre);
    }
    return points;
  }
  Point place_of_marker(const ChannelSettings& channel) const {
    Eigen::VectorXd at = experiment_.geometry.shape->axis()->point(*channel.foot, 0, 0);
    if (!channel.standoff.empty()) at += vector_of(channel.standoff);
    return at.head<2>() / kMillimetre;
  }

  void add_cables(Page& page, const Window& window, Plots& plots) const {
    Rows lines, vias, fixed;
    for (const CableSettings& cable : experiment_.cables.cables) {
      const std::vector<Point> points = points_of(cable);
      for (size_t i = 0; i < points.size(); ++i) {
        if (i > 0) window.add(lines, points[i - 1], points[i]);
        const bool end = i == 0 || i + 1 == points.size();
        if (cable.line && !end) continue;  // of a row of eyelets only the ends
        const bool anchor = !cable.line && ((i == 0 && cable.start_fixed) || (end && i > 0 && cable.end_fixed));
        if (window.contains(points[i])) (anchor ? fixed : vias).push_back({points[i].x(), points[i].y()});
      }
    }
    page.add(plots, lines, "lines lw 2", kCable);
    page.add(plots, vias, "points pt 7 ps 0.7", kCable);
    page.add(plots, fixed, "points pt 5 ps 1.1", kCable);
  }

  Rows supports(const Window& window, double scale) const {
    Rows lines;
    const double px = 1 / scale, spacing = 9 * px;
    for (const SupportSettings& support : experiment_.supports) {
      const Tag tag = mesh_.select(support.on);
      for (int i = 0; i < tag.count() && tag.dimension == 1; ++i) {
        const int* nodes = &tag.entities[static_cast<size_t>(i) * tag.nodes_per_entity];
        const Point a = mesh_.node(nodes[0]) / kMillimetre, b = mesh_.node(nodes[1]) / kMillimetre;
        const Point t = (b - a).normalized(), n(t.y(), -t.x());
        window.add(lines, a, b, px * n);
        // At whole multiples of the spacing along the face, in whatever order its edges come.
        const double from = a.dot(t), to = b.dot(t);
        for (double along = std::ceil(from / spacing) * spacing; along < to; along += spacing) {
          const Point foot = a + (along - from) * t;
          const Point end = foot + 10 * px * (n + (t.x() + t.y() > 0 ? -0.8 : 0.8) * t);
          if (window.contains(foot)) append(lines, {{foot.x(), foot.y()}, {end.x(), end.y()}});
        }
      }
    }
    return lines;
  }

  void add_channels(Page& page, const Window& window, Plots& plots) const {
    Rows rows;
    for (const ChannelSettings& channel : experiment_.channels) {
      const ChannelKind::On on = channel.kind->on;
      if (on != ChannelKind::On::place && on != ChannelKind::On::tag) continue;  // a cable is drawn as such
      const Point at = channel.foot         ? place_of_marker(channel)
                       : channel.on.empty() ? Point(Point(channel.point[0], channel.point[1]) / kMillimetre)
                                            : place_of(mesh_, mesh_.select(channel.on)).middle;
      if (window.contains(at)) rows.push_back({at.x(), at.y()});
    }
    page.add(plots, rows, "points pt 13 ps 1.4", kMeasured);
  }

  const Experiment& experiment_;
  const Mesh& mesh_;
  std::vector<Area> areas_;
  Window body_;
};

/// A panel with dimensions around a window of the drawing, laid out before it knows where on the page it will stand.
class View {
 public:
  /// `beside` and `under` are pixels kept free between the window and its dimensions for supports, loads and names.
  View(const Window& window, std::vector<Dimension> list, double across, double tallest, double beside, double under)
      : window_(window), across_(across), beside_(beside), under_(under) {
    const Point size = window.upper - window.lower;
    scale_ = std::min((across - 2 * beside) / size.x(), tallest / size.y());
    // Columns beside the window take from its width, and how many they are depends on the scale.
    for (int round = 0; round < 6; ++round) {
      dimensions_.emplace(list, scale_);
      const int columns = dimensions_->rows(Dimension::left) + dimensions_->rows(Dimension::right);
      const double room = across - 2 * beside - columns * Dimensions::spacing - 36;
      const double scale = std::min(room / size.x(), tallest / size.y());
      if (std::abs(scale - scale_) < 1e-9 * scale_) break;
      scale_ = scale;
    }
    above_ = edge + Dimensions::spacing * dimensions_->rows(Dimension::above);
    below_ = edge + under + Dimensions::spacing * dimensions_->rows(Dimension::below);
    // Numbers of upright dimensions may reach farther than the window.
    for (const Dimension::Side side : {Dimension::left, Dimension::right}) {
      if (dimensions_->rows(side) == 0) continue;
      above_ = std::max(above_, dimensions_->highest(side) - scale_ * window.upper.y() + 10);
      below_ = std::max(below_, scale_ * window.lower.y() - dimensions_->lowest(side) + 10);
    }
  }

  double height() const { return above_ + below_ + scale_ * (window_.upper - window_.lower).y(); }
  double scale() const { return scale_; }
  const Window& window() const { return window_; }

  /// Below the upper edge of `box`, which is as wide.
  void draw(Page& page, const Sheet& sheet, Box box, const std::string& title, const std::string& extra) const {
    const double columns = dimensions_->rows(Dimension::right) - dimensions_->rows(Dimension::left);
    const double middle = 0.5 * (window_.lower + window_.upper).x() + 0.5 * columns * Dimensions::spacing / scale_;
    const double reach = 0.5 * across_ / scale_, beside = beside_ / scale_;
    Axis x{"x [mm]", middle - reach, middle + reach, 1};
    Axis y{"y [mm]", window_.lower.y() - below_ / scale_, window_.upper.y() + above_ / scale_, 1};
    x.step = y.step = axis_over({0, (window_.upper - window_.lower).maxCoeff()}, "", 6, false).step;
    box.bottom = box.top - height();
    page.panel(box, x, y, title, sheet.plots(page, window_, scale_),
               "unset grid\n" +
                   dimensions_->drawn(window_.lower.x() - beside, window_.lower.y() - under_ / scale_,
                                      window_.upper.x() + beside, window_.upper.y()) +
                   extra);
  }

 private:
  static constexpr double edge = 30;  // px
  Window window_;
  double across_, beside_, under_, scale_, above_, below_;
  std::optional<Dimensions> dimensions_;
};

std::vector<Dimension> overall(const Window& body) {
  const Point size = body.upper - body.lower;
  return {{Dimension::below, body.lower.x(), body.upper.x(), body.lower.y(), millimetres(kMillimetre * size.x())},
          {Dimension::right, body.lower.y(), body.upper.y(), body.upper.x(), millimetres(kMillimetre * size.y())}};
}

std::vector<Dimension> dimensions_of(const std::vector<DimensionLine>& lines) {
  std::vector<Dimension> list;
  for (const auto& [side, from, to, body, name] : lines) {
    list.push_back(
        {side, from / kMillimetre, to / kMillimetre, body / kMillimetre, name + " " + millimetres(to - from)});
  }
  return list;
}

/// Lengths inside the body, and its axis.
std::string drawn_inside(const ShapeDrawing& drawing, double scale) {
  std::string out;
  for (const InnerLine& line : drawing.inner) {
    const double width = (line.right - line.left) / kMillimetre;
    const double place = width * scale > 60 ? line.place : std::max(line.place, 0.62);  // numbers stand on its left
    out += dimension_inside(line.left / kMillimetre + place * width, line.from / kMillimetre, line.to / kMillimetre,
                            line.name + " " + millimetres(line.to - line.from), scale);
  }
  if (drawing.axis) {
    out +=
        fmt::format("set arrow from first {:.8g},0 to first {:.8g},0 nohead front lw 0.9 dt (14,4,2,4) lc rgb '{}'\n",
                    drawing.axis->first / kMillimetre, drawing.axis->second / kMillimetre, kGrey);
  }
  return out;
}

std::string rows_of(const std::vector<Dimension>& dimensions) {
  std::string csv;
  for (const Dimension& d : dimensions) csv += line("dimension", d.text, "", "", "", d.to - d.from);
  return csv;
}

std::string frame_around(const Window& window, const char* style) {
  return fmt::format(
      "set object rectangle from first {:.8g},{:.8g} to first {:.8g},{:.8g} front fs empty border lc rgb "
      "'{}' {}\n",
      window.lower.x(), window.lower.y(), window.upper.x(), window.upper.y(), kGrey, style);
}

/// One part of the body, enlarged: its panel and the frame around it in both.
struct DetailView {
  DetailView(const ShapeDrawing::Detail& detail, double across)
      : title(detail.title + ", enlarged (the dashed frame above)"),
        window{detail.lower / kMillimetre, detail.upper / kMillimetre},
        list(dimensions_of(detail.lines)),
        view(window, list, across, 330, 10, 0) {}

  std::string frame() const { return frame_around(window, "dt (4,4) lw 1.2"); }

  std::string title;
  Window window;
  std::vector<Dimension> list;
  View view;
};

Drawing rest_drawing(const Experiment& experiment, const Mesh& mesh) {
  const Sheet sheet(experiment, mesh);
  Grid grid({.legend = 250}, sheet.legend());
  const std::optional<ShapeDrawing> own = experiment.geometry.shape->drawing();
  const std::vector<Dimension> whole = own ? dimensions_of(own->lines) : overall(sheet.body());
  const View main(sheet.body(), whole, grid.across, 420, Sheet::tag_beside + 14, own ? 0 : 26);
  std::optional<DetailView> detail;
  if (own && own->detail) detail.emplace(*own->detail, grid.across);

  const double beside_legend = legend_height(grid.legend) + 40;
  if (detail) {
    grid.rows({std::max(main.height(), beside_legend - 200) + 14, detail->view.height()});
  } else {
    grid.rows({std::max(main.height(), beside_legend)});
  }
  const std::string title = "The specimen at rest, to scale";
  const std::string subtitle = experiment.title + ": " + (own ? own->summary + ", " : "") +
                               millimetres(experiment.geometry.thickness) + " thick";
  // A drawing shows no readings, so there are no simulated ones to warn of.
  Page page = grid.page(title, subtitle, false);
  std::string extra = sheet.marks(main.scale());
  if (own) extra += drawn_inside(*own, main.scale());
  if (detail) extra += detail->frame();
  main.draw(page, sheet, grid.box(0), "", extra);
  std::string csv = sheet.csv() + rows_of(whole);
  if (detail) {
    detail->view.draw(page, sheet, grid.box(1), detail->title, detail->frame());
    csv += rows_of(detail->list);
  }
  const char* caption =
      "The specimen as the experiment file describes it, before anything is loaded: materials, what is held, where "
      "loads "
      "act and what is measured. Dimensions in millimetres.";
  return {{"drawing", title, caption}, csv, page};
}

}  // namespace
}  // namespace plot

Figure draw_experiment(const Experiment& experiment, const Mesh& mesh, const std::string& folder) {
  if (mesh.dimension() != 2) {
    throw InputError(
        fmt::format("{}: [geometry] kind = \"{}\" is 3D and taut draws 2D experiments only; run `taut replay` and open "
                    "states/states.pvd in ParaView",
                    experiment.path, experiment.geometry.kind()));
  }
  return plot::finished(plot::rest_drawing(experiment, mesh), folder);
}

}  // namespace taut

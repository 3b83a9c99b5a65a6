#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "reports/run_sections.hpp"

namespace taut::plot {
namespace {

using Line = ShapeRecord::Line;

constexpr const char* kCable = "#d55e00";
constexpr size_t kMostColumns = 6, kMostRows = 8;  // more would be too small to see

double signed_area(const Line& line) {
  double sum = 0;
  for (size_t i = 0; i < line.size(); ++i) {
    const auto& [x0, y0] = line[i];
    const auto& [x1, y1] = line[(i + 1) % line.size()];
    sum += 0.5 * (x0 * y1 - x1 * y0);
  }
  return sum;
}

std::vector<std::vector<double>> in_mm(const Line& line, bool close) {
  std::vector<std::vector<double>> rows;
  for (const auto& [x, y] : line) rows.push_back({x / kMillimetre, y / kMillimetre});
  if (close && !rows.empty()) rows.push_back(std::vector<double>(rows.front()));
  return rows;
}

/// At most `most` of `names`, the first and the last among them.
std::vector<std::string> thinned(const std::vector<std::string>& names, size_t most) {
  if (names.size() <= most) return names;
  std::vector<std::string> kept;
  for (size_t i = 0; i < most; ++i) kept.push_back(names[i * (names.size() - 1) / (most - 1)]);
  return kept;
}

/// Plots of one shape: areas, large ones first so that what lies in a hole is painted after it, outlines, cables.
std::vector<std::string> painted(Page& page, const ShapeRecord& shape, const std::vector<std::string>& regions) {
  struct Fill {
    const Line* line;
    std::string colour;
    double size;
  };
  std::vector<Fill> fills;
  std::vector<std::vector<double>> outlines, cables;
  for (const ShapeRecord::Area& area : shape.areas) {
    const auto place = std::ranges::find(regions, area.region) - regions.begin();
    for (const Line& loop : area.loops) {
      const double size = signed_area(loop);
      fills.push_back({&loop, size > 0 ? region_colour(area.region, static_cast<size_t>(place)) : "#ffffff", size});
      const auto rows = in_mm(loop, true);
      outlines.insert(outlines.end(), rows.begin(), rows.end());
      outlines.push_back({});
    }
  }
  std::ranges::stable_sort(fills, [](const Fill& a, const Fill& b) { return std::abs(a.size) > std::abs(b.size); });
  std::vector<std::string> plots;
  for (const Fill& fill : fills) {
    plots.push_back(fmt::format("{} using 1:2 with filledcurves closed fs solid 1 noborder fc rgb '{}'",
                                page.data(in_mm(*fill.line, false)), fill.colour));
  }
  if (!outlines.empty())
    plots.push_back(fmt::format("{} using 1:2 with lines lw 0.7 lc rgb '{}'", page.data(outlines), kBlack));
  for (const Line& cable : shape.cables) {
    const auto rows = in_mm(cable, false);
    cables.insert(cables.end(), rows.begin(), rows.end());
    cables.push_back({});
  }
  if (!cables.empty())
    plots.push_back(fmt::format("{} using 1:2 with lines lw 1.3 lc rgb '{}'", page.data(cables), kCable));
  return plots;
}

}  // namespace

std::optional<Drawing> shape_panels(const RunRecord& record) {
  std::vector<std::string> rows, columns, regions;
  std::map<std::pair<std::string, std::string>, const ShapeRecord*> shapes;
  const ShapeRecord* rest = nullptr;
  std::vector<double> xs, ys;
  bool cables = false;
  for (const ShapeRecord& shape : record.shapes) {
    if (shape.areas.empty()) return std::nullopt;
    for (const ShapeRecord::Area& area : shape.areas) {
      place_in(regions, area.region);
      for (const Line& loop : area.loops) {
        for (const auto& [x, y] : loop) {
          xs.push_back(x / kMillimetre);
          ys.push_back(y / kMillimetre);
        }
      }
    }
    cables = cables || !shape.cables.empty();
    if (shape.row.empty() && shape.column.empty()) {
      rest = &shape;
      continue;
    }
    place_in(rows, shape.row);
    place_in(columns, shape.column);
    shapes[{shape.row, shape.column}] = &shape;
  }
  // One row of one material is clearer with all shapes in one panel.
  if (shapes.empty() || xs.empty() || (rows.size() < 2 && regions.size() < 2 && !cables)) return std::nullopt;
  const size_t all_rows = rows.size(), all_columns = columns.size();
  rows = thinned(rows, kMostRows);
  columns = thinned(columns, kMostColumns);

  std::vector<LegendEntry> legend{{LegendEntry::heading, "Material"}};
  for (size_t i = 0; i < regions.size(); ++i)
    legend.push_back({LegendEntry::area, regions[i], region_colour(regions[i], i)});
  if (cables) legend.push_back({LegendEntry::line, "cable", kCable});
  if (rest != nullptr) legend.push_back({LegendEntry::line, "outline at rest", "#b0b0b0"});

  // Equal scales in all panels: they share the proportions of everything that is shown.
  Axis x = axis_over(xs, record.shape_axes[0] + " [mm]", 3, false);
  Axis y = axis_over(ys, record.shape_axes[1] + " [mm]", 3, false);
  constexpr double left = 76, gap = 14, below = 58, heading = 34, title = 24;
  const double legend_left = kPageWidth - legend_width(legend) - 8;
  const double count = static_cast<double>(columns.size());
  double across = (legend_left - 24 - left - gap * (count - 1)) / count;
  double tall = across * (y.high - y.low) / (x.high - x.low);
  constexpr double tallest = 320;
  if (tall > tallest) {
    across *= tallest / tall;
    tall = tallest;
  }
  x.step = y.step = std::max(x.step, y.step);
  const double each_row = heading + title + tall;
  const double height = std::max(kTitle + each_row * static_cast<double>(rows.size()) + below,
                                 kTitle + 19.0 * static_cast<double>(legend.size()) + 60);
  Page page(kPageWidth, height, "Deformed shapes, to one scale", record.title, record.simulated);
  page.legend(legend_left, height - kTitle - heading, legend);

  std::vector<std::vector<double>> rest_lines;
  if (rest != nullptr) {
    for (const std::array<double, 4>& s : rest->segments) {
      rest_lines.push_back({s[0] / kMillimetre, s[1] / kMillimetre});
      rest_lines.push_back({s[2] / kMillimetre, s[3] / kMillimetre});
      rest_lines.push_back({});
    }
  }
  const std::string rest_block = rest_lines.empty() ? "" : page.data(rest_lines);
  std::string csv = "held,load,kind,name,part,x_mm,y_mm\n";
  for (size_t r = 0; r < rows.size(); ++r) {
    const double top = height - kTitle - static_cast<double>(r) * each_row;
    if (!rows[r].empty()) page.legend(left, top - 20, {{LegendEntry::heading, rows[r]}});
    const double bottom = top - each_row;
    for (size_t c = 0; c < columns.size(); ++c) {
      const auto found = shapes.find({rows[r], columns[c]});
      if (found == shapes.end()) continue;  // no such condition, or its simulation failed
      const ShapeRecord& shape = *found->second;
      std::vector<std::string> plots = painted(page, shape, regions);
      if (!rest_block.empty()) plots.insert(plots.begin(), rest_block + " using 1:2 with lines lw 1 lc rgb '#b0b0b0'");
      const double from = left + static_cast<double>(c) * (across + gap);
      Axis panel_x = x, panel_y = y;
      // Numbers and names of the axes at the outer panels only.
      const bool lowest = r + 1 == rows.size(), first = c == 0;
      if (!lowest) panel_x.label.clear();
      if (!first) panel_y.label.clear();
      page.panel({from, bottom, from + across, bottom + tall}, panel_x, panel_y, columns[c], plots,
                 fmt::format("set format x '{}'\nset format y '{}'\n", lowest ? "%g" : "", first ? "%g" : ""));
    }
  }
  for (const auto& [key, shape] : shapes) {
    int part = 0;
    const auto add = [&](const char* kind, const std::string& name, const Line& line_of_points) {
      ++part;
      for (const auto& [px, py] : line_of_points) {
        csv += line(key.first, key.second, std::string(kind), name, part, px / kMillimetre, py / kMillimetre);
      }
    };
    for (const ShapeRecord::Area& area : shape->areas) {
      for (const Line& loop : area.loops) add(signed_area(loop) > 0 ? "outline" : "hole", area.region, loop);
    }
    for (const Line& cable : shape->cables) add("cable", "", cable);
  }
  std::string caption =
      "The specimen as the fitted model has it, seen from the side, all panels at one scale and equal along both axes; "
      "what is held and the load stand above each.";
  if (rows.size() < all_rows || columns.size() < all_columns)
    caption += fmt::format(" {} of {} conditions are shown.", rows.size() * columns.size(), all_rows * all_columns);
  return Drawing{{"deformed_shapes", "Deformed shapes, to one scale", caption, ""}, csv, page};
}

}  // namespace taut::plot

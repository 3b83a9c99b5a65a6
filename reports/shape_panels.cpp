#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "reports/run_sections.hpp"

namespace taut::plot {
namespace {

using Line = ShapeRecord::Line;

constexpr const char* kRest = "#b0b0b0";
constexpr size_t kMostColumns = 6, kMostRows = 8;  // more would be too small to see

/// At most `most` of `names`, the first and the last among them.
std::vector<std::string> thinned(const std::vector<std::string>& names, size_t most) {
  std::vector<std::string> kept;
  for (const size_t i : evenly_chosen(names.size(), most)) kept.push_back(names[i]);
  return kept;
}

/// Conditions as a table of pictures, and what there is to see in them.
struct Table {
  std::vector<std::string> rows, columns, regions;
  std::map<std::pair<std::string, std::string>, const ShapeRecord*> shapes;
  const ShapeRecord* rest = nullptr;
  std::vector<double> xs, ys;  ///< of all outlines [mm]
  bool cables = false;

  void add(const ShapeRecord& shape) {
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
      return;
    }
    place_in(rows, shape.row);
    place_in(columns, shape.column);
    shapes[{shape.row, shape.column}] = &shape;
  }

  std::vector<LegendEntry> legend() const {
    std::vector<LegendEntry> entries{{LegendEntry::heading, "Material"}};
    for (size_t i = 0; i < regions.size(); ++i)
      entries.push_back({LegendEntry::area, regions[i], region_colour(regions[i], i)});
    if (cables) entries.push_back({LegendEntry::line, "cable", kCable});
    if (rest != nullptr) entries.push_back({LegendEntry::line, "outline at rest", kRest});
    return entries;
  }

  /// Plots of one shape: areas, outlines, cables.
  Plots painted(Page& page, const ShapeRecord& shape) const {
    struct Fill {
      Rows line;
      std::string colour;
      double size;
    };
    std::vector<Fill> fills;
    Rows outlines, lines;
    for (const ShapeRecord::Area& area : shape.areas) {
      const auto place = static_cast<size_t>(std::ranges::find(regions, area.region) - regions.begin());
      for (const Line& loop : area.loops) {
        const double size = signed_area(loop);
        const Rows line = rows_in(kMillimetre, loop);
        fills.push_back({line, size > 0 ? region_colour(area.region, place) : "#ffffff", size});
        append(outlines, closed(line));
      }
    }
    for (const Line& cable : shape.cables) append(lines, rows_in(kMillimetre, cable));
    Plots plots;
    largest_first(fills);
    for (const Fill& fill : fills) page.add(plots, fill.line, kFilled, fill.colour);
    page.add(plots, outlines, "lines lw 0.7", kBlack);
    page.add(plots, lines, "lines lw 1.3", kCable);
    return plots;
  }

  std::string csv() const {
    std::string csv = "held,load,kind,name,part,x_mm,y_mm\n";
    for (const auto& [key, shape] : shapes) {
      int part = 0;
      const auto add = [&](const char* kind, const std::string& name, const Line& points) {
        ++part;
        for (const auto& p : rows_in(kMillimetre, points))
          csv += line(key.first, key.second, kind, name, part, p[0], p[1]);
      };
      for (const ShapeRecord::Area& area : shape->areas) {
        for (const Line& loop : area.loops) add(signed_area(loop) > 0 ? "outline" : "hole", area.region, loop);
      }
      for (const Line& cable : shape->cables) add("cable", "", cable);
    }
    return csv;
  }
};

}  // namespace

std::optional<Drawing> shape_panels(const RunRecord& record) {
  if (std::ranges::any_of(record.shapes, [](const ShapeRecord& shape) { return shape.areas.empty(); }))
    return std::nullopt;
  Table table;
  for (const ShapeRecord& shape : record.shapes) table.add(shape);
  // One row of one material is clearer with all shapes in one panel.
  if (table.shapes.empty() || table.xs.empty() || (table.rows.size() < 2 && table.regions.size() < 2 && !table.cables))
    return std::nullopt;
  const std::vector<std::string> rows = thinned(table.rows, kMostRows), columns = thinned(table.columns, kMostColumns);

  // Equal scales in all panels: they share the proportions of everything that is shown.
  Axis x = axis_over(table.xs, record.shape_axes[0] + " [mm]", 3, false);
  Axis y = axis_over(table.ys, record.shape_axes[1] + " [mm]", 3, false);
  x.step = y.step = std::max(x.step, y.step);
  constexpr double heading = 34, tallest = 320;
  Grid grid({.gap = 14, .above = heading + 24, .below = 0, .foot = 58}, table.legend(), columns.size());
  const double shape = (y.high - y.low) / (x.high - x.low);
  grid.across = std::min(grid.across, tallest / shape);
  grid.panels(rows.size() * columns.size(), grid.across * shape);
  const std::string title = "Deformed shapes, to one scale";
  Page page = grid.page(title, record.title, record.simulated, heading);

  Plots behind;
  if (table.rest != nullptr) page.add(behind, lines_of(*table.rest), "lines lw 1", kRest);
  for (size_t i = 0; i < rows.size() * columns.size(); ++i) {
    const std::string &row = rows[i / columns.size()], &column = columns[i % columns.size()];
    const Box box = grid.box(i);
    if (grid.leftmost(i) && !row.empty()) page.legend(grid.room.left, box.top + 38, {{LegendEntry::heading, row}});
    const auto found = table.shapes.find({row, column});
    if (found == table.shapes.end()) continue;  // no such condition, or its simulation failed
    Axis panel_x = x, panel_y = y;
    const std::string labels =
        outer_labels(panel_x, panel_y, i + columns.size() >= rows.size() * columns.size(), grid.leftmost(i));
    Plots plots = behind;
    std::ranges::copy(table.painted(page, *found->second), std::back_inserter(plots));
    page.panel(box, panel_x, panel_y, column, plots, labels);
  }
  std::string caption =
      "The specimen as the fitted model has it, seen from the side, all panels at one scale and equal along both axes; "
      "what is held and the load stand above each.";
  if (rows.size() < table.rows.size() || columns.size() < table.columns.size()) {
    caption += fmt::format(" {} of {} conditions are shown.", rows.size() * columns.size(),
                           table.rows.size() * table.columns.size());
  }
  return Drawing{{"deformed_shapes", title, caption}, table.csv(), page};
}

}  // namespace taut::plot

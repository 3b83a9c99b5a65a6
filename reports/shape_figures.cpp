#include <algorithm>

#include "reports/run_sections.hpp"

namespace taut::plot {

Rows lines_of(const ShapeRecord& shape) {
  Rows lines;
  for (const auto& [x0, y0, x1, y1] : shape.segments)
    append(lines, {{x0 / kMillimetre, y0 / kMillimetre}, {x1 / kMillimetre, y1 / kMillimetre}});
  return lines;
}

std::optional<Drawing> deformed_shapes(const RunRecord& record) {
  if (std::optional<Drawing> panels = shape_panels(record)) return panels;
  if (record.shapes.empty()) return std::nullopt;
  std::vector<double> xs, ys;
  std::vector<LegendEntry> legend = {{LegendEntry::heading, "Shape"}};
  std::string csv = "shape,x0_mm,y0_mm,x1_mm,y1_mm\n";
  std::vector<Rows> lines;
  const bool rest_first = record.shapes.front().label.starts_with("rest");
  const size_t resting = rest_first ? 1 : 0;
  for (const ShapeRecord& shape : record.shapes) {
    const size_t i = lines.size();
    legend.push_back({LegendEntry::line, shape.label,
                      i < resting ? "#9a9a9a" : ordered_colour(i - resting, record.shapes.size() - resting)});
    lines.push_back(lines_of(shape));
    for (const std::array<double, 4>& s : shape.segments) {
      const auto [x0, y0, x1, y1] =
          std::array{s[0] / kMillimetre, s[1] / kMillimetre, s[2] / kMillimetre, s[3] / kMillimetre};
      xs.insert(xs.end(), {x0, x1});
      ys.insert(ys.end(), {y0, y1});
      csv += line(shape.label, x0, y0, x1, y1);
    }
  }
  if (xs.empty()) return std::nullopt;
  Axis x = axis_over(xs, record.shape_axes[0] + " [mm]", 8, false);
  Axis y = axis_over(ys, record.shape_axes[1] + " [mm]", 5, false);
  Grid grid({.above = 26}, legend);
  const double least = std::max(160.0, legend_height(legend) + 20);
  grid.rows({to_one_scale(x, y, grid.across, least, 560)});
  y.step = x.step = std::min(x.step, 2 * y.step);

  const std::string title = "Deformed shapes, to scale";
  Page page = grid.page(title, record.title, record.simulated);
  Plots plots;
  for (size_t i = 0; i < lines.size(); ++i) page.add(plots, lines[i], "lines lw 1.8", legend[i + 1].colour);
  page.panel(grid.box(0), x, y, "", plots);
  return Drawing{
      {"deformed_shapes", title,
       "The specimen as the fitted model has it, with equal scales along all axes; the still picture is its outline "
       "from the side. Compare it with a photograph taken at the bench."},
      csv,
      page};
}

}  // namespace taut::plot

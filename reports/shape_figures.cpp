#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "reports/run_sections.hpp"
#include "sim/core/units.hpp"

namespace taut::plot {

std::optional<Drawing> deformed_shapes(const RunRecord& record) {
  if (std::optional<Drawing> panels = shape_panels(record)) return panels;
  std::vector<double> xs, ys;
  for (const ShapeRecord& shape : record.shapes) {
    for (const std::array<double, 4>& s : shape.segments) {
      xs.insert(xs.end(), {s[0] / kMillimetre, s[2] / kMillimetre});
      ys.insert(ys.end(), {s[1] / kMillimetre, s[3] / kMillimetre});
    }
  }
  if (xs.empty()) return std::nullopt;
  std::vector<LegendEntry> legend = {{LegendEntry::heading, "Shape"}};
  const bool rest_first = record.shapes.front().label.starts_with("rest");
  const size_t ordered = record.shapes.size() - (rest_first ? 1 : 0);
  std::vector<std::string> colours;
  for (size_t i = 0; i < record.shapes.size(); ++i) {
    colours.push_back(rest_first && i == 0 ? "#9a9a9a" : ordered_colour(i - (rest_first ? 1 : 0), ordered));
    legend.push_back({LegendEntry::line, record.shapes[i].label, colours.back()});
  }
  Axis x = axis_over(xs, record.shape_axes[0] + " [mm]", 8, false);
  Axis y = axis_over(ys, record.shape_axes[1] + " [mm]", 5, false);
  // Equal scales: the box takes the data's proportions, and a lean figure gets room at its sides.
  constexpr double left = 76, below = 58, above = 26;
  const double legend_left = kPageWidth - legend_width(legend) - 8;
  const double across = legend_left - 24 - left;
  const double rows = 19.0 * static_cast<double>(legend.size()) + 20;
  const double tall = std::clamp(across * (y.high - y.low) / (x.high - x.low), std::max(160.0, rows), 560.0);
  const double scale = std::max((x.high - x.low) / across, (y.high - y.low) / tall);  // mm per px
  const auto widen = [](Axis& axis, double span) {
    const double middle = (axis.low + axis.high) / 2;
    axis.low = middle - span / 2;
    axis.high = middle + span / 2;
  };
  widen(x, scale * across);
  widen(y, scale * tall);
  y.step = x.step = std::min(x.step, 2 * y.step);

  Page page(kPageWidth, kTitle + above + tall + below, "Deformed shapes, to scale", record.title, record.simulated);
  page.legend(legend_left, below + tall - 6, legend);
  std::string csv = "shape,x0_mm,y0_mm,x1_mm,y1_mm\n";
  std::vector<std::string> plots;
  for (size_t i = 0; i < record.shapes.size(); ++i) {
    std::vector<std::vector<double>> rows_of_shape;
    for (const std::array<double, 4>& s : record.shapes[i].segments) {
      std::array<double, 4> mm{};
      for (size_t k = 0; k < 4; ++k) mm[k] = s[k] / kMillimetre;
      rows_of_shape.insert(rows_of_shape.end(), {{mm[0], mm[1]}, {mm[2], mm[3]}, {}});
      csv += line(record.shapes[i].label, mm[0], mm[1], mm[2], mm[3]);
    }
    if (rows_of_shape.empty()) continue;
    plots.push_back(fmt::format("{} using 1:2 with lines lw 1.8 lc rgb '{}'", page.data(rows_of_shape), colours[i]));
  }
  page.panel({left, below, left + across, below + tall}, x, y, "", plots);
  return Drawing{
      {"deformed_shapes", "Deformed shapes, to scale",
       "Outline of the specimen as the fitted model has it, seen from the side, with equal scales along both "
       "axes. Compare it with a photograph taken at the bench.",
       ""},
      csv,
      page};
}

std::optional<Drawing> variants(const RunRecord& record) {
  if (over_strain(record)) return std::nullopt;
  if (record.fit.parameters.empty() || (record.variants.empty() && record.references.empty())) return std::nullopt;
  struct Row {
    std::string kind, name;
    double value, se;
  };
  std::vector<std::vector<Row>> panels;
  std::vector<const ParameterEstimate*> compared;  // those that there is something to compare with
  size_t longest = 0, row_count = 0;
  for (size_t p = 0; p < record.fit.parameters.size(); ++p) {
    const ParameterEstimate& estimate = record.fit.parameters[p];
    std::vector<Row> rows = {{"main", "▶ " + (record.main.name.empty() ? std::string("this fit") : record.main.name),
                              estimate.value, estimate.standard_error}};
    for (const VariantRecord& v : record.variants) {
      const double nan = std::numeric_limits<double>::quiet_NaN();
      rows.push_back({"variant", v.name, p < v.values.size() ? v.values[p] : nan,
                      p < v.standard_errors.size() ? v.standard_errors[p] : nan});
      if (!std::isfinite(rows.back().value)) rows.back().name += " (no result)";
    }
    for (const ReferenceRecord& r : record.references) {
      if (r.parameter == estimate.spec.id) rows.push_back({"reference", r.source, r.value, 0});
    }
    if (rows.size() == 1) continue;
    compared.push_back(&estimate);
    for (Row& row : rows) {
      row.name = shortened(row.name, 50);
      longest = std::max(longest, length_of(row.name));
    }
    row_count += rows.size();
    panels.push_back(std::move(rows));
  }
  if (panels.empty()) return std::nullopt;
  constexpr double row_height = 30, below = 58, above = 34;
  std::vector<LegendEntry> legend = {{LegendEntry::point, "this fit", colour(0), 7}};
  if (!record.variants.empty()) legend.push_back({LegendEntry::point, "other mesh", colour(2), 6});
  legend.push_back({LegendEntry::bar_along_x, "± 1 standard error"});
  if (!record.references.empty()) legend.push_back({LegendEntry::point, "reference value", colour(1), 13});
  const std::string title = record.references.empty() ? "Effect of the mesh"
                            : record.variants.empty() ? "This fit and reference values"
                                                      : "Effect of the mesh, and reference values";
  const double left = 30 + 7.8 * static_cast<double>(longest);
  const double legend_left = kPageWidth - legend_width(legend) - 8;
  const double height = kTitle + row_height * static_cast<double>(row_count) +
                        static_cast<double>(panels.size()) * (below + above + row_height / 2) + 20;
  Page page(kPageWidth, height, title, record.title, record.simulated);
  page.legend(legend_left, height - kTitle - above - 6, legend);

  std::string csv = "parameter,unit,kind,name,value,standard_error\n";
  double top = height - kTitle - above;
  for (size_t p = 0; p < panels.size(); ++p) {
    const ParameterEstimate& estimate = *compared[p];
    const DisplayUnit unit = display_unit(estimate.value, estimate.spec.unit);
    std::map<std::string, std::vector<std::vector<double>>> points;
    std::vector<double> shown;
    std::string tics_text, extra;
    double y = static_cast<double>(panels[p].size());
    for (const Row& row : panels[p]) {
      csv += line(estimate.spec.id, estimate.spec.unit, row.kind, row.name, row.value, row.se);
      const double value = row.value / unit.factor, se = std::isfinite(row.se) ? row.se / unit.factor : 0;
      tics_text += fmt::format("{}{} {}", tics_text.empty() ? "" : ", ", literal(row.name), y);
      if (std::isfinite(value)) {
        points[row.kind].push_back({value, y, se});
        shown.insert(shown.end(), {value - se, value + se});
        if (row.kind == "reference") {
          extra += fmt::format(
              "set arrow from first {0:.10g}, graph 0 to first {0:.10g}, graph 1 nohead lw 1.5 dt (6,4) lc rgb '{1}'\n",
              value, colour(1));
        }
      }
      y -= 1;
    }
    extra += "set ytics (" + tics_text + ")\n";
    const double bottom = top - row_height * (static_cast<double>(panels[p].size()) + 0.5);
    std::vector<std::string> plots;
    const auto add = [&](const char* kind, const std::string& with, const std::string& colour) {
      if (points.contains(kind)) plots.push_back(page.data(points[kind]) + with + " lc rgb '" + colour + "'");
    };
    add("reference", " using 1:2 with points pt 13 ps 1.3", colour(1));
    add("variant", " using 1:2:3 with xerrorbars pt 6 ps 1.1 lw 2", colour(2));
    add("main", " using 1:2:3 with xerrorbars pt 7 ps 1.2 lw 2", colour(0));
    const std::string name = bracketed(estimate.spec.id, unit.name);
    const auto [low, high] =
        shown.empty() ? std::pair(1.0, 1.0) : std::pair(std::ranges::min(shown), std::ranges::max(shown));
    const Axis x = low > 0 && high / low > 20 ? logarithmic_axis_over(shown, name) : axis_over(shown, name, 6, false);
    const Axis rows{"", 0.4, static_cast<double>(panels[p].size()) + 0.6, 1};
    page.panel({left, bottom, legend_left - 24, top}, x, rows, "", plots, extra);
    top = bottom - below - above;
  }
  std::string caption;
  if (!record.variants.empty()) {
    caption =
        "The same fit with other elements and meshes (open circles) beside this one (filled circle). If the circles "
        "move by more than their bars, the mesh is part of the number and must be told with it.";
  }
  if (!record.references.empty()) caption += (caption.empty() ? "" : " ") + std::string("Dashed: reference values.");
  return Drawing{{"variants", title, caption, ""}, csv, page};
}

}  // namespace taut::plot

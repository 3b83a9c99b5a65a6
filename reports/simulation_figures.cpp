#include "reports/simulation_figures.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>

namespace taut::plot {
namespace {

constexpr size_t kFewSamples = 40;  // up to here each sample is a point

/// What curves run over: the sample variable as a series; of equilibria the control that drives them, where it does not
/// turn back.
Series samples_of(const SimulationRecord& record) {
  if (const Series* driver = driver_of(record);
      driver != nullptr &&
      (std::ranges::is_sorted(driver->values) || std::ranges::is_sorted(driver->values, std::greater())))
    return *driver;
  return {record.sample_name, record.sample_unit, record.sample_name, record.samples};
}

/// The largest size of the values of several series of one unit decides how they are shown.
WrittenUnit common_unit(const std::vector<const Series*>& list) {
  std::vector<double> all;
  for (const Series* series : list) all.insert(all.end(), series->values.begin(), series->values.end());
  return shown_unit(list.front()->unit, all);
}

/// Series of one unit each, in order of appearance.
std::vector<std::vector<const Series*>> by_unit(const std::vector<const Series*>& list) {
  std::vector<std::vector<const Series*>> groups;
  for (const Series* series : list) {
    const auto same = std::ranges::find_if(groups, [&](const auto& g) { return g.front()->unit == series->unit; });
    if (same != groups.end()) {
      same->push_back(series);
    } else {
      groups.push_back({series});
    }
  }
  return groups;
}

/// One panel of curves over a common x.
struct Panel {
  std::string title;
  std::vector<const Series*> y;
  double least_height;      ///< px
  size_t first_colour = 0;  ///< of its curves
};

std::string dashes(size_t i) {
  static const std::array<const char*, 4> kinds = {"", "dt (8,4)", "dt (2,3)", "dt (8,3,2,3)"};
  return kinds[i / 7 % kinds.size()];  // where the colours begin again
}

/// `ends`: start and end of the curves are marked.
std::vector<LegendEntry> legend_of(const Panel& panel, bool ends) {
  std::vector<LegendEntry> entries;
  for (const Series* series : panel.y) {
    const size_t c = panel.first_colour + entries.size();
    entries.push_back({dashes(c).empty() ? LegendEntry::line : LegendEntry::dashes, label_of(*series), colour(c)});
  }
  if (ends) {
    entries.push_back({LegendEntry::point, "start", kGrey, 6});
    entries.push_back({LegendEntry::point, "end", kGrey, 7});
  }
  return entries;
}

/// The axis that all panels share: where the ends are not marked from the first to the last sample, no farther, with a
/// little room around the points of few samples.
Axis common_axis(const std::vector<double>& xs, bool ends) {
  Axis x = axis_over(xs, "", 8, false);
  const auto [low, high] = std::ranges::minmax_element(xs);
  if (ends || low == xs.end() || !(*high > *low)) return x;
  const double room = xs.size() <= kFewSamples ? 0.03 * (x.high - x.low) : 0;
  x.low = *low - room;
  x.high = *high + room;
  return x;
}

void draw_panel(Page& page, const Box& box, const Panel& panel, const Axis& x, const std::vector<double>& xs,
                bool ends) {
  const WrittenUnit unit = common_unit(panel.y);
  const bool few = xs.size() <= kFewSamples, low = box.top - box.bottom < 200;
  std::vector<double> shown;
  Plots plots, marks;
  for (size_t i = 0; i < panel.y.size(); ++i) {
    const size_t c = panel.first_colour + i;
    Rows rows, real;
    for (size_t k = 0; k < xs.size(); ++k) {
      const double y = panel.y[i]->values[k] / unit.factor;
      shown.push_back(y);
      rows.emplace_back();  // where there is no value the line is interrupted
      if (std::isfinite(y) && std::isfinite(xs[k])) real.push_back(rows.back() = {xs[k], y});
    }
    if (real.empty()) continue;
    page.add(plots, rows, (few ? "linespoints pt 7 ps 0.4 lw 2 " : "lines lw 2 ") + dashes(c), colour(c));
    if (!ends) continue;
    page.add(marks, {real.front()}, "points pt 6 ps 1.1 lw 2", colour(c));
    page.add(marks, {real.back()}, "points pt 7 ps 1", colour(c));
  }
  plots.insert(plots.end(), marks.begin(), marks.end());
  const std::string what = panel.y.size() == 1 && !low ? shortened(label_of(*panel.y.front()), 34) : "";
  page.panel(box, x, axis_over(shown, bracketed(what, unit.label), low ? 3 : 6, false), panel.title, plots);
}

/// A column for x and each series.
std::string csv_of(const Series& x, const std::vector<Panel>& panels) {
  std::vector<const Series*> columns = {&x};
  for (const Panel& panel : panels) columns.insert(columns.end(), panel.y.begin(), panel.y.end());
  std::string csv;
  const auto add = [&](auto&& text) {
    for (const Series* series : columns) csv += text(*series, written_unit(series->unit)) + ",";
    csv.back() = '\n';
  };
  add([](const Series& series, const WrittenUnit& unit) { return series.id + "_" + unit.suffix; });
  for (size_t k = 0; k < x.values.size(); ++k)
    add([&](const Series& series, const WrittenUnit& unit) { return field(series.values[k] / unit.factor); });
  return csv;
}

/// Panels above each other over one x; `ends`: start and end of the curves are marked.
Drawing curves(const SimulationRecord& record, const std::string& name, const std::string& title,
               const std::string& caption, const Series& x_series, std::vector<Panel> panels, bool ends) {
  const WrittenUnit x_unit = shown_unit(x_series.unit, x_series.values);
  std::vector<double> xs, heights;
  for (const double x : x_series.values) xs.push_back(x / x_unit.factor);
  std::vector<std::vector<LegendEntry>> legends;
  size_t used = 0;
  for (Panel& panel : panels) {
    panel.first_colour = used;
    used += panel.y.size();
    legends.push_back(legend_of(panel, ends));
    heights.push_back(std::max(panel.least_height, legend_height(legends.back()) + 10));
  }
  const auto& widest = *std::ranges::max_element(legends, {}, [](const auto& legend) { return legend_width(legend); });
  const Grid grid = Grid({.left = 86, .below = 30, .foot = 28}, widest).rows(heights);
  Page page(kPageWidth, grid.height, "Simulation: " + title, record.title, false);
  Axis x = common_axis(xs, ends);
  for (size_t p = 0; p < panels.size(); ++p) {
    if (p + 1 == panels.size()) x.label = bracketed(label_of(x_series), x_unit.label);
    const Box box = grid.box(p);
    draw_panel(page, box, panels[p], x, xs, ends);
    page.legend(grid.legend_left, box.top - 8, legends[p]);
  }
  return Drawing{{name, title, caption}, csv_of(x_series, panels), page};
}

bool moves(const Series& series) {
  const auto [low, high] = std::ranges::minmax_element(series.values);
  return low != series.values.end() && *high > *low;
}

std::string ids_of(const std::vector<const Series*>& list) {
  std::string text;
  for (const Series* series : list) text += (text.empty() ? "" : ", ") + series->id;
  return text;
}

}  // namespace

std::string label_of(const Series& series) {
  return series.meaning.empty() ? series.id : series.meaning;
}

std::string shown_value(const Series& series, size_t sample) {
  const WrittenUnit unit = shown_unit(series.unit, series.values);
  double largest = 0, value = series.values[sample] / unit.factor;
  for (const double other : series.values) largest = std::max(largest, std::isfinite(other) ? std::abs(other) : 0);
  if (std::abs(value) < 1e-4 * largest / unit.factor) value = 0;
  return fmt::format("{:.4g}{}{}", value + 0.0, unit.label.empty() ? "" : " ", unit.label);
}

std::optional<Drawing> channels_of_unit(const SimulationRecord& record, const std::string& si_unit) {
  std::vector<const Series*> channels, controls;
  const Series x = samples_of(record);
  for (const Series& channel : record.channels) {
    if (channel.unit == si_unit) channels.push_back(&channel);
  }
  if (channels.empty()) return std::nullopt;
  for (const Series& control : record.controls) {
    if (control.id != x.id && moves(control)) controls.push_back(&control);
  }
  const WrittenUnit unit = common_unit(channels);
  const std::string title =
      (unit.label.empty() ? "channels without unit" : "channels in " + unit.label) + " over " + label_of(x);
  std::vector<Panel> panels = {{"Computed", channels, 300}};
  for (const auto& group : by_unit(controls)) panels.push_back({"Prescribed", group, 110});
  std::string caption = fmt::format("What the simulation computes ({}) over {}", ids_of(channels), label_of(x));
  caption += controls.empty() ? "." : fmt::format("; below it the controls that drive it ({}).", ids_of(controls));
  return curves(record, "channels_" + file_name_of(written_unit(si_unit).suffix), title, caption, x, panels, false);
}

Drawing asked_plot(const SimulationRecord& record, const SimulationRecord::Plot& plot) {
  const Series samples = samples_of(record);
  const std::vector<const Series*> all = all_series(record);
  const auto named = [&](const std::string& id) {
    const auto found = std::ranges::find(all, id, &Series::id);
    return found == all.end() ? &samples : *found;  // check() has seen that it exists
  };
  const Series* x = plot.x.empty() ? &samples : named(plot.x);
  std::vector<const Series*> y;
  for (const std::string& id : plot.y) y.push_back(named(id));
  std::vector<Panel> panels;
  for (const auto& group : by_unit(y)) panels.push_back({"", group, 300});
  const bool path = x != &samples;
  std::string caption = fmt::format("{} over {}.", ids_of(y), x->id);
  if (path) {
    caption +=
        fmt::format(" The curves run in the order of {}, from the open circle to the filled one.", record.sample_name);
  }
  return curves(record, "plot_" + file_name_of(plot.id), plot.title.empty() ? plot.id : plot.title, caption, *x, panels,
                path);
}

std::optional<Drawing> workspaces(const SimulationRecord& record) {
  if (record.workspaces.empty()) return std::nullopt;
  std::vector<double> xs, ys;
  std::vector<LegendEntry> legend = {{LegendEntry::heading, "Mode and area"}};
  std::string csv = "mode,kind,x_mm,y_mm\n";
  for (const SimulationRecord::Workspace& space : record.workspaces) {
    legend.push_back({LegendEntry::line,
                      fmt::format("{}: {:.3g} ± {:.2g} cm²", space.mode, space.area / 1e-4, space.area_error / 1e-4),
                      colour(legend.size() - 1)});
    for (const auto& [kind, points] : {std::pair("point", &space.points), std::pair("outline", &space.outline)}) {
      for (const std::vector<double>& p : rows_in(kMillimetre, *points)) {
        xs.push_back(p[0]);
        ys.push_back(p[1]);
        csv += line(space.mode, kind, p[0], p[1]);
      }
    }
  }
  legend.push_back({LegendEntry::point, "one equilibrium", kGrey, 7});
  Axis x = axis_over(xs, "x [mm]", 8, false), y = axis_over(ys, "y [mm]", 6, false);
  Grid grid({.left = 86}, legend);
  const double least = std::max(240.0, legend_height(legend) + 20);
  grid.rows({to_one_scale(x, y, grid.across, least, 620)});
  x.step = y.step = std::max(x.step, y.step);
  Page page = grid.page("Simulation: reachable places", record.title, false);
  Plots areas, points, outlines;
  for (size_t i = 0; i < record.workspaces.size(); ++i) {
    const SimulationRecord::Workspace& space = record.workspaces[i];
    page.add(points, rows_in(kMillimetre, space.points), "points pt 7 ps 0.35", colour(i));
    const Rows outline = closed(rows_in(kMillimetre, space.outline));
    page.add(areas, outline, "filledcurves closed fs transparent solid 0.12 noborder", colour(i));
    page.add(outlines, outline, "lines lw 2", colour(i));
  }
  Plots plots(areas.rbegin(), areas.rend());
  for (const Plots& more : {points, outlines}) plots.insert(plots.end(), more.begin(), more.end());
  page.panel(grid.box(0), x, y, "", plots);
  const char* caption =
      "Where the chosen place of the robot comes to in each actuation mode: every dot is one computed equilibrium, or "
      "its "
      "mirror image where the scene is symmetric, the line is the outline of all of them and the number its area, with "
      "what half of the dots, or a finer outline, change of it.";
  return Drawing{{"workspaces", "reachable places", caption}, csv, page};
}

}  // namespace taut::plot

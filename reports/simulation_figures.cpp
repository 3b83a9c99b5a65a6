#include "reports/simulation_figures.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace taut::plot {
namespace {

constexpr double kLeft = 86, kBelow = 58, kAbove = 30, kBetween = 30;  // of a panel, px
constexpr double kLegendRow = 19;                                      // px
constexpr size_t kFewSamples = 40;                                     // up to here each sample is a point

std::string label_of(const Series& series) {
  return series.meaning.empty() ? series.id : series.meaning;
}

/// The sample variable as a series.
Series samples_of(const SimulationRecord& record) {
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
  double least_height;  ///< px
};

std::string dashes(size_t i) {
  static const std::array<const char*, 4> kinds = {"", "dt (8,4)", "dt (2,3)", "dt (8,3,2,3)"};
  return kinds[i / 7 % kinds.size()];  // where the colours begin again
}

/// Panels above each other over one x; `ends`: start and end of the curves are marked.
Drawing curves(const SimulationRecord& record, const std::string& name, const std::string& title,
               const std::string& caption, const Series& x_series, const std::vector<Panel>& panels, bool ends) {
  const WrittenUnit x_unit = shown_unit(x_series.unit, x_series.values);
  const size_t count = x_series.values.size();
  std::vector<double> xs;
  for (const double x : x_series.values) xs.push_back(x / x_unit.factor);
  Axis x = axis_over(xs, bracketed(label_of(x_series), x_unit.label), 8, false);
  const double room = 0.03 * (x.high - x.low);
  if (!ends && count > 1) {  // from the first to the last sample, no farther
    const auto [low, high] = std::ranges::minmax(xs);
    if (high > low) {
      x.low = low;
      x.high = high + (count <= kFewSamples ? room : 0);
      if (count <= kFewSamples) x.low -= room;
    }
  }

  std::vector<std::vector<LegendEntry>> legends;
  double legend = 0, height = kTitle;
  std::vector<double> tall;
  std::vector<size_t> first_colour;
  size_t used = 0;
  for (const Panel& panel : panels) {
    first_colour.push_back(used);
    used += panel.y.size();
    std::vector<LegendEntry>& entries = legends.emplace_back();
    for (size_t i = 0; i < panel.y.size(); ++i) {
      const size_t c = first_colour.back() + i;
      entries.push_back(
          {dashes(c).empty() ? LegendEntry::line : LegendEntry::dashes, label_of(*panel.y[i]), colour(c)});
    }
    if (ends) {
      entries.push_back({LegendEntry::point, "start", kGrey, 6});
      entries.push_back({LegendEntry::point, "end", kGrey, 7});
    }
    legend = std::max(legend, legend_width(entries));
    tall.push_back(std::max(panel.least_height, kLegendRow * static_cast<double>(entries.size()) + 10));
    height += kAbove + tall.back() + (legends.size() < panels.size() ? kBetween : kBelow);
  }
  const double legend_left = kPageWidth - legend - 8;

  Page page(kPageWidth, height, "Simulation: " + title, record.title, false);
  std::string header = x_series.id + "_" + written_unit(x_series.unit).suffix + ",";
  std::vector<const Series*> columns;
  double top = height - kTitle - kAbove;
  for (size_t p = 0; p < panels.size(); ++p) {
    const Panel& panel = panels[p];
    const WrittenUnit unit = common_unit(panel.y);
    std::vector<double> shown;
    std::vector<std::string> plots, marks;
    for (size_t i = 0; i < panel.y.size(); ++i) {
      const Series& series = *panel.y[i];
      const size_t c = first_colour[p] + i;
      columns.push_back(&series);
      header += series.id + "_" + written_unit(series.unit).suffix + ",";
      std::vector<std::vector<double>> rows, first, last;
      for (size_t k = 0; k < count; ++k) {
        const double y = series.values[k] / unit.factor;
        shown.push_back(y);
        if (!std::isfinite(y) || !std::isfinite(xs[k])) {
          rows.push_back({});  // the line is interrupted
          continue;
        }
        rows.push_back({xs[k], y});
        if (first.empty()) first = {rows.back()};
        last = {rows.back()};
      }
      if (last.empty()) continue;
      plots.push_back(fmt::format("{} using 1:2 with {} lw 2 {} lc rgb '{}'", page.data(rows),
                                  count <= kFewSamples ? "linespoints pt 7 ps 0.4" : "lines", dashes(c), colour(c)));
      if (ends) {
        marks.push_back(
            fmt::format("{} using 1:2 with points pt 6 ps 1.1 lw 2 lc rgb '{}'", page.data(first), colour(c)));
        marks.push_back(fmt::format("{} using 1:2 with points pt 7 ps 1 lc rgb '{}'", page.data(last), colour(c)));
      }
    }
    plots.insert(plots.end(), marks.begin(), marks.end());
    const bool low = tall[p] < 200;
    const std::string what = panel.y.size() == 1 && !low ? shortened(label_of(*panel.y.front()), 34) : "";
    const Axis y = axis_over(shown, bracketed(what, unit.label), low ? 3 : 6, false);
    Axis panel_x = x;
    if (p + 1 < panels.size()) panel_x.label.clear();
    page.panel({kLeft, top - tall[p], legend_left - 24, top}, panel_x, y, panel.title, plots);
    page.legend(legend_left, top - 8, legends[p]);
    top -= tall[p] + kBetween + kAbove;
  }
  header.back() = '\n';
  std::string csv = header;
  for (size_t k = 0; k < count; ++k) {
    csv += field(x_series.values[k] / written_unit(x_series.unit).factor);
    for (const Series* series : columns) csv += "," + field(series->values[k] / written_unit(series->unit).factor);
    csv += "\n";
  }
  return Drawing{{name, title, caption, ""}, csv, page};
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

std::optional<Drawing> channels_of_unit(const SimulationRecord& record, const std::string& si_unit) {
  std::vector<const Series*> channels, controls;
  for (const Series& channel : record.channels) {
    if (channel.unit == si_unit) channels.push_back(&channel);
  }
  if (channels.empty()) return std::nullopt;
  for (const Series& control : record.controls) {
    if (control.id != record.sample_name && moves(control)) controls.push_back(&control);
  }
  const WrittenUnit unit = common_unit(channels);
  const std::string title =
      (unit.label.empty() ? "channels without unit" : "channels in " + unit.label) + " over " + record.sample_name;
  std::vector<Panel> panels = {{"Computed", channels, 300}};
  for (const auto& group : by_unit(controls)) panels.push_back({"Prescribed", group, 110});
  std::string caption = fmt::format("What the simulation computes ({}) over {}", ids_of(channels), record.sample_name);
  caption += controls.empty() ? "." : fmt::format("; below it the controls that drive it ({}).", ids_of(controls));
  return curves(record, "channels_" + file_name_of(written_unit(si_unit).suffix), title, caption, samples_of(record),
                panels, false);
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
  for (size_t i = 0; i < record.workspaces.size(); ++i) {
    const SimulationRecord::Workspace& space = record.workspaces[i];
    legend.push_back({LegendEntry::line, fmt::format("{}: {:.3g} cm²", space.mode, space.area / 1e-4), colour(i)});
    for (const auto& [kind, points] : {std::pair("point", &space.points), std::pair("outline", &space.outline)}) {
      for (const Eigen::Vector2d& p : *points) {
        xs.push_back(p.x() / kMillimetre);
        ys.push_back(p.y() / kMillimetre);
        csv += line(space.mode, std::string(kind), xs.back(), ys.back());
      }
    }
  }
  legend.push_back({LegendEntry::point, "one equilibrium", kGrey, 7});
  Axis x = axis_over(xs, "x [mm]", 8, false), y = axis_over(ys, "y [mm]", 6, false);
  const double legend_left = kPageWidth - legend_width(legend) - 8, across = legend_left - 24 - kLeft;
  const double rows = kLegendRow * static_cast<double>(legend.size()) + 20;
  const double tall = std::clamp(across * (y.high - y.low) / (x.high - x.low), std::max(240.0, rows), 620.0);
  const double scale = std::max((x.high - x.low) / across, (y.high - y.low) / tall);  // mm per px
  for (const auto& [axis, pixels] : {std::pair(&x, across), std::pair(&y, tall)}) {
    const double middle = (axis->low + axis->high) / 2;
    axis->low = middle - scale * pixels / 2;
    axis->high = middle + scale * pixels / 2;
  }
  x.step = y.step = std::max(x.step, y.step);
  Page page(kPageWidth, kTitle + kAbove + tall + kBelow, "Simulation: reachable places", record.title, false);
  page.legend(legend_left, kBelow + tall - 6, legend);
  std::vector<std::string> points, outlines;
  for (size_t i = 0; i < record.workspaces.size(); ++i) {
    const auto rows_of = [](const std::vector<Eigen::Vector2d>& list) {
      std::vector<std::vector<double>> out;
      for (const Eigen::Vector2d& p : list) out.push_back({p.x() / kMillimetre, p.y() / kMillimetre});
      return out;
    };
    if (!record.workspaces[i].points.empty()) {
      points.push_back(fmt::format("{} using 1:2 with points pt 7 ps 0.35 lc rgb '{}'",
                                   page.data(rows_of(record.workspaces[i].points)), colour(i)));
    }
    if (record.workspaces[i].outline.empty()) continue;
    std::vector<std::vector<double>> outline = rows_of(record.workspaces[i].outline);
    outline.push_back(std::vector<double>(outline.front()));
    const std::string block = page.data(outline);
    points.insert(points.begin(),
                  fmt::format("{} using 1:2 with filledcurves closed fs transparent solid 0.12 noborder "
                              "fc rgb '{}'",
                              block, colour(i)));
    outlines.push_back(fmt::format("{} using 1:2 with lines lw 2 lc rgb '{}'", block, colour(i)));
  }
  points.insert(points.end(), outlines.begin(), outlines.end());
  page.panel({kLeft, kBelow, kLeft + across, kBelow + tall}, x, y, "", points);
  return Drawing{{"workspaces", "reachable places",
                  "Where the chosen place of the robot comes to in each actuation mode: every dot is one computed "
                  "equilibrium, the line is the outline of all of them and the number its area.",
                  ""},
                 csv,
                 page};
}

}  // namespace taut::plot

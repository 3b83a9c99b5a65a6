#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "reports/diagnostic.hpp"
#include "reports/run_sections.hpp"
#include "sim/core/units.hpp"

namespace taut::plot {
namespace {

constexpr double kRise = k95 * k95;  // of chi squared at the ends of a 95 % interval
constexpr double kHighest = 8;       // rise that is drawn; points above are in the CSV only

using Points = std::vector<std::pair<double, double>>;  // value, rise of chi squared

/// The finite points of a profile; empty when it has none beside the optimum.
Points points_of(const ParameterEstimate& estimate) {
  Points points;
  for (const auto& [value, rise] : estimate.profile) {
    if (std::isfinite(value) && std::isfinite(rise)) points.emplace_back(value, std::max(rise, 0.0));
  }
  std::ranges::sort(points);
  return points.size() < 2 ? Points() : points;
}

/// The line through the points: straight in the root of the rise, negative below the optimum, so that a parabola comes
/// out as one.
std::vector<std::vector<double>> joined(const Points& points, double optimum, bool logarithmic) {
  const auto root = [&](const std::pair<double, double>& point) {
    return (point.first < optimum ? -1 : 1) * std::sqrt(point.second);
  };
  std::vector<std::vector<double>> rows;
  constexpr int steps = 24;
  for (size_t i = 0; i + 1 < points.size(); ++i) {
    const double a = points[i].first, b = points[i + 1].first, from = root(points[i]), to = root(points[i + 1]);
    for (int k = i == 0 ? 0 : 1; k <= steps; ++k) {
      const double t = static_cast<double>(k) / steps, value = from + t * (to - from);
      rows.push_back({logarithmic ? a * std::pow(b / a, t) : a + t * (b - a), value * value});
    }
  }
  return rows;
}

/// Why the interval is open on one side.
std::string open_end(const ParameterEstimate& estimate, const Points& points, bool above) {
  const auto& [value, rise] = above ? points.back() : points.front();
  const double bound = above ? estimate.upper : estimate.lower;
  const bool at_bound = std::abs(value - bound) <= 1e-6 * std::abs(bound);
  const std::string side = fmt::format(" {} is open {}: chi squared ", estimate.spec.id, above ? "above" : "below");
  const std::string place = with_unit(value, estimate.spec.unit, 3);
  if (rise >= 0.99 * kRise) {
    return side + fmt::format("rises by {:.2f} up to {} only because another parameter meets its bound.", kRise, place);
  }
  if (at_bound) {
    return side + fmt::format(
                      "rises by {:.2g} only as far as {}, the bound of the fit, so the readings set no limit "
                      "there.",
                      rise, place);
  }
  return side + fmt::format("rises by {:.2g} only as far as {}, and no farther could be searched.", rise, place);
}

/// "1.88 to 13.1 GPa", "1.88 GPa to open".
std::string interval_of(const ParameterEstimate& estimate, const DisplayUnit& unit) {
  const std::string name = unit.name.empty() || unit.name == "1" ? "" : " " + unit.name;
  const auto text = [&](const std::optional<double>& end, bool with_name) {
    return end ? fmt::format("{:.4g}{}", *end / unit.factor, with_name ? name : "") : "open";
  };
  if (!estimate.lower95 && !estimate.upper95) return "open on both sides";
  return text(estimate.lower95, !estimate.upper95) + " to " + text(estimate.upper95, true);
}

std::string profile_csv(const ParameterEstimate& estimate, const Points& points) {
  const std::string &id = estimate.spec.id, &si = estimate.spec.unit;
  std::string csv;
  const double nan = std::numeric_limits<double>::quiet_NaN();
  csv += line(id, si, std::string("value"), estimate.value, 0.0);
  csv += line(id, si, std::string("lower95"), estimate.lower95.value_or(nan), estimate.lower95 ? kRise : nan);
  csv += line(id, si, std::string("upper95"), estimate.upper95.value_or(nan), estimate.upper95 ? kRise : nan);
  for (const auto& [value, rise] : points) csv += line(id, si, std::string("point"), value, rise);
  return csv;
}

Axis profile_axis(const std::vector<double>& shown, const std::string& name, bool logarithmic) {
  const Axis linear = axis_over(shown, name, 5, false);
  if (!logarithmic) return linear;
  Axis x = logarithmic_axis_over(shown, name + ", logarithmic");
  const auto [low, high] = std::ranges::minmax(shown);
  const double room = std::pow(high / low, 0.06);
  x.low = low / room;
  x.high = high * room;
  x.step = linear.step;
  return x;
}

/// The interval as an area, to the edge of the panel where it is open, and the rise of chi squared at its ends.
std::string interval_marks(const ParameterEstimate& estimate, const DisplayUnit& unit) {
  const auto edge = [&](const std::optional<double>& end, int open) {
    return end ? fmt::format("first {:.10g}", *end / unit.factor) : fmt::format("graph {}", open);
  };
  std::string extra = fmt::format(
      "set object rectangle from {}, graph 0 to {}, graph 1 behind fs transparent solid 0.14 noborder fc rgb '{}'\n",
      edge(estimate.lower95, 0), edge(estimate.upper95, 1), colour(0));
  extra += fmt::format(
      "set arrow from graph 0, first {0:.10g} to graph 1, first {0:.10g} nohead lw 1.5 dt (6,4) lc rgb '{1}'\n", kRise,
      colour(1));
  extra +=
      fmt::format("set label '{:.2f}' at first {:.10g}, first {:.10g} center offset 0,0.6 font ',11' tc rgb '{}'\n",
                  kRise, estimate.value / unit.factor, kRise, colour(1));
  for (const bool upper : {false, true}) {
    if (upper ? estimate.upper95.has_value() : estimate.lower95.has_value()) continue;
    extra += fmt::format(
        "set arrow from graph {}, graph 0.93 to graph {}, graph 0.93 head filled size screen {:.5f},18 lw 2.5 lc rgb "
        "'{}'\n",
        upper ? 0.86 : 0.14, upper ? 0.99 : 0.01, 10 / kPageWidth, colour(1));
    extra += fmt::format("set label 'open' at graph {}, graph 0.93 {} font ',12' tc rgb '{}'\n", upper ? 0.84 : 0.16,
                         upper ? "right" : "left", colour(1));
  }
  return extra;
}

/// A panel of one profile; the `first` of a row names its upright axis.
void add_profile(Page& page, const Box& box, const ParameterEstimate& estimate, const Points& points, bool first) {
  const DisplayUnit unit = display_unit(estimate.value, estimate.spec.unit);
  const bool logarithmic = estimate.spec.logarithmic && points.front().first > 0;
  Points met = points;  // and the ends of the interval, which may lie a little beyond the last point
  if (estimate.lower95 && *estimate.lower95 < met.front().first) met.insert(met.begin(), {*estimate.lower95, kRise});
  if (estimate.upper95 && *estimate.upper95 > met.back().first) met.emplace_back(*estimate.upper95, kRise);
  std::vector<std::vector<double>> curve = joined(met, estimate.value, logarithmic), marks;
  for (std::vector<double>& point : curve) point[0] /= unit.factor;
  std::vector<double> shown = {estimate.value / unit.factor};
  double highest = 1.3 * kRise;
  for (const auto& [value, rise] : points) {
    if (value == estimate.value || rise > kHighest) continue;
    marks.push_back({value / unit.factor, rise});
    shown.push_back(value / unit.factor);
    highest = std::max(highest, 1.06 * rise);
  }
  for (const std::optional<double>& end : {estimate.lower95, estimate.upper95}) {
    if (end) shown.push_back(*end / unit.factor);
  }
  const std::string name = bracketed(estimate.spec.id, unit.name);
  const Axis x = profile_axis(shown, name, logarithmic);
  const Axis y{first ? "rise of chi squared" : "", 0, highest, highest > 6 ? 2.0 : 1.0};

  std::vector<std::string> plots = {
      fmt::format("{} using 1:2 with lines lw 2 lc rgb '{}'", page.data(curve), colour(0))};
  if (!marks.empty()) {
    plots.push_back(
        fmt::format("{} using 1:2 with points pt 6 ps 0.9 lw 1.4 lc rgb '{}'", page.data(marks), colour(0)));
  }
  plots.push_back(fmt::format("{} using 1:2 with points pt 7 ps 1.2 lc rgb '{}'",
                              page.data({{estimate.value / unit.factor, 0}}), colour(0)));
  page.panel(box, x, y, estimate.spec.id + ": " + interval_of(estimate, unit), plots, interval_marks(estimate, unit));
}

std::string label_of(const DiagnosticRecord& part) {
  return shortened(part.part, 40) + (std::isfinite(part.value) ? "" : " (failed)");
}

}  // namespace

std::optional<Drawing> profiles(const RunRecord& record) {
  struct Panel {
    const ParameterEstimate* estimate;
    Points points;
  };
  std::vector<Panel> panels;
  bool any_open = false;
  for (const ParameterEstimate& estimate : record.fit.parameters) {
    Points points = points_of(estimate);
    if (points.empty() || !std::isfinite(estimate.value)) continue;
    any_open = any_open || !estimate.lower95 || !estimate.upper95;
    panels.push_back({&estimate, std::move(points)});
  }
  if (panels.empty()) return std::nullopt;

  std::vector<LegendEntry> legend = {{LegendEntry::point, "fitted value", colour(0), 7},
                                     {LegendEntry::point, "refit of the others", colour(0), 6},
                                     {LegendEntry::line, "between the points", colour(0)},
                                     {LegendEntry::band, "95 % interval", colour(0)},
                                     {LegendEntry::dashes, fmt::format("rise of {:.2f}", kRise), colour(1)}};
  if (any_open) legend.push_back({LegendEntry::arrow, "open: no limit", colour(1)});
  constexpr double left = 76, gap = 50, below = 58, above = 34, tall = 210;
  const size_t columns = panels.size() == 1 ? 1 : 2, rows = (panels.size() + columns - 1) / columns;
  const double legend_left = kPageWidth - legend_width(legend) - 8;
  const double across =
      (legend_left - 24 - left - gap * static_cast<double>(columns - 1)) / static_cast<double>(columns);
  const double height = kTitle + static_cast<double>(rows) * (above + tall + below);
  Page page(kPageWidth, height, "How well the readings know each parameter", record.title, record.simulated);
  page.legend(legend_left, height - kTitle - above - 6, legend);

  std::string csv = "parameter,unit,kind,value,rise_of_chi_squared\n", open_ends;
  for (size_t p = 0; p < panels.size(); ++p) {
    const ParameterEstimate& estimate = *panels[p].estimate;
    const Points& points = panels[p].points;
    csv += profile_csv(estimate, points);
    if (!estimate.lower95) open_ends += open_end(estimate, points, false);
    if (!estimate.upper95) open_ends += open_end(estimate, points, true);

    const double from = left + static_cast<double>(p % columns) * (across + gap);
    const double top = height - kTitle - above - static_cast<double>(p / columns) * (above + tall + below);
    add_profile(page, {from, top - tall, from + across, top}, estimate, points, p % columns == 0);
  }
  return Drawing{
      {"profiles", "How well the readings know each parameter",
       fmt::format("Each parameter is held at several values while all others are fitted again; the rise of chi "
                   "squared over the best fit says how much worse that is. Values below the dashed line at {:.2f} are "
                   "the 95 % interval. A steep valley is a parameter that the readings know well, a flat side one "
                   "that they leave open.",
                   kRise) +
           open_ends,
       ""},
      csv,
      page};
}

std::optional<Drawing> diagnostic(const RunRecord& record) {
  const std::vector<DiagnosticGroup> groups = diagnostic_groups(record);
  if (groups.empty()) return std::nullopt;
  size_t longest = 0, row_count = 0;
  for (const DiagnosticGroup& group : groups) {
    row_count += group.parts.size();
    for (const DiagnosticRecord* part : group.parts) longest = std::max(longest, length_of(label_of(*part)));
  }
  constexpr double row_height = 30, below = 58, above = 34;
  const std::vector<LegendEntry> legend = {{LegendEntry::point, "from these alone", colour(0), 6},
                                           {LegendEntry::bar_along_x, "95 % of its fit", colour(0)},
                                           {LegendEntry::line, "whole fit", kBlack},
                                           {LegendEntry::band, "its 95 % interval", kBlack}};
  const double left = 30 + 7.8 * static_cast<double>(longest);
  const double legend_left = kPageWidth - legend_width(legend) - 8;
  const double height = std::max(kTitle + row_height * static_cast<double>(row_count) +
                                     static_cast<double>(groups.size()) * (below + above + row_height / 2),
                                 kTitle + above + 19.0 * static_cast<double>(legend.size()) + 20);
  const std::string title = "From each " + groups.front().held + " alone";
  Page page(kPageWidth, height, title, record.title, record.simulated);
  page.legend(legend_left, height - kTitle - above - 6, legend);

  std::string csv = "parameter,unit,part,readings,value,standard_error,lower95,upper95,chi_squared\n";
  double top = height - kTitle - above;
  for (const DiagnosticGroup& group : groups) {
    const ParameterEstimate& whole = *group.whole;
    const DisplayUnit unit = display_unit(whole.value, whole.spec.unit);
    const double lower = whole.lower95.value_or(whole.value - k95 * whole.standard_error);
    const double upper = whole.upper95.value_or(whole.value + k95 * whole.standard_error);
    std::vector<double> shown = {whole.value / unit.factor, lower / unit.factor, upper / unit.factor};
    csv += line(whole.spec.id, whole.spec.unit, std::string("all"), static_cast<int>(record.readings.size()),
                whole.value, whole.standard_error, lower, upper, record.fit.chi_squared);
    std::vector<std::vector<double>> points;
    std::string tics_text;
    double y = static_cast<double>(group.parts.size());
    for (const DiagnosticRecord* part : group.parts) {
      const double half = k95 * part->standard_error;
      csv += line(whole.spec.id, whole.spec.unit, part->part, part->readings, part->value, part->standard_error,
                  part->value - half, part->value + half, part->chi_squared);
      tics_text += fmt::format("{}{} {}", tics_text.empty() ? "" : ", ", literal(label_of(*part)), y);
      if (std::isfinite(part->value)) {
        const double value = part->value / unit.factor, bar = std::isfinite(half) ? half / unit.factor : 0;
        points.push_back({value, y, bar});
        shown.insert(shown.end(), {value - bar, value + bar});
      }
      y -= 1;
    }
    const double tall = row_height * (static_cast<double>(group.parts.size()) + 0.5);
    std::string extra = "set ytics (" + tics_text + ")\n";
    if (std::isfinite(lower) && std::isfinite(upper)) {
      extra += fmt::format(
          "set object rectangle from first {:.10g}, graph 0 to first {:.10g}, graph 1 behind fs transparent solid 0.14 "
          "noborder fc rgb '{}'\n",
          lower / unit.factor, upper / unit.factor, kBlack);
    }
    if (std::isfinite(whole.value)) {
      extra +=
          fmt::format("set arrow from first {0:.10g}, graph 0 to first {0:.10g}, graph 1 nohead lw 1.5 lc rgb '{1}'\n",
                      whole.value / unit.factor, kBlack);
    }
    std::vector<std::string> plots;
    if (!points.empty()) {
      plots.push_back(
          fmt::format("{} using 1:2:3 with xerrorbars pt 6 ps 1.1 lw 2 lc rgb '{}'", page.data(points), colour(0)));
    }
    const std::string name = bracketed(whole.spec.id, unit.name);
    page.panel({left, top - tall, legend_left - 24, top}, axis_over(shown, name, 6, false),
               {"", 0.4, static_cast<double>(group.parts.size()) + 0.6, 1}, "", plots, extra);
    top -= tall + below + above;
  }
  return Drawing{{"diagnostic", title,
                  "One parameter fitted to each part of the readings alone, everything else held at the whole fit, "
                  "with 95 % bars. Bars that miss the grey band, and more so a drift from one part to the next, say "
                  "that one law does not serve all readings.",
                  ""},
                 csv,
                 page};
}

}  // namespace taut::plot

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "reports/run_sections.hpp"
#include "sim/core/units.hpp"

namespace taut::plot {
namespace {

constexpr double kRise = z95 * z95;  // of chi squared at the ends of a 95 % interval
constexpr double kHighest = 8;       // rise that is drawn; points above are in the CSV only

using Profile = std::vector<std::pair<double, double>>;  // value, rise of chi squared

/// The finite points of the profile of parameter j, those of an ensemble of profiles among them; empty when it has none
/// beside the optimum.
Profile points_of(const RunRecord& record, size_t j) {
  Profile points;
  const auto add = [&](const Profile& profile) {
    for (const auto& [value, rise] : profile) {
      if (std::isfinite(value) && std::isfinite(rise)) points.emplace_back(value, std::max(rise, 0.0));
    }
  };
  add(record.fit.parameters[j].profile);
  for (const EnsembleRecord& ensemble : record.ensembles) {
    if (j < ensemble.profiles.size()) add(ensemble.profiles[j]);
  }
  std::ranges::sort(points);
  points.erase(std::ranges::unique(points, {}, &std::pair<double, double>::first).begin(), points.end());
  return points.size() < 2 ? Profile() : points;
}

/// The line through the points: straight in the root of the rise, negative below the optimum, so that a parabola comes
/// out as one.
Rows joined(const Profile& points, double optimum, bool logarithmic) {
  const auto root = [&](const std::pair<double, double>& point) {
    return (point.first < optimum ? -1 : 1) * std::sqrt(point.second);
  };
  Rows rows;
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
std::string open_end(const ParameterEstimate& estimate, const Profile& points, bool above) {
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

std::string profile_csv(const ParameterEstimate& estimate, const Profile& points) {
  std::string csv;
  const auto add = [&](const char* kind, const std::optional<double>& value, double rise) {
    const double nan = std::nan("");
    csv += line(estimate.spec.id, estimate.spec.unit, kind, value.value_or(nan), value ? rise : nan);
  };
  add("value", estimate.value, 0);
  add("lower95", estimate.lower95, kRise);
  add("upper95", estimate.upper95, kRise);
  for (const auto& [value, rise] : points) add("point", value, rise);
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
    return end ? first(*end / unit.factor) : fmt::format("graph {}", open);
  };
  std::string extra = shade(edge(estimate.lower95, 0) + ", graph 0", edge(estimate.upper95, 1) + ", graph 1",
                            "transparent solid 0.14", colour(0)) +
                      horizontal_line(kRise, colour(1), kDashed);
  extra += fmt::format("set label '{:.2f}' at {}, {} center offset 0,0.6 font ',12' tc rgb '{}'\n", kRise,
                       first(estimate.value / unit.factor), first(kRise), colour(1));
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

/// A panel of one profile; the `leftmost` of a row names its upright axis.
void add_profile(Page& page, const Box& box, const ParameterEstimate& estimate, const Profile& points, bool leftmost) {
  const DisplayUnit unit = display_unit(estimate.value, estimate.spec.unit);
  const bool logarithmic = estimate.spec.logarithmic && points.front().first > 0;
  Profile met = points;  // and the ends of the interval, which may lie a little beyond the last point
  if (estimate.lower95 && *estimate.lower95 < met.front().first) met.insert(met.begin(), {*estimate.lower95, kRise});
  if (estimate.upper95 && *estimate.upper95 > met.back().first) met.emplace_back(*estimate.upper95, kRise);
  Rows curve = joined(met, estimate.value, logarithmic), marks;
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
  Plots plots;
  page.add(plots, curve, "lines lw 2", colour(0));
  page.add(plots, marks, "points pt 6 ps 0.9 lw 1.4", colour(0));
  page.add(plots, {{estimate.value / unit.factor, 0}}, "points pt 7 ps 1.2", colour(0));
  page.panel(box, profile_axis(shown, bracketed(estimate.spec.id, unit.name), logarithmic),
             {leftmost ? "rise of chi squared" : "", 0, highest, highest > 6 ? 2.0 : 1.0},
             estimate.spec.id + ": " + interval_of(estimate, unit), plots, interval_marks(estimate, unit));
}

}  // namespace

std::optional<Drawing> profiles(const RunRecord& record) {
  std::vector<std::pair<const ParameterEstimate*, Profile>> panels;
  std::string csv = "parameter,unit,kind,value,rise_of_chi_squared\n", open_ends;
  for (size_t j = 0; j < record.fit.parameters.size(); ++j) {
    const ParameterEstimate& estimate = record.fit.parameters[j];
    Profile points = points_of(record, j);
    if (points.empty() || !std::isfinite(estimate.value)) continue;
    csv += profile_csv(estimate, points);
    if (!estimate.lower95) open_ends += open_end(estimate, points, false);
    if (!estimate.upper95) open_ends += open_end(estimate, points, true);
    panels.emplace_back(&estimate, std::move(points));
  }
  if (panels.empty()) return std::nullopt;

  std::vector<LegendEntry> legend = {{LegendEntry::point, "fitted value", colour(0), 7},
                                     {LegendEntry::point, "refit of the others", colour(0), 6},
                                     {LegendEntry::line, "between the points", colour(0)},
                                     {LegendEntry::band, "95 % interval", colour(0)},
                                     {LegendEntry::dashes, fmt::format("rise of {:.2f}", kRise), colour(1)}};
  if (!open_ends.empty()) legend.push_back({LegendEntry::arrow, "open: no limit", colour(1)});
  const Grid grid = Grid({.gap = 50, .above = 34}, legend, panels.size() == 1 ? 1 : 2).panels(panels.size(), 210);
  const std::string title = "How well the readings know each parameter";
  Page page = grid.page(title, record.title, record.simulated);
  for (size_t p = 0; p < panels.size(); ++p)
    add_profile(page, grid.box(p), *panels[p].first, panels[p].second, grid.leftmost(p));
  const std::string caption = fmt::format(
      "Each parameter is held at several values while all others are fitted again; the rise of chi squared over the "
      "best fit says how much worse that is. Values below the dashed line at {:.2f} are the 95 % interval. A steep "
      "valley is a parameter that the readings know well, a flat side one that they leave open.",
      kRise);
  return Drawing{{"profiles", title, caption + open_ends}, csv, page};
}

}  // namespace taut::plot

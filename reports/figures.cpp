#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <map>
#include <optional>

#include "calib/units.hpp"
#include "reports/gnuplot.hpp"
#include "reports/report.hpp"

namespace taut {
namespace {

using plot::Axis;
using plot::Box;
using plot::LegendEntry;

constexpr double kMillimetre = 1e-3;
constexpr double k95 = 1.959963984540054;  // 97.5 % quantile of the normal distribution
constexpr double kPageWidth = 960;         // px
constexpr double kTitle = 64;              // px, for the two lines of the title
constexpr double kPanelHeight = 330;       // px, axis labels and panel title not counted

/// A figure before it is drawn.
struct Drawing {
  Figure figure;
  std::string csv;
  plot::Page page;
};

/// Readings of one channel in one series, and the curve that the fit draws through them.
struct Group {
  std::string channel, series, colour;
  size_t panel = 0;  ///< one per channel
  double sign = 1;   ///< that makes the mean displacement positive
  std::vector<size_t> readings;
  const CurveRecord* curve = nullptr;
};

struct Groups {
  std::vector<Group> all;
  std::vector<std::string> channels, series, trials;  ///< in order of appearance
};

size_t place_in(std::vector<std::string>& list, const std::string& item) {
  const auto found = std::ranges::find(list, item);
  if (found != list.end()) return static_cast<size_t>(found - list.begin());
  list.push_back(item);
  return list.size() - 1;
}

std::string series_of(const RunRecord& record, size_t reading) {
  return record.series.empty() ? "" : record.series.at(reading);
}

bool has_loads(const RunRecord& record) {
  return !record.readings.empty() && record.load_newtons.size() == record.readings.size();
}

Groups groups_of(const RunRecord& record) {
  Groups groups;
  std::map<std::pair<size_t, size_t>, size_t> index;
  std::map<size_t, double> sum;  // of the readings of a channel
  for (size_t i = 0; i < record.readings.size(); ++i) {
    const ReadingRecord& reading = record.readings[i];
    const size_t channel = place_in(groups.channels, reading.channel);
    const size_t series = place_in(groups.series, series_of(record, i));
    place_in(groups.trials, reading.trial);
    sum[channel] += reading.measured;
    const auto [entry, added] = index.try_emplace({channel, series}, groups.all.size());
    if (added) groups.all.push_back({reading.channel, groups.series[series], "", channel, 1, {}, nullptr});
    groups.all[entry->second].readings.push_back(i);
  }
  for (Group& group : groups.all) {
    std::vector<std::string>& coloured = groups.series.size() > 1 ? groups.series : groups.channels;
    group.colour = plot::colour(place_in(coloured, groups.series.size() > 1 ? group.series : group.channel));
    group.sign = sum[group.panel] < 0 ? -1 : 1;
    for (const CurveRecord& curve : record.curves) {
      if (curve.channel == group.channel && curve.series == group.series) group.curve = &curve;
    }
  }
  return groups;
}

/// A CSV field; quoted when it must be.
std::string field(const std::string& text) {
  if (text.find_first_of(",\"\n\r") == std::string::npos) return text;
  std::string out = "\"";
  for (const char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c);
  return out + "\"";
}

std::string field(double value) { return std::isfinite(value) ? fmt::format("{:.10g}", value) : ""; }

template <class... Fields>
std::string line(const Fields&... fields) {
  std::string out;
  ((out += (out.empty() ? "" : ",") + field(fields)), ...);
  return out + "\n";
}

/// Legend of the figures over the load: colours of the series, symbols of the trials, what is drawn.
std::vector<LegendEntry> legend_of(const Groups& groups, const std::vector<LegendEntry>& marks) {
  std::vector<LegendEntry> entries;
  if (groups.series.size() > 1) {
    entries.push_back({LegendEntry::heading, "Series"});
    for (size_t i = 0; i < groups.series.size(); ++i) {
      entries.push_back({LegendEntry::line, groups.series[i].empty() ? "(none)" : groups.series[i], plot::colour(i)});
    }
  }
  entries.push_back({LegendEntry::heading, "Readings"});
  constexpr size_t most = 9;  // symbols repeat beyond
  for (size_t i = 0; i < std::min(groups.trials.size(), most); ++i) {
    const std::string& trial = groups.trials[i];
    entries.push_back({LegendEntry::point, trial.empty() ? "reading" : "trial " + trial, plot::kGrey, plot::symbol(i)});
  }
  if (groups.trials.size() > most) {
    entries.push_back({LegendEntry::text, fmt::format("… {} trials in all", groups.trials.size())});
  }
  entries.insert(entries.end(), marks.begin(), marks.end());
  return entries;
}

/// Panels in up to three columns with the legend to their right.
struct Grid {
  double width = kPageWidth, height = 0;
  std::vector<Box> boxes;
  double legend_left = 0, legend_top = 0;
};

Grid grid_of(size_t count, size_t columns, double legend, double panel_height) {
  constexpr double left = 66, gap = 52, below = 58, above = 30;
  Grid grid;
  const size_t rows = (count + columns - 1) / columns;
  const double row = panel_height + below + above;
  grid.height = kTitle + static_cast<double>(rows) * row;
  grid.legend_left = grid.width - legend - 8;
  grid.legend_top = grid.height - kTitle - above - 6;
  const double gaps = gap * static_cast<double>(columns - 1);
  const double across = (grid.legend_left - 24 - left - gaps) / static_cast<double>(columns);
  for (size_t i = 0; i < count; ++i) {
    const double x = left + static_cast<double>(i % columns) * (across + gap);
    const double top = grid.height - kTitle - above - static_cast<double>(i / columns) * row;
    grid.boxes.push_back({x, top - panel_height, x + across, top});
  }
  return grid;
}

/// Plots of points of a group with one symbol per trial. Rows: x, y, sigma; `bars` is xerrorbars or yerrorbars.
void add_points(plot::Page& page, const RunRecord& record, const Groups& groups, const Group& group,
                const std::map<size_t, std::vector<double>>& rows, const std::string& bars,
                std::vector<std::string>& plots) {
  for (size_t t = 0; t < groups.trials.size(); ++t) {
    std::vector<std::vector<double>> points;
    for (const auto& [reading, row] : rows) {
      if (record.readings[reading].trial == groups.trials[t]) points.push_back(row);
    }
    if (points.empty()) continue;
    plots.push_back(fmt::format("{} using 1:2:3 with {} pt {} ps 0.9 lw 1.4 lc rgb '{}'", page.data(points), bars,
                                plot::symbol(t), group.colour));
  }
}

/// A curve and its band, given as lower and upper points in the figure's own axes.
struct Band {
  std::vector<std::vector<double>> middle, lower, upper;
};

void add_band(plot::Page& page, const Group& group, const Band& band, std::vector<std::string>& plots) {
  if (band.middle.empty()) return;
  std::vector<std::vector<double>> around = band.lower;
  around.insert(around.end(), band.upper.rbegin(), band.upper.rend());
  plots.push_back(
      fmt::format("{} using 1:2 with filledcurves closed fc rgb '{}'", page.data(around), group.colour));
  plots.push_back(fmt::format("{} using 1:2 with lines lw 2 lc rgb '{}'", page.data(band.middle), group.colour));
}

std::string panel_title(const std::string& channel) { return channel.empty() ? "" : "Channel " + channel; }

std::string load_axis_label(const RunRecord& record) {
  return (record.load_label.empty() ? "load" : record.load_label) + " [N]";
}

int tics_for(const Box& box) { return box.right - box.left > 400 ? 8 : 4; }

// ---- the figures

std::optional<Drawing> force_displacement(const RunRecord& record) {
  if (!has_loads(record)) return std::nullopt;
  const Groups groups = groups_of(record);
  const std::vector<LegendEntry> legend =
      legend_of(groups, {{LegendEntry::bar_along_x, "± 1 σ of a reading"},
                         {LegendEntry::heading, "Fitted model"},
                         {LegendEntry::line, "curve"},
                         {LegendEntry::band, "its 95 % band"}});
  const size_t columns = std::min<size_t>(groups.channels.size(), 3);
  const Grid grid = grid_of(groups.channels.size(), columns, plot::legend_width(legend), kPanelHeight);
  plot::Page page(grid.width, grid.height, "Force and displacement", record.title, record.simulated);
  page.legend(grid.legend_left, grid.legend_top, legend);

  std::string csv = "kind,channel,series,trial,load_N,displacement_mm,sigma_mm,band_lower_mm,band_upper_mm\n";
  std::vector<std::vector<double>> shown(groups.channels.size());
  std::vector<std::vector<std::string>> points(groups.channels.size()), curves(groups.channels.size());
  std::vector<double> loads = record.load_newtons;
  const std::string none;
  for (const Group& group : groups.all) {
    std::map<size_t, std::vector<double>> rows;
    for (const size_t i : group.readings) {
      const ReadingRecord& r = record.readings[i];
      const double x = group.sign * r.measured / kMillimetre, sigma = r.sigma / kMillimetre;
      rows[i] = {x, record.load_newtons[i], sigma};
      shown[group.panel].insert(shown[group.panel].end(), {x - sigma, x + sigma});
      csv += line("reading", r.channel, group.series, r.trial, record.load_newtons[i], x, sigma, none, none);
    }
    add_points(page, record, groups, group, rows, "xerrorbars", points[group.panel]);
    if (group.curve == nullptr) continue;
    Band band;
    for (size_t i = 0; i < group.curve->load.size(); ++i) {
      const double load = group.curve->load[i], x = group.sign * group.curve->value.at(i) / kMillimetre;
      const double se = group.curve->se.at(i) / kMillimetre, half = std::isfinite(se) ? k95 * se : 0;
      band.middle.push_back({x, load});
      band.lower.push_back({x - half, load});
      band.upper.push_back({x + half, load});
      shown[group.panel].insert(shown[group.panel].end(), {x - half, x + half});
      loads.push_back(load);
      csv += line("curve", group.channel, group.series, none, load, x, se, x - half, x + half);
    }
    add_band(page, group, band, curves[group.panel]);
  }
  for (size_t c = 0; c < groups.channels.size(); ++c) {
    curves[c].insert(curves[c].end(), points[c].begin(), points[c].end());
    const Box& box = grid.boxes[c];
    page.panel(box, plot::axis_over(shown[c], "displacement magnitude [mm]", tics_for(box), true),
               plot::axis_over(loads, c % columns == 0 ? load_axis_label(record) : "", 6, true),
               panel_title(groups.channels[c]), curves[c]);
  }
  return Drawing{{"force_displacement", "Force and displacement",
                  "Every reading is a point; the bars are one standard deviation to either side. The line is the fitted "
                  "model, the band around it the 95 % interval of the curve (often thinner than the line). A good fit "
                  "passes through the points within about two bars.",
                  ""},
                 csv,
                 page};
}

/// What a group's stiffness is taken over: the displacement, or its increment beyond the unloaded reading.
struct Unloaded {
  bool available = false;
  double measured = 0, sigma = 0;  ///< mean of the readings at zero load [m]
  double predicted = 0, se = 0;    ///< the model's value there [m]
};

Unloaded unloaded_of(const RunRecord& record, const Group& group) {
  Unloaded zero;
  double variance = 0, n = 0;
  for (const size_t i : group.readings) {
    const ReadingRecord& r = record.readings[i];
    if (record.load_newtons[i] != 0) continue;
    n += 1;
    zero.measured += r.measured;
    variance += r.sigma * r.sigma;
    zero.predicted += r.predicted;
    zero.se = r.prediction_se;
  }
  if (n == 0) return {};
  zero.available = true;
  zero.measured /= n;
  zero.predicted /= n;
  zero.sigma = std::sqrt(variance) / n;
  return zero;
}

std::optional<Drawing> effective_stiffness(const RunRecord& record) {
  if (!has_loads(record)) return std::nullopt;
  const Groups groups = groups_of(record);
  std::string csv =
      "kind,channel,series,trial,load_N,displacement_mm,stiffness_N_per_m,sigma_N_per_m,band_lower_N_per_m,"
      "band_upper_N_per_m\n";
  const std::string none;
  bool any_increment = false, any_plain = false, any_bound = false;

  struct Rows {
    std::map<size_t, std::vector<double>> points;
    Band band;
  };
  std::vector<Rows> rows(groups.all.size());
  std::vector<double> loads, centres, reach;
  for (size_t g = 0; g < groups.all.size(); ++g) {
    const Group& group = groups.all[g];
    const Unloaded zero = unloaded_of(record, group);
    (zero.available ? any_increment : any_plain) = true;
    double work = 0, smallest = std::numeric_limits<double>::infinity();
    for (const size_t i : group.readings) {
      work += record.load_newtons[i] * (record.readings[i].measured - zero.measured);
      if (record.load_newtons[i] != 0) smallest = std::min(smallest, std::abs(record.load_newtons[i]));
    }
    const double sign = work < 0 ? -1 : 1;
    for (const size_t i : group.readings) {
      const ReadingRecord& r = record.readings[i];
      const double force = record.load_newtons[i], delta = sign * (r.measured - zero.measured);
      if (force == 0 || delta == 0) continue;
      const double k = force / delta;
      const double sigma = std::abs(force) * std::hypot(r.sigma, zero.sigma) / (delta * delta);
      rows[g].points[i] = {force, k, sigma};
      loads.push_back(force);
      centres.push_back(k);
      reach.insert(reach.end(), {k - sigma, k + sigma});
      csv += line("reading", r.channel, group.series, r.trial, force, delta / kMillimetre, k, sigma, none, none);
    }
    if (group.curve == nullptr) continue;
    const CurveRecord& curve = *group.curve;
    for (size_t i = 0; i < curve.load.size(); ++i) {
      const double force = curve.load[i], delta = sign * (curve.value.at(i) - zero.predicted);
      // Near zero load the quotient says nothing.
      if (std::abs(force) < 0.5 * smallest || delta == 0) continue;
      const double k = force / delta;
      double se = curve.se.at(i);
      if (zero.available && curve.increment_se.size() == curve.load.size()) {
        se = curve.increment_se[i];
      } else if (zero.available) {
        se += zero.se;  // whatever their correlation, it is not more
        any_bound = true;
      }
      const double half = std::isfinite(se) ? k95 * std::abs(force) * se / (delta * delta) : 0;
      rows[g].band.middle.push_back({force, k});
      rows[g].band.lower.push_back({force, k - half});
      rows[g].band.upper.push_back({force, k + half});
      loads.push_back(force);
      centres.push_back(k);
      reach.insert(reach.end(), {k - half, k + half});
      csv += line("curve", group.channel, group.series, none, force, delta / kMillimetre, k, half / k95, k - half,
                  k + half);
    }
  }
  if (centres.empty()) return std::nullopt;

  const std::vector<LegendEntry> legend =
      legend_of(groups, {{LegendEntry::bar_along_y, "± 1 σ, propagated"},
                         {LegendEntry::heading, "Fitted model"},
                         {LegendEntry::line, "curve"},
                         {LegendEntry::band, "its 95 % band"}});
  const size_t columns = std::min<size_t>(groups.channels.size(), 3);
  const Grid grid = grid_of(groups.channels.size(), columns, plot::legend_width(legend), kPanelHeight);
  const std::string title = any_increment && !any_plain ? "Effective stiffness: force per increment beyond self-weight"
                                                        : "Effective stiffness: force per displacement";
  plot::Page page(grid.width, grid.height, title, record.title, record.simulated);
  page.legend(grid.legend_left, grid.legend_top, legend);

  // One common axis; a long bar of one poor reading does not squeeze the rest.
  const auto [low, high] = std::ranges::minmax(centres);
  const double room = std::max(0.5 * (high - low), 0.02 * std::max(std::abs(low), std::abs(high)));
  for (double& value : reach) value = std::clamp(value, low - room, high + room);
  const bool logarithmic = low > 0 && high / low > 8;
  const std::string label = "force / displacement [N/m]";
  for (double& value : reach) value = logarithmic ? std::clamp(value, low / 1.3, high * 1.3) : value;
  std::vector<std::vector<std::string>> points(groups.channels.size()), curves(groups.channels.size());
  for (size_t g = 0; g < groups.all.size(); ++g) {
    const size_t panel = groups.all[g].panel;
    add_points(page, record, groups, groups.all[g], rows[g].points, "yerrorbars", points[panel]);
    add_band(page, groups.all[g], rows[g].band, curves[panel]);
  }
  for (size_t c = 0; c < groups.channels.size(); ++c) {
    curves[c].insert(curves[c].end(), points[c].begin(), points[c].end());
    const Box& box = grid.boxes[c];
    const std::string shown = c % columns == 0 ? label : "";
    page.panel(box, plot::axis_over(loads, load_axis_label(record), tics_for(box), true),
               logarithmic ? plot::logarithmic_axis_over(reach, shown) : plot::axis_over(reach, shown, 6, false),
               panel_title(groups.channels[c]), curves[c]);
  }
  std::string caption =
      "Secant stiffness of every reading: load divided by displacement, the bars being the standard deviation of the "
      "reading carried over. A straight horizontal line would be a linear spring; a rising one stiffens under load.";
  if (any_increment) {
    caption += any_plain ? " Where readings at zero load exist, the displacement is the increment beyond their mean."
                         : " The displacement is the increment beyond self-weight, that is beyond the mean reading at "
                           "zero load.";
  }
  if (any_bound) caption += " The band of an increment is drawn at its largest possible width.";
  if (!logarithmic) caption += " The vertical axis does not start at zero.";
  return Drawing{{"effective_stiffness", "Effective stiffness", caption, ""}, csv, page};
}

std::optional<Drawing> residuals(const RunRecord& record) {
  if (record.readings.empty()) return std::nullopt;
  const Groups groups = groups_of(record);
  const bool loads_known = has_loads(record);
  std::vector<LegendEntry> legend = legend_of(groups, {{LegendEntry::bar_along_y, "± 1 σ of a reading"}});
  legend.push_back({LegendEntry::heading, "Expectation"});
  legend.push_back({LegendEntry::line, "fitted model", plot::kBlack});
  legend.push_back({LegendEntry::band, "95 % if all is right"});
  const size_t count = groups.channels.size(), columns = std::min<size_t>(count, 3);
  const size_t blocks = (count + columns - 1) / columns;
  const Grid grid = grid_of(2 * blocks * columns, columns, plot::legend_width(legend), 210);
  plot::Page page(grid.width, grid.height, "What the fitted model misses", record.title, record.simulated);
  page.legend(grid.legend_left, grid.legend_top, legend);

  std::string csv = "channel,series,trial,load_N,residual_mm,sigma_mm,normalised_residual\n";
  std::vector<std::vector<std::string>> above(count), below(count);
  std::vector<std::vector<double>> millimetres(count);
  std::vector<double> places, scaled = {-2.6, 2.6};
  for (const Group& group : groups.all) {
    std::map<size_t, std::vector<double>> lengths, ratios;
    for (const size_t i : group.readings) {
      const ReadingRecord& r = record.readings[i];
      const double place = loads_known ? record.load_newtons[i] : static_cast<double>(i + 1);
      const double residual = r.measured - r.predicted;
      lengths[i] = {place, residual / kMillimetre, r.sigma / kMillimetre};
      ratios[i] = {place, residual / r.sigma, 1};
      places.push_back(place);
      scaled.insert(scaled.end(), {residual / r.sigma - 1, residual / r.sigma + 1});
      millimetres[group.panel].insert(millimetres[group.panel].end(),
                                      {(residual - r.sigma) / kMillimetre, (residual + r.sigma) / kMillimetre});
      csv += line(r.channel, group.series, r.trial,
                  loads_known ? record.load_newtons[i] : std::numeric_limits<double>::quiet_NaN(),
                  residual / kMillimetre, r.sigma / kMillimetre, residual / r.sigma);
    }
    add_points(page, record, groups, group, lengths, "yerrorbars", above[group.panel]);
    add_points(page, record, groups, group, ratios, "yerrorbars", below[group.panel]);
  }
  // Channels of like size share their scale, so that they can be compared at a glance.
  double smallest = std::numeric_limits<double>::infinity(), largest = 0;
  std::vector<double> together;
  for (const std::vector<double>& values : millimetres) {
    double size = 0;
    for (const double value : values) size = std::max(size, std::abs(value));
    smallest = std::min(smallest, size);
    largest = std::max(largest, size);
    together.insert(together.end(), values.begin(), values.end());
  }
  const bool common = largest < 5 * smallest;
  const std::string x_label = loads_known ? load_axis_label(record) : "reading";
  const std::string zero_line = fmt::format("set arrow from graph 0, first 0 to graph 1, first 0 nohead lw 1.5 lc rgb '{}'\n",
                                            plot::kBlack);
  const std::string expected =
      fmt::format("set object rectangle from graph 0, first -2 to graph 1, first 2 behind fs transparent solid 0.18 "
                  "noborder fc rgb '{}'\n",
                  plot::kGrey);
  for (size_t c = 0; c < count; ++c) {
    const size_t upper = (c / columns) * 2 * columns + c % columns, lower = upper + columns;
    const bool first = c % columns == 0;
    const Box& box = grid.boxes[upper];
    const std::string name = panel_title(groups.channels[c]);
    page.panel(box, plot::axis_over(places, x_label, tics_for(box), true),
               plot::axis_over(common ? together : millimetres[c], first ? "measured − fitted [mm]" : "", 5, true),
               name, above[c], zero_line);
    page.panel(grid.boxes[lower], plot::axis_over(places, x_label, tics_for(box), true),
               plot::axis_over(scaled, first ? "(measured − fitted) / σ" : "", 6, true),
               name.empty() ? "In standard deviations" : name + ", in standard deviations", below[c],
               expected + zero_line);
  }
  return Drawing{{"residuals", "What the fitted model misses",
                  "Above in millimetres, below in standard deviations of the reading. If the model and the declared "
                  "standard deviations are right, about 95 % of the points below lie in the grey band, without a trend.",
                  ""},
                 csv,
                 page};
}

std::optional<Drawing> deformed_shapes(const RunRecord& record) {
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
    colours.push_back(rest_first && i == 0 ? "#9a9a9a" : plot::ordered_colour(i - (rest_first ? 1 : 0), ordered));
    legend.push_back({LegendEntry::line, record.shapes[i].label, colours.back()});
  }
  Axis x = plot::axis_over(xs, record.shape_axes[0] + " [mm]", 8, false);
  Axis y = plot::axis_over(ys, record.shape_axes[1] + " [mm]", 5, false);
  // Equal scales: the box takes the data's proportions, and a lean figure gets room at its sides.
  constexpr double left = 66, below = 58, above = 26;
  const double legend_left = kPageWidth - plot::legend_width(legend) - 8;
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

  plot::Page page(kPageWidth, kTitle + above + tall + below, "Deformed shapes, to scale", record.title,
                  record.simulated);
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
    plots.push_back(
        fmt::format("{} using 1:2 with lines lw 1.8 lc rgb '{}'", page.data(rows_of_shape), colours[i]));
  }
  page.panel({left, below, left + across, below + tall}, x, y, "", plots);
  return Drawing{{"deformed_shapes", "Deformed shapes, to scale",
                  "Outline of the specimen as the fitted model has it, seen from the side, with equal scales along both "
                  "axes. Compare it with a photograph taken at the bench.",
                  ""},
                 csv,
                 page};
}

std::optional<Drawing> variants(const RunRecord& record) {
  if (record.fit.parameters.empty() || (record.variants.empty() && record.references.empty())) return std::nullopt;
  struct Row {
    std::string kind, name;
    double value, se;
  };
  std::vector<std::vector<Row>> panels;
  size_t longest = 0, row_count = 0;
  for (size_t p = 0; p < record.fit.parameters.size(); ++p) {
    const ParameterEstimate& estimate = record.fit.parameters[p];
    std::vector<Row> rows = {{"main",
                              "▶ " + (record.main.name.empty() ? std::string("this fit") : record.main.name),
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
    for (Row& row : rows) {
      row.name = plot::shortened(row.name, 52);
      longest = std::max(longest, plot::length_of(row.name));
    }
    row_count += rows.size();
    panels.push_back(std::move(rows));
  }
  constexpr double row_height = 30, below = 58, above = 34;
  const std::vector<LegendEntry> legend = {{LegendEntry::point, "this fit", plot::colour(0), 7},
                                           {LegendEntry::point, "other mesh", plot::colour(2), 6},
                                           {LegendEntry::bar_along_x, "± 1 standard error"},
                                           {LegendEntry::point, "reference value", plot::colour(1), 13}};
  const double left = 40 + 7.0 * static_cast<double>(longest);
  const double legend_left = kPageWidth - plot::legend_width(legend) - 8;
  const double height = kTitle + row_height * static_cast<double>(row_count) +
                        static_cast<double>(panels.size()) * (below + above + row_height / 2) + 20;
  plot::Page page(kPageWidth, height, "What mesh and elements do to the result, and other people's values",
                  record.title, record.simulated);
  page.legend(legend_left, height - kTitle - above - 6, legend);

  std::string csv = "parameter,unit,kind,name,value,standard_error\n";
  double top = height - kTitle - above;
  for (size_t p = 0; p < panels.size(); ++p) {
    const ParameterEstimate& estimate = record.fit.parameters[p];
    const DisplayUnit unit = display_unit(estimate.value, estimate.spec.unit);
    std::map<std::string, std::vector<std::vector<double>>> points;
    std::vector<double> shown;
    std::string tics_text, extra;
    double y = static_cast<double>(panels[p].size());
    for (const Row& row : panels[p]) {
      csv += line(estimate.spec.id, estimate.spec.unit, row.kind, row.name, row.value, row.se);
      const double value = row.value / unit.factor, se = std::isfinite(row.se) ? row.se / unit.factor : 0;
      tics_text += fmt::format("{}{} {}", tics_text.empty() ? "" : ", ", plot::quoted(row.name), y);
      if (std::isfinite(value)) {
        points[row.kind].push_back({value, y, se});
        shown.insert(shown.end(), {value - se, value + se});
        if (row.kind == "reference") {
          extra += fmt::format(
              "set arrow from first {0:.10g}, graph 0 to first {0:.10g}, graph 1 nohead lw 1.5 dt (6,4) lc rgb '{1}'\n",
              value, plot::colour(1));
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
    add("reference", " using 1:2 with points pt 13 ps 1.3", plot::colour(1));
    add("variant", " using 1:2:3 with xerrorbars pt 6 ps 1.1 lw 2", plot::colour(2));
    add("main", " using 1:2:3 with xerrorbars pt 7 ps 1.2 lw 2", plot::colour(0));
    const bool pure = unit.name.empty() || unit.name == "1";
    const std::string name = estimate.spec.id + (pure ? "" : " [" + unit.name + "]");
    const auto [low, high] = shown.empty() ? std::pair(1.0, 1.0) : std::pair(std::ranges::min(shown), std::ranges::max(shown));
    const Axis x = low > 0 && high / low > 20 ? plot::logarithmic_axis_over(shown, name)
                                              : plot::axis_over(shown, name, 6, false);
    const Axis rows{"", 0.4, static_cast<double>(panels[p].size()) + 0.6, 1};
    page.panel({left, bottom, legend_left - 24, top}, x, rows, "", plots, extra);
    top = bottom - below - above;
  }
  return Drawing{{"variants", "Mesh, elements and other people's values",
                  "The same fit with other elements and meshes (open circles) beside this one (filled circle). If the "
                  "circles move by more than their bars, the mesh is part of the number and must be told with it. Dashed "
                  "lines are the reference values.",
                  ""},
                 csv,
                 page};
}

}  // namespace

std::vector<Figure> draw_figures(const RunRecord& record, const std::string& folder) {
  const std::filesystem::path figures = std::filesystem::path(folder) / "figures";
  std::vector<Figure> drawn;
  for (const auto& figure : {force_displacement, effective_stiffness, residuals, deformed_shapes, variants}) {
    std::optional<Drawing> drawing = figure(record);
    if (!drawing) continue;
    const std::string& name = drawing->figure.name;
    write_file((figures / (name + ".csv")).string(), drawing->csv);
    write_file((figures / (name + ".gp")).string(), drawing->page.script(name));
    plot::run_gnuplot(figures.string(), name);
    drawing->figure.svg = read_file((figures / (name + ".svg")).string());
    if (record.simulated) drawing->figure.title = "SIMULATED DATA: " + drawing->figure.title;
    drawn.push_back(std::move(drawing->figure));
  }
  return drawn;
}

}  // namespace taut

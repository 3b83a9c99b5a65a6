#include <fmt/format.h>

#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>

#include "reports/run_sections.hpp"

namespace taut::plot {
namespace {

constexpr double kPanelHeight = 330;  // px, axis labels and panel title not counted

/// Readings of one channel in one series, and the curve that the fit draws through them.
struct Group {
  std::string channel, series, colour;
  size_t panel = 0;  ///< one per channel
  double sign = 1;   ///< that makes the mean reading positive
  std::vector<size_t> readings;
  const CurveRecord* curve = nullptr;
};

struct Groups {
  std::vector<Group> all;
  std::vector<std::string> channels, series, trials;  ///< in order of appearance
};

std::string series_of(const RunRecord& record, size_t reading) {
  return record.series.empty() ? "" : record.series.at(reading);
}

bool has_loads(const RunRecord& record) {
  return !record.readings.empty() && record.load_newtons.size() == record.readings.size();
}

/// Of all channels, or of those that measure `quantity` only.
Groups groups_of(const RunRecord& record, std::optional<Quantity> quantity = std::nullopt) {
  Groups groups;
  std::map<std::pair<size_t, size_t>, size_t> index;
  std::map<size_t, double> sum;  // of the readings of a channel
  for (size_t i = 0; i < record.readings.size(); ++i) {
    const ReadingRecord& reading = record.readings[i];
    if (quantity && !is(channel_axis(record, reading.channel), *quantity)) continue;
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
    group.colour = colour(place_in(coloured, groups.series.size() > 1 ? group.series : group.channel));
    group.sign = sum[group.panel] < 0 ? -1 : 1;
    for (const CurveRecord& curve : record.curves) {
      if (curve.channel == group.channel && curve.series == group.series) group.curve = &curve;
    }
  }
  return groups;
}

/// Legend of the figures over the load: colours of the series, symbols of the trials, what is drawn.
std::vector<LegendEntry> legend_of(const Groups& groups, const std::vector<LegendEntry>& marks) {
  std::vector<LegendEntry> entries;
  if (groups.series.size() > 1) {
    entries.push_back({LegendEntry::heading, "Series"});
    for (size_t i = 0; i < groups.series.size(); ++i) {
      entries.push_back({LegendEntry::line, groups.series[i].empty() ? "(none)" : groups.series[i], colour(i)});
    }
  }
  entries.push_back({LegendEntry::heading, "Readings"});
  constexpr size_t most = 9;  // symbols repeat beyond
  for (size_t i = 0; i < std::min(groups.trials.size(), most); ++i) {
    const std::string& trial = groups.trials[i];
    entries.push_back({LegendEntry::point, trial.empty() ? "reading" : "trial " + trial, kGrey, symbol(i)});
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
  constexpr double left = 86, gap = 56, below = 58, above = 30;
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

/// Plots of the readings of a group, bars below symbols, one symbol per trial, so that none hides another. Rows: x, y,
/// sigma; `bars` is xerrorbars or yerrorbars.
void add_points(Page& page, const RunRecord& record, const Groups& groups, const Group& group,
                const std::map<size_t, std::vector<double>>& rows, const std::string& bars,
                std::vector<std::string>& plots) {
  std::vector<std::string> symbols;
  for (size_t t = 0; t < groups.trials.size(); ++t) {
    std::vector<std::vector<double>> points;
    for (const auto& [reading, row] : rows) {
      if (record.readings[reading].trial == groups.trials[t]) points.push_back(row);
    }
    if (points.empty()) continue;
    const std::string block = page.data(points);
    plots.push_back(fmt::format("{} using 1:2:3 with {} pt 0 ps 0 lw 1.2 lc rgb '{}'", block, bars, group.colour));
    symbols.push_back(
        fmt::format("{} using 1:2 with points pt {} ps 1 lw 1.4 lc rgb '{}'", block, symbol(t), group.colour));
  }
  plots.insert(plots.end(), symbols.begin(), symbols.end());
}

/// A curve and its band, given as lower and upper points in the figure's own axes.
struct Band {
  std::vector<std::vector<double>> middle, lower, upper;
};

void add_band(Page& page, const Group& group, const Band& band, std::vector<std::string>& plots) {
  if (band.middle.empty()) return;
  std::vector<std::vector<double>> around = band.lower;
  around.insert(around.end(), band.upper.rbegin(), band.upper.rend());
  plots.push_back(fmt::format("{} using 1:2 with filledcurves closed fc rgb '{}'", page.data(around), group.colour));
  plots.push_back(fmt::format("{} using 1:2 with lines lw 2 lc rgb '{}'", page.data(band.middle), group.colour));
}

/// Polynomial through points (x, y, sigma) by weighted least squares, as a line over their range; of a lower degree
/// where there are too few different x.
std::vector<std::vector<double>> trend(const std::map<size_t, std::vector<double>>& points, int degree) {
  std::set<double> places;
  for (const auto& [reading, row] : points) places.insert(row[0]);
  if (places.size() < 2) return {};
  const double from = *places.begin(), to = *places.rbegin();
  const auto n = std::min<Eigen::Index>(degree, static_cast<Eigen::Index>(places.size()) - 1) + 1;
  const auto powers = [&](double x) {  // of x mapped to [-1, 1], which keeps the normal equations sound
    Eigen::VectorXd p = Eigen::VectorXd::Ones(n);
    for (Eigen::Index k = 1; k < n; ++k) p[k] = p[k - 1] * (2 * (x - from) / (to - from) - 1);
    return p;
  };
  Eigen::MatrixXd A(static_cast<Eigen::Index>(points.size()), n);
  Eigen::VectorXd b(A.rows());
  Eigen::Index i = 0;
  for (const auto& [reading, row] : points) {
    A.row(i) = powers(row[0]) / row[2];
    b[i++] = row[1] / row[2];
  }
  const Eigen::VectorXd coefficients = A.colPivHouseholderQr().solve(b);
  std::vector<std::vector<double>> line_of_points;
  constexpr int steps = 40;
  for (int k = 0; k <= steps; ++k) {
    const double x = from + (to - from) * k / steps;
    line_of_points.push_back({x, coefficients.dot(powers(x))});
  }
  return line_of_points;
}

std::string panel_title(const std::string& channel) {
  return channel.empty() ? "" : "Channel " + channel;
}

std::string load_axis_label(const RunRecord& record) {
  return (record.load_label.empty() ? "load" : record.load_label) + " [N]";
}

int tics_for(const Box& box) {
  return box.right - box.left > 400 ? 8 : 5;
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

/// Secant stiffness of a group: points of its readings and a band of its curve, [N/m] over [N].
struct Stiffness {
  std::map<size_t, std::vector<double>> points;  ///< by reading: force, k, sigma of k
  Band band;
  bool increment = false;  ///< displacements are counted from the readings at zero load
  bool bound = false;      ///< the band is as wide as it can be: a correlation is not known
};

/// Numbers of all groups, for axes and the CSV file.
struct StiffnessNumbers {
  std::vector<double> loads, centres, reach;
  std::string csv;

  void add(double force, double k, double half) {
    loads.push_back(force);
    centres.push_back(k);
    reach.insert(reach.end(), {k - half, k + half});
  }
};

Stiffness stiffness_of(const RunRecord& record, const Group& group, StiffnessNumbers& numbers) {
  const std::string none;
  const Unloaded zero = unloaded_of(record, group);
  Stiffness out;
  out.increment = zero.available;
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
    out.points[i] = {force, k, sigma};
    numbers.add(force, k, sigma);
    numbers.csv += line("reading", r.channel, group.series, r.trial, force, delta / kMillimetre, k, sigma, none, none);
  }
  if (group.curve == nullptr) return out;
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
      out.bound = true;
    }
    const double half = std::isfinite(se) ? k95 * std::abs(force) * se / (delta * delta) : 0;
    out.band.middle.push_back({force, k});
    out.band.lower.push_back({force, k - half});
    out.band.upper.push_back({force, k + half});
    numbers.add(force, k, half);
    numbers.csv +=
        line("curve", group.channel, group.series, none, force, delta / kMillimetre, k, half / k95, k - half, k + half);
  }
  return out;
}

/// The plot of the polynomial through the points of a group, where there is one; its numbers go to `csv`.
void add_trend(Page& page, const Group& group, const std::map<size_t, std::vector<double>>& points, int degree,
               bool positive_only, std::string& csv, std::vector<std::string>& plots) {
  const std::string none;
  std::vector<std::vector<double>> polynomial = trend(points, degree);
  std::erase_if(polynomial, [&](const std::vector<double>& point) { return positive_only && !(point[1] > 0); });
  for (const std::vector<double>& point : polynomial)
    csv += line("trend", group.channel, group.series, none, point[0], none, point[1], none, none, none);
  if (!polynomial.empty())
    plots.push_back(
        fmt::format("{} using 1:2 with lines lw 1.6 dt (6,4) lc rgb '{}'", page.data(polynomial), group.colour));
}

std::string stiffness_caption(bool any_increment, bool any_plain, bool any_bound, bool trend, bool logarithmic) {
  std::string caption =
      "Secant stiffness of every reading: load divided by displacement, the bars being the standard deviation of the "
      "reading carried over. A straight horizontal line would be a linear spring; a rising one stiffens under load.";
  if (any_increment) {
    caption += any_plain ? " Where readings at zero load exist, the displacement is the increment beyond their mean."
                         : " The displacement is the increment beyond self-weight, that is beyond the mean reading at "
                           "zero load.";
  }
  if (any_bound) caption += " The band of an increment is drawn at its largest possible width.";
  if (trend)
    caption +=
        " Dashed: a polynomial through the readings of each series, weighted with their bars, without any model.";
  if (!logarithmic) caption += " The vertical axis does not start at zero.";
  return caption;
}

}  // namespace

std::optional<Drawing> force_displacement(const RunRecord& record) {
  if (!has_loads(record)) return std::nullopt;
  const Groups groups = groups_of(record);
  const std::vector<LegendEntry> legend = legend_of(groups, {{LegendEntry::bar_along_x, "± 1 σ of a reading"},
                                                             {LegendEntry::heading, "Fitted model"},
                                                             {LegendEntry::line, "curve"},
                                                             {LegendEntry::band, "its 95 % band"}});
  const ReadingUnits units(record);
  const size_t columns = std::min<size_t>(groups.channels.size(), 3);
  const Grid grid = grid_of(groups.channels.size(), columns, legend_width(legend), kPanelHeight);
  const std::string title = "Force and " + (units.what() == "value" ? "readings" : units.what());
  Page page(grid.width, grid.height, title, record.title, record.simulated);
  page.legend(grid.legend_left, grid.legend_top, legend);

  std::string csv =
      units.heads(fmt::format("kind,channel,series,trial,load_N,{},{},{},{}\n", units.column(units.what()),
                              units.column("sigma"), units.column("band_lower"), units.column("band_upper")));
  std::vector<std::vector<double>> shown(groups.channels.size());
  std::vector<std::vector<std::string>> points(groups.channels.size()), curves(groups.channels.size());
  std::vector<double> loads = record.load_newtons;
  const std::string none;
  for (const Group& group : groups.all) {
    std::map<size_t, std::vector<double>> rows;
    const double unit = units.of(group.channel).factor;
    for (const size_t i : group.readings) {
      const ReadingRecord& r = record.readings[i];
      const double x = group.sign * r.measured / unit, sigma = r.sigma / unit;
      rows[i] = {x, record.load_newtons[i], sigma};
      shown[group.panel].insert(shown[group.panel].end(), {x - sigma, x + sigma});
      csv += units.row(line("reading", r.channel, group.series, r.trial, record.load_newtons[i], x, sigma, none, none),
                       r.channel);
    }
    add_points(page, record, groups, group, rows, "xerrorbars", points[group.panel]);
    if (group.curve == nullptr) continue;
    Band band;
    for (size_t i = 0; i < group.curve->load.size(); ++i) {
      const double load = group.curve->load[i], x = group.sign * group.curve->value.at(i) / unit;
      const double se = group.curve->se.at(i) / unit, half = std::isfinite(se) ? k95 * se : 0;
      band.middle.push_back({x, load});
      band.lower.push_back({x - half, load});
      band.upper.push_back({x + half, load});
      shown[group.panel].insert(shown[group.panel].end(), {x - half, x + half});
      loads.push_back(load);
      csv +=
          units.row(line("curve", group.channel, group.series, none, load, x, se, x - half, x + half), group.channel);
    }
    add_band(page, group, band, curves[group.panel]);
  }
  for (size_t c = 0; c < groups.channels.size(); ++c) {
    curves[c].insert(curves[c].end(), points[c].begin(), points[c].end());
    const Box& box = grid.boxes[c];
    const std::string label =
        bracketed(channel_axis(record, groups.channels[c]).label, units.of(groups.channels[c]).label);
    page.panel(box, axis_over(shown[c], label, tics_for(box), true),
               axis_over(loads, c % columns == 0 ? load_axis_label(record) : "", 6, true),
               panel_title(groups.channels[c]), curves[c]);
  }
  return Drawing{
      {"force_displacement", title,
       fmt::format("Every reading is a point at the magnitude of its {}; the bars are one standard deviation "
                   "to either side. The line is the fitted "
                   "model, the band around it the 95 % interval of the curve (often thinner than the line). "
                   "A good fit passes through the points within about two bars.",
                   units.what()),
       ""},
      csv,
      page};
}

std::optional<Drawing> effective_stiffness(const RunRecord& record) {
  if (!has_loads(record)) return std::nullopt;
  const Groups groups = groups_of(record, Quantity::length);
  StiffnessNumbers numbers;
  numbers.csv =
      "kind,channel,series,trial,load_N,displacement_mm,stiffness_N_per_m,sigma_N_per_m,band_lower_N_per_m,"
      "band_upper_N_per_m\n";
  std::vector<Stiffness> rows;
  for (const Group& group : groups.all) rows.push_back(stiffness_of(record, group, numbers));
  const bool any_increment = std::ranges::any_of(rows, &Stiffness::increment);
  const bool any_plain = !std::ranges::all_of(rows, &Stiffness::increment);
  const bool any_bound = std::ranges::any_of(rows, &Stiffness::bound);
  if (numbers.centres.empty()) return std::nullopt;

  std::vector<LegendEntry> legend = legend_of(groups, {{LegendEntry::bar_along_y, "± 1 σ, propagated"},
                                                       {LegendEntry::heading, "Fitted model"},
                                                       {LegendEntry::line, "curve"},
                                                       {LegendEntry::band, "its 95 % band"}});
  if (record.trend_degree > 0) {
    legend.push_back({LegendEntry::heading, "Trend, no model"});
    legend.push_back({LegendEntry::dashes, fmt::format("polynomial, degree {}", record.trend_degree)});
  }
  const size_t columns = std::min<size_t>(groups.channels.size(), 3);
  const Grid grid = grid_of(groups.channels.size(), columns, legend_width(legend), kPanelHeight);
  const bool increments = any_increment && !any_plain;
  const std::string title = increments ? "Effective stiffness: force per increment beyond self-weight"
                                       : "Effective stiffness: force per displacement";
  Page page(grid.width, grid.height, title, record.title, record.simulated);
  page.legend(grid.legend_left, grid.legend_top, legend);

  // One common axis; a long bar of one poor reading does not squeeze the rest.
  const auto [low, high] = std::ranges::minmax(numbers.centres);
  const double room = std::max(0.5 * (high - low), 0.02 * std::max(std::abs(low), std::abs(high)));
  for (double& value : numbers.reach) value = std::clamp(value, low - room, high + room);
  const bool logarithmic = low > 0 && high / low > 8;
  const std::string label = std::string(increments ? "force / increment" : "force / displacement") + " [N/m]" +
                            (logarithmic ? ", logarithmic" : "");
  for (double& value : numbers.reach) value = logarithmic ? std::clamp(value, low / 1.3, high * 1.3) : value;
  std::vector<std::vector<std::string>> points(groups.channels.size()), curves(groups.channels.size());
  for (size_t g = 0; g < groups.all.size(); ++g) {
    const size_t panel = groups.all[g].panel;
    add_points(page, record, groups, groups.all[g], rows[g].points, "yerrorbars", points[panel]);
    add_band(page, groups.all[g], rows[g].band, curves[panel]);
    if (record.trend_degree > 0)
      add_trend(page, groups.all[g], rows[g].points, record.trend_degree, logarithmic, numbers.csv, curves[panel]);
  }
  for (size_t c = 0; c < groups.channels.size(); ++c) {
    curves[c].insert(curves[c].end(), points[c].begin(), points[c].end());
    const Box& box = grid.boxes[c];
    const std::string shown = c % columns == 0 ? label : "";
    page.panel(box, axis_over(numbers.loads, load_axis_label(record), tics_for(box), true),
               logarithmic ? logarithmic_axis_over(numbers.reach, shown) : axis_over(numbers.reach, shown, 6, false),
               panel_title(groups.channels[c]), curves[c]);
  }
  const std::string caption =
      stiffness_caption(any_increment, any_plain, any_bound, record.trend_degree > 0, logarithmic);
  return Drawing{{"effective_stiffness", "Effective stiffness", caption, ""}, numbers.csv, page};
}

std::optional<Drawing> residuals(const RunRecord& record) {
  if (record.readings.empty() || over_strain(record) || over_time(record)) return std::nullopt;
  const Groups groups = groups_of(record);
  const bool loads_known = has_loads(record);
  std::vector<LegendEntry> legend = legend_of(groups, {{LegendEntry::bar_along_y, "± 1 σ of a reading"}});
  legend.push_back({LegendEntry::heading, "Expectation"});
  legend.push_back({LegendEntry::line, "fitted model", kBlack});
  legend.push_back({LegendEntry::band, "95 % if all is right"});
  // Several series in one panel would lie on top of each other.
  const bool split = groups.series.size() > 1 && groups.all.size() <= 9;
  const size_t count = split ? groups.all.size() : groups.channels.size();
  const size_t columns = count == 4 ? 2 : std::min<size_t>(count, 3);
  const size_t blocks = (count + columns - 1) / columns;
  const Grid grid = grid_of(2 * blocks * columns, columns, legend_width(legend), 210);
  Page page(grid.width, grid.height, "What the fitted model misses", record.title, record.simulated);
  page.legend(grid.legend_left, grid.legend_top, legend);

  const ReadingUnits units(record);
  std::string csv = units.heads(fmt::format("channel,series,trial,load_N,{},{},normalised_residual\n",
                                            units.column("residual"), units.column("sigma")));
  std::vector<std::vector<std::string>> above(count), below(count);
  std::vector<std::vector<double>> reach(count);
  std::vector<std::string> names(count), unit_labels(count);
  std::vector<double> places, scaled = {-2.6, 2.6};
  for (size_t g = 0; g < groups.all.size(); ++g) {
    const Group& group = groups.all[g];
    const size_t panel = split ? g : group.panel;
    names[panel] = panel_title(group.channel);
    if (split) names[panel] = groups.channels.size() > 1 ? names[panel] + ", " + group.series : group.series;
    const WrittenUnit& unit = units.of(group.channel);
    unit_labels[panel] = unit.label;
    std::map<size_t, std::vector<double>> misses, ratios;
    for (const size_t i : group.readings) {
      const ReadingRecord& r = record.readings[i];
      const double place = loads_known ? record.load_newtons[i] : static_cast<double>(i + 1);
      const double residual = r.measured - r.predicted;
      misses[i] = {place, residual / unit.factor, r.sigma / unit.factor};
      ratios[i] = {place, residual / r.sigma, 1};
      places.push_back(place);
      scaled.insert(scaled.end(), {residual / r.sigma - 1, residual / r.sigma + 1});
      reach[panel].insert(reach[panel].end(), {(residual - r.sigma) / unit.factor, (residual + r.sigma) / unit.factor});
      csv += units.row(line(r.channel, group.series, r.trial,
                            loads_known ? record.load_newtons[i] : std::numeric_limits<double>::quiet_NaN(),
                            residual / unit.factor, r.sigma / unit.factor, residual / r.sigma),
                       r.channel);
    }
    add_points(page, record, groups, group, misses, "yerrorbars", above[panel]);
    add_points(page, record, groups, group, ratios, "yerrorbars", below[panel]);
  }
  // Panels of like size share their scale, so that they can be compared at a glance.
  double smallest = std::numeric_limits<double>::infinity(), largest = 0;
  std::vector<double> together;
  for (const std::vector<double>& values : reach) {
    double size = 0;
    for (const double value : values) size = std::max(size, std::abs(value));
    smallest = std::min(smallest, size);
    largest = std::max(largest, size);
    together.insert(together.end(), values.begin(), values.end());
  }
  const bool common = units.common() && largest < 5 * smallest;
  const std::string x_label = loads_known ? load_axis_label(record) : "reading";
  for (size_t c = 0; c < count; ++c) {
    const size_t upper = (c / columns) * 2 * columns + c % columns, lower = upper + columns;
    const bool first = c % columns == 0;
    const Box& box = grid.boxes[upper];
    page.panel(box, axis_over(places, x_label, tics_for(box), true),
               axis_over(common ? together : reach[c],
                         first || !units.common() ? bracketed("measured − fitted", unit_labels[c]) : "", 5, true),
               names[c], above[c], zero_line());
    page.panel(grid.boxes[lower], axis_over(places, x_label, tics_for(box), true),
               axis_over(scaled, first ? "(measured − fitted) / σ" : "", 6, true), names[c], below[c],
               expected_band() + zero_line());
  }
  return Drawing{
      {"residuals", "What the fitted model misses",
       fmt::format("Above in {}, below in standard deviations of the reading. If the model and the declared "
                   "standard deviations are right, about 95 % of the points below lie in the grey band, without a "
                   "trend.",
                   !units.common()                 ? "the units of the readings"
                   : units.common()->label == "mm" ? "millimetres"
                                                   : units.common()->label),
       ""},
      csv,
      page};
}

}  // namespace taut::plot

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>

#include "reports/run_sections.hpp"
#include "sim/core/dense.hpp"

namespace taut::plot {
namespace {

/// Readings by their index: x, y, sigma; or x, y, ends of the bar, sigma.
using Points = std::map<size_t, std::vector<double>>;

/// Readings of one channel in one series, and the curve that the fit draws through them.
struct Group {
  std::string channel, series, colour;
  size_t panel = 0;  ///< one per channel
  double sign = 1;   ///< that makes the mean reading positive; of positions 1
  std::vector<size_t> readings;
  const CurveRecord* curve = nullptr;
};

struct Groups {
  std::vector<Group> all;
  std::vector<std::string> channels, series, trials;  ///< in order of appearance
  bool any_excluded = false;
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
    groups.any_excluded |= reading.excluded;
    sum[channel] += reading.measured;
    const auto [entry, added] = index.try_emplace({channel, series}, groups.all.size());
    if (added) groups.all.push_back({reading.channel, groups.series[series], "", channel, 1, {}, nullptr});
    groups.all[entry->second].readings.push_back(i);
  }
  for (Group& group : groups.all) {
    std::vector<std::string>& coloured = groups.series.size() > 1 ? groups.series : groups.channels;
    group.colour = colour(place_in(coloured, groups.series.size() > 1 ? group.series : group.channel));
    const bool place = channel_axis(record, group.channel).label == "position";
    group.sign = sum[group.panel] < 0 && !place ? -1 : 1;
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
  if (groups.any_excluded) entries.push_back({LegendEntry::point, "not fitted", kGrey, kCross});
  entries.insert(entries.end(), marks.begin(), marks.end());
  return entries;
}

/// The same with what stands for the fitted model.
std::vector<LegendEntry> legend_with_model(const Groups& groups, const LegendEntry& bar) {
  return legend_of(groups, {bar,
                            {LegendEntry::heading, "Fitted model"},
                            {LegendEntry::line, "curve"},
                            {LegendEntry::band, "its 95 % band"}});
}

Grid grid_of(const std::vector<LegendEntry>& legend, size_t columns) {
  return Grid({.left = 86}, legend, columns);
}

/// Plots of the readings of a group, bars below symbols, one symbol per trial, so that none hides another; `bars` is
/// xerrorbars or yerrorbars.
void add_points(Page& page, const RunRecord& record, const Groups& groups, const Group& group, const Points& points,
                const std::string& bars, Plots& plots) {
  Plots symbols;
  for (size_t t = 0; t < groups.trials.size(); ++t) {
    Rows rows;
    for (const auto& [reading, row] : points) {
      const ReadingRecord& r = record.readings[reading];
      if (r.trial == groups.trials[t] && !r.excluded) rows.push_back(row);
    }
    if (rows.empty()) continue;
    const std::string block = page.data(rows);
    plots.push_back(
        plotted(block, bars + " pt 0 ps 0 lw 1.2", group.colour, rows.front().size() > 3 ? "1:2:3:4" : "1:2:3"));
    symbols.push_back(plotted(block, fmt::format("points pt {} ps 1 lw 1.4", symbol(t)), group.colour));
  }
  plots.insert(plots.end(), symbols.begin(), symbols.end());
  Rows excluded;
  for (const auto& [reading, row] : points) {
    if (record.readings[reading].excluded) excluded.push_back(row);
  }
  add_excluded(page, excluded, plots);
}

/// Polynomial through points (x, y, ..., sigma) by weighted least squares, as a line over their range; of a lower
/// degree where there are too few different x.
Rows trend(const Points& points, int degree) {
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
    A.row(i) = powers(row[0]) / row.back();
    b[i++] = row[1] / row.back();
  }
  const Eigen::VectorXd coefficients = least_squares(A, b);
  Rows line_of_points;
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
  const std::string label = record.load_label.empty() ? "load" : record.load_label;
  const bool torque =
      record.load_control >= 0 && record.controls[static_cast<size_t>(record.load_control)].unit == "Nm";
  return label + (torque ? " [Nm]" : " [N]");
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
    if (record.load_newtons[i] != 0 || r.excluded) continue;
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
  Points points;  ///< force, k, k where the displacement is a sigma larger and smaller, sigma of k
  Rows at_least;  ///< of readings within 2 sigma of no displacement: force, smallest k
  Band band;
  bool increment = false;  ///< displacements are counted from the readings at zero load
  bool bound = false;      ///< the band is as wide as it can be: a correlation is not known
};

/// Numbers of all groups, for axes and the CSV file.
struct StiffnessNumbers {
  std::vector<double> loads, centres, reach;
  std::string csv;

  /// Near no displacement the quotient may be anything: what is within 2 sigma of that does not stretch the axis.
  void add(double force, double k, double sigma, double low, double high) {
    loads.push_back(force);
    if (std::abs(k) < 2 * sigma) return;
    centres.push_back(k);
    reach.insert(reach.end(), {low, high});
  }
};

Stiffness stiffness_of(const RunRecord& record, const Group& group, StiffnessNumbers& numbers) {
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
    const double spread = std::hypot(r.sigma, zero.sigma);
    if (force == 0) continue;
    if (std::abs(delta) < 2 * spread && !r.excluded) {  // k may be anything from here on
      const double least = std::abs(force) / (std::copysign(1, force) * delta + 2 * spread);
      out.at_least.push_back({force, least});
      numbers.loads.push_back(force);
      numbers.csv +=
          line("at_least", r.channel, group.series, r.trial, r.line, force, delta / kMillimetre, "", "", least, "");
    } else if (delta != 0) {
      const double k = force / delta, sigma = std::abs(force) * spread / (delta * delta);
      // 1/x is not symmetric: near no displacement the upper bar is the longer one by far.
      const bool near = std::abs(delta) <= spread;  // of excluded ones, which have no bars
      const auto [low, high] =
          near ? std::pair(k - sigma, k + sigma) : std::minmax({force / (delta + spread), force / (delta - spread)});
      out.points[i] = {force, k, low, high, sigma};
      numbers.add(force, k, sigma, low, high);
      numbers.csv += line(r.excluded ? "excluded" : "reading", r.channel, group.series, r.trial, r.line, force,
                          delta / kMillimetre, k, sigma, low, high);
    }
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
    const double half = half95(se) * std::abs(force) / (delta * delta);
    out.band.add(force, k, 0, half);
    numbers.add(force, k, half / z95, k - half, k + half);
    numbers.csv += line("curve", group.channel, group.series, "", "", force, delta / kMillimetre, k, half / z95,
                        k - half, k + half);
  }
  return out;
}

/// The plot of the polynomial through the points of a group, where there is one; its numbers go to `csv`.
void add_trend(Page& page, const RunRecord& record, const Group& group, Points points, int degree, bool positive_only,
               std::string& csv, Plots& plots) {
  std::erase_if(points, [&](const auto& point) { return record.readings[point.first].excluded; });
  Rows polynomial = trend(points, degree);
  std::erase_if(polynomial, [&](const std::vector<double>& point) { return positive_only && !(point[1] > 0); });
  for (const std::vector<double>& point : polynomial)
    csv += line("trend", group.channel, group.series, "", "", point[0], "", point[1], "", "", "");
  page.add(plots, polynomial, "lines lw 1.6 dt (6,4)", group.colour);
}

std::string stiffness_caption(bool any_increment, bool any_plain, bool any_bound, bool any_at_least, bool trend,
                              bool logarithmic) {
  std::string caption =
      "Secant stiffness of every reading: load divided by displacement, the bars reaching to what it would be if "
      "the displacement were one standard deviation larger or smaller. A straight horizontal line would be a linear "
      "spring; a rising one stiffens under load.";
  if (any_increment) {
    caption += any_plain ? " Where readings at zero load exist, the displacement is the increment beyond their mean."
                         : " The displacement is the increment beyond self-weight, that is beyond the mean reading at "
                           "zero load.";
  }
  if (any_bound) caption += " The band of an increment is drawn at its largest possible width.";
  if (any_at_least)
    caption +=
        " Arrows begin at the least stiffness, 2 σ away, of readings that are within 2 σ of no displacement: there the "
        "quotient itself says nothing.";
  if (trend)
    caption +=
        " Dashed: a polynomial through the readings of each series, weighted with their bars, without any model.";
  if (!logarithmic) caption += " The vertical axis does not start at zero.";
  return caption;
}

/// A page with a panel for each channel; points are painted over curves.
struct LoadSheet {
  const Groups& groups;
  Grid grid;
  Page page;
  std::vector<Plots> curves, points;  ///< of each panel

  LoadSheet(const RunRecord& record, const Groups& all, const std::vector<LegendEntry>& legend,
            const std::string& title)
      : groups(all),
        grid(grid_of(legend, std::min<size_t>(groups.channels.size(), 3)).panels(groups.channels.size(), 330)),
        page(grid.page(title, record.title, record.simulated)),
        curves(groups.channels.size()),
        points(groups.channels.size()) {}

  void draw(size_t c, const Axis& x, const Axis& y) {
    curves[c].insert(curves[c].end(), points[c].begin(), points[c].end());
    page.panel(grid.box(c), x, y, panel_title(groups.channels[c]), curves[c]);
  }
};

/// What two panels above each other show: residuals, and the same in standard deviations of the readings.
struct Misses {
  std::string title, unit;
  Plots plots, scaled_plots;
  std::vector<double> reach;

  double size() const {
    double size = 0;
    for (const double value : reach) size = std::max(size, std::abs(value));
    return size;
  }
};

/// Numbers of all residuals, for axes and the CSV file.
struct ResidualNumbers {
  std::vector<double> places, scaled = {-2.6, 2.6};
  std::string csv;
};

void add_misses(Page& page, const RunRecord& record, const Groups& groups, const Group& group,
                const ReadingUnits& units, Misses& misses, ResidualNumbers& numbers) {
  const WrittenUnit& unit = units.of(group.channel);
  misses.unit = unit.label;
  Points absolute, ratios;
  for (const size_t i : group.readings) {
    const ReadingRecord& r = record.readings[i];
    const double load = has_loads(record) ? record.load_newtons[i] : std::nan("");
    const double place = has_loads(record) ? load : static_cast<double>(i + 1);
    const double residual = r.measured - r.predicted, ratio = residual / r.sigma;
    if (r.excluded && !std::isfinite(residual)) continue;  // nothing predicts it
    absolute[i] = {place, residual / unit.factor, r.sigma / unit.factor};
    ratios[i] = {place, ratio, 1};
    numbers.places.push_back(place);
    numbers.scaled.insert(numbers.scaled.end(), {ratio - 1, ratio + 1});
    misses.reach.insert(misses.reach.end(), {(residual - r.sigma) / unit.factor, (residual + r.sigma) / unit.factor});
    numbers.csv += units.row(
        line(r.channel, group.series, r.trial, r.line, load, absolute[i][1], absolute[i][2], ratio), r.channel);
  }
  add_points(page, record, groups, group, absolute, "yerrorbars", misses.plots);
  add_points(page, record, groups, group, ratios, "yerrorbars", misses.scaled_plots);
}

/// Two rows of panels for each row of `all`, in `grid`.
void draw_misses(Page& page, const Grid& grid, const RunRecord& record, const std::vector<Misses>& all,
                 const ResidualNumbers& numbers, bool one_unit) {
  // Panels of like size share their scale, so that they can be compared at a glance.
  const auto [smallest, largest] = std::ranges::minmax(all, {}, &Misses::size);
  std::vector<double> together;
  for (const Misses& misses : all) together.insert(together.end(), misses.reach.begin(), misses.reach.end());
  const bool common = one_unit && largest.size() < 5 * smallest.size();
  const std::string x_label = has_loads(record) ? load_axis_label(record) : "reading";
  for (size_t c = 0; c < all.size(); ++c) {
    const size_t upper = c + c / grid.columns * grid.columns, lower = upper + grid.columns;
    const bool first = grid.leftmost(c);
    const Box box = grid.box(upper);
    const Axis x = axis_over(numbers.places, x_label, tics_for(box), true);
    const std::string label = first || !one_unit ? bracketed("measured − fitted", all[c].unit) : "";
    page.panel(box, x, axis_over(common ? together : all[c].reach, label, 5, true), all[c].title, all[c].plots,
               zero_line());
    page.panel(grid.box(lower), x, axis_over(numbers.scaled, first ? "(measured − fitted) / σ" : "", 6, true),
               all[c].title, all[c].scaled_plots, expected_band() + zero_line());
  }
}

}  // namespace

std::optional<Drawing> force_displacement(const RunRecord& record) {
  if (!has_loads(record)) return std::nullopt;
  const Groups groups = groups_of(record);
  const ReadingUnits units(record);
  const std::string title = "Force and " + (units.what() == "value" ? "readings" : units.what());
  LoadSheet sheet(record, groups, legend_with_model(groups, {LegendEntry::bar_along_x, "± 1 σ of a reading"}), title);

  std::string csv =
      units.heads(fmt::format("kind,channel,series,trial,line,load_N,{},{},{},{}\n", units.column(units.what()),
                              units.column("sigma"), units.column("band_lower"), units.column("band_upper")));
  std::vector<std::vector<double>> shown(groups.channels.size());
  std::vector<double> loads = record.load_newtons;
  for (const Group& group : groups.all) {
    std::vector<double>& reach = shown[group.panel];
    Points points;
    const double unit = units.of(group.channel).factor;
    for (const size_t i : group.readings) {
      const ReadingRecord& r = record.readings[i];
      const double load = record.load_newtons[i], x = group.sign * r.measured / unit, sigma = r.sigma / unit;
      points[i] = {x, load, sigma};
      reach.insert(reach.end(), {x - sigma, x + sigma});
      csv += units.row(
          line(r.excluded ? "excluded" : "reading", r.channel, group.series, r.trial, r.line, load, x, sigma, "", ""),
          r.channel);
    }
    add_points(sheet.page, record, groups, group, points, "xerrorbars", sheet.points[group.panel]);
    if (group.curve == nullptr) continue;
    Band band;
    for (size_t i = 0; i < group.curve->load.size(); ++i) {
      const double load = group.curve->load[i], x = group.sign * group.curve->value.at(i) / unit;
      const double se = group.curve->se.at(i) / unit, half = half95(se);
      band.add(x, load, half, 0);
      reach.insert(reach.end(), {x - half, x + half});
      loads.push_back(load);
      csv +=
          units.row(line("curve", group.channel, group.series, "", "", load, x, se, x - half, x + half), group.channel);
    }
    band.draw(sheet.page, group.colour, sheet.curves[group.panel]);
    for (const CurveRecord& start : record.start_curves) {  // for the numbers and the page's own figure
      if (start.channel != group.channel || start.series != group.series) continue;
      for (size_t i = 0; i < start.load.size(); ++i)
        csv += units.row(line("start", group.channel, group.series, "", "", start.load[i],
                              group.sign * start.value.at(i) / unit, "", "", ""),
                         group.channel);
    }
  }
  for (size_t c = 0; c < groups.channels.size(); ++c) {
    const std::string& channel = groups.channels[c];
    const std::string label = bracketed(channel_axis(record, channel).label, units.of(channel).label);
    sheet.draw(c, axis_over(shown[c], label, tics_for(sheet.grid.box(c)), true),
               axis_over(loads, sheet.grid.leftmost(c) ? load_axis_label(record) : "", 6, true));
  }
  const std::string caption = fmt::format(
      "Every reading is a point at {}its {}; the bars are one standard deviation to either "
      "side. The line is the fitted model, the band around it the 95 % interval of the curve (often "
      "thinner than the line). A good fit passes through the points within about two bars.",
      units.what() == "position" ? "" : "the magnitude of ", units.what());
  return Drawing{{"force_displacement", title, caption}, csv, sheet.page};
}

std::optional<Drawing> effective_stiffness(const RunRecord& record) {
  if (!has_loads(record) || record.by_tension) return std::nullopt;
  const Groups groups = groups_of(record, Quantity::length);
  StiffnessNumbers numbers;
  numbers.csv =
      "kind,channel,series,trial,line,load_N,displacement_mm,stiffness_N_per_m,sigma_N_per_m,band_lower_N_per_m,"
      "band_upper_N_per_m\n";
  std::vector<Stiffness> rows;
  for (const Group& group : groups.all) rows.push_back(stiffness_of(record, group, numbers));
  const bool any_increment = std::ranges::any_of(rows, &Stiffness::increment);
  const bool any_plain = !std::ranges::all_of(rows, &Stiffness::increment);
  const bool any_bound = std::ranges::any_of(rows, &Stiffness::bound);
  const bool any_at_least = std::ranges::any_of(rows, [](const Stiffness& row) { return !row.at_least.empty(); });
  if (numbers.loads.empty()) return std::nullopt;

  std::vector<LegendEntry> legend = legend_with_model(groups, {LegendEntry::bar_along_y, "± 1 σ, propagated"});
  if (any_at_least) legend.push_back({LegendEntry::arrow, "at least, within 2 σ of none"});
  if (record.trend_degree > 0) {
    legend.push_back({LegendEntry::heading, "Trend, no model"});
    legend.push_back({LegendEntry::dashes, fmt::format("polynomial, degree {}", record.trend_degree)});
  }
  const bool increments = any_increment && !any_plain;
  LoadSheet sheet(record, groups, legend,
                  increments ? "Effective stiffness: force per increment beyond self-weight"
                             : "Effective stiffness: force per displacement");

  // One common axis; a long bar of one poor reading does not squeeze the rest. Where no reading is
  // better, the arrows make it.
  if (numbers.centres.empty()) {
    for (const Stiffness& row : rows) {
      for (const std::vector<double>& point : row.at_least) numbers.centres.push_back(point[1]);
    }
  }
  if (numbers.centres.empty()) return std::nullopt;
  const auto [low, high] = std::ranges::minmax(numbers.centres);
  const double room = std::max(0.5 * (high - low), 0.02 * std::max(std::abs(low), std::abs(high)));
  const bool logarithmic = low > 0 && high / low > 8;
  const auto arrow_tip = [&](double k) { return logarithmic ? 1.15 * k : k + 0.08 * (high - low + room); };
  for (const Stiffness& row : rows) {
    for (const std::vector<double>& point : row.at_least) numbers.reach.push_back(arrow_tip(point[1]));
  }
  for (double& value : numbers.reach) {
    value = std::clamp(value, low - room, high + room);
    if (logarithmic) value = std::clamp(value, low / 1.3, high * 1.3);
  }
  const std::string label = std::string(increments ? "force / increment" : "force / displacement") + " [N/m]" +
                            (logarithmic ? ", logarithmic" : "");
  for (size_t g = 0; g < groups.all.size(); ++g) {
    const Group& group = groups.all[g];
    Plots& curves = sheet.curves[group.panel];
    add_points(sheet.page, record, groups, group, rows[g].points, "yerrorbars", sheet.points[group.panel]);
    Rows arrows;
    for (const std::vector<double>& point : rows[g].at_least)
      arrows.push_back({point[0], point[1], arrow_tip(point[1]) - point[1]});
    sheet.page.add(sheet.points[group.panel], arrows, "vectors filled lw 1.4", group.colour, "1:2:(0):3");
    rows[g].band.draw(sheet.page, group.colour, curves);
    if (record.trend_degree > 0)
      add_trend(sheet.page, record, group, rows[g].points, record.trend_degree, logarithmic, numbers.csv, curves);
  }
  for (size_t c = 0; c < groups.channels.size(); ++c) {
    const std::string shown = sheet.grid.leftmost(c) ? label : "";
    sheet.draw(c, axis_over(numbers.loads, load_axis_label(record), tics_for(sheet.grid.box(c)), true),
               logarithmic ? logarithmic_axis_over(numbers.reach, shown) : axis_over(numbers.reach, shown, 6, false));
  }
  const std::string caption =
      stiffness_caption(any_increment, any_plain, any_bound, any_at_least, record.trend_degree > 0, logarithmic);
  return Drawing{{"effective_stiffness", "Effective stiffness", caption}, numbers.csv, sheet.page};
}

std::optional<Drawing> residuals(const RunRecord& record) {
  if (record.readings.empty() || over_strain(record) || over_time(record)) return std::nullopt;
  const Groups groups = groups_of(record);
  const std::vector<LegendEntry> legend = legend_of(groups, {{LegendEntry::bar_along_y, "± 1 σ of a reading"},
                                                             {LegendEntry::heading, "Expectation"},
                                                             {LegendEntry::line, "fitted model", kBlack},
                                                             {LegendEntry::band, "95 % if all is right"}});
  // Several series in one panel would lie on top of each other.
  const bool split = groups.series.size() > 1 && groups.all.size() <= 9;
  std::vector<Misses> misses(split ? groups.all.size() : groups.channels.size());
  const size_t columns = misses.size() == 4 ? 2 : std::min<size_t>(misses.size(), 3);
  const Grid grid = grid_of(legend, columns).panels(2 * columns * row_count(misses.size(), columns), 210);
  const std::string title = "What the fitted model misses";
  Page page = grid.page(title, record.title, record.simulated);

  const ReadingUnits units(record);
  ResidualNumbers numbers;
  numbers.csv = units.heads(fmt::format("channel,series,trial,line,load_N,{},{},normalised_residual\n",
                                        units.column("residual"), units.column("sigma")));
  for (size_t g = 0; g < groups.all.size(); ++g) {
    const Group& group = groups.all[g];
    Misses& to = misses[split ? g : group.panel];
    to.title = panel_title(group.channel);
    if (split) to.title = groups.channels.size() > 1 ? to.title + ", " + group.series : group.series;
    add_misses(page, record, groups, group, units, to, numbers);
  }
  draw_misses(page, grid, record, misses, numbers, units.common().has_value());
  const std::string caption = fmt::format(
      "Above in {}, below in standard deviations of the reading. If the model and the declared standard "
      "deviations are right, about 95 % of the points below lie in the grey band, without a trend.",
      !units.common()                 ? "the units of the readings"
      : units.common()->label == "mm" ? "millimetres"
                                      : units.common()->label);
  return Drawing{{"residuals", title, caption}, numbers.csv, page};
}

}  // namespace taut::plot

#include "reports/accuracy_figures.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "reports/figures.hpp"

namespace taut {
namespace plot {
namespace {

constexpr double kWide = 1120;  // px
constexpr double kRow = 19;     // px, of a legend
constexpr double kStrip = 34;   // px, of the failed settings
constexpr const char* kFront = "#ffcf70";
constexpr size_t kMostParameters = 6;  // panels
constexpr double kFloor = 1e-10;       // error below which all are alike

using Runs = std::vector<std::optional<AccuracyRun>>;

/// How a figure groups settings; "": it does not show this one.
using Grouping = std::function<std::string(const AccuracySetting&)>;

std::string by_axis(const AccuracySetting& setting) {
  return setting.axis;
}
std::string by_integrator(const AccuracySetting& setting) {
  return setting.integrator;
}

/// The groups of a study in their order, for colours and the legend.
std::vector<std::string> groups_of(const AccuracyStudy& study, const Runs& runs, const Grouping& group) {
  std::vector<std::string> groups;
  for (size_t i = 0; i < runs.size(); ++i) {
    const std::string name = group(study.settings[i]);
    if (runs[i] && !name.empty() && std::find(groups.begin(), groups.end(), name) == groups.end())
      groups.push_back(name);
  }
  return groups;
}

size_t index_of(const std::vector<std::string>& axes, const std::string& axis) {
  return static_cast<size_t>(std::find(axes.begin(), axes.end(), axis) - axes.begin());
}

std::string marks(const std::string& data, size_t i, double size) {
  return fmt::format("{} using 1:2 with points pt {} ps {} lw 1.8 lc rgb '{}'", data, symbol(i), size, colour(i));
}

/// What a panel shows: points of the chart with their costs, and errors in per cent.
struct Cloud {
  std::vector<const AccuracyPoint*> points;
  std::vector<double> cost, error;
  double uncertainty = NAN, noise = NAN;
};

/// Lines and marks of a cloud: each axis in its colour, the front, the setting in use.
std::vector<std::string> plots_of(Page& page, const AccuracyStudy& study, const std::vector<std::string>& axes,
                                  const Grouping& group, const Cloud& cloud) {
  std::vector<std::string> plots;
  std::vector<std::vector<std::vector<double>>> rows(axes.size());
  std::vector<std::vector<double>> ring, front;
  std::vector<std::pair<double, double>> all;
  for (size_t p = 0; p < cloud.points.size(); ++p) {
    const AccuracySetting& setting = study.settings[cloud.points[p]->setting];
    rows[index_of(axes, group(setting))].push_back({cloud.cost[p], cloud.error[p]});
    if (setting.in_use) ring.push_back({cloud.cost[p], cloud.error[p]});
    all.emplace_back(cloud.cost[p], cloud.error[p]);
  }
  for (size_t p : pareto_front(all)) front.push_back({all[p].first, all[p].second});
  plots.push_back(fmt::format("{} using 1:2 with lines lw 6 lc rgb '{}'", page.data(front), kFront));
  for (size_t a = 0; a < axes.size(); ++a) {
    if (rows[a].empty()) continue;
    std::sort(rows[a].begin(), rows[a].end());
    const std::string data = page.data(rows[a]);
    if (rows[a].size() > 1) plots.push_back(fmt::format("{} using 1:2 with lines lw 1 lc rgb '{}'", data, colour(a)));
    plots.push_back(marks(data, a, 1.1));
  }
  plots.push_back(fmt::format("{} using 1:2 with points pt 6 ps 2.6 lw 2.2 lc rgb '{}'", page.data(ring), kBlack));
  return plots;
}

Axis error_axis(const Cloud& cloud, const std::string& label) {
  std::vector<double> values;
  for (double error : cloud.error) values.push_back(error);
  for (double line : {cloud.uncertainty, cloud.noise}) {
    if (std::isfinite(line) && line > 0) values.push_back(line);
  }
  Axis axis = logarithmic_axis_over(values, label);
  axis.low /= 2;
  return axis;
}

/// The grey band below which nobody can tell, and the line of the noise.
std::string behind(const Cloud& cloud, const Axis& y) {
  std::string extra;
  if (cloud.uncertainty > y.low) {
    extra += fmt::format(
        "set object rectangle from graph 0, graph 0 to graph 1, first {:.6g} behind fs solid 0.25 noborder fc rgb "
        "'{}'\n",
        std::min(cloud.uncertainty, y.high), kGrey);
  }
  if (cloud.noise > y.low && cloud.noise < y.high) {
    extra += fmt::format(
        "set arrow from graph 0, first {0:.6g} to graph 1, first {0:.6g} nohead lw 1.5 dt (6,4) lc rgb '{1}'\n",
        cloud.noise, kBlack);
  }
  return extra;
}

/// Errors in per cent, no smaller than can be drawn.
double shown_error(double error, double uncertainty) {
  const double least = std::isfinite(uncertainty) && uncertainty > 0 ? 0.1 * uncertainty : kFloor;
  return 100 * std::max(std::abs(error), least);
}

std::vector<LegendEntry> legend_for(const std::vector<std::string>& axes, bool failed, bool noise, bool uncertainty) {
  std::vector<LegendEntry> legend{{LegendEntry::heading, "What is varied", kBlack}};
  for (size_t a = 0; a < axes.size(); ++a) legend.push_back({LegendEntry::point, axes[a], colour(a), symbol(a)});
  legend.push_back({LegendEntry::heading, "And", kBlack});
  legend.push_back({LegendEntry::point, "the setting in use", kBlack, 6});
  legend.push_back({LegendEntry::line, "nothing is faster and better", kFront});
  if (uncertainty) legend.push_back({LegendEntry::band, "too near to tell", kGrey});
  if (noise) legend.push_back({LegendEntry::dashes, "noise of the readings", kBlack});
  if (failed) legend.push_back({LegendEntry::text, "Top strip: failed, see below", kGrey});
  return legend;
}

/// "quadratic, 10 x 4 cells: 0.54 % in 0.0035 s, 13 factorisations".
std::string told(const AccuracyStudy& study, const Runs& runs, const AccuracyPoint& point, double error) {
  const AccuracyRun& run = *runs[point.setting];
  return fmt::format("{}: {:.2g} % in {:.2g} s, {} factorisations", study.settings[point.setting].name, 100 * error,
                     run.seconds, run.factorisations);
}

double seconds_of(const AccuracyRun& run) {
  return std::max(run.seconds, 1e-4);
}

/// One error of settings over wall time and over factorisations.
struct CostFigure {
  std::string name, title, subtitle, caption;
  std::function<double(const AccuracyPoint&)> error;
  double uncertainty = NAN;  ///< of what the errors are to
  Grouping group;
};

Page cost_page(const AccuracyStudy& study, const Runs& runs, const AccuracyChart& chart, const CostFigure& figure) {
  const std::vector<std::string> axes = groups_of(study, runs, figure.group);
  Cloud time, factorisations;
  std::vector<std::pair<double, double>> costs_and_errors;
  for (const AccuracyPoint& point : chart.points) {
    if (figure.group(study.settings[point.setting]).empty()) continue;
    const AccuracyRun& run = *runs[point.setting];
    time.points.push_back(&point);
    time.cost.push_back(seconds_of(run));
    time.error.push_back(shown_error(figure.error(point), figure.uncertainty));
    factorisations.cost.push_back(std::max(1, run.factorisations));
    costs_and_errors.emplace_back(run.seconds, figure.error(point));
  }
  factorisations.points = time.points;
  factorisations.error = time.error;
  time.uncertainty = factorisations.uncertainty = 100 * figure.uncertainty;

  std::string labels_time, labels_factorisations;
  std::vector<LegendEntry> below{{LegendEntry::heading, "Nothing is faster and better than:", kBlack}};
  for (size_t i : pareto_front(costs_and_errors)) {
    const auto label = [&](double x) {
      return fmt::format("set label '{}' at first {:.6g}, first {:.6g} right offset -0.7,-0.6 font ',12' tc rgb '{}'\n",
                         below.size(), x, time.error[i], kBlack);
    };
    labels_time += label(time.cost[i]);
    labels_factorisations += label(factorisations.cost[i]);
    const std::string text = told(study, runs, *time.points[i], costs_and_errors[i].second);
    below.push_back({LegendEntry::text, fmt::format("{}  {}", below.size(), text), kGrey});
  }
  for (const AccuracyPoint* point : time.points) {
    if (study.settings[point->setting].in_use)
      below.push_back({LegendEntry::heading, "In use: " + told(study, runs, *point, figure.error(*point)), kBlack});
  }
  // Failed settings stand over what they took, at the edge where that is beyond the others.
  const auto inside = [](double cost, const std::vector<double>& costs) {
    const auto [low, high] = std::minmax_element(costs.begin(), costs.end());
    return std::clamp(cost, *low, *high);
  };
  std::vector<std::string> failures;
  std::vector<std::vector<std::vector<double>>> failed_time(axes.size()), failed_factorisations(axes.size());
  size_t missing = 0, asked = 0;
  for (size_t i = 0; i < runs.size(); ++i) {
    const AccuracySetting& setting = study.settings[i];
    if (figure.group(setting).empty()) continue;
    ++asked;
    if (!runs[i]) ++missing;
    if (!runs[i] || runs[i]->failure.empty()) continue;
    const size_t a = index_of(axes, figure.group(setting));
    failed_time[a].push_back({inside(seconds_of(*runs[i]), time.cost), 0.5});
    failed_factorisations[a].push_back({inside(runs[i]->factorisations, factorisations.cost), 0.5});
    failures.push_back(setting.name + ": " + runs[i]->failure);
  }
  const bool failed = !failures.empty();
  if (failed) below.push_back({LegendEntry::heading, "Failed:", kBlack});
  constexpr size_t most = 12;
  for (size_t i = 0; i < std::min(failures.size(), most); ++i) below.push_back({LegendEntry::text, failures[i], kGrey});
  if (failures.size() > most)
    below.push_back({LegendEntry::text, fmt::format("and {} more, see the table", failures.size() - most), kGrey});
  if (missing > 0)
    below.push_back(
        {LegendEntry::heading,
         fmt::format("{} of {} settings are missing: they did not fit into the time allowed", missing, asked), kBlack});

  const std::vector<LegendEntry> legend = legend_for(axes, failed, false, figure.uncertainty > 0);
  constexpr double left = 84, gap = 46, tall = 320, under = 66;
  const double above = 34 + (failed ? kStrip + 8 : 0);
  const double listed = kRow * static_cast<double>(below.size()) + 46;
  const double height = kTitle + above + tall + under + listed;
  const double legend_left = kWide - legend_width(legend) - 8;
  const double across = (legend_left - 26 - left - gap) / 2;
  Page page(kWide, height, figure.title, figure.subtitle, study.simulated);
  page.legend(legend_left, height - kTitle - 40, legend);
  page.legend(left, listed - 18, below);

  const double bottom = listed + under, top = bottom + tall;
  const auto draw = [&](double from, const Cloud& cloud, const std::string& label, const std::string& marks_of_front,
                        const std::vector<std::vector<std::vector<double>>>& strip, const std::string& y_label) {
    Axis x = logarithmic_axis_over(cloud.cost, label);
    x.low /= 1.3;
    const Axis y = error_axis(cloud, y_label);
    page.panel({from, bottom, from + across, top}, x, y, "", plots_of(page, study, axes, figure.group, cloud),
               "set tics nomirror out scale 0.6\n" + behind(cloud, y) + marks_of_front);
    if (!failed) return;
    std::vector<std::string> plots;
    for (size_t a = 0; a < axes.size(); ++a) {
      if (!strip[a].empty()) plots.push_back(marks(page.data(strip[a]), a, 1.1));
    }
    Axis none = x;
    none.label.clear();
    page.panel({from, top + 8, from + across, top + 8 + kStrip}, none, {"", 0, 1, 2}, "failed", plots,
               "unset xtics\nunset ytics\n"
               "set object rectangle from graph 0, graph 0 to graph 1, graph 1 behind fs solid 0.15 noborder fc rgb "
               "'#d55e00'\n");
  };
  draw(left, time, "wall time [s]", labels_time, failed_time, "error [%]");
  draw(left + across + gap, factorisations, "matrix factorisations", labels_factorisations, failed_factorisations, "");
  return page;
}

}  // namespace

Drawing accuracy_cost(const AccuracyStudy& study, const Runs& runs, const AccuracyChart& chart) {
  std::string csv =
      "axis,setting,in_use,unknowns,seconds,factorisations,error_%,largest_error_%,from_setting_in_use_%,on_front,"
      "failure\n";
  for (const AccuracyPoint& point : chart.points) {
    const AccuracySetting& setting = study.settings[point.setting];
    const AccuracyRun& run = *runs[point.setting];
    csv += line(setting.axis, setting.name, setting.in_use ? 1 : 0, run.unknowns, run.seconds, run.factorisations,
                100 * point.error, 100 * point.largest, 100 * point.from_setting_in_use, point.on_front ? 1 : 0,
                std::string());
  }
  csv += line(std::string("reference"), chart.reference, 0, std::string(), std::string(), std::string(),
              100 * chart.uncertainty, std::string(), std::string(), std::string(), std::string());
  for (size_t i = 0; i < runs.size(); ++i) {
    if (!runs[i] || runs[i]->failure.empty()) continue;
    const AccuracySetting& setting = study.settings[i];
    csv += line(setting.axis, setting.name, setting.in_use ? 1 : 0, runs[i]->unknowns, runs[i]->seconds,
                runs[i]->factorisations, std::string(), std::string(), std::string(), 0, runs[i]->failure);
  }
  const CostFigure figure{
      "accuracy_cost",
      "What accuracy costs: error against time and work",
      study.title + "; error of the " + study.result,
      fmt::format("Each mark is one way to compute the same {}: root mean square error over what it took. Left and "
                  "below is better; on the yellow line nothing is both faster and more accurate. The reference: {}. "
                  "Within the grey band errors cannot be told from the reference's own.",
                  study.result, chart.reference),
      [](const AccuracyPoint& point) { return point.error; },
      chart.uncertainty,
      by_axis};
  return {{figure.name, "What accuracy costs", figure.caption, ""}, csv, cost_page(study, runs, chart, figure)};
}

std::optional<Drawing> accuracy_steps(const AccuracyStudy& study, const Runs& runs, const AccuracyChart& chart) {
  if (chart.step_reference.empty()) return std::nullopt;
  std::string csv = "integrator,setting,in_use,seconds,factorisations,error_%,failure\n";
  csv += line(std::string("reference"), chart.step_reference, 0, std::string(), std::string(),
              100 * chart.step_uncertainty, std::string());
  for (const AccuracyPoint& point : chart.points) {
    const AccuracySetting& setting = study.settings[point.setting];
    const AccuracyRun& run = *runs[point.setting];
    if (setting.integrator.empty()) continue;
    csv += line(setting.integrator, setting.name, setting.in_use ? 1 : 0, run.seconds, run.factorisations,
                100 * point.step_error, std::string());
  }
  for (size_t i = 0; i < runs.size(); ++i) {
    const AccuracySetting& setting = study.settings[i];
    if (setting.integrator.empty() || !runs[i] || runs[i]->failure.empty()) continue;
    csv += line(setting.integrator, setting.name, setting.in_use ? 1 : 0, runs[i]->seconds, runs[i]->factorisations,
                std::string(), runs[i]->failure);
  }
  const CostFigure figure{
      "accuracy_steps",
      "What accuracy in time costs: integrators on one mesh",
      study.title + "; error by the time steps alone, of the " + study.result,
      fmt::format("The file's own mesh throughout, so that only the way through time differs. The reference: {}. "
                  "Integrators of another making that come to the same are its best confirmation.",
                  chart.step_reference),
      [](const AccuracyPoint& point) { return point.step_error; },
      chart.step_uncertainty,
      by_integrator};
  return Drawing{
      {figure.name, "What accuracy in time costs", figure.caption, ""}, csv, cost_page(study, runs, chart, figure)};
}

std::optional<Drawing> accuracy_parameters(const AccuracyStudy& study, const Runs& runs, const AccuracyChart& chart) {
  if (study.free.empty() || chart.points.empty()) return std::nullopt;
  const std::vector<std::string> axes = groups_of(study, runs, by_axis);
  const size_t count = std::min(study.free.size(), kMostParameters), columns = count == 1 ? 1 : 2;
  const size_t rows = (count + columns - 1) / columns;
  const std::vector<LegendEntry> legend = legend_for(axes, false, true, chart.uncertainty > 0);
  constexpr double left = 84, gap = 76, below = 58, above = 34, tall = 250;
  const double height = kTitle + static_cast<double>(rows) * (above + tall + below);
  const double legend_left = kWide - legend_width(legend) - 8;
  const double across =
      (legend_left - 26 - left - gap * static_cast<double>(columns - 1)) / static_cast<double>(columns);
  Page page(kWide, height, "What the setting does to each fitted parameter",
            study.title + "; change of a fit's result by the setting alone", study.simulated);
  page.legend(legend_left, height - kTitle - 40, legend);
  std::string csv = "parameter,axis,setting,in_use,seconds,factorisations,error_%\n";
  for (size_t j = 0; j < count; ++j) {
    const ParameterSpec& spec = study.table[study.free[j].index];
    Cloud cloud;
    cloud.uncertainty = 100 * chart.parameter_uncertainty[j];
    cloud.noise = 100 * chart.parameter_noise[j];
    csv += line(spec.id, std::string("reference"), chart.reference, 0, std::string(), std::string(), cloud.uncertainty);
    csv += line(spec.id, std::string("noise"), std::string("standard error from the readings' noise"), 0, std::string(),
                std::string(), cloud.noise);
    for (const AccuracyPoint& point : chart.points) {
      const AccuracySetting& setting = study.settings[point.setting];
      const AccuracyRun& run = *runs[point.setting];
      cloud.points.push_back(&point);
      cloud.cost.push_back(seconds_of(run));
      cloud.error.push_back(shown_error(point.parameters[j], chart.parameter_uncertainty[j]));
      csv += line(spec.id, setting.axis, setting.name, setting.in_use ? 1 : 0, run.seconds, run.factorisations,
                  100 * point.parameters[j]);
    }
    const double from = left + static_cast<double>(j % columns) * (across + gap);
    const double top = height - kTitle - above - static_cast<double>(j / columns) * (above + tall + below);
    const Axis y = error_axis(cloud, spec.logarithmic ? "error [%]" : "error [% of its range]");
    page.panel({from, top - tall, from + across, top}, logarithmic_axis_over(cloud.cost, "wall time [s]"), y, spec.id,
               plots_of(page, study, axes, by_axis, cloud), behind(cloud, y));
  }
  return Drawing{
      {"accuracy_parameters", "What the setting does to each fitted parameter",
       fmt::format(
           "If readings were exactly what the reference says, a fit with each setting would be off by "
           "this much. Below the dashed line the setting matters less than the noise of the "
           "readings.{}",
           study.free.size() > count ? fmt::format(" The first {} of {} parameters.", count, study.free.size()) : ""),
       ""},
      csv,
      page};
}

}  // namespace plot

std::vector<Figure> draw_accuracy(const AccuracyStudy& study, const std::vector<std::optional<AccuracyRun>>& runs,
                                  const AccuracyChart& chart, const std::string& folder) {
  std::vector<Figure> figures;
  figures.push_back(plot::finished(plot::accuracy_cost(study, runs, chart), folder));
  if (auto drawing = plot::accuracy_steps(study, runs, chart))
    figures.push_back(plot::finished(std::move(*drawing), folder));
  if (auto drawing = plot::accuracy_parameters(study, runs, chart))
    figures.push_back(plot::finished(std::move(*drawing), folder));
  return figures;
}

}  // namespace taut

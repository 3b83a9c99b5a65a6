#include "reports/accuracy_figures.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "reports/figures.hpp"

namespace taut {
namespace plot {
namespace {

constexpr Room kRoom{.left = 84, .gap = 76, .above = 34, .right = 26, .page = 1120};
constexpr double kStrip = 34;  // px, of the failed settings
constexpr const char* kFront = "#ffcf70";
constexpr size_t kMostParameters = 6;  // panels
constexpr double kFloor = 1e-10;       // error below which all are alike

using Runs = std::vector<std::optional<AccuracyRun>>;

/// What a setting takes, as a panel shows it.
using Cost = double (*)(const AccuracyRun& run);
double seconds_of(const AccuracyRun& run) {
  return std::max(run.seconds, 1e-4);
}
double factorisations_of(const AccuracyRun& run) {
  return std::max(1, run.factorisations);
}

/// Points of the chart that a panel shows, with their errors in per cent.
struct Cloud {
  std::vector<const AccuracyPoint*> points;
  std::vector<double> error;
  double uncertainty = NAN, noise = NAN;

  /// An error no smaller than can be drawn.
  void add(const AccuracyPoint& point, double value) {
    points.push_back(&point);
    error.push_back(std::max(100 * std::abs(value),
                             std::isfinite(uncertainty) && uncertainty > 0 ? 0.1 * uncertainty : 100 * kFloor));
  }
};

Axis error_axis(const Cloud& cloud, const std::string& label) {
  std::vector<double> values = cloud.error;
  values.insert(values.end(), {cloud.uncertainty, cloud.noise});
  Axis axis = logarithmic_axis_over(values, label);
  axis.low /= 2;
  return axis;
}

/// The grey band below which nobody can tell, and the line of the noise.
std::string behind(const Cloud& cloud, const Axis& y) {
  std::string extra;
  if (cloud.uncertainty > y.low)
    extra += shade("graph 0, graph 0", "graph 1, " + first(std::min(cloud.uncertainty, y.high)), "solid 0.25", kGrey);
  if (cloud.noise > y.low && cloud.noise < y.high) extra += horizontal_line(cloud.noise, kBlack, kDashed);
  return extra;
}

/// A study and what came of it, with its settings in groups that have a colour and a symbol each.
class Chart {
 public:
  const AccuracyStudy& study;
  const Runs& runs;
  const AccuracyChart& chart;

  /// `group` names the group of a setting; "": it is not shown.
  Chart(const AccuracyStudy& all, const Runs& made, const AccuracyChart& judged, std::string AccuracySetting::*group)
      : study(all), runs(made), chart(judged), group_(group) {
    for (size_t i = 0; i < runs.size(); ++i) {
      if (runs[i] && shows(i)) place_in(groups_, study.settings[i].*group_);
    }
  }

  bool shows(size_t setting) const { return !(study.settings[setting].*group_).empty(); }
  bool failed(size_t setting) const { return shows(setting) && runs[setting] && !runs[setting]->failure.empty(); }

  /// "quadratic, 10 x 4 cells: 0.54 % in 0.0035 s, 13 factorisations".
  std::string told(const AccuracyPoint& point, double error) const {
    const AccuracyRun& run = *runs[point.setting];
    return fmt::format("{}: {:.2g} % in {:.2g} s, {} factorisations", study.settings[point.setting].name, 100 * error,
                       run.seconds, run.factorisations);
  }

  std::vector<LegendEntry> legend(bool any_failed, bool noise, bool uncertainty) const {
    std::vector<LegendEntry> entries{{LegendEntry::heading, "What is varied", kBlack}};
    for (size_t g = 0; g < groups_.size(); ++g)
      entries.push_back({LegendEntry::point, groups_[g], colour(g), symbol(g)});
    entries.push_back({LegendEntry::heading, "And", kBlack});
    entries.push_back({LegendEntry::point, "the setting in use", kBlack, 6});
    entries.push_back({LegendEntry::line, "nothing is faster and better", kFront});
    if (uncertainty) entries.push_back({LegendEntry::band, "too near to tell", kGrey});
    if (noise) entries.push_back({LegendEntry::dashes, "noise of the readings", kBlack});
    if (any_failed) entries.push_back({LegendEntry::text, "Top strip: failed, see below", kGrey});
    return entries;
  }

  std::vector<double> costs(const Cloud& cloud, Cost cost) const {
    std::vector<double> costs;
    for (const AccuracyPoint* point : cloud.points) costs.push_back(cost(*runs[point->setting]));
    return costs;
  }

  /// Lines and marks of a cloud: each group in its colour, the front, the setting in use.
  Plots plots(Page& page, const Cloud& cloud, Cost cost) const {
    std::vector<Rows> groups(groups_.size());
    Rows ring, front;
    std::vector<std::pair<double, double>> all;
    for (size_t p = 0; p < cloud.points.size(); ++p) {
      const size_t setting = cloud.points[p]->setting;
      all.emplace_back(cost(*runs[setting]), cloud.error[p]);
      groups[place(setting)].push_back({all[p].first, all[p].second});
      if (study.settings[setting].in_use) ring.push_back({all[p].first, all[p].second});
    }
    for (const size_t p : pareto_front(all)) front.push_back({all[p].first, all[p].second});
    Plots plots{plotted(page.data(front), "lines lw 6", kFront)};
    for (size_t g = 0; g < groups.size(); ++g) {
      std::ranges::sort(groups[g]);
      if (groups[g].empty()) continue;
      const std::string block = page.data(groups[g]);
      if (groups[g].size() > 1) plots.push_back(plotted(block, "lines lw 1", colour(g)));
      plots.push_back(marks(block, g));
    }
    plots.push_back(plotted(page.data(ring), "points pt 6 ps 2.6 lw 2.2", kBlack));
    return plots;
  }

  /// Marks of the failed settings over what they took, at the edge where that is beyond the others.
  Plots failed_plots(Page& page, const Cloud& cloud, Cost cost) const {
    const auto [low, high] = std::ranges::minmax(costs(cloud, cost));
    std::vector<Rows> groups(groups_.size());
    for (size_t i = 0; i < runs.size(); ++i) {
      if (failed(i)) groups[place(i)].push_back({std::clamp(cost(*runs[i]), low, high), 0.5});
    }
    Plots plots;
    for (size_t g = 0; g < groups.size(); ++g) {
      if (!groups[g].empty()) plots.push_back(marks(page.data(groups[g]), g));
    }
    return plots;
  }

  /// A line of a CSV file: what was set and what that took, between other columns.
  template <class... More>
  std::string row(size_t setting, const More&... more) const {
    const AccuracySetting& s = study.settings[setting];
    return line(s.*group_, s.name, s.in_use ? 1 : 0, runs[setting]->seconds, runs[setting]->factorisations, more...);
  }

 private:
  size_t place(size_t setting) const {
    return static_cast<size_t>(std::ranges::find(groups_, study.settings[setting].*group_) - groups_.begin());
  }
  static std::string marks(const std::string& block, size_t group) {
    return plotted(block, fmt::format("points pt {} ps 1.1 lw 1.8", symbol(group)), colour(group));
  }

  std::string AccuracySetting::*group_;
  std::vector<std::string> groups_;  ///< in the order of the study
};

/// One error of settings over wall time and over factorisations.
struct CostFigure {
  std::string title, subtitle;
  double AccuracyPoint::*error;
  double uncertainty;  ///< of what the errors are to
};

/// What stands below the panels in words: points that nothing beats, by the numbers at their marks, the setting in use,
/// what failed, what is missing.
std::vector<LegendEntry> told_below(const Chart& chart, const CostFigure& figure, const std::vector<size_t>& front,
                                    const Cloud& cloud) {
  std::vector<LegendEntry> below{{LegendEntry::heading, "Nothing is faster and better than:", kBlack}};
  const auto text = [&](const std::string& words) { below.push_back({LegendEntry::text, words, kGrey}); };
  const auto heading = [&](const std::string& words) { below.push_back({LegendEntry::heading, words, kBlack}); };
  const auto told = [&](const AccuracyPoint* point) { return chart.told(*point, point->*figure.error); };
  for (const size_t i : front) text(fmt::format("{}  {}", below.size(), told(cloud.points[i])));
  for (const AccuracyPoint* point : cloud.points) {
    if (chart.study.settings[point->setting].in_use) heading("In use: " + told(point));
  }
  if (!chart.chart.section.empty()) text(chart.chart.section);
  size_t missing = 0, asked = 0, failures = 0;
  constexpr size_t most = 12;
  for (size_t i = 0; i < chart.runs.size(); ++i) {
    asked += chart.shows(i);
    missing += chart.shows(i) && !chart.runs[i];
    if (!chart.failed(i)) continue;
    if (failures == 0) heading("Failed:");
    if (++failures <= most) text(chart.study.settings[i].name + ": " + chart.runs[i]->failure);
  }
  if (failures > most) text(fmt::format("and {} more, see the table", failures - most));
  if (missing > 0)
    heading(fmt::format("{} of {} settings are missing: they did not fit into the time allowed", missing, asked));
  return below;
}

Page cost_page(const Chart& chart, const CostFigure& figure) {
  Cloud cloud;
  cloud.uncertainty = 100 * figure.uncertainty;
  std::vector<std::pair<double, double>> costs_and_errors;
  for (const AccuracyPoint& point : chart.chart.points) {
    if (!chart.shows(point.setting)) continue;
    cloud.add(point, point.*figure.error);
    costs_and_errors.emplace_back(chart.runs[point.setting]->seconds, point.*figure.error);
  }
  const std::vector<size_t> front = pareto_front(costs_and_errors);
  const std::vector<LegendEntry> below = told_below(chart, figure, front, cloud);
  bool failed = false;
  for (size_t i = 0; i < chart.runs.size(); ++i) failed = failed || chart.failed(i);

  constexpr double tall = 320, between = 8;
  Room room = kRoom;
  room.gap = 46;
  room.below = 66;
  room.foot = legend_height(below) + 46;
  const Grid grid =
      Grid(room, chart.legend(failed, false, figure.uncertainty > 0), 2).rows({tall + (failed ? between + kStrip : 0)});
  Page page = grid.page(figure.title, figure.subtitle, chart.study.simulated);
  page.legend(room.left, room.foot - 18, below);

  const auto draw = [&](size_t panel, Cost cost, const std::string& label, const std::string& y_label) {
    const std::vector<double> costs = chart.costs(cloud, cost);
    Axis x = logarithmic_axis_over(costs, label);
    x.low /= 1.3;
    const Axis y = error_axis(cloud, y_label);
    std::string numbers;
    for (size_t n = 0; n < front.size(); ++n) {
      numbers += fmt::format("set label '{}' at {}, {} right offset -0.7,-0.6 font ',12' tc rgb '{}'\n", n + 1,
                             first(costs[front[n]]), first(cloud.error[front[n]]), kBlack);
    }
    Box box = grid.box(panel);
    const Box strip{box.left, box.top - kStrip, box.right, box.top};
    box.top = box.bottom + tall;
    page.panel(box, x, y, "", chart.plots(page, cloud, cost),
               "set tics nomirror out scale 0.6\n" + behind(cloud, y) + numbers);
    if (!failed) return;
    x.label.clear();
    page.panel(strip, x, {"", 0, 1, 2}, "failed", chart.failed_plots(page, cloud, cost),
               "unset xtics\nunset ytics\n" + shade("graph 0, graph 0", "graph 1, graph 1", "solid 0.15", "#d55e00"));
  };
  draw(0, seconds_of, "wall time [s]", "error [%]");
  draw(1, factorisations_of, "matrix factorisations", "");
  return page;
}

Drawing accuracy_cost(const AccuracyStudy& study, const Runs& runs, const AccuracyChart& judged) {
  const Chart chart(study, runs, judged, &AccuracySetting::axis);
  std::string csv =
      "axis,setting,in_use,unknowns,seconds,factorisations,error_%,largest_error_%,from_setting_in_use_%,on_front,"
      "failure\n";
  const auto add = [&](size_t i, const auto& error, const auto& largest, const auto& from_in_use, bool on_front) {
    const AccuracySetting& setting = study.settings[i];
    csv += line(setting.axis, setting.name, setting.in_use ? 1 : 0, runs[i]->unknowns, runs[i]->seconds,
                runs[i]->factorisations, error, largest, from_in_use, on_front ? 1 : 0, runs[i]->failure);
  };
  for (const AccuracyPoint& p : judged.points)
    add(p.setting, 100 * p.error, 100 * p.largest, 100 * p.from_setting_in_use, p.on_front);
  csv += line("reference", judged.reference, 0, "", "", "", 100 * judged.uncertainty, "", "", "", "");
  for (size_t i = 0; i < runs.size(); ++i) {
    if (chart.failed(i)) add(i, "", "", "", false);
  }
  const std::string caption = fmt::format(
      "Each mark is one way to compute the same {}: root mean square error over what it took. Left and below "
      "is better; on the yellow line nothing is both faster and more accurate. The reference: {}. Within the "
      "grey band errors cannot be told from the reference's own.",
      study.result, judged.reference);
  return {
      {"accuracy_cost", "What accuracy costs", caption},
      csv,
      cost_page(chart, {"What accuracy costs: error against time and work",
                        study.title + "; error of the " + study.result, &AccuracyPoint::error, judged.uncertainty})};
}

/// A line for each setting that is shown, those that failed last.
std::string rows_of(const Chart& chart, double AccuracyPoint::*error) {
  std::string csv;
  for (const AccuracyPoint& point : chart.chart.points) {
    if (chart.shows(point.setting)) csv += chart.row(point.setting, 100 * point.*error, "");
  }
  for (size_t i = 0; i < chart.runs.size(); ++i) {
    if (chart.failed(i)) csv += chart.row(i, "", chart.runs[i]->failure);
  }
  return csv;
}

std::optional<Drawing> accuracy_steps(const AccuracyStudy& study, const Runs& runs, const AccuracyChart& judged) {
  if (judged.step_reference.empty()) return std::nullopt;
  const Chart chart(study, runs, judged, &AccuracySetting::integrator);
  std::string csv = "integrator,setting,in_use,seconds,factorisations,error_%,failure\n";
  csv += line("reference", judged.step_reference, 0, "", "", 100 * judged.step_uncertainty, "");
  csv += rows_of(chart, &AccuracyPoint::step_error);
  const std::string caption = fmt::format(
      "The file's own mesh throughout, so that only the way through time differs. The reference: {}. "
      "Integrators of another making that come to the same are its best confirmation.",
      judged.step_reference);
  return Drawing{{"accuracy_steps", "What accuracy in time costs", caption},
                 csv,
                 cost_page(chart, {"What accuracy in time costs: integrators on one mesh",
                                   study.title + "; error by the time steps alone, of the " + study.result,
                                   &AccuracyPoint::step_error, judged.step_uncertainty})};
}

std::optional<Drawing> accuracy_models(const AccuracyStudy& study, const Runs& runs, const AccuracyChart& judged) {
  if (judged.model_reference.empty()) return std::nullopt;
  const Chart chart(study, runs, judged, &AccuracySetting::model);
  std::string csv = "model,setting,in_use,seconds,factorisations,error_%,failure\n";
  csv += line("reference", judged.model_reference, 0, "", "", 100 * judged.model_uncertainty, "");
  csv += rows_of(chart, &AccuracyPoint::model_error);
  const std::string caption = fmt::format(
      "From the cheapest model to the solid: {}. The reference: {}. Within the grey band errors cannot be told from "
      "its "
      "own.",
      judged.section, judged.model_reference);
  return Drawing{{"accuracy_models", "How much model it needs", caption},
                 csv,
                 cost_page(chart, {"How much model it needs: from beams to the solid",
                                   study.title + "; error to the solid, of the " + study.result,
                                   &AccuracyPoint::model_error, judged.model_uncertainty})};
}

std::optional<Drawing> accuracy_parameters(const AccuracyStudy& study, const Runs& runs, const AccuracyChart& judged) {
  if (study.free.empty() || judged.points.empty()) return std::nullopt;
  const Chart chart(study, runs, judged, &AccuracySetting::axis);
  const size_t count = std::min(study.free.size(), kMostParameters);
  const Grid grid =
      Grid(kRoom, chart.legend(false, true, judged.uncertainty > 0), count == 1 ? 1 : 2).panels(count, 250);
  const std::string title = "What the setting does to each fitted parameter";
  Page page = grid.page(title, study.title + "; change of a fit's result by the setting alone", study.simulated);
  std::string csv = "parameter,axis,setting,in_use,seconds,factorisations,error_%\n";
  for (size_t j = 0; j < count; ++j) {
    const ParameterSpec& spec = study.table[study.free[j].index];
    Cloud cloud;
    cloud.uncertainty = 100 * judged.parameter_uncertainty[j];
    cloud.noise = 100 * judged.parameter_noise[j];
    csv += line(spec.id, "reference", judged.reference, 0, "", "", cloud.uncertainty);
    csv += line(spec.id, "noise", "standard error from the readings' noise", 0, "", "", cloud.noise);
    for (const AccuracyPoint& point : judged.points) {
      cloud.add(point, point.parameters[j]);
      csv += field(spec.id) + "," + chart.row(point.setting, 100 * point.parameters[j]);
    }
    const Axis y = error_axis(cloud, spec.logarithmic ? "error [%]" : "error [% of its range]");
    page.panel(grid.box(j), logarithmic_axis_over(chart.costs(cloud, seconds_of), "wall time [s]"), y, spec.id,
               chart.plots(page, cloud, seconds_of), behind(cloud, y));
  }
  const std::string caption = fmt::format(
      "If readings were exactly what the reference says, a fit with each setting would be off by this much. Below the "
      "dashed line the setting matters less than the noise of the readings.{}",
      study.free.size() > count ? fmt::format(" The first {} of {} parameters.", count, study.free.size()) : "");
  return Drawing{{"accuracy_parameters", title, caption}, csv, page};
}

}  // namespace
}  // namespace plot

std::vector<Figure> draw_accuracy(const AccuracyStudy& study, const std::vector<std::optional<AccuracyRun>>& runs,
                                  const AccuracyChart& chart, const std::string& folder) {
  std::vector<Figure> figures;
  for (std::optional<plot::Drawing> drawing :
       {std::optional(plot::accuracy_cost(study, runs, chart)), plot::accuracy_steps(study, runs, chart),
        plot::accuracy_models(study, runs, chart), plot::accuracy_parameters(study, runs, chart)}) {
    if (drawing) figures.push_back(plot::finished(std::move(*drawing), folder));
  }
  return figures;
}

}  // namespace taut

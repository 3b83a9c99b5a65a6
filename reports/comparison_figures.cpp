#include "reports/comparison_figures.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>

#include "reports/axes.hpp"
#include "reports/figures.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

using plot::LegendEntry;
using plot::Rows;

bool any_simulated(const std::vector<NamedRun>& runs) {
  return std::ranges::any_of(runs, [](const NamedRun& run) { return run.record->simulated; });
}

std::vector<LegendEntry> legend_of(const std::vector<NamedRun>& runs) {
  std::vector<LegendEntry> legend{{LegendEntry::heading, "run"}};
  for (size_t i = 0; i < runs.size(); ++i)
    legend.push_back({LegendEntry::line, plot::shortened(runs[i].name, 34), plot::colour(i)});
  return legend;
}

/// Days since 1970 of "2026-11-29T18:35:04Z"; NaN: it is none.
double days_of(const std::string& date) {
  int year = 0, month = 0, day = 0, hour = 0, minute = 0, second = 0;
  if (std::sscanf(date.c_str(), "%d-%d-%dT%d:%d:%d", &year, &month, &day, &hour, &minute, &second) != 6)
    return std::nan("");
  const std::chrono::sys_days whole = std::chrono::year(year) / month / day;
  return static_cast<double>(whole.time_since_epoch().count()) + (hour + (minute + second / 60.0) / 60) / 24;
}

const ParameterEstimate* estimate_in(const RunRecord& record, const std::string& id) {
  for (const ParameterEstimate& e : record.fit.parameters) {
    if (e.spec.id == id) return &e;
  }
  return nullptr;
}

}  // namespace

Figure draw_compared_curves(const std::vector<NamedRun>& runs, const std::string& folder) {
  const RunRecord& main = *runs.front().record;
  std::vector<LegendEntry> legend = legend_of(runs);
  legend.push_back({LegendEntry::point, "readings"});
  legend.push_back({LegendEntry::band, "95 % of the curve (noise)"});
  plot::Grid grid({.above = 34}, legend);
  grid.panels(main.channels.size(), 260);
  const std::string title = "Fitted curves of several runs over each other";
  plot::Page page = grid.page(title, main.title, any_simulated(runs));
  std::string csv = "run,channel,series,load,value,standard_error\n";
  std::vector<double> loads, sizes;
  for (const NamedRun& run : runs) {
    for (const CurveRecord& curve : run.record->curves) loads.insert(loads.end(), curve.load.begin(), curve.load.end());
  }
  const bool load = main.load_control >= 0;
  const WrittenUnit load_unit = shown_unit(load ? "N" : drawn_control(main).unit, loads);
  for (double& value : loads) value /= load_unit.factor;
  for (size_t c = 0; c < main.channels.size(); ++c) {
    const AxisRecord& channel = main.channels[c];
    plot::Plots plots;
    std::vector<double> values;
    std::vector<Rows> points(runs.size());
    std::vector<std::vector<plot::Band>> bands(runs.size());
    for (size_t i = 0; i < runs.size(); ++i) {
      for (const CurveRecord& curve : runs[i].record->curves) {
        if (curve.channel != channel.id) continue;
        for (size_t k = 0; k < curve.load.size(); ++k) {
          values.push_back(curve.value[k]);
          csv += plot::line(runs[i].name, curve.channel, curve.series, curve.load[k], curve.value[k], curve.se[k]);
        }
      }
      for (const ReadingRecord& reading : runs[i].record->readings) {
        if (reading.channel == channel.id) values.push_back(reading.measured);
      }
    }
    const WrittenUnit unit = shown_unit(channel.unit, values);
    for (size_t i = 0; i < runs.size(); ++i) {
      for (const CurveRecord& curve : runs[i].record->curves) {
        if (curve.channel != channel.id) continue;
        plot::Band band;
        for (size_t k = 0; k < curve.load.size(); ++k) {
          if (!std::isfinite(curve.value[k])) continue;
          band.add(curve.load[k] / load_unit.factor, curve.value[k] / unit.factor, 0,
                   plot::half95(curve.se[k]) / unit.factor);
        }
        if (!band.middle.empty()) band.draw(page, plot::colour(i), plots);
      }
      const std::vector<ReadingRecord>& readings = runs[i].record->readings;
      for (size_t k = 0; k < readings.size(); ++k) {
        if (readings[k].channel == channel.id && !readings[k].excluded && k < runs[i].record->load_newtons.size())
          points[i].push_back({runs[i].record->load_newtons[k] / load_unit.factor, readings[k].measured / unit.factor});
      }
      page.add(plots, points[i], fmt::format("points pt {} ps 0.8", plot::symbol(i)), plot::colour(i));
    }
    for (double& value : values) value /= unit.factor;
    page.panel(grid.box(c), plot::axis_over(loads, bracketed(main.load_label, load_unit.label), 7, false),
               plot::axis_over(values, bracketed(channel.id, unit.label), 5, true), "", plots);
  }
  const std::string caption =
      "The curves that each run's fit predicts, with their 95 % bands, and the readings of each. Where bands part, the "
      "calibrations predict something else.";
  return plot::finished({{"compare_curves", title, caption}, csv, page}, folder);
}

Figure draw_compared_parameters(const std::vector<NamedRun>& runs, const std::string& folder) {
  std::vector<double> days;
  for (const NamedRun& run : runs) days.push_back(days_of(run.record->provenance.started));
  const auto [first, last] = std::ranges::minmax(days);
  const bool over_days = last - first > 1;  // not with NaN
  std::vector<const ParameterEstimate*> shown;
  for (const ParameterEstimate& e : runs.front().record->fit.parameters) {
    if (std::ranges::all_of(runs, [&](const NamedRun& run) { return estimate_in(*run.record, e.spec.id) != nullptr; }))
      shown.push_back(&e);
  }
  std::vector<LegendEntry> legend{{LegendEntry::heading, "run"}};
  for (size_t i = 0; i < runs.size(); ++i)
    legend.push_back({LegendEntry::text, fmt::format("{}: {}", i + 1, plot::shortened(runs[i].name, 32))});
  legend.push_back({LegendEntry::bar_along_y, "95 %, in all"});
  plot::Grid grid({.left = 84, .above = 34}, legend);
  grid.panels(std::max<size_t>(1, shown.size()), 170);
  const std::string title =
      over_days ? "Drift: fitted parameters over the days of their fits" : "Fitted parameters of several runs";
  plot::Page page = grid.page(title, runs.front().record->title, any_simulated(runs));
  std::string csv = "parameter,unit,run,fitted_at,value,lower95,upper95\n";
  for (size_t p = 0; p < shown.size(); ++p) {
    const ParameterSpec& spec = shown[p]->spec;
    const DisplayUnit unit = display_unit(shown[p]->value, spec.unit);
    Rows rows;
    std::vector<double> places, values;
    std::vector<std::pair<std::string, double>> names;
    for (size_t i = 0; i < runs.size(); ++i) {
      const ParameterEstimate& e = *estimate_in(*runs[i].record, spec.id);
      const bool total = e.total_lower95 && e.total_upper95;
      const auto lower = total ? e.total_lower95 : e.lower95, upper = total ? e.total_upper95 : e.upper95;
      const double x = over_days ? days[i] - first : static_cast<double>(i + 1);
      const double value = e.value / unit.factor, low = lower.value_or(e.value) / unit.factor,
                   high = upper.value_or(e.value) / unit.factor;
      rows.push_back({x, value, low, high});
      places.push_back(x);
      names.emplace_back(std::to_string(i + 1), x);
      values.insert(values.end(), {value, low, high});
      csv += plot::line(spec.id, spec.unit, runs[i].name, runs[i].record->provenance.started, e.value,
                        lower.value_or(std::nan("")), upper.value_or(std::nan("")));
    }
    plot::Plots plots;
    page.add(plots, rows, "yerrorbars pt 7 ps 1 lw 2", plot::colour(0), "1:2:3:4");
    plot::Axis x = plot::axis_over(places, "", 6, false);
    std::string extra;
    if (!over_days) {
      x = {"", 0.5, static_cast<double>(runs.size()) + 0.5, 1};
      extra = plot::named_tics('x', names);
    }
    if (p + 1 == shown.size()) x.label = over_days ? "days since the first fit" : "run";
    page.panel(grid.box(p), x, plot::axis_over(values, bracketed(spec.id, unit.name), 4, false), "", plots, extra);
  }
  const std::string caption =
      "The fitted value of each parameter in each run, with its 95 % interval in all (noise and what was assumed). "
      "What "
      "all runs assumed alike moves them alike: a difference may be real though the bars overlap.";
  return plot::finished({{"compare_parameters", title, caption}, csv, page}, folder);
}

}  // namespace taut

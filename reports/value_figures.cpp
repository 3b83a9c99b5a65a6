#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "reports/diagnostic.hpp"
#include "reports/estimate_text.hpp"
#include "reports/run_sections.hpp"
#include "sim/core/units.hpp"

// Figures of what several fits say of a parameter: a row for each value, with its name at the left.
namespace taut::plot {
namespace {

/// Values in the order of painting, and how each kind looks.
enum Kind { reference, variant, main_fit, part };
struct Look {
  const char *kind, *style, *columns;
  size_t colour;
};
constexpr std::array<Look, 4> kLooks = {{{"reference", "points pt 13 ps 1.3", "1:2", 1},
                                         {"variant", "xerrorbars pt 6 ps 1.1 lw 2", "1:2:3", 2},
                                         {"main", "xerrorbars pt 7 ps 1.2 lw 2", "1:2:3", 0},
                                         {"part", "xerrorbars pt 6 ps 1.1 lw 2", "1:2:3", 0}}};

struct Value {
  Kind kind;
  std::string name;
  double value, bar;  ///< SI; the bar goes to either side
};

/// A panel of the values of one parameter, and the interval of the whole fit behind them where it is to be shown.
struct Values {
  const ParameterEstimate* estimate;
  std::vector<Value> rows;
  std::optional<std::pair<double, double>> interval = {};
};

void draw_values(Page& page, const Box& box, const Values& panel) {
  const ParameterEstimate& estimate = *panel.estimate;
  const DisplayUnit unit = display_unit(estimate.value, estimate.spec.unit);
  const double count = static_cast<double>(panel.rows.size());
  std::array<Rows, kLooks.size()> points;  // x, row, bar
  std::vector<std::pair<std::string, double>> names;
  std::vector<double> shown;
  std::string extra;
  for (const Value& row : panel.rows) {
    const double y = count - static_cast<double>(names.size());
    names.emplace_back(row.name, y);
    const double value = row.value / unit.factor, bar = std::isfinite(row.bar) ? row.bar / unit.factor : 0;
    if (!std::isfinite(value)) continue;
    points[row.kind].push_back({value, y, bar});
    shown.insert(shown.end(), {value - bar, value + bar});
    if (row.kind == reference) extra += vertical_line(value, colour(1), kDashed);
  }
  extra += named_tics('y', names);
  if (panel.interval) {
    const double whole = estimate.value / unit.factor;
    const double lower = panel.interval->first / unit.factor, upper = panel.interval->second / unit.factor;
    shown.insert(shown.end(), {whole, lower, upper});
    if (std::isfinite(lower) && std::isfinite(upper))
      extra += shade(first(lower) + ", graph 0", first(upper) + ", graph 1", "transparent solid 0.14", kBlack);
    if (std::isfinite(whole)) extra += vertical_line(whole, kBlack);
  }
  Plots plots;
  for (size_t k = 0; k < kLooks.size(); ++k)
    page.add(plots, points[k], kLooks[k].style, colour(kLooks[k].colour), kLooks[k].columns);
  const std::string name = bracketed(estimate.spec.id, unit.name);
  std::erase_if(shown, [](double value) { return !std::isfinite(value); });
  const auto [low, high] = shown.empty() ? std::ranges::minmax({1.0}) : std::ranges::minmax(shown);
  page.panel(box, low > 0 && high / low > 20 ? logarithmic_axis_over(shown, name) : axis_over(shown, name, 6, false),
             {"", 0.4, count + 0.6, 1}, "", plots, extra);
}

Page page_of(const RunRecord& record, const std::string& title, const std::vector<LegendEntry>& legend,
             const std::vector<Values>& panels, double foot) {
  size_t longest = 0;
  std::vector<double> heights;
  for (const Values& panel : panels) {
    heights.push_back(30 * (static_cast<double>(panel.rows.size()) + 0.5));
    for (const Value& row : panel.rows) longest = std::max(longest, length_of(row.name));
  }
  const Room room{.left = 30 + 7.8 * static_cast<double>(longest), .above = 34, .foot = foot};
  const Grid grid = Grid(room, legend).rows(heights);
  Page page = grid.page(title, record.title, record.simulated);
  for (size_t p = 0; p < panels.size(); ++p) draw_values(page, grid.box(p), panels[p]);
  return page;
}

/// This fit, the variants and the references; a panel for each parameter that has something to compare with.
std::vector<Values> compared(const RunRecord& record) {
  std::vector<Values> panels;
  for (size_t p = 0; p < record.fit.parameters.size(); ++p) {
    const ParameterEstimate& estimate = record.fit.parameters[p];
    const std::string name = record.main.name.empty() ? "this fit" : record.main.name;
    Values panel{&estimate, {{main_fit, "▶ " + name, estimate.value, estimate.standard_error}}};
    for (const VariantRecord& v : record.variants) {
      const auto at = [&](const std::vector<double>& values) { return p < values.size() ? values[p] : std::nan(""); };
      const double value = at(v.values);
      const bool tied = std::ranges::any_of(
          v.further, [](const FurtherRecord& one) { return one.verdict == name_of(Verdict::tied); });
      panel.rows.push_back({variant,
                            v.name + (!std::isfinite(value) ? " (no result)"
                                      : tied                ? " (tied)"
                                                            : ""),
                            value, at(v.standard_errors)});
    }
    for (const ReferenceRecord& r : record.references) {
      if (r.parameter == estimate.spec.id) panel.rows.push_back({reference, r.source, r.value, 0});
    }
    for (Value& row : panel.rows) row.name = shortened(row.name, 50);
    if (panel.rows.size() > 1) panels.push_back(std::move(panel));
  }
  return panels;
}

}  // namespace

std::optional<Drawing> variants(const RunRecord& record) {
  if (over_strain(record)) return std::nullopt;
  const std::vector<Values> panels = compared(record);
  if (panels.empty()) return std::nullopt;
  const bool further = std::ranges::any_of(record.variants, [](const auto& one) { return one.other_model(); });
  const std::string other = further ? "other free parameters" : "other mesh";
  const std::string effect = further ? "Effect of further free parameters" : "Effect of the mesh";
  const bool meshes = !record.variants.empty(), references = !record.references.empty();
  std::vector<LegendEntry> legend = {{LegendEntry::point, "this fit", colour(0), 7}};
  if (meshes) legend.push_back({LegendEntry::point, other, colour(2), 6});
  legend.push_back({LegendEntry::bar_along_x, "± 1 standard error"});
  if (references) legend.push_back({LegendEntry::point, "reference value", colour(1), 13});
  const std::string title = !references ? effect
                            : !meshes   ? "This fit and reference values"
                                        : effect + ", and reference values";
  std::string csv = "parameter,unit,kind,name,value,standard_error\n";
  for (const auto& [estimate, rows, interval] : panels) {
    for (const Value& row : rows)
      csv += line(estimate->spec.id, estimate->spec.unit, kLooks[row.kind].kind, row.name, row.value, row.bar);
  }
  std::string caption;
  if (further) {
    caption =
        "The same fit with further free parameters (open circles) beside this one (filled circle). If the circles move "
        "by "
        "more than their bars, which parameters are free is part of the number and must be told with it.";
  } else if (meshes) {
    caption =
        "The same fit with other elements and meshes (open circles) beside this one (filled circle). If the circles "
        "move by more than their bars, the mesh is part of the number and must be told with it.";
  }
  if (references) caption += (caption.empty() ? "" : " ") + std::string("Dashed: reference values.");
  return Drawing{{"variants", title, caption}, csv, page_of(record, title, legend, panels, 20)};
}

std::optional<Drawing> diagnostic(const RunRecord& record) {
  const std::vector<DiagnosticGroup> groups = diagnostic_groups(record);
  if (groups.empty()) return std::nullopt;
  const std::vector<LegendEntry> legend = {{LegendEntry::point, "from these alone", colour(0), 6},
                                           {LegendEntry::bar_along_x, "95 % of its fit", colour(0)},
                                           {LegendEntry::line, "whole fit", kBlack},
                                           {LegendEntry::band, "its 95 % interval", kBlack}};
  std::string csv = "parameter,unit,part,readings,value,standard_error,lower95,upper95,chi_squared\n";
  std::vector<Values> panels;
  for (const auto& [whole, held, parts] : groups) {
    const auto add = [&](const std::string& name, int readings, double value, double se, double lower, double upper,
                         double chi_squared) {
      csv += line(whole->spec.id, whole->spec.unit, name, readings, value, se, lower, upper, chi_squared);
    };
    const double half = z95 * whole->standard_error;
    const double lower = whole->lower95.value_or(whole->value - half);
    const double upper = whole->upper95.value_or(whole->value + half);
    add("all", static_cast<int>(fitted_readings(record)), whole->value, whole->standard_error, lower, upper,
        record.fit.chi_squared);
    Values& panel = panels.emplace_back(Values{whole, {}, std::pair(lower, upper)});
    for (const DiagnosticRecord* p : parts) {
      const double bar = z95 * p->standard_error;
      add(p->part, p->readings, p->value, p->standard_error, p->value - bar, p->value + bar, p->chi_squared);
      panel.rows.push_back(
          {part, shortened(p->part, 40) + (std::isfinite(p->value) ? "" : " (failed)"), p->value, bar});
    }
  }
  const std::string title = "From each " + groups.front().held + " alone";
  const char* caption =
      "One parameter fitted to each part of the readings alone, everything else held at the whole fit, with 95 % bars. "
      "Bars that miss the grey band, and more so a drift from one part to the next, say that one law does not serve "
      "all "
      "readings.";
  return Drawing{{"diagnostic", title, caption}, csv, page_of(record, title, legend, panels, 0)};
}

}  // namespace taut::plot

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "calib/fit/distributions.hpp"
#include "reports/axes.hpp"
#include "reports/estimate_text.hpp"
#include "reports/html.hpp"
#include "reports/run_sections.hpp"
#include "sim/core/units.hpp"

// What many fits say beside the one: a section of the page and its figure.
namespace taut {
namespace {

using html::bare_number;
using html::Cells;
using html::paragraph;
using html::table;

/// What members of each kind are called, and what is read from them.
struct EnsembleWords {
  const char *heading, *members, *interval;
};

EnsembleWords words_of(const EnsembleRecord& ensemble) {
  if (ensemble.kind == name_of(EnsembleKind::posterior))
    return {"Beyond the parabola: posterior", "draws", "#posterior's"};
  if (ensemble.kind == name_of(EnsembleKind::bootstrap)) return {"Bootstrap", "fits", "#bootstrap's"};
  if (ensemble.kind == name_of(EnsembleKind::profiles)) return {"Along profiles", "fits", "#the profile's"};
  return {"From other starts", "fits", ""};
}

std::string counts_of(const EnsembleRecord& ensemble) {
  std::string text = fmt::format("{} {}", ensemble.finished, words_of(ensemble).members);
  if (ensemble.profiles.empty()) text += fmt::format(" (seed {})", ensemble.seed);
  if (ensemble.failed > 0) text += fmt::format(", {} of them without a result", ensemble.failed);
  if (ensemble.outside > 0) text += fmt::format(", {} where the prior is zero", ensemble.outside);
  if (ensemble.kind == name_of(EnsembleKind::posterior))
    text += fmt::format("; with their weights they say as much as {:.0f} equal ones", ensemble.effective);
  return text + fmt::format(". Each took {:.1f} replays.", ensemble.evaluations);
}

std::string marginals_table(const RunRecord& record, const EnsembleRecord& ensemble) {
  const bool profiles = !ensemble.profiles.empty();
  std::vector<Cells> rows;
  for (size_t j = 0; j < ensemble.parameters.size(); ++j) {
    const EnsembleMarginal& one = ensemble.parameters[j];
    ParameterEstimate shown_as = record.fit.parameters[j];
    const auto end = [](double value) { return std::isfinite(value) ? std::optional(value) : std::nullopt; };
    shown_as.lower95 = end(one.lower95);
    shown_as.upper95 = end(one.upper95);
    shown_as.total_lower95 = one.total_lower95;
    shown_as.total_upper95 = one.total_upper95;
    const Shown shown(shown_as);
    rows.push_back({one.id, shown.with_unit(one.median), shown.interval(shown_as),
                    one.total_lower95 ? shown.total(shown_as) : "",
                    !std::isfinite(one.width) ? "none"
                    : profiles                ? fmt::format("{:.2f}", one.width)
                                              : fmt::format("{:.2f} ± {:.2f}", one.width, one.width_error),
                    one.verdict});
  }
  return table({"Parameter", profiles ? "#Lowest at" : "#Median", "#95 % interval", "#With all shares",
                "#Width over the parabola's", "The parabola is"},
               rows);
}

std::string minima_table(const RunRecord& record, const EnsembleRecord& ensemble) {
  Cells header{"#Chi squared", "#Starts that ended there"};
  for (const ParameterEstimate& estimate : record.fit.parameters) header.push_back("#" + estimate.spec.id);
  std::vector<Cells> rows;
  for (const EnsembleMinimum& minimum : ensemble.minima) {
    if (rows.size() == 10) break;
    Cells& row = rows.emplace_back(Cells{bare_number(minimum.chi_squared), std::to_string(minimum.starts)});
    for (size_t j = 0; j < minimum.values.size(); ++j)
      row.push_back(with_unit(minimum.values[j], record.fit.parameters[j].spec.unit));
  }
  return table(header, rows);
}

}  // namespace

std::optional<Section> ensembles(const RunRecord& record) {
  Section section;
  for (const EnsembleRecord& ensemble : record.ensembles) {
    section.html += fmt::format("<h3>{}</h3>\n", words_of(ensemble).heading) + paragraph(ensemble.verdict) +
                    paragraph(counts_of(ensemble));
    if (!ensemble.parameters.empty()) section.html += marginals_table(record, ensemble);
    if (!ensemble.minima.empty()) section.html += minima_table(record, ensemble);
    section.html += paragraph(ensemble.how);
    for (const std::string& failure : ensemble.failures) section.html += paragraph("Without a result: " + failure);
    if (auto figure = plot::ensemble(record, ensemble)) section.figures.push_back(std::move(*figure));
  }
  return section.html.empty() ? std::nullopt : std::optional(std::move(section));
}

namespace plot {
namespace {

/// A parameter of an ensemble as a figure shows it.
struct ShownParameter {
  const ParameterEstimate* estimate;
  DisplayUnit unit;
  std::vector<double> values;  ///< of the members, in that unit
  bool logarithmic = false;    ///< the axis; where they spread over more than a factor of five
  Axis axis;

  double place(double value) const { return logarithmic ? std::log(value) : value; }
  double value(double place) const { return logarithmic ? std::exp(place) : place; }
};

ShownParameter shown_parameter(const RunRecord& record, const EnsembleRecord& ensemble, size_t j) {
  ShownParameter shown{&record.fit.parameters[j],
                       display_unit(record.fit.parameters[j].value, record.fit.parameters[j].spec.unit),
                       {},
                       false,
                       {}};
  for (const std::vector<double>& member : ensemble.drawn) shown.values.push_back(member[j] / shown.unit.factor);
  const auto [low, high] = std::ranges::minmax(shown.values);
  const std::string label = bracketed(shown.estimate->spec.id, shown.unit.name);
  shown.logarithmic = shown.estimate->spec.logarithmic && low > 0 && high > 5 * low;
  shown.axis =
      shown.logarithmic ? logarithmic_axis_over(shown.values, label) : axis_over(shown.values, label, 3, false);
  return shown;
}

/// Weight per bin, the largest 1, as boxes' centres, heights and widths.
Rows histogram(const ShownParameter& shown, const std::vector<double>& weights) {
  constexpr size_t bins = 24;
  const auto [low, high] = std::ranges::minmax(shown.values);
  const double from = shown.place(low), width = (shown.place(high) - from) / bins;
  std::vector<double> heights(bins, 0.0);
  for (size_t i = 0; i < weights.size(); ++i) {
    const double place = width > 0 ? (shown.place(shown.values[i]) - from) / width : 0;
    heights[std::min(static_cast<size_t>(place), bins - 1)] += weights[i];
  }
  const double most = std::ranges::max(heights);
  Rows rows{{shown.value(from), 0}};  // a line of steps
  for (size_t k = 0; k < bins; ++k) {
    rows.push_back({shown.value(from + static_cast<double>(k) * width), heights[k] / most});
    rows.push_back({shown.value(from + static_cast<double>(k + 1) * width), heights[k] / most});
  }
  rows.push_back({shown.value(from + bins * width), 0});
  return rows;
}

/// The density of the parabola on the fitted scale, its peak as high as a histogram's would be.
Rows parabola(const ShownParameter& shown) {
  const ParameterEstimate& e = *shown.estimate;
  const bool logarithm = e.spec.logarithmic;
  const double se = e.standard_error / (logarithm ? e.value : 1);
  if (!(se > 0) || !std::isfinite(se)) return {};
  Rows rows;
  for (double z = -4; z <= 4.001; z += 0.1) {
    const double value = (logarithm ? e.value * std::exp(z * se) : e.value + z * se) / shown.unit.factor;
    if (value >= shown.axis.low && value <= shown.axis.high)
      rows.push_back({value, normal_density(z) / normal_density(0)});
  }
  return rows;
}

/// Powers of ten alone along a logarithmic axis that holds two or more: panels are narrow.
std::string decades(char axis, const ShownParameter& shown) {
  if (!shown.logarithmic) return "";
  std::vector<std::pair<std::string, double>> tics;
  for (double k = std::ceil(std::log10(shown.axis.low)); k <= std::log10(shown.axis.high); ++k)
    tics.emplace_back(fmt::format("{:g}", std::pow(10, k)), std::pow(10, k));
  return tics.size() < 2 ? "" : named_tics(axis, tics);
}

Rows cloud(const ShownParameter& x, const ShownParameter& y, const std::vector<double>& weights) {
  Rows rows;
  for (size_t i = 0; i < weights.size(); ++i)
    rows.push_back({x.values[i], y.values[i], 0.2 + 0.5 * std::sqrt(weights[i])});
  return rows;
}

}  // namespace

std::optional<Drawing> ensemble(const RunRecord& record, const EnsembleRecord& ensemble) {
  constexpr size_t most_parameters = 5;
  const size_t n = std::min(record.fit.parameters.size(), most_parameters);
  if (ensemble.drawn.size() < 20 || n == 0) return std::nullopt;
  std::vector<ShownParameter> shown;
  for (size_t j = 0; j < n; ++j) shown.push_back(shown_parameter(record, ensemble, j));
  const std::vector<LegendEntry> legend{
      {LegendEntry::line, "all " + std::string(words_of(ensemble).members), colour(0)},
      {LegendEntry::point, "one of them, by weight", colour(0), 7},
      {LegendEntry::dashes, "the parabola's density", colour(1)},
      {LegendEntry::point, "fitted value", colour(1), 2}};
  const Grid grid =
      Grid({.gap = 62, .above = 26}, legend, n).panels(n * n, n == 1 ? 260.0 : 560.0 / static_cast<double>(n));
  const std::string title =
      ensemble.kind == name_of(EnsembleKind::posterior) ? "Posterior of the parameters" : "Bootstrap of the parameters";
  Page page = grid.page(title, record.title, record.simulated);
  for (size_t i = 0; i < n; ++i) {
    for (size_t j = 0; j <= i; ++j) {
      Axis x = shown[j].axis, y = i == j ? Axis{j == 0 ? "density over its peak" : "", 0, 1.12, 0.5} : shown[i].axis;
      Plots plots;
      if (i == j) {
        page.add(plots, histogram(shown[j], ensemble.weights), "lines lw 2", colour(0));
        page.add(plots, parabola(shown[j]), std::string("lines lw 2 ") + kDashed, colour(1));
      } else {
        page.add(plots, cloud(shown[j], shown[i], ensemble.weights), "points pt 7 ps variable", colour(0), "1:2:3");
        page.add(plots,
                 {{shown[j].estimate->value / shown[j].unit.factor, shown[i].estimate->value / shown[i].unit.factor}},
                 "points pt 2 ps 1.4 lw 3", colour(1));
      }
      const std::string tics = decades('x', shown[j]) + (i == j ? "" : decades('y', shown[i]));
      if (i + 1 < n) x.label.clear();
      if (j > 0) y.label.clear();
      page.panel(grid.box(i * n + j), x, y, i == j ? shown[j].estimate->spec.id : "", plots, tics);
    }
  }
  std::string csv = "number,weight";
  for (const ParameterEstimate& estimate : record.fit.parameters)
    csv += "," + estimate.spec.id + "_" + column_suffix(estimate.spec.unit);
  csv += "\n";
  for (size_t i = 0; i < ensemble.drawn.size(); ++i) {
    csv += fmt::format("{},{}", i, field(ensemble.weights[i]));
    for (double value : ensemble.drawn[i]) csv += "," + field(value);
    csv += "\n";
  }
  return Drawing{
      {"ensemble_" + ensemble.kind, title,
       "On the diagonal the distribution of each parameter, the dashed line the normal one that the fit's "
       "standard error stands for; below it every two parameters over one another: a narrow slanted cloud is "
       "a combination that the readings know better than either of them."},
      csv,
      page};
}

}  // namespace plot
}  // namespace taut

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "reports/run_sections.hpp"

namespace taut::plot {
namespace {

constexpr double kKilopascal = 1e3;
constexpr double kPerCent = 1e-2;

/// Stress of a curve at one of its strains; NaN where it has no point.
double at_strain(const CurveRecord& curve, double strain) {
  const auto found = std::ranges::find(curve.load, strain);
  return found == curve.load.end() ? std::nan("") : curve.value.at(static_cast<size_t>(found - curve.load.begin()));
}

/// What the two panels of a mode show.
struct Mode {
  std::vector<double> strains, stresses, scaled = {-2.6, 2.6};  ///< for the axes
  Plots curves, residuals;                                      ///< above and below
};

/// Its numbers go to `csv`.
Mode mode_of(Page& page, const RunRecord& record, const std::string& name, const std::vector<std::string>& series,
             std::string& csv) {
  Rows points, excluded;
  Mode mode;
  for (const ReadingRecord& r : record.readings) {
    if (r.channel != name) continue;
    const double stress = r.measured / kKilopascal, sigma = r.sigma / kKilopascal;
    (r.excluded ? excluded : points).push_back({r.controls.at(0) / kPerCent, stress, sigma});
    mode.strains.push_back(r.controls[0] / kPerCent);
    mode.stresses.insert(mode.stresses.end(), {stress - sigma, stress + sigma});
    csv += line(r.excluded ? "excluded" : "reading", r.channel, "", r.trial, r.line, r.controls[0], stress, sigma, "",
                "", (r.measured - r.predicted) / r.sigma);
  }
  for (const CurveRecord& curve : record.curves) {
    if (curve.channel != name) continue;
    const size_t s = static_cast<size_t>(std::ranges::find(series, curve.series) - series.begin());
    Band band;
    Rows misses;
    for (size_t i = 0; i < curve.load.size(); ++i) {
      const double strain = curve.load[i] / kPerCent, stress = curve.value.at(i) / kKilopascal;
      const double half = half95(curve.se.at(i)) / kKilopascal;
      band.add(strain, stress, 0, half);
      mode.strains.push_back(strain);
      mode.stresses.push_back(stress);
      csv += line("curve", curve.channel, curve.series, "", "", curve.load[i], stress, "", stress - half, stress + half,
                  "");
    }
    band.draw(page, colour(s), mode.curves);
    for (const ReadingRecord& r : record.readings) {
      if (r.channel != name || r.excluded) continue;
      const double miss = (r.measured - at_strain(curve, r.controls.at(0))) / r.sigma;
      if (!std::isfinite(miss)) continue;
      misses.push_back({r.controls[0] / kPerCent, miss});
      mode.scaled.push_back(miss);
    }
    std::ranges::sort(misses);
    page.add(mode.residuals, misses, fmt::format("linespoints pt {} ps 0.8 lw 1.2", symbol(s)), colour(s));
  }
  const std::string block = page.data(points);
  mode.curves.push_back(plotted(block, "yerrorbars pt 0 ps 0 lw 1.2", kBlack, "1:2:3"));
  mode.curves.push_back(plotted(block, fmt::format("points pt {} ps 1 lw 1.4", symbol(0)), kBlack));
  add_excluded(page, excluded, mode.curves);
  return mode;
}

}  // namespace

std::optional<Drawing> stress_strain(const RunRecord& record) {
  const auto is_stress = [](const AxisRecord& axis) { return is(axis, Quantity::pressure); };
  if (!over_strain(record) || record.readings.empty() || !std::ranges::all_of(record.channels, is_stress))
    return std::nullopt;
  std::vector<std::string> modes, series;
  for (const ReadingRecord& reading : record.readings) place_in(modes, reading.channel);
  for (const CurveRecord& curve : record.curves) place_in(series, curve.series);

  std::vector<LegendEntry> legend = {{LegendEntry::heading, "Readings"},
                                     {LegendEntry::point, "reading", kBlack, symbol(0)},
                                     {LegendEntry::bar_along_y, "± 1 σ of a reading"},
                                     {LegendEntry::heading, "Fitted"}};
  for (size_t s = 0; s < series.size(); ++s) legend.push_back({LegendEntry::line, shortened(series[s], 34), colour(s)});
  legend.push_back({LegendEntry::band, "95 % of the curves"});
  legend.push_back({LegendEntry::heading, "Below"});
  legend.push_back({LegendEntry::band, "95 % if all is right"});

  const Grid grid = Grid({.gap = 58}, legend, modes.size()).rows({300, 170});
  const std::string title = "Stress and strain";
  Page page = grid.page(title, record.title, record.simulated);
  std::string csv =
      "kind,mode,series,trial,line,strain,stress_kPa,sigma_kPa,band_lower_kPa,band_upper_kPa,normalised_residual\n";
  for (size_t m = 0; m < modes.size(); ++m) {
    const Mode mode = mode_of(page, record, modes[m], series, csv);
    const std::string strain = modes[m] == "shear" ? "amount of shear" : drawn_control(record).label;
    const Axis strains = axis_over(mode.strains, bracketed(strain, "%"), 4, true);
    const std::string stress = m == 0 ? bracketed(record.channels.front().label, "kPa") : "";
    page.panel(grid.box(m), strains, axis_over(mode.stresses, stress, 6, true), modes[m], mode.curves);
    page.panel(grid.box(modes.size() + m), strains,
               axis_over(mode.scaled, m == 0 ? "(measured − fitted) / σ" : "", 5, true), "", mode.residuals,
               expected_band() + zero_line());
  }
  const char* caption =
      "Above, every reading with one standard deviation to either side, and what the fitted laws say; each is drawn "
      "over the readings that it was fitted to. Below, what they miss, in standard deviations: points beyond the grey "
      "band, or a trend, say that the law lacks something there.";
  return Drawing{{"stress_strain", title, caption}, csv, page};
}

}  // namespace taut::plot

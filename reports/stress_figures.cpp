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
  std::vector<std::string> curves, residuals;                   ///< plots above and below
};

/// Its numbers go to `csv`.
Mode mode_of(Page& page, const RunRecord& record, const std::string& name, const std::vector<std::string>& series,
             std::string& csv) {
  const std::string none;
  std::vector<std::vector<double>> points;
  Mode mode;
  for (const ReadingRecord& r : record.readings) {
    if (r.channel != name) continue;
    const double stress = r.measured / kKilopascal, sigma = r.sigma / kKilopascal;
    points.push_back({r.controls.at(0) / kPerCent, stress, sigma});
    mode.strains.push_back(r.controls[0] / kPerCent);
    mode.stresses.insert(mode.stresses.end(), {stress - sigma, stress + sigma});
    csv += line("reading", r.channel, none, r.controls[0], stress, sigma, none, none,
                (r.measured - r.predicted) / r.sigma);
  }
  for (const CurveRecord& curve : record.curves) {
    if (curve.channel != name) continue;
    const size_t s = static_cast<size_t>(std::ranges::find(series, curve.series) - series.begin());
    std::vector<std::vector<double>> middle, band, back, misses;
    for (size_t i = 0; i < curve.load.size(); ++i) {
      const double strain = curve.load[i] / kPerCent, stress = curve.value.at(i) / kKilopascal;
      const double half = std::isfinite(curve.se.at(i)) ? k95 * curve.se[i] / kKilopascal : 0;
      middle.push_back({strain, stress});
      band.push_back({strain, stress - half});
      back.push_back({strain, stress + half});
      mode.strains.push_back(strain);
      mode.stresses.push_back(stress);
      csv +=
          line("curve", curve.channel, curve.series, curve.load[i], stress, none, stress - half, stress + half, none);
    }
    band.insert(band.end(), back.rbegin(), back.rend());
    mode.curves.push_back(fmt::format("{} using 1:2 with filledcurves closed fc rgb '{}'", page.data(band), colour(s)));
    mode.curves.push_back(fmt::format("{} using 1:2 with lines lw 2 lc rgb '{}'", page.data(middle), colour(s)));
    for (const ReadingRecord& r : record.readings) {
      if (r.channel != name) continue;
      const double miss = (r.measured - at_strain(curve, r.controls.at(0))) / r.sigma;
      if (!std::isfinite(miss)) continue;
      misses.push_back({r.controls[0] / kPerCent, miss});
      mode.scaled.push_back(miss);
    }
    if (misses.empty()) continue;
    std::ranges::sort(misses);
    mode.residuals.push_back(fmt::format("{} using 1:2 with linespoints pt {} ps 0.8 lw 1.2 lc rgb '{}'",
                                         page.data(misses), symbol(s), colour(s)));
  }
  const std::string block = page.data(points);
  mode.curves.push_back(fmt::format("{} using 1:2:3 with yerrorbars pt 0 ps 0 lw 1.2 lc rgb '{}'", block, kBlack));
  mode.curves.push_back(
      fmt::format("{} using 1:2 with points pt {} ps 1 lw 1.4 lc rgb '{}'", block, symbol(0), kBlack));
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

  constexpr double left = 76, gap = 58, below = 58, above = 30, upper_height = 300, lower_height = 170;
  const double legend_left = kPageWidth - legend_width(legend) - 8;
  const double height = kTitle + upper_height + lower_height + 2 * (below + above);
  const double across =
      (legend_left - 24 - left - gap * static_cast<double>(modes.size() - 1)) / static_cast<double>(modes.size());
  Page page(kPageWidth, height, "Stress and strain", record.title, record.simulated);
  page.legend(legend_left, height - kTitle - above - 6, legend);

  std::string csv = "kind,mode,series,strain,stress_kPa,sigma_kPa,band_lower_kPa,band_upper_kPa,normalised_residual\n";
  for (size_t m = 0; m < modes.size(); ++m) {
    const Mode mode = mode_of(page, record, modes[m], series, csv);
    const double x = left + static_cast<double>(m) * (across + gap), top = height - kTitle - above;
    const Box upper{x, top - upper_height, x + across, top};
    const double lower_top = upper.bottom - below - above;
    const Box lower{x, lower_top - lower_height, x + across, lower_top};
    const Axis strain_axis = axis_over(
        mode.strains, bracketed(modes[m] == "shear" ? "amount of shear" : drawn_control(record).label, "%"), 4, true);
    page.panel(upper, strain_axis,
               axis_over(mode.stresses, m == 0 ? bracketed(record.channels.front().label, "kPa") : "", 6, true),
               modes[m], mode.curves);
    page.panel(lower, strain_axis, axis_over(mode.scaled, m == 0 ? "(measured − fitted) / σ" : "", 5, true), "",
               mode.residuals, expected_band() + zero_line());
  }
  return Drawing{{"stress_strain", "Stress and strain",
                  "Above, every reading with one standard deviation to either side, and what the fitted laws say; each "
                  "is drawn over the readings that it was fitted to. Below, what they miss, in standard deviations: "
                  "points beyond the grey band, or a trend, say that the law lacks something there.",
                  ""},
                 csv,
                 page};
}

}  // namespace taut::plot

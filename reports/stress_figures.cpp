#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "reports/figures.hpp"

namespace taut::plot {
namespace {

constexpr double k95 = 1.959963984540054;  // 97.5 % quantile of the normal distribution
constexpr double kKilopascal = 1e3;
constexpr double kPerCent = 1e-2;

void add_once(std::vector<std::string>& list, const std::string& item) {
  if (std::ranges::find(list, item) == list.end()) list.push_back(item);
}

/// Stress of a curve at one of its strains; NaN where it has no point.
double at_strain(const CurveRecord& curve, double strain) {
  const auto found = std::ranges::find(curve.load, strain);
  return found == curve.load.end() ? std::nan("") : curve.value.at(static_cast<size_t>(found - curve.load.begin()));
}

}  // namespace

std::optional<Drawing> stress_strain(const RunRecord& record) {
  if (!record.material_point || record.readings.empty()) return std::nullopt;
  std::vector<std::string> modes, series;
  for (const ReadingRecord& reading : record.readings) add_once(modes, reading.channel);
  for (const CurveRecord& curve : record.curves) add_once(series, curve.series);

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
  const std::string none;
  for (size_t m = 0; m < modes.size(); ++m) {
    std::vector<std::vector<double>> points;
    std::vector<double> strains, stresses, scaled = {-2.6, 2.6};
    std::vector<std::string> curves, residuals;
    for (const ReadingRecord& r : record.readings) {
      if (r.channel != modes[m]) continue;
      const double stress = r.measured / kKilopascal, sigma = r.sigma / kKilopascal;
      points.push_back({r.controls.at(0) / kPerCent, stress, sigma});
      strains.push_back(r.controls[0] / kPerCent);
      stresses.insert(stresses.end(), {stress - sigma, stress + sigma});
      csv += line("reading", r.channel, none, r.controls[0], stress, sigma, none, none,
                  (r.measured - r.predicted) / r.sigma);
    }
    for (const CurveRecord& curve : record.curves) {
      if (curve.channel != modes[m]) continue;
      const size_t s = static_cast<size_t>(std::ranges::find(series, curve.series) - series.begin());
      std::vector<std::vector<double>> middle, band, back, misses;
      for (size_t i = 0; i < curve.load.size(); ++i) {
        const double strain = curve.load[i] / kPerCent, stress = curve.value.at(i) / kKilopascal;
        const double half = std::isfinite(curve.se.at(i)) ? k95 * curve.se[i] / kKilopascal : 0;
        middle.push_back({strain, stress});
        band.push_back({strain, stress - half});
        back.push_back({strain, stress + half});
        strains.push_back(strain);
        stresses.push_back(stress);
        csv +=
            line("curve", curve.channel, curve.series, curve.load[i], stress, none, stress - half, stress + half, none);
      }
      band.insert(band.end(), back.rbegin(), back.rend());
      curves.push_back(fmt::format("{} using 1:2 with filledcurves closed fc rgb '{}'", page.data(band), colour(s)));
      curves.push_back(fmt::format("{} using 1:2 with lines lw 2 lc rgb '{}'", page.data(middle), colour(s)));
      for (const ReadingRecord& r : record.readings) {
        if (r.channel != modes[m]) continue;
        const double miss = (r.measured - at_strain(curve, r.controls.at(0))) / r.sigma;
        if (!std::isfinite(miss)) continue;
        misses.push_back({r.controls[0] / kPerCent, miss});
        scaled.push_back(miss);
      }
      if (misses.empty()) continue;
      std::ranges::sort(misses);
      residuals.push_back(fmt::format("{} using 1:2 with linespoints pt {} ps 0.8 lw 1.2 lc rgb '{}'",
                                      page.data(misses), symbol(s), colour(s)));
    }
    const std::string block = page.data(points);
    curves.push_back(fmt::format("{} using 1:2:3 with yerrorbars pt 0 ps 0 lw 1.2 lc rgb '{}'", block, kBlack));
    curves.push_back(fmt::format("{} using 1:2 with points pt {} ps 1 lw 1.4 lc rgb '{}'", block, symbol(0), kBlack));

    const double x = left + static_cast<double>(m) * (across + gap), top = height - kTitle - above;
    const Box upper{x, top - upper_height, x + across, top};
    const double lower_top = upper.bottom - below - above;
    const Box lower{x, lower_top - lower_height, x + across, lower_top};
    const Axis strain_axis =
        axis_over(strains, modes[m] == "shear" ? "amount of shear [%]" : "engineering strain [%]", 4, true);
    page.panel(upper, strain_axis, axis_over(stresses, m == 0 ? "nominal stress [kPa]" : "", 6, true), modes[m],
               curves);
    page.panel(lower, strain_axis, axis_over(scaled, m == 0 ? "(measured − fitted) / σ" : "", 5, true), "", residuals,
               fmt::format("set object rectangle from graph 0, first -2 to graph 1, first 2 behind fs transparent "
                           "solid 0.18 noborder fc rgb '{}'\n"
                           "set arrow from graph 0, first 0 to graph 1, first 0 nohead lw 1.5 lc rgb '{}'\n",
                           kGrey, kBlack));
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

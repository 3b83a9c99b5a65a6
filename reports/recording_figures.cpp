#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "reports/figures.hpp"

namespace taut::plot {
namespace {

void add_once(std::vector<std::string>& list, const std::string& text) {
  if (std::ranges::find(list, text) == list.end()) list.push_back(text);
}

}  // namespace

std::optional<Drawing> recordings(const RunRecord& record) {
  if (!record.over_time || record.readings.empty()) return std::nullopt;
  std::vector<std::string> names, channels;
  for (size_t i = 0; i < record.readings.size(); ++i) {
    add_once(names, record.series.at(i));
    add_once(channels, record.readings[i].channel);
  }
  std::vector<LegendEntry> legend = {{LegendEntry::heading, "Measured, simulated"}};
  for (size_t c = 0; c < channels.size(); ++c) {
    legend.push_back({LegendEntry::point, shortened(channels[c], 20), colour(c), symbol(c)});
    legend.push_back({LegendEntry::line, shortened(channels[c], 20), colour(c)});
  }
  legend.push_back({LegendEntry::heading, "Below"});
  legend.push_back({LegendEntry::text, "measured − simulated"});
  legend.push_back({LegendEntry::band, "± 1 σ of a reading"});

  constexpr double left = 70, gap = 62, below = 34, above = 30, tall = 170, low = 78, between = 14;
  const size_t columns = std::min<size_t>(2, names.size()), rows = (names.size() + columns - 1) / columns;
  const double legend_left = kPageWidth - legend_width(legend, 180) - 8;
  const double across =
      (legend_left - 20 - left - gap * static_cast<double>(columns - 1)) / static_cast<double>(columns);
  const double height = kTitle + static_cast<double>(rows) * (above + tall + between + low + below) + 22;
  Page page(kPageWidth, height, "Recordings", record.title, record.simulated);
  page.legend(legend_left, height - kTitle - above - 6, legend);

  // One scale of time, and one of residuals, for all.
  std::vector<double> times, misses;
  for (const ReadingRecord& r : record.readings) {
    times.push_back(r.controls.at(0));
    for (double miss : {(r.measured - r.predicted) / kMillimetre, r.sigma / kMillimetre, -r.sigma / kMillimetre})
      misses.push_back(miss);
  }
  std::string csv = "kind,recording,channel,time_s,displacement_mm,sigma_mm,residual_mm\n";
  const std::string none;
  for (size_t n = 0; n < names.size(); ++n) {
    const size_t row = n / columns, column = n % columns;
    std::vector<std::string> upper_plots, lower_plots;
    std::vector<double> values;
    double sigma = 0;
    for (const CurveRecord& curve : record.curves) {
      if (curve.series != names[n]) continue;
      const size_t c = static_cast<size_t>(std::ranges::find(channels, curve.channel) - channels.begin());
      std::vector<std::vector<double>> points;
      for (size_t i = 0; i < curve.load.size(); ++i) {
        points.push_back({curve.load[i], curve.value[i] / kMillimetre});
        values.push_back(points.back()[1]);
        csv += line("curve", names[n], curve.channel, curve.load[i], curve.value[i] / kMillimetre, none, none);
      }
      upper_plots.push_back(fmt::format("{} using 1:2 with lines lw 1.6 lc rgb '{}'", page.data(points), colour(c)));
    }
    for (size_t c = 0; c < channels.size(); ++c) {
      std::vector<std::vector<double>> points;
      for (size_t i = 0; i < record.readings.size(); ++i) {
        const ReadingRecord& r = record.readings[i];
        if (record.series[i] != names[n] || r.channel != channels[c]) continue;
        const double residual = (r.measured - r.predicted) / kMillimetre;
        points.push_back({r.controls[0], r.measured / kMillimetre, residual});
        values.push_back(points.back()[1]);
        sigma = std::max(sigma, r.sigma / kMillimetre);
        csv += line("reading", names[n], r.channel, r.controls[0], r.measured / kMillimetre, r.sigma / kMillimetre,
                    residual);
      }
      const std::string block = page.data(points);
      upper_plots.push_back(
          fmt::format("{} using 1:2 with points pt {} ps 0.7 lw 1.2 lc rgb '{}'", block, symbol(c), colour(c)));
      lower_plots.push_back(
          fmt::format("{} using 1:3 with linespoints pt {} ps 0.5 lw 1 lc rgb '{}'", block, symbol(c), colour(c)));
    }
    const double x = left + static_cast<double>(column) * (across + gap);
    const double top = height - kTitle - above - static_cast<double>(row) * (above + tall + between + low + below);
    const Box upper{x, top - tall, x + across, top};
    const Box lower{x, upper.bottom - between - low, x + across, upper.bottom - between};
    const bool last = n + columns >= names.size();
    const std::string y_label = column == 0 ? "displacement [mm]" : "";
    page.panel(upper, axis_over(times, "", 5, false), axis_over(values, y_label, 5, false), names[n], upper_plots,
               "set format x ''\n");
    page.panel(
        lower, axis_over(times, last ? "time [s]" : "", 5, false),
        axis_over(misses, column == 0 ? "[mm]" : "", 3, false), "", lower_plots,
        fmt::format("set format x '%g'\nset object rectangle from graph 0, first {:.6g} to graph 1, first {:.6g} "
                    "behind fs transparent solid 0.18 noborder fc rgb '{}'\n",
                    -sigma, sigma, kGrey));
  }
  return Drawing{
      {"recordings", "Recordings",
       "Above, each recording as measured (points) and as simulated (line) from its release on; below, the "
       "difference. Residuals that stay on one side, or swing with the motion, are no noise: the model's rest "
       "position, frequency or decay is off there.",
       ""},
      csv,
      page};
}

std::optional<Drawing> swings(const RunRecord& record) {
  if (record.swings.empty()) return std::nullopt;
  const std::vector<LegendEntry> legend = {{LegendEntry::point, "measured", kBlack, symbol(0)},
                                           {LegendEntry::point, "simulated", colour(0), 7}};
  constexpr double left = 76, gap = 76, below = 96, above = 30, tall = 220;
  const double legend_left = kPageWidth - legend_width(legend) - 8;
  const double across = (legend_left - 24 - left - gap) / 2, height = kTitle + above + tall + below;
  Page page(kPageWidth, height, "Frequency and decay", record.title, record.simulated);
  page.legend(legend_left, height - kTitle - above - 6, legend);
  std::vector<std::vector<double>> rows;
  std::vector<double> frequencies, decays;
  std::string csv = "recording,channel,frequency_Hz,simulated_frequency_Hz,decay_per_s,simulated_decay_per_s\n", tics;
  for (size_t i = 0; i < record.swings.size(); ++i) {
    const SwingRecord& s = record.swings[i];
    rows.push_back({static_cast<double>(i + 1), s.frequency, s.predicted_frequency, s.decay, s.predicted_decay});
    frequencies.insert(frequencies.end(), {s.frequency, s.predicted_frequency});
    decays.insert(decays.end(), {s.decay, s.predicted_decay});
    tics += fmt::format("{}{} {}", i == 0 ? "" : ", ", literal(shortened(s.recording, 16)), i + 1);
    csv += line(s.recording, s.channel, s.frequency, s.predicted_frequency, s.decay, s.predicted_decay);
  }
  const std::string block = page.data(rows);
  const Axis x{"", 0.5, static_cast<double>(record.swings.size()) + 0.5, 1};
  for (size_t k = 0; k < 2; ++k) {
    const double from = left + static_cast<double>(k) * (across + gap);
    const Axis y = axis_over(k == 0 ? frequencies : decays, k == 0 ? "frequency [Hz]" : "decay [1/s]", 5, true);
    std::vector<std::string> plots;
    for (size_t simulated : {0u, 1u}) {
      plots.push_back(fmt::format("{} using 1:{} with points pt {} ps {} lw 1.4 lc rgb '{}'", block,
                                  2 + 2 * k + simulated, simulated == 0 ? symbol(0) : 7, simulated == 0 ? 1.4 : 0.7,
                                  simulated == 0 ? kBlack : colour(0)));
    }
    page.panel({from, height - kTitle - above - tall, from + across, height - kTitle - above}, x, y, "", plots,
               fmt::format("set xtics rotate by 40 right ({})\n", tics));
  }
  return Drawing{
      {"swings", "Frequency and decay",
       "Of each recording, measured and simulated, by the same fit of a decaying oscillation. Repeats of one "
       "case show how well either is known.",
       ""},
      csv,
      page};
}

}  // namespace taut::plot

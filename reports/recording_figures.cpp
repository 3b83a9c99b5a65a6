#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "reports/run_sections.hpp"

namespace taut::plot {
namespace {

/// What a pair of panels shows: the channels of one unit in one recording. Above the motion, below what the model
/// misses.
struct Motion {
  std::vector<std::string> above, below;  ///< plots
  std::vector<double> values;             ///< shown above
  double sigma = 0;                       ///< the largest
};

std::vector<LegendEntry> recordings_legend(const std::vector<std::string>& channels) {
  std::vector<LegendEntry> legend = {{LegendEntry::heading, "Measured, simulated"}};
  for (size_t c = 0; c < channels.size(); ++c) {
    legend.push_back({LegendEntry::point, shortened(channels[c], 20), colour(c), symbol(c)});
    legend.push_back({LegendEntry::line, shortened(channels[c], 20), colour(c)});
  }
  legend.push_back({LegendEntry::heading, "Below"});
  legend.push_back({LegendEntry::text, "measured − simulated"});
  legend.push_back({LegendEntry::band, "± 1 σ of a reading"});
  return legend;
}

/// Of the channels that have `unit`; their numbers go to `csv`.
Motion motion_of(Page& page, const RunRecord& record, const ReadingUnits& units, const std::string& name,
                 const std::vector<std::string>& channels, const WrittenUnit& unit, std::string& csv) {
  const std::string none;
  Motion motion;
  for (const CurveRecord& curve : record.curves) {
    if (curve.series != name || units.of(curve.channel) != unit) continue;
    std::vector<std::vector<double>> points;
    for (size_t i = 0; i < curve.load.size(); ++i) {
      const double value = curve.value[i] / unit.factor;
      points.push_back({curve.load[i], value});
      motion.values.push_back(value);
      csv += units.row(line("curve", name, curve.channel, curve.load[i], value, none, none), curve.channel);
    }
    const size_t c = static_cast<size_t>(std::ranges::find(channels, curve.channel) - channels.begin());
    motion.above.push_back(fmt::format("{} using 1:2 with lines lw 1.6 lc rgb '{}'", page.data(points), colour(c)));
  }
  for (size_t c = 0; c < channels.size(); ++c) {
    if (units.of(channels[c]) != unit) continue;
    std::vector<std::vector<double>> points;
    for (size_t i = 0; i < record.readings.size(); ++i) {
      const ReadingRecord& r = record.readings[i];
      if (record.series[i] != name || r.channel != channels[c]) continue;
      const double value = r.measured / unit.factor, sigma = r.sigma / unit.factor;
      const double residual = (r.measured - r.predicted) / unit.factor;
      points.push_back({r.controls[0], value, residual});
      motion.values.push_back(value);
      motion.sigma = std::max(motion.sigma, sigma);
      csv += units.row(line("reading", name, r.channel, r.controls[0], value, sigma, residual), r.channel);
    }
    const std::string block = page.data(points);
    motion.above.push_back(
        fmt::format("{} using 1:2 with points pt {} ps 0.7 lw 1.2 lc rgb '{}'", block, symbol(c), colour(c)));
    motion.below.push_back(
        fmt::format("{} using 1:3 with linespoints pt {} ps 0.5 lw 1 lc rgb '{}'", block, symbol(c), colour(c)));
  }
  return motion;
}

/// What the model misses in the readings of this unit, and their sigmas to either side: one scale for all recordings.
std::vector<double> misses_of(const RunRecord& record, const ReadingUnits& units, const WrittenUnit& unit) {
  std::vector<double> misses;
  for (const ReadingRecord& r : record.readings) {
    if (units.of(r.channel) != unit) continue;
    for (double miss : {r.measured - r.predicted, r.sigma, -r.sigma}) misses.push_back(miss / unit.factor);
  }
  return misses;
}

}  // namespace

std::optional<Drawing> recordings(const RunRecord& record) {
  if (!over_time(record) || record.readings.empty()) return std::nullopt;
  const ReadingUnits units(record);
  std::vector<std::string> names, channels;
  std::vector<double> times;
  std::vector<WrittenUnit> kinds;  // of channels: each has its own panels
  std::vector<std::string> labels;
  for (size_t i = 0; i < record.readings.size(); ++i) {
    const ReadingRecord& reading = record.readings[i];
    place_in(names, record.series.at(i));
    place_in(channels, reading.channel);
    times.push_back(reading.controls.at(0));
    if (std::ranges::find(kinds, units.of(reading.channel)) != kinds.end()) continue;
    kinds.push_back(units.of(reading.channel));
    labels.push_back(channel_axis(record, reading.channel).label);
  }
  const size_t panels = names.size() * kinds.size();
  const std::vector<LegendEntry> legend = recordings_legend(channels);
  constexpr double left = 70, gap = 62, below = 34, above = 30, tall = 170, low = 78, between = 14;
  constexpr double each = above + tall + between + low + below;
  const size_t columns = std::min<size_t>(2, panels), rows = (panels + columns - 1) / columns;
  const double legend_left = kPageWidth - legend_width(legend, 180) - 8;
  const double across =
      (legend_left - 20 - left - gap * static_cast<double>(columns - 1)) / static_cast<double>(columns);
  const double height = kTitle + static_cast<double>(rows) * each + 22;
  Page page(kPageWidth, height, "Recordings", record.title, record.simulated);
  page.legend(legend_left, height - kTitle - above - 6, legend);

  std::string csv = units.heads(fmt::format("kind,recording,channel,time_s,{},{},{}\n", units.column(units.what()),
                                            units.column("sigma"), units.column("residual")));
  for (size_t n = 0; n < panels; ++n) {
    const std::string& name = names[n / kinds.size()];
    const size_t kind = n % kinds.size();
    const WrittenUnit& unit = kinds[kind];
    const Motion motion = motion_of(page, record, units, name, channels, unit, csv);
    const bool first = n % columns == 0 || kinds.size() > 1, last = n + columns >= panels;
    const double x = left + static_cast<double>(n % columns) * (across + gap);
    const double top = height - kTitle - above - static_cast<double>(n / columns) * each;
    const Box upper{x, top - tall, x + across, top};
    const Box lower{x, upper.bottom - between - low, x + across, upper.bottom - between};
    page.panel(upper, axis_over(times, "", 5, false),
               axis_over(motion.values, first ? bracketed(labels[kind], unit.label) : "", 5, false), name, motion.above,
               "set format x ''\n");
    page.panel(
        lower, axis_over(times, last ? "time [s]" : "", 5, false),
        axis_over(misses_of(record, units, unit), first ? bracketed("", unit.label) : "", 3, false), "", motion.below,
        fmt::format("set format x '%g'\nset object rectangle from graph 0, first {:.6g} to graph 1, first {:.6g} "
                    "behind fs transparent solid 0.18 noborder fc rgb '{}'\n",
                    -motion.sigma, motion.sigma, kGrey));
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

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "reports/run_sections.hpp"

namespace taut::plot {
namespace {

/// What a pair of panels shows: the channels of one unit in one recording. Above the motion, below what the model
/// misses.
struct Motion {
  Plots above, below;
  std::vector<double> values;  ///< shown above
  double sigma = 0;            ///< the largest
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
  Motion motion;
  for (const CurveRecord& curve : record.curves) {
    if (curve.series != name || units.of(curve.channel) != unit) continue;
    Rows points;
    for (size_t i = 0; i < curve.load.size(); ++i) {
      const double value = curve.value[i] / unit.factor;
      points.push_back({curve.load[i], value});
      motion.values.push_back(value);
      csv += units.row(line("curve", name, curve.channel, curve.load[i], value, "", ""), curve.channel);
    }
    const size_t c = static_cast<size_t>(std::ranges::find(channels, curve.channel) - channels.begin());
    page.add(motion.above, points, "lines lw 1.6", colour(c));
  }
  for (size_t c = 0; c < channels.size(); ++c) {
    if (units.of(channels[c]) != unit) continue;
    Rows points;
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
    motion.above.push_back(plotted(block, fmt::format("points pt {} ps 0.7 lw 1.2", symbol(c)), colour(c)));
    motion.below.push_back(plotted(block, fmt::format("linespoints pt {} ps 0.5 lw 1", symbol(c)), colour(c), "1:3"));
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
  constexpr double tall = 170, between = 14, low = 78;
  const size_t columns = std::min<size_t>(2, panels);
  const Grid grid = Grid({.left = 70, .gap = 62, .below = 34, .foot = 22, .right = 20, .legend = 180}, legend, columns)
                        .panels(panels, tall + between + low);
  const std::string title = "Recordings";
  Page page = grid.page(title, record.title, record.simulated);

  std::string csv = units.heads(fmt::format("kind,recording,channel,time_s,{},{},{}\n", units.column(units.what()),
                                            units.column("sigma"), units.column("residual")));
  for (size_t n = 0; n < panels; ++n) {
    const std::string& name = names[n / kinds.size()];
    const size_t kind = n % kinds.size();
    const WrittenUnit& unit = kinds[kind];
    const Motion motion = motion_of(page, record, units, name, channels, unit, csv);
    const bool first = grid.leftmost(n) || kinds.size() > 1, last = n + columns >= panels;
    Box upper = grid.box(n), lower = upper;
    upper.bottom = upper.top - tall;
    lower.top = lower.bottom + low;
    page.panel(upper, axis_over(times, "", 5, false),
               axis_over(motion.values, first ? bracketed(labels[kind], unit.label) : "", 5, false), name, motion.above,
               "set format x ''\n");
    page.panel(lower, axis_over(times, last ? "time [s]" : "", 5, false),
               axis_over(misses_of(record, units, unit), first ? bracketed("", unit.label) : "", 3, false), "",
               motion.below,
               "set format x '%g'\n" + shade("graph 0, " + plot::first(-motion.sigma),
                                             "graph 1, " + plot::first(motion.sigma), "transparent solid 0.18", kGrey));
  }
  const char* caption =
      "Above, each recording as measured (points) and as simulated (line) from its release on; below, the difference. "
      "Residuals that stay on one side, or swing with the motion, are no noise: the model's rest position, frequency "
      "or decay is off there.";
  return Drawing{{"recordings", title, caption}, csv, page};
}

std::optional<Drawing> swings(const RunRecord& record) {
  if (record.swings.empty()) return std::nullopt;
  const std::vector<LegendEntry> legend = {{LegendEntry::point, "measured", kBlack, symbol(0)},
                                           {LegendEntry::point, "simulated", colour(0), 7}};
  const Grid grid = Grid({.gap = 76, .below = 96}, legend, 2).rows({220});
  const std::string title = "Frequency and decay";
  Page page = grid.page(title, record.title, record.simulated);
  Rows rows;
  std::vector<double> frequencies, decays;
  std::vector<std::pair<std::string, double>> names;
  std::string csv = "recording,channel,frequency_Hz,simulated_frequency_Hz,decay_per_s,simulated_decay_per_s\n";
  for (const SwingRecord& s : record.swings) {
    const double place = static_cast<double>(rows.size() + 1);
    rows.push_back({place, s.frequency, s.predicted_frequency, s.decay, s.predicted_decay});
    frequencies.insert(frequencies.end(), {s.frequency, s.predicted_frequency});
    decays.insert(decays.end(), {s.decay, s.predicted_decay});
    names.emplace_back(shortened(s.recording, 16), place);
    csv += line(s.recording, s.channel, s.frequency, s.predicted_frequency, s.decay, s.predicted_decay);
  }
  const std::string block = page.data(rows);
  const Axis x{"", 0.5, static_cast<double>(record.swings.size()) + 0.5, 1};
  const auto draw = [&](size_t panel, const Axis& y, const char* measured, const char* simulated) {
    page.panel(grid.box(panel), x, y, "",
               {plotted(block, fmt::format("points pt {} ps 1.4 lw 1.4", symbol(0)), kBlack, measured),
                plotted(block, "points pt 7 ps 0.7 lw 1.4", colour(0), simulated)},
               named_tics('x', names) + "set xtics rotate by 40 right\n");
  };
  draw(0, axis_over(frequencies, "frequency [Hz]", 5, true), "1:2", "1:3");
  draw(1, axis_over(decays, "decay [1/s]", 5, true), "1:4", "1:5");
  const char* caption =
      "Of each recording, measured and simulated, by the same fit of a decaying oscillation. Repeats of one case show "
      "how "
      "well either is known.";
  return Drawing{{"swings", title, caption}, csv, page};
}

}  // namespace taut::plot

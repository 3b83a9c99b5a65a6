#include "reports/stability_figures.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "reports/figures.hpp"

namespace taut {
namespace {

using plot::Box;
using plot::LegendEntry;
using plot::Page;

constexpr double kWidth = 1180;  // px
constexpr size_t kColumns = 4;   // panels beside each other

struct Look {
  int colour;         ///< 0xRRGGBB
  bool light;         ///< text on it is white
  const char* words;  ///< for the legend
};

/// In the order of Outcome. Good ones are pale; a grey print still tells good from bad.
constexpr std::array<Look, 8> kLooks{{{0xc9ead3, false, "converged at once"},
                                      {0xfff0a8, false, "converged, steps halved"},
                                      {0xf5b461, false, "too stiff by over 10 %"},
                                      {0x7fb8e6, false, "slipped: another answer"},
                                      {0xc08bc9, false, "not a minimum: unstable"},
                                      {0xa8a8a8, false, "no end: stalled or limit"},
                                      {0xc43d2b, true, "elements inside out"},
                                      {0x222222, true, "passed through something"}}};

const Look& look_of(Outcome outcome) {
  return kLooks[static_cast<size_t>(outcome)];
}

/// The names at the cells, or marks alone.
std::string tics(char axis, const std::vector<std::string>& names, bool shown) {
  std::string text = fmt::format("set {}tics (", axis);
  for (size_t i = 0; i < names.size(); ++i)
    text += fmt::format("{}{} {}", i == 0 ? "" : ", ", plot::literal(shown ? names[i] : ""), i);
  return text + ")\n";
}

std::vector<LegendEntry> legend_of(const StabilityMap& map, const std::vector<std::optional<StabilityRun>>& runs) {
  std::vector<LegendEntry> legend{{LegendEntry::heading, "The run"}};
  for (size_t k = 0; k < kLooks.size(); ++k) {
    if (std::ranges::any_of(runs, [&](const auto& run) { return run && static_cast<size_t>(run->outcome) == k; }))
      legend.push_back({LegendEntry::area,
                        static_cast<Outcome>(k) == Outcome::elsewhere ? map.elsewhere : kLooks[k].words,
                        fmt::format("#{:06x}", kLooks[k].colour)});
  }
  if (std::ranges::any_of(runs, [](const auto& run) { return !run; }))
    legend.push_back({LegendEntry::area, "not run: no time left", "#ffffff"});
  legend.push_back({LegendEntry::heading, "In a cell"});
  legend.push_back({LegendEntry::text, "Newton iterations"});
  if (map.id == "step_stiffness") legend.push_back({LegendEntry::text, "(explicit: evaluations)"});
  if (map.shows_error) legend.push_back({LegendEntry::text, "below: error in %"});
  return legend;
}

/// The cells of one method as plots.
std::vector<std::string> cells_of(Page& page, const StabilityMap& map,
                                  const std::vector<std::optional<StabilityRun>>& runs, size_t method) {
  std::vector<std::vector<double>> boxes, dark, light, dark_errors, light_errors;
  for (size_t y = 0; y < map.y.size(); ++y) {
    for (size_t x = 0; x < map.x.size(); ++x) {
      const std::optional<StabilityRun>& run = runs[map.cell(method, x, y)];
      const double i = static_cast<double>(x), j = static_cast<double>(y);
      const int colour = run ? look_of(run->outcome).colour : 0xffffff;
      boxes.push_back({i, j, i - 0.48, i + 0.48, j - 0.48, j + 0.48, static_cast<double>(colour)});
      if (!run) continue;
      const bool white = look_of(run->outcome).light, error = map.shows_error && std::isfinite(run->error);
      (white ? light : dark).push_back({i, error ? j + 0.2 : j, static_cast<double>(run->iterations)});
      if (error)
        (white ? light_errors : dark_errors).push_back({i, j - 0.2, std::clamp(100 * run->error, -999.0, 999.0)});
    }
  }
  std::vector<std::string> plots{page.data(boxes) +
                                 " using 1:2:3:4:5:6:7 with boxxyerror fs solid 1 noborder lc rgb variable"};
  const auto add = [&](const std::vector<std::vector<double>>& texts, const char* format, const char* colour) {
    if (texts.empty()) return;
    plots.push_back(fmt::format("{} using 1:2:(sprintf('{}',$3)) with labels font ',9' tc rgb '{}'", page.data(texts),
                                format, colour));
  };
  add(dark, "%g", plot::kBlack);
  add(light, "%g", "#ffffff");
  add(dark_errors, "%+.0f %%", plot::kBlack);
  add(light_errors, "%+.0f %%", "#ffffff");
  return plots;
}

std::string csv_of(const StabilityMap& map, const std::vector<std::optional<StabilityRun>>& runs) {
  std::string csv = plot::line(std::string("method"), map.x_label, map.y_label, std::string("outcome"),
                               std::string("iterations"), std::string("factorisations"), std::string("error"));
  for (size_t m = 0; m < map.methods.size(); ++m) {
    for (size_t y = 0; y < map.y.size(); ++y) {
      for (size_t x = 0; x < map.x.size(); ++x) {
        const std::optional<StabilityRun>& run = runs[map.cell(m, x, y)];
        if (!run) continue;
        csv += plot::line(map.methods[m], map.x[x], map.y[y], std::string(name_of(run->outcome)), run->iterations,
                          run->factorisations, run->error);
      }
    }
  }
  return csv;
}

struct Score {
  std::string method;
  int right = 0, run = 0;
  double share() const { return run == 0 ? 0 : static_cast<double>(right) / run; }
};

Score score_of(const StabilityMap& map, const std::vector<std::optional<StabilityRun>>& runs, size_t method) {
  Score score{map.methods[method]};
  for (size_t y = 0; y < map.y.size(); ++y) {
    for (size_t x = 0; x < map.x.size(); ++x) {
      const std::optional<StabilityRun>& run = runs[map.cell(method, x, y)];
      if (!run) continue;
      ++score.run;
      score.right += run->outcome <= Outcome::cut_back;
    }
  }
  return score;
}

}  // namespace

std::string sentence_of(const StabilityMap& map, const std::vector<std::optional<StabilityRun>>& runs) {
  std::vector<Score> scores;
  for (size_t m = 0; m < map.methods.size(); ++m) scores.push_back(score_of(map, runs, m));
  std::erase_if(scores, [](const Score& score) { return score.run == 0; });
  if (scores.empty()) return map.title;
  const Score& first = scores.front();
  const Score& worst = *std::ranges::min_element(scores, {}, &Score::share);
  const Score& best = *std::ranges::max_element(scores, {}, &Score::share);
  const Score& other = worst.share() < first.share() ? worst : best;
  if (other.share() == first.share())
    return fmt::format("{}: every method is right in {} of {} runs", map.title, first.right, first.run);
  return fmt::format("{}: '{}' is right in {} of {} runs, '{}' in {}", map.title, first.method, first.right, first.run,
                     other.method, other.right);
}

Figure draw_stability(const StabilityMap& map, const std::vector<std::optional<StabilityRun>>& runs,
                      const std::string& subject, bool simulated, const std::string& folder) {
  const std::vector<LegendEntry> legend = legend_of(map, runs);
  const double legend_left = kWidth - plot::legend_width(legend) - 12;
  size_t longest = 0;
  for (const std::string& name : map.y) longest = std::max(longest, plot::length_of(name));
  const double left = 46 + 8 * static_cast<double>(longest), gap = 18, below = 62, heading = 40;
  const double across = (legend_left - 24 - left - gap * (kColumns - 1)) / kColumns;
  const double tall = across * static_cast<double>(map.y.size()) / static_cast<double>(map.x.size());
  const size_t rows = (map.methods.size() + kColumns - 1) / kColumns;
  const double each = heading + tall;
  const double height = std::max(plot::kTitle + each * static_cast<double>(rows) + below,
                                 plot::kTitle + 19.0 * static_cast<double>(legend.size()) + 60);
  const std::string title = sentence_of(map, runs);
  std::string subtitle = subject + ": " + map.setting;
  if (plot::length_of(subtitle) > 155) subtitle = subject.substr(0, subject.find(',')) + ": " + map.setting;
  Page page(kWidth, height, title, subtitle, simulated);
  page.legend(legend_left, height - plot::kTitle - heading, legend);
  for (size_t m = 0; m < map.methods.size(); ++m) {
    const size_t row = m / kColumns, column = m % kColumns;
    const double top = height - plot::kTitle - static_cast<double>(row) * each - heading;
    const double from = left + static_cast<double>(column) * (across + gap);
    // The last panel above an empty place needs its numbers too.
    const bool lowest = m + kColumns >= map.methods.size(), first = column == 0;
    plot::Axis x{lowest ? map.x_label : "", -0.5, static_cast<double>(map.x.size()) - 0.5, 1},
        y{first ? map.y_label : "", -0.5, static_cast<double>(map.y.size()) - 0.5, 1};
    const std::string extra = "unset grid\n" + tics('x', map.x, lowest) + tics('y', map.y, first) +
                              "set xtics font ',10'\nset ytics font ',10'\n";
    page.panel({from, top - tall, from + across, top}, x, y,
               plot::shortened(map.methods[m], static_cast<size_t>(across / 6.6)), cells_of(page, map, runs, m), extra);
  }
  const std::string caption = title + "; " + map.setting + ".";
  return plot::finished({{"stability_" + map.id, title, caption, ""}, csv_of(map, runs), page}, folder);
}

}  // namespace taut

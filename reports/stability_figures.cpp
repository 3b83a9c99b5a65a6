#include "reports/stability_figures.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "reports/figures.hpp"

namespace taut {
namespace {

using plot::LegendEntry;
using plot::Page;
using plot::Rows;
using Runs = std::vector<std::optional<StabilityRun>>;

constexpr size_t kColumns = 4;  // panels beside each other

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
  std::vector<std::pair<std::string, double>> places;
  for (const std::string& name : names) places.emplace_back(shown ? name : "", places.size());
  return plot::named_tics(axis, places);
}

/// Calls action(x, y, run) for each cell of a method, row by row; the run is empty where there was none.
template <class Action>
void each_cell(const StabilityMap& map, const Runs& runs, size_t method, Action&& action) {
  for (size_t y = 0; y < map.y.size(); ++y) {
    for (size_t x = 0; x < map.x.size(); ++x) action(x, y, runs[map.cell(method, x, y)]);
  }
}

std::vector<LegendEntry> legend_of(const StabilityMap& map, const Runs& runs) {
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
plot::Plots cells_of(Page& page, const StabilityMap& map, const Runs& runs, size_t method) {
  Rows boxes;
  std::array<Rows, 2> counts, errors;  // on dark cells last
  each_cell(map, runs, method, [&](size_t x, size_t y, const std::optional<StabilityRun>& run) {
    const double i = static_cast<double>(x), j = static_cast<double>(y);
    const int colour = run ? look_of(run->outcome).colour : 0xffffff;
    boxes.push_back({i, j, i - 0.48, i + 0.48, j - 0.48, j + 0.48, static_cast<double>(colour)});
    if (!run) return;
    const bool white = look_of(run->outcome).light, error = map.shows_error && std::isfinite(run->error);
    counts[white].push_back({i, error ? j + 0.2 : j, static_cast<double>(run->iterations)});
    if (error) errors[white].push_back({i, j - 0.2, std::clamp(100 * run->error, -999.0, 999.0)});
  });
  plot::Plots plots{page.data(boxes) + " using 1:2:3:4:5:6:7 with boxxyerror fs solid 1 noborder lc rgb variable"};
  for (const auto& [texts, format] : {std::pair(counts, "%g"), std::pair(errors, "%+.0f %%")}) {
    for (const bool white : {false, true}) {
      if (texts[white].empty()) continue;
      plots.push_back(fmt::format("{} using 1:2:(sprintf('{}',$3)) with labels font ',9' tc rgb '{}'",
                                  page.data(texts[white]), format, white ? "#ffffff" : plot::kBlack));
    }
  }
  return plots;
}

std::string csv_of(const StabilityMap& map, const Runs& runs) {
  std::string csv = plot::line("method", map.x_label, map.y_label, "outcome", "iterations", "factorisations", "error");
  for (size_t m = 0; m < map.methods.size(); ++m) {
    each_cell(map, runs, m, [&](size_t x, size_t y, const std::optional<StabilityRun>& run) {
      if (run)
        csv += plot::line(map.methods[m], map.x[x], map.y[y], std::string(name_of(run->outcome)), run->iterations,
                          run->factorisations, run->error);
    });
  }
  return csv;
}

struct Score {
  std::string method;
  int right = 0, run = 0;
  double share() const { return run == 0 ? 0 : static_cast<double>(right) / run; }
};

Score score_of(const StabilityMap& map, const Runs& runs, size_t method) {
  Score score{map.methods[method]};
  each_cell(map, runs, method, [&](size_t, size_t, const std::optional<StabilityRun>& run) {
    score.run += run.has_value();
    score.right += run && run->outcome <= Outcome::cut_back;
  });
  return score;
}

}  // namespace

std::string sentence_of(const StabilityMap& map, const Runs& runs) {
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

Figure draw_stability(const StabilityMap& map, const Runs& runs, const std::string& subject, bool simulated,
                      const std::string& folder) {
  size_t longest = 0;
  for (const std::string& name : map.y) longest = std::max(longest, plot::length_of(name));
  const double heading = 40, wide = static_cast<double>(map.x.size()), high = static_cast<double>(map.y.size());
  plot::Grid grid({.left = 46 + 8 * static_cast<double>(longest),
                   .gap = 18,
                   .above = heading,
                   .below = 0,
                   .foot = 62,
                   .edge = 12,
                   .page = 1180},
                  legend_of(map, runs), kColumns);
  grid.panels(map.methods.size(), grid.across * high / wide);
  const std::string title = sentence_of(map, runs);
  std::string subtitle = subject + ": " + map.setting;
  if (plot::length_of(subtitle) > 155) subtitle = subject.substr(0, subject.find(',')) + ": " + map.setting;
  Page page = grid.page(title, subtitle, simulated, heading);
  for (size_t m = 0; m < map.methods.size(); ++m) {
    // The last panel above an empty place needs its numbers too.
    const bool lowest = m + kColumns >= map.methods.size(), first = grid.leftmost(m);
    page.panel(grid.box(m), {lowest ? map.x_label : "", -0.5, wide - 0.5, 1},
               {first ? map.y_label : "", -0.5, high - 0.5, 1},
               plot::shortened(map.methods[m], static_cast<size_t>(grid.across / 6.6)), cells_of(page, map, runs, m),
               "unset grid\n" + tics('x', map.x, lowest) + tics('y', map.y, first) +
                   "set xtics font ',10'\nset ytics font ',10'\n");
  }
  const std::string caption = title + "; " + map.setting + ".";
  return plot::finished({{"stability_" + map.id, title, caption}, csv_of(map, runs), page}, folder);
}

}  // namespace taut

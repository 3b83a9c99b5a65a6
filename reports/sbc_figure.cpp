#include "reports/sbc_figure.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "calib/fit/distributions.hpp"
#include "reports/figures.hpp"

namespace taut {

using namespace plot;

void draw_sbc(const Bench& bench, const std::vector<std::optional<SbcResult>>& results,
              const std::vector<SbcVerdict>& verdicts, const std::string& folder) {
  constexpr size_t bins = 10;
  const std::vector<LegendEntry> legend{{LegendEntry::line, "truths of this rank", colour(0)},
                                        {LegendEntry::band, "95 % of bars, if right", colour(1)}};
  const Grid grid = Grid({.gap = 50, .above = 34}, legend, verdicts.size() == 1 ? 1 : 2).panels(verdicts.size(), 200);
  const std::string title = "Ranks of the truth in the posterior";
  Page page = grid.page(title, bench.experiment().title, true);
  std::string csv = "parameter,rank\n";
  for (size_t j = 0; j < verdicts.size(); ++j) {
    std::vector<double> counts(bins, 0.0);
    for (const auto& result : results) {
      if (!result || result->ranks.empty()) continue;
      csv += line(verdicts[j].id, result->ranks[j]);
      counts[std::min(static_cast<size_t>(result->ranks[j] * bins), bins - 1)] += 1;
    }
    Rows steps{{0, 0}};
    for (size_t k = 0; k < bins; ++k) {
      steps.push_back({static_cast<double>(k) / bins, counts[k]});
      steps.push_back({static_cast<double>(k + 1) / bins, counts[k]});
    }
    steps.push_back({1, 0});
    // A bar counts a binomial number, near enough a normal one.
    const double n = verdicts[j].count, mean = n / bins, half = z95 * std::sqrt(n / bins * (1 - 1.0 / bins));
    Plots plots;
    page.add(plots, steps, "lines lw 2", colour(0));
    std::vector<double> shown = counts;
    shown.push_back(mean + half);
    page.panel(grid.box(j), {"share of the posterior below the truth", 0, 1, 0.2},
               axis_over(shown, grid.leftmost(j) ? "truths" : "", 4, true),
               fmt::format("{}: p = {:.2g}", verdicts[j].id, verdicts[j].p), plots,
               shade("graph 0, " + first(std::max(mean - half, 0.0)), "graph 1, " + first(mean + half),
                     "transparent solid 0.14", colour(1)));
  }
  finished(
      Drawing{{"sbc", title,
               "Truths were drawn from the prior, their readings simulated and sampled; where the posterior is the "
               "right one every rank is equally likely."},
              csv,
              page},
      folder);
}

}  // namespace taut

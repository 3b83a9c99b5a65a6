#pragma once
#include <optional>
#include <string>
#include <vector>

#include "calib/studies/stability.hpp"
#include "reports/report.hpp"

namespace taut {

/// "A crumpled start: the default arrives in 20 of 25 runs, full steps in 12": the map's title with the first method's
/// score, and the worst one's, or where none is worse the best one's. An answer that is wrong does not count.
std::string sentence_of(const StabilityMap& map, const std::vector<std::optional<StabilityRun>>& runs);

/// Draws a map into `folder`/figures as stability_<id>: a panel of coloured cells for each method, with the number of
/// iterations and, where the map has one, the error in per cent. `runs` by StabilityMap::cell(), empty ones were not
/// run; `subject` names the experiment. Simulated data are said so. Needs gnuplot, see undrawn_figures().
Figure draw_stability(const StabilityMap& map, const std::vector<std::optional<StabilityRun>>& runs,
                      const std::string& subject, bool simulated, const std::string& folder);

}  // namespace taut

#pragma once
#include <string>
#include <vector>

#include "reports/report.hpp"

namespace taut {

/// A run with the name that figures give it.
struct NamedRun {
  std::string name;
  const RunRecord* record;
};

/// A panel for each channel, with the fitted curves of all runs over each other, their bands and readings; runs by
/// colour. Runs whose curves run over the same load. See undrawn_figures().
Figure draw_compared_curves(const std::vector<NamedRun>& runs, const std::string& folder);

/// A panel for each parameter: its value in each run with its 95 % interval in all (else of the noise), in the order of
/// the fits' dates, over days where they are of more than one day. Parameters of all runs.
Figure draw_compared_parameters(const std::vector<NamedRun>& runs, const std::string& folder);

}  // namespace taut

#pragma once
#include <optional>
#include <string>
#include <vector>

#include "calib/studies/sbc.hpp"

namespace taut {

/// Ranks of truths in their posteriors as histograms, with the band in which 95 % of the bars lie where the posterior
/// is right: figures sbc.svg, .pdf and .png with its data in `folder`/figures.
void draw_sbc(const Bench& bench, const std::vector<std::optional<SbcResult>>& results,
              const std::vector<SbcVerdict>& verdicts, const std::string& folder);

}  // namespace taut

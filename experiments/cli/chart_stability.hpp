#pragma once
#include "experiments/cli/commands.hpp"

namespace taut {

/// `taut chart stability EXPERIMENT`.
int chart_stability(const CommandOptions& options);

}  // namespace taut

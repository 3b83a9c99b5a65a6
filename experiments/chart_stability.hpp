#pragma once
#include "experiments/commands.hpp"

namespace taut {

/// `taut chart stability EXPERIMENT`.
int chart_stability(const CommandOptions& options);

}  // namespace taut

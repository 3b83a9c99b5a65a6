#pragma once
#include "experiments/cli/commands.hpp"

namespace taut {

/// `taut check` and `taut fit` of experiments with geometry kind "uniaxial" (calib/uniaxial.hpp): no mesh, no solves.
int check_uniaxial(const CommandOptions& options);
int fit_uniaxial(const CommandOptions& options);

}  // namespace taut

#pragma once
#include "experiments/cli/commands.hpp"

namespace taut {

/// `taut check`, `taut replay` and `taut fit` of experiments with a bench of recordings (calib/recordings.hpp).
int check_recordings(const CommandOptions& options);
int replay_recordings(const CommandOptions& options);
int fit_recordings(const CommandOptions& options);

}  // namespace taut

#pragma once
#include <map>
#include <string>

#include "calib/files/experiment.hpp"
#include "sim/files/tables.hpp"

namespace taut {

/// Reads [bench] with kind = "recordings", and [dynamics] and [damping.REGION] of `root`, into experiment.recordings
/// and experiment.dynamics, and checks them against what `experiment` has already: materials, loads, channels. Throws
/// InputError.
void read_recordings(TableReader bench, TableReader& root, Experiment& experiment);

/// What a case may have for itself: constants of materials and damping, by their ids in the model.
std::map<std::string, double> material_values(const Experiment& experiment);

}  // namespace taut

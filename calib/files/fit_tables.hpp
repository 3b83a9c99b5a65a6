#pragma once
#include "calib/files/experiment.hpp"
#include "sim/files/toml_reader.hpp"

// Tables that experiment files of all kinds have in common. All functions throw InputError with file and line.
namespace taut {

/// The keys title and data at the top of a file.
void read_head(TableReader& root, Experiment& experiment);
/// [fit.free.ID].
void read_free(TableReader& fit, Experiment& experiment);
/// [[fit.reference]].
void read_references(TableReader& fit, Experiment& experiment);

}  // namespace taut

#pragma once
#include "calib/runs/run_record.hpp"

namespace taut {

/// Standard deviation that a new reading of this channel at these controls would have, of the value `value` [SI]: what
/// the file declares, else, where the bench lists it row by row, that of the run's readings, interpolated over the load
/// and constant beyond them.
double sigma_of_new_reading(const RunRecord& record, const Bench& bench, const BenchReading& at, double value);

/// The same before any run: what the file declares. Throws InputError where it declares nothing.
double sigma_of_new_reading(const Bench& bench, const BenchReading& at, double value);

}  // namespace taut

#pragma once
#include <string>

#include "calib/runs/run_record.hpp"

namespace taut {

/// Throws InputError, with the file and the key, for a record that contradicts itself: lists that belong together and
/// differ in length, a covariance that is not symmetric or has a negative variance, a correlation beyond 1, a value
/// outside its bounds, a reading or sigma that is no number or below what a double resolves, a result of a fit that has
/// none. What predicts from a record or compares it must not believe such a file.
void check_record(const RunRecord& record, const std::string& file);

}  // namespace taut

#pragma once
#include <optional>
#include <string>

#include "calib/data/trials.hpp"

namespace taut {

/// The rows of a bench that is planned and not measured yet: each row's controls, with readings of all its channels
/// whose value and sigma are NaN. `rows`: a CSV file with the columns of controls, as read_load_rows() takes it (a
/// trial column may be there); "": the bench's own file, whose header has to be as read_trials() wants it. nullopt:
/// that file holds a reading, so that the bench is no plan. A file without a row is refused, or stands for one row,
/// line 0, in which nothing is set (`rows_needed` false), so that all else can be looked at. Throws InputError as
/// read_trials() does.
std::optional<Trials> read_plan(const BenchFormat& format, const std::string& rows, bool rows_needed);

}  // namespace taut

#pragma once
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"

// Controls and channels of a bench, and their values, as words of the command line.
namespace taut {

/// "12.3 mm"; zero in the unit of the control's other values.
std::string value_text(const Bench& bench, size_t control, double value);
/// Position of the axis that is called `id`. Throws InputError that begins with `where` and says `what` there is not.
size_t place_of_id(const std::vector<AxisRecord>& axes, const std::string& id, const std::string& where,
                   const std::string& what);
/// A value with its unit, in SI. Throws InputError that begins with `where`.
double in_unit_of(const AxisRecord& axis, const std::string& text, const std::string& where);
/// "5mm" as "5 mm": between number and unit a blank is wanted.
std::string spaced(const std::string& text);

}  // namespace taut

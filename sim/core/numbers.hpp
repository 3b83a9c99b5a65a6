#pragma once
#include <limits>

namespace taut {

/// What a number is while nobody knows it.
inline constexpr double not_a_number = std::numeric_limits<double>::quiet_NaN();
/// Beyond every number.
inline constexpr double infinity = std::numeric_limits<double>::infinity();

}  // namespace taut

#pragma once
#include <string>

namespace taut {

/// "10 times", "25.4 times (inches?)", "with the other sign": what a slip of the pen or of a unit makes of a number,
/// when `ratio` is such a factor within `tolerance` (of it); else "".
std::string slip_of(double ratio, double tolerance);

}  // namespace taut

#pragma once
#include <string>
#include <vector>

#include "calib/data/trials.hpp"

namespace taut {

/// "10 times", "25.4 times (inches?)", "with the other sign": what a slip of the pen or of a unit makes of a number,
/// when `ratio` is such a factor within `tolerance` (of it); else "".
std::string slip_of(double ratio, double tolerance);

/// Readings, of those that are not excluded, that their repeats contradict: a reading is named when it is farther from
/// the median of its siblings (same controls and channel, two at least) than 8 of its sigmas and 8 times their own
/// scatter about it. One sentence each, with line, value, what the siblings say and, where it fits, which slip would
/// explain it. With a single sibling that is 8 sigmas of both away the pair is named. `units`: SI unit of each channel.
std::vector<std::string> odd_repeats(const Trials& trials, const std::vector<std::string>& units);

/// Values that are out of proportion to a specimen of the diagonal `size` [m]: retractions of more than half of it (ids
/// in `retractions`), readings in metres of more than three of it. `units`: SI unit of each channel. One sentence each.
std::vector<std::string> out_of_proportion(const Trials& trials, const std::vector<std::string>& retractions,
                                           const std::vector<std::string>& units, double size);

}  // namespace taut

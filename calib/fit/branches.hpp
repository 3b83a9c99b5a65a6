#pragma once
#include <vector>

#include "calib/fit/fit.hpp"

namespace taut {

/// What the readings say of rows that have two equilibria.
enum class Decided { path, other, undecided };

/// How far the readings of an alternative's rows are from either of its equilibria.
struct BranchMisfit {
  double path = 0, other = 0;  ///< chi squared
  int readings = 0;
  /// The one that they agree with, to five standard deviations (root mean square), where the odds against the other one
  /// are above 1000; there has to be another one.
  Decided decided() const;
};
/// Of the measurements of its rows.
BranchMisfit branch_misfit(const Alternative& alternative, const std::vector<Measurement>& measurements);

/// The rows whose readings are nearer to the other equilibrium, by a chi squared of more than 25: whether they follow
/// that one a fit with them there has to say.
std::vector<int> rows_elsewhere(const std::vector<Alternative>& alternatives,
                                const std::vector<Measurement>& measurements);

}  // namespace taut

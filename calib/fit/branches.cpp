#include "calib/fit/branches.hpp"

#include <algorithm>
#include <cmath>

namespace taut {

Decided BranchMisfit::decided() const {
  const double least = 2 * std::log(1000.0);  // of the likelihood's ratio
  if (std::min(path, other) > 25.0 * readings || std::abs(path - other) < least) return Decided::undecided;
  return path < other ? Decided::path : Decided::other;
}

BranchMisfit branch_misfit(const Alternative& alternative, const std::vector<Measurement>& measurements) {
  BranchMisfit misfit;
  for (const Measurement& m : measurements) {
    const auto row = std::ranges::find(alternative.rows, m.row);
    if (row == alternative.rows.end()) continue;
    const auto i = static_cast<Eigen::Index>(row - alternative.rows.begin());
    misfit.path += std::pow((alternative.path[i] - m.value) / m.sigma, 2);
    if (alternative.other.size() > 0) misfit.other += std::pow((alternative.other[i] - m.value) / m.sigma, 2);
    ++misfit.readings;
  }
  return misfit;
}

std::vector<int> rows_elsewhere(const std::vector<Alternative>& alternatives,
                                const std::vector<Measurement>& measurements) {
  std::vector<int> rows;
  for (const Alternative& alternative : alternatives) {
    if (alternative.other.size() == 0) continue;
    const BranchMisfit misfit = branch_misfit(alternative, measurements);
    if (misfit.path - misfit.other > 25) rows.insert(rows.end(), alternative.rows.begin(), alternative.rows.end());
  }
  return rows;
}

}  // namespace taut

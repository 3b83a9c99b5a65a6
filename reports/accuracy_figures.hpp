#pragma once
#include <optional>
#include <string>
#include <vector>

#include "calib/studies/accuracy.hpp"
#include "reports/report.hpp"

namespace taut {

/// Draws what judge() found into folder/figures: accuracy_cost, the error of the result over wall time and over matrix
/// factorisations; accuracy_steps, the same for the error by time steps alone, of what goes over time; and
/// accuracy_parameters, the error that each fitted parameter would have. SVG, PDF, PNG, CSV and gnuplot script each.
/// What gnuplot cannot draw is left out, see undrawn_figures().
std::vector<Figure> draw_accuracy(const AccuracyStudy& study, const std::vector<std::optional<AccuracyRun>>& runs,
                                  const AccuracyChart& chart, const std::string& folder);

}  // namespace taut

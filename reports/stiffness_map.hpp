#pragma once
#include <string>
#include <vector>

#include "calib/studies/tuning.hpp"
#include "reports/report.hpp"

namespace taut {

/// What stands around a map of stiffness in its files.
struct StiffnessMapText {
  std::string title;                      ///< of the run
  bool simulated = false;                 ///< its readings were
  AxisRecord control, load;               ///< over which it is
  std::vector<AxisRecord> held = {};      ///< other controls,
  std::vector<double> held_at = {};       ///< and their values, SI
  std::vector<AxisRecord> channels = {};  ///< what is read there, as TunedState::readings
};

/// What interpolating in the map is worth: its errors at points between the nodes, where closing runs between them
/// apart, as the end of a sentence.
std::string interpolation_error(const StiffnessMap& map, const StiffnessMapText& text);

/// The map as a table, a node a row: both controls, `stiffness_N_per_m`, the half widths of its 95 % bands of noise and
/// in all (N/m), whether surfaces touch (0, 1), whether the way there slipped, what each channel reads. A state without
/// an equilibrium has no number. SI; comment lines say how to interpolate and what that is worth.
std::string stiffness_map_csv(const StiffnessMap& map, const StiffnessMapText& text);

/// The same as JSON: `control` and `load` with their `values`, `stiffness_N_per_m` and the others as lists of rows (a
/// row for each value of the control), `interpolation` with its rule and its errors at the checks.
std::string stiffness_map_json(const StiffnessMap& map, const StiffnessMapText& text);

/// Stiffness over the control, a curve with its band for each load, what touches filled; below it the map of both.
/// `wanted` [N/m] and the values that were found for it are marked. See undrawn_figures().
Figure draw_stiffness_map(const StiffnessMap& map, const StiffnessMapText& text, double wanted,
                          const std::vector<double>& found, const std::string& folder);

}  // namespace taut

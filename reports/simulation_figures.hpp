#pragma once
#include <optional>
#include <string>
#include <vector>

#include "reports/figures.hpp"
#include "reports/simulation_record.hpp"

/// The figures of a simulation; a new one is declared here and goes into what_it_gives() (simulation_report.cpp). Used
/// inside reports/ only.
namespace taut::plot {

std::string label_of(const Series& series);  ///< its meaning, else its id

/// "12.5 mm", in the unit in which figures show the series; what is nothing beside its largest value is 0.
std::string shown_value(const Series& series, size_t sample);

/// All channels of one SI unit over the samples (of equilibria over the control that drives them, unless it turns
/// back), with the controls that move below; nothing without such channels.
std::optional<Drawing> channels_of_unit(const SimulationRecord& record, const std::string& si_unit);

/// A plot of the record, one panel per unit of its y; start and end are marked when x is not the sample variable.
Drawing asked_plot(const SimulationRecord& record, const SimulationRecord::Plot& plot);

/// Reachable points with outlines and areas, axes equal; nothing without workspaces.
std::optional<Drawing> workspaces(const SimulationRecord& record);

/// 5 to 8 stored states (all when there are fewer) beside each other, evenly chosen, in one window and scale: filled
/// regions in 2D; in 3D an isometric view with shaded facets, painted from the farthest to the nearest. The CSV holds
/// what is drawn, in millimetres; in 3D right, up and towards the viewer.
Drawing strip(const SimulationRecord& record);

}  // namespace taut::plot

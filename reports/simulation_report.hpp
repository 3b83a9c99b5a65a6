#pragma once
#include <string>
#include <vector>

#include "reports/simulation_record.hpp"

namespace taut {

/// channels.csv: the sample variable, controls and channels over the samples, each column with its unit at the end of
/// its name ("time_s", "tip_y_mm"), in millimetres, degrees, kilopascals, else SI; empty where there is no value.
std::string channels_csv(const SimulationRecord& record);

/// Writes into `folder` (created) and returns the files, relative to it: channels.csv, NAME.pvd and
/// frames/NAME_0000.vtu onwards for ParaView, animation.html, then figures/ (strip, the asked plots, workspaces,
/// channels by unit; .svg, .pdf, .png, .csv and .gp each) and report.html. Throws as check() does, and InputError when
/// a file cannot be written. What gnuplot cannot draw is left out, see undrawn_figures().
std::vector<std::string> write_simulation(const SimulationRecord& record, const std::string& folder);

}  // namespace taut

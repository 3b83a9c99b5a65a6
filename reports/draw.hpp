#pragma once
#include <string>

#include "calib/files/experiment.hpp"
#include "reports/report.hpp"

namespace taut {

/// Draws an experiment at rest: regions, supports, loads, what is measured, cables with their via points, and
/// dimensions in millimetres; of a push-puppet module every length, with an enlarged gap. Written to
/// `folder`/figures/drawing.svg, .pdf, .png and .csv. `mesh` is the experiment's. Throws InputError for 3D geometries.
Figure draw_experiment(const Experiment& experiment, const Mesh& mesh, const std::string& folder);

}  // namespace taut

#pragma once
#include <string>
#include <vector>

#include "reports/run_record.hpp"

namespace taut {

/// A figure as gnuplot made it: folder/figures/NAME.svg, .pdf, .png and the numbers beside them as NAME.csv.
struct Figure {
  std::string name;
  std::string title;
  std::string caption;   ///< what a person should see in it, in one or two sentences
  std::string svg = {};  ///< the SVG text, for inlining
};

/// Why figures could not be drawn since this was last asked, with the remedy; "": all were. Their numbers and scripts
/// are in the folder all the same, and pages leave them out.
std::string undrawn_figures();

/// The page of a run without its figures.
std::string report_html(const RunRecord& record);

/// Draws all figures of a run into `folder`/figures, writes report.html (one self-contained file, figures inline,
/// nothing loaded from anywhere) and returns the figures. Needs gnuplot, no display. A missing or failing gnuplot costs
/// the figures only, see undrawn_figures(). Simulated data say so in every title.
std::vector<Figure> write_report(const RunRecord& record, const std::string& folder);

/// predictions.csv: one line per reading, SI units in the header, or in a last column where channels differ.
std::string predictions_csv(const RunRecord& record);

/// Everything a run folder holds, from the record alone: fit.json, predictions.csv, figures/, report.html.
void write_run(const RunRecord& record, const std::string& folder);

}  // namespace taut

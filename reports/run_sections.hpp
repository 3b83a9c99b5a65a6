#pragma once
#include "reports/section.hpp"

/// The page of a run: its figures, a file each, its sections of text, and the list of both. A new figure is written
/// into a file of its own, declared here, and named in kRunPage. Used inside reports/ only.
namespace taut {
namespace plot {

std::optional<Drawing> force_displacement(const RunRecord& record);  ///< readings with the fitted curves
std::optional<Drawing> effective_stiffness(
    const RunRecord& record);                                   ///< force per displacement, or per increment of it
std::optional<Drawing> residuals(const RunRecord& record);      ///< of readings at rest, in units of sigma
std::optional<Drawing> stress_strain(const RunRecord& record);  ///< of a material point
/// The lines of a shape [mm].
Rows lines_of(const ShapeRecord& shape);
std::optional<Drawing> deformed_shapes(const RunRecord& record);  ///< shape_panels(), else outlines over one another
/// The same as panels beside each other, with filled regions and cables: for several materials, cables or several held
/// values; else nothing.
std::optional<Drawing> shape_panels(const RunRecord& record);
/// Chi squared and the parameters over the evaluations of the search; for records that have them.
std::optional<Drawing> search_history(const RunRecord& record);
std::optional<Drawing> variants(const RunRecord& record);  ///< values of other meshes and of references
/// Rise of chi squared over the value of each parameter whose profile likelihood was searched; open ends are arrows.
std::optional<Drawing> profiles(const RunRecord& record);
/// An ensemble: each parameter's distribution beside the parabola's, and every two of them over one another.
std::optional<Drawing> ensemble(const RunRecord& record, const EnsembleRecord& ensemble);
/// Measured and simulated motion of each recording over time, with residuals below.
std::optional<Drawing> recordings(const RunRecord& record);
/// Frequency and decay of each recording, measured and simulated.
std::optional<Drawing> swings(const RunRecord& record);
/// Values of a parameter fitted to each part of the readings alone, beside the whole fit.
std::optional<Drawing> diagnostic(const RunRecord& record);

}  // namespace plot

/// The numbers that were asked for, and whether to believe them.
std::optional<Section> answer(const RunRecord& record);
std::optional<Section> frequency_and_decay(const RunRecord& record);  ///< of recordings: measured and simulated
std::optional<Section> fitted_parameters(const RunRecord& record);    ///< values, intervals and verdicts
std::optional<Section> ensembles(const RunRecord& record);            ///< posterior, bootstrap, other starts
std::optional<Section> goodness_of_fit(const RunRecord& record);      ///< chi squared and lack of fit, in words
/// One parameter from each part of the readings alone.
std::optional<Section> diagnostics(const RunRecord& record);
std::optional<Section> reading_by_reading(const RunRecord& record);       ///< measured beside predicted
std::optional<Section> variants_and_references(const RunRecord& record);  ///< the refits, and published values
std::optional<Section> correlations(const RunRecord& record);             ///< between fitted parameters
std::optional<Section> every_reading(const RunRecord& record);            ///< as a table
std::optional<Section> setup(const RunRecord& record);                    ///< what was fitted, and how
std::optional<Section> provenance(const RunRecord& record);               ///< where the result comes from

/// The report of a fit, from top to bottom.
inline constexpr MakeSection<RunRecord> kRunPage[] = {answer,
                                                      alone<plot::force_displacement>,
                                                      alone<plot::stress_strain>,
                                                      alone<plot::recordings>,
                                                      frequency_and_decay,
                                                      fitted_parameters,
                                                      alone<plot::profiles>,
                                                      ensembles,
                                                      goodness_of_fit,
                                                      diagnostics,
                                                      reading_by_reading,
                                                      alone<plot::effective_stiffness>,
                                                      variants_and_references,
                                                      alone<plot::deformed_shapes>,
                                                      correlations,
                                                      alone<plot::search_history>,
                                                      every_reading,
                                                      setup,
                                                      provenance};

}  // namespace taut

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "reports/axes.hpp"
#include "reports/diagnostic.hpp"
#include "reports/estimate_text.hpp"
#include "reports/html.hpp"
#include "reports/run_sections.hpp"

// The sections of a run's page that say how well the model fits.
namespace taut {
namespace {

using html::bare_number;
using html::Cells;
using html::escaped;
using html::paragraph;
using html::table;

/// What repeats say of the misfit.
std::string lack_of_fit_text(const RunRecord& record) {
  std::string out;
  const LackOfFit& lack = record.fit.lack_of_fit;
  if (lack.available) {
    out += paragraph(
        fmt::format("Repeats tell the two apart: the curve misses the means of the repeats {:.3g} times as much (in "
                    "squares) as the scatter of the repeats explains (F = {:.4g} with {} and {} degrees of freedom, "
                    "probability {}).",
                    lack.F, lack.F, lack.lack_of_fit_dof, lack.pure_error_dof, probability(lack.p_value)));
    out +=
        paragraph(lack.p_value < 0.05
                      ? "That is more than chance: the model itself misses something that repeats agree on, such as a "
                        "wrong dimension, a clamp that gives, another material law. More repeats will not help."
                      : "That is within chance: what the model misses looks like the scatter between repeats.");
    if (const std::string remedy = remedy_for_lack_of_fit(record); !remedy.empty()) out += paragraph(remedy, "warning");
    const double scatter = lack.pure_error_dof > 0 ? lack.pure_error / lack.pure_error_dof : NAN;
    if (scatter > 2 || scatter < 0.3) {
      out +=
          paragraph(fmt::format("Repeats scatter {:.1f} times as much as the declared standard deviations say; declare "
                                "{} ones.",
                                std::sqrt(scatter), scatter > 2 ? "larger" : "smaller"));
    }
  } else if (over_time(record)) {
    out += paragraph(
        "Samples of one motion miss the curve together: their residuals are not independent, so the intervals above "
        "are "
        "too narrow, and the differences between repeats say more about what is known.");
  } else {
    out += paragraph("There are no repeats to tell noise from a wrong model; measure some conditions twice or more.");
  }
  return out;
}

std::string largest_residual(const RunRecord& record) {
  std::vector<ReadingRecord> fitted = record.readings;
  std::erase_if(fitted, [](const ReadingRecord& r) { return r.excluded; });
  if (fitted.empty()) return "";
  const auto residual = [](const ReadingRecord& r) { return std::abs(r.measured - r.predicted); };
  const auto normalised = [&](const ReadingRecord& r) { return residual(r) / r.sigma; };
  const ReadingRecord& far = *std::ranges::max_element(fitted, {}, residual);
  const ReadingRecord& odd = *std::ranges::max_element(fitted, {}, normalised);
  const std::string largest =
      fmt::format("{:.1f} at line {}, channel {}.", (odd.measured - odd.predicted) / odd.sigma, odd.line, odd.channel);
  const std::optional<WrittenUnit> unit = ReadingUnits(record).common();
  if (!unit) return paragraph("The largest residual, measured in its own standard deviation, is " + largest);
  return paragraph(
      fmt::format("The largest residual is {:.3g} {} (line {} of the data, channel {}); measured in its own "
                  "standard deviation it is {}",
                  (far.measured - far.predicted) / unit->factor, unit->label, far.line, far.channel, largest));
}

/// How the readings of each part are predicted by the others.
std::string held_out_table(const RunRecord& record) {
  if (record.held_out.empty()) return "";
  std::vector<Cells> rows;
  for (const HeldOut& part : record.held_out)
    rows.push_back({part.part, std::to_string(part.readings),
                    part.dof == 0 ? "cannot be predicted" : fmt::format("{:.3g} for {}", part.chi_squared, part.dof),
                    small_probability(part.p_value), part.own.empty() ? "" : join(part.own, ", ")});
  return "<h3>Each part against the others</h3>\n" + paragraph(held_out_verdict(record) + ".") +
         table({"Left out", "#Readings", "#Chi squared of them", "#p", "Three times less certain without them"}, rows) +
         paragraph(
             "Each part of the readings beside what the fit of all others predicts for it, to first order; chi squared "
             "counts the errors of that prediction and the noise. What only the part itself determines is not judged.");
}

/// What would explain the misfit, where something would.
std::string explanation_table(const RunRecord& record) {
  std::vector<Cells> rows;
  for (const Explanation& e : telling(record.explanations))
    rows.push_back({e.what, fmt::format("{:.4g} for {}", e.chi_squared, e.dof), small_probability(e.p_value),
                    parameters_with(record, e), cannot_be_told_from(e)});
  if (rows.empty()) return "";
  return "<h3>What would explain the misfit</h3>\n" +
         table({"What", "#Chi squared would be", "#p", "And then", "Not to be told apart"}, rows) +
         paragraph(
             "Best first, each by itself, to first order from the optimum, without a simulation more; p is the "
             "probability of so large a fall of chi squared by chance, corrected for all that was tried. None of it is "
             "shown: look there first.");
}

}  // namespace

std::optional<Section> goodness_of_fit(const RunRecord& record) {
  const FitResult& fit = record.fit;
  std::string out = "<h2>Does the model fit?</h2>\n";
  if (!std::isfinite(fit.chi_squared)) return Section{out + paragraph("There is no result to judge.")};
  if (fit.dof <= 0)
    return Section{out + paragraph("There are as many parameters as readings, so this cannot be judged.")};
  const double ratio = misfit_ratio(fit);
  out += paragraph(
      fmt::format("Chi squared is {} for {} degrees of freedom, {} per degree (about 1 is expected). If model "
                  "and standard deviations were right, a value this large would come up with probability {}.",
                  bare_number(fit.chi_squared), fit.dof, bare_number(ratio), probability(fit.chi_squared_p)));
  if (!fits(fit)) {
    out += paragraph(
        fmt::format("So the readings lie farther from the curve than their standard deviations explain. "
                    "Either those were declared too small or the model lacks something. The intervals count the "
                    "declared standard deviations only; if all of the misfit were random, they would be {:.1f} "
                    "times as wide, and if it is not, no width makes up for it.",
                    std::sqrt(ratio)),
        "warning");
  } else if (ratio < 0.5) {
    out += paragraph(
        "That is smaller than expected: the declared standard deviations look too large, and the intervals "
        "with them.");
  }
  return Section{out + lack_of_fit_text(record) + largest_residual(record) + held_out_table(record) +
                 explanation_table(record)};
}

std::optional<Section> diagnostics(const RunRecord& record) {
  std::string out;
  for (const DiagnosticGroup& group : diagnostic_groups(record)) {
    const Shown whole(*group.whole);
    std::vector<Cells> rows;
    for (const DiagnosticRecord* part : group.parts) {
      ParameterEstimate estimate = *group.whole;
      estimate.standard_error = part->standard_error;  // for the digits; the unit stays that of the whole fit
      const Shown shown(estimate);
      const double apart = standard_errors_apart(group, *part);
      const bool known = std::isfinite(part->value);
      rows.push_back({group.whole->spec.id, part->part,
                      known ? shown.number(part->value) + " ± " + shown.with_unit(part->standard_error) : "no result",
                      std::isfinite(apart) ? fmt::format("{:+.1f}", apart) : "not known",
                      std::to_string(part->readings), known ? bare_number(part->chi_squared) : "not known"});
    }
    rows.push_back({group.whole->spec.id, "all readings",
                    whole.number(group.whole->value) + " ± " + whole.with_unit(group.whole->standard_error), "",
                    std::to_string(fitted_readings(record)), bare_number(record.fit.chi_squared)});
    out += fmt::format("<h3>From each {} alone</h3>\n", escaped(group.held)) +
           table({"Parameter", "Part", "#Value ± standard error", "#Standard errors from the whole fit", "#Readings",
                  "#Chi squared"},
                 rows) +
           paragraph(interpretation(record, group));
  }
  return with_figure(out, plot::diagnostic(record));
}

std::optional<Section> reading_by_reading(const RunRecord& record) {
  return with_figure(diagnostic_groups(record).empty() ? "" : "<h3>Reading by reading</h3>\n", plot::residuals(record));
}

}  // namespace taut

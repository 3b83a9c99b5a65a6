#include "reports/report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "reports/diagnostic.hpp"
#include "reports/figures.hpp"
#include "reports/html.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

using html::bare_number;
using html::escaped;
using html::table;

const char* const kStyle = R"(
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; color: #222;
  background: #fff; margin: 0 auto; padding: 1.5rem 1rem 4rem; max-width: 60rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.25rem; margin: 2.4rem 0 .6rem; padding-bottom: .2rem; border-bottom: 1px solid #ddd; }
h3 { font-size: 1rem; margin: 1.4rem 0 .4rem; }
p { margin: .5rem 0; max-width: 46rem; }
.origin { color: #666; margin-bottom: 1rem; }
.banner { background: #d55e00; color: #fff; font-weight: 600; padding: .6rem 1rem; border-radius: .3rem;
  margin: 0 0 1rem; max-width: none; }
.answer { background: #f1f6fa; border-left: .35rem solid #0072b2; padding: .8rem 1rem; margin: 1rem 0; }
.answer p { max-width: none; margin: .25rem 0; }
.answer .number { font-size: 1.2rem; font-weight: 600; }
.warning { border-left: .35rem solid #d55e00; padding: .2rem 0 .2rem .8rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .88rem; margin: .6rem 0; }
th, td { text-align: left; vertical-align: top; padding: .28rem .8rem .28rem 0; border-bottom: 1px solid #e6e6e6; }
th { border-bottom: 2px solid #bbb; font-weight: 600; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
td.hash { font-family: ui-monospace, Menlo, Consolas, monospace; font-size: .75rem; overflow-wrap: anywhere; }
figure { margin: 1.6rem 0; }
figure svg { width: 100%; height: auto; display: block; }
figcaption { margin-top: .6rem; color: #555; font-size: .92rem; max-width: 46rem; }
code { font-family: ui-monospace, Menlo, Consolas, monospace; font-size: .85em; overflow-wrap: anywhere; }
@media print { body { font-size: 10.5pt; max-width: none; padding: 0; } h2 { break-after: avoid; }
  .scroll { overflow: visible; } table { font-size: 8pt; } figure, tr, .answer { break-inside: avoid; } .banner { color: #000; border: 2px solid #d55e00; } }
)";

std::string paragraph(const std::string& text, const char* kind = "") {
  return fmt::format("<p{}>{}</p>\n", *kind ? fmt::format(" class=\"{}\"", kind) : "", escaped(text));
}

std::string percent(double ratio) {
  return std::isfinite(ratio) ? fmt::format("{:+.1f} %", 100 * ratio) : "not known";
}

/// The unit in which readings are shown, and its SI value.
const char* shown_unit(const RunRecord& record) {
  return record.material_point ? "kPa" : "mm";
}
double shown_factor(const RunRecord& record) {
  return record.material_point ? 1e3 : 1e-3;
}

/// Probabilities as people write them.
std::string probability(double p) {
  if (!std::isfinite(p)) return "not known";
  return p < 0.001 ? "less than 0.001" : fmt::format("{:.3f}", p);
}

/// An estimate in one unit, cut to the digits that its standard error leaves.
struct Shown {
  DisplayUnit unit;
  int decimals = 0;

  explicit Shown(const ParameterEstimate& estimate) : unit(display_unit(estimate.value, estimate.spec.unit)) {
    if (unit.name == "1") unit.name = "";
    double resolution = estimate.standard_error;
    if (!std::isfinite(resolution) || resolution <= 0) resolution = std::abs(estimate.value) / 100;
    if (std::isfinite(resolution) && resolution > 0) {
      decimals = std::clamp(1 - static_cast<int>(std::floor(std::log10(resolution / unit.factor))), 0, 9);
    }
  }
  std::string number(double value) const {
    return std::isfinite(value) ? fmt::format("{:.{}f}", value / unit.factor, decimals) : "not known";
  }
  std::string with_unit(double value) const {
    return number(value) + (unit.name.empty() || !std::isfinite(value) ? "" : " " + unit.name);
  }
  std::string interval(const ParameterEstimate& estimate) const {
    const std::optional<double>&lower = estimate.lower95, &upper = estimate.upper95;
    if (!lower && !upper) return "open on both sides";
    // An end so near to zero that the common digits would leave nothing of it gets its own.
    const auto vanishes = [&](const std::optional<double>& end) {
      return end && *end != 0 && std::abs(*end / unit.factor) < std::pow(10.0, 1 - decimals);
    };
    const bool own = vanishes(lower) || vanishes(upper);
    const auto text = [&](double end) { return own ? taut::with_unit(end, estimate.spec.unit, 3) : with_unit(end); };
    if (!lower) return "open to " + text(*upper);
    if (!upper) return text(*lower) + " to open";
    return (own ? text(*lower) : number(*lower)) + " to " + text(*upper);
  }
};

std::string bound(double value, const std::string& unit) {
  return std::isfinite(value) ? with_unit(value, unit) : "no limit";
}

double misfit_ratio(const FitResult& fit) {
  return fit.dof > 0 ? fit.chi_squared / fit.dof : NAN;
}
/// There are more readings than parameters, and a result.
bool can_judge(const FitResult& fit) {
  return fit.dof > 0 && std::isfinite(fit.chi_squared);
}
bool fits(const FitResult& fit) {
  return fit.chi_squared_p >= 0.05;
}

/// By how much the results of the variants differ from parameter `p` of the fit: lowest and highest ratio - 1.
std::optional<std::pair<double, double>> spread(const RunRecord& record, size_t p) {
  std::optional<std::pair<double, double>> range;
  const double value = record.fit.parameters[p].value;
  for (const VariantRecord& variant : record.variants) {
    if (p >= variant.values.size() || !std::isfinite(variant.values[p]) || value == 0) continue;
    const double ratio = variant.values[p] / value - 1;
    if (!std::isfinite(ratio)) continue;
    range = range ? std::pair(std::min(range->first, ratio), std::max(range->second, ratio)) : std::pair(ratio, ratio);
  }
  return range;
}

std::string summary(const RunRecord& record) {
  const FitResult& fit = record.fit;
  std::string out = "<div class=\"answer\">\n";
  if (fit.status != FitStatus::converged) {
    out += paragraph(fmt::format("The fit has not converged ({}): {} Do not use the numbers below as results.",
                                 name_of(fit.status), fit.message),
                     "warning");
  }
  for (size_t p = 0; p < fit.parameters.size(); ++p) {
    const ParameterEstimate& estimate = fit.parameters[p];
    const Shown shown(estimate);
    out += paragraph(fmt::format("{} = {}, 95 % interval {}, {}.", estimate.spec.id, shown.with_unit(estimate.value),
                                 shown.interval(estimate), name_of(estimate.verdict)),
                     "number");
  }
  if (can_judge(fit) && fits(fit)) {
    out += paragraph("The model fits the readings within their declared noise.");
  } else if (can_judge(fit)) {
    out += paragraph(
        fmt::format("The model does not fit within the declared noise: it misses the readings by {:.1f} standard "
                    "deviations (root mean square). The interval counts that noise only, not what the model lacks.",
                    std::sqrt(misfit_ratio(fit))));
  }
  for (size_t p = 0; p < fit.parameters.size(); ++p) {
    const ParameterEstimate& estimate = fit.parameters[p];
    if (const auto range = spread(record, p)) {
      const char *one = "Another mesh moves", *several = "Other meshes move";
      if (record.material_point) one = several = "Another law or choice of readings moves";
      out += paragraph(range->first == range->second
                           ? fmt::format("{} {} by {}.", one, estimate.spec.id, percent(range->first))
                           : fmt::format("{} {} by {} to {}.", several, estimate.spec.id, percent(range->first),
                                         percent(range->second)));
    }
    for (const ReferenceRecord& reference : record.references) {
      if (reference.parameter != estimate.spec.id || reference.value == 0 || !std::isfinite(estimate.value)) {
        continue;
      }
      out += paragraph(fmt::format("{} differs by {} from {} ({}).", estimate.spec.id,
                                   percent(estimate.value / reference.value - 1),
                                   with_unit(reference.value, estimate.spec.unit), reference.source));
    }
  }
  return out + "</div>\n";
}

/// "-0.41 ± 0.2 kPa".
std::string share_of(const DiscretisationShare& share, size_t p, const Shown& shown) {
  const std::string unit = shown.unit.name.empty() ? "" : " " + shown.unit.name;
  const std::string bias = fmt::format("{:+.2g}", share.bias[p] / shown.unit.factor);
  return std::isfinite(share.error[p]) ? fmt::format("{} ± {:.2g}{}", bias, share.error[p] / shown.unit.factor, unit)
                                       : bias + unit;
}

std::string parameter_section(const RunRecord& record) {
  std::vector<std::vector<std::string>> rows;
  std::vector<std::string> header = {"Parameter", "Meaning", "#Value", "#Standard error"};
  for (const DiscretisationShare& share : record.shares) header.push_back("#" + share.source + " adds");
  header.insert(header.end(), {"#95 % interval", "Verdict", "#Start", "#Allowed in the fit"});
  std::string explanations;
  for (size_t p = 0; p < record.fit.parameters.size(); ++p) {
    const ParameterEstimate& estimate = record.fit.parameters[p];
    const Shown shown(estimate);
    const std::string unit = estimate.spec.unit;
    std::vector<std::string>& row = rows.emplace_back();
    row = {estimate.spec.id, estimate.spec.meaning, shown.with_unit(estimate.value),
           shown.with_unit(estimate.standard_error)};
    for (const DiscretisationShare& share : record.shares)
      row.push_back(std::isfinite(share.bias[p]) ? share_of(share, p, shown) : "not known");
    row.insert(row.end(),
               {shown.interval(estimate), std::string(name_of(estimate.verdict)), with_unit(estimate.start, unit),
                bound(estimate.lower, unit) + " to " + bound(estimate.upper, unit)});
    if (!estimate.explanation.empty()) {
      explanations += fmt::format("<p><b>{}</b>: {}</p>\n", escaped(estimate.spec.id), escaped(estimate.explanation));
    }
  }
  std::string shares;
  for (const DiscretisationShare& share : record.shares)
    shares += paragraph(fmt::format("What the {} adds: {} ({:.1f} s).", share.source, share.how, share.seconds));
  if (!shares.empty())
    shares = paragraph(
                 "What mesh and contact gap add is part of the value as it stands: taking it off gives what elements "
                 "without size, or faces without a gap, would have given.") +
             shares;
  return "<h2>What was fitted</h2>\n" + table(header, rows) + explanations + shares +
         paragraph(
             "\"Open\" means that the readings set no limit on that side. Standard errors and intervals come from "
             "the declared standard deviations of the readings alone; they know nothing of a wrong model, a wrong "
             "length or a coarse mesh.");
}

std::string figure_html(const std::vector<Figure>& figures, const std::string& name) {
  for (const Figure& figure : figures) {
    if (figure.name != name) continue;
    return fmt::format("<figure>\n{}<figcaption>{}</figcaption>\n</figure>\n",
                       html::inlined(figure.svg, figure.name, figure.title), escaped(figure.caption));
  }
  return "";
}

std::string goodness_of_fit(const RunRecord& record) {
  const FitResult& fit = record.fit;
  std::string out = "<h2>Does the model fit?</h2>\n";
  if (!std::isfinite(fit.chi_squared)) return out + paragraph("There is no result to judge.");
  if (fit.dof <= 0) return out + paragraph("There are as many parameters as readings, so this cannot be judged.");
  const double ratio = misfit_ratio(fit);
  out += paragraph(
      fmt::format("Chi squared is {} for {} degrees of freedom, {} per degree (about 1 is expected). If model "
                  "and standard deviations were right, a value this large would come up with probability {}.",
                  bare_number(fit.chi_squared), fit.dof, bare_number(ratio), probability(fit.chi_squared_p)));
  if (!fits(fit)) {
    const std::string widened = fmt::format("{:.1f}", std::sqrt(ratio));
    out += paragraph(
        fmt::format("So the readings lie farther from the curve than their standard deviations explain. "
                    "Either those were declared too small or the model lacks something. The intervals count the "
                    "declared standard deviations only; if all of the misfit were random, they would be {} "
                    "times as wide, and if it is not, no width makes up for it.",
                    widened),
        "warning");
  } else if (ratio < 0.5) {
    out += paragraph(
        "That is smaller than expected: the declared standard deviations look too large, and the intervals "
        "with them.");
  }
  const LackOfFit& lack = fit.lack_of_fit;
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
  } else if (record.over_time) {
    out += paragraph(
        "Samples of one motion miss the curve together: their residuals are not independent, so the intervals above "
        "are "
        "too narrow, and the differences between repeats say more about what is known.");
  } else {
    out += paragraph("There are no repeats to tell noise from a wrong model; measure some conditions twice or more.");
  }
  const auto farther = [](const ReadingRecord& a, const ReadingRecord& b) {
    return std::abs(a.measured - a.predicted) < std::abs(b.measured - b.predicted);
  };
  const auto odder = [](const ReadingRecord& a, const ReadingRecord& b) {
    return std::abs((a.measured - a.predicted) / a.sigma) < std::abs((b.measured - b.predicted) / b.sigma);
  };
  if (!record.readings.empty()) {
    const ReadingRecord& far = *std::ranges::max_element(record.readings, farther);
    const ReadingRecord& odd = *std::ranges::max_element(record.readings, odder);
    out +=
        paragraph(fmt::format("The largest residual is {:.3g} {} (line {} of the data, channel {}); measured in its "
                              "own standard deviation it is "
                              "{:.1f} at line {}, channel {}.",
                              (far.measured - far.predicted) / shown_factor(record), shown_unit(record), far.line,
                              far.channel, (odd.measured - odd.predicted) / odd.sigma, odd.line, odd.channel));
  }
  return out;
}

std::string swing_section(const RunRecord& record, const std::vector<Figure>& figures) {
  if (record.swings.empty()) return "";
  std::vector<std::vector<std::string>> rows;
  for (const SwingRecord& s : record.swings) {
    rows.push_back({s.recording, s.channel, fmt::format("{:.3f}", s.frequency),
                    fmt::format("{:.3f}", s.predicted_frequency), percent(s.predicted_frequency / s.frequency - 1),
                    fmt::format("{:.3f}", s.decay), fmt::format("{:.3f}", s.predicted_decay),
                    percent(s.predicted_decay / s.decay - 1)});
  }
  return "<h2>Frequency and decay</h2>\n" +
         table({"Recording", "Channel", "#Frequency [Hz]", "#Simulated [Hz]", "#Differs by", "#Decay [1/s]",
                "#Simulated [1/s]", "#Differs by"},
               rows) +
         paragraph(
             "Both by the same least-squares fit of offset, drift and one decaying oscillation to the samples and "
             "to the simulation at their times.") +
         figure_html(figures, "swings");
}

std::string mesh_section(const RunRecord& record, const std::vector<Figure>& figures) {
  const std::vector<ParameterEstimate>& parameters = record.fit.parameters;
  std::string out;
  if (!record.variants.empty()) {
    out += record.material_point ? "<h2>What law and readings do to the number</h2>\n"
                                 : "<h2>What the mesh does to the number</h2>\n";
    std::vector<std::string> header = {"Fit", "Mesh", "#Unknowns"};
    if (record.material_point) header = {"Fit", "Law and modes", "#Readings"};
    for (const ParameterEstimate& estimate : parameters) {
      header.insert(header.end(), {"#" + estimate.spec.id + " ± standard error", "#Change"});
    }
    header.insert(header.end(), {"#Chi squared", "#Time", "Status"});
    std::vector<std::vector<std::string>> rows;
    const auto add = [&](const VariantRecord& variant, bool main) {
      std::vector<std::string> row = {main && variant.name != "this fit" ? variant.name + " (this fit)" : variant.name,
                                      variant.mesh, std::to_string(variant.unknowns)};
      for (size_t p = 0; p < parameters.size(); ++p) {
        const double value = p < variant.values.size() ? variant.values[p] : NAN;
        const double se = p < variant.standard_errors.size() ? variant.standard_errors[p] : NAN;
        const Shown shown(parameters[p]);
        row.insert(row.end(), {std::isfinite(value)    ? shown.number(value) + " ± " + shown.with_unit(se)
                               : record.material_point ? "none"
                                                       : "no result",
                               main || !std::isfinite(value) ? "" : percent(value / parameters[p].value - 1)});
      }
      row.insert(row.end(), {bare_number(variant.chi_squared), with_unit(variant.seconds, "s", 3), variant.status});
      rows.push_back(row);
    };
    VariantRecord main = record.main;
    if (main.values.empty()) {
      for (const ParameterEstimate& estimate : parameters) {
        main.values.push_back(estimate.value);
        main.standard_errors.push_back(estimate.standard_error);
      }
    }
    add(main, true);
    for (const VariantRecord& variant : record.variants) add(variant, false);
    out += table(header, rows);
  }
  if (!record.references.empty()) {
    out += "<h2>Values from elsewhere</h2>\n";
    std::vector<std::vector<std::string>> rows;
    for (const ReferenceRecord& reference : record.references) {
      for (const ParameterEstimate& estimate : parameters) {
        if (estimate.spec.id != reference.parameter) continue;
        const Shown shown(estimate);
        rows.push_back({reference.parameter, with_unit(reference.value, estimate.spec.unit),
                        shown.with_unit(estimate.value), percent(estimate.value / reference.value - 1),
                        reference.source});
      }
    }
    out += table({"Parameter", "#Reference", "#This fit", "#This fit differs by", "Source"}, rows);
  }
  return out + figure_html(figures, "variants");
}

/// One parameter from each part of the readings alone.
std::string diagnostic_section(const RunRecord& record, const std::vector<Figure>& figures) {
  std::string out;
  for (const DiagnosticGroup& group : diagnostic_groups(record)) {
    const Shown whole(*group.whole);
    std::vector<std::vector<std::string>> rows;
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
                    std::to_string(record.readings.size()), bare_number(record.fit.chi_squared)});
    out += fmt::format("<h3>From each {} alone</h3>\n", escaped(group.held)) +
           table({"Parameter", "Part", "#Value ± standard error", "#Standard errors from the whole fit", "#Readings",
                  "#Chi squared"},
                 rows) +
           paragraph(interpretation(record, group));
  }
  return out + figure_html(figures, "diagnostic");
}

std::string correlation_section(const RunRecord& record) {
  const std::vector<ParameterEstimate>& parameters = record.fit.parameters;
  const Eigen::MatrixXd& correlation = record.fit.correlation;
  const auto n = static_cast<Eigen::Index>(parameters.size());
  if (n < 2 || correlation.rows() != n || correlation.cols() != n) return "";
  std::vector<std::string> header = {""};
  std::vector<std::vector<std::string>> rows;
  for (const ParameterEstimate& estimate : parameters) header.push_back("#" + estimate.spec.id);
  for (Eigen::Index i = 0; i < n; ++i) {
    std::vector<std::string> row = {parameters[static_cast<size_t>(i)].spec.id};
    for (Eigen::Index j = 0; j < n; ++j) {
      row.push_back(std::isfinite(correlation(i, j)) ? fmt::format("{:.3f}", correlation(i, j)) : "not known");
    }
    rows.push_back(row);
  }
  return "<h2>How the parameters hang together</h2>\n" + table(header, rows) +
         paragraph(
             "Correlation of the estimates. Near +1 or -1, the readings fix a combination of two parameters but "
             "not each of them.");
}

std::string readings_section(const RunRecord& record) {
  std::vector<std::string> header = {"#Line", "Trial", "Channel"};
  std::vector<double> factors;
  for (size_t c = 0; c < record.control_ids.size(); ++c) {
    double largest = 0;
    for (const ReadingRecord& r : record.readings) largest = std::max(largest, std::abs(r.controls.at(c)));
    const DisplayUnit unit = display_unit(largest, record.control_units.at(c));
    factors.push_back(unit.factor);
    const bool pure = unit.name.empty() || unit.name == "1";
    header.push_back("#" + record.control_ids[c] + (pure ? "" : " [" + unit.name + "]"));
  }
  for (const char* what : {"#Measured", "#σ", "#Fitted", "#Residual"})
    header.push_back(fmt::format("{} [{}]", what, shown_unit(record)));
  header.emplace_back("#Residual / σ");
  std::vector<std::vector<std::string>> rows;
  for (const ReadingRecord& r : record.readings) {
    std::vector<std::string> row = {std::to_string(r.line), r.trial, r.channel};
    for (size_t c = 0; c < factors.size(); ++c) row.push_back(fmt::format("{:.5g}", r.controls[c] / factors[c]));
    const double residual = r.measured - r.predicted;
    const auto shown = [&](double value) {
      return std::isfinite(value) ? fmt::format("{:.3f}", value / shown_factor(record)) : std::string("not known");
    };
    row.insert(row.end(), {shown(r.measured), shown(r.sigma), shown(r.predicted), shown(residual),
                           std::isfinite(residual) ? fmt::format("{:+.2f}", residual / r.sigma) : "not known"});
    rows.push_back(row);
  }
  return "<h2>Every reading</h2>\n" + table(header, rows);
}

std::string setup_section(const RunRecord& record) {
  std::string out;
  if (!record.setup.empty()) {
    std::vector<std::vector<std::string>> rows;
    for (const auto& [name, value] : record.setup) rows.push_back({name, value});
    out += "<h2>Set-up of the model</h2>\n" + table({"What", "How"}, rows);
  }
  if (!record.remarks.empty() || !record.fit.failures.empty()) {
    out += "<h2>Remarks</h2>\n<ul>\n";
    for (const auto& list : {record.remarks, record.fit.failures}) {
      for (const std::string& remark : list) out += "<li>" + escaped(remark) + "</li>\n";
    }
    out += "</ul>\n";
  }
  return out;
}

std::string provenance_section(const RunRecord& record) {
  const Provenance& p = record.provenance;
  const FitResult& fit = record.fit;
  std::vector<std::string> libraries;
  for (const auto& [name, version] : p.libraries) libraries.push_back(name + " " + version);
  std::string all;
  for (const std::string& library : libraries) all += (all.empty() ? "" : ", ") + library;
  std::vector<std::vector<std::string>> rows = {
      {"taut", p.version + (p.commit.empty() ? "" : ", commit " + p.commit)},
      {"Command", "`" + p.command_line},
      {"Started", p.started},
      {"Machine", p.machine},
      {"Libraries", all},
      {"Random seed", p.seed == 0 ? "none, nothing in the fit is random" : std::to_string(p.seed)},
      {"Fit", fmt::format("{}; {} iterations, {} evaluations of the experiment, {} of them failed; {}",
                          name_of(fit.status), fit.iterations, fit.evaluations, fit.failed_evaluations, fit.message)},
      {"Time",
       fmt::format("{} in all; one cold replay of all readings {} with {} factorisations, the fit {} with {}, "
                   "profiles {} with {}",
                   with_unit(p.wall_seconds, "s", 3), with_unit(record.replay_seconds, "s", 3),
                   record.replay_factorisations, with_unit(fit.search.seconds, "s", 3), fit.search.factorisations,
                   with_unit(fit.profiles.seconds, "s", 3), fit.profiles.factorisations)}};
  for (const auto& [path, hash] : p.inputs) rows.push_back({"Input " + path, "`SHA-256 " + hash});
  if (!record.experiment_file.empty()) rows.push_back({"Copies in this folder", record.experiment_file});
  if (!record.data_file.empty()) rows.back()[1] += (record.experiment_file.empty() ? "" : ", ") + record.data_file;
  return "<h2>Where this comes from</h2>\n" + table({"", ""}, rows);
}

}  // namespace

std::string report_html(const RunRecord& record, const std::vector<Figure>& figures) {
  std::string out = fmt::format(
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{}</title>\n<style>{}</style>\n"
      "</head>\n<body>\n",
      escaped(record.simulated ? "SIMULATED DATA: " + record.title : record.title), kStyle);
  if (record.simulated) {
    out += paragraph("SIMULATED DATA: the readings below come from a simulation, not from a bench.", "banner");
  }
  out += fmt::format("<h1>{}</h1>\n", escaped(record.title));
  out += paragraph(fmt::format("{} readings, fitted with taut {} on {}", record.readings.size(),
                               record.provenance.version, record.provenance.started),
                   "origin");
  out += summary(record);
  out += figure_html(figures, "force_displacement");
  out += figure_html(figures, "stress_strain");
  out += figure_html(figures, "recordings");
  out += swing_section(record, figures);
  out += parameter_section(record);
  out += figure_html(figures, "profiles");
  out += goodness_of_fit(record);
  const std::string diagnostics = diagnostic_section(record, figures);
  out += diagnostics;
  if (!diagnostics.empty()) out += "<h3>Reading by reading</h3>\n";
  out += figure_html(figures, "residuals");
  out += figure_html(figures, "effective_stiffness");
  out += mesh_section(record, figures);
  out += figure_html(figures, "deformed_shapes");
  out += correlation_section(record);
  out += readings_section(record);
  out += setup_section(record);
  out += provenance_section(record);
  return out + "</body>\n</html>\n";
}

std::string predictions_csv(const RunRecord& record) {
  std::string out = "line,trial,channel,";
  for (size_t c = 0; c < record.control_ids.size(); ++c) {
    std::string suffix;
    for (const char letter : record.control_units.at(c)) suffix += letter == '/' ? "_per_" : std::string(1, letter);
    out += record.control_ids[c] + (suffix.empty() ? "" : "_" + suffix) + ",";
  }
  const char* unit = record.material_point ? "Pa" : "m";
  for (const char* what : {"measured", "sigma", "predicted", "prediction_se", "residual"})
    out += fmt::format("{}_{},", what, unit);
  out += "normalised_residual\n";
  for (const ReadingRecord& r : record.readings) {
    std::string controls;
    for (const double control : r.controls) controls += plot::field(control) + ",";
    const double residual = r.measured - r.predicted;
    out += plot::field(r.line) + "," + plot::field(r.trial) + "," + plot::field(r.channel) + "," + controls +
           plot::line(r.measured, r.sigma, r.predicted, r.prediction_se, residual, residual / r.sigma);
  }
  return out;
}

void write_run(const RunRecord& record, const std::string& folder) {
  const std::filesystem::path root(folder);
  // The result first: a missing gnuplot must not cost a fit.
  write_file((root / "fit.json").string(), to_json(record));
  write_file((root / "predictions.csv").string(), predictions_csv(record));
  const std::vector<Figure> figures = draw_figures(record, folder);
  write_file((root / "report.html").string(), report_html(record, figures));
}

}  // namespace taut

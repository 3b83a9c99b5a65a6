#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "reports/axes.hpp"
#include "reports/estimate_text.hpp"
#include "reports/html.hpp"
#include "reports/run_sections.hpp"

// The sections of a run's page that say what was found.
namespace taut {
namespace {

using html::bare_number;
using html::Cells;
using html::escaped;
using html::paragraph;
using html::rows_of;
using html::table;

/// What other fits and other people find for parameter `p`.
std::string differences(const RunRecord& record, size_t p) {
  const ParameterEstimate& estimate = record.fit.parameters[p];
  std::string out;
  std::vector<double> changes;
  for (const VariantRecord& variant : record.variants) {
    if (variant.other_model()) continue;
    const double change = p < variant.values.size() ? variant.values[p] / estimate.value - 1 : NAN;
    if (std::isfinite(change)) changes.push_back(change);
  }
  if (!changes.empty()) {
    const char *one = "Another mesh moves", *several = "Other meshes move";
    if (over_strain(record)) one = several = "Another law or choice of readings moves";
    const auto [low, high] = std::ranges::minmax(changes);
    out += paragraph(low == high
                         ? fmt::format("{} {} by {}.", one, estimate.spec.id, percent(low))
                         : fmt::format("{} {} by {} to {}.", several, estimate.spec.id, percent(low), percent(high)));
  }
  for (const ReferenceRecord& reference : record.references) {
    if (reference.parameter != estimate.spec.id || reference.value == 0 || !std::isfinite(estimate.value)) {
      continue;
    }
    out += paragraph(fmt::format("{} differs by {} from {} ({}).", estimate.spec.id,
                                 percent(estimate.value / reference.value - 1),
                                 with_unit(reference.value, estimate.spec.unit), reference.source));
  }
  return out;
}

/// "-0.41 ± 0.2 kPa".
std::string share_of(const Share& share, size_t p, const Shown& shown) {
  const std::string unit = shown.unit.name.empty() ? "" : " " + shown.unit.name;
  const std::string bias = share.bias[p] == 0 ? "" : fmt::format("{:+.2g}", share.bias[p] / shown.unit.factor);
  return std::isfinite(share.error[p])
             ? fmt::format("{}± {:.2g}{}", bias.empty() ? "" : bias + " ", share.error[p] / shown.unit.factor, unit)
             : bias + unit;
}

/// What was assumed, a row each: what it does to every parameter.
std::string share_table(const RunRecord& record) {
  if (record.shares.empty()) return "";
  Cells header = {"What was assumed"};
  for (const ParameterEstimate& estimate : record.fit.parameters) header.push_back("#" + estimate.spec.id);
  header.insert(header.end(), {"Counts", "How"});
  std::vector<Cells> rows;
  std::string notes;
  const auto add = [&](const Share& share) {
    Cells& row = rows.emplace_back();
    row.push_back(share.source);
    for (size_t p = 0; p < record.fit.parameters.size(); ++p)
      row.push_back(std::isfinite(share.bias[p]) ? share_of(share, p, Shown(record.fit.parameters[p])) : "not known");
    const bool at_length = share.how.size() > 60;
    row.insert(row.end(), {share.counted ? "yes" : "no", at_length ? "see below" : share.how});
    if (at_length)
      notes += paragraph(fmt::format("What the {} adds: {} ({:.1f} s).", share.source, share.how, share.seconds));
  };
  for (bool counted : {true, false}) {
    for (const Share& share : record.shares) {
      if (share.counted == counted) add(share);
    }
  }
  return "<h2>What else is in the values</h2>\n" + table(header, rows) + notes +
         paragraph(
             "Taking a share off gives what would have been found without it. Those that count are added to the "
             "noise as root of squares, which makes the interval in all. What does not count is shown for a change "
             "by 1 %: its tolerance is not stated; write it into the experiment, \"17.0 mm +- 0.1 mm\".");
}

/// Rows of closed modules without friction of their lips, and with so much that they stick.
std::string friction_table(const RunRecord& record) {
  if (record.lip_friction.empty()) return "";
  Cells header = {"Channel"};
  for (const AxisRecord& control : record.controls) header.push_back("#" + control.id);
  header.insert(header.end(), {"#Sliding", "#Sticking", "#Stiffness, sliding", "#Stiffness, sticking"});
  std::vector<Cells> rows;
  for (const FrictionRow& one : record.lip_friction) {
    const std::string& unit = channel_axis(record, one.channel).unit;
    Cells& row = rows.emplace_back();
    row.push_back(one.channel);
    for (size_t k = 0; k < one.controls.size(); ++k) row.push_back(text_of(record.controls[k], one.controls[k]));
    row.insert(row.end(), {with_unit(one.sliding, unit), with_unit(one.sticking, unit)});
    for (const double stiffness : {one.sliding_stiffness, one.sticking_stiffness})
      row.push_back(std::isfinite(stiffness) ? with_unit(stiffness, "N/m") : "none");
  }
  return "<h2>Friction of the lips</h2>\n" +
         paragraph(
             "The model has none. Whatever friction there is, readings of loads that grow lie between these two: "
             "lips that slide freely, and lips that cannot slide from where they first touched, unloaded or under a "
             "smaller load.") +
         table(header, rows);
}

/// What each set of further free parameters buys, and what it does to the others.
std::string evidence_table(const RunRecord& record) {
  std::vector<VariantRecord> all = record.variants;
  std::erase_if(all, [](const VariantRecord& variant) { return !variant.other_model(); });
  if (all.empty()) return "";
  all.insert(all.begin(), record.main);
  const std::vector<ParameterEstimate>& parameters = record.fit.parameters;
  Cells header = {"Fit", "#Free", "#Chi squared", "#AIC, less this fit's"};
  for (const ParameterEstimate& estimate : parameters) header.push_back("#" + estimate.spec.id);
  for (const MarkerMisfit& misfit : record.main.markers) header.push_back("#" + misfit.marker);
  header.push_back("Further");
  const auto row_of = [&](const VariantRecord& fit) {
    Cells row = {fit.name, std::to_string(parameters.size() + fit.further.size()), bare_number(fit.chi_squared),
                 fmt::format("{:+.1f}", fit.aic() - record.main.aic())};
    for (size_t p = 0; p < parameters.size(); ++p) {
      const Shown shown(parameters[p]);
      row.push_back(p < fit.values.size()
                        ? shown.number(fit.values[p]) + " ± " + shown.with_unit(fit.standard_errors[p])
                        : fit.status);
    }
    for (const MarkerMisfit& misfit : fit.markers) row.push_back(fmt::format("{:.1f} mm", 1e3 * misfit.rms));
    row.resize(header.size() - 1);
    row.push_back(fit.law.empty() ? further_text(fit) : "sections: " + fit.law);
    return row;
  };
  const std::vector<std::string> limits = spread_over_sets(record);
  std::string text =
      "AIC is chi squared and twice the number of free parameters: the readings ask for what makes it smaller by more "
      "than about 10, and tell nothing of what makes it larger.";
  if (!record.main.markers.empty())
    text += " Under a marker's name stands how far its predicted places are from the measured ones (root mean square).";
  return "<h2>What further parameters buy</h2>\n" + table(header, rows_of(all, row_of)) + paragraph(text) +
         html::list(limits);
}

std::string variant_table(const RunRecord& record) {
  const std::vector<ParameterEstimate>& parameters = record.fit.parameters;
  const bool point = over_strain(record);  // variants are other laws or fewer readings
  Cells header = {"Fit", point ? "Law and modes" : "Mesh", point ? "#Readings" : "#Unknowns"};
  for (const ParameterEstimate& estimate : parameters)
    header.insert(header.end(), {"#" + estimate.spec.id + " ± standard error", "#Change"});
  header.insert(header.end(), {"#Chi squared", "#Time", "Status"});
  std::vector<VariantRecord> all = record.variants;
  std::erase_if(all, [](const VariantRecord& variant) { return variant.other_model(); });
  if (all.empty()) return "";
  VariantRecord& main = *all.insert(all.begin(), record.main);
  if (main.name != "this fit") main.name += " (this fit)";
  for (size_t p = 0; record.main.values.empty() && p < parameters.size(); ++p) {
    main.values.push_back(parameters[p].value);
    main.standard_errors.push_back(parameters[p].standard_error);
  }
  const auto row_of = [&](const VariantRecord& variant) {
    Cells row = {variant.name, variant.mesh, std::to_string(variant.unknowns)};
    for (size_t p = 0; p < parameters.size(); ++p) {
      const double value = p < variant.values.size() ? variant.values[p] : NAN;
      const double se = p < variant.standard_errors.size() ? variant.standard_errors[p] : NAN;
      const bool known = std::isfinite(value);
      const Shown shown(parameters[p]);
      row.push_back(known ? shown.number(value) + " ± " + shown.with_unit(se) : point ? "none" : "no result");
      row.push_back(&variant == &main || !known ? "" : percent(value / parameters[p].value - 1));
    }
    row.insert(row.end(), {bare_number(variant.chi_squared), with_unit(variant.seconds, "s", 3), variant.status});
    return row;
  };
  return (point ? "<h2>What law and readings do to the number</h2>\n" : "<h2>What the mesh does to the number</h2>\n") +
         table(header, rows_of(all, row_of));
}

std::string reference_table(const RunRecord& record) {
  if (record.references.empty()) return "";
  std::vector<Cells> rows;
  for (const ReferenceRecord& reference : record.references) {
    for (const ParameterEstimate& estimate : record.fit.parameters) {
      if (estimate.spec.id == reference.parameter)
        rows.push_back({reference.parameter, with_unit(reference.value, estimate.spec.unit),
                        Shown(estimate).with_unit(estimate.value), percent(estimate.value / reference.value - 1),
                        reference.source});
    }
  }
  return "<h2>Values from elsewhere</h2>\n" +
         table({"Parameter", "#Reference", "#This fit", "#This fit differs by", "Source"}, rows);
}

/// How the robust fit was made, and what it sets aside.
std::string robust_text(const RunRecord& record) {
  if (record.robust.method.empty()) return "";
  const std::string outliers = robust_outliers(record);
  return paragraph(fmt::format(
      "Robust fit: as if the noise had the distribution {}, so that readings far off count little. {}",
      record.robust.method, outliers.empty() ? "It sets none aside." : "It all but sets aside: " + outliers + "."));
}

}  // namespace

std::optional<Section> answer(const RunRecord& record) {
  const FitResult& fit = record.fit;
  std::string out = "<div class=\"answer\">\n";
  const bool converged = fit.status == FitStatus::converged;
  if (!converged) out += paragraph(fmt::format("No result ({}): {}", name_of(fit.status), fit.message), "warning");
  if (converged && misses_readings(fit))
    out +=
        paragraph("The model does not describe the readings: what its parameters are worth is not known.", "warning");
  if (const std::string first = look_first(record); !first.empty()) out += paragraph(first + ".", "warning");
  if (!converged) return Section{out + "</div>\n"};
  for (const ParameterEstimate& estimate : fit.parameters) {
    const Shown shown(estimate);
    const bool in_all = estimate.total_lower95 || estimate.total_upper95;
    const size_t j = static_cast<size_t>(&estimate - fit.parameters.data());
    const std::string but = but_unknown(record, j);
    const std::string of = !in_all ? " (noise alone)" : but.empty() ? "" : " (in all" + but + ": not known)";
    out +=
        paragraph(fmt::format("{} = {}, 95 % interval {}{}, {}.", estimate.spec.id, shown.with_unit(estimate.value),
                              in_all ? shown.total(estimate) : shown.interval(estimate), of, name_of(estimate.verdict)),
                  "number");
    if (const std::string limit = limit_text(record, j); !limit.empty()) out += paragraph(limit);
  }
  if (can_judge(fit) && fits(fit)) {
    out += paragraph("The model fits the readings within their declared noise.");
  } else if (can_judge(fit)) {
    out += paragraph(
        fmt::format("The model does not fit within the declared noise: it misses the readings by {:.1f} standard "
                    "deviations (root mean square). The interval counts that noise only, not what the model lacks.",
                    std::sqrt(misfit_ratio(fit))));
  }
  for (size_t p = 0; p < fit.parameters.size(); ++p) out += differences(record, p);
  for (const EquilibriaRecord& rows : record.equilibria) {
    if (rows.has_to_be_said()) out += paragraph("Of several equilibria: " + rows.text + ".", "warning");
  }
  return Section{out + "</div>\n"};
}

std::optional<Section> fitted_parameters(const RunRecord& record) {
  std::vector<Cells> rows;
  Cells header = {"Parameter", "Meaning", "#Value", "#Standard error"};
  std::string explanations;
  header.insert(header.end(),
                {"#95 % interval in all", "#95 % interval of the noise", "Verdict", "#Start", "#Allowed in the fit"});
  for (size_t p = 0; p < record.fit.parameters.size(); ++p) {
    const ParameterEstimate& estimate = record.fit.parameters[p];
    const Shown shown(estimate);
    const std::string unit = estimate.spec.unit;
    Cells& row = rows.emplace_back();
    row = {estimate.spec.id, estimate.spec.meaning, shown.with_unit(estimate.value),
           shown.with_unit(estimate.standard_error)};
    if (!record.robust.method.empty())
      row.push_back(shown.number(record.robust.values[p]) + " ± " + shown.with_unit(record.robust.standard_errors[p]));
    row.insert(row.end(),
               {shown.total(estimate), shown.interval(estimate), std::string(name_of(estimate.verdict)),
                with_unit(estimate.start, unit), bound(estimate.lower, unit) + " to " + bound(estimate.upper, unit)});
    if (!estimate.explanation.empty())
      explanations += fmt::format("<p><b>{}</b>: {}</p>\n", escaped(estimate.spec.id), escaped(estimate.explanation));
  }
  if (!record.robust.method.empty()) header.insert(header.begin() + 4, "#Robust fit");
  return Section{
      "<h2>What was fitted</h2>\n" + table(header, rows) + explanations + robust_text(record) +
      paragraph("\"Open\" means that the readings set no limit on that side. Standard errors and intervals come from "
                "the declared standard deviations of the readings alone; the interval in all adds what counts below. "
                "Neither knows of a law that is wrong.") +
      share_table(record) + friction_table(record)};
}

std::optional<Section> variants_and_references(const RunRecord& record) {
  return with_figure(evidence_table(record) + variant_table(record) + reference_table(record), plot::variants(record));
}

std::optional<Section> correlations(const RunRecord& record) {
  const std::vector<ParameterEstimate>& parameters = record.fit.parameters;
  const Eigen::MatrixXd& correlation = record.fit.correlation;
  const auto n = static_cast<Eigen::Index>(parameters.size());
  if (n < 2 || correlation.rows() != n || correlation.cols() != n) return std::nullopt;
  Cells header = {""};
  std::vector<Cells> rows;
  for (Eigen::Index i = 0; i < n; ++i) {
    const std::string& id = parameters[static_cast<size_t>(i)].spec.id;
    header.push_back("#" + id);
    Cells& row = rows.emplace_back(1, id);
    for (const double value : correlation.row(i))
      row.push_back(std::isfinite(value) ? fmt::format("{:.3f}", value) : "not known");
  }
  return Section{
      "<h2>How the parameters hang together</h2>\n<div id=\"correlations\">\n" + table(header, rows) + "</div>\n" +
      paragraph("Correlation of the estimates. Near +1 or -1, the readings fix a combination of two parameters but "
                "not each of them.")};
}

}  // namespace taut

#include "experiments/cli/print.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>

#include "reports/axes.hpp"
#include "reports/diagnostic.hpp"
#include "reports/estimate_text.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

/// An error in the unit that its value is shown in: "0.36" beside "61.15 kPa".
std::string bare_beside(double value, double error, std::string_view si_unit) {
  return fmt::format("{:.2g}", error / display_unit(value, si_unit).factor);
}

/// The same with the unit: "0.36 kPa".
std::string beside(double value, double error, std::string_view si_unit) {
  const DisplayUnit unit = display_unit(value, si_unit);
  return bare_beside(value, error, si_unit) + (unit.name == "1" ? "" : " " + unit.name);
}

std::string interval_text(const ParameterEstimate& e, const std::optional<double>& lower,
                          const std::optional<double>& upper) {
  auto end = [&](const std::optional<double>& value) {
    return value ? with_unit(*value, e.spec.unit) : std::string("open");
  };
  return fmt::format("{} to {}", end(lower), end(upper));
}

/// Numbers whose tolerance nobody stated, with what 1 % of each does to the j-th parameter; the largest first, none
/// that is small beside the noise.
std::string unstated_text(const RunRecord& record, size_t j) {
  const ParameterEstimate& e = record.fit.parameters[j];
  std::vector<const Share*> shares;
  for (const Share& share : record.shares) {
    if (!share.counted && share.error[j] > 0.1 * e.standard_error) shares.push_back(&share);
  }
  std::ranges::sort(shares, std::greater(), [&](const Share* share) { return share->error[j]; });
  std::string text;
  for (size_t k = 0; k < shares.size() && k < 6; ++k)
    text += fmt::format("{}{} {}", k == 0 ? "" : ", ", shares[k]->source,
                        beside(e.value, shares[k]->error[j], e.spec.unit));
  if (shares.size() > 6) text += fmt::format(" and {} more", shares.size() - 6);
  return text.empty() ? "" : "  not counted, for 1 % of each, since no tolerance is stated: " + text + "\n";
}

void print_parameter(const RunRecord& record, size_t j) {
  const ParameterEstimate& e = record.fit.parameters[j];
  if (record.fit.status != FitStatus::converged) {
    fmt::print("{}: the search ended at {}, which is no result\n", e.spec.id, with_unit(e.value, e.spec.unit));
    return;
  }
  std::string shares, biases;
  for (const Share& share : record.shares) {
    const double most = std::abs(share.bias[j]) + (std::isfinite(share.error[j]) ? share.error[j] : 0);
    if (!std::isfinite(e.standard_error) || most <= 1e-3 * e.standard_error || (!share.counted && std::isfinite(most)))
      continue;
    shares +=
        fmt::format("{}{} ({})", shares.empty() ? "; may be off by " : ", ",
                    std::isfinite(most) ? bare_beside(e.value, most, e.spec.unit) : "an unknown amount", share.source);
    biases += fmt::format("  {}\n", describe(share, e, j));
  }
  const std::string total =
      e.total_lower95 || e.total_upper95
          ? fmt::format("95 % interval {} in all{}, ", interval_text(e, e.total_lower95, e.total_upper95),
                        but_unknown(record, j))
          : "95 % interval ";
  const std::string limit = limit_text(record, j);
  fmt::print("{} = {}, standard error {} (noise){}; {}{} of the noise: {}\n  {}\n{}{}{}", e.spec.id,
             with_unit(e.value, e.spec.unit),
             std::isfinite(e.standard_error) ? bare_beside(e.value, e.standard_error, e.spec.unit) : "unknown", shares,
             total, interval_text(e, e.lower95, e.upper95), name_of(e.verdict), e.explanation,
             limit.empty() ? "" : "  " + limit + "\n", biases, unstated_text(record, j));
  if (!record.robust.method.empty())
    fmt::print("  robust fit: {} +- {}\n", with_unit(record.robust.values[j], e.spec.unit),
               bare_beside(record.robust.values[j], record.robust.standard_errors[j], e.spec.unit));
}

/// What would explain the misfit, best first.
void print_explanations(const RunRecord& record) {
  const std::vector<Explanation> told = telling(record.explanations);
  if (told.empty()) return;
  fmt::print(
      "what would explain that, best first and each by itself, to first order (none of it is shown; p is corrected for "
      "all that was tried):\n");
  for (const Explanation& e : told) {
    const std::string then = parameters_with(record, e), unlike = cannot_be_told_from(e);
    fmt::print("  {:>8.4g} for {:<4} p {:<12} {}{}{}\n", e.chi_squared, e.dof, small_probability(e.p_value), e.what,
               then.empty() ? "" : "; then " + then, unlike.empty() ? "" : "; " + unlike);
  }
}

void print_robust(const RunRecord& record) {
  if (record.robust.method.empty()) return;
  const std::string outliers = robust_outliers(record);
  fmt::print("robust fit ({}): {}\n", record.robust.method,
             outliers.empty() ? "no reading is set aside" : "all but sets aside " + outliers);
}

void print_goodness(const FitResult& fit) {
  fmt::print("chi squared {:.4g} for {} degrees of freedom (p = {:.2g})", fit.chi_squared, fit.dof, fit.chi_squared_p);
  if (fit.lack_of_fit.available)
    fmt::print("; lack of fit F = {:.3g} (p = {:.2g})", fit.lack_of_fit.F, fit.lack_of_fit.p_value);
  fmt::print("\n");
  if (fit.chi_squared_p < 0.05 && fit.dof > 0 && !misses_readings(fit)) {
    fmt::print(
        "  the curve misses the readings by more than the declared sigmas: model or sigmas are not right somewhere; if "
        "it were noise, standard errors would be {:.2g} times as large\n",
        std::sqrt(fit.chi_squared / fit.dof));
  }
}

void print_markers(const VariantRecord& fit) {
  std::string text;
  for (const MarkerMisfit& misfit : fit.markers)
    text += fmt::format("{}{} {:.1f} mm", text.empty() ? "" : ", ", misfit.marker, 1e3 * misfit.rms);
  if (!text.empty()) fmt::print("  distance from the measured places (root mean square): {}\n", text);
}

void print_variant(const RunRecord& record, const VariantRecord& variant) {
  std::string values;
  for (size_t j = 0; j < variant.values.size(); ++j) {
    const ParameterSpec& spec = record.fit.parameters[j].spec;
    if (std::isfinite(variant.values[j]))
      values += fmt::format("{}{} = {}", values.empty() ? "" : ", ", spec.id, with_unit(variant.values[j], spec.unit));
  }
  if (over_strain(record) && !values.empty())
    values += fmt::format("; chi squared {:.4g} of {} readings", variant.chi_squared, variant.unknowns);
  if (variant.other_model()) {
    fmt::print("variant {:<22} chi squared {:.4g}, AIC {:+.1f}; {}; {}\n", variant.name, variant.chi_squared,
               variant.aic() - record.main.aic(), values,
               variant.law.empty() ? further_text(variant) : variant.law + " sections");
    print_markers(variant);
    return;
  }
  fmt::print("variant {:<22} {:<48} {}\n", variant.name, variant.mesh, values.empty() ? variant.status : values);
}

}  // namespace

void print_failures(const std::vector<std::string>& failures) {
  for (const std::string& failure : failures) fmt::print(stderr, "taut: {}\n", failure);
}

std::string key(const std::string& name, const RunRecord& record, const std::string& channel) {
  return name + "_" + column_suffix(channel_axis(record, channel).unit);
}

void print_readings(const RunRecord& record) {
  fmt::print("{:>5}  {:<12} {:<14} {:<28} {:>11} {:>11} {:>9} {:>8}\n", "line", "trial", "channel", "controls",
             "measured", "predicted", "residual", "/sigma");
  for (const ReadingRecord& reading : record.readings) {
    std::string controls;
    for (size_t k = 0; k < reading.controls.size(); ++k)
      controls += fmt::format("{}{}", k == 0 ? "" : ", ", text_of(record.controls[k], reading.controls[k]));
    const WrittenUnit unit = written_unit(channel_axis(record, reading.channel).unit);
    if (std::isnan(reading.measured)) {  // of a plan
      fmt::print("{:>5}  {:<12} {:<14} {:<28} {:>11} {:>8.3f} {}\n", reading.line, reading.trial, reading.channel,
                 controls, "", reading.predicted / unit.factor, unit.label);
      continue;
    }
    const double residual = reading.measured - reading.predicted;
    const char* excluded = reading.excluded ? "  not fitted" : "";
    fmt::print("{:>5}  {:<12} {:<14} {:<28} {:>8.3f} {} {:>8.3f} {} {:>6.3f} {} {:>8.2f}{}\n", reading.line,
               reading.trial, reading.channel, controls, reading.measured / unit.factor, unit.label,
               reading.predicted / unit.factor, unit.label, residual / unit.factor, unit.label,
               residual / reading.sigma, excluded);
  }
}

void print_swings(const RunRecord& record) {
  fmt::print("{:<16} {:<12} {:>12} {:>12} {:>8} {:>12} {:>12} {:>8}\n", "recording", "channel", "frequency",
             "simulated", "", "decay", "simulated", "");
  for (const SwingRecord& s : record.swings) {
    fmt::print("{:<16} {:<12} {:>9.3f} Hz {:>9.3f} Hz {:>+6.1f} % {:>8.3f} 1/s {:>8.3f} 1/s {:>+6.1f} %\n", s.recording,
               s.channel, s.frequency, s.predicted_frequency, 100 * (s.predicted_frequency / s.frequency - 1), s.decay,
               s.predicted_decay, 100 * (s.predicted_decay / s.decay - 1));
  }
}

void print_cables(const std::vector<CableState>& states) {
  for (const CableState& state : states) {
    fmt::print("cable {:<10} {:<40} tension {:>9}, length {}\n", state.cable, state.where,
               with_unit(state.tension, "N"), with_unit(state.length, "m", 5));
  }
}

void print_fit(const RunRecord& record) {
  const FitResult& fit = record.fit;
  const auto estimate_of = [&](const std::string& id) {
    return std::find_if(fit.parameters.begin(), fit.parameters.end(),
                        [&](const ParameterEstimate& e) { return e.spec.id == id; });
  };
  if (record.simulated) fmt::print("SIMULATED DATA: the readings were made by a program, not measured.\n");
  if (fit.status != FitStatus::converged) {
    fmt::print("NO RESULT ({}): {}\n", name_of(fit.status), fit.message);
  } else if (misses_readings(fit)) {
    fmt::print(
        "THE MODEL DOES NOT DESCRIBE THE READINGS: it misses them by {:.2g} standard deviations (root mean square); "
        "look for the readings that it misses most, units and signs, dimensions and the law, before the values below\n",
        std::sqrt(fit.chi_squared / fit.dof));
  }
  if (const std::string first = look_first(record); !first.empty()) fmt::print("{}\n", first);
  if (const std::string excluded = excluded_text(record); !excluded.empty()) fmt::print("{}\n", excluded);
  for (size_t j = 0; j < fit.parameters.size(); ++j) print_parameter(record, j);
  print_goodness(fit);
  for (const EquilibriaRecord& rows : record.equilibria) {
    if (rows.has_to_be_said()) fmt::print("{}\n", rows.text);
  }
  if (const std::string parts = held_out_text(record); !parts.empty()) fmt::print("{}\n", parts);
  if (const std::string friction = friction_text(record); !friction.empty()) fmt::print("{}\n", friction);
  print_explanations(record);
  print_robust(record);
  for (const DiagnosticRecord& diagnostic : record.diagnostics) {
    const auto e = estimate_of(diagnostic.parameter);
    if (e == fit.parameters.end()) continue;
    fmt::print("from {} alone: {} = {} +- {} ({} readings)\n", diagnostic.part, e->spec.id,
               with_unit(diagnostic.value, e->spec.unit),
               beside(diagnostic.value, diagnostic.standard_error, e->spec.unit), diagnostic.readings);
  }
  for (const DiagnosticGroup& group : diagnostic_groups(record)) fmt::print("  {}\n", interpretation(record, group));
  print_markers(record.main);
  for (const VariantRecord& variant : record.variants) print_variant(record, variant);
  for (const std::string& limit : spread_over_sets(record)) fmt::print("{}\n", limit);
  for (const ReferenceRecord& reference : record.references) {
    const auto e = estimate_of(reference.parameter);
    if (e == fit.parameters.end()) continue;
    fmt::print("for comparison {} = {} ({}): ours is {:+.1f} %\n", e->spec.id, with_unit(reference.value, e->spec.unit),
               reference.source, 100 * (e->value / reference.value - 1));
  }
  if (!record.swings.empty()) print_swings(record);
}

void print_json(const nlohmann::ordered_json& json, int indent) {
  fmt::print("{}\n", json.dump(indent, ' ', false, nlohmann::ordered_json::error_handler_t::replace));
}

void print_check(const RunRecord& record, const ParameterTable& table, const std::vector<FreeParameter>& free) {
  fmt::print("{}\n", record.title);
  for (const auto& [label, text] : record.setup) fmt::print("  {:<22} {}\n", label, text);
  for (const FreeParameter& p : free) {
    const ParameterSpec& spec = table[p.index];
    fmt::print("  {:<22} start {}, bounds {} to {}\n", "free " + spec.id, with_unit(p.start, spec.unit),
               with_unit(p.lower, spec.unit), with_unit(p.upper, spec.unit));
  }
  if (free.empty())
    fmt::print("  nothing is free: `taut fit` needs at least one [fit.free.ID]; parameters: {}\n", join(table.ids()));
  for (const std::string& warning : record.remarks) fmt::print("warning: {}\n", warning);
  if (record.remarks.empty()) fmt::print("no problems found\n");
}

}  // namespace taut

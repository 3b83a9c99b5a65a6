#include "reports/estimate_text.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "calib/fit/distributions.hpp"
#include "reports/axes.hpp"
#include "sim/core/error.hpp"

namespace taut {

std::string percent(double ratio) {
  return std::isfinite(ratio) ? fmt::format("{:+.1f} %", 100 * ratio) : "not known";
}

std::string probability(double p) {
  if (!std::isfinite(p)) return "not known";
  return p < 0.001 ? "less than 0.001" : fmt::format("{:.3f}", p);
}

std::string bound(double value, const std::string& unit) {
  return std::isfinite(value) ? with_unit(value, unit) : "no limit";
}

double misfit_ratio(const FitResult& fit) {
  return fit.dof > 0 ? fit.chi_squared / fit.dof : NAN;
}

std::string outlier_text(const RunRecord& record) {
  const ReadingRecord* worst = nullptr;
  double most = 0;
  for (const ReadingRecord& reading : record.readings) {
    if (reading.excluded) continue;
    const double part = std::pow((reading.measured - reading.predicted) / reading.sigma, 2);
    if (!(part > most)) continue;
    most = part;
    worst = &reading;
  }
  if (worst == nullptr || !(most > 0.5 * record.fit.chi_squared)) return "";
  const std::string remedy = over_time(record) ? "take it out of the bench file"
                                               : fmt::format("leave it out ([bench] exclude = [{}])", worst->line);
  return fmt::format("line {} alone makes {:.0f} % of chi squared: read it again, or {}", worst->line,
                     100 * most / record.fit.chi_squared, remedy);
}

size_t fitted_readings(const RunRecord& record) {
  return static_cast<size_t>(
      std::ranges::count_if(record.readings, [](const ReadingRecord& reading) { return !reading.excluded; }));
}

std::string excluded_text(const RunRecord& record) {
  std::set<int> lines;
  for (const ReadingRecord& reading : record.readings) {
    if (reading.excluded) lines.insert(reading.line);
  }
  if (lines.empty()) return "";
  const size_t count = record.readings.size() - fitted_readings(record);
  return fmt::format("Not fitted: line{} {} ({} reading{}).", lines.size() == 1 ? "" : "s", fmt::join(lines, ", "),
                     count, count == 1 ? "" : "s");
}

std::string look_first(const RunRecord& record) {
  const std::vector<Explanation> told = telling(record.explanations);
  const bool to_say = record.fit.status == FitStatus::converged && misses_readings(record.fit);
  if (told.empty()) return to_say ? outlier_text(record) : "";
  const Explanation& best = told.front();
  const bool all = chi_squared_probability(best.chi_squared, best.dof) >= telling_p_value;
  std::string text = fmt::format(
      "What would explain {}the misfit: {} (chi squared {:.4g} for {} degrees of freedom instead of {:.4g} for {})",
      all ? "" : "a part of ", best.what, best.chi_squared, best.dof, record.fit.chi_squared, record.fit.dof);
  const std::string unlike = cannot_be_told_from(best);
  if (!unlike.empty()) text += "; " + unlike;
  if (best.lines.size() == 1)
    text += fmt::format("; read it again, or leave it out ([bench] exclude = [{}])", best.lines.front());
  return text;
}

std::vector<std::string> spread_over_sets(const RunRecord& record) {
  std::vector<std::string> sentences;
  for (size_t p = 0; p < record.fit.parameters.size(); ++p) {
    const ParameterEstimate& e = record.fit.parameters[p];
    double low = e.value, high = e.value;
    int sets = 1;
    for (const VariantRecord& variant : record.variants) {
      if (!variant.other_model() || p >= variant.values.size()) continue;
      ++sets;
      low = std::min(low, variant.values[p]);
      high = std::max(high, variant.values[p]);
    }
    if (sets < 2) continue;
    const std::string range =
        fmt::format("{} to {} over {} sets of free parameters and laws, standard error {}", with_unit(low, e.spec.unit),
                    with_unit(high, e.spec.unit), sets, with_unit(e.standard_error, e.spec.unit, 2));
    sentences.push_back(
        high - low > 2 * e.standard_error
            ? fmt::format("{}: {}; which set is right limits it more than the noise does", e.spec.id, range)
            : fmt::format("{}: {}", e.spec.id, range));
  }
  return sentences;
}

std::string further_text(const VariantRecord& variant) {
  std::vector<std::string> texts;
  for (const FurtherRecord& one : variant.further) {
    const double shown = std::isfinite(one.standard_error) ? one.standard_error : 0;
    const DisplayUnit unit = display_unit(std::max(std::abs(one.value), shown), one.unit);
    const std::string error = std::isfinite(one.standard_error)
                                  ? fmt::format("{:.2g}", one.standard_error / unit.factor)
                                  : std::string("not known");
    texts.push_back(fmt::format("{} = {:.3g} ± {}{}", one.id, one.value / unit.factor, error,
                                unit.name == "1" ? "" : " " + unit.name));
    if (one.verdict != name_of(Verdict::well_determined)) texts.back() += fmt::format(" ({})", one.verdict);
  }
  return join(texts);
}

std::string held_out_verdict(const RunRecord& record) {
  std::vector<std::string> odd;
  for (const HeldOut& part : record.held_out) {
    if (part.p_value < telling_held_out(record.held_out.size())) odd.push_back(part.part);
  }
  if (odd.empty()) return "Left out one by one, the readings at each are what those at the others predict";
  return fmt::format(
      "The readings at {} are NOT what those at the others predict: one model does not serve them all, and its "
      "intervals are too narrow where nothing was measured",
      join(odd, " and "));
}

std::string held_out_text(const RunRecord& record) {
  if (record.held_out.empty()) return "";
  std::vector<std::string> parts;
  for (const HeldOut& part : record.held_out) {
    std::string& text = parts.emplace_back(part.part);
    text += part.dof == 0 ? ": cannot be predicted"
                          : fmt::format(": chi squared {:.3g} for {}, p = {}", part.chi_squared, part.dof,
                                        small_probability(part.p_value));
    if (!part.own.empty())
      text += fmt::format("; without it {} would be three times less certain or worse", join(part.own, " and "));
  }
  return fmt::format("{} (to first order):\n  {}", held_out_verdict(record), join(parts, "\n  "));
}

std::string small_probability(double p) {
  return p < 1e-99 ? "below 1e-99" : fmt::format("{:.1g}", p);
}

std::string parameters_with(const RunRecord& record, const Explanation& explanation) {
  std::string text;
  for (size_t j = 0; j < record.fit.parameters.size(); ++j) {
    const ParameterEstimate& e = record.fit.parameters[j];
    const bool determined = e.verdict == Verdict::well_determined || e.verdict == Verdict::weakly_determined ||
                            e.verdict == Verdict::of_a_wrong_model;
    if (determined)
      text += fmt::format("{}{} = {}", text.empty() ? "" : ", ", e.spec.id,
                          taut::with_unit(e.value + explanation.shifts[j], e.spec.unit));
  }
  return text;
}

std::string cannot_be_told_from(const Explanation& explanation) {
  std::string text;
  if (!explanation.like.empty()) text = "the readings cannot tell it from " + join(explanation.like, " or ");
  if (!explanation.like_parameters.empty())
    text += (text.empty() ? "" : "; ") + std::string("nearly all of it is made up for by ") +
            join(explanation.like_parameters, " and ");
  return text;
}

std::string robust_outliers(const RunRecord& record) {
  constexpr size_t most = 4;
  const size_t count = record.robust.outliers.size();
  std::string text;
  for (size_t i = 0; i < std::min(most, count); ++i) {
    const OutlierRecord& outlier = record.robust.outliers[i];
    const std::string& unit = channel_axis(record, outlier.channel).unit;
    text += fmt::format("{}line {} ({}): {}, {:.1f} sigmas off {}", text.empty() ? "" : "; ", outlier.line,
                        outlier.channel, taut::with_unit(outlier.measured, unit), std::abs(outlier.off),
                        taut::with_unit(outlier.expected, unit));
  }
  return count <= most ? text : text + fmt::format("; and {} more", count - most);
}

bool can_judge(const FitResult& fit) {
  return fit.dof > 0 && std::isfinite(fit.chi_squared);
}

bool fits(const FitResult& fit) {
  return fit.chi_squared_p >= 0.05;
}

std::string but_unknown(const RunRecord& record, size_t j) {
  const TotalInterval total = total_interval(record.fit.parameters[j], record.shares, j);
  return total.without.empty() ? "" : " but the " + join(total.without, ", the ");
}

std::string friction_text(const RunRecord& record) {
  if (record.lip_friction.empty()) return "";
  const auto change = [](const FrictionRow& row) { return std::abs(row.sticking / row.sliding - 1); };
  const FrictionRow& most = *std::ranges::max_element(record.lip_friction, {}, change);
  const std::string& unit = channel_axis(record, most.channel).unit;
  std::vector<std::string> controls;
  for (size_t k = 0; k < most.controls.size(); ++k)
    controls.push_back(record.controls[k].id + " = " + text_of(record.controls[k], most.controls[k]));
  std::string text = fmt::format(
      "friction of the lips, between none and any: it changes {} closed row{} by {:.2g} % at most ({}: {} {} with lips "
      "that slide, {} with lips that stick",
      record.lip_friction.size(), record.lip_friction.size() == 1 ? "" : "s", 100 * change(most), join(controls),
      most.channel, with_unit(most.sliding, unit), with_unit(most.sticking, unit));
  if (std::isfinite(most.sliding_stiffness))
    text +=
        fmt::format("; {} and {}", with_unit(most.sliding_stiffness, "N/m"), with_unit(most.sticking_stiffness, "N/m"));
  return text + ")";
}

std::string remedy_of(const Share& share) {
  const std::string& source = share.source;
  if (source == "mesh") return "refine the mesh";
  if (source == "contact gap") return "make contact_gap smaller";
  if (source == "plane section") return "fit with model = \"solid\"";
  if (source == "model" || source == "rigidity") return "fit with model = \"full\"";
  if (source == "friction of the lips") return "read rows whose lips are open";
  if (source == "section law") return "see which the readings want, by a [[fit.variant]] with the other rod_section";
  if (source.starts_with("scatter")) return "look for what differs from one to the next";
  return "measure it better";
}

std::string limit_text(const RunRecord& record, size_t j) {
  const ParameterEstimate& e = record.fit.parameters[j];
  if (!std::isfinite(e.standard_error)) return "";
  const auto most = [&](const Share& share) {
    return std::isfinite(share.bias[j]) ? std::abs(share.bias[j]) + std::max(0.0, share.error[j]) : 0;
  };
  const Share *counted = nullptr, *unstated = nullptr;
  for (const Share& share : record.shares) {
    const Share*& largest = share.counted ? counted : unstated;
    if (largest == nullptr || most(share) > most(*largest)) largest = &share;
  }
  const auto size = [&](const Share& share) {
    const DisplayUnit unit = display_unit(e.value, e.spec.unit);
    return fmt::format("{:.2g}{}", most(share) / unit.factor, unit.name == "1" ? "" : " " + unit.name);
  };
  const double noise = z95 * e.standard_error;
  std::string text;
  if (counted != nullptr && most(*counted) > noise) {
    text = fmt::format("Limited by the {} ({}) rather than the noise: {}.", counted->source, size(*counted),
                       remedy_of(*counted));
  }
  if (unstated != nullptr && most(*unstated) > noise)
    text += fmt::format("{}1 % of {} is worth {}, more than the noise: measure it and state its tolerance.",
                        text.empty() ? "" : " ", unstated->source, size(*unstated));
  return text;
}

Shown::Shown(const ParameterEstimate& estimate) : unit(display_unit(estimate.value, estimate.spec.unit)) {
  if (unit.name == "1") unit.name = "";
  double resolution = estimate.standard_error;
  if (!std::isfinite(resolution) || resolution <= 0) resolution = std::abs(estimate.value) / 100;
  if (std::isfinite(resolution) && resolution > 0)
    decimals = std::clamp(1 - static_cast<int>(std::floor(std::log10(resolution / unit.factor))), 0, 9);
}

std::string Shown::number(double value) const {
  return std::isfinite(value) ? fmt::format("{:.{}f}", value / unit.factor, decimals) : "not known";
}

std::string Shown::with_unit(double value) const {
  return number(value) + (unit.name.empty() || !std::isfinite(value) ? "" : " " + unit.name);
}

std::string Shown::interval(const ParameterEstimate& estimate) const {
  return interval(estimate, estimate.lower95, estimate.upper95);
}

std::string Shown::total(const ParameterEstimate& estimate) const {
  if (!estimate.total_lower95 && !estimate.total_upper95) return "not asked for";
  return interval(estimate, estimate.total_lower95, estimate.total_upper95);
}

std::string Shown::interval(const ParameterEstimate& estimate, const std::optional<double>& lower,
                            const std::optional<double>& upper) const {
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

}  // namespace taut

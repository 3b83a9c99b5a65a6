#include "reports/estimate_text.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

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
    const double part = std::pow((reading.measured - reading.predicted) / reading.sigma, 2);
    if (!(part > most)) continue;
    most = part;
    worst = &reading;
  }
  if (worst == nullptr || !(most > 0.5 * record.fit.chi_squared)) return "";
  return fmt::format("line {} alone makes {:.0f} % of chi squared: read it again, or take it out of the bench file",
                     worst->line, 100 * most / record.fit.chi_squared);
}

bool can_judge(const FitResult& fit) {
  return fit.dof > 0 && std::isfinite(fit.chi_squared);
}

bool fits(const FitResult& fit) {
  return fit.chi_squared_p >= 0.05;
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
  const double noise = 1.96 * e.standard_error;
  std::string text;
  if (counted != nullptr && most(*counted) > noise) {
    const char* remedy = counted->source == "mesh"            ? "refine the mesh"
                         : counted->source == "contact gap"   ? "make contact_gap smaller"
                         : counted->source == "plane section" ? "fit with model = \"solid\""
                                                              : "measure it better, or free it";
    text = fmt::format("Limited by the {} ({}) rather than the noise: {}. ", counted->source, size(*counted), remedy);
  }
  if (unstated != nullptr && most(*unstated) > noise)
    text += fmt::format("1 % of {} is worth {}, more than the noise: measure it and state its tolerance. ",
                        unstated->source, size(*unstated));
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

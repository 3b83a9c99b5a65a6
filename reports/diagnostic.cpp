#include "reports/diagnostic.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "reports/axes.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

/// The law of a region, from the lines of the set-up; "" when it does not stand there.
std::string law_of(const RunRecord& record, const std::string& region) {
  for (const auto& [name, value] : record.setup) {
    if (name == "material " + region) return value.substr(0, value.find(','));
  }
  return "";
}

/// From the first part to the last, in standard errors of the difference; 0 where the parts between do not follow.
double change_over(const std::vector<const DiagnosticRecord*>& parts) {
  const auto rise = [](const DiagnosticRecord& a, const DiagnosticRecord& b) {
    return (b.value - a.value) / std::hypot(a.standard_error, b.standard_error);
  };
  const double whole = rise(*parts.front(), *parts.back());
  if (!(std::abs(whole) > 2)) return 0;
  for (size_t i = 1; i < parts.size(); ++i) {
    const double step = rise(*parts[i - 1], *parts[i]);
    if (whole < 0 ? step > 1 : step < -1) return 0;
  }
  return whole;
}

/// What makes a foam soften more than the model says.
std::string softer_law(const RunRecord& record, const std::string& parameter) {
  if (!parameter.starts_with("E_")) return "the model is too stiff there: look at what the load meets last";
  const std::string region = parameter.substr(2);
  if (law_of(record, region) == "ogden_hill") {
    return fmt::format(
        "the foam softens under compression more than its exponent allows; free alpha_{} or start it higher", region);
  }
  return fmt::format(
      "the foam softens under compression, which a neo-Hookean law does not do; try law = \"ogden_hill\" in "
      "[materials.{}]",
      region);
}

}  // namespace

std::vector<DiagnosticGroup> diagnostic_groups(const RunRecord& record) {
  std::vector<DiagnosticGroup> groups;
  for (const ParameterEstimate& estimate : record.fit.parameters) {
    DiagnosticGroup group{&estimate, "", {}};
    for (const DiagnosticRecord& diagnostic : record.diagnostics) {
      if (diagnostic.parameter != estimate.spec.id) continue;
      if (group.parts.empty()) group.held = diagnostic.part.substr(0, diagnostic.part.find(" = "));
      group.parts.push_back(&diagnostic);
    }
    if (!group.parts.empty()) groups.push_back(group);
  }
  return groups;
}

double standard_errors_apart(const DiagnosticGroup& group, const DiagnosticRecord& part) {
  return (part.value - group.whole->value) / part.standard_error;
}

std::string interpretation(const RunRecord& record, const DiagnosticGroup& group) {
  std::vector<const DiagnosticRecord*> known = group.parts;
  std::erase_if(known, [&](const auto* part) { return !std::isfinite(standard_errors_apart(group, *part)); });
  const std::string failed = known.size() == group.parts.size()
                                 ? ""
                                 : fmt::format(" {} of {} fits failed and say nothing.",
                                               group.parts.size() - known.size(), group.parts.size());
  if (known.size() < 2) return "There are not two values to compare." + failed;
  const auto apart = [&](const DiagnosticRecord* part) { return std::abs(standard_errors_apart(group, *part)); };
  const DiagnosticRecord* farthest = *std::ranges::max_element(known, {}, apart);
  if (apart(farthest) <= 2) {
    return fmt::format("All agree with the whole fit within 2 standard errors: one law serves every {}.", group.held) +
           failed;
  }
  const double change = change_over(known);
  if (change == 0) {
    return fmt::format(
               "They disagree without an order in {}: {} is {:.1f} standard errors from the whole fit. Look at its "
               "readings first, then at what acts there alone, such as contact or a zero error.",
               group.held, farthest->part, apart(farthest)) +
           failed;
  }
  const ParameterSpec& spec = group.whole->spec;
  const auto shown = [&](const DiagnosticRecord* part) { return with_unit(part->value, spec.unit, 3); };
  const std::string text = fmt::format(
      "{} {} as {} grows, from {} to {}, {:.1f} standard errors of the difference: ", spec.id,
      change < 0 ? "falls" : "rises", group.held, shown(known.front()), shown(known.back()), std::abs(change));
  if (change < 0) return text + softer_law(record, spec.id) + "." + failed;
  return text +
         "the specimen stiffens more than the model says, by its material or because parts meet earlier; check "
         "gaps and other dimensions." +
         failed;
}

std::string remedy_for_lack_of_fit(const RunRecord& record) {
  const LackOfFit& lack = record.fit.lack_of_fit;
  if (!lack.available || !(lack.p_value < 0.05)) return "";
  if (over_strain(record)) {
    return "What to try: a [[fit.variant]] with another law, or with the modes apart, to see which one the law does "
           "not follow.";
  }
  std::string text = "What to try, one at a time: ";
  const std::vector<DiagnosticGroup> groups = diagnostic_groups(record);
  if (!groups.empty()) {
    text += fmt::format("what the table of each {} alone says; ", groups.front().held);
  } else if (std::ranges::adjacent_find(record.series, std::not_equal_to<>()) != record.series.end()) {
    text += "a [fit.diagnostic] table, which fits a parameter to parts of the readings and shows where they disagree; ";
  }
  return text +
         "another material law (for a foam law = \"ogden_hill\"); a clamp that gives (rotation_stiffness in "
         "[[support]]); the dimensions, measured again; a finer mesh as a [[fit.variant]].";
}

}  // namespace taut

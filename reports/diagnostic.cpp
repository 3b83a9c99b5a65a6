#include "reports/diagnostic.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "reports/axes.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

enum class Order { none, falls, rises };

/// The name of the region whose Young's modulus this is; "" for other parameters.
std::string region_of(const std::string& parameter) {
  return parameter.starts_with("E_") ? parameter.substr(2) : "";
}

/// The law of a region, from the lines of the set-up; "" when it does not stand there.
std::string law_of(const RunRecord& record, const std::string& region) {
  for (const auto& [name, value] : record.setup) {
    if (name == "material " + region) return value.substr(0, value.find(','));
  }
  return "";
}

struct Change {
  Order order = Order::none;
  double standard_errors = 0;  ///< of the difference between the first part and the last
};

Change change_over(const std::vector<const DiagnosticRecord*>& parts) {
  const auto rise = [](const DiagnosticRecord& a, const DiagnosticRecord& b) {
    return (b.value - a.value) / std::hypot(a.standard_error, b.standard_error);
  };
  if (parts.size() < 2) return {};
  const double whole = rise(*parts.front(), *parts.back());
  if (!(std::abs(whole) > 2)) return {};
  for (size_t i = 1; i < parts.size(); ++i) {
    const double step = rise(*parts[i - 1], *parts[i]);
    if (whole < 0 ? step > 1 : step < -1) return {};
  }
  return {whole < 0 ? Order::falls : Order::rises, std::abs(whole)};
}

/// What makes a foam soften more than the model says.
std::string softer_law(const RunRecord& record, const std::string& parameter) {
  const std::string region = region_of(parameter);
  if (region.empty()) return "the model is too stiff there: look at what the load meets last";
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
    DiagnosticGroup group;
    for (const DiagnosticRecord& diagnostic : record.diagnostics) {
      if (diagnostic.parameter == estimate.spec.id) group.parts.push_back(&diagnostic);
    }
    if (group.parts.empty()) continue;
    group.whole = &estimate;
    const std::string& part = group.parts.front()->part;
    group.held = part.substr(0, part.find(" = "));
    groups.push_back(group);
  }
  return groups;
}

double standard_errors_apart(const DiagnosticGroup& group, const DiagnosticRecord& part) {
  return (part.value - group.whole->value) / part.standard_error;
}

std::string interpretation(const RunRecord& record, const DiagnosticGroup& group) {
  std::vector<const DiagnosticRecord*> known;
  const DiagnosticRecord* farthest = nullptr;
  double most = 0;
  for (const DiagnosticRecord* part : group.parts) {
    const double apart = standard_errors_apart(group, *part);
    if (!std::isfinite(apart)) continue;
    known.push_back(part);
    if (farthest == nullptr || std::abs(apart) > std::abs(most)) {
      farthest = part;
      most = apart;
    }
  }
  const std::string& id = group.whole->spec.id;
  const std::string failed = known.size() == group.parts.size()
                                 ? ""
                                 : fmt::format(" {} of {} fits failed and say nothing.",
                                               group.parts.size() - known.size(), group.parts.size());
  if (known.size() < 2) return "There are not two values to compare." + failed;
  if (std::abs(most) <= 2) {
    return fmt::format("All agree with the whole fit within 2 standard errors: one law serves every {}.", group.held) +
           failed;
  }
  const auto shown = [&](const DiagnosticRecord* part) { return with_unit(part->value, group.whole->spec.unit, 3); };
  const Change change = change_over(known);
  if (change.order == Order::none) {
    return fmt::format(
               "They disagree without an order in {}: {} is {:.1f} standard errors from the whole fit. Look at its "
               "readings first, then at what acts there alone, such as contact or a zero error.",
               group.held, farthest->part, std::abs(most)) +
           failed;
  }
  const std::string text =
      fmt::format("{} {} as {} grows, from {} to {}, {:.1f} standard errors of the difference: ", id,
                  change.order == Order::falls ? "falls" : "rises", group.held, shown(known.front()),
                  shown(known.back()), change.standard_errors);
  if (change.order == Order::falls) return text + softer_law(record, id) + "." + failed;
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

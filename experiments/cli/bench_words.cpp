#include "experiments/cli/bench_words.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "sim/core/error.hpp"
#include "sim/core/units.hpp"

namespace taut {

std::string value_text(const Bench& bench, size_t control, double value) {
  return bench.describe_control(control, value).substr(bench.controls()[control].id.size() + 3);
}

size_t place_of_id(const std::vector<AxisRecord>& axes, const std::string& id, const std::string& where,
                   const std::string& what) {
  const auto found = std::ranges::find(axes, id, &AxisRecord::id);
  if (found != axes.end()) return static_cast<size_t>(found - axes.begin());
  std::vector<std::string> ids;
  for (const AxisRecord& axis : axes) ids.push_back(axis.id);
  throw InputError(
      fmt::format("{}: '{}' is no {}{}; there are: {}", where, id, what, did_you_mean(id, ids), join(ids)));
}

double in_unit_of(const AxisRecord& axis, const std::string& text, const std::string& where) {
  return parse_quantity(spaced(text), quantity_of_si_unit(axis.unit), where);
}

std::string spaced(const std::string& text) {
  const size_t unit = text.find_first_not_of("+-.0123456789eE");
  if (unit == std::string::npos || unit == 0 || text[unit] == ' ') return text;
  return text.substr(0, unit) + " " + text.substr(unit);
}

}  // namespace taut

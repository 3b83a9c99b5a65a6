#include "sim/core/parameters.hpp"

#include <fmt/format.h>

#include <cmath>

#include "sim/core/error.hpp"

namespace taut {

int ParameterTable::declare(ParameterSpec spec) {
  if (contains(spec.id)) throw std::logic_error("parameter declared twice: " + spec.id);
  specs_.push_back(std::move(spec));
  return size() - 1;
}

int ParameterTable::index(std::string_view id) const {
  for (int i = 0; i < size(); ++i) {
    if ((*this)[i].id == id) return i;
  }
  throw InputError(
      fmt::format("unknown parameter '{}'{}; the model has: {}", id, did_you_mean(id, ids()), join(ids())));
}

bool ParameterTable::contains(std::string_view id) const {
  for (const ParameterSpec& spec : specs_) {
    if (spec.id == id) return true;
  }
  return false;
}

std::vector<std::string> ParameterTable::ids() const {
  std::vector<std::string> ids;
  for (const ParameterSpec& spec : specs_) ids.push_back(spec.id);
  return ids;
}

void ParameterTable::check(int index, double value) const {
  const ParameterSpec& spec = (*this)[index];
  if (std::isfinite(value) && value >= spec.lower && value <= spec.upper) return;
  throw InputError(fmt::format("{} = {:.6g} {} is outside its physical range [{:.6g}, {:.6g}] ({})", spec.id, value,
                               spec.unit, spec.lower, spec.upper, spec.meaning));
}

}  // namespace taut

#pragma once
#include <fmt/format.h>

#include <string_view>
#include <tuple>

#include "sim/core/error.hpp"
#include "sim/materials/laws.hpp"
#include "sim/materials/neo_hookean.hpp"
#include "sim/materials/ogden_hill.hpp"

namespace taut {

/// The list of materials. A new material is one new file and its name here: factory, help, experiment files and the
/// test battery follow from this list.
template <class T = double>
using AllMaterials = std::tuple<NeoHookean<T>, OgdenHill<T>>;

/// Calls `action` with a default-constructed material of the named law. Throws InputError with the nearest name.
template <class Action>
auto with_law(std::string_view law, Action&& action) {
  using First = std::tuple_element_t<0, AllMaterials<>>;
  decltype(action(First{})) result{};
  bool found = false;
  std::apply([&](auto... material) { ((material.id == law ? (result = action(material), found = true) : false), ...); },
             AllMaterials<>{});
  if (!found) {
    throw InputError(fmt::format("unknown material law '{}'{}; known laws: {}", law, did_you_mean(law, material_laws()),
                                 join(material_laws())));
  }
  return result;
}

}  // namespace taut

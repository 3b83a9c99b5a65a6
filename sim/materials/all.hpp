#pragma once
#include <tuple>

#include "sim/materials/neo_hookean.hpp"
#include "sim/materials/ogden_hill.hpp"

namespace taut {

/// The list of materials. A new material is one new file pair and its name here: factory, help, experiment files and
/// the test battery follow from this list.
template <class T = double>
using AllMaterials = std::tuple<NeoHookean<T>, OgdenHill<T>>;

}  // namespace taut

#include "sim/materials/neo_hookean.hpp"

#include "sim/materials/point_law_of.hpp"

template struct taut::PointLaws<taut::NeoHookean<>>;

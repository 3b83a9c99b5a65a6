#include "sim/materials/ogden_hill.hpp"

#include "sim/materials/point_law_of.hpp"

template struct taut::PointLaws<taut::OgdenHill<>>;

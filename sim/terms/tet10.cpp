#include "sim/terms/element_terms_of.hpp"

template struct taut::ElementTerms<taut::ElementShape::tet10>;

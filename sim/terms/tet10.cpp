#include "sim/terms/element_terms_of.hpp"

// With tet10_motion.cpp, in two halves: a compiler needs 550 MB for either.
template std::unique_ptr<taut::Term> taut::ElementTerms<taut::ElementShape::tet10>::solid(const Mesh&,
                                                                                          const SolidDefinition&);

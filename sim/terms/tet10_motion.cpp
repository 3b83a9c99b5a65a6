#include "sim/terms/element_terms_of.hpp"

// See tet10.cpp.
template std::unique_ptr<taut::Term> taut::ElementTerms<taut::ElementShape::tet10>::inertia(const Mesh&,
                                                                                            const InertiaDefinition&);
template std::unique_ptr<taut::Term> taut::ElementTerms<taut::ElementShape::tet10>::viscosity(
    const Mesh&, const ViscosityDefinition&);

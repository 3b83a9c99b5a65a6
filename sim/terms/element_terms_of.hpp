#pragma once
#include "sim/terms/element_terms.hpp"
#include "sim/terms/inertia_of.hpp"
#include "sim/terms/solid_of.hpp"

// For a shape's own source, which says `template struct taut::ElementTerms<taut::ElementShape::tri3>;`
namespace taut {

template <ElementShape S>
std::unique_ptr<Term> ElementTerms<S>::solid(const Mesh& mesh, const SolidDefinition& definition) {
  return std::make_unique<Solid<S>>(mesh, definition);
}
template <ElementShape S>
std::unique_ptr<Term> ElementTerms<S>::inertia(const Mesh& mesh, const InertiaDefinition& definition) {
  return std::make_unique<Inertia<S>>(mesh, definition);
}
template <ElementShape S>
std::unique_ptr<Term> ElementTerms<S>::viscosity(const Mesh& mesh, const ViscosityDefinition& definition) {
  return std::make_unique<Viscosity<S>>(mesh, definition);
}

}  // namespace taut

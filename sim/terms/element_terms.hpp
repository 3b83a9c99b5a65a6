#pragma once
#include <memory>

#include "sim/terms/inertia.hpp"
#include "sim/terms/solid.hpp"

namespace taut {

/// The energies of a region whose elements have one shape. Each shape's source (tri3.cpp and its siblings) instantiates
/// it, so that nothing else has to compile that shape.
template <ElementShape S>
struct ElementTerms {
  /// See make_solid().
  static std::unique_ptr<Term> solid(const Mesh& mesh, const SolidDefinition& definition);
  /// See make_inertia().
  static std::unique_ptr<Term> inertia(const Mesh& mesh, const InertiaDefinition& definition);
  /// See make_viscosity().
  static std::unique_ptr<Term> viscosity(const Mesh& mesh, const ViscosityDefinition& definition);
};

}  // namespace taut

#include "sim/terms/solid.hpp"

#include <fmt/format.h>

#include <limits>

#include "sim/core/error.hpp"
#include "sim/mesh/shape_functions.hpp"
#include "sim/terms/element_terms.hpp"
#include "sim/terms/region_term.hpp"

namespace taut {

std::unique_ptr<Term> make_solid(const Mesh& mesh, const SolidDefinition& definition) {
  if (definition.formulation == Formulation::locking_free) {
    constexpr auto remedy = "use formulation = \"standard\"";
    if (!law_named(definition.law).splits_volume)
      throw InputError(fmt::format("material law '{}' has no separate energy of volume change to average; {}",
                                   definition.law, remedy));
    if (mesh.dimension() == 2 && definition.plane == Plane::stress)
      throw InputError(fmt::format("plane stress does not lock, because the thickness is free to change; {}", remedy));
    if (order_of(mesh.shape) == 1)
      throw InputError(
          fmt::format("the locking-free formulation needs quadratic elements (a linear one has only one volume "
                      "change to average); use element = \"quadratic\", or {}",
                      remedy));
  }
  return with_shape(mesh.shape, [&](auto shape) { return ElementTerms<shape>::solid(mesh, definition); });
}

double smallest_jacobian(const Mesh& mesh, const Eigen::VectorXd& u) {
  return with_shape(mesh.shape, [&](auto shape) {
    using Reference = ReferenceElement<shape>;
    constexpr int D = Reference::D, N = Reference::N;
    std::vector<typename Reference::Xi> samples;
    for (const auto& point : Reference::quadrature()) samples.push_back(point.xi);
    for (int a = 0; a < N; ++a) samples.push_back(Reference::node(a));
    double smallest = std::numeric_limits<double>::infinity();
    for (int e = 0; e < mesh.element_count(); ++e) {
      const Eigen::Matrix<double, D, N> X = Reference::positions(mesh, e);
      const Eigen::Matrix<double, D, N> x = X + ElementNodes<shape>(mesh, e).gather(u);
      for (const auto& xi : samples) {
        const Eigen::Matrix<double, D, N> natural = Reference::gradients(xi);
        const Eigen::Matrix<double, D, D> rest = X * natural.transpose(), now = x * natural.transpose();
        smallest = std::min(smallest, now.determinant() / rest.determinant());
      }
    }
    return smallest;
  });
}

}  // namespace taut

#pragma once
#include <map>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "sim/core/parameters.hpp"
#include "sim/materials/tensor.hpp"

// Laws by their names. All functions throw InputError with the nearest name for an unknown law.
namespace taut {

/// Ids of all laws, for help texts and messages.
std::vector<std::string> material_laws();
/// Parameter declarations of a law (ids without the region).
std::vector<ParameterSpec> material_parameters(std::string_view law);

/// The parameters of a region's material, "<constant>_<region>", in the law's order and with their values. Throws
/// InputError for constants that are missing or that the law does not have.
std::vector<std::pair<ParameterSpec, double>> region_parameters(const std::string& region, const std::string& law,
                                                                const std::map<std::string, double>& constants);

/// Young's modulus [Pa] of an isotropic material at small strain, from its tangent at rest: with its entries c11 =
/// lambda + 2 mu and c12 = lambda, E = (c11 - c12)(c11 + 2 c12) / (c11 + c12).
template <class Material>
double modulus_at_rest(const Material& material) {
  const Tangent<double, 3> A = material.tangent(Tensor<double, 3>(Tensor<double, 3>::Zero()));
  const double c11 = A(0, 0), c12 = A(0, 4);
  return (c11 - c12) * (c11 + 2 * c12) / (c11 + c12);
}
/// The same of a law with all its constants; a constant E is that modulus.
double youngs_modulus(std::string_view law, const std::map<std::string, double>& constants);

}  // namespace taut

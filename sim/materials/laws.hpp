#pragma once
#include <map>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "sim/core/parameters.hpp"
#include "sim/materials/point_law.hpp"

// Laws by their names. All functions throw InputError with the nearest name for an unknown law.
namespace taut {

/// What is known of a material law.
struct Law {
  std::string id;
  std::vector<ParameterSpec> parameters;  ///< its constants (ids without the region)
  bool splits_volume = false;             ///< whether it has point laws that average the volume change
  std::unique_ptr<PointLaw<2>> (*section)(const std::vector<double>& theta, Plane plane, bool averages) = nullptr;
  std::unique_ptr<PointLaw<3>> (*solid)(const std::vector<double>& theta, bool averages) = nullptr;
};
/// The law of that id; lives as long as the program.
const Law& law_named(std::string_view id);

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
double modulus_at_rest(const Tangent<double, 3>& tangent);
/// The same of a law with all its constants; a constant E is that modulus.
double youngs_modulus(std::string_view law, const std::map<std::string, double>& constants);

}  // namespace taut

#include "sim/materials/laws.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "sim/core/error.hpp"
#include "sim/materials/all.hpp"

namespace taut {
namespace {

template <class Material>
Law law_of() {
  const auto specs = Material::parameters();
  return {std::string(Material::id),
          {specs.begin(), specs.end()},
          Material::splits_volume,
          PointLaws<Material>::section,
          PointLaws<Material>::solid};
}

const std::vector<Law>& all_laws() {
  static const std::vector<Law> all =
      std::apply([](auto... material) { return std::vector<Law>{law_of<decltype(material)>()...}; }, AllMaterials<>{});
  return all;
}

}  // namespace

const Law& law_named(std::string_view id) {
  for (const Law& law : all_laws()) {
    if (law.id == id) return law;
  }
  throw InputError(fmt::format("unknown material law '{}'{}; known laws: {}", id, did_you_mean(id, material_laws()),
                               join(material_laws())));
}

std::vector<std::string> material_laws() {
  std::vector<std::string> ids;
  for (const Law& law : all_laws()) ids.push_back(law.id);
  return ids;
}

std::vector<ParameterSpec> material_parameters(std::string_view law) {
  return law_named(law).parameters;
}

std::vector<std::pair<ParameterSpec, double>> region_parameters(const std::string& region, const std::string& law,
                                                                const std::map<std::string, double>& constants) {
  std::vector<std::string> known;
  for (const ParameterSpec& spec : material_parameters(law)) known.push_back(spec.id);
  for (const auto& [id, value] : constants) {
    if (std::find(known.begin(), known.end(), id) == known.end())
      throw InputError(fmt::format("material of region '{}': '{}' has no constant '{}'{}; it has: {}", region, law, id,
                                   did_you_mean(id, known), join(known)));
  }
  std::vector<std::pair<ParameterSpec, double>> parameters;
  for (ParameterSpec spec : material_parameters(law)) {
    const auto found = constants.find(spec.id);
    if (found == constants.end())
      throw InputError(fmt::format("material of region '{}': {} ({}) is missing; law '{}' needs {}", region, spec.id,
                                   spec.meaning, law, join(known)));
    spec.id += "_" + region;
    spec.meaning += " of " + region;
    parameters.emplace_back(std::move(spec), found->second);
  }
  return parameters;
}

double modulus_at_rest(const Tangent<double, 3>& tangent) {
  const double c11 = tangent(0, 0), c12 = tangent(0, 4);
  return (c11 - c12) * (c11 + 2 * c12) / (c11 + c12);
}

double youngs_modulus(std::string_view law, const std::map<std::string, double>& constants) {
  if (const auto own = constants.find("E"); own != constants.end()) return own->second;
  std::vector<double> theta;
  for (const ParameterSpec& spec : material_parameters(law)) theta.push_back(constants.at(spec.id));
  return modulus_at_rest(law_named(law).solid(theta, false)->tangent(Tensor<double, 3>::Zero()));
}

}  // namespace taut

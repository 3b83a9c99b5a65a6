#include "sim/materials/laws.hpp"

#include <algorithm>

#include "sim/materials/all.hpp"

namespace taut {

std::vector<std::string> material_laws() {
  return std::apply([](auto... material) { return std::vector<std::string>{std::string(material.id)...}; },
                    AllMaterials<>{});
}

std::vector<ParameterSpec> material_parameters(std::string_view law) {
  return with_law(law, [](auto material) {
    const auto specs = material.parameters();
    return std::vector<ParameterSpec>(specs.begin(), specs.end());
  });
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

double youngs_modulus(std::string_view law, const std::map<std::string, double>& constants) {
  if (const auto own = constants.find("E"); own != constants.end()) return own->second;
  return with_law(law, [&](auto material) {
    using Material = decltype(material);
    std::array<double, std::tuple_size_v<decltype(Material::parameters())>> theta;
    for (size_t j = 0; j < theta.size(); ++j) theta[j] = constants.at(Material::parameters()[j].id);
    return modulus_at_rest(Material(theta));
  });
}

}  // namespace taut

#pragma once
#include <algorithm>
#include <tuple>
#include <type_traits>

#include "sim/materials/plane_stress.hpp"
#include "sim/materials/point_law.hpp"

// How a material struct becomes a PointLaw. For the material's own source, which says
// `template struct taut::PointLaws<taut::NeoHookean<>>;`
namespace taut {

/// The solid itself, or its plane-strain section: the material's own functions.
template <class Material>
struct Direct {
  Material solid;
  template <int D>
  double energy(const Tensor<double, D>& H) const {
    return solid.energy(H);
  }
  template <int D>
  Tensor<double, D> stress(const Tensor<double, D>& H) const {
    return solid.stress(H);
  }
  template <int D>
  Tangent<double, D> tangent(const Tensor<double, D>& H) const {
    return solid.tangent(H);
  }
  template <int D>
  Tensor<double, D> stress_derivative(const Tensor<double, D>& H, const Material& derivative) const {
    return derivative.stress(H);
  }
};

/// A material in one of its uses, with its constants.
template <int D, class Material, template <class> class Law>
class PointLawOf final : public PointLaw<D> {
  using Theta = std::array<double, std::tuple_size_v<decltype(Material::parameters())>>;
  static constexpr bool splits = Material::splits_volume && std::is_same_v<Law<Material>, Direct<Material>>;

 public:
  PointLawOf(const std::vector<double>& theta, bool averages) : averages_(averages) {
    std::copy_n(theta.begin(), theta_.size(), theta_.begin());
    const Material material(theta_);
    rest_.solid = material;
    if constexpr (splits) {
      modulus_ = material.volumetric_modulus();
      rest_.solid = material.without_volume();
    }
    law_.solid = averages ? rest_.solid : material;
  }

  double energy(const Tensor<double, D>& H) const override { return law_.energy(H); }
  Tensor<double, D> stress(const Tensor<double, D>& H) const override { return law_.stress(H); }
  Tangent<double, D> tangent(const Tensor<double, D>& H) const override { return law_.tangent(H); }
  Tangent<double, D> rest_tangent(const Tensor<double, D>& H) const override { return rest_.tangent(H); }
  Tensor<double, D> stress_derivative(const Tensor<double, D>& H, int j) const override {
    Material derivative = Material::derivative(theta_, j);
    if constexpr (splits) {
      if (averages_) derivative = derivative.without_volume();
    }
    return law_.stress_derivative(H, derivative);
  }
  double volumetric_modulus() const override { return modulus_; }
  double volumetric_modulus_derivative(int j) const override {
    if constexpr (splits) return Material::derivative(theta_, j).volumetric_modulus();
    return 0;
  }

 private:
  Theta theta_;
  bool averages_;
  Law<Material> law_, rest_;
  double modulus_ = 0;
};

template <class Material>
std::unique_ptr<PointLaw<2>> PointLaws<Material>::section(const std::vector<double>& theta, Plane plane,
                                                          bool averages) {
  if (plane == Plane::stress) return std::make_unique<PointLawOf<2, Material, PlaneStress>>(theta, averages);
  return std::make_unique<PointLawOf<2, Material, Direct>>(theta, averages);
}

template <class Material>
std::unique_ptr<PointLaw<3>> PointLaws<Material>::solid(const std::vector<double>& theta, bool averages) {
  return std::make_unique<PointLawOf<3, Material, Direct>>(theta, averages);
}

}  // namespace taut

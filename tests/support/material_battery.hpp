#pragma once
#include <ceres/jet.h>
#include <gtest/gtest.h>

#include <Eigen/QR>
#include <random>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "sim/materials/all.hpp"

namespace taut::test {

/// The k-th material of the list in D dimensions, for any scalar.
template <size_t k, int D>
struct MaterialCase {
  template <class T>
  using Material = std::tuple_element_t<k, AllMaterials<T>>;
  static constexpr int dimension = D;
  static constexpr size_t parameter_count = std::tuple_size_v<decltype(Material<double>::parameters())>;
  using Theta = std::array<double, parameter_count>;
};

template <size_t... k>
auto material_cases(std::index_sequence<k...>) -> ::testing::Types<MaterialCase<k, 2>..., MaterialCase<k, 3>...>;
/// Every material of sim/materials/all.hpp, in 2D and in 3D.
using AllMaterialCases = decltype(material_cases(std::make_index_sequence<std::tuple_size_v<AllMaterials<>>>{}));

struct MaterialCaseName {
  template <class Case>
  static std::string GetName(int) {
    return std::string(Case::template Material<double>::id) + "_" + std::to_string(Case::dimension) + "D";
  }
};

/// Values between the bounds of every parameter, up to 0.02 % from the upper one: moduli from 1e3 to 1e9, the others at
/// fractions of their range.
template <class Case>
std::vector<typename Case::Theta> sample_parameters() {
  const auto specs = Case::template Material<double>::parameters();
  std::vector<typename Case::Theta> samples;
  for (double fraction : {0.4, 0.9, 0.65, 0.9998}) {
    typename Case::Theta theta;
    for (size_t j = 0; j < specs.size(); ++j) {
      theta[j] = specs[j].logarithmic ? std::pow(10.0, 3.0 + 6.0 * fraction)
                                      : specs[j].lower + fraction * (specs[j].upper - specs[j].lower);
    }
    samples.push_back(theta);
  }
  return samples;
}

template <int D>
Tensor<double, D> random_tensor(std::mt19937& random) {
  std::normal_distribution<double> normal;
  Tensor<double, D> A;
  for (int i = 0; i < D * D; ++i) A.data()[i] = normal(random);
  return A;
}

template <int D>
Tensor<double, D> random_rotation(std::mt19937& random) {
  Tensor<double, D> Q = random_tensor<D>(random).householderQr().householderQ();
  if (Q.determinant() < 0) Q.col(0) *= -1.0;
  return Q;
}

/// Random displacement gradients with J > 0.2, of the given size.
template <int D>
std::vector<Tensor<double, D>> sample_gradients(double size, int count = 5, unsigned seed = 1) {
  std::mt19937 random(seed);
  std::vector<Tensor<double, D>> samples;
  while (static_cast<int>(samples.size()) < count) {
    const Tensor<double, D> H = size * random_tensor<D>(random);
    if (jacobian_minus_one<double, D>(H) > -0.8) samples.push_back(H);
  }
  return samples;
}

/// From a relative strain at which 1 + strain keeps no more than half of the digits to large deformation.
constexpr double strain_sizes[] = {1e-8, 1e-6, 1e-3, 0.03, 0.3};

/// H with D^2 (or more) infinitesimal parts, one per component, column-major.
template <int D>
auto with_infinitesimals(const Tensor<double, D>& H) {
  using Jet = ceres::Jet<double, D * D>;
  Tensor<Jet, D> jets;
  for (int i = 0; i < D * D; ++i) jets.data()[i] = Jet(H.data()[i], i);
  return jets;
}

template <size_t n>
auto with_infinitesimals(const std::array<double, n>& theta) {
  using Jet = ceres::Jet<double, static_cast<int>(n)>;
  std::array<Jet, n> jets;
  for (size_t j = 0; j < n; ++j) jets[j] = Jet(theta[j], static_cast<int>(j));
  return jets;
}

/// theta in another scalar, without infinitesimal parts.
template <class T, size_t n>
std::array<T, n> as(const std::array<double, n>& theta) {
  std::array<T, n> converted;
  for (size_t j = 0; j < n; ++j) converted[j] = T(theta[j]);
  return converted;
}

inline Tensor<double, 3> embedded(const Tensor<double, 2>& H, double thickness_strain = 0.0) {
  Tensor<double, 3> full = Tensor<double, 3>::Zero();
  full.topLeftCorner<2, 2>() = H;
  full(2, 2) = thickness_strain;
  return full;
}

}  // namespace taut::test

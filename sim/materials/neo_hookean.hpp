#pragma once
#include <Eigen/LU>
#include <array>
#include <cmath>
#include <string_view>

#include "sim/core/parameters.hpp"
#include "sim/materials/tensor.hpp"

namespace taut {

/// Compressible neo-Hookean solid, the paper's Eq. 3:
///
///   Psi = mu/2 (tr F^T F - d) - mu ln J + lambda/2 (ln J)^2      [J/m^3],   J = det F,
///   mu = E / (2 (1 + nu)),   lambda = E nu / ((1 + nu)(1 - 2 nu)).
///
/// D = 3 is the solid, D = 2 the same solid in plane strain. All functions take the displacement gradient H = F - I
/// and are written so that rounding is relative to the strain, not to 1: stiff and soft regions share one sum.
/// Valid for J > 0; the energy is +inf otherwise. At small strain it is Hooke's law with the same E and nu.
template <class T = double>
struct NeoHookean {
  static constexpr std::string_view id = "neo_hookean";
  static constexpr std::string_view summary = "compressible neo-Hookean solid (Eq. 3 of the push-puppet paper)";
  /// Its constants with their bounds.
  static std::array<ParameterSpec, 2> parameters() {
    return {
        {{"E", "E", "Pa", 1.0, 1e13, "Young's modulus", true}, {"nu", "nu", "1", -0.95, 0.4999999, "Poisson's ratio"}}};
  }

  T mu{0};      ///< shear modulus [Pa]
  T lambda{0};  ///< Lame's first parameter [Pa]

  NeoHookean() = default;
  NeoHookean(const T& mu_, const T& lambda_) : mu(mu_), lambda(lambda_) {}  ///< from mu and lambda [Pa]
  /// From {E [Pa], nu}.
  explicit NeoHookean(const std::array<T, 2>& theta) {
    const auto& [E, nu] = theta;
    mu = E / (2.0 * (1.0 + nu));
    lambda = E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu));
  }

  /// dPsi/dtheta_j is a neo-Hookean energy too, because Psi is linear in mu and lambda; these are its constants.
  static NeoHookean derivative(const std::array<T, 2>& theta, int j) {
    const auto& [E, nu] = theta;
    if (j == 0) return NeoHookean(std::array<T, 2>{T(1.0), nu});
    const T a = 1.0 + nu, b = 1.0 - 2.0 * nu;
    return {-E / (2.0 * a * a), E * (1.0 + 2.0 * nu * nu) / (a * a * b * b)};
  }

  /// The volumetric part lambda/2 (ln J)^2 can be averaged over patches of elements (locking-free formulation): its
  /// modulus, and the material without it.
  static constexpr bool splits_volume = true;
  T volumetric_modulus() const { return lambda; }             ///< [Pa]
  NeoHookean without_volume() const { return {mu, T(0.0)}; }  ///< mu alone

  /// Psi [J/m^3], +inf for J <= 0.
  template <int D>
  T energy(const Tensor<T, D>& H) const {
    using std::log1p;
    const T j = jacobian_minus_one(H);
    if (!(j > -1.0)) return T(std::numeric_limits<double>::infinity());
    const T ln_j = log1p(j);
    if constexpr (D == 2) {
      const T difference = H(0, 0) - H(1, 1), shear = H(0, 1) + H(1, 0);
      return mu * (0.5 * (difference * difference + shear * shear) + minus_log1p(j)) + 0.5 * lambda * ln_j * ln_j;
    } else {
      // With Green's strain G, its invariants I, II, III and q = det C - 1 = 2 I + 4 II + 8 III, the term tr C - 3 = 2
      // I is q - 4 II - 8 III: the parts of first order in the strain cancel on paper and not in the last digits.
      const Tensor<T, 3> G = green_strain<T, 3>(H);
      const T two = G(0, 0) * G(1, 1) + G(1, 1) * G(2, 2) + G(2, 2) * G(0, 0) - G(0, 1) * G(0, 1) - G(1, 2) * G(1, 2) -
                    G(0, 2) * G(0, 2);
      const T three = G(0, 0) * (G(1, 1) * G(2, 2) - G(1, 2) * G(1, 2)) -
                      G(0, 1) * (G(0, 1) * G(2, 2) - G(1, 2) * G(0, 2)) +
                      G(0, 2) * (G(0, 1) * G(1, 2) - G(1, 1) * G(0, 2));
      const T q = 2.0 * (G(0, 0) + G(1, 1) + G(2, 2)) + 4.0 * two + 8.0 * three;
      // ln det C = 2 ln J; once q is large that is the better of the two, down to J = 0.
      const T first = q > -0.5 ? T(0.5 * minus_log1p(q)) : T(0.5 * q - ln_j);
      return mu * (first - 2.0 * two - 4.0 * three) + 0.5 * lambda * ln_j * ln_j;
    }
  }

  /// First Piola-Kirchhoff stress P = dPsi/dF = F^-T (2 mu G + lambda ln J I) [Pa], G Green's strain.
  template <int D>
  Tensor<T, D> stress(const Tensor<T, D>& H) const {
    using std::log1p;
    const T j = jacobian_minus_one(H);
    const Tensor<T, D> inverse = inverse_of<T, D>(H);
    Tensor<T, D> s = (2.0 * mu) * green_strain<T, D>(H);
    const T pressure = lambda * log1p(j);
    for (int i = 0; i < D; ++i) s(i, i) += pressure;
    return inverse.transpose() * s;
  }

  /// dP/dF as a D^2 x D^2 symmetric matrix [Pa], row and column index i + D * J of P_iJ (column-major vec):
  /// dP_iJ/dF_kL = mu d_ik d_JL + (mu - lambda ln J) Finv_Jk Finv_Li + lambda Finv_Ji Finv_Lk.
  template <int D>
  Tangent<T, D> tangent(const Tensor<T, D>& H) const {
    using std::log1p;
    const T c = mu - lambda * log1p(jacobian_minus_one(H));
    const Tensor<T, D> inverse = inverse_of<T, D>(H);
    Tangent<T, D> A;
    for (int L = 0; L < D; ++L) {
      for (int k = 0; k < D; ++k) {
        for (int J = 0; J < D; ++J) {
          for (int i = 0; i < D; ++i) {
            A(i + D * J, k + D * L) = c * inverse(J, k) * inverse(L, i) + lambda * inverse(J, i) * inverse(L, k);
          }
        }
      }
    }
    for (int i = 0; i < D * D; ++i) A(i, i) += mu;
    return A;
  }
};

}  // namespace taut

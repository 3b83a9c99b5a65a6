#pragma once
#include <cmath>

#include "sim/materials/tensor.hpp"

namespace taut {

/// Plane stress of any solid: the out-of-plane stretch c is such that P_33 = 0, found by Newton's method at each point.
/// Psi(H) = min_c Psi_3D(diag(H, c - 1)); the tangent is the Schur complement. Works on the 3D functions of Material.
/// The derivative of the stress with respect to a parameter is condensed in the same way.
template <class Material>
struct PlaneStress {
  Material solid;

  /// Out-of-plane displacement gradient c - 1 for the in-plane H; NaN when det F <= 0 in the plane. Newton's method on
  /// ln c, in which the energy is convex and far stretches are near: dPsi/d ln c = c P_33.
  double thickness_strain(const Tensor<double, 2>& H) const {
    if (!(jacobian_minus_one(H) > -1.0)) return std::nan("");
    double strain = 0.0;
    for (int iteration = 0; iteration < 50; ++iteration) {
      const Tensor<double, 3> full = embed(H, strain);
      const double c = 1.0 + strain, residual = c * solid.stress(full)(2, 2);
      const double slope = c * c * solid.tangent(full)(8, 8) + residual;
      double step = -residual / slope;
      if (!(slope > 0.0) || !(std::abs(step) <= 1.0)) step = residual > 0.0 ? -1.0 : 1.0;
      strain += c * std::expm1(step);
      if (std::abs(step) <= 1e-9 * (std::abs(strain) + H.norm())) break;  // what is left is its square
    }
    return strain;
  }

  /// Psi per rest volume [J/m^3]; +inf where the free thickness is not found.
  template <int D>
  double energy(const Tensor<double, D>& H) const {
    static_assert(D == 2);
    const double strain = thickness_strain(H);
    return std::isnan(strain) ? std::numeric_limits<double>::infinity() : solid.energy(embed(H, strain));
  }

  /// P = dPsi/dH in the plane [Pa].
  template <int D>
  Tensor<double, 2> stress(const Tensor<double, D>& H) const {
    return solid.stress(embed(H, thickness_strain(H))).template topLeftCorner<2, 2>();
  }

  /// dP/dH in the plane [Pa], the thickness following.
  template <int D>
  Tangent<double, 2> tangent(const Tensor<double, D>& H) const {
    const Tangent<double, 3> full = solid.tangent(embed(H, thickness_strain(H)));
    Tangent<double, 2> A;
    for (int a = 0; a < 4; ++a) {
      for (int b = 0; b < 4; ++b)
        A(a, b) = full(in_plane(a), in_plane(b)) - full(in_plane(a), 8) * full(8, in_plane(b)) / full(8, 8);
    }
    return A;
  }

  /// Derivative of the in-plane stress when the solid's stress changes by `derivative`'s stress (see
  /// Material::derivative): dP = dP_3D - A_33col dP_33 / A_33.
  Tensor<double, 2> stress_derivative(const Tensor<double, 2>& H, const Material& derivative) const {
    const Tensor<double, 3> full = embed(H, thickness_strain(H));
    const Tensor<double, 3> explicit_part = derivative.stress(full);
    const Tangent<double, 3> A = solid.tangent(full);
    Tensor<double, 2> result = explicit_part.topLeftCorner<2, 2>();
    for (int a = 0; a < 4; ++a) result(a % 2, a / 2) -= A(in_plane(a), 8) / A(8, 8) * explicit_part(2, 2);
    return result;
  }

 private:
  static int in_plane(int a) { return (a % 2) + 3 * (a / 2); }
  static Tensor<double, 3> embed(const Tensor<double, 2>& H, double strain) {
    Tensor<double, 3> full = Tensor<double, 3>::Zero();
    full.topLeftCorner<2, 2>() = H;
    full(2, 2) = strain;
    return full;
  }
};

}  // namespace taut

#pragma once
#include <memory>
#include <vector>

#include "sim/materials/tensor.hpp"

namespace taut {

/// How a 2D model stands for a body of finite thickness; 3D models have nothing to assume.
enum class Plane { strain, stress };

/// A material with its constants, at a point of a plane section (D = 2) or in space (D = 3): what solids are assembled
/// from. All functions take the displacement gradient H = F - I.
///
/// Its energy is Psi = Psi_rest + k/2 (ln J)^2, with k = 0 for laws (and in plane stress) whose volume change is no
/// term of its own. One that `averages` leaves the second term to whom it serves: energy, stress and tangent are those
/// of Psi_rest.
template <int D>
class PointLaw {
 public:
  virtual ~PointLaw() = default;
  /// [J/m^3], +inf for J <= 0.
  virtual double energy(const Tensor<double, D>& H) const = 0;
  /// First Piola-Kirchhoff stress P = dPsi/dF [Pa].
  virtual Tensor<double, D> stress(const Tensor<double, D>& H) const = 0;
  /// dP/dF [Pa], symmetric.
  virtual Tangent<double, D> tangent(const Tensor<double, D>& H) const = 0;
  /// The part of dP/dF that Psi_rest has.
  virtual Tangent<double, D> rest_tangent(const Tensor<double, D>& H) const = 0;
  /// dP/dtheta_j with the law's j-th constant.
  virtual Tensor<double, D> stress_derivative(const Tensor<double, D>& H, int j) const = 0;
  /// k [Pa], that of the law also where it is left to whom the law serves.
  virtual double volumetric_modulus() const = 0;
  /// dk/dtheta_j.
  virtual double volumetric_modulus_derivative(int j) const = 0;
};

/// Makes the point laws of one material struct from its constants, in the order of its parameters. Each material's
/// source instantiates it (see point_law_of.hpp), so that nothing else has to compile the material.
template <class Material>
struct PointLaws {
  /// Of a section; `averages` has a meaning in plane strain, for laws whose volume change is a term of its own.
  static std::unique_ptr<PointLaw<2>> section(const std::vector<double>& theta, Plane plane, bool averages);
  /// In space.
  static std::unique_ptr<PointLaw<3>> solid(const std::vector<double>& theta, bool averages);
};

}  // namespace taut

#pragma once
#include <Eigen/Core>
#include <memory>
#include <vector>

#include "sim/mesh/mesh.hpp"
#include "sim/model/term.hpp"

namespace taut {

/// How the mass of a body sits in its nodes.
/// consistent: M_ab = rho integral N_a N_b, exact for quadratic fields on straight-sided elements.
/// lumped:     diagonal; the consistent diagonal scaled to the element's mass (Hinton, Rock and Zienkiewicz 1976),
/// which
///             keeps all masses positive where row sums give zero or less at the vertices of quadratic elements.
enum class MassForm { consistent, lumped };

/// What one region's inertia is made of: indices of the parameter table.
struct InertiaDefinition {
  int region = 0;
  int density = -1;    ///< rho [kg/m^3]
  int thickness = -1;  ///< t [m] in 2D, -1 in 3D
  int damping = -1;    ///< mass-proportional damping alpha [1/s], -1: none
  MassForm form = MassForm::consistent;
};

/// Incremental potential of a region's inertia and of damping in proportion to its mass, within a time step s:
///
///     E = 1/2 s.inertia |u - s.reference|_M^2 + alpha / (2 s.rate[0]) |v|_M^2   [J],
///     v = s.rate[0] u + s.rate[1] s.previous + s.rate[2] s.before,
///
/// whose gradient is M a + alpha M v [N]. Nothing in statics. Eq. 2 of the push-puppet paper, divided by h^2.
std::unique_ptr<Term> make_inertia(const Mesh& mesh, const InertiaDefinition& definition);

/// The same for a point mass p[mass] [kg] whose position is the mean of a tag's (a mass hung on a face, without its
/// swing): displacement weights . u along each axis, weights as in mean_weights().
std::unique_ptr<Term> make_point_mass(const Mesh& mesh, const Tag& tag, int mass);

/// Incremental potential of viscosity in proportion to the stiffness at rest (Kelvin-Voigt), within a time step s:
///
///     E = beta t / (2 s.rate[0]) integral  2 mu dE : dE + lambda de^2  [J],
///     dE = s.rate[0] E(u) + s.rate[1] E(s.previous) + s.rate[2] E(s.before),   E = (F^T F - I) / 2,
///
/// and de the same rate of each element's mean of ln J (in plane stress, of tr E), so that nothing locks and motions
/// that keep the volume cost no volume viscosity; mu and lambda of the region's E and nu (lambda that of plane stress
/// there). Rigid motions cost nothing; for small strains this is damping by beta K, K the elastic Hessian at rest. beta
/// [s] damps a mode of angular frequency w by the ratio beta w / 2. Valid where J > 0.
struct ViscosityDefinition {
  int region = 0;
  int youngs_modulus = -1, poisson_ratio = -1;  ///< [Pa], [1]
  int damping = -1;                             ///< beta [s]
  int thickness = -1;                           ///< [m] in 2D
  bool plane_stress = false;
};
/// See ViscosityDefinition.
std::unique_ptr<Term> make_viscosity(const Mesh& mesh, const ViscosityDefinition& definition);

}  // namespace taut

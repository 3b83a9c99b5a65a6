#pragma once
#include <array>
#include <memory>
#include <string>
#include <vector>

#include "sim/materials/laws.hpp"
#include "sim/mesh/mesh.hpp"
#include "sim/model/term.hpp"

namespace taut {

/// How the energy of volume change is sampled.
/// standard:     at every quadrature point. Locks as nu goes to 1/2: linear elements badly, quadratic tetrahedra too.
/// locking_free: mean dilatation, U = lambda/2 V_e (mean_e ln J)^2 in each element e. This is the mixed method with
///               quadratic displacements and one pressure per element, with the pressure eliminated: still the minimum
///               of an energy, with the standard element's sparsity. For quadratic elements; a linear one has a single
///               J anyway. Valid for tensions lambda ln J below about two shear moduli; beyond, single elements buckle
///               inside, which the standard ones do not. (The mean of J instead of ln J moves that limit to
///               compression, where foam works.)
enum class Formulation { standard, locking_free };

/// What a region is made of: a law by its name and where its parameters stand in the model's table.
///
/// With Prony pairs (g_i, tau_i) the material remembers: its second Piola-Kirchhoff stress is
///
///   S = (1 - sum g_i) S_e + sum h_i,   dh_i/dt = -h_i / tau_i + g_i dS_e/dt   [Pa],
///
/// S_e that of the law, so that E is the instantaneous modulus and (1 - sum g_i) E the one in the long run. Over a step
/// of length h from a state with S_0 and h_i (PronyStep) that is the stress of the energy
///
///   (1 - sum g_i (1 - gain_i)) Psi + (sum decay_i h_i - g_i gain_i S_0) : G   [J/m^3],   G = (F^T F - I) / 2,
///
/// whose history is linear in Green's strain and so turns with the body; exact where S_e goes evenly in time, else off
/// by O(h^2). Without a step the material answers at once, with E. Sum of g_i below 1, tau_i > 0.
struct SolidDefinition {
  int region = 0;
  std::string law = "neo_hookean";
  std::vector<int> parameters;  ///< table index of each of the law's parameters, in the law's order
  int thickness = -1;           ///< table index of the thickness [m] in 2D, -1 in 3D
  Plane plane = Plane::strain;
  Formulation formulation = Formulation::standard;
  std::vector<std::array<int, 2>> prony = {};  ///< table indices of g [1] and tau [s]
};

/// Elastic energy of one region [J]: sum over quadrature points of weight * thickness * Psi(F). Energy +inf when J <= 0
/// at a quadrature point. Throws InputError for an unknown law, and for the locking-free formulation where it has no
/// meaning: linear elements, plane stress (which does not lock) and laws without a separate energy of volume change.
std::unique_ptr<Term> make_solid(const Mesh& mesh, const SolidDefinition& definition);

/// Smallest J = det F over all quadrature points and nodes of the mesh: <= 0 means that an element has folded, which
/// quadratic elements can do between their quadrature points.
double smallest_jacobian(const Mesh& mesh, const Eigen::VectorXd& u);

}  // namespace taut

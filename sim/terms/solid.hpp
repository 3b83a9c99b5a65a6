#pragma once
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "sim/core/term.hpp"
#include "sim/mesh/mesh.hpp"

namespace taut {

/// How a 2D model stands for a body of finite thickness; 3D models have nothing to assume.
enum class Plane { strain, stress };

/// How the energy of volume change is sampled.
/// standard:       at every quadrature point. Locks as nu goes to 1/2 (linear elements badly, quadratic tetrahedra too).
/// locking_free:   ln J is averaged over the elements around each vertex with the vertex's linear hat function, so that
///                 U = lambda/2 sum_a V_a (mean_a ln J)^2. It is the continuous-pressure (Taylor-Hood) mixed method with
///                 a lumped pressure mass matrix and the pressure eliminated: inf-sup stable with quadratic elements
///                 in 2D and 3D, and still the minimum of an energy.
/// mean_dilatation: ln J is averaged over each element (piecewise constant pressure). Cheaper, one order less accurate.
enum class Formulation { standard, locking_free, mean_dilatation };

/// What a region is made of: a law of sim/materials/all.hpp and where its parameters stand in the model's table.
struct SolidDefinition {
  int region = 0;
  std::string law = "neo_hookean";
  std::vector<int> parameters;  ///< table index of each of the law's parameters, in the law's order
  int thickness = -1;           ///< table index of the thickness [m] in 2D, -1 in 3D
  Plane plane = Plane::strain;
  Formulation formulation = Formulation::standard;
};

/// Elastic energy of one region [J]: sum over quadrature points of weight * thickness * Psi(F). Energy +inf when J <= 0
/// at a quadrature point. Throws InputError for an unknown law, a law without a volumetric split in another formulation
/// than standard, and for plane stress (which does not lock) in another formulation than standard.
std::unique_ptr<Term> make_solid(const Mesh& mesh, const SolidDefinition& definition);

/// Ids of all laws, for help texts and messages.
std::vector<std::string> material_laws();
/// Parameter declarations of a law (ids without the region). Throws InputError with the nearest name.
std::vector<ParameterSpec> material_parameters(std::string_view law);

/// Smallest J = det F over all quadrature points and nodes of the mesh: <= 0 means that an element has folded, which
/// quadratic elements can do between their quadrature points.
double smallest_jacobian(const Mesh& mesh, const Eigen::VectorXd& u);

/// Volume (3D) or area (2D) of each element at rest.
std::vector<double> element_measures(const Mesh& mesh);

}  // namespace taut

#include <gtest/gtest.h>

#include "sim/solve/equilibrium.hpp"
#include "sim/terms/solid.hpp"
#include "tests/support/term_battery.hpp"

// Patch tests: a displacement that is linear in X, prescribed on the boundary of an irregular mesh, must be found
// inside to the last digits, with the stress of the homogeneous deformation.
namespace taut {
namespace {

using namespace test;

/// u = s H X on the boundary, the control s from 0 to 1.
Model patch_model(Mesh mesh, const Eigen::MatrixXd& H, Formulation formulation, Plane plane) {
  ParameterTable table;
  SolidDefinition definition;
  for (const ParameterSpec& spec : material_parameters("neo_hookean"))
    definition.parameters.push_back(table.declare(spec));
  const int control = table.declare({"s", "s", "1", 0, 1, "fraction of the deformation", false});
  definition.formulation = formulation;
  definition.plane = plane;
  std::vector<std::unique_ptr<Term>> terms;
  terms.push_back(make_solid(mesh, definition));
  std::vector<Support> supports;
  const int d = mesh.dimension();
  for (int node : boundary(mesh).nodes()) {
    const Eigen::VectorXd u = H * mesh.node(node);
    for (int i = 0; i < d; ++i) supports.push_back({node * d + i, control, u[i]});
  }
  return Model(std::move(mesh), std::move(table), std::move(terms), std::move(supports));
}

/// A square or cube of 4 x 4 (x 4) cells whose vertices are moved at random by up to a quarter of a cell.
Mesh random_mesh(ElementShape shape) {
  const int order = order_of(shape);
  Mesh mesh = dimension_of(shape) == 2 ? rectangle(graded(1, 4), graded(1, 4), order, "body")
                                       : box(graded(1, 3), graded(1, 3), graded(1, 3), order, "body");
  std::mt19937 random(1);
  std::uniform_real_distribution<double> shift(-0.06, 0.06);
  map_vertices(mesh, [&](const Eigen::VectorXd& X) -> Eigen::VectorXd {
    Eigen::VectorXd moved = X;
    for (double& x : moved) x += shift(random);
    return moved;
  });
  return mesh;
}

void expect_patch_test(ElementShape shape, Formulation formulation, Plane plane, double nu) {
  const std::string name = std::string(name_of(shape)) + ", nu = " + std::to_string(nu) +
                           (formulation == Formulation::locking_free ? ", locking-free" : "") +
                           (plane == Plane::stress ? ", plane stress" : "");
  const int d = dimension_of(shape);
  Eigen::MatrixXd H(d, d);
  if (d == 2)
    H << 0.15, 0.3, -0.2, -0.1;
  else
    H << 0.15, 0.3, -0.1, -0.2, -0.1, 0.05, 0.1, 0.2, 0.12;
  if (formulation == Formulation::locking_free) {
    // A change of volume whose pressure is a fifth of the shear modulus: J = 1 + mu / (5 lambda), affine in H's last
    // entry.
    double& last = H(d - 1, d - 1);
    const auto volume = [&](double value) {
      last = value;
      return (Eigen::MatrixXd::Identity(d, d) + H).determinant();
    };
    const double at_zero = volume(0), slope = volume(1) - at_zero;
    last = (1 + 0.2 * (1 - 2 * nu) / (2 * nu) - at_zero) / slope;
  }
  const Model model = patch_model(random_mesh(shape), H, formulation, plane);
  ASSERT_GT(model.free_unknowns(), 0);
  Equilibrium equilibrium(model);
  equilibrium.start_at_rest(Eigen::Vector3d(10, nu, 0));
  const Params loaded = Eigen::Vector3d(10, nu, 1);
  ASSERT_EQ(equilibrium.solve(loaded).status, SolveStatus::converged) << name << ": " << equilibrium.report().message();
  for (int i = 0; i < model.mesh().node_count(); ++i) {
    EXPECT_LE((equilibrium.u().segment(i * d, d) - H * model.mesh().node(i)).norm(), 1e-12) << name << ", node " << i;
  }
}

TEST(PatchTest, LinearDisplacementsAreExactOnIrregularMeshes) {
  for (ElementShape shape : all_shapes) {
    for (double nu : {-0.3, 0.0, 0.3, 0.49}) expect_patch_test(shape, Formulation::standard, Plane::strain, nu);
  }
}

TEST(PatchTest, LinearDisplacementsAreExactInPlaneStress) {
  for (ElementShape shape : {ElementShape::tri3, ElementShape::tri6}) {
    for (double nu : {0.0, 0.3, 0.49}) expect_patch_test(shape, Formulation::standard, Plane::stress, nu);
  }
}

TEST(PatchTest, LinearDisplacementsAreExactWithoutLocking) {
  for (ElementShape shape : {ElementShape::tri6, ElementShape::tet10}) {
    for (double nu : {0.3, 0.49, 0.4999}) expect_patch_test(shape, Formulation::locking_free, Plane::strain, nu);
  }
}

}  // namespace
}  // namespace taut

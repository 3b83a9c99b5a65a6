#include <functional>

#include "tests/support/mesh_checks.hpp"
#include "tests/support/problems.hpp"
#include "tests/support/taylor.hpp"

namespace taut {
namespace {

using namespace test;

/// A bent and pressed block in which every kind of parameter acts: moduli of two regions, thickness, density, g, a hung
/// mass, a force, a traction, a point force and a prescribed displacement.
Scene loaded_block(int d, int order, double nu, Formulation formulation, Plane plane = Plane::strain) {
  Mesh mesh = d == 2 ? rectangle(graded(0.2, 6), graded(0.06, 3), order, "soft")
                     : box(graded(0.2, 4), graded(0.06, 2), graded(0.04, 1), order, "soft");
  assign_regions(mesh, [](const Eigen::VectorXd& c) { return c[0] < 0.1 ? "soft" : "firm"; });
  SceneBuilder builder(std::move(mesh), plane, 0.04);
  builder.add_solid("soft", "neo_hookean", {{"E", 5e4}, {"nu", nu}}, formulation);
  builder.add_solid("firm", "neo_hookean", {{"E", 4e5}, {"nu", 0.3}}, formulation);
  const auto declare = [&](const char* id, double value) {
    return builder.declare({id, id, "SI", -1e6, 1e6, id, false}, value);
  };
  const Eigen::VectorXd down = d == 2 ? vec({0, -1}) : vec({0, -1, 0.3}), along = Eigen::VectorXd::Unit(d, 0);
  const int g = declare("g", 9.81);
  builder.fix("xmin", d == 2 ? std::vector{0, 1} : std::vector{0, 1, 2});
  builder.prescribe("xmax", 0, declare("travel", -0.004));
  builder.add_weight("soft", 1100, down, g);
  builder.add_force("xmax", down, declare("mass", 0.03), g);
  builder.add_force("ymin", down, declare("force", 0.2));
  builder.add_traction("ymax", along, declare("traction", 150));
  builder.add_point_force(d == 2 ? vec({0.12, 0.06}) : vec({0.12, 0.06, 0.01}), down, declare("finger", 0.1));
  return builder.build();
}

/// Rest, which has no load.
Params at_rest(const Scene& scene) {
  Params p = scene.values;
  for (const char* id : {"g", "travel", "force", "traction", "finger"}) p[scene.model->parameters().index(id)] = 0;
  return p;
}

void expect_sensitivities(const Scene& scene, const std::string& what) {
  const Model& model = *scene.model;
  const EquilibriumOptions precise{.step_tolerance = 1e-11};
  Equilibrium reference(model, precise);
  reference.start_at_rest(at_rest(scene));
  ASSERT_EQ(reference.solve(scene.values).status, SolveStatus::converged)
      << what << ": " << reference.report().message();
  ASSERT_GT(reference.u().cwiseAbs().maxCoeff(), 0.005) << "bent far enough to be nonlinear";
  std::vector<int> all;
  for (int k = 0; k < model.parameters().size(); ++k) all.push_back(k);
  const Eigen::MatrixXd sensitivities = reference.sensitivities(all);
  for (int k : all) {
    const std::string& id = model.parameters()[k].id;
    const Eigen::VectorXd slope = sensitivities.col(k);
    // Far enough that rounding of the solve is nothing, and within the bounds of nu.
    const double size = id == "nu_soft" ? 0.3 * (0.5 - scene.values[k]) : 0.1 * std::abs(scene.values[k]);
    EXPECT_GT(slope.norm() * size, 1e-6) << what << ": " << id << " tests nothing";
    expect_taylor_order(
        [&](double h) {
          Params p = scene.values;
          p[k] += h;
          Equilibrium moved(model, precise);
          moved.start_at(reference.u(), scene.values);
          EXPECT_EQ(moved.solve(p).status, SolveStatus::converged) << what << ": " << id;
          return (moved.u() - reference.u() - h * slope).norm();
        },
        2, 1e-12, size, 5, what + ": " + id);
  }
}

TEST(Sensitivity, IsTheSlopeOfTheWholeSolveIn2D) {
  for (int order : {1, 2}) expect_sensitivities(loaded_block(2, order, 0.3, Formulation::standard), "2D");
}

TEST(Sensitivity, IsTheSlopeOfTheWholeSolveInPlaneStress) {
  for (int order : {1, 2}) {
    expect_sensitivities(loaded_block(2, order, 0.4, Formulation::standard, Plane::stress), "plane stress");
  }
}

TEST(Sensitivity, IsTheSlopeOfTheWholeSolveIn3D) {
  for (int order : {1, 2}) expect_sensitivities(loaded_block(3, order, 0.3, Formulation::standard), "3D");
}

TEST(Sensitivity, IsTheSlopeOfTheWholeSolveForNearlyIncompressibleSolids) {
  for (int d : {2, 3})
    expect_sensitivities(loaded_block(d, 2, 0.499, Formulation::locking_free), std::to_string(d) + "D");
}

TEST(Sensitivity, OfSupportedComponentsIsTheirCoefficient) {
  const Scene scene = loaded_block(2, 2, 0.3, Formulation::standard);
  const Model& model = *scene.model;
  Equilibrium equilibrium(model);
  equilibrium.start_at_rest(at_rest(scene));
  ASSERT_EQ(equilibrium.solve(scene.values).status, SolveStatus::converged);
  const Eigen::MatrixXd s =
      equilibrium.sensitivities({model.parameters().index("travel"), model.parameters().index("force")});
  for (int node : model.mesh().select("xmax").nodes()) {
    EXPECT_EQ(s(2 * node, 0), 1.0);
    EXPECT_EQ(s(2 * node, 1), 0.0);
  }
  for (int node : model.mesh().select("xmin").nodes()) {
    for (int i : {0, 1}) EXPECT_EQ(s.row(2 * node + i).norm(), 0.0);
  }
}

TEST(Sensitivity, ToTheModulusIsMinusTheLoadsSensitivityInTheirRatio) {
  // u depends on F / (E t) alone, so that E du/dE = t du/dt = -F du/dF.
  const Problem problem = problem_a1(4, 2);
  Equilibrium equilibrium(*problem.scene.model);
  equilibrium.start_at_rest(problem.scene.values);
  Params p = problem.scene.values;
  p[problem.force] = 2.0;
  ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged);
  const ParameterTable& table = problem.scene.model->parameters();
  const int E = table.index("E_beam"), t = table.index("thickness");
  const Eigen::MatrixXd s = equilibrium.sensitivities({E, t, problem.force});
  const Eigen::VectorXd per_load = p[problem.force] * s.col(2);
  EXPECT_LE((p[E] * s.col(0) + per_load).norm(), 1e-10 * per_load.norm());
  EXPECT_LE((p[t] * s.col(1) + per_load).norm(), 1e-10 * per_load.norm());
}

TEST(Sensitivity, WithoutAnEquilibriumThereIsNone) {
  const Problem problem = problem_a1(2, 1);
  Equilibrium equilibrium(*problem.scene.model);
  equilibrium.start_at_rest(problem.scene.values);
  EXPECT_THROW(equilibrium.sensitivities({0}), std::logic_error);
}

}  // namespace
}  // namespace taut

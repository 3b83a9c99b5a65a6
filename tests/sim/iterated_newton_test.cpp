#include <gtest/gtest.h>

#include <array>

#include "sim/mesh/structured.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/scene/scene.hpp"
#include "sim/solve/equilibrium.hpp"
#include "sim/solve/hessian.hpp"

// Where factorisations are dear, Newton's steps come from conjugate gradients with the factor of a state before.
namespace taut::test {
namespace {

/// A column of 20 x `width` x `length` of 1 MPa, clamped at its foot, with "force" [N] downwards on its top.
struct Column {
  Scene scene;
  int force = -1;
  double euler = 0;        ///< its load with clamped and free ends [N]
  Eigen::VectorXd across;  ///< weights of the top's mean displacement along x and
  Eigen::VectorXd down;    ///< against z
};

Column column(double width, double length, const std::array<int, 3>& cells) {
  SceneBuilder builder(box(graded(20e-3, cells[0]), graded(width, cells[1]), graded(length, cells[2]), 2, "column"), {},
                       1.0);
  builder.add_solid("column", "neo_hookean", {{"E", 1e6}, {"nu", 0.0}});
  builder.fix("zmin", {0, 1, 2});
  Column result;
  result.euler = std::pow(3.14159265358979 / (2 * length), 2) * 1e6 * width * std::pow(20e-3, 3) / 12;
  result.force = builder.declare({"force", "F", "N", -1e6, 1e6, "load"}, 0.0);
  builder.add_force("zmax", Eigen::Vector3d(0, 0, -1), result.force);
  const Mesh& mesh = builder.mesh();
  result.across = mean_weights(mesh, mesh.select("zmax"), Eigen::Vector3d(1, 0, 0));
  result.down = mean_weights(mesh, mesh.select("zmax"), Eigen::Vector3d(0, 0, -1));
  result.scene = builder.build();
  return result;
}

Column wide() {
  return column(30e-3, 100e-3, {4, 5, 14});
}

/// Small models stand for those of ten times as many unknowns.
EquilibriumOptions iterating() {
  EquilibriumOptions options;
  options.dear = 1;
  return options;
}

Params under(const Column& column, double force) {
  Params p = column.scene.values;
  p[column.force] = force;
  return p;
}

TEST(IteratedNewton, SolvesWithTheHessianOfOneStateByTheFactorOfAnother) {
  const Column c = wide();
  const Model& model = *c.scene.model;
  Equilibrium pulled(model);
  pulled.start_at_rest(c.scene.values);
  ASSERT_EQ(pulled.solve(under(c, -60)).status, SolveStatus::converged);  // by a tenth
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(model.unknowns());
  Eigen::VectorXd v(model.free_unknowns());
  for (Eigen::Index i = 0; i < v.size(); ++i) v[i] = std::sin(1.0 + 0.7 * static_cast<double>(i));

  Hessian hessian(model);
  hessian.assemble({rest, c.scene.values}, Curvature::exact, nullptr);
  EXPECT_FALSE(hessian.iterate(v, 0.1)) << "without a factor";
  ASSERT_TRUE(hessian.factorise());
  hessian.assemble({pulled.u(), pulled.p()}, Curvature::exact, nullptr);
  const auto x = hessian.iterate(v, 0.1);
  ASSERT_TRUE(x);
  // The residual in the norm of the factor's inverse, by that factor and another evaluation of the Hessian.
  const Eigen::VectorXd Hx =
      model.restrict_to_free(model.hessian_times({pulled.u(), pulled.p()}, model.extend_from_free(*x)));
  const Eigen::VectorXd r = v - Hx;
  EXPECT_LE(r.dot(hessian.solve(r).col(0)), 0.1001 * 0.1001 * v.dot(hessian.solve(v).col(0)));
  EXPECT_GT(r.norm(), 1e-6 * v.norm()) << "that factor is of another state";

  EXPECT_FALSE(hessian.iterate(v, 1e-12)) << "for as long as a factorisation takes, and no longer";
  hessian.drop_factor();
  EXPECT_FALSE(hessian.iterate(v, 0.1));
}

TEST(IteratedNewton, NegativeCurvatureIsLeftToAFactorisation) {
  const Column c = wide();
  const Model& model = *c.scene.model;
  Hessian hessian(model);
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(model.unknowns());
  hessian.assemble({rest, c.scene.values}, Curvature::exact, nullptr);
  ASSERT_TRUE(hessian.factorise());
  const Eigen::VectorXd load = model.restrict_to_free(c.across);
  EXPECT_TRUE(hessian.iterate(load, 1e-3));
  // Straight, and shortened by a tenth: beyond Euler's load, so that bending costs less than nothing.
  Eigen::VectorXd u = rest;
  for (int i = 0; i < model.mesh().node_count(); ++i) u[3 * i + 2] = -0.1 * model.mesh().node(i)[2];
  hessian.assemble({u, c.scene.values}, Curvature::exact, nullptr);
  EXPECT_FALSE(hessian.iterate(load, 1e-3));
  EXPECT_FALSE(hessian.factorise());
}

TEST(IteratedNewton, ComesToTheSameStateWithOneFactorisationAndShowsThatItIsAMinimum) {
  const Column c = wide();
  Equilibrium straight(*c.scene.model), iterated(*c.scene.model, iterating());
  iterated.start_at_rest(c.scene.values);
  ASSERT_EQ(iterated.solve(under(c, -60)).status, SolveStatus::converged);
  const SolveReport& report = iterated.solve(under(c, -120));
  ASSERT_EQ(report.status, SolveStatus::converged);
  EXPECT_EQ(report.factorisations, 1) << report.message();
  EXPECT_GE(report.iterations, 3);
  EXPECT_TRUE(iterated.has_factor());

  straight.start_at_rest(c.scene.values);
  ASSERT_EQ(straight.solve(under(c, -120)).status, SolveStatus::converged);
  EXPECT_LT((iterated.u() - straight.u()).cwiseAbs().maxCoeff(), 1e-9 * c.scene.model->length_scale());
  const Eigen::MatrixXd by_one = straight.sensitivities({c.force}), by_other = iterated.sensitivities({c.force});
  EXPECT_LT((by_one - by_other).norm(), 1e-7 * by_one.norm());

  iterated.drop_factor();
  EXPECT_EQ(iterated.solve(under(c, -180)).factorisations, 2);  // one to go by, and the last
}

// Nearly incompressible: turned by a large step, its stiff directions are no more those of the factor before, and a
// residual that is small beside theirs says nothing of bending.
TEST(IteratedNewton, ALargeStepOfAStiffSolidIsNotCutShort) {
  SceneBuilder builder(box(graded(20e-3, 2), graded(20e-3, 2), graded(100e-3, 10), 2, "beam"), {}, 1.0);
  builder.add_solid("beam", "neo_hookean", {{"E", 1e6}, {"nu", 0.499}}, Formulation::locking_free);
  builder.fix("zmin", {0, 1, 2});
  const int force = builder.declare({"force", "F", "N", 0, 1e6, "load"}, 0.0);
  builder.add_force("zmax", Eigen::Vector3d(1, 0, 0), force);
  const Scene scene = builder.build();
  Params p = scene.values;
  p[force] = 1.5;
  std::array<int, 2> steps{};
  std::array<Eigen::VectorXd, 2> u;
  for (size_t k : {0, 1}) {
    Equilibrium equilibrium(*scene.model, k == 0 ? EquilibriumOptions() : iterating());
    equilibrium.start_at_rest(scene.values);
    ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged);
    steps[k] = equilibrium.report().iterations;
    u[k] = equilibrium.u();
  }
  EXPECT_LT((u[1] - u[0]).cwiseAbs().maxCoeff(), 1e-9 * scene.model->length_scale());
  EXPECT_GT(u[0].cwiseAbs().maxCoeff(), 30e-3);
  EXPECT_LE(steps[1], 1.5 * steps[0]);
}

TEST(IteratedNewton, AColumnThatStoodStraightBuckles) {
  const Column c = column(30e-3, 100e-3, {3, 4, 10});
  Equilibrium equilibrium(*c.scene.model, iterating());
  equilibrium.start_at_rest(c.scene.values);
  ASSERT_EQ(equilibrium.solve(under(c, 0.85 * c.euler)).status, SolveStatus::converged);
  EXPECT_FALSE(equilibrium.report().left_saddle);
  EXPECT_NEAR(c.across.dot(equilibrium.u()), 0.0, 1e-6);
  ASSERT_EQ(equilibrium.solve(under(c, 1.05 * c.euler)).status, SolveStatus::converged);
  EXPECT_TRUE(equilibrium.report().left_saddle);
  EXPECT_GT(c.across.dot(equilibrium.u()), 10e-3);
}

// It bends as well one way as across it: two unstable modes that no shorter load step tells apart. The top's place on
// the elastica is Timoshenko and Gere's (table 2-1), to what the shear of so short a column changes.
TEST(Equilibrium, ASquareColumnInSpaceBuckles) {
  const Column c = column(20e-3, 100e-3, {2, 2, 10});
  Equilibrium equilibrium(*c.scene.model);
  equilibrium.start_at_rest(c.scene.values);
  ASSERT_EQ(equilibrium.solve(under(c, 1.1517 * c.euler)).status, SolveStatus::converged);
  EXPECT_TRUE(equilibrium.report().left_saddle);
  EXPECT_LT(equilibrium.report().iterations, 100) << equilibrium.report().message();
  EXPECT_NEAR(c.down.dot(equilibrium.u()), (1 - 0.741) * 100e-3, 5e-3);
}

}  // namespace
}  // namespace taut::test

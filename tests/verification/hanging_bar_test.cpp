#include <gtest/gtest.h>

#include <cmath>

#include "sim/terms/load.hpp"
#include "tests/support/mesh_checks.hpp"
#include "tests/support/problems.hpp"

// A bar that hangs from its upper end under its own weight.
namespace taut {
namespace {

using namespace test;

constexpr double L = 0.3, W = 0.02, E = 1e5, rho = 1000, g = 9.81;

/// Along x, clamped sideways only as far as rigid motions need; `W` wide.
struct HangingBar {
  Scene scene;
  int gravity;
};
HangingBar hanging_bar(int d, double nu, int cells) {
  SceneBuilder builder(d == 2 ? rectangle(graded(L, cells), graded(W, 1), 2, "bar")
                              : box(graded(L, cells), graded(W, 1), graded(W, 1), 2, "bar"),
                       Plane::strain, 0.05);
  builder.add_solid("bar", "neo_hookean", {{"E", E}, {"nu", nu}});
  const int gravity = builder.declare({"g", "g", "m/s2", 0, 100, "gravity", false}, 0.0);
  builder.add_weight("bar", rho, Eigen::VectorXd::Unit(d, 0), gravity);
  builder.fix("xmin", {0});
  builder.fix("ymin", {1});
  if (d == 3) builder.fix("zmin", {2});
  return {builder.build(), gravity};
}

Eigen::VectorXd hang(const HangingBar& bar, double gravity) {
  Equilibrium equilibrium(*bar.scene.model);
  equilibrium.start_at_rest(bar.scene.values);
  Params p = bar.scene.values;
  p[bar.gravity] = gravity;
  EXPECT_EQ(equilibrium.solve(p).status, SolveStatus::converged) << equilibrium.report().message();
  return equilibrium.u();
}

double mean_drop(const Mesh& mesh, const std::string& tag, const Eigen::VectorXd& u) {
  return mean_weights(mesh, mesh.select(tag), Eigen::VectorXd::Unit(mesh.dimension(), 0)).dot(u);
}

/// Displacement per unit g of a linear bar with free sides whose middle of the upper end is held, y = z = 0 being
/// planes of symmetry: rho/E [L x - x^2/2 - nu (y^2 + z^2)/2] along, -nu rho/E (L - x) y across. Plane strain has E/(1
/// - nu^2) for E and nu/(1 - nu) for nu.
Eigen::VectorXd linear_bar(const Eigen::VectorXd& X, double nu, bool plane_strain) {
  const double modulus = plane_strain ? E / (1 - nu * nu) : E, ratio = plane_strain ? nu / (1 - nu) : nu;
  Eigen::VectorXd u = -ratio * rho / modulus * (L - X[0]) * X;
  u[0] = rho / modulus * (L * X[0] - 0.5 * X[0] * X[0] - 0.5 * ratio * X.tail(X.size() - 1).squaredNorm());
  return u;
}

TEST(HangingBar, SmallDisplacementsAreExactAtEveryNodeOfQuadraticElements) {
  struct {
    int d;
    double nu;
    Plane plane;
  } const cases[] = {{2, 0.0, Plane::strain}, {2, 0.3, Plane::strain}, {2, 0.3, Plane::stress},
                     {3, 0.0, Plane::strain}, {3, 0.3, Plane::strain}, {3, 0.45, Plane::strain}};
  for (const auto& c : cases) {
    Mesh mesh = c.d == 2 ? rectangle(graded(L, 5, 2.0), graded(W, 2), 2, "bar")
                         : box(graded(L, 5, 2.0), graded(W, 2), graded(W, 1), 2, "bar");
    ParameterTable table;
    SolidDefinition definition;
    definition.plane = c.plane;
    for (const ParameterSpec& spec : material_parameters("neo_hookean"))
      definition.parameters.push_back(table.declare(spec));
    const int density = table.declare({"rho", "rho", "kg/m3", 0, 1e5, "density", false});
    const int gravity = table.declare({"g", "g", "m/s2", 0, 100, "gravity", false});
    const bool plane_strain = c.d == 2 && c.plane == Plane::strain;
    std::vector<Support> supports;
    for (int i = 0; i < mesh.node_count(); ++i) {
      const Eigen::VectorXd X = mesh.node(i), u = linear_bar(X, c.nu, plane_strain);
      if (X[0] == 0) supports.push_back({i * c.d, gravity, u[0]});
      for (int k = 1; k < c.d; ++k) {
        if (X[k] == 0) supports.push_back({i * c.d + k, -1, 0});
      }
    }
    std::vector<std::unique_ptr<Term>> terms;
    terms.push_back(make_solid(mesh, definition));
    terms.push_back(make_load(body_weights(mesh, 0, Eigen::VectorXd::Unit(c.d, 0)), {density, gravity}));
    const Model model(std::move(mesh), std::move(table), std::move(terms), std::move(supports));
    Equilibrium equilibrium(model, {.step_tolerance = 1e-15});
    const double little = 1e-8 * g;
    equilibrium.start_at_rest(Eigen::Vector4d(E, c.nu, rho, 0));
    ASSERT_EQ(equilibrium.solve(Eigen::Vector4d(E, c.nu, rho, little)).status, SolveStatus::converged);
    const double drop = rho * little * L * L / (2 * E);
    for (int i = 0; i < model.mesh().node_count(); ++i) {
      const Eigen::VectorXd expected = little * linear_bar(model.mesh().node(i), c.nu, plane_strain);
      EXPECT_LE((equilibrium.u().segment(i * c.d, c.d) - expected).norm(), 1e-8 * drop) << c.d << "D, nu = " << c.nu;
    }
  }
}

/// Drop of the end with nu = 0: P = (c - 1/c) E / 2 = rho g (L - X), so that the stretch is c = s + sqrt(1 + s^2) with
/// s = rho g (L - X) / E, and its integral is E / (rho g) [s^2 + s sqrt(1 + s^2) + asinh s] / 2.
double large_drop(double gravity) {
  const double s = rho * gravity * L / E;
  return E / (rho * gravity) * 0.5 * (s * s + s * std::sqrt(1 + s * s) + std::asinh(s)) - L;
}

TEST(HangingBar, LargeDropIsThatOfTheNonlinearClosedForm) {
  for (double gravity : {g, 10 * g, 50 * g}) {
    const double expected = large_drop(gravity);
    ASSERT_GT(expected / L, 0.01);
    for (int d : {2, 3}) {
      double last = INFINITY;
      for (int cells : {4, 8, 16}) {
        const HangingBar bar = hanging_bar(d, 0.0, cells);
        const double error = std::abs(mean_drop(bar.scene.model->mesh(), "xmax", hang(bar, gravity)) / expected - 1);
        EXPECT_LT(error, std::max(last / 7, 1e-9)) << d << "D, " << cells << " cells, g = " << gravity;
        last = error;
      }
      EXPECT_LT(last, 1e-5);
    }
  }
}

TEST(HangingBar, TheSupportCarriesTheWholeWeight) {
  const HangingBar bar = hanging_bar(3, 0.3, 4);
  const Eigen::VectorXd u = hang(bar, g);
  Params p = bar.scene.values;
  p[bar.gravity] = g;
  Eigen::VectorXd gradient;
  Assembly out;
  out.gradient = &gradient;
  bar.scene.model->evaluate({u, p}, out);
  double reaction = 0;
  for (int node : bar.scene.model->mesh().select("xmin").nodes()) reaction += gradient[3 * node];
  EXPECT_NEAR(reaction, -rho * g * L * W * W, 1e-9);
}

}  // namespace
}  // namespace taut

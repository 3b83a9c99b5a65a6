#include "sim/terms/inertia.hpp"

#include <Eigen/Geometry>

#include "sim/mesh/weights.hpp"
#include "sim/terms/solid.hpp"
#include "tests/support/term_battery.hpp"

namespace taut {
namespace {

using namespace test;

// Parameters of all cases: density, thickness, alpha, E, nu, beta, mass.
enum { density, thickness, alpha, youngs_modulus, poisson_ratio, beta, mass };

ParameterTable table() {
  ParameterTable table;
  table.declare({"density", "rho", "kg/m3", 0, 1e5, "density"});
  table.declare({"thickness", "t", "m", 0, 1, "thickness"});
  table.declare({"alpha", "alpha", "1/s", 0, 1e5, "mass-proportional damping"});
  table.declare({"E", "E", "Pa", 0, 1e12, "Young's modulus"});
  table.declare({"nu", "nu", "1", 0, 0.5, "Poisson's ratio"});
  table.declare({"beta", "beta", "s", 0, 1, "stiffness-proportional damping"});
  table.declare({"mass", "m", "kg", 0, 1e3, "hung mass"});
  return table;
}
Params values() {
  Params p(7);
  p << 1200, 0.03, 3, 2e5, 0.3, 0.004, 0.2;
  return p;
}

/// Some state of the past and the rates of a two-step formula.
std::shared_ptr<TimeStep> some_step(const Mesh& mesh) {
  auto step = std::make_shared<TimeStep>();
  step->rate = {150, -200, 50};
  step->inertia = 150 * 150;
  step->reference = random_state(mesh, 0.05, 0.01, 21);
  step->previous = random_state(mesh, 0.08, 0.01, 22);
  step->before = random_state(mesh, 0.06, 0.01, 23);
  return step;
}

enum class Kind { consistent, lumped, viscous, point };

TermUnderTest case_of(Kind kind, ElementShape shape, bool plane_stress = false) {
  Mesh mesh = irregular_mesh(shape);
  const int t = mesh.dimension() == 2 ? thickness : -1;
  std::unique_ptr<Term> term;
  if (kind == Kind::viscous)
    term = make_viscosity(mesh, {0, youngs_modulus, poisson_ratio, beta, t, plane_stress});
  else if (kind == Kind::point)
    term = make_point_mass(mesh, mesh.select("xmax"), mass);
  else
    term = make_inertia(mesh, {0, density, t, alpha, kind == Kind::lumped ? MassForm::lumped : MassForm::consistent});
  Eigen::VectorXd u = random_state(mesh, 0.1, 0.01, 5);
  std::shared_ptr<TimeStep> step = some_step(mesh);
  TermUnderTest result = term_under_test(std::move(mesh), table(), std::move(term), values(), std::move(u),
                                         std::string(name_of(shape)) + " " + std::to_string(static_cast<int>(kind)));
  result.step = step;
  return result;
}

template <class Action>
void for_each_case(Action&& action) {
  for (ElementShape shape : all_shapes) {
    for (Kind kind : {Kind::consistent, Kind::lumped, Kind::viscous, Kind::point}) action(case_of(kind, shape));
  }
  action(case_of(Kind::viscous, ElementShape::tri6, true));
}

TEST(Inertia, GradientAndHessianAreTheDerivativesOfTheEnergy) {
  for_each_case([](const TermUnderTest& t) { expect_derivatives(t, 1e-4); });
}

TEST(Inertia, ParameterDerivativesAreThoseOfTheGradient) {
  for_each_case([](const TermUnderTest& t) { expect_parameter_derivatives(t); });
}

TEST(Inertia, HessianIsSymmetricAndItsProjectionPositiveSemiDefinite) {
  for_each_case([](const TermUnderTest& t) {
    expect_symmetric_hessian(t);
    expect_projection_is_semidefinite(t);
  });
}

TEST(Inertia, ContributesNothingInStatics) {
  for_each_case([](const TermUnderTest& t) {
    EXPECT_EQ(energy_of(t.model, t.u, t.p), 0.0);
    EXPECT_EQ(gradient_of(t.model, t.u, t.p).norm(), 0.0);
    EXPECT_EQ(hessian_of(t.model, t.u, t.p).norm(), 0.0);
  });
}

TEST(Inertia, HistoryProductsAreDerivativesWithRespectToThePast) {
  for_each_case([](const TermUnderTest& t) {
    std::mt19937 random(3);
    for (History q : {History::reference, History::previous, History::before}) {
      const Eigen::VectorXd x = random_vector(t.u.size(), random), y = random_vector(t.u.size(), random);
      const Eigen::VectorXd product = t.model.history_product(t.at(), q, x, false);
      const Eigen::VectorXd gradient = gradient_of(t.model, t.u, t.p, t.step.get());
      auto moved = [&](double h) {
        TimeStep step = *t.step;
        (q == History::reference ? step.reference : q == History::previous ? step.previous : step.before) += h * x;
        return gradient_of(t.model, t.u, t.p, &step);
      };
      const double size = 5e-4;  // elements must not turn inside out
      expect_taylor_order([&](double h) { return (moved(h) - gradient - h * product).norm(); }, 2,
                          1e-13 * (gradient.norm() + size * product.norm()), size, 6, t.name);
      const double there = y.dot(product), back = x.dot(t.model.history_product(t.at(), q, y, true));
      EXPECT_NEAR(there, back, 1e-12 * (std::abs(there) + product.norm())) << t.name;
    }
  });
}

TEST(Inertia, KineticEnergyOfALinearVelocityFieldIsItsIntegral) {
  // v = (a + b x, c y): integral over [0, l] x [0, h] (x [0, w]) in closed form; lumped masses keep the total.
  const double l = 0.2, h = 0.1, w = 0.05, a = 2, b = 30, c = -20;
  for (ElementShape shape : all_shapes) {
    const int d = dimension_of(shape), order = order_of(shape);
    const Mesh mesh = d == 2 ? rectangle(graded(l, 3), graded(h, 2), order, "body")
                             : box(graded(l, 3), graded(h, 2), graded(w, 1), order, "body");
    for (MassForm form : {MassForm::consistent, MassForm::lumped}) {
      TermUnderTest t =
          term_under_test(mesh, table(), make_inertia(mesh, {0, density, d == 2 ? thickness : -1, -1, form}), values(),
                          Eigen::VectorXd::Zero(mesh.X.size()), std::string(name_of(shape)));
      TimeStep step;
      step.inertia = 1;
      step.rate = {1, -1, 0};
      step.previous = t.u;
      auto kinetic = [&](bool linear) {
        step.reference = t.u;
        for (int i = 0; i < mesh.node_count(); ++i) {
          step.reference[i * d] -= linear ? a + b * mesh.node(i)[0] : 1;
          step.reference[i * d + 1] -= linear ? c * mesh.node(i)[1] : 0;
        }
        Assembly out;
        t.model.evaluate_inertia({t.u, t.p, &step}, out);
        return out.energy;
      };
      const double m = t.p[density] * l * h * (d == 2 ? t.p[thickness] : w);
      EXPECT_NEAR(kinetic(false), 0.5 * m, 1e-13 * m);
      if (form == MassForm::lumped) continue;
      const double mean = a * a + a * b * l + b * b * l * l / 3 + c * c * h * h / 3;
      EXPECT_NEAR(kinetic(true), 0.5 * m * mean, 1e-12 * m * mean) << name_of(shape);
    }
  }
}

TEST(Viscosity, ARigidMotionCostsNothing) {
  for (ElementShape shape : all_shapes) {
    TermUnderTest t = case_of(Kind::viscous, shape);
    const Mesh& mesh = t.model.mesh();
    const int d = mesh.dimension();
    auto turned = [&](double angle, double shift) {
      Eigen::MatrixXd R = Eigen::MatrixXd::Identity(d, d);
      R.topLeftCorner(2, 2) = Eigen::Rotation2Dd(angle).toRotationMatrix();
      Eigen::VectorXd u(mesh.X.size());
      for (int i = 0; i < mesh.node_count(); ++i)
        u.segment(i * d, d) =
            R * (mesh.node(i) + t.u.segment(i * d, d)) - mesh.node(i) + Eigen::VectorXd::Constant(d, shift);
      return u;
    };
    const Eigen::VectorXd u = turned(1.1, 0.3);
    t.step->previous = turned(0.2, -0.1);
    t.step->before = turned(-0.4, 0);
    TimeStep straight = *t.step;  // the same states, but one of them stretched
    straight.previous *= 1.01;
    EXPECT_LE(energy_of(t.model, u, t.p, t.step.get()), 1e-20 * energy_of(t.model, u, t.p, &straight)) << t.name;
  }
}

TEST(Viscosity, AShearThatKeepsTheVolumeCostsNoVolumeViscosity) {
  // Simple shear g: F = [1 g; 0 1], E = [0 g/2; g/2 g^2/2], J = 1. With nu near 1/2 lambda is 5000 mu; none of it
  // counts.
  for (ElementShape shape : all_shapes) {
    TermUnderTest t = case_of(Kind::viscous, shape);
    const Mesh& mesh = t.model.mesh();
    const int d = mesh.dimension();
    t.p[poisson_ratio] = 0.4999;
    const auto sheared = [&](double g) {
      Eigen::VectorXd u = Eigen::VectorXd::Zero(mesh.X.size());
      for (int i = 0; i < mesh.node_count(); ++i) u[i * d] = g * mesh.node(i)[1];
      return u;
    };
    const double g = 0.6, g1 = 0.4, a0 = 100;
    *t.step = {0, sheared(0), {a0, -a0, 0}, sheared(g1), {}};
    double volume = 0;
    for (double measure : element_measures(mesh)) volume += measure;
    const double mu = t.p[youngs_modulus] / (2 * (1 + t.p[poisson_ratio]));
    const double off = a0 * (g - g1) / 2, diagonal = a0 * (g * g - g1 * g1) / 2;
    const double thick = d == 2 ? t.p[thickness] : 1.0;
    const double expected = t.p[beta] * thick * volume / (2 * a0) * 2 * mu * (2 * off * off + diagonal * diagonal);
    EXPECT_NEAR(energy_of(t.model, sheared(g), t.p, t.step.get()), expected, 1e-9 * expected) << t.name;
  }
}

TEST(Viscosity, ForSmallStrainsItIsBetaTimesTheElasticHessianAtRest) {
  for (ElementShape shape : all_shapes) {
    TermUnderTest t = case_of(Kind::viscous, shape);
    SolidDefinition solid;
    solid.parameters = {youngs_modulus, poisson_ratio};
    solid.thickness = t.model.mesh().dimension() == 2 ? thickness : -1;
    solid.formulation = order_of(shape) == 2 ? Formulation::locking_free : Formulation::standard;
    const TermUnderTest elastic = term_under_test(t.model.mesh(), table(), make_solid(t.model.mesh(), solid), t.p,
                                                  Eigen::VectorXd::Zero(t.u.size()), "elastic");
    *t.step = {0, elastic.u, {100, -100, 0}, elastic.u, {}};
    const Eigen::MatrixXd K = hessian_of(elastic.model, elastic.u, t.p);
    const Eigen::MatrixXd C = hessian_of(t.model, elastic.u, t.p, Curvature::exact, t.step.get());
    EXPECT_LE((C - 100 * t.p[beta] * K).norm(), 1e-12 * C.norm()) << t.name;
  }
}

}  // namespace
}  // namespace taut

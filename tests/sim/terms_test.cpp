#include "sim/materials/all.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/scene/scene.hpp"
#include "sim/terms/load.hpp"
#include "sim/terms/solid.hpp"
#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"
#include "tests/support/term_battery.hpp"

namespace taut {
namespace {

using namespace test;

std::string name_of_case(ElementShape shape, Formulation formulation, Plane plane) {
  return std::string(name_of(shape)) + (formulation == Formulation::locking_free ? "_locking_free" : "") +
         (plane == Plane::stress ? "_plane_stress" : "");
}

/// A solid of E = 3, nu = `nu`, thickness 0.5, and one parameter that it does not depend on.
TermUnderTest solid_case(ElementShape shape, Formulation formulation, Plane plane, double strain, double noise,
                         double nu = 0.4, unsigned seed = 5) {
  ParameterTable table;
  SolidDefinition definition;
  for (const ParameterSpec& spec : material_parameters("neo_hookean"))
    definition.parameters.push_back(table.declare(spec));
  table.declare({"other", "x", "1", -10, 10, "a number of some other term", false});
  const int thickness = table.declare({"thickness", "t", "m", 1e-9, 1e3, "thickness", false});
  if (dimension_of(shape) == 2) definition.thickness = thickness;
  definition.formulation = formulation;
  definition.plane = plane;
  Mesh mesh = irregular_mesh(shape);
  auto term = make_solid(mesh, definition);
  Eigen::VectorXd u = random_state(mesh, strain, noise, seed);
  return term_under_test(std::move(mesh), std::move(table), std::move(term), Eigen::Vector4d(3.0, nu, 1.0, 0.5),
                         std::move(u), name_of_case(shape, formulation, plane));
}

template <class Action>
void for_each_solid(double strain, double noise, Action&& action) {
  for (ElementShape shape : all_shapes) {
    action(solid_case(shape, Formulation::standard, Plane::strain, strain, noise));
    if (order_of(shape) == 2) action(solid_case(shape, Formulation::locking_free, Plane::strain, strain, noise));
    if (dimension_of(shape) == 2) action(solid_case(shape, Formulation::standard, Plane::stress, strain, noise));
  }
}

TEST(Solid, GradientAndHessianAreTheDerivativesOfTheEnergy) {
  for_each_solid(0.1, 0.01, [](const TermUnderTest& t) { expect_derivatives(t, 2e-3); });
}

TEST(Solid, ParameterDerivativesAreThoseOfTheGradient) {
  for_each_solid(0.1, 0.01, [](const TermUnderTest& t) {
    expect_parameter_derivatives(t, 0.03);
    EXPECT_EQ(t.model.parameter_gradient({t.u, t.p}, 2).norm(), 0.0) << "a parameter of another term";
    EXPECT_GT(t.model.parameter_gradient({t.u, t.p}, 0).norm(), 0.0);
    EXPECT_GT(t.model.parameter_gradient({t.u, t.p}, 1).norm(), 0.0);
  });
}

TEST(Solid, HessianIsSymmetric) {
  for_each_solid(0.1, 0.01, expect_symmetric_hessian);
}

TEST(Solid, ProjectedHessianIsPositiveSemiDefiniteWhereTheExactOneIsNot) {
  for_each_solid(0.15, 0.03, [](const TermUnderTest& t) {
    const Eigen::MatrixXd exact = hessian_of(t.model, t.u, t.p);
    const Eigen::VectorXd eigenvalues = Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(exact).eigenvalues();
    EXPECT_LT(eigenvalues[0], -1e-4 * eigenvalues.cwiseAbs().maxCoeff()) << t.name << ": the state tests nothing";
    expect_projection_is_semidefinite(t);
  });
}

TEST(Solid, ProjectionChangesNothingAtRest) {
  for_each_solid(0, 0, [](const TermUnderTest& t) {
    const Eigen::MatrixXd exact = hessian_of(t.model, t.u, t.p);
    EXPECT_LE((hessian_of(t.model, t.u, t.p, Curvature::projected) - exact).norm(), 1e-13 * exact.norm()) << t.name;
  });
}

TEST(Solid, ExertsNoNetForceOrMoment) {
  for_each_solid(0.2, 0.02, expect_no_net_force_or_moment);
}

TEST(Solid, RestStoresNoEnergyAndRigidMotionsExertNoForce) {
  for_each_solid(0, 0, [](TermUnderTest t) {
    EXPECT_EQ(energy_of(t.model, t.u, t.p), 0.0) << t.name;
    EXPECT_EQ(gradient_of(t.model, t.u, t.p).norm(), 0.0) << t.name;
    const double stiffness = hessian_of(t.model, t.u, t.p).norm();
    const Mesh& mesh = t.model.mesh();
    const int d = mesh.dimension();
    Eigen::MatrixXd Q = Eigen::MatrixXd::Identity(d, d);
    Q.topLeftCorner<2, 2>() << std::cos(2.0), -std::sin(2.0), std::sin(2.0), std::cos(2.0);
    for (int i = 0; i < mesh.node_count(); ++i) {
      t.u.segment(i * d, d) = Q * mesh.node(i) - mesh.node(i) + Eigen::VectorXd::Constant(d, 0.3);
    }
    EXPECT_NEAR(energy_of(t.model, t.u, t.p), 0.0, 1e-15 * stiffness) << t.name;
    EXPECT_LE(gradient_of(t.model, t.u, t.p).norm(), 1e-14 * stiffness * mesh.diagonal()) << t.name;
  });
}

TEST(Solid, HomogeneousDeformationStoresTheMaterialsEnergyInEveryFormulation) {
  const NeoHookean<> material(std::array{3.0, 0.4});
  for_each_solid(0.2, 0, [&](const TermUnderTest& t) {
    if (t.name.ends_with("plane_stress")) return;
    const int d = t.model.mesh().dimension();
    std::mt19937 random(5);  // as in random_state
    const Eigen::MatrixXd H = 0.2 * random_vector(d * d, random).reshaped(d, d);
    const double density = d == 2 ? material.energy(Tensor<double, 2>(H)) : material.energy(Tensor<double, 3>(H));
    const double expected = density * total_measure(t.model.mesh()) * (d == 2 ? 0.5 : 1.0);
    EXPECT_NEAR(energy_of(t.model, t.u, t.p), expected, 1e-13 * expected) << t.name;
  });
}

TEST(Solid, AveragingTheDilatationNeverStoresMoreEnergy) {
  for (ElementShape shape : {ElementShape::tri6, ElementShape::tet10}) {
    const TermUnderTest a = solid_case(shape, Formulation::standard, Plane::strain, 0.1, 0.01, 0.49);
    const TermUnderTest b = solid_case(shape, Formulation::locking_free, Plane::strain, 0.1, 0.01, 0.49);
    EXPECT_LT(energy_of(b.model, b.u, b.p), 0.9 * energy_of(a.model, a.u, a.p));
  }
}

TEST(Solid, AnInvertedElementHasInfiniteEnergyInEveryFormulation) {
  for_each_solid(0, 0, [](TermUnderTest t) {
    const int d = t.model.mesh().dimension();
    for (int i = 0; i < t.model.mesh().node_count(); ++i) t.u[i * d] = -2 * t.model.mesh().node(i)[0];
    EXPECT_EQ(energy_of(t.model, t.u, t.p), std::numeric_limits<double>::infinity()) << t.name;
  });
}

TEST(Solid, SmallestJacobianSeesFoldsBetweenQuadraturePoints) {
  const Mesh mesh = rectangle({0, 1}, {0, 1}, 2, "body");
  Eigen::VectorXd u = Eigen::VectorXd::Zero(mesh.X.size());
  EXPECT_NEAR(smallest_jacobian(mesh, u), 1.0, 1e-15);
  for (int i = 0; i < mesh.node_count(); ++i) u[2 * i] = 0.25 * mesh.node(i)[0];
  EXPECT_NEAR(smallest_jacobian(mesh, u), 1.25, 1e-15);
  const int* nodes = mesh.element(0);
  u.setZero();
  u.segment<2>(2 * nodes[3]) = 0.35 * (mesh.node(nodes[1]) - mesh.node(nodes[0]));  // past the quarter point
  EXPECT_LT(smallest_jacobian(mesh, u), 0.0);
}

TEST(Solid, WrongDefinitionsAreRefused) {
  const Mesh flat = irregular_mesh(ElementShape::tri6);
  SolidDefinition definition{.parameters = {0, 1}};
  definition.law = "neo_hokean";
  expect_input_error([&] { make_solid(flat, definition); }, {"'neo_hokean'", "did you mean 'neo_hookean'?"});
  definition.law = "neo_hookean";
  definition.plane = Plane::stress;
  definition.formulation = Formulation::locking_free;
  expect_input_error([&] { make_solid(flat, definition); }, {"plane stress does not lock", "standard"});
  definition.plane = Plane::strain;
  for (ElementShape shape : {ElementShape::tri3, ElementShape::tet4}) {
    expect_input_error([&] { make_solid(irregular_mesh(shape), definition); }, {"quadratic elements", "standard"});
  }
}

/// Parameters of loads: a force, a mass, g, a density, a thickness.
TermUnderTest load_case(ElementShape shape, const std::function<Eigen::VectorXd(const Mesh&)>& weights,
                        std::vector<int> factors, const std::string& name) {
  ParameterTable table;
  for (const char* id : {"force", "mass", "g", "density", "thickness"})
    table.declare({id, id, "SI", -1e9, 1e9, id, false});
  Mesh mesh = irregular_mesh(shape);
  auto term = make_load(weights(mesh), std::move(factors));
  Eigen::VectorXd u = random_state(mesh, 0.1, 0.05, 3), p(5);
  p << 2.0, 0.4, 9.81, 1100.0, 0.03;
  return term_under_test(std::move(mesh), std::move(table), std::move(term), p, std::move(u), name);
}

Eigen::VectorXd slanted(int d) {
  return d == 2 ? vec({3, -4}) : vec({2, -3, 6});
}

template <class Action>
void for_each_load(Action&& action) {
  for (ElementShape shape : all_shapes) {
    const int d = dimension_of(shape);
    const auto face = [d](const Mesh& mesh) { return mean_weights(mesh, mesh.select("xmax"), slanted(d)); };
    const auto corner = [d](const Mesh& mesh) {
      return mean_weights(mesh, mesh.select(d == 2 ? "xmax & ymin" : "xmax & ymin & zmax"), slanted(d));
    };
    const auto body = [d](const Mesh& mesh) { return body_weights(mesh, 0, slanted(d)); };
    const auto point = [d](const Mesh& mesh) {
      return point_weights(mesh, locate(mesh, mesh.node(0) + Eigen::VectorXd::Constant(d, 0.02)), slanted(d));
    };
    const std::string s(name_of(shape));
    action(load_case(shape, face, {0}, s + " force"), 2.0);
    action(load_case(shape, corner, {0}, s + " force on a corner"), 2.0);
    action(load_case(shape, face, {1, 2}, s + " hung mass"), 0.4 * 9.81);
    action(load_case(shape, face, {0, 4}, s + " traction"), 2.0 * 0.03);
    action(load_case(shape, body, {3, 2, 4}, s + " weight"),
           1100.0 * 9.81 * 0.03 * total_measure(irregular_mesh(shape)));
    action(load_case(shape, point, {0}, s + " point force"), 2.0);
  }
}

TEST(Load, DerivativesAreThoseOfItsPotential) {
  for_each_load([](const TermUnderTest& t, double) {
    expect_derivatives(t, 2e-3);
    expect_parameter_derivatives(t);
  });
}

TEST(Load, TotalForceIsTheProductOfItsFactorsInItsDirection) {
  for_each_load([](const TermUnderTest& t, double expected) {
    const int d = t.model.mesh().dimension();
    Eigen::VectorXd total = Eigen::VectorXd::Zero(d);
    const Eigen::VectorXd force = -gradient_of(t.model, t.u, t.p);
    for (int i = 0; i < t.model.mesh().node_count(); ++i) total += force.segment(i * d, d);
    EXPECT_LE((total - expected * slanted(d).normalized()).norm(), 1e-14 * expected) << t.name;
  });
}

TEST(Load, EachFactorHasItsDerivativeAndOthersHaveNone) {
  const TermUnderTest t = load_case(
      ElementShape::tri6, [](const Mesh& mesh) { return body_weights(mesh, 0, slanted(2)); }, {3, 2, 4}, "weight");
  const Eigen::VectorXd gradient = gradient_of(t.model, t.u, t.p);
  for (int k : {2, 3, 4}) {
    EXPECT_LE((t.model.parameter_gradient({t.u, t.p}, k) - gradient / t.p[k]).norm(), 1e-14 * gradient.norm() / t.p[k]);
  }
  for (int k : {0, 1}) EXPECT_EQ(t.model.parameter_gradient({t.u, t.p}, k).norm(), 0.0);
}

/// Polynomials that the elements represent: of degree 1 or 2.
double polynomial(const Eigen::VectorXd& X, int order) {
  double value = 0.3 + X.dot(Eigen::VectorXd::LinSpaced(X.size(), 1.0, 2.0));
  if (order == 2) value += 5 * X[0] * X[1] - 7 * X[1] * X[1] + 3 * X[0] * X[X.size() - 1];
  return value;
}

/// Integral of the polynomial over a simplex by the degree-2 rule of edge and vertex values, exact for quadratic ones.
double simplex_mean(const std::vector<Eigen::VectorXd>& corners, int order) {
  const size_t n = corners.size();
  const double d = static_cast<double>(n) - 1;
  double at_vertices = 0, at_middles = 0;
  for (size_t a = 0; a < n; ++a) {
    at_vertices += polynomial(corners[a], order);
    for (size_t b = 0; b < a; ++b) at_middles += polynomial(0.5 * (corners[a] + corners[b]), order);
  }
  return ((2 - d) * at_vertices + 4 * at_middles) / ((d + 1) * (d + 2));
}

Eigen::VectorXd polynomial_state(const Mesh& mesh) {
  const int d = mesh.dimension();
  Eigen::VectorXd u = Eigen::VectorXd::Zero(mesh.X.size());
  for (int i = 0; i < mesh.node_count(); ++i) u[i * d + 1] = polynomial(mesh.node(i), order_of(mesh.shape));
  return u;
}

TEST(Load, MeanWeightsTakeTheMeanDisplacementOfAFaceExactly) {
  for (ElementShape shape : all_shapes) {
    const Mesh mesh = irregular_mesh(shape);
    const Tag tag = mesh.select("xmax");
    double integral = 0, measure = 0;
    for (int entity = 0; entity < tag.count(); ++entity) {
      const int* nodes = &tag.entities[entity * tag.nodes_per_entity];
      std::vector<Eigen::VectorXd> corners;
      for (int a = 0; a < mesh.dimension(); ++a) corners.push_back(mesh.node(nodes[a]));
      const double size = facet_normal(mesh, nodes).norm();
      integral += size * simplex_mean(corners, order_of(shape));
      measure += size;
    }
    EXPECT_NEAR(measure_of(mesh, tag), measure, 1e-15);
    const Eigen::VectorXd weights = mean_weights(mesh, tag, Eigen::VectorXd::Unit(mesh.dimension(), 1) * 7.0);
    EXPECT_NEAR(weights.dot(polynomial_state(mesh)), integral / measure, 1e-14) << name_of(shape);
  }
}

TEST(Load, BodyWeightsIntegrateTheDisplacementOfARegionExactly) {
  for (ElementShape shape : all_shapes) {
    Mesh mesh = irregular_mesh(shape);
    assign_regions(mesh, [](const Eigen::VectorXd& c) { return c[0] < 0.1 ? "left" : "right"; });
    double integral[2] = {0, 0};
    for (int e = 0; e < mesh.element_count(); ++e) {
      std::vector<Eigen::VectorXd> corners;
      for (int a = 0; a <= mesh.dimension(); ++a) corners.push_back(mesh.node(mesh.element(e)[a]));
      integral[mesh.region[e]] += measure(mesh, e) * simplex_mean(corners, order_of(shape));
    }
    for (int region : {0, 1}) {
      const Eigen::VectorXd weights = body_weights(mesh, region, Eigen::VectorXd::Unit(mesh.dimension(), 1));
      EXPECT_NEAR(weights.dot(polynomial_state(mesh)), integral[region], 1e-16) << name_of(shape);
    }
  }
}

TEST(Load, PointWeightsTakeTheDisplacementOfAMaterialPoint) {
  for (ElementShape shape : all_shapes) {
    const Mesh mesh = irregular_mesh(shape);
    const Eigen::VectorXd point = mesh.node(0) + Eigen::VectorXd::Constant(mesh.dimension(), 0.023);
    const Eigen::VectorXd weights =
        point_weights(mesh, locate(mesh, point), Eigen::VectorXd::Unit(mesh.dimension(), 1));
    EXPECT_NEAR(weights.dot(polynomial_state(mesh)), polynomial(point, order_of(shape)), 1e-14) << name_of(shape);
  }
}

/// Force that a scene's loads exert in total at rest.
Eigen::VectorXd total_load(const Scene& scene) {
  const int d = scene.model->mesh().dimension();
  const Eigen::VectorXd force =
      -gradient_of(*scene.model, Eigen::VectorXd::Zero(scene.model->unknowns()), scene.values);
  Eigen::VectorXd total = Eigen::VectorXd::Zero(d);
  for (int i = 0; i < scene.model->mesh().node_count(); ++i) total += force.segment(i * d, d);
  return total;
}

TEST(Load, ScenesGiveEachLoadItsFactors) {
  for (int d : {2, 3}) {
    const auto builder = [d] {
      SceneBuilder b(
          d == 2 ? rectangle({0, 0.1, 0.2}, {0, 0.1}, 2, "body") : box({0, 0.1, 0.2}, {0, 0.1}, {0, 0.03}, 2, "body"),
          Plane::strain, 0.03);
      b.add_solid("body", "neo_hookean", {{"E", 1e5}, {"nu", 0.3}});
      b.fix("xmin", d == 2 ? std::vector{0, 1} : std::vector{0, 1, 2});
      return b;
    };
    const auto control = [](SceneBuilder& b, const char* id, double value) {
      return b.declare({id, id, "SI", -1e9, 1e9, id, false}, value);
    };
    const Eigen::VectorXd direction = slanted(d), unit = direction.normalized();
    const auto expect_total = [&](SceneBuilder& b, double expected) {
      EXPECT_LE((total_load(b.build()) - expected * unit).norm(), 1e-14 * expected) << d << "D";
    };
    SceneBuilder force = builder(), hung = builder(), traction = builder(), line = builder(), weight = builder(),
                 point = builder();
    force.add_force("xmax", direction, control(force, "F", 3.0));
    expect_total(force, 3.0);
    const int mass = control(hung, "m", 0.2);
    hung.add_force("xmax", direction, mass, control(hung, "g", 9.81));
    expect_total(hung, 0.2 * 9.81);
    traction.add_traction("xmax", direction, control(traction, "p", 700));
    expect_total(traction, 700 * 0.1 * 0.03);
    line.add_line_load("xmax & ymax", direction, control(line, "q", 40));
    expect_total(line, 40 * 0.03);
    weight.add_weight("body", 1200, direction, control(weight, "g", 9.81));
    expect_total(weight, 1200 * 9.81 * 0.2 * 0.1 * 0.03);
    const int hung_mass = control(point, "m", 0.5);
    point.add_point_force(Eigen::VectorXd::Constant(d, 0.02), direction, hung_mass, control(point, "g", 9.81));
    expect_total(point, 0.5 * 9.81);
  }
}

TEST(Load, ATractionOnAPointIsRefused) {
  SceneBuilder builder(rectangle({0, 1}, {0, 1}, 1, "body"));
  const int control = builder.declare({"p", "p", "Pa", -1e9, 1e9, "pressure", false}, 1);
  expect_input_error([&] { builder.add_traction("xmax & ymin", Eigen::Vector2d(1, 0), control); },
                     {"traction", "an edge", "'xmax & ymin' is not one"});
  expect_input_error([&] { builder.add_force("xmax", Eigen::Vector2d(0, 0), control); },
                     {"direction", "2 finite numbers"});
  expect_input_error([&] { builder.add_force("xmax", Eigen::Vector3d(0, 0, 1), control); }, {"2D", "2 finite numbers"});
}

}  // namespace
}  // namespace taut

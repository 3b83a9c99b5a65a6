#include "sim/terms/elastic_base.hpp"

#include <Eigen/Geometry>

#include "sim/mesh/weights.hpp"
#include "tests/support/message.hpp"
#include "tests/support/term_battery.hpp"

namespace taut {
namespace {

using namespace test;

constexpr double c = 0.7, K = 3;

/// The end face of an irregular body on an elastic base, and one parameter that it does not depend on. The body is
/// turned by `angle` and deformed.
TermUnderTest base_case(ElementShape shape, double angle, double strain = 0.1, double noise = 0.01) {
  ParameterTable table;
  table.declare({"other", "x", "1", -10, 10, "a number of some other term", false});
  table.declare({"c", "c", "N m/rad", 0, 1e9, "rotation stiffness", true});
  Mesh mesh = irregular_mesh(shape);
  auto term = make_elastic_base(mesh, mesh.select("xmax"), 1, K);
  Eigen::VectorXd u = random_state(mesh, strain, noise, 5);
  const Eigen::Matrix2d R = Eigen::Rotation2Dd(angle).toRotationMatrix();
  for (int i = 0; i < mesh.node_count(); ++i)
    u.segment<2>(2 * i) = R * (mesh.node(i) + u.segment<2>(2 * i)) - mesh.node(i) + Eigen::Vector2d(0.01, -0.02);
  return term_under_test(std::move(mesh), std::move(table), std::move(term), Eigen::Vector2d(1, c), u,
                         std::string(name_of(shape)) + " turned by " + std::to_string(angle));
}

template <class Action>
void for_each_base(Action&& action) {
  for (ElementShape shape : {ElementShape::tri3, ElementShape::tri6}) {
    for (double angle : {0.0, 0.1, -1.2, 2.5}) action(base_case(shape, angle));
  }
}

TEST(ElasticBase, GradientAndHessianAreTheDerivativesOfTheEnergy) {
  for_each_base([](const TermUnderTest& t) { expect_derivatives(t, 4e-4); });
}

TEST(ElasticBase, ParameterDerivativesAreThoseOfTheGradient) {
  for_each_base([](const TermUnderTest& t) {
    expect_parameter_derivatives(t);
    EXPECT_EQ(t.model.parameter_gradient({t.u, t.p}, 0).norm(), 0.0) << "a parameter of another term";
    EXPECT_GT(t.model.parameter_gradient({t.u, t.p}, 1).norm(), 0.0);
  });
}

TEST(ElasticBase, HessianIsSymmetricAndItsProjectionPositiveSemiDefinite) {
  for_each_base([](const TermUnderTest& t) {
    expect_symmetric_hessian(t);
    expect_projection_is_semidefinite(t);
  });
}

TEST(ElasticBase, RigidMotionsStoreTheEnergyOfTheirTranslationAndRotation) {
  for (ElementShape shape : {ElementShape::tri3, ElementShape::tri6}) {
    TermUnderTest t = base_case(shape, 0, 0, 0);
    const Mesh& mesh = t.model.mesh();
    const Tag face = mesh.select("xmax");
    Eigen::Vector2d centre = Eigen::Vector2d::Zero();
    double length = 0;
    for (int e = 0; e < face.count(); ++e) {
      const int* nodes = &face.entities[static_cast<size_t>(e) * face.nodes_per_entity];
      const double share = (mesh.node(nodes[1]) - mesh.node(nodes[0])).norm();
      centre += share * 0.5 * (mesh.node(nodes[0]) + mesh.node(nodes[1]));
      length += share;
    }
    centre /= length;
    const Eigen::Vector2d shift(0.003, -0.004);
    for (double angle : {0.0, 1e-9, 0.01, 1.0, -3.0}) {
      const Eigen::Matrix2d R = Eigen::Rotation2Dd(angle).toRotationMatrix();
      for (int i = 0; i < mesh.node_count(); ++i)
        t.u.segment<2>(2 * i) = (R - Eigen::Matrix2d::Identity()) * (mesh.node(i) - centre) + shift;
      const double expected = 0.5 * K * shift.squaredNorm() + 0.5 * c * angle * angle;
      EXPECT_NEAR(energy_of(t.model, t.u, t.p), expected, 1e-13 * expected) << t.name << " " << angle;
    }
    t.u.setZero();
    EXPECT_EQ(energy_of(t.model, t.u, t.p), 0.0);
    EXPECT_EQ(gradient_of(t.model, t.u, t.p).norm(), 0.0);
  }
}

TEST(ElasticBase, AStretchOfTheFaceStoresNothing) {
  for (ElementShape shape : {ElementShape::tri3, ElementShape::tri6}) {
    TermUnderTest t = base_case(shape, 0, 0, 0);
    const Mesh& mesh = t.model.mesh();
    const Eigen::VectorXd x = mean_weights(mesh, mesh.select("xmax"), Eigen::Vector2d(1, 0)),
                          y = mean_weights(mesh, mesh.select("xmax"), Eigen::Vector2d(0, 1));
    const Eigen::Vector2d centre(x.dot(mesh.X), y.dot(mesh.X));
    for (int i = 0; i < mesh.node_count(); ++i) t.u.segment<2>(2 * i) = 0.3 * (mesh.node(i) - centre);
    EXPECT_NEAR(energy_of(t.model, t.u, t.p), 0.0, 1e-28);
  }
}

TEST(ElasticBase, AFaceWithoutARotationHasInfiniteEnergy) {
  const Mesh mesh = rectangle({0, 1}, {0, 1}, 1, "body");  // all numbers dyadic, so the moment vanishes exactly
  Eigen::VectorXd u(mesh.X.size());
  for (int i = 0; i < mesh.node_count(); ++i) u.segment<2>(2 * i) = -mesh.node(i);
  Assembly out;
  make_elastic_base(mesh, mesh.select("xmax"), 0, K)->assemble({u, Eigen::VectorXd::Constant(1, c)}, out);
  EXPECT_EQ(out.energy, std::numeric_limits<double>::infinity());
}

TEST(ElasticBase, WrongPlacesAreRefused) {
  const Mesh solid = irregular_mesh(ElementShape::tet4), flat = irregular_mesh(ElementShape::tri6);
  expect_input_error([&] { make_elastic_base(solid, solid.select("xmax"), 0, K); }, {"3D", "2D only"});
  expect_input_error([&] { make_elastic_base(flat, flat.select("xmax & ymin"), 0, K); }, {"single point", "a face"});
  for (double wrong : {0.0, -1.0, double(NAN), double(INFINITY)})
    expect_input_error([&] { make_elastic_base(flat, flat.select("xmax"), 0, wrong); },
                       {"translation stiffness", "positive"});
}

}  // namespace
}  // namespace taut

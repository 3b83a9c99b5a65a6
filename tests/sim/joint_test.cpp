#include "sim/terms/joint.hpp"

#include <Eigen/Geometry>

#include "sim/mesh/weights.hpp"
#include "sim/scene/scene.hpp"
#include "sim/solve/equilibrium.hpp"
#include "tests/support/arm.hpp"
#include "tests/support/graded.hpp"
#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"
#include "tests/support/term_battery.hpp"

namespace taut {
namespace {

using namespace test;

constexpr double pi = 3.14159265358979323846;
constexpr double degree = pi / 180;

// ---------------------------------------------------------------------------------------------------------------------
// The energy alone, on two irregular bodies that lie over each other.

enum { angle, pin_stiffness, motor_stiffness, other };

ParameterTable joint_table() {
  ParameterTable table;
  table.declare({"theta", "theta", "rad", -100, 100, "angle", false});
  table.declare({"k_pin", "k", "N/m", 0, 1e9, "stiffness", true});
  table.declare({"k_mot", "k", "N/m", 0, 1e9, "stiffness", true});
  table.declare({"other", "x", "1", -10, 10, "a number of some other term", false});
  return table;
}

Mesh two_bodies(ElementShape shape) {
  Mesh mesh = merge({{"lower", irregular_mesh(shape)}, {"upper", irregular_mesh(shape)}});
  return mesh;
}

struct Setting {
  bool world = false, motor = true;
  double radius = 0.04, theta = 0.7, strain = 0.1;
};

Joint joint_in(const Mesh& mesh, const Setting& setting) {
  const int d = mesh.dimension();
  const auto at = [&](double x, double y, double z) { return d == 2 ? vec({x, y}) : vec({x, y, z}); };
  const auto attach = [&](const char* part, const Eigen::VectorXd& point) {
    return setting.world && part == std::string("lower")
               ? world_attachment(point)
               : make_attachment(mesh, mesh.part(part), point, setting.radius);
  };
  Joint joint;
  joint.name = "elbow";
  joint.pivot_a = attach("lower", at(0.08, 0.05, 0.05));
  joint.pivot_b = attach("upper", at(0.08, 0.05, 0.05));
  if (d == 3) {
    joint.axis_a = attach("lower", at(0.09, 0.055, 0.08));
    joint.axis_b = attach("upper", at(0.09, 0.055, 0.08));
  }
  if (setting.motor) {
    joint.motor_a = attach("lower", at(0.13, 0.06, 0.06));  // in 3D not at right angles to the axis
    joint.motor_b = attach("upper", at(0.13, 0.06, 0.06));
    joint.angle = angle;
    joint.motor_stiffness = motor_stiffness;
  }
  joint.pin_stiffness = pin_stiffness;
  return joint;
}

TermUnderTest joint_case(ElementShape shape, const Setting& setting) {
  Mesh mesh = two_bodies(shape);
  auto term = make_joint(mesh, joint_in(mesh, setting));
  const Eigen::VectorXd u = random_state(mesh, setting.strain, 0.01, 5);
  Params p(4);
  p << setting.theta, 900, 700, 1;
  return term_under_test(
      std::move(mesh), joint_table(), std::move(term), p, u,
      std::string(name_of(shape)) + (setting.world ? ", world" : "") + (setting.motor ? ", motor" : ", free"));
}

template <class Action>
void for_each_joint(Action&& action) {
  for (ElementShape shape : all_shapes) {
    for (bool world : {false, true}) {
      for (bool motor : {false, true}) action(joint_case(shape, {world, motor}));
    }
    action(joint_case(shape, {false, true, 0.0, 2.5}));
  }
}

TEST(Joint, GradientAndHessianAreTheDerivativesOfTheEnergy) {
  for_each_joint([](const TermUnderTest& t) { expect_derivatives(t, 3e-4); });
}

TEST(Joint, ParameterDerivativesAreThoseOfTheGradient) {
  for_each_joint([](const TermUnderTest& t) {
    expect_parameter_derivatives(t, 0.05);
    EXPECT_EQ(t.model.parameter_gradient({t.u, t.p}, other).norm(), 0.0) << t.name;
    EXPECT_GT(t.model.parameter_gradient({t.u, t.p}, pin_stiffness).norm(), 0.0) << t.name;
  });
  const TermUnderTest t = joint_case(ElementShape::tet4, {});
  for (int index : {angle, motor_stiffness}) EXPECT_GT(t.model.parameter_gradient({t.u, t.p}, index).norm(), 0.0);
}

TEST(Joint, HessianIsSymmetricAndItsProjectionPositiveSemiDefinite) {
  for_each_joint([](const TermUnderTest& t) {
    expect_symmetric_hessian(t);
    expect_projection_is_semidefinite(t);
  });
}

TEST(Joint, In2DTheHessianIsConstantAndPositiveSemiDefiniteAsItIs) {
  const TermUnderTest one = joint_case(ElementShape::tri6, {}), two = joint_case(ElementShape::tri6, {.strain = 0.3});
  EXPECT_GT((one.u - two.u).norm(), 0.01);
  EXPECT_EQ((hessian_of(one.model, one.u, one.p) - hessian_of(two.model, two.u, two.p)).norm(), 0.0);
  EXPECT_EQ((hessian_of(one.model, one.u, one.p) - hessian_of(one.model, one.u, one.p, Curvature::projected)).norm(),
            0.0);
}

TEST(Joint, BetweenTwoBodiesExertsNoNetForceOrMoment) {
  for (ElementShape shape : all_shapes) {
    for (double theta : {0.0, 0.7, 3.0}) expect_no_net_force_or_moment(joint_case(shape, {.theta = theta}));
  }
}

TEST(Joint, EnergyIsInvariantUnderRigidMotionsOfBothBodiesForAnyAngle) {
  for (ElementShape shape : all_shapes) {
    const TermUnderTest t = joint_case(shape, {});
    const int d = t.model.mesh().dimension();
    const Eigen::Matrix3d full =
        Eigen::AngleAxisd(1.9, (d == 2 ? Eigen::Vector3d(0, 0, 1) : Eigen::Vector3d(1, -2, 0.7)).normalized())
            .toRotationMatrix();
    Eigen::VectorXd moved(t.u.size());
    for (int i = 0; i < t.model.mesh().node_count(); ++i) {
      const Eigen::VectorXd X = t.model.mesh().node(i);
      moved.segment(i * d, d) =
          full.topLeftCorner(d, d) * (X + t.u.segment(i * d, d)) + Eigen::Vector3d(0.3, -0.2, 0.1).head(d) - X;
    }
    const double energy = energy_of(t.model, t.u, t.p);
    EXPECT_GT(energy, 1e-4);
    EXPECT_NEAR(energy_of(t.model, moved, t.p), energy, 1e-13 * energy) << t.name;
  }
}

TEST(Joint, ChannelsHaveTheirDerivatives) {
  for (ElementShape shape : {ElementShape::tri6, ElementShape::tet4}) {
    for (bool world : {false, true}) {
      const TermUnderTest t = joint_case(shape, {.world = world});
      const Mesh& mesh = t.model.mesh();
      const Joint joint = joint_in(mesh, {.world = world});
      std::mt19937 random(3);
      const Eigen::VectorXd v = random_vector(t.u.size(), random);
      for (const auto& channel :
           {make_joint_gap(mesh, joint), make_joint_angle(mesh, joint), make_joint_torque(mesh, joint)}) {
        const double y = channel->value({t.u, t.p}), slope = channel->gradient({t.u, t.p}).dot(v);
        EXPECT_NE(slope, 0.0);
        expect_taylor_order(
            [&](double h) {
              return std::abs(channel->value({t.u + h * v, t.p}) - y - h * slope);
            },
            2, 1e-14 * (std::abs(y) + 1), 1e-4, 6, t.name);
        for (int index = 0; index < 4; ++index) {
          const double derivative = channel->parameter_derivative({t.u, t.p}, index);
          expect_taylor_order(
              [&](double h) {
                Params p = t.p;
                p[index] += h;
                return std::abs(channel->value({t.u, p}) - y - h * derivative);
              },
              2, 1e-13 * (std::abs(y) + 1), 0.1, 6, t.name);
        }
      }
      // The work of the motor: torque = dE/dtheta at fixed displacements, by central differences.
      Params more = t.p, less = t.p;
      more[angle] += 1e-5;
      less[angle] -= 1e-5;
      const double rate = (energy_of(t.model, t.u, more) - energy_of(t.model, t.u, less)) / 2e-5;
      EXPECT_NEAR(make_joint_torque(mesh, joint)->value({t.u, t.p}), rate, 1e-8 * std::abs(rate));
    }
  }
}

TEST(Joint, TorqueIsStiffnessTimesRadiusSquaredTimesTheSineOfTheMisalignment) {
  // The upper body turned about the pivot by `actual`, the lower one by nothing; in 3D about the axis.
  for (ElementShape shape : {ElementShape::tri3, ElementShape::tet10}) {
    const Mesh mesh = two_bodies(shape);
    const int d = mesh.dimension();
    const Joint joint = joint_in(mesh, {});
    Eigen::Vector3d n(0, 0, 1), arm(0, 0, 0);
    if (d == 3) n = (joint.axis_a.point - joint.pivot_a.point).normalized();
    arm.head(d) = joint.motor_a.point - joint.pivot_a.point;
    const double r = arm.cross(n).norm();
    const auto angle_channel = make_joint_angle(mesh, joint), torque = make_joint_torque(mesh, joint),
               gap = make_joint_gap(mesh, joint);
    for (double actual : {0.0, 0.4, -2.0}) {
      const Eigen::Matrix3d R = Eigen::AngleAxisd(actual, n).toRotationMatrix();
      Eigen::VectorXd u = Eigen::VectorXd::Zero(mesh.X.size());
      const Part& upper = mesh.part("upper");
      for (int i = upper.first_node; i < upper.first_node + upper.node_count; ++i) {
        Eigen::Vector3d X = Eigen::Vector3d::Zero();
        X.head(d) = mesh.node(i) - joint.pivot_a.point;
        u.segment(i * d, d) = (R * X - X).head(d);
      }
      for (double theta : {0.0, 0.5, pi / 2, 2.9, 7.0, -20.0}) {
        Params p(4);
        p << theta, 900, 700, 1;
        EXPECT_NEAR(torque->value({u, p}), 700 * r * r * std::sin(theta - actual), 1e-12);
        const double turned = angle_channel->value({u, p});
        EXPECT_NEAR(std::cos(turned - actual), 1, 1e-12);
        EXPECT_LE(std::abs(turned - theta), pi * (1 + 1e-12));
        EXPECT_NEAR(gap->value({u, p}), 0, 1e-15);
      }
    }
  }
}

TEST(Joint, AFreePinHasAnAngleAboutZeroAndNoTorque) {
  const Mesh mesh = two_bodies(ElementShape::tri3);
  Joint joint = joint_in(mesh, {});
  joint.angle = -1;
  const Eigen::VectorXd none = Eigen::VectorXd::Zero(mesh.X.size());
  EXPECT_EQ(make_joint_angle(mesh, joint)->value({none, Eigen::Vector4d(5, 900, 700, 1)}), 0.0);
  expect_input_error([&] { make_joint_torque(mesh, joint); }, {"elbow", "free pin", "motor point"});
}

TEST(Joint, In3DAFreeHingeLeavesTheRotationAboutItsAxisFreeAndAMotorHoldsIt) {
  for (bool motor : {false, true}) {
    Mesh mesh = two_bodies(ElementShape::tet4);
    const Joint joint = joint_in(mesh, {.world = true, .motor = motor});
    const Part upper = mesh.part("upper");
    // Rigid motions of the upper body: three translations, three rotations about the pivot.
    Eigen::MatrixXd rigid = Eigen::MatrixXd::Zero(mesh.X.size(), 6);
    for (int i = upper.first_node; i < upper.first_node + upper.node_count; ++i) {
      rigid.block<3, 3>(3 * i, 0).setIdentity();
      const Eigen::Vector3d X = mesh.node(i) - joint.pivot_a.point;
      for (int c = 0; c < 3; ++c) rigid.block<3, 1>(3 * i, 3 + c) = Eigen::Vector3d::Unit(c).cross(X) / 0.05;
    }
    const Eigen::Vector3d n = (joint.axis_a.point - joint.pivot_a.point).normalized();
    auto term = make_joint(mesh, joint);
    Params p(4);
    p << 0, 900, 700, 1;
    const TermUnderTest t = term_under_test(std::move(mesh), joint_table(), std::move(term), p,
                                            Eigen::VectorXd::Zero(rigid.rows()), "hinge");
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> modes(rigid.transpose() * hessian_of(t.model, t.u, t.p) *
                                                               rigid);
    EXPECT_GT(modes.eigenvalues()[1], 10.0);
    if (motor) {
      EXPECT_GT(modes.eigenvalues()[0], 10.0);
    } else {
      EXPECT_NEAR(modes.eigenvalues()[0], 0, 1e-10);
      EXPECT_NEAR(std::abs(modes.eigenvectors().col(0).tail<3>().dot(n)), 1, 1e-10);
    }
  }
}

TEST(Joint, WrongDefinitionsAreRefusedWithTheSentence) {
  const Mesh flat = two_bodies(ElementShape::tri3), solid = two_bodies(ElementShape::tet4);
  Joint joint = joint_in(flat, {});
  joint.pivot_b.point[0] += 1e-3;
  expect_input_error([&] { make_joint(flat, joint); }, {"elbow", "pivot", "one point at rest", "(81, 50)"});
  joint = joint_in(flat, {});
  joint.motor_b = joint.motor_a = joint.pivot_a;
  expect_input_error([&] { make_joint(flat, joint); }, {"elbow", "motor point lies on its axis"});
  joint = joint_in(flat, {.motor = false});
  joint.angle = angle;
  expect_input_error([&] { make_joint(flat, joint); }, {"elbow", "no motor point"});
  joint.angle = -1;
  expect_input_error([&] { make_joint_angle(flat, joint); }, {"elbow", "no motor point"});
  joint.pivot_a = joint.pivot_b = world_attachment(joint.pivot_a.point);
  expect_input_error([&] { make_joint(flat, joint); }, {"elbow", "fixed in space on both sides"});
  joint = joint_in(solid, {});
  joint.axis_a = joint.axis_b = joint.pivot_a;
  expect_input_error([&] { make_joint(solid, joint); }, {"elbow", "axis has no length"});
  expect_input_error(
      [&] {
        make_attachment(flat, flat.part("lower"), vec({0.4, 0.05}), 0.01);
      },
      {"(400, 50)", "outside 'lower'"});
  expect_input_error([&] { make_attachment(flat, flat.part("lower"), vec({0.1, 0.05}), -0.01); }, {"radius", "-10"});
}

// ---------------------------------------------------------------------------------------------------------------------
// Attachments.

TEST(Attachment, WeightsReproduceAffineFunctionsForAnyRadius) {
  for (ElementShape shape : all_shapes) {
    const Mesh mesh = two_bodies(shape);
    const int d = mesh.dimension();
    const Eigen::VectorXd point = d == 2 ? vec({0.13, 0.06}) : vec({0.13, 0.06, 0.06});
    size_t smallest = 0;
    for (double radius : {0.0, 1e-4, 0.03, 0.07, 1.0}) {
      const Attachment a = make_attachment(mesh, mesh.part("upper"), point, radius);
      double sum = 0;
      Eigen::VectorXd mean = Eigen::VectorXd::Zero(d);
      for (size_t i = 0; i < a.nodes.size(); ++i) {
        EXPECT_GE(a.nodes[i], mesh.part("upper").first_node);
        sum += a.weights[i];
        mean += a.weights[i] * mesh.node(a.nodes[i]);
      }
      EXPECT_NEAR(sum, 1, 1e-13);
      EXPECT_LE((mean - point).norm(), 1e-14);
      EXPECT_GE(a.nodes.size(), smallest);
      smallest = a.nodes.size();
    }
    EXPECT_EQ(static_cast<int>(smallest), mesh.part("upper").node_count) << "a large radius takes in the whole part";
  }
}

/// Displacement per force [m/N] of an attachment in the middle of a square that is clamped on both sides.
double compliance(const std::vector<double>& grid, double radius) {
  SceneBuilder builder(rectangle(grid, grid, 1, "body"), Plane::strain, 1.0);
  builder.add_solid("body", "neo_hookean", {{"E", 1e6}, {"nu", 0.3}});
  builder.fix("xmin", {0, 1});
  builder.fix("xmax", {0, 1});
  const Mesh& mesh = builder.mesh();
  const Attachment a =
      make_attachment(mesh, {"", 0, mesh.node_count(), 0, mesh.element_count()}, vec({0.5, 0.5}), radius);
  const Eigen::VectorXd weights = point_weights(mesh, {a.nodes, a.weights}, vec({1, 0}));
  const Scene scene = builder.build();
  Equilibrium equilibrium(*scene.model);
  equilibrium.start_at_rest(scene.values);
  equilibrium.solve(scene.values);
  return weights.dot(equilibrium.solve_linear(weights).col(0));
}

TEST(Attachment, ComplianceOfAPatchConvergesUnderRefinementWhereThatOfAPointGrowsByKelvinsLogarithm) {
  // Kelvin's point force in plane strain: u = -F (3 - 4 nu)/(8 pi mu (1 - nu)) ln r, so each halving of h adds ln 2 of
  // it.
  const double nu = 0.3, mu = 1e6 / (2 * (1 + nu));
  const double halving = (3 - 4 * nu) / (8 * pi * mu * (1 - nu)) * std::log(2.0);
  const auto at = [](int cells, double radius) { return compliance(graded(1, cells), radius); };
  const double p16 = at(16, 0), p32 = at(32, 0), p64 = at(64, 0);
  EXPECT_NEAR(p32 - p16, halving, 0.03 * halving);
  EXPECT_NEAR(p64 - p32, halving, 0.03 * halving);
  const double r16 = at(16, 0.15), r32 = at(32, 0.15), r64 = at(64, 0.15);
  EXPECT_LT(std::abs(r32 - r16), 0.15 * halving);
  EXPECT_LT(std::abs(r64 - r32), 0.05 * halving);
  // A mesh that is finest in the middle of the patch: the force is spread as before, not to where the nodes are.
  EXPECT_LT(std::abs(compliance(graded_both(1, 64, 0.1), 0.15) - r64), 0.05 * halving);
}

// ---------------------------------------------------------------------------------------------------------------------
// Arms of stiff links.

TEST(Joint, ATwoLinkArmFollowsForwardKinematics) {
  SceneBuilder builder = arm_builder(2);
  const Joint one = builder.add_joint(arm_joint(0)), two = builder.add_joint(arm_joint(1));
  const Scene scene = builder.build();
  Equilibrium equilibrium(*scene.model);
  equilibrium.start_at_rest(scene.values);
  int factorisations = 0;
  for (const auto& [a, b] : {std::pair{20.0, 30.0}, {50.0, 55.0}, {30.0, 85.0}, {0.0, 60.0}, {-30.0, 30.0}}) {
    Params p = scene.values;
    p[one.angle] = a * degree;
    p[two.angle] = b * degree;
    const SolveReport& report = equilibrium.solve(p);
    ASSERT_EQ(report.status, SolveStatus::converged) << report.message();
    factorisations += report.factorisations;
    const Eigen::Vector2d expected = two_link_tip(a * degree, b * degree);
    EXPECT_LE((arm_tip(scene.model->mesh(), equilibrium.u()) - expected).norm(), 1e-6 * 2 * arm_link) << a << ", " << b;
    EXPECT_NEAR(make_joint_angle(scene.model->mesh(), two)->value({equilibrium.u(), p}), b * degree, 1e-8);
    EXPECT_LE(make_joint_gap(scene.model->mesh(), one)->value({equilibrium.u(), p}), 1e-10);
  }
  RecordProperty("factorisations", factorisations);
  EXPECT_LE(factorisations, 100);
}

TEST(Joint, AHorizontalLinkUnderItsWeightNeedsHalfItsWeightTimesItsLength) {
  SceneBuilder builder = arm_builder(1);
  const Joint joint = builder.add_joint(arm_joint(0));
  const int gravity = builder.declare({"g", "g", "m/s2", -100, 100, "gravity"}, 0.0);
  builder.add_weight("link1", 1000, vec({0, -1}), gravity);
  const Scene scene = builder.build();
  Equilibrium equilibrium(*scene.model);
  equilibrium.start_at_rest(scene.values);
  Params p = scene.values;
  p[gravity] = 9.81;
  ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged);
  const double mass = 1000 * 0.06 * 0.01 * arm_thickness, arm = 0.03 - arm_base;
  EXPECT_NEAR(make_joint_torque(scene.model->mesh(), joint)->value({equilibrium.u(), p}), mass * 9.81 * arm,
              1e-6 * mass * 9.81 * arm);
  EXPECT_LE(make_joint_gap(scene.model->mesh(), joint)->value({equilibrium.u(), p}), 1e-5 * 0.06);
}

TEST(Joint, FollowsTwoTurnsCommandedInStepsOf30Degrees) {
  SceneBuilder builder = arm_builder(1);
  const Joint joint = builder.add_joint(arm_joint(0));
  const Scene scene = builder.build();
  const auto actual = make_joint_angle(scene.model->mesh(), joint);
  Equilibrium equilibrium(*scene.model);
  equilibrium.start_at_rest(scene.values);
  Params p = scene.values;
  double turned = 0;
  for (int step = 1; step <= 24; ++step) {
    const Eigen::Vector2d before = arm_tip(scene.model->mesh(), equilibrium.u()) - Eigen::Vector2d(arm_base, 0);
    p[joint.angle] = step * 30 * degree;
    ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged) << step << ": " << equilibrium.report().message();
    EXPECT_NEAR(actual->value({equilibrium.u(), p}), p[joint.angle], 1e-8);
    const Eigen::Vector2d after = arm_tip(scene.model->mesh(), equilibrium.u()) - Eigen::Vector2d(arm_base, 0);
    turned += std::atan2(before[0] * after[1] - before[1] * after[0], before.dot(after));
  }
  EXPECT_NEAR(turned, 4 * pi, 1e-7);
}

TEST(Joint, ALinkMuchStifferThanItsNeighbourTurnsAsItIsAboutTheWorldsPivot) {
  // The links' bodies count as stiff beside a soft third one, so steps turn them about their centres, not about pivots.
  SceneBuilder builder = [] {
    std::vector<std::pair<std::string, Mesh>> parts;
    for (const char* name : {"link1", "link2", "pad"}) {
      Mesh mesh = rectangle(graded(0.06, 12), graded(0.01, 2), 2, name);
      place(mesh, Eigen::Matrix2d::Identity(), Eigen::Vector2d(static_cast<double>(parts.size()) * arm_link, -0.005));
      parts.emplace_back(name, std::move(mesh));
    }
    return SceneBuilder(merge(parts), Plane::stress, arm_thickness);
  }();
  builder.add_solid("link1", "neo_hookean", {{"E", 2e9}, {"nu", 0.3}});
  builder.add_solid("link2", "neo_hookean", {{"E", 2e9}, {"nu", 0.3}});
  builder.add_solid("pad", "neo_hookean", {{"E", 5e4}, {"nu", 0.3}});
  const Joint one = builder.add_joint(arm_joint(0)), two = builder.add_joint(arm_joint(1));
  JointSettings last = arm_joint(2);
  last.part_b = "pad";
  builder.add_joint(last);
  const Scene scene = builder.build();
  Equilibrium equilibrium(*scene.model);
  equilibrium.start_at_rest(scene.values);
  Params p = scene.values;
  for (int step = 1; step <= 3; ++step) {
    p[one.angle] = step * 30 * degree;
    p[two.angle] = -step * 20 * degree;
    ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged) << equilibrium.report().message();
    EXPECT_LE(equilibrium.report().factorisations, 30) << equilibrium.report().message();
  }
  const Eigen::Vector2d expected = Eigen::Vector2d(arm_base, 0) + arm_link * Eigen::Vector2d(0, 1) +
                                   2 * arm_link * Eigen::Vector2d(std::cos(30 * degree), std::sin(30 * degree));
  EXPECT_LE((arm_tip(scene.model->mesh(), equilibrium.u()) - expected).norm(), 1e-6 * 3 * arm_link);
}

TEST(Joint, AHingeIn3DTurnsABlockAboutItsAxisAndNothingElse) {
  Mesh mesh = box(graded(0.06, 4), graded(0.02, 2), graded(0.02, 2), 1, "block");
  SceneBuilder builder(std::move(mesh));
  builder.add_solid("block", "neo_hookean", {{"E", 1e8}, {"nu", 0.3}});
  JointSettings settings;
  settings.id = "hinge";
  settings.part_a = "world";
  settings.pivot = vec({0.01, 0.01, 0.004});
  settings.axis_end = vec({0.01, 0.014, 0.016});
  settings.motor = vec({0.03, 0.01, 0.01});
  settings.radius = 0.01;
  const Joint joint = builder.add_joint(settings);
  const Scene scene = builder.build();
  EXPECT_NEAR(scene.values[joint.pin_stiffness], 10 * 1e8 * std::hypot(0.004, 0.012), 1);
  Equilibrium equilibrium(*scene.model);
  equilibrium.start_at_rest(scene.values);
  Params p = scene.values;
  const Eigen::Vector3d n = (settings.axis_end - settings.pivot).normalized();
  for (int step = 1; step <= 4; ++step) {
    p[joint.angle] = 30 * degree * step;
    ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged) << equilibrium.report().message();
    const Eigen::Matrix3d R = Eigen::AngleAxisd(p[joint.angle], n).toRotationMatrix();
    double error = 0;
    for (int i = 0; i < scene.model->mesh().node_count(); ++i) {
      const Eigen::Vector3d X = scene.model->mesh().node(i), x = X + equilibrium.u().segment<3>(3 * i);
      error = std::max(error, (settings.pivot + R * (X - settings.pivot) - x).norm());
    }
    EXPECT_LE(error, 1e-9) << step;
  }
}

TEST(Joint, SceneRefusesPointsOffABodyAndStiffnessFromNothingAndNamesTheJoint) {
  SceneBuilder builder = arm_builder(2);
  JointSettings wrong = arm_joint(1);
  wrong.pivot = vec({0.09, 0});
  expect_input_error([&] { builder.add_joint(wrong); }, {"joint 'joint2'", "(90, 0)", "outside 'link1'"});
  wrong = arm_joint(1);
  wrong.part_b = "lnk2";
  expect_input_error([&] { builder.add_joint(wrong); }, {"joint 'joint2'", "lnk2", "link2"});
  SceneBuilder bare(rectangle(graded(0.06, 12), graded(0.01, 2), 1, "link1"));
  JointSettings single = arm_joint(0);
  single.part_b = "";
  single.pivot[1] = single.motor[1] = 0.005;
  expect_input_error([&] { bare.add_joint(single); }, {"joint 'joint1'", "no modulus", "materials"});
  single.stiffness = 1e5;
  const Joint joint = bare.add_joint(single);
  EXPECT_EQ(bare.parameters()[joint.angle].id, "joint1");
  EXPECT_EQ(bare.parameters()[joint.angle].unit, "rad");
  EXPECT_EQ(bare.parameters()[joint.pin_stiffness].id, "k_joint1");
}

TEST(Joint, PartsAreHeldByJointsToSupportedOnesAndByMotorsToTheWorld) {
  // Joined to nothing: refused. A free pin to the world leaves one rotation.
  EXPECT_THROW(arm_builder(2).build(), InputError);
  SceneBuilder loose = arm_builder(2);
  loose.add_joint(arm_joint(0));
  expect_input_error([&] { loose.build(); }, {"3 of 3 rigid motions"});
  SceneBuilder pinned = arm_builder(1);
  JointSettings free_pin = arm_joint(0);
  free_pin.motor = {};
  pinned.add_joint(free_pin);
  expect_input_error([&] { pinned.build(); }, {"1 of 3 rigid motions"});
  SceneBuilder held = arm_builder(2);
  held.fix("link2.xmax", {0, 1});
  held.add_joint(arm_joint(1));
  EXPECT_NO_THROW(held.build());
  // Two joints may share an angle.
  SceneBuilder shared = arm_builder(2);
  const JointSettings second = arm_joint(1);
  const int angle = shared.add_joint(arm_joint(0)).angle;
  EXPECT_EQ(shared.add_joint(second, angle).angle, angle);
  EXPECT_NO_THROW(shared.build());
}

}  // namespace
}  // namespace taut

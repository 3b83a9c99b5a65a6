#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>

#include "sim/mesh/weights.hpp"
#include "sim/scene/build_scene.hpp"
#include "sim/shapes/all.hpp"
#include "sim/solve/equilibrium.hpp"
#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"
#include "tests/support/taylor.hpp"

// Bodies that are turned and shifted, and what is placed along their axes: markers, and cables whose tension is held.
namespace taut {
namespace {

using namespace test;

const ChannelKind* kind_called(std::string_view name) {
  for (const ChannelKind& kind : channel_kinds()) {
    if (kind.name == name) return &kind;
  }
  return nullptr;
}

/// A setup of one body without a name, clamped at `clamped`, of one material.
taut::Setup setup_of(const Shape& shape, const std::string& clamped, MeshSettings mesh) {
  taut::Setup setup;
  setup.path = "setup.toml";
  setup.dimension = shape.dimension();
  setup.plane = Plane::stress;
  BodySettings& body = setup.bodies.emplace_back();
  body.geometry.shape = shape.clone();
  body.geometry.dimension = setup.dimension;
  body.mesh = std::move(mesh);
  setup.materials.push_back({"body", "neo_hookean", {{"E", 1e6}, {"nu", 0.0}}, std::nullopt});
  SupportSettings& clamp = setup.supports.emplace_back();
  clamp.on = clamped;
  for (int i = 0; i < setup.dimension; ++i) clamp.fix.push_back(i);
  return setup;
}

taut::Setup round_setup(std::vector<double> bore = {}) {
  Revolved round;
  round.s.values = {0, 0.1};
  round.radius.values = {0.015, 0.006};
  round.bore.values = std::move(bore);
  round.region = "body";
  MeshSettings mesh;
  mesh.counts = {{"layers", 4}, {"rings", 1}};
  return setup_of(round, "base", mesh);
}

constexpr double bar_length = 0.2, bar_width = 0.02, bar_height = 0.01;
taut::Setup box_setup() {
  Box bar;
  bar.size = {bar_length, bar_width, bar_height};
  bar.origin = {0, -bar_width / 2, -bar_height / 2};
  bar.region = "body";
  MeshSettings mesh;
  mesh.cells = {10, 2, 2};
  return setup_of(bar, "xmin", mesh);
}
taut::Setup rectangle_setup() {
  Rectangle bar;
  bar.size = {bar_length, bar_width};
  bar.origin = {0, -bar_width / 2};
  bar.region = "body";
  MeshSettings mesh;
  mesh.cells = {10, 2};
  taut::Setup setup = setup_of(bar, "xmin", mesh);
  setup.thickness = bar_height;
  return setup;
}

std::vector<double> as_list(const Eigen::VectorXd& v) {
  return {v.begin(), v.end()};
}

void add_marker(Setup& setup, const std::string& kind, double foot, const Eigen::VectorXd& standoff,
                const Eigen::VectorXd& direction) {
  ChannelSettings& channel = setup.channels.emplace_back();
  channel.id = "marker_" + std::to_string(setup.channels.size());
  channel.kind = kind_called(kind);
  channel.foot = foot;
  channel.marker = "m";
  channel.standoff = as_list(standoff);
  channel.direction = as_list(direction);
}

TEST(PlacedBody, TurnsAboutZThenXThenYThenZ) {
  BodySettings body;
  body.angle = 0.3;
  body.turn = {0.5, -0.7, 1.1};
  Eigen::Matrix3d x, y, z, first;
  const auto c = [](double a) { return std::cos(a); };
  const auto s = [](double a) { return std::sin(a); };
  first << c(0.3), -s(0.3), 0, s(0.3), c(0.3), 0, 0, 0, 1;
  x << 1, 0, 0, 0, c(0.5), -s(0.5), 0, s(0.5), c(0.5);
  y << c(-0.7), 0, s(-0.7), 0, 1, 0, -s(-0.7), 0, c(-0.7);
  z << c(1.1), -s(1.1), 0, s(1.1), c(1.1), 0, 0, 0, 1;
  EXPECT_LT((rotation_of(body, 3) - z * y * x * first).norm(), 1e-15);
  EXPECT_LT((rotation_of(body, 2) - first.topLeftCorner<2, 2>()).norm(), 1e-16);
  const Eigen::Vector3d point(1, 2, 3);
  EXPECT_LT((placed(body, point) - z * y * x * first * point).norm(), 1e-14) << "turned without being shifted";
  body.at = {4, 5, 6};
  EXPECT_LT((placed(body, point) - z * y * x * first * point - Eigen::Vector3d(4, 5, 6)).norm(), 1e-14);
}

TEST(PlacedBody, MeshAndAxisGoWhereItsPointsGo) {
  taut::Setup setup = round_setup();
  BodySettings& body = setup.bodies.front();
  const Mesh own = make_mesh(body.geometry, body.mesh, false, false);
  body.turn = {0, M_PI / 2, 0.2};  // along -z
  const auto expect_placed = [&] {
    const BuiltScene built = build_scene(setup, {});
    const Mesh& mesh = built.scene.model->mesh();
    for (int i = 0; i < mesh.node_count(); ++i)
      ASSERT_LT((mesh.node(i) - placed(body, own.node(i))).norm(), 1e-16) << "node " << i;
    const BodyAxis axis = axis_of(body);
    EXPECT_LT((axis.along - Eigen::Vector3d(0, 0, -1)).norm(), 1e-15);
    EXPECT_LT((axis.point(0.07, 0.01, 0.4) - placed(body, body.geometry.shape->axis()->point(0.07, 0.01, 0.4))).norm(),
              1e-16);
  };
  expect_placed();
  body.at = {0.01, -0.02, 0.03};
  expect_placed();
  body.at.clear();
  body.turn.clear();
  body.angle = 0.4;
  const BuiltScene turned = build_scene(setup, {});
  EXPECT_LT((turned.scene.model->mesh().node(7) - placed(body, own.node(7))).norm(), 1e-16) << "without a place";
}

TEST(PlacedBody, AKindWithoutAnAxisIsRefused) {
  BodySettings body;
  body.geometry.shape = make_shape("sheet");
  expect_input_error([&] { axis_of(body); }, {"a sheet has no straight axis", "box, rectangle, revolved"});
}

/// x = R X + t of all nodes, as displacements.
Eigen::VectorXd turned_nodes(const Mesh& mesh, const Eigen::MatrixXd& R, const Eigen::VectorXd& t) {
  const int d = mesh.dimension();
  Eigen::VectorXd u(mesh.X.size());
  for (int i = 0; i < mesh.node_count(); ++i) u.segment(i * d, d) = R * mesh.node(i) + t - mesh.node(i);
  return u;
}

TEST(AxisMarker, MovesWithItsSectionExactlyInRigidMotions) {
  for (taut::Setup setup : {round_setup(), round_setup({0.003}), box_setup(), rectangle_setup()}) {
    const int d = setup.dimension;
    BodySettings& body = setup.bodies.front();
    body.angle = 0.3;
    body.at.assign(static_cast<size_t>(d), 0.01);
    if (d == 3) body.turn = {0.2, M_PI / 2, -0.1};
    const BodyAxis own = *body.geometry.shape->axis();
    const Eigen::VectorXd ahead = own.offset(0.02, 0.7, 0.015);
    const Eigen::VectorXd direction = vec({1, -2, 3}).head(d);
    const double foot[] = {0, 0.4 * own.length, own.length};
    for (double s : foot) {
      add_marker(setup, "position", s, ahead, direction);
      add_marker(setup, "displacement", s, ahead, direction);
    }
    const BuiltScene built = build_scene(setup, {});
    const Mesh& mesh = built.scene.model->mesh();
    Eigen::MatrixXd R = Eigen::Rotation2Dd(2.1).toRotationMatrix();
    if (d == 3) R = Eigen::AngleAxisd(2.1, Eigen::Vector3d(1, -2, 0.5).normalized()).toRotationMatrix();
    const Eigen::VectorXd t = vec({0.02, -0.03, 0.05}).head(d), rest = Eigen::VectorXd::Zero(mesh.X.size());
    for (size_t k = 0; k < 3; ++k) {
      const Eigen::VectorXd place = placed(body, own.point(foot[k], 0, 0) + ahead);
      const SceneReading &position = built.readings[2 * k], &displacement = built.readings[2 * k + 1];
      const auto value = [&](const SceneReading& reading, const Eigen::VectorXd& u) {
        return reading.rest + reading.channel->value({u, built.scene.values});
      };
      const Eigen::VectorXd n = direction.normalized(), u = turned_nodes(mesh, R, t);
      EXPECT_NEAR(value(position, rest), n.dot(place), 1e-15);
      EXPECT_NEAR(value(displacement, rest), 0, 1e-16);
      EXPECT_NEAR(value(position, u), n.dot(R * place + t), 1e-14);
      EXPECT_NEAR(value(displacement, u), n.dot(R * place + t - place), 1e-14);
      EXPECT_EQ(position.meaning, "position of marker m");
    }
  }
}

TEST(AxisMarker, GradientIsThatOfItsValue) {
  for (taut::Setup setup : {round_setup(), round_setup({0.003}), rectangle_setup()}) {
    const int d = setup.dimension;
    add_marker(setup, "displacement", 0.07, vec({0.004, 0.02, -0.01}).head(d), vec({1, 2, -1}).head(d));
    const BuiltScene built = build_scene(setup, {});
    const Mesh& mesh = built.scene.model->mesh();
    std::mt19937 random(3);
    std::normal_distribution<double> normal;
    const auto some = [&] {
      Eigen::VectorXd v(mesh.X.size());
      for (double& x : v) x = normal(random);
      return v;
    };
    const Eigen::VectorXd u = 1e-4 * some(), v = some();
    const Channel& channel = *built.readings.front().channel;
    const double y = channel.value({u, built.scene.values}), slope = channel.gradient({u, built.scene.values}).dot(v);
    ASSERT_GT(std::abs(slope), 1e-3);
    expect_taylor_order(
        [&](double step) {
          const Eigen::VectorXd moved = u + step * v;
          return std::abs(channel.value({moved, built.scene.values}) - y - step * slope);
        },
        2, 1e-15, 3e-5);
  }
}

TEST(AxisMarker, IsOnTheBodyThatItsChannelNames) {
  taut::Setup setup = round_setup();
  setup.bodies.push_back(setup.bodies.front());
  setup.bodies[0].name = "one";
  setup.bodies[1].name = "other";
  setup.bodies[1].at = {0, 0.5, 0};
  setup.supports.front().on = "one.base";
  setup.supports.push_back(setup.supports.front());
  setup.supports.back().on = "other.base";
  add_marker(setup, "position", 0.1, Eigen::Vector3d(0.01, 0, 0), Eigen::Vector3d(1, 1, 0));
  setup.channels.push_back(setup.channels.front());
  setup.channels.back().on = "other";
  const BuiltScene built = build_scene(setup, {});
  const Mesh& mesh = built.scene.model->mesh();
  Eigen::VectorXd u = Eigen::VectorXd::Zero(mesh.X.size());
  u.tail(3 * mesh.part("other").node_count).setConstant(0.02);  // the other one alone
  const auto value = [&](const SceneReading& reading) {
    return reading.rest + reading.channel->value({u, built.scene.values});
  };
  EXPECT_NEAR(value(built.readings[0]), 0.11 / std::sqrt(2), 1e-15);
  EXPECT_NEAR(value(built.readings[1]), (0.11 + 0.5 + 0.04) / std::sqrt(2), 1e-15);
}

TEST(AxisMarker, AFootBesideTheAxisIsRefused) {
  for (double foot : {-1e-3, 0.101, std::nan("")}) {
    taut::Setup setup = round_setup();
    add_marker(setup, "position", foot, Eigen::Vector3d::Zero(), Eigen::Vector3d::UnitX());
    expect_input_error([&] { build_scene(setup, {}); }, {"[[channel]] 'marker_1'", "foot", "from 0 to 100 mm"});
  }
}

/// Equilibrium under what the setup has, the controls at `values`.
Eigen::VectorXd solved_scene(const BuiltScene& built, const std::vector<double>& values = {}) {
  Params p = built.scene.values;
  for (size_t k = 0; k < values.size(); ++k) p[built.controls[k]] = values[k];
  Params rest = built.scene.values;
  for (int index : built.off_at_rest) rest[index] = 0;
  Equilibrium equilibrium(*built.scene.model);
  equilibrium.start_at_rest(rest);
  EXPECT_EQ(equilibrium.solve(p).status, SolveStatus::converged) << equilibrium.report().message();
  return equilibrium.u();
}

CableSettings held_cable(double offset, double angle, double tension) {
  CableSettings cable;
  cable.id = "tendon";
  cable.line = EyeletLine{0, bar_length, offset, offset, angle, 20};
  cable.held = true;
  cable.tension = tension;
  return cable;
}

constexpr double bar_EA = 1e6 * bar_width * bar_height, bar_EI = bar_EA * bar_width * bar_width / 12;

TEST(HeldTendon, AlongTheAxisShortensABarByTLOverEA) {
  for (taut::Setup setup : {box_setup(), rectangle_setup()}) {
    const double T = 1e-3;
    setup.cables.cables.push_back(held_cable(0, 0, T));
    const BuiltScene built = build_scene(setup, {});
    EXPECT_EQ(built.off_at_rest.size(), 1u);
    const Mesh& mesh = built.scene.model->mesh();
    const Eigen::VectorXd along = mean_weights(mesh, mesh.select("xmax"), Eigen::VectorXd::Unit(setup.dimension, 0));
    EXPECT_NEAR(along.dot(solved_scene(built)), -T * bar_length / bar_EA, 1e-4 * T * bar_length / bar_EA);
  }
}

/// Compression by T, and bending by T d, constant all along, towards the tendon. Off the end face, where it pulls on a
/// point.
TEST(HeldTendon, BesideTheAxisBendsABarByTDOverEI) {
  const double T = 1e-4, d = 0.004, s = 0.5 * bar_length, standoff = 0.03, curvature = T * d / bar_EI;
  for (taut::Setup setup : {box_setup(), rectangle_setup()}) {
    const int dimension = setup.dimension;
    setup.cables.cables.push_back(held_cable(d, M_PI, T));  // at y = -d
    const Eigen::VectorXd x = Eigen::VectorXd::Unit(dimension, 0), y = Eigen::VectorXd::Unit(dimension, 1);
    add_marker(setup, "displacement", s, 0 * x, y);
    add_marker(setup, "displacement", s, standoff * x, y);
    add_marker(setup, "displacement", s, standoff * y, x);
    const BuiltScene built = build_scene(setup, {});
    const Eigen::VectorXd u = solved_scene(built);
    const auto reading = [&](size_t k) { return built.readings[k].channel->value({u, built.scene.values}); };
    const double turn = curvature * s;
    EXPECT_NEAR(reading(0), -0.5 * curvature * s * s, 2e-3 * curvature * s * s);
    EXPECT_NEAR(reading(1) - reading(0), -turn * standoff, 2e-3 * turn * standoff);
    EXPECT_NEAR(reading(2), turn * standoff - T * s / bar_EA, 2e-3 * turn * standoff);
  }
}

/// One half of the bar, 0 <= z <= h / 2, with half of its tendon.
TEST(HeldTendon, ShortensHalfOfASolidAsItDoesAllOfIt) {
  taut::Setup setup = rectangle_setup();
  const double T = 1e-3;
  setup.dimension = 3;
  BodySettings& body = setup.bodies.front();
  body.geometry.dimension = 3;
  body.geometry.thickness = bar_height;
  body.mesh.depth_cells = 1;
  setup.supports.front().fix = {0, 1, 2};
  setup.supports.emplace_back().on = "symmetry";
  setup.supports.back().fix = {2};
  setup.cables.cables.push_back(held_cable(0, 0, T));
  const BuiltScene built = build_scene(setup, {});
  const Mesh& mesh = built.scene.model->mesh();
  const Eigen::VectorXd along = mean_weights(mesh, mesh.select("xmax"), Eigen::Vector3d::UnitX());
  EXPECT_NEAR(along.dot(solved_scene(built)), -T * bar_length / bar_EA, 1e-4 * T * bar_length / bar_EA);
  add_marker(setup, "position", 0.1, Eigen::Vector3d::Zero(), Eigen::Vector3d::UnitX());
  expect_input_error([&] { build_scene(setup, {}); }, {"[[channel]] 'marker_1'", "half of a solid", "'point'"});
}

TEST(HeldTendon, AControlPullsByItselfOrOverASpoolAndAllTensionsHaveOneFactor) {
  const double T = 1e-3;
  taut::Setup setup = box_setup();
  setup.controls = {{"pull", Quantity::force}, {"motor", Quantity::torque}};
  for (const char* control : {"pull", "motor"}) {
    CableSettings& cable = setup.cables.cables.emplace_back(held_cable(0, 0, 0));
    cable.id = std::string("by_") + control;
    cable.control = control;
    if (cable.control == "motor") cable.spool = 0.02;
  }
  setup.cables.cables.push_back(held_cable(0, 0, T));
  for (const CableSettings& cable : setup.cables.cables) {
    ChannelSettings& channel = setup.channels.emplace_back();
    channel.id = channel.on = cable.id;
    channel.kind = kind_called("tension");
  }
  const BuiltScene built = build_scene(setup, {});
  const ParameterTable& table = built.scene.model->parameters();
  EXPECT_FALSE(table.contains("k_cable") || table.contains("slack")) << "no cable has a law";
  EXPECT_EQ(table[table.index("motor")].unit, "Nm");
  EXPECT_EQ(built.off_at_rest, std::vector<int>{table.index("tension_tendon")});
  const Mesh& mesh = built.scene.model->mesh();
  const Eigen::VectorXd along = mean_weights(mesh, mesh.select("xmax"), Eigen::Vector3d::UnitX());
  const double unit = T * bar_length / bar_EA;
  EXPECT_NEAR(along.dot(solved_scene(built, {2 * T, 3 * T * 0.02})), -6 * unit, 1e-3 * unit);
  Params p = built.scene.values;
  p[table.index("tension_scale")] = 0.5;
  p[table.index("pull")] = 2 * T;
  p[table.index("motor")] = 3 * T * 0.02;
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(mesh.X.size());
  for (size_t k = 0; k < 3; ++k) {
    const double times[] = {2, 3, 1};
    EXPECT_NEAR(built.readings[k].channel->value({rest, p}), 0.5 * times[k] * T, 1e-18);
  }
}

TEST(HeldTendon, ARowOfEyeletsOutsideOfItsBodyIsRefused) {
  const auto expect = [](EyeletLine line, const std::vector<std::string>& parts) {
    taut::Setup setup = box_setup();
    setup.cables.cables.push_back(held_cable(0, 0, 1));
    setup.cables.cables.back().line = line;
    expect_input_error([&] { build_scene(setup, {}); }, parts);
  };
  expect({0, 2 * bar_length, 0, 0, 0, 20}, {"cable 'tendon'", "outside"});
  expect({0, bar_length, bar_width, bar_width, 0, 20}, {"cable 'tendon'", "outside"});
  expect({0, bar_length, 0, 0, 0, 0}, {"cable 'tendon'", "0 pieces", "at least 1"});
}

}  // namespace
}  // namespace taut

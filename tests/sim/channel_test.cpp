#include "sim/model/channel.hpp"

#include <Eigen/Geometry>

#include "sim/mesh/weights.hpp"
#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"
#include "tests/support/term_battery.hpp"

namespace taut {
namespace {

const Params none;  // displacements do not depend on parameters

using namespace test;

Eigen::MatrixXd rotation(int d, double angle) {
  if (d == 2) return Eigen::Rotation2Dd(angle).toRotationMatrix();
  return Eigen::AngleAxisd(angle, Eigen::Vector3d(1, -2, 0.5).normalized()).toRotationMatrix();
}

/// Displacement of the rigid motion x = R X + t.
Eigen::VectorXd rigid_motion(const Mesh& mesh, const Eigen::MatrixXd& R, const Eigen::VectorXd& t) {
  const int d = mesh.dimension();
  Eigen::VectorXd u(mesh.X.size());
  for (int i = 0; i < mesh.node_count(); ++i) u.segment(i * d, d) = R * mesh.node(i) + t - mesh.node(i);
  return u;
}

Eigen::VectorXd first_of(int d, double a, double b, double c) {
  return d == 2 ? vec({a, b}) : vec({a, b, c});
}

/// A marker on the end face of an irregular body of each shape.
struct Marker {
  explicit Marker(ElementShape shape) : mesh(irregular_mesh(shape)), d(mesh.dimension()) {
    const Tag face = mesh.select("xmax");
    foot_point = mesh.node(face.entities[0]);
    standoff = first_of(d, 0.04, -0.015, 0.02);
    direction = first_of(d, 1, 3, -2);
    channel = make_marker_channel(mesh, locate(mesh, foot_point), standoff, face, direction);
  }
  Mesh mesh;
  int d;
  Eigen::VectorXd foot_point, standoff, direction;
  std::unique_ptr<Channel> channel;
};

void expect_gradient_by_slope(const Channel& channel, const Eigen::VectorXd& u, double size, const std::string& what) {
  std::mt19937 random(4);
  const Eigen::VectorXd gradient = channel.gradient({u, none});
  ASSERT_EQ(gradient.size(), u.size());
  for (int k = 0; k < 3; ++k) {
    const Eigen::VectorXd v = random_vector(u.size(), random);
    expect_taylor_order(
        [&](double h) {
          return std::abs(channel.value({u + h * v, none}) - channel.value({u, none}) - h * gradient.dot(v));
        },
        2, 1e-16, size, 6, what);
  }
}

TEST(LinearChannel, IsItsWeightsTimesTheDisplacement) {
  std::mt19937 random(1);
  const Eigen::VectorXd weights = random_vector(20, random), u = random_vector(20, random);
  const auto channel = make_linear_channel(weights);
  EXPECT_EQ(channel->value({u, none}), weights.dot(u));
  EXPECT_EQ((channel->gradient({u, none}) - weights).norm(), 0.0);
}

TEST(LinearChannel, MeanOfAFaceHasTheSignOfTheDirection) {
  const Mesh mesh = irregular_mesh(ElementShape::tet10);
  const Eigen::VectorXd u = rigid_motion(mesh, Eigen::Matrix3d::Identity(), vec({0.001, -0.002, 0.003}));
  for (double sign : {1.0, -1.0}) {
    const auto channel = make_linear_channel(mean_weights(mesh, mesh.select("xmax"), sign * vec({0, 5, 0})));
    EXPECT_NEAR(channel->value({u, none}), -0.002 * sign, 1e-17);
  }
}

TEST(MarkerChannel, IsExactForRigidMotions) {
  for (ElementShape shape : all_shapes) {
    const Marker marker(shape);
    for (double angle : {0.0, 1e-6, 0.3, 1.5, 3.0, -2.5}) {
      const Eigen::MatrixXd R = rotation(marker.d, angle);
      const Eigen::VectorXd t = first_of(marker.d, 0.02, -0.03, 0.05);
      const Eigen::VectorXd point = marker.foot_point + marker.standoff;
      const double expected = marker.direction.normalized().dot(R * point + t - point);
      EXPECT_NEAR(marker.channel->value({rigid_motion(marker.mesh, R, t), none}), expected, 5e-16)
          << name_of(shape) << " " << angle;
    }
  }
}

TEST(MarkerChannel, GradientIsThatOfItsValueAtFiniteRotations) {
  for (ElementShape shape : all_shapes) {
    const Marker marker(shape);
    for (double angle : {0.0, 0.4, 2.0, -1.2}) {
      const Eigen::VectorXd u =
          rigid_motion(marker.mesh, rotation(marker.d, angle), Eigen::VectorXd::Constant(marker.d, 0.01)) +
          random_state(marker.mesh, 0.1, 0.02, 6);
      expect_gradient_by_slope(*marker.channel, u, 5e-4,
                               std::string(name_of(shape)) + " turned by " + std::to_string(angle));
    }
  }
}

TEST(MarkerChannel, WithoutStandoffIsTheDisplacementOfItsFoot) {
  for (ElementShape shape : all_shapes) {
    const Mesh mesh = irregular_mesh(shape);
    const Tag face = mesh.select("xmax");
    const Eigen::VectorXd u = random_state(mesh, 0.1, 0.02, 6);
    const int d = mesh.dimension(), node = face.entities[0];
    const auto channel = make_marker_channel(mesh, locate(mesh, mesh.node(node)), Eigen::VectorXd::Zero(d), face,
                                             Eigen::VectorXd::Unit(d, 1));
    EXPECT_NEAR(channel->value({u, none}), u[node * d + 1], 1e-16);
    EXPECT_NEAR((channel->gradient({u, none}) - Eigen::VectorXd::Unit(u.size(), node * d + 1)).norm(), 0.0, 1e-15);
  }
}

TEST(MarkerChannel, AStandoffAboveATiltingFaceMovesAgainstTheTilt) {
  // A face with normal y turned anticlockwise by a small angle carries a marker above it to the left.
  const Mesh mesh = rectangle(graded(0.1, 4), graded(0.02, 2), 2, "body");
  const double angle = 0.01;
  const auto channel =
      make_marker_channel(mesh, locate(mesh, vec({0.05, 0.02})), vec({0, 0.03}), mesh.select("ymax"), vec({2, 0}));
  const Eigen::VectorXd pivot = vec({0.05, 0.02});
  const Eigen::MatrixXd R = rotation(2, angle);
  const double value = channel->value({rigid_motion(mesh, R, pivot - R * pivot), none});
  EXPECT_NEAR(value, -0.03 * std::sin(angle), 1e-16);
  const auto opposite =
      make_marker_channel(mesh, locate(mesh, vec({0.05, 0.02})), vec({0, 0.03}), mesh.select("ymax"), vec({-1, 0}));
  EXPECT_NEAR(opposite->value({rigid_motion(mesh, R, pivot - R * pivot), none}), 0.03 * std::sin(angle), 1e-16);
}

TEST(MarkerChannel, AUniformStretchDoesNotTurnIt) {
  for (ElementShape shape : all_shapes) {
    const Marker marker(shape);
    Eigen::VectorXd u(marker.mesh.X.size());
    for (int i = 0; i < marker.mesh.node_count(); ++i) u.segment(i * marker.d, marker.d) = 0.3 * marker.mesh.node(i);
    EXPECT_NEAR(marker.channel->value({u, none}), 0.3 * marker.direction.normalized().dot(marker.foot_point), 1e-16);
  }
}

TEST(MarkerChannel, APatchWithoutARotationIsRefused) {
  const Mesh flat = rectangle(graded(0.1, 2), graded(0.1, 2), 2, "body");
  const Mesh solid = box(graded(0.1, 2), graded(0.1, 2), graded(0.1, 2), 2, "body");
  expect_input_error(
      [&] {
        make_marker_channel(flat, locate(flat, vec({0.1, 0.1})), vec({0, 0.01}), flat.select("xmax & ymax"),
                            vec({0, 1}));
      },
      {"a single point", "name a face"});
  expect_input_error(
      [&] {
        make_marker_channel(solid, locate(solid, vec({0.1, 0.1, 0})), vec({0, 0.01, 0}), solid.select("xmax & ymax"),
                            vec({0, 1, 0}));
      },
      {"a straight line", "name a face"});
  EXPECT_NO_THROW(
      make_marker_channel(flat, locate(flat, vec({0.1, 0.1})), vec({0, 0.01}), flat.select("xmax"), vec({0, 1})));
}

TEST(RotationChannel, IsTheAngleOfATurnedBodyAndItsGradientTheDerivative) {
  for (ElementShape shape : all_shapes) {
    const Mesh mesh = irregular_mesh(shape);
    const int d = mesh.dimension();
    const Eigen::Vector3d axis = d == 2 ? Eigen::Vector3d::UnitZ() : Eigen::Vector3d(1, 2, -1).normalized();
    const auto channel =
        make_rotation_channel(mesh, mesh.select("xmax"), d == 2 ? Eigen::VectorXd() : Eigen::VectorXd(axis));
    for (double angle : {0.0, 0.4, -1.3, 2.9}) {
      const Eigen::Matrix3d R = Eigen::AngleAxisd(angle, axis).toRotationMatrix();
      Eigen::VectorXd u(mesh.X.size());
      for (int i = 0; i < mesh.node_count(); ++i) {
        u.segment(i * d, d) = R.topLeftCorner(d, d) * mesh.node(i) - mesh.node(i) + Eigen::VectorXd::Constant(d, 0.3);
      }
      EXPECT_NEAR(channel->value({u, none}), angle, 1e-12);
      std::mt19937 random(5);
      u += 0.003 * random_vector(u.size(), random);
      const Eigen::VectorXd v = random_vector(u.size(), random), moved = u;
      const double y = channel->value({u, none}), slope = channel->gradient({u, none}).dot(v);
      expect_taylor_order(
          [&](double h) {
            return std::abs(channel->value({moved + h * v, none}) - y - h * slope);
          },
          2, 1e-14, 1e-3, 6, std::string(name_of(shape)));
    }
  }
}

}  // namespace
}  // namespace taut

#include <gtest/gtest.h>

#include <Eigen/SVD>
#include <cmath>

#include "sim/files/simulation.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/robots/simulate.hpp"
#include "sim/scene/scene.hpp"
#include "sim/shapes/sheet.hpp"
#include "sim/shapes/twist.hpp"
#include "sim/solve/equilibrium.hpp"

// The robots of experiments/twist and experiments/sheet against geometry and against the strength of materials.
namespace taut {
namespace {

constexpr double degree = M_PI / 180;

struct Run3d {
  Simulation simulation;
  Robot robot;
  SimulationResult result;

  const std::vector<double>& reading(const std::string& id) const {
    for (size_t k = 0; k < robot.readings.size(); ++k) {
      if (robot.readings[k].id == id) return result.readings[k];
    }
    throw std::logic_error(id);
  }
};

/// The experiment of a folder in `steps` steps, up to `until` of its duration. Modules have two cells of four, and
/// coarse ones, so that half the retraction closes them.
Run3d run(const std::string& name, int steps, double until) {
  Run3d run{read_simulation(TAUT_SOURCE_DIR "/experiments/" + name + "/experiment.toml"), {}, {}};
  run.simulation.duration *= until;
  run.simulation.step = run.simulation.duration / steps;
  for (BodySettings& body : run.simulation.bodies) {
    if (body.geometry.kind() != "twist") continue;
    body.geometry.edit<TwistModule>().cells = 2;
    body.mesh.order = 1;
  }
  run.robot = make_robot(run.simulation);
  run.result = simulate(run.simulation, run.robot);
  EXPECT_EQ(run.result.failure, "");
  EXPECT_EQ(run.result.times.size(), static_cast<size_t>(steps) + 1);
  return run;
}

void expect_sound(const Run3d& run) {
  EXPECT_GT(run.result.smallest_jacobian, 0.1);
  EXPECT_EQ(run.result.intersecting, 0);
  EXPECT_GT(run.result.smallest_distance, 0);
}

const Run3d& twist() {
  static const Run3d once = run("twist", 11, 0.55);
  return once;
}
const Run3d& sheet() {
  static const Run3d once = run("sheet", 3, 0.4);
  return once;
}

TEST(SlowTwist, OppositeHandednessGivesTheOppositeAngleAndTheSameTension) {
  const std::vector<double>&right = twist().reading("twist_right"), &left = twist().reading("twist_left");
  const std::vector<double>&T_right = twist().reading("tension_right"), &T_left = twist().reading("tension_left");
  for (size_t i = 1; i < right.size(); ++i) {
    EXPECT_NEAR(right[i], -left[i], 1e-6 * left[i]);
    EXPECT_NEAR(T_right[i], T_left[i], 1e-6 * T_left[i]);
  }
  expect_sound(twist());
}

TEST(SlowTwist, TheAngleGrowsWithTheRetractionAndTheRimsMeetAtItsEnd) {
  const std::vector<double>&angle = twist().reading("twist_left"), &T = twist().reading("tension_left");
  const std::vector<double>& shortening = twist().reading("shortening_left");
  for (size_t i = 1; i < angle.size(); ++i) EXPECT_GT(angle[i], angle[i - 1]);
  // No rim can pass another: all that can be lost is the gaps, and closed rims stiffen the module.
  const TwistModule& m = twist().simulation.bodies[0].geometry.as<TwistModule>();
  const size_t end = angle.size() - 1;
  EXPECT_LT(shortening[end], m.cells * m.rim_gap + 1e-5);
  EXPECT_GT(shortening[end], 0.99 * m.cells * m.rim_gap);
  EXPECT_GT(T[end] - T[end - 1], 2 * (T[end - 3] - T[end - 4]));
}

// Plates are stiff and all cells alike, so a helix has only one way to become shorter: each span joins points at the
// radius r, turned by alpha - theta/n and h - s/n apart, and their lengths add up to what the winch has left.
TEST(SlowTwist, ShorteningAndAngleObeyTheLengthOfTheHelix) {
  const TwistModule& m = twist().simulation.bodies[1].geometry.as<TwistModule>();
  const auto length = [&](double theta, double s) {
    const double across = 2 * m.cable_radius * std::sin(0.5 * (m.cable_turn - theta / m.cells));
    return m.cells * std::hypot(across, m.cell_length - s / m.cells) + (m.cells + 1) * m.plate_thickness;
  };
  for (size_t i = 1; i < twist().result.times.size(); ++i) {
    const double u = twist().result.controls[0][i], k = twist().simulation.cables.cables[0].own->k.value();
    const double theta = twist().reading("twist_left")[i], s = twist().reading("shortening_left")[i];
    const double left = length(0, 0) - u + twist().reading("tension_left")[i] / k;
    EXPECT_NEAR(length(theta, s), left, 0.01 * u) << 1e3 * u << " mm";
  }
}

TEST(SlowTwist, HalfTheStepChangesTheEndAngleByLessThanAThousandth) {
  const double angle = run("twist", 3, 0.4).reading("twist_left").back();
  EXPECT_NEAR(run("twist", 6, 0.4).reading("twist_left").back(), angle, 1e-3 * angle);
}

// One cell, retracted a little. Cables of tension T load it by 4 T h/l along the axis and 4 T r^2 sin(alpha)/l about
// it. Its stiffness lies between those of admissible stresses (free sides: E A/h, and Saint-Venant's 0.1406 G a^4/h)
// and those of admissible displacements (straight sides: M A/h, G a^4/(6 h)).
TEST(SlowTwist, AtFirstAngleAndTensionLieBetweenTheBoundsOfElasticity) {
  TwistModule m;
  m.cells = 1;
  const double E = 61.15e3, nu = 0.2, G = 0.5 * E / (1 + nu), M = E * (1 - nu) / ((1 + nu) * (1 - 2 * nu));
  SceneBuilder builder(m.mesh({.order = 2}, false, false));
  builder.add_solid("foam", "neo_hookean", {{"E", E}, {"nu", nu}});
  builder.add_solid("plastic", "neo_hookean", {{"E", 2.3e9}, {"nu", 0.35}});
  builder.fix("base", {0, 1, 2});
  const int k = builder.declare({"k", "k", "N/m", 1, 1e6, "stiffness of a cable"}, 5e3);
  const int u = builder.declare({"u", "u", "m", 0, 1, "retraction"}, 0);
  Cable cable;
  cable.stiffness = k;
  cable.retraction = u;
  cable.smoothing = 0;
  for (int i = 0; i < m.cables; ++i) {
    cable.points.clear();
    for (const Eigen::Vector3d& x : cable_path(m, i, -1)) cable.points.push_back({locate(builder.mesh(), x), x});
    builder.add_cable(cable);
  }
  Scene scene = builder.build();
  const Mesh& mesh = scene.model->mesh();
  Equilibrium equilibrium(*scene.model);
  equilibrium.start_at_rest(scene.values);
  scene.values[u] = 20e-6;
  ASSERT_EQ(equilibrium.solve(scene.values).status, SolveStatus::converged);
  const auto value = [&](const Channel& channel) { return channel.value({equilibrium.u(), equilibrium.p()}); };
  const double theta = value(*make_rotation_channel(mesh, mesh.select("tip"), Eigen::Vector3d::UnitZ()));
  const double s = value(*make_linear_channel(mean_weights(mesh, mesh.select("tip"), -Eigen::Vector3d::UnitZ())));
  const double T = value(*make_cable_tension(mesh, cable));
  const double h = m.cell_length, r = m.cable_radius, a = m.core_width;
  const double l = std::hypot(2 * r * std::sin(0.5 * m.cable_turn), h);
  const double along = 4 * T * h / l / s, about = 4 * T * r * r * std::sin(m.cable_turn) / l / theta;
  EXPECT_GT(along, E * a * a / h);
  EXPECT_LT(along, M * a * a / h);
  EXPECT_GT(about, 0.1406 * G * std::pow(a, 4) / h);
  EXPECT_LT(about, G * std::pow(a, 4) / (6 * h));
}

/// Where points that move with a tile go: the rigid motion next to that of its nodes.
std::vector<Eigen::Vector3d> carried(const Mesh& mesh, const Eigen::VectorXd& u, const Eigen::Vector3d& lower,
                                     const Eigen::Vector3d& upper, const std::vector<Eigen::Vector3d>& points) {
  Eigen::Vector3d at_rest = Eigen::Vector3d::Zero(), now = Eigen::Vector3d::Zero();
  std::vector<int> nodes;
  for (int i = 0; i < mesh.node_count(); ++i) {
    const Eigen::Vector3d X = mesh.node(i);
    if (((X - lower).array() < -1e-9).any() || ((X - upper).array() > 1e-9).any()) continue;
    nodes.push_back(i);
    at_rest += X;
    now += X + u.segment<3>(3 * Eigen::Index(i));
  }
  at_rest /= static_cast<double>(nodes.size());
  now /= static_cast<double>(nodes.size());
  Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
  for (int i : nodes) {
    const Eigen::Vector3d X = mesh.node(i);
    sum += (X + u.segment<3>(3 * Eigen::Index(i)) - now) * (X - at_rest).transpose();
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(sum, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Matrix3d R = svd.matrixU() * svd.matrixV().transpose();
  std::vector<Eigen::Vector3d> moved;
  for (const Eigen::Vector3d& X : points) moved.push_back(now + R * (X - at_rest));
  return moved;
}

TEST(SlowSheet, ShortenedCablesFitBetweenStiffTiles) {
  const Sheet& s = sheet().simulation.bodies[0].geometry.as<Sheet>();
  const double z = s.cable_height, pitch = s.tile + s.strip;
  const Mesh& mesh = sheet().robot.scene.model->mesh();
  const char* tensions[] = {"tension_front", "tension_middle", "tension_back"};
  for (size_t i = 1; i < sheet().result.times.size(); ++i) {
    const double u = sheet().result.controls[0][i];
    for (int row = 0; row < s.rows; ++row) {
      double length = 0;
      Eigen::Vector3d last = Eigen::Vector3d::Zero();
      for (int column = 0; column < s.columns; ++column) {
        const Eigen::Vector3d lower(column * pitch, row * pitch, -0.5 * s.thickness);
        const Eigen::Vector3d enters(column * pitch, row * pitch + 0.5 * s.tile, z);
        const std::vector<Eigen::Vector3d> ends =
            carried(mesh, sheet().result.states[i], lower, lower + Eigen::Vector3d(s.tile, s.tile, s.thickness),
                    {enters, enters + s.tile * Eigen::Vector3d::UnitX()});
        if (column > 0) length += (ends[0] - last).norm();
        length += s.tile;
        last = ends[1];
      }
      const double T = sheet().reading(tensions[row])[i];
      EXPECT_NEAR(length, s.length() - u + T / sheet().simulation.cables.cables[0].own->k.value(), 0.01 * u)
          << row << " " << 1e3 * u;
    }
  }
  expect_sound(sheet());
}

// Strips as beams: the cables' force T and its moment T z shorten the line that they run along by u - T/k = theta (z +
// t^2/(12 z)), whatever the foam; the moment is that of a modulus between E (free to widen) and M (not at all).
TEST(SlowSheet, CurlAndTensionAreNearThoseOfBeams) {
  const Sheet& s = sheet().simulation.bodies[0].geometry.as<Sheet>();
  const double z = s.cable_height, t = s.thickness;
  const double E = 61.15e3, nu = 0.2, M = E * (1 - nu) / ((1 + nu) * (1 - 2 * nu));
  double last = 0;
  for (size_t i = 1; i < sheet().result.times.size(); ++i) {
    const double curl = sheet().reading("curl")[i], u = sheet().result.controls[0][i];
    const double T = (sheet().reading("tension_front")[i] + sheet().reading("tension_middle")[i] +
                      sheet().reading("tension_back")[i]) /
                     3;
    EXPECT_GT(curl, last);
    last = curl;
    if (curl > 90 * degree) continue;  // by then the strips are too bent for straight beams
    EXPECT_NEAR(curl, (u - T / sheet().simulation.cables.cables[0].own->k.value()) / (z + t * t / (12 * z)),
                0.03 * curl);
    const double modulus = s.rows * T * z / (s.width() * t * t * t / 12) * (s.columns - 1) * s.strip / curl;
    EXPECT_GT(modulus, E);
    EXPECT_LT(modulus, M);
  }
}

TEST(SlowSheet, HalfTheStepChangesTheEndAngleByLessThanAThousandth) {
  const double angle = sheet().reading("curl").back();
  EXPECT_NEAR(run("sheet", 6, 0.4).reading("curl").back(), angle, 1e-3 * angle);
}

}  // namespace
}  // namespace taut

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sim/files/simulation.hpp"
#include "sim/mesh/mesh.hpp"
#include "sim/robots/robot_ik.hpp"
#include "sim/robots/simulate.hpp"
#include "sim/robots/workspace.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"

// Scenes of several bodies against what is known of them without a simulation.
namespace taut {
namespace {

using namespace test;

struct Scenario {
  Simulation simulation;
  Robot robot;
  SimulationResult result;

  explicit Scenario(const std::string& toml) {
    const TemporaryFolder folder;
    simulation = read_simulation(folder.write("experiment.toml", toml));
    robot = make_robot(simulation);
    result = simulate(simulation, robot);
  }
  const Mesh& mesh() const { return robot.scene.model->mesh(); }
  const std::vector<double>& channel(const std::string& id) const {
    return result.readings[static_cast<size_t>(&robot.reading(id) - robot.readings.data())];
  }
};

// Two links of 60 x 10 mm that overlap by 10 mm about a motorised joint, the first one clamped.
const std::string two_links = R"(title = "Two links"
[simulation]
integrator = "static"
duration = "1 s"
step = "50 ms"
thickness = "10 mm"
[materials.rubber]
law = "neo_hookean"
E = "10 MPa"
nu = 0.3
[[body]]
name = "one"
geometry = { kind = "rectangle", size = ["60 mm", "10 mm"], region = "rubber" }
mesh = { cells = [24, 4], element = "linear" }
clamped = ["xmin"]
[[body]]
name = "two"
geometry = { kind = "rectangle", size = ["60 mm", "10 mm"], region = "rubber" }
mesh = { cells = [24, 4], element = "linear" }
at = ["50 mm", "0 mm"]
[[control]]
id = "motor"
start = "0 deg"
[[control.piece]]
until = "1 s"
kind = "linear"
to = "TURN"
[[joint]]
id = "elbow"
between = ["one", "two"]
at = ["55 mm", "5 mm"]
motor_at = ["55 mm", "8 mm"]
radius = "4 mm"
angle = "motor"
[contact]
gap = "0.1 mm"
[[channel]]
id = "turned"
kind = "joint_angle"
of = "elbow"
)";

/// The corners of a body's rectangle of `cells` along its boundary nodes, anticlockwise, in a state.
std::vector<Eigen::Vector2d> outline_of(const Mesh& mesh, const std::string& body, const Eigen::VectorXd& u) {
  const Part& part = mesh.part(body);
  std::vector<Eigen::Vector2d> outline;
  const Tag edges = boundary(mesh);
  int at = -1, first = -1;
  do {
    for (int e = 0; e < edges.count(); ++e) {
      const int from = edges.entity(e)[0], to = edges.entity(e)[1];
      if (from < part.first_node || from >= part.first_node + part.node_count) continue;
      if (at < 0) at = first = from;
      if (from != at) continue;
      outline.push_back(mesh.node(at) + u.segment<2>(2 * at));
      at = to;
      break;
    }
  } while (at != first);
  return outline;
}

/// By the sum of the angles at which the edges are seen.
bool inside(const Eigen::Vector2d& point, const std::vector<Eigen::Vector2d>& outline) {
  double turn = 0;
  for (size_t i = 0; i < outline.size(); ++i) {
    const Eigen::Vector2d a = outline[i] - point, b = outline[(i + 1) % outline.size()] - point;
    turn += std::atan2(a[0] * b[1] - a[1] * b[0], a.dot(b));
  }
  return std::abs(turn) > std::numbers::pi;
}

TEST(JoinedBodies, SeeEachOtherBeyondTheirOverlapAboutThePin) {
  const Scenario easy(replaced(two_links, "TURN", "80 deg"));
  ASSERT_EQ(easy.result.failure, "");
  ASSERT_EQ(easy.robot.joined.size(), 1u);
  // The corner of the overlap of 10 x 10 mm, and two gaps.
  EXPECT_NEAR(easy.robot.joined[0].radius, std::sqrt(2.0) * 5e-3 + 0.2e-3, 1e-9);
  EXPECT_NEAR(easy.channel("turned").back(), 80 * std::numbers::pi / 180, 1e-4) << "nothing is in the way yet";

  // Strips of half width a meet outside the circle of radius R once they are folded by more than 180 deg - 2 asin(a/R).
  const Scenario folded(replaced(two_links, "TURN", "150 deg"));
  const double meet = 180 - 2 * std::asin(5e-3 / folded.robot.joined[0].radius) * 180 / std::numbers::pi;
  EXPECT_NEAR(meet, 93, 1) << "of the test";
  EXPECT_EQ(folded.result.intersecting, 0);
  const Mesh& mesh = folded.mesh();
  const Eigen::Vector2d pin(55e-3, 5e-3);
  int watched = 0;
  for (const Eigen::VectorXd& u : folded.result.states) {
    for (const auto& [here, there] : {std::pair("one", "two"), std::pair("two", "one")}) {
      const std::vector<Eigen::Vector2d> other = outline_of(mesh, there, u);
      const Part& part = mesh.part(here);
      for (int node = part.first_node; node < part.first_node + part.node_count; ++node) {
        if ((mesh.node(node) - pin).norm() <= folded.robot.joined[0].radius) continue;
        ++watched;
        EXPECT_FALSE(inside(mesh.node(node) + u.segment<2>(2 * node), other)) << here << " node " << node;
      }
    }
  }
  EXPECT_GT(watched, 1000);
  const double turned = folded.channel("turned").back() * 180 / std::numbers::pi;
  const bool stopped = !folded.result.failure.empty();
  EXPECT_TRUE(stopped || turned < 149) << "what is in the way stops the motor, or bends: " << turned;
}

TEST(JoinedBodies, AnAnswerThatLiesAgainstALinkCostsLittleMoreThanOneThatDoesNot) {
  std::string toml = replaced(replaced(two_links, "clamped = [\"xmin\"]\n", ""), "TURN", "0 deg");
  toml = replaced(toml, "E = \"10 MPa\"", "E = \"1 GPa\"");
  toml += R"(
[[control]]
id = "lift"
start = "0 deg"
[[joint]]
id = "shoulder"
between = ["world", "one"]
at = ["5 mm", "5 mm"]
motor_at = ["5 mm", "8 mm"]
radius = "4 mm"
angle = "lift"
[[channel]]
id = "tip_x"
kind = "position"
of = "two.xmax"
direction = [1, 0]
[ik]
tolerance = "0.05 mm"
[ik.control.motor]
lower = "-150 deg"
upper = "150 deg"
[ik.control.lift]
lower = "-60 deg"
upper = "60 deg"
[[ik.path]]
name = "inwards"
tip_x = ["60 mm", "55 mm", "50 mm", "45 mm", "40 mm", "36 mm", "34 mm", "32 mm", "30 mm", "28 mm", "26 mm", "24 mm"]
)";
  const TemporaryFolder folder;
  const Simulation simulation = read_simulation(folder.write("experiment.toml", toml));
  const Robot robot = make_robot(simulation);
  const std::vector<IkAnswer> answers = solve_target(simulation, robot, simulation.ik->targets.front());
  ASSERT_EQ(answers.size(), 12u);
  // The strips meet where SeeEachOtherBeyondTheirOverlapAboutThePin says; from there on the shoulder has to do it.
  const double meet = std::numbers::pi - 2 * std::asin(5e-3 / robot.joined[0].radius);
  const auto along = [&](double lift, double elbow) {
    return 5e-3 + 50e-3 * std::cos(lift) + 55e-3 * std::cos(lift + elbow);
  };
  int against = 0, most = 0;
  for (const IkAnswer& answer : answers) {
    ASSERT_EQ(answer.result.status, IkStatus::reached) << answer.result.message;
    double elbow = 0, lift = 0;
    for (size_t k = 0; k < answer.free.size(); ++k)
      (simulation.controls[answer.free[k]].id == "motor" ? elbow : lift) =
          answer.result.controls[static_cast<Eigen::Index>(k)];
    if (answer.wanted[0] > 33e-3) continue;
    ++against;
    if (against > 1) most = std::max(most, answer.result.factorisations);
    EXPECT_NEAR(std::abs(elbow), meet, 0.05) << "held where the links meet, at " << answer.wanted[0];
    EXPECT_NEAR(along(lift, std::copysign(meet, elbow)), answer.wanted[0], 2.5e-3);
  }
  EXPECT_EQ(against, 5);
  EXPECT_LE(most, 10);
}

TEST(JoinedBodies, APinWithoutContactHasNoPatch) {
  const Scenario free(replaced(replaced(two_links, "TURN", "150 deg"), "[contact]\ngap = \"0.1 mm\"\n", ""));
  EXPECT_EQ(free.result.failure, "");
  EXPECT_EQ(free.robot.joined[0].radius, 0);
  EXPECT_NEAR(free.channel("turned").back(), 150 * std::numbers::pi / 180, 1e-4);
}

// Two bars of 50 mm over a rise of 4 mm, pinned to the world and to each other: a shallow von Mises truss.
std::string truss(double force) {
  const double rise = 4, half = 50, length = std::hypot(rise, half), angle = std::atan2(rise, half);
  // A bar's corner, so that the middle of its left end is at the pin.
  const auto corner = [&](double x, double y, double turn) {
    return fmt::format("at = [\"{:.9g} mm\", \"{:.9g} mm\"]\nturned = \"{:.12g} rad\"", x + 3 * std::sin(turn),
                       y - 3 * std::cos(turn), turn);
  };
  return fmt::format(R"(title = "Truss"
[simulation]
integrator = "static"
duration = "1 s"
step = "20 ms"
thickness = "10 mm"
[materials.rubber]
law = "neo_hookean"
E = "1 MPa"
nu = 0
[[body]]
name = "left"
geometry = {{ kind = "rectangle", size = ["{0:.9g} mm", "6 mm"], region = "rubber" }}
mesh = {{ cells = [16, 2] }}
{1}
[[body]]
name = "right"
geometry = {{ kind = "rectangle", size = ["{0:.9g} mm", "6 mm"], region = "rubber" }}
mesh = {{ cells = [16, 2] }}
{2}
[[joint]]
id = "left_pin"
between = ["world", "left"]
at = ["0 mm", "0 mm"]
radius = "3 mm"
[[joint]]
id = "right_pin"
between = ["world", "right"]
at = ["100 mm", "0 mm"]
radius = "3 mm"
[[joint]]
id = "apex"
between = ["left", "right"]
at = ["50 mm", "4 mm"]
radius = "3 mm"
[[control]]
id = "push"
start = "0 N"
[[control.piece]]
until = "1 s"
kind = "linear"
to = "{3:.9g} N"
[[load]]
id = "dead"
on = "left.xmax"
direction = [0, -1]
control = "push"
[[channel]]
id = "drop"
kind = "displacement"
of = "left.xmax"
direction = [0, -1]
[workspace]
x = "drop"
y = "rise"
samples = 30
[[workspace.mode]]
name = "pushed"
push = ["0 N", "{3:.9g} N"]
[[channel]]
id = "rise"
kind = "displacement"
of = "left.xmax"
direction = [0, 1]
)",
                     length, corner(0, 0, angle), corner(half, rise, -angle), force);
}

TEST(Slips, AVonMisesTrussJumpsAtItsFoldAndSaysSo) {
  // Shallow: F = EA z (h^2 - z^2) / L^3 at the height z, at most 2 EA h^3 / (3 sqrt(3) L^3) at z = h / sqrt(3), and
  // from there to z = -2 h / sqrt(3).
  const double h = 4e-3, L = std::hypot(4e-3, 50e-3), EA = 1e6 * 6e-3 * 10e-3;
  const double fold = 2 * EA * std::pow(h / L, 3) / (3 * std::sqrt(3.0));
  const Scenario truss_run(truss(2 * fold));
  ASSERT_EQ(truss_run.result.failure, "");
  ASSERT_EQ(truss_run.result.slips.size(), 1u);
  const SimulationResult::Slip& slip = truss_run.result.slips[0];
  EXPECT_NEAR(2 * slip.t, 1, 0.15) << "of twice the fold's load in a second; pins act over patches";
  EXPECT_NEAR(slip.jump, std::sqrt(3.0) * h, 0.15 * std::sqrt(3.0) * h);

  const Scenario below(truss(0.7 * fold));
  EXPECT_EQ(below.result.failure, "");
  EXPECT_TRUE(below.result.slips.empty());

  EXPECT_GT(sample_workspaces(truss_run.simulation, truss_run.robot).front().slips, 0);
  EXPECT_EQ(sample_workspaces(below.simulation, below.robot).front().slips, 0);
}

// A cantilever between two tendons, which a force may stretch besides.
const std::string between_tendons = R"(title = "Tendons"
[simulation]
integrator = "static"
duration = "1 s"
step = "1 s"
thickness = "10 mm"
gravity = "9.81 m/s2"
direction = [1, 0]
[materials.rubber]
law = "neo_hookean"
E = "100 kPa"
nu = 0.3
density = "1000 kg/m3"
[[body]]
name = "beam"
geometry = { kind = "rectangle", size = ["60 mm", "10 mm"], region = "rubber" }
mesh = { cells = [12, 2] }
clamped = ["xmin"]
[[control]]
id = "upper"
start = "0 N"
[[control]]
id = "lower"
start = "0 N"
[[control]]
id = "pull"
start = "0 N"
[[cable]]
id = "upper_tendon"
body = "beam"
x = ["0 mm", "60 mm"]
y = ["9 mm", "9 mm"]
tension = "upper"
[[cable]]
id = "lower_tendon"
body = "beam"
x = ["0 mm", "60 mm"]
y = ["1 mm", "1 mm"]
tension = "lower"
[[load]]
id = "dead"
on = "beam.xmax"
direction = [1, 0]
control = "pull"
[[channel]]
id = "x"
kind = "position"
of = "beam.xmax"
direction = [1, 0]
[[channel]]
id = "y"
kind = "position"
of = "beam.xmax"
direction = [0, 1]
[workspace]
x = "x"
y = "y"
samples = 60
[[workspace.mode]]
name = "soft"
upper = ["0 N", "50 mN"]
lower = ["0 N", "50 mN"]
[[workspace.mode]]
name = "pulled"
upper = ["0 N", "50 mN"]
lower = ["0 N", "50 mN"]
pull = ["-20 mN", "0.2 N"]
)";

TEST(Workspaces, OfASymmetricSceneAreSymmetricAndHoldThoseOfModesWithin) {
  const TemporaryFolder folder;
  const auto reach = [&](const std::string& toml) {
    const Simulation simulation = read_simulation(folder.write("experiment.toml", toml));
    return sample_workspaces(simulation, make_robot(simulation));
  };
  const std::vector<WorkspaceResult> spaces = reach(between_tendons);
  ASSERT_EQ(spaces.size(), 2u);
  for (const WorkspaceResult& space : spaces) {
    EXPECT_EQ(space.mirrored, 1);
    EXPECT_EQ(space.samples, 62);
    EXPECT_EQ(space.failures, 0);
    double above = 0, below = 0;
    for (const Eigen::Vector2d& point : space.points) {
      above = std::max(above, point[1] - 5e-3);
      below = std::max(below, 5e-3 - point[1]);
    }
    EXPECT_NEAR(above, below, 1e-12);
    EXPECT_GT(above, 3e-3);
    EXPECT_GT(space.area_error, 0);
    EXPECT_LT(space.area_error, space.area);
  }
  EXPECT_TRUE(spaces[0].holds.empty());
  EXPECT_EQ(spaces[1].holds, std::vector<std::string>{"soft"});
  EXPECT_EQ(spaces[1].points.size(), 4u * 62u);
  EXPECT_GE(spaces[1].area, spaces[0].area);

  // Weight across the axis leaves no symmetry.
  EXPECT_EQ(
      reach(replaced(between_tendons, "direction = [1, 0]\n[materials", "direction = [0, -1]\n[materials"))[0].mirrored,
      -1);
}

TEST(Slips, PosesBeyondAFoldAreSaidToBeReachedByAJump) {
  const double h = 4e-3, L = std::hypot(4e-3, 50e-3), EA = 1e6 * 6e-3 * 10e-3;
  const double fold = 2 * EA * std::pow(h / L, 3) / (3 * std::sqrt(3.0));
  const Scenario scene(truss(0.1 * fold));
  const Model& model = *scene.robot.scene.model;
  const auto jumps = [&](const std::vector<double>& loads) {
    Equilibrium equilibrium = equilibrium_at_rest(scene.simulation, scene.robot, model);
    std::vector<IkAnswer> answers;
    for (const double load : loads) {
      Params p = scene.robot.scene.values;
      p[scene.robot.controls[0]] = load * fold;
      EXPECT_EQ(equilibrium.solve(p).status, SolveStatus::converged);
      answers.emplace_back();
      answers.back().u = equilibrium.u();
      answers.back().p = p;
    }
    return jumps_to(scene.simulation, scene.robot, answers);
  };
  EXPECT_EQ(jumps({0.4, 0.7}), std::vector<size_t>());
  EXPECT_EQ(jumps({0.7, 1.8, 2}), std::vector<size_t>{1});
}

// Two fingers in the plane, the second one the mirror image of the first in the line x = 0.
const std::string fingers = R"(title = "Fingers"
[simulation]
integrator = "static"
duration = "1 s"
step = "0.5 s"
thickness = "20 mm"
[materials.foam]
law = "neo_hookean"
E = "60 kPa"
nu = 0.2
[materials.plastic]
law = "neo_hookean"
E = "1 GPa"
nu = 0.35
[[body]]
name = "left"
geometry = { kind = "finger", segments = 3 }
mesh = { size = "4 mm", element = "linear" }
at = ["-80 mm", "0 mm"]
turned = "-60 deg"
clamped = ["base"]
[[body]]
name = "right"
geometry = { kind = "finger", segments = 3 }
mesh = { size = "4 mm", element = "linear" }
mirror = "x"
at = ["80 mm", "0 mm"]
turned = "60 deg"
clamped = ["base"]
[[control]]
id = "pull"
start = "0 mm"
[[control.piece]]
until = "1 s"
kind = "linear"
to = "3 mm"
[[cable]]
id = "left_tendon"
body = "left"
path = "cable"
anchored = true
k = "17 N/mm"
retraction = "pull"
[[cable]]
id = "right_tendon"
body = "right"
path = "cable"
anchored = true
k = "17 N/mm"
retraction = "pull"
[contact]
gap = "20 um"
)";

TEST(MirroredBodies, MoveAsTheirMirrorImagesDo) {
  const TemporaryFolder folder;
  std::string toml = fingers;
  for (const std::string body : {"left", "right"}) {
    for (const auto& [id, direction] : {std::pair("x", "[1, 0]"), std::pair("y", "[0, 1]")})
      toml += fmt::format("[[channel]]\nid = \"{0}_{1}\"\nkind = \"position\"\nof = \"{0}.tip\"\ndirection = {2}\n",
                          body, id, direction);
  }
  const Scenario run(toml);
  ASSERT_EQ(run.result.failure, "");
  run.mesh().check("mirrored");
  const Part &left = run.mesh().part("left"), &right = run.mesh().part("right");
  ASSERT_EQ(left.node_count, right.node_count);
  for (int i = 0; i < left.node_count; ++i) {
    const Eigen::Vector2d here = run.mesh().node(left.first_node + i), there = run.mesh().node(right.first_node + i);
    EXPECT_NEAR(here[0], -there[0], 1e-15);
    EXPECT_NEAR(here[1], there[1], 1e-15);
  }
  for (size_t k = 0; k < run.result.times.size(); ++k) {
    EXPECT_NEAR(run.channel("left_x")[k], -run.channel("right_x")[k], 1e-9);
    EXPECT_NEAR(run.channel("left_y")[k], run.channel("right_y")[k], 1e-9);
  }
  EXPECT_GT((Eigen::Vector2d(run.channel("left_x").back(), run.channel("left_y").back()) -
             Eigen::Vector2d(run.channel("left_x")[0], run.channel("left_y")[0]))
                .norm(),
            2e-3)
      << "they bend";
}

// A cantilever over which a block is thrown, and a block that hangs from the world by two cables.
const std::string sag_and_fall = R"(title = "A cantilever sags, a block falls"
[simulation]
start = "equilibrium"
duration = "20 ms"
step = "1 ms"
thickness = "10 mm"
gravity = "9.81 m/s2"
direction = [0, -1]
[materials.rubber]
law = "neo_hookean"
E = "1 MPa"
nu = 0.3
density = "1000 kg/m3"
[[body]]
name = "beam"
geometry = { kind = "rectangle", size = ["60 mm", "4 mm"], region = "rubber" }
mesh = { cells = [12, 2] }
clamped = ["xmin"]
[[body]]
name = "block"
geometry = { kind = "rectangle", size = ["8 mm", "8 mm"], region = "rubber" }
mesh = { cells = [2, 2] }
at = ["40 mm", "10 mm"]
velocity = ["0.1 m/s", "0.2 m/s"]
[[body]]
name = "hung"
geometry = { kind = "rectangle", size = ["20 mm", "8 mm"], region = "rubber" }
mesh = { cells = [4, 2] }
at = ["100 mm", "0 mm"]
[[cable]]
id = "left"
body = "hung"
x = ["-2 mm", "2 mm"]
y = ["40 mm", "6 mm"]
fixed = "start"
k = "1 N/mm"
[[cable]]
id = "right"
body = "hung"
x = ["22 mm", "18 mm"]
y = ["40 mm", "6 mm"]
fixed = "start"
k = "1 N/mm"
[contact]
gap = "0.1 mm"
[[channel]]
id = "tip"
kind = "displacement"
of = "beam.xmax"
direction = [0, -1]
[[channel]]
id = "height"
kind = "displacement"
of = "block"
direction = [0, 1]
[[channel]]
id = "way"
kind = "displacement"
of = "block"
direction = [1, 0]
[[channel]]
id = "tension"
kind = "tension"
of = "left"
)";

TEST(StartInEquilibrium, LeavesFreeBodiesWhereTheyWerePutWithTheirVelocity) {
  const Scenario run(sag_and_fall);
  ASSERT_EQ(run.result.failure, "");
  const double g = 9.81, step = 1e-3;
  EXPECT_EQ(run.channel("height")[0], 0);
  for (size_t n = 1; n < run.result.times.size(); ++n) {
    const double k = static_cast<double>(n), t = k * step;  // implicit Euler of a falling mass
    EXPECT_NEAR(run.channel("height")[n], 0.2 * t - 0.5 * g * step * step * k * (k + 1), 1e-9);
    EXPECT_NEAR(run.channel("way")[n], 0.1 * t, 1e-9);
  }
  // A slender cantilever under its weight in plane strain: rho g h L^4 / (8 E' I).
  const double stiffness = 1e6 / (1 - 0.09) * std::pow(4e-3, 3) / 12, load = 1000 * g * 4e-3;
  const double sag = load * std::pow(60e-3, 4) / (8 * stiffness);
  EXPECT_NEAR(run.channel("tip")[0], sag, 0.05 * sag);
  for (const double tip : run.channel("tip")) EXPECT_NEAR(tip, run.channel("tip")[0], 1e-6 * sag) << "at rest";
  // What hangs by cables is held: half of its weight over the cosine of the cables' slope.
  const double weight = 1000 * 20e-3 * 8e-3 * 10e-3 * g, cosine = 34 / std::hypot(34.0, 4.0);
  for (const double tension : run.channel("tension")) EXPECT_NEAR(tension, 0.5 * weight / cosine, 0.01 * weight);
}

// A plastic rod on a pin, let go where it is horizontal, and a soft pad far away, which makes it rigid.
const std::string rod_and_pad = R"(title = "Rod"
[simulation]
model = "rigid_segments"
integrator = "bdf2"
duration = "160 ms"
step = "0.5 ms"
thickness = "10 mm"
gravity = "9.81 m/s2"
direction = [0, -1]
[materials.plastic]
law = "neo_hookean"
E = "2.3 GPa"
nu = 0.35
density = "1050 kg/m3"
[materials.foam]
law = "neo_hookean"
E = "60 kPa"
nu = 0.2
density = "30 kg/m3"
[[body]]
name = "rod"
geometry = { kind = "rectangle", size = ["100 mm", "4 mm"], origin = ["0 mm", "-2 mm"], region = "plastic" }
mesh = { cells = [20, 1], element = "linear" }
[[body]]
name = "pad"
geometry = { kind = "rectangle", size = ["10 mm", "10 mm"], region = "foam" }
mesh = { cells = [2, 2], element = "linear" }
at = ["300 mm", "0 mm"]
clamped = ["ymin"]
[[joint]]
id = "pin"
between = ["world", "rod"]
at = ["0 mm", "0 mm"]
radius = "2 mm"
[[channel]]
id = "turn"
kind = "rotation"
of = "rod.xmax"
)";

TEST(RigidSegments, ARodOnAPinFallsAsAPhysicalPendulumDoes) {
  const Scenario rod(rod_and_pad);
  ASSERT_EQ(rod.result.failure, "");
  // From 90 degrees to the vertical it takes a quarter of the period, 4 sqrt(I/(m g L/2)) K(sin 45 deg).
  const double L = 0.1, w = 0.004, g = 9.81;
  const double quarter = std::sqrt((L * L / 3 + w * w / 12) / (g * 0.5 * L)) * std::comp_ellint_1(std::sqrt(0.5));
  const std::vector<double>& turn = rod.channel("turn");
  const auto passed = std::ranges::find_if(turn, [](double angle) { return angle < -0.5 * std::numbers::pi; });
  ASSERT_NE(passed, turn.end());
  const auto k = static_cast<size_t>(passed - turn.begin());
  const double part = (turn[k - 1] + 0.5 * std::numbers::pi) / (turn[k - 1] - turn[k]);
  EXPECT_NEAR(std::lerp(rod.result.times[k - 1], rod.result.times[k], part), quarter, 1e-3 * quarter);
}

TEST(RigidSegments, AFingerBendsAsWithPlasticAThousandTimesAsStiffAsItsFoam) {
  const auto finger = [](const char* model) {
    return Scenario(fmt::format(R"(title = "Finger"
[simulation]
model = "{}"
integrator = "static"
duration = "1 s"
step = "250 ms"
thickness = "20 mm"
[materials.foam]
law = "neo_hookean"
E = "60 kPa"
nu = 0.2
[materials.plastic]
law = "neo_hookean"
E = "2.3 GPa"
nu = 0.35
[[body]]
name = "finger"
geometry = {{ kind = "finger", segments = 3 }}
mesh = {{ size = "3 mm", element = "linear" }}
clamped = ["base"]
[[control]]
id = "pull"
start = "0 mm"
[[control.piece]]
until = "1 s"
to = "3 mm"
[[cable]]
id = "tendon"
body = "finger"
path = "cable"
anchored = true
k = "17 N/mm"
retraction = "pull"
[[channel]]
id = "turn"
kind = "rotation"
of = "finger.tip"
)",
                                model));
  };
  const Scenario full = finger("full"), rigid = finger("rigid_segments");
  ASSERT_EQ(rigid.result.failure, "");
  ASSERT_GT(std::abs(full.channel("turn").back()), 0.2) << "it bends";
  EXPECT_NEAR(rigid.channel("turn").back() / full.channel("turn").back(), 1, 2e-3);
  EXPECT_NE(rigid.channel("turn").back(), full.channel("turn").back());
}

TEST(RigidSegments, WhatTheyCannotServeIsRefused) {
  const auto refused = [](const std::string& toml, const std::string& why) {
    expect_input_error([&] { Scenario scenario(toml); }, {why});
  };
  refused(replaced(rod_and_pad, "\"bdf2\"", "\"cvode\""), "SUNDIALS' integrators know no rigid segments");
  refused(replaced(rod_and_pad, "2.3 GPa", "1 MPa"), "no region is more than 100 times as stiff");
  refused(replaced(rod_and_pad, "\"rigid_segments\"", "\"rigid\""), "rigid_segments");
}

}  // namespace
}  // namespace taut

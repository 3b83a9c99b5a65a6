#include "sim/contact/contact_friction.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "sim/files/simulation.hpp"
#include "sim/mesh/structured.hpp"
#include "sim/robots/simulate.hpp"
#include "sim/scene/scene.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"

// Coulomb friction with true stick against closed forms: Johnson, Contact Mechanics (1985), for the stick zone.
namespace taut {
namespace {

using namespace test;

constexpr double g = 9.81;

struct Slid {
  Simulation simulation;
  Robot robot;
  SimulationResult result;

  explicit Slid(const std::string& toml, const SimulationSensitivities& wanted = {}) {
    const TemporaryFolder folder;
    simulation = read_simulation(folder.write("experiment.toml", toml));
    robot = make_robot(simulation);
    SimulateOptions options;
    options.sensitivities = wanted;
    result = simulate(simulation, robot, options);
  }
  const std::vector<double>& channel(const std::string& id) const {
    return result.readings[static_cast<size_t>(&robot.reading(id) - robot.readings.data())];
  }
  /// By the last three steps of implicit Euler, exact under a constant force.
  double acceleration(const std::string& id) const {
    const std::vector<double>& x = channel(id);
    const size_t n = x.size();
    return (x[n - 1] - 2 * x[n - 2] + x[n - 3]) / std::pow(simulation.step, 2);
  }
};

/// What a block lies on, by the lines of its file.
const std::string ground_2d = "[[contact.ground]]\npoint = [\"0 mm\", \"0 mm\"]\nnormal = [0, 1]\n";
const std::string slab_2d =
    "[[body]]\nname = \"slab\"\ngeometry = { kind = \"rectangle\", size = [\"80 mm\", \"10 mm\"], region = \"rubber\" "
    "}\n"
    "mesh = { cells = [37, 2], element = \"linear\" }\nat = [\"-10 mm\", \"-10 mm\"]\nclamped = [\"ymin\"]\n";
const std::string obstacle_2d =
    "[[contact.obstacle]]\nx = [\"70 mm\", \"45 mm\", \"20 mm\", \"5 mm\", \"-10 mm\"]\n"
    "y = [\"0 mm\", \"0 mm\", \"0 mm\", \"0 mm\", \"0 mm\"]\n";

/// A rubber block on something flat, in gravity that is tilted by an angle about it.
std::string incline(double degrees, const std::string& on, double time, double step = 2e-3) {
  const double angle = degrees * std::numbers::pi / 180;
  return fmt::format(R"(title = "Incline"
[simulation]
duration = "{} s"
step = "{} s"
thickness = "10 mm"
gravity = "9.81 m/s2"
direction = [{:.15g}, {:.15g}]
[materials.rubber]
law = "neo_hookean"
E = "1 MPa"
nu = 0.3
density = "1000 kg/m3"
[damping.rubber]
stiffness = "1 ms"
[[body]]
name = "block"
geometry = {{ kind = "rectangle", size = ["20 mm", "10 mm"], region = "rubber" }}
mesh = {{ cells = [8, 4], element = "linear" }}
at = ["0 mm", "0.101 mm"]
{}[contact]
gap = "0.1 mm"
friction = 0.5
{}[[channel]]
id = "way"
kind = "displacement"
of = "block"
direction = [1, 0]
)",
                     time, step, std::sin(angle), -std::cos(angle), on == slab_2d ? on : "", on == slab_2d ? "" : on);
}

TEST(ContactFriction, ABlockSticksBelowTheAngleOfFrictionForGoodAndSlidesAboveAsCoulombSays) {
  // atan(0.5) = 26.6 degrees.
  for (const std::string& on : {ground_2d, slab_2d, obstacle_2d}) {
    const Slid sticks(incline(25, on, 1.2));
    ASSERT_EQ(sticks.result.failure, "");
    const std::vector<double>& way = sticks.channel("way");
    ASSERT_EQ(way.size(), 601u);
    for (size_t k = 100; k < way.size(); ++k) EXPECT_NEAR(way[k], way[100], 1e-12) << k;
    EXPECT_LT(way.back(), 0.5e-3) << "it was put there without friction yet";

    const Slid slides(incline(35, on, 0.1));
    ASSERT_EQ(slides.result.failure, "");
    const double angle = 35 * std::numbers::pi / 180, expected = g * (std::sin(angle) - 0.5 * std::cos(angle));
    // On the slab nodes pass over edges, and press a little more or less as they do.
    EXPECT_NEAR(slides.acceleration("way"), expected, (on == ground_2d ? 1e-3 : 0.1) * expected);
    const std::vector<double>& path = slides.channel("way");
    const double h = 2e-3, n = 20;  // of a constant acceleration over the last steps
    const double mean =
        2 * (path.back() - 2 * path[path.size() - 11] + path[path.size() - 21]) / (2 * std::pow(n / 2 * h, 2));
    EXPECT_NEAR(mean, expected, 0.02 * expected);
  }
}

TEST(ContactFriction, InSpaceABlockSlidesDownTheSteepestWay) {
  const double angle = 35 * std::numbers::pi / 180, turn = 0.6;
  const auto scene = [&](double degrees, double time) {
    const double tilt = degrees * std::numbers::pi / 180;
    return fmt::format(R"(title = "Incline"
[simulation]
dimension = 3
duration = "{} s"
step = "2 ms"
gravity = "9.81 m/s2"
direction = [{:.15g}, {:.15g}, {:.15g}]
[materials.rubber]
law = "neo_hookean"
E = "1 MPa"
nu = 0.3
density = "1000 kg/m3"
[damping.rubber]
stiffness = "1 ms"
[[body]]
name = "block"
geometry = {{ kind = "box", size = ["20 mm", "20 mm", "10 mm"], region = "rubber" }}
mesh = {{ cells = [3, 3, 2], element = "linear" }}
at = ["0 mm", "0 mm", "0.101 mm"]
[contact]
gap = "0.1 mm"
friction = 0.5
[[contact.ground]]
point = ["0 mm", "0 mm", "0 mm"]
normal = [0, 0, 1]
[[channel]]
id = "x"
kind = "displacement"
of = "block"
direction = [1, 0, 0]
[[channel]]
id = "y"
kind = "displacement"
of = "block"
direction = [0, 1, 0]
)",
                       time, std::sin(tilt) * std::cos(turn), std::sin(tilt) * std::sin(turn), -std::cos(tilt));
  };
  const Slid slides(scene(35, 0.08));
  ASSERT_EQ(slides.result.failure, "");
  const double expected = g * (std::sin(angle) - 0.5 * std::cos(angle));
  EXPECT_NEAR(slides.acceleration("x"), expected * std::cos(turn), 2e-3 * expected);
  EXPECT_NEAR(slides.acceleration("y"), expected * std::sin(turn), 2e-3 * expected);
  const Slid sticks(scene(25, 0.4));
  const std::vector<double>&x = sticks.channel("x"), &y = sticks.channel("y");
  for (size_t k = 120; k < x.size(); ++k) {
    EXPECT_NEAR(x[k], x[120], 1e-12);
    EXPECT_NEAR(y[k], y[120], 1e-12);
  }
}

TEST(ContactFriction, ADraggedBlockHoldsUpToMuNAndNoMore) {
  // Two blocks, the upper one pressed by 0.4 N and slowly dragged over the lower one by a cable.
  const std::string toml = R"(title = "Dragged"
[simulation]
duration = "1 s"
step = "10 ms"
thickness = "10 mm"
[materials.rubber]
law = "neo_hookean"
E = "1 MPa"
nu = 0.3
density = "1000 kg/m3"
[damping.rubber]
stiffness = "1 ms"
[[body]]
name = "lower"
geometry = { kind = "rectangle", size = ["60 mm", "10 mm"], region = "rubber" }
mesh = { cells = [25, 3], element = "linear" }
at = ["-20 mm", "-10 mm"]
clamped = ["ymin"]
[[body]]
name = "upper"
geometry = { kind = "rectangle", size = ["20 mm", "10 mm"], region = "rubber" }
mesh = { cells = [8, 4], element = "linear" }
at = ["0 mm", "0.101 mm"]
[[control]]
id = "press"
start = "0 N"
[[control.piece]]
until = "0.2 s"
kind = "linear"
to = "0.4 N"
[[control]]
id = "drag"
start = "0 mm"
[[control.piece]]
until = "0.2 s"
kind = "hold"
[[control.piece]]
until = "1 s"
kind = "linear"
to = "4 mm"
[[load]]
id = "pressing"
on = "upper.ymax"
direction = [0, -1]
control = "press"
[[cable]]
id = "puller"
body = "upper"
x = ["60 mm", "10 mm"]
y = ["0.5 mm", "0.5 mm"]
fixed = "start"
k = "0.1 N/mm"
retraction = "drag"
[contact]
gap = "0.1 mm"
friction = 0.3
[[channel]]
id = "tension"
kind = "tension"
of = "puller"
[[channel]]
id = "way"
kind = "displacement"
of = "upper"
direction = [1, 0]
)";
  const Slid dragged(toml);
  ASSERT_EQ(dragged.result.failure, "");
  const std::vector<double>&tension = dragged.channel("tension"), &way = dragged.channel("way");
  const double limit = 0.3 * 0.4;
  EXPECT_NEAR(*std::ranges::max_element(tension), limit, 0.02 * limit);
  EXPECT_NEAR(tension.back(), limit, 0.02 * limit);
  // Before that, what the cable is drawn in is its stretch: 0.1 N/mm.
  const size_t early = 40;  // 1 mm
  EXPECT_NEAR(tension[early], 0.1e3 * 1e-3, 0.05 * limit);
  EXPECT_LT(way[early], 0.05e-3);
  EXPECT_NEAR(way.back(), 4e-3 - limit / 0.1e3, 0.1e-3);
}

/// A body with a round underside of radius R that is pressed onto a ground and then dragged along it.
struct RoundPunch {
  static constexpr double radius = 40e-3, height = 8e-3, half = 12e-3;
  Scene scene;
  std::vector<int> top;
  int press = -1, drag = -1, first_memory = 0;

  RoundPunch(int across, double mu) {
    std::vector<double> x;
    for (int i = 0; i <= across; ++i) {  // closer towards the middle
      const double t = 2.0 * i / across - 1;
      x.push_back(half * (0.15 * t + 0.85 * t * t * t));
    }
    Mesh mesh = rectangle(x, graded(height, 12, 40), 2, "rubber");
    for (int i = 0; i < mesh.node_count(); ++i) {
      const double bottom = radius - std::sqrt(radius * radius - std::pow(mesh.X[2 * i], 2));
      mesh.X[2 * i + 1] = bottom + (height - bottom) * mesh.X[2 * i + 1] / height;
    }
    SceneBuilder builder(std::move(mesh), Plane::strain, 1);
    builder.add_solid("rubber", "neo_hookean", {{"E", 1e6}, {"nu", 0.48}});
    press = builder.declare({"press", "u", "m", -1, 1, "way down"}, 0);
    drag = builder.declare({"drag", "u", "m", -1, 1, "way along"}, 0);
    builder.prescribe("ymax", 1, press);
    builder.prescribe("ymax", 0, drag);
    const double gap = 2e-6;
    const Contact& contact = builder.add_contact(gap, {{"rubber", 1e6}}, {}, {{{0, -1.01 * gap}, {0, 1}}});
    builder.add_contact_friction(contact, mu);
    scene = builder.build();
    top = scene.model->mesh().select("ymax").nodes();
  }
};

TEST(ContactFriction, TheStickZoneOfARoundPunchIsThatOfCattaneoAndMindlin) {
  const double mu = 0.05;  // so small that the drag hardly tilts it
  const RoundPunch punch(80, mu);
  const Model& model = *punch.scene.model;
  Equilibrium equilibrium(model);
  equilibrium.start_at_rest(punch.scene.values);
  Params p = punch.scene.values;
  TimeStep step;
  step.memory = Eigen::VectorXd::Zero(model.memory_size());
  step.length = 1;
  const auto go_on = [&] {
    ASSERT_EQ(equilibrium.solve(p, Polish::full, &step).status, SolveStatus::converged)
        << equilibrium.report().message();
    step.memory = model.remember({equilibrium.u(), p, &step});
  };
  // Per vertex: feature + 1, caught place (x, y), force; then the same of a second side.
  const auto pressed = [&] {
    double sum = 0;
    for (Eigen::Index i = 0; i < step.memory.size(); i += 8) sum += step.memory[i + 3];
    return sum;
  };
  // Without friction at first: on a rigid ground a body that spreads as it is pressed would be caught spreading.
  const int friction = model.parameters().index("contact_friction");
  p[friction] = 0;
  for (int k = 1; k <= 5; ++k) {
    p[punch.press] = -k * 16e-6;
    go_on();
  }
  p[friction] = mu;
  const Eigen::VectorXd caught = step.memory;
  for (int k = 1; k <= 8; ++k) {
    p[punch.drag] = k * 5e-7;
    go_on();
  }
  Assembly all;
  Eigen::VectorXd force;
  all.gradient = &force;
  force = Eigen::VectorXd::Zero(model.unknowns());
  model.evaluate({equilibrium.u(), p, &step}, all);
  double Q = 0;
  for (int node : punch.top) Q += force[2 * node];
  const double P = pressed();
  ASSERT_GT(Q / (mu * P), 0.2);
  ASSERT_LT(Q / (mu * P), 0.95);
  // The outermost node of those that are caught where they were before it was dragged.
  double stick = 0;
  for (Eigen::Index i = 0; i < step.memory.size(); i += 8) {
    const bool is_caught = step.memory[i] != 0 && std::abs(step.memory[i + 1] - caught[i + 1]) < 1e-9;
    if (is_caught) stick = std::max(stick, std::abs(step.memory[i + 1]));
  }
  // Hertz: a^2 = 4 P R / (pi E'), and of that c^2 / a^2 = 1 - Q / (mu P).
  const double a = std::sqrt(4 * P * RoundPunch::radius / (std::numbers::pi * 1e6 / (1 - 0.48 * 0.48)));
  const double spacing = 0.09e-3;  // of nodes there
  EXPECT_NEAR(stick, a * std::sqrt(1 - Q / (mu * P)), 1.5 * spacing) << a << " " << Q / (mu * P);
}

TEST(ContactFriction, ADiscBetweenTwoFingersIsHeldForTenSecondsWithoutCreeping) {
  const std::string toml = R"(title = "Held"
[simulation]
duration = "10 s"
step = "20 ms"
thickness = "10 mm"
gravity = "9.81 m/s2"
direction = [0, -1]
[materials.rubber]
law = "neo_hookean"
E = "1 MPa"
nu = 0.3
density = "1000 kg/m3"
[materials.plastic]
law = "neo_hookean"
E = "1 GPa"
nu = 0.3
density = "1000 kg/m3"
[damping.rubber]
stiffness = "2 ms"
[[body]]
name = "left"
geometry = { kind = "rectangle", size = ["6 mm", "60 mm"], region = "plastic" }
mesh = { cells = [2, 20], element = "linear" }
at = ["-16.2 mm", "-50 mm"]
[[body]]
name = "right"
geometry = { kind = "rectangle", size = ["6 mm", "60 mm"], region = "plastic" }
mesh = { cells = [2, 20], element = "linear" }
at = ["10.2 mm", "-50 mm"]
clamped = ["xmax"]
[[body]]
name = "disc"
geometry = { kind = "disc", radius = "10 mm", region = "rubber" }
mesh = { size = "3 mm", element = "linear" }
[[control]]
id = "grasp"
start = "0 mm"
[[control.piece]]
until = "20 ms"
to = "1.4 mm"
[[support]]
on = "left.xmin"
fix = ["y"]
move = "x"
control = "grasp"
[contact]
gap = "0.1 mm"
friction = 0.4
[[channel]]
id = "height"
kind = "displacement"
of = "disc"
direction = [0, 1]
)";
  const Slid held(toml);
  ASSERT_EQ(held.result.failure, "");
  const std::vector<double>& height = held.channel("height");
  EXPECT_GT(height.back(), -25e-3) << "it falls while it is not held yet";
  for (size_t k = 100; k < height.size(); ++k) ASSERT_NEAR(height[k], height[100], 1e-9) << k;
  EXPECT_EQ(held.result.intersecting, 0);
  // Without friction it falls through.
  const Slid falls(replaced(replaced(toml, "friction = 0.4", "friction = 0"), "10 s", "0.6 s"));
  EXPECT_LT(falls.channel("height").back(), -0.1);
}

TEST(ContactFriction, DerivativesAreThoseOfWhatWasComputed) {
  const std::string toml = incline(35, slab_2d, 0.03);
  const TemporaryFolder folder;
  const Simulation simulation = read_simulation(folder.write("experiment.toml", toml));
  const Robot robot = make_robot(simulation);
  const ParameterTable& table = robot.scene.model->parameters();
  SimulationSensitivities wanted;
  wanted.all_readings = true;
  wanted.parameters = {table.index("contact_friction"), table.index("E_rubber"), table.index("density_rubber"),
                       table.index("thickness")};
  SimulateOptions options;
  options.sensitivities = wanted;
  const SimulationResult result = simulate(simulation, robot, options);
  ASSERT_EQ(result.failure, "");
  const Eigen::MatrixXd& slopes = result.derivatives.back();
  for (size_t j = 0; j < wanted.parameters.size(); ++j) {
    const auto way = [&](double change) {
      Robot other = make_robot(simulation);
      other.scene.values[wanted.parameters[j]] *= 1 + change;
      return simulate(simulation, other).readings[0].back();
    };
    const double value = robot.scene.values[wanted.parameters[j]], step = 1e-6;
    const double difference = (way(step) - way(-step)) / (2 * step * value);
    EXPECT_NEAR(slopes(0, static_cast<Eigen::Index>(j)), difference, 1e-4 * std::abs(difference) + 1e-8 / value)
        << table[wanted.parameters[j]].id;
  }
  // Of a block that slides all the time: a falls by g cos per unit of mu.
  const double angle = 35 * std::numbers::pi / 180, t = 0.03;
  EXPECT_NEAR(slopes(0, 0), -0.5 * g * std::cos(angle) * t * t, 0.25 * 0.5 * g * t * t);
}

TEST(ContactFriction, WrongInputGetsASentence) {
  const TemporaryFolder folder;
  const auto refused = [&](const std::string& toml, const std::vector<std::string>& words) {
    const std::string path = folder.write("experiment.toml", toml);
    expect_input_error(
        [&] {
          const Simulation simulation = read_simulation(path);
          simulate(simulation, make_robot(simulation));
        },
        words);
  };
  const std::string good = incline(25, ground_2d, 0.01);
  refused(replaced(good, "friction = 0.5", "friction = -0.1"), {"[contact]", "friction", "0", "10"});
  refused(replaced(good, "[simulation]\n", "[simulation]\nintegrator = \"cvode\"\n"), {"friction", "implicit_euler"});
  refused(good + "[[support]]\non = \"block.ymin\"\n", {"[support]", "fix", "move"});
  refused(good + "[[support]]\non = \"block.ymin\"\nmove = \"x\"\ncontrol = \"none\"\n", {"none"});
}

}  // namespace
}  // namespace taut

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "sim/contact/contact_friction.hpp"
#include "sim/files/simulation.hpp"
#include "sim/mesh/structured.hpp"
#include "sim/robots/simulate.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"
#include "tests/support/term_battery.hpp"

// Grounds that are round, that move, and what they press with.
namespace taut {
namespace {

using namespace test;

constexpr int kappa_of = 0, gap_of = 1, mu_of = 2;

ParameterTable ground_table() {
  ParameterTable table;
  table.declare({"kappa", "kappa", "Pa", 0, 1e9, "pressure"});
  table.declare({"dhat", "dhat", "m", 0, 1e9, "gap"});
  table.declare({"mu", "mu", "1", 0, 10, "friction"});
  return table;
}

/// A block over a ground that a node of its own carries.
template <int D>
struct OverGround {
  Mesh mesh;
  std::conditional_t<D == 2, ContactSettings, Contact3dSettings> settings;
  Eigen::VectorXd u;

  OverGround(GroundKind kind, unsigned seed) {
    if constexpr (D == 2) {
      mesh = rectangle(graded(1, 3), graded(1, 2), 1, "b");
      settings.edges = contact_edges(mesh);
      settings.stiffness.assign(settings.edges.size(), kappa_of);
    } else {
      mesh = box(graded(1, 2), graded(1, 3), graded(1, 2), 1, "b");
      settings.triangles = contact_triangles(mesh);
      settings.stiffness.assign(settings.triangles.size(), kappa_of);
    }
    settings.gap = gap_of;
    mesh.X.conservativeResize(mesh.X.size() + D);
    mesh.X.tail(D) = mesh.node(0);
    Ground<D> ground;
    ground.kind = kind;
    ground.node = mesh.node_count() - 1;
    ground.normal = Eigen::Matrix<double, D, 1>::Constant(0.05);
    ground.normal[kind == GroundKind::cylinder ? 0 : D - 1] = 1;
    ground.radius = kind == GroundKind::plane ? 0 : 2;
    ground.point = Eigen::Matrix<double, D, 1>::Constant(0.4);
    ground.point[D - 1] = kind == GroundKind::plane ? -0.12 : -2.12;
    settings.grounds = {ground};
    std::mt19937 random(seed);
    u = 0.03 * random_vector(mesh.X.size(), random);
  }
  auto contact() const {
    if constexpr (D == 2)
      return std::make_unique<Contact>(mesh, settings);
    else
      return std::make_unique<Contact3d>(mesh, settings);
  }
};

const Params ground_values = Eigen::Vector3d(3.0, 0.25, 0.3);

template <class Action>
void each_ground(Action&& action) {
  for (GroundKind kind : {GroundKind::plane, GroundKind::sphere}) action(OverGround<2>(kind, 5), 2);
  for (GroundKind kind : {GroundKind::plane, GroundKind::sphere, GroundKind::cylinder})
    action(OverGround<3>(kind, 6), 3);
}

TEST(Ground, EnergyOfRoundOnesThatMoveHasItsDerivativesAndExertsNoNetForce) {
  each_ground([](const auto& over, int d) {
    const TermUnderTest t =
        term_under_test(over.mesh, ground_table(), over.contact(), ground_values, over.u,
                        fmt::format("{}D, kind {}", d, static_cast<int>(over.settings.grounds[0].kind)));
    expect_derivatives(t, 2e-4);
    expect_parameter_derivatives(t, 1e-3);
    expect_symmetric_hessian(t);
    expect_projection_is_semidefinite(t);
    const Eigen::VectorXd f = gradient_of(t.model, t.u, t.p);
    const Eigen::VectorXd sum = f.reshaped(d, f.size() / d).rowwise().sum();
    EXPECT_GT(f.tail(d).norm(), 1e-3);
    EXPECT_LT(sum.norm(), 1e-13 * f.norm()) << "what presses on the bodies presses on the ground";
  });
}

TEST(Ground, FrictionOnRoundOnesThatMoveHasItsDerivatives) {
  each_ground([](const auto& over, int d) {
    const auto contact = over.contact();
    TermUnderTest t = term_under_test(over.mesh, ground_table(), make_contact_friction(*contact, mu_of, ground_values),
                                      ground_values, over.u, fmt::format("{}D", d));
    t.step = std::make_shared<TimeStep>();
    t.step->memory = Eigen::VectorXd::Zero(t.model.memory_size());
    t.step->memory = t.model.remember(t.at());
    ASSERT_GT(t.step->memory.norm(), 0);
    std::mt19937 random(9);
    const Eigen::VectorXd caught_at = t.u, way = random_vector(t.u.size(), random);
    for (double far : {1e-3, 0.05}) {  // sticking, sliding
      t.u = caught_at + far * way;
      ASSERT_GT(energy_of(t.model, t.u, t.p, t.step.get()), 0);
      expect_derivatives(t, far == 1e-3 ? 2e-5 : 2e-4);
      // By the memory, and of what is remembered next, against differences.
      const Eigen::VectorXd du = random_vector(t.u.size(), random);
      Eigen::VectorXd dmemory = random_vector(t.step->memory.size(), random);
      for (Eigen::Index i = 0; i < dmemory.size(); i += d + 2) dmemory[i] = 0;  // which feature it is
      const double h = 1e-6;
      const auto at = [&](double s) {
        TermUnderTest other = term_under_test(
            over.mesh, ground_table(), make_contact_friction(*contact, mu_of, ground_values), t.p, t.u + s * du, "");
        TimeStep step = *t.step;
        step.memory += s * dmemory;
        const Point point{other.u, other.p, &step};
        Eigen::VectorXd gradient;
        Assembly out;
        out.gradient = &gradient;
        other.model.evaluate(point, out);
        return std::pair(gradient, other.model.remember(point));
      };
      const auto [ahead, next_ahead] = at(h);
      const auto [behind, next_behind] = at(-h);
      const Eigen::VectorXd slope = t.model.hessian_times(t.at(), du) + t.model.memory_product(t.at(), dmemory);
      EXPECT_LT((slope - (ahead - behind) / (2 * h)).norm(), 1e-6 * slope.norm()) << t.name << " " << far;
      const Eigen::MatrixXd next = t.model.remember_change(t.at(), du, Params::Zero(3), dmemory);
      EXPECT_LT((next.col(0) - (next_ahead - next_behind) / (2 * h)).norm(), 1e-6 * next.norm())
          << t.name << " " << far;
    }
  });
}

TEST(Ground, NothingPassesThroughOneThatIsRoundOrMovesWithinTheStepLimit) {
  each_ground([](const auto& over, int d) {
    const auto contact = over.contact();
    const double before = contact->smallest_distance(over.u, 10);
    ASSERT_GT(before, 0);
    Eigen::VectorXd step = Eigen::VectorXd::Zero(over.u.size());
    step[step.size() - 1] = 1.1;  // the ground comes up through the block
    const double limit = contact->step_limit({over.u, ground_values}, step);
    EXPECT_LT(limit, 1);
    EXPECT_FALSE(contact->intersects(over.u + limit * step));
    EXPECT_TRUE(contact->intersects(over.u + 1.2 * limit * step)) << "and the limit is not far too small";
    const double left = contact->smallest_distance(over.u + limit * step, 10);
    EXPECT_GE(left, 0.1 * before * (1 - 1e-9)) << d;
    step[step.size() - 1] = -1.1;
    EXPECT_EQ(contact->step_limit({over.u, ground_values}, step), 1);
  });
}

struct Ran {
  Simulation simulation;
  Robot robot;
  SimulationResult result;

  explicit Ran(const std::string& toml, const SimulationSensitivities& wanted = {}) {
    const TemporaryFolder folder;
    simulation = read_simulation(folder.write("experiment.toml", toml));
    robot = make_robot(simulation);
    SimulateOptions options;
    options.sensitivities = wanted;
    result = simulate(simulation, robot, options);
    EXPECT_EQ(result.failure, "");
    EXPECT_EQ(result.intersecting, 0);
  }
  const std::vector<double>& channel(const std::string& id) const {
    return result.readings[static_cast<size_t>(&robot.reading(id) - robot.readings.data())];
  }
};

const std::string rubber = R"([materials.rubber]
law = "neo_hookean"
E = "1 MPa"
nu = 0.3
density = "1000 kg/m3"
)";
const std::string block_3d = R"([[body]]
name = "block"
geometry = { kind = "box", size = ["20 mm", "20 mm", "10 mm"], region = "rubber" }
mesh = { cells = [2, 2, 2], element = "linear" }
at = ["0 mm", "0 mm", "0.101 mm"]
)";

/// A block between a floor and a press that comes down on it, without friction.
std::string pressed(const std::string& way) {
  return R"(title = "Press"
[simulation]
integrator = "static"
dimension = 3
duration = "1 s"
step = "0.25 s"
)" + rubber +
         block_3d + R"([[support]]
on = "block.xmin"
fix = ["x"]
[[support]]
on = "block.ymin"
fix = ["y"]
[[support]]
on = "block.zmin"
fix = ["z"]
[[control]]
id = "down"
start = "0 mm"
[[control.piece]]
until = "1 s"
kind = "linear"
to = ")" +
         (way == "z" ? "-" : "") + R"(1.102 mm"
[contact]
gap = "0.1 mm"
[[contact.ground]]
name = "press"
point = ["0 mm", "0 mm", "10.204 mm"]
normal = [0, 0, -1]
control = "down"
move = ")" +
         way + R"("
[[channel]]
id = "force"
kind = "contact_force"
of = "block"
by = "press"
direction = [0, 0, -1]
[[channel]]
id = "floor"
kind = "reaction"
of = "block.zmin"
direction = [0, 0, 1]
[[channel]]
id = "top"
kind = "displacement"
of = "block.zmax"
direction = [0, 0, 1]
)";
}

TEST(Ground, APressThatComesDownPressesWithTheStressOfTheStrain) {
  const Ran run(pressed("normal"));
  const double force = run.channel("force").back();
  EXPECT_NEAR(run.channel("floor").back(), force, 1e-9);
  // Uniaxial stress of the neo-Hookean law: mu (b^2 - 1) + lambda ln(a b^2) = 0 across, P along, stretches a and b.
  const double mu = 1e6 / 2.6, lambda = 1e6 * 0.3 / (1.3 * 0.4), a = 1 + run.channel("top").back() / 10e-3;
  ASSERT_LT(a, 0.91);
  double low = 1, high = 1.1;
  for (int k = 0; k < 60; ++k) {
    const double b = (low + high) / 2;
    (mu * (b * b - 1) + lambda * std::log(a * b * b) < 0 ? low : high) = b;
  }
  const double stress = mu * (a - 1 / a) + lambda * std::log(a * low * low) / a;
  EXPECT_NEAR(force, -stress * 400e-6, 1e-6 * force);
  EXPECT_EQ(run.channel("force").front(), 0);
  const Ran along_axis(pressed("z"));
  EXPECT_NEAR(along_axis.channel("force").back(), force, 1e-9) << "down along its normal is down along z";
}

TEST(Ground, DerivativesByTheControlThatMovesItAreThoseOfWhatWasComputed) {
  const TemporaryFolder folder;
  const Simulation simulation = read_simulation(folder.write("experiment.toml", pressed("normal")));
  const Robot robot = make_robot(simulation);
  SimulateOptions options;
  options.sensitivities.all_readings = true;
  options.sensitivities.parameters = {robot.controls[0], robot.scene.model->parameters().index("E_rubber")};
  const SimulationResult result = simulate(simulation, robot, options);
  ASSERT_EQ(result.failure, "");
  const auto force = [&](double offset, double stiffer) {
    Simulation other = simulation;
    other.schedules[0] = ControlSchedule(0);
    other.schedules[0].add({ControlSchedule::Kind::linear, 1.0, 1.102e-3 + offset});
    Robot changed = make_robot(other);
    changed.scene.values[options.sensitivities.parameters[1]] *= 1 + stiffer;
    return simulate(other, changed).readings[0].back();
  };
  const double by_way = (force(1e-7, 0) - force(-1e-7, 0)) / 2e-7,
               by_modulus = (force(0, 1e-4) - force(0, -1e-4)) / 200;
  EXPECT_NEAR(result.derivatives.back()(0, 0), by_way, 1e-5 * by_way);
  EXPECT_NEAR(result.derivatives.back()(0, 1), by_modulus, 1e-5 * by_modulus);
  EXPECT_GT(by_way, 0.8 * 1e6 * 400e-6 / 10e-3);
}

/// A block in gravity on a belt that runs at 0.2 m/s along x, mu = 0.3.
std::string on_belt(const std::string& dimension, const std::string& ground, const std::string& time,
                    const std::string& step = "1 ms") {
  const bool flat = dimension == "2";
  std::string toml = R"(title = "Belt"
[simulation]
duration = "TIME"
step = "STEP"
dimension = DIM
gravity = "9.81 m/s2"
direction = [0, DOWN]
THICK)" + rubber + R"([damping.rubber]
stiffness = "1 ms"
[[body]]
name = "block"
geometry = { kind = "BOX", size = [SIZE"10 mm"], region = "rubber" }
mesh = { cells = [2, CELLS2], element = "linear" }
at = [ZEROS"0.101 mm"]
[[control]]
id = "run"
start = "0 mm"
[[control.piece]]
until = "1 s"
kind = "linear"
to = "200 mm"
[contact]
gap = "0.1 mm"
friction = 0.3
[[contact.ground]]
name = "belt"
control = "run"
move = "x"
GROUND[[channel]]
id = "way"
kind = "displacement"
of = "block"
direction = [1, SIDE]
[[channel]]
id = "drag"
kind = "contact_force"
of = "block"
by = "belt"
direction = [1, SIDE]
[[channel]]
id = "weight"
kind = "contact_force"
of = "block"
by = "belt"
direction = [0, UPWARDS]
)";
  const std::vector<std::pair<std::string, std::string>> words{
      {"TIME", time},
      {"STEP", step},
      {"DIM", dimension},
      {"THICK", flat ? "thickness = \"20 mm\"\n" : ""},
      {"BOX", flat ? "rectangle" : "box"},
      {"SIZE", flat ? "\"20 mm\", " : "\"20 mm\", \"20 mm\", "},
      {"CELLS", flat ? "" : "2, "},
      {"ZEROS", flat ? "\"0 mm\", " : "\"0 mm\", \"0 mm\", "},
      {"DOWN", flat ? "-1" : "0, -1"},
      {"UPWARDS", flat ? "1" : "0, 1"},
      {"SIDE", flat ? "0" : "0, 0"},
      {"GROUND", ground}};
  for (const auto& [word, by] : words) {
    for (size_t at = toml.find(word); at != std::string::npos; at = toml.find(word)) toml.replace(at, word.size(), by);
  }
  return toml;
}

TEST(Ground, ABlockOnABeltIsDraggedByMuNUntilItGoesWithIt) {
  const double g = 9.81, mu = 0.3, weight = 1000 * g * 20e-3 * 20e-3 * 10e-3;
  const std::vector<std::pair<std::string, std::string>> grounds{
      {"2", "point = [\"0 mm\", \"0 mm\"]\nnormal = [0, 1]\n"},
      {"2", "kind = \"disc\"\nradius = \"1000 m\"\npoint = [\"10 mm\", \"-1000 m\"]\n"},
      {"3", "point = [\"0 mm\", \"0 mm\", \"0 mm\"]\nnormal = [0, 0, 1]\n"},
      {"3", "kind = \"sphere\"\nradius = \"1000 m\"\npoint = [\"10 mm\", \"10 mm\", \"-1000 m\"]\n"},
      {"3",
       "kind = \"cylinder\"\naxis = [1, 0, 0]\nradius = \"1000 m\"\npoint = [\"0 mm\", \"10 mm\", \"-1000 m\"]\n"}};
  for (const auto& [dimension, ground] : grounds) {
    SCOPED_TRACE(dimension + ground);
    const Ran run(on_belt(dimension, ground, "200 ms", "2 ms"));
    const std::vector<double>&way = run.channel("way"), &drag = run.channel("drag"), &up = run.channel("weight");
    const size_t slips = 25, n = way.size() - 1;  // at 50 ms it has 0.147 m/s of the belt's 0.2 m/s
    EXPECT_NEAR(drag[slips], mu * up[slips], 0.02 * mu * weight);
    EXPECT_NEAR((way[slips] - way[slips - 10]) / 20e-3, mu * g * 40e-3, 0.05 * 0.2);
    EXPECT_NEAR((way[n] - way[n - 25]) / 50e-3, 0.2, 1e-4) << "it sticks to the belt";
    EXPECT_NEAR(drag[n], 0, 1e-3 * weight);
    EXPECT_NEAR(up[n], weight, 1e-3 * weight);
  }
}

TEST(Ground, DerivativesOfWhatABeltDragsAreThoseOfWhatWasComputed) {
  const std::string round = "kind = \"sphere\"\nradius = \"2 m\"\npoint = [\"10 mm\", \"10 mm\", \"-2000 mm\"]\n";
  const TemporaryFolder folder;
  const Simulation simulation = read_simulation(folder.write("experiment.toml", on_belt("3", round, "6 ms", "2 ms")));
  const Robot robot = make_robot(simulation);
  SimulateOptions options;
  options.sensitivities.all_readings = true;
  options.sensitivities.parameters = {robot.scene.model->parameters().index("contact_friction"), robot.controls[0]};
  const SimulationResult result = simulate(simulation, robot, options);
  ASSERT_EQ(result.failure, "");
  const auto readings = [&](double friction, double offset) {
    Simulation other = simulation;
    other.schedules[0] = ControlSchedule(offset);
    other.schedules[0].add({ControlSchedule::Kind::linear, 1.0, 0.2 + offset});
    Robot changed = make_robot(other);
    changed.scene.values[options.sensitivities.parameters[0]] += friction;
    const SimulationResult run = simulate(other, changed);
    return Eigen::Vector3d(run.readings[0].back(), run.readings[1].back(), run.readings[2].back());
  };
  // Steps so large that what Newton's method leaves of the contact's forces does not count.
  const Eigen::Vector3d by_friction = (readings(1e-4, 0) - readings(-1e-4, 0)) / 2e-4,
                        by_offset = (readings(0, 1e-4) - readings(0, -1e-4)) / 2e-4;
  for (Eigen::Index channel = 0; channel < 3; ++channel) {
    EXPECT_NEAR(result.derivatives.back()(channel, 0), by_friction[channel], 1e-3 * std::abs(by_friction[channel]));
    EXPECT_NEAR(result.derivatives.back()(channel, 1), by_offset[channel], 1e-2 * std::abs(by_offset[channel]));
  }
  EXPECT_NEAR(by_friction[1], 1000 * 9.81 * 4e-6, 0.2 * 1000 * 9.81 * 4e-6) << "mu N by mu";
}

TEST(Ground, ContactForceOfWhatRestsIsItsWeightToElevenDigits) {
  const std::string toml = R"(title = "Rest"
[simulation]
integrator = "static"
dimension = 3
duration = "1 s"
step = "0.5 s"
gravity = "9.81 m/s2"
direction = [0, 0, -1]
)" + rubber + block_3d + R"([[support]]
on = "block.xmin"
fix = ["x"]
[[support]]
on = "block.ymin"
fix = ["y"]
[contact]
gap = "0.1 mm"
[[contact.ground]]
name = "floor"
point = ["0 mm", "0 mm", "0 mm"]
normal = [0, 0, 1]
[[channel]]
id = "up"
kind = "contact_force"
of = "block"
by = "floor"
direction = [0, 0, 2]
)";
  const double weight = 1000 * 9.81 * 4e-6;
  EXPECT_NEAR(Ran(toml).channel("up").back(), weight, 1e-9 * weight);
  // On another body: what the one exerts is what the other feels.
  const Ran on_slab(replaced(
      replaced(toml,
               "[[contact.ground]]\nname = \"floor\"\npoint = [\"0 mm\", \"0 mm\", \"0 mm\"]\nnormal = [0, 0, 1]\n",
               ""),
      "[contact]\n", R"([[body]]
name = "floor"
geometry = { kind = "box", size = ["30 mm", "30 mm", "5 mm"], region = "rubber" }
mesh = { cells = [5, 5, 2], element = "linear" }
at = ["-5 mm", "-5 mm", "-5 mm"]
clamped = ["zmin"]
[[channel]]
id = "down"
kind = "contact_force"
of = "floor"
by = "block"
direction = [0, 0, 1]
[contact]
)"));
  EXPECT_NEAR(on_slab.channel("up").back(), weight, 1e-9 * weight);
  EXPECT_NEAR(on_slab.channel("down").back(), -on_slab.channel("up").back(), 1e-12 * weight);
}

TEST(Ground, WrongOnesGetASentence) {
  const TemporaryFolder folder;
  const auto refused = [&](const std::string& from, const std::string& to, const std::vector<std::string>& words) {
    const std::string path = folder.write("experiment.toml", replaced(pressed("normal"), from, to));
    expect_input_error([&] { make_robot(read_simulation(path)); }, words);
  };
  const std::string plane = "normal = [0, 0, -1]\n";
  refused("move = \"normal\"\n", "", {"[contact.ground]", "'move'", "'control'"});
  refused("move = \"normal\"", "move = \"w\"", {"move", "'w'", "x, y, z"});
  refused("control = \"down\"", "control = \"up\"", {"control", "'up'", "down"});
  refused(plane, "kind = \"disc\"\n", {"kind", "disc", "sphere", "cylinder"});
  refused(plane, "kind = \"sphere\"\n", {"radius"});
  refused(plane, "kind = \"sphere\"\nradius = \"-1 mm\"\n", {"radius", "positive"});
  refused(plane, "kind = \"sphere\"\nradius = \"1 mm\"\n", {"move", "normal", "x, y, z"});
  refused(plane, "kind = \"cylinder\"\nradius = \"1 mm\"\naxis = [0, 0, 0]\n", {"axis", "zeros"});
  refused("by = \"press\"", "by = \"pres\"", {"by", "'pres'", "did you mean 'press'"});
  refused("by = \"press\"", "by = \"block\"", {"by", "itself"});
  refused("name = \"press\"", "name = \"block\"", {"'block'", "name of its own"});
  const std::string inside = "kind = \"sphere\"\nradius = \"1 mm\"\n";
  const std::string path = folder.write(
      "experiment.toml", replaced(replaced(replaced(pressed("z"), plane, inside), "\"10.204 mm\"]", "\"6 mm\"]"),
                                  "point = [\"0 mm\", \"0 mm\"", "point = [\"6 mm\", \"6 mm\""));
  expect_input_error([&] { make_robot(read_simulation(path)); }, {"round ground", "inside", "move one"});
}

}  // namespace
}  // namespace taut

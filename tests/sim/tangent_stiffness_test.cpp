#include "sim/solve/tangent_stiffness.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "sim/files/simulation.hpp"
#include "sim/robots/simulate.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"
#include "tests/support/term_battery.hpp"

// The channel "stiffness", and tractions, in simulations of a cantilever.
namespace taut {
namespace {

using namespace test;

constexpr double beam_length = 0.1, beam_height = 0.005, beam_thickness = 0.01, beam_modulus = 1e6;

/// A slender beam under a force at its end, or other loads.
std::string beam_under(const std::string& load) {
  return R"(title = "Cantilever"
[simulation]
integrator = "static"
duration = "1 s"
step = "0.5 s"
thickness = "10 mm"
plane = "stress"
[materials.rubber]
law = "neo_hookean"
E = "1 MPa"
nu = 0.3
[[body]]
name = "beam"
geometry = { kind = "rectangle", size = ["100 mm", "5 mm"], region = "rubber" }
mesh = { cells = [40, 2], element = "quadratic" }
clamped = ["xmin"]
[[control]]
id = "pull"
start = "0 )" +
         load + R"("
[[control.piece]]
until = "1 s"
kind = "linear"
to = "LARGEST"
[[load]]
id = "end"
on = "beam.xmax"
direction = [0, 1]
control = "pull"
[[channel]]
id = "stiffness"
kind = "stiffness"
of = "beam.xmax"
direction = [0, 3]
[[channel]]
id = "way"
kind = "displacement"
of = "beam.xmax"
direction = [0, 1]
[[channel]]
id = "held"
kind = "reaction"
of = "beam.xmin"
direction = [0, -1]
)";
}

struct Bent {
  Simulation simulation;
  Robot robot;
  SimulationResult result;
  Bent(const std::string& load, const std::string& largest, bool slopes = false, const std::string& on = "beam.xmax") {
    const TemporaryFolder folder;
    simulation =
        read_simulation(folder.write("experiment.toml", replaced(replaced(beam_under(load), "LARGEST", largest),
                                                                 "on = \"beam.xmax\"", "on = \"" + on + "\"")));
    robot = make_robot(simulation);
    SimulateOptions options;
    if (slopes) {
      options.sensitivities.all_readings = true;
      options.sensitivities.parameters = {robot.controls[0], robot.scene.model->parameters().index("E_rubber"),
                                          robot.scene.model->parameters().index("thickness")};
    }
    result = simulate(simulation, robot, options);
    EXPECT_EQ(result.failure, "");
  }
  double end(size_t channel) const { return result.readings[channel].back(); }
};

TEST(TangentStiffness, OfACantileverAtRestIsThatOfItsBeam) {
  const Bent rest("N", "0.001 mN");
  const double area = beam_height * beam_thickness, second = beam_thickness * std::pow(beam_height, 3) / 12;
  // Bending and shear: L^3/(3 E I) + 6/5 L/(G A).
  const double compliance =
      std::pow(beam_length, 3) / (3 * beam_modulus * second) + 1.2 * beam_length / (beam_modulus / 2.6 * area);
  EXPECT_NEAR(rest.end(0), 1 / compliance, 2e-3 / compliance);
  EXPECT_NEAR(rest.end(0), 3 * beam_modulus * second / std::pow(beam_length, 3), 0.01 / compliance);
}

TEST(TangentStiffness, OfABentOneIsTheDifferenceOfForcesOverThatOfWays) {
  const Bent bent("N", "20 mN");
  const double rest = bent.result.readings[0].front();
  ASSERT_GT(bent.end(1), 0.03) << "it bends far";
  ASSERT_GT(std::abs(bent.end(0) / rest - 1), 0.05) << "and its stiffness has changed";
  const Bent more("N", "20.01 mN"), less("N", "19.99 mN");
  const double difference = 2e-5 / (more.end(1) - less.end(1));
  EXPECT_NEAR(bent.end(0), difference, 1e-5 * difference);
}

TEST(TangentStiffness, DerivativesAreThoseOfTheValue) {
  const Bent bent("N", "20 mN", true), more("N", "20.01 mN"), less("N", "19.99 mN");
  const double by_force = (more.end(0) - less.end(0)) / 2e-5;
  EXPECT_NEAR(bent.result.derivatives.back()(0, 0), by_force, 1e-4 * std::abs(by_force));
  for (Eigen::Index j = 1; j < 3; ++j) {
    const auto changed = [&](double change) {
      Robot other = make_robot(bent.simulation);
      const std::vector<std::string> ids{"", "E_rubber", "thickness"};
      const int index = other.scene.model->parameters().index(ids[static_cast<size_t>(j)]);
      const double value = other.scene.values[index];
      other.scene.values[index] *= 1 + change;
      return std::pair(value, simulate(bent.simulation, other).readings[0].back());
    };
    const auto [value, ahead] = changed(1e-4);
    const double difference = (ahead - changed(-1e-4).second) / (2e-4 * value);
    EXPECT_NEAR(bent.result.derivatives.back()(0, j), difference, 1e-4 * std::abs(difference)) << j;
  }
}

TEST(TangentStiffness, IsOfEquilibriaAndOfPlacesThatCanMove) {
  const TemporaryFolder folder;
  const auto refused = [&](const std::string& toml, const std::vector<std::string>& words) {
    const std::string path = folder.write("experiment.toml", toml);
    expect_input_error([&] { make_robot(read_simulation(path)); }, words);
  };
  const std::string good = replaced(beam_under("N"), "LARGEST", "1 mN");
  refused(replaced(good, "kind = \"stiffness\"\nof = \"beam.xmax\"", "kind = \"stiffness\"\nof = \"beam.xmin\""),
          {"stiffness", "held", "name a place"});
  refused(replaced(replaced(good, "integrator = \"static\"\n", ""), "nu = 0.3\n", "nu = 0.3\ndensity = \"1 g/cm3\"\n"),
          {"stiffness", "equilibrium", "static"});
}

TEST(Traction, OnAFaceOfASimulationIsItsPressureTimesTheRestAreaAndDead) {
  // On 5 mm x 10 mm; a dead one keeps its direction and size while the face turns.
  const Bent pressed("Pa", "400 Pa"), forced("N", "20 mN");
  EXPECT_NEAR(pressed.end(2), 400 * beam_height * beam_thickness, 1e-9);
  EXPECT_NEAR(pressed.end(1), forced.end(1), 1e-9);
  const Bent line("N/m", "2 N/m", false, "beam.xmax & beam.ymax");
  EXPECT_NEAR(line.end(2), 2 * beam_thickness, 1e-9) << "in the plane it runs through the thickness";
}

}  // namespace
}  // namespace taut

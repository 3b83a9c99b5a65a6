#include <gtest/gtest.h>

#include <numeric>

#include "sim/files/simulation.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/robots/simulate.hpp"

// The gripper of experiments/gripper_3d against the weight of what it lifts.
namespace taut {
namespace {

struct Gripped {
  Simulation simulation = read_simulation(TAUT_SOURCE_DIR "/experiments/gripper_3d/experiment.toml");
  Robot robot;
  SimulationResult result;
  double weight = 0;  ///< [N]

  explicit Gripped(double friction) {
    simulation.contact.friction = friction;
    robot = make_robot(simulation);
    result = simulate(simulation, robot);
    EXPECT_EQ(result.failure, "");
    EXPECT_EQ(result.intersecting, 0);
    EXPECT_GT(result.smallest_jacobian, 0.5);
    const Mesh& mesh = robot.scene.model->mesh();
    const Part& cork = mesh.part("cork");
    const std::vector<double> volume = element_measures(mesh);
    const auto first = volume.begin() + cork.first_element;
    weight = 1000 * 9.81 * std::accumulate(first, first + cork.element_count, 0.0);
  }
  double end(const std::string& id) const {
    return result.readings[static_cast<size_t>(&robot.reading(id) - robot.readings.data())].back();
  }
};

TEST(SlowGripper3d, FrictionAloneCarriesTheCorkThatThePadsLift) {
  const Gripped rough(0.5);
  EXPECT_NEAR(rough.end("height"), 30e-3, 0.2e-3);
  EXPECT_NEAR(rough.end("carried_left") + rough.end("carried_right"), rough.weight, 1e-3 * rough.weight);
  EXPECT_LT(rough.end("carried_left"), 0.5 * rough.end("grip"));
  EXPECT_EQ(rough.end("on_table"), 0);
}

TEST(SlowGripper3d, WithoutFrictionTheCorkStaysOnTheTable) {
  const Gripped smooth(0);
  EXPECT_LT(smooth.end("height"), 1e-3);
  EXPECT_NEAR(smooth.end("on_table"), smooth.weight, 1e-3 * smooth.weight);
}

}  // namespace
}  // namespace taut

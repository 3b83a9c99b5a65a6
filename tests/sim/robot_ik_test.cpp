#include "sim/robots/robot_ik.hpp"

#include <gtest/gtest.h>

#include "sim/files/simulation.hpp"
#include "sim/robots/simulate.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"
#include "tests/support/small_robot.hpp"

namespace taut {
namespace {

using namespace test;

/// The small robot with its block on the ground, and what it is asked for.
std::string with_ik(const std::string& targets) {
  return replaced(robot_toml, "velocity = [\"0 m/s\", \"-0.5 m/s\"]", "clamped = [\"ymin\"]") + R"(
[ik]
tolerance = "0.1 mm"
[ik.control.motor]
lower = "-30 deg"
upper = "30 deg"
[ik.control.pull]
lower = "0 mm"
upper = "6 mm"
nominal = "2 mm"
)" + targets;
}

TEST(RobotIk, FollowsAPathUnderLoadsWithOneControlHeld) {
  const TemporaryFolder folder;
  const Simulation simulation = read_simulation(folder.write("experiment.toml", with_ik(R"(
[[ik.path]]
name = "up"
tip_y = ["-2 mm", "1 mm", "4 mm"]
hold_pull = "1 mm"
)")));
  const Robot robot = make_robot(simulation);
  const std::vector<IkAnswer> answers = solve_target(simulation, robot, simulation.ik->targets.front());
  ASSERT_EQ(answers.size(), 3u);
  double last = -1;
  for (const IkAnswer& answer : answers) {
    ASSERT_EQ(answer.result.status, IkStatus::reached) << answer.result.message;
    ASSERT_EQ(answer.free.size(), 1u);
    EXPECT_EQ(simulation.controls[answer.free[0]].id, "motor");
    EXPECT_GT(answer.result.controls[0], last) << "higher places ask for larger angles";
    last = answer.result.controls[0];
    EXPECT_DOUBLE_EQ(answer.p[robot.controls[0]], 1e-3) << "held";
    // From rest, with its own weight and the hung mass, the same controls bring the tip there.
    Equilibrium equilibrium(*robot.scene.model);
    equilibrium.start_at_rest(at_rest(simulation, robot));
    ASSERT_EQ(equilibrium.solve(answer.p).status, SolveStatus::converged);
    const SceneReading& tip = robot.readings.front();
    ASSERT_EQ(tip.id, "tip_y");
    EXPECT_NEAR(tip.rest + tip.channel->value({equilibrium.u(), equilibrium.p()}), answer.wanted[0], 1e-4);
  }
}

TEST(RobotIk, SaysWhatIsWrongWithATarget) {
  const auto expect = [](const std::string& targets, const std::vector<std::string>& parts) {
    const TemporaryFolder folder;
    const std::string path = folder.write("experiment.toml", with_ik(targets));
    expect_input_error([&] { read_simulation(path); }, parts);
  };
  const std::string head = "[[ik.path]]\nname = \"up\"\ntip_y = [\"1 mm\", \"2 mm\"]\n";
  expect("", {"[ik]", "no target"});
  expect("[[ik.target]]\nname = \"up\"\n", {"a target needs the value of a channel"});
  expect(head + "block_height = [\"1 mm\"]\n", {"as many values"});
  expect(head + "hold_motor = \"1 deg\"\nhold_pull = \"1 mm\"\n", {"all controls are held"});
  expect(head + "stiffness_tip_y = \"-1 N/m\"\n", {"stiffness_tip_y", "positive"});
  expect(head + "stiffness_tip_turn = \"1 N/m\"\n", {"unknown key 'stiffness_tip_turn'"});
  expect(head + "[ik.control.slide]\nlower = \"0 mm\"\nupper = \"1 mm\"\n", {"'slide' is not a [[control]]"});
}

}  // namespace
}  // namespace taut

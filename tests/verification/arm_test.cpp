#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "sim/files/simulation.hpp"
#include "sim/robots/robot_ik.hpp"
#include "sim/robots/simulate.hpp"

namespace taut {
namespace {

const std::string folder = std::string(TAUT_SOURCE_DIR) + "/experiments/arm/";

Simulation arm_simulation() {
  return read_simulation(folder + "experiment.toml");
}

/// Places in the order of simulation.channels.
double reading_at(const Simulation& simulation, const SimulationResult& result, const std::string& id, double t) {
  size_t channel = 0, sample = 0;
  while (simulation.channels[channel].id != id) ++channel;
  while (sample + 1 < result.times.size() && result.times[sample] < t - 1e-9) ++sample;
  return result.readings[channel][sample];
}

const IkTarget& target_called(const Simulation& simulation, const std::string& name) {
  for (const IkTarget& target : simulation.ik->targets) {
    if (target.name == name) return target;
  }
  throw std::runtime_error("no target " + name);
}

TEST(SlowArm, GoesFromSoftToRigidWithoutFoldsCrossingsOrGaps) {
  Simulation simulation = arm_simulation();
  simulation.duration = 5;  // soft mode, the transition, and the motors' first second
  simulation.step = 0.02;
  const Robot robot = make_robot(simulation);
  const SimulationResult result = simulate(simulation, robot);
  ASSERT_EQ(result.failure, "");
  EXPECT_GT(result.smallest_jacobian, 0.3);
  EXPECT_EQ(result.intersecting, 0);
  EXPECT_GT(result.smallest_distance, 0);
  EXPECT_LT(result.largest_joint_gap, 1e-3 * 0.055) << "of a module's length";
  EXPECT_LT(result.largest_motor_error, 0.5 * std::numbers::pi / 180);
  // Motors still: each link is shorter by what its cables were retracted, less their slack and stretch.
  const double rest = reading_at(simulation, result, "tip_x", 0), rigid = reading_at(simulation, result, "tip_x", 4);
  double shorter = 0;
  for (int link = 1; link <= 3; ++link)
    shorter += 17.68e-3 - 0.29e-3 - reading_at(simulation, result, "tension" + std::to_string(link), 4) / 17080;
  EXPECT_NEAR(rest - rigid, shorter, 0.4e-3);
  // Then the tip is where three straight links are that turn by the commanded angles.
  const double t = 4.6;
  const Params p = robot.at(simulation, t);
  double x = 0, y = 0, angle = 0;
  for (int link = 1; link <= 3; ++link) {
    angle += p[robot.scene.model->parameters().index("motor" + std::to_string(link))];
    const double length = (link < 3 ? 0.085 : rest - 0.17) - shorter / 3;
    x += length * std::cos(angle);
    y += length * std::sin(angle);
  }
  EXPECT_GT(std::hypot(x - rigid, y), 0.02) << "they have moved";
  EXPECT_NEAR(reading_at(simulation, result, "tip_x", t), x, 3e-3);
  EXPECT_NEAR(reading_at(simulation, result, "tip_y", t), y, 3e-3);
}

TEST(SlowArm, HalvingTheStepQuartersTheChangeOfTheTip) {
  // Soft mode until 1 s: cables are taut, lips open.
  std::vector<Eigen::Vector2d> tips;
  for (double step : {0.02, 0.01, 0.005}) {
    Simulation simulation = arm_simulation();
    simulation.duration = 1;
    simulation.step = step;
    const SimulationResult result = simulate(simulation, make_robot(simulation));
    ASSERT_EQ(result.failure, "");
    tips.emplace_back(reading_at(simulation, result, "tip_x", 1), reading_at(simulation, result, "tip_y", 1));
  }
  const double coarse = (tips[0] - tips[1]).norm(), fine = (tips[1] - tips[2]).norm();
  RecordProperty("ratio", std::to_string(coarse / fine));
  EXPECT_GT(coarse / fine, 2.8);
  EXPECT_LT(coarse / fine, 6);
  EXPECT_LT(fine, 0.5e-3);
}

TEST(Arm, BendsLessUnderATipMassWhenItIsRigid) {
  const Simulation simulation = read_simulation(folder + "tip_mass.toml");
  const SimulationResult result = simulate(simulation, make_robot(simulation));
  ASSERT_EQ(result.failure, "");
  const double soft = reading_at(simulation, result, "deflection", 1);
  const double off = reading_at(simulation, result, "deflection", 2);
  const double rigid = reading_at(simulation, result, "deflection", 4);
  EXPECT_NEAR(off, 0, 1e-6) << "elastic: without the mass it is back";
  EXPECT_GT(rigid, 0);
  EXPECT_GT(soft / rigid, 15);
  EXPECT_EQ(result.intersecting, 0);
}

class SlowArmIk : public testing::TestWithParam<const char*> {};

TEST_P(SlowArmIk, BringsTheTipToATargetWithinATenthOfAMillimetreAndTheBounds) {
  const Simulation simulation = arm_simulation();
  const Robot robot = make_robot(simulation);
  const IkAnswer answer = solve_target(simulation, robot, target_called(simulation, GetParam())).front();
  ASSERT_EQ(answer.result.status, IkStatus::reached) << answer.result.message;
  for (size_t j = 0; j < answer.free.size(); ++j) {
    const std::string& id = simulation.controls[answer.free[j]].id;
    for (const IkRange& range : simulation.ik->controls) {
      if (range.id != id) continue;
      EXPECT_GE(answer.result.controls[static_cast<Eigen::Index>(j)], range.lower);
      EXPECT_LE(answer.result.controls[static_cast<Eigen::Index>(j)], range.upper);
    }
  }
  // Another path to the same controls, through equilibria from rest, comes to the same place.
  Equilibrium equilibrium(*robot.scene.model);
  equilibrium.start_at_rest(at_rest(simulation, robot));
  for (double part : {0.25, 0.5, 0.75, 1.0})
    ASSERT_EQ(equilibrium.solve(at_rest(simulation, robot) + part * (answer.p - at_rest(simulation, robot))).status,
              SolveStatus::converged);
  for (size_t i = 0; i < answer.channels.size(); ++i) {
    for (const SceneReading& reading : robot.readings) {
      if (reading.id != answer.channels[i]) continue;
      EXPECT_NEAR(reading.rest + reading.channel->value({equilibrium.u(), equilibrium.p()}), answer.wanted[i], 1e-4);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Modes, SlowArmIk, testing::Values("soft", "rigid", "hybrid"),
                         [](const auto& mode) { return std::string(mode.param); });

TEST(SlowArm, TheStiffnessThatWasAskedForIsWhatASmallMassFeels) {
  const Simulation simulation = arm_simulation(), loaded = read_simulation(folder + "tip_mass.toml");
  const Robot robot = make_robot(simulation), hung = make_robot(loaded);
  for (const double wanted : {80.0, 88.0}) {
    const IkTarget& target = target_called(simulation, wanted == 80 ? "80 N per m" : "88 N per m");
    const IkAnswer answer = solve_target(simulation, robot, target).front();
    ASSERT_EQ(answer.result.status, IkStatus::reached) << answer.result.message;
    // The same controls in the model that has a load: what does a tenth of a gram move?
    Params p = at_rest(loaded, hung);
    Equilibrium equilibrium(*hung.scene.model);
    equilibrium.start_at_rest(p);
    for (size_t k = 0; k < simulation.controls.size(); ++k)
      p[hung.scene.model->parameters().index(simulation.controls[k].id)] = answer.p[robot.controls[k]];
    p[hung.gravity] = 9.81;
    const SceneReading& deflection = hung.readings.front();
    ASSERT_EQ(deflection.id, "deflection");
    ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged);
    const double before = deflection.channel->value({equilibrium.u(), equilibrium.p()});
    EXPECT_NEAR(before, -10e-3, 1e-4) << "down is positive";
    p[hung.scene.model->parameters().index("mass")] = 1e-4;
    ASSERT_EQ(equilibrium.solve(p).status, SolveStatus::converged);
    const double moved = deflection.channel->value({equilibrium.u(), equilibrium.p()}) - before;
    EXPECT_NEAR(1e-4 * 9.81 / moved, wanted, 0.015 * wanted);
  }
}

TEST(SlowArm, OutOfReachItStretchesTowardsTheTarget) {
  // Rigid: three straight links, so the nearest point to a target beyond them lies on the line to it.
  const Simulation simulation = arm_simulation();
  const Robot robot = make_robot(simulation);
  const IkAnswer answer = solve_target(simulation, robot, target_called(simulation, "out of reach")).front();
  EXPECT_EQ(answer.result.status, IkStatus::unreachable) << answer.result.message;
  const double length = std::hypot(answer.achieved[0], answer.achieved[1]);
  EXPECT_NEAR(length, 0.243 - 3 * 16.4e-3, 1e-3);
  EXPECT_NEAR(std::atan2(answer.achieved[1], answer.achieved[0]), std::atan2(answer.wanted[1], answer.wanted[0]), 1e-2);
}

}  // namespace
}  // namespace taut

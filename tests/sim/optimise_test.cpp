#include "sim/robots/optimise.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "sim/files/simulation.hpp"
#include "sim/files/simulation_text.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"
#include "tests/support/small_robot.hpp"

namespace taut {
namespace {

using namespace test;

/// A simulation with [optimise], and its robot.
struct Made {
  explicit Made(const std::string& toml)
      : simulation(read_simulation(folder.write("experiment.toml", toml))), robot(make_robot(simulation)) {}
  TemporaryFolder folder;
  Simulation simulation;
  Robot robot;
};

/// The small robot, its controls in two pieces and free.
std::string free_robot(const std::string& goals) {
  std::string toml = replaced(robot_toml, "[[control.piece]]\nuntil = \"40 ms\"\nto = \"3 mm\"",
                              "piece = [{ until = \"15 ms\", to = \"2 mm\" }, { until = \"40 ms\", to = \"3 mm\" }]");
  toml = replaced(toml, "[[control.piece]]\nuntil = \"40 ms\"\nkind = \"linear\"\nto = \"20 deg\"",
                  "piece = [{ until = \"10 ms\", kind = \"linear\", to = \"12 deg\" }, { until = \"12 ms\", kind = "
                  "\"hold\" }, { until = \"40 ms\", kind = \"linear\", to = \"20 deg\" }]");
  return toml + R"(
[optimise.control.pull]
lower = "0 mm"
upper = "6 mm"
change = "2 mm"
[optimise.control.motor]
lower = "-40 deg"
upper = "40 deg"
)" + goals;
}

/// Without the block that falls: no net force, and equilibria.
std::string resting(const std::string& toml) {
  return replaced(replaced(toml, "velocity = [\"0 m/s\", \"-0.5 m/s\"]", "clamped = [\"ymin\"]"),
                  "[[channel]]\nid = \"block_force\"\nkind = \"net_force\"\nof = \"block\"\ndirection = [0, 1]\n\n",
                  "");
}

const std::string three_goals = R"(
[[optimise.goal]]
channel = "tip_y"
aim = "reach"
value = "20 mm"
scale = "5 mm"
time = "30 ms"
[[optimise.goal]]
channel = "tension"
aim = "minimise"
scale = "2 N"
time = "20 ms"
[[optimise.goal]]
channel = "tip_turn"
)";

TEST(ControlSchedule, IsLinearInTheTargetsOfItsPieces) {
  using Kind = ControlSchedule::Kind;
  ControlSchedule schedule(0.3);
  schedule.add({Kind::smooth, 1, 0.7});
  schedule.add({Kind::hold, 1.5});
  schedule.add({Kind::linear, 2, -0.4});
  schedule.add({Kind::sine, 3, 0, 0.2, 1.5, 0.4});
  schedule.add({Kind::smooth, 4, 0.1});
  for (const size_t piece : {0u, 2u, 4u}) {
    ControlSchedule moved = schedule;
    moved.set_target(piece, schedule.pieces()[piece].target + 1.5);
    const ControlSchedule derivative = schedule.by_target(piece);
    double largest = 0;
    for (int i = 0; i <= 50; ++i) {
      const double t = 0.1 * i;
      EXPECT_NEAR(moved.at(t) - schedule.at(t), 1.5 * derivative.at(t), 1e-14) << piece << " at " << t;
      largest = std::max(largest, derivative.at(t));
    }
    EXPECT_DOUBLE_EQ(largest, 1);
  }
  EXPECT_THROW(schedule.set_target(1, 0.5), std::logic_error) << "a hold has none";
  EXPECT_THROW(schedule.set_target(0, NAN), std::logic_error);
}

TEST(ControlObjective, ItsGradientIsTheSlopeOfWholeSimulations) {
  for (const std::string method :
       {"\"implicit_euler\"", "\"bdf2\"", "\"bdf2\"\nstart = \"equilibrium\"", "\"static\""}) {
    Made made(replaced(resting(free_robot(three_goals)), "\"implicit_euler\"", method));
    made.simulation.equilibrium.step_tolerance = 1e-13;
    const ControlObjective objective(made.simulation, made.robot);
    const Eigen::VectorXd x = objective.start();
    ASSERT_EQ(x.size(), 4);
    const ControlObjective::Value here = objective.at(x);
    ASSERT_TRUE(std::isfinite(here.objective)) << here.run.failure;
    for (Eigen::Index j = 0; j < x.size(); ++j) {
      const ControlObjective::Target& target = objective.targets()[static_cast<size_t>(j)];
      const double h = 1e-4 * (target.upper - target.lower);
      const auto moved = [&](double by) {
        Eigen::VectorXd there = x;
        there[j] += by;
        return objective.at(there).objective;
      };
      // Central differences of order four.
      const double slope = (8 * (moved(h) - moved(-h)) - (moved(2 * h) - moved(-2 * h))) / (12 * h);
      EXPECT_GT(std::abs(slope), 1e-3) << method << ": " << j << " tests nothing";
      EXPECT_NEAR(here.gradient[j], slope, 1e-5 * std::abs(slope)) << method << ": " << j;
    }
  }
}

TEST(ControlObjective, ItsGradientIsThatSlopeWhileABlockIsThrown) {
  // The arm hits the block that has fallen onto it; the goal is where the block is afterwards.
  std::string toml = free_robot("[[optimise.goal]]\nchannel = \"block_height\"\ntime = \"36 ms\"\nscale = \"1 mm\"\n");
  toml = replaced(toml, "at = [\"20 mm\", \"-38 mm\"]", "at = [\"40 mm\", \"8 mm\"]");
  Made made(toml);
  made.simulation.equilibrium.step_tolerance = 1e-13;
  const ControlObjective objective(made.simulation, made.robot);
  const Eigen::VectorXd x = objective.start();
  const ControlObjective::Value here = objective.at(x);
  ASSERT_TRUE(std::isfinite(here.objective)) << here.run.failure;
  ASSERT_GT(here.goals[0], 12e-3 + 2e-3) << "thrown";
  for (const Eigen::Index j : {0, 2, 3}) {
    const double h = j == 0 ? 2e-7 : 2e-5;
    const auto moved = [&](double by) {
      Eigen::VectorXd there = x;
      there[j] += by;
      return objective.at(there).objective;
    };
    const double slope = (8 * (moved(h) - moved(-h)) - (moved(2 * h) - moved(-2 * h))) / (12 * h);
    EXPECT_GT(std::abs(slope), 1e-2) << j << " tests nothing";
    EXPECT_NEAR(here.gradient[j], slope, 1e-5 * std::abs(slope)) << j;
  }
}

const std::string free_mass = R"(title = "A block that a force moves"
[simulation]
integrator = "implicit_euler"
duration = "0.1 s"
step = "2 ms"
thickness = "20 mm"
[[body]]
name = "block"
geometry = { kind = "rectangle", size = ["30 mm", "20 mm"], region = "rubber" }
mesh = { cells = [2, 2], element = "linear" }
[materials.rubber]
law = "neo_hookean"
E = "2 MPa"
nu = 0.4
density = "1000 kg/m3"
[damping.rubber]
stiffness = "5 ms"
[[control]]
id = "push"
start = "0 N"
piece = [
  { until = "20 ms", kind = "linear", to = "0 N" },
  { until = "50 ms", kind = "linear", to = "0.05 N" },
  { until = "70 ms", kind = "linear", to = "0 N" },
  { until = "100 ms", kind = "linear", to = "0 N" },
]
[[load]]
id = "hand"
on = "block.xmin"
direction = [1, 0]
control = "push"
[[channel]]
id = "x"
kind = "displacement"
of = "block"
direction = [1, 0]
[optimise]
tolerance = 1e-12
iterations = 300
[optimise.control.push]
lower = "-1 N"
upper = "1 N"
change = "0.1 N"
[[optimise.goal]]
channel = "x"
aim = "reach"
value = "30 mm"
scale = "10 mm"
)";

TEST(ControlObjective, ItsGradientIsThatSlopeWhereASupportMoves) {
  std::string toml =
      replaced(free_mass, "[[load]]\nid = \"hand\"\non = \"block.xmin\"\ndirection = [1, 0]\ncontrol = \"push\"",
               "[[support]]\non = \"block.xmin\"\nfix = [\"y\"]\nmove = \"x\"\ncontrol = \"push\"");
  size_t at = 0;
  while ((at = toml.find(" N\"", at)) != std::string::npos) toml.replace(at, 3, " m\"");
  toml = replaced(toml, "of = \"block\"\ndirection", "of = \"block.xmax\"\ndirection");
  for (const std::string method : {"\"implicit_euler\"", "\"bdf2\"", "\"bdf2\"\nstart = \"equilibrium\""}) {
    Made made(replaced(replaced(toml, "\"implicit_euler\"", method), "E = \"2 MPa\"", "E = \"20 kPa\""));
    made.simulation.equilibrium.step_tolerance = 1e-13;
    const ControlObjective objective(made.simulation, made.robot);
    const Eigen::VectorXd x = 0.1 * objective.start();
    const ControlObjective::Value here = objective.at(x);
    ASSERT_TRUE(std::isfinite(here.objective)) << here.run.failure;
    for (Eigen::Index j = 0; j < x.size(); ++j) {
      const auto moved = [&](double by) {
        Eigen::VectorXd there = x;
        there[j] += by;
        return objective.at(there).objective;
      };
      const double h = 1e-4, slope = (8 * (moved(h) - moved(-h)) - (moved(2 * h) - moved(-2 * h))) / (12 * h);
      EXPECT_GT(std::abs(slope), 0.1) << method << ": " << j << " tests nothing";
      EXPECT_NEAR(here.gradient[j], slope, 1e-5 * std::abs(slope)) << method << ": " << j;
    }
  }
}

TEST(Optimise, TheLeastEffortThatMovesAMassIsThatOfTheNormalEquations) {
  // Implicit Euler moves the centre of a mass by x = h^2/m sum_k (N - k + 1) F(t_k), whatever its shape does.
  const Made made(free_mass);
  const OptimiseResult result = optimise(made.simulation, made.robot);
  const double mass = 0.03 * 0.02 * 0.02 * 1000, h = 2e-3;
  const std::vector<double> knots{0, 0.02, 0.05, 0.07, 0.1};
  Eigen::VectorXd response = Eigen::VectorXd::Zero(4);  // of x to the force at each knot but the first
  for (int k = 1; k <= 50; ++k) {
    for (size_t j = 1; j < knots.size(); ++j) {
      const double t = k * h, rise = (t - knots[j - 1]) / (knots[j] - knots[j - 1]);
      const double fall = j + 1 < knots.size() ? (knots[j + 1] - t) / (knots[j + 1] - knots[j]) : 2.0;
      response[static_cast<Eigen::Index>(j) - 1] += h * h / mass * (50 - k + 1) * std::max(0.0, std::min(rise, fall));
    }
  }
  // (a a^T + 100 D^T D) x = 3 a with the differences D, whose inverse sums up; by Sherman and Morrison.
  Eigen::MatrixXd sums = Eigen::MatrixXd::Zero(4, 4);
  for (Eigen::Index i = 0; i < 4; ++i) sums.row(i).head(i + 1).setOnes();
  const Eigen::VectorXd a = response / 0.01, softest = sums * (sums.transpose() * a) / 100;
  const Eigen::VectorXd best = 3 * softest / (1 + a.dot(softest));
  ASSERT_GT(best.maxCoeff(), 0.1);
  EXPECT_TRUE(result.status == OptimiseStatus::converged || result.status == OptimiseStatus::stalled) << result.message;
  for (Eigen::Index j = 0; j < 4; ++j) EXPECT_NEAR(result.found[j], best[j], 1e-4 * best.maxCoeff()) << j;
  const double miss = a.dot(best) - 3, effort = 3 * 3 * a.dot(softest) / std::pow(1 + a.dot(softest), 2);
  EXPECT_NEAR(result.value.objective, miss * miss + effort, 1e-8);
  EXPECT_NEAR(result.value.effort, effort, 1e-3 * effort);
  EXPECT_LT(result.value.objective, 0.5 * result.before_value.objective);
  // Where it begins: a push of 0.05 N at the second knot, x = sin q.
  const Eigen::Vector4d begin(0, 0.05, 0, 0);
  const double far = a.dot(begin) - 3;
  const Eigen::Vector4d gradient =
      2 * far * a + 200 * Eigen::Vector4d(-0.05, 2 * 0.05, -0.05, 0);  // of the squared changes 0.05 and -0.05
  EXPECT_NEAR(result.iterations.front().objective, far * far + 100 * 2 * 0.05 * 0.05, 1e-6);
  const Eigen::Vector4d slopes(1, std::sqrt(1 - 0.05 * 0.05), 1, 1);
  const double norm = gradient.cwiseProduct(slopes).norm();
  EXPECT_NEAR(result.iterations.front().gradient_norm, norm, 1e-5 * norm);
  EXPECT_LT(result.iterations.back().gradient_norm, 1e-4 * norm);
}

TEST(Optimise, ABoundHoldsAndTheRestIsTheBestWithinIt) {
  // The farthest: full force all the time.
  std::string toml = replaced(free_mass, "aim = \"reach\"\nvalue = \"30 mm\"\n", "aim = \"maximise\"\n");
  toml = replaced(toml, "change = \"0.1 N\"\n", "");
  const Made made(replaced(toml, "lower = \"-1 N\"\nupper = \"1 N\"", "lower = \"-0.4 N\"\nupper = \"0.3 N\""));
  const OptimiseResult result = optimise(made.simulation, made.robot);
  EXPECT_EQ(result.status, OptimiseStatus::converged) << result.message;
  for (Eigen::Index j = 0; j < 4; ++j) {
    EXPECT_LE(result.found[j], 0.3);
    EXPECT_NEAR(result.found[j], 0.3, 3e-3) << j;
  }
  EXPECT_EQ(result.bound[0], 1);
  EXPECT_NE(result.message.find("local optimum"), std::string::npos);
}

TEST(Optimise, ASimulationThatFailsCostsItsPointAndNotTheSearch) {
  // As low as the motor can bring the tip, through equilibria that too few Newton iterations may look for.
  const auto lowest = [](int max_iterations) {
    const Made made(replaced(resting(robot_toml), "\"implicit_euler\"",
                             "\"static\"\nmax_iterations = " + std::to_string(max_iterations)) +
                    "[optimise.control.motor]\nlower = \"-170 deg\"\nupper = \"170 deg\"\n[[optimise.goal]]\nchannel = "
                    "\"tip_y\"\naim = \"minimise\"\n");
    return optimise(made.simulation, made.robot);
  };
  const OptimiseResult poor = lowest(5), good = lowest(60);
  EXPECT_GT(poor.failed, 0);
  EXPECT_LT(poor.failed, poor.simulations);
  EXPECT_NE(poor.message.find("simulations failed"), std::string::npos) << poor.message;
  EXPECT_EQ(poor.value.run.failure, "");
  EXPECT_EQ(good.failed, 0);
  EXPECT_LT(good.value.objective, good.before_value.objective - 0.05);
  EXPECT_NEAR(poor.value.objective, good.value.objective, 1e-6);
}

TEST(Optimise, AnInterruptedSearchKeepsTheBestSoFar) {
  const Made made(free_mass);
  std::atomic<bool> stop = false;
  double last = 0;
  const OptimiseResult result = optimise(made.simulation, made.robot, &stop, [&](const OptimiseIteration& one) {
    last = one.objective;
    if (one.iteration == 2) stop = true;
  });
  EXPECT_EQ(result.status, OptimiseStatus::interrupted);
  EXPECT_EQ(result.iterations.back().iteration, 2);
  EXPECT_LT(result.value.objective, result.before_value.objective);
  EXPECT_DOUBLE_EQ(result.value.objective, last);
  ASSERT_FALSE(result.value.run.times.empty());
  EXPECT_DOUBLE_EQ(result.value.run.times.back(), 0.1) << "its simulation is whole";
}

TEST(Optimise, GoalsThatNoFreeControlMovesAreRefused) {
  // The block rests on the ground, far from the arm.
  const Made made(resting(free_robot("[[optimise.goal]]\nchannel = \"block_height\"\n")));
  expect_input_error([&] { optimise(made.simulation, made.robot); },
                     {"experiment.toml", "[optimise]", "no free control moves a goal", "zero"});
  // What is reached already has no slope either, but a sense.
  const Made there(replaced(free_mass, "value = \"30 mm\"", "value = \"0 mm\""));
  EXPECT_NO_THROW(optimise(there.simulation, there.robot));
}

TEST(Optimise, WhatIsWrongInItsTablesIsOneSentence) {
  const auto refused = [](const std::string& toml, const std::vector<std::string>& parts) {
    const TemporaryFolder folder;
    const std::string path = folder.write("experiment.toml", toml);
    expect_input_error([&] { read_simulation(path); }, parts);
  };
  const std::string goal = "[[optimise.goal]]\nchannel = \"tip_y\"\n";
  const auto with = [&](const std::string& from, const std::string& to) {
    return replaced(free_robot(goal), from, to);
  };
  const std::string pull = "lower = \"0 mm\"\nupper = \"6 mm\"\nchange = \"2 mm\"";
  refused(free_robot(""), {"[optimise]", "there is no goal", "[[optimise.goal]]"});
  refused(robot_toml + "[optimise]\n" + goal, {"[optimise]", "no control is free", "[optimise.control.ID]"});
  refused(with("channel = \"tip_y\"\n", "channel = \"tip\"\n"), {"channel", "'tip'", "did you mean 'tip_y'"});
  refused(with("channel = \"tip_y\"\n", "channel = \"block_force\"\n"), {"'block_force' is a net_force", "no goal"});
  refused(free_robot(goal + "time = \"1 s\"\n"), {"time", "1 s is not within the simulation", "40 ms"});
  refused(free_robot(goal + "aim = \"reach\"\n"), {"'value' is missing"});
  refused(free_robot(goal + "aim = \"reach\"\nvalue = \"1 N\"\n"), {"value", "not a unit of length"});
  refused(free_robot(goal + "aim = \"maximize\"\n"), {"aim", "maximise", "minimise", "reach"});
  refused(free_robot(goal + "scale = \"0 mm\"\n"), {"scale", "positive"});
  refused(with("[optimise.control.pull]", "[optimise.control.pul]"), {"'pul' is not a [[control]]", "'pull'"});
  refused(with(pull, "lower = \"6 mm\"\nupper = \"0 mm\""), {"upper", "above the lower one"});
  refused(with(pull, "lower = \"0 mm\"\nupper = \"2.5 mm\""),
          {"'pull' goes to 3 mm in its piece that ends at 40 ms", "not within the bounds"});
  refused(with("piece = [{ until = \"15 ms\", to = \"2 mm\" }, { until = \"40 ms\", to = \"3 mm\" }]", ""),
          {"[optimise.control.pull]", "no piece with 'to'", "add [[control.piece]]"});
  refused(with("{ until = \"40 ms\", to = \"3 mm\" }",
               "{ until = \"40 ms\", kind = \"sine\", amplitude = \"1 mm\", period = \"10 ms\" }"),
          {"'pull' has a sine", "bounds"});
  refused(replaced(resting(free_robot(goal)), "\"implicit_euler\"", "\"cvode\""), {"[optimise]", "SUNDIALS", "bdf2"});
  refused(with("gap = \"0.3 mm\"\n", "gap = \"0.3 mm\"\nfriction = 0.3\n"), {"[optimise]", "friction"});
  refused(free_robot("[optimise]\ntolerance = 0.5\n" + goal), {"tolerance", "0.1"});
}

TEST(SimulationText, ReadAgainGivesTheSchedulesToTheLastBitAndAllElseAsItStood) {
  const std::string toml =
      replaced(free_mass, "  { until = \"20 ms\", kind = \"linear\", to = \"0 N\" },\n  { until = \"50 ms\"",
               "  { until = \"20 ms\", kind = \"linear\", to = '0 mN' }, # größer, später\n  { kind = \"linear\", to = "
               "\"0.05 N\", "
               "until = \"50 ms\" }, { until = \"60 ms\", kind = \"hold\" }, # \u00b5\n  { until = \"65 ms\"");
  // The piece that stood at 50 ms now ends at 65 ms.
  const Made made(
      replaced(toml, "kind = \"linear\", to = \"0.05 N\" },\n  { until = \"70", "to = \"50 mN\" },\n  { until = \"70"));
  Simulation moved = made.simulation;
  EXPECT_EQ(text_with_schedules(moved), text_of(moved.path)) << "nothing moved, nothing changes";
  std::vector<double> targets{1.0 / 3, -2e-17, M_PI, 0.05, 1e-3 / 7};
  const std::vector<size_t> pieces{0, 1, 3, 4, 5};
  for (size_t i = 0; i < pieces.size(); ++i) moved.schedules[0].set_target(pieces[i], targets[i]);
  const std::string text = text_with_schedules(moved);
  const TemporaryFolder folder;
  const Simulation again = read_simulation(folder.write("again.toml", text.substr(0, text.find("[optimise]"))));
  for (size_t i = 0; i < pieces.size(); ++i)
    EXPECT_EQ(again.schedules[0].pieces()[pieces[i]].target, targets[i]) << text;
  EXPECT_NE(text.find("mN\" }, # größer, später\n"), std::string::npos) << "units and comments stay: " << text;
  EXPECT_NE(text.find("\"hold\" }, # \u00b5\n"), std::string::npos);
}

TEST(SimulationText, PathsOfMeshesBecomeAbsolute) {
  const TemporaryFolder folder;
  const std::string toml =
      replaced(replaced(free_mass, "{ kind = \"rectangle\", size = [\"30 mm\", \"20 mm\"], region = \"rubber\" }",
                        "{ kind = \"msh\", file = \"../block.msh\", unit = \"mm\", dimension = 2 }"),
               "mesh = { cells = [2, 2], element = \"linear\" }", "mesh = { element = \"linear\" }");
  Simulation simulation = Made(free_mass).simulation;
  std::filesystem::create_directory(folder / "deep");
  simulation.path = folder.write("deep/experiment.toml", toml);
  EXPECT_NE(text_with_schedules(simulation).find("file = \"" + (folder / "block.msh") + "\", unit"), std::string::npos)
      << text_with_schedules(simulation);
}

}  // namespace
}  // namespace taut

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "tests/support/command.hpp"
#include "tests/support/small_robot.hpp"

// `taut optimise`: what it says and writes.
namespace taut {
namespace {

using namespace test;
namespace fs = std::filesystem;
using nlohmann::json;

/// The small robot with its block held; its controls shall bring the tip somewhere.
const std::string goal_toml =
    replaced(replaced(robot_toml, "velocity = [\"0 m/s\", \"-0.5 m/s\"]", "clamped = [\"ymin\"]"),
             "until = \"40 ms\"\nkind = \"linear\"\nto = \"20 deg\"",
             "until = \"20 ms\"\nto = \"10 deg\"\n[[control.piece]]\nuntil = \"40 ms\"\nto = \"20 deg\"") +
    R"(
[optimise]
iterations = 12
[optimise.control.pull]
lower = "0 mm"
upper = "6 mm"
[optimise.control.motor]
lower = "-40 deg"
upper = "40 deg"
change = "40 deg"
[[optimise.goal]]
channel = "tip_y"
aim = "reach"
value = "25 mm"
scale = "1 mm"
)";

TEST(OptimiseCommand, WritesAFileThatSimulateReplaysToTheSameGoal) {
  const TemporaryFolder folder;
  folder.write("robot.toml", goal_toml);
  const Outcome run = run_in(folder / "", {"optimise", "robot.toml", "--json"});
  ASSERT_TRUE(run.code == 0 || run.code == 4) << run.err;
  expect_holds(run.err, {"iteration 0: objective", "iteration 1: objective", "gradient", "found.toml"});
  const json found = json::parse(run.out);
  EXPECT_EQ(found["simulated"], true);
  EXPECT_LT(found["objective"]["found"], 0.5 * found["objective"]["before"].get<double>());
  const json& goal = found["goals"][0];
  EXPECT_EQ(goal["aim"], "reach");
  EXPECT_EQ(goal["wanted"], 0.025);
  const double miss = (goal["found"].get<double>() - 0.025) / 1e-3;
  EXPECT_NEAR(found["objective"]["found"].get<double>() - found["objective"]["effort"].get<double>(), miss * miss,
              1e-9 + 1e-9 * miss * miss);
  EXPECT_EQ(found["controls"]["motor"]["until_s"], json({0.02, 0.04}));
  EXPECT_EQ(found["controls"]["motor"]["unit"], "rad");
  EXPECT_EQ(found["iterations"].front()["iteration"], 0);
  for (size_t k = 1; k < found["iterations"].size(); ++k)
    EXPECT_LE(found["iterations"][k]["objective"], found["iterations"][k - 1]["objective"]);

  const fs::path made = folder / "runs/robot/optimise";
  for (const char* file : {"found.toml", "search.csv", "channels.csv", "report.html", "robot_optimised.pvd",
                           "figures/plot_motor_optimised.svg", "figures/plot_pull_optimised.svg"})
    EXPECT_TRUE(fs::exists(made / file)) << file;
  const Outcome replay = done_in(folder / "", {"simulate", "runs/robot/optimise/found.toml", "--json", "-q"});
  const double end = json::parse(replay.out)["channels"]["tip_y"]["end"];
  EXPECT_NEAR(end, goal["found"].get<double>(), 1e-9 * std::abs(end));
  EXPECT_NE(end, json::parse(
                     done_in(folder / "", {"simulate", "robot.toml", "--json", "-q"}).out)["channels"]["tip_y"]["end"]);

  // A simulation of the same file leaves it, and the search may go on from there.
  const Outcome again = run_in(folder / "", {"optimise", "runs/robot/optimise/found.toml", "--out", "further", "-q"});
  EXPECT_TRUE(again.code == 0 || again.code == 4) << again.err;
  expect_holds(again.out, {"trajectory optimisation of a simulation", "reach 25 mm tip_y at 40 ms", "motor", "before"});
  EXPECT_TRUE(fs::exists(folder / "further/optimise/found.toml"));
}

TEST(OptimiseCommand, AnInterruptedSearchWritesTheBestSoFar) {
  const TemporaryFolder folder;
  folder.write("robot.toml", replaced(replaced(goal_toml, "iterations = 12", "iterations = 1000\ntolerance = 1e-15"),
                                      "step = \"2 ms\"", "step = \"0.1 ms\""));
  const auto interrupted = [&] {
    const pid_t child = start({"optimise", "robot.toml"}, folder / "");
    wait_until_said(child, folder / "", "iteration 2:");
    kill(child, SIGINT);
    return finish(child, folder / "");
  };
  const Outcome first = interrupted();
  EXPECT_EQ(first.code, 130) << first.err;
  expect_holds(first.out, {"interrupted after", "best so far is kept"});
  EXPECT_TRUE(fs::exists(folder / "runs/robot/optimise/found.toml"));
  // A finished run stays, and the best of an interrupted one lies beside it.
  folder.write("robot.toml", goal_toml);
  const Outcome whole = run_in(folder / "", {"optimise", "robot.toml", "-q"});
  ASSERT_TRUE(whole.code == 0 || whole.code == 4) << whole.err;
  const std::string before = text_of(folder / "runs/robot/optimise/found.toml");
  folder.write("robot.toml", replaced(goal_toml, "step = \"2 ms\"", "step = \"0.1 ms\""));
  const Outcome second = interrupted();
  EXPECT_EQ(second.code, 130) << second.err;
  expect_holds(second.err, {"finished run in runs/robot/optimise stays", "best_so_far.toml"});
  EXPECT_EQ(text_of(folder / "runs/robot/optimise/found.toml"), before);
  EXPECT_NE(text_of(folder / "runs/robot/optimise/best_so_far.toml"), text_of(folder / "robot.toml"));
}

TEST(OptimiseCommand, WrongInputIsASentenceAndExitCodeTwo) {
  const TemporaryFolder folder;
  const auto refused = [&](const std::string& toml, const std::vector<std::string>& parts) {
    folder.write("robot.toml", toml);
    const Outcome run = run_in(folder / "", {"optimise", "robot.toml", "-q"});
    EXPECT_EQ(run.code, 2) << run.out;
    expect_holds(run.err, parts);
    EXPECT_EQ(std::count(run.err.begin(), run.err.end(), '\n'), 1) << run.err;
  };
  refused(robot_toml, {"robot.toml", "there is no [optimise]", "[[optimise.goal]]"});
  refused(replaced(goal_toml, "channel = \"tip_y\"\naim = \"reach\"\nvalue = \"25 mm\"\nscale = \"1 mm\"",
                   "channel = \"block_height\""),
          {"no free control moves a goal"});
  refused(beam_toml, {"there is no [simulation]"});
}

TEST(OptimiseCommand, ASimulationThatFailsFromTheStartIsExitCodeThree) {
  const TemporaryFolder folder;
  const std::string hopeless =
      replaced(goal_toml, "integrator = \"implicit_euler\"", "integrator = \"static\"\nmax_iterations = 1");
  folder.write("robot.toml",
               replaced(hopeless,
                        "[[channel]]\nid = \"block_force\"\nkind = \"net_force\"\nof = \"block\"\ndirection "
                        "= [0, 1]\n\n",
                        ""));
  const Outcome run = run_in(folder / "", {"optimise", "robot.toml", "-q"});
  EXPECT_EQ(run.code, 3) << run.out;
  expect_holds(run.err, {"robot.toml", "the file's own controls fails", "start from controls"});
}

/// The shipped experiment; its result, and the tip's height when its file is simulated with half the step.
TEST(SlowSwingUp, TheTipComesUpAsItsReadmeSaysAndANudgeToTheOtherSideGivesTheMirrorImage) {
  const TemporaryFolder folder;
  const std::string toml = text_of(TAUT_SOURCE_DIR "/experiments/swing_up/experiment.toml");
  const auto optimised = [&](const std::string& name, const std::string& text) {
    folder.write(name + ".toml", text);
    return json::parse(done_in(folder / "", {"optimise", name + ".toml", "--json", "-q"}).out);
  };
  const json right = optimised("right", toml);
  EXPECT_EQ(right["status"], "converged");
  EXPECT_NEAR(right["goals"][0]["before"], -0.145, 2e-4);
  EXPECT_NEAR(right["goals"][0]["found"], 0.0801, 1e-4);
  const json left = optimised("left", replaced(replaced(toml, "to = \"5 deg\"", "to = \"-4 deg\""),
                                               "s\", to = \"-5 deg\"", "s\", to = \"6 deg\""));
  EXPECT_NEAR(left["goals"][0]["found"], right["goals"][0]["found"], 1e-6);
  const json &one = right["controls"]["motor"]["found"], &other = left["controls"]["motor"]["found"];
  ASSERT_EQ(one.size(), 8u);
  for (size_t k = 0; k < one.size(); ++k) EXPECT_NEAR(one[k].get<double>(), -other[k].get<double>(), 0.02) << k;
  const std::string finer =
      replaced(text_of(folder / "runs/right/optimise/found.toml"), "step = \"5 ms\"", "step = \"2.5 ms\"");
  folder.write("finer.toml", finer);
  const json half = json::parse(done_in(folder / "", {"simulate", "finer.toml", "--json", "-q"}).out);
  EXPECT_NEAR(half["channels"]["tip_height"]["end"], 0.0817, 1e-4);
}

/// Through contact: kinked, so that where exactly the search stalls is left open.
TEST(SlowThrow, TheBallFliesHighAndTheSearchSaysThatItStalledAtAKink) {
  const TemporaryFolder folder;
  folder.write("throw.toml", text_of(TAUT_SOURCE_DIR "/experiments/throw/experiment.toml"));
  const json thrown = json::parse(done_in(folder / "", {"optimise", "throw.toml", "--json", "-q"}).out);
  EXPECT_NEAR(thrown["goals"][0]["before"], 0.0265, 1e-4);
  EXPECT_NEAR(thrown["goals"][0]["found"], 0.172, 0.01);
  EXPECT_EQ(thrown["status"], "stalled");
  // A ball beside the arm is nothing to throw.
  folder.write("beside.toml", replaced(text_of(folder / "throw.toml"), "at = [\"90 mm\", \"13.8 mm\"]",
                                       "at = [\"150 mm\", \"60 mm\"]"));
  const Outcome beside = run_in(folder / "", {"optimise", "beside.toml", "-q"});
  EXPECT_EQ(beside.code, 2);
  expect_holds(beside.err, {"no free control moves a goal", "gradient at the start is zero"});
}

}  // namespace
}  // namespace taut

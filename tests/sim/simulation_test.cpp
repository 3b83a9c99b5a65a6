#include "sim/files/simulation.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <numeric>

#include "sim/robots/simulate.hpp"
#include "sim/robots/workspace.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"
#include "tests/support/small_robot.hpp"

namespace taut {
namespace {

using namespace test;

TEST(Schedule, GoesThroughItsPiecesWithoutAJump) {
  using Kind = ControlSchedule::Kind;
  ControlSchedule schedule(1);
  schedule.add({Kind::hold, 1});
  schedule.add({Kind::linear, 3, 5});
  schedule.add({Kind::smooth, 4, 2});
  schedule.add({Kind::sine, 6, 0, 0.5, 1, -M_PI / 2});
  EXPECT_EQ(schedule.at(0), 1);
  EXPECT_EQ(schedule.at(0.9), 1);
  EXPECT_DOUBLE_EQ(schedule.at(2), 3);
  EXPECT_DOUBLE_EQ(schedule.at(3), 5);
  EXPECT_DOUBLE_EQ(schedule.at(3.5), 3.5);
  EXPECT_DOUBLE_EQ(schedule.at(4.5), 2 + 0.5 * (0 + 1) + 0.5);  // sin(pi - pi/2) - sin(-pi/2) = 2
  EXPECT_NEAR(schedule.at(6), 2, 1e-12);
  EXPECT_NEAR(schedule.at(60), 2, 1e-12) << "the last value stays";
  for (double t = 0; t < 7; t += 1e-4) EXPECT_LT(std::abs(schedule.at(t + 1e-4) - schedule.at(t)), 1e-3);
}

TEST(Schedule, RefusesNumbersThatAreNotFiniteAndPiecesOutOfOrder) {
  ControlSchedule schedule;
  expect_input_error([&] { schedule.add({ControlSchedule::Kind::linear, 1, std::nan("")}); }, {"not finite"});
  schedule.add({ControlSchedule::Kind::hold, 2});
  expect_input_error([&] { schedule.add({ControlSchedule::Kind::hold, 1}); }, {"does not end after", "order"});
}

struct Finished {
  Simulation simulation;
  Robot robot;
  SimulationResult result;
};
Finished run(const std::string& toml) {
  const TemporaryFolder folder;
  const std::string path = folder.write("experiment.toml", toml);
  EXPECT_TRUE(is_simulation(path));
  Finished run{read_simulation(path), {}, {}};
  run.robot = make_robot(run.simulation);
  run.result = simulate(run.simulation, run.robot);
  return run;
}
const std::vector<double>& channel(const Finished& run, const std::string& id) {
  for (size_t k = 0; k < run.robot.readings.size(); ++k) {
    if (run.robot.readings[k].id == id) return run.result.readings[k];
  }
  throw std::logic_error(id);
}

std::string without_net_force(const std::string& toml) {
  return replaced(
      toml, "[[channel]]\nid = \"block_force\"\nkind = \"net_force\"\nof = \"block\"\ndirection = [0, 1]\n\n", "");
}

TEST(Simulate, RunsASceneOfJointCableLoadAndFreeBodyToItsEnd) {
  const Finished r = run(robot_toml);
  EXPECT_EQ(r.result.failure, "");
  ASSERT_EQ(r.result.times.size(), 21u);
  EXPECT_DOUBLE_EQ(r.result.times.back(), 0.04);
  EXPECT_EQ(r.result.intersecting, 0);
  EXPECT_GT(r.result.smallest_jacobian, 0.1);
  EXPECT_GT(r.result.smallest_distance, 0);
  EXPECT_LT(r.result.largest_joint_gap, 6e-5) << "a thousandth of the arm";
  EXPECT_LT(r.result.largest_motor_error, 0.5 * M_PI / 180);
  EXPECT_NEAR(channel(r, "shoulder_angle").back(), 20 * M_PI / 180, 0.5 * M_PI / 180);
  EXPECT_GT(channel(r, "tension").back(), 0);
  EXPECT_GT(channel(r, "tip_turn").back(), channel(r, "shoulder_angle").back() - 0.3);
  EXPECT_EQ(r.result.controls[0].back(), 0.003);
}

TEST(Simulate, TheForceOnAFreeBodyIsZeroInFlightAndItsImpulseTheChangeOfMomentum) {
  const Finished r = run(robot_toml);
  const std::vector<double>&force = channel(r, "block_force"), &height = channel(r, "block_height");
  const double m = 1000 * 0.008 * 0.008 * 0.02, g = 9.81;
  EXPECT_NEAR(force[1], 0, 1e-9) << "in flight";
  const double peak = *std::max_element(force.begin(), force.end());
  EXPECT_GT(peak, 5 * m * g) << "it meets the ground";
  // The impulse of the force less the weight is the change of momentum; steps of 2 ms, velocities by differences as
  // implicit Euler has them.
  const double h = 0.002;
  const double impulse = h * std::accumulate(force.begin() + 1, force.end(), 0.0);
  const double v_end = (height[20] - height[19]) / h;
  EXPECT_NEAR(impulse - m * g * 0.04, m * (v_end + 0.5), 1e-6);
}

TEST(Simulate, AllIntegratorsComeToTheSameTrajectory) {
  // Without the falling block: contact is met by each method as it can.
  std::string toml = without_net_force(robot_toml);
  toml = replaced(toml, "velocity = [\"0 m/s\", \"-0.5 m/s\"]", "at = [\"20 mm\", \"200 mm\"]");
  toml = replaced(toml, "at = [\"20 mm\", \"-38 mm\"]\n", "");
  toml = replaced(toml, "duration = \"40 ms\"\nstep = \"2 ms\"", "duration = \"30 ms\"\nstep = \"0.25 ms\"");
  const auto tip = [&](const std::string& integrator, const std::string& step = "0.25 ms") {
    std::string changed = replaced(toml, "integrator = \"implicit_euler\"", "integrator = \"" + integrator + "\"");
    const Finished r = run(replaced(changed, "step = \"0.25 ms\"", "step = \"" + step + "\""));
    EXPECT_EQ(r.result.failure, "") << integrator;
    return channel(r, "tip_y").back();
  };
  const double bdf2 = tip("bdf2"), finer = tip("bdf2", "0.125 ms"), limit = finer + (finer - bdf2) / 3;
  const double reference = tip("arkode_implicit");
  EXPECT_NEAR(limit, reference, 2e-6);
  EXPECT_NEAR(tip("cvode"), reference, 2e-5);
  const double euler = tip("implicit_euler"), euler_finer = tip("implicit_euler", "0.125 ms");
  EXPECT_NEAR(2 * euler_finer - euler, reference, 1e-5);
  EXPECT_NEAR((euler - reference) / (euler_finer - reference), 2, 0.2) << "order 1";
  EXPECT_NEAR((bdf2 - limit) / (finer - limit), 4, 1.0) << "order 2";
}

TEST(Simulate, AStaticRunIsASequenceOfEquilibria) {
  std::string toml =
      replaced(without_net_force(robot_toml), "integrator = \"implicit_euler\"", "integrator = \"static\"");
  // A free body has no equilibrium; on a ground without friction neither.
  expect_input_error([&] { run(toml); }, {"body 'block'", "rigid motions free", "add a support"});
  toml = replaced(toml, "at = [\"20 mm\", \"-38 mm\"]\nvelocity = [\"0 m/s\", \"-0.5 m/s\"]",
                  "at = [\"20 mm\", \"-38 mm\"]\nclamped = [\"ymin\"]");
  const Finished r = run(toml);
  EXPECT_EQ(r.result.failure, "");
  for (size_t k = 0; k < r.result.times.size(); k += 5) {
    const Params p = r.robot.at(r.simulation, r.result.times[k]);
    Eigen::VectorXd gradient;
    Assembly out;
    out.gradient = &gradient;
    r.robot.scene.model->evaluate({r.result.states[k], p}, out);
    EXPECT_LT(r.robot.scene.model->restrict_to_free(gradient).cwiseAbs().maxCoeff(), 1e-4);
  }
}

TEST(Simulate, AStaticRunReadsReactionsAndLengthsOfCables) {
  std::string toml =
      replaced(without_net_force(robot_toml), "integrator = \"implicit_euler\"", "integrator = \"static\"");
  toml = replaced(toml, "at = [\"20 mm\", \"-38 mm\"]\nvelocity = [\"0 m/s\", \"-0.5 m/s\"]",
                  "at = [\"20 mm\", \"-38 mm\"]\nclamped = [\"ymin\"]");
  toml +=
      "[[channel]]\nid = \"foot\"\nkind = \"reaction\"\nof = \"block.ymin\"\ndirection = [0, 1]\n"
      "[[channel]]\nid = \"path\"\nkind = \"length\"\nof = \"upper\"\n";
  const Finished r = run(toml);
  EXPECT_EQ(r.result.failure, "");
  EXPECT_NEAR(channel(r, "foot").back(), 1000 * 0.008 * 0.008 * 0.02 * 9.81, 1e-7) << "the block's weight";
  ASSERT_GT(channel(r, "tension").back(), 0.1);
  EXPECT_NEAR(channel(r, "path").back(), 0.06 - 0.003 + channel(r, "tension").back() / 2000, 1e-9);
}

/// A strip that a cable in its middle pulls together, held at tensions.
const std::string pulled_strip = R"(
title = "A strip is pulled together"
[simulation]
integrator = "static"
duration = "1 s"
step = "0.5 s"
thickness = "20 mm"
plane = "stress"
[[body]]
name = "strip"
geometry = { kind = "rectangle", size = ["100 mm", "10 mm"], region = "foam" }
mesh = { cells = [20, 2] }
clamped = ["xmin"]
[materials.foam]
E = "500 kPa"
nu = 0
density = "50 kg/m3"
[[control]]
id = "pull"
start = "0 N"
[[control.piece]]
until = "1 s"
kind = "linear"
to = "0.2 N"
[[cable]]
id = "middle"
body = "strip"
along = ["0 mm", "100 mm"]
tension = "pull"
[[channel]]
id = "tip"
kind = "displacement"
of = "strip.xmax"
direction = [1, 0]
[[channel]]
id = "tension"
kind = "tension"
of = "middle"
)";

TEST(Simulate, ACableHeldAtAScheduledTensionShortensAStripByTLOverEA) {
  const Finished r = run(pulled_strip);
  ASSERT_EQ(r.result.failure, "");
  ASSERT_EQ(r.result.times.size(), 3u);
  for (size_t k = 0; k < 3; ++k) {
    const double T = 0.1 * static_cast<double>(k);
    EXPECT_NEAR(channel(r, "tension")[k], T, 1e-12);
    EXPECT_NEAR(channel(r, "tip")[k], -T * 0.1 / (500e3 * 0.02 * 0.01), 2e-3 * T * 1e-3);
  }
}

TEST(Simulate, TensionsThatContradictThemselvesAreRefused) {
  const TemporaryFolder folder;
  const auto refuses = [&](const std::string& to, const std::vector<std::string>& parts) {
    const std::string path = folder.write("strip.toml", replaced(pulled_strip, "tension = \"pull\"", to));
    expect_input_error([&] { read_simulation(path); }, parts);
  };
  refuses("tension = \"pull\"\nretraction = \"pull\"", {"[cable] tension", "by its retraction or by its tension"});
  refuses("tension = \"-1 N\"", {"[cable] tension", "cannot push"});
  refuses("tension = \"1 mm\"", {"[cable] tension", "mm"});
  refuses("tension = \"pul\"", {"pul", "did you mean 'pull'?"});
  refuses("tension = \"pull\"\nk = \"1 N/mm\"", {"[cable]", "k"});
}

/// A block of 8 x 6 mm in two cables up to the world.
const char* const hung_block = R"(
title = "A block in cables"
[simulation]
integrator = "static"
duration = "1 s"
step = "1 s"
thickness = "20 mm"
gravity = "9.81 m/s2"
direction = [0, -1]
[[body]]
name = "block"
geometry = { kind = "rectangle", size = ["8 mm", "6 mm"], region = "nylon" }
mesh = { cells = [4, 3] }
[materials.nylon]
E = "2 GPa"
nu = 0.3
density = "1150 kg/m3"
[[cable]]
id = "left"
body = "block"
x = ["0 mm", "0 mm"]
y = ["90 mm", "6 mm"]
fixed = "start"
k = "150 N/m"
slack = "0 mm"
[[cable]]
id = "right"
body = "block"
x = ["8 mm", "8 mm"]
y = ["90 mm", "6 mm"]
fixed = "start"
k = "150 N/m"
slack = "0 mm"
[[channel]]
id = "y"
kind = "displacement"
of = "block"
direction = [0, 1]
[[channel]]
id = "left_tension"
kind = "tension"
of = "left"
[[channel]]
id = "right_tension"
kind = "tension"
of = "right"
)";

TEST(Simulate, ABlockInTwoCablesHangsByItsWeightOverTheirStiffness) {
  const double weight = 1150 * 9.81 * 0.02 * 0.008 * 0.006;
  const Finished r = run(hung_block);
  ASSERT_EQ(r.result.failure, "");
  EXPECT_NEAR(channel(r, "y").back(), -weight / 300, 1e-8) << "nylon strains by 1e-7";
  EXPECT_NEAR(channel(r, "left_tension").back(), weight / 2, 1e-6 * weight);
  // With slack it falls until they are taut.
  std::string slack = hung_block;
  for (size_t at; (at = slack.find("\"0 mm\"\n[[")) != std::string::npos;) slack.replace(at, 6, "\"3 mm\"");
  const Finished fallen = run(slack);
  ASSERT_EQ(fallen.result.failure, "");
  EXPECT_NEAR(channel(fallen, "y").back(), -0.003 - weight / 300, 1e-8);
}

TEST(Simulate, ABlockInStudsFallsByTheirClearanceAndByItsWeightOverTheirStiffness) {
  std::string block = hung_block;
  block.erase(block.find("[[cable]]"), block.find("[[channel]]") - block.find("[[cable]]"));
  block.erase(block.find("[[channel]]\nid = \"left_tension\""));
  const std::string studs = R"(
[studs]
clearance = "0.2 mm"
stiffness = "150 N/m"
[[stud]]
id = "left"
on = "block.xmin & block.ymin"
direction = [0, 1]
[[stud]]
id = "right"
on = "block.xmax & block.ymin"
direction = [0, 1]
[[stud]]
id = "across"
on = "block.ymin"
direction = [1, 0]
clearance = "0 mm"
)";
  const double weight = 1150 * 9.81 * 0.02 * 0.008 * 0.006;
  const Finished r = run(block + studs);
  ASSERT_EQ(r.result.failure, "");
  EXPECT_NEAR(channel(r, "y").back(), -0.2e-3 - weight / 300, 1e-8);
  expect_input_error(
      [&] {
        run(replaced(block + studs, "id = \"across\"\non = \"block.ymin\"",
                     "id = \"across\"\npoint = [\"0 mm\", \"0 mm\"]"));
      },
      {"[stud]", "'on' is missing"});
}

TEST(Simulate, OneCableHoldsABlockInThePlaneAsAPendulum) {
  std::string one = replaced(hung_block, "x = [\"0 mm\", \"0 mm\"]", "x = [\"4 mm\", \"4 mm\"]");
  const size_t from = one.find("[[cable]]\nid = \"right\""), to = one.find("[[channel]]");
  one.erase(from, to - from);
  one.erase(one.find("[[channel]]\nid = \"right_tension\""));
  const Finished r = run(one);
  ASSERT_EQ(r.result.failure, "");
  EXPECT_NEAR(channel(r, "left_tension").back(), 1150 * 9.81 * 0.02 * 0.008 * 0.006, 1e-8);
}

TEST(Simulate, SlackCablesHoldNothingWithoutWeight) {
  std::string slack = replaced(hung_block, "gravity = \"9.81 m/s2\"\ndirection = [0, -1]\n", "");
  for (size_t at; (at = slack.find("\"0 mm\"\n[[")) != std::string::npos;) slack.replace(at, 6, "\"3 mm\"");
  expect_input_error([&] { run(slack); }, {"body 'block'", "rigid motions free", "add a support"});
}

TEST(Simulate, AGrooveHoldsAWedgeWithoutCablesAndOneGroundHoldsNoBlock) {
  std::string block = hung_block;
  block.erase(block.find("[[cable]]"), block.find("[[channel]]") - block.find("[[cable]]"));
  block.erase(block.find("[[channel]]\nid = \"left_tension\""));
  const std::string ground =
      "[contact]\ngap = \"0.01 mm\"\n[[contact.ground]]\npoint = [\"0 mm\", \"-0.2 mm\"]\nnormal = [0, 1]\n";
  expect_input_error([&] { run(block); },
                     {"3 of 3 rigid motions free", "body 'block'", "hold it by cables or contact"});
  expect_input_error([&] { run(block + ground); }, {"body 'block'", "rigid motions free"});
  // A wedge in a groove of its own angle, 0.3 mm below.
  std::string wedge = replaced(
      block,
      "geometry = { kind = \"rectangle\", size = [\"8 mm\", \"6 mm\"], region = \"nylon\" }\nmesh = { cells = [4, 3] }",
      "geometry = { kind = \"polygons\", polygon = [{ region = \"nylon\", x = [\"0 mm\", \"8 mm\", \"-8 mm\"], y = "
      "[\"0 mm\", "
      "\"8 mm\", \"8 mm\"], edges = [\"\", \"\", \"\"] }] }\nmesh = { size = \"4 mm\" }");
  const Finished r =
      run(wedge +
          "[contact]\ngap = \"0.01 mm\"\n[[contact.ground]]\npoint = [\"0 mm\", \"-0.3 mm\"]\nnormal = [1, 1]\n"
          "[[contact.ground]]\npoint = [\"0 mm\", \"-0.3 mm\"]\nnormal = [-1, 1]\n");
  ASSERT_EQ(r.result.failure, "");
  EXPECT_NEAR(channel(r, "y").back(), -0.3e-3, 2e-5) << "within the contact gap";
}

struct Wrong {
  std::string what, from, to;
  std::vector<std::string> parts;
};

class WrongSimulation : public testing::TestWithParam<Wrong> {};

TEST_P(WrongSimulation, IsRefusedWithOneClearSentence) {
  const Wrong& wrong = GetParam();
  const TemporaryFolder folder;
  const std::string path = folder.write("experiment.toml", replaced(robot_toml, wrong.from, wrong.to));
  std::vector<std::string> parts = wrong.parts;
  parts.push_back(path);
  expect_input_error([&] { make_robot(read_simulation(path)); }, parts);
}

const std::vector<Wrong> mistakes{
    {"joint point outside its body",
     "at = [\"2 mm\", \"0 mm\"]",
     "at = [\"-20 mm\", \"0 mm\"]",
     {"[[joint]] 'shoulder'", "20 mm outside 'arm'"}},
    {"cable through no body",
     "y = [\"5 mm\", \"5 mm\", \"5 mm\"]",
     "y = [\"5 mm\", \"50 mm\", \"5 mm\"]",
     {"[[cable]] 'upper'", "44 mm outside 'arm'"}},
    {"bodies that overlap at rest",
     "at = [\"20 mm\", \"-38 mm\"]",
     "at = [\"20 mm\", \"-8 mm\"]",
     {"[contact]", "cross each other at rest"}},
    {"a body behind the ground",
     "at = [\"20 mm\", \"-38 mm\"]",
     "at = [\"20 mm\", \"-42 mm\"]",
     {"[contact]", "cross each other at rest"}},
    {"a negative mass", "value = \"2 g\"", "value = \"-2 g\"", {"[load] value", "negative"}},
    {"a negative density",
     "density = \"100 kg/m3\"",
     "density = \"-100 kg/m3\"",
     {"[materials.foam] density", "positive"}},
    {"a negative mass by a control",
     "value = \"2 g\"",
     "control = \"weight\"\n\n[[control]]\nid = \"weight\"\nstart = \"2 g\"\n[[control.piece]]\nuntil = \"20 ms\"\nto "
     "= "
     "\"-2 g\"",
     {"negative"}},
    {"a plot of nothing",
     "y = [\"tip_turn\"]",
     "y = [\"tip_trun\"]",
     {"[plot]", "'tip_trun'", "did you mean 'tip_turn'"}},
    {"a control that moves nothing",
     "[[load]]",
     "[[control]]\nid = \"idle\"\nstart = \"0 mm\"\n\n[[load]]",
     {"'idle'", "moves nothing"}},
    {"a body inside another", "at = [\"20 mm\", \"-38 mm\"]", "at = [\"20 mm\", \"-4 mm\"]", {"'block'", "inside"}},
    {"a period of zero",
     "kind = \"linear\"\nto = \"20 deg\"",
     "kind = \"sine\"\namplitude = \"2 deg\"\nperiod = \"0 s\"",
     {"period", "positive"}},
    {"steps without end", "duration = \"40 ms\"", "duration = \"1000000000 s\"", {"duration", "steps"}},
    {"NaN in a schedule", "to = \"20 deg\"", "to = \"nan deg\"", {"nan"}},
    {"NaN start", "start = \"0 mm\"", "start = \"nan mm\"", {"nan"}},
    {"pieces out of order",
     "until = \"40 ms\"\nto = \"3 mm\"",
     "until = \"-1 ms\"\nto = \"3 mm\"",
     {"until", "does not end after"}},
    {"an angle that retracts",
     "retraction = \"pull\"",
     "retraction = \"motor\"",
     {"retraction", "'motor' is not a length"}},
    {"a control that is not there", "angle = \"motor\"", "angle = \"moter\"", {"'moter'", "did you mean 'motor'"}},
    {"a body that is not there",
     "between = [\"world\", \"arm\"]",
     "between = [\"world\", \"amr\"]",
     {"'amr'", "did you mean 'arm'"}},
    {"a joint with itself", "between = [\"world\", \"arm\"]", "between = [\"arm\", \"arm\"]", {"two different bodies"}},
    {"an unknown tag",
     "of = \"arm.xmax\"\ndirection",
     "of = \"arm.xmx\"\ndirection",
     {"[[channel]] 'tip_y'", "arm.xmx"}},
    {"a region without material", "[materials.rubber]", "[materials.robber]", {"robber"}},
    {"no density", "density = \"100 kg/m3\"\n", "", {"[materials.foam]", "density"}},
    {"a step longer than the run", "step = \"2 ms\"", "step = \"2 s\"", {"step", "not longer than the duration"}},
    {"a gap larger than distances at rest",
     "gap = \"0.3 mm\"",
     "gap = \"5 mm\"",
     {"[contact]", "larger than the smallest"}},
    {"an unknown integrator",
     "integrator = \"implicit_euler\"",
     "integrator = \"euler\"",
     {"integrator", "euler", "bdf2"}},
    {"a misspelt key", "description = \"For tests.\"", "descripton = \"For tests.\"", {"unknown key 'descripton'"}},
    {"two of one id", "id = \"tip_turn\"", "id = \"tip_y\"", {"'tip_y' is used twice"}},
    {"damping of no material", "[damping.foam]", "[damping.fome]", {"[damping.fome]", "did you mean 'foam'"}},
    {"a reaction over time",
     "kind = \"net_force\"\nof = \"block\"",
     "kind = \"reaction\"\nof = \"arm.xmin\"",
     {"[channel] kind", "equilibrium", "static"}},
    {"a speed in mm",
     "velocity = [\"0 m/s\", \"-0.5 m/s\"]",
     "velocity = [\"0 m/s\", \"-5 mm\"]",
     {"velocity", "speed"}},
};
INSTANTIATE_TEST_SUITE_P(All, WrongSimulation, testing::ValuesIn(mistakes), [](const auto& wrong) {
  std::string name = wrong.param.what;
  for (char& c : name) c = std::isalnum(static_cast<unsigned char>(c)) != 0 ? c : '_';
  return name;
});

/// The small robot, by this integrator, and its block held where it does not fall.
std::pair<Simulation, Robot> small_robot(const std::string& integrator, bool falling) {
  std::string toml = replaced(robot_toml, "\"implicit_euler\"", "\"" + integrator + "\"");
  if (!falling)
    toml = without_net_force(replaced(toml, "velocity = [\"0 m/s\", \"-0.5 m/s\"]", "clamped = [\"ymin\"]"));
  const TemporaryFolder folder;
  std::pair<Simulation, Robot> made;
  made.first = read_simulation(folder.write("experiment.toml", toml));
  made.second = make_robot(made.first);
  return made;
}

TEST(Simulate, DerivativesOfAllReadingsAreTheSlopesOfWholeRunsAndTheGoalsGradientIsThem) {
  for (const std::string integrator : {"implicit_euler", "bdf2", "static"}) {
    auto [simulation, robot] = small_robot(integrator, integrator == "implicit_euler");
    simulation.equilibrium.step_tolerance =
        1e-13;  // a force over a time step is a difference of places over its square
    const ParameterTable& table = robot.scene.model->parameters();
    // Changes that do not leave a state under its weight as it is.
    const std::vector<std::pair<const char*, double>> moved{
        {"E_foam", 1}, {"E_rubber", -1}, {"k_upper", 0.5}, {"tip_mass", -1}};
    SimulateOptions options;
    Eigen::VectorXd change(moved.size());
    for (size_t j = 0; j < moved.size(); ++j) {
      const int index = table.index(moved[j].first);
      options.sensitivities.parameters.push_back(index);
      change[static_cast<Eigen::Index>(j)] = 1e-4 * moved[j].second * robot.scene.values[index];
    }
    options.sensitivities.all_readings = true;
    options.sensitivities.goals = {{0, 0.04}};
    const SimulationResult here = simulate(simulation, robot, options);
    ASSERT_EQ(here.failure, "");
    ASSERT_EQ(here.derivatives.size(), here.times.size());
    const auto readings = [&](double sign) {
      Robot other = make_robot(simulation);
      for (size_t j = 0; j < moved.size(); ++j)
        other.scene.values[options.sensitivities.parameters[j]] += sign * change[static_cast<Eigen::Index>(j)];
      return simulate(simulation, other).readings;
    };
    const auto more = readings(1), less = readings(-1);
    for (size_t k = 0; k < more.size(); ++k) {
      double largest = 0;
      for (size_t i = 0; i < here.times.size(); ++i) {
        const Eigen::RowVectorXd row = here.derivatives[i].row(static_cast<Eigen::Index>(k));
        const double size = row.cwiseAbs().dot(change.cwiseAbs());
        largest = std::max(largest, size);
        EXPECT_NEAR(row.dot(change), 0.5 * (more[k][i] - less[k][i]), 1e-5 * size + 1e-14)
            << integrator << ": " << robot.readings[k].id << " at " << here.times[i] << " s";
      }
      EXPECT_GT(largest, 3e-11) << integrator << ": " << robot.readings[k].id;
    }
    ASSERT_EQ(here.goal_samples, std::vector{here.times.size() - 1});
    const Eigen::VectorXd forward = here.derivatives.back().row(0).transpose();
    for (Eigen::Index j = 0; j < forward.size(); ++j)
      EXPECT_NEAR(here.goal_gradient[j], forward[j], 1e-6 * std::abs(forward[j]))
          << integrator << ": " << moved[j].first;
  }
}

TEST(Simulate, SensitivitiesThatThereAreNoneOfAreRefused) {
  SimulateOptions options;
  options.sensitivities.parameters = {0};
  options.sensitivities.all_readings = true;
  auto [explicitly, robot] = small_robot("cvode", false);
  expect_input_error([&] { simulate(explicitly, robot, options); }, {"no sensitivities", "\"implicit_euler\""});
  auto [simulation, falling] = small_robot("implicit_euler", true);
  const auto net = std::ranges::find(falling.readings, "block_force", &SceneReading::id) - falling.readings.begin();
  options.sensitivities.goals = {{static_cast<size_t>(net), 0.02}};
  expect_input_error([&] { simulate(simulation, falling, options); }, {"'block_force' is a net force", "no goal"});
}

TEST(Simulate, AnInterruptedRunKeepsWhatWasFinished) {
  for (const std::string integrator : {"implicit_euler", "cvode", "static"}) {
    const auto [simulation, robot] = small_robot(integrator, false);
    std::atomic<bool> stop = false;
    SimulateOptions options;
    options.stop = &stop;
    options.progress = [&](double t, const SimulationResult& so_far) {
      EXPECT_EQ(so_far.times.back(), t);
      stop = t > 0.009;
    };
    const SimulationResult result = simulate(simulation, robot, options);
    EXPECT_TRUE(result.interrupted) << integrator;
    // Of equilibria the one that was not found is named.
    const std::string where = integrator == "static" ? "12 ms" : "10 ms";
    EXPECT_TRUE(result.failure.starts_with("stopped at " + where + ": interrupted")) << result.failure;
    ASSERT_EQ(result.times.size(), 6u) << integrator;
    EXPECT_EQ(result.readings[0].size(), 6u);
    EXPECT_NEAR(result.times.back(), 0.01, 1e-12);
  }
}

TEST(Simulate, WithoutAnEquilibriumToStartFromItSaysSo) {
  auto [simulation, robot] = small_robot("implicit_euler", false);
  simulation.from_equilibrium = true;
  EXPECT_EQ(simulate(simulation, robot).failure, "");
  simulation.equilibrium.max_iterations = 1;
  simulation.equilibrium.max_halvings = 0;
  const SimulationResult result = simulate(simulation, robot);
  EXPECT_TRUE(result.failure.starts_with("there is no equilibrium to start from: ")) << result.failure;
  EXPECT_FALSE(result.interrupted);
}

TEST(Workspace, ControlsGoToAndFroInTimesOfTheirOwnDwellAtTheirEndsAndMoveByNoMoreThanAnEighth) {
  // Two bars, each shortened by its own tendon in proportion to its tension: a channel says where a control is.
  std::string toml = R"(title = "Two bars"
[simulation]
duration = "1 ms"
step = "1 ms"
thickness = "10 mm"
[materials.rubber]
law = "neo_hookean"
E = "1 GPa"
nu = 0
density = "1000 kg/m3"
)";
  for (const std::string name : {"a", "b"}) {
    toml += fmt::format(R"([[body]]
name = "{0}"
geometry = {{ kind = "rectangle", size = ["20 mm", "10 mm"], region = "rubber" }}
mesh = {{ cells = [2, 1], element = "linear" }}
at = ["0 mm", "{1} mm"]
clamped = ["xmin"]
[[control]]
id = "{0}"
start = "0 N"
[[cable]]
id = "{0}_tendon"
body = "{0}"
x = ["0 mm", "20 mm"]
y = ["5 mm", "5 mm"]
tension = "{0}"
[[channel]]
id = "{0}_end"
kind = "displacement"
of = "{0}.xmax"
direction = [-1, 0]
)",
                        name, name == "a" ? 0 : 30);
  }
  toml += R"([workspace]
x = "a_end"
y = "b_end"
samples = 480
[[workspace.mode]]
name = "both"
a = ["1 N", "3 N"]
b = ["2 N", "1 N"]
)";
  const TemporaryFolder folder;
  const Simulation simulation = read_simulation(folder.write("experiment.toml", toml));
  const Robot robot = make_robot(simulation);
  const WorkspaceResult result = sample_workspaces(simulation, robot).front();
  EXPECT_EQ(result.failures, 0);
  ASSERT_EQ(result.points.size(), 482u);
  const Eigen::Vector2d upper = result.points[0], lower = result.points[1];
  EXPECT_NEAR(upper[0] / lower[0], 3, 1e-3);
  EXPECT_NEAR(upper[1] / lower[1], 0.5, 1e-3);
  double turns[2];
  for (int k : {0, 1}) {
    const auto at = [&](size_t i) { return (result.points[i][k] - lower[k]) / (upper[k] - lower[k]); };
    int ends[2] = {0, 0}, crossings = 0;
    size_t first = 0, last = 0;
    double fastest = 0;
    for (size_t i = 2; i < 482; ++i) {
      EXPECT_NEAR(at(i), 0.5, 0.501);
      ends[0] += at(i) < 1e-3;
      ends[1] += at(i) > 0.999;
      if (i == 2) continue;
      fastest = std::max(fastest, std::abs(at(i) - at(i - 1)));
      if ((at(i) - 0.5) * (at(i - 1) - 0.5) >= 0) continue;
      if (++crossings == 1) first = i;
      last = i;
    }
    EXPECT_LT(fastest, 0.126);
    EXPECT_GT(ends[0], 60);
    EXPECT_GT(ends[1], 60);
    turns[k] = 0.5 * (crossings - 1) / static_cast<double>(last - first);
  }
  EXPECT_NEAR(turns[1] / turns[0], std::sqrt(3.0 / 2), 0.02) << "primes 2 and 3";
}

}  // namespace
}  // namespace taut

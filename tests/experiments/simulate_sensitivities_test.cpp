#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "tests/support/command.hpp"
#include "tests/support/small_robot.hpp"

// `taut simulate --sensitivities --goal` against finite differences of whole commands: the parameters are changed in
// copies of the file.
namespace taut {
namespace {

using namespace test;
using nlohmann::json;

/// A number of the file and the parameter that it is.
struct Entry {
  std::string parameter;
  std::string before, unit;  ///< what stands before the number, which ends in its unit
  double value, factor;      ///< in that unit, and its SI value
  double weight;             ///< of its change: were all changed alike, a state under its weight would stay
};

/// The file with each entry moved by its weight times this fraction of its value.
std::string moved(std::string toml, const std::vector<Entry>& entries, double change) {
  for (const Entry& entry : entries) {
    const auto text = [&](double value) { return entry.before + json(value).dump() + " " + entry.unit + "\""; };
    const std::string from = entry.before + json(entry.value).dump() + " " + entry.unit + "\"";
    toml = replaced(toml, from, text(entry.value * (1 + entry.weight * change)));
  }
  return toml;
}

json simulated(const TemporaryFolder& folder, const std::string& toml, const std::vector<std::string>& more = {}) {
  folder.write("robot.toml", toml);
  std::vector<std::string> arguments{"simulate", "robot.toml", "--json", "-q"};
  arguments.insert(arguments.end(), more.begin(), more.end());
  const Outcome run = run_in(folder / "", arguments);
  EXPECT_EQ(run.code, 0) << run.err;
  return run.code == 0 ? json::parse(run.out) : json();
}

const std::vector<Entry> entries{
    {"E_foam", "[materials.foam]\nlaw = \"neo_hookean\"\nE = \"", "kPa", 100.5, 1e3, 1},
    {"E_rubber", "[materials.rubber]\nlaw = \"neo_hookean\"\nE = \"", "kPa", 200.5, 1e3, -1},
    {"density_foam", "nu = 0.3\ndensity = \"", "kg/m3", 100.5, 1, -0.5},
    {"k_upper", "k = \"", "N/mm", 2.5, 1e3, 0.5},
    {"tip_mass", "value = \"", "g", 2.5, 1e-3, -1}};

/// The small robot with numbers that can be moved, and contact pressures that do not move with them.
std::string scene(const std::string& integrator) {
  std::string toml = replaced(robot_toml, "\"100 kPa\"", "\"100.5 kPa\"");
  toml = replaced(toml, "\"200 kPa\"", "\"200.5 kPa\"");
  toml = replaced(toml, "\"100 kg/m3\"", "\"100.5 kg/m3\"");
  toml = replaced(toml, "\"2 N/mm\"", "\"2.5 N/mm\"");
  toml = replaced(toml, "\"2 g\"", "\"2.5 g\"");
  toml = replaced(toml, "gap = \"0.3 mm\"\n",
                  "gap = \"0.3 mm\"\n[contact.pressure]\nfoam = \"100 kPa\"\nrubber = \"200 kPa\"\n");
  return replaced(toml, "integrator = \"implicit_euler\"", integrator);
}

/// The same without the block that falls: no net force, and an equilibrium to start from.
std::string resting_scene(const std::string& integrator) {
  const std::string toml = replaced(scene(integrator), "velocity = [\"0 m/s\", \"-0.5 m/s\"]", "clamped = [\"ymin\"]");
  return replaced(
      toml, "[[channel]]\nid = \"block_force\"\nkind = \"net_force\"\nof = \"block\"\ndirection = [0, 1]\n\n", "");
}

/// Derivatives of all channels at the end, along a change of all entries, are those of the
/// commands' own numbers; the goal's gradient is the forward one.
void expect_sensitivities(const std::string& toml) {
  const TemporaryFolder folder;
  std::string wrt;
  for (const Entry& entry : entries) wrt += (wrt.empty() ? "" : ",") + entry.parameter;
  const json here = simulated(folder, toml, {"--sensitivities", "--goal", "tip_y", "--wrt", wrt});
  const double change = 3e-4;
  const json more = simulated(folder, moved(toml, entries, change)),
             less = simulated(folder, moved(toml, entries, -change));
  ASSERT_TRUE(here.contains("sensitivities") && here.contains("goal") && !more.is_null() && !less.is_null());
  for (const auto& [id, channel] : here["channels"].items()) {
    if (id.ends_with("_energy")) continue;
    double expected = (more["channels"][id]["end"].get<double>() - less["channels"][id]["end"].get<double>()) / 2,
           along = 0, size = 0;
    for (const Entry& entry : entries) {
      const json& derivative = here["sensitivities"]["channels"][id][entry.parameter];
      const double part =
          derivative["values"].back().get<double>() * entry.value * entry.factor * entry.weight * change;
      along += part;
      size += std::abs(part);
    }
    ASSERT_GT(size, 0) << id;
    EXPECT_NEAR(along, expected, 1e-6 * size) << id;
    EXPECT_EQ(here["sensitivities"]["channels"][id]["E_foam"]["unit"], channel["unit"].get<std::string>() + "/Pa");
  }
  for (const Entry& entry : entries) {
    const double forward = here["sensitivities"]["channels"]["tip_y"][entry.parameter]["values"].back();
    EXPECT_NEAR(here["goal"]["gradient"][entry.parameter]["derivative"], forward, 1e-6 * std::abs(forward))
        << entry.parameter;
  }
}

TEST(SimulateSensitivities, OfImplicitEulerDuringAnImpactAreThoseOfWholeCommands) {
  // The block has met the ground and is still pushed off at the end.
  const std::string toml =
      replaced(scene("integrator = \"implicit_euler\""), "\"40 ms\"\nstep = \"2 ms\"", "\"6 ms\"\nstep = \"1 ms\"");
  const TemporaryFolder folder;
  EXPECT_GT(simulated(folder, toml)["channels"]["block_force"]["end"], 0.01);
  expect_sensitivities(toml);
}

TEST(SimulateSensitivities, OfBdf2FromAnEquilibriumAreThoseOfWholeCommands) {
  expect_sensitivities(resting_scene("integrator = \"bdf2\"\nstart = \"equilibrium\""));
}

TEST(SimulateSensitivities, OfEquilibriaAreThoseOfWholeCommands) {
  expect_sensitivities(resting_scene("integrator = \"static\""));
}

TEST(SimulateSensitivities, AControlIsAnOffsetOfItsWholeScheduleAndAGoalMayStandInTheMiddle) {
  const TemporaryFolder folder;
  const std::string toml = resting_scene("integrator = \"bdf2\"");
  const json here = simulated(folder, toml, {"--sensitivities", "--goal", "tension@20 ms", "--wrt", "pull"});
  const std::string csv = text_of(folder / "runs/robot/sensitivities.csv");  // the next run takes its place
  ASSERT_TRUE(here.contains("goal"));
  EXPECT_EQ(here["goal"]["unit"], "N");
  EXPECT_EQ(here["goal"]["gradient"]["pull"]["unit"], "N/m");
  const json& times = here["sensitivities"]["time_s"];
  const auto middle =
      static_cast<size_t>(std::find(times.begin(), times.end(), here["goal"]["time_s"]) - times.begin());
  ASSERT_EQ(middle, 10u);
  const json& values = here["sensitivities"]["channels"]["tension"]["pull"]["values"];
  EXPECT_EQ(values.size(), 21u);
  const double forward = values[middle], adjoint = here["goal"]["gradient"]["pull"]["derivative"];
  EXPECT_NEAR(adjoint, forward, 1e-6 * std::abs(forward));
  const auto offset = [&](double mm) {
    std::string changed =
        replaced(toml, "id = \"pull\"\nstart = \"0 mm\"", "id = \"pull\"\nstart = \"" + json(mm).dump() + " mm\"");
    changed = replaced(changed, "to = \"3 mm\"", "to = \"" + json(3 + mm).dump() + " mm\"");
    return simulated(folder, changed)["channels"]["tension"]["end"].get<double>();
  };
  const double slope = (offset(2e-4) - offset(-2e-4)) / 4e-7, end = values.back();
  EXPECT_NEAR(end, slope, 1e-4 * std::abs(slope));
  EXPECT_TRUE(csv.starts_with("time_s,d_tip_y_d_pull_1,d_tip_turn_d_pull_rad_per_m,d_tension_d_pull_N_per_m")) << csv;
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 22);
}

TEST(SimulateSensitivities, WrongRequestsAreSentencesOfTheirOwn) {
  const TemporaryFolder folder;
  const auto refused = [&](const std::string& toml, const std::vector<std::string>& more,
                           const std::vector<std::string>& parts) {
    folder.write("robot.toml", toml);
    std::vector<std::string> arguments{"simulate", "robot.toml", "-q"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    const Outcome run = run_in(folder / "", arguments);
    EXPECT_EQ(run.code, 2) << run.out;
    expect_holds(run.err, parts);
  };
  refused(robot_toml, {"--wrt", "E_foam"}, {"--wrt", "--sensitivities", "--goal"});
  refused(robot_toml, {"--sensitivities", "--wrt", "E_foma"}, {"unknown parameter 'E_foma'", "did you mean 'E_foam'"});
  refused(robot_toml, {"--goal", "tip"}, {"no channel 'tip'", "tip_y"});
  refused(robot_toml, {"--goal", "tip_y@1 s"}, {"not within the simulation", "40 ms"});
  refused(robot_toml, {"--goal", "block_force"}, {"robot.toml", "net force", "forward"});
  refused(resting_scene("integrator = \"cvode\""), {"--sensitivities"},
          {"SUNDIALS", "implicit_euler", "bdf2", "static"});
}

}  // namespace
}  // namespace taut

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <sstream>

#include "tests/support/command.hpp"
#include "tests/support/experiment_files.hpp"

// `taut export`: chains of hinges against beams and against replays, and the files in the simulators that they are for.
// Those come by `experiments/install simulators`; without them the tests that load files are skipped.
namespace taut {
namespace {

using namespace test;
using nlohmann::json;

const std::string kPackages = TAUT_SOURCE_DIR "/build/simulators/node_modules";

/// Output of a shell command and its exit status.
Outcome shell(const std::string& command) {
  Outcome outcome;
  FILE* pipe = popen((command + " 2>&1").c_str(), "r");
  std::array<char, 4096> block{};
  while (const size_t n = fread(block.data(), 1, block.size(), pipe)) outcome.out.append(block.data(), n);
  outcome.code = pclose(pipe);
  return outcome;
}

bool has_mujoco() {
  return std::filesystem::exists(kPackages + "/mujoco-js") && shell("node --version").code == 0;
}
const char* const kNoMujoco = "MuJoCo is not installed: experiments/install simulators";

/// Where the watched point comes to rest in MuJoCo under these forces, from where it is without [m].
std::vector<double> in_mujoco(const std::string& states, size_t state, const std::vector<double>& forces) {
  std::string command =
      fmt::format("node '{}/tests/support/mujoco_statics.mjs' '{}' '{}' {}", TAUT_SOURCE_DIR, kPackages, states, state);
  for (const double force : forces) command += fmt::format(" {:.17g}", force);
  const Outcome outcome = shell(command);
  EXPECT_EQ(outcome.code, 0) << outcome.out;
  std::vector<double> moved;
  if (outcome.code == 0) {
    const json found = json::parse(outcome.out);
    for (const json& one : found.at("moved")) moved.push_back(one.at("displacement").get<double>());
  }
  return moved;
}

/// Where the watched point is without a force [m].
std::vector<double> rest_in_mujoco(const std::string& states) {
  const Outcome outcome =
      shell(fmt::format("node '{}/tests/support/mujoco_statics.mjs' '{}' '{}' 0", TAUT_SOURCE_DIR, kPackages, states));
  EXPECT_EQ(outcome.code, 0) << outcome.out;
  return json::parse(outcome.out).at("rest").get<std::vector<double>>();
}

/// The file in MuJoCo stands where the chain's own statics has it (but for a nanometre, at which steps end), and where
/// the replay has it within what was printed.
void expect_same_in_mujoco(const std::string& states) {
  const json all = json::parse(text_of(states));
  for (size_t k = 0; k < all.at("states").size(); ++k) {
    const json& state = all.at("states")[k];
    const auto forces = state.at("forces_N").get<std::vector<double>>();
    const auto chain = state.at("chain_m").get<std::vector<double>>();
    const auto replay = state.at("replay_m").get<std::vector<double>>();
    const double difference = state.at("largest_difference").get<double>();
    const std::vector<double> moved = in_mujoco(states, k, forces);
    ASSERT_EQ(moved.size(), forces.size());
    for (size_t i = 0; i < forces.size(); ++i) {
      EXPECT_NEAR(moved[i], chain[i], 1e-6 * std::abs(chain[i]) + 1e-9) << state.at("file") << " at " << forces[i];
      EXPECT_NEAR(moved[i], replay[i], (difference + 1e-6) * std::abs(replay[i])) << state.at("file");
    }
  }
}

/// A fitted beam, 60 x 12 x 20 mm of foam, and files of it.
class Export : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new TemporaryFolder;
    folder_->write("beam.toml", beam_toml);
    folder_->write("bench.csv", "trial,pull_N,tip_mm\na,0.02,1\na,0.04,2.1\nb,0.02,1.1\nb,0.04,2\n");
    done_in(*folder_ / "", {"fit", "beam.toml", "--quiet", "--out", "run"});
    E_ = json::parse(text_of(*folder_ / "run/fit.json")).at("parameters")[0].at("value").get<double>();
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }
  static Outcome exported(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), {"export", "run", "--quiet"});
    return run_in(*folder_ / "", arguments);
  }
  static TemporaryFolder* folder_;
  static double E_;
};
TemporaryFolder* Export::folder_ = nullptr;
double Export::E_ = 0;

/// Timoshenko's cantilever in plane strain drops by F (L^3 / 3 EI + L / kappa G A), ten hinges by F sum l^2 / k.
TEST_F(Export, TheHingesOfABeamHaveTheStiffnessOfItsPieces) {
  const Outcome outcome = exported({"--to", "mujoco", "--largest", "1 mN", "--out", "small", "--json"});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const double L = 60e-3, h = 12e-3, b = 20e-3, nu = 0.3;
  const double EI = E_ / (1 - nu * nu) * b * h * h * h / 12, GA = E_ / (2 * (1 + nu)) * b * h;
  const double per_newton = L * L * L / (3 * EI) + L / (5.0 / 6 * GA);
  double levers = 0;
  for (int i = 0; i < 10; ++i) levers += std::pow(L * (i + 0.5) / 10, 2);
  const json state = json::parse(outcome.out).at("exported").at("states")[0];
  EXPECT_NEAR(state.at("hinge_stiffness_Nm_per_rad").get<double>(), levers / per_newton, 0.02 * levers / per_newton);
  EXPECT_LT(state.at("largest_difference").get<double>(), 1e-3);  // linear, as a chain is
  ASSERT_EQ(state.at("hinges_m").size(), 10u);
  for (int i = 0; i < 10; ++i) {
    EXPECT_NEAR(state.at("hinges_m")[static_cast<size_t>(i)][0].get<double>(), L * (i + 0.5) / 10, 1e-9);
    EXPECT_NEAR(state.at("hinges_m")[static_cast<size_t>(i)][2].get<double>(), h / 2, 1e-9);  // up is z
  }
  double mass = 0;
  for (const json& segment : state.at("segments")) mass += segment.at("mass_kg").get<double>();
  EXPECT_NEAR(mass, 1000 * L * h * b, 1e-12);  // of the density that is assumed
  EXPECT_EQ(state.at("density_assumed")[0], "foam");
  // Wherever it is cut, the pieces' moments about the middle of the block are the block's, exactly.
  const Eigen::Vector3d middle(L / 2, 0, h / 2);
  Eigen::Vector3d moments = Eigen::Vector3d::Zero();  // about along, across and the normal
  for (const json& segment : state.at("segments")) {
    const auto inertia = segment.at("inertia_kg_m2").get<std::vector<double>>();
    const auto centre = segment.at("centre_m").get<std::vector<double>>();
    const double along = centre[0] - middle.x(), across = centre[2] - middle.z();
    const Eigen::Vector3d steiner(across * across, along * along, along * along + across * across);
    moments += Eigen::Vector3d(inertia.data()) + segment.at("mass_kg").get<double>() * steiner;
  }
  const Eigen::Vector3d block = mass / 12 * Eigen::Vector3d(h * h + b * b, L * L + b * b, L * L + h * h);
  EXPECT_LT((moments - block).norm(), 1e-12 * block.norm()) << moments.transpose() << " and " << block.transpose();
}

TEST_F(Export, MuJoCoStandsWhereTheReplayDoesWithinWhatWasSaid) {
  if (!has_mujoco()) GTEST_SKIP() << kNoMujoco;
  const Outcome outcome = exported({"--to", "mujoco", "--largest", "0.1 N", "--out", "mujoco"});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  expect_holds(outcome.out, {"SIMULATED DATA", "run.xml: 10 hinges of ", "follows the replay of tip to within "});
  expect_holds(text_of(*folder_ / "mujoco/run.xml"),
               {"SIMULATED DATA", "follows taut's replay to within", "Assumed, not measured: damping"});
  expect_same_in_mujoco(*folder_ / "mujoco/hinges.json");
}

/// MuJoCo reads URDF too; stiffness is set after loading, as the file says.
TEST_F(Export, AUrdfStandsWhereTheReplayDoesOnceItsStiffnessIsSet) {
  if (!has_mujoco()) GTEST_SKIP() << kNoMujoco;
  const Outcome outcome = exported({"--to", "urdf", "--hinges", "6", "--out", "urdf"});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  expect_holds(outcome.out, {"URDF has no stiffness of joints"});
  expect_same_in_mujoco(*folder_ / "urdf/hinges.json");
}

TEST_F(Export, TheUrdfIsOneForItsOwnParser) {
  if (shell("command -v check_urdf").code != 0)
    GTEST_SKIP() << "check_urdf is not installed: experiments/install simulators";
  ASSERT_EQ(exported({"--to", "urdf", "--hinges", "3", "--out", "parsed"}).code, 0);
  const Outcome parsed = shell("check_urdf '" + *folder_ / "parsed/run.urdf" + "'");
  EXPECT_EQ(parsed.code, 0) << parsed.out;
  expect_holds(parsed.out, {"Successfully Parsed", "child(1):  segment_3", "load", "watched"});
}

TEST_F(Export, WrongInputGetsOneSentence) {
  const auto refuses = [&](const std::vector<std::string>& arguments, const std::string& why) {
    const Outcome outcome = exported(arguments);
    EXPECT_EQ(outcome.code, 2) << why;
    expect_holds(outcome.err, {why});
  };
  refuses({}, "--to is missing; say what for: table, mujoco or urdf");
  refuses({"--to", "gazebo"}, "--to 'gazebo' is unknown");
  refuses({"--to", "mujoco", "--retraction", "3 mm"}, "no cable of run is retracted");
  refuses({"--to", "mujoco", "--channel", "top"}, "'top' is no channel (did you mean 'tip'?)");
  refuses({"--to", "mujoco", "--hinges", "0"}, "--hinges: a whole number from 1 to 1000");
  refuses({"--to", "mujoco", "--hinges", "500"}, "500 hinges are more than the mesh resolves");
  refuses({"--to", "mujoco", "--largest", "0 N"}, "--largest: pull is to be loaded with something");
  refuses({"--to", "table"}, "nothing to tune or map");
}

/// A box in space that is held at its far end and sags under its own weight.
const char* const kHeavy = R"(title = "A heavy beam"
data = "simulated"

[geometry]
kind = "box"
size = ["100 mm", "20 mm", "10 mm"]
region = "foam"

[mesh]
cells = [10, 2, 2]
element = "quadratic"

[materials.foam]
law = "neo_hookean"
E = "500 kPa"
nu = 0.3
density = "900 kg/m3"

[gravity]
direction = [0, 0, -1]

[[support]]
on = "xmax"
fix = ["x", "y", "z"]

[[load]]
id = "pull"
on = "xmin"
direction = [0, 0, -1]
column = "pull_N"

[[channel]]
id = "tip"
on = "xmin"
direction = [0, 0, -1]
column = "tip_mm"
noise = { absolute = "0.1 mm" }

[bench]
file = "bench.csv"

[fit.free.E_foam]
lower = "1 kPa"
upper = "10 MPa"
)";

/// Sag w L^4 / 8 EI + w L^2 / 2 kappa G A of the weight w per length.
TEST(SlowExport, ABodyInSpaceSagsInMuJoCoAsABeamDoes) {
  const TemporaryFolder folder;
  folder.write("heavy.toml", kHeavy);
  folder.write("bench.csv", "pull_N,tip_mm\n0.02,4.5\n0.04,6.7\n");
  run_in(folder / "", {"fit", "heavy.toml", "--quiet", "--out", "run"});
  const double E = json::parse(text_of(folder / "run/fit.json")).at("parameters")[0].at("value").get<double>();
  const Outcome outcome = run_in(folder / "", {"export", "run", "--to", "mujoco", "--quiet", "--out", "files"});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const json state = json::parse(text_of(folder / "files/hinges.json")).at("states")[0];
  const double L = 100e-3, b = 20e-3, h = 10e-3;
  double mass = 0, moment = 0;
  for (const json& segment : state.at("segments")) {
    mass += segment.at("mass_kg").get<double>();
    moment += segment.at("mass_kg").get<double>() * segment.at("centre_m")[0].get<double>();
  }
  EXPECT_NEAR(mass, 900 * L * b * h, 1e-10);
  EXPECT_NEAR(moment, mass * L / 2, 1e-6 * mass * L);
  EXPECT_TRUE(state.at("density_assumed").empty());
  EXPECT_NEAR(state.at("gravity_m_per_s2")[2].get<double>(), -9.81, 1e-12);
  if (!has_mujoco()) GTEST_SKIP() << kNoMujoco;
  const std::string states = folder / "files/hinges.json";
  expect_same_in_mujoco(states);
  const double weight = 900 * 9.81 * b * h, EI = E * b * h * h * h / 12, GA = E / 2.6 * b * h;
  const double sag = weight * std::pow(L, 4) / (8 * EI) + weight * L * L / (2 * 5.0 / 6 * GA);
  EXPECT_NEAR(h / 2 - rest_in_mujoco(states).at(2), sag, 0.05 * sag);
}

/// The module, with coarse elements and one free parameter.
std::string coarse_module() {
  std::string toml = text_of(TAUT_SOURCE_DIR "/experiments/push_puppet/experiment.toml");
  toml = toml.substr(0, toml.find("[fit]")) +
         "[fit]\n\n[fit.free.E_foam]\nstart = \"60 kPa\"\nlower = \"1 kPa\"\nupper = \"10 MPa\"\n";
  return replaced(toml, "element = \"quadratic\"", "element = \"linear\"");
}

/// One cable is longer than the other, so that retraction bends the module.
TEST(SlowExport, SegmentsOfABentModuleLieAlongTheLinesBetweenTheirHinges) {
  std::string toml = coarse_module();
  toml = replaced(toml, toml.substr(toml.find("[cables]"), toml.find("[[load]]") - toml.find("[cables]")),
                  "[cables]\nretraction = \"retraction_mm\"\n"
                  "[[cables.cable]]\nid = \"upper\"\nk = \"10 kN/m\"\nslack = \"0 mm\"\n"
                  "[[cables.cable]]\nid = \"lower\"\nk = \"10 kN/m\"\nslack = \"2 mm\"\n\n");
  const TemporaryFolder folder;
  folder.write("module.toml", replaced(toml, "../../data/push_puppet_synthetic/", ""));
  folder.write("bench.csv", "trial,retraction_mm,mass_g,tip_displacement_mm\na,5,50,2\na,5,100,4\n");
  done_in(folder / "", {"fit", "module.toml", "--no-variants", "--quiet", "--out", "run"});
  done_in(folder / "", {"export", "run", "--to", "mujoco", "--quiet", "--largest", "50 g", "--out", "files"});
  const json state = json::parse(text_of(folder / "files/hinges.json")).at("states")[0];
  const std::string xml = text_of(folder / "files/" + state.at("file").get<std::string>());
  const auto hinge = [&](size_t i) { return state.at("hinges_m")[i].get<std::vector<double>>(); };
  double turned = 0;
  size_t at = 0;
  for (size_t i = 0; i < 3; ++i) {  // the tip's segment has one hinge
    at = xml.find("xyaxes=\"", xml.find("<inertial", at)) + 8;
    std::istringstream axes(xml.substr(at, xml.find('"', at) - at));
    double x = 0, y = 0, z = 0;
    axes >> x >> y >> z;
    const std::vector<double> from = hinge(i), to = hinge(i + 1);
    const double line = std::atan2(to[2] - from[2], to[0] - from[0]);
    EXPECT_NEAR(std::atan2(z, x), line, 0.01 * line);
    EXPECT_GT(line, turned + 0.01) << "each cell turns the rest upwards";
    turned = line;
  }
}

TEST(SlowExport, MuJoCoStandsWhereTheModuleDoesAtEachRetraction) {
  const std::string toml = replaced(coarse_module(), "../../data", TAUT_SOURCE_DIR "/data");
  const TemporaryFolder folder;
  folder.write("module.toml", toml);
  run_in(folder / "", {"fit", "module.toml", "--quiet", "--out", "run"});
  const Outcome outcome =
      run_in(folder / "", {"export", "run", "--to", "mujoco", "--quiet", "--largest", "200 g", "--out", "files"});
  ASSERT_EQ(outcome.code, 0) << outcome.err;
  const json states = json::parse(text_of(folder / "files/hinges.json")).at("states");
  ASSERT_EQ(states.size(), 4u);
  const std::string csv = text_of(folder / "files/hinges.csv");
  expect_holds(csv, {"retraction_m,hinge_stiffness_Nm_per_rad", "run_retraction_17.68_mm.xml"});
  double before = 0;
  for (const json& state : states) {
    ASSERT_EQ(state.at("hinges_m").size(), 4u);
    EXPECT_GT(state.at("hinge_stiffness_Nm_per_rad").get<double>(), before);  // retraction stiffens
    before = state.at("hinge_stiffness_Nm_per_rad").get<double>();
  }
  // At rest, but for the tension of a micrometre's stretch while cables go taut, hinges are in the middle of the
  // cells, 11.5 mm wide every 14.5 mm, and the tip is at 58 mm.
  for (size_t i = 0; i < 4; ++i)
    EXPECT_NEAR(states[0].at("hinges_m")[i][0].get<double>(), 5.75e-3 + 14.5e-3 * static_cast<double>(i), 2e-6);
  EXPECT_NEAR(states[0].at("watched_at").at("at_m")[0].get<double>(), 58e-3, 2e-6);
  // Cables take up about their retraction: four cells shorten by it, less the cables' stretch.
  const double tip = states[2].at("watched_at").at("at_m")[0].get<double>();
  EXPECT_LT(tip, 58e-3 - 0.8 * 11.79e-3);
  EXPECT_GT(tip, 58e-3 - 11.79e-3);
  if (!has_mujoco()) GTEST_SKIP() << kNoMujoco;
  expect_same_in_mujoco(folder / "files/hinges.json");
}

}  // namespace
}  // namespace taut

#include <gtest/gtest.h>

#include <cmath>

#include "calib/models/ladder.hpp"
#include "sim/files/simulation.hpp"
#include "sim/robots/robot.hpp"
#include "tests/support/message.hpp"
#include "tests/support/static_bench.hpp"

// The push-puppet module in space on a bench: its symmetries, its parts, its stiffnesses.
namespace taut::test {
namespace {

/// What of a bench differs from test to test.
struct Module3d {
  std::string geometry;  ///< further keys
  std::string mesh = "size = \"15 mm\"\nlip_cells = 1\nelement = \"linear\"\n";
  std::string more;  ///< loads, channels and further tables
  std::string from = "unloaded";
  std::string cables = "[cables]\nk = \"20 kN/m\"\nretraction = \"retraction_mm\"\n";
  std::string foam = "E = \"50 kPa\"\nnu = 0.2\n";
};

std::string toml_of(const Module3d& m) {
  return R"(title = "Module in space"
data = "simulated"
[geometry]
kind = "push_puppet_3d"
)" + m.geometry +
         "[mesh]\n" + m.mesh + "[materials.foam]\n" + m.foam + R"([materials.plastic]
E = "2.3 GPa"
nu = 0.35
[[support]]
on = "base"
fix = ["x", "y", "z"]
)" + m.cables +
         m.more + "[bench]\nfile = \"bench.csv\"\nmeasured_from = \"" + m.from + "\"\n[fit.free.E_foam]\n";
}

std::string load(const std::string& id, const std::string& on, const std::string& direction,
                 const std::string& column = "load_N") {
  return "[[load]]\nid = \"" + id + "\"\non = \"" + on + "\"\ndirection = " + direction + "\ncolumn = \"" + column +
         "\"\n";
}

std::string channel(const std::string& id, const std::string& direction, const std::string& on = "tip",
                    const std::string& kind = "displacement") {
  const std::string unit = kind == "rotation" ? "rad" : "mm";
  return "[[channel]]\nid = \"" + id + "\"\nkind = \"" + kind + "\"\non = \"" + on + "\"\ndirection = " + direction +
         "\ncolumn = \"" + id + "_" + unit + "\"\nnoise = { absolute = \"1 " + unit + "\" }\n";
}

const std::string along_x = channel("x", "[-1, 0, 0]"), along_y = channel("y", "[0, 1, 0]"),
                  along_z = channel("z", "[0, 0, 1]");

/// Readings of the channels, line by line of the bench.
Eigen::VectorXd readings(const Module3d& module, const std::string& csv) {
  const TemporaryFolder folder;
  const Experiment e = experiment_in(folder, toml_of(module), csv);
  const StaticReplay bench = bench_of(e);
  Eigen::VectorXd values = predicted(bench).values;
  const BenchModel model = make_model(e, e.mesh, read_trials(e.bench));
  for (const auto& condition : bench.protocol->conditions()) {
    const bool passed = model.intersects && model.intersects(condition.u);
    EXPECT_FALSE(passed) << "lips have passed through each other";
  }
  return values;
}

const std::string two_cells = "cells = 2\ngap_total = \"8.6 mm\"\n";

TEST(Module3d, AllCablesAlikeShortenItWithoutAnyLateralMotion) {
  const Eigen::VectorXd tip = readings({.geometry = two_cells, .more = along_x + along_y + along_z, .from = "rest"},
                                       "retraction_mm,x_mm,y_mm,z_mm\n4,0,0,0\n9,0,0,0\n");
  for (Eigen::Index row : {0, 3}) {
    EXPECT_GT(tip[row], row == 0 ? 3.5e-3 : 8.5e-3);
    EXPECT_LT(std::abs(tip[row + 1]), 1e-9 * tip[row]);
    EXPECT_LT(std::abs(tip[row + 2]), 1e-9 * tip[row]);
  }
  // Closed: gaps in all, and what the plastic gives.
  EXPECT_LT(tip[3], 8.6e-3 + 20e-6);
}

/// Pushed by a force along y and by the same along z, at the same retraction.
void expect_alike_both_ways(const std::string& retraction, double least, double tolerance) {
  const std::string csv = "load_N,retraction_mm,y_mm,z_mm\n0.3," + retraction + ",0,0\n-0.3," + retraction + ",0,0\n";
  Module3d m{.geometry = two_cells, .more = load("push", "tip", "[0, 1, 0]") + along_y + along_z};
  const Eigen::VectorXd by_y = readings(m, csv);
  m.more = load("push", "tip", "[0, 0, 1]") + along_y + along_z;
  const Eigen::VectorXd by_z = readings(m, csv);
  for (Eigen::Index row : {0, 2}) {
    EXPECT_GT(std::abs(by_y[row]), least);
    EXPECT_LT(std::abs(by_y[row]), 10 * least);
    EXPECT_LT(std::abs(by_y[row + 1]), tolerance * std::abs(by_y[row])) << "across the load";
    EXPECT_NEAR(by_z[row + 1] / by_y[row], 1, tolerance) << "y and z exchanged";
    EXPECT_LT(std::abs(by_z[row]), tolerance * std::abs(by_y[row]));
  }
  EXPECT_NEAR(by_y[2] / by_y[0], -1, tolerance) << "the mirror image";
}

TEST(Module3d, LateralLoadsAreAlikeBothWaysAndMirroredOnesMirrorTheAnswer) {
  expect_alike_both_ways("0", 0.1e-3, 1e-9);
}

// A closed module gives 18 micrometres, as a difference of two equilibria that have each come 9 mm: what an equilibrium
// leaves over (some 1e-9 of its way, other on another processor) is up to 1e-6 of the difference.
TEST(SlowModule3d, ClosedTooLateralLoadsAreAlikeBothWays) {
  expect_alike_both_ways("9", 2e-6, 1e-5);
}

/// The part and the whole, pushed along the part's planes of symmetry.
void expect_same_as_whole(const std::string& part, const std::string& direction, const std::string& channels,
                          const std::string& columns, const std::string& rows) {
  const auto of_part = [&](const std::string& one) {
    return readings({.geometry = two_cells + "part = \"" + one + "\"\n",
                     .more = load("push", "tip", direction) + channels +
                             "[[channel]]\nid = \"pull\"\nkind = \"tension\"\nof = \"upper_front\"\n"
                             "column = \"pull_N\"\nnoise = { absolute = \"1 N\" }\n" +
                             "[[channel]]\nid = \"clamp\"\nkind = \"reaction\"\non = \"base\"\ndirection = " +
                             direction + "\ncolumn = \"clamp_N\"\nnoise = { absolute = \"1 N\" }\n",
                     .from = "rest"},
                    "load_N,retraction_mm,pull_N,clamp_N" + columns + rows);
  };
  const Eigen::VectorXd expected = of_part("whole"), values = of_part(part);
  ASSERT_EQ(values.size(), expected.size());
  for (Eigen::Index i = 0; i < values.size(); ++i) EXPECT_NEAR(values[i] / expected[i], 1, 1e-6) << i;
}

TEST(SlowModule3d, AHalfGivesTheNumbersOfTheWhole) {
  expect_same_as_whole("half", "[0, -1, 0]", along_x + along_y, ",x_mm,y_mm\n", "0.2,2,0,0,0,0\n0.2,9,0,0,0,0\n");
}

TEST(SlowModule3d, AQuarterGivesTheNumbersOfTheWhole) {
  expect_same_as_whole("quarter", "[-1, 0, 0]", along_x, ",x_mm\n", "0.2,2,0,0,0\n0.2,9,0,0,0\n");
}

TEST(Module3d, AQuarterCarriesAQuarterOfTheForceAndItsOneCableAllOfItsTension) {
  expect_same_as_whole("quarter", "[-1, 0, 0]", along_x, ",x_mm\n", "0.2,2,0,0,0\n");
}

/// Foam blocks between rigid plates, bent and sheared by a force at the end, in series.
TEST(Module3d, WithoutCablesItIsAsStiffAsFoamBlocksBetweenRigidPlatesInSeries) {
  const double E = 50e3, G = E / 2, a = 30e-3, second = std::pow(a, 4) / 12, end = 58e-3, force = 1e-3;
  double compliance = 0;
  for (int cell = 0; cell < 4; ++cell) {
    const double from_end = end - 14.5e-3 * cell, to_end = from_end - 11.5e-3;
    compliance += (std::pow(from_end, 3) - std::pow(to_end, 3)) / (3 * E * second) + 11.5e-3 / (5.0 / 6 * G * a * a);
  }
  const Eigen::VectorXd tip = readings({.geometry = "part = \"half\"\n",
                                        .mesh = "size = \"8 mm\"\nlip_cells = 1\n",
                                        .more = "[contact]\non = false\n" + load("push", "tip", "[0, 1, 0]") + along_y,
                                        .cables = "",
                                        .foam = "E = \"50 kPa\"\nnu = 0\n"},
                                       "load_N,y_mm\n0.001,0\n");
  EXPECT_NEAR(tip[0] / (force * compliance), 1, 0.03);
}

/// A couple about the axis by two forces; foam blocks in series, whose ends the webs keep from warping in part.
TEST(Module3d, InTorsionItIsBetweenSaintVenantsAndCoulombsFoamBlocks) {
  const double E = 50e3, G = E / 2, a = 30e-3, couple = 2 * 21e-3 * 0.01, length = 2 * 11.5e-3;
  const Eigen::VectorXd turn = readings({.geometry = two_cells,
                                         .mesh = "size = \"8 mm\"\nlip_cells = 1\n",
                                         .more = "[contact]\non = false\n" + load("up", "tip & upper", "[0, 0, 1]") +
                                                 load("down", "tip & lower", "[0, 0, -1]", "other_N") +
                                                 channel("turn", "[1, 0, 0]", "tip", "rotation") + along_y + along_z,
                                         .cables = "",
                                         .foam = "E = \"50 kPa\"\nnu = 0\n"},
                                        "load_N,other_N,turn_rad,y_mm,z_mm\n0.01,0.01,0,0,0\n");
  EXPECT_LT(turn[0], couple * length / (G * 0.1405770 * std::pow(a, 4)));
  EXPECT_GT(turn[0], couple * length / (G * std::pow(a, 4) / 6));
  EXPECT_LT(std::abs(turn[1]) + std::abs(turn[2]), 1e-6 * 20e-3 * turn[0]) << "it turns about its axis";
}

TEST(Module3d, StudsLimitSidewaysTravelToTheirPlay) {
  const std::string csv = "load_N,y_mm,z_mm\n1,0,0\n";
  // Beside the hole's mouth, and as far on the other axis.
  const std::string places =
      "[[channel]]\nid = \"y\"\npoint = [\"7.5 mm\", \"0 mm\", \"20.5 mm\"]\ndirection = [0, 1, 0]\n"
      "column = \"y_mm\"\nnoise = { absolute = \"1 mm\" }\n" +
      along_z;
  const auto pushed = [&](const std::string& studs) {
    return readings({.geometry = "cells = 1\ngap_total = \"2 mm\"\n" + studs,
                     .more = load("push", "tip", "[0, 1, 0]") + places,
                     .cables = ""},
                    csv);
  };
  const Eigen::VectorXd with = pushed("stud_length = \"3 mm\"\nstud_play = \"0.1 mm\"\n"), without = pushed("");
  EXPECT_GT(without[0], 4 * 0.1e-3);
  EXPECT_NEAR(with[0], 0.1e-3, 0.015e-3) << "play, and what tilts and gives";
  EXPECT_LT(std::abs(with[1]), 1e-9 * with[0]);
}

TEST(Module3d, TheLadderTakesRigidSegmentsAndSeesWhatIsClosed) {
  const TemporaryFolder folder;
  Experiment e = experiment_in(
      folder,
      toml_of({.geometry = "cells = 1\ngap_total = \"4.3 mm\"\n", .more = load("push", "tip", "[0, -1, 0]") + along_y}),
      "load_N,retraction_mm,y_mm\n0.1,0,0\n0.1,5,0\n");
  e.model = Rung::automatic;
  const Trials trials = read_trials(e.bench);
  const Ladder ladder = climb(e, trials, bench_of(e));
  ASSERT_EQ(ladder.rows.size(), 2u);
  EXPECT_EQ(ladder.rows[0].rung, Rung::rigid_segments);
  EXPECT_FALSE(ladder.rows[0].closed);
  EXPECT_TRUE(ladder.rows[1].closed);
}

TEST(Module3d, WhatHasNoMirrorImageIsRefusedOnAPart) {
  const TemporaryFolder folder;
  const auto refused = [&](const std::string& part, const std::string& more, const std::vector<std::string>& parts,
                           const std::string& csv = "load_N,retraction_mm,y_mm\n0,0,0\n") {
    expect_input_error(
        [&] {
          bench_of(
              experiment_in(folder, toml_of({.geometry = two_cells + "part = \"" + part + "\"\n", .more = more}), csv));
        },
        parts);
  };
  const std::string push = load("push", "tip", "[0, 1, 0]");
  refused("third", push + along_y, {"experiment.toml:", "part \"third\"", "whole, half, quarter"});
  refused("half", load("push", "tip", "[0, 0, 1]") + along_y,
          {"[[load]] 'push'", "'symmetry_z'", "take the whole body"});
  refused("quarter", push + along_y, {"[[load]] 'push'", "'symmetry_y'"});
  refused("half", load("push", "front", "[0, 1, 0]") + along_y, {"[[load]] 'push'", "does not reach", "'symmetry_z'"});
  refused("half", push + channel("y", "[0, 0, 1]"), {"[[channel]] 'y'", "'symmetry_z'"});
  refused("half", push + channel("y", "[1, 0, 0]", "tip", "rotation"), {"[[channel]] 'y'", "axis", "'symmetry_z'"},
          "load_N,retraction_mm,y_rad\n0,0,0\n");
  refused("half", push + along_y + "[base]\nturn = [\"1 deg\", \"0 deg\", \"0 deg\"]\n", {"'symmetry_z'", "turned"});
  refused("half", push + along_y + "[gravity]\ndirection = [0, 0, -1]\n", {"density"});
  refused("whole", push + along_y + "[[contact.obstacle]]\nx = [\"0 mm\", \"1 mm\"]\ny = [\"0 mm\", \"1 mm\"]\n",
          {"obstacle", "2D"});
  Experiment half =
      experiment_in(folder, toml_of({.geometry = two_cells + "part = \"half\"\n", .more = push + along_y}),
                    "load_N,retraction_mm,y_mm\n0,0,0\n");
  half.model = Rung::rigid_segments;
  expect_input_error([&] { bench_of(half); }, {"model", "rigid region", "take the whole body"});
  refused("whole", push + along_y + "[contact]\nform = \"pair_sum\"\n", {"form"});
}

TEST(Module3d, AHalfThatIsTurnedAboutItsNormalsOrOntoThemGivesTheSameNumbers) {
  const auto of = [&](const std::string& turn, const std::string& direction) {
    return readings({.geometry = two_cells + "part = \"half\"\n",
                     .more = turn + load("push", "tip", direction) + channel("y", direction),
                     .cables = ""},
                    "load_N,y_mm\n0.05,0\n")[0];
  };
  const double up = of("", "[0, 1, 0]");
  EXPECT_GT(up, 1e-4);
  EXPECT_NEAR(of("[base]\nturn = [\"90 deg\", \"0 deg\", \"0 deg\"]\n", "[0, 0, 1]") / up, 1, 1e-9);
  EXPECT_NEAR(
      of("[base]\nturn = [\"0 deg\", \"0 deg\", \"90 deg\"]\nat = [\"1 mm\", \"2 mm\", \"3 mm\"]\n", "[-1, 0, 0]") / up,
      1, 1e-9);
}

TEST(Module3d, OverTimeAndBesideOthersAPartIsRefusedWhereItDoesNotStandForTheWhole) {
  const std::string body = R"([[body]]
name = "NAME"
geometry = { kind = "push_puppet_3d", part = "half", cells = 1, gap_total = "4 mm" }
mesh = { size = "15 mm", lip_cells = 1, element = "linear" }
clamped = ["base"]
)";
  const std::string head = R"(title = "Half a module"
[simulation]
dimension = 3
duration = "1 s"
step = "1 s"
)";
  const std::string materials = R"([materials.foam]
E = "50 kPa"
nu = 0.2
density = "30 kg/m3"
[materials.plastic]
E = "2 GPa"
nu = 0.35
density = "1000 kg/m3"
)";
  const auto refused = [&](const std::string& bodies, const std::string& more, const std::vector<std::string>& parts) {
    const TemporaryFolder folder;
    const Simulation simulation = read_simulation(folder.write("experiment.toml", head + bodies + materials + more));
    expect_input_error([&] { make_robot(simulation); }, parts);
  };
  const auto named = [&](const std::string& name) {
    std::string own = body;
    return own.replace(own.find("NAME"), 4, name);
  };
  refused(named("one") + named("two") + "at = [\"100 mm\", \"0 mm\", \"0 mm\"]\n", "",
          {"[[body]] 'one'", "part of a body", "take the whole"});
  refused(named("one"), "[[load]]\nid = \"m\"\non = \"one.tip\"\ndirection = [0, -1, 0]\nvalue = \"10 g\"\n",
          {"[[load]] 'm'", "inertia", "take the whole body"});
  refused(named("one"), "[[channel]]\nid = \"f\"\nkind = \"net_force\"\nof = \"one\"\ndirection = [1, 0, 0]\n",
          {"[[channel]] 'f'", "net_force", "whole body"});
  refused(named("one"), "[[channel]]\nid = \"z\"\nof = \"one\"\ndirection = [0, 0, 1]\n",
          {"[[channel]] 'z'", "'one.symmetry_z'", "take the whole body"});
}

}  // namespace
}  // namespace taut::test

#include <gtest/gtest.h>

#include <numbers>

#include "calib/benches/recordings.hpp"
#include "calib/models/beam_model.hpp"
#include "tests/support/message.hpp"
#include "tests/support/static_bench.hpp"
#include "tests/support/taylor.hpp"

// Every kind of channel on a bench, each against what is known of it in closed form or by balance.
namespace taut {
namespace {

using namespace test;

constexpr double kE = 1e5, kArea = 0.012 * 0.020, kLength = 0.06, kBar = kE * kArea / kLength, kCable = 500;

/// A bar with E = 100 kPa and nu = 0 in plane stress, free to stretch.
const std::string free_bar = replaced(foam_piece("A bar", "[6, 2]", "E = \"100 kPa\"\nnu = 0.0\n"),
                                      "thickness = \"20 mm\"", "thickness = \"20 mm\"\nplane = \"stress\"") +
                             R"(fix = ["x"]

[[support]]
on = "xmin & ymin"
fix = ["y"]

[bench]
file = "bench.csv"
)";

/// With a cable from the wall through its middle to its end.
const std::string bar_toml = free_bar + R"(
[[load]]
id = "pull"
on = "xmax"
direction = [1, 0]
column = "pull_N"

[cables]
k = "500 N/m"
retraction = "winch_mm"
smoothing = "0 mm"
[[cables.cable]]
id = "middle"
x = ["0 mm", "60 mm"]
y = ["6 mm", "6 mm"]

[[channel]]
id = "read"
CHANNEL
)";

/// Its end face is moved.
const std::string pulled_toml = free_bar + R"(
[[support]]
on = "xmax"
move = "x"
id = "travel"
column = "travel_um"

[[channel]]
id = "cell"
kind = "reaction"
on = "xmax"
direction = [1, 0]
column = "cell_mN"
noise = { absolute = "0.1 mN" }

[fit.free.E_foam]
start = "30 kPa"
)";

class ChannelKinds : public testing::Test {
 protected:
  StaticReplay bench_of(const std::string& toml, const std::string& csv) const {
    return test::bench_of(experiment_in(folder_, toml, csv));
  }
  static std::string bar(const std::string& channel) { return replaced(bar_toml, "CHANNEL", channel); }
  static std::string beam(const std::string& channel) {
    return replaced(beam_toml, "on = \"xmax\"\ndirection = [0, -1]\ncolumn = \"tip_mm\"\n", channel);
  }
  /// The value at which a parameter ends, fitted to a bench's own readings.
  double fitted(const std::string& toml, const std::string& csv, const std::string& id) {
    const Experiment experiment = experiment_in(folder_, toml, csv);
    const StaticReplay bench = test::bench_of(experiment);
    const FitResult result = fit(*bench.protocol, bench.measurements, free_parameters(experiment, *bench.protocol));
    EXPECT_EQ(result.status, FitStatus::converged);
    EXPECT_EQ(bench.protocol->parameters()[bench.protocol->parameters().index(id)].id, id);
    return result.parameters.at(0).value;
  }
  TemporaryFolder folder_;
};

TEST_F(ChannelKinds, APositionIsTheRestPlaceAndTheDisplacement) {
  const std::string csv = "trial,pull_N,tip_mm\na,0.05,1\n";
  const double moved = predicted(bench_of(beam_toml, csv)).values[0];
  ASSERT_GT(moved, 1e-3);
  const std::string place = "on = \"xmax\"\ndirection = [0, -1]\ncolumn = \"tip_mm\"\n";
  EXPECT_NEAR(predicted(bench_of(beam("kind = \"position\"\n" + place), csv)).values[0], -0.006 + moved, 1e-15);
  const std::string marker =
      "point = [\"60 mm\", \"6 mm\"]\nstandoff = [\"10 mm\", \"3 mm\"]\nturns_with = \"xmax\"\ndirection = [0, 2]\n"
      "column = \"tip_mm\"\n";
  const double turned = predicted(bench_of(beam(marker), csv)).values[0];
  EXPECT_NEAR(predicted(bench_of(beam("kind = \"position\"\n" + marker), csv)).values[0], 0.009 + turned, 1e-15);
}

TEST_F(ChannelKinds, ARotationIsThatOfACantileversEndReadInDegrees) {
  const std::string toml =
      replaced(replaced(beam("kind = \"rotation\"\non = \"xmax\"\ncolumn = \"tip_deg\"\n"), "nu = 0.3", "nu = 0.0"),
               "absolute = \"0.1 mm\"", "absolute = \"0.5 deg\"");
  const StaticReplay bench = bench_of(toml, "trial,pull_N,tip_deg\na,0.001,-2\n");
  EXPECT_NEAR(bench.measurements[0].value, -2 * std::numbers::pi / 180, 1e-15);
  EXPECT_NEAR(bench.measurements[0].sigma, 0.5 * std::numbers::pi / 180, 1e-15);
  // F L^2 / (2 E I), clockwise
  const double expected = -0.001 * kLength * kLength / (2 * kE * 0.020 * std::pow(0.012, 3) / 12);
  EXPECT_NEAR(predicted(bench).values[0] / expected, 1, 0.02);
}

TEST_F(ChannelKinds, ATensionIsThatOfCableAndBarInARowAndItsFitFindsTheCable) {
  // The bar is pressed together by a part c of its length, T = A E/2 (1/l - l) with l = 1 - c, and the cable gives way
  // by T / k: together what the winch takes in. One linear element across the bar spreads the cable's end evenly.
  const double c = 2.5e-4, expected = kArea * kE / 2 * (1 / (1 - c) - (1 - c));
  const std::string winch = fmt::format("0,{:.12f}", 1e3 * (c * kLength + expected / kCable));
  const std::string channel =
      "kind = \"tension\"\nof = \"middle\"\ncolumn = \"cable_mN\"\nnoise = { absolute = \"0.01 mN\" }\n";
  const auto even = [](const std::string& toml) {
    return replaced(toml, "cells = [6, 2]", "cells = [6, 1]\nelement = \"linear\"");
  };
  const std::string head = "pull_N,winch_mm,cable_mN\n";
  const StaticReplay bench = bench_of(even(bar(channel)), head + winch + ",6.5\n");
  EXPECT_NEAR(bench.measurements[0].value, 6.5e-3, 1e-15);
  EXPECT_NEAR(bench.measurements[0].sigma, 1e-5, 1e-18);
  const double tension = predicted(bench).values[0];
  EXPECT_NEAR(tension / expected, 1, 1e-9);
  const std::string wall =
      "kind = \"reaction\"\non = \"xmin\"\ndirection = [1, 0]\ncolumn = \"cable_mN\"\n"
      "noise = { absolute = \"0.01 mN\" }\n";
  EXPECT_NEAR(predicted(bench_of(even(bar(wall)), head + winch + ",1\n")).values[0], tension, 1e-9)
      << "the wall holds against the cable";
  const std::string own = head + winch + fmt::format(",{:.9f}\n", 1e3 * tension);
  EXPECT_NEAR(fitted(even(bar(channel)) + "[fit.free.k_cable]\nstart = \"100 N/m\"\n", own, "k_cable") / kCable, 1,
              1e-4);
}

TEST_F(ChannelKinds, ACablesLengthIsItsRestLessWhatTheWinchTookInAndItStretched) {
  const std::string of = "of = \"middle\"\nnoise = { relative = \"1 %\" }\n";
  const double length = predicted(bench_of(bar("kind = \"length\"\ncolumn = \"cable_mm\"\n" + of),
                                           "pull_N,winch_mm,cable_mm\n0,0.5,60\n"))
                            .values[0];
  const double tension =
      predicted(bench_of(bar("kind = \"tension\"\ncolumn = \"cable_N\"\n" + of), "pull_N,winch_mm,cable_N\n0,0.5,1\n"))
          .values[0];
  ASSERT_GT(tension, 0.05);
  EXPECT_NEAR(length, kLength - 0.5e-3 + tension / kCable, 1e-10);
}

TEST_F(ChannelKinds, AReactionBalancesTheLoad) {
  const std::string channel =
      "kind = \"reaction\"\non = \"xmin\"\ndirection = [-1, 0]\ncolumn = \"cell_N\"\nnoise = { absolute = \"1 mN\" }\n";
  std::string toml = replaced(bar(channel),
                              "[cables]\nk = \"500 N/m\"\nretraction = \"winch_mm\"\nsmoothing = \"0 mm\"\n"
                              "[[cables.cable]]\nid = \"middle\"\nx = [\"0 mm\", \"60 mm\"]\n"
                              "y = [\"6 mm\", \"6 mm\"]\n",
                              "");
  EXPECT_NEAR(predicted(bench_of(toml, "pull_N,cell_N\n2,2\n")).values[0], 2, 1e-7);
}

TEST_F(ChannelKinds, ALoadCellOnAMovedFaceFindsTheModulus) {
  const double force = kBar * 6e-6;
  EXPECT_NEAR(predicted(bench_of(pulled_toml, "travel_um,cell_mN\n6,1\n")).values[0] / force, 1, 1e-3);
  const std::string csv = fmt::format("travel_um,cell_mN\n6,{:.9f}\n60,{:.9f}\n", 1e3 * force, 1e4 * force);
  EXPECT_NEAR(fitted(pulled_toml, csv, "E_foam") / kE, 1, 2e-3);
}

TEST_F(ChannelKinds, DerivativesOfAllKindsAreThoseOfTheWholePrediction) {
  const std::string more = R"(kind = "tension"
of = "middle"
column = "tension_N"
noise = { absolute = "1 mN" }
[[channel]]
id = "length"
kind = "length"
of = "middle"
column = "length_mm"
noise = { absolute = "1 mm" }
[[channel]]
id = "turn"
kind = "rotation"
on = "xmax"
column = "turn_rad"
noise = { absolute = "1 deg" }
[[channel]]
id = "wall"
kind = "reaction"
on = "xmin"
direction = [1, 0]
column = "wall_N"
noise = { absolute = "1 mN" }
[[channel]]
id = "place"
kind = "position"
on = "ymax"
direction = [1, 1]
column = "place_mm"
noise = { absolute = "1 mm" }
)";
  std::string toml = replaced(bar(more), "y = [\"6 mm\", \"6 mm\"]", "y = [\"9 mm\", \"9 mm\"]");
  toml = replaced(toml, "nu = 0.0", "nu = 0.3") + "[solver]\nstep_tolerance = 1e-12\n";
  const StaticReplay bench =
      bench_of(toml, "pull_N,winch_mm,tension_N,length_mm,turn_rad,wall_N,place_mm\n0.1,4,1,1,1,1,1\n");
  StaticProtocol& protocol = *bench.protocol;
  const Params p = protocol.nominal();
  std::vector<int> free;
  for (const char* id : {"E_foam", "nu_foam", "thickness", "k_cable", "slack"})
    free.push_back(protocol.parameters().index(id));
  const Prediction at = protocol.predict(p, free);
  ASSERT_TRUE(at.complete()) << at.failures.front();
  ASSERT_GT(at.values.cwiseAbs().minCoeff(), 1e-3);
  for (size_t j = 0; j < free.size(); ++j) {
    const Eigen::VectorXd slope = at.derivatives.col(static_cast<Eigen::Index>(j));
    const double size = std::max(0.1 * std::abs(p[free[j]]), 1e-4);
    for (Eigen::Index row = 0; row < slope.size(); ++row) {
      expect_taylor_order(
          [&](double h) {
            Params moved = p;
            moved[free[j]] += h;
            return std::abs(protocol.predict(moved, {}).values[row] - at.values[row] - h * slope[row]);
          },
          2, row == 0 || row == 3 ? 1e-10 : 1e-11, size, 5,
          protocol.parameters()[free[j]].id + ", row " + std::to_string(row));
    }
  }
}

TEST_F(ChannelKinds, HalfASolidReadsWhatTheWholeBodyDoes) {
  const auto both = [&](const std::string& toml, const std::string& csv) {
    const Experiment plane = experiment_in(folder_, toml, csv);
    Experiment solid = as_solid(plane, 1);
    SupportSettings side;
    side.on = "side";
    side.fix = {2};
    solid.supports.push_back(side);
    return std::pair(predicted(test::bench_of(plane)).values[0], predicted(test::bench_of(solid)).values[0]);
  };
  const auto [turn, half_turn] =
      both(replaced(beam("kind = \"rotation\"\non = \"xmax\"\ncolumn = \"tip_rad\"\n"), "0.1 mm", "1 deg"),
           "trial,pull_N,tip_rad\na,0.01,1\n");
  EXPECT_NEAR(half_turn / turn, 1, 3e-3);
  const auto [force, half_force] =
      both(replaced(beam("kind = \"reaction\"\non = \"xmin\"\ndirection = [0, 1]\ncolumn = \"wall_N\"\n"),
                    "absolute = \"0.1 mm\"", "absolute = \"1 mN\""),
           "trial,pull_N,wall_N\na,0.01,1\n");
  EXPECT_NEAR(force, 0.01, 1e-9);
  EXPECT_NEAR(half_force, 0.01, 1e-9) << "not the half";
}

TEST_F(ChannelKinds, ATensionAndARotationAreReadOverTime) {
  folder_.write("swing.csv", "time_ms,cable_N,turn_deg\n-1,0.2,0\n4,0.3,3\n");
  std::string toml =
      bar("kind = \"tension\"\nof = \"middle\"\ncolumn = \"cable_N\"\nnoise = { absolute = \"10 mN\" }\n"
          "[[channel]]\nid = \"turn\"\nkind = \"rotation\"\non = \"xmax\"\ncolumn = \"turn_deg\"\n"
          "noise = { absolute = \"1 deg\" }\n");
  toml = replaced(toml, "nu = 0.0", "nu = 0.0\ndensity = \"100 kg/m3\"");
  toml = replaced(toml, "column = \"pull_N\"", "value = \"0 N\"");
  toml = replaced(toml, "retraction = \"winch_mm\"", "slack = \"-0.2 mm\"");
  toml = replaced(toml, "file = \"bench.csv\"",
                  "kind = \"recordings\"\ntime = \"time_ms\"\n[dynamics]\nstep = \"1 ms\"\n[[bench.recording]]\n"
                  "file = \"swing.csv\"\ncase = \"one\"\nheld = { pull = \"0.1 N\" }");
  const Experiment experiment = read_experiment(folder_.write("experiment.toml", toml));
  const std::vector<Sample> samples = read_samples(experiment);
  ASSERT_EQ(samples.size(), 4u);
  EXPECT_NEAR(samples[1].value, 0.3, 1e-15);
  EXPECT_NEAR(samples[1].sigma, 0.01, 1e-15);
  EXPECT_NEAR(samples[3].value, 3 * std::numbers::pi / 180, 1e-15);
  const RecordingReplay bench = make_recording_replay(experiment, experiment.mesh, samples);
  const Prediction prediction = bench.protocol->predict(bench.protocol->nominal(), {});
  ASSERT_TRUE(prediction.complete()) << prediction.failures.front();
  // Held in equilibrium at first, where the cable, shorter than its path by 0.2 mm, all but bears the pull.
  EXPECT_NEAR(prediction.values[0], kCable * 0.2e-3, 0.03);
  EXPECT_LT(prediction.values[1], prediction.values[0]) << "let go, the bar draws the cable's end back";
  // The same file refuses what would be wrong over time.
  const auto refused = [&](const std::string& from, const std::string& to, const std::vector<std::string>& parts) {
    SCOPED_TRACE(to);
    expect_input_error([&] { read_experiment(folder_.write("experiment.toml", replaced(toml, from, to))); }, parts);
  };
  refused("time = \"time_ms\"", "time = \"time_ms\"\nreference = \"before\"",
          {"reference", "'read' is a tension", "not measured from rest"});
  refused("kind = \"rotation\"\non = \"xmax\"", "kind = \"reaction\"\ndirection = [1, 0]\non = \"xmin\"",
          {"noise", "absolute"});
  refused("kind = \"rotation\"\non = \"xmax\"\ncolumn = \"turn_deg\"\nnoise = { absolute = \"1 deg\" }",
          "kind = \"reaction\"\ndirection = [1, 0]\non = \"xmin\"\ncolumn = \"turn_N\"\nnoise = { absolute = \"1 N\" }",
          {"[[channel]] 'turn'", "a reaction is that of an equilibrium"});
  refused("time = \"time_ms\"", "time = \"time_ms\"\nsigma = \"1 N\"",
          {"sigma", "'read' and 'turn' are different quantities", "noise"});
}

TEST_F(ChannelKinds, WrongChannelsAreRefusedWithOneClearSentence) {
  const std::string bench_csv = "trial,pull_N,tip_mm\na,0.05,1\n";
  const auto refused = [&](const std::string& toml, const std::vector<std::string>& parts) {
    SCOPED_TRACE(toml);
    expect_input_error([&] { bench_of(toml, bench_csv); }, parts);
  };
  refused(beam("kind = \"rotaton\"\non = \"xmax\"\ncolumn = \"tip_deg\"\n"),
          {"[channel] kind", "did you mean 'rotation'",
           "displacement, position, rotation, tension, end_tension, length, reaction"});
  refused(beam("kind = \"rotation\"\non = \"xmax\"\ncolumn = \"tip_deg\"\n"), {"noise", "'mm' is not a unit of angle"});
  refused(replaced(beam("kind = \"rotation\"\non = \"xmax\"\ncolumn = \"tip_mm\"\n"), "0.1 mm", "1 deg"),
          {"bench.csv", "tip_mm", "angle"});
  refused(beam("kind = \"rotation\"\npoint = [\"60 mm\", \"6 mm\"]\ncolumn = \"tip_deg\"\n"), {"'on' is missing"});
  refused(beam("kind = \"tension\"\nof = \"upper\"\ncolumn = \"tip_N\"\n"),
          {"'upper' is not a [[cable]]", "none is there"});
  refused(
      replaced(beam("kind = \"reaction\"\non = \"xmax\"\ndirection = [0, 1]\ncolumn = \"tip_N\"\n"), "0.1 mm", "1 N"),
      {"bench.csv", "tip_N"});
  refused(replaced(beam("kind = \"position\"\non = \"xmax\"\ndirection = [0, 1]\ncolumn = \"tip_mm\"\n"),
                   "trial = \"trial\"", "trial = \"trial\"\nmeasured_from = \"unloaded\""),
          {"measured_from", "'tip' is a position"});
  folder_.write("bench.csv", "trial,pull_N,tip_N\na,0.05,1\n");
  const std::string unheld =
      replaced(beam("kind = \"reaction\"\non = \"xmax\"\ndirection = [0, 1]\ncolumn = \"tip_N\"\n"), "0.1 mm", "1 N");
  expect_input_error([&] { bench_of(unheld, "trial,pull_N,tip_N\na,0.05,1\n"); },
                     {"[[channel]] 'tip'", "nothing that is fixed or moved holds"});
  const std::string offset = replaced(unheld, "trial = \"trial\"", "trial = \"trial\"\nzero_offset_per = \"pull\"");
  expect_input_error([&] { bench_of(offset, "trial,pull_N,tip_N\na,0.05,1\n"); }, {"zero_offset_per", "'tip' is none"});
}

TEST_F(ChannelKinds, ChainsOfBeamsShowDisplacementsOnly) {
  const std::string toml =
      replaced(beam("kind = \"rotation\"\non = \"xmax\"\ncolumn = \"tip_deg\"\n"), "0.1 mm", "1 deg");
  const Experiment e = experiment_in(folder_, toml, "trial,pull_N,tip_deg\na,0.05,1\n");
  expect_input_error([&] { make_beam_bench(e, read_trials(e.bench)); },
                     {"[[channel]] 'tip'", "displacements", "rotation"});
}

}  // namespace
}  // namespace taut

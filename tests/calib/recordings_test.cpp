#include "calib/benches/recordings.hpp"

#include <gtest/gtest.h>

#include "calib/files/experiment.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"

namespace taut {
namespace {

using namespace test;

const std::string toml = released_toml + R"(
[gravity]
direction = [0, -1]

[[load]]
id = "hung"
on = "xmax & ymax"
direction = [0, -1]
value = "0 g"

[bench]
kind = "recordings"
time = "time_ms"
sigma = "0.2 mm"
per_case = ["stiffness_damping_foam"]

[[bench.recording]]
file = "one.csv"
case = "light"
held = { hand = "0.1 N" }
release = "2 ms"

[[bench.recording]]
file = "two.csv"
case = "heavy"
trial = "b"
reference = "mean"
loads = { hung = "5 g" }
from = "1 ms"
until = "9 ms"
every = 2
sigma = "0.5 mm"

[fit.free.E_foam]
)";

const std::string one_csv = "time_ms,tip_mm\n-2,1\n-1,3\n0,2.5\n10,-4\n";
const std::string two_csv = "time_ms,other,tip_mm\n0,7,1\n2,7,2\n4,7,3\n6,7,4\n8,7,5\n10,7,6\n";

/// An experiment folder whose parts can be spoilt one by one.
struct Folder {
  TemporaryFolder folder;
  std::string path;
  Folder(const std::string& experiment, const std::string& one = one_csv) {
    folder.write("one.csv", one);
    folder.write("two.csv", two_csv);
    path = folder.write("experiment.toml", experiment);
  }
};

const std::string good = replaced(toml, "reference = \"mean\"\n", "");

TEST(Recordings, SamplesAreThoseOfTheWindowInSiUnitsFromTheMeanBeforeTimeZero) {
  const Folder files(replaced(good, "per_case", "reference = \"before\"\nper_case"),
                     "time_ms,tip_mm\n-2,1\n-1,3\n0,2.5\n10,-4\n");
  test::expect_input_error([&] { read_samples(read_experiment(files.path)); }, {"two.csv", "heavy_b", "before time 0"});
  const Folder plain(good);
  EXPECT_TRUE(!read_experiment(plain.path).kind->at_rest);
  const std::vector<Sample> samples = read_samples(read_experiment(plain.path));
  ASSERT_EQ(samples.size(), 6u);
  EXPECT_EQ(samples[0].time, -0.002);
  EXPECT_EQ(samples[3].line, 5);
  EXPECT_NEAR(samples[3].value, -0.004, 1e-15);
  EXPECT_EQ(samples[3].sigma, 0.2e-3);
  // From 1 ms on, to 9 ms, every second one.
  EXPECT_NEAR(samples[4].time, 0.002, 1e-15);
  EXPECT_NEAR(samples[5].time, 0.006, 1e-15);
  EXPECT_NEAR(samples[5].value, 0.004, 1e-15);
  EXPECT_EQ(samples[5].sigma, 0.5e-3);

  Experiment before = read_experiment(plain.path);
  recordings_of(before).from_mean_before = true;
  recordings_of(before).recordings.pop_back();
  EXPECT_NEAR(read_samples(before)[3].value, -0.006, 1e-15);
}

TEST(Recordings, EachRecordingHasItsReleaseItsHoldAndEachCaseItsDamping) {
  const Folder files(good);
  const Experiment experiment = read_experiment(files.path);
  const RecordingReplay bench = make_recording_replay(experiment, experiment.mesh, read_samples(experiment));
  const ParameterTable& table = bench.protocol->parameters();
  const Params& p = bench.protocol->nominal();
  EXPECT_EQ(p[table.index("release_light")], 0.002);
  EXPECT_EQ(p[table.index("release_heavy_b")], 0);
  EXPECT_EQ(p[table.index("hand_light")], 0.1);
  EXPECT_FALSE(table.contains("hand_heavy_b"));
  EXPECT_EQ(p[table.index("stiffness_damping_foam_light")], 0.001);
  EXPECT_EQ(p[table.index("stiffness_damping_foam_heavy")], 0.001);
  EXPECT_EQ(bench.protocol->trajectories(), 2);
  EXPECT_TRUE(bench.protocol->predict(p, {}).complete());
}

TEST(Recordings, WhatIsWrongInAnExperimentFileIsSaid) {
  const auto refused = [](const std::string& from, const std::string& to, const std::vector<std::string>& parts) {
    const Folder files(replaced(good, from, to));
    expect_input_error([&] { read_experiment(files.path); }, parts);
  };
  refused("[\"stiffness_damping_foam\"]", "[\"stiffness_damping_fom\"]",
          {"per_case", "'stiffness_damping_fom'", "did you mean 'stiffness_damping_foam'"});
  refused("loads = { hung = ", "loads = { hnug = ", {"hnug", "hung"});
  refused("held = { hand = \"0.1 N\" }", "held = { hand = \"0.1 N\" }\nloads = { hand = \"1 N\" }",
          {"'hand'", "'loads' too"});
  refused("density = \"500 kg/m3\"\n", "", {"density"});
  refused("sigma = \"0.2 mm\"\n", "", {"recording 'light' has no noise"});
  refused("case = \"heavy\"\ntrial = \"b\"", "case = \"light\"", {"'light' is there twice", "trial"});
  refused("value = \"0 N\"", "column = \"hand_N\"", {"'hand'", "recordings do not have"});
  refused("column = \"tip_mm\"\n", "", {"channel 'tip'", "column"});
  refused("[damping.foam]", "[damping.fom]", {"'fom'", "did you mean 'foam'"});
  refused("step = \"1 ms\"", "step = \"0 ms\"", {"step", "positive"});
  refused("until = \"9 ms\"", "until = \"1 ms\"", {"'from' must be earlier"});
  refused("time = \"time_ms\"", "time = \"time_mm\"", {"time_mm", "a unit of length", "time is needed"});
  const Folder unknown(toml);
  expect_input_error([&] { read_experiment(unknown.path); }, {"reference"});
}

TEST(Recordings, WhatIsWrongInARecordingIsSaidWithItsLine) {
  const auto refused = [](const std::string& csv, const std::vector<std::string>& parts) {
    const Folder files(good, csv);
    expect_input_error([&] { read_samples(read_experiment(files.path)); }, parts);
  };
  refused("time_ms,tipp_mm\n0,1\n", {"one.csv", "line 1", "'tip_mm'", "did you mean 'tipp_mm'"});
  refused("time_s,tip_mm\n0,1\n", {"one.csv", "'time_ms'", "time_s"});
  refused("time_ms,tip_mm\n0,1\n1,inf\n", {"line 3", "'inf' is not a finite number"});
  refused("time_ms,tip_mm\n0,1\n,1\n", {"line 3", "'' is not a finite number"});
  refused("time_ms,tip_mm\n0,1\n2,1\n2,1\n", {"line 4", "not after", "order of time"});
  refused("time_ms,tip_mm\n0,1\n1,1,1\n", {"line 3", "3 cells"});
  const Folder missing(replaced(good, "one.csv", "none.csv"));
  expect_input_error([&] { read_samples(read_experiment(missing.path)); }, {"none.csv"});
  const Folder empty(replaced(good, "from = \"1 ms\"\nuntil = \"9 ms\"", "from = \"11 ms\""));
  expect_input_error([&] { read_samples(read_experiment(empty.path)); }, {"two.csv", "no sample from 0.011 s"});
}

}  // namespace
}  // namespace taut

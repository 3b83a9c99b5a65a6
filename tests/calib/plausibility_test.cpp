#include "calib/check/plausibility.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <functional>
#include <map>
#include <random>
#include <sstream>

#include "calib/benches/static_bench.hpp"
#include "calib/models/beam_model.hpp"
#include "calib/runs/open_bench.hpp"
#include "calib/runs/run_fit.hpp"
#include "tests/support/experiment_files.hpp"

// Every kind of implausible input, each as one change of a bench in which nothing is wrong.
namespace taut {
namespace {

using namespace test;
namespace fs = std::filesystem;

/// An experiment and its readings.
struct Input {
  std::string toml, csv;
};

/// A shipped experiment with its readings beside it.
Input shipped(const std::string& name, const std::string& data) {
  const std::string root = TAUT_SOURCE_DIR;
  std::string csv = text_of(root + "/data/" + data);
  std::erase(csv, '\r');
  return {replaced(text_of(root + "/experiments/" + name + "/experiment.toml"), "../../data/" + data, "bench.csv"),
          csv};
}

Input beam() {
  return shipped("foam_cantilever", "foam_cantilever_synthetic/bench.csv");
}
Input module() {
  return shipped("push_puppet", "push_puppet_synthetic/bench.csv");
}
Input block() {
  return shipped("silicone_block", "silicone_block/static_tip_displacement.csv");
}
Input arm() {
  return shipped("tentacle", "tentacle/bench.csv");
}
Input point() {
  return shipped("foam_point", "foam_curves/bench.csv");
}

/// The beam that a hand lets go, one recording of 40 samples.
Input swing() {
  Input input{released_toml + R"(
[bench]
kind = "recordings"
time = "time_s"
sigma = "0.1 mm"

[[bench.recording]]
file = "bench.csv"
case = "free"
held = { hand = "0.05 N" }
release = "0 s"

[fit.free.E_foam]
)",
              "time_s,tip_mm\n"};
  for (int i = 0; i < 40; ++i)
    input.csv += fmt::format("{:.3f},{:.3f}\n", 0.005 * i, -4 * std::exp(-0.02 * i) * std::cos(0.5 * i));
  return input;
}

using Edit = std::function<void(Input&)>;
/// What a number of a row becomes; `row`: from 0, with its cells.
using Change = std::function<double(double value, int row, const std::vector<std::string>& cells)>;

/// One text of the experiment by another one.
Edit in_file(const std::string& from, const std::string& to) {
  return [=](Input& input) { input.toml = replaced(input.toml, from, to); };
}
/// One text of the readings by another one.
Edit in_readings(const std::string& from, const std::string& to) {
  return [=](Input& input) { input.csv = replaced(input.csv, from, to); };
}
/// All numbers of a column, rounded to a hundredth.
Edit column(size_t index, const Change& change) {
  return [=](Input& input) {
    std::istringstream lines(input.csv);
    std::string line, all;
    std::getline(lines, all);
    all += "\n";
    for (int row = 0; std::getline(lines, line); ++row) {
      std::vector<std::string> cells;
      std::istringstream parts(line);
      for (std::string cell; std::getline(parts, cell, ',');) cells.push_back(cell);
      cells[index] = fmt::format("{}", std::round(1e4 * change(std::stod(cells[index]), row, cells)) / 1e4);
      for (size_t i = 0; i < cells.size(); ++i) all += (i == 0 ? "" : ",") + cells[i];
      all += "\n";
    }
    input.csv = all;
  };
}
/// A column's title, in the experiment too.
Edit renamed(const std::string& from, const std::string& to) {
  return [=](Input& input) {
    input.toml = replaced(input.toml, '"' + from + '"', '"' + to + '"');
    input.csv = replaced(input.csv, from, to);
  };
}
Edit scaled(size_t index, double factor) {
  return column(index, [=](double value, int, const auto&) { return factor * value; });
}
/// One more column, with what it holds in each row.
Edit further_column(const std::string& title, const std::function<std::string(const std::string& line)>& value) {
  return [=](Input& input) {
    std::istringstream lines(input.csv);
    std::string all;
    for (std::string line; std::getline(lines, line);) all += line + "," + (all.empty() ? title : value(line)) + "\n";
    input.csv = all;
  };
}
/// Rows that hold a text go.
Edit without_rows(const std::string& text) {
  return [=](Input& input) {
    std::istringstream lines(input.csv);
    std::string all;
    for (std::string line; std::getline(lines, line);) all += line.find(text) == std::string::npos ? line + "\n" : "";
    input.csv = all;
  };
}
Edit both(const Edit& one, const Edit& other) {
  return [=](Input& input) { one(input), other(input); };
}

struct Case {
  std::string kind;                ///< Implausible::name
  Input (*base)();                 ///< in which nothing is wrong
  Edit edit;                       ///< what goes wrong
  std::vector<std::string> parts;  ///< of the sentence
};

const std::vector<Case>& cases() {
  static const std::vector<Case> table{
      // readings
      {"a reading against its repeats",
       beam,
       in_readings("2,1,9.18", "2,1,91.8"),
       {"line 6: 91.8 mm where 2 repeats say 9.08 mm", "larger by 10", "sigmas"}},
      {"a reading against its repeats", beam, in_readings("3,2,17.42", "3,2,-17.42"), {"line 10", "other sign"}},
      {"a reading against its repeats", beam, in_readings("2,0.5,4.61", "2,0.5,0.1815"), {"line 3", "25.4: inches?"}},
      {"two readings exchanged between their repeats",
       beam,
       both(in_readings("1,0.5,4.64", "1,0.5,17.55"), in_readings("1,2,17.55\n", "1,2,4.64\n")),
       {"lines 2 and 8 are exchanged", "17.55 mm and 4.64 mm"}},
      {"two readings exchanged against the trend",
       block,
       both(in_readings("-6.494,0.2\n", "-17.147,0.2\n"),
            both(in_readings("a,0.51012,tip_top,3.595,0.569,-17.147", "a,0.51012,tip_top,3.595,0.569,-6.494"),
                 [](Input& input) {  // one trial, and a fourth load
                   without_rows(",b,")(input);
                   input.csv += "more,a,1.5,tip_top,0,0,-35.1,0.7\n";
                 })),
       {"lines 2 and 5 ('tip_top') look exchanged", "-17.15 mm and -6.494 mm"}},
      {"a trial in another unit",
       module,
       column(3, [](double v, int, const auto& cells) { return cells[0] == "2" ? v / 25.4 : v; }),
       {"trial '2'", "0.0395 times", "smaller by 25.4: inches?"}},
      {"drift over trials",
       module,
       column(3, [](double v, int, const auto& cells) { return v * (1 + 0.04 * (std::stod(cells[0]) - 2)); }),
       {"trial '1' is -", "trial '3' +", "creep"}},
      {"a trial apart from the others",
       module,
       column(3, [](double v, int, const auto& cells) { return cells[0] == "3" ? 1.06 * v : v; }),
       {"trial '3' is off the others in all conditions, by +"}},
      {"drift with order",
       beam,
       [](Input& input) {  // up and down and up, without trials
         input.toml = replaced(input.toml, "trial = \"trial\"\n", "");
         input.csv = "tip_load_N,tip_drop_mm\n";
         int line = 0;
         const double noise[] = {0.3, -0.5, 0.1, 0.4, -0.2, -0.4, 0.5, 0, -0.1, 0.2, -0.3, 0.1};
         for (double load : {0.5, 1.0, 2.0, 4.0, 4.0, 2.0, 1.0, 0.5, 0.5, 1.0, 2.0, 4.0}) {
           const double drop = load == 0.5 ? 4.65 : load == 1 ? 9.1 : load == 2 ? 17.45 : 30.8;
           input.csv += fmt::format("{},{:.2f}\n", load, drop * (1 + 0.004 * line + 0.003 * noise[line]));
           ++line;
         }
       },
       {"repeats drift with their order", "+", "lines"}},
      {"a copied trial",
       module,
       [](Input& input) {
         std::map<std::string, std::string> first;
         std::istringstream lines(input.csv);
         std::string all;
         for (std::string line; std::getline(lines, line);) {
           const size_t value = line.rfind(',');
           const std::string condition = line.substr(2, value - 2);
           if (line[0] == '1') first[condition] = line.substr(value);
           if (line[0] == '3') line = line.substr(0, value) + first[condition];
           all += line + "\n";
         }
         input.csv = all;
       },
       {"trials '1' and '3' read the same to the last digit in all 16 conditions"}},
      {"declared noise below the scatter",
       module,
       in_file("relative = \"1.5 %\", absolute = \"0.02 mm\", resolution = \"0.01 mm\"",
               "relative = \"0.15 %\", absolute = \"0.002 mm\""),
       {"repeats scatter by", "times the declared noise", "declare about"}},
      {"declared noise above the scatter",
       module,
       in_file("relative = \"1.5 %\", absolute = \"0.02 mm\"", "relative = \"40 %\", absolute = \"0.8 mm\""),
       {"over", "times the repeats' scatter", "32 degrees of freedom"}},
      {"a mistyped control",
       module,
       in_readings("2,5.89,200.0", "2,58.9,200.0"),
       {"line 21: 'retraction' is 58.9 mm", "trial '2' alone has none at 5.89 mm", "larger by 10"}},
      {"readings that are all zero", beam, scaled(2, 0), {"all 12 readings are 0", "connected"}},
      {"readings that never change",
       beam,
       column(2, [](double, int, const auto&) { return 3.21; }),
       {"3.21 mm to the last digit in all 4 conditions"}},
      {"rounding coarser than the noise",
       beam,
       column(2, [](double v, int, const auto&) { return std::round(v / 2); }),
       {"multiples of 1 mm", "rounding alone is 290 um"}},
      {"resolution coarser than the readings",
       module,
       in_file("resolution = \"0.01 mm\"", "resolution = \"1 mm\""),
       {"resolution, 1 mm, is coarser than its smallest reading (280 um in line 38)"}},
      {"noise larger than the readings",
       beam,
       in_file("relative = \"1 %\"", "relative = 1"),
       {"a relative noise of 1 is 100 %", "relative = \"1 %\""}},
      {"noise larger than the readings",
       beam,
       in_file("absolute = \"0.02 mm\"", "absolute = \"0.2 m\""),
       {"larger than every reading"}},
      {"fewer readings than free parameters",
       module,
       both(without_rows(",50.0,"),
            both(without_rows(",200.0,"), both(without_rows(",100.0,"), without_rows(",0.0,")))),
       {"4 free parameters and 3 different readings"}},
      {"a zero that is not zero",
       beam,
       [](Input& input) { input.csv += "1,0,0.62\n2,0,0.61\n3,0,0.63\n"; },
       {"line 14: 'tip' reads 620 um where nothing acts", "sigmas"}},
      {"readings larger than the specimen",
       beam,
       scaled(2, 10),
       {"line 13: 'tip' reads 309.1 mm on a specimen of 62.65 mm", "4.9 times"}},
      {"angles in another unit",
       beam,
       both(in_file("column = \"tip_drop_mm\"", "kind = \"rotation\"\ncolumn = \"tip_rad\""),
            both(in_file("direction = [0, -1]        # drops are positive\n", ""),
                 both(in_file("noise = { relative = \"1 %\", absolute = \"0.02 mm\", resolution = \"0.01 mm\" }",
                              "noise = { absolute = \"0.1 rad\" }"),
                      in_readings("tip_drop_mm", "tip_rad")))),
       {"30.91 rad, more than a whole turn", "degrees"}},
      {"a channel against its load",
       block,
       column(6, [](double v, int, const auto& cells) { return cells[3] == "tip_left" ? -v : v; }),
       {"channel 'tip_left' goes back by", "sigmas", "load 'tip_load' grows"}},
      {"a negative mass", module, scaled(2, -1), {"line 2: 'mass' is -50 g"}},
      // settings
      {"a retraction beyond all gaps",
       module,
       renamed("retraction_mm", "retraction_cm"),
       {"line 38: 'retraction' is 176.8 mm, 10 times all gaps together (17 mm)", "more than all the foam (46 mm)",
        "if it were 10 times smaller"}},
      {"a motion beyond the specimen",
       beam,
       both(in_file("[[load]]",
                    "[[support]]\non = \"xmax\"\nmove = \"x\"\nid = \"shift\"\ncolumn = \"shift_mm\"\n\n[[load]]"),
            further_column("shift_mm", [](const std::string&) { return "300"; })),
       {"line 2: 'shift' goes to 300 mm, 4.8 times the specimen's 62.65 mm"}},
      {"a retraction that reaches no lip",
       module,
       scaled(1, 0.1),
       {"'retraction' goes to 1.768 mm at most", "10 % of all gaps (17 mm)", "10 times larger"}},
      {"a slack beyond all gaps",
       module,
       both(in_file("slack = \"0 mm\"", "slack = \"29 mm\""), in_file("upper = \"5 mm\"", "upper = \"30 mm\"")),
       {"slack = 29 mm is more than all gaps (17 mm)"}},
      {"cables softer than the foam",
       module,
       both(in_file("k = \"10 kN/m\"", "k = \"10 N/m\""), in_file("lower = \"100 N/m\"", "lower = \"1 N/m\"")),
       {"[cables] k = 10 N/m", "N/mm for N/m?"}},
      {"a density of no solid", block, in_file("1070 kg/m3", "1.07 kg/m3"), {"density = 1.07 kg/m3", "g/cm3"}},
      {"a gravity of no place", block, in_file("9.80709 m/s2", "980.709 m/s2"), {"980.71 m/s2", "the one in cm/s2"}},
      {"a modulus of no solid",
       beam,
       both(both(in_file("E = \"80 kPa\"", "E = \"80 Pa\""), scaled(1, 1e-3)),
            both(in_file("start = \"300 kPa\"\n", ""), in_file("\"1 kPa\"", "\"1 Pa\""))),
       {"[materials.foam] E = 80 Pa", "kPa or MPa for Pa"}},
      {"materials exchanged",
       module,
       both(in_file("start = \"80 kPa\"", "start = \"3 MPa\""),
            both(in_file("E = \"2.3 GPa\"", "E = \"2.3 MPa\""), in_file("lower = \"10 MPa\"", "lower = \"1 MPa\""))),
       {"E of plastic (2.3 MPa) is not above that of foam (3 MPa)"}},
      {"a thickness of no specimen",
       beam,
       in_file("thickness = \"30 mm\"", "thickness = \"30 m\""),
       {"thickness = 30 m on a section of 62.65 mm"}},
      {"a tension beyond the body",
       arm,
       both(in_file("E = \"505 kPa\"", "E = \"505 Pa\""), in_file("lower = \"50 kPa\"", "lower = \"50 Pa\"")),
       {"cable 'tendon_1' pulls with", "is its unit right"}},
      {"a spool of no bench",
       arm,
       [](Input& input) {
         input.csv = replaced(input.csv, "tension_1_N,", "tension_1_Nm,");
         input.toml =
             replaced(input.toml, "tension = \"tension_1_N\"", "tension = \"tension_1_Nm\"\nspool = \"32.5 m\"");
       },
       {"a spool of radius 32.5 m"}},
      {"eyelets that bend nothing or stand twice",
       arm,
       in_file("angle = \"-60 deg\"", "angle = \"60 deg\""),
       {"'tendon_1' and 'tendon_2' have one row of eyelets"}},
      {"a tolerance as large as its value",
       module,
       in_file("\"17.0 mm\"", "\"17.0 mm +- 100 mm\""),
       {"gap_total = 17 mm with a tolerance of 100 mm, 588 % of it"}},
      {"a reference outside the bounds",
       block,
       in_file("\"283 kPa\"", "\"283 Pa\""),
       {"E_silicone = 283 Pa", "outside the bounds of its fit, 10 kPa to 10 MPa"}},
      {"a marker far from the specimen",
       block,
       in_file("standoff = [\"0 mm\", \"-6 mm\", \"0 mm\"]", "standoff = [\"0 mm\", \"-6 m\", \"0 mm\"]"),
       {"'tip_left': its marker stands 6 m off", "unit of standoff"}},
      {"loads beyond any strength", module, renamed("mass_g", "mass_kg"), {"line 11: 'mass' is 4.905 kN", "kg for g"}},
      // against beams
      {"a channel reversed",
       module,
       in_file("direction = [0, -1]        # drops", "direction = [0, 1]        # drops"),
       {"channel 'tip': its readings go the other way than the loads push", "turn the channel's direction round"}},
      {"readings out of scale", module, scaled(3, 10), {"channel 'tip'", "10 times too large"}},
      {"readings out of scale",
       beam,
       both(scaled(2, 1 / 25.4),
            in_file("[fit.free.E_foam]\nstart = \"300 kPa\"\nlower = \"1 kPa\"\nupper = \"100 MPa\"\n", "")),
       {"they would need E_foam = 2.8 MPa", "readings are 25.4 times too small (with E_foam = 9"}},
      {"readings out of scale",  // a twentieth of the start is no likely modulus, although the bounds have it
       beam,
       scaled(2, 40),
       {"at the best E_foam from 15 kPa to 6 MPa"}},
      {"bounds that exclude the readings",
       beam,
       in_file("lower = \"1 kPa\"", "lower = \"250 kPa\""),
       {"[fit.free.E_foam]", "need about", "the bounds are 250 kPa to 100 MPa"}},
      {"channels that contradict each other",
       module,
       both(in_file("[bench]\n",
                    "[[channel]]\nid = \"camera\"\non = \"tip\"\ndirection = [0, -1]\ncolumn = \"camera_mm\"\n"
                    "noise = { absolute = \"0.1 mm\" }\n\n[bench]\n"),
            further_column("camera_mm",
                           [](const std::string& line) {
                             return fmt::format("{:.3f}", 0.1 * std::stod(line.substr(line.rfind(',') + 1)));
                           })),
       {"channels 'tip' and 'camera' contradict each other"}},
      {"a zero error that explains the trend",
       beam,
       column(2, [](double v, int, const auto&) { return v + 3; }),
       {"run to", "at no load", "standard errors from zero", "zero_offset_per"}},
      {"a free parameter that no row sees",
       module,
       both(
           [](Input& input) {
             for (const char* retracted : {",5.89,", ",11.79,", ",17.68,", ",500.0,"}) without_rows(retracted)(input);
           },
           both(in_file("slack = \"0 mm\"", "slack = \"16 mm\""),
                in_file("[fit.free.slack]\nlower = \"-2 mm\"\nupper = \"5 mm\"\n", ""))),
       {"[fit.free.k_cable]: no row sees it"}},
      // over time, and at a point
      {"times in another unit",
       swing,
       [](Input& input) { scaled(0, 1e6)(input); },
       {"recording 'free': it lasts", "ms written as s"}},
      {"times in another unit",
       swing,
       renamed("time_s", "time_ms"),
       {"recording 'free': it lasts 0.195 ms", "s written as ms"}},
      {"a release out of sight",
       swing,
       in_file("release = \"0 s\"", "release = \"5 s\""),
       {"recording 'free'", "let go at 5 s, after its last sample"}},
      {"a recording that is clipped",
       swing,
       column(1, [](double v, int, const auto&) { return std::clamp(v, -0.9, 0.9); }),
       {"recording 'free', line 12: 'tip' stays at -900 um, its extreme, for 6 samples"}},
      {"a recording that stands still", swing, scaled(1, 0.01), {"no more than its noise"}},
      {"strains in per cent",
       point,
       both(without_rows("compression"), renamed("strain_%", "strain_1")),
       {"a strain of 30 is 3000 %", "..._%"}},
      {"stresses out of scale",
       point,
       both(renamed("stress_kPa", "stress_Pa"), renamed("sd_kPa", "sd_Pa")),
       {"smaller by 1000: a wrong unit?"}},
      {"stresses of the other sign",
       point,
       column(2, [](double v, int, const auto&) { return std::abs(v); }),
       {"compression", "the other sign"}},
  };
  return table;
}

/// The kinds and sentences of an input.
std::vector<Finding> found_in(const Input& input) {
  const TemporaryFolder folder;
  folder.write("bench.csv", input.csv);
  const std::unique_ptr<Bench> bench = open_bench(folder.write("experiment.toml", input.toml));
  bench->free();  // wrong input, if that throws
  return implausible(*bench);
}

std::string listed(const std::vector<Finding>& findings) {
  std::string text;
  for (const auto& [kind, sentence] : findings) text += fmt::format("\n  {}: {}", kind, sentence);
  return text.empty() ? " nothing" : text;
}

TEST(Plausibility, EachKindIsFoundInABenchWithOneThingWrong) {
  for (const Case& one : cases()) {
    SCOPED_TRACE(one.kind);
    Input input = one.base();
    one.edit(input);
    const std::vector<Finding> findings = found_in(input);
    const bool found = std::ranges::any_of(findings, [&](const Finding& finding) {
      return finding.kind == one.kind && std::ranges::all_of(one.parts, [&](const std::string& part) {
               return finding.sentence.find(part) != std::string::npos;
             });
    });
    EXPECT_TRUE(found) << fmt::format("{}", fmt::join(one.parts, " ... ")) << "\nfound:" << listed(findings);
    EXPECT_LE(findings.size(), 4u) << listed(findings);
  }
}

TEST(Plausibility, EveryKindHasItsCase) {
  const std::vector<Implausible> kinds = kinds_of_implausible();
  EXPECT_GE(kinds.size(), 30u);
  for (const Implausible& kind : kinds) {
    EXPECT_TRUE(std::ranges::any_of(cases(), [&](const Case& one) { return one.kind == kind.name; })) << kind.name;
    EXPECT_EQ(std::ranges::count(kinds, kind.name, &Implausible::name), 1) << kind.name;
  }
}

TEST(Plausibility, NothingIsSaidOfTheBasesAndTheShippedBenches) {
  for (const auto& base : {beam, module, block, arm, point, swing})
    EXPECT_TRUE(found_in(base()).empty()) << base().toml << listed(found_in(base()));
  int benches = 0;
  for (const fs::directory_entry& entry : fs::recursive_directory_iterator(TAUT_SOURCE_DIR "/experiments")) {
    const std::string path = entry.path().string();
    if (entry.path().extension() != ".toml" || text_of(path).find("[simulation]") != std::string::npos) continue;
    if (path.find("/experiments/init/") != std::string::npos) continue;  // have no readings
    ++benches;
    EXPECT_EQ(start_record(*open_bench(path)).remarks, std::vector<std::string>{}) << path;
  }
  EXPECT_GE(benches, 6);
}

TEST(SlowPlausibility, CleanReadingsAlarmInFewerThanOneOfAHundredFiles) {
  const TemporaryFolder folder;
  Input input = beam();
  input.toml = replaced(replaced(input.toml, "cells = [29, 16]", "cells = [4, 2]"), "\"quadratic\"\n\n[mat",
                        "\"linear\"\n\n[mat");
  folder.write("bench.csv", input.csv);
  const Experiment experiment = read_experiment(folder.write("experiment.toml", input.toml));
  Trials trials = read_trials(experiment.bench);
  const BeamBench beams = make_beam_bench(experiment, trials);
  const Prediction truth = beams.protocol->predict(beams.protocol->nominal(), {});
  std::mt19937 engine(1);
  std::normal_distribution<double> normal;
  int alarms = 0;
  for (int file = 0; file < 300; ++file) {
    for (size_t i = 0; i < trials.readings.size(); ++i) {
      Reading& reading = trials.readings[i];
      const double value = truth.values[beams.row_of_reading[i]];
      reading.sigma = experiment.bench.channels[0].noise.sigma(value);
      reading.value = 1e-5 * std::round(1e5 * (value + reading.sigma * normal(engine)));
    }
    const std::vector<Finding> findings = implausible(StaticBench(experiment, trials));
    alarms += !findings.empty();
    if (!findings.empty()) RecordProperty("alarm", listed(findings));
  }
  EXPECT_LT(alarms, 3);
}

}  // namespace
}  // namespace taut

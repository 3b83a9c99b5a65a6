#include "reports/simulation_report.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <regex>
#include <set>

#include "calib/data/csv_table.hpp"
#include "reports/animation.hpp"
#include "sim/core/units.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"
#include "tests/support/simulation_records.hpp"

namespace taut {
namespace {

using namespace test;

/// Two records, written once for all tests that look at files: gnuplot takes its time.
class SimulationFiles : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new TemporaryFolder;
    files_ = write_simulation(bending_beam(11), *folder_ / "plane");
    write_simulation(twisted_column(4), *folder_ / "space");
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }
  static std::string text(const std::string& file) { return text_of(*folder_ / file); }
  static size_t count(const std::string& file, const std::string& what) {
    const std::string all = text(file);
    size_t n = 0;
    for (size_t at = all.find(what); at != std::string::npos; at = all.find(what, at + 1)) ++n;
    return n;
  }

  static inline TemporaryFolder* folder_ = nullptr;
  static inline std::vector<std::string> files_;
};

double number(const std::string& cell) {
  return cell.empty() ? NAN : parse_number(cell).value();
}

TEST_F(SimulationFiles, AreAllThereAndListed) {
  std::set<std::string> found;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(*folder_ / "plane")) {
    if (entry.is_regular_file()) {
      EXPECT_GT(entry.file_size(), 50u) << entry.path();
      found.insert(std::filesystem::relative(entry.path(), *folder_ / "plane").string());
    }
  }
  EXPECT_EQ(found, std::set<std::string>(files_.begin(), files_.end()));
  for (const char* file : {"channels.csv", "bending_beam.pvd", "frames/bending_beam_0010.vtu", "animation.html",
                           "report.html", "figures/strip.svg", "figures/strip.pdf", "figures/strip.png",
                           "figures/workspaces.svg", "figures/plot_path.csv", "figures/plot_pull.svg",
                           "figures/channels_mm.svg", "figures/channels_N.svg", "figures/channels_deg.svg"}) {
    EXPECT_TRUE(found.contains(file)) << file;
  }
}

TEST_F(SimulationFiles, ChannelsReadBackToTheSameNumbers) {
  const SimulationRecord record = bending_beam(11);
  const CsvTable table = read_csv(*folder_ / "plane/channels.csv");
  check_cell_counts(table);
  ASSERT_EQ(table.rows.size(), record.samples.size());
  std::vector<const std::vector<double>*> columns = {&record.samples};
  std::vector<std::string> names = {"time"};
  for (const auto* list : {&record.controls, &record.channels}) {
    for (const Series& series : *list) {
      columns.push_back(&series.values);
      names.push_back(series.id);
    }
  }
  ASSERT_EQ(table.header.cells.size(), columns.size());
  for (size_t c = 0; c < columns.size(); ++c) {
    if (names[c] == "energy") {  // the file's only unit that is no quantity of an experiment file
      EXPECT_EQ(table.header.cells[c], "energy_J");
      continue;
    }
    const HeaderUnit header = parse_header(
        table.header.cells[c],
        {Quantity::time, Quantity::length, Quantity::angle, Quantity::force, Quantity::acceleration}, "test");
    EXPECT_EQ(header.name, names[c]);
    for (size_t k = 0; k < table.rows.size(); ++k) {
      const double value = header.factor * number(table.rows[k].cells[c]), expected = (*columns[c])[k];
      if (std::isnan(expected)) {
        EXPECT_TRUE(std::isnan(value));
      } else {
        EXPECT_NEAR(value, expected, 1e-9 * std::abs(expected)) << names[c] << ", sample " << k;
      }
    }
  }
}

TEST_F(SimulationFiles, TheCollectionListsTheFramesWithTheirTimesAndStates) {
  const SimulationRecord record = bending_beam(11);
  const std::string pvd = text("plane/bending_beam.pvd");
  const std::regex line("timestep=\"([^\"]+)\" part=\"0\" file=\"([^\"]+)\"");
  size_t f = 0;
  for (auto it = std::sregex_iterator(pvd.begin(), pvd.end(), line); it != std::sregex_iterator(); ++it, ++f) {
    ASSERT_LT(f, record.frames.size());
    EXPECT_EQ(number((*it)[1]), record.samples[static_cast<size_t>(record.frames[f])]);
    const std::string vtu = text("plane/" + (*it)[2].str());
    const size_t at = vtu.find('>', vtu.find("Name=\"displacement\"")) + 1;
    std::istringstream numbers(vtu.substr(at, vtu.find('<', at) - at));
    for (int i = 0; i < record.mesh.node_count(); ++i) {
      double x = NAN, y = NAN, z = NAN;
      numbers >> x >> y >> z;
      ASSERT_EQ(x, record.states[f][2 * i]);
      ASSERT_EQ(y, record.states[f][2 * i + 1]);
    }
  }
  EXPECT_EQ(f, record.frames.size());
}

/// All "set xrange [a:b]" of a script, or those of y.
std::vector<std::pair<double, double>> ranges(const std::string& script, char axis) {
  std::vector<std::pair<double, double>> out;
  const std::regex range(std::string("set ") + axis + "range \\[([^:]+):([^\\]]+)\\]");
  for (auto it = std::sregex_iterator(script.begin(), script.end(), range); it != std::sregex_iterator(); ++it)
    out.emplace_back(number((*it)[1]), number((*it)[2]));
  return out;
}

TEST_F(SimulationFiles, TheStripShowsFirstAndLastStateInOneWindowThatHoldsAllNodesOfAllFrames) {
  const SimulationRecord record = bending_beam(11);
  const std::string svg = text("plane/figures/strip.svg"), report = text("plane/report.html");
  std::vector<std::string> labels;
  const std::regex label("time [0-9.]+ s");
  for (auto it = std::sregex_iterator(svg.begin(), svg.end(), label); it != std::sregex_iterator(); ++it)
    labels.push_back(it->str());
  EXPECT_EQ(labels, (std::vector<std::string>{"time 0.00 s", "time 0.20 s", "time 0.40 s", "time 0.60 s", "time 0.80 s",
                                              "time 1.00 s"}));
  EXPECT_NE(report.find("6 of 11 stored states"), std::string::npos);

  const std::string script = text("plane/figures/strip.gp");
  const auto x = ranges(script, 'x'), y = ranges(script, 'y');
  ASSERT_EQ(x.size(), labels.size());
  for (size_t i = 0; i < x.size(); ++i) {
    EXPECT_EQ(x[i], x[0]);
    EXPECT_EQ(y[i], y[0]);
  }
  for (const Eigen::VectorXd& u : record.states) {
    for (int i = 0; i < record.mesh.node_count(); ++i) {
      const Eigen::Vector2d mm = 1e3 * (record.mesh.node(i) + u.segment<2>(2 * i));
      ASSERT_TRUE(mm.x() > x[0].first && mm.x() < x[0].second && mm.y() > y[0].first && mm.y() < y[0].second);
    }
  }
  // also the ground at -35 mm and the cable's end 10 mm behind the clamp
  EXPECT_LT(y[0].first, -35);
  EXPECT_LT(x[0].first, -10);
}

TEST_F(SimulationFiles, TheStripInSpaceIsPaintedFromTheBackToTheFront) {
  const CsvTable table = read_csv(*folder_ / "space/figures/strip.csv");
  ASSERT_EQ(table.header.cells,
            (std::vector<std::string>{"turn_deg", "kind", "name", "part", "right_mm", "up_mm", "toward_viewer_mm"}));
  std::string sample;
  double before = -1e9, area = 0;
  int facets = 0, panels = 0;
  for (size_t i = 0; i < table.rows.size();) {
    const auto& cells = table.rows[i].cells;
    if (cells[1] != "facet") {
      ++i;
      continue;
    }
    ASSERT_LT(i + 2, table.rows.size());
    if (cells[0] != sample) {
      sample = cells[0];
      before = -1e9;
      ++panels;
    }
    Eigen::Matrix3d p;
    for (int k = 0; k < 3; ++k) {
      for (int c = 0; c < 3; ++c)
        p(c, k) = number(table.rows[i + static_cast<size_t>(k)].cells[static_cast<size_t>(4 + c)]);
    }
    const double depth = p.row(2).mean();
    EXPECT_GE(depth, before - 1e-6) << "facet at line " << table.rows[i].line;
    before = depth;
    // Seen from outside, so anticlockwise in the picture.
    const double twice = (p(0, 1) - p(0, 0)) * (p(1, 2) - p(1, 0)) - (p(0, 2) - p(0, 0)) * (p(1, 1) - p(1, 0));
    EXPECT_GT(twice, 0);
    if (panels == 1) {
      area += twice / 2;
      // Isometric: right = (x + y)/sqrt 2, depth = (x - y + z)/sqrt 3. The corners lie on the three visible faces.
      for (int k = 0; k < 3; ++k) {
        const double z = p(1, k) / std::sqrt(1.5) + p(2, k) / std::sqrt(3.0);
        const double difference = p(2, k) * std::sqrt(3.0) - z, sum = p(0, k) * std::sqrt(2.0);
        const double x = (sum + difference) / 2, y = (sum - difference) / 2;
        EXPECT_NEAR(std::min({std::abs(x - 10), std::abs(y + 10), std::abs(z - 60)}), 0, 1e-6);
      }
    }
    ++facets;
    i += 3;
  }
  EXPECT_EQ(panels, 4);
  EXPECT_GT(facets, 4 * 100);
  // Outline of the box at rest: each visible face has 1/sqrt 3 of its area.
  EXPECT_NEAR(area, (20 * 20 + 2 * 20 * 60) / std::sqrt(3.0), 1e-6);
}

TEST_F(SimulationFiles, EveryPictureAndPageSaysThatItIsASimulation) {
  for (const std::string& file : files_) {
    if (!file.ends_with(".svg") && !file.ends_with(".html")) continue;
    EXPECT_NE(text("plane/" + file).find("Simulation: "), std::string::npos) << file;
  }
  EXPECT_NE(text("plane/report.html").find("nothing was measured"), std::string::npos);
}

TEST_F(SimulationFiles, TheReportHoldsEveryFigureAndLoadsNothing) {
  const std::string report = text("plane/report.html");
  for (const char* part : {"A beam that &lt;bends&gt; &amp; swings", "implicit Euler, 41 steps", "taut simulate exp",
                           "simulation-data", "href=\"animation.html\"", "0.1.0", "bending_beam.pvd"}) {
    EXPECT_NE(report.find(part), std::string::npos) << part;
  }
  EXPECT_EQ(report.find("<bends>"), std::string::npos);
  EXPECT_EQ(count("plane/report.html", "<figure "), 8u);  // strip, two plots, workspaces, mm, deg, N, J
  for (const char* outside : {"src=", "@import", "href=\"http", "url(http"}) {
    EXPECT_EQ(report.find(outside), std::string::npos) << outside;
  }
}

TEST_F(SimulationFiles, WorkspacesAreNamedWithTheirAreas) {
  // pi 0.8 (8 mm)^2 and pi 0.8 (14 mm)^2
  const std::string svg = text("plane/figures/workspaces.svg");
  EXPECT_NE(svg.find("one cable: 1.61 ± 0.08 cm²"), std::string::npos);
  EXPECT_NE(svg.find("both cables: 4.93 ± 0.25 cm²"), std::string::npos);
  EXPECT_EQ(count("plane/figures/workspaces.csv", "both cables,outline,"), 40u);
}

TEST_F(SimulationFiles, AControlThatNeverMovesIsNotDrawnAndOneThatIsTheSampleVariableIsNotRepeated) {
  const auto header = [&](const std::string& file) {
    const std::string all = text(file);
    return all.substr(0, all.find('\n'));
  };
  EXPECT_EQ(header("plane/figures/channels_mm.csv"), "time_s,tip_x_mm,tip_y_mm,retraction_upper_mm");
  EXPECT_EQ(header("plane/figures/plot_path.csv"), "tip_x_mm,tip_y_mm");
  EXPECT_EQ(header("space/channels.csv"), "turn_deg,torque_Nm");
  EXPECT_EQ(header("space/figures/channels_Nm.csv"), "turn_deg,torque_Nm");
}

TEST(SimulationAtRest, RunsOverTheControlThatDrivesItAndItsPageBeginsWithWhatThePlotsFound) {
  SimulationRecord record = bending_beam(11);
  record.at_rest = true;
  record.plots = {{"pull", "What the cable does", "", {"tip_angle"}}};
  for (size_t k = 0; k < 21; ++k) {
    record.controls[0].values[k] = 1e-3 * static_cast<double>(k);
    record.channels[2].values[k] = k == 15 ? 1.2 : 0.05 * static_cast<double>(k);  // 1 rad in the end
  }
  record.channels[2].values[0] = 1e-7;
  const TemporaryFolder folder;
  write_simulation(record, folder / "run");
  const std::string page = text_of(folder / "run/report.html");
  const size_t answer = page.find(
      "What the cable does: turn of the tip goes from 0 deg at upper cable pulled in 0 mm to "
      "57.3 deg at upper cable pulled in 20 mm; the most is 68.75 deg at upper cable pulled "
      "in 15 mm.");
  ASSERT_NE(answer, std::string::npos);
  EXPECT_LT(answer, page.find("What happens"));
  EXPECT_NE(page.find("21 equilibria over upper cable pulled in from 0 mm to 20 mm"), std::string::npos);
  EXPECT_NE(page.find("upper cable pulled in 20 mm"), std::string::npos) << "in the strip";
  EXPECT_TRUE(text_of(folder / "run/figures/channels_deg.csv").starts_with("retraction_upper_mm,tip_angle_deg"));
  const auto json = nlohmann::json::parse(animation_json(record))["sample"];
  EXPECT_EQ(json["name"], "upper cable pulled in");
  EXPECT_EQ(json["seconds"], 0.0);
  EXPECT_EQ(json["values"].back(), 20.0);
  // Time drives where inertia is in it, and where no control moves.
  record.at_rest = false;
  EXPECT_EQ(driver_of(record), nullptr);
  record.at_rest = true;
  for (Series& control : record.controls) std::ranges::fill(control.values, 1.0);
  EXPECT_EQ(driver_of(record), nullptr);
}

TEST(SimulationRecord, ASeriesOfAnotherLengthIsAProgrammingError) {
  SimulationRecord record = bending_beam(3);
  record.channels[1].values.pop_back();
  TemporaryFolder folder;
  EXPECT_THROW(write_simulation(record, folder / "run"), std::logic_error);
  EXPECT_FALSE(std::filesystem::exists(folder / "run"));
}

TEST(SimulationRecord, FramesThatDoNotFitAreAProgrammingError) {
  const SimulationRecord good = bending_beam(3);
  EXPECT_NO_THROW(check(good));
  SimulationRecord record = good;
  record.frames = {0, 0, 4};
  EXPECT_THROW(check(record), std::logic_error);
  record.frames = {0, 2, 5};
  EXPECT_THROW(check(record), std::logic_error);
  record.frames = {0, 2};
  EXPECT_THROW(check(record), std::logic_error);
  record = good;
  record.states[1].conservativeResize(8);
  EXPECT_THROW(check(record), std::logic_error);
  record = good;
  record.frames.clear();
  record.states.clear();
  EXPECT_THROW(check(record), std::logic_error);
}

TEST(SimulationRecord, APlotOfAnUnknownSeriesNamesItAndTheNearest) {
  SimulationRecord record = bending_beam(3);
  record.plots[0].y = {"tip_z"};
  expect_input_error([&] { check(record); }, {"plot 'path'", "'tip_z'", "did you mean 'tip_", "retraction_upper"});
  record.plots[0] = {"path", "", "tme", {"tip_y"}};
  expect_input_error([&] { check(record); }, {"'tme'", "did you mean 'time'?"});
  record.plots[0].x = "time";
  EXPECT_NO_THROW(check(record));
}

TEST(SimulationRecord, TwoSeriesOfOneNameAreRefused) {
  SimulationRecord record = bending_beam(3);
  record.controls[0].id = "tip_x";
  expect_input_error([&] { check(record); }, {"'tip_x'", "its own name"});
}

TEST(SimulationRecord, ASingleStateOfASingleSampleIsWrittenToo) {
  TemporaryFolder folder;
  SimulationRecord record = bending_beam(1);
  record.workspaces.clear();
  record.plots.clear();
  record.channels.resize(1);
  write_simulation(record, folder / "run");
  EXPECT_GT(std::filesystem::file_size(folder / "run/figures/strip.png"), 1000u);
}

TEST(SimulationUnits, AreThoseOfTheBench) {
  for (const auto& [si, suffix] : {std::pair("m", "mm"),
                                   {"rad", "deg"},
                                   {"N", "N"},
                                   {"s", "s"},
                                   {"N/m", "N_per_m"},
                                   {"Pa", "kPa"},
                                   {"1", "1"},
                                   {"m2", "cm2"},
                                   {"m/s", "mm_per_s"}}) {
    const WrittenUnit unit = written_unit(si);
    EXPECT_EQ(unit.suffix, suffix);
    const HeaderUnit header = parse_header(std::string("x_") + suffix, {quantity_of_si_unit(si)}, "test");
    EXPECT_EQ(header.name, "x");
    EXPECT_DOUBLE_EQ(header.factor, unit.factor) << si;
  }
}

}  // namespace
}  // namespace taut

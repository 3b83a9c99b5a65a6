#include "calib/data/trials.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <random>
#include <string_view>

#include "tests/support/message.hpp"

namespace taut {
namespace {

using test::expect_input_error;
namespace fs = std::filesystem;

/// A temporary folder that goes when the test ends, and the bench format that most tests share.
class ReadTrials : public testing::Test {
 protected:
  ReadTrials() {
    std::random_device random;
    do {
      folder_ = fs::temp_directory_path() / ("taut_trials_" + std::to_string(random()));
    } while (!fs::create_directory(folder_));
    format_.path = (folder_ / "bench.csv").string();
    format_.trial_column = "trial";
    format_.controls = {{"retraction", "retraction_mm", {Quantity::length}},
                        {"load", "mass_g", {Quantity::force, Quantity::mass}}};
    format_.channels = {
        {"drop", "drop_mm", Quantity::length, {.absolute = 2e-5, .relative = 0.015, .resolution = 1e-5}}};
  }
  ~ReadTrials() override {
    std::error_code ignored;
    fs::remove_all(folder_, ignored);
  }

  void write(std::string_view text) const { std::ofstream(format_.path, std::ios::binary) << text; }

  Trials read(std::string_view text) const {
    write(text);
    return read_trials(format_);
  }

  /// Reading `text` fails with a message that begins with the file's name and holds all `parts`.
  void expect_refused(std::string_view text, std::vector<std::string> parts) const {
    write(text);
    parts.push_back("bench.csv");
    expect_input_error([&] { read_trials(format_); }, parts);
  }

  /// A format for one channel and no controls.
  void use_only(const std::string& column, InstrumentNoise noise = {.absolute = 1e-5}) {
    format_.trial_column.clear();
    format_.controls.clear();
    format_.channels = {{"drop", column, Quantity::length, noise}};
  }

  void use_long_file() {
    format_.channels = {{"tip", "", Quantity::length, {.absolute = 1e-5}},
                        {"middle", "", Quantity::length, {.absolute = 2e-5}}};
    format_.channel_column = "marker";
    format_.value_column = "drop_mm";
  }

  fs::path folder_;
  BenchFormat format_;
};

constexpr std::string_view kHeader = "trial,retraction_mm,mass_g,drop_mm\n";
const std::string kGood =
    std::string(kHeader) + "1,0.0,50.0,3.55\n2,0.0,50.0,3.52\n1,2.5,50.0,-1.25e-1\n2,2.5,50.0,+0.1\n";

std::string with_header(std::string_view rows) {
  return std::string(kHeader) + std::string(rows);
}

std::string replaced(std::string text, std::string_view from, std::string_view to) {
  for (size_t at = text.find(from); at != std::string::npos; at = text.find(from, at + to.size())) {
    text.replace(at, from.size(), to);
  }
  return text;
}

void expect_identical(const Trials& a, const Trials& b, int line_shift = 0) {
  EXPECT_EQ(a.control_ids, b.control_ids);
  EXPECT_EQ(a.control_quantities, b.control_quantities);
  EXPECT_EQ(a.channel_ids, b.channel_ids);
  ASSERT_EQ(a.readings.size(), b.readings.size());
  for (size_t i = 0; i < a.readings.size(); ++i) {
    EXPECT_EQ(a.readings[i].line + line_shift, b.readings[i].line);
    EXPECT_EQ(a.readings[i].trial, b.readings[i].trial);
    EXPECT_EQ(a.readings[i].controls, b.readings[i].controls);
    EXPECT_EQ(a.readings[i].channel, b.readings[i].channel);
    EXPECT_EQ(a.readings[i].value, b.readings[i].value);
    EXPECT_EQ(a.readings[i].sigma, b.readings[i].sigma);
  }
}

bool has_remark(const Trials& trials, std::string_view part) {
  for (const std::string& remark : trials.remarks) {
    if (remark.find(part) != std::string::npos) return true;
  }
  return false;
}

// ---------------------------------------------------------------------------------------------------------------------
// Right files

TEST(InstrumentNoise, AddsItsPartsInQuadratureAndRoundingAsAUniformError) {
  EXPECT_EQ(InstrumentNoise{}.sigma(5), 0.0);
  EXPECT_DOUBLE_EQ((InstrumentNoise{.absolute = 3}).sigma(1e9), 3);
  EXPECT_DOUBLE_EQ((InstrumentNoise{.relative = 0.5}).sigma(-8), 4);
  EXPECT_DOUBLE_EQ((InstrumentNoise{.resolution = 1}).sigma(7), 0.28867513459481287);  // 1 / sqrt(12)
  // sqrt(3^2 + 4^2 + 12^2) = 13
  EXPECT_DOUBLE_EQ((InstrumentNoise{.absolute = 3, .relative = 0.5, .resolution = 12 * std::sqrt(12.0)}).sigma(8), 13);
}

TEST_F(ReadTrials, TurnsCellsIntoSiWithTheirLines) {
  const Trials trials = read(kGood);
  EXPECT_EQ(trials.control_ids, (std::vector<std::string>{"retraction", "load"}));
  EXPECT_EQ(trials.control_quantities, (std::vector<Quantity>{Quantity::length, Quantity::mass}));
  EXPECT_EQ(trials.channel_ids, std::vector<std::string>{"drop"});
  ASSERT_EQ(trials.readings.size(), 4u);
  const Reading& third = trials.readings[2];
  EXPECT_EQ(third.line, 4);
  EXPECT_EQ(third.trial, "1");
  EXPECT_EQ(third.channel, 0);
  ASSERT_EQ(third.controls.size(), 2u);
  EXPECT_DOUBLE_EQ(third.controls[0], 2.5e-3);
  EXPECT_DOUBLE_EQ(third.controls[1], 50e-3);
  EXPECT_DOUBLE_EQ(third.value, -1.25e-4);
  EXPECT_DOUBLE_EQ(third.sigma, std::sqrt(2e-5 * 2e-5 + 0.015 * 1.25e-4 * 0.015 * 1.25e-4 + 1e-10 / 12));
  EXPECT_DOUBLE_EQ(trials.readings[3].value, 1e-4);
}

TEST_F(ReadTrials, EveryDialectGivesBitIdenticalReadings) {
  const Trials plain = read(kGood);
  const std::string semicolons = replaced(kGood, ",", ";");
  expect_identical(plain, read(semicolons));
  expect_identical(plain, read(replaced(semicolons, ".", ",")));
  expect_identical(plain, read(replaced(kGood, ",", "\t")));
  expect_identical(plain, read(replaced(replaced(kGood, ",", "\t"), ".", ",")));
  expect_identical(plain, read(replaced(kGood, "\n", "\r\n")));
  expect_identical(plain, read("\xEF\xBB\xBF" + kGood));
  expect_identical(plain, read("\xEF\xBB\xBF" + replaced(replaced(semicolons, ".", ","), "\n", "\r\n")));
  expect_identical(plain, read(kGood.substr(0, kGood.size() - 1)));
  expect_identical(plain, read(replaced(kGood, ",", " , ")));
  expect_identical(
      plain, read("\"" + replaced(replaced(kGood.substr(0, kGood.size() - 1), ",", "\",\""), "\n", "\"\n\"") + "\"\n"));
  expect_identical(plain, read("# a comment, with; separators\n\n" + kGood), 2);
  expect_identical(plain, read(kGood + "\n   \n# the end"));
}

TEST_F(ReadTrials, TheOrderOfColumnsDoesNotMatter) {
  const Trials plain = read(kGood);
  expect_identical(plain,
                   read("drop_mm,mass_g,trial,retraction_mm\n3.55,50.0,1,0.0\n3.52,50.0,2,0.0\n-1.25e-1,50.0,1,2.5\n"
                        "+0.1,50.0,2,2.5\n"));
}

TEST_F(ReadTrials, RemarksSayWhatWasRecognised) {
  const Trials plain = read(kGood);
  EXPECT_EQ(plain.remarks, std::vector<std::string>{"4 readings: 2 conditions x 2 trials"});
  const Trials dressed =
      read("\xEF\xBB\xBF# by hand\r\n" + replaced(replaced(replaced(kGood, ",", ";"), ".", ","), "\n", "\r\n"));
  EXPECT_TRUE(has_remark(dressed, "semicolons and decimal commas"));
  EXPECT_TRUE(has_remark(dressed, "BOM"));
  EXPECT_TRUE(has_remark(dressed, "CRLF"));
  EXPECT_TRUE(has_remark(dressed, "1 comment line skipped"));
  EXPECT_TRUE(has_remark(read(replaced(kGood, ",", "\t")), "tabs between cells"));
  EXPECT_TRUE(has_remark(read(kGood + "3,2.5,50,0.2\n"), "5 readings: 2 conditions, 2 to 3 trials each"));
}

TEST_F(ReadTrials, RepeatsAreKeptWithAndWithoutATrialColumn) {
  EXPECT_EQ(read(kGood).readings.size(), 4u);
  format_.trial_column.clear();
  const Trials trials = read("retraction_mm,mass_g,drop_mm\n0,50,3.55\n0,50,3.55\n0,50,3.56\n");
  ASSERT_EQ(trials.readings.size(), 3u);
  EXPECT_EQ(trials.readings[0].value, trials.readings[1].value);
  EXPECT_EQ(trials.readings[2].trial, "");
  EXPECT_TRUE(has_remark(trials, "3 readings: 1 condition x 3 trials"));
}

TEST_F(ReadTrials, WideFilesGiveOneReadingPerRowAndChannel) {
  format_.channels.push_back({"pull", "pull_N", Quantity::force, {.absolute = 0.1}});
  const Trials trials = read("trial,retraction_mm,mass_g,drop_mm,pull_N\n1,0,50,3.5,7\n2,0,50,3.6,8\n");
  ASSERT_EQ(trials.readings.size(), 4u);
  EXPECT_EQ(trials.readings[1].channel, 1);
  EXPECT_EQ(trials.readings[1].line, 2);
  EXPECT_EQ(trials.readings[1].value, 7);
  EXPECT_EQ(trials.readings[1].sigma, 0.1);
  EXPECT_DOUBLE_EQ(trials.readings[2].value, 3.6e-3);
  EXPECT_TRUE(has_remark(trials, "4 readings: 1 condition x 2 channels x 2 trials"));
}

TEST_F(ReadTrials, LongFilesNameTheChannelInEachRow) {
  use_long_file();
  const Trials trials =
      read("trial,retraction_mm,mass_g,marker,drop_mm\n1,0,50,middle,1.5\n1,0,50,tip,3.5\n1,2,50,tip,3\n");
  ASSERT_EQ(trials.readings.size(), 3u);
  EXPECT_EQ(trials.readings[0].channel, 1);
  EXPECT_DOUBLE_EQ(trials.readings[0].value, 1.5e-3);
  EXPECT_EQ(trials.readings[0].sigma, 2e-5);
  EXPECT_EQ(trials.readings[1].channel, 0);
  EXPECT_EQ(trials.readings[1].sigma, 1e-5);
  EXPECT_TRUE(has_remark(trials, "3 readings: 2 conditions, 2 channels, 0 to 1 trials each"));
}

TEST_F(ReadTrials, ASigmaColumnOverridesTheNoiseOfAllChannelsOfItsRow) {
  format_.channels.push_back({"sag", "sag_cm", Quantity::length, {}});
  format_.sigma_column = "sd_um";
  const Trials trials = read("trial,retraction_mm,mass_g,drop_mm,sag_cm,sd_um\n1,0,50,3.5,0.1,20\n2,0,50,0,0.1,30\n");
  ASSERT_EQ(trials.readings.size(), 4u);
  for (size_t i = 0; i < 4; ++i) EXPECT_DOUBLE_EQ(trials.readings[i].sigma, i < 2 ? 20e-6 : 30e-6);
}

TEST_F(ReadTrials, IgnoredColumnsMayHoldAnythingOrBeAbsent) {
  format_.ignored = {"note", "not there"};
  const Trials trials =
      read("trial,retraction_mm,mass_g,drop_mm,note\n1,0,50,3.5,\"said \"\"ok\"\", 1,5\"\n2,0,50,3.5,\n");
  EXPECT_EQ(trials.readings.size(), 2u);
  EXPECT_TRUE(has_remark(trials, "columns ignored: note"));
}

TEST_F(ReadTrials, AFileOfOneColumnIsEnough) {
  use_only("drop_mm");
  const Trials trials = read("drop_mm\n1\n2");
  ASSERT_EQ(trials.readings.size(), 2u);
  EXPECT_DOUBLE_EQ(trials.readings[1].value, 2e-3);
}

TEST_F(ReadTrials, LongFilesOfManyRowsKeepTheirLineNumbers) {
  use_only("drop_mm");
  std::string text = "drop_mm\n";
  for (int i = 0; i < 20000; ++i) text += std::to_string(i) + "\n";
  const Trials trials = read(text);
  ASSERT_EQ(trials.readings.size(), 20000u);
  EXPECT_EQ(trials.readings.back().line, 20001);
  EXPECT_DOUBLE_EQ(trials.readings.back().value, 19.999);
}

// ---------------------------------------------------------------------------------------------------------------------
// Exports

/// A file of a spreadsheet or a machine that says: forces of 0.05 N and 1200 N, drops of 0.53 mm and 1.07 mm.
struct Export {
  const char* name;
  std::string load, drop;  ///< columns as the experiment names them
  std::string text;
  std::vector<std::string> ignored = {};
};

std::vector<Export> exports() {
  const std::string bom = "\xEF\xBB\xBF";
  return {
      {"plain", "load_N", "drop_mm", "load_N,drop_mm\n0.05,0.53\n1200,1.07\n"},
      {"Excel, German", "load_N", "drop_mm", "load_N;drop_mm\r\n0,05;0,53\r\n1200;1,07\r\n"},
      {"Excel, German, CSV UTF-8", "load_N", "drop_mm", bom + "load_N;drop_mm\r\n0,05;0,53\r\n1200;1,07\r\n"},
      {"Excel, declared separator", "load_N", "drop_mm", "sep=;\r\nload_N;drop_mm\r\n0,05;0,53\r\n1200;1,07\r\n"},
      {"Excel, text with tabs", "load_N", "drop_mm", "load_N\tdrop_mm\r\n0,05\t0,53\r\n1200\t1,07\r\n"},
      {"Excel for the Mac of old", "load_N", "drop_mm", "load_N;drop_mm\r0,05;0,53\r1200;1,07\r"},
      {"points between thousands", "load_N", "drop_mm", "load_N;drop_mm\n0,05;0,53\n1.200,0;1,07\n"},
      {"commas between thousands", "load_N", "drop_mm", "load_N,drop_mm\n0.05,0.53\n\"1,200.0\",1.07\n"},
      {"blanks between thousands", "load_N", "drop_mm", "load_N;drop_mm\n0,05;0,53\n1 200;1,07\n"},
      {"hard blanks of cp1252", "load_N", "drop_mm",
       "load_N;drop_mm\n0,05;0,53\n1\xA0"
       "200;1,07\n"},
      {"Swiss", "load_N", "drop_mm", "load_N;drop_mm\n0.05;0.53\n1'200.00;1.07\n"},
      {"quoted decimal commas", "load_N", "drop_mm", "load_N,drop_mm\n\"0,05\",\"0,53\"\n\"1200,0\",\"1,07\"\n"},
      {"units in round brackets", "Load (N)", "Drop (mm)", "Load (N),Drop (mm)\n0.05,0.53\n1200,1.07\n"},
      {"units in square brackets", "Load [N]", "Drop [mm]", "Load [N];Drop [mm]\n0,05;0,53\n1200;1,07\n"},
      {"units after a slash", "Kraft / N", "Weg / mm", "Kraft / N;Weg / mm\n0,05;0,53\n1200;1,07\n"},
      {"units after in", "Kraft in N", "Weg in mm", "Kraft in N;Weg in mm\n0,05;0,53\n1200;1,07\n"},
      {"another spelling of the header", "Load_N", "Drop_mm", "Load [N],Drop (mm)\n0.05,0.53\n1200,1.07\n"},
      {"names alone", "Load", "Drop", "Load (kN),Drop (cm)\n0.00005,0.053\n1.2,0.107\n"},
      {"units row", "Load", "Drop", "Load,Drop\nN,mm\n0.05,0.53\n1200,1.07\n"},
      {"units row in brackets",
       "Load",
       "Drop",
       "Time,Load,Drop\n(s),(kN),(mm)\n\"0\",\"0.00005\",\"0.53\"\n\"1\",\"1.2\",\"1.07\"\n",
       {"Time"}},
      {"units row of a universal machine",
       "Standardkraft",
       "Standardweg",
       "\"Pr\xFC"
       "fzeit\";\"Standardkraft\";\"Standardweg\"\r\n\"s\";\"N\";\"\xB5m\"\r\n0;0,05;530\r\n1;1200;1070\r\n",
       {"Prüfzeit"}},
      {"preamble of commas",
       "Load",
       "Extension",
       "Specimen : Anvil height,\"3,11\",mm\r\nSpecimen : "
       "Geometry,Circular\r\n\r\nTime,Extension,Load\r\n(s),(mm),(N)\r\n\"0,0\",\"0,53\",\"0,05\"\r\n\"0,1\",\"1,07\","
       "\"1200,0\"\r\n",
       {"Time"}},
      {"preamble of keys and values",
       "Kraft_N",
       "Weg_mm",
       "Operator;M\xFCller\nDatum;28.11.2026\nLoad cell;500\n\nNr;Weg_mm;Kraft_N\n1;0,53;0,05\n2;1,07;1200\n",
       {"Nr"}},
      {"preamble padded by separators",
       "load_N",
       "drop_mm",
       "General : Number,1,,\nLength,50,mm,\n,,,\nload_N,drop_mm,x,\n0.05,0.53,1,\n1200,1.07,1,\n",
       {"x"}},
      {"end of header mark", "load_N", "drop_mm",
       "LabVIEW Measurement\nSeparator\tTab\n***End_of_Header***\nload_N\tdrop_mm\n0.05\t0.53\n1200\t1.07\n"},
      {"footer below an empty line", "load_N", "drop_mm",
       "load_N,drop_mm\n0.05,0.53\n1200,1.07\n\nMean,0.8\nPeak load,1200\n"},
      {"footer at once", "load_N", "drop_mm",
       "load_N;drop_mm\n0,05;0,53\n1200;1,07\nMittelwert;0,8\nStandardabweichung;0,3\n"},
      {"a sentence at the end", "load_N", "drop_mm", "load_N,drop_mm\n0.05,0.53\n1200,1.07\n*** end of test ***\n"},
      {"comments", "load_N", "drop_mm", "% by hand\nload_N,drop_mm\n# first\n0.05,0.53\n1200,1.07\n% end, 2 rows\n"},
      {"header in a comment", "load_N", "drop_mm", "# load_N,drop_mm\n0.05,0.53\n1200,1.07\n"},
      {"trailing separators and empty rows", "load_N", "drop_mm",
       "load_N;drop_mm;;\n0,05;0,53;;\n1200;1,07;;\n;;;\n;;;\n"},
      {"a column of numbers called #", "load_N", "drop_mm", "#;load_N;drop_mm\n1;0,05;0,53\n2;1200;1,07\n", {"#"}},
      {"columns without use, by number",
       "load_N",
       "drop_mm",
       "load_N,??,drop_mm,\n0.05,x,0.53,y\n1200,x,1.07,y\n",
       {"#2", "#4"}},
  };
}

TEST_F(ReadTrials, ExportsOfSpreadsheetsAndMachinesGiveTheSameNumbers) {
  format_.trial_column.clear();
  for (const Export& from : exports()) {
    SCOPED_TRACE(from.name);
    format_.controls = {{"load", from.load, {Quantity::force, Quantity::mass}}};
    format_.channels = {{"drop", from.drop, Quantity::length, {.absolute = 1e-5}}};
    format_.ignored = from.ignored;
    const Trials trials = read(from.text);
    ASSERT_EQ(trials.readings.size(), 2u);
    EXPECT_DOUBLE_EQ(trials.readings[0].controls[0], 0.05);
    EXPECT_DOUBLE_EQ(trials.readings[1].controls[0], 1200);
    EXPECT_DOUBLE_EQ(trials.readings[0].value, 0.53e-3);
    EXPECT_DOUBLE_EQ(trials.readings[1].value, 1.07e-3);
  }
}

TEST_F(ReadTrials, WhatWasFoundAroundATableIsSaid) {
  format_.trial_column.clear();
  format_.controls.clear();
  format_.channels[0].column = "Weg";
  format_.ignored = {"Kraft"};
  const Trials trials = read(
      "Pr\xFC"
      "fer;M\n\nWeg;Kraft\nmm;N\n0,5;1\n0,6;2\n\nMittelwert;1,5\n");
  ASSERT_EQ(trials.readings.size(), 2u);
  EXPECT_EQ(trials.readings[0].line, 5);
  EXPECT_EQ(trials.layout, format_.path +
                               ": table from line 3, ';' between columns, decimal commas, units in line 4, " +
                               "footer from line 8, not UTF-8 in line 1: such bytes taken as cp1252 (Windows)");
}

TEST_F(ReadTrials, ReadingsThatWereNotTakenAreCounted) {
  format_.channels.push_back({"sag", "sag_mm", Quantity::length, {.absolute = 1e-5}});
  for (const char* cell : {"", "NA", "N/A", "NaN", "nan", "-", "--", "null", "n.a."}) {
    SCOPED_TRACE(cell);
    const Trials trials = read("trial,retraction_mm,mass_g,drop_mm,sag_mm\n1,0,50,3.5," + std::string(cell) +
                               "\n1,0,400," + cell + "," + cell + "\n2,0,50,3.6,2\n");
    ASSERT_EQ(trials.readings.size(), 3u);
    EXPECT_DOUBLE_EQ(trials.readings[2].value, 2e-3);
    EXPECT_EQ(trials.control_values[1].size(), 1u);  // nothing was read at 400 g
    EXPECT_TRUE(has_remark(trials, "3 readings not taken"));
  }
  expect_refused("trial,retraction_mm,mass_g,drop_mm,sag_mm\n1,0,NA,3,3\n", {"line 2, column 'mass_g': 'NA'"});
  expect_refused("trial,retraction_mm,mass_g,drop_mm,sag_mm\n1,0,50,NA,-\n", {"line 2", "no row below", "all 2"});
}

TEST_F(ReadTrials, AWrongCellInTheLastRowIsNoFooter) {
  expect_refused(with_header("1,0,50,3\n1,2.5,5O,3\n"), {"line 3, column 'mass_g': '5O'"});
  expect_refused(with_header("1,0,50,3\n\n1,2.5,5O,3\n"), {"line 4, column 'mass_g': '5O'"});
  expect_refused(with_header("1,0,50,3\n\n1,2.5,50\n"), {"line 4: found 3 cells"});
  expect_refused(with_header("1,0,50,3\n\n,2.5,50,3\n"), {"line 4, column 'trial': the cell is empty"});
}

TEST_F(ReadTrials, ATableThatCannotBeUsedIsAnsweredWithWhereItSeemsToStart) {
  expect_refused("Operator;Max\nDate;today\n\nWeg;Kraft\nmm;N\n1;2\n3;4\n",
                 {"line 4: column 'trial'", "Weg, Kraft", "the table seems to start here"});
  expect_refused("1,2,50,3\n2,2,50,3\n", {"line 1: the table seems to start here, with numbers and no names"});
}

TEST_F(ReadTrials, AUnitsRowThatContradictsAHeaderIsRefused) {
  expect_refused("trial,retraction_mm,mass_g,drop_mm\n,mm,g,cm\n1,0,50,3\n",
                 {"line 2: the unit of column 'drop_mm' is 'cm' here and 'mm' in the header"});
}

TEST_F(ReadTrials, TextInCp1252IsTakenAndSaid) {
  const Trials trials =
      read(with_header("Pr\xFC"
                       "fung,0,50,3\n"));
  EXPECT_EQ(trials.readings[0].trial, "Prüfung");
  EXPECT_NE(trials.layout.find("not UTF-8 in line 2: such bytes taken as cp1252"), std::string::npos);
  EXPECT_EQ(read(with_header("\x80\xB5,0,50,3\n")).readings[0].trial, "€µ");
  EXPECT_EQ(read(with_header("\xC3\xBC\xFC,0,50,3\n")).readings[0].trial, "üü");
}

// ---------------------------------------------------------------------------------------------------------------------
// Wrong files

TEST_F(ReadTrials, AMissingFileIsAnsweredWithTheNearestName) {
  write(kGood);
  format_.path = (folder_ / "bensh.csv").string();
  expect_input_error([&] { read_trials(format_); }, {"bensh.csv: there is no such file", "did you mean 'bench.csv'?"});
  format_.path = (folder_ / "no" / "such" / "folder.csv").string();
  expect_input_error([&] { read_trials(format_); }, {"folder.csv: there is no such file"});
  format_.path = folder_.string();
  expect_input_error([&] { read_trials(format_); }, {"this is a folder", "CSV file"});
}

TEST_F(ReadTrials, AnEmptyFileIsRefused) {
  for (const char* text : {"", "\n\n", "# only a comment\n", "\xEF\xBB\xBF", "\xEF\xBB\xBF\r\n"}) {
    expect_refused(text, {"the file is empty", "header line"});
  }
}

TEST_F(ReadTrials, AHeaderWithoutRowsIsRefused) {
  expect_refused(kHeader, {"line 1", "no row below it", "one row per reading"});
}

TEST_F(ReadTrials, AMissingColumnIsAnsweredWithThoseThereAndTheNearest) {
  expect_refused("trial,retraction_mm,mass_g,dropp_mm\n1,0,50,3\n",
                 {"line 1: column 'drop_mm' for channel 'drop' is missing",
                  "the header has: trial, retraction_mm, mass_g, dropp_mm", "did you mean 'dropp_mm'?"});
  expect_refused("trial|retraction_mm|mass_g|drop_mm\n1|0|50|3\n", {"'trial'", "commas, semicolons or tabs"});
}

TEST_F(ReadTrials, AColumnThatIsThereInAnotherUnitIsNamedWithBothUnits) {
  expect_refused("trial,retraction_mm,mass_kg,drop_mm\n1,0,0.05,3\n",
                 {"line 1: column 'mass_g' for control 'load' is missing", "there is 'mass_kg', in kg instead of g",
                  "experiment file"});
}

TEST_F(ReadTrials, AColumnThatIsNotUsedIsRefusedUnlessItIsIgnored) {
  expect_refused("trial,retraction_mm,mass_g,drop_mm,note\n1,0,50,3,x\n",
                 {"line 1: column 'note' is not used", "list it under ignore"});
}

TEST_F(ReadTrials, DuplicateAndNamelessColumnsAreRefused) {
  expect_refused("trial,retraction_mm,mass_g,drop_mm,mass_g\n1,0,50,3,50\n",
                 {"line 1: column 'mass_g' stands twice, as columns 3 and 5", "own name"});
  expect_refused("trial,retraction_mm,mass_g,drop_mm,\n1,0,50,3,x\n", {"line 1: column 5 of 5 has no name", "delete"});
}

TEST_F(ReadTrials, AWrongOrMissingUnitIsRefused) {
  format_.channels[0].column = "drop_s";
  expect_refused("trial,retraction_mm,mass_g,drop_s\n1,0,50,3\n",
                 {"line 1, channel 'drop': column 'drop_s' ends in 's', a unit of time, but length is needed", "_mm"});
  format_.channels[0].column = "drop";
  expect_refused("trial,retraction_mm,mass_g,drop\n1,0,50,3\n",
                 {"line 1, channel 'drop': column 'drop' does not end in a unit of length", "'drop_m'"});
  format_.controls[1].column = "mass";
  expect_refused("trial,retraction_mm,mass,drop\n1,0,50,3\n", {"control 'load'", "unit of force or mass"});
}

TEST_F(ReadTrials, AnEmptyCellIsRefused) {
  expect_refused(with_header("1,0,50,3\n2,0,,3\n"), {"line 3, column 'mass_g': the cell is empty", "delete the row"});
  expect_refused(with_header("1,0,50,3\n ,0,50,3\n"), {"line 3, column 'trial': the cell is empty"});
}

TEST_F(ReadTrials, RowsOfALongFileMayHoldSeveralCoordinatesOfAMarker) {
  use_long_file();
  format_.value_column.clear();
  const BenchFormat::Channel like = format_.channels.front();
  format_.channels.clear();
  for (const char* id : {"tip_x", "tip_z", "base_x"}) {
    BenchFormat::Channel& channel = format_.channels.emplace_back(like);
    channel.id = id;
    channel.label = std::string(id).substr(0, std::string(id).find('_'));
    channel.column = std::string(1, id[std::string(id).size() - 1]) + "_mm";
  }
  const Trials trials =
      read("trial,retraction_mm,mass_g,marker,x_mm,z_mm\na,0,10,tip,1,2\na,0,10,base,3,4\na,0,20,tip,NA,6\n");
  ASSERT_EQ(trials.readings.size(), 4u);
  EXPECT_EQ(trials.readings[0].channel, 0);
  EXPECT_DOUBLE_EQ(trials.readings[1].value, 2e-3);
  EXPECT_EQ(trials.readings[1].channel, 1);
  EXPECT_DOUBLE_EQ(trials.readings[2].value, 3e-3);
  EXPECT_EQ(trials.readings[2].channel, 2);
  EXPECT_EQ(trials.readings[3].line, 4);
  EXPECT_EQ(trials.readings[3].channel, 1);
  expect_refused("trial,retraction_mm,mass_g,marker,x_mm,z_mm\na,0,10,tp,1,2\n",
                 {"'tp' is not a channel of the experiment (did you mean 'tip'?); it has: tip, base"});
}

TEST_F(ReadTrials, ATensionThatPushesIsRefused) {
  format_.controls[1] = {"pull", "pull_N", {Quantity::force}, true};
  expect_refused("trial,retraction_mm,pull_N,drop_mm\na,0,1,1\na,0,-2,1\n",
                 {"line 3, column 'pull_N': the tension is '-2', but a cable cannot push"});
}

TEST_F(ReadTrials, TextWhereANumberBelongsIsRefused) {
  for (const char* cell : {"abc", "3.5 mm", "3.5mm", "--3", "+-3", "0x10", "1e", "3;5"}) {
    expect_refused(with_header(std::string("1,0,50,") + cell + "\n"),
                   {"line 2, column 'drop_mm': '" + std::string(cell) + "' is not a finite number", "12.5"});
  }
  expect_refused(with_header("1,0,50,\xE2\x88\x92"
                             "3\n"),
                 {"line 2, column 'drop_mm'", "special character"});
}

TEST_F(ReadTrials, InfinityAndOverflowAreRefused) {
  for (const char* cell : {"-nan", "inf", "-Infinity", "1e999"}) {
    expect_refused(with_header(std::string("1,0,50,") + cell + "\n"),
                   {"line 2, column 'drop_mm': '" + std::string(cell) + "' is not a finite number", "delete the row"});
  }
}

TEST_F(ReadTrials, RowsWithTooFewOrTooManyCellsAreRefused) {
  expect_refused(with_header("1,0,50,3\n1,2,50\n"), {"line 3: found 3 cells where the header in line 1 has 4"});
  expect_refused(with_header("1\n"), {"line 2: found 1 cell where"});
  expect_refused("# c\n" + with_header("1,0,50,3,4\n"), {"line 3: found 5 cells where the header in line 2 has 4"});
}

TEST_F(ReadTrials, DecimalCommasBetweenCommasAreSuspected) {
  expect_refused(with_header("1,0,50,3,55\n"),
                 {"line 2: found 5 cells", "a decimal comma? it needs semicolons or tabs"});
}

TEST_F(ReadTrials, DecimalPointsAndCommasInOneFileAreRefused) {
  expect_refused("trial;retraction_mm;mass_g;drop_mm\n1;0;50;3,5\n2;0;50.1;3,5\n",
                 {"line 2, column 'drop_mm': '3,5' has a decimal comma",
                  "'50.1' in line 3, column 'mass_g' has a decimal point", "one of them"});
}

TEST_F(ReadTrials, ThousandsSeparatorsThatMayBeDecimalOnesAreRefused) {
  expect_refused(with_header("1,0,50,\"1,234\"\n"),
                 {"line 2, column 'drop_mm': '1,234' may be 1.234 or 1234", "without thousands separators"});
  expect_refused("trial;retraction_mm;mass_g;drop_mm\n1;0;50;1.234,5\n2;0;50;1,234.5\n", {"'1.234,5'", "line 2"});
}

TEST_F(ReadTrials, AnUnknownChannelIsAnsweredWithTheKnownOnes) {
  use_long_file();
  expect_refused("trial,retraction_mm,mass_g,marker,drop_mm\n1,0,50,midle,3\n",
                 {"line 2, column 'marker': 'midle' is not a channel", "did you mean 'middle'?", "tip, middle"});
}

TEST_F(ReadTrials, AReadingThatStandsTwiceIsNamedWithBothLines) {
  expect_refused(with_header("1,0,50,3\n2,0,50,3\n1,0.0,50.0,4\n"),
                 {"line 4: the reading of channel 'drop' stands twice, first in line 2", "trial '1'",
                  "retraction_mm = 0.0", "mass_g = 50.0", "column 'trial'"});
  use_long_file();
  expect_refused("trial,retraction_mm,mass_g,marker,drop_mm\n1,0,50,tip,3\n1,0,50,middle,3\n1,0,50,middle,3\n",
                 {"line 4: the reading of channel 'middle' stands twice, first in line 3"});
}

TEST_F(ReadTrials, SigmaMustBePositive) {
  format_.sigma_column = "sd_mm";
  const std::string header = "trial,retraction_mm,mass_g,drop_mm,sd_mm\n";
  expect_refused(header + "1,0,50,3,0.1\n2,0,50,3,0\n", {"line 3, column 'sd_mm': sigma is '0'", "positive"});
  expect_refused(header + "1,0,50,3,-0.1\n", {"line 2, column 'sd_mm': sigma is '-0.1'"});
  expect_refused(header + "1,0,50,3,\n", {"line 2, column 'sd_mm': the cell is empty"});
  expect_refused(header + "1,0,50,3,nan\n", {"line 2, column 'sd_mm': 'nan' is not a finite number"});
}

TEST_F(ReadTrials, SigmaHasTheQuantityOfItsChannel) {
  format_.sigma_column = "sd_g";
  expect_refused("trial,retraction_mm,mass_g,drop_mm,sd_g\n1,0,50,3,0.1\n",
                 {"sigma of channel 'drop'", "'sd_g'", "length is needed"});
}

TEST_F(ReadTrials, AChannelWithoutNoiseIsRefusedWithTheKeysThatGiveIt) {
  format_.channels[0].noise = {};
  expect_refused(kGood,
                 {"channel 'drop' has no noise", "absolute, relative or resolution", "[[channel]]", "sigma column"});
  format_.channels[0].noise = {.absolute = -1};
  expect_refused(kGood, {"noise of channel 'drop' has the value -1"});
  format_.channels[0].noise = {.relative = std::numeric_limits<double>::quiet_NaN()};
  expect_refused(kGood, {"noise of channel 'drop' has the value nan"});
}

TEST_F(ReadTrials, AZeroReadingNeedsMoreThanRelativeNoise) {
  format_.channels[0].noise = {.relative = 0.02};
  expect_refused(with_header("1,0,50,3\n2,0,50,0.0\n"),
                 {"line 3, column 'drop_mm'", "sigma = 0 for the reading '0.0'", "absolute or resolution"});
}

TEST_F(ReadTrials, AnUnclosedQuoteIsRefused) {
  expect_refused(with_header("1,0,50,3\n1,2,50,\"3\n"), {"line 3: a quoted cell is not closed"});
  expect_refused("trial,\"retraction_mm,mass_g,drop_mm\n1,0,50,3\n", {"line 1: a quoted cell is not closed"});
}

TEST_F(ReadTrials, SpreadsheetsAndOtherBinaryFilesAreRefused) {
  using namespace std::string_view_literals;
  expect_refused("PK\x03\x04\0\0\0"sv, {"line 1, byte 0: this is a zip archive", ".xlsx", "CSV UTF-8"});
  expect_refused("\xD0\xCF\x11\xE0\xA1\xB1"sv, {"line 1, byte 0: this is a workbook of Excel (.xls)", "CSV UTF-8"});
  expect_refused("\xFF\xFEt\0r\0i\0\n\0"sv, {"line 1, byte 0: this is text in UTF-16", "CSV UTF-8"});
  expect_refused("trial,x\n1,\0"sv, {"line 2, byte 10: there is a zero byte", "CSV UTF-8"});
}

TEST_F(ReadTrials, ALineBeyondTheLimitIsRefused) {
  expect_refused(with_header("1,0,50," + std::string(size_t{1} << 24, '1') + "\n"),
                 {"line 2: the line is longer than 16777215"});
}

TEST_F(ReadTrials, LongAndStrangeTextIsShortenedInMessages) {
  expect_refused(with_header("1,0,50," + std::string(1000, 'x') + "\n"), {"xxxx...' is not a finite number"});
  expect_refused(with_header("1,0,50,a\x01"
                             "b\n"),
                 {"'a?b' is not a finite number"});
  std::string header = "a0";
  for (int i = 1; i < 200; ++i) header += ",a" + std::to_string(i);
  expect_refused(header + "\n", {"the header has: a0, a1, a2", "and 194 more"});
}

TEST_F(ReadTrials, AContradictoryDescriptionIsRefused) {
  const BenchFormat good = format_;
  format_.channels.clear();
  expect_refused(kGood, {"there is no channel"});
  format_ = good;
  format_.value_column = "drop_mm";
  expect_refused(kGood, {"a value column belongs to a long file"});
  format_.channel_column = "marker";
  expect_refused(kGood, {"column 'drop_mm' is used for channel 'drop' and for the reading"});
  format_.value_column.clear();
  format_.channels[0].column.clear();
  expect_refused(kGood, {"channel 'drop' has no column; name it, or the value column"});
  format_.channels[0].column = "x_mm";
  format_.channels.push_back(format_.channels[0]);
  format_.channels[0].label = format_.channels[1].label = "tip";
  format_.channels[1].id = "rise";
  expect_refused(kGood, {"channels 'drop' and 'rise' are read from one column 'x_mm' of the same rows"});
  format_ = good;
  format_.ignored = {"mass_g"};
  expect_refused(kGood, {"column 'mass_g' is ignored and used for control 'load'"});
  format_ = good;
  format_.controls[0].column = "mass_g";
  expect_refused(kGood, {"column 'mass_g' is used for control 'retraction' and for control 'load'"});
  format_ = good;
  format_.channels.push_back(format_.channels[0]);
  format_.channels[1].column = "other_mm";
  expect_refused(kGood, {"the name 'drop' stands twice"});
  format_ = good;
  format_.channels[0].column.clear();
  expect_refused(kGood, {"channel 'drop' has no column"});
}

TEST_F(ReadTrials, ExcludedLinesAreMarkedCountedAndAllowedOnlyWhereReadingsAre) {
  use_only("drop_mm");
  const std::string text = "drop_mm\n1\n2\n\n3\n4\n";
  format_.excluded = {3, 5};
  const Trials trials = read(text);
  std::vector<int> excluded;
  for (const Reading& reading : trials.readings) {
    if (reading.excluded) excluded.push_back(reading.line);
  }
  EXPECT_EQ(excluded, (std::vector<int>{3, 5}));
  EXPECT_EQ(trials.remarks.at(1), "not fitted (exclude): 2 readings in lines 3, 5");
  format_.excluded = {4};
  expect_refused(text, {"line 4", "holds no reading", "readings stand in lines 2, 3, 5, 6"});
  format_.excluded = {2, 3, 5, 6};
  expect_refused(text, {"all readings are excluded"});
}

}  // namespace
}  // namespace taut

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <regex>
#include <set>

#include "sim/shapes/geometry.hpp"
#include "sim/shapes/shape.hpp"
#include "tests/support/command.hpp"

// `taut schema`: what it says of files, against all files that are shipped, the documentation, and the list of shapes.
namespace taut {
namespace {

using namespace test;
using nlohmann::json;
namespace fs = std::filesystem;

struct SchemaOfFiles : testing::Test {
  SchemaOfFiles() {
    for (const std::string language : {"experiment", "simulation"})
      folder_.write(language + ".json", done_in(folder_ / "", {"schema", language}).out);
  }

  json schema(const std::string& language) const { return json::parse(text_of(folder_ / language + ".json")); }

  /// What an independent program, python3-jsonschema, finds wrong with a file; by draft 4 and by 2020-12.
  std::string faults(const std::string& language, const std::string& path) const {
    const std::string call = std::string(TAUT_SOURCE_DIR "/tests/experiments/validate_schema ") + "'" +
                             (folder_ / language) + ".json' '" + path + "' > '" + (folder_ / "faults.txt") + "' 2>&1";
    const int status = std::system(call.c_str());
    const std::string found = text_of(folder_ / "faults.txt");
    EXPECT_EQ(status == 0, found.empty()) << found;
    return found;
  }

  TemporaryFolder folder_;
};

std::vector<fs::path> shipped_files() {
  std::vector<fs::path> files;
  for (const fs::directory_entry& entry : fs::recursive_directory_iterator(TAUT_SOURCE_DIR "/experiments")) {
    if (entry.path().extension() == ".toml") files.push_back(entry.path());
  }
  return files;
}

std::string language_of_file(const std::string& text) {
  return text.find("\n[simulation]") == std::string::npos ? "experiment" : "simulation";
}

/// Calls `visit(place, key, schema)` for each key of each table.
void each_key(const json& of, const std::string& place,
              const std::function<void(const std::string&, const std::string&, const json&)>& visit) {
  if (of.contains("properties")) {
    for (const auto& [key, value] : of.at("properties").items()) {
      visit(place, key, value);
      each_key(value, place + "." + key, visit);
    }
  }
  if (of.contains("additionalProperties") && of.at("additionalProperties").is_object())
    each_key(of.at("additionalProperties"), place + ".ID", visit);
  if (of.contains("items")) each_key(of.at("items"), place, visit);
  if (of.contains("anyOf")) {
    for (const json& one : of.at("anyOf")) each_key(one, place, visit);
  }
}

TEST_F(SchemaOfFiles, AllShippedFilesAreValid) {
  const std::vector<fs::path> files = shipped_files();
  EXPECT_GT(files.size(), 30u);
  std::string experiments, simulations;  // in one call each: Python starts slowly
  for (const fs::path& file : files)
    (language_of_file(text_of(file.string())) == "experiment" ? experiments : simulations) += "' '" + file.string();
  EXPECT_EQ(faults("experiment", experiments.substr(3)), "");
  EXPECT_EQ(faults("simulation", simulations.substr(3)), "");
}

TEST_F(SchemaOfFiles, WhatTautRefusesOfKeysWordsAndUnitsIsUnderlined) {
  const std::string good = text_of(TAUT_SOURCE_DIR "/experiments/foam_cantilever/experiment.toml");
  const auto changed = [&](const std::string& from, const std::string& to) {
    std::string text = good;
    const size_t at = text.find(from);
    EXPECT_NE(at, std::string::npos) << from;
    return text.replace(at, from.size(), to);
  };
  const std::vector<std::pair<std::string, std::string>> wrong{
      {"thickness = \"30 mm\"", "thicknes = \"30 mm\""},   // a key
      {"[mesh]", "[mehs]"},                                // a table
      {"plane = \"strain\"", "plane = \"strian\""},        // a word
      {"thickness = \"30 mm\"", "thickness = \"30 kg\""},  // a unit
      {"thickness = \"30 mm\"", "thickness = 30"},         // none
      {"nu = 0.3", "nu = \"a third\""},                    // no number
      {"cells = [29, 16]", "cells = 29"},                  // no list
      {"noise = { relative", "noise = { relativ"},         // in an inline table
      {"start = \"300 kPa\"", "begin = \"300 kPa\""},      // below an id
      {"[[load]]", "[load]"}};                             // not a list of tables
  for (const auto& [from, to] : wrong) {
    folder_.write("experiment.toml", changed(from, to));
    EXPECT_NE(faults("experiment", folder_ / "experiment.toml"), "") << to;
    const Outcome check = run_in(folder_ / "", {"check", "experiment.toml"});
    EXPECT_EQ(check.code, 2) << to;
  }
  // What taut takes is not underlined.
  for (const auto& [from, to] :
       std::vector<std::pair<std::string, std::string>>{{"thickness = \"30 mm\"", "thickness = \"30.0 mm +- 0.6 %\""},
                                                        {"thickness = \"30 mm\"", "thickness = \"3e4 µm ± 1e2 um\""},
                                                        {"thickness = \"30 mm\"", "thickness = \"1.18 inch\""},
                                                        {"nu = 0.3", "nu = \"30 % +- 5 %\""},
                                                        {"id = \"tip_load\"", "id = \"anything\""}}) {
    folder_.write("experiment.toml", changed(from, to));
    EXPECT_EQ(faults("experiment", folder_ / "experiment.toml"), "") << to;
  }
}

TEST_F(SchemaOfFiles, EveryKeyHasAType) {
  for (const std::string language : {"experiment", "simulation"}) {
    int count = 0;
    each_key(schema(language), language, [&](const std::string& place, const std::string& key, const json& value) {
      EXPECT_FALSE(value.empty()) << place << "." << key
                                  << ": no file shows what stands there; add one to experiments/init/keys";
      const json open{{"type", "object"}};
      EXPECT_FALSE(value.contains("items") && value.at("items") == open) << place << "." << key;
      EXPECT_NE(value, open) << place << "." << key << ": no file has this table";
      ++count;
    });
    EXPECT_GT(count, 150) << language;
  }
}

TEST_F(SchemaOfFiles, EveryKeyOfEveryShapeIsThere) {
  const json in_experiment = schema("experiment").at("properties").at("geometry").at("properties"),
             in_simulation =
                 schema("simulation")["properties"]["body"]["items"]["properties"]["geometry"]["properties"];
  for (const std::string& kind : shape_kinds()) {
    for (const ShapeKey& key : make_shape(kind)->keys()) {
      EXPECT_TRUE(in_experiment.contains(std::string(key.key))) << kind << " " << key.key;
      EXPECT_TRUE(in_simulation.contains(std::string(key.key))) << kind << " " << key.key;
    }
  }
}

TEST_F(SchemaOfFiles, KeysAndDocumentationAgree) {
  const std::string guide = text_of(TAUT_SOURCE_DIR "/experiments/README.md");
  std::set<std::string> known;
  for (const std::string language : {"experiment", "simulation"}) {
    each_key(schema(language), language, [&](const std::string& place, const std::string& key, const json&) {
      known.insert(key);
      const std::regex word("[`.\\[ {,]" + key + "(`|\\]| =|,|\\.)");
      EXPECT_TRUE(std::regex_search(guide, word)) << place << "." << key << " is not in experiments/README.md";
    });
  }
  // Tables of keys there begin with `| key |`; a row's first cell names some.
  const std::regex table(R"(\n\| key \| default \|[^\n]*\n\|[-| ]+\n((\|[^\n]*\n)+))"), name("`([a-z_]+)`");
  int rows = 0;
  for (std::sregex_iterator found(guide.begin(), guide.end(), table), end; found != end; ++found) {
    std::istringstream lines((*found)[1].str());
    for (std::string line; std::getline(lines, line); ++rows) {
      const std::string cell = line.substr(1, line.find('|', 1));
      for (std::sregex_iterator key(cell.begin(), cell.end(), name); key != end; ++key)
        EXPECT_TRUE(known.contains((*key)[1]))
            << (*key)[1] << " is in experiments/README.md, but no reader asks for it";
    }
  }
  EXPECT_GT(rows, 30);
}

TEST_F(SchemaOfFiles, AWrongLanguageIsAnsweredInOneSentence) {
  const Outcome wrong = run_in(folder_ / "", {"schema", "experiments"});
  EXPECT_EQ(wrong.code, 2);
  expect_holds(wrong.err, {"'experiments' is no language of files (did you mean 'experiment'?)"});
}

}  // namespace
}  // namespace taut

#include <gtest/gtest.h>

#include <filesystem>
#include <map>
#include <regex>
#include <set>

#include "tests/support/experiment_files.hpp"

namespace taut {
namespace {

using namespace test;
namespace fs = std::filesystem;

/// The folders of the sources, lowest first: a file includes what stands in its own folder or before it.
const std::vector<std::string> kOrder = {
    "sim/core",   "sim/mesh",      "sim/model",       "sim/materials",     "sim/terms",   "sim/contact",
    "sim/shapes", "sim/solve",     "sim/scene",       "sim/robots",        "sim/files",   "calib/data",
    "calib/fit",  "calib/benches", "calib/files",     "calib/models",      "calib/check", "calib/studies",
    "calib/runs", "reports",       "experiments/cli", "experiments/python"};

struct Source {
  std::string path;                   ///< from the root, "sim/mesh/mesh.hpp"
  std::vector<std::string> included;  ///< in quotes
  std::vector<std::string> system;    ///< in angle brackets
};

std::vector<Source> sources() {
  std::vector<Source> found;
  for (const char* layer : {"sim", "calib", "reports", "experiments"}) {
    for (const fs::directory_entry& entry : fs::recursive_directory_iterator(fs::path(TAUT_SOURCE_DIR) / layer)) {
      const std::string extension = entry.path().extension().string();
      if (extension != ".cpp" && extension != ".hpp") continue;
      Source& source = found.emplace_back();
      source.path = fs::relative(entry.path(), TAUT_SOURCE_DIR).generic_string();
      std::istringstream text(text_of(entry.path().string()));
      const std::regex include("#include ([\"<])([^\">]*)[\">].*");
      std::smatch match;
      for (std::string line; std::getline(text, line);) {
        if (std::regex_match(line, match, include))
          (match[1] == "\"" ? source.included : source.system).push_back(match[2]);
      }
    }
  }
  return found;
}

size_t place_of(const std::string& path) {
  const std::string folder = fs::path(path).parent_path().generic_string();
  return static_cast<size_t>(std::find(kOrder.begin(), kOrder.end(), folder) - kOrder.begin());
}

TEST(Layers, NoFileIncludesAHigherLayerOrFolder) {
  int includes = 0;
  for (const Source& source : sources()) {
    EXPECT_LT(place_of(source.path), kOrder.size()) << source.path << ": its folder is not in the order of folders";
    for (const std::string& included : source.included) {
      ++includes;
      EXPECT_LE(place_of(included), place_of(source.path)) << source.path << " includes " << included;
      EXPECT_LT(place_of(included), kOrder.size()) << source.path << ": includes start at the root: " << included;
    }
  }
  EXPECT_GT(includes, 300);
}

TEST(Layers, NoLibraryHeaderPullsInJsonOrToml) {
  int headers = 0;
  for (const Source& source : sources()) {
    if (!source.path.ends_with(".hpp") || source.path.starts_with("experiments/")) continue;
    ++headers;
    for (const std::string& included : source.system) {
      EXPECT_EQ(included.find("nlohmann"), std::string::npos) << source.path;
      EXPECT_EQ(included.find("toml"), std::string::npos) << source.path;
    }
  }
  EXPECT_GT(headers, 60);
}

TEST(Layers, NoHeaderIncludesItselfInACircle) {
  std::map<std::string, std::vector<std::string>> graph;
  for (const Source& source : sources()) {
    if (source.path.ends_with(".hpp")) graph[source.path] = source.included;
  }
  std::map<std::string, int> state;  // 1: on the way down, 2: done
  std::function<void(const std::string&)> visit = [&](const std::string& header) {
    state[header] = 1;
    for (const std::string& next : graph[header]) {
      EXPECT_NE(state[next], 1) << header << " and " << next << " include each other in a circle";
      if (state[next] == 0) visit(next);
    }
    state[header] = 2;
  };
  for (const auto& [header, included] : std::map(graph)) {
    if (state[header] == 0) visit(header);
  }
  EXPECT_GT(graph.size(), 60u);
}

}  // namespace
}  // namespace taut

#include <gtest/gtest.h>

#include <filesystem>

#include "tests/support/experiment_files.hpp"

namespace taut {
namespace {

using namespace test;
namespace fs = std::filesystem;

const std::vector<std::string> kLayers = {"sim", "calib", "reports", "experiments"};

TEST(Layers, NoFileIncludesAHigherLayer) {
  int files = 0, includes = 0;
  for (size_t layer = 0; layer < kLayers.size(); ++layer) {
    for (const fs::directory_entry& entry :
         fs::recursive_directory_iterator(fs::path(TAUT_SOURCE_DIR) / kLayers[layer])) {
      const std::string extension = entry.path().extension().string();
      if (extension != ".cpp" && extension != ".hpp") continue;
      ++files;
      std::istringstream text(text_of(entry.path().string()));
      for (std::string line; std::getline(text, line);) {
        if (!line.starts_with("#include \"")) continue;
        ++includes;
        for (size_t higher = layer + 1; higher < kLayers.size(); ++higher) {
          EXPECT_FALSE(line.starts_with("#include \"" + kLayers[higher] + "/")) << entry.path() << ": " << line;
        }
        EXPECT_NE(line.find('/'), std::string::npos) << entry.path() << ": includes start at the root: " << line;
      }
    }
  }
  EXPECT_GT(files, 40);
  EXPECT_GT(includes, 100);
}

}  // namespace
}  // namespace taut

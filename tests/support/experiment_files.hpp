#pragma once
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <random>
#include <sstream>
#include <string>

namespace taut::test {

/// A temporary folder that goes when the test ends.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::random_device random;
    do {
      path_ = std::filesystem::temp_directory_path() / ("taut_" + std::to_string(random()));
    } while (!std::filesystem::create_directory(path_));
  }
  ~TemporaryFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;

  std::string operator/(const std::string& name) const { return (path_ / name).string(); }
  /// Writes a file and returns its path.
  std::string write(const std::string& name, const std::string& text) const {
    std::ofstream(path_ / name, std::ios::binary) << text;
    return *this / name;
  }

 private:
  std::filesystem::path path_;
};

inline std::string text_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

/// `text` with its only `from` replaced.
inline std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const size_t at = text.find(from);
  if (at == std::string::npos || text.find(from, at + 1) != std::string::npos) {
    ADD_FAILURE() << "'" << from << "' is not there exactly once";
    return text;
  }
  return text.replace(at, from.size(), to);
}

/// A plane beam, 60 x 12 x 20 mm, clamped at its left end, loaded and watched at its right one: small enough for quick
/// tests.
inline const std::string beam_toml = R"(title = "A small beam"
data = "simulated"

[geometry]
kind = "rectangle"
size = ["60 mm", "12 mm"]
region = "foam"
thickness = "20 mm"
plane = "strain"

[mesh]
cells = [10, 4]
element = "quadratic"

[materials.foam]
law = "neo_hookean"
E = "100 kPa"
nu = 0.3

[[support]]
on = "xmin"
fix = ["x", "y"]

[[load]]
id = "pull"
on = "xmax"
direction = [0, -1]
column = "pull_N"

[[channel]]
id = "tip"
on = "xmax"
direction = [0, -1]
column = "tip_mm"
noise = { absolute = "0.1 mm" }

[bench]
file = "bench.csv"
trial = "trial"

[fit.free.E_foam]
start = "50 kPa"
lower = "1 kPa"
upper = "10 MPa"
)";
inline const std::string beam_csv = "trial,pull_N,tip_mm\na,0.05,1\na,0.1,2\nb,0.05,1\nb,0.1,2\n";

}  // namespace taut::test

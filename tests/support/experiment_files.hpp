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

/// A plane piece of foam, 60 x 12 x 20 mm, held at its left end: the begin of an experiment.
inline std::string foam_piece(const std::string& title, const std::string& cells, const std::string& material) {
  return "title = \"" + title + R"("
data = "simulated"

[geometry]
kind = "rectangle"
size = ["60 mm", "12 mm"]
region = "foam"
thickness = "20 mm"

[mesh]
cells = )" +
         cells + R"(

[materials.foam]
law = "neo_hookean"
)" + material +
         R"(
[[support]]
on = "xmin"
)";
}

/// A beam that a hand holds at its end and lets go; its bench is to be added.
inline const std::string released_toml =
    foam_piece("A beam lets go", "[4, 1]", "E = \"200 kPa\"\nnu = 0.3\ndensity = \"500 kg/m3\"\n") + R"(fix = ["x", "y"]

[damping.foam]
stiffness = "1 ms"

[[load]]
id = "hand"
on = "xmax & ymax"
direction = [0, -1]
value = "0 N"

[[channel]]
id = "tip"
on = "xmax"
direction = [0, 1]
column = "tip_mm"

[dynamics]
step = "1 ms"
)";

/// A plane beam, 60 x 12 x 20 mm, clamped at its left end, loaded and watched at its right one: small enough for quick
/// tests.
inline const std::string beam_toml = text_of(TAUT_SOURCE_DIR "/tests/support/beam.toml");
inline const std::string beam_csv = "trial,pull_N,tip_mm\na,0.05,1\na,0.1,2\nb,0.05,1\nb,0.1,2\n";

}  // namespace taut::test

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "sim/core/error.hpp"
#include "tests/fuzz/targets.hpp"

// libFuzzer over one target, TAUT_FUZZ_TARGET in the environment ("csv").
namespace {

const taut::fuzz::Target& chosen() {
  const char* name = std::getenv("TAUT_FUZZ_TARGET");
  for (const taut::fuzz::Target& target : taut::fuzz::targets()) {
    if (name != nullptr && target.name == name) return target;
  }
  std::fputs("set TAUT_FUZZ_TARGET to one of:", stderr);
  for (const taut::fuzz::Target& target : taut::fuzz::targets())
    std::fprintf(stderr, " %.*s", static_cast<int>(target.name.size()), target.name.data());
  std::fputs("\n", stderr);
  std::exit(2);
}

}  // namespace

/// Good inputs to begin with, into the folder TAUT_FUZZ_SEEDS.
extern "C" int LLVMFuzzerInitialize(int*, char***) {
  const char* folder = std::getenv("TAUT_FUZZ_SEEDS");
  if (folder == nullptr) return 0;
  std::filesystem::create_directories(folder);
  int count = 0;
  for (const std::string& seed : chosen().seeds())
    std::ofstream(std::filesystem::path(folder) / ("seed" + std::to_string(count++)), std::ios::binary) << seed;
  return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const taut::fuzz::Target& target = chosen();
  try {
    target.take({reinterpret_cast<const char*>(data), size});
  } catch (const taut::InputError&) {
    // a sentence, as it should be
  }
  return 0;  // any other exception ends the program, and libFuzzer keeps the input
}

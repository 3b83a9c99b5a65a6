#pragma once
#include <string>
#include <string_view>
#include <vector>

// What reads what strangers write. Each target is given any bytes: it takes them, or throws InputError; anything else
// is a fault. tests/fuzz/fuzz_test.cpp gives them mutations of good files, libfuzzer.cpp what libFuzzer finds.
namespace taut::fuzz {

/// One reader.
struct Target {
  std::string_view name;                ///< the folder of its corpus
  void (*take)(std::string_view);       ///< throws InputError, or nothing
  std::vector<std::string> (*seeds)();  ///< good inputs
};

/// All of them: "csv", "experiment", "simulation", "units", "msh", "record".
const std::vector<Target>& targets();

}  // namespace taut::fuzz

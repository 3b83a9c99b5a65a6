#include <fmt/format.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <random>
#include <sstream>

#include "sim/core/error.hpp"
#include "tests/fuzz/targets.hpp"

// Good files with something wrong in them, and the inputs that went wrong once: each is taken or refused with a
// sentence.
namespace taut::fuzz {
namespace {

namespace fs = std::filesystem;

/// What changes a file in the ways in which files go wrong: cut, torn, doubled, mixed, with numbers that nobody
/// expects.
class Mutator {
 public:
  explicit Mutator(unsigned seed) : random_(seed) {}

  std::string operator()(std::string text, const std::vector<std::string>& others) {
    for (int left = 1 + below(4); left > 0; --left) change(text, others);
    return text;
  }

 private:
  int below(size_t count) { return static_cast<int>(std::uniform_int_distribution<size_t>(0, count - 1)(random_)); }

  void change(std::string& text, const std::vector<std::string>& others) {
    if (text.empty()) text = "x";
    const size_t at = static_cast<size_t>(below(text.size()));
    switch (below(9)) {
      case 0:  // another byte
        text[at] = static_cast<char>(below(256));
        return;
      case 1:  // the rest is lost
        text.resize(at);
        return;
      case 2:  // a piece is lost
        text.erase(at, static_cast<size_t>(1 + below(20)));
        return;
      case 3: {  // a piece stands twice
        const std::string piece = text.substr(at, static_cast<size_t>(1 + below(60)));
        text.insert(at, piece);
        return;
      }
      case 4: {  // a piece of another file
        const std::string& other = others[static_cast<size_t>(below(others.size()))];
        text.insert(at, other.substr(static_cast<size_t>(below(other.size())), static_cast<size_t>(1 + below(80))));
        return;
      }
      case 5:  // a line is lost
        text.erase(at, text.find('\n', at) - at);
        return;
      case 6: {  // very many of something
        text.insert(at, std::string(static_cast<size_t>(1 + below(3000)), text[at]));
        return;
      }
      default:
        number(text, at);
    }
  }

  /// Another number in the place of the next one.
  void number(std::string& text, size_t from) {
    static const std::vector<std::string> odd{"0",
                                              "-0",
                                              "-1",
                                              "1e999",
                                              "-1e308",
                                              "1e-320",
                                              "nan",
                                              "inf",
                                              "2147483647",
                                              "2147483648",
                                              "-2147483648",
                                              "4294967296",
                                              "9223372036854775807",
                                              "99999999999999999999",
                                              "1e9",
                                              "1e-300",
                                              "0x10",
                                              "1.5",
                                              "",
                                              "null",
                                              "[]"};
    const size_t begin = text.find_first_of("0123456789", from);
    if (begin == std::string::npos) return;
    const size_t end = std::min(text.find_first_not_of("0123456789.eE+-", begin), text.size());
    text.replace(begin, end - begin, odd[static_cast<size_t>(below(odd.size()))]);
  }

  std::mt19937 random_;
};

/// Whether it was taken, not refused. Keeps an input that went wrong, for tests/fuzz/corpus.
bool give(const Target& target, const std::string& input, const std::string& name) {
  const auto begin = std::chrono::steady_clock::now();
  const std::string last =
      (fs::temp_directory_path() / fmt::format("taut_fuzz_last_{}_{}", target.name, getpid())).string();
  std::ofstream(last, std::ios::binary) << input;  // is left where this crashes
  bool taken = false;
  try {
    target.take(input);
    taken = true;
  } catch (const InputError& error) {
    const std::string message = error.what();
    EXPECT_FALSE(message.empty()) << name;
    EXPECT_EQ(message.find('\n'), std::string::npos) << name << ": " << message;
  } catch (const std::exception& error) {
    std::ofstream("failed_" + name, std::ios::binary) << input;
    ADD_FAILURE() << name << " (kept as failed_" << name << "): " << error.what();
  }
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(20)) << name;
  fs::remove(last);
  return taken;
}

int times(int usual) {
  const char* given = std::getenv("TAUT_FUZZ_COUNT");
  return given != nullptr ? std::atoi(given) : usual;
}

class Fuzz : public testing::TestWithParam<size_t> {
 protected:
  const Target& target = targets()[GetParam()];
};

TEST_P(Fuzz, SeedsAreTaken) {
  for (const std::string& seed : target.seeds()) EXPECT_NO_THROW(target.take(seed)) << seed.substr(0, 200);
}

TEST_P(Fuzz, MutationsOfGoodFilesAreTakenOrRefusedWithASentence) {
  const std::vector<std::string> seeds = target.seeds();
  const unsigned first = static_cast<unsigned>(times(0) > 0 ? std::random_device()() : 1);
  const int inputs = times(300);
  int taken = 0;
  for (int i = 0; i < inputs; ++i) {
    const unsigned seed = first + static_cast<unsigned>(i);
    taken += give(target, Mutator(seed)(seeds[static_cast<size_t>(i) % seeds.size()], seeds),
                  fmt::format("{}_{}", target.name, seed));
  }
  fmt::print("{}: {} inputs, {} taken, {} refused with a sentence\n", target.name, inputs, taken, inputs - taken);
}

TEST_P(Fuzz, WhatWentWrongOnceDoesNoMore) {
  const fs::path folder = fs::path(TAUT_SOURCE_DIR) / "tests/fuzz/corpus" / target.name;
  if (!fs::exists(folder)) return;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
    std::ostringstream text;
    text << std::ifstream(entry.path(), std::ios::binary).rdbuf();
    give(target, text.str(), entry.path().filename().string());
  }
}

INSTANTIATE_TEST_SUITE_P(AllReaders, Fuzz, testing::Range<size_t>(0, 6),
                         [](const auto& info) { return std::string(targets()[info.param].name); });

}  // namespace
}  // namespace taut::fuzz

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "tests/support/command.hpp"

// A disk that is full at any write, a factorisation that fails anywhere: the answer is right or the exit is clean, what
// was finished is there, and the same command goes on from it.
namespace taut {
namespace {

using namespace test;
namespace fs = std::filesystem;

struct Faults : testing::Test {
  void SetUp() override {
    folder.write("bench.csv", beam_csv);
    folder.write("experiment.toml", beam_toml);
    fs::create_directory(folder / "bin");
    folder.write("bin/gnuplot", "#!/bin/sh\nfor f in svg pdf png; do echo '<svg></svg>' > ${2%.gp}.$f; done\n");
    fs::permissions(folder / "bin/gnuplot", fs::perms::owner_all);
  }
  /// The fit with faults; a code of 128 and more: a signal ended it, or it did not end.
  Outcome fit(const std::string& faults) {
    const std::string command =
        "cd '" + (folder / "") + "' && export PATH=\"$PWD/bin:$PATH\" && " +
        (faults.empty() ? "" : "LD_PRELOAD='" TAUT_FAULTS "' " + faults) +
        " timeout -s KILL 120 '" TAUT_BINARY
        "' fit experiment.toml --no-variants --quiet --threads 1 --out run >stdout.txt 2>stderr.txt";
    const int status = std::system(command.c_str());
    return {WIFEXITED(status) ? WEXITSTATUS(status) : 128, text_of(folder / "stdout.txt"),
            text_of(folder / "stderr.txt")};
  }
  /// The modulus of a finished fit that is in the folder; NaN: there is none.
  double modulus() {
    if (!fs::exists(folder / "run/fit.json")) return std::nan("");
    const auto run = nlohmann::json::parse(text_of(folder / "run/fit.json"));
    if (run["status"] != "converged") return std::nan("");
    return run["parameters"][0]["value"];
  }
  void expect_right_or_clean(const std::string& faults) {
    fs::remove_all(folder / "run");
    const Outcome outcome = fit(faults);
    const std::string said = faults + ": " + std::to_string(outcome.code) + " " + outcome.err;
    EXPECT_LT(outcome.code, 128) << said;
    const double found = modulus();
    EXPECT_TRUE(std::isnan(found) || std::abs(found - right) < 1e-5 * right) << found << " " << said;
    EXPECT_TRUE(outcome.code != 0 || !std::isnan(found)) << said;
    EXPECT_TRUE(outcome.code == 0 || outcome.err.find("taut: ") != std::string::npos) << said;
    // A part after the fit that failed is a remark of the run.
    if (outcome.code == 3 && !std::isnan(found)) {
      EXPECT_NE(text_of(folder / "run/fit.json").find("failed and is left out"), std::string::npos) << said;
    }
    const Outcome again = fit("");
    EXPECT_EQ(again.code, 0) << said << "\nand then: " << again.err;
    EXPECT_NEAR(modulus(), right, 1e-5 * right) << said;
  }
  /// How many writes and factorisations an undisturbed fit has.
  std::pair<int, int> counted() {
    EXPECT_EQ(fit("TAUT_FAULT_COUNTS=counts.txt").code, 0) << text_of(folder / "stderr.txt");
    right = modulus();
    // 3 E I / (1 - nu^2) / L^3 = F / u, of a slender beam in plane strain, without the compliance in shear.
    const double length = 0.06, second = 0.02 * std::pow(0.012, 3) / 12;
    const double slender = 0.05 / 1e-3 * std::pow(length, 3) / (3 * second) * (1 - 0.3 * 0.3);
    EXPECT_NEAR(right, slender, 0.05 * slender);
    std::istringstream counts(text_of(folder / "counts.txt"));
    std::pair<int, int> result{0, 0};
    counts >> result.first >> result.second;
    EXPECT_GT(result.first, 20);
    EXPECT_GT(result.second, 10);
    return result;
  }
  TemporaryFolder folder;
  double right = 0;
};

struct SlowFaults : Faults {};

TEST_F(Faults, AStageThatFailsIsSaidInOneSentenceWhenQuietToo) {
  const int solves = counted().second;  // the last of them is of a stage after the fit
  fs::remove_all(folder / "run");
  const Outcome outcome = fit("TAUT_FAIL_MEMORY=1 TAUT_FAIL_SOLVE=" + std::to_string(solves));
  EXPECT_EQ(outcome.code, 3);
  EXPECT_NEAR(modulus(), right, 1e-5 * right);
  EXPECT_TRUE(outcome.err.starts_with("taut: the shares of what was assumed failed and is left out: ")) << outcome.err;
  EXPECT_EQ(std::ranges::count(outcome.err, '\n'), 1) << outcome.err;
}

TEST_F(SlowFaults, ADiskThatIsFullAtAnyWrite) {
  const int writes = counted().first;
  for (int n = 1; n <= writes; n += std::max(1, writes / 25))
    expect_right_or_clean("TAUT_FAIL_WRITE=" + std::to_string(n));
}

TEST_F(SlowFaults, AFactorisationThatFailsAnywhere) {
  const int solves = counted().second;
  for (int n = 1; n <= solves; n += std::max(1, solves / 12)) {
    expect_right_or_clean("TAUT_FAIL_SOLVE=" + std::to_string(n));
    expect_right_or_clean("TAUT_FAIL_MEMORY=1 TAUT_FAIL_SOLVE=" + std::to_string(n));
  }
}

}  // namespace
}  // namespace taut

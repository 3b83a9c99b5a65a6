#include <gtest/gtest.h>

#include <algorithm>
#include <cctype>
#include <regex>
#include <sstream>

#include "calib/fit/fit.hpp"
#include "sim/core/units.hpp"
#include "tests/support/command.hpp"

// `taut help`: parts of the documentation, and man page and completions as the build makes them.
namespace taut {
namespace {

using namespace test;

struct Help : testing::Test {
  std::string help(const std::string& name) const { return done_in(folder_ / "", {"help", name}).out; }

  /// Names that stand two blanks from the left, below this line of `taut help`.
  std::vector<std::string> listed(const std::string& title) const {
    std::istringstream lines(done_in(folder_ / "", {"help"}).out);
    std::vector<std::string> names;
    bool here = false;
    for (std::string line; std::getline(lines, line);) {
      if (here && line.empty()) break;
      if (here) names.push_back(line.substr(2, line.find(' ', 2) - 2));
      here = here || line == title;
    }
    EXPECT_FALSE(names.empty());
    return names;
  }

  std::vector<std::string> commands() const { return listed("commands:"); }
  std::vector<std::string> topics() const { return listed("topics of `taut help TOPIC`:"); }

  /// What a shell prints.
  std::string shell(const std::string& script) const {
    folder_.write("script", script);
    const std::string call = "cd '" + folder_ / "" + "' && bash script > shell.txt 2>&1";
    EXPECT_EQ(std::system(call.c_str()), 0);
    return text_of(folder_ / "shell.txt");
  }

  TemporaryFolder folder_;
};

std::vector<std::string> options_in(const std::string& help) {
  const std::regex option("\n  .*(--[a-z-]+)");
  std::vector<std::string> names;
  const std::string table = help.substr(help.find("options:"));
  for (std::sregex_iterator it(table.begin(), table.end(), option), end; it != end; ++it) names.push_back((*it)[1]);
  return names;
}

/// Letters and digits alone.
std::string squeezed(const std::string& text) {
  std::string rest;
  std::ranges::copy_if(text, std::back_inserter(rest), [](unsigned char c) { return std::isalnum(c) != 0; });
  return rest;
}

/// From the first line that holds `begin` to the next that holds `end`.
std::string part(const std::string& text, const std::string& begin, const std::string& end) {
  const size_t from = text.find(begin);
  EXPECT_NE(from, std::string::npos) << begin;
  return from == std::string::npos ? "" : text.substr(from, text.find(end, from + begin.size()) - from);
}

TEST_F(Help, EveryCommandAndOptionStandsInManPageAndCompletions) {
  const std::string man = std::regex_replace(help("man"), std::regex(R"(\\-)"), "-");
  const std::string bash = help("bash"), zsh = help("zsh");
  for (const std::string& command : commands()) {
    const std::string page = part(man, ".SS taut " + command + " ", ".SS");
    const std::string in_bash = part(bash, "\n    " + command + ") ", ";;");
    const std::string in_zsh = part(zsh, "\n    " + command + ")\n", ";;");
    expect_holds(zsh, {"'" + command + ":"});
    const std::vector<std::string> options = options_in(help(command));
    EXPECT_GE(options.size(), 3u) << command;
    for (const std::string& option : options) {
      EXPECT_TRUE(std::regex_search(page, std::regex("\n\\.B .*" + option + "( .*)?\n"))) << option << page;
      EXPECT_TRUE(std::regex_search(in_bash, std::regex("options='.*" + option + "[ ']"))) << option << in_bash;
      EXPECT_TRUE(std::regex_search(in_zsh, std::regex(option + "=?\\["))) << option << in_zsh;
    }
  }
  for (const std::string& topic : topics()) expect_holds(man, {"\n.B " + topic + "\n"});
  expect_holds(man, {".SH NAME", ".SH SYNOPSIS", ".SH DESCRIPTION", ".SH EXIT STATUS", ".SH FILES", "\n.B 130\n"});
}

TEST_F(Help, GroffHasNoWarningsOfTheManPage) {
  folder_.write("taut.1", help("man"));
  EXPECT_EQ(shell("groff -man -ww -Tascii taut.1 2>&1 > page.txt"), "");
  expect_holds(text_of(folder_ / "page.txt"), {"soft-rigid robot modules", "start anew"});
}

TEST_F(Help, BashCompletesCommandsOptionsFilesAndTopics) {
  folder_.write("completion", help("bash"));
  const std::string script = R"(
    mkdir -p 'my bench' runs; touch a.toml 'my bench/experiment.toml' new.csv notes.txt
    source ./completion
    try() { COMP_WORDS=("$@") COMP_CWORD=$(($# - 1)); _taut; (IFS='|'; echo "${COMPREPLY[*]}"); }
    try taut si
    try taut fit --fr
    try taut fit ''
    try taut fit my
    try taut fit 'my\ bench/e'
    try taut fit --threads 2 ''
    try taut fit --threads ''
    try taut fit --out ''
    try taut fit --out = ru
    try taut fit --out = runs ''
    try taut predict runs --rows ''
    try taut predict ''
    try taut chart s
    try taut chart stability ''
    try taut help verd
    try taut help fi
    try taut fit a.toml ''
    try taut nonsense ''
  )";
  EXPECT_EQ(shell(script),
            "simulate\n--fresh\na.toml|my bench|runs\nmy bench\nmy bench/experiment.toml\na.toml|my bench|runs\n\n"
            "my bench|runs\nruns\na.toml|my bench|runs\nnew.csv|my bench|runs\nmy bench|runs\nstability|sbc\n"
            "a.toml|my bench|runs\nverdicts\nfinger|fit\n\n\n");
}

TEST_F(Help, TopicsAreTheTextOfTheDocumentation) {
  const std::string text = squeezed(text_of(TAUT_SOURCE_DIR "/experiments/README.md"));
  EXPECT_NE(text.find(squeezed(help("intervals"))), std::string::npos);  // it has no table, whose cells are wrapped
  EXPECT_GE(topics().size(), 10u);
  for (const std::string& topic : topics()) {
    const std::string shown = help(topic);
    EXPECT_GT(shown.size(), 200u) << topic;
    for (const std::string mark : {"**", "`", "](", "| "}) EXPECT_EQ(shown.find(mark), std::string::npos) << topic;
    std::istringstream lines(shown);
    for (std::string line; std::getline(lines, line);) EXPECT_LE(line.size(), 80u) << topic << ": " << line;
  }
}

TEST_F(Help, VerdictsUnitsAndExitCodesAreThoseOfTheProgram) {
  const std::string verdicts = help("verdicts");
  for (int i = 0; i <= static_cast<int>(Verdict::unknown); ++i)
    expect_holds(verdicts, {"\n" + std::string(name_of(static_cast<Verdict>(i))) + "  "});
  const std::string units = help("units");
  for (int i = 0; i <= static_cast<int>(Quantity::line_load); ++i) {
    const auto quantity = static_cast<Quantity>(i);
    std::string row =
        part(units, "\n" + std::string(name_of(quantity)) + " ", "\n").substr(1 + name_of(quantity).size());
    std::string all;
    for (const std::string& unit : units_of(quantity)) all += (all.empty() ? "" : ", ") + unit;
    EXPECT_EQ(row.substr(row.find_first_not_of(' ')), all) << name_of(quantity);
  }
  for (const char* code : {"0", "1", "2", "3", "4", "5", "130"})
    expect_holds(help("exit-codes"), {"\n" + std::string(code) + " "});
}

TEST_F(Help, OfACommandIsItsOwnHelp) {
  EXPECT_EQ(help("fit"), done_in(folder_ / "", {"fit", "--help"}).out);
  EXPECT_EQ(done_in(folder_ / "", {"help"}).out, done_in(folder_ / "", {"--help"}).out);
}

TEST_F(Help, AnUnknownTopicIsExitCodeTwoWithTheNearestName) {
  const Outcome outcome = run_in(folder_ / "", {"help", "verdict"});
  EXPECT_EQ(outcome.code, 2);
  EXPECT_EQ(outcome.out, "");
  expect_holds(outcome.err, {"'verdict' is no topic (did you mean 'verdicts'?)", "topics: ", "glossary", "commands: "});
  EXPECT_EQ(run_in(folder_ / "", {"help", "fit", "chart"}).code, 2);
}

}  // namespace
}  // namespace taut

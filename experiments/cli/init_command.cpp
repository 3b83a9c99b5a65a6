#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "calib/data/files.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/schema.hpp"
#include "experiments/cli/topics.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view starts = "experiments/init/";

/// The folders below experiments/init that hold an experiment.toml, by name.
std::vector<std::string> kinds_of_starts() {
  std::set<std::string> kinds;
  for (const auto& [document, text] : documents()) {
    if (!document.starts_with(starts) || !document.ends_with("/experiment.toml")) continue;
    const std::string_view below = document.substr(starts.size());
    kinds.emplace(below.substr(0, below.find('/')));
  }
  return {kinds.begin(), kinds.end()};
}

/// What is written, by the files' names.
std::map<std::string, std::string> files_of(const std::string& kind) {
  const std::string prefix = fmt::format("{}{}/", starts, kind);
  std::map<std::string, std::string> files;
  for (const auto& [document, text] : documents()) {
    if (document.starts_with(prefix)) files.emplace(document.substr(prefix.size()), text);
  }
  const std::string language = language_of("experiment.toml", files.at("experiment.toml"));
  if (language == "experiment") files.at("README.md") += documents().at("experiments/init/protocol.md");
  files[language + ".schema.json"] = schema_of(language).dump(1) + "\n";
  return files;
}

/// Writes a file to begin with, the bench that belongs to it, and how to measure.
int init_main(const CommandOptions& options) {
  const std::vector<std::string> kinds = kinds_of_starts();
  if (std::ranges::find(kinds, options.name) == kinds.end())
    throw InputError(fmt::format("taut init: there is no start '{}'{}; allowed: {}", options.name,
                                 did_you_mean(options.name, kinds), join(kinds)));
  const std::map<std::string, std::string> files = files_of(options.name);
  const fs::path folder(options.target);
  for (const auto& [name, text] : files) {
    if (fs::exists(folder / name))
      throw InputError(fmt::format("{} is there already and is not overwritten; name another folder, or move it",
                                   (folder / name).string()));
  }
  nlohmann::ordered_json written = nlohmann::ordered_json::array();
  for (const auto& [name, text] : files) {
    write_file((folder / name).string(), text);
    written.push_back((folder / name).string());
  }
  const std::string experiment = (folder / "experiment.toml").string();
  const bool bench = files.contains("bench.csv");
  if (options.json) {
    print_json(nlohmann::ordered_json{{"kind", options.name}, {"files", written}});
    return exit_ok;
  }
  for (const nlohmann::ordered_json& file : written) fmt::print("{}\n", file.get<std::string>());
  fmt::print("next: write your numbers into the lines with MEASURE (grep MEASURE {0}), then\n  taut check {0}\n",
             experiment);
  if (bench)
    fmt::print("  taut replay {0}   # what the bench will read\n  taut fit {0}      # with readings in {1}\n",
               experiment, (folder / "bench.csv").string());
  else
    fmt::print("  taut simulate {}\n", experiment);
  fmt::print("How to measure, and what to do next, is in {}.\n", (folder / "README.md").string());
  return exit_ok;
}

}  // namespace

Command init_command() {
  return {"init",
          join(kinds_of_starts(), "|") + " DIR",
          "Begins an experiment: a commented file with what to measure marked, an empty bench, how to measure. "
          "Overwrites nothing.",
          "  taut init push_puppet my_module\n"
          "  taut check my_module/experiment.toml   # then: what is missing\n",
          nullptr,
          init_main,
          {&CommandOptions::name, &CommandOptions::target}};
}

}  // namespace taut

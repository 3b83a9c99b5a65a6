#include <fmt/format.h>

#include <algorithm>
#include <boost/program_options.hpp>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "calib/data/run_folder.hpp"
#include "calib/runs/comparison.hpp"
#include "calib/runs/provenance.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "reports/comparison_figures.hpp"
#include "reports/run_record.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;
namespace po = boost::program_options;
using CompareJson = nlohmann::ordered_json;

constexpr size_t most_listed = 12;  ///< of readings, for people

/// The copy of the experiment file in a run folder.
std::string file_of_run(const RunRecord& record, const std::string& folder) {
  if (record.provenance.inputs.empty()) throw InputError(folder + ": its fit.json names no inputs; run its fit again");
  return (fs::path(folder) / record.provenance.inputs.front().copy).string();
}

std::string in_units(const std::optional<double>& value, const std::string& unit) {
  return value ? with_unit(*value, unit) : "not there";
}

void print_comparison(const RunComparison& found, const std::string& first, const std::string& second, double limit) {
  fmt::print("{} against {}: the calibrations {}\n", second, first, found.differs(limit) ? "differ" : "agree");
  fmt::print("{:<16} {:>14} {:>14} {:>12} {:>8}\n", "parameter", "first", "second", "one sigma", "sigmas");
  for (const ParameterDifference& one : found.parameters) {
    fmt::print("{:<16} {:>14} {:>14} {:>12} {:>+8.2f}", one.id, with_unit(one.first, one.unit),
               with_unit(one.second, one.unit), with_unit(one.sigma, one.unit, 2), one.in_sigmas);
    fmt::print("{}\n", one.cancelled.empty() ? "" : "  (in common: " + join(one.cancelled) + ")");
  }
  for (const auto& [ids, run] : {std::pair(found.first_alone, first), std::pair(found.second_alone, second)}) {
    if (!ids.empty()) fmt::print("fitted by {} alone: {}\n", run, join(ids));
  }
  if (found.same_readings)
    fmt::print("both were fitted to the same {} readings: their noise is common, and sigmas are those of one fit\n",
               found.equal_readings);
  else
    fmt::print("all together: chi squared {:.3g} for {} parameters (p = {:.2g})\n", found.chi_squared,
               found.parameters.size(), found.p_value);
  for (const CurveDifference& one : found.curves)
    fmt::print("curve of {}{}: at {} apart by {}, {:+.2f} sigmas\n", one.channel,
               one.series.empty() ? "" : ", " + one.series, with_unit(one.load, one.load_unit),
               with_unit(one.second - one.first, one.unit, 3), one.in_sigmas);
  if (!found.readings.empty())
    fmt::print("readings: {} in both, {} of them equal; these moved or are in one alone:\n", found.common_readings,
               found.equal_readings);
  for (size_t i = 0; i < std::min(most_listed, found.readings.size()); ++i) {
    const ReadingDifference& one = found.readings[i];
    fmt::print("  {}: {} and {}", one.what, in_units(one.first, one.unit), in_units(one.second, one.unit));
    fmt::print("{}\n", one.first && one.second ? fmt::format(", {:+.2f} sigmas", one.in_sigmas) : "");
  }
  if (found.readings.size() > most_listed) fmt::print("  and {} more (--json)\n", found.readings.size() - most_listed);
  if (found.inputs.empty()) fmt::print("the experiment files say the same\n");
  for (const InputDifference& one : found.inputs)
    fmt::print("{}: {} and {}\n", one.key, one.first.empty() ? "not there" : one.first,
               one.second.empty() ? "not there" : one.second);
}

CompareJson comparison_json(const RunComparison& found, const std::string& first, const std::string& second,
                            double limit) {
  CompareJson json{{"first", first}, {"second", second}, {"differs", found.differs(limit)}};
  json["parameters"] = CompareJson::array();
  for (const ParameterDifference& one : found.parameters)
    json["parameters"].push_back({{"id", one.id},
                                  {"unit", one.unit},
                                  {"first", one.first},
                                  {"second", one.second},
                                  {"sigma", one.sigma},
                                  {"in_sigmas", one.in_sigmas},
                                  {"in_common", one.cancelled}});
  json["first_alone"] = found.first_alone;
  json["second_alone"] = found.second_alone;
  json["chi_squared"] = found.chi_squared;
  json["p_value"] = found.p_value;
  json["same_readings"] = found.same_readings;
  json["curves"] = CompareJson::array();
  for (const CurveDifference& one : found.curves)
    json["curves"].push_back({{"channel", one.channel},
                              {"series", one.series},
                              {"unit", one.unit},
                              {"load", one.load},
                              {"first", one.first},
                              {"second", one.second},
                              {"in_sigmas", one.in_sigmas}});
  const auto number = [](const std::optional<double>& value) { return value ? CompareJson(*value) : CompareJson(); };
  json["readings"] = {{"in_both", found.common_readings}, {"equal", found.equal_readings}};
  json["readings"]["moved"] = CompareJson::array();
  for (const ReadingDifference& one : found.readings)
    json["readings"]["moved"].push_back({{"reading", one.what},
                                         {"unit", one.unit},
                                         {"first", number(one.first)},
                                         {"second", number(one.second)},
                                         {"in_sigmas", one.in_sigmas}});
  json["inputs"] = CompareJson::array();
  for (const InputDifference& one : found.inputs)
    json["inputs"].push_back({{"key", one.key}, {"first", one.first}, {"second", one.second}});
  return json;
}

/// Compares each further run with the first one.
int compare_main(const CommandOptions& options) {
  if (options.further.empty())
    throw InputError("taut compare: one run alone has nothing to be compared with; name two run folders or more");
  if (!(options.sigmas > 0)) throw InputError("--sigmas: a number larger than zero belongs here, such as 3");
  std::vector<std::string> folders{options.target};
  folders.insert(folders.end(), options.further.begin(), options.further.end());
  std::vector<RunRecord> records;
  for (const std::string& folder : folders) {
    settle_run_folder(folder);
    records.push_back(read_run(folder));
    check_inputs(records.back(), folder);
  }
  Progress progress(options.quiet);
  CompareJson json = CompareJson::array();
  bool differs = false;
  for (size_t i = 1; i < folders.size(); ++i) {
    const RunComparison found =
        compare(records.front(), records[i],
                input_differences(file_of_run(records.front(), folders.front()), file_of_run(records[i], folders[i])));
    differs |= found.differs(options.sigmas);
    if (options.json)
      json.push_back(comparison_json(found, folders.front(), folders[i], options.sigmas));
    else
      print_comparison(found, folders.front(), folders[i], options.sigmas);
  }
  if (options.json) print_json({{"comparisons", json}, {"differs", differs}});
  if (!options.out.empty()) {
    std::vector<NamedRun> runs;
    for (size_t i = 0; i < folders.size(); ++i) runs.push_back({folders[i], &records[i]});
    draw_compared_parameters(runs, options.out);
    if (!records.front().curves.empty()) draw_compared_curves(runs, options.out);
    progress.say(fmt::format("figures: {}/figures", options.out));
  }
  return differs ? exit_differs : exit_ok;
}

void add_compare_options(AddOption add, CommandOptions& options) {
  add("sigmas", po::value(&options.sigmas)->value_name("N"),
      "standard deviations of a difference beyond which a parameter differs; default: 3");
  add_out(add, options, "folder for figures: parameters over the dates of the fits, curves; default: none are drawn");
}

}  // namespace

Command compare_command() {
  return {"compare",
          "RUN_FOLDER RUN_FOLDER...",
          "Compares runs: parameters in sigmas, curves, readings, inputs; exit code 5 where calibrations differ.",
          "  taut compare runs/january runs/june --out runs/drift   # figures too\n",
          add_compare_options,
          compare_main,
          {&CommandOptions::target},
          true};
}

}  // namespace taut

#include "experiments/cli/ensemble_output.hpp"

#include <fmt/format.h>

#include <boost/program_options.hpp>
#include <charconv>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "calib/studies/crew.hpp"
#include "experiments/cli/print.hpp"
#include "reports/estimate_text.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

using Json = nlohmann::ordered_json;

Json json_of(const EnsembleRun& run) {
  const EnsembleRecord& record = run.record;
  Json json{{"kind", record.kind},
            {"asked", record.asked},
            {"finished", record.finished},
            {"failed", record.failed},
            {"outside", record.outside},
            {"seed", record.seed},
            {"effective", record.effective},
            {"evaluations_per_member", record.evaluations},
            {"how", record.how},
            {"verdict", record.verdict},
            {"parameters", Json::array()},
            {"minima", Json::array()},
            {"failures", record.failures}};
  for (const EnsembleMarginal& one : record.parameters) {
    Json& entry = json["parameters"].emplace_back(Json{{"id", one.id},
                                                       {"unit", one.unit},
                                                       {"mean", one.mean},
                                                       {"deviation", one.deviation},
                                                       {"median", one.median},
                                                       {"interval95", {one.lower95, one.upper95}}});
    if (one.total_lower95 && one.total_upper95) entry["total95"] = {*one.total_lower95, *one.total_upper95};
    entry["width_to_parabola"] = one.width;
    entry["width_error"] = one.width_error;
    entry["verdict"] = one.verdict;
  }
  for (const EnsembleMinimum& one : record.minima)
    json["minima"].push_back({{"chi_squared", one.chi_squared}, {"starts", one.starts}, {"values", one.values}});
  if (!record.profiles.empty()) json["profiles"] = record.profiles;
  return json;
}

void print_text(const EnsembleRecord& record) {
  fmt::print(
      "{} of {} members, {} without values{}{}\n", record.finished, record.asked, record.failed,
      record.outside > 0 ? fmt::format(", {} where the prior is zero", record.outside) : "",
      record.kind == "posterior" ? fmt::format("; they say as much as {:.0f} equal ones", record.effective) : "");
  if (!record.parameters.empty()) {
    const bool profiles = !record.profiles.empty();
    fmt::print("{:<14} {:>14} {:>30} {:>9}  {}\n", "parameter", profiles ? "lowest at" : "median", "95 % interval",
               "width", "the parabola's interval is");
    const auto end = [](double value, const std::string& unit) {
      return std::isfinite(value) ? with_unit(value, unit) : "open";
    };
    for (const EnsembleMarginal& one : record.parameters)
      fmt::print("{:<14} {:>14} {:>30} {:>9}  {}\n", one.id, with_unit(one.median, one.unit),
                 fmt::format("{} .. {}", end(one.lower95, one.unit), end(one.upper95, one.unit)),
                 !std::isfinite(one.width) ? "-"
                 : profiles                ? fmt::format("{:.2f}", one.width)
                                           : fmt::format("{:.2f}+-{:.2f}", one.width, one.width_error),
                 one.verdict);
  }
  for (const EnsembleMinimum& one : record.minima)
    fmt::print("chi squared {:.6g}: {} start(s)\n", one.chi_squared, one.starts);
  for (const std::string& failure : record.failures) fmt::print("without values: {}\n", failure);
  fmt::print("{}\n{}\n", record.how, record.verdict);
}

}  // namespace

unsigned members_asked(int number, const std::string& option, unsigned otherwise) {
  if (number < 0 || number > 1'000'000)
    throw InputError(fmt::format("{}: a whole number from 1 to 1000000 belongs here", option));
  return number == 0 ? otherwise : static_cast<unsigned>(number);
}

StudyOptions ensemble_options(const CommandOptions& options, Progress& progress) {
  StudyOptions study;
  study.budget = std::numeric_limits<double>::infinity();
  study.stop = options.stop;
  study.shard = shard_of(options);
  study.messages = options.messages;
  study.progress = [&progress](const std::string& what, size_t done, size_t all) {
    progress.show(fmt::format("{} ({} of {} are there)", what, done, all));
  };
  return study;
}

void print_ensemble(const EnsembleRun& run, const EnsembleTask& task, Progress& progress, bool as_text) {
  if (run.missing > 0)
    progress.say(
        fmt::format("{} of {} members are missing; the same command goes on from here", run.missing, task.count));
  if (as_text) print_text(run.record);
}

int end_ensemble(const CommandOptions& options, const EnsembleRun& run, const EnsembleTask& task, Progress& progress) {
  if (!options.shard.empty()) {
    progress.say(fmt::format("{} of {} members are there; once all are, the same command without --shard sums them up",
                             static_cast<int>(task.count) - run.missing, task.count));
    return options.interrupted() ? exit_interrupted : exit_ok;
  }
  print_ensemble(run, task, progress, !options.json);
  if (options.json) print_json(json_of(run));
  if (options.interrupted()) return exit_interrupted;
  return run.missing > 0 ? exit_solve : exit_ok;
}

void add_shard(AddOption add, CommandOptions& options) {
  add("shard", boost::program_options::value(&options.shard)->value_name("I/N"),
      "run the I-th of N parts only, for job arrays; nothing is summed up or drawn before all are done");
}

Shard shard_of(const CommandOptions& options) {
  if (options.shard.empty()) return {};
  const std::string& text = options.shard;
  const char* const end = text.data() + text.size();
  size_t index = 0, count = 0;
  const auto [slash, bad] = std::from_chars(text.data(), end, index);
  bool right = bad == std::errc() && slash != end && *slash == '/';
  if (right) {
    const auto [rest, wrong] = std::from_chars(slash + 1, end, count);
    right = wrong == std::errc() && rest == end && index >= 1 && index <= count && count <= 1'000'000;
  }
  if (!right)
    throw InputError(fmt::format("--shard: '{}' is no part; write I/N with 1 <= I <= N, for example 2/4", text));
  if (options.messages != nullptr)
    throw InputError("--shard: mpirun shares the work out itself; leave one of them out");
  return {index - 1, count};
}

}  // namespace taut

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "calib/runs/open_bench.hpp"
#include "calib/studies/sbc.hpp"
#include "experiments/cli/chart.hpp"
#include "experiments/cli/print.hpp"
#include "reports/sbc_figure.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

constexpr unsigned sbc_count = 200, sbc_draws = 100;
constexpr int enough_ranks = 50;  ///< fewer would not show a width that is off by half

const char* verdict_of(const SbcVerdict& verdict) {
  if (verdict.p < 0.01) return "the posterior is NOT the right one";
  return verdict.count < enough_ranks ? "too few to tell" : "as the right posterior's would be";
}

}  // namespace

int chart_sbc(const CommandOptions& options) {
  Progress progress(options.quiet);
  const Charted charted = read_charted(options);
  const auto* experiment = std::get_if<Experiment>(&charted);
  if (experiment == nullptr)
    throw InputError(options.target + ": a simulation has no parameters to fit; name an experiment with readings");
  const ChartFolder folder = open_chart(options, "sbc", charted, progress);
  const std::unique_ptr<Bench> bench = open_bench(*experiment, {options.threads, options.stop});
  const auto results = run_sbc(*bench, sbc_count, sbc_draws, folder.study);
  const auto missing = static_cast<size_t>(std::count(results.begin(), results.end(), std::nullopt));
  if (folder.study.is_part() || missing == results.size())
    return close_chart(options, missing, results.size(), progress);
  const std::vector<SbcVerdict> verdicts = judge_sbc(*bench, results);
  int failed = 0;
  double effective = 0;
  for (const auto& result : results) {
    failed += result && result->status != "ok";
    if (result) effective += result->effective / static_cast<double>(results.size() - missing);
  }
  draw_sbc(*bench, results, verdicts, folder.path.string());
  if (options.json) {
    nlohmann::ordered_json json{{"truths", results.size() - missing},
                                {"failed", failed},
                                {"draws", sbc_draws},
                                {"effective", effective},
                                {"parameters", nlohmann::ordered_json::array()}};
    for (const SbcVerdict& one : verdicts)
      json["parameters"].push_back({{"id", one.id}, {"ranks", one.count}, {"distance", one.distance}, {"p", one.p}});
    print_json(json);
  } else {
    fmt::print("SIMULATED DATA: truths drawn between the bounds, readings with their noise.\n");
    fmt::print("{} truths, {} without a posterior; {} draws each, which say as much as {:.0f} equal ones\n",
               results.size() - missing, failed, sbc_draws, effective);
    for (const SbcVerdict& one : verdicts)
      fmt::print("{}: {} ranks, largest distance from uniform {:.3f}, p = {:.2g}: {}\n", one.id, one.count,
                 one.distance, one.p, verdict_of(one));
  }
  return close_chart(options, missing, results.size(), progress);
}

}  // namespace taut

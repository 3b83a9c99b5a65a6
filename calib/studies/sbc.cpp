#include "calib/studies/sbc.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <sstream>

#include "calib/fit/distributions.hpp"
#include "calib/fit/gauss_newton.hpp"
#include "calib/fit/posterior.hpp"
#include "sim/core/draws.hpp"
#include "sim/core/error.hpp"
#include "sim/core/stopwatch.hpp"

namespace taut {
namespace {

/// A truth from the prior, and what a bench with it would read.
std::vector<Measurement> readings_of_truth(const Bench& bench, const std::vector<FreeParameter>& free, Draws& random,
                                           Params& truth) {
  Protocol& protocol = bench.protocol();
  truth = protocol.nominal();
  for (const FreeParameter& one : free)
    truth[one.index] = protocol.parameters()[one.index].logarithmic ? random.logarithmic(one.lower, one.upper)
                                                                    : random.uniform(one.lower, one.upper);
  protocol.forget();
  const Prediction predicted = protocol.predict(truth, {});
  if (!predicted.complete()) throw InputError(predicted.failures.front());
  std::vector<Measurement> readings = bench.measurements();
  for (Measurement& one : readings) one.value = predicted.values[one.row] + one.sigma * random.normal();
  return readings;
}

SbcResult ranked(const Bench& bench, const std::vector<FreeParameter>& free, unsigned number, unsigned draws,
                 const std::atomic<bool>* stop) {
  Draws random(number);
  Params truth;
  const std::vector<Measurement> readings = readings_of_truth(bench, free, random, truth);
  FitOptions options;
  options.profiles = false;
  options.stop = stop;
  bench.protocol().forget();
  const FitResult found = fit(bench.protocol(), readings, free, options);
  if (found.status != FitStatus::converged) return {std::string(name_of(found.status)), {}};
  options.held = found.p;
  const std::vector<FreeParameter> optimum = free_at(found, bench.protocol().parameters());
  PosteriorSampler sampler(bench.protocol(), readings, optimum, options);
  std::vector<std::vector<double>> values(free.size());
  std::vector<double> logs;
  for (unsigned k = 0; k < draws; ++k) {
    const PosteriorDraw draw = sampler.draw(k, number);
    if (draw.values.empty()) continue;
    logs.push_back(draw.log_weight);
    for (size_t j = 0; j < free.size(); ++j) values[j].push_back(draw.values[j]);
  }
  const std::vector<double> weights = weights_of(logs);
  SbcResult result{"ok", {}, effective_number(weights)};
  for (size_t j = 0; j < free.size(); ++j) {
    double below = 0, all = 0;
    for (size_t i = 0; i < weights.size(); ++i) {
      all += weights[i];
      below += values[j][i] < truth[free[j].index] ? weights[i] : 0;
    }
    result.ranks.push_back(below / all);
  }
  return result;
}

}  // namespace

std::vector<std::optional<SbcResult>> run_sbc(const Bench& bench, unsigned count, unsigned draws,
                                              const StudyOptions& options) {
  const std::vector<FreeParameter> free = bench.free();
  for (const FreeParameter& one : free) {
    const ParameterSpec& spec = bench.protocol().parameters()[one.index];
    if (!std::isfinite(one.lower) || !std::isfinite(one.upper) || (spec.logarithmic && !(one.lower > 0)))
      throw InputError(
          fmt::format("[fit.free.{}]: truths are drawn between its bounds; give it two finite ones", spec.id));
  }
  std::vector<std::optional<SbcResult>> results(count);
  Study study;
  study.columns = {"fingerprint", "draws", "number", "status", "effective", "ranks"};
  study.keys = 2;
  for (unsigned k = 1; k <= count; ++k)
    study.settings.push_back({{std::to_string(draws), std::to_string(k)}, fmt::format("truth {}", k), 1});
  study.least = 1;
  study.run = [&](size_t setting, const Deadline& deadline) -> std::optional<StudyResult> {
    const Stopwatch watch;
    SbcResult result;
    try {
      result = ranked(bench, free, static_cast<unsigned>(setting + 1), draws, &deadline.flag());
    } catch (const InputError& error) {
      result.status = error.what();
    }
    if (deadline.flag()) return std::nullopt;
    std::string ranks;
    for (double rank : result.ranks) ranks += fmt::format("{}{}", ranks.empty() ? "" : " ", rank);
    return StudyResult{{result.status, fmt::format("{}", result.effective), ranks}, watch.seconds()};
  };
  study.take = [&](size_t setting, const Cells& cells) {
    SbcResult result{cells[0], {}, std::strtod(cells[1].c_str(), nullptr)};
    std::istringstream in(cells[2]);
    for (std::string word; in >> word;) result.ranks.push_back(std::strtod(word.c_str(), nullptr));
    if (result.ranks.size() != (result.status == "ok" ? free.size() : 0)) return false;
    results[setting] = std::move(result);
    return true;
  };
  run_study(study, options);
  return results;
}

std::vector<SbcVerdict> judge_sbc(const Bench& bench, const std::vector<std::optional<SbcResult>>& results) {
  std::vector<SbcVerdict> verdicts;
  const std::vector<FreeParameter> free = bench.free();
  for (size_t j = 0; j < free.size(); ++j) {
    std::vector<double> ranks;
    for (const auto& result : results) {
      if (result && !result->ranks.empty()) ranks.push_back(result->ranks[j]);
    }
    std::ranges::sort(ranks);
    SbcVerdict& verdict = verdicts.emplace_back();
    verdict.id = bench.protocol().parameters()[free[j].index].id;
    verdict.count = static_cast<int>(ranks.size());
    const auto n = static_cast<double>(ranks.size());
    for (size_t i = 0; i < ranks.size(); ++i)
      verdict.distance = std::max(
          {verdict.distance, ranks[i] - static_cast<double>(i) / n, static_cast<double>(i + 1) / n - ranks[i]});
    if (!ranks.empty()) verdict.p = kolmogorov_probability(verdict.distance, verdict.count);
  }
  return verdicts;
}

}  // namespace taut

#include "calib/studies/score.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "calib/fit/distributions.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

/// Whether controls are the same, to what each may differ by.
class SameControls {
 public:
  explicit SameControls(const Trials& rig) : allowed_(rig.control_ids.size(), 0.0) {
    for (const Reading& reading : rig.readings) {
      for (size_t k = 0; k < allowed_.size(); ++k)
        allowed_[k] = std::max(allowed_[k], same_control * std::abs(reading.controls[k]));
    }
  }
  bool operator()(const std::vector<double>& a, const std::vector<double>& b) const {
    for (size_t k = 0; k < allowed_.size(); ++k) {
      if (!(std::abs(a[k] - b[k]) <= allowed_[k])) return false;
    }
    return true;
  }
  bool operator()(size_t k, double a, double b) const { return std::abs(a - b) <= allowed_[k]; }

 private:
  std::vector<double> allowed_;
};

/// One simulator's predictions, by the conditions of the rig.
struct MatchedSim {
  std::vector<std::optional<double>> predicted;  ///< of each reading of the rig
  std::vector<int> unpredicted, unread;          ///< lines
};

MatchedSim matched(const Trials& rig, const SimPredictions& sim, const SameControls& same) {
  MatchedSim found;
  found.predicted.resize(rig.readings.size());
  std::vector<const Reading*> by(rig.readings.size(), nullptr);
  std::set<int> unread, read, unpredicted;
  for (const Reading& row : sim.rows) {
    bool any = false;
    for (size_t i = 0; i < rig.readings.size(); ++i) {
      const Reading& reading = rig.readings[i];
      if (reading.channel != row.channel || !same(reading.controls, row.controls)) continue;
      any = true;
      if (by[i] != nullptr && std::abs(by[i]->value - row.value) > 1e-9 * std::abs(row.value))
        throw InputError(fmt::format(
            "{}, lines {} and {}: both predict channel '{}' for the same controls, {:.8g} and {:.8g} (SI); leave one",
            sim.name, by[i]->line, row.line, rig.channel_ids[static_cast<size_t>(row.channel)], by[i]->value,
            row.value));
      by[i] = &row;
      found.predicted[i] = row.value;
    }
    (any ? read : unread).insert(row.line);
  }
  for (const int line : unread) {
    if (!read.contains(line)) found.unread.push_back(line);
  }
  for (size_t i = 0; i < rig.readings.size(); ++i) {
    if (!found.predicted[i] && !rig.readings[i].excluded) unpredicted.insert(rig.readings[i].line);
  }
  found.unpredicted.assign(unpredicted.begin(), unpredicted.end());
  return found;
}

/// Groups of readings of one channel with the same controls.
std::vector<std::vector<const Reading*>> conditions_of(const std::vector<const Reading*>& readings,
                                                       const SameControls& same) {
  std::vector<std::vector<const Reading*>> groups;
  for (const Reading* reading : readings) {
    const auto group = std::ranges::find_if(groups, [&](const auto& one) {
      return one.front()->channel == reading->channel && same(one.front()->controls, reading->controls);
    });
    if (group == groups.end())
      groups.push_back({reading});
    else
      group->push_back(reading);
  }
  return groups;
}

RepeatScatter scatter_of(const std::vector<const Reading*>& readings, bool has_noise, const SameControls& same) {
  RepeatScatter scatter;
  double squares = 0, chi_squared = 0;
  for (const auto& group : conditions_of(readings, same)) {
    double sum = 0, weighted = 0, weights = 0;
    for (const Reading* reading : group) {
      const double weight = 1 / (reading->sigma * reading->sigma);
      sum += reading->value;
      weighted += weight * reading->value;
      weights += weight;
    }
    const double mean = sum / static_cast<double>(group.size());
    for (const Reading* reading : group) {
      squares += std::pow(reading->value - mean, 2);
      chi_squared += std::pow((reading->value - weighted / weights) / reading->sigma, 2);
    }
    scatter.dof += static_cast<int>(group.size()) - 1;
  }
  if (scatter.dof == 0) return scatter;
  scatter.standard_deviation = std::sqrt(squares / scatter.dof);
  scatter.least_rmse = std::sqrt(squares / static_cast<double>(readings.size()));
  if (has_noise) scatter.least_chi_squared = chi_squared;
  return scatter;
}

using Pairs = std::vector<std::pair<const Reading*, double>>;  // a reading and its prediction

ChannelScore channel_score(const Pairs& pairs, bool has_noise) {
  ChannelScore score;
  score.readings = static_cast<int>(pairs.size());
  if (pairs.empty()) return score;
  const double n = static_cast<double>(pairs.size());
  double squares = 0, sum = 0, chi_squared = 0, mean = 0, spread = 0, largest = -1;
  for (const auto& [reading, predicted] : pairs) mean += reading->value / n;
  for (const auto& [reading, predicted] : pairs) {
    const double miss = predicted - reading->value;
    squares += miss * miss;
    sum += miss;
    chi_squared += std::pow(miss / reading->sigma, 2);
    spread += std::pow(reading->value - mean, 2);
    if (std::abs(miss) > largest) {
      largest = std::abs(miss);
      score.largest = {reading->line, reading->controls, reading->value, predicted};
    }
  }
  score.rmse = std::sqrt(squares / n);
  score.bias = sum / n;
  const double scale = spread > 0 ? std::sqrt(spread / n) : std::abs(mean);
  score.relative = scale > 0 ? score.rmse / scale : score.rmse == 0 ? 0 : infinity;
  if (!has_noise) return score;
  score.chi_squared = chi_squared;
  score.p_value = chi_squared_probability(chi_squared, n);
  return score;
}

/// Means of one series over the retraction, ascending.
struct Series {
  std::vector<double> held, retraction, reading, prediction;
};

std::vector<Series> series_over(size_t control, const Pairs& pairs, const SameControls& same) {
  std::vector<const Reading*> readings;
  std::map<const Reading*, double> predicted;
  for (const auto& [reading, value] : pairs) {
    readings.push_back(reading);
    predicted[reading] = value;
  }
  std::vector<std::vector<const Reading*>> groups = conditions_of(readings, same);
  std::ranges::stable_sort(groups, {}, [&](const auto& group) { return group.front()->controls[control]; });
  std::vector<Series> all;
  for (const auto& group : groups) {
    std::vector<double> held = group.front()->controls;
    held[control] = not_a_number;
    auto series = std::ranges::find_if(all, [&](const Series& one) {
      for (size_t k = 0; k < held.size(); ++k) {
        if (k != control && !same(k, one.held[k], held[k])) return false;
      }
      return true;
    });
    if (series == all.end()) series = all.insert(all.end(), Series{held, {}, {}, {}});
    double sum = 0;
    for (const Reading* reading : group) sum += reading->value;
    series->retraction.push_back(group.front()->controls[control]);
    series->reading.push_back(sum / static_cast<double>(group.size()));
    series->prediction.push_back(predicted[group.front()]);
  }
  return all;
}

/// The step over which the size of `values` falls by the largest factor.
Closure::Step steepest(const std::vector<double>& at, const std::vector<double>& values) {
  Closure::Step step{at[0], at[1], 0};
  for (size_t i = 0; i + 1 < at.size(); ++i) {
    const double factor = std::abs(values[i] / values[i + 1]);
    if (factor > step.factor) step = {at[i], at[i + 1], factor};
  }
  return step;
}

/// The closure of one channel over one retraction, at the largest load that at least three retractions share.
std::optional<Closure> closure_over(size_t control, size_t load, int channel, const Pairs& pairs,
                                    const SameControls& same) {
  std::optional<Series> chosen;
  for (Series& series : series_over(control, pairs, same)) {
    if (series.retraction.size() < 3) continue;
    if (!chosen || std::abs(series.held[load]) > std::abs(chosen->held[load])) chosen = std::move(series);
  }
  if (!chosen) return std::nullopt;
  Closure closure;
  closure.channel = channel;
  closure.held = chosen->held;
  closure.measured = steepest(chosen->retraction, chosen->reading);
  closure.predicted = steepest(chosen->retraction, chosen->prediction);
  closure.at = closure.measured.to;
  const auto place =
      static_cast<size_t>(std::ranges::find(chosen->retraction, closure.at) - chosen->retraction.begin());
  closure.reading = chosen->reading[place];
  closure.prediction = chosen->prediction[place];
  return closure;
}

SimScore sim_score(const Trials& rig, const MatchedSim& sim, const std::vector<bool>& scored,
                   const std::vector<bool>& has_noise, const SameControls& same, const ClosureQuestion& closure) {
  SimScore score;
  score.unpredicted = sim.unpredicted;
  score.unread = sim.unread;
  double squares = 0, chi_squared = 0;
  int channels = 0;
  for (size_t c = 0; c < rig.channel_ids.size(); ++c) {
    Pairs pairs;
    for (size_t i = 0; i < rig.readings.size(); ++i) {
      if (scored[i] && rig.readings[i].channel == static_cast<int>(c))
        pairs.emplace_back(&rig.readings[i], *sim.predicted[i]);
    }
    const ChannelScore& one = score.channels.emplace_back(channel_score(pairs, has_noise[c]));
    if (pairs.empty()) continue;
    score.readings += one.readings;
    chi_squared += one.chi_squared;  // NaN where the noise is not known
    squares += one.relative * one.relative;
    ++channels;
    if (!closure.load || std::ranges::count(closure.displacements, static_cast<int>(c)) == 0) continue;
    for (const size_t control : closure.retractions) {
      if (const auto found = closure_over(control, *closure.load, static_cast<int>(c), pairs, same))
        score.closures.push_back(*found);
    }
  }
  score.relative = std::sqrt(squares / channels);
  score.chi_squared = chi_squared;
  if (std::isfinite(chi_squared)) score.p_value = chi_squared_probability(chi_squared, score.readings);
  return score;
}

}  // namespace

ScoreTable score(const Trials& rig, const std::vector<SimPredictions>& sims, const std::vector<bool>& has_noise,
                 const ClosureQuestion& closure) {
  const SameControls same(rig);
  ScoreTable table;
  std::vector<MatchedSim> found;
  std::vector<bool> scored;
  for (const Reading& reading : rig.readings) scored.push_back(!reading.excluded);
  table.available = static_cast<int>(std::ranges::count(scored, true));
  std::vector<std::string> names;
  for (const SimPredictions& sim : sims) {
    found.push_back(matched(rig, sim, same));
    names.push_back(sim.name);
    for (size_t i = 0; i < scored.size(); ++i) scored[i] = scored[i] && found.back().predicted[i];
  }
  table.readings = static_cast<int>(std::ranges::count(scored, true));
  if (table.readings == 0)
    throw InputError(fmt::format(
        "{}: no reading of the rig is predicted by {}: no row has its controls (to 1e-6 of each one's largest value); "
        "write the controls that were set into the table, with their units",
        join(names), sims.size() == 1 ? "it" : "all of them"));
  for (size_t c = 0; c < rig.channel_ids.size(); ++c) {
    std::vector<const Reading*> readings;
    for (size_t i = 0; i < scored.size(); ++i) {
      if (scored[i] && rig.readings[i].channel == static_cast<int>(c)) readings.push_back(&rig.readings[i]);
    }
    table.repeats.push_back(scatter_of(readings, has_noise[c], same));
  }
  for (size_t k = 0; k < sims.size(); ++k) {
    table.sims.push_back(sim_score(rig, found[k], scored, has_noise, same, closure));
    table.sims.back().name = sims[k].name;
  }
  const bool by_noise = std::ranges::all_of(table.sims, [](const SimScore& s) { return std::isfinite(s.chi_squared); });
  std::ranges::stable_sort(table.sims, {}, [&](const SimScore& s) { return by_noise ? s.chi_squared : s.relative; });
  return table;
}

}  // namespace taut

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <set>

#include "calib/check/look.hpp"
#include "calib/fit/distributions.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"

// Repeats of one condition against each other, one by one and trial by trial.
namespace taut {
namespace {

/// Below this, chance is no explanation.
constexpr double rare = 1e-4;

/// The names of the trials, in the order of the file.
std::vector<std::string> trials_of(const Look& look) {
  std::vector<std::string> names;
  for (const BenchReading* reading : look.readings) {
    if (std::ranges::find(names, reading->trial) == names.end()) names.push_back(reading->trial);
  }
  return names;
}

// One by one

/// A reading that its repeats contradict, and what they say.
struct OddRepeat {
  const BenchReading* reading = nullptr;
  double expected = 0;
  size_t repeats = 0;
};

/// Farther from the median of its repeats than 8 of its sigmas and 8 times their own scatter about it. Of a pair, the
/// first one.
std::vector<OddRepeat> contradicted(const Look& look) {
  std::vector<OddRepeat> found;
  for (const Repeats& group : look.repeats) {
    for (size_t i = 0; i < group.readings.size(); ++i) {
      std::vector<double> others, apart;
      for (size_t k = 0; k < group.readings.size(); ++k) {
        if (k != i) others.push_back(group.readings[k]->value);
      }
      if (others.empty() || (others.size() == 1 && i == 1)) continue;
      const double middle = median_of(others);
      for (double value : others) apart.push_back(std::abs(value - middle));
      const double sigma = group.readings[i]->sigma * std::sqrt(1 + 1.0 / static_cast<double>(others.size()));
      if (std::abs(group.readings[i]->value - middle) > 8 * std::max(sigma, 1.5 * median_of(apart)))
        found.push_back({group.readings[i], middle, others.size()});
    }
  }
  return found;
}

/// The trials all of whose readings, three at least, are one factor times what the others say.
std::map<std::string, double> trial_factors(const Look& look) {
  std::map<std::string, std::vector<double>> ratios;
  const size_t count = trials_of(look).size();
  for (const Repeats& group : look.repeats) {
    std::vector<double> values;
    for (const BenchReading* reading : group.readings) values.push_back(reading->value);
    if (values.size() < 2 || values.size() != count) continue;
    // Of two, the first is the measure.
    const double middle = count == 2 ? values.front() : median_of(values);
    if (std::abs(middle) < 5 * group.readings.front()->sigma) continue;
    for (const BenchReading* reading : group.readings) ratios[reading->trial].push_back(reading->value / middle);
  }
  std::map<std::string, double> factors;
  for (const auto& [trial, of_trial] : ratios) {
    const double middle = median_of(of_trial);
    const bool alike = std::ranges::all_of(of_trial, [&](double r) { return std::abs(r / middle - 1) < 0.1; });
    if (of_trial.size() >= 3 && alike && std::abs(middle - 1) > 0.3) factors[trial] = middle;
  }
  return factors;
}

/// Pairs of contradicted readings of one trial and channel that say what the other's repeats say.
std::vector<std::pair<OddRepeat, OddRepeat>> exchanged_pairs(const std::vector<OddRepeat>& odd) {
  std::vector<std::pair<OddRepeat, OddRepeat>> pairs;
  const auto says = [](const OddRepeat& one, const OddRepeat& other) {
    return std::abs(one.reading->value - other.expected) < 5 * one.reading->sigma;
  };
  for (size_t i = 0; i < odd.size(); ++i) {
    for (size_t k = i + 1; k < odd.size(); ++k) {
      const BenchReading &a = *odd[i].reading, &b = *odd[k].reading;
      if (a.trial == b.trial && a.channel == b.channel && says(odd[i], odd[k]) && says(odd[k], odd[i]))
        pairs.emplace_back(odd[i], odd[k]);
    }
  }
  return pairs;
}

Sentences odd_repeats(const Look& look) {
  const std::vector<OddRepeat> odd = contradicted(look);
  const auto pairs = exchanged_pairs(odd);
  const std::map<std::string, double> factors = trial_factors(look);
  const bool two = trials_of(look).size() == 2;
  Sentences found;
  for (const auto& [reading, expected, repeats] : odd) {
    const bool exchanged = std::ranges::any_of(pairs, [reading = reading](const auto& pair) {
      return pair.first.reading == reading || pair.second.reading == reading;
    });
    if (exchanged || factors.count(reading->trial) > 0 || (two && !factors.empty())) continue;  // said of all of them
    found.push_back(
        fmt::format("line {}: {} where {} {}{} ({}, {:.2g} of its sigmas off; the fit would be drawn to it)",
                    reading->line, with_unit(reading->value, look.unit(reading->channel)),
                    repeats == 1 ? "its repeat says" : fmt::format("{} repeats say", repeats),
                    with_unit(expected, look.unit(reading->channel)), slip_text(reading->value / expected, 0.05),
                    look.channel(reading->channel), std::abs(reading->value - expected) / reading->sigma));
  }
  return found;
}

Sentences exchanged_repeats(const Look& look) {
  Sentences found;
  for (const auto& [one, other] : exchanged_pairs(contradicted(look))) {
    const auto value = [&](const OddRepeat& odd) {
      return with_unit(odd.reading->value, look.unit(odd.reading->channel));
    };
    found.push_back(fmt::format(
        "lines {} and {} are exchanged: they read {} and {} ('{}'), and their repeats say it the other way round",
        one.reading->line, other.reading->line, value(one), value(other), look.channel(one.reading->channel)));
  }
  return found;
}

Sentences trials_in_other_units(const Look& look) {
  Sentences found;
  for (const auto& [trial, factor] : trial_factors(look))
    found.push_back(fmt::format("trial '{}': all its readings are {:.3g} times those of the other trials{}", trial,
                                factor, slip_text(factor, 0.05)));
  return found;
}

// Trial by trial

/// Deviations of repeats from the mean of their condition, over their sigmas: of a condition and a trial, the mean over
/// the channels, as what disturbs one disturbs the others too. Only conditions with all trials.
struct TrialTable {
  std::vector<std::string> trials;
  std::vector<std::vector<double>> off;   ///< of each condition, by trial
  std::vector<std::vector<double>> line;  ///< where they stand in the file
  std::vector<double> shift;              ///< of each trial, the mean of `off`
  double scatter = 0;                     ///< of a single one about its trial's shift
  double dof = 0;                         ///< of the scatter; below 6: too few to say anything
};

TrialTable trial_table(const Look& look) {
  TrialTable table{trials_of(look), {}, {}, {}, 0, 0};
  const size_t count = table.trials.size();
  std::map<std::vector<double>, std::pair<std::vector<double>, std::vector<double>>> rows;
  std::map<std::vector<double>, double> channels;
  for (const Repeats& group : look.repeats) {
    if (count < 2 || group.readings.size() != count) continue;
    auto& [off, line] = rows[group.controls];
    off.resize(count), line.resize(count);
    ++channels[group.controls];
    for (const BenchReading* reading : group.readings) {
      const auto t = static_cast<size_t>(std::ranges::find(table.trials, reading->trial) - table.trials.begin());
      off[t] += (reading->value - group.mean()) / reading->sigma;
      line[t] = reading->line;
    }
  }
  for (auto& [controls, row] : rows) {
    for (double& off : row.first) off /= channels[controls];
    table.off.push_back(row.first);
    table.line.push_back(row.second);
  }
  table.shift.assign(count, 0);
  const double conditions = static_cast<double>(table.off.size());
  for (const std::vector<double>& off : table.off) {
    for (size_t t = 0; t < count; ++t) table.shift[t] += off[t] / conditions;
  }
  table.dof = (conditions - 1) * (static_cast<double>(count) - 1);
  for (const std::vector<double>& off : table.off) {
    for (size_t t = 0; t < count; ++t) table.scatter += std::pow(off[t] - table.shift[t], 2);
  }
  table.scatter = std::sqrt(table.scatter / std::max(table.dof, 1.0));
  return table;
}

/// Whether trials differ from each other by more than their scatter and by half a sigma (Fisher's F test).
bool trials_differ(const TrialTable& table) {
  if (table.dof < 6) return false;
  double squares = 0, largest = 0;
  for (double shift : table.shift) {
    squares += static_cast<double>(table.off.size()) * shift * shift;
    largest = std::max(largest, std::abs(shift));
  }
  const double between = static_cast<double>(table.trials.size()) - 1;
  const double f = squares / between / std::max(table.scatter * table.scatter, 1e-12);
  return largest > 0.5 && f_probability(f, between, table.dof) < rare;
}

/// Whether the shifts go one way, no step of three or more being nothing beside the whole.
bool drifting(const std::vector<double>& shift) {
  const double whole = shift.back() - shift.front();
  bool one_way = shift.size() >= 3;
  for (size_t t = 1; t < shift.size(); ++t)
    one_way = one_way && (shift[t] - shift[t - 1]) / whole > 0.5 / static_cast<double>(shift.size());
  return one_way;
}

Sentences drift_over_trials(const Look& look) {
  const TrialTable table = trial_table(look);
  if (!trials_differ(table) || !drifting(table.shift)) return {};
  return {fmt::format(
      "readings drift from trial to trial: trial '{}' is {:+.2g} and trial '{}' {:+.2g} sigmas off the mean of all {} "
      "(scatter {:.2g}): does the specimen creep, soften or slip? The repeats' mean is then no value of one specimen",
      table.trials.front(), table.shift.front(), table.trials.back(), table.shift.back(), table.trials.size(),
      table.scatter)};
}

Sentences shifted_trials(const Look& look) {
  const TrialTable table = trial_table(look);
  if (!trials_differ(table) || drifting(table.shift) || !trial_factors(look).empty()) return {};
  const size_t odd = static_cast<size_t>(
      std::ranges::max_element(table.shift, {}, [](double s) { return std::abs(s); }) - table.shift.begin());
  return {fmt::format(
      "trial '{}' is off the others in all conditions, by {:+.2g} sigmas on average (scatter {:.2g}): was it taken "
      "under other conditions, or from another zero?",
      table.trials[odd],
      table.shift[odd] * static_cast<double>(table.trials.size()) / (static_cast<double>(table.trials.size()) - 1),
      table.scatter)};
}

/// Deviations of repeats, what belongs to condition and trial taken off, over the line in which they stand.
Sentences drift_with_order(const Look& look) {
  std::vector<std::pair<double, double>> points;
  double dof = -1;
  const TrialTable table = trial_table(look);
  if (table.trials.size() > 1) {
    std::vector<double> mean_line(table.trials.size(), 0);
    for (const std::vector<double>& line : table.line) {
      for (size_t t = 0; t < line.size(); ++t)
        mean_line[t] += (line[t] - median_of({line.begin(), line.end()})) / static_cast<double>(table.line.size());
    }
    for (size_t c = 0; c < table.off.size(); ++c) {
      const double middle = median_of(table.line[c]);
      for (size_t t = 0; t < table.trials.size(); ++t)
        points.emplace_back(table.line[c][t] - middle - mean_line[t], table.off[c][t] - table.shift[t]);
    }
    dof += table.dof;
  } else {
    for (const Repeats& group : look.repeats) {
      double line = 0;
      for (const BenchReading* reading : group.readings)
        line += reading->line / static_cast<double>(group.readings.size());
      for (const BenchReading* reading : group.readings)
        points.emplace_back(reading->line - line, (reading->value - group.mean()) / reading->sigma);
      dof += static_cast<double>(group.readings.size()) - 1;
    }
  }
  double xx = 0, xy = 0, rest = 0, first = 0, last = 0;
  for (const auto& [x, y] : points) xx += x * x, xy += x * y, first = std::min(first, x), last = std::max(last, x);
  if (dof < 6 || xx < 1) return {};
  for (const auto& [x, y] : points) rest += std::pow(y - xy / xx * x, 2);
  const double t = xy / std::sqrt(xx * std::max(rest / dof, 1e-12));
  const double whole = xy / xx * (last - first);
  if (std::abs(whole) < 1 || t_probability(t, dof) > rare) return {};
  return {fmt::format(
      "repeats drift with their order in the file, by {:+.2g} sigmas over {:.0f} lines (t = {:.2g}): does the specimen "
      "creep or does loading differ from unloading? Keep rows of one direction, or let the specimen rest before each",
      whole, last - first, t)};
}

Sentences copied_trials(const Look& look) {
  const std::vector<std::string> trials = trials_of(look);
  // Of pairs of trials: conditions in common, and how many of them read the same to the last digit.
  std::map<std::pair<std::string, std::string>, std::array<double, 2>> pairs;
  std::map<std::pair<std::string, std::string>, std::set<double>> values;
  std::vector<double> chances;
  for (const Repeats& group : look.repeats) {
    for (const BenchReading* a : group.readings) {
      for (const BenchReading* b : group.readings) {
        if (a->trial >= b->trial) continue;
        ++pairs[{a->trial, b->trial}][0];
        pairs[{a->trial, b->trial}][1] += a->value == b->value;
        values[{a->trial, b->trial}].insert(a->value);
      }
    }
  }
  Sentences found;
  for (const auto& [names, counts] : pairs) {
    if (counts[0] < 4 || counts[1] < counts[0] || values[names].size() < 4) continue;
    double chance = 0, others = 0, same = 0;
    for (const auto& [other, of_other] : pairs) {
      if (other != names) others += of_other[0], same += of_other[1];
    }
    if (others > 0) {
      chance = (same + 1) / (others + 2);
    } else {  // two that are rounded meet by chance
      double sigma = 0;
      for (const BenchReading* reading : look.readings)
        sigma += reading->sigma / static_cast<double>(look.readings.size());
      chance = step_of({values[names].begin(), values[names].end()}) / (2 * std::sqrt(M_PI) * sigma);
    }
    if (std::pow(std::min(chance, 1.0), counts[0]) < 0.01 * rare)
      found.push_back(fmt::format(
          "trials '{}' and '{}' read the same to the last digit in all {} conditions: one is a copy of the other, and "
          "counts as if it had been measured",
          names.first, names.second, counts[0]));
  }
  return found;
}

/// Scatter of repeats over what is declared, by channel.
struct Scatter {
  int channel = 0;
  double ratio = 0, dof = 0;
  double sigma = 0;  ///< declared, in the mean
};

std::vector<Scatter> scatters(const Look& look) {
  std::map<int, Scatter> found;
  std::map<int, double> count;
  std::set<const BenchReading*> odd;
  for (const OddRepeat& one : contradicted(look)) odd.insert(one.reading);
  for (const Repeats& group : look.repeats) {
    if (std::ranges::any_of(group.readings, [&](const BenchReading* reading) { return odd.count(reading) > 0; }))
      continue;
    Scatter& scatter = found.try_emplace(group.channel, Scatter{group.channel}).first->second;
    for (const BenchReading* reading : group.readings) {
      scatter.ratio += std::pow((reading->value - group.mean()) / reading->sigma, 2);
      scatter.sigma += reading->sigma;
      ++count[group.channel];
    }
    scatter.dof += static_cast<double>(group.readings.size()) - 1;
  }
  std::vector<Scatter> all;
  for (auto& [channel, scatter] : found) {
    scatter.ratio = std::sqrt(scatter.ratio / std::max(scatter.dof, 1.0));
    scatter.sigma /= count[channel];
    if (scatter.dof >= 6) all.push_back(scatter);
  }
  return all;
}

Sentences noise_too_small(const Look& look) {
  Sentences found;
  if (trials_differ(trial_table(look))) return found;  // said of the trials
  for (const auto& [channel, ratio, dof, sigma] : scatters(look)) {
    const double p = chi_squared_probability(ratio * ratio * dof, dof);
    if (ratio > 2 && p < rare)
      found.push_back(fmt::format(
          "channel '{}': repeats scatter by {:.2g} times the declared noise ({} on average; {:.0f} degrees of "
          "freedom): errors of the fit would be too small by as much; declare about {}",
          look.channel(channel), ratio, with_unit(sigma, look.unit(channel), 2), dof,
          with_unit(sigma * ratio, look.unit(channel), 2)));
  }
  return found;
}

Sentences noise_too_large(const Look& look) {
  Sentences found;
  for (const auto& [channel, ratio, dof, sigma] : scatters(look)) {
    // What all repeats share may be ten times their scatter, and rounding alone can make them alike.
    if (ratio < 1.0 / 20 && step_of(look.values_of(channel)) < sigma / 4)
      found.push_back(fmt::format(
          "channel '{}': the declared noise ({} on average) is over {:.0f} times the repeats' scatter ({:.0f} degrees "
          "of freedom): errors of the fit would be too large by as much, unless it is meant to hold what all "
          "repeats share",
          look.channel(channel), with_unit(sigma, look.unit(channel), 2), std::min(1 / ratio, 999.0), dof));
  }
  return found;
}

/// A condition that one trial alone has, in the place of one that it alone has not; they differ in one control.
Sentences mistyped_controls(const Look& look) {
  const size_t trials = trials_of(look).size();
  std::vector<const Repeats*> lone, short_of_one;
  size_t whole = 0;
  for (const Repeats& group : look.repeats) {
    if (trials < 2 || (group.readings.front()->trial).empty()) return {};
    if (group.readings.size() == 1) lone.push_back(&group);
    if (group.readings.size() + 1 == trials) short_of_one.push_back(&group);
    whole += group.readings.size() == trials;
  }
  Sentences found;
  for (const Repeats* one : lone) {
    const BenchReading& reading = *one->readings.front();
    for (const Repeats* other : short_of_one) {
      if (whole < 3 * lone.size() || other->channel != one->channel || other == one) continue;
      if (std::ranges::any_of(other->readings, [&](const BenchReading* r) { return r->trial == reading.trial; }))
        continue;
      std::vector<size_t> differ;
      for (size_t k = 0; k < one->controls.size(); ++k) {
        if (one->controls[k] != other->controls[k]) differ.push_back(k);
      }
      const auto uses = [&](const Repeats& group) {
        return std::ranges::count_if(look.readings, [&](const BenchReading* r) {
          return r->channel == group.channel && r->controls[differ[0]] == group.controls[differ[0]];
        });
      };
      if (differ.size() != 1 || uses(*one) > 1 || uses(*other) < 2) continue;
      const size_t k = differ[0];
      const std::string& unit = look.bench.controls()[k].unit;
      found.push_back(
          fmt::format("line {}: '{}' is {}, a condition that no other trial has, while trial '{}' alone has none at "
                      "{}: mistyped{}",
                      reading.line, look.bench.controls()[k].id, with_unit(one->controls[k], unit), reading.trial,
                      with_unit(other->controls[k], unit), slip_text(one->controls[k] / other->controls[k], 0.01)));
    }
  }
  return found;
}

}  // namespace

std::vector<Implausible> implausible_trials() {
  return {{"a reading against its repeats", odd_repeats},
          {"two readings exchanged between their repeats", exchanged_repeats},
          {"a trial in another unit", trials_in_other_units},
          {"drift over trials", drift_over_trials},
          {"a trial apart from the others", shifted_trials},
          {"drift with order", drift_with_order},
          {"a copied trial", copied_trials},
          {"declared noise below the scatter", noise_too_small},
          {"declared noise above the scatter", noise_too_large},
          {"a mistyped control", mistyped_controls}};
}

}  // namespace taut

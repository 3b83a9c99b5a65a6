#include "calib/data/plausibility.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

namespace taut {
namespace {

double median(std::vector<double> values) {
  std::ranges::sort(values);
  const size_t n = values.size();
  return 0.5 * (values[(n - 1) / 2] + values[n / 2]);
}

/// What a repeat says against its siblings' values; "" when nothing.
std::string oddness(const Reading& reading, const std::vector<double>& others, const std::string& unit) {
  const double middle = median(others);
  std::vector<double> apart;
  for (double value : others) apart.push_back(std::abs(value - middle));
  const double off = std::abs(reading.value - middle);
  if (off <=
      8 * std::max({reading.sigma * std::sqrt(1 + 1.0 / static_cast<double>(others.size())), 1.5 * median(apart)}))
    return "";
  const std::string slip = slip_of(reading.value / middle, 0.05);
  return fmt::format("line {}: {} where {} say{} {}{}", reading.line, with_unit(reading.value, unit),
                     others.size() == 1 ? "its repeat" : fmt::format("{} repeats", others.size()),
                     others.size() == 1 ? "s" : "", with_unit(middle, unit),
                     slip.empty() ? "" : fmt::format(", {}", slip));
}

}  // namespace

std::string slip_of(double ratio, double tolerance) {
  struct Slip {
    double factor;
    const char* words;
  };
  constexpr std::array<Slip, 5> slips{{{10, "a slipped decimal point or a wrong unit?"},
                                       {100, "a slipped decimal point or a wrong unit?"},
                                       {1000, "a wrong unit?"},
                                       {25.4, "inches?"},
                                       {9.81, "a mass for a force?"}}};
  if (std::abs(ratio + 1) < tolerance) return "the same with the other sign";
  for (const bool inverse : {false, true}) {
    const double r = inverse ? 1 / ratio : ratio;
    const Slip* nearest = nullptr;
    for (const Slip& slip : slips) {
      const auto off = [&](const Slip& s) { return std::abs(r / s.factor - 1); };
      if (off(slip) < tolerance && (nearest == nullptr || off(slip) < off(*nearest))) nearest = &slip;
    }
    if (nearest != nullptr)
      return fmt::format("{} {}: {}", inverse ? "smaller by" : "larger by", nearest->factor, nearest->words);
  }
  return "";
}

std::vector<std::string> odd_repeats(const Trials& trials, const std::vector<std::string>& units) {
  std::map<std::pair<int, std::vector<double>>, std::vector<const Reading*>> groups;
  for (const Reading& reading : trials.readings) {
    if (!reading.excluded) groups[{reading.channel, reading.controls}].push_back(&reading);
  }
  std::vector<std::string> found;
  for (const auto& group : groups) {
    const std::vector<const Reading*>& readings = group.second;
    for (size_t i = 0; i < readings.size(); ++i) {
      std::vector<double> others;
      for (size_t k = 0; k < readings.size(); ++k) {
        if (k != i) others.push_back(readings[k]->value);
      }
      if (others.empty() || (others.size() == 1 && i == 1)) continue;  // a pair is told once
      const std::string odd = oddness(*readings[i], others, units[static_cast<size_t>(readings[i]->channel)]);
      if (!odd.empty())
        found.push_back(odd + fmt::format(" ({}; the fit would be drawn to it)",
                                          trials.channel_ids[static_cast<size_t>(readings[i]->channel)]));
    }
  }
  return found;
}

std::vector<std::string> out_of_proportion(const Trials& trials, const std::vector<std::string>& retractions,
                                           const std::vector<std::string>& units, double size) {
  std::vector<std::string> found;
  for (size_t k = 0; k < trials.control_ids.size(); ++k) {
    if (std::ranges::find(retractions, trials.control_ids[k]) == retractions.end() || trials.control_values[k].empty())
      continue;
    const double most =
        std::max(std::abs(*trials.control_values[k].begin()), std::abs(*trials.control_values[k].rbegin()));
    if (most > 0.5 * size)
      found.push_back(fmt::format(
          "'{}' goes to {}, more than half of the specimen's {}: no cable can be retracted so far; is its unit right "
          "(cm or inches for mm)?",
          trials.control_ids[k], with_unit(most, "m"), with_unit(size, "m")));
  }
  for (size_t c = 0; c < trials.channel_ids.size(); ++c) {
    const Reading* largest = nullptr;
    for (const Reading& reading : trials.readings) {
      if (static_cast<size_t>(reading.channel) != c || units[c] != "m" || reading.excluded) continue;
      if (largest == nullptr || std::abs(reading.value) > std::abs(largest->value)) largest = &reading;
    }
    if (largest != nullptr && std::abs(largest->value) > 3 * size)
      found.push_back(fmt::format("line {}: '{}' reads {} on a specimen of {}; is its unit right?", largest->line,
                                  trials.channel_ids[c], with_unit(largest->value, "m"), with_unit(size, "m")));
  }
  return found;
}

}  // namespace taut

#include "calib/runs/new_reading.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>

#include "sim/core/error.hpp"

namespace taut {
namespace {

/// Of the run's readings of a channel, interpolated over the load.
double sigma_at(const RunRecord& record, const std::string& channel, double load) {
  std::map<double, std::pair<double, int>> by_load;  // load to sum of sigma^2 and count
  for (size_t i = 0; i < record.readings.size(); ++i) {
    if (record.readings[i].channel != channel || record.readings[i].excluded) continue;
    auto& [sum, count] = by_load[record.load_newtons[i]];
    sum += record.readings[i].sigma * record.readings[i].sigma;
    ++count;
  }
  auto sigma = [](const auto& entry) { return std::sqrt(entry->second.first / entry->second.second); };
  if (by_load.empty()) return 0;
  const auto above = by_load.lower_bound(load);
  if (above == by_load.begin()) return sigma(above);
  if (above == by_load.end()) return sigma(std::prev(above));
  const auto below = std::prev(above);
  const double t = (load - below->first) / (above->first - below->first);
  return (1 - t) * sigma(below) + t * sigma(above);
}

}  // namespace

double sigma_of_new_reading(const RunRecord& record, const Bench& bench, const BenchReading& at, double value) {
  if (const std::optional<double> declared = bench.declared_sigma(at.channel, value)) return *declared;
  const size_t k = static_cast<size_t>(std::max(0, record.load_control));
  const double load = record.load_control < 0 ? 0.0 : bench.as_force(k, at.controls[k]);
  return sigma_at(record, bench.channels()[static_cast<size_t>(at.channel)].id, load);
}

double sigma_of_new_reading(const Bench& bench, const BenchReading& at, double value) {
  if (const std::optional<double> declared = bench.declared_sigma(at.channel, value)) return *declared;
  const BenchFormat::Channel& channel = bench.experiment().bench.channels[static_cast<size_t>(at.channel)];
  if (channel.noise.given()) return channel.noise.sigma(value);
  throw InputError(
      fmt::format("{}: nothing says yet how much channel '{}' will scatter: sigmas stand in the column "
                  "'{}'; give it noise = {{ absolute = ... }} in its [[channel]] to plan",
                  bench.experiment().path, channel.id, bench.experiment().bench.sigma_column));
}

}  // namespace taut

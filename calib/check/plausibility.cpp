#include "calib/check/plausibility.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <tuple>

#include "calib/check/look.hpp"
#include "calib/data/slips.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"

namespace taut {
namespace {

/// The way in which it is a chain of beams, clamped where the first support is.
std::optional<Spine> spine_of(const Experiment& experiment) {
  if (!experiment.geometry.shape) return std::nullopt;
  try {
    const std::vector<Spine> spines = experiment.geometry.shape->spines();
    for (const Spine& spine : spines) {
      if (!experiment.supports.empty() && spine.clamped == experiment.supports.front().on) return spine;
    }
    if (!spines.empty()) return spines.front();
  } catch (const InputError&) {  // its dimensions make it no chain
  }
  return std::nullopt;
}

/// What is free, none where that is wrong input: whoever fits it says so.
std::vector<FreeParameter> free_of(const Bench& bench) {
  try {
    return bench.free();
  } catch (const InputError&) {
    return {};
  }
}

double size_of(const Bench& bench) {
  if (const Mesh* mesh = bench.states().mesh) return mesh->diagonal();
  if (!bench.experiment().geometry.shape) return 0;
  return vector_of(bench.experiment().geometry.shape->extent()).norm();
}

}  // namespace

double Repeats::mean() const {
  double sum = 0;
  for (const BenchReading* reading : readings) sum += reading->value;
  return sum / static_cast<double>(readings.size());
}

double Repeats::median() const {
  std::vector<double> values;
  for (const BenchReading* reading : readings) values.push_back(reading->value);
  return median_of(values);
}

double Repeats::sigma() const {
  double sum = 0;
  for (const BenchReading* reading : readings) sum += reading->sigma * reading->sigma;
  return std::sqrt(sum) / static_cast<double>(readings.size());
}

Look::Look(const Bench& of)
    : bench(of),
      experiment(of.experiment()),
      table(of.protocol().parameters()),
      free(free_of(of)),
      start(of.protocol().nominal()),
      size(size_of(of)),
      spine(spine_of(of.experiment())) {
  for (const FreeParameter& parameter : free) start[parameter.index] = parameter.start;
  // Where readings depend on what was before them, only those with the same past are repeats.
  const bool ordered = experiment.cables.rub || !experiment.kind->specimen;
  const auto past_of = [&](const BenchReading& reading) {
    const bool by_order = ordered && !std::isnan(reading.order);
    return std::array<double, 3>{reading.turn.dwell, reading.turn.rest, by_order ? reading.order : 0};
  };
  std::map<std::tuple<int, std::vector<double>, std::array<double, 3>>, std::vector<const BenchReading*>> groups;
  for (const BenchReading& reading : bench.readings()) {
    if (reading.excluded) continue;
    readings.push_back(&reading);
    if (at_rest() || !experiment.kind->specimen)
      groups[{reading.channel, reading.controls, past_of(reading)}].push_back(&reading);
  }
  for (auto& [key, of_group] : groups) repeats.push_back({std::get<0>(key), std::get<1>(key), std::move(of_group)});
}

std::vector<double> Look::values_of(int channel) const {
  std::vector<double> values;
  for (const BenchReading* reading : readings) {
    if (reading->channel == channel) values.push_back(reading->value);
  }
  return values;
}

std::vector<Look::Motion> Look::motions(bool retractions) const {
  std::vector<Motion> found;
  for (size_t k = 0; at_rest() && k < bench.controls().size(); ++k) {
    const AxisRecord& control = bench.controls()[k];
    if (control.unit != "m" || (experiment.cables.columns.count(control.id) > 0) != retractions) continue;
    Motion motion{control.id, 0, 0};
    for (const BenchReading* reading : readings) {
      if (std::abs(reading->controls[k]) > motion.most)
        motion = {control.id, std::abs(reading->controls[k]), reading->line};
    }
    found.push_back(motion);
  }
  return found;
}

const FreeParameter* Look::free_parameter(const std::string& id) const {
  const auto found = std::ranges::find_if(free, [&](const FreeParameter& p) { return table[p.index].id == id; });
  return found == free.end() ? nullptr : &*found;
}

double Look::value(const std::string& id) const {
  return table.contains(id) ? start[table.index(id)] : not_a_number;
}

double median_of(std::vector<double> values) {
  std::ranges::sort(values);
  const size_t n = values.size();
  return 0.5 * (values[(n - 1) / 2] + values[n / 2]);
}

double step_of(const std::vector<double>& values) {
  double largest = 0;
  for (double value : values) largest = std::max(largest, std::abs(value));
  if (largest == 0) return 0;
  const int first = static_cast<int>(std::floor(std::log10(largest)));
  for (int power = first; power > first - 9; --power) {
    const double step = std::pow(10.0, power);
    if (std::ranges::all_of(values, [&](double v) { return std::abs(v / step - std::round(v / step)) < 1e-6; }))
      return step;
  }
  return 0;
}

std::string slip_text(double ratio, double tolerance) {
  const std::string slip = slip_of(ratio, tolerance);
  return slip.empty() ? "" : ", " + slip;
}

std::vector<Implausible> kinds_of_implausible() {
  std::vector<Implausible> kinds;
  for (const auto& table :
       {implausible_readings, implausible_trials, implausible_settings, implausible_for_beams, implausible_curves}) {
    for (const Implausible& kind : table()) kinds.push_back(kind);
  }
  return kinds;
}

std::vector<Finding> implausible(const Bench& bench) {
  const Look look(bench);
  std::vector<Finding> findings;
  // Of a plan, what was not measured cannot be wrong.
  const bool plan = std::ranges::all_of(bench.readings(), [](const BenchReading& r) { return std::isnan(r.value); });
  for (const Implausible& kind : plan ? implausible_settings() : kinds_of_implausible()) {
    for (std::string& sentence : kind.find(look)) findings.push_back({kind.name, std::move(sentence)});
  }
  return findings;
}

}  // namespace taut

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "calib/check/look.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"
#include "sim/mesh/mesh.hpp"
#include "sim/scene/channel_kinds.hpp"

// What readings at rest say by themselves, against their controls and against the specimen's size.
namespace taut {
namespace {

/// The control over which a reading is followed: a load, or the strain of a material point; -1: none.
int followed_control(const Look& look) {
  return look.experiment.kind->specimen ? look.bench.drawn_control() : 0;
}

/// Medians of one channel over the followed control, all others held, ascending.
struct Series {
  int channel = 0;
  std::vector<const Repeats*> points;
};

std::vector<Series> series_of(const Look& look) {
  const int followed = followed_control(look);
  std::map<std::pair<int, std::vector<double>>, Series> found;
  if (followed < 0) return {};
  for (const Repeats& group : look.repeats) {  // these ascend by their controls
    std::vector<double> held = group.controls;
    held[static_cast<size_t>(followed)] = 0;
    Series& series = found.try_emplace({group.channel, held}, Series{group.channel, {}}).first->second;
    series.points.push_back(&group);
  }
  std::vector<Series> all;
  for (auto& [key, series] : found) {
    std::ranges::sort(series.points, {}, [&](const Repeats* p) { return p->controls[static_cast<size_t>(followed)]; });
    all.push_back(std::move(series));
  }
  return all;
}

/// Whether the values go one way, but for steps back within 5 of their sigmas.
bool goes_one_way(const std::vector<double>& values, const std::vector<double>& sigmas, double way) {
  for (size_t i = 1; i < values.size(); ++i) {
    if (way * (values[i] - values[i - 1]) < -5 * std::hypot(sigmas[i], sigmas[i - 1])) return false;
  }
  return true;
}

Sentences exchanged_in_series(const Look& look) {
  Sentences found;
  for (const Series& series : series_of(look)) {
    std::vector<double> values, sigmas;
    for (const Repeats* point : series.points) values.push_back(point->median()), sigmas.push_back(point->sigma());
    const size_t n = values.size();
    if (n < 4) continue;
    double way = 0;
    for (size_t i = 0; i < n; ++i) way += (2 * static_cast<double>(i) - static_cast<double>(n - 1)) * values[i];
    way = way < 0 ? -1 : 1;
    if (goes_one_way(values, sigmas, way)) continue;
    std::vector<std::pair<size_t, size_t>> mends;
    for (size_t i = 0; i < n; ++i) {
      for (size_t k = i + 1; k < n; ++k) {
        std::vector<double> swapped = values;
        std::swap(swapped[i], swapped[k]);
        if (goes_one_way(swapped, sigmas, way)) mends.emplace_back(i, k);
      }
    }
    if (mends.size() != 1) continue;
    const auto& [i, k] = mends.front();
    found.push_back(fmt::format(
        "lines {} and {} ('{}') look exchanged: they read {} and {} against the trend of the {} readings of their "
        "series, {:.2g} sigmas, and the other way round with it",
        series.points[i]->readings.front()->line, series.points[k]->readings.front()->line,
        look.channel(series.channel), with_unit(values[i], look.unit(series.channel)),
        with_unit(values[k], look.unit(series.channel)), n,
        std::abs(values[i] - values[k]) / std::hypot(sigmas[i], sigmas[k])));
  }
  return found;
}

/// Where a load or a channel acts: the middle of its tag, or its point.
Eigen::VectorXd middle_of(const Mesh& mesh, const std::string& on, const std::vector<double>& point) {
  if (on.empty()) return vector_of(point);
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(mesh.dimension());
  const std::vector<int> nodes = mesh.select(on).nodes();
  for (int node : nodes) sum += mesh.node(node) / static_cast<double>(nodes.size());
  return sum;
}

/// A displacement at the place of a load and along it grows with the load in every stable state.
Sentences against_its_load(const Look& look) {
  Sentences found;
  const Mesh* mesh = look.bench.states().mesh;
  const std::vector<LoadSettings>& loads = look.experiment.loads;
  if (!look.at_rest() || mesh == nullptr || loads.size() != 1 || loads[0].column.empty() || !look.beam_views().empty())
    return found;
  const LoadSettings& load = loads[0];
  if (mesh->dimension() != static_cast<int>(load.direction.size())) return found;
  std::string said;
  for (const Series& series : series_of(look)) {
    const ChannelSettings& channel = look.experiment.channels[static_cast<size_t>(series.channel)];
    if (channel.kind->name != "displacement" || series.points.size() < 2 || channel.id == said) continue;
    const double along = vector_of(load.direction).normalized().dot(vector_of(channel.direction).normalized());
    const Eigen::VectorXd apart = middle_of(*mesh, load.on, load.point) - middle_of(*mesh, channel.on, channel.point);
    if (std::abs(along) < 0.7 || apart.norm() > 0.3 * look.size) continue;
    const Repeats &first = *series.points.front(), &last = *series.points.back();
    const double sigma = std::hypot(first.sigma(), last.sigma());
    const double growth = (along < 0 ? -1 : 1) * (last.median() - first.median());
    if (growth >= -8 * sigma) continue;
    said = channel.id;
    found.push_back(
        fmt::format("line {}: channel '{}' goes back by {} ({:.2g} sigmas) while its load '{}' grows: turn the "
                    "channel's direction "
                    "round, or the readings' sign",
                    last.readings.front()->line, channel.id, with_unit(-growth, look.unit(series.channel)),
                    -growth / sigma, load.id));
  }
  return found;
}

Sentences all_zero(const Look& look) {
  Sentences found;
  for (size_t c = 0; c < look.bench.channels().size(); ++c) {
    const std::vector<double> values = look.values_of(static_cast<int>(c));
    if (values.size() >= 3 && std::ranges::all_of(values, [](double v) { return v == 0; }))
      found.push_back(fmt::format(
          "channel '{}': all {} readings are 0: was it connected? Readings that were not taken are left empty",
          look.channel(static_cast<int>(c)), values.size()));
  }
  return found;
}

Sentences stuck(const Look& look) {
  Sentences found;
  for (size_t c = 0; look.at_rest() && c < look.bench.channels().size(); ++c) {
    const int channel = static_cast<int>(c);
    const std::vector<double> values = look.values_of(channel);
    const auto conditions = std::ranges::count(look.repeats, channel, &Repeats::channel);
    if (conditions < 4 || values.front() == 0 ||
        std::ranges::any_of(values, [&](double v) { return v != values.front(); }))
      continue;
    found.push_back(fmt::format(
        "channel '{}': reads {} to the last digit in all {} conditions: the instrument hangs, or the column is not "
        "its own",
        look.channel(channel), with_unit(values.front(), look.unit(channel)), conditions));
  }
  return found;
}

Sentences coarse_rounding(const Look& look) {
  Sentences found;
  for (size_t c = 0; c < look.bench.channels().size(); ++c) {
    const int channel = static_cast<int>(c);
    const std::vector<double> values = look.values_of(channel);
    const std::set<double> distinct(values.begin(), values.end());
    if (values.size() < 6 || distinct.size() < 4) continue;
    std::vector<double> sigmas;
    for (const BenchReading* reading : look.readings) {
      if (reading->channel == channel) sigmas.push_back(reading->sigma);
    }
    const double step = step_of(values), rounding = step / std::sqrt(12.0), sigma = median_of(sigmas);
    if (rounding > 2 * sigma)
      found.push_back(fmt::format(
          "channel '{}': all {} readings are multiples of {}, whose rounding alone is {}, {:.2g} times the declared "
          "noise ({}); declare resolution = \"{}\"",
          look.channel(channel), values.size(), with_unit(step, look.unit(channel)),
          with_unit(rounding, look.unit(channel), 2), rounding / sigma, with_unit(sigma, look.unit(channel), 2),
          with_unit(step, look.unit(channel))));
  }
  return found;
}

Sentences coarse_resolution(const Look& look) {
  Sentences found;
  for (size_t c = 0; c < look.bench.channels().size(); ++c) {
    const int channel = static_cast<int>(c);
    if (!look.experiment.bench.sigma_column.empty() || c >= look.experiment.bench.channels.size()) continue;
    const double resolution = look.experiment.bench.channels[c].noise.resolution;
    const BenchReading* smallest = nullptr;
    for (const BenchReading* reading : look.readings) {
      if (reading->channel != channel || reading->value == 0) continue;
      if (smallest == nullptr || std::abs(reading->value) < std::abs(smallest->value)) smallest = reading;
    }
    const double step = step_of(look.values_of(channel));
    if (smallest != nullptr && resolution > std::abs(smallest->value) && resolution > 5 * step)
      found.push_back(fmt::format(
          "channel '{}': its resolution, {}, is coarser than its smallest reading ({} in line {}), and its readings "
          "have digits down to {}; is the resolution's unit right?",
          look.channel(channel), with_unit(resolution, look.unit(channel)),
          with_unit(smallest->value, look.unit(channel)), smallest->line, with_unit(step, look.unit(channel))));
  }
  return found;
}

Sentences loud_noise(const Look& look) {
  Sentences found;
  for (size_t c = 0; c < look.experiment.bench.channels.size(); ++c) {
    const int channel = static_cast<int>(c);
    const double relative = look.experiment.bench.channels[c].noise.relative;
    bool all = true, zero = true;
    for (const BenchReading* reading : look.readings) {
      if (reading->channel != channel) continue;
      all = all && std::abs(reading->value) < reading->sigma;
      zero = zero && reading->value == 0;
    }
    if (relative >= 0.5 && look.experiment.bench.sigma_column.empty())
      found.push_back(fmt::format(
          "channel '{}': a relative noise of {:.4g} is {:.4g} % of the reading: meant in per cent? It would be "
          "relative = \"{:.4g} %\"",
          look.channel(channel), relative, 100 * relative, relative));
    else if (all && !zero && look.values_of(channel).size() >= 3)
      found.push_back(fmt::format(
          "channel '{}': the declared noise is larger than every reading: nothing can be learnt from them; is its unit "
          "right?",
          look.channel(channel)));
  }
  return found;
}

Sentences too_few_conditions(const Look& look) {
  if (look.repeats.empty() || look.repeats.size() >= look.free.size()) return {};
  return {fmt::format(
      "{} free parameters and {} different readings, repeats aside: some parameters cannot be told; measure more "
      "conditions or hold {} of them",
      look.free.size(), look.repeats.size(), look.free.size() - look.repeats.size())};
}

/// Whether nothing acts in a condition that does not act where readings start from.
bool nothing_acts(const Look& look, const Repeats& group) {
  const Experiment& e = look.experiment;
  const bool constant_load =
      std::ranges::any_of(e.loads, [](const LoadSettings& load) { return load.column.empty() && load.value != 0; });
  bool retracted = false;
  for (size_t k = 0; k < group.controls.size(); ++k) {
    const bool retraction = e.cables.columns.count(look.bench.controls()[k].id) > 0;
    if (group.controls[k] != 0 && !retraction) return false;
    retracted = retracted || group.controls[k] != 0;
  }
  return e.from_unloaded ? !constant_load : !constant_load && !retracted && !look.own_weight();
}

Sentences zero_not_zero(const Look& look) {
  Sentences found;
  if (!look.at_rest() || !look.experiment.zero_offset_per.empty()) return found;
  for (const Repeats& group : look.repeats) {
    const double off = group.median(), sigma = group.readings.front()->sigma;
    if (!look.experiment.channels[static_cast<size_t>(group.channel)].kind->from_rest || std::abs(off) < 6 * sigma ||
        !nothing_acts(look, group))
      continue;
    found.push_back(fmt::format(
        "line {}: '{}' reads {} where nothing acts ({:.2g} sigmas): subtract this zero, or let the fit find it "
        "([bench] zero_offset_per)",
        group.readings.front()->line, look.channel(group.channel), with_unit(off, look.unit(group.channel)),
        std::abs(off) / sigma));
  }
  return found;
}

/// The largest reading of each channel of this unit.
std::vector<const BenchReading*> largest_readings(const Look& look, std::string_view unit) {
  std::vector<const BenchReading*> largest(look.bench.channels().size(), nullptr);
  for (const BenchReading* reading : look.readings) {
    const BenchReading*& most = largest[static_cast<size_t>(reading->channel)];
    if (look.unit(reading->channel) == unit && (most == nullptr || std::abs(reading->value) > std::abs(most->value)))
      most = reading;
  }
  std::erase(largest, nullptr);
  return largest;
}

Sentences beyond_the_specimen(const Look& look) {
  Sentences found;
  if (!look.at_rest() || look.size == 0) return found;
  for (const BenchReading* reading : largest_readings(look, "m")) {
    if (std::abs(reading->value) > 1000 * look.size)
      throw InputError(fmt::format(
          "{}: [bench] line {}: '{}' reads {} on a specimen of {}; no specimen moves a thousand times its own "
          "size, so correct the reading or its unit",
          look.experiment.path, reading->line, look.channel(reading->channel), with_unit(reading->value, "m"),
          with_unit(look.size, "m")));
    if (std::abs(reading->value) > 3 * look.size)
      found.push_back(
          fmt::format("line {}: '{}' reads {} on a specimen of {}, {:.2g} times its size; is its unit right?",
                      reading->line, look.channel(reading->channel), with_unit(reading->value, "m"),
                      with_unit(look.size, "m"), std::abs(reading->value) / look.size));
  }
  return found;
}

Sentences turns_beyond_one(const Look& look) {
  Sentences found;
  if (!look.at_rest()) return found;
  for (const BenchReading* reading : largest_readings(look, "rad")) {
    if (std::abs(reading->value) > 2 * M_PI)
      found.push_back(fmt::format(
          "line {}: '{}' reads {:.4g} rad, more than a whole turn: degrees? The column would be called ..._deg",
          reading->line, look.channel(reading->channel), reading->value));
  }
  return found;
}

Sentences negative_masses(const Look& look) {
  for (size_t k = 0; k < look.bench.controls().size(); ++k) {
    if (look.bench.controls()[k].quantity != name_of(Quantity::mass)) continue;
    for (const BenchReading* reading : look.readings) {
      if (reading->controls[k] < 0)
        return {fmt::format(
            "line {}: '{}' is {}, and nothing weighs less than nothing: the load's direction says which way it pulls",
            reading->line, look.bench.controls()[k].id, with_unit(reading->controls[k], "kg"))};
    }
  }
  return {};
}

}  // namespace

std::vector<Implausible> implausible_readings() {
  return {{"two readings exchanged against the trend", exchanged_in_series},
          {"a channel against its load", against_its_load},
          {"readings that are all zero", all_zero},
          {"readings that never change", stuck},
          {"rounding coarser than the noise", coarse_rounding},
          {"resolution coarser than the readings", coarse_resolution},
          {"noise larger than the readings", loud_noise},
          {"fewer readings than free parameters", too_few_conditions},
          {"a zero that is not zero", zero_not_zero},
          {"readings larger than the specimen", beyond_the_specimen},
          {"angles in another unit", turns_beyond_one},
          {"a negative mass", negative_masses}};
}

}  // namespace taut

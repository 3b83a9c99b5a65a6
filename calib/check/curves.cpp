#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "calib/benches/recordings.hpp"
#include "calib/benches/recordings_bench.hpp"
#include "calib/check/look.hpp"
#include "calib/data/slips.hpp"
#include "sim/core/units.hpp"

// Recordings over time, and stresses over strains.
namespace taut {
namespace {

bool over_time(const Look& look) {
  return look.experiment.kind == &recordings_kind;
}
bool at_a_point(const Look& look) {
  return !look.experiment.kind->specimen;
}

/// Samples of one channel of one recording, in the order of time.
struct Recorded {
  const RecordingSettings* settings = nullptr;
  int channel = 0;
  std::vector<const BenchReading*> samples;
  double first() const { return samples.front()->controls[0]; }
  double last() const { return samples.back()->controls[0]; }
};

std::vector<Recorded> recorded(const Look& look) {
  std::vector<Recorded> all;
  if (!over_time(look)) return all;
  for (const BenchReading* reading : look.readings) {
    if (all.empty() || all.back().settings->id != reading->trial || all.back().channel != reading->channel) {
      const auto& settings = recordings_of(look.experiment).recordings;
      all.push_back({&*std::ranges::find(settings, reading->trial, &RecordingSettings::id), reading->channel, {}});
    }
    all.back().samples.push_back(reading);
  }
  return all;
}

Sentences strange_times(const Look& look) {
  Sentences found;
  const double step = over_time(look) ? recordings_of(look.experiment).step : 0;
  for (const Recorded& one : recorded(look)) {
    const double steps = (one.last() - one.first()) / step;
    if (one.channel != 0 || one.samples.size() < 2 || (steps > 3 && steps < 2e5)) continue;
    found.push_back(fmt::format(
        "recording '{}': it lasts {}, which is {:.3g} of the integrator's steps ({}): is the unit of time right ({})?",
        one.settings->id, with_unit(one.last() - one.first(), "s"), steps, with_unit(step, "s"),
        steps > 3 ? "ms written as s" : "s written as ms"));
  }
  return found;
}

Sentences release_out_of_sight(const Look& look) {
  Sentences found;
  for (const Recorded& one : recorded(look)) {
    const double length = one.last() - one.first(), release = one.settings->release;
    if (one.channel != 0 || one.samples.size() < 2) continue;
    if (release >= one.last())
      found.push_back(
          fmt::format("recording '{}': it is let go at {}, after its last sample ({}): nothing of the motion is seen",
                      one.settings->id, with_unit(release, "s"), with_unit(one.last(), "s")));
    else if (one.first() - release > 0.5 * length)
      found.push_back(fmt::format(
          "recording '{}': it begins {} after the release at {}, and lasts {}: most of the motion is over; is the "
          "release on the recording's own clock?",
          one.settings->id, with_unit(one.first() - release, "s"), with_unit(release, "s"), with_unit(length, "s")));
  }
  return found;
}

Sentences clipped(const Look& look) {
  Sentences found;
  for (const Recorded& one : recorded(look)) {
    const auto [low, high] = std::ranges::minmax(one.samples, {}, &BenchReading::value);
    for (const double end : {low->value, high->value}) {
      size_t run = 0, longest = 0, at = 0;
      for (size_t i = 0; i < one.samples.size(); ++i) {
        run = one.samples[i]->value == end ? run + 1 : 0;
        if (run > longest) longest = run, at = i + 1 - run;
      }
      if (longest >= 4 && high->value - low->value > 10 * one.samples.front()->sigma)
        found.push_back(
            fmt::format("recording '{}', line {}: '{}' stays at {}, its extreme, for {} samples: the instrument's "
                        "range ended there; "
                        "leave those samples out or mount it anew",
                        one.settings->id, one.samples[at]->line, look.channel(one.channel),
                        with_unit(end, look.unit(one.channel)), longest));
    }
  }
  return found;
}

Sentences still(const Look& look) {
  Sentences found;
  for (const Recorded& one : recorded(look)) {
    const auto [low, high] = std::ranges::minmax(one.samples, {}, &BenchReading::value);
    if (one.samples.size() >= 8 && high->value - low->value < 2 * one.samples.front()->sigma)
      found.push_back(fmt::format(
          "recording '{}': '{}' moves by {} in all, no more than its noise ({}): is the unit right, of either?",
          one.settings->id, look.channel(one.channel), with_unit(high->value - low->value, look.unit(one.channel)),
          with_unit(one.samples.front()->sigma, look.unit(one.channel))));
  }
  return found;
}

Sentences strange_strains(const Look& look) {
  if (!at_a_point(look)) return {};
  const auto most = std::ranges::max_element(
      look.readings, {}, [](const BenchReading* reading) { return std::abs(reading->controls[0]); });
  const double strain = std::abs((*most)->controls[0]);
  if (strain <= 8) return {};
  return {fmt::format(
      "line {}: a strain of {:.4g} is {:.4g} %: were strains in per cent? Their column would be called ..._%",
      (*most)->line, strain, 100 * strain)};
}

/// Of each mode: stress over what the law says with its start.
std::vector<std::pair<int, std::vector<double>>> stress_ratios(const Look& look) {
  std::vector<std::pair<int, std::vector<double>>> all;
  if (!at_a_point(look)) return all;
  const Prediction prediction = look.bench.protocol().predict(look.start, {});
  for (size_t c = 0; c < look.bench.channels().size(); ++c) {
    std::vector<double> ratios;
    for (const BenchReading* reading : look.readings) {
      const double ratio = reading->row < 0 ? 0 : reading->value / prediction.values[reading->row];
      if (reading->channel == static_cast<int>(c) && reading->row >= 0 && std::isfinite(ratio)) ratios.push_back(ratio);
    }
    if (!ratios.empty()) all.emplace_back(static_cast<int>(c), ratios);
  }
  return all;
}

Sentences stress_out_of_scale(const Look& look) {
  Sentences found;
  for (const auto& [mode, ratios] : stress_ratios(look)) {
    const double ratio = median_of(ratios);
    if (ratio <= 0 || (ratio < 50 && ratio > 1.0 / 50)) continue;
    found.push_back(fmt::format(
        "{}: its stresses are {:.3g} times what the law says at the start{}; are their unit and the start right?",
        look.channel(mode), ratio, slip_text(ratio, 0.5)));
  }
  return found;
}

Sentences stress_reversed(const Look& look) {
  Sentences found;
  for (const auto& [mode, ratios] : stress_ratios(look)) {
    if (ratios.size() < 2 || median_of(ratios) >= 0) continue;
    found.push_back(fmt::format(
        "{}: its stresses have the other sign than its strains ({} readings): those of compression are negative here, "
        "strain and stress alike",
        look.channel(mode), ratios.size()));
  }
  return found;
}

}  // namespace

std::vector<Implausible> implausible_curves() {
  return {{"times in another unit", strange_times},       {"a release out of sight", release_out_of_sight},
          {"a recording that is clipped", clipped},       {"a recording that stands still", still},
          {"strains in per cent", strange_strains},       {"stresses out of scale", stress_out_of_scale},
          {"stresses of the other sign", stress_reversed}};
}

}  // namespace taut

#include "reports/simulation_record.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <stdexcept>

#include "sim/core/error.hpp"

namespace taut {

std::vector<const Series*> all_series(const SimulationRecord& record) {
  std::vector<const Series*> all;
  for (const Series& control : record.controls) {
    if (control.id != record.sample_name) all.push_back(&control);
  }
  for (const Series& channel : record.channels) all.push_back(&channel);
  return all;
}

void check(const SimulationRecord& record) {
  const auto need = [](bool right, const std::string& otherwise) {
    if (!right) throw std::logic_error("simulation record: " + otherwise);
  };
  const size_t samples = record.samples.size();
  for (const std::vector<Series>* list : {&record.controls, &record.channels}) {
    for (const Series& series : *list)
      need(series.values.size() == samples,
           fmt::format("series '{}' has {} values for {} samples", series.id, series.values.size(), samples));
  }
  std::vector<std::string> ids = {record.sample_name};
  for (const Series* series : all_series(record)) {
    if (std::ranges::find(ids, series->id) != ids.end()) {
      throw InputError(
          fmt::format("{}: two columns of the results would be called '{}'; give each control and channel its own name",
                      record.name, series->id));
    }
    ids.push_back(series->id);
  }
  need(!record.frames.empty() && record.frames.size() == record.states.size(),
       fmt::format("{} states for {} frames", record.states.size(), record.frames.size()));
  for (size_t i = 0; i < record.frames.size(); ++i) {
    const int frame = record.frames[i], before = i > 0 ? record.frames[i - 1] : -1;
    need(frame > before && static_cast<size_t>(frame) < samples,
         fmt::format("frame {} at sample {} of {}", i, frame, samples));
    need(record.states[i].size() == record.mesh.X.size(),
         fmt::format("state {} has {} unknowns, the mesh {}", i, record.states[i].size(), record.mesh.X.size()));
  }
  for (const SimulationRecord::Plot& plot : record.plots) {
    std::vector<std::string> wanted = plot.y;
    if (!plot.x.empty()) wanted.push_back(plot.x);
    for (const std::string& id : wanted) {
      if (std::ranges::find(ids, id) == ids.end()) {
        throw InputError(fmt::format("{}, plot '{}': there is no control or channel '{}'{}; name one of: {}",
                                     record.name, plot.id, id, did_you_mean(id, ids), join(ids)));
      }
    }
  }
}

const Series* driver_of(const SimulationRecord& record) {
  if (!record.at_rest || record.sample_unit != "s") return nullptr;
  for (const Series& control : record.controls) {
    if (std::ranges::any_of(control.values, [&](double value) { return value != control.values.front(); }))
      return &control;
  }
  return nullptr;
}

std::string file_name_of(const std::string& text) {
  std::string name = text;
  for (char& c : name) {
    if (!std::isalnum(static_cast<unsigned char>(c)) && c != '-' && c != '_' && c != '.') c = '_';
  }
  return name.empty() || name.front() == '.' ? "_" + name : name;
}

SampleLabel::SampleLabel(const SimulationRecord& record) : unit_(shown_unit(record.sample_unit, record.samples)) {
  const auto [low, high] = std::ranges::minmax(record.samples);
  const double range = (high - low) / unit_.factor;
  decimals_ = range > 0 ? std::clamp(2 - static_cast<int>(std::floor(std::log10(range))), 0, 9) : 2;
}

std::string SampleLabel::operator()(double sample) const {
  return fmt::format("{:.{}f}{}{}", sample / unit_.factor + 0.0, decimals_, unit_.label.empty() ? "" : " ",
                     unit_.label);
}

}  // namespace taut

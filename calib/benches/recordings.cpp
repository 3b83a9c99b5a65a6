#include "calib/benches/recordings.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <set>

#include "calib/data/csv_table.hpp"
#include "calib/files/recordings_file.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

size_t column_of(const CsvTable& table, const std::string& name) {
  const auto found = std::find(table.header.cells.begin(), table.header.cells.end(), name);
  if (found != table.header.cells.end()) return static_cast<size_t>(found - table.header.cells.begin());
  throw InputError(fmt::format("{}: there is no column '{}'{}; the file has: {}", table.at(table.header.line), name,
                               did_you_mean(name, table.header.cells), listed(table.header.cells)));
}

double number_in(const CsvTable& table, const CsvTable::Row& row, size_t column) {
  if (const std::optional<double> number = parse_number(row.cells[column])) return *number;
  throw InputError(fmt::format("{}: '{}' is not a finite number; write a number like 12.5 or 1.25e1, or delete the row",
                               table.at(row, column), shown(row.cells[column])));
}

void add_samples(const Experiment& experiment, size_t index, std::vector<Sample>& samples) {
  const RecordingsSettings& bench = *experiment.recordings;
  const RecordingSettings& recording = bench.recordings[index];
  const CsvTable table = read_csv(recording.path);
  check_cell_counts(table);
  const size_t time_column = column_of(table, bench.time_column);
  const double second = parse_header(bench.time_column, {Quantity::time}, table.at(table.header, time_column)).factor;
  std::vector<double> times;
  for (const CsvTable::Row& row : table.rows) {
    times.push_back(second * number_in(table, row, time_column));
    if (times.size() > 1 && !(times.back() > times[times.size() - 2]))
      throw InputError(
          fmt::format("{}: the time {} s is not after that of the line before, {} s; put the rows in order "
                      "of time",
                      table.at(row, time_column), times.back(), times[times.size() - 2]));
  }
  const auto chosen = [&](double time) { return time >= recording.from && time <= recording.until; };
  if (std::none_of(times.begin(), times.end(), chosen))
    throw InputError(fmt::format("{}: recording '{}' has no sample from {} s to {} s; mend 'from' and 'until'",
                                 recording.path, recording.id, recording.from, recording.until));
  for (size_t c = 0; c < experiment.bench.channels.size(); ++c) {
    const BenchFormat::Channel& channel = experiment.bench.channels[c];
    const size_t column = column_of(table, channel.column);
    const double unit = parse_header(channel.column, {channel.quantity}, table.at(table.header, column)).factor;
    std::vector<double> values;
    for (const CsvTable::Row& row : table.rows) values.push_back(unit * number_in(table, row, column));
    double reference = 0;
    if (bench.from_mean_before) {
      const auto before = std::lower_bound(times.begin(), times.end(), 0.0) - times.begin();
      if (before == 0)
        throw InputError(
            fmt::format("{}: recording '{}' has no sample before time 0 whose mean could be the reference; "
                        "give displacements and leave out reference = \"before\"",
                        recording.path, recording.id));
      for (auto i = 0; i < before; ++i) reference += values[static_cast<size_t>(i)] / static_cast<double>(before);
    }
    int left = 0;
    for (size_t i = 0; i < times.size(); ++i) {
      if (!chosen(times[i]) || left++ % recording.every != 0) continue;
      Sample sample;
      sample.recording = static_cast<int>(index);
      sample.channel = static_cast<int>(c);
      sample.line = table.rows[i].line;
      sample.time = times[i];
      sample.value = values[i] - reference;
      sample.sigma = recording.sigma > 0 ? recording.sigma : channel.noise.sigma(sample.value);
      samples.push_back(sample);
    }
  }
}

}  // namespace

std::vector<Sample> read_samples(const Experiment& experiment) {
  std::vector<Sample> samples;
  for (size_t i = 0; i < experiment.recordings->recordings.size(); ++i) add_samples(experiment, i, samples);
  return samples;
}

std::vector<Recording> declare_recordings(const Experiment& experiment, SceneBuilder& builder) {
  std::vector<Recording> recordings;
  const std::map<std::string, double> values = material_values(experiment);
  const ParameterTable& table = builder.parameters();
  const auto copy_of = [&](int index, const std::string& of, double value) {
    ParameterSpec spec = table[index];
    spec.id += "_" + of;
    spec.meaning += ", " + of;
    return table.contains(spec.id) ? table.index(spec.id) : builder.declare(spec, value);
  };
  for (const RecordingSettings& settings : experiment.recordings->recordings) {
    Recording recording;
    recording.id = settings.id;
    for (const auto& [id, value] : settings.loads) recording.set.emplace_back(table.index(id), value);
    for (const auto& [id, value] : settings.held) {
      const int index = table.index(id);
      recording.held.emplace_back(index, copy_of(index, settings.id, value));
    }
    for (const std::string& id : experiment.recordings->per_case) {
      const int index = table.index(id);
      recording.takes.emplace_back(index, copy_of(index, settings.case_id, values.at(id)));
    }
    recording.release = builder.declare(
        {"release_" + settings.id, "t0", "s", -1e6, 1e6, "time of the release of " + settings.id}, settings.release);
    recordings.push_back(std::move(recording));
  }
  return recordings;
}

RecordingReplay make_recording_replay(const Experiment& experiment, const MeshSettings& settings,
                                      const std::vector<Sample>& samples) {
  BenchModel model = make_model(experiment, settings, {});
  RecordingReplay bench;
  std::vector<RecordingRow> rows;
  for (const Sample& sample : samples) {
    const int row = static_cast<int>(rows.size());
    rows.push_back({sample.recording, sample.channel, sample.time});
    bench.measurements.push_back({row, sample.value, sample.sigma, row});
  }
  RecordingProtocol::Options options;
  options.integrator = experiment.dynamics.integrator;
  options.step = experiment.dynamics.step;
  options.equilibrium = experiment.equilibrium;
  options.threads = experiment.threads;
  bench.protocol =
      std::make_unique<RecordingProtocol>(std::move(model.scene), std::move(model.channels), model.switched_off_at_rest,
                                          std::move(model.recordings), rows, options);
  return bench;
}

}  // namespace taut

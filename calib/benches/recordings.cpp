#include "calib/benches/recordings.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <set>

#include "calib/data/csv_table.hpp"
#include "calib/data/number_style.hpp"
#include "sim/core/error.hpp"
#include "sim/files/tables.hpp"
#include "sim/scene/channel_kinds.hpp"

namespace taut {
namespace {

void read_dynamics(TableReader& root, Experiment& experiment, RecordingsSettings& settings) {
  TableReader table = root.table("dynamics");
  settings.integrator = table.choice<Integrator>(
      "integrator", {{"bdf2", Integrator::bdf2}, {"implicit_euler", Integrator::implicit_euler}});
  settings.step = table.positive("step", Quantity::time, "step");
  experiment.mass = read_mass_form(table);
  table.finish();
  for (const MaterialSettings& material : experiment.materials) {
    if (!material.density)
      throw InputError(
          fmt::format("{}: [materials.{}]: recordings over time need a density; add for example density = "
                      "\"1070 kg/m3\"",
                      experiment.path, material.region));
  }
  read_damping(root, experiment);
}

/// Channels whose readings over time would not be what the model shows.
void check_channels(const TableReader& table, const Experiment& experiment, bool from_rest) {
  for (const ChannelSettings& channel : experiment.channels) {
    const ChannelKind& kind = *channel.kind;
    if (kind.known != ChannelKind::Known::always)
      throw InputError(
          fmt::format("{}: [[channel]] '{}': a {} {}, without what inertia adds; recordings take other kinds",
                      experiment.path, channel.id, kind.name, kind.why));
    if (from_rest && !kind.from_rest)
      table.fail("reference",
                 fmt::format("'{}' is a {}, which is not measured from rest; leave this out", channel.id, kind.name));
  }
}

/// A table of values of loads, { tip_load = "52 g" }.
std::map<std::string, double> read_values(TableReader& table, std::string_view key, const Experiment& experiment) {
  std::map<std::string, double> values;
  auto loads = table.optional_table(key);
  if (!loads) return values;
  loads->keys_are_ids();
  for (const LoadSettings& load : experiment.loads) {
    if (loads->has(load.id)) values[load.id] = loads->quantity(load.id, load.quantity);
  }
  loads->finish();
  return values;
}

/// Keys that [bench] gives for all recordings, and each of them for itself.
void read_window(TableReader& table, const BenchFormat& bench, RecordingSettings& settings) {
  if (const auto from = table.optional_quantity("from", Quantity::time)) settings.from = *from;
  if (const auto until = table.optional_quantity("until", Quantity::time)) settings.until = *until;
  settings.every = table.integer("every", settings.every, 1);
  const Quantity quantity = bench.channels.front().quantity;
  if (const auto sigma = table.optional_quantity("sigma", quantity)) {
    for (const BenchFormat::Channel& channel : bench.channels) {
      if (channel.quantity != quantity)
        table.fail("sigma", fmt::format("'{}' and '{}' are different quantities; give each [[channel]] its noise",
                                        bench.channels.front().id, channel.id));
    }
    if (!(*sigma > 0)) table.fail("sigma", "a standard deviation is positive");
    settings.sigma = *sigma;
  }
}

/// Where a motion came to rest: rest = { after = "5 s", sigma = "0.2 mm", tip = "-6.5 mm" }.
void read_rest(TableReader& table, const BenchFormat& bench, RecordingSettings& recording) {
  recording.rest_after = table.positive("after", Quantity::time, "time since the release");
  recording.rest_sigma = table.positive("sigma", bench.channels.front().quantity, "standard deviation");
  table.keys_are_ids();
  for (const BenchFormat::Channel& channel : bench.channels) {
    if (const auto value = table.optional_quantity(channel.id, channel.quantity)) recording.rest[channel.id] = *value;
  }
  if (recording.rest.empty())
    table.fail("", fmt::format("there is no reading; give that of a channel, for example {} = \"-6.5 mm\"",
                               bench.channels.front().id));
  table.finish();
}

RecordingSettings read_recording(TableReader& table, const RecordingSettings& common, const Experiment& experiment) {
  RecordingSettings recording = common;
  recording.path = path_beside(experiment.path, table.text("file"));
  recording.case_id = table.text("case");
  recording.trial = table.text("trial", "");
  recording.id = recording.case_id + (recording.trial.empty() ? "" : "_" + recording.trial);
  recording.loads = read_values(table, "loads", experiment);
  recording.held = read_values(table, "held", experiment);
  if (const auto seconds = table.optional_quantity("held_for", Quantity::time)) {
    if (recording.held.empty() || !experiment.remembers() || *seconds < 0)
      table.fail(
          "held_for",
          "a time of zero or more for which what relaxes ([materials.REGION] prony) was 'held'; leave it out, or "
          "give those");
    recording.held_for = *seconds;
  }
  recording.release = table.optional_quantity("release", Quantity::time).value_or(0);
  read_window(table, experiment.bench, recording);
  if (auto rest = table.optional_table("rest")) read_rest(*rest, experiment.bench, recording);
  if (!(recording.from < recording.until)) table.fail("", "'from' must be earlier than 'until'");
  for (const auto& [id, value] : recording.held) {
    if (recording.loads.count(id) > 0)
      table.fail("held", fmt::format("'{}' is among 'loads' too; a load either stays or goes at the release", id));
  }
  table.finish();
  for (const BenchFormat::Channel& channel : experiment.bench.channels) {
    if (recording.sigma == 0 && !channel.noise.given())
      throw InputError(
          fmt::format("{}: recording '{}' has no noise; add for example sigma = \"0.2 mm\" to it or to "
                      "[bench], or noise to [[channel]] '{}'",
                      experiment.path, recording.id, channel.id));
  }
  return recording;
}

/// What a case may have for itself: constants of materials and damping, by their ids in the model.
std::map<std::string, double> material_values(const Experiment& experiment) {
  std::map<std::string, double> values;
  for (const MaterialSettings& material : experiment.materials) {
    for (const auto& [id, value] : material.constants) values[id + "_" + material.region] = value;
  }
  for (const auto& [region, value] : experiment.mass_damping) values["mass_damping_" + region] = value;
  for (const auto& [region, value] : experiment.stiffness_damping) values["stiffness_damping_" + region] = value;
  return values;
}

size_t column_of(const CsvTable& table, const std::string& name) {
  if (const std::optional<size_t> found = find_column(table, name)) return *found;
  throw InputError(fmt::format("{}: there is no column '{}'{}; the file has: {}", table.at(table.header.line), name,
                               did_you_mean(name, table.header.cells), listed(table.header.cells)));
}

/// The file of a recording, with its columns of time and channels.
struct RecordingFile {
  CsvTable table;
  size_t time = 0;
  std::vector<size_t> channels;
  NumberStyle style;

  RecordingFile(const Experiment& experiment, const RecordingSettings& recording) {
    std::vector<std::string> wanted{recordings_of(experiment).time_column};
    for (const BenchFormat::Channel& channel : experiment.bench.channels) wanted.push_back(channel.column);
    table = read_csv(recording.path, wanted);
    check_names(table);
    check_cell_counts(table);
    std::vector<size_t> columns;
    for (const std::string& name : wanted) columns.push_back(column_of(table, name));
    style = number_style(table, columns);
    time = columns.front();
    channels.assign(columns.begin() + 1, columns.end());
  }

  double number(const CsvTable::Row& row, size_t column) const {
    if (const std::optional<double> number = style.number(row.cells[column])) return *number;
    throw InputError(
        fmt::format("{}: '{}' is not a finite number; write a number like 12.5 or 1.25e1, or delete the row",
                    table.at(row, column), shown(row.cells[column])));
  }

  /// What cells are multiplied by.
  double unit(size_t column, Quantity quantity) const {
    return parse_header(table.title(column), {quantity}, table.at(table.header, column)).factor;
  }
};

void add_samples(const Experiment& experiment, size_t index, std::vector<Sample>& samples) {
  const RecordingsSettings& bench = recordings_of(experiment);
  const RecordingSettings& recording = bench.recordings[index];
  const RecordingFile file(experiment, recording);
  const CsvTable& table = file.table;
  const double second = file.unit(file.time, Quantity::time);
  std::vector<double> times;
  for (const CsvTable::Row& row : table.rows) {
    times.push_back(second * file.number(row, file.time));
    if (times.size() > 1 && !(times.back() > times[times.size() - 2]))
      throw InputError(
          fmt::format("{}: the time {} s is not after that of the line before, {} s; put the rows in order "
                      "of time",
                      table.at(row, file.time), times.back(), times[times.size() - 2]));
  }
  const auto chosen = [&](double time) { return time >= recording.from && time <= recording.until; };
  if (std::none_of(times.begin(), times.end(), chosen))
    throw InputError(fmt::format("{}: recording '{}' has no sample from {} s to {} s; mend 'from' and 'until'",
                                 recording.path, recording.id, recording.from, recording.until));
  for (size_t c = 0; c < experiment.bench.channels.size(); ++c) {
    const BenchFormat::Channel& channel = experiment.bench.channels[c];
    const double unit = file.unit(file.channels[c], channel.quantity);
    std::vector<std::optional<double>> values;  // none: not taken
    for (const CsvTable::Row& row : table.rows) {
      const bool taken = !not_taken(row.cells[file.channels[c]]);
      values.push_back(taken ? std::optional(unit * file.number(row, file.channels[c])) : std::nullopt);
    }
    double reference = 0;
    if (bench.from_mean_before) {
      const auto zero = std::lower_bound(times.begin(), times.end(), 0.0) - times.begin();
      const auto before =
          std::count_if(values.begin(), values.begin() + zero, [](const auto& v) { return v.has_value(); });
      if (before == 0)
        throw InputError(
            fmt::format("{}: recording '{}' has no sample before time 0 whose mean could be the reference; "
                        "give displacements and leave out reference = \"before\"",
                        recording.path, recording.id));
      for (auto i = 0; i < zero; ++i)
        reference += values[static_cast<size_t>(i)].value_or(0) / static_cast<double>(before);
    }
    int left = 0;
    for (size_t i = 0; i < times.size(); ++i) {
      if (!chosen(times[i]) || left++ % recording.every != 0 || !values[i]) continue;
      Sample sample;
      sample.recording = static_cast<int>(index);
      sample.channel = static_cast<int>(c);
      sample.line = table.rows[i].line;
      sample.time = times[i];
      sample.value = *values[i] - reference;
      sample.sigma = recording.sigma > 0 ? recording.sigma : channel.noise.sigma(sample.value);
      samples.push_back(sample);
    }
    if (const auto rest = recording.rest.find(channel.id); rest != recording.rest.end())
      samples.push_back({static_cast<int>(index), static_cast<int>(c), 0, recording.release + recording.rest_after,
                         rest->second, recording.rest_sigma, true});
  }
}

}  // namespace

void read_recordings(TableReader& root, Experiment& experiment) {
  if (experiment.model != Rung::full)
    root.fail("model", "recordings over time are replayed by the full model; leave 'model' out");
  TableReader table = root.table("bench");
  table.text("kind");
  RecordingsSettings bench;
  bench.time_column = table.text("time");
  if (unit_in_header(bench.time_column)) parse_header(bench.time_column, {Quantity::time}, table.where("time"));
  bench.from_mean_before = table.choice<bool>("reference", {{"none", false}, {"before", true}});
  check_channels(table, experiment, bench.from_mean_before);
  read_dynamics(root, experiment, bench);
  const std::map<std::string, double> values = material_values(experiment);
  std::vector<std::string> allowed;
  for (const auto& [id, value] : values) allowed.push_back(id);
  bench.per_case = table.texts_or_none("per_case");
  for (const std::string& id : bench.per_case) check_id(table, "per_case", id, allowed, "a constant of a material");
  RecordingSettings common;
  read_window(table, experiment.bench, common);
  for (const BenchFormat::Channel& channel : experiment.bench.channels) {
    if (channel.column.empty())
      throw InputError(
          fmt::format("{}: channel '{}': its column in the recordings is missing; add column = \"NAME_mm\"",
                      experiment.path, channel.id));
  }
  if (!experiment.bench.controls.empty())
    throw InputError(
        fmt::format("{}: '{}' takes its values from a column, which recordings do not have; give a load "
                    "'value' and each [[bench.recording]] its own, loads = {{ {} = ... }}",
                    experiment.path, experiment.bench.controls.front().id, experiment.bench.controls.front().id));
  for (const LoadSettings& load : experiment.loads) {
    if (load.quantity == Quantity::mass && load.on.empty())
      throw InputError(
          fmt::format("{}: load '{}': a mass that moves hangs on a tag; use 'on'", experiment.path, load.id));
  }
  std::set<std::string> ids;
  for (TableReader& one : table.tables("recording")) {
    bench.recordings.push_back(read_recording(one, common, experiment));
    if (!ids.insert(bench.recordings.back().id).second)
      throw InputError(fmt::format("{}: the recording '{}' is there twice; tell repeats of a case apart by 'trial'",
                                   experiment.path, bench.recordings.back().id));
  }
  if (bench.recordings.empty()) table.fail("", "there is no recording; add [[bench.recording]] with file and case");
  table.finish();
  experiment.own = std::move(bench);
}

std::string recording_layout(const Experiment& experiment, size_t index) {
  const RecordingFile file(experiment, recordings_of(experiment).recordings[index]);
  const auto missing = [&](const CsvTable::Row& row) {
    return std::ranges::count_if(file.channels, [&](size_t column) { return not_taken(row.cells[column]); });
  };
  std::ptrdiff_t count = 0;
  for (const CsvTable::Row& row : file.table.rows) count += missing(row);
  const std::string layout = file.table.layout(file.style.describe());
  if (count == 0) return layout;
  return fmt::format("{}{}{} readings not taken", layout, layout.empty() ? "" : ", ", count);
}

std::vector<Sample> read_samples(const Experiment& experiment) {
  std::vector<Sample> samples;
  for (size_t i = 0; i < recordings_of(experiment).recordings.size(); ++i) add_samples(experiment, i, samples);
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
  const RecordingsSettings& bench = recordings_of(experiment);
  for (const RecordingSettings& settings : bench.recordings) {
    Recording& recording = recordings.emplace_back();
    recording.id = settings.id;
    recording.held_for = settings.held_for;
    for (const auto& [id, value] : settings.loads) recording.set.emplace_back(table.index(id), value);
    for (const auto& [id, value] : settings.held) {
      const int index = table.index(id);
      recording.held.emplace_back(index, copy_of(index, settings.id, value));
    }
    for (const std::string& id : bench.per_case) {
      const int index = table.index(id);
      recording.takes.emplace_back(index, copy_of(index, settings.case_id, values.at(id)));
    }
    recording.release = builder.declare(
        {"release_" + settings.id, "t0", "s", -1e6, 1e6, "time of the release of " + settings.id}, settings.release);
  }
  return recordings;
}

RecordingReplay make_recording_replay(const Experiment& experiment, const MeshSettings& settings,
                                      const std::vector<Sample>& samples) {
  std::vector<Recording> recordings;
  BenchModel model = make_model(experiment, settings, {}, [&](SceneBuilder& builder) {
    recordings = at(experiment, "[bench]", [&] { return declare_recordings(experiment, builder); });
  });
  RecordingReplay bench;
  std::vector<RecordingRow> rows;
  for (const Sample& sample : samples) {
    const int row = static_cast<int>(rows.size());
    rows.push_back({sample.recording, sample.channel, sample.time, sample.still});
    bench.measurements.push_back({row, sample.value, sample.sigma, row});
  }
  RecordingProtocol::Options options;
  options.integrator = recordings_of(experiment).integrator;
  options.step = recordings_of(experiment).step;
  options.equilibrium = experiment.equilibrium;
  options.threads = experiment.threads;
  bench.protocol = std::make_unique<RecordingProtocol>(std::move(model.scene), std::move(model.channels),
                                                       model.off_at_rest, std::move(recordings), rows, options);
  return bench;
}

}  // namespace taut

#include "calib/files/recordings_file.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <set>

#include "sim/core/error.hpp"

namespace taut {
namespace {

void read_dynamics(TableReader& root, Experiment& experiment) {
  DynamicsSettings& dynamics = experiment.dynamics;
  TableReader table = root.table("dynamics");
  dynamics.integrator =
      table.choice("integrator", {"bdf2", "implicit_euler"}) == "bdf2" ? Integrator::bdf2 : Integrator::implicit_euler;
  dynamics.step = table.quantity("step", Quantity::time);
  if (!(dynamics.step > 0)) table.fail("step", "the step must be positive");
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
void check_channels(const TableReader& table, const Experiment& experiment) {
  using Kind = ChannelSettings::Kind;
  for (const ChannelSettings& channel : experiment.channels) {
    if (channel.kind == Kind::reaction)
      throw InputError(
          fmt::format("{}: [[channel]] '{}': a reaction is that of an equilibrium, without what inertia "
                      "adds; recordings take other kinds",
                      experiment.path, channel.id));
    const bool from_rest = channel.kind == Kind::displacement || channel.kind == Kind::rotation;
    if (experiment.recordings->from_mean_before && !from_rest)
      table.fail("reference", fmt::format("'{}' is a {}, which is not measured from rest; leave this out", channel.id,
                                          name_of(channel.kind)));
  }
}

/// A table of values of loads, { tip_load = "52 g" }.
std::map<std::string, double> read_values(TableReader& table, std::string_view key, const Experiment& experiment) {
  std::map<std::string, double> values;
  auto loads = table.optional_table(key);
  if (!loads) return values;
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

RecordingSettings read_recording(TableReader& table, const RecordingSettings& common, const Experiment& experiment) {
  RecordingSettings recording = common;
  recording.path = path_beside(experiment.path, table.text("file"));
  recording.case_id = table.text("case");
  recording.trial = table.text("trial", "");
  recording.id = recording.case_id + (recording.trial.empty() ? "" : "_" + recording.trial);
  recording.loads = read_values(table, "loads", experiment);
  recording.held = read_values(table, "held", experiment);
  recording.release = table.optional_quantity("release", Quantity::time).value_or(0);
  read_window(table, experiment.bench, recording);
  if (!(recording.from < recording.until)) table.fail("", "'from' must be earlier than 'until'");
  for (const auto& [id, value] : recording.held) {
    if (recording.loads.count(id) > 0)
      table.fail("held", fmt::format("'{}' is among 'loads' too; a load either stays or goes at the release", id));
  }
  table.finish();
  for (size_t i = 0; i < experiment.bench.channels.size(); ++i) {
    const InstrumentNoise& noise = experiment.bench.channels[i].noise;
    if (recording.sigma == 0 && noise.absolute == 0 && noise.relative == 0 && noise.resolution == 0)
      throw InputError(
          fmt::format("{}: recording '{}' has no noise; add for example sigma = \"0.2 mm\" to it or to "
                      "[bench], or noise to [[channel]] '{}'",
                      experiment.path, recording.id, experiment.bench.channels[i].id));
  }
  return recording;
}

}  // namespace

std::map<std::string, double> material_values(const Experiment& experiment) {
  std::map<std::string, double> values;
  for (const MaterialSettings& material : experiment.materials) {
    for (const auto& [id, value] : material.constants) values[id + "_" + material.region] = value;
  }
  for (const auto& [region, value] : experiment.mass_damping) values["mass_damping_" + region] = value;
  for (const auto& [region, value] : experiment.stiffness_damping) values["stiffness_damping_" + region] = value;
  return values;
}

void read_recordings(TableReader table, TableReader& root, Experiment& experiment) {
  RecordingsSettings& bench = experiment.recordings.emplace();
  bench.time_column = table.text("time");
  parse_header(bench.time_column, {Quantity::time}, table.where("time"));
  bench.from_mean_before = table.choice("reference", {"none", "before"}) == "before";
  check_channels(table, experiment);
  read_dynamics(root, experiment);
  const std::map<std::string, double> values = material_values(experiment);
  std::vector<std::string> allowed;
  for (const auto& [id, value] : values) allowed.push_back(id);
  bench.per_case = table.texts_or_none("per_case");
  for (const std::string& id : bench.per_case) {
    if (values.count(id) == 0)
      table.fail("per_case", fmt::format("'{}' is no constant of a material{}; allowed: {}", id,
                                         did_you_mean(id, allowed), join(allowed)));
  }
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
}

}  // namespace taut

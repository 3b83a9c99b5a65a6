#include <fmt/format.h>

#include <algorithm>

#include "calib/benches/assumptions.hpp"
#include "calib/benches/control_name.hpp"
#include "calib/benches/static_bench.hpp"
#include "sim/core/error.hpp"
#include "sim/files/tables.hpp"
#include "sim/scene/channel_kinds.hpp"

namespace taut {

namespace {

/// Numbers of a specimen that may be unlike in others: dimensions, and the thickness of a section.
std::vector<ParameterSpec> of_specimens(const Experiment& experiment) {
  std::vector<ParameterSpec> specs;
  for (const Dimension& dimension : all_dimensions(experiment)) specs.push_back(dimension.spec);
  if (experiment.geometry.dimension == 2 && std::ranges::find(specs, "thickness", &ParameterSpec::id) == specs.end())
    specs.push_back({"thickness", "t", "m", 0, 1e3, "thickness"});
  return specs;
}

/// Columns that set a dimension, and the tables of specimens that a column names.
void read_specimens(TableReader& root, TableReader& table, Experiment& experiment) {
  BenchFormat& bench = experiment.bench;
  const std::vector<ParameterSpec> specs = of_specimens(experiment);
  if (auto set = table.optional_table("set")) {
    set->keys_are_ids();
    for (const ParameterSpec& spec : specs) {
      const std::string column = set->text(spec.id, "");
      if (column.empty()) continue;
      const Quantity quantity = quantity_of_si_unit(spec.unit);
      const std::string id = column_unit(experiment, column, {quantity}, set->where(spec.id)).name;
      experiment.set_by[id] = spec.id;
      bench.controls.push_back({id, column, {quantity}});
    }
    set->finish();
  }
  const std::string column = table.text("specimen", "");
  std::vector<std::string> labels;
  for (TableReader& one : root.tables("specimen")) {
    SpecimenSettings& specimen = experiment.specimens.emplace_back();
    labels.push_back(specimen.id = one.text("id"));
    if (auto set = one.optional_table("set")) {
      set->keys_are_ids();
      for (const ParameterSpec& spec : specs) {
        if (const auto value = set->optional_quantity(spec.id, quantity_of_si_unit(spec.unit)))
          specimen.set[spec.id] = *value;
      }
      set->finish();
    }
    one.finish();
  }
  refuse_repeated(experiment.path, {labels}, "specimens");
  if (column.empty() != labels.empty())
    table.fail(
        column.empty() ? "" : "specimen",
        "'specimen' (the column that names each row's) and the tables [[specimen]] with an id each belong together");
  if (column.empty()) return;
  if (!experiment.set_by.empty())
    table.fail("specimen",
               "either one column names the specimens or columns set their dimensions; take one of them out");
  experiment.specimen_control = "specimen";
  bench.controls.push_back({"specimen", column, {Quantity::pure}, false, labels, "a [[specimen]] of the experiment"});
  for (const std::string& id : ids_set_by_columns(experiment)) {
    for (const SpecimenSettings& specimen : experiment.specimens) {
      if (!specimen.set.contains(id))
        throw InputError(fmt::format("{}: [[specimen]] '{}' does not set {}, which others do; give it in each",
                                     experiment.path, specimen.id, id));
    }
  }
}

}  // namespace

/// The column of a time, or what it is in all rows.
void read_time(TableReader& table, std::string_view key, std::string& column, std::optional<double>& constant) {
  const std::string given = table.text(key, "");
  if (!is_quantity(given)) {
    column = given;
    return;
  }
  constant = parse_quantity(given, Quantity::time, table.where(key));
  if (*constant < 0) table.fail(key, "a time is zero or more");
}

/// When readings were taken.
void read_history(TableReader& table, Experiment& experiment) {
  BenchFormat::History& history = experiment.bench.history;
  history.time_column = table.text("time", "");
  read_time(table, "dwell", history.dwell_column, history.dwell);
  read_time(table, "rest", history.rest_column, history.rest);
  history.counts = experiment.remembers();
  if (!history.counts) return;
  if (history.time_column.empty() && history.dwell_column.empty() && !history.dwell)
    table.fail("",
               "stresses relax (prony), so that readings depend on when they were taken; add 'dwell' (a column or "
               "\"10 s\": for how long its load had acted) and 'rest' (without load before that), or 'time', or take "
               "'prony' out");
  if (experiment.model != Rung::full && experiment.model != Rung::rigid_segments && experiment.model != Rung::solid)
    table.fail("", fmt::format("stresses relax (prony), which the model \"{}\" does not know; set model = \"full\"",
                               name_of(experiment.model)));
}

void read_readings(TableReader& root, Experiment& experiment) {
  TableReader table = root.table("bench");
  table.text("kind", "");
  BenchFormat& bench = experiment.bench;
  bench.path = path_beside(experiment.path, table.text("file"));
  bench.trial_column = table.text("trial", "");
  bench.channel_column = table.text("channel", "");
  bench.value_column = table.text("value", "");
  bench.sigma_column = table.text("sigma", "");
  bench.ignored = table.columns_or_none("ignore");
  bench.excluded = table.integers_or_none("exclude", 1);
  if (bench.channel_column.empty() && !bench.value_column.empty())
    table.fail("value",
               "it belongs to files with a reading a row; name the column 'channel' that holds the channel's "
               "id too, or give each channel its own column");
  read_specimens(root, table, experiment);
  bench.order_column = table.text("order", "");
  if (const std::string column = table.text("direction", ""); !column.empty()) {
    if (experiment.model == Rung::rod && experiment.cables.friction > 0)
      table.fail("direction",
                 "a rod's tendons have the friction of loading only; leave it out, and let 'file' hold rows that load");
    bench.controls.push_back(
        {std::string(direction_control), column, {Quantity::pure}, false, {"loading", "unloading"}, "a direction"});
  }
  read_history(table, experiment);
  experiment.zero_offset_per = table.text("zero_offset_per", "");
  if (!experiment.zero_offset_per.empty()) {
    experiment.zero_offset_per = control_named(table, "zero_offset_per", experiment);
    for (const BenchFormat::Channel& channel : bench.channels) {
      if (channel.quantity != Quantity::length)
        table.fail("zero_offset_per",
                   fmt::format("a zero error is a length that all channels share, and '{}' is none", channel.id));
    }
  }
  experiment.from_unloaded = table.choice<bool>("measured_from", {{"rest", false}, {"unloaded", true}});
  for (const ChannelSettings& channel : experiment.channels) {
    const ChannelKind& kind = *channel.kind;
    if (experiment.from_unloaded && kind.on == ChannelKind::On::place && !kind.from_rest)
      table.fail("measured_from", fmt::format("'{}' is a {}, which is measured from nowhere; make its kind "
                                              "\"displacement\", or leave this out",
                                              channel.id, kind.name));
  }
  if (auto tolerances = table.optional_table("tolerance")) {
    tolerances->keys_are_ids();
    for (const BenchFormat::Control& control : bench.controls) {
      if (experiment.set_by.contains(control.id) || !control.labels.empty()) continue;
      if (auto given = tolerances->optional_given(control.id))
        experiment.control_tolerances.emplace(control.id, *std::move(given));
    }
    tolerances->finish();
  }
  table.finish();
  for (const BenchFormat::Channel& channel : bench.channels) {
    if (channel.column.empty() && bench.value_column.empty())
      throw InputError(
          fmt::format("{}: channel '{}': its bench column is missing; add column = \"NAME_mm\", or name the [bench] "
                      "columns 'channel' "
                      "and 'value'",
                      experiment.path, channel.id));
    if (bench.sigma_column.empty() && !channel.noise.given()) {
      throw InputError(
          fmt::format("{}: channel '{}' has no noise; add for example noise = {{ absolute = \"0.1 mm\" }} to its "
                      "[[channel]], or name a 'sigma' column in [bench]",
                      experiment.path, channel.id));
    }
  }
}

}  // namespace taut

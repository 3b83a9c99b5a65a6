#include <fmt/format.h>

#include "calib/benches/static_bench.hpp"
#include "sim/core/error.hpp"
#include "sim/files/tables.hpp"
#include "sim/scene/channel_kinds.hpp"

namespace taut {

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
  experiment.zero_offset_per = table.text("zero_offset_per", "");
  if (!experiment.zero_offset_per.empty()) {
    known_id(table, "zero_offset_per", ids_of(bench.controls), "set by the bench");
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
    for (const BenchFormat::Control& control : bench.controls) {
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

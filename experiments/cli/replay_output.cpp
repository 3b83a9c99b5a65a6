#include "experiments/cli/replay_output.hpp"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <optional>

#include "experiments/cli/print.hpp"
#include "reports/axes.hpp"
#include "sim/core/units.hpp"

namespace taut {

using Json = nlohmann::ordered_json;

namespace {

Json sensitivities_json(const Replay& replay, const Bench& bench) {
  const ParameterTable& table = bench.protocol().parameters();
  Json json{{"with_respect_to", Json::array()}, {"rows", Json::array()}, {"tangent_stiffness", Json::array()}};
  for (int index : replay.with_respect_to)
    json["with_respect_to"].push_back({{"id", table[index].id},
                                       {"unit", table[index].unit},
                                       {"kind", bench.sets(table[index].id) ? "control" : "parameter"}});
  for (size_t i = 0; i < replay.record.readings.size(); ++i) {
    const ReadingRecord& reading = replay.record.readings[i];
    json["rows"].push_back({{"line", reading.line},
                            {"channel", reading.channel},
                            {"unit", channel_axis(replay.record, reading.channel).unit},
                            {"derivatives", replay.derivatives[i]}});
  }
  for (const TangentStiffness& one : replay.stiffness)
    json["tangent_stiffness"].push_back({{"state", one.where}, {"load", one.load}, {"N_per_m", one.value}});
  return json;
}

}  // namespace

std::string sensitivities_csv(const Replay& replay, const Bench& bench) {
  const ParameterTable& table = bench.protocol().parameters();
  std::string text = "line,trial,channel,unit";
  for (int index : replay.with_respect_to) text += fmt::format(",d_{}[{}]", table[index].id, table[index].unit);
  text += "\n";
  for (size_t i = 0; i < replay.record.readings.size(); ++i) {
    const ReadingRecord& reading = replay.record.readings[i];
    text += fmt::format("{},{},{},{}", reading.line, reading.trial, reading.channel,
                        channel_axis(replay.record, reading.channel).unit);
    for (double value : replay.derivatives[i]) text += fmt::format(",{:.10g}", value);
    text += "\n";
  }
  return text;
}

void print_sensitivities(const Replay& replay, const Bench& bench) {
  const ParameterTable& table = bench.protocol().parameters();
  fmt::print("derivatives in SI units, everything else held:\n{:>5}  {:<14}", "line", "channel");
  for (int index : replay.with_respect_to) fmt::print(" {:>16}", "d/d " + table[index].id);
  fmt::print("\n");
  for (size_t i = 0; i < replay.record.readings.size(); ++i) {
    fmt::print("{:>5}  {:<14}", replay.record.readings[i].line, replay.record.readings[i].channel);
    for (double value : replay.derivatives[i]) fmt::print(" {:>16.6g}", value);
    fmt::print("\n");
  }
  for (const TangentStiffness& one : replay.stiffness)
    fmt::print("tangent stiffness along {} at {}: {}\n", one.load, one.where, with_unit(one.value, "N/m"));
}

Json replay_json(const Replay& replay, const Bench& bench) {
  const RunRecord& record = replay.record;
  Json json{{"title", record.title},
            {"data", record.simulated ? "simulated" : "measured"},
            {"seconds", record.replay_seconds},
            {"factorisations", bench.protocol().factorisations()}};
  if (!bench.choice().empty()) json["model"] = bench.choice();
  for (size_t i = 0; i < record.readings.size(); ++i) {
    const ReadingRecord& r = record.readings[i];
    Json row{{"line", r.line},
             {"channel", r.channel},
             {"trial", r.trial},
             {"controls", r.controls},
             {key("measured", record, r.channel), r.measured},
             {key("predicted", record, r.channel), r.predicted}};
    if (r.excluded) row["excluded"] = true;
    const int predicted_by = bench.readings()[i].row;
    if (const auto model = predicted_by < 0 ? std::nullopt : bench.model_of(predicted_by)) {
      row["model"] = model->name;
      row["model_error"] = std::isfinite(model->error) ? Json(model->error) : Json();
    }
    json["rows"].push_back(std::move(row));
  }
  for (const CableState& state : bench.cable_states())
    json["cables"].push_back(
        {{"state", state.where}, {"cable", state.cable}, {"tension_N", state.tension}, {"length_m", state.length}});
  for (const SwingRecord& s : record.swings)
    json["swings"].push_back({{"recording", s.recording},
                              {"channel", s.channel},
                              {"frequency_Hz", s.frequency},
                              {"predicted_frequency_Hz", s.predicted_frequency},
                              {"decay_per_s", s.decay},
                              {"predicted_decay_per_s", s.predicted_decay}});
  if (!replay.with_respect_to.empty()) json["sensitivities"] = sensitivities_json(replay, bench);
  json["warnings"] = record.remarks;
  for (const std::string& warning : bench.warnings_after()) json["warnings"].push_back(warning);
  json["failures"] = replay.prediction.failures;
  return json;
}

}  // namespace taut

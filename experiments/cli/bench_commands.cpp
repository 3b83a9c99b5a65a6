#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>

#include "calib/benches/model.hpp"
#include "calib/data/files.hpp"
#include "calib/data/run_folder.hpp"
#include "calib/runs/open_bench.hpp"
#include "calib/runs/run_fit.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "experiments/cli/run_inputs.hpp"
#include "experiments/cli/simulate_command.hpp"
#include "reports/axes.hpp"
#include "reports/draw.hpp"
#include "reports/report.hpp"
#include "reports/vtu.hpp"
#include "sim/core/error.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/core/units.hpp"
#include "sim/files/simulation.hpp"

namespace taut {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

/// A finite number or null.
Json number(double value) {
  return std::isfinite(value) ? Json(value) : Json(nullptr);
}

Json json_of(const std::vector<double>& values) {
  Json list = Json::array();
  for (double value : values) list.push_back(number(value));
  return list;
}

/// "measured_m": a key of JSON with the SI unit of a channel.
std::string key(const std::string& name, const RunRecord& record, const std::string& channel) {
  return name + "_" + column_suffix(channel_axis(record, channel).unit);
}

Json check_json(const RunRecord& record, const ParameterTable& table, const std::vector<FreeParameter>& free) {
  Json json{{"title", record.title}, {"data", record.simulated ? "simulated" : "measured"}};
  for (const auto& [label, text] : record.setup) json["setup"].push_back({label, text});
  json["free"] = Json::array();
  for (const FreeParameter& p : free)
    json["free"].push_back(
        {{"id", table[p.index].id}, {"start", p.start}, {"bounds", {p.lower, p.upper}}, {"unit", table[p.index].unit}});
  json["warnings"] = record.remarks;
  return json;
}

/// The file's parameters with what --set says.
Params parameters_of(const CommandOptions& options, const Bench& bench) {
  const ParameterTable& table = bench.protocol().parameters();
  Params p = bench.protocol().nominal();
  for (const auto& [id, text] : options.set) {
    if (bench.sets(id)) {
      throw InputError(fmt::format(
          "--set {0}: '{0}' is set by the bench, row by row; change its column in a copy of the bench file", id));
    }
    const int index = table.index(id);
    p[index] = parse_quantity(text, quantity_of_si_unit(table[index].unit), "--set " + id);
    table.check(index, p[index]);
  }
  return p;
}

/// A replay's files go to the run folder; where a fit stands there, beside it.
std::string replay_folder(const CommandOptions& options) {
  const fs::path folder = run_folder(options);
  return (fs::exists(folder / "fit.json") ? folder / "replay" : folder).string();
}

/// What a replay found, with derivatives where they were asked for.
struct Replay {
  RunRecord record;
  Prediction prediction;
  std::vector<int> with_respect_to;
  std::vector<TangentStiffness> stiffness;
};

/// The row of a reading among the derivatives, and its value there, one per parameter.
std::vector<double> derivatives_of(const Replay& replay, const Bench& bench, size_t reading) {
  const Eigen::VectorXd row = replay.prediction.derivatives.row(bench.readings()[reading].row);
  return {row.begin(), row.end()};
}

std::string sensitivities_csv(const Replay& replay, const Bench& bench) {
  const ParameterTable& table = bench.protocol().parameters();
  std::string text = "line,trial,channel,unit";
  for (int index : replay.with_respect_to) text += fmt::format(",d_{}[{}]", table[index].id, table[index].unit);
  text += "\n";
  for (size_t i = 0; i < replay.record.readings.size(); ++i) {
    const ReadingRecord& reading = replay.record.readings[i];
    text += fmt::format("{},{},{},{}", reading.line, reading.trial, reading.channel,
                        channel_axis(replay.record, reading.channel).unit);
    for (double value : derivatives_of(replay, bench, i)) text += fmt::format(",{:.10g}", value);
    text += "\n";
  }
  return text;
}

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
                            {"derivatives", json_of(derivatives_of(replay, bench, i))}});
  }
  for (const TangentStiffness& one : replay.stiffness)
    json["tangent_stiffness"].push_back({{"state", one.where}, {"load", one.load}, {"N_per_m", number(one.value)}});
  return json;
}

void print_sensitivities(const Replay& replay, const Bench& bench) {
  const ParameterTable& table = bench.protocol().parameters();
  fmt::print("derivatives in SI units, everything else held:\n{:>5}  {:<14}", "line", "channel");
  for (int index : replay.with_respect_to) fmt::print(" {:>16}", "d/d " + table[index].id);
  fmt::print("\n");
  for (size_t i = 0; i < replay.record.readings.size(); ++i) {
    fmt::print("{:>5}  {:<14}", replay.record.readings[i].line, replay.record.readings[i].channel);
    for (double value : derivatives_of(replay, bench, i)) fmt::print(" {:>16.6g}", value);
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
  for (const ReadingRecord& r : record.readings) {
    json["rows"].push_back({{"line", r.line},
                            {"channel", r.channel},
                            {"trial", r.trial},
                            {"controls", r.controls},
                            {key("measured", record, r.channel), r.measured},
                            {key("predicted", record, r.channel), number(r.predicted)}});
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
  json["failures"] = replay.prediction.failures;
  return json;
}

void print_replay(const Replay& replay, const Bench& bench) {
  if (replay.record.simulated) fmt::print("SIMULATED DATA in the column 'measured'.\n");
  if (replay.record.swings.empty())
    print_readings(replay.record);
  else
    print_swings(replay.record);
  print_cables(bench.cable_states());
  if (!replay.with_respect_to.empty()) print_sensitivities(replay, bench);
}

Replay replay_bench(const CommandOptions& options, const Bench& bench, const Params& p) {
  Replay replay;
  replay.record = start_record(bench);
  Protocol& protocol = bench.protocol();
  if (options.sensitivities) {
    for (int i = 0; i < protocol.parameters().size(); ++i) replay.with_respect_to.push_back(i);
  }
  protocol.forget();  // what the choice of the model left
  const Stopwatch watch;
  replay.prediction = protocol.predict(p, replay.with_respect_to);
  replay.record.replay_seconds = watch.seconds();
  if (options.sensitivities && bench.one_model()) replay.stiffness = bench.tangent_stiffness();
  fill_predictions(bench, replay.prediction.values, {}, replay.record);
  replay.record.swings = bench.swings(replay.prediction.values);
  return replay;
}

}  // namespace

int check_command(const CommandOptions& options) {
  if (is_simulation(options.target)) return check_simulation(options);
  const std::unique_ptr<Bench> bench = open_bench(options.target, {options.threads, options.stop});
  RunRecord record = start_record(*bench);
  record.setup.emplace_back("size", bench->size_text());
  const ParameterTable& table = bench->protocol().parameters();
  if (options.json)
    fmt::print("{}\n", check_json(record, table, bench->free()).dump(2));
  else
    print_check(record, table, bench->free());
  return exit_ok;
}

int draw_command(const CommandOptions& options) {
  const Experiment experiment = read_experiment(options.target);
  if (!experiment.kind->specimen)
    throw InputError(fmt::format("{}: {} has no specimen to draw; use `taut check` and `taut fit` on it",
                                 options.target, experiment.kind->about));
  const std::string folder = run_folder(options);
  draw_experiment(experiment, make_mesh(experiment, experiment.mesh), folder);
  Json files = Json::array();
  for (const char* format : {"svg", "pdf", "png", "csv"})
    files.push_back((fs::path(folder) / "figures" / (std::string("drawing.") + format)).string());
  if (options.json)
    fmt::print("{}\n", Json{{"title", experiment.title}, {"files", files}}.dump(2));
  else
    for (const Json& file : files) fmt::print("{}\n", file.get<std::string>());
  return exit_ok;
}

int replay_command(const CommandOptions& options) {
  const std::unique_ptr<Bench> bench = open_bench(options.target, {options.threads, options.stop});
  Progress progress(options.quiet);
  const Params p = parameters_of(options, *bench);
  progress.say("replaying " + bench->size_text());
  const Replay replay = replay_bench(options, *bench, p);
  const RunRecord& record = replay.record;
  if (!bench->choice().empty()) progress.say(bench->choice());
  const std::string comparison = bench->compare_models(p, replay.prediction.values, record.replay_seconds);
  if (!comparison.empty()) progress.say(comparison);
  const std::string folder = replay_folder(options);
  write_file((fs::path(folder) / "predictions.csv").string(), predictions_csv(record));
  const fs::path derivatives = fs::path(folder) / "sensitivities.csv";
  fs::remove(derivatives);  // of an earlier replay, with other parameters perhaps
  if (options.sensitivities) write_file(derivatives.string(), sensitivities_csv(replay, *bench));
  const std::string pictures = write_states(bench->states(), folder);
  if (options.json)
    fmt::print("{}\n", replay_json(replay, *bench).dump(2));
  else
    print_replay(replay, *bench);
  for (const std::string& warning : record.remarks) progress.say("warning: " + warning);
  for (const std::string& warning : bench->warnings_after()) progress.say("warning: " + warning);
  for (const std::string& failure : replay.prediction.failures) fmt::print(stderr, "taut: {}\n", failure);
  progress.say(fmt::format("{:.2f} s, {}; {}/predictions.csv{}", record.replay_seconds, bench->effort(), folder,
                           pictures.empty() ? "" : ", " + pictures));
  if (interrupted(options)) return exit_interrupted;
  return replay.prediction.complete() ? exit_ok : exit_solve;
}

namespace {

/// Standard deviation that a new reading of a channel would have at this load when the bench lists them row by row:
/// that of the run's readings, interpolated over the load and constant beyond them.
double sigma_at(const RunRecord& record, const std::string& channel, double load) {
  std::map<double, std::pair<double, int>> by_load;  // load to sum of sigma^2 and count
  for (size_t i = 0; i < record.readings.size(); ++i) {
    if (record.readings[i].channel != channel) continue;
    auto& [sum, count] = by_load[record.load_newtons[i]];
    sum += record.readings[i].sigma * record.readings[i].sigma;
    ++count;
  }
  auto sigma = [](const auto& entry) { return std::sqrt(entry->second.first / entry->second.second); };
  if (by_load.empty()) return 0;
  const auto above = by_load.lower_bound(load);
  if (above == by_load.begin()) return sigma(above);
  if (above == by_load.end()) return sigma(std::prev(above));
  const auto below = std::prev(above);
  const double t = (load - below->first) / (above->first - below->first);
  return (1 - t) * sigma(below) + t * sigma(above);
}

/// Values at new loads, with the bands of the curve (what the fit leaves open) and of a new reading, which scatters by
/// its own noise on top.
struct PredictedRow {
  int line = 0;
  std::string channel;
  std::vector<double> controls;
  double value = 0, error = 0, curve = 0, reading = 0;  ///< SI; half widths of the 95 % bands
};

std::vector<PredictedRow> predicted_rows(const RunRecord& record, const Bench& bench, const Prediction& prediction,
                                         const Eigen::VectorXd& se) {
  std::vector<PredictedRow> rows;
  for (const BenchReading& reading : bench.readings()) {
    PredictedRow& row = rows.emplace_back();
    row.line = reading.line;
    row.channel = bench.channels()[static_cast<size_t>(reading.channel)].id;
    row.controls = reading.controls;
    row.value = prediction.values[reading.row];
    row.error = se[reading.row];
    const size_t k = static_cast<size_t>(std::max(0, record.load_control));
    const double load = record.load_control < 0 ? 0.0 : bench.as_force(k, reading.controls[k]);
    const double sigma = bench.declared_sigma(reading.channel, row.value).value_or(sigma_at(record, row.channel, load));
    row.curve = 1.96 * row.error;
    row.reading = 1.96 * std::hypot(row.error, sigma);
  }
  return rows;
}

std::string predicted_csv(const RunRecord& record, const std::vector<PredictedRow>& rows) {
  const ReadingUnits units(record, ReadingUnits::si);
  std::string heads = "line,channel";
  for (const AxisRecord& control : record.controls) heads += "," + control.id + "_" + column_suffix(control.unit);
  for (const char* name : {"predicted", "standard_error", "lower95", "upper95", "reading_lower95", "reading_upper95"})
    heads += "," + units.column(name);
  std::string csv = units.heads(heads + "\n");
  for (const PredictedRow& row : rows) {
    std::string line = fmt::format("{},{}", row.line, row.channel);
    for (double control : row.controls) line += fmt::format(",{:.10g}", control);
    line += fmt::format(",{:.8g},{:.3g},{:.8g},{:.8g},{:.8g},{:.8g}", row.value, row.error, row.value - row.curve,
                        row.value + row.curve, row.value - row.reading, row.value + row.reading);
    csv += units.row(line + "\n", row.channel);
  }
  return csv;
}

Json predicted_json(const RunRecord& record, const std::vector<PredictedRow>& rows) {
  Json json{{"title", record.title}, {"data", record.simulated ? "simulated" : "measured"}};
  for (const PredictedRow& row : rows) {
    const auto band = [&](double half) { return Json{number(row.value - half), number(row.value + half)}; };
    json["rows"].push_back({{"line", row.line},
                            {"channel", row.channel},
                            {"controls", row.controls},
                            {key("predicted", record, row.channel), number(row.value)},
                            {key("standard_error", record, row.channel), number(row.error)},
                            {key("interval95", record, row.channel), band(row.curve)},
                            {key("reading_interval95", record, row.channel), band(row.reading)}});
  }
  return json;
}

}  // namespace

int predict_command(const CommandOptions& options) {
  settle_run_folder(options.target);
  const RunRecord record = read_run(options.target);
  if (record.fit.covariance.size() == 0) {
    throw InputError(fmt::format("{}: its fit has no result to predict from ({}: {}); run the fit again",
                                 options.target, name_of(record.fit.status), record.fit.message));
  }
  const std::unique_ptr<Bench> whole =
      open_bench(experiment_of_run(record, options.target), {options.threads, options.stop});
  const std::unique_ptr<Bench> bench = whole->at_loads(options.rows);
  Protocol& protocol = bench->protocol();
  Params p = protocol.nominal();
  std::vector<FreeParameter> free;
  for (const ParameterEstimate& e : record.fit.parameters) {
    FreeParameter& parameter = free.emplace_back();
    parameter.index = protocol.parameters().index(e.spec.id);
    p[parameter.index] = e.value;
  }
  Progress progress(options.quiet);
  progress.say(fmt::format("predicting {} rows with {} unknowns", bench->readings().size(), bench->unknowns()));
  const Prediction prediction = protocol.predict(p, indices_of(free));
  const Eigen::VectorXd se = standard_errors(prediction, protocol.parameters(), p, free, record.fit.covariance);
  const std::vector<PredictedRow> rows = predicted_rows(record, *bench, prediction, se);
  if (options.json)
    fmt::print("{}\n", predicted_json(record, rows).dump(2));
  else
    fmt::print("{}", predicted_csv(record, rows));
  for (const std::string& failure : prediction.failures) fmt::print(stderr, "taut: {}\n", failure);
  for (const std::string& warning : bench->warnings_after()) progress.say("warning: " + warning);
  if (interrupted(options)) return exit_interrupted;
  return prediction.complete() ? exit_ok : exit_solve;
}

int report_command(const CommandOptions& options) {
  settle_run_folder(options.target);
  const RunRecord record = read_run(options.target);
  check_inputs(record, options.target);
  RunFolder folder(options.target);
  write_run(record, folder.next());
  folder.publish(RunFolder::Publish::part);
  const std::string page = (fs::path(options.target) / "report.html").string();
  fmt::print("{}\n", options.json ? Json{{"report", page}}.dump() : page);
  return exit_ok;
}

}  // namespace taut

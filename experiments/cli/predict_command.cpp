#include <fmt/format.h>

#include <algorithm>
#include <boost/program_options.hpp>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>

#include "calib/data/run_folder.hpp"
#include "calib/runs/open_bench.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "experiments/cli/provenance.hpp"
#include "reports/axes.hpp"
#include "reports/run_record.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"

namespace taut {
namespace {

using Json = nlohmann::ordered_json;
namespace po = boost::program_options;

/// Standard deviation that a new reading of a channel would have at this load when the bench lists them row by row:
/// that of the run's readings, interpolated over the load and constant beyond them.
double sigma_at(const RunRecord& record, const std::string& channel, double load) {
  std::map<double, std::pair<double, int>> by_load;  // load to sum of sigma^2 and count
  for (size_t i = 0; i < record.readings.size(); ++i) {
    if (record.readings[i].channel != channel || record.readings[i].excluded) continue;
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
  std::string equilibria = {};                          ///< mark_of() those of its row; "": there is one
};

std::vector<PredictedRow> predicted_rows(const RunRecord& record, const Bench& bench, const Prediction& prediction,
                                         const Eigen::VectorXd& se, const std::vector<EquilibriaRecord>& equilibria) {
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
    for (const EquilibriaRecord& rows_there : equilibria) {
      if (std::ranges::count(rows_there.lines, row.line) > 0) row.equilibria = mark_of(rows_there);
    }
  }
  return rows;
}

std::string predicted_csv(const RunRecord& record, const std::vector<PredictedRow>& rows) {
  const ReadingUnits units(record, ReadingUnits::si);
  std::string heads = "line,channel";
  for (const AxisRecord& control : record.controls) heads += "," + control.id + "_" + column_suffix(control.unit);
  for (const char* name : {"predicted", "standard_error", "lower95", "upper95", "reading_lower95", "reading_upper95"})
    heads += "," + units.column(name);
  const bool marked = std::ranges::any_of(rows, [](const PredictedRow& row) { return !row.equilibria.empty(); });
  if (marked) heads += ",equilibria";
  std::string csv = units.heads(heads + "\n");
  for (const PredictedRow& row : rows) {
    std::string line = fmt::format("{},{}", row.line, row.channel);
    for (double control : row.controls) line += fmt::format(",{:.10g}", control);
    line += fmt::format(",{:.8g},{:.3g},{:.8g},{:.8g},{:.8g},{:.8g}", row.value, row.error, row.value - row.curve,
                        row.value + row.curve, row.value - row.reading, row.value + row.reading);
    if (marked) line += "," + row.equilibria;
    csv += units.row(line + "\n", row.channel);
  }
  return csv;
}

Json predicted_json(const RunRecord& record, const std::vector<PredictedRow>& rows,
                    const std::vector<std::string>& warnings) {
  Json json{{"title", record.title}, {"data", record.simulated ? "simulated" : "measured"}};
  for (const PredictedRow& row : rows) {
    const auto band = [&](double half) { return Json{row.value - half, row.value + half}; };
    json["rows"].push_back({{"line", row.line},
                            {"channel", row.channel},
                            {"controls", row.controls},
                            {key("predicted", record, row.channel), row.value},
                            {key("standard_error", record, row.channel), row.error},
                            {key("interval95", record, row.channel), band(row.curve)},
                            {key("reading_interval95", record, row.channel), band(row.reading)}});
    if (!row.equilibria.empty()) json["rows"].back()["equilibria"] = row.equilibria;
  }
  json["warnings"] = warnings;
  return json;
}

/// Predicts at new loads with the parameters and covariance of a run.
int predict_main(const CommandOptions& options) {
  if (options.rows.empty())
    throw InputError("taut predict: --rows FILE is missing; give a CSV file with the load columns of the bench");
  settle_run_folder(options.target);
  const RunRecord record = read_run(options.target);
  if (record.fit.covariance.size() == 0 && !options.anyway) {
    throw InputError(fmt::format(
        "{}: its fit has no result to predict from ({}: {}); run the fit again, or see what it would be with --anyway",
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
    if (!std::isfinite(e.value))
      throw InputError(
          fmt::format("{}: '{}' has no value in its fit.json; run the fit again", options.target, e.spec.id));
    p[parameter.index] = e.value;
  }
  Progress progress(options.quiet);
  progress.say(fmt::format("predicting {} rows with {} unknowns", bench->readings().size(), bench->unknowns()));
  if (!bench->choice().empty()) progress.say(bench->choice());
  const Prediction prediction = protocol.predict(p, indices_of(free));
  Eigen::VectorXd se = standard_errors(prediction, protocol.parameters(), p, free, record.fit.covariance);
  if (record.fit.covariance.size() == 0) {
    se.setConstant(not_a_number);
    progress.say(fmt::format("THE FIT HAS NO RESULT ({}): values where its search ended, without errors",
                             name_of(record.fit.status)));
  } else if (misses_readings(record.fit)) {
    progress.say("THE MODEL DID NOT DESCRIBE THE READINGS that it was fitted to: the bands count their noise only");
  }
  const std::vector<EquilibriaRecord> equilibria = equilibria_of(*bench, protocol.alternatives(p), {}, {});
  const std::vector<PredictedRow> rows = predicted_rows(record, *bench, prediction, se, equilibria);
  std::vector<std::string> warnings = bench->warnings_after();
  for (const EquilibriaRecord& rows_there : equilibria) warnings.push_back(rows_there.text);
  if (options.json)
    print_json(predicted_json(record, rows, warnings));
  else
    fmt::print("{}", predicted_csv(record, rows));
  print_failures(prediction.failures);
  for (const std::string& warning : warnings) progress.say("warning: " + warning);
  if (options.interrupted()) return exit_interrupted;
  return prediction.complete() ? exit_ok : exit_solve;
}

void add_predict_options(AddOption add, CommandOptions& options) {
  add_threads(add, options);
  add("rows", po::value(&options.rows)->value_name("FILE"), "CSV file with the load columns of the bench (required)");
  add("anyway", po::bool_switch(&options.anyway), "also from a fit without a result, without errors");
}

}  // namespace

Command predict_command() {
  return {"predict",
          "RUN_FOLDER",
          "Predicts at new loads with the parameters of a run, with 95 % bands.",
          "  taut predict runs/silicone_block --rows new.csv        # new.csv: the load columns of the bench, one row "
          "per prediction\n",
          add_predict_options,
          predict_main};
}

}  // namespace taut

#include <fmt/format.h>

#include <algorithm>
#include <boost/program_options.hpp>
#include <nlohmann/json.hpp>

#include "calib/data/run_folder.hpp"
#include "calib/runs/open_bench.hpp"
#include "calib/runs/predict_rows.hpp"
#include "calib/runs/provenance.hpp"
#include "experiments/cli/commands.hpp"
#include "experiments/cli/print.hpp"
#include "experiments/cli/progress.hpp"
#include "reports/axes.hpp"
#include "reports/run_record.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

using Json = nlohmann::ordered_json;
namespace po = boost::program_options;

std::string predicted_csv(const RunRecord& record, const std::vector<PredictedRow>& rows) {
  const ReadingUnits units(record, ReadingUnits::si);
  std::string heads = "line,channel";
  for (const AxisRecord& control : record.controls) heads += "," + control.id + "_" + column_suffix(control.unit);
  for (const char* name : {"predicted", "standard_error", "lower95", "upper95", "reading_lower95", "reading_upper95"})
    heads += "," + units.column(name);
  const bool marked = std::ranges::any_of(rows, [](const PredictedRow& row) { return !row.equilibria.empty(); });
  if (marked) heads += ",equilibria";
  const BenchColumns in_file(
      record, {"predicted", "standard_error", "lower95", "upper95", "reading_lower95", "reading_upper95"});
  const auto ended = [](std::string line, const std::string& more) { return line.insert(line.size() - 1, more); };
  std::string csv = ended(units.heads(heads + "\n"), in_file.heads());
  for (const PredictedRow& row : rows) {
    std::string line = fmt::format("{},{}", row.line, row.channel);
    for (double control : row.controls) line += fmt::format(",{:.10g}", control);
    line += fmt::format(",{:.8g},{:.3g},{:.8g},{:.8g},{:.8g},{:.8g}", row.value, row.error, row.value - row.curve,
                        row.value + row.curve, row.value - row.reading, row.value + row.reading);
    if (marked) line += "," + row.equilibria;
    csv += ended(units.row(line + "\n", row.channel),
                 in_file.fields(row.controls, row.channel,
                                {row.value, row.error, row.value - row.curve, row.value + row.curve,
                                 row.value - row.reading, row.value + row.reading}));
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
  refuse_without_result(record, options.target, options.anyway);
  const std::unique_ptr<Bench> whole =
      open_bench(experiment_of_run(record, options.target), {options.threads, options.stop});
  const std::unique_ptr<Bench> bench = whole->at_loads(options.rows);
  Progress progress(options.quiet);
  progress.say(fmt::format("predicting {} rows with {} unknowns", bench->readings().size(), bench->unknowns()));
  if (!bench->choice().empty()) progress.say(bench->choice());
  if (record.fit.covariance.size() == 0) {
    progress.say(fmt::format("THE FIT HAS NO RESULT ({}): values where its search ended, without errors",
                             name_of(record.fit.status)));
  } else if (misses_readings(record.fit)) {
    progress.say("THE MODEL DID NOT DESCRIBE THE READINGS that it was fitted to: the bands count their noise only");
  }
  const RowsPrediction predicted = predict_rows(record, *bench);
  if (options.json)
    print_json(predicted_json(record, predicted.rows, predicted.warnings));
  else
    fmt::print("{}", predicted_csv(record, predicted.rows));
  print_failures(predicted.failures);
  for (const std::string& warning : predicted.warnings) progress.say("warning: " + warning);
  if (options.interrupted()) return exit_interrupted;
  return predicted.failures.empty() ? exit_ok : exit_solve;
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

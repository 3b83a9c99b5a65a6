#include "experiments/cli/uniaxial_commands.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <set>

#include "calib/benches/static_bench.hpp"
#include "calib/benches/uniaxial.hpp"
#include "calib/files/uniaxial_file.hpp"
#include "experiments/cli/session.hpp"
#include "experiments/cli/version.hpp"
#include "reports/report.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

using Json = nlohmann::ordered_json;
using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// A law with its constants, fitted to the readings of some modes.
struct PointFit {
  std::string name, law;
  std::map<std::string, double> constants;
  std::vector<PointMode> modes;
};

struct PointSession {
  UniaxialExperiment experiment;
  Trials trials;
  UniaxialBench bench;
  PointFit main;

  explicit PointSession(const CommandOptions& options)
      : experiment(read_uniaxial(options.target)),
        trials(read_trials(experiment.common.bench)),
        bench(make_uniaxial_bench(experiment.common.bench, trials)) {
    const MaterialSettings& material = experiment.common.materials.front();
    main = {
        "this fit", material.law, material.constants, {PointMode::tension, PointMode::compression, PointMode::shear}};
  }

  UniaxialProtocol protocol(const PointFit& fit, std::vector<PointRow> rows) const {
    return {experiment.common.materials.front().region, fit.law, fit.constants, std::move(rows)};
  }
  std::vector<Measurement> measurements(const PointFit& fit) const {
    std::vector<Measurement> chosen = bench.measurements;
    std::erase_if(chosen, [&](const Measurement& m) { return !has(fit, bench.rows[static_cast<size_t>(m.row)].mode); });
    return chosen;
  }
  static bool has(const PointFit& fit, PointMode mode) {
    return std::find(fit.modes.begin(), fit.modes.end(), mode) != fit.modes.end();
  }
};

std::string describe(const PointFit& fit) {
  std::string text = fit.law;
  if (fit.modes.size() == 3) return text;
  for (size_t i = 0; i < fit.modes.size(); ++i)
    text += fmt::format("{}{}", i == 0 ? ", " : " and ", name_of(fit.modes[i]));
  return text + " only";
}

std::vector<std::pair<std::string, std::string>> describe_setup(const PointSession& session) {
  const Experiment& e = session.experiment.common;
  const MaterialSettings& material = e.materials.front();
  std::vector<std::pair<std::string, std::string>> lines;
  lines.emplace_back("data", e.simulated ? "simulated" : "measured");
  lines.emplace_back("geometry", "material point: homogeneous deformation, free sides in tension and compression");
  std::string text = material.law;
  for (const ParameterSpec& spec : material_parameters(material.law))
    text += fmt::format(", {} = {}", spec.id, with_unit(material.constants.at(spec.id), spec.unit));
  lines.emplace_back("material " + material.region, text);
  for (size_t channel = 0; channel < session.trials.channel_ids.size(); ++channel) {
    std::set<double> strains;
    size_t count = 0;
    for (const Reading& reading : session.trials.readings) {
      if (reading.channel != static_cast<int>(channel)) continue;
      strains.insert(reading.controls.front());
      ++count;
    }
    if (count > 0)
      lines.emplace_back(session.trials.channel_ids[channel],
                         fmt::format("{} readings, strains from {:.3g} to {:.3g} %", count, 100 * *strains.begin(),
                                     100 * *strains.rbegin()));
  }
  for (const std::string& remark : session.trials.remarks) {
    // Its count of conditions and trials takes every strain for a load under which each mode should be read.
    if (remark.find(" conditions, ") == std::string::npos) lines.emplace_back("bench", remark);
  }
  return lines;
}

RunRecord start_record(const PointSession& session, const Protocol& protocol, const CommandOptions& options) {
  RunRecord record;
  record.title = session.experiment.common.title;
  record.simulated = session.experiment.common.simulated;
  record.material_point = true;
  record.setup = describe_setup(session);
  record.control_ids = session.trials.control_ids;
  record.control_units = {"1"};
  record.load_label = "strain";
  record.parameter_ids = protocol.parameters().ids();
  for (const Reading& reading : session.trials.readings) {
    ReadingRecord& line = record.readings.emplace_back();
    line.line = reading.line;
    line.trial = reading.trial;
    line.channel = session.trials.channel_ids[static_cast<size_t>(reading.channel)];
    line.controls = reading.controls;
    line.measured = reading.value;
    line.sigma = reading.sigma;
    line.predicted = line.prediction_se = std::nan("");
  }
  for (const ReferenceValue& reference : session.experiment.common.references) {
    const ParameterSpec& spec = protocol.parameters()[protocol.parameters().index(reference.parameter)];
    record.references.push_back(
        {reference.parameter,
         parse_quantity(reference.value.text, quantity_of_si_unit(spec.unit), reference.value.where),
         reference.source});
  }
  record.provenance.version = version();
  record.provenance.commit = commit();
  record.provenance.libraries = library_versions();
  record.provenance.command_line = options.command_line;
  record.provenance.started = utc_now();
  record.provenance.machine = machine_description();
  return record;
}

/// The fitted curve of each mode that `fit` was fitted to, from zero to the largest strain and at every reading.
void add_curves(const PointSession& session, const PointFit& fit, const FitResult& result,
                const std::vector<FreeParameter>& free, RunRecord& record) {
  constexpr int steps = 30;
  std::vector<int> indices;
  for (const FreeParameter& parameter : free) indices.push_back(parameter.index);
  for (PointMode mode : {PointMode::tension, PointMode::compression, PointMode::shear}) {
    std::set<double> strains;
    for (const PointRow& row : session.bench.rows) {
      if (row.mode == mode) strains.insert(row.strain);
    }
    if (strains.empty() || !PointSession::has(fit, mode)) continue;
    const double low = std::min(0.0, *strains.begin()), high = std::max(0.0, *strains.rbegin());
    for (int i = 0; i <= steps; ++i) strains.insert(low + (high - low) * i / steps);
    std::vector<PointRow> rows;
    for (double strain : strains) rows.push_back({mode, strain});
    UniaxialProtocol protocol = session.protocol(fit, rows);
    const Prediction prediction = protocol.predict(result.p, indices);
    const Eigen::VectorXd se = standard_errors(prediction, protocol.parameters(), result.p, free, result.covariance);
    CurveRecord& curve = record.curves.emplace_back();
    curve.channel = name_of(mode);
    curve.series = fit.name == session.main.name ? describe(fit) + " (this fit)" : fit.name;
    for (size_t i = 0; i < rows.size(); ++i) {
      curve.load.push_back(rows[i].strain);
      curve.value.push_back(prediction.values[static_cast<Eigen::Index>(i)]);
      curve.se.push_back(se[static_cast<Eigen::Index>(i)]);
    }
  }
}

/// `result` as a row of the table of variants, its values in the order of the main fit's parameters.
VariantRecord as_variant(const PointFit& fit, const FitResult& result, const FitResult& main, size_t readings,
                         double seconds) {
  VariantRecord record;
  record.name = fit.name;
  record.mesh = describe(fit);
  record.unknowns = static_cast<int>(readings);
  record.status = name_of(result.status);
  record.chi_squared = result.chi_squared;
  record.seconds = seconds;
  for (const ParameterEstimate& wanted : main.parameters) {
    const auto found = std::find_if(result.parameters.begin(), result.parameters.end(),
                                    [&](const ParameterEstimate& e) { return e.spec.id == wanted.spec.id; });
    const bool has = result.status == FitStatus::converged && found != result.parameters.end();
    record.values.push_back(has ? found->value : std::nan(""));
    record.standard_errors.push_back(has ? found->standard_error : std::nan(""));
  }
  return record;
}

}  // namespace

int check_uniaxial(const CommandOptions& options) {
  const PointSession session(options);
  const UniaxialProtocol protocol = session.protocol(session.main, session.bench.rows);
  const std::vector<FreeParameter> free = free_parameters(session.experiment.common, protocol);
  print_check(start_record(session, protocol, options), protocol.parameters(), free, options.json);
  return exit_ok;
}

int fit_uniaxial(const CommandOptions& options) {
  const Clock::time_point start = Clock::now();
  const PointSession session(options);
  Progress progress(options.quiet);
  UniaxialProtocol protocol = session.protocol(session.main, session.bench.rows);
  const std::vector<FreeParameter> free = free_parameters(session.experiment.common, protocol);
  RunRecord record = start_record(session, protocol, options);
  const std::string folder = run_folder(options);
  FitOptions how;
  how.stop = options.stop;
  record.fit = fit(protocol, session.bench.measurements, free, how);
  if (record.fit.status == FitStatus::start_failed) {
    for (const std::string& failure : record.fit.failures) fmt::print(stderr, "taut: {}\n", failure);
    fmt::print(stderr, "taut: the prediction failed at the start of the fit; change the start values\n");
    return exit_solve;
  }
  record.main = as_variant(session.main, record.fit, record.fit, record.readings.size(), seconds_since(start));
  record.main.name = session.main.law;
  for (size_t i = 0; i < record.readings.size(); ++i) {
    const int row = session.bench.measurements[i].row;
    record.readings[i].predicted = record.fit.predicted[row];
    record.readings[i].prediction_se = record.fit.prediction_se[row];
  }
  add_curves(session, session.main, record.fit, free, record);
  for (const UniaxialVariant& variant : session.experiment.variants) {
    if (!options.variants) break;
    const Clock::time_point begin = Clock::now();
    const PointFit other{variant.name, variant.law, variant.constants, variant.modes};
    UniaxialProtocol its = session.protocol(other, session.bench.rows);
    const std::vector<FreeParameter> its_free = free_parameters_of_law(session.experiment.common, its);
    FitOptions quick = how;
    quick.profiles = false;
    const std::vector<Measurement> measurements = session.measurements(other);
    const FitResult result = fit(its, measurements, its_free, quick);
    record.variants.push_back(as_variant(other, result, record.fit, measurements.size(), seconds_since(begin)));
    if (result.status == FitStatus::converged) add_curves(session, other, result, its_free, record);
  }
  Session inputs;
  inputs.experiment = session.experiment.common;
  copy_inputs(inputs, folder, record);
  record.provenance.wall_seconds = seconds_since(start);
  write_run(record, folder);
  if (options.json)
    fmt::print("{}\n", to_json(record));
  else
    print_fit(record);
  progress.say("report: " + (std::filesystem::path(folder) / "report.html").string());
  if (record.fit.status == FitStatus::converged) return exit_ok;
  fmt::print(stderr, "taut: the fit did not converge: {}\n", record.fit.message);
  return record.fit.status == FitStatus::interrupted ? exit_interrupted : exit_fit;
}

}  // namespace taut

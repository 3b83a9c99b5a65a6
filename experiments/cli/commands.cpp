#include "experiments/cli/commands.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>

#include "calib/benches/recordings.hpp"
#include "calib/benches/uniaxial.hpp"
#include "calib/files/recordings_file.hpp"
#include "calib/files/uniaxial_file.hpp"
#include "calib/models/beam_model.hpp"
#include "calib/models/ladder.hpp"
#include "experiments/cli/recording_commands.hpp"
#include "experiments/cli/session.hpp"
#include "experiments/cli/simulate_command.hpp"
#include "experiments/cli/uniaxial_commands.hpp"
#include "reports/diagnostic.hpp"
#include "reports/draw.hpp"
#include "reports/report.hpp"
#include "sim/core/error.hpp"
#include "sim/files/simulation.hpp"
#include "sim/robots/simulation.hpp"

namespace taut {
namespace {

/// An error in the unit that its value is shown in: "0.36" beside "61.15 kPa".
std::string bare_beside(double value, double error, std::string_view si_unit) {
  return fmt::format("{:.2g}", error / display_unit(value, si_unit).factor);
}
/// The same with the unit: "0.36 kPa".
std::string beside(double value, double error, std::string_view si_unit) {
  const DisplayUnit unit = display_unit(value, si_unit);
  return bare_beside(value, error, si_unit) + (unit.name == "1" ? "" : " " + unit.name);
}

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

class Stopwatch {
 public:
  double seconds() const { return std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count(); }

 private:
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

bool interrupted(const CommandOptions& options) {
  return options.stop != nullptr && options.stop->load();
}

std::vector<int> indices_of(const std::vector<FreeParameter>& free) {
  std::vector<int> indices;
  for (const FreeParameter& parameter : free) indices.push_back(parameter.index);
  return indices;
}

/// A finite number or null.
Json number(double value) {
  return std::isfinite(value) ? Json(value) : Json(nullptr);
}

/// Readings as a table for people.
void print_readings(const RunRecord& record) {
  fmt::print("{:>5}  {:<12} {:<14} {:<28} {:>11} {:>11} {:>9} {:>8}\n", "line", "trial", "channel", "controls",
             "measured", "predicted", "residual", "/sigma");
  for (const ReadingRecord& reading : record.readings) {
    std::string controls;
    for (size_t k = 0; k < reading.controls.size(); ++k)
      controls += fmt::format("{}{}", k == 0 ? "" : ", ", with_unit(reading.controls[k], record.control_units[k]));
    const double residual = reading.measured - reading.predicted;
    fmt::print("{:>5}  {:<12} {:<14} {:<28} {:>8.3f} mm {:>8.3f} mm {:>6.3f} mm {:>8.2f}\n", reading.line,
               reading.trial, reading.channel, controls, 1e3 * reading.measured, 1e3 * reading.predicted,
               1e3 * residual, residual / reading.sigma);
  }
}

void fill_predictions(RunRecord& record, const StaticBench& bench, const Eigen::VectorXd& values,
                      const Eigen::VectorXd& se) {
  for (size_t i = 0; i < record.readings.size(); ++i) {
    record.readings[i].predicted = values[bench.row_of_reading[i]];
    if (se.size() > 0) record.readings[i].prediction_se = se[bench.row_of_reading[i]];
  }
}

std::string interval_text(const ParameterEstimate& e) {
  auto end = [&](const std::optional<double>& value) {
    return value ? with_unit(*value, e.spec.unit) : std::string("open");
  };
  return fmt::format("{} to {}", end(e.lower95), end(e.upper95));
}

}  // namespace

void print_fit(const RunRecord& record) {
  const FitResult& fit = record.fit;
  if (record.simulated) fmt::print("SIMULATED DATA: the readings were made by a program, not measured.\n");
  for (size_t j = 0; j < fit.parameters.size(); ++j) {
    const ParameterEstimate& e = fit.parameters[j];
    std::string shares, biases;
    for (const DiscretisationShare& share : record.shares) {
      const double most = std::abs(share.bias[j]) + (std::isfinite(share.error[j]) ? share.error[j] : 0);
      shares += fmt::format(" +- {} ({})", std::isfinite(most) ? bare_beside(e.value, most, e.spec.unit) : "unknown",
                            share.source);
      biases += fmt::format("  {}\n", describe(share, e, j));
    }
    fmt::print("{} = {} +- {} (noise){}, 95 % interval of the noise {}: {}\n  {}\n{}", e.spec.id,
               with_unit(e.value, e.spec.unit),
               std::isfinite(e.standard_error) ? bare_beside(e.value, e.standard_error, e.spec.unit) : "unknown",
               shares, interval_text(e), name_of(e.verdict), e.explanation, biases);
  }
  fmt::print("chi squared {:.4g} for {} degrees of freedom (p = {:.2g})", fit.chi_squared, fit.dof, fit.chi_squared_p);
  if (fit.lack_of_fit.available)
    fmt::print("; lack of fit F = {:.3g} (p = {:.2g})", fit.lack_of_fit.F, fit.lack_of_fit.p_value);
  fmt::print("\n");
  if (fit.chi_squared_p < 0.05 && fit.dof > 0) {
    fmt::print(
        "  the curve misses the readings by more than the declared sigmas: model or sigmas are not right somewhere; if "
        "it were noise, standard errors would be {:.2g} times as large\n",
        std::sqrt(fit.chi_squared / fit.dof));
  }
  for (const DiagnosticRecord& diagnostic : record.diagnostics) {
    for (const ParameterEstimate& e : fit.parameters) {
      if (e.spec.id != diagnostic.parameter) continue;
      fmt::print("from {} alone: {} = {} +- {} ({} readings)\n", diagnostic.part, e.spec.id,
                 with_unit(diagnostic.value, e.spec.unit),
                 beside(diagnostic.value, diagnostic.standard_error, e.spec.unit), diagnostic.readings);
    }
  }
  for (const DiagnosticGroup& group : diagnostic_groups(record)) fmt::print("  {}\n", interpretation(record, group));
  for (const VariantRecord& variant : record.variants) {
    std::string values;
    for (size_t j = 0; j < variant.values.size(); ++j) {
      if (std::isfinite(variant.values[j]))
        values += fmt::format("{}{} = {}", values.empty() ? "" : ", ", fit.parameters[j].spec.id,
                              with_unit(variant.values[j], fit.parameters[j].spec.unit));
    }
    if (record.material_point && !values.empty())
      values += fmt::format("; chi squared {:.4g} of {} readings", variant.chi_squared, variant.unknowns);
    fmt::print("variant {:<22} {:<48} {}\n", variant.name, variant.mesh, values.empty() ? variant.status : values);
  }
  for (const ReferenceRecord& reference : record.references) {
    for (const ParameterEstimate& e : fit.parameters) {
      if (e.spec.id == reference.parameter) {
        fmt::print("for comparison {} = {} ({}): ours is {:+.1f} %\n", e.spec.id,
                   with_unit(reference.value, e.spec.unit), reference.source, 100 * (e.value / reference.value - 1));
      }
    }
  }
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

/// The same fit with another mesh, started from the main one's result. What fails costs that variant.
VariantRecord fit_variant(const Session& session, const VariantSettings& variant, const FitResult& main,
                          const CommandOptions& options, Progress& progress) {
  const Stopwatch watch;
  try {
    const MeshSettings mesh =
        session.experiment.model == Rung::solid ? deepened(session.experiment, variant.mesh) : variant.mesh;
    const StaticBench bench = make_static_bench(session.experiment, mesh, session.trials);
    std::vector<FreeParameter> free = free_parameters(session.experiment, *bench.protocol);
    for (size_t j = 0; j < free.size(); ++j) free[j].start = main.parameters[j].value;
    FitOptions how = fit_options(options, session.experiment, session.bench.protocol->parameters(), free, progress,
                                 "variant " + variant.name);
    how.profiles = false;
    how.tolerance = 1e-6;
    const FitResult fit_result = fit(*bench.protocol, bench.measurements, free, how);
    return as_variant(variant.name, variant.mesh, *bench.protocol->scene().model, fit_result, watch.seconds());
  } catch (const InputError& error) {
    VariantRecord record;
    record.name = variant.name;
    record.mesh = variant.mesh.describe();
    record.status = error.what();
    record.seconds = watch.seconds();
    return record;
  }
}

/// Fits one parameter to the readings of each value of a control alone, from the whole fit's result: values that differ
/// by more than their errors say that one law does not serve all readings.
std::vector<DiagnosticRecord> diagnose(const Session& session, const FitResult& main, const CommandOptions& options,
                                       Progress& progress) {
  std::vector<DiagnosticRecord> records;
  const DiagnosticSettings& settings = *session.experiment.diagnostic;
  const size_t control = diagnostic_control(session);
  for (double held : session.trials.control_values[control]) {
    if (interrupted(options)) break;
    DiagnosticRecord& record = records.emplace_back();
    record.parameter = settings.parameter;
    record.part = describe_control(session, control, held);
    progress.show(fmt::format("{} from {} alone", record.parameter, record.part));
    Trials part = session.trials;
    std::erase_if(part.readings, [&](const Reading& reading) { return reading.controls[control] != held; });
    record.readings = static_cast<int>(part.readings.size());
    const StaticBench bench = make_static_bench(session.experiment, session.experiment.mesh, part);
    StaticProtocol& protocol = *bench.protocol;
    FitOptions how;
    how.held = main.p;
    how.profiles = false;
    how.stop = options.stop;
    const int index = protocol.parameters().index(settings.parameter);
    const auto whole = std::find_if(main.parameters.begin(), main.parameters.end(),
                                    [&](const ParameterEstimate& e) { return e.spec.id == settings.parameter; });
    const FitResult result =
        fit(protocol, bench.measurements, {{index, whole->value, whole->lower, whole->upper}}, how);
    const bool good = result.status == FitStatus::converged;
    record.value = good ? result.parameters.front().value : std::nan("");
    record.standard_error = good ? result.parameters.front().standard_error : std::nan("");
    record.chi_squared = result.chi_squared;
  }
  return records;
}

}  // namespace

void print_check(const RunRecord& record, const ParameterTable& table, const std::vector<FreeParameter>& free,
                 bool as_json) {
  if (as_json) {
    Json json{{"title", record.title}, {"data", record.simulated ? "simulated" : "measured"}};
    for (const auto& [label, text] : record.setup) json["setup"].push_back({label, text});
    json["free"] = Json::array();
    for (const FreeParameter& p : free)
      json["free"].push_back({{"id", table[p.index].id},
                              {"start", p.start},
                              {"bounds", {p.lower, p.upper}},
                              {"unit", table[p.index].unit}});
    json["warnings"] = record.remarks;
    fmt::print("{}\n", json.dump(2));
    return;
  }
  fmt::print("{}\n", record.title);
  for (const auto& [label, text] : record.setup) fmt::print("  {:<22} {}\n", label, text);
  for (const FreeParameter& p : free) {
    const ParameterSpec& spec = table[p.index];
    fmt::print("  {:<22} start {}, bounds {} to {}\n", "free " + spec.id, with_unit(p.start, spec.unit),
               with_unit(p.lower, spec.unit), with_unit(p.upper, spec.unit));
  }
  if (free.empty())
    fmt::print("  nothing is free: `taut fit` needs at least one [fit.free.ID]; parameters: {}\n", join(table.ids()));
  for (const std::string& warning : record.remarks) fmt::print("warning: {}\n", warning);
  if (record.remarks.empty()) fmt::print("no problems found\n");
}

int check_command(const CommandOptions& options) {
  if (is_simulation(options.target)) return check_simulation(options);
  if (is_uniaxial(options.target)) return check_uniaxial(options);
  if (has_recordings(options.target)) return check_recordings(options);
  const Session session = open_session(options);
  const StaticProtocol& protocol = *session.bench.protocol;
  RunRecord record = start_record(session, options);
  record.setup.emplace_back("distinct solves", std::to_string(protocol.conditions().size()));
  print_check(record, protocol.parameters(), free_parameters(session.experiment, protocol), options.json);
  return exit_ok;
}

int draw_command(const CommandOptions& options) {
  const Experiment experiment = read_experiment(options.target);
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
  if (has_recordings(options.target)) return replay_recordings(options);
  const Session session = open_session(options);
  Progress progress(options.quiet);
  StaticProtocol& protocol = *session.bench.protocol;
  RunRecord record = start_record(session, options);
  Params p = protocol.nominal();
  for (const auto& [id, text] : options.set) {
    const int index = protocol.parameters().index(id);
    if (std::find(protocol.controls().begin(), protocol.controls().end(), index) != protocol.controls().end()) {
      throw InputError(fmt::format(
          "--set {0}: '{0}' is set by the bench, row by row; change its column in a copy of the bench file", id));
    }
    p[index] = parse_quantity(text, quantity_of_si_unit(protocol.parameters()[index].unit), "--set " + id);
    protocol.parameters().check(index, p[index]);
  }
  progress.say(fmt::format("replaying {} conditions with {} unknowns", protocol.conditions().size(),
                           protocol.scene().model->free_unknowns()));
  session.model().forget();  // what the choice of the model left
  const Stopwatch watch;
  const Prediction prediction = session.model().predict(p, {});
  record.replay_seconds = watch.seconds();
  if (!session.choice.empty()) progress.say(session.choice);
  const std::string comparison = compare_models(session, p, prediction.values, record.replay_seconds);
  if (!comparison.empty()) progress.say(comparison);
  fill_predictions(record, session.bench, prediction.values, {});
  const std::string folder = run_folder(options);
  write_file((fs::path(folder) / "predictions.csv").string(), predictions_csv(record));
  make_shapes(session, folder, record.shape_axes);
  if (options.json) {
    Json json{{"title", record.title},
              {"data", record.simulated ? "simulated" : "measured"},
              {"seconds", record.replay_seconds},
              {"factorisations", session.model().factorisations()}};
    if (!session.choice.empty()) json["model"] = session.choice;
    for (const ReadingRecord& r : record.readings) {
      json["rows"].push_back({{"line", r.line},
                              {"channel", r.channel},
                              {"trial", r.trial},
                              {"controls", r.controls},
                              {"measured_m", r.measured},
                              {"predicted_m", number(r.predicted)}});
    }
    for (const CableState& state : cable_states(session))
      json["cables"].push_back(
          {{"state", state.where}, {"cable", state.cable}, {"tension_N", state.tension}, {"length_m", state.length}});
    json["failures"] = prediction.failures;
    fmt::print("{}\n", json.dump(2));
  } else {
    if (record.simulated) fmt::print("SIMULATED DATA in the column 'measured'.\n");
    print_readings(record);
    for (const CableState& state : cable_states(session)) {
      fmt::print("cable {:<10} {:<40} tension {:>9}, length {}\n", state.cable, state.where,
                 with_unit(state.tension, "N"), with_unit(state.length, "m", 5));
    }
  }
  for (const std::string& warning : record.remarks) progress.say("warning: " + warning);
  for (const std::string& warning : warnings_after(protocol)) progress.say("warning: " + warning);
  for (const std::string& failure : prediction.failures) fmt::print(stderr, "taut: {}\n", failure);
  progress.say(
      fmt::format("{:.2f} s, {} Newton iterations, {} factorisations; {}/predictions.csv, {}/states/states.pvd",
                  record.replay_seconds, protocol.newton_iterations(), protocol.factorisations(), folder, folder));
  if (interrupted(options)) return exit_interrupted;
  return prediction.complete() ? exit_ok : exit_solve;
}

int fit_command(const CommandOptions& options) {
  if (is_uniaxial(options.target)) return fit_uniaxial(options);
  if (has_recordings(options.target)) return fit_recordings(options);
  const Stopwatch watch;
  Session session = open_session(options);
  Progress progress(options.quiet);
  StaticProtocol& protocol = *session.bench.protocol;
  const std::vector<FreeParameter> free = free_parameters(session.experiment, protocol);
  RunRecord record = start_record(session, options);
  const std::string folder = run_folder(options);
  for (const std::string& warning : record.remarks) progress.say("warning: " + warning);
  progress.say(fmt::format("fitting {} readings in {} conditions with {} unknowns", record.readings.size(),
                           protocol.conditions().size(), protocol.scene().model->free_unknowns()));

  if (!session.choice.empty()) {
    progress.say(session.choice);
    record.remarks.push_back(session.choice);
  }
  const Stopwatch fit_watch;
  const std::vector<FreeParameter> start = start_by_beams(session.experiment, session.trials, free);
  const double beam_seconds = fit_watch.seconds();
  record.fit =
      fit(session.model(), session.bench.measurements, start,
          fit_options(options, session.experiment, session.bench.protocol->parameters(), free, progress, "fit"));
  if (record.fit.status == FitStatus::start_failed && start.front().start != free.front().start) {
    record.fit =
        fit(session.model(), session.bench.measurements, free,
            fit_options(options, session.experiment, session.bench.protocol->parameters(), free, progress, "fit"));
  }
  record.fit.search.seconds += beam_seconds;
  for (size_t j = 0; j < record.fit.parameters.size(); ++j) record.fit.parameters[j].start = free[j].start;
  record.main =
      as_variant("this fit", session.experiment.mesh, *protocol.scene().model, record.fit, fit_watch.seconds());
  if (record.fit.status == FitStatus::start_failed) {
    for (const std::string& failure : record.fit.failures) fmt::print(stderr, "taut: {}\n", failure);
    fmt::print(stderr,
               "taut: the simulation failed at the start of the fit; change the start values, or look at the model "
               "with `taut replay`\n");
    return interrupted(options) ? exit_interrupted : exit_solve;
  }
  copy_inputs(session, folder, record);
  for (const std::string& failure : record.fit.failures) record.remarks.push_back("survived in the fit: " + failure);

  if (!interrupted(options)) {
    Protocol& model = session.model();
    const int before = model.factorisations();
    const Stopwatch replay_watch;
    model.forget();
    const Prediction again = model.predict(record.fit.p, {});
    record.replay_seconds = replay_watch.seconds();
    record.replay_factorisations = model.factorisations() - before;
    const std::string comparison = compare_models(session, record.fit.p, again.values, record.replay_seconds);
    if (!comparison.empty()) record.remarks.push_back(comparison);
  }
  if (!interrupted(options) && record.fit.predicted.size() > 0) {  // empty: the optimum could not be replayed
    fill_predictions(record, session.bench, record.fit.predicted, record.fit.prediction_se);
    progress.show("drawing curves");
    if (!session.rungs) record.curves = make_curves(session, record.fit.p, free, record.fit.covariance);
    record.shapes = make_shapes(session, folder, record.shape_axes);
    for (const std::string& warning : warnings_after(protocol)) record.remarks.push_back(warning);
    const bool asked = session.experiment.mesh_share && session.experiment.model == Rung::full;
    if (asked && record.fit.status == FitStatus::converged && !interrupted(options)) {
      record.shares = discretisation_shares(session.experiment, session.trials, record.fit,
                                            [&](const std::string& what) { progress.show(what); });
      if (interrupted(options)) record.shares.clear();
    }
    if (session.experiment.diagnostic && !session.rungs)
      record.diagnostics = diagnose(session, record.fit, options, progress);
  }
  if (session.rungs)
    record.remarks.emplace_back("curves, variants and diagnostics need one model for all rows: left out");
  if (options.variants && !session.rungs) {
    for (const VariantSettings& variant : session.experiment.variants) {
      if (interrupted(options)) break;
      progress.show("variant " + variant.name);
      VariantRecord result = fit_variant(session, variant, record.fit, options, progress);
      if (!interrupted(options)) record.variants.push_back(std::move(result));
    }
  }
  if (interrupted(options)) {
    if (record.fit.status != FitStatus::interrupted)
      record.remarks.emplace_back("interrupted: later parts of the run are missing");
    record.fit.message = "interrupted";
  }
  record.provenance.wall_seconds = watch.seconds();
  progress.show("writing " + folder);
  write_run(record, folder);

  if (options.json)
    fmt::print("{}\n", to_json(record));
  else
    print_fit(record);
  for (const std::string& remark : record.remarks) progress.say("note: " + remark);
  const FitCost &search = record.fit.search, &profiles = record.fit.profiles;
  progress.say(fmt::format(
      "{:.1f} s in all; fit {:.2f} s with {} factorisations in {} evaluations, {:.1f} times one cold replay's {:.2f} s "
      "with {}; profiles {:.2f} s with {}",
      record.provenance.wall_seconds, search.seconds, search.factorisations, record.fit.evaluations,
      search.seconds / record.replay_seconds, record.replay_seconds, record.replay_factorisations, profiles.seconds,
      profiles.factorisations));
  progress.say("report: " + (fs::path(folder) / "report.html").string());
  if (interrupted(options)) return exit_interrupted;
  if (record.fit.status == FitStatus::converged) return exit_ok;
  fmt::print(stderr, "taut: the fit did not converge: {}\n", record.fit.message);
  return exit_fit;
}

int predict_command(const CommandOptions& options) {
  const RunRecord record = read_run(options.target);
  if (record.fit.covariance.size() == 0) {
    throw InputError(fmt::format("{}: its fit has no result to predict from ({}: {}); run the fit again",
                                 options.target, name_of(record.fit.status), record.fit.message));
  }
  if (record.over_time)
    throw InputError(
        fmt::format("{}: is a fit of recordings, which have no table of loads to predict at; use `taut "
                    "replay` on the experiment with --set",
                    options.target));
  Experiment experiment = experiment_of_run(record, options.target);
  experiment.equilibrium.stop = options.stop;
  experiment.threads = options.threads;
  const std::vector<LoadRow> rows = read_load_rows(experiment.bench, options.rows);
  Trials trials = read_trials(experiment.bench);
  trials.readings.clear();
  for (const LoadRow& row : rows) {
    for (size_t channel = 0; channel < trials.channel_ids.size(); ++channel) {
      Reading reading;
      reading.line = row.line;
      reading.controls = row.controls;
      reading.channel = static_cast<int>(channel);
      trials.readings.push_back(reading);
    }
  }
  if (experiment.model == Rung::beam || experiment.model == Rung::automatic) {
    throw InputError(
        fmt::format("{}: was fitted with model = \"{}\", and predictions are made by finite elements of one kind; "
                    "fit again with \"full\", \"rigid_segments\" or \"solid\"",
                    options.target, name_of(experiment.model)));
  }
  if (experiment.model == Rung::solid) experiment.mesh = deepened(experiment, experiment.mesh);
  const StaticBench bench = make_static_bench(experiment, experiment.mesh, trials);
  StaticProtocol& protocol = *bench.protocol;
  Params p = protocol.nominal();
  std::vector<FreeParameter> free;
  for (const ParameterEstimate& e : record.fit.parameters) {
    FreeParameter& parameter = free.emplace_back();
    parameter.index = protocol.parameters().index(e.spec.id);
    p[parameter.index] = e.value;
  }
  Progress progress(options.quiet);
  progress.say(
      fmt::format("predicting {} rows with {} unknowns", rows.size(), protocol.scene().model->free_unknowns()));
  const Prediction prediction = protocol.predict(p, indices_of(free));
  const Eigen::VectorXd se = standard_errors(prediction, protocol.parameters(), p, free, record.fit.covariance);

  Json json{{"title", record.title}, {"data", record.simulated ? "simulated" : "measured"}};
  std::string header = "line,channel";
  for (size_t k = 0; k < record.control_ids.size(); ++k)
    header += "," + record.control_ids[k] + "_" + record.control_units[k];
  // The curve's band is what the fit leaves open; a new reading scatters by its own noise on top.
  std::string csv = header + ",predicted_m,standard_error_m,lower95_m,upper95_m,reading_lower95_m,reading_upper95_m\n";
  for (size_t i = 0; i < trials.readings.size(); ++i) {
    const Reading& reading = trials.readings[i];
    const std::string& channel = trials.channel_ids[static_cast<size_t>(reading.channel)];
    const double value = prediction.values[bench.row_of_reading[i]], error = se[bench.row_of_reading[i]];
    const int k = record.load_control;
    const double load = k < 0 ? 0.0
                              : load_in_newtons(experiment, trials.control_quantities[static_cast<size_t>(k)],
                                                reading.controls[static_cast<size_t>(k)]);
    const BenchFormat& format = experiment.bench;
    const double sigma = format.sigma_column.empty()
                             ? format.channels[static_cast<size_t>(reading.channel)].noise.sigma(value)
                             : sigma_at(record, channel, load);
    const double curve = 1.96 * error, noisy = 1.96 * std::hypot(error, sigma);
    csv += fmt::format("{},{}", reading.line, channel);
    for (double control : reading.controls) csv += fmt::format(",{:.10g}", control);
    csv += fmt::format(",{:.8g},{:.3g},{:.8g},{:.8g},{:.8g},{:.8g}\n", value, error, value - curve, value + curve,
                       value - noisy, value + noisy);
    json["rows"].push_back({{"line", reading.line},
                            {"channel", channel},
                            {"controls", reading.controls},
                            {"predicted_m", number(value)},
                            {"standard_error_m", number(error)},
                            {"interval95_m", {number(value - curve), number(value + curve)}},
                            {"reading_interval95_m", {number(value - noisy), number(value + noisy)}}});
  }
  if (options.json)
    fmt::print("{}\n", json.dump(2));
  else
    fmt::print("{}", csv);
  for (const std::string& failure : prediction.failures) fmt::print(stderr, "taut: {}\n", failure);
  for (const std::string& warning : warnings_after(protocol)) progress.say("warning: " + warning);
  if (interrupted(options)) return exit_interrupted;
  return prediction.complete() ? exit_ok : exit_solve;
}

int report_command(const CommandOptions& options) {
  const RunRecord record = read_run(options.target);
  write_run(record, options.target);
  if (options.json)
    fmt::print("{}\n", Json{{"report", (fs::path(options.target) / "report.html").string()}}.dump());
  else
    fmt::print("{}\n", (fs::path(options.target) / "report.html").string());
  return exit_ok;
}

}  // namespace taut

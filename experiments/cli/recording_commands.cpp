#include "experiments/cli/recording_commands.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "calib/benches/recordings.hpp"
#include "calib/data/ring_down.hpp"
#include "experiments/cli/session.hpp"
#include "experiments/cli/version.hpp"
#include "reports/report.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;
using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

bool interrupted(const CommandOptions& options) {
  return options.stop != nullptr && options.stop->load();
}

struct RecordingSession {
  Experiment experiment;
  std::vector<Sample> samples;
  RecordingBench bench;

  explicit RecordingSession(const CommandOptions& options) : experiment(read_experiment(options.target)) {
    experiment.equilibrium.stop = options.stop;
    if (options.threads > 0) experiment.threads = options.threads;
    samples = read_samples(experiment);
    bench = make_recording_bench(experiment, experiment.mesh, samples);
  }
  const std::string& recording(const Sample& sample) const {
    return experiment.recordings->recordings[static_cast<size_t>(sample.recording)].id;
  }
  const std::string& channel(const Sample& sample) const {
    return experiment.channels[static_cast<size_t>(sample.channel)].id;
  }
};

std::vector<std::pair<std::string, std::string>> describe_setup(const RecordingSession& session) {
  const Experiment& e = session.experiment;
  const Model& model = *session.bench.protocol->scene().model;
  std::vector<std::pair<std::string, std::string>> lines;
  lines.emplace_back("data", e.simulated ? "simulated" : "measured");
  lines.emplace_back("mesh",
                     fmt::format("{}D, {}: {} nodes, {} elements, {} unknowns", e.geometry.dimension, e.mesh.describe(),
                                 model.mesh().node_count(), model.mesh().element_count(), model.free_unknowns()));
  for (const MaterialSettings& material : e.materials) {
    std::string text = material.law;
    for (const auto& [id, value] : material.constants)
      text += fmt::format(", {} = {}", id, with_unit(value, id == "E" ? "Pa" : "1"));
    text += fmt::format(", density = {}", with_unit(*material.density, "kg/m3"));
    const auto& [mass, stiffness] = std::pair(e.dynamics.mass_damping, e.dynamics.stiffness_damping);
    if (mass.count(material.region) > 0)
      text += fmt::format(", damping {} of its mass", with_unit(mass.at(material.region), "1/s"));
    if (stiffness.count(material.region) > 0)
      text += fmt::format(", damping {} of its stiffness", with_unit(stiffness.at(material.region), "s"));
    lines.emplace_back("material " + material.region, text);
  }
  for (const LoadSettings& load : e.loads)
    lines.emplace_back("load " + load.id, fmt::format("{} on {}{}", name_of(load.quantity), load.on,
                                                      load.quantity == Quantity::mass ? ", with its inertia" : ""));
  lines.emplace_back("integrator", fmt::format("{}, steps of {}",
                                               e.dynamics.integrator == Integrator::bdf2 ? "BDF2" : "implicit Euler",
                                               with_unit(e.dynamics.step, "s")));
  for (size_t r = 0; r < e.recordings->recordings.size(); ++r) {
    const RecordingSettings& recording = e.recordings->recordings[r];
    std::string text;
    double first = 1e300, last = -1e300;
    int count = 0;
    for (const Sample& sample : session.samples) {
      if (sample.recording != static_cast<int>(r)) continue;
      first = std::min(first, sample.time);
      last = std::max(last, sample.time);
      ++count;
    }
    text = fmt::format("{} samples from {} to {}", count, with_unit(first, "s"), with_unit(last, "s"));
    for (const auto& [id, value] : recording.loads) text += fmt::format("; {} = {:.6g} (SI)", id, value);
    text += recording.held.empty() ? "; held at rest" : "";
    for (const auto& [id, value] : recording.held) text += fmt::format("; held by {} = {:.6g} (SI)", id, value);
    text += fmt::format(", let go at {}", with_unit(recording.release, "s"));
    lines.emplace_back("recording " + recording.id, text);
  }
  lines.emplace_back("trajectories", std::to_string(session.bench.protocol->trajectories()));
  return lines;
}

RunRecord start_record(const RecordingSession& session, const CommandOptions& options) {
  RunRecord record;
  record.title = session.experiment.title;
  record.simulated = session.experiment.simulated;
  record.over_time = true;
  record.setup = describe_setup(session);
  record.control_ids = {"time"};
  record.control_units = {"s"};
  record.load_label = "time";
  const ParameterTable& table = session.bench.protocol->parameters();
  record.parameter_ids = table.ids();
  for (const Sample& sample : session.samples) {
    ReadingRecord& line = record.readings.emplace_back();
    line.line = sample.line;
    line.trial = session.recording(sample);
    line.channel = session.channel(sample);
    line.controls = {sample.time};
    line.measured = sample.value;
    line.sigma = sample.sigma;
    line.predicted = line.prediction_se = std::nan("");
    record.series.push_back(session.recording(sample));
  }
  for (const ReferenceValue& reference : session.experiment.references) {
    const ParameterSpec& spec = table[table.index(reference.parameter)];
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

/// Frequency and decay of every channel of every recording; those too short for it are left out.
std::vector<SwingRecord> swings_of(const RecordingSession& session, const Eigen::VectorXd& predicted) {
  std::vector<SwingRecord> swings;
  for (size_t first = 0; first < session.samples.size();) {
    const Sample& sample = session.samples[first];
    std::vector<double> times, measured, simulated;
    size_t i = first;
    for (; i < session.samples.size() && session.samples[i].recording == sample.recording &&
           session.samples[i].channel == sample.channel;
         ++i) {
      times.push_back(session.samples[i].time);
      measured.push_back(session.samples[i].value);
      simulated.push_back(predicted[static_cast<Eigen::Index>(i)]);
    }
    const bool whole = std::all_of(simulated.begin(), simulated.end(), [](double y) { return std::isfinite(y); });
    if (times.size() >= 8 && whole) {
      const RingDown one = ring_down(times, measured), other = ring_down(times, simulated);
      swings.push_back(
          {session.recording(sample), session.channel(sample), one.frequency, one.decay, other.frequency, other.decay});
    }
    first = i;
  }
  return swings;
}

/// The simulated motions from the first to the last sample of each recording and channel.
std::vector<CurveRecord> make_curves(const RecordingSession& session, const Params& p) {
  constexpr int points = 240;
  std::vector<CurveRecord> curves;
  std::vector<Sample> dense;
  for (size_t i = 0; i < session.samples.size(); ++i) {
    const Sample& sample = session.samples[i];
    const bool same = i + 1 < session.samples.size() && session.samples[i + 1].recording == sample.recording &&
                      session.samples[i + 1].channel == sample.channel;
    if (curves.empty() || curves.back().series != session.recording(sample) ||
        curves.back().channel != session.channel(sample)) {
      CurveRecord& curve = curves.emplace_back();
      curve.channel = session.channel(sample);
      curve.series = session.recording(sample);
      curve.load = {sample.time};
    }
    if (same) continue;
    const double first = curves.back().load.front();
    curves.back().load.clear();
    for (int k = 0; k <= points; ++k) {
      Sample& one = dense.emplace_back(sample);
      one.time = first + (sample.time - first) * k / points;
      curves.back().load.push_back(one.time);
    }
  }
  const RecordingBench bench = make_recording_bench(session.experiment, session.experiment.mesh, dense);
  const Prediction prediction = bench.protocol->predict(p, {});
  Eigen::Index row = 0;
  for (CurveRecord& curve : curves) {
    for (size_t k = 0; k < curve.load.size(); ++k) curve.value.push_back(prediction.values[row++]);
    curve.se.assign(curve.load.size(), std::nan(""));
  }
  return curves;
}

VariantRecord fit_variant(const RecordingSession& session, const VariantSettings& variant, const FitResult& main,
                          const CommandOptions& options, Progress& progress) {
  const Clock::time_point start = Clock::now();
  const RecordingBench bench = make_recording_bench(session.experiment, variant.mesh, session.samples);
  std::vector<FreeParameter> free = free_parameters(session.experiment, *bench.protocol);
  for (size_t j = 0; j < free.size(); ++j) free[j].start = main.parameters[j].value;
  FitOptions how = fit_options(options, session.experiment, session.bench.protocol->parameters(), free, progress,
                               "variant " + variant.name);
  how.profiles = false;
  const FitResult result = fit(*bench.protocol, bench.measurements, free, how);
  return as_variant(variant.name, variant.mesh, *bench.protocol->scene().model, result, seconds_since(start));
}

/// Copies the experiment file and the recordings, which keep their names.
void copy_inputs(const RecordingSession& session, const std::string& folder, RunRecord& record) {
  const auto copy = [&](const std::string& from, const std::string& to) {
    write_file((fs::path(folder) / to).string(), read_file(from));
    record.provenance.inputs.emplace_back(from, sha256_of(from));
  };
  record.experiment_file = "experiment.toml";
  copy(session.experiment.path, record.experiment_file);
  for (const RecordingSettings& recording : session.experiment.recordings->recordings) {
    const std::string name = recording.id + ".csv";
    copy(recording.path, name);
    record.data_file += (record.data_file.empty() ? "" : ", ") + name;
  }
}

void print_swings(const RunRecord& record) {
  fmt::print("{:<16} {:<12} {:>12} {:>12} {:>8} {:>12} {:>12} {:>8}\n", "recording", "channel", "frequency",
             "simulated", "", "decay", "simulated", "");
  for (const SwingRecord& s : record.swings) {
    fmt::print("{:<16} {:<12} {:>9.3f} Hz {:>9.3f} Hz {:>+6.1f} % {:>8.3f} 1/s {:>8.3f} 1/s {:>+6.1f} %\n", s.recording,
               s.channel, s.frequency, s.predicted_frequency, 100 * (s.predicted_frequency / s.frequency - 1), s.decay,
               s.predicted_decay, 100 * (s.predicted_decay / s.decay - 1));
  }
}

}  // namespace

int check_recordings(const CommandOptions& options) {
  const RecordingSession session(options);
  const RecordingProtocol& protocol = *session.bench.protocol;
  print_check(start_record(session, options), protocol.parameters(), free_parameters(session.experiment, protocol),
              options.json);
  return exit_ok;
}

int replay_recordings(const CommandOptions& options) {
  const RecordingSession session(options);
  Progress progress(options.quiet);
  RecordingProtocol& protocol = *session.bench.protocol;
  RunRecord record = start_record(session, options);
  Params p = protocol.nominal();
  for (const auto& [id, text] : options.set) {
    const int index = protocol.parameters().index(id);
    p[index] = parse_quantity(text, quantity_of_si_unit(protocol.parameters()[index].unit), "--set " + id);
    protocol.parameters().check(index, p[index]);
  }
  const Clock::time_point start = Clock::now();
  const Prediction prediction = protocol.predict(p, {});
  record.replay_seconds = seconds_since(start);
  for (size_t i = 0; i < record.readings.size(); ++i)
    record.readings[i].predicted = prediction.values[static_cast<Eigen::Index>(i)];
  record.swings = swings_of(session, prediction.values);
  const std::string folder = run_folder(options);
  write_file((fs::path(folder) / "predictions.csv").string(), predictions_csv(record));
  if (options.json) {
    Json json{{"title", record.title}, {"seconds", record.replay_seconds}, {"failures", prediction.failures}};
    for (const SwingRecord& s : record.swings)
      json["swings"].push_back({{"recording", s.recording},
                                {"channel", s.channel},
                                {"frequency_Hz", s.frequency},
                                {"predicted_frequency_Hz", s.predicted_frequency},
                                {"decay_per_s", s.decay},
                                {"predicted_decay_per_s", s.predicted_decay}});
    fmt::print("{}\n", json.dump(2));
  } else {
    if (record.simulated) fmt::print("SIMULATED DATA: the recordings were made by a program, not measured.\n");
    print_swings(record);
  }
  for (const std::string& failure : prediction.failures) fmt::print(stderr, "taut: {}\n", failure);
  progress.say(fmt::format("{:.2f} s, {} trajectories, {} steps, {} factorisations; {}/predictions.csv",
                           record.replay_seconds, protocol.trajectories(), protocol.steps(), protocol.factorisations(),
                           folder));
  if (interrupted(options)) return exit_interrupted;
  return prediction.complete() ? exit_ok : exit_solve;
}

int fit_recordings(const CommandOptions& options) {
  const Clock::time_point start = Clock::now();
  const RecordingSession session(options);
  Progress progress(options.quiet);
  RecordingProtocol& protocol = *session.bench.protocol;
  const std::vector<FreeParameter> free = free_parameters(session.experiment, protocol);
  RunRecord record = start_record(session, options);
  const std::string folder = run_folder(options);
  progress.say(fmt::format("fitting {} samples of {} recordings, {} trajectories with {} unknowns",
                           session.samples.size(), protocol.recordings().size(), protocol.trajectories(),
                           protocol.scene().model->free_unknowns()));
  record.fit =
      fit(protocol, session.bench.measurements, free,
          fit_options(options, session.experiment, session.bench.protocol->parameters(), free, progress, "fit"));
  record.main =
      as_variant("this fit", session.experiment.mesh, *protocol.scene().model, record.fit, seconds_since(start));
  if (record.fit.status == FitStatus::start_failed) {
    for (const std::string& failure : record.fit.failures) fmt::print(stderr, "taut: {}\n", failure);
    fmt::print(stderr, "taut: the simulation failed at the start of the fit; change the start values\n");
    return interrupted(options) ? exit_interrupted : exit_solve;
  }
  copy_inputs(session, folder, record);
  for (const std::string& failure : record.fit.failures) record.remarks.push_back("survived in the fit: " + failure);
  if (!interrupted(options) && record.fit.predicted.size() > 0) {
    for (size_t i = 0; i < record.readings.size(); ++i) {
      record.readings[i].predicted = record.fit.predicted[static_cast<Eigen::Index>(i)];
      record.readings[i].prediction_se = record.fit.prediction_se[static_cast<Eigen::Index>(i)];
    }
    record.swings = swings_of(session, record.fit.predicted);
    progress.show("drawing curves");
    const Clock::time_point replay = Clock::now();
    record.curves = make_curves(session, record.fit.p);
    record.replay_seconds = seconds_since(replay);
  }
  for (const VariantSettings& variant : session.experiment.variants) {
    if (interrupted(options) || !options.variants) break;
    record.variants.push_back(fit_variant(session, variant, record.fit, options, progress));
  }
  if (interrupted(options)) record.fit.message = "interrupted";
  record.provenance.wall_seconds = seconds_since(start);
  write_run(record, folder);
  if (options.json) {
    fmt::print("{}\n", to_json(record));
  } else {
    print_fit(record);
    print_swings(record);
  }
  const FitCost& search = record.fit.search;
  progress.say(fmt::format("{:.1f} s in all; fit {:.1f} s with {} factorisations in {} evaluations",
                           record.provenance.wall_seconds, search.seconds, search.factorisations,
                           record.fit.evaluations));
  progress.say("report: " + (fs::path(folder) / "report.html").string());
  if (interrupted(options)) return exit_interrupted;
  if (record.fit.status == FitStatus::converged) return exit_ok;
  fmt::print(stderr, "taut: the fit did not converge: {}\n", record.fit.message);
  return exit_fit;
}

}  // namespace taut

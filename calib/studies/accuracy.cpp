#include "calib/studies/accuracy.hpp"

#include <fmt/format.h>

#include <Eigen/SVD>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <filesystem>
#include <fstream>
#include <limits>
#include <mutex>
#include <sstream>
#include <thread>

#include "calib/benches/recordings.hpp"
#include "calib/data/csv_table.hpp"
#include "calib/studies/discretisation.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"
#include "sim/robots/simulate.hpp"
#include "sim/shapes/geometry.hpp"

namespace taut {
namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

// ---- settings

/// An element with its formulation, and how a legend calls it.
struct Element {
  int order;
  Formulation formulation;
  std::string name;
};

std::vector<Element> elements_for(bool locking_free) {
  std::vector<Element> elements{{1, Formulation::standard, "linear elements"},
                                {2, Formulation::standard, "quadratic elements"}};
  if (locking_free) elements.push_back({2, Formulation::locking_free, "quadratic, locking-free"});
  return elements;
}

/// How much finer than the file's own mesh.
std::vector<double> mesh_factors(int dimension, int order) {
  if (dimension == 2) return {0.5, 0.7, 1, 1.4, 2};
  return order == 1 ? std::vector{0.65, 1.0, 1.45, 2.0} : std::vector{0.43, 0.65, 1.0, 1.45};
}

/// Work of one factorisation, in no unit: nested dissection takes n^1.5 in 2D and n^2 in 3D.
double work(double unknowns, int dimension) {
  return std::pow(unknowns, dimension == 2 ? 1.5 : 2.0);
}

double size_of_elements(const Mesh& mesh) {
  return std::pow(static_cast<double>(mesh.element_count()), -1.0 / mesh.dimension());
}

void add_setting(AccuracyStudy& study, AccuracySetting setting) {
  const bool known = std::any_of(study.settings.begin(), study.settings.end(),
                                 [&](const AccuracySetting& other) { return other.name == setting.name; });
  if (!known) study.settings.push_back(std::move(setting));
}

/// All rows of a bench at the file's own parameters, from rest.
AccuracyRun replay(const Experiment& experiment, Protocol& protocol, int unknowns) {
  std::vector<int> free;
  for (const FreeParameter& parameter : free_parameters(experiment, protocol)) free.push_back(parameter.index);
  AccuracyRun run;
  run.unknowns = unknowns;
  Prediction prediction;
  // Quick replays are repeated, each from the start of the path; the fastest was disturbed least.
  const Clock::time_point start = Clock::now();
  for (int repeat = 0; repeat < 3 && (repeat == 0 || seconds_since(start) < 1); ++repeat) {
    protocol.forget();
    const int before = protocol.factorisations();
    const Clock::time_point began = Clock::now();
    prediction = protocol.predict(protocol.nominal(), free);
    run.seconds = repeat == 0 ? seconds_since(began) : std::min(run.seconds, seconds_since(began));
    run.factorisations = protocol.factorisations() - before;
  }
  run.values = prediction.values;
  run.derivatives = prediction.derivatives;
  if (!prediction.complete()) run.failure = prediction.failures.front();
  return run;
}

AccuracyRun replay(Experiment experiment, const MeshSettings& mesh, const Trials& trials,
                   const std::atomic<bool>& stop) {
  experiment.equilibrium.stop = &stop;
  const StaticBench bench = make_static_bench(experiment, mesh, trials);
  return replay(experiment, *bench.protocol, bench.protocol->scene().model->free_unknowns());
}

AccuracyRun replay(Experiment experiment, const MeshSettings& mesh, const std::vector<Sample>& samples,
                   const std::atomic<bool>& stop) {
  experiment.equilibrium.stop = &stop;
  const RecordingBench bench = make_recording_bench(experiment, mesh, samples);
  return replay(experiment, *bench.protocol, bench.protocol->scene().model->free_unknowns());
}

constexpr int instants = 101;

/// The channels of a simulation at even times, one curve after the other.
AccuracyRun replay(const Simulation& simulation, const std::atomic<bool>& stop) {
  const Robot robot = make_robot(simulation);
  SimulateOptions options;
  options.stop = &stop;
  const SimulationResult result = simulate(simulation, robot, options);
  AccuracyRun run;
  run.unknowns = robot.scene.model->free_unknowns();
  run.seconds = result.seconds;
  run.factorisations = result.factorisations;
  run.failure = result.failure;
  if (run.failure.empty() && result.intersecting > 0)
    run.failure = fmt::format("boundaries cross in {} of {} states", result.intersecting, result.states.size());
  if (run.failure.empty() && !(result.smallest_jacobian > 0)) run.failure = "elements have turned inside out";
  if (!run.failure.empty()) return run;
  std::vector<double> values;
  for (size_t k = 0; k < robot.readings.size(); ++k) {
    if (robot.readings[k].part >= 0) continue;
    const std::vector<double>& y = result.readings[k];
    size_t next = 1;
    for (int i = 0; i < instants; ++i) {
      const double t = simulation.duration * i / (instants - 1);
      while (next + 1 < result.times.size() && result.times[next] < t) ++next;
      const double t0 = result.times[next - 1], t1 = result.times[next];
      const double s = std::clamp((t - t0) / (t1 - t0), 0.0, 1.0);
      values.push_back((1 - s) * y[next - 1] + s * y[next]);
    }
  }
  run.values = Eigen::Map<const Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
  return run;
}

bool needs_locking_free(const std::vector<MaterialSettings>& materials) {
  return std::any_of(materials.begin(), materials.end(), [](const MaterialSettings& material) {
    const auto nu = material.constants.find("nu");
    return nu != material.constants.end() && nu->second > 0.4;
  });
}

const char* name_of(SimulationMethod method) {
  switch (method) {
    case SimulationMethod::implicit_euler:
      return "implicit Euler";
    case SimulationMethod::bdf2:
      return "BDF2";
    case SimulationMethod::cvode:
      return "CVODE";
    case SimulationMethod::arkode_implicit:
      return "ARKODE, implicit";
    case SimulationMethod::arkode_explicit:
      return "ARKODE, explicit";
    case SimulationMethod::quasi_static:
      break;
  }
  return "equilibria";
}

// ---- the table on disk

constexpr const char* header =
    "fingerprint,axis,setting,in_use,unknowns,seconds,factorisations,failure,values,derivatives\n";

std::string quoted(const std::string& text) {
  std::string out = "\"";
  for (char c : text) out += c == '"' ? std::string("\"\"") : std::string(1, c == '\n' ? ' ' : c);
  return out + "\"";
}

std::string packed(const double* values, Eigen::Index count) {
  std::string text;
  for (Eigen::Index i = 0; i < count; ++i) text += fmt::format("{}{:.12g}", i == 0 ? "" : " ", values[i]);
  return text;
}

std::vector<double> unpacked(const std::string& text) {
  std::vector<double> values;
  std::istringstream in(text);
  for (std::string word; in >> word;) values.push_back(std::strtod(word.c_str(), nullptr));
  return values;
}

std::string row_of(const std::string& fingerprint, const AccuracySetting& setting, const AccuracyRun& run) {
  const bool good = run.failure.empty();
  return fmt::format("{},{},{},{},{},{:.6g},{},{},{},{}\n", fingerprint, quoted(setting.axis), quoted(setting.name),
                     setting.in_use ? 1 : 0, run.unknowns, run.seconds, run.factorisations, quoted(run.failure),
                     good ? packed(run.values.data(), run.values.size()) : "",
                     good ? packed(run.derivatives.data(), run.derivatives.size()) : "");
}

std::map<std::string, AccuracyRun> read_runs(const AccuracyStudy& study, const AccuracyOptions& options) {
  std::map<std::string, AccuracyRun> runs;
  if (!std::filesystem::exists(options.file)) return runs;
  const CsvTable table = read_csv(options.file);
  for (const CsvTable::Row& row : table.rows) {
    if (row.cells.size() != 10 || row.cells[0] != options.fingerprint) continue;  // half written, or of another file
    AccuracyRun run;
    run.unknowns = std::atoi(row.cells[4].c_str());
    run.seconds = std::strtod(row.cells[5].c_str(), nullptr);
    run.factorisations = std::atoi(row.cells[6].c_str());
    run.failure = row.cells[7];
    const std::vector<double> values = unpacked(row.cells[8]), derivatives = unpacked(row.cells[9]);
    if (run.failure.empty() && (values.empty() || derivatives.size() != values.size() * study.free.size())) continue;
    const Eigen::Index n = static_cast<Eigen::Index>(values.size());
    run.values = Eigen::Map<const Eigen::VectorXd>(values.data(), n);
    if (!derivatives.empty())
      run.derivatives =
          Eigen::Map<const Eigen::MatrixXd>(derivatives.data(), n, static_cast<Eigen::Index>(study.free.size()));
    runs[row.cells[2]] = run;
  }
  return runs;
}

/// Raises a flag after some seconds, or when another one is raised.
class Deadline {
 public:
  Deadline(double seconds, const std::atomic<bool>* stop)
      : thread_([this, seconds, stop] {
          const Clock::time_point start = Clock::now();
          std::unique_lock lock(mutex_);
          while (!done_) {
            late_ = seconds_since(start) > seconds;
            if (late_ || (stop != nullptr && stop->load())) raised_ = true;
            if (raised_) return;
            wake_.wait_for(lock, std::chrono::milliseconds(50));
          }
        }) {}
  ~Deadline() {
    {
      const std::lock_guard lock(mutex_);
      done_ = true;
    }
    wake_.notify_all();
    thread_.join();
  }
  Deadline(const Deadline&) = delete;
  Deadline& operator=(const Deadline&) = delete;

  const std::atomic<bool>& flag() const { return raised_; }
  bool late() const { return late_; }

 private:
  std::atomic<bool> raised_{false}, late_{false};
  bool done_ = false;
  std::mutex mutex_;
  std::condition_variable wake_;
  std::thread thread_;
};

double root_mean_square(const Eigen::VectorXd& v) {
  return v.size() == 0 ? 0 : std::sqrt(v.squaredNorm() / static_cast<double>(v.size()));
}

/// What errors of each value are relative to.
Eigen::VectorXd scales_of(const AccuracyStudy& study, const Eigen::VectorXd& values) {
  if (study.series.empty()) return values.cwiseAbs().cwiseMax(0.01 * values.cwiseAbs().maxCoeff());
  std::map<int, std::pair<double, double>> ranges;
  for (Eigen::Index i = 0; i < values.size(); ++i) {
    auto& [low, high] = ranges.try_emplace(study.series[static_cast<size_t>(i)], values[i], values[i]).first->second;
    low = std::min(low, values[i]);
    high = std::max(high, values[i]);
  }
  Eigen::VectorXd scales(values.size());
  for (Eigen::Index i = 0; i < values.size(); ++i) {
    const auto& [low, high] = ranges.at(study.series[static_cast<size_t>(i)]);
    scales[i] = std::max(high - low, 1e-300);
  }
  return scales;
}

/// What an error of a free parameter is relative to: its value if it is logarithmic, else its range.
double unit_of(const AccuracyStudy& study, size_t j) {
  const FreeParameter& parameter = study.free[j];
  const double value = study.nominal[parameter.index], range = parameter.upper - parameter.lower;
  if (study.table[parameter.index].logarithmic) return value;
  return std::isfinite(range) ? range : std::max(std::abs(value), 1e-12);
}

/// Relative change of each free parameter if readings that are `truth` are fitted with this model.
std::vector<double> parameter_errors(const AccuracyStudy& study, const Eigen::VectorXd& values,
                                     const Eigen::MatrixXd& derivatives, const Eigen::VectorXd& truth) {
  if (study.free.empty()) return {};
  std::vector<Measurement> measurements;
  for (Eigen::Index i = 0; i < truth.size(); ++i) {
    const int row = static_cast<int>(i);
    measurements.push_back({row, truth[i], study.sigma[static_cast<size_t>(i)], row});
  }
  const Eigen::VectorXd step =
      gauss_newton_step({values, derivatives, {}}, measurements, study.table, study.nominal, study.free);
  std::vector<double> errors;
  for (size_t j = 0; j < study.free.size(); ++j) {
    const FreeParameter& parameter = study.free[j];
    const double change = step[static_cast<Eigen::Index>(j)];
    errors.push_back(study.table[parameter.index].logarithmic ? std::expm1(change) : change / unit_of(study, j));
  }
  return errors;
}

/// Standard errors of the free parameters from the noise of the readings, relative, first order.
std::vector<double> parameter_noise(const AccuracyStudy& study, const Eigen::MatrixXd& derivatives) {
  if (study.free.empty()) return {};
  Eigen::MatrixXd J = derivatives;
  for (Eigen::Index i = 0; i < J.rows(); ++i) J.row(i) /= study.sigma[static_cast<size_t>(i)];
  for (size_t j = 0; j < study.free.size(); ++j) J.col(static_cast<Eigen::Index>(j)) *= unit_of(study, j);
  const Eigen::JacobiSVD<Eigen::MatrixXd> svd(J, Eigen::ComputeThinU | Eigen::ComputeThinV);
  const Eigen::VectorXd errors =
      (svd.matrixV() * svd.singularValues().cwiseMax(0.01).cwiseInverse().asDiagonal()).rowwise().norm();
  return {errors.data(), errors.data() + errors.size()};
}

/// Every n-th sample, so that a recording has no more of a channel than a simulation.
std::vector<Sample> thinned(const std::vector<Sample>& samples) {
  std::map<std::pair<int, int>, int> counts, seen;
  for (const Sample& sample : samples) ++counts[{sample.recording, sample.channel}];
  std::vector<Sample> kept;
  for (Sample sample : samples) {
    const int every = 1 + counts[{sample.recording, sample.channel}] / instants;
    if (seen[{sample.recording, sample.channel}]++ % every != 0) continue;
    sample.sigma /= std::sqrt(every);  // it stands for the others too
    kept.push_back(sample);
  }
  return kept;
}

AccuracyStudy study_of_recordings(const Experiment& experiment) {
  AccuracyStudy study;
  study.title = experiment.title;
  study.path = experiment.path;
  study.simulated = experiment.simulated;
  study.result = "recorded motions, at the parameters that the file starts from";
  study.highest_order = {{"mesh", 2}, {"step", 2}};
  const std::vector<Sample> samples = thinned(read_samples(experiment));
  const RecordingBench bench = make_recording_bench(experiment, experiment.mesh, samples);
  study.table = bench.protocol->parameters();
  study.nominal = bench.protocol->nominal();
  study.free = free_parameters(experiment, *bench.protocol);
  for (const Sample& sample : samples) {
    study.series.push_back(sample.recording * static_cast<int>(experiment.channels.size()) + sample.channel);
    study.sigma.push_back(sample.sigma);
  }
  const MeshSettings& own = experiment.mesh;
  const MeshSettings best = most_accurate(experiment, own);
  auto add = [&](const std::string& axis, const std::string& name, const Experiment& e, const MeshSettings& mesh,
                 const std::string& sequence, double size) {
    AccuracySetting setting;
    setting.axis = axis;
    setting.name = name;
    const Mesh made = make_mesh(e, mesh);
    setting.cost = work(static_cast<double>(made.X.size()), made.dimension()) / e.dynamics.step;
    if (!sequence.empty()) setting.sequences[sequence] = sequence == "mesh" ? size_of_elements(made) : size;
    setting.run = [e, mesh, samples](const std::atomic<bool>& stop) { return replay(e, mesh, samples, stop); };
    add_setting(study, setting);
    return study.settings.size() - 1;
  };
  for (const Element& element : elements_for(best.formulation == Formulation::locking_free)) {
    for (double factor : {0.5, 0.7, 1.0, 1.4}) {
      MeshSettings mesh = refined(own, experiment.geometry, factor);
      mesh.order = element.order;
      mesh.formulation = element.formulation;
      const bool ladder = element.order == best.order && element.formulation == best.formulation;
      const size_t i = add(element.name, mesh.describe(), experiment, mesh, ladder ? "mesh" : "", 0);
      if (factor != 1 || element.order != own.order || element.formulation != own.formulation) continue;
      study.settings[i].in_use = true;
      study.settings[i].integrator = experiment.dynamics.integrator == Integrator::bdf2 ? "BDF2" : "implicit Euler";
      if (experiment.dynamics.integrator == Integrator::bdf2)
        study.settings[i].sequences["step"] = experiment.dynamics.step;
    }
  }
  for (Integrator integrator : {Integrator::implicit_euler, Integrator::bdf2}) {
    const std::string name = integrator == Integrator::bdf2 ? "BDF2" : "implicit Euler";
    for (double factor : {4.0, 2.0, 1.0, 0.5}) {
      if (integrator == experiment.dynamics.integrator && factor == 1) continue;
      Experiment e = experiment;
      e.dynamics.integrator = integrator;
      e.dynamics.step = factor * experiment.dynamics.step;
      const size_t i = add(name, fmt::format("{}, steps of {}", name, with_unit(e.dynamics.step, "s", 3)), e, own,
                           integrator == Integrator::bdf2 ? "step" : "", e.dynamics.step);
      study.settings[i].integrator = name;
    }
  }
  return study;
}

}  // namespace

AccuracyStudy accuracy_study(const Experiment& experiment) {
  if (experiment.recordings) return study_of_recordings(experiment);
  AccuracyStudy study;
  study.title = experiment.title;
  study.path = experiment.path;
  study.simulated = experiment.simulated;
  study.result = "displacements of all rows, at the parameters that the file starts from";
  study.highest_order = {{"mesh", 2}, {"contact gap", 1}};
  const Trials trials = read_trials(experiment.bench);
  const StaticBench bench = make_static_bench(experiment, experiment.mesh, trials);
  study.table = bench.protocol->parameters();
  study.nominal = bench.protocol->nominal();
  study.free = free_parameters(experiment, *bench.protocol);
  study.sigma.assign(static_cast<size_t>(bench.protocol->row_count()), 0);
  std::vector<int> repeats(study.sigma.size(), 0);
  for (const Measurement& m : bench.measurements) {
    study.sigma[static_cast<size_t>(m.row)] += m.sigma * m.sigma;
    ++repeats[static_cast<size_t>(m.row)];
  }
  for (size_t i = 0; i < repeats.size(); ++i) study.sigma[i] = std::sqrt(study.sigma[i]) / repeats[i];

  const MeshSettings& own = experiment.mesh;
  const Mesh own_mesh = make_mesh(experiment, own);
  const int d = own_mesh.dimension();
  const double own_work = work(static_cast<double>(own_mesh.X.size()), d);
  const MeshSettings best = most_accurate(experiment, own);
  const double own_gap = contact_gap(own, own_mesh.diagonal());
  const bool plane = experiment.geometry.dimension == 2;
  const bool volumes = !plane || experiment.geometry.plane == Plane::strain;
  auto setting = [&](const std::string& axis, const std::string& name, const Experiment& e, const MeshSettings& mesh,
                     double cost) {
    AccuracySetting result;
    result.axis = axis;
    result.name = name;
    result.cost = cost;
    result.run = [e, mesh, trials](const std::atomic<bool>& stop) { return replay(e, mesh, trials, stop); };
    return result;
  };
  const bool locking_free =
      own.formulation == Formulation::locking_free || (volumes && needs_locking_free(experiment.materials));
  for (const Element& element : elements_for(locking_free)) {
    for (double factor : mesh_factors(d, element.order)) {
      MeshSettings mesh = refined(own, experiment.geometry, factor);
      mesh.order = element.order;
      mesh.formulation = element.formulation;
      double size = 0, cost = own_work;
      try {
        const Mesh made = make_mesh(experiment, mesh);
        size = size_of_elements(made);
        cost = work(static_cast<double>(made.X.size()), d);
      } catch (const InputError&) {
        continue;  // this geometry cannot be meshed so coarsely
      }
      AccuracySetting one = setting(element.name, mesh.describe(), experiment, mesh, cost);
      one.in_use = factor == 1 && element.order == own.order && element.formulation == own.formulation;
      if (one.in_use && experiment.contact.on) one.sequences["contact gap"] = own_gap;
      if (element.order == best.order && element.formulation == best.formulation) one.sequences["mesh"] = size;
      add_setting(study, one);
    }
  }
  for (double tolerance : {1e-5, 1e-7, 1e-9, 1e-11}) {
    Experiment e = experiment;
    e.equilibrium.step_tolerance = tolerance;
    if (tolerance != experiment.equilibrium.step_tolerance)
      add_setting(study, setting("step tolerance", fmt::format("step tolerance {:.0e}", tolerance), e, own, own_work));
  }
  for (int steps : {1, 2, 4, 8}) {
    Experiment e = experiment;
    e.equilibrium.load_steps = steps;
    if (steps != experiment.equilibrium.load_steps)
      add_setting(study, setting("load steps", fmt::format("{} load step{}", steps, steps == 1 ? "" : "s"), e, own,
                                 own_work * steps));
  }
  for (double factor : {4.0, 2.0, 0.5, 0.25}) {
    if (!experiment.contact.on) break;
    MeshSettings mesh = own;
    mesh.contact_gap = factor * own_gap;
    AccuracySetting one = setting("contact gap", "contact gap " + with_unit(mesh.contact_gap, "m", 3), experiment, mesh,
                                  own_work * (1 + 0.1 / factor));
    one.sequences["contact gap"] = mesh.contact_gap;
    add_setting(study, one);
  }
  if (plane) {
    Experiment e = experiment;
    MeshSettings mesh = own;
    const bool strain = experiment.geometry.plane == Plane::strain;
    e.geometry.plane = strain ? Plane::stress : Plane::strain;
    if (strain) mesh.formulation = Formulation::standard;
    const std::string name = strain ? "plane stress" : "plane strain";
    add_setting(study, setting(name, name, e, mesh, own_work));
    // With contact a solid is a matter of hours.
    for (int depth : {1, 2}) {
      if (experiment.contact.on) break;
      mesh = own;
      mesh.depth_cells = depth;
      const Mesh made = make_mesh(experiment, mesh);
      add_setting(study, setting("as a solid", fmt::format("as a solid, {} cells across half of it", depth), experiment,
                                 mesh, work(static_cast<double>(made.X.size()), 3)));
    }
  }
  return study;
}

AccuracyStudy accuracy_study(const Simulation& simulation) {
  if (simulation.method == SimulationMethod::quasi_static)
    throw InputError(
        fmt::format("{}: a simulation through equilibria has no integrator to compare; chart one over time, or an "
                    "experiment with a bench",
                    simulation.path));
  AccuracyStudy study;
  study.title = simulation.title;
  study.path = simulation.path;
  study.simulated = true;
  study.result = "channels over time, forces between bodies left out";
  study.highest_order = {{"mesh", 2}, {"contact gap", 1}, {"step", 2}};
  int curves = 0;
  for (const RobotChannel& channel : simulation.channels) {
    if (channel.kind == RobotChannel::Kind::net_force) continue;
    study.series.insert(study.series.end(), instants, curves++);
  }
  if (curves == 0)
    throw InputError(
        fmt::format("{}: there is no channel to compare but net forces; add a [[channel]] of kind "
                    "position, displacement, rotation or tension",
                    simulation.path));
  auto size_of = [](const Simulation& s) {
    int unknowns = 0, elements = 0;
    for (const BodySettings& body : s.bodies) {
      const Mesh mesh = make_mesh(body.geometry, body.mesh, s.contact, false);
      unknowns += static_cast<int>(mesh.X.size());
      elements += mesh.element_count();
    }
    return std::pair(static_cast<double>(unknowns), std::pow(static_cast<double>(elements), -1.0 / s.dimension));
  };
  auto setting = [&](const std::string& axis, const std::string& name, const Simulation& s) {
    AccuracySetting result;
    result.axis = axis;
    result.name = name;
    result.cost = work(size_of(s).first, s.dimension) * s.duration / s.step;
    result.run = [s](const std::atomic<bool>& stop) { return replay(s, stop); };
    return result;
  };
  const int own_order = simulation.bodies.front().mesh.order;
  const Formulation own_formulation = simulation.bodies.front().mesh.formulation;
  for (const Element& element : elements_for(own_formulation == Formulation::locking_free)) {
    for (double factor : {0.5, 0.7, 1.0, 1.4}) {
      Simulation s = simulation;
      for (BodySettings& body : s.bodies) {
        body.mesh = refined(body.mesh, body.geometry, factor);
        body.mesh.order = element.order;
        body.mesh.formulation = element.formulation;
      }
      AccuracySetting one;
      try {
        one = setting(
            element.name,
            element.name + (factor == 1 ? ", the file's mesh" : fmt::format(", mesh {:g} times as fine", factor)), s);
        if (element.order == 2 && element.formulation == own_formulation) one.sequences["mesh"] = size_of(s).second;
      } catch (const InputError&) {
        continue;
      }
      one.in_use = factor == 1 && element.order == own_order && element.formulation == own_formulation;
      if (one.in_use) {
        one.integrator = name_of(simulation.method);
        one.name += fmt::format(", {}, steps of {}", one.integrator, with_unit(simulation.step, "s", 3));
      }
      if (one.in_use && simulation.contact) one.sequences["contact gap"] = simulation.contact_gap;
      if (one.in_use && simulation.method == SimulationMethod::bdf2) one.sequences["step"] = simulation.step;
      add_setting(study, one);
    }
  }
  for (SimulationMethod method : {SimulationMethod::implicit_euler, SimulationMethod::bdf2}) {
    for (double factor : {4.0, 2.0, 1.0, 0.5, 0.25}) {
      if (method == simulation.method && factor == 1) continue;
      Simulation s = simulation;
      s.method = method;
      s.tolerance = 0;
      s.step = factor * simulation.step;
      AccuracySetting one =
          setting(name_of(method), fmt::format("{}, steps of {}", name_of(method), with_unit(s.step, "s", 3)), s);
      if (method == SimulationMethod::bdf2) one.sequences["step"] = s.step;
      one.integrator = name_of(method);
      add_setting(study, one);
    }
  }
  for (SimulationMethod method :
       {SimulationMethod::cvode, SimulationMethod::arkode_implicit, SimulationMethod::arkode_explicit}) {
    for (double tolerance : {1e-2, 1e-4}) {
      Simulation s = simulation;
      s.method = method;
      s.tolerance = tolerance;
      AccuracySetting one =
          setting(name_of(method), fmt::format("{}, tolerance {:.0e}", name_of(method), tolerance), s);
      one.may_hang = true;
      one.integrator = name_of(method);
      add_setting(study, one);
    }
  }
  for (double factor : {4.0, 2.0, 0.5, 0.25}) {
    if (!simulation.contact) break;
    Simulation s = simulation;
    s.contact_gap = factor * simulation.contact_gap;
    AccuracySetting one = setting("contact gap", "contact gap " + with_unit(s.contact_gap, "m", 3), s);
    one.sequences["contact gap"] = s.contact_gap;
    add_setting(study, one);
  }
  for (double tolerance : {1e-5, 1e-7, 1e-11}) {
    Simulation s = simulation;
    s.equilibrium.step_tolerance = tolerance;
    if (tolerance != simulation.equilibrium.step_tolerance)
      add_setting(study, setting("step tolerance", fmt::format("step tolerance {:.0e}", tolerance), s));
  }
  return study;
}

std::vector<std::optional<AccuracyRun>> run_settings(const AccuracyStudy& study, const AccuracyOptions& options) {
  const std::map<std::string, AccuracyRun> known = read_runs(study, options);
  std::vector<std::optional<AccuracyRun>> runs(study.settings.size());
  std::vector<size_t> order;
  double rate = 0;  // seconds per unit of cost, by the run before
  for (size_t i = 0; i < runs.size(); ++i) {
    const auto found = known.find(study.settings[i].name);
    if (found != known.end()) {
      runs[i] = found->second;
      if (study.settings[i].in_use) rate = runs[i]->seconds / study.settings[i].cost;
    } else {
      order.push_back(i);
    }
  }
  std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) {
    const AccuracySetting &one = study.settings[a], &other = study.settings[b];
    if (one.in_use != other.in_use) return one.in_use;
    if (one.may_hang != other.may_hang) return other.may_hang;
    return one.cost < other.cost;
  });
  const Clock::time_point start = Clock::now();
  bool any = false;
  for (size_t i : order) {
    if (options.stop != nullptr && options.stop->load()) break;
    const AccuracySetting& setting = study.settings[i];
    const double left = options.budget - seconds_since(start);
    if (any && (left <= 0 || (!setting.may_hang && rate * setting.cost > left))) continue;
    if (options.progress)
      options.progress(fmt::format("{} ({} of {})", setting.name,
                                   runs.size() - order.size() + 1 +
                                       static_cast<size_t>(std::find(order.begin(), order.end(), i) - order.begin()),
                                   runs.size()));
    const double patience = setting.may_hang ? 0.1 * options.budget : any ? 1.5 * left : 1e9;
    AccuracyRun run;
    {
      const Deadline deadline(patience, options.stop);
      const Clock::time_point began = Clock::now();
      try {
        run = setting.run(deadline.flag());
      } catch (const InputError& error) {
        run.failure = error.what();
        // The file need not be told in its own chart.
        if (run.failure.starts_with(study.path + ": ")) run.failure.erase(0, study.path.size() + 2);
        run.seconds = seconds_since(began);
      }
      if (!run.failure.empty() && deadline.flag()) {
        if (!deadline.late()) break;      // interrupted
        if (!setting.may_hang) continue;  // the budget is used up
        const std::string_view why = ": interrupted";
        if (run.failure.ends_with(why)) run.failure.erase(run.failure.size() - why.size());
        run.failure = fmt::format("given up after {:.0f} s: {}", patience, run.failure);
      }
    }
    any = true;
    if (run.failure.empty()) rate = run.seconds / setting.cost;
    const bool fresh = !std::filesystem::exists(options.file);
    std::ofstream file(options.file, std::ios::app);
    if (fresh) file << header;
    file << row_of(options.fingerprint, setting, run) << std::flush;
    if (!file)
      throw InputError(
          fmt::format("{}: cannot be written; choose a folder that you may write to with --out", options.file));
    runs[i] = run;
  }
  return runs;
}

std::vector<size_t> pareto_front(const std::vector<std::pair<double, double>>& cost_and_error) {
  std::vector<size_t> order(cost_and_error.size());
  for (size_t i = 0; i < order.size(); ++i) order[i] = i;
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return cost_and_error[a] < cost_and_error[b]; });
  std::vector<size_t> front;
  for (size_t i : order) {
    if (front.empty() || cost_and_error[i].second < 0.98 * cost_and_error[front.back()].second) front.push_back(i);
  }
  return front;
}

AccuracyChart judge(const AccuracyStudy& study, const std::vector<std::optional<AccuracyRun>>& runs) {
  auto good = [&](size_t i) { return runs[i] && runs[i]->failure.empty(); };
  size_t own = runs.size();
  for (size_t i = 0; i < runs.size(); ++i) {
    if (study.settings[i].in_use && good(i)) own = i;
  }
  if (own == runs.size())
    throw InputError(
        fmt::format("{}: the experiment as its file has it gave no result, so there is nothing to compare "
                    "with; run `taut replay` or `taut simulate` on it",
                    study.title));
  const Eigen::VectorXd in_use = runs[own]->values, scales = scales_of(study, in_use);
  Eigen::VectorXd step_limit;  // on the file's mesh; empty: not known
  Eigen::VectorXd reference = in_use, squares = Eigen::VectorXd::Zero(in_use.size());
  AccuracyChart chart;
  for (const auto& [sequence, highest] : study.highest_order) {
    std::vector<size_t> levels;
    for (size_t i = 0; i < runs.size(); ++i) {
      if (good(i) && study.settings[i].sequences.count(sequence) > 0) levels.push_back(i);
    }
    auto size = [&](size_t i) { return study.settings[i].sequences.at(sequence); };
    std::sort(levels.begin(), levels.end(), [&](size_t a, size_t b) { return size(a) > size(b); });
    if (levels.empty() || (levels.size() == 1 && levels.front() == own)) continue;
    std::vector<double> h;
    Eigen::MatrixXd values(in_use.size(), static_cast<Eigen::Index>(levels.size()));
    for (size_t k = 0; k < levels.size(); ++k) {
      h.push_back(size(levels[k]));
      values.col(static_cast<Eigen::Index>(k)) = runs[levels[k]]->values.cwiseQuotient(scales);
    }
    const Extrapolation limit = extrapolate(h, values, highest);
    reference += limit.limit.cwiseProduct(scales) - in_use;
    // A single level tells nothing of its own error: as much as it is away from the setting in use is allowed for.
    squares +=
        (levels.size() > 1 ? limit.error : Eigen::VectorXd(limit.limit - in_use.cwiseQuotient(scales))).cwiseAbs2();
    const std::string& finest = study.settings[levels.back()].name;
    const std::string how =
        limit.measured ? fmt::format("{} extrapolated from {} with order {:.2g}", sequence, finest, limit.order)
                       : fmt::format("{} from {}", sequence, finest);
    chart.reference += (chart.reference.empty() ? "" : "; ") + how;
    if (sequence == "step" && levels.size() > 1) {
      step_limit = limit.limit.cwiseProduct(scales);
      chart.step_uncertainty = root_mean_square(limit.error);
      chart.step_reference = how;
    }
  }
  if (chart.reference.empty()) {
    chart.reference = "the setting in use itself: nothing finer was run";
    squares.setConstant(std::numeric_limits<double>::quiet_NaN());
  }
  chart.uncertainty = root_mean_square(squares.cwiseSqrt());
  const Eigen::VectorXd off = reference + squares.cwiseSqrt().cwiseProduct(scales);
  for (double error : parameter_errors(study, reference, runs[own]->derivatives, off))
    chart.parameter_uncertainty.push_back(std::abs(error));
  chart.parameter_noise = parameter_noise(study, runs[own]->derivatives);
  std::vector<std::pair<double, double>> cost_and_error;
  for (size_t i = 0; i < runs.size(); ++i) {
    if (!good(i)) continue;
    const AccuracyRun& run = *runs[i];
    AccuracyPoint point;
    point.setting = i;
    const Eigen::VectorXd error = (run.values - reference).cwiseQuotient(scales);
    point.error = root_mean_square(error);
    point.largest = error.cwiseAbs().maxCoeff();
    if (!study.settings[i].integrator.empty() && step_limit.size() > 0)
      point.step_error = root_mean_square((run.values - step_limit).cwiseQuotient(scales));
    point.from_setting_in_use = root_mean_square((run.values - in_use).cwiseQuotient(scales));
    point.parameters = parameter_errors(study, run.values, run.derivatives, reference);
    chart.points.push_back(point);
    cost_and_error.emplace_back(run.seconds, point.error);
  }
  for (size_t i : pareto_front(cost_and_error)) chart.points[i].on_front = true;
  return chart;
}

}  // namespace taut

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "calib/benches/bench.hpp"
#include "calib/benches/recordings_bench.hpp"
#include "calib/models/beam_model.hpp"
#include "calib/models/rod_model.hpp"
#include "calib/studies/accuracy.hpp"
#include "calib/studies/discretisation.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/core/units.hpp"
#include "sim/robots/simulate.hpp"
#include "sim/shapes/geometry.hpp"

namespace taut {
namespace {

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

double work(const Mesh& mesh) {
  return work(static_cast<double>(mesh.X.size()), mesh.dimension());
}

/// Unless another one is called the same: then the setting in use stays.
void add_setting(AccuracyStudy& study, AccuracySetting setting) {
  const auto known = std::ranges::find(study.settings, setting.name, &AccuracySetting::name);
  if (known == study.settings.end()) {
    study.settings.push_back(std::move(setting));
  } else if (setting.in_use) {
    *known = std::move(setting);
  }
}

// ---- runs

int unknowns_of(const StaticProtocol& protocol) {
  return protocol.scene().model->free_unknowns();
}
int unknowns_of(const RecordingProtocol& protocol) {
  return protocol.scene().model->free_unknowns();
}
int unknowns_of(const BeamProtocol& protocol) {
  return protocol.unknowns();
}
int unknowns_of(const RodProtocol& protocol) {
  return protocol.unknowns();
}

/// All rows of a bench at the file's own parameters, from rest.
AccuracyRun replay(const Experiment& experiment, Protocol& protocol, int unknowns) {
  const std::vector<int> free = indices_of(free_parameters(experiment, protocol));
  AccuracyRun run;
  run.unknowns = unknowns;
  Prediction prediction;
  // Quick replays are repeated, each from the start of the path; the fastest was disturbed least.
  const Stopwatch all;
  for (int repeat = 0; repeat < 3 && (repeat == 0 || all.seconds() < 1); ++repeat) {
    protocol.forget();
    const int before = protocol.factorisations();
    const Stopwatch watch;
    prediction = protocol.predict(protocol.nominal(), free);
    run.seconds = repeat == 0 ? watch.seconds() : std::min(run.seconds, watch.seconds());
    run.factorisations = protocol.factorisations() - before;
  }
  run.values = prediction.values;
  run.derivatives = prediction.derivatives;
  if (!prediction.complete()) run.failure = prediction.failures.front();
  return run;
}

constexpr int instants = 101;

/// A curve over `times` at even times from 0 to `duration`, added to `values`.
void add_curve(const std::vector<double>& times, const std::vector<double>& y, double duration,
               std::vector<double>& values) {
  size_t next = 1;
  for (int i = 0; i < instants; ++i) {
    const double t = duration * i / (instants - 1);
    while (next + 1 < times.size() && times[next] < t) ++next;
    const double t0 = times[next - 1], t1 = times[next];
    const double s = std::clamp((t - t0) / (t1 - t0), 0.0, 1.0);
    values.push_back((1 - s) * y[next - 1] + s * y[next]);
  }
}

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
    if (robot.readings[k].part < 0) add_curve(result.times, result.readings[k], simulation.duration, values);
  }
  run.values = Eigen::Map<const Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
  return run;
}

// ---- settings

const char* name_of(SimulationMethod method) {
  constexpr std::array<const char*, 6> names{"equilibria", "implicit Euler",   "BDF2",
                                             "CVODE",      "ARKODE, implicit", "ARKODE, explicit"};
  return names[static_cast<size_t>(method)];
}

const char* name_of(Integrator integrator) {
  return name_of(integrator == Integrator::bdf2 ? SimulationMethod::bdf2 : SimulationMethod::implicit_euler);
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

AccuracySetting named(const std::string& axis, const std::string& name, double cost) {
  AccuracySetting setting;
  setting.axis = axis;
  setting.name = name;
  setting.cost = cost;
  return setting;
}

/// Elements times meshes: `make(element, factor)` is one of them.
template <class Make>
void add_meshes(AccuracyStudy& study, bool locking_free, const std::function<std::vector<double>(int order)>& factors,
                Make&& make) {
  for (const Element& element : elements_for(locking_free)) {
    for (double factor : factors(element.order)) {
      try {
        add_setting(study, make(element, factor));
      } catch (const InputError&) {  // a geometry cannot be meshed so coarsely
      }
    }
  }
}

/// The contact gap of a simulation's surfaces, or of a bench's mesh; `own` is that of the file.
template <class Subject, class Make>
void add_gaps(AccuracyStudy& study, const Subject& subject, double own, double& (*gap_of)(Subject&), Make&& make) {
  for (double factor : {4.0, 2.0, 0.5, 0.25}) {
    Subject other = subject;
    gap_of(other) = factor * own;
    AccuracySetting one = make("contact gap", "contact gap " + with_unit(factor * own, "m", 3), other, factor);
    one.sequences["contact gap"] = factor * own;
    add_setting(study, one);
  }
}

template <class Subject, class Make>
void add_tolerances(AccuracyStudy& study, const Subject& subject, const std::vector<double>& tolerances, Make&& make) {
  for (double tolerance : tolerances) {
    if (tolerance == subject.equilibrium.step_tolerance) continue;
    Subject other = subject;
    other.equilibrium.step_tolerance = tolerance;
    add_setting(study, make("step tolerance", fmt::format("step tolerance {:.0e}", tolerance), other));
  }
}

// ---- benches

/// What all studies of a bench begin with.
AccuracyStudy study_of(const Experiment& experiment, const Protocol& protocol) {
  AccuracyStudy study;
  study.title = experiment.title;
  study.simulated = experiment.simulated;
  study.table = protocol.parameters();
  study.nominal = protocol.nominal();
  study.free = free_parameters(experiment, protocol);
  return study;
}

/// Makes a setting of an axis, a name, an experiment and the work of a factorisation on its mesh.
using MakeSetting = std::function<AccuracySetting(const std::string&, const std::string&, const Experiment&, double)>;

/// A setting of an experiment whose bench is made by `bench_of(experiment)`.
template <class BenchOf>
AccuracySetting of_bench(const std::string& axis, const std::string& name, double cost, Experiment experiment,
                         BenchOf bench_of) {
  AccuracySetting one = named(axis, name, cost);
  one.run = [=](const std::atomic<bool>& stop) {
    Experiment stopped = experiment;
    stopped.equilibrium.stop = &stop;
    const auto bench = bench_of(stopped);
    return replay(stopped, *bench.protocol, unknowns_of(*bench.protocol));
  };
  return one;
}

/// Elements times meshes of a bench. `in_use` marks the file's own.
void add_meshes(AccuracyStudy& study, const Experiment& experiment,
                const std::function<std::vector<double>(int order)>& factors, const MakeSetting& setting,
                const std::function<void(AccuracySetting&)>& in_use) {
  const MeshSettings &own = experiment.mesh, best = most_accurate(experiment, own);
  const auto has = [](const MeshSettings& mesh, const Element& element) {
    return mesh.order == element.order && mesh.formulation == element.formulation;
  };
  const bool locking_free = best.formulation == Formulation::locking_free;
  add_meshes(study, locking_free, factors, [&](const Element& element, double factor) {
    Experiment e = experiment;
    e.mesh = refined(own, experiment.geometry, factor);
    e.mesh.order = element.order;
    e.mesh.formulation = element.formulation;
    const Mesh made = make_mesh(e, e.mesh);
    AccuracySetting one = setting(element.name, e.mesh.describe(), e, work(made));
    one.in_use = factor == 1 && has(own, element);
    if (one.in_use) in_use(one);
    if (has(best, element)) one.sequences["mesh"] = element_size(made);
    return one;
  });
}

// ---- recordings

/// Integrators times steps of recordings.
void add_steps(AccuracyStudy& study, const Experiment& experiment, const MakeSetting& setting) {
  const double own_work = work(make_mesh(experiment, experiment.mesh));
  for (Integrator integrator : {Integrator::implicit_euler, Integrator::bdf2}) {
    const std::string name = name_of(integrator);
    for (double factor : {4.0, 2.0, 1.0, 0.5}) {
      if (integrator == recordings_of(experiment).integrator && factor == 1) continue;
      Experiment e = experiment;
      const double step = factor * recordings_of(experiment).step;
      recordings_of(e).integrator = integrator;
      recordings_of(e).step = step;
      AccuracySetting one = setting(name, fmt::format("{}, steps of {}", name, with_unit(step, "s", 3)), e, own_work);
      if (integrator == Integrator::bdf2) one.sequences["step"] = step;
      one.integrator = name;
      add_setting(study, one);
    }
  }
}

AccuracyStudy study_of_recordings(const Experiment& experiment) {
  const std::vector<Sample> samples = thinned(read_samples(experiment));
  const auto bench_of = [=](const Experiment& e) { return make_recording_replay(e, e.mesh, samples); };
  AccuracyStudy study = study_of(experiment, *bench_of(experiment).protocol);
  study.result = "recorded motions, at the parameters that the file starts from";
  study.highest_order = {{"mesh", 2}, {"step", 2}};
  for (const Sample& sample : samples) {
    study.series.push_back(sample.recording * static_cast<int>(experiment.channels.size()) + sample.channel);
    study.sigma.push_back(sample.sigma);
  }
  const MakeSetting setting = [&](const std::string& axis, const std::string& name, const Experiment& e,
                                  double factorisation) {
    return of_bench(axis, name, factorisation / recordings_of(e).step, e, bench_of);
  };
  const auto factors = [](int) { return std::vector{0.5, 0.7, 1.0, 1.4}; };
  add_meshes(study, experiment, factors, setting, [&](AccuracySetting& in_use) {
    const RecordingsSettings& own = recordings_of(experiment);
    in_use.integrator = name_of(own.integrator);
    if (own.integrator == Integrator::bdf2) in_use.sequences["step"] = own.step;
  });
  add_steps(study, experiment, setting);
  return study;
}

// ---- readings at rest

void add_load_steps(AccuracyStudy& study, const Experiment& experiment, double own_work, const MakeSetting& setting) {
  for (int steps : {1, 2, 4, 8}) {
    if (steps == experiment.equilibrium.load_steps) continue;
    Experiment e = experiment;
    e.equilibrium.load_steps = steps;
    const std::string name = fmt::format("{} load step{}", steps, steps == 1 ? "" : "s");
    add_setting(study, setting("load steps", name, e, own_work * steps));
  }
}

/// The other kind of plane, and the solid that the section stands for.
void add_planes(AccuracyStudy& study, const Experiment& experiment, double own_work, const MakeSetting& setting) {
  Experiment e = experiment;
  const bool strain = experiment.geometry.plane == Plane::strain;
  e.geometry.plane = strain ? Plane::stress : Plane::strain;
  if (strain) e.mesh.formulation = Formulation::standard;
  const std::string name = strain ? "plane stress" : "plane strain";
  add_setting(study, setting(name, name, e, own_work));
  for (int depth : {1, 2}) {
    e = experiment;
    e.mesh.depth_cells = depth;
    AccuracySetting solid =
        setting("as a solid", fmt::format("as a solid, {} {} across half of it", depth, depth == 1 ? "cell" : "cells"),
                e, work(make_mesh(e, e.mesh)));
    solid.sequences["depth"] = 1.0 / depth;
    solid.model = "solid";
    add_setting(study, solid);
  }
}

/// Models with fewer unknowns, those that describe the bench: `make(experiment)` has `protocol`.
template <class Make>
void add_cheaper_model(AccuracyStudy& study, const Experiment& experiment, Rung rung, double cost, Make make) {
  try {
    make(experiment);
  } catch (const InputError&) {
    return;
  }
  AccuracySetting one = named("cheaper models", fmt::format("model \"{}\"", name_of(rung)), cost);
  one.model = name_of(rung);
  one.run = [=](const std::atomic<bool>& stop) {
    Experiment stopped = experiment;
    stopped.equilibrium.stop = &stop;
    const auto bench = make(stopped);
    return replay(stopped, *bench.protocol, unknowns_of(*bench.protocol));
  };
  add_setting(study, one);
}

void add_cheaper_models(AccuracyStudy& study, const Experiment& experiment, const Trials& trials, double own_work) {
  add_cheaper_model(study, experiment, Rung::beam, 1, [=](const Experiment& e) { return make_beam_bench(e, trials); });
  add_cheaper_model(study, experiment, Rung::rod, 2, [=](const Experiment& e) { return make_rod_bench(e, trials); });
  Experiment rigid = experiment;
  rigid.model = Rung::rigid_segments;
  add_cheaper_model(study, rigid, Rung::rigid_segments, own_work,
                    [=](const Experiment& e) { return make_static_replay(e, e.mesh, trials); });
}

/// Noise of each row's mean.
std::vector<double> sigma_of_rows(const StaticReplay& bench) {
  std::vector<double> sigma(static_cast<size_t>(bench.protocol->row_count()), 0);
  std::vector<int> repeats(sigma.size(), 0);
  for (const Measurement& m : bench.measurements) {
    sigma[static_cast<size_t>(m.row)] += m.sigma * m.sigma;
    ++repeats[static_cast<size_t>(m.row)];
  }
  for (size_t i = 0; i < repeats.size(); ++i) sigma[i] = std::sqrt(sigma[i]) / repeats[i];
  return sigma;
}

// ---- simulations

/// One setting of a simulation.
AccuracySetting simulated(const std::string& axis, const std::string& name, const Simulation& s) {
  double unknowns = 0;
  for (const BodySettings& body : s.bodies)
    unknowns += static_cast<double>(make_mesh(body.geometry, body.mesh, s.contact.on, false).X.size());
  AccuracySetting one = named(axis, name, work(unknowns, s.dimension) * s.duration / s.step);
  one.run = [s](const std::atomic<bool>& stop) { return replay(s, stop); };
  return one;
}

/// Mean edge of the bodies' elements, of their size.
double element_size(const Simulation& s) {
  int elements = 0;
  for (const BodySettings& body : s.bodies)
    elements += make_mesh(body.geometry, body.mesh, s.contact.on, false).element_count();
  return std::pow(static_cast<double>(elements), -1.0 / s.dimension);
}

/// What the file's own setting is besides its mesh.
void mark_in_use(AccuracySetting& one, const Simulation& simulation) {
  one.in_use = true;
  one.integrator = name_of(simulation.method);
  one.name += fmt::format(", {}, steps of {}", one.integrator, with_unit(simulation.step, "s", 3));
  if (simulation.contact.on) one.sequences["contact gap"] = simulation.contact.gap;
  if (simulation.method == SimulationMethod::bdf2) one.sequences["step"] = simulation.step;
}

void add_meshes(AccuracyStudy& study, const Simulation& simulation) {
  const MeshSettings& own = simulation.bodies.front().mesh;
  const auto factors = [](int) { return std::vector{0.5, 0.7, 1.0, 1.4}; };
  const bool locking_free = own.formulation == Formulation::locking_free;
  add_meshes(study, locking_free, factors, [&](const Element& element, double factor) {
    Simulation s = simulation;
    for (BodySettings& body : s.bodies) {
      body.mesh = refined(body.mesh, body.geometry, factor);
      body.mesh.order = element.order;
      body.mesh.formulation = element.formulation;
    }
    const std::string mesh = factor == 1 ? ", the file's mesh" : fmt::format(", mesh {:g} times as fine", factor);
    AccuracySetting one = simulated(element.name, element.name + mesh, s);
    if (element.order == 2 && element.formulation == own.formulation) one.sequences["mesh"] = element_size(s);
    if (factor == 1 && element.order == own.order && element.formulation == own.formulation)
      mark_in_use(one, simulation);
    return one;
  });
}

/// Own integrators times steps, SUNDIALS' ones times tolerances.
void add_integrators(AccuracyStudy& study, const Simulation& simulation) {
  const auto add = [&](const Simulation& s, const std::string& how) {
    AccuracySetting one = simulated(name_of(s.method), fmt::format("{}, {}", name_of(s.method), how), s);
    if (s.method == SimulationMethod::bdf2) one.sequences["step"] = s.step;
    one.may_hang = s.tolerance > 0;
    one.integrator = name_of(s.method);
    add_setting(study, one);
  };
  for (SimulationMethod method : {SimulationMethod::implicit_euler, SimulationMethod::bdf2}) {
    for (double factor : {4.0, 2.0, 1.0, 0.5, 0.25}) {
      if (method == simulation.method && factor == 1) continue;
      Simulation s = simulation;
      s.method = method;
      s.tolerance = 0;
      s.step = factor * simulation.step;
      add(s, "steps of " + with_unit(s.step, "s", 3));
    }
  }
  for (SimulationMethod method :
       {SimulationMethod::cvode, SimulationMethod::arkode_implicit, SimulationMethod::arkode_explicit}) {
    for (double tolerance : {1e-2, 1e-4}) {
      Simulation s = simulation;
      s.method = method;
      s.tolerance = tolerance;
      add(s, fmt::format("tolerance {:.0e}", tolerance));
    }
  }
}

}  // namespace

AccuracyStudy accuracy_study(const Experiment& experiment) {
  if (experiment.kind == &recordings_kind) return study_of_recordings(experiment);
  const Trials trials = read_trials(experiment.bench);
  const auto bench_of = [=](const Experiment& e) { return make_static_replay(e, e.mesh, trials); };
  const StaticReplay bench = bench_of(experiment);
  AccuracyStudy study = study_of(experiment, *bench.protocol);
  study.result = "displacements of all rows, at the parameters that the file starts from";
  study.highest_order = {{"mesh", 2}, {"contact gap", 1}, {"depth", 2}};
  study.sigma = sigma_of_rows(bench);
  const Mesh own = make_mesh(experiment, experiment.mesh);
  const double own_work = work(own), own_gap = contact_gap(experiment.mesh, own.diagonal());
  const MakeSetting setting = [&](const std::string& axis, const std::string& name, const Experiment& e, double cost) {
    return of_bench(axis, name, cost, e, bench_of);
  };
  const auto on_own_mesh = [&](const std::string& axis, const std::string& name, const Experiment& e,
                               double finer = infinity) {
    return setting(axis, name, e, own_work * (1 + 0.1 / finer));
  };
  const auto factors = [&](int order) { return mesh_factors(own.dimension(), order); };
  add_meshes(study, experiment, factors, setting, [&](AccuracySetting& in_use) {
    if (experiment.contact.on) in_use.sequences["contact gap"] = own_gap;
  });
  add_tolerances(study, experiment, {1e-5, 1e-7, 1e-9, 1e-11}, on_own_mesh);
  add_load_steps(study, experiment, own_work, setting);
  if (experiment.contact.on)
    add_gaps(
        study, experiment, own_gap, +[](Experiment& e) -> double& { return e.mesh.contact_gap; }, on_own_mesh);
  if (experiment.geometry.dimension == 2) add_planes(study, experiment, own_work, setting);
  add_cheaper_models(study, experiment, trials, own_work);
  for (AccuracySetting& one : study.settings) {
    if (one.model.empty() && (one.axis.starts_with("linear") || one.axis.starts_with("quadratic")))
      one.model = "plane section, " + one.axis;
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
  study.simulated = true;
  study.result = "channels over time, forces between bodies left out";
  study.highest_order = {{"mesh", 2}, {"contact gap", 1}, {"step", 2}};
  int curves = 0;
  for (const ChannelSettings& channel : simulation.channels) {
    if (channel.kind->known == ChannelKind::Known::in_steps) continue;
    study.series.insert(study.series.end(), instants, curves++);
  }
  if (curves == 0)
    throw InputError(
        fmt::format("{}: there is no channel to compare but net forces; add a [[channel]] of kind "
                    "position, displacement, rotation or tension",
                    simulation.path));
  add_meshes(study, simulation);
  add_integrators(study, simulation);
  const auto other = [](const std::string& axis, const std::string& name, const Simulation& s, double = 0) {
    return simulated(axis, name, s);
  };
  if (simulation.contact.on)
    add_gaps(
        study, simulation, simulation.contact.gap, +[](Simulation& s) -> double& { return s.contact.gap; }, other);
  add_tolerances(study, simulation, {1e-5, 1e-7, 1e-11}, other);
  return study;
}

}  // namespace taut

#include "calib/studies/planted.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <sstream>

#include "calib/benches/model.hpp"
#include "calib/benches/specimens.hpp"
#include "calib/models/beam_model.hpp"
#include "calib/studies/assumption_shares.hpp"
#include "sim/core/draws.hpp"
#include "sim/core/error.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/shapes/push_puppet.hpp"

namespace taut {
namespace {

/// By the ids of dimensions and constants [m], pure: what a caliper, a data sheet and a balance leave open.
constexpr double length_tolerance = 0.1e-3, thickness_tolerance = 0.2e-3, via_tolerance = 0.1e-3, nu_tolerance = 0.05,
                 plastic_tolerance = 0.2, mass_tolerance = 0.005, retraction_tolerance = 0.05e-3;

void draw_module(PushPuppet& m, Draws& draws) {
  m.cells = static_cast<int>(draws.uniform(2, 7));
  for (double* length : {&m.cell_length, &m.core_height, &m.web_thickness, &m.plate_thickness, &m.lip_thickness})
    *length *= draws.uniform(0.8, 1.25);
  m.gap_total = m.cells * m.cell_length * draws.uniform(0.2, 0.4);
  m.cable_offset = PushPuppetLayout(m).middle;
  m.via_inset = draws.uniform(0.3e-3, 1.5e-3);
}

MaterialSettings& material(Experiment& experiment, std::string_view region) {
  return *std::ranges::find(experiment.materials, region, &MaterialSettings::region);
}

/// The tip's displacement per kilogram of the slack module, at small loads.
double tip_per_kilogram(const Experiment& experiment, Trials trials) {
  trials.readings = {{.line = 1, .trial = "", .controls = {1e-3, 0}, .channel = 0, .value = 0, .sigma = 1e-5}};
  const StaticReplay replay = make_static_replay(experiment, experiment.mesh, trials);
  return 1e3 * std::abs(replay.protocol->predict(replay.protocol->nominal(), {}).values[0]);
}

/// The readings that are to be taken, all zero: masses up to `most` [kg].
Trials rows_of(const Experiment& experiment, double most, Draws& draws) {
  Trials trials;
  for (const BenchFormat::Control& control : experiment.bench.controls) trials.control_ids.push_back(control.id);
  trials.control_quantities = {Quantity::mass, Quantity::length};
  trials.control_values.resize(2);
  trials.channel_ids = {experiment.channels[0].id};
  const double gap = experiment.geometry.as<PushPuppet>().gap_total;
  int line = 1;
  const double between[] = {0, draws.uniform(0.3, 0.7), draws.uniform(0.75, 0.95), draws.uniform(1.02, 1.08)};
  for (const char* trial : {"1", "2", "3"}) {
    for (double part : between) {
      for (double mass : {0.25, 0.5, 0.75, 1.0}) {
        const double m = std::round(1e3 * mass * most) / 1e3, r = std::round(1e5 * part * gap) / 1e5;
        trials.readings.push_back({.line = ++line, .trial = trial, .controls = {m, r}, .channel = 0});
        trials.control_values[0].insert(m);
        trials.control_values[1].insert(r);
      }
    }
  }
  return trials;
}

/// States the tolerances, and moves the truth within them.
void put_off(PlantedBench& bench, Draws& draws) {
  Experiment& said = bench.experiment;
  for (const Dimension& dimension : dimensions_of(said)) {
    const bool stud = dimension.spec.id.starts_with("stud_") || dimension.spec.id.ends_with("bracket_height");
    if (stud) continue;
    const double tolerance = dimension.spec.id == "via_inset" ? via_tolerance : length_tolerance;
    said.tolerances[dimension.place] = {tolerance, dimension.place};
    dimension.set(bench.truth, dimension.value + 0.5 * tolerance * draws.normal());
  }
  said.tolerances["geometry.thickness"] = {thickness_tolerance, ""};
  bench.truth.geometry.thickness += 0.5 * thickness_tolerance * draws.normal();
  said.tolerances["materials.foam.nu"] = {nu_tolerance, ""};
  double& nu = material(bench.truth, "foam").constants["nu"];
  nu = std::clamp(nu + 0.5 * nu_tolerance * draws.normal(), 0.0, 0.45);
  double& plastic = material(bench.truth, "plastic").constants["E"];
  said.tolerances["materials.plastic.E"] = {plastic_tolerance * plastic, ""};
  plastic *= 1 + 0.5 * plastic_tolerance * draws.normal();
  said.control_tolerances[said.bench.controls[0].id] = {fmt::format("{} %", 100 * mass_tolerance), ""};
  said.control_tolerances[said.bench.controls[1].id] = {fmt::format("{} mm", 1e3 * retraction_tolerance), ""};
}

/// Reads the truth, with noise. What the bench sets is not quite what its files say when it is `off`.
void read_truth(PlantedBench& bench, bool off, Draws& draws) {
  const double scale = off ? 1 + 0.5 * mass_tolerance * draws.normal() : 1,
               zero = off ? 0.5 * retraction_tolerance * draws.normal() : 0;
  Trials truly = bench.trials;
  for (std::set<double>& values : truly.control_values) values.clear();
  for (Reading& reading : truly.readings) {
    reading.controls = {scale * reading.controls[0], std::max(0.0, reading.controls[1] + zero)};
    for (size_t k : {0u, 1u}) truly.control_values[k].insert(reading.controls[k]);
  }
  const MeshSettings mesh = refined(bench.truth.mesh, bench.truth.geometry, 1 / 0.6);
  const StaticReplay replay = make_static_replay(bench.truth, mesh, truly);
  const ParameterTable& table = replay.protocol->parameters();
  Params p = replay.protocol->nominal();
  for (const auto& [id, value] : bench.planted) p[table.index(id)] = value;
  const Prediction exact = replay.protocol->predict(p, {});
  if (!exact.complete()) throw InputError("the planted module has no equilibrium: " + exact.failures.front());
  const InstrumentNoise& noise = bench.truth.bench.channels[0].noise;
  for (size_t i = 0; i < bench.trials.readings.size(); ++i) {
    Reading& reading = bench.trials.readings[i];
    const double value = exact.values[replay.row_of_reading[i]];
    reading.value = value + noise.sigma(value) * draws.normal();
    if (noise.resolution > 0) reading.value = noise.resolution * std::round(reading.value / noise.resolution);
    reading.sigma = noise.sigma(value);
  }
}

/// What is fitted, from `start` times its planted value.
std::vector<FreeParameter> free_of(const PlantedBench& bench, const StaticProtocol& protocol, double start) {
  std::vector<FreeParameter> free = free_parameters(bench.experiment, protocol);
  for (FreeParameter& parameter : free) {
    const double truth = bench.planted.at(protocol.parameters()[parameter.index].id);
    parameter.start = protocol.parameters()[parameter.index].logarithmic ? start * truth : 0;
  }
  return start_by_beams(bench.experiment, bench.trials, std::move(free));
}

bool holds(const std::optional<double>& lower, const std::optional<double>& upper, double value) {
  return (!lower || *lower <= value) && (!upper || value <= *upper);
}

void fit_exact(const PlantedBench& bench, PlantedResult& result) {
  FitResult fits[2];
  const double starts[] = {0.4, 2.5};
  for (size_t k : {0u, 1u}) {
    const StaticReplay replay = make_static_replay(bench.experiment, bench.experiment.mesh, bench.trials);
    StaticProtocol& protocol = *replay.protocol;
    result.unknowns = protocol.scene().model->free_unknowns();
    const int before = protocol.factorisations();
    fits[k] = fit(protocol, replay.measurements, free_of(bench, protocol, starts[k]));
    result.status[k] = name_of(fits[k].status);
    protocol.forget();
    const int searched = protocol.factorisations() - before;
    const int cold = protocol.factorisations();
    protocol.predict(fits[k].p, {});
    result.cold_replays =
        std::max(result.cold_replays, static_cast<double>(searched) / std::max(1, protocol.factorisations() - cold));
  }
  const FitResult& best = fits[0].chi_squared <= fits[1].chi_squared ? fits[0] : fits[1];
  const ParameterEstimate &one = fits[0].parameters[0], &other = fits[1].parameters[0];
  result.apart = std::abs(one.value - other.value) / one.standard_error;
  result.chi_squared = best.chi_squared;
  result.dof = best.dof;
  result.p = best.chi_squared_p;
  for (const ParameterEstimate& e : best.parameters) {
    const double truth = bench.planted.at(e.spec.id);
    result.parameters.push_back(e.spec.id);
    result.error.push_back(e.spec.logarithmic ? e.value / truth - 1 : (e.value - truth) / 1e-3);
    result.noise_holds.push_back(holds(e.lower95, e.upper95, truth));
  }
}

void fit_off(const PlantedBench& bench, PlantedResult& result) {
  const StaticReplay replay = make_static_replay(bench.experiment, bench.experiment.mesh, bench.trials);
  FitResult found = fit(*replay.protocol, replay.measurements, free_of(bench, *replay.protocol, 1.5));
  result.total_status = name_of(found.status);
  std::vector<Share> shares;
  if (found.status == FitStatus::converged) {
    Experiment experiment = bench.experiment;
    shares = discretisation_shares(experiment, bench.trials, found);
    for (Share& share :
         assumption_shares(experiment, full_model(experiment, bench.trials, dimensions_of(experiment)), found))
      shares.push_back(std::move(share));
  }
  for (size_t j = 0; j < found.parameters.size(); ++j) {
    const ParameterEstimate& e = found.parameters[j];
    const TotalInterval total = total_interval(e, shares, j);
    const bool known = found.status == FitStatus::converged;
    result.total_holds.push_back(known ? holds(total.lower, total.upper, bench.planted.at(e.spec.id)) : -1);
    result.total_width.push_back(known && total.lower && total.upper
                                     ? 0.5 * (*total.upper - *total.lower) / (e.spec.logarithmic ? e.value : 1e-3)
                                     : INFINITY);
  }
}

const Cells planted_columns{"fingerprint", "number", "cells",       "unknowns",   "largest",     "soft_start",
                            "stiff_start", "apart",  "chi_squared", "dof",        "p",           "cold_replays",
                            "parameters",  "error",  "noise_holds", "off_status", "total_holds", "total_width"};

template <class Value>
std::string words(const std::vector<Value>& values) {
  std::string text;
  for (const Value& value : values)
    text += fmt::format("{}{:.4g}", text.empty() ? "" : " ", static_cast<double>(value));
  return text;
}

template <class Value>
std::vector<Value> numbers_in(const std::string& text) {
  std::vector<Value> values;
  std::istringstream in(text);
  for (std::string word; in >> word;) values.push_back(static_cast<Value>(std::strtod(word.c_str(), nullptr)));
  return values;
}

Cells cells_of(const PlantedResult& r) {
  std::string parameters;
  for (const std::string& id : r.parameters) parameters += (parameters.empty() ? "" : " ") + id;
  return {fmt::format("{}", r.cells),
          fmt::format("{}", r.unknowns),
          fmt::format("{:.3g}", r.largest),
          r.status[0],
          r.status[1],
          fmt::format("{:.3g}", r.apart),
          fmt::format("{:.4g}", r.chi_squared),
          fmt::format("{}", r.dof),
          fmt::format("{:.3g}", r.p),
          fmt::format("{:.3g}", r.cold_replays),
          parameters,
          words(r.error),
          words(r.noise_holds),
          r.total_status,
          words(r.total_holds),
          words(r.total_width)};
}

PlantedResult planted_of(const Cells& cells) {
  PlantedResult r;
  r.cells = std::atoi(cells[0].c_str());
  r.unknowns = std::atoi(cells[1].c_str());
  r.largest = std::strtod(cells[2].c_str(), nullptr);
  r.status[0] = cells[3];
  r.status[1] = cells[4];
  r.apart = std::strtod(cells[5].c_str(), nullptr);
  r.chi_squared = std::strtod(cells[6].c_str(), nullptr);
  r.dof = std::atoi(cells[7].c_str());
  r.p = std::strtod(cells[8].c_str(), nullptr);
  r.cold_replays = std::strtod(cells[9].c_str(), nullptr);
  std::istringstream in(cells[10]);
  for (std::string word; in >> word;) r.parameters.push_back(word);
  r.error = numbers_in<double>(cells[11]);
  r.noise_holds = numbers_in<int>(cells[12]);
  r.total_status = cells[13];
  r.total_holds = numbers_in<int>(cells[14]);
  r.total_width = numbers_in<double>(cells[15]);
  return r;
}

}  // namespace

PlantedBench plant(const Experiment& base, unsigned number, bool off) {
  if (base.geometry.kind() != "push_puppet" || base.bench.controls.size() != 2 || base.channels.size() != 1)
    throw InputError(base.path +
                     ": planted benches are push_puppet modules with a hung mass, retracted cables and one "
                     "channel; name an experiment of that kind");
  Draws draws(number);
  PlantedBench bench;
  Experiment& said = bench.experiment;
  said = base;
  said.variants.clear();
  said.threads = 0;
  draw_module(said.geometry.edit<PushPuppet>(), draws);
  said.geometry.shape->check();
  for (CableSettings& cable : said.cables.cables) {
    cable.points.clear();
    for (const Eigen::VectorXd& point : own_cable(said.geometry, cable.id))
      cable.points.emplace_back(point.begin(), point.end());
  }
  said.geometry.thickness *= draws.uniform(0.8, 1.25);
  material(said, "foam").constants["nu"] = draws.uniform(0, 0.3);
  material(said, "foam").constants["E"] = draws.logarithmic(20e3, 200e3);
  bench.planted = {{"E_foam", material(said, "foam").constants["E"]},
                   {"k_cable", draws.logarithmic(3e3, 40e3)},
                   {"slack", draws.uniform(0, 0.6e-3)}};
  said.free.clear();
  for (const auto& [id, value] : bench.planted) said.free.push_back({id, {}, {}, {}});
  const double length = PushPuppetLayout(said.geometry.as<PushPuppet>()).tip;
  const double most = draws.uniform(0.02, 0.3) * length / tip_per_kilogram(said, rows_of(said, 1e-3, draws));
  bench.trials = rows_of(said, most, draws);
  bench.truth = said;
  if (off) put_off(bench, draws);
  read_truth(bench, off, draws);
  return bench;
}

std::vector<std::optional<PlantedResult>> run_planted(const Experiment& base, unsigned count,
                                                      const StudyOptions& options) {
  std::vector<std::optional<PlantedResult>> results(count);
  Study study;
  study.columns = planted_columns;
  for (unsigned k = 1; k <= count; ++k)
    study.settings.push_back({{std::to_string(k)}, fmt::format("planted bench {}", k), 1});
  study.least = 1;
  study.run = [&](size_t setting, const Deadline&) -> std::optional<StudyResult> {
    const Stopwatch watch;
    const auto number = static_cast<unsigned>(setting + 1);
    PlantedResult result;
    const PlantedBench exact = plant(base, number, false);
    result.cells = exact.experiment.geometry.as<PushPuppet>().cells;
    for (const Reading& reading : exact.trials.readings)
      result.largest = std::max(
          result.largest, std::abs(reading.value) / PushPuppetLayout(exact.experiment.geometry.as<PushPuppet>()).tip);
    fit_exact(exact, result);
    fit_off(plant(base, number, true), result);
    return StudyResult{cells_of(result), watch.seconds()};
  };
  study.take = [&](size_t setting, const Cells& cells) {
    results[setting] = planted_of(cells);
    return true;
  };
  run_study(study, options);
  return results;
}

}  // namespace taut

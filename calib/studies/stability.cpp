#include "calib/studies/stability.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <random>
#include <tuple>

#include "calib/studies/discretisation.hpp"
#include "sim/core/error.hpp"
#include "sim/materials/laws.hpp"
#include "sim/mesh/weights.hpp"
#include "sim/robots/robot.hpp"
#include "sim/shapes/geometry.hpp"
#include "sim/solve/sundials_integrator.hpp"
#include "sim/solve/time_stepper.hpp"

namespace taut {
namespace {

constexpr double too_stiff = 0.9;          // answer over the right one, below which a body counts as locked
constexpr double static_tolerance = 0.05;  // of displacements, beyond which it is another answer
constexpr double dynamic_tolerance = 0.2;  // the same after a time: long implicit steps damp
constexpr int most_unknowns = 2500, most_unknowns_3d = 1500;  // of the meshes of maps: their runs have to be quick
constexpr int most_steps = 400;                               // of a run over time

double largest(const Eigen::VectorXd& v) {
  return v.size() == 0 ? 0.0 : v.cwiseAbs().maxCoeff();
}

std::string number(double value) {
  return std::abs(value) < 1e5 ? fmt::format("{:g}", std::stod(fmt::format("{:.3g}", value)))
                               : fmt::format("{:.3g}", value);
}

/// Multiples of `times` in a unit.
std::vector<std::string> numbers(const std::vector<double>& values, double unit = 1, double times = 1) {
  std::vector<std::string> text;
  for (double value : values) text.push_back(number(value * times / unit));
  return text;
}

std::vector<std::string> powers_of_ten(const std::vector<double>& values) {
  std::vector<std::string> text;
  for (double value : values) text.push_back(fmt::format("1e{:.0f}", std::log10(value)));
  return text;
}

/// Whether any two edges of the boundary cross.
bool crosses(const Mesh& mesh, const Eigen::VectorXd& u) {
  ContactSettings settings;
  settings.edges = contact_edges(mesh);
  settings.stiffness.assign(settings.edges.size(), 0);
  settings.gap = 0;
  return Contact(mesh, settings).intersects(u);
}

auto& material_of(auto& materials, const std::string& region) {
  return *std::ranges::find(materials, region, &MaterialSettings::region);
}

/// The regions with the smallest and the largest modulus; the same where there is one material.
struct Contrast {
  std::string soft, stiff;

  static double modulus(const MaterialSettings& material) { return youngs_modulus(material.law, material.constants); }
  void find(const std::vector<MaterialSettings>& materials) {
    soft = std::ranges::min_element(materials, {}, modulus)->region;
    stiff = std::ranges::max_element(materials, {}, modulus)->region;
  }
  std::string ratio_label() const { return fmt::format("E of {} / E of {}", stiff, soft); }
  void set_ratio(std::vector<MaterialSettings>& materials, double ratio) const {
    MaterialSettings& material = material_of(materials, stiff);
    const double factor = ratio * modulus(material_of(materials, soft)) / modulus(material);
    for (const ParameterSpec& spec : material_parameters(material.law))
      if (spec.unit == "Pa") material.constants.at(spec.id) *= factor;
  }
};

/// Calls `make(factor)`, which says whether its mesh is small enough, with ever smaller factors of refinement until it
/// is, or the mesh is too coarse for its geometry.
template <class Make>
void coarsen(double least, Make&& make) {
  for (double factor = 1; factor > least; factor /= 1.25) {
    try {
      if (make(factor)) return;
    } catch (const InputError&) {
      if (factor == 1) throw;
      return;
    }
  }
}

/// A value that is computed when it is first asked for.
template <class Key, class Value, class Compute>
const Value& remembered(std::map<Key, Value>& values, const Key& key, Compute&& compute) {
  const auto found = values.find(key);
  return found != values.end() ? found->second : values.emplace(key, compute()).first->second;
}

// ---- at rest

/// What the maps of a bench experiment share.
struct StaticSubject : Contrast {
  Experiment experiment;  ///< with the solver's options for maps
  Trials trials;
  MeshSettings coarse;
  int unknowns = 0;
  std::vector<size_t> first;  ///< controls that are set before the others: retractions
  int load = -1;              ///< the control with most values among the others; -1: none

  bool contact() const { return experiment.contact.on; }
  bool retracts(size_t control) const { return std::ranges::find(first, control) != first.end(); }
  double top(size_t control) const { return *trials.control_values[control].rbegin(); }
  /// Controls with the retractions at a fraction of their largest value and the load at one of its own.
  std::vector<double> controls(double retraction, double loads) const {
    std::vector<double> values(trials.control_ids.size(), 0.0);
    for (size_t k = 0; k < values.size(); ++k)
      values[k] = (retracts(k) ? retraction : static_cast<int>(k) == load ? loads : 0) * top(k);
    return values;
  }
  std::string mesh_text() const { return fmt::format("{} ({} unknowns)", coarse.describe(), unknowns); }
  /// The label of a control's axis, and fractions of its largest value there.
  std::pair<std::string, std::vector<std::string>> axis(size_t control, const std::vector<double>& fractions) const {
    const DisplayUnit unit = display_unit(top(control), units_of(trials.control_quantities[control]).front());
    return {fmt::format("{} [{}]", trials.control_ids[control], unit.name),
            numbers(fractions, unit.factor, top(control))};
  }
};
using Subject = std::shared_ptr<const StaticSubject>;

Subject subject_of(const Experiment& experiment, const Trials& trials) {
  if (!experiment.kind->at_rest)
    throw InputError(
        fmt::format("{}: its bench holds recordings over time; 'taut chart stability' takes benches with "
                    "readings at rest and simulations over time",
                    experiment.path));
  auto subject = std::make_shared<StaticSubject>();
  subject->experiment = experiment;
  EquilibriumOptions& options = subject->experiment.equilibrium;
  options.stop = nullptr;
  options.max_iterations = 40;
  options.max_halvings = 5;
  options.max_total_iterations = 160;
  options.load_steps = 1;
  subject->trials = trials;
  size_t most = 0;
  for (size_t k = 0; k < trials.control_ids.size(); ++k) {
    if (experiment.cables.columns.count(trials.control_ids[k]) > 0) {
      subject->first.push_back(k);
    } else if (trials.control_values[k].size() > most) {
      most = trials.control_values[k].size();
      subject->load = static_cast<int>(k);
    }
  }
  subject->find(experiment.materials);
  coarsen(0.05, [&](double factor) {
    const MeshSettings settings = refined(experiment.mesh, experiment.geometry, factor);
    subject->unknowns = static_cast<int>(make_mesh(experiment, settings).X.size());
    subject->coarse = settings;
    const int allowed = experiment.geometry.dimension == 2 ? most_unknowns : most_unknowns_3d;
    return subject->unknowns <= allowed || !refinable(experiment.geometry);
  });
  return subject;
}

/// A static solve of an experiment that was changed.
struct StaticCase {
  Experiment experiment;
  MeshSettings mesh;
  std::vector<double> controls;
  bool retract_first = false;
  double perturbed = 0;  ///< amplitude of the start's noise [m]
};

/// One ingredient of the solver changed; all else as it is.
struct NaiveMethod {
  std::string name;
  std::function<void(StaticCase&)> change;
};

EquilibriumOptions::Comparison& comparison(StaticCase& what) {
  return what.experiment.equilibrium.comparison;
}

/// First those that change how Newton's method goes on; last those that need contact.
const std::vector<NaiveMethod> static_methods{
    {"default", [](StaticCase&) {}},
    {"Hessian always projected", [](StaticCase& what) { comparison(what).always_project = true; }},
    {"no line search", [](StaticCase& what) { comparison(what).line_search = LineSearch::none; }},
    {"energy only, straight steps",
     [](StaticCase& what) {
       comparison(what).line_search = LineSearch::armijo;
       comparison(what).straight_steps = true;
     }},
    {"no test for a minimum", [](StaticCase& what) { what.experiment.equilibrium.check_minimum = false; }},
    {"penalty contact", [](StaticCase& what) { what.experiment.contact.form = ContactForm::penalty; }},
    {"steps not stopped by contact", [](StaticCase& what) { comparison(what).ignore_contact = true; }},
};
const std::vector<NaiveMethod> newton_methods(static_methods.begin(), static_methods.begin() + 4);
const std::vector<NaiveMethod> contact_methods(static_methods.end() - 2, static_methods.end());

struct StaticAnswer {
  StabilityRun run;
  double reading = not_a_number;  ///< of the first channel, from the unloaded state [m]; NaN where it does not arrive
  Eigen::VectorXd u;              ///< empty where it does not arrive, or slips
};

/// `reference`: displacements of the right answer; empty where they are not known.
StaticAnswer solve_case(const StaticCase& what, const StaticSubject& subject, const Eigen::VectorXd& reference = {}) {
  const EquilibriumOptions& options = what.experiment.equilibrium;
  const BenchModel bench = make_model(what.experiment, what.mesh, subject.trials);
  const Model& model = *bench.scene.model;
  Params rest = bench.scene.values, unloaded = rest, p = rest;
  for (int index : bench.off_at_rest) rest[index] = 0;
  for (size_t k = 0; k < what.controls.size(); ++k) {
    p[bench.controls[k]] = what.controls[k];
    unloaded[bench.controls[k]] = subject.retracts(k) ? what.controls[k] : 0.0;
  }
  Equilibrium equilibrium(model, options);
  equilibrium.start_at_rest(rest);
  if (what.perturbed > 0) {
    std::mt19937 random(1);
    std::uniform_real_distribution<double> uniform(-1, 1);
    Eigen::VectorXd noise(model.unknowns());
    for (double& entry : noise) entry = what.perturbed * uniform(random);
    equilibrium.start_beyond(Eigen::VectorXd::Zero(noise.size()), model.extend_from_free(model.restrict_to_free(noise)),
                             rest);
  }
  StaticAnswer answer;
  SolveReport retracting;
  double before = 0;
  bool going = true;
  const auto reading_at = [&](const Params& at) {
    return bench.channels.front().channel->value({equilibrium.u(), at});
  };
  if (what.retract_first) {
    going = equilibrium.solve(unloaded).status == SolveStatus::converged;
    if (going) retracting = equilibrium.report();
    before = reading_at(unloaded);
  }
  if (going && equilibrium.solve(p).status == SolveStatus::converged) {
    answer.reading = reading_at(p) - before;
    if (!equilibrium.report().slipped) answer.u = equilibrium.u();
  }
  answer.run = judge(equilibrium, options, p, reference, static_tolerance, subject.contact());
  answer.run.iterations += retracting.iterations;
  answer.run.factorisations += retracting.factorisations;
  return answer;
}

/// The default's path in small steps, looked after for slips.
StaticAnswer refined_path(StaticCase what, const StaticSubject& subject) {
  what.retract_first = true;
  what.perturbed = 0;
  EquilibriumOptions& options = what.experiment.equilibrium;
  options.load_steps = 4;
  options.check_path = true;
  options.max_halvings = 10;
  options.max_total_iterations = 1000;
  return solve_case(what, subject);
}

/// Runs a case and judges it by displacements.
StabilityRun run_case(const StaticCase& what, const StaticSubject& subject, const Eigen::VectorXd& reference) {
  StabilityRun run = solve_case(what, subject, reference).run;
  // Where the refined path slips or ends before, no path leads to what was found.
  if (reference.size() == 0 && run.outcome < Outcome::elsewhere) run.outcome = Outcome::elsewhere;
  return run;
}

/// Runs a case and judges it by the first channel's reading. `right`: NaN where there is none.
StabilityRun run_case(const StaticCase& what, const StaticSubject& subject, double right) {
  auto [run, reading, u] = solve_case(what, subject);
  if (run.outcome > Outcome::elsewhere || !std::isfinite(right)) return run;
  run.error = reading / right - 1;
  if (run.error < too_stiff - 1) run.outcome = Outcome::locked;
  if (run.error > 1 - too_stiff) run.outcome = Outcome::elsewhere;
  return run;
}

using Place = std::pair<size_t, size_t>;  ///< x and y in a map

/// A map whose cells are cases, changed by each method, and judged by the reference of their place; cells share that
/// where it is the same for them.
template <class CaseOf, class PlaceOf, class ReferenceOf>
StabilityMap filled(StabilityMap map, Subject subject, const std::vector<NaiveMethod>& methods, CaseOf case_of,
                    PlaceOf place_of, ReferenceOf reference_of) {
  for (const NaiveMethod& method : methods) map.methods.push_back(method.name);
  using References = std::map<Place, decltype(reference_of(size_t{}, size_t{}))>;
  map.run = [=, references = std::make_shared<References>()](size_t m, size_t x, size_t y) {
    const Place place = place_of(x, y);
    const auto& reference = remembered(*references, place, [&] { return reference_of(place.first, place.second); });
    StaticCase what = case_of(x, y);
    what.experiment.contact.form = ContactForm::length_weighted;
    methods[m].change(what);
    return run_case(what, *subject, reference);
  };
  return map;
}

/// The same, judged by the displacements of the refined path.
template <class CaseOf, class PlaceOf>
StabilityMap judged_by_path(StabilityMap map, Subject subject, const std::vector<NaiveMethod>& methods, CaseOf case_of,
                            PlaceOf place_of) {
  const auto reference_of = [=](size_t x, size_t y) { return refined_path(case_of(x, y), *subject).u; };
  return filled(std::move(map), subject, methods, case_of, place_of, reference_of);
}

/// Cells of one x, or all of them, share a path: what it takes does not change with y.
constexpr auto of_cell = [](size_t x, size_t y) { return Place(x, y); };
constexpr auto of_column = [](size_t x, size_t) { return Place(x, 0); };
constexpr auto of_map = [](size_t, size_t) { return Place(0, 0); };

StabilityMap retraction_over_load(Subject subject) {
  const std::vector<double> loads{0.1, 0.4, 1, 1.5, 2}, retractions{0, 0.35, 0.7, 1, 1.2};
  const auto [load_label, load_texts] = subject->axis(static_cast<size_t>(subject->load), loads);
  const auto [length_label, length_texts] = subject->axis(subject->first.front(), retractions);
  std::vector<NaiveMethod> methods = static_methods;
  if (!subject->contact()) methods.resize(methods.size() - contact_methods.size());
  methods.front().name = "default, all at once";
  methods.insert(methods.begin(), {"default, retraction first", [](StaticCase& what) { what.retract_first = true; }});
  const auto case_of = [=](size_t x, size_t y) {
    return StaticCase{subject->experiment, subject->coarse, subject->controls(retractions[y], loads[x])};
  };
  return judged_by_path({"retraction_load", "Retraction and load at once, from rest",
                         subject->mesh_text() + "; only the first panel retracts before it loads, as the bench does",
                         load_label, length_label, load_texts, length_texts},
                        subject, methods, case_of, of_cell);
}

const std::vector<std::string> step_counts{"1", "2", "4", "8", "16"};

/// A case with the load steps of a place of `step_counts`.
StaticCase stepped(const StaticSubject& subject, std::vector<double> controls, size_t y) {
  StaticCase what{subject.experiment, subject.coarse, std::move(controls)};
  what.experiment.equilibrium.load_steps = 1 << y;
  return what;
}

StabilityMap ratio_over_steps(Subject subject) {
  const std::vector<double> ratios{1e1, 1e3, 1e5, 1e6, 1e7};
  const auto case_of = [=](size_t x, size_t y) {
    StaticCase what = stepped(*subject, subject->controls(0.33, 1), y);
    subject->set_ratio(what.experiment.materials, ratios[x]);
    return what;
  };
  return judged_by_path({"stiffness_ratio", "A stiff part beside a soft one",
                         subject->mesh_text() + "; a third of the largest retraction and the largest load, all at once",
                         subject->ratio_label(), "load steps", powers_of_ten(ratios), step_counts},
                        subject, newton_methods, case_of, of_column);
}

StabilityMap load_over_steps(Subject subject) {
  const std::vector<double> loads{1, 3, 10, 30, 100};
  const auto [label, texts] = subject->axis(static_cast<size_t>(subject->load), loads);
  const auto case_of = [=](size_t x, size_t y) { return stepped(*subject, subject->controls(0, loads[x]), y); };
  return judged_by_path(
      {"load_steps", "Loads far beyond the bench's own", subject->mesh_text(), label, "load steps", texts, step_counts},
      subject, newton_methods, case_of, of_column);
}

StabilityMap poisson_over_element(Subject subject) {
  const std::vector<double> ratios{0, 0.3, 0.45, 0.49, 0.4999};
  const std::vector<std::pair<int, Formulation>> elements{
      {1, Formulation::standard}, {2, Formulation::standard}, {2, Formulation::locking_free}};
  const Experiment& experiment = subject->experiment;
  const auto of_element = [=](MeshSettings mesh, size_t y) {
    std::tie(mesh.order, mesh.formulation) = elements[y];
    return mesh;
  };
  const auto case_on = [=](const MeshSettings& mesh, size_t x, size_t y) {
    StaticCase what{subject->experiment, of_element(mesh, y), subject->controls(0.35, 0.1), true};
    material_of(what.experiment.materials, subject->soft).constants["nu"] = ratios[x];
    return what;
  };
  const auto case_of = [=](size_t x, size_t y) { return case_on(subject->coarse, x, y); };
  const auto reference_of = [=, fine = refined(experiment.mesh, experiment.geometry, 1.5)](size_t x, size_t) {
    return solve_case(case_on(fine, x, 2), *subject).reading;
  };
  const auto own_mesh = [=](StaticCase& what) {
    MeshSettings own = subject->experiment.mesh;
    own.order = what.mesh.order;
    own.formulation = what.mesh.formulation;
    what.mesh = own;
  };
  StabilityMap map{
      "poisson_element",
      fmt::format("Elements as {} becomes incompressible", subject->soft),
      fmt::format("error of '{}' at a small load, against locking-free elements 1.5 times finer than its own; coarse: "
                  "{} unknowns",
                  experiment.channels.front().id, subject->unknowns),
      fmt::format("Poisson's ratio of {}", subject->soft),
      "element",
      {"0", "0.3", "0.45", "0.49", "0.4999"},
      {"linear", "quadratic", "locking-free"}};
  map.elsewhere = "too soft by over 10 %";
  map.shows_error = true;
  const std::vector<NaiveMethod> methods{{"default, coarse mesh", static_methods[0].change},
                                         {"default, own mesh", own_mesh},
                                         {"projected, coarse mesh", static_methods[1].change}};
  return filled(std::move(map), subject, methods, case_of, of_column, reference_of);
}

StabilityMap gap_over_size(Subject subject) {
  const std::vector<double> sizes{1, 0.8, 0.6, 0.45};
  const auto mesh_of = [=](double size, double gap) {
    MeshSettings mesh = refined(subject->coarse, subject->experiment.geometry, 1 / size);
    mesh.contact_gap = gap;
    return mesh;
  };
  // The largest gap is the largest that the finest mesh admits at rest, by halves.
  double most = 1e-2 * make_mesh(subject->experiment, subject->coarse).diagonal();
  const auto admitted = [&](double gap) {
    try {
      make_model(subject->experiment, mesh_of(sizes.back(), gap), subject->trials);
    } catch (const InputError&) {
      return false;
    }
    return true;
  };
  for (int halved = 0; halved < 12 && !admitted(most); ++halved) most *= 0.5;
  const std::vector<double> gaps{most / 200, most / 20, most / 4, most};
  const auto case_of = [=](size_t x, size_t y) {
    return StaticCase{subject->experiment, mesh_of(sizes[y], gaps[x]), subject->controls(1, 0.4), true};
  };
  const auto reference_of = [=](size_t, size_t) { return solve_case(case_of(0, sizes.size() - 1), *subject).reading; };
  StabilityMap map{
      "contact_gap",
      "Contact gap of the closed module",
      fmt::format("largest retraction, then 40 % of the largest load; error against the smallest gap and elements; "
                  "100 %: {} unknowns",
                  subject->unknowns),
      "contact gap [um]",
      "element size [%]",
      numbers(gaps, 1e-6),
      numbers(sizes, 1e-2)};
  map.elsewhere = "too soft by over 10 %";
  map.shows_error = true;
  std::vector<NaiveMethod> methods{
      {"default: length-weighted", static_methods[0].change},
      {"sum over pairs", [](StaticCase& what) { what.experiment.contact.form = ContactForm::pair_sum; }}};
  methods.insert(methods.end(), contact_methods.begin(), contact_methods.end());
  return filled(std::move(map), subject, methods, case_of, of_map, reference_of);
}

StabilityMap start_over_steps(Subject subject) {
  const std::vector<double> amplitudes{0, 0.005, 0.01, 0.02, 0.05};
  const Mesh mesh = make_mesh(subject->experiment, subject->coarse);
  double volume = 0;
  for (double measure : element_measures(mesh)) volume += measure;
  const double mean = std::pow(volume / mesh.element_count(), 1.0 / mesh.dimension());
  const auto case_of = [=](size_t x, size_t y) {
    StaticCase what = stepped(*subject, subject->controls(0.33, 1), y);
    what.perturbed = mean * amplitudes[x];
    return what;
  };
  return judged_by_path(
      {"perturbed_start", "A crumpled start",
       subject->mesh_text() + "; nodes moved at random (seed 1); a third of the largest retraction, largest load",
       "noise / element size", "load steps", numbers(amplitudes), step_counts},
      subject, newton_methods, case_of, of_map);
}

// ---- over time

/// What the maps of a simulation share: a start just before the first touch, and a short while from there. Controls
/// stay at their first values, so that bodies at rest are in equilibrium.
struct FlightSubject : Contrast {
  Simulation simulation;     ///< on a coarse mesh
  double t = 0, length = 0;  ///< start and length of the while [s]
  Eigen::VectorXd u, v;
  int unknowns = 0;
  std::string flying;  ///< region of the bodies without supports, else the stiff one
};

/// Bodies that nothing holds.
std::vector<const BodySettings*> free_bodies(const Simulation& simulation) {
  std::vector<const BodySettings*> free;
  for (const BodySettings& body : simulation.bodies) {
    const auto holds = [&](const JointSettings& joint) {
      return joint.part_a == body.name || joint.part_b == body.name;
    };
    const auto pulls = [&](const CableSettings& cable) { return cable.body == body.name; };
    if (body.fixed.empty() && std::none_of(simulation.joints.begin(), simulation.joints.end(), holds) &&
        std::none_of(simulation.cables.cables.begin(), simulation.cables.cables.end(), pulls))
      free.push_back(&body);
  }
  return free;
}

/// Lets what is free fly until it all but touches something.
void fly(FlightSubject& subject, const Robot& robot) {
  const Simulation& simulation = subject.simulation;
  const Mesh& mesh = robot.scene.model->mesh();
  const int d = mesh.dimension();
  Eigen::VectorXd fall = Eigen::VectorXd::Zero(d);
  if (!simulation.gravity_direction.empty()) {
    fall = Eigen::Map<const Eigen::VectorXd>(simulation.gravity_direction.data(), d);
    fall *= simulation.gravity / fall.norm();
  }
  Eigen::VectorXd pull = Eigen::VectorXd::Zero(mesh.X.size());
  for (const BodySettings* body : free_bodies(simulation)) {
    const Part& part = mesh.part(body->name);
    for (int node = part.first_node; node < part.first_node + part.node_count; ++node)
      pull.segment(static_cast<Eigen::Index>(node) * d, d) = fall;
  }
  const auto at = [&](double t) { return Eigen::VectorXd(t * robot.velocity + 0.5 * t * t * pull); };
  subject.u = Eigen::VectorXd::Zero(mesh.X.size());
  subject.v = robot.velocity;
  if (!robot.smallest_distance || pull.isZero(0)) return;
  const double near = 2 * simulation.contact.gap;
  const double threshold = 0.999 * std::min(near, robot.smallest_distance(subject.u, near));
  const double step = 1e-3 * simulation.duration;
  for (double t = step; t < simulation.duration; t += step) {
    if (!(robot.smallest_distance(at(t), near) < threshold) && !robot.intersects(at(t))) continue;
    double low = t - step, high = t;
    for (int k = 0; k < 40; ++k) {
      const double middle = 0.5 * (low + high);
      (robot.smallest_distance(at(middle), near) < threshold || robot.intersects(at(middle)) ? high : low) = middle;
    }
    subject.t = low;
    subject.u = at(low);
    subject.v = robot.velocity + low * pull;
    return;
  }
}

std::shared_ptr<const FlightSubject> subject_of(const Simulation& simulation) {
  if (simulation.method == SimulationMethod::quasi_static)
    throw InputError(
        fmt::format("{}: a quasi-static simulation has no time steps; 'taut chart stability' takes benches "
                    "with readings at rest and simulations over time",
                    simulation.path));
  auto subject = std::make_shared<FlightSubject>();
  coarsen(0.1, [&](double factor) {
    Simulation coarse = simulation;
    coarse.equilibrium.stop = nullptr;
    for (BodySettings& body : coarse.bodies) body.mesh = refined(body.mesh, body.geometry, factor);
    subject->unknowns = make_robot(coarse).scene.model->free_unknowns();
    subject->simulation = coarse;
    return subject->unknowns <= most_unknowns_3d;
  });
  subject->find(simulation.materials);
  const Robot robot = make_robot(subject->simulation);
  fly(*subject, robot);
  subject->length = 20 * simulation.step;
  subject->flying = subject->stiff;
  if (const auto free = free_bodies(simulation); !free.empty()) {
    const Mesh& mesh = robot.scene.model->mesh();
    subject->flying = mesh.region_names[static_cast<size_t>(
        mesh.region[static_cast<size_t>(mesh.part(free[0]->name).first_element)])];
  }
  return subject;
}

struct FlightMethod {
  const char* name;
  Integrator integrator = Integrator::implicit_euler;
  bool ignores_contact = false, is_explicit = false;
};
const std::vector<FlightMethod> flight_methods{{"default: implicit Euler"},
                                               {"BDF2", Integrator::bdf2},
                                               {"steps not stopped by contact", Integrator::implicit_euler, true},
                                               {"explicit Runge-Kutta", Integrator::implicit_euler, false, true}};

/// The last state of a run over time, and what was seen on the way.
struct Flown {
  bool arrived = false, folded = false, crossed = false;
  int failures = 0;
  StabilityRun run;  ///< not yet judged
  Eigen::VectorXd u;

  void look(const Robot& robot, const Eigen::VectorXd& state) {
    u = state;
    folded = folded || !(smallest_jacobian(robot.scene.model->mesh(), u) > 0);
    crossed = crossed || (robot.intersects && robot.intersects(u));
  }
};

Flown step_through(const FlightSubject& subject, const Robot& robot, double h, const FlightMethod& method) {
  TimeStepperOptions options;
  options.step = h;
  options.integrator = method.integrator;
  options.shortest = 1.0 / 64;
  options.equilibrium = subject.simulation.equilibrium;
  options.equilibrium.comparison.ignore_contact = method.ignores_contact;
  TimeStepper stepper(*robot.scene.model, options);
  const Params p = robot.at(subject.simulation, 0);
  stepper.start(0, subject.u, subject.v, [&](double) { return p; });
  Flown flown;
  flown.u = stepper.u();
  bool going = true;
  for (int steps = 0; going && stepper.t() < subject.length && steps < most_steps && !flown.crossed; ++steps) {
    going = stepper.advance(subject.length);
    flown.look(robot, stepper.u());
  }
  const TimeStepperReport& report = stepper.report();
  flown.arrived = going && stepper.t() >= subject.length;
  flown.failures = report.failures;
  flown.run.iterations = report.iterations;
  flown.run.factorisations = report.factorisations;
  return flown;
}

/// Explicit Runge-Kutta steps of order 4, as long as its error control lets them be, up to h.
Flown leap_through(const FlightSubject& subject, const Robot& robot, double h) {
  OdeOptions options;
  options.method = OdeMethod::explicit_runge_kutta;
  options.tolerance = 1e-3;
  options.longest_step = h;
  options.max_steps = most_steps;
  OdeIntegrator integrator(*robot.scene.model, options);
  const Params p = robot.at(subject.simulation, 0);
  integrator.start(0, subject.u, subject.v, [&](double) { return p; });
  Flown flown;
  flown.arrived = integrator.advance_to(subject.length);
  flown.crossed = integrator.report().status == OdeStatus::passed_through;
  flown.look(robot, integrator.u());
  flown.run.iterations = integrator.report().evaluations;
  return flown;
}

StabilityRun run_flight(const FlightSubject& subject, const Robot& robot, const FlightMethod& method, double h,
                        const Eigen::VectorXd& reference) {
  const Flown flown = method.is_explicit ? leap_through(subject, robot, h) : step_through(subject, robot, h, method);
  StabilityRun run = flown.run;
  if (reference.size() > 0 && flown.arrived) run.error = largest(flown.u - reference) / largest(reference - subject.u);
  run.outcome = flown.crossed                          ? Outcome::intersected
                : flown.folded || !flown.u.allFinite() ? Outcome::inverted
                : !flown.arrived                       ? Outcome::diverged
                : run.error > dynamic_tolerance        ? Outcome::elsewhere
                : flown.failures > 0                   ? Outcome::cut_back
                                                       : Outcome::converged;
  return run;
}

/// A map over time steps and what `alter` changes.
StabilityMap time_map(std::shared_ptr<const FlightSubject> subject, StabilityMap map,
                      std::function<void(Simulation&, size_t y)> alter) {
  const std::vector<double> steps{0.2, 1, 4, 10, 20};
  const double own = subject->simulation.step;
  const DisplayUnit unit = display_unit(own, "s");
  map.setting = fmt::format(
      "{:.3g} ms {}, coarse mesh: {} unknowns; against BDF2 with half of the shortest step; at most {} steps",
      1e3 * subject->length, subject->t > 0 ? "from the first touch on" : "from the start on", subject->unknowns,
      most_steps);
  map.x_label = fmt::format("time step [{}]", unit.name);
  map.x = numbers(steps, unit.factor, own);
  for (const FlightMethod& method : flight_methods) map.methods.push_back(method.name);
  map.elsewhere = fmt::format("off by over {:.0f} %", 100 * dynamic_tolerance);
  map.shows_error = true;
  struct Row {
    Robot robot;
    Eigen::VectorXd reference;
  };
  map.run = [=, rows = std::make_shared<std::map<size_t, Row>>()](size_t m, size_t x, size_t y) {
    const Row& row = remembered(*rows, y, [&] {
      Simulation altered = subject->simulation;
      alter(altered, y);
      Row made{make_robot(altered), {}};
      const Flown fine = step_through(*subject, made.robot, 0.5 * steps[0] * own, {"reference", Integrator::bdf2});
      if (fine.arrived) made.reference = fine.u;
      return made;
    });
    return run_flight(*subject, row.robot, flight_methods[m], steps[x] * own, row.reference);
  };
  return map;
}

// ---- store

const Cells map_columns{"map", "method", "x", "y", "outcome", "iterations", "factorisations", "error", "fingerprint"};

/// In the order of Outcome.
constexpr std::array<std::string_view, 8> outcome_names{"converged", "cut back", "locked",   "elsewhere",
                                                        "saddle",    "diverged", "inverted", "intersected"};

Cells cells_of(const StabilityRun& run) {
  return {std::string(name_of(run.outcome)), fmt::format("{}", run.iterations), fmt::format("{}", run.factorisations),
          std::isfinite(run.error) ? fmt::format("{}", run.error) : ""};
}

std::optional<StabilityRun> run_of(const Cells& cells) {
  const auto outcome = std::ranges::find(outcome_names, cells[0]);
  const auto iterations = parse_number(cells[1]), factorisations = parse_number(cells[2]);
  if (outcome == outcome_names.end() || !iterations || !factorisations) return std::nullopt;
  return StabilityRun{static_cast<Outcome>(outcome - outcome_names.begin()), static_cast<int>(*iterations),
                      static_cast<int>(*factorisations), parse_number(cells[3]).value_or(not_a_number)};
}

/// A cell of a map among the settings of a study.
struct CellOf {
  const StabilityMap* map;
  size_t method, x, y;
  std::optional<StabilityRun>* run;  ///< its place
};

/// A cell as a setting. Older tables have no quotes, so a comma is none here either.
StudySetting setting_of(const CellOf& cell) {
  const StabilityMap& map = *cell.map;
  Cells key{map.id, map.methods[cell.method], map.x[cell.x], map.y[cell.y]};
  for (std::string& text : key) std::ranges::replace(text, ',', ';');
  return {key, fmt::format("{}, {}", map.id, map.methods[cell.method])};
}

}  // namespace

std::string_view name_of(Outcome outcome) {
  return outcome_names[static_cast<size_t>(outcome)];
}

StabilityRun judge(Equilibrium& equilibrium, const EquilibriumOptions& options, const Params& p,
                   const Eigen::VectorXd& reference, double tolerance, bool contact) {
  const Model& model = equilibrium.model();
  const SolveReport report = equilibrium.report();
  StabilityRun run;
  run.iterations = report.iterations;
  run.factorisations = report.factorisations;
  if (contact && model.mesh().dimension() == 2 && crosses(model.mesh(), equilibrium.u())) {
    run.outcome = Outcome::intersected;
  } else if (!(smallest_jacobian(model.mesh(), equilibrium.u()) > 0) ||
             report.status == SolveStatus::infeasible_start) {
    run.outcome = Outcome::inverted;
  } else if (report.status != SolveStatus::converged && report.status != SolveStatus::not_a_minimum) {
    // Full steps end early only where the energy is infinite; what the whole load does from here tells.
    Equilibrium probe(model, options);
    probe.start_at(equilibrium.u(), p);
    const bool early =
        options.comparison.line_search == LineSearch::none && probe.solve(p).status == SolveStatus::stalled;
    run.outcome = early ? Outcome::inverted : Outcome::diverged;
  } else if (report.status == SolveStatus::not_a_minimum || !equilibrium.refactorise()) {
    run.outcome = Outcome::saddle;
  } else {
    if (reference.size() > 0) run.error = largest(equilibrium.u() - reference) / largest(reference);
    run.outcome = report.slipped || run.error > tolerance  ? Outcome::elsewhere
                  : report.load_steps > options.load_steps ? Outcome::cut_back
                                                           : Outcome::converged;
  }
  return run;
}

std::vector<StabilityMap> stability_maps(const Experiment& experiment, const Trials& trials) {
  const Subject subject = subject_of(experiment, trials);
  const bool loaded = subject->load >= 0, two = subject->soft != subject->stiff, cables = !subject->first.empty();
  std::vector<StabilityMap> maps;
  if (loaded && cables) maps.push_back(retraction_over_load(subject));
  if (two) maps.push_back(ratio_over_steps(subject));
  if (loaded && !two) maps.push_back(load_over_steps(subject));
  if (material_of(experiment.materials, subject->soft).constants.count("nu") > 0 &&
      experiment.geometry.plane == Plane::strain)
    maps.push_back(poisson_over_element(subject));
  if (subject->contact() && loaded && cables) maps.push_back(gap_over_size(subject));
  if (loaded) maps.push_back(start_over_steps(subject));
  return maps;
}

std::vector<StabilityMap> stability_maps(const Simulation& simulation) {
  const auto subject = subject_of(simulation);
  std::vector<StabilityMap> maps;
  if (subject->soft != subject->stiff) {
    const std::vector<double> ratios{1, 1e1, 1e2, 1e4, 1e6};
    const StabilityMap map{"step_stiffness",     "Time steps beside a stiff part", "", "", subject->ratio_label(), {},
                           powers_of_ten(ratios)};
    maps.push_back(time_map(subject, map,
                            [=](Simulation& altered, size_t y) { subject->set_ratio(altered.materials, ratios[y]); }));
  }
  if (material_of(simulation.materials, subject->flying).density) {
    const std::vector<double> factors{0.01, 0.1, 1, 10, 100};
    const StabilityMap map{"step_mass",
                           "Time steps when a light or a heavy body strikes",
                           "",
                           "",
                           fmt::format("density of {} / its own", subject->flying),
                           {},
                           numbers(factors)};
    maps.push_back(time_map(subject, map, [=](Simulation& altered, size_t y) {
      *material_of(altered.materials, subject->flying).density *= factors[y];
    }));
    maps.back().methods.pop_back();  // explicit ones are of no use here either
  }
  return maps;
}

std::vector<std::vector<std::optional<StabilityRun>>> run_stability(const std::vector<StabilityMap>& maps,
                                                                    const StudyOptions& options) {
  std::vector<std::vector<std::optional<StabilityRun>>> all;
  for (const StabilityMap& map : maps) all.emplace_back(map.cells());
  std::vector<CellOf> cells;
  Study study;
  study.columns = map_columns;
  study.keys = 4;
  for (size_t k = 0; k < maps.size(); ++k) {
    // Method by method innermost: they share what a place of the map needs.
    for (size_t y = 0; y < maps[k].y.size(); ++y) {
      for (size_t x = 0; x < maps[k].x.size(); ++x) {
        for (size_t m = 0; m < maps[k].methods.size(); ++m) {
          cells.push_back({&maps[k], m, x, y, &all[k][maps[k].cell(m, x, y)]});
          study.settings.push_back(setting_of(cells.back()));
        }
      }
    }
  }
  study.run = [&](size_t i, const Deadline&) {
    return StudyResult{cells_of(cells[i].map->run(cells[i].method, cells[i].x, cells[i].y))};
  };
  study.take = [&](size_t i, const Cells& result) {
    *cells[i].run = run_of(result);
    return cells[i].run->has_value();
  };
  run_study(study, options);
  return all;
}

}  // namespace taut

#include "calib/studies/stability.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <random>

#include "calib/studies/discretisation.hpp"
#include "sim/core/error.hpp"
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

std::vector<std::string> numbers(const std::vector<double>& values, double unit = 1) {
  std::vector<std::string> text;
  for (double value : values) text.push_back(number(value / unit));
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

// ---- at rest

/// One ingredient of the solver changed; all else as it is.
struct NaiveMethod {
  std::string name;
  std::function<void(EquilibriumOptions&)> change;
  ContactForm form = ContactForm::length_weighted;
};

std::vector<NaiveMethod> static_methods(bool contact) {
  std::vector<NaiveMethod> methods{
      {"default", [](EquilibriumOptions&) {}},
      {"Hessian always projected", [](EquilibriumOptions& o) { o.comparison.always_project = true; }},
      {"no line search", [](EquilibriumOptions& o) { o.comparison.line_search = LineSearch::none; }},
      {"energy only, straight steps",
       [](EquilibriumOptions& o) {
         o.comparison.line_search = LineSearch::armijo;
         o.comparison.straight_steps = true;
       }},
      {"no test for a minimum", [](EquilibriumOptions& o) { o.check_minimum = false; }},
  };
  if (contact) {
    methods.push_back({"penalty contact", [](EquilibriumOptions&) {}, ContactForm::penalty});
    methods.push_back(
        {"steps not stopped by contact", [](EquilibriumOptions& o) { o.comparison.ignore_contact = true; }});
  }
  return methods;
}

EquilibriumOptions map_options(const Experiment& experiment) {
  EquilibriumOptions options = experiment.equilibrium;
  options.stop = nullptr;
  options.max_iterations = 40;
  options.max_halvings = 5;
  options.max_total_iterations = 160;
  return options;
}

/// Those that change how Newton's method goes on.
std::vector<NaiveMethod> newton_methods() {
  std::vector<NaiveMethod> methods = static_methods(false);
  methods.pop_back();
  return methods;
}

std::vector<std::string> names_of(const std::vector<NaiveMethod>& methods) {
  std::vector<std::string> names;
  for (const NaiveMethod& method : methods) names.push_back(method.name);
  return names;
}

/// What the maps of a bench experiment share.
struct StaticSubject {
  Experiment experiment;
  Trials trials;
  MeshSettings coarse;
  int unknowns = 0;
  std::vector<size_t> first;  ///< controls that are set before the others: retractions
  int load = -1;              ///< the control with most values among the others; -1: none
  std::string soft, stiff;    ///< regions; equal where there is one material

  bool contact() const { return experiment.contact.on; }
  double top(size_t control) const { return *trials.control_values[control].rbegin(); }
  /// Controls with the retractions at a fraction of their largest value and the load at one of its own.
  std::vector<double> controls(double retraction, double loads) const {
    std::vector<double> values(trials.control_ids.size(), 0.0);
    for (size_t k = 0; k < values.size(); ++k) {
      const bool before = std::find(first.begin(), first.end(), k) != first.end();
      values[k] = (before ? retraction : static_cast<int>(k) == load ? loads : 0) * top(k);
    }
    return values;
  }
};

std::shared_ptr<const StaticSubject> subject_of(const Experiment& experiment, const Trials& trials) {
  if (!experiment.kind->at_rest)
    throw InputError(
        fmt::format("{}: its bench holds recordings over time; 'taut chart stability' takes benches with "
                    "readings at rest and simulations over time",
                    experiment.path));
  auto subject = std::make_shared<StaticSubject>();
  subject->experiment = experiment;
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
  const auto modulus = [&](const std::string& region) {
    for (const MaterialSettings& material : experiment.materials) {
      const auto E = material.constants.find("E");
      if (material.region == region && E != material.constants.end()) return E->second;
    }
    return 0.0;
  };
  subject->soft = subject->stiff = experiment.materials.front().region;
  for (const MaterialSettings& material : experiment.materials) {
    if (modulus(material.region) == 0) continue;
    if (modulus(material.region) < modulus(subject->soft)) subject->soft = material.region;
    if (modulus(material.region) > modulus(subject->stiff)) subject->stiff = material.region;
  }
  for (double factor = 1; factor > 0.05; factor /= 1.25) {
    try {
      const MeshSettings settings = refined(experiment.mesh, experiment.geometry, factor);
      const auto size = make_mesh(experiment, settings).X.size();
      subject->coarse = settings;
      subject->unknowns = static_cast<int>(size);
      const int allowed = experiment.geometry.dimension == 2 ? most_unknowns : most_unknowns_3d;
      if (size <= allowed || !refinable(experiment.geometry)) break;
    } catch (const InputError&) {
      if (subject->unknowns == 0) throw;
      break;  // too coarse for the geometry
    }
  }
  return subject;
}

/// A static solve of an experiment that was changed.
struct StaticCase {
  Experiment experiment;
  MeshSettings mesh;
  std::vector<double> controls;
  bool retract_first = false;
  double perturbed = 0;  ///< amplitude of the start's noise [m]
  int load_steps = 1;
};

struct StaticAnswer {
  BenchModel model;
  std::unique_ptr<Equilibrium> equilibrium;
  Params p;
  double reading = not_a_number;  ///< of the first channel, from the unloaded state [m]
  bool reached = false;
  int iterations = 0, factorisations = 0;  ///< before the last solve
};

StaticAnswer solve_case(const StaticCase& what, const Trials& trials, const EquilibriumOptions& options) {
  StaticAnswer answer;
  answer.model = make_model(what.experiment, what.mesh, trials);
  const Scene& scene = answer.model.scene;
  EquilibriumOptions stepped = options;
  stepped.load_steps = what.load_steps;
  answer.equilibrium = std::make_unique<Equilibrium>(*scene.model, stepped);
  Equilibrium& equilibrium = *answer.equilibrium;
  Params rest = scene.values, unloaded;
  for (int index : answer.model.off_at_rest) rest[index] = 0;
  answer.p = scene.values;
  for (size_t k = 0; k < what.controls.size(); ++k) answer.p[answer.model.controls[k]] = what.controls[k];
  unloaded = answer.p;
  for (size_t k = 0; k < what.controls.size(); ++k) {
    if (what.experiment.cables.columns.count(what.experiment.bench.controls[k].id) == 0)
      unloaded[answer.model.controls[k]] = 0;
  }
  equilibrium.start_at_rest(rest);
  if (what.perturbed > 0) {
    std::mt19937 random(1);
    std::uniform_real_distribution<double> uniform(-1, 1);
    Eigen::VectorXd noise(scene.model->unknowns());
    for (Eigen::Index i = 0; i < noise.size(); ++i) noise[i] = what.perturbed * uniform(random);
    equilibrium.start_beyond(Eigen::VectorXd::Zero(noise.size()),
                             scene.model->extend_from_free(scene.model->restrict_to_free(noise)), rest);
  }
  double before = 0;
  if (what.retract_first) {
    if (equilibrium.solve(unloaded).status != SolveStatus::converged) return answer;
    before = answer.model.channels.front().channel->value({equilibrium.u(), unloaded});
    answer.iterations = equilibrium.report().iterations;
    answer.factorisations = equilibrium.report().factorisations;
  }
  answer.reached = equilibrium.solve(answer.p).status == SolveStatus::converged;
  answer.reading = answer.model.channels.front().channel->value({equilibrium.u(), answer.p}) - before;
  return answer;
}

StaticCase refined_path(StaticCase what) {
  what.retract_first = true;
  what.perturbed = 0;
  what.load_steps = 4;
  return what;
}

/// Displacements of the default's path in small steps, looked after for slips; empty where it does not arrive.
Eigen::VectorXd reference_of(const StaticCase& what, const StaticSubject& subject) {
  EquilibriumOptions options = map_options(subject.experiment);
  options.check_path = true;
  options.max_halvings = 10;
  options.max_total_iterations = 1000;
  const StaticAnswer answer = solve_case(refined_path(what), subject.trials, options);
  return answer.reached && !answer.equilibrium->report().slipped ? answer.equilibrium->u() : Eigen::VectorXd();
}

StabilityRun judged(const StaticAnswer& answer, const EquilibriumOptions& options, const Eigen::VectorXd& reference,
                    bool contact) {
  StabilityRun run = judge(*answer.equilibrium, options, answer.p, reference, static_tolerance, contact);
  run.iterations += answer.iterations;
  run.factorisations += answer.factorisations;
  return run;
}

/// Runs a case by a method and judges it by displacements.
StabilityRun run_case(StaticCase what, const StaticSubject& subject, const NaiveMethod& method,
                      const Eigen::VectorXd& reference) {
  EquilibriumOptions options = map_options(subject.experiment);
  method.change(options);
  what.experiment.contact.form = method.form;
  const StaticAnswer answer = solve_case(what, subject.trials, options);
  options.load_steps = what.load_steps;
  StabilityRun run = judged(answer, options, reference, subject.contact());
  // Where the refined path slips or ends before, no path leads to what was found.
  if (reference.size() == 0 && run.outcome < Outcome::elsewhere) run.outcome = Outcome::elsewhere;
  return run;
}

/// Values that are computed once per (x, y) and used by all methods.
template <class Value>
class Remembered {
 public:
  template <class Compute>
  const Value& at(size_t x, size_t y, Compute&& compute) {
    const auto found = values_.find({x, y});
    return found != values_.end() ? found->second : values_.emplace(std::pair{x, y}, compute()).first->second;
  }

 private:
  std::map<std::pair<size_t, size_t>, Value> values_;
};

/// Makes a map's cells those of `case_of(method, x, y)`, judged by the displacements of the refined path of
/// `place_of(x, y)`.
template <class CaseOf, class PlaceOf>
void judge_by_path(StabilityMap& map, std::shared_ptr<const StaticSubject> subject,
                   const std::vector<NaiveMethod>& methods, CaseOf case_of, PlaceOf place_of) {
  map.methods = names_of(methods);
  map.run = [=, references = std::make_shared<Remembered<Eigen::VectorXd>>()](size_t m, size_t x, size_t y) {
    const StaticCase what = case_of(m, x, y);
    const auto [i, j] = place_of(x, y);
    return run_case(what, *subject, methods[m], references->at(i, j, [&] { return reference_of(what, *subject); }));
  };
}

/// Cells of one x, or all of them, share a path: what it takes does not change with y.
constexpr auto of_column = [](size_t x, size_t) { return std::pair(x, size_t{0}); };
constexpr auto of_map = [](size_t, size_t) { return std::pair(size_t{0}, size_t{0}); };

std::string mesh_text(const StaticSubject& subject) {
  return fmt::format("{} ({} unknowns)", subject.coarse.describe(), subject.unknowns);
}

/// The unit in which a control is shown, and its label.
std::pair<double, std::string> axis_of(const StaticSubject& subject, size_t control) {
  const Quantity quantity = subject.trials.control_quantities[control];
  const std::string si = units_of(quantity).front();
  const DisplayUnit unit = display_unit(subject.top(control), si);
  return {unit.factor, fmt::format("{} [{}]", subject.trials.control_ids[control], unit.name)};
}

StabilityMap retraction_over_load(std::shared_ptr<const StaticSubject> subject) {
  const auto load = static_cast<size_t>(subject->load), retraction = subject->first.front();
  const auto [load_unit, load_label] = axis_of(*subject, load);
  const auto [length_unit, length_label] = axis_of(*subject, retraction);
  const std::vector<double> loads{0.1, 0.4, 1, 1.5, 2}, retractions{0, 0.35, 0.7, 1, 1.2};
  std::vector<NaiveMethod> methods = static_methods(subject->contact());
  methods.insert(methods.begin(), {"default, retraction first", [](EquilibriumOptions&) {}});
  methods[1].name = "default, all at once";
  StabilityMap map;
  map.id = "retraction_load";
  map.title = "Retraction and load at once, from rest";
  map.setting = mesh_text(*subject) + "; only the first panel retracts before it loads, as the bench does";
  map.x_label = load_label;
  map.y_label = length_label;
  for (double x : loads) map.x.push_back(number(x * subject->top(load) / load_unit));
  for (double y : retractions) map.y.push_back(number(y * subject->top(retraction) / length_unit));
  const auto case_of = [=](size_t m, size_t x, size_t y) {
    return StaticCase{subject->experiment, subject->coarse, subject->controls(retractions[y], loads[x]), m == 0};
  };
  judge_by_path(map, subject, methods, case_of, [](size_t x, size_t y) { return std::pair(x, y); });
  return map;
}

void set_constant(std::vector<MaterialSettings>& materials, const std::string& region, const char* id, double value) {
  for (MaterialSettings& material : materials) {
    if (material.region == region) material.constants[id] = value;
  }
}

/// NaN where the region's law has none.
double constant_of(const std::vector<MaterialSettings>& materials, const std::string& region, const char* id) {
  for (const MaterialSettings& material : materials) {
    if (material.region == region && material.constants.count(id) > 0) return material.constants.at(id);
  }
  return not_a_number;
}

const std::vector<int> step_counts{1, 2, 4, 8, 16};

std::vector<std::string> step_texts() {
  std::vector<std::string> text;
  for (int count : step_counts) text.push_back(std::to_string(count));
  return text;
}

StabilityMap ratio_over_steps(std::shared_ptr<const StaticSubject> subject) {
  const std::vector<double> ratios{1e1, 1e3, 1e5, 1e6, 1e7};
  StabilityMap map;
  map.id = "stiffness_ratio";
  map.title = "A stiff part beside a soft one";
  map.setting = mesh_text(*subject) + "; a third of the largest retraction and the largest load, all at once";
  map.x_label = fmt::format("E of {} / E of {}", subject->stiff, subject->soft);
  map.y_label = "load steps";
  for (double ratio : ratios) map.x.push_back(fmt::format("1e{:.0f}", std::log10(ratio)));
  map.y = step_texts();
  const auto case_of = [=](size_t, size_t x, size_t y) {
    StaticCase what{subject->experiment, subject->coarse, subject->controls(0.33, 1), false, 0, step_counts[y]};
    std::vector<MaterialSettings>& materials = what.experiment.materials;
    set_constant(materials, subject->stiff, "E", ratios[x] * constant_of(materials, subject->soft, "E"));
    return what;
  };
  judge_by_path(map, subject, newton_methods(), case_of, of_column);
  return map;
}

StabilityMap load_over_steps(std::shared_ptr<const StaticSubject> subject) {
  const auto load = static_cast<size_t>(subject->load);
  const auto [unit, label] = axis_of(*subject, load);
  const std::vector<double> loads{1, 3, 10, 30, 100};
  StabilityMap map;
  map.id = "load_steps";
  map.title = "Loads far beyond the bench's own";
  map.setting = mesh_text(*subject);
  map.x_label = label;
  map.y_label = "load steps";
  for (double x : loads) map.x.push_back(number(x * subject->top(load) / unit));
  map.y = step_texts();
  const auto case_of = [=](size_t, size_t x, size_t y) {
    return StaticCase{subject->experiment, subject->coarse, subject->controls(0, loads[x]), false, 0, step_counts[y]};
  };
  judge_by_path(map, subject, newton_methods(), case_of, of_column);
  return map;
}

/// The first channel's reading in a case that the default solves; NaN where it does not arrive.
double right_reading(const StaticCase& what, const StaticSubject& subject) {
  const StaticAnswer answer = solve_case(what, subject.trials, map_options(subject.experiment));
  return answer.reached ? answer.reading : not_a_number;
}

/// Runs a case by a method and judges it by the first channel's reading. `right`: NaN where there is none.
StabilityRun run_by_reading(StaticCase what, const StaticSubject& subject, const NaiveMethod& method, double right) {
  EquilibriumOptions options = map_options(subject.experiment);
  method.change(options);
  what.experiment.contact.form = method.form;
  const StaticAnswer answer = solve_case(what, subject.trials, options);
  StabilityRun run = judged(answer, options, {}, subject.contact());
  if (run.outcome > Outcome::elsewhere || !std::isfinite(right)) return run;
  run.error = answer.reading / right - 1;
  if (run.error < too_stiff - 1) {
    run.outcome = Outcome::locked;
  } else if (run.error > 1 - too_stiff) {
    run.outcome = Outcome::elsewhere;
  }
  return run;
}

StabilityMap poisson_over_element(std::shared_ptr<const StaticSubject> subject) {
  const std::vector<double> ratios{0, 0.3, 0.45, 0.49, 0.4999};
  struct Element {
    const char* name;
    int order;
    Formulation formulation;
  };
  const std::vector<Element> elements{{"linear", 1, Formulation::standard},
                                      {"quadratic", 2, Formulation::standard},
                                      {"locking-free", 2, Formulation::locking_free}};
  StabilityMap map;
  map.id = "poisson_element";
  map.elsewhere = "too soft by over 10 %";
  map.title = fmt::format("Elements as {} becomes incompressible", subject->soft);
  map.setting = fmt::format(
      "error of '{}' at a small load, against locking-free elements 1.5 times finer than its own; coarse: {} unknowns",
      subject->experiment.channels.front().id, subject->unknowns);
  map.x_label = fmt::format("Poisson's ratio of {}", subject->soft);
  map.y_label = "element";
  map.x = {"0", "0.3", "0.45", "0.49", "0.4999"};
  for (const Element& element : elements) map.y.push_back(element.name);
  map.methods = {"default, coarse mesh", "default, own mesh", "projected, coarse mesh"};
  map.shows_error = true;
  map.run = [=, references = std::make_shared<Remembered<double>>()](size_t m, size_t x, size_t y) {
    StaticCase what{subject->experiment, subject->coarse, subject->controls(0.35, 0.1), true};
    set_constant(what.experiment.materials, subject->soft, "nu", ratios[x]);
    const double right = references->at(x, 0, [&] {
      StaticCase fine = what;
      fine.mesh = refined(subject->experiment.mesh, subject->experiment.geometry, 1.5);
      fine.mesh.order = 2;
      fine.mesh.formulation = Formulation::locking_free;
      return right_reading(fine, *subject);
    });
    if (m == 1) what.mesh = subject->experiment.mesh;
    what.mesh.order = elements[y].order;
    what.mesh.formulation = elements[y].formulation;
    return run_by_reading(what, *subject, {"", [&](EquilibriumOptions& o) { o.comparison.always_project = m == 2; }},
                          right);
  };
  return map;
}

StabilityMap gap_over_size(std::shared_ptr<const StaticSubject> subject) {
  const std::vector<double> sizes{1, 0.8, 0.6, 0.45};
  // The largest gap is the largest that the finest mesh admits at rest, by halves.
  double most = 1e-2 * make_mesh(subject->experiment, subject->coarse).diagonal();
  const auto admitted = [&](double gap) {
    MeshSettings settings = refined(subject->coarse, subject->experiment.geometry, 1 / sizes.back());
    settings.contact_gap = gap;
    try {
      make_model(subject->experiment, settings, subject->trials);
    } catch (const InputError&) {
      return false;
    }
    return true;
  };
  for (int halved = 0; halved < 12 && !admitted(most); ++halved) most *= 0.5;
  const std::vector<double> gaps{most / 200, most / 20, most / 4, most};
  const std::vector<std::pair<std::string, ContactForm>> forms{{"default: length-weighted", {}},
                                                               {"sum over pairs", ContactForm::pair_sum},
                                                               {"penalty contact", ContactForm::penalty}};
  StabilityMap map;
  map.id = "contact_gap";
  map.elsewhere = "too soft by over 10 %";
  map.title = "Contact gap of the closed module";
  map.setting = fmt::format(
      "largest retraction, then 40 % of the largest load; error against the smallest gap and elements; 100 %: {} "
      "unknowns",
      subject->unknowns);
  map.x_label = "contact gap [um]";
  map.y_label = "element size [%]";
  map.x = numbers(gaps, 1e-6);
  map.y = numbers(sizes, 1e-2);
  map.shows_error = true;
  for (const auto& [name, form] : forms) map.methods.push_back(name);
  map.methods.push_back("steps not stopped by contact");
  const auto barrier = [=](size_t x, size_t y) {
    StaticCase what{subject->experiment, refined(subject->coarse, subject->experiment.geometry, 1 / sizes[y]),
                    subject->controls(1, 0.4), true};
    what.mesh.contact_gap = gaps[x];
    return what;
  };
  map.run = [=, references = std::make_shared<Remembered<double>>()](size_t m, size_t x, size_t y) {
    const double right = references->at(0, 0, [&] { return right_reading(barrier(0, sizes.size() - 1), *subject); });
    const NaiveMethod method{"", [&](EquilibriumOptions& o) { o.comparison.ignore_contact = m == forms.size(); },
                             m < forms.size() ? forms[m].second : ContactForm::length_weighted};
    return run_by_reading(barrier(x, y), *subject, method, right);
  };
  return map;
}

StabilityMap start_over_steps(std::shared_ptr<const StaticSubject> subject) {
  const std::vector<double> amplitudes{0, 0.005, 0.01, 0.02, 0.05};
  const Mesh mesh = make_mesh(subject->experiment, subject->coarse);
  double volume = 0;
  for (double measure : element_measures(mesh)) volume += measure;
  const double mean = std::pow(volume / mesh.element_count(), 1.0 / mesh.dimension());
  StabilityMap map;
  map.id = "perturbed_start";
  map.title = "A crumpled start";
  map.setting =
      mesh_text(*subject) + "; nodes moved at random (seed 1); a third of the largest retraction, largest load";
  map.x_label = "noise / element size";
  map.y_label = "load steps";
  map.x = numbers(amplitudes);
  map.y = step_texts();
  const auto case_of = [=](size_t, size_t x, size_t y) {
    return StaticCase{subject->experiment,  subject->coarse, subject->controls(0.33, 1), false,
                      mean * amplitudes[x], step_counts[y]};
  };
  judge_by_path(map, subject, newton_methods(), case_of, of_map);
  return map;
}

// ---- over time

/// What the maps of a simulation share: a start just before the first touch, and a short while from there. Controls
/// stay at their first values, so that bodies at rest are in equilibrium.
struct FlightSubject {
  Simulation simulation;     ///< on a coarse mesh
  double t = 0, length = 0;  ///< start and length of the while [s]
  Eigen::VectorXd u, v;
  int unknowns = 0;
  std::string soft, stiff, flying;  ///< regions; `flying`: of the bodies without supports, else the stiff one
};

double* density_of(Simulation& simulation, const std::string& region) {
  for (MaterialSettings& material : simulation.materials) {
    if (material.region == region && material.density) return &*material.density;
  }
  return nullptr;
}

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
  for (double factor = 1; factor > 0.1; factor /= 1.25) {
    try {
      Simulation coarse = simulation;
      coarse.equilibrium.stop = nullptr;
      for (BodySettings& body : coarse.bodies) body.mesh = refined(body.mesh, body.geometry, factor);
      const Robot robot = make_robot(coarse);
      subject->unknowns = robot.scene.model->free_unknowns();
      subject->simulation = coarse;
      if (subject->unknowns <= most_unknowns_3d) break;
    } catch (const InputError&) {
      if (subject->unknowns == 0) throw;
      break;
    }
  }
  const auto stiffness = [](const MaterialSettings& material) { return material.constants.at("E"); };
  std::vector<MaterialSettings> materials;
  for (const MaterialSettings& material : simulation.materials) {
    if (material.constants.count("E") > 0) materials.push_back(material);
  }
  if (!materials.empty()) {
    subject->soft = std::ranges::min_element(materials, {}, stiffness)->region;
    subject->stiff = std::ranges::max_element(materials, {}, stiffness)->region;
  }
  const Robot robot = make_robot(subject->simulation);
  fly(*subject, robot);
  subject->length = 20 * simulation.step;
  subject->flying = subject->stiff;
  const auto free = free_bodies(simulation);
  if (!free.empty()) {
    const Mesh& mesh = robot.scene.model->mesh();
    subject->flying = mesh.region_names[static_cast<size_t>(
        mesh.region[static_cast<size_t>(mesh.part(free[0]->name).first_element)])];
  }
  return subject;
}

/// The last state of a run over time, and what was seen on the way.
struct Flown {
  bool arrived = false, folded = false, crossed = false;
  int failures = 0, iterations = 0, factorisations = 0;
  Eigen::VectorXd u;
};

Flown step_through(const FlightSubject& subject, const Robot& robot, double h, Integrator integrator,
                   const std::function<void(EquilibriumOptions&)>& change) {
  TimeStepperOptions options;
  options.step = h;
  options.integrator = integrator;
  options.shortest = 1.0 / 64;
  options.equilibrium = subject.simulation.equilibrium;
  change(options.equilibrium);
  TimeStepper stepper(*robot.scene.model, options);
  const Params p = robot.at(subject.simulation, 0);
  stepper.start(0, subject.u, subject.v, [&](double) { return p; });
  Flown flown;
  int steps = 0;
  bool going = true;
  while (going && stepper.t() < subject.length && steps++ < most_steps) {
    going = stepper.advance(subject.length);
    flown.folded = flown.folded || !(smallest_jacobian(robot.scene.model->mesh(), stepper.u()) > 0);
    flown.crossed = flown.crossed || (robot.intersects && robot.intersects(stepper.u()));
    if (flown.crossed) break;
  }
  const TimeStepperReport& report = stepper.report();
  flown.arrived = going && stepper.t() >= subject.length;
  flown.failures = report.failures;
  flown.iterations = report.iterations;
  flown.factorisations = report.factorisations;
  flown.u = stepper.u();
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
  flown.u = integrator.u();
  flown.folded = !(smallest_jacobian(robot.scene.model->mesh(), flown.u) > 0);
  flown.crossed =
      (robot.intersects && robot.intersects(flown.u)) || integrator.report().status == OdeStatus::passed_through;
  flown.iterations = integrator.report().evaluations;
  return flown;
}

enum class FlightMethod { implicit_euler, bdf2, not_stopped, explicit_steps };
const std::vector<std::string> flight_methods{"default: implicit Euler", "BDF2", "steps not stopped by contact",
                                              "explicit Runge-Kutta"};

StabilityRun run_flight(const FlightSubject& subject, const Robot& robot, FlightMethod method, double h,
                        const Eigen::VectorXd& reference) {
  const auto change = [&](EquilibriumOptions& options) {
    options.comparison.ignore_contact = method == FlightMethod::not_stopped;
  };
  const Integrator integrator = method == FlightMethod::bdf2 ? Integrator::bdf2 : Integrator::implicit_euler;
  const Flown flown = method == FlightMethod::explicit_steps ? leap_through(subject, robot, h)
                                                             : step_through(subject, robot, h, integrator, change);
  StabilityRun run;
  run.iterations = flown.iterations;
  run.factorisations = flown.factorisations;
  if (reference.size() > 0 && flown.arrived) run.error = largest(flown.u - reference) / largest(reference - subject.u);
  run.outcome = flown.crossed                          ? Outcome::intersected
                : flown.folded || !flown.u.allFinite() ? Outcome::inverted
                : !flown.arrived                       ? Outcome::diverged
                : run.error > dynamic_tolerance        ? Outcome::elsewhere
                : flown.failures > 0                   ? Outcome::cut_back
                                                       : Outcome::converged;
  return run;
}

/// A map over time steps and what `alter` changes; values in the unit of `y`.
StabilityMap time_map(std::shared_ptr<const FlightSubject> subject, std::function<void(Simulation&, size_t y)> alter) {
  const std::vector<double> steps{0.2, 1, 4, 10, 20};
  const double own = subject->simulation.step;
  const DisplayUnit unit = display_unit(own, "s");
  StabilityMap map;
  map.setting = fmt::format(
      "{:.3g} ms {}, coarse mesh: {} unknowns; against BDF2 with half of the shortest step; at most {} steps",
      1e3 * subject->length, subject->t > 0 ? "from the first touch on" : "from the start on", subject->unknowns,
      most_steps);
  map.x_label = fmt::format("time step [{}]", unit.name);
  for (double x : steps) map.x.push_back(number(x * own / unit.factor));
  map.methods = flight_methods;
  map.elsewhere = fmt::format("off by over {:.0f} %", 100 * dynamic_tolerance);
  map.shows_error = true;
  struct Row {
    Robot robot;
    Eigen::VectorXd reference;
  };
  map.run = [=, rows = std::make_shared<Remembered<std::shared_ptr<Row>>>()](size_t m, size_t x, size_t y) {
    const Row& row = *rows->at(0, y, [&] {
      Simulation altered = subject->simulation;
      alter(altered, y);
      auto made = std::make_shared<Row>(Row{make_robot(altered), {}});
      const Flown fine =
          step_through(*subject, made->robot, 0.5 * steps[0] * own, Integrator::bdf2, [](EquilibriumOptions&) {});
      if (fine.arrived) made->reference = fine.u;
      return made;
    });
    return run_flight(*subject, row.robot, static_cast<FlightMethod>(m), steps[x] * own, row.reference);
  };
  return map;
}

// ---- store

const Cells columns{"map", "method", "x", "y", "outcome", "iterations", "factorisations", "error", "fingerprint"};

std::optional<Outcome> outcome_called(const std::string& name) {
  for (int k = 0; k <= static_cast<int>(Outcome::intersected); ++k) {
    if (name_of(static_cast<Outcome>(k)) == name) return static_cast<Outcome>(k);
  }
  return std::nullopt;
}

Cells cells_of(const StabilityRun& run) {
  return {std::string(name_of(run.outcome)), fmt::format("{}", run.iterations), fmt::format("{}", run.factorisations),
          std::isfinite(run.error) ? fmt::format("{}", run.error) : ""};
}

std::optional<StabilityRun> run_of(const Cells& cells) {
  const std::optional<Outcome> outcome = outcome_called(cells[0]);
  const auto iterations = parse_number(cells[1]), factorisations = parse_number(cells[2]);
  if (!outcome || !iterations || !factorisations) return std::nullopt;
  return StabilityRun{*outcome, static_cast<int>(*iterations), static_cast<int>(*factorisations),
                      parse_number(cells[3]).value_or(not_a_number)};
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
  switch (outcome) {
    case Outcome::converged:
      return "converged";
    case Outcome::cut_back:
      return "cut back";
    case Outcome::locked:
      return "locked";
    case Outcome::elsewhere:
      return "elsewhere";
    case Outcome::saddle:
      return "saddle";
    case Outcome::diverged:
      return "diverged";
    case Outcome::inverted:
      return "inverted";
    case Outcome::intersected:
      return "intersected";
  }
  return "";
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
  } else if (report.status == SolveStatus::not_a_minimum) {
    run.outcome = Outcome::saddle;
  } else if (report.status != SolveStatus::converged) {
    // Full steps end early only where the energy is infinite; what the whole load does from here tells.
    Equilibrium probe(model, options);
    probe.start_at(equilibrium.u(), p);
    const bool early =
        options.comparison.line_search == LineSearch::none && probe.solve(p).status == SolveStatus::stalled;
    run.outcome = early ? Outcome::inverted : Outcome::diverged;
  } else if (!equilibrium.refactorise()) {
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
  const auto subject = subject_of(experiment, trials);
  const bool loaded = subject->load >= 0, two = subject->soft != subject->stiff;
  std::vector<StabilityMap> maps;
  if (loaded && !subject->first.empty()) maps.push_back(retraction_over_load(subject));
  if (two) maps.push_back(ratio_over_steps(subject));
  if (loaded && !two) maps.push_back(load_over_steps(subject));
  if (std::isfinite(constant_of(experiment.materials, subject->soft, "nu")) &&
      experiment.geometry.plane == Plane::strain)
    maps.push_back(poisson_over_element(subject));
  if (subject->contact() && loaded && !subject->first.empty()) maps.push_back(gap_over_size(subject));
  if (loaded) maps.push_back(start_over_steps(subject));
  return maps;
}

std::vector<StabilityMap> stability_maps(const Simulation& simulation) {
  const auto subject = subject_of(simulation);
  std::vector<StabilityMap> maps;
  if (subject->soft != subject->stiff) {
    const std::vector<double> ratios{1, 1e1, 1e2, 1e4, 1e6};
    maps.push_back(time_map(subject, [=](Simulation& altered, size_t y) {
      const double soft = constant_of(altered.materials, subject->soft, "E");
      set_constant(altered.materials, subject->stiff, "E", ratios[y] * soft);
    }));
    maps.back().id = "step_stiffness";
    maps.back().title = "Time steps beside a stiff part";
    maps.back().y_label = fmt::format("E of {} / E of {}", subject->stiff, subject->soft);
    for (double ratio : ratios) maps.back().y.push_back(fmt::format("1e{:.0f}", std::log10(ratio)));
  }
  Simulation probe = simulation;
  if (density_of(probe, subject->flying) != nullptr) {
    const std::vector<double> factors{0.01, 0.1, 1, 10, 100};
    maps.push_back(
        time_map(subject, [=](Simulation& altered, size_t y) { *density_of(altered, subject->flying) *= factors[y]; }));
    maps.back().id = "step_mass";
    maps.back().methods.pop_back();  // explicit ones are of no use here either
    maps.back().title = "Time steps when a light or a heavy body strikes";
    maps.back().y_label = fmt::format("density of {} / its own", subject->flying);
    maps.back().y = numbers(factors);
  }
  return maps;
}

std::vector<std::vector<std::optional<StabilityRun>>> run_stability(const std::vector<StabilityMap>& maps,
                                                                    const StudyOptions& options) {
  std::vector<std::vector<std::optional<StabilityRun>>> all;
  for (const StabilityMap& map : maps) all.emplace_back(map.cells());
  std::vector<CellOf> cells;
  Study study;
  study.columns = columns;
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

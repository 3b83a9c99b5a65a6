#include "sim/robots/simulate.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "sim/core/error.hpp"
#include "sim/core/memory_budget.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/core/units.hpp"
#include "sim/robots/sensitivities.hpp"
#include "sim/solve/sundials_integrator.hpp"
#include "sim/terms/solid.hpp"

namespace taut {
namespace {

/// Throws InputError for what the method of the simulation cannot follow, and for sensitivities that there are none of.
void check_method(const Simulation& simulation, const Robot& robot, const SimulationSensitivities& wanted) {
  using enum SimulationMethod;
  const bool by_steps = simulation.method == implicit_euler || simulation.method == bdf2;
  if (simulation.remembers() && !by_steps && (wanted.any() || simulation.method != quasi_static))
    throw InputError(
        fmt::format("{}: [simulation]: states depend on those before them (prony, friction), which {} not follow; "
                    "choose integrator = "
                    "\"implicit_euler\" or \"bdf2\"",
                    simulation.path, wanted.any() ? "sensitivities of equilibria do" : "SUNDIALS' integrators do"));
  if (!wanted.any()) return;
  if (simulation.remembers() && !wanted.goals.empty())
    throw InputError(fmt::format(
        "{}: states depend on those before them (prony, friction), which the gradient of a goal does not follow; take "
        "forward sensitivities",
        simulation.path));
  if (simulation.method != quasi_static && simulation.method != implicit_euler && simulation.method != bdf2) {
    throw InputError(
        fmt::format("{}: [simulation]: SUNDIALS' integrators give no sensitivities here; choose integrator = "
                    "\"implicit_euler\", \"bdf2\" or \"static\"",
                    simulation.path));
  }
  for (const SimulationSensitivities::Goal& goal : wanted.goals) {
    if (robot.readings[goal.reading].channel) continue;
    throw InputError(
        fmt::format("{}: channel '{}' is a net force, which depends on several states and can be no goal; take its "
                    "forward sensitivities",
                    simulation.path, robot.readings[goal.reading].id));
  }
}

/// Of a node [m].
double largest_motion(const Eigen::VectorXd& change, int dimension) {
  return change.reshaped(dimension, change.size() / dimension).colwise().norm().maxCoeff();
}

/// Which of the times comes nearest to t.
size_t nearest(const std::vector<double>& times, double t) {
  const auto distance = [t](double time) { return std::abs(time - t); };
  return static_cast<size_t>(std::ranges::min_element(times, {}, distance) - times.begin());
}

/// du/dp at the last equilibrium.
Eigen::MatrixXd equilibrium_derivatives(Equilibrium& equilibrium, const std::vector<int>& parameters) {
  if (!equilibrium.has_factor() && !equilibrium.refactorise())
    throw std::logic_error("an equilibrium's Hessian is not positive definite");
  return equilibrium.sensitivities(parameters);
}

/// All states are kept: what they take must be there before the first step. The adjoint method keeps what it goes back
/// through besides: displacement, velocity, two references, parameters and memory.
void require_states(const Simulation& simulation, const Model& model, const SimulationSensitivities& wanted) {
  const double steps = std::ceil(simulation.duration / simulation.step);
  double numbers = model.unknowns();
  if (!wanted.goals.empty())
    numbers += 4.0 * model.unknowns() + model.parameters().size() + 2.0 * static_cast<double>(model.memory_size());
  if (wanted.all_readings) numbers += static_cast<double>(wanted.parameters.size() * model.parameters().size());
  require_memory(8 * steps * numbers,
                 fmt::format("{}: [simulation] duration: {:.4g} steps of {} unknowns, which are all kept, take",
                             simulation.path, steps, model.unknowns()),
                 "make the step longer, the duration shorter or the mesh coarser");
}

/// One run, and what it has found so far.
class Run {
 public:
  Run(const Simulation& simulation, const Robot& robot, const SimulateOptions& options)
      : simulation_(simulation),
        robot_(robot),
        options_(options),
        wanted_(options.sensitivities),
        model_(*robot.scene.model) {
    result_.controls.resize(robot.controls.size());
    result_.readings.resize(robot.readings.size());
  }

  SimulationResult to_end() {
    const Stopwatch stopwatch;
    switch (simulation_.method) {
      case SimulationMethod::quasi_static:
        go_through_equilibria();
        break;
      case SimulationMethod::implicit_euler:
      case SimulationMethod::bdf2:
        step_by_minimisation();
        break;
      default:
        integrate_by_sundials();
    }
    result_.seconds = stopwatch.seconds();
    test_states();
    return std::move(result_);
  }

 private:
  using Goal = SimulationSensitivities::Goal;
  /// Displacements to start from, and their derivatives where sensitivities are asked for.
  struct Start {
    Eigen::VectorXd u;
    Eigen::MatrixXd du;
  };

  void go_through_equilibria() {
    Equilibrium equilibrium = equilibrium_at_rest(simulation_, robot_, model_, options_.stop);
    std::vector<double> times;
    for (int k = 0; k <= intervals(); ++k) times.push_back(std::min(simulation_.duration, k * simulation_.step));
    std::vector<size_t> goal_samples;
    for (const Goal& goal : wanted_.goals) goal_samples.push_back(nearest(times, goal.time));
    std::vector<Eigen::RowVectorXd> goal_rows(goal_samples.size());
    const Eigen::VectorXd still = Eigen::VectorXd::Zero(model_.unknowns());
    const bool remembers = model_.memory_size() > 0;
    TimeStep relaxing;
    relaxing.memory = Eigen::VectorXd::Zero(model_.memory_size());
    for (size_t k = 0; k < times.size(); ++k) {
      const Params p = robot_.at(simulation_, times[k]);
      relaxing.length = k == 0 ? 0.0 : times[k] - times[k - 1];
      const Eigen::VectorXd before = equilibrium.u();
      const SolveReport& report = equilibrium.solve(p, Polish::full, remembers ? &relaxing : nullptr);
      if (report.left_saddle) ++result_.saddles_left;
      if (result_.side.empty()) result_.side = report.side;
      result_.iterations += report.iterations;
      result_.factorisations += report.factorisations;
      result_.repeated += report.load_steps > 1 ? report.load_steps - 1 : 0;
      result_.interrupted = report.status == SolveStatus::interrupted;
      if (report.status == SolveStatus::not_held && k == 0)
        throw InputError(fmt::format("{}: {}", simulation_.path, report.held_by_nothing()));
      if (report.status != SolveStatus::converged) return stop_at(times[k], report.message());
      if (report.slipped) {
        const double t = times[k] - (1 - report.slipped_after) * relaxing.length;
        result_.slips.push_back({t, largest_motion(equilibrium.u() - before, model_.mesh().dimension())});
      }
      const AcceptedStep state{times[k], k == 0 ? 0 : simulation_.step, equilibrium.u(), still, p, relaxing};
      if (remembers) relaxing.memory = model_.remember({equilibrium.u(), p, &relaxing});
      record(state);
      if (wanted_.all_readings || std::ranges::find(goal_samples, k) != goal_samples.end()) {
        const Eigen::MatrixXd du = equilibrium_derivatives(equilibrium, wanted_.parameters);
        const Eigen::MatrixXd dy = reading_derivatives(
            robot_, state, {du, Eigen::MatrixXd::Zero(du.rows(), du.cols()), {}}, wanted_.parameters);
        if (wanted_.all_readings) result_.derivatives.push_back(dy);
        for (size_t g = 0; g < goal_rows.size(); ++g) {
          if (goal_samples[g] == k) goal_rows[g] = dy.row(static_cast<Eigen::Index>(wanted_.goals[g].reading));
        }
      }
      ++result_.steps;
      tell(times[k]);
    }
    if (wanted_.goals.empty()) return;
    const std::vector<WeightedReading> sum = reached_goals(std::move(goal_samples));
    for (size_t g = 0; g < sum.size(); ++g)  // an equilibrium knows the parameters of its own time only
      result_.goal_gradient_over_time.col(static_cast<Eigen::Index>(sum[g].state)) +=
          sum[g].weight * goal_rows[g].transpose();
    result_.goal_gradient = result_.goal_gradient_over_time.rowwise().sum();
  }

  /// The goals with what each counts in the number that they make up, whose gradient is yet to be added up.
  std::vector<WeightedReading> reached_goals(std::vector<size_t> samples) {
    result_.goal_samples = std::move(samples);
    for (size_t g = 0; g < wanted_.goals.size(); ++g)
      result_.goal_values.push_back(result_.readings[wanted_.goals[g].reading][result_.goal_samples[g]]);
    const std::vector<double> slopes =
        wanted_.slopes ? wanted_.slopes(result_.goal_values) : std::vector<double>(wanted_.goals.size(), 1.0);
    std::vector<WeightedReading> sum;
    for (size_t g = 0; g < wanted_.goals.size(); ++g)
      sum.push_back({wanted_.goals[g].reading, result_.goal_samples[g], slopes[g]});
    result_.goal_gradient_over_time = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(wanted_.parameters.size()),
                                                            static_cast<Eigen::Index>(result_.times.size()));
    return sum;
  }

  void step_by_minimisation() {
    TimeStepperOptions settings;
    settings.integrator = simulation_.method == SimulationMethod::bdf2 ? Integrator::bdf2 : Integrator::implicit_euler;
    settings.step = simulation_.step;
    settings.tolerance = simulation_.tolerance;
    settings.equilibrium = simulation_.equilibrium;
    settings.equilibrium.stop = options_.stop;
    TimeStepper stepper(model_, settings);
    const Start start = start_of_motion();
    if (!result_.failure.empty()) return;
    // A parameter moves by itself and as much at all times: dp/dtheta is made of unit vectors.
    const auto count = static_cast<Eigen::Index>(wanted_.parameters.size());
    Eigen::MatrixXd offsets = Eigen::MatrixXd::Zero(model_.parameters().size(), count);
    for (Eigen::Index j = 0; j < count; ++j) offsets(wanted_.parameters[static_cast<size_t>(j)], j) = 1;
    if (wanted_.all_readings) stepper.track(static_cast<int>(count), [&](double) { return offsets; });
    stepper.start(
        0, start.u, robot_.velocity, [&](double t) { return robot_.at(simulation_, t); },
        wanted_.all_readings ? start.du : Eigen::MatrixXd());
    std::vector<AcceptedStep> states;  // what the adjoint method goes back through
    const auto keep = [&] {
      record(stepper.last());
      if (!wanted_.goals.empty()) states.push_back(stepper.last());
      if (!wanted_.all_readings) return;
      result_.derivatives.push_back(reading_derivatives(
          robot_, stepper.last(), {stepper.du(), stepper.dreference(), stepper.dmemory()}, wanted_.parameters));
    };
    keep();
    while (stepper.t() < simulation_.duration && advance(stepper)) {
      keep();
      if (result_.steps >= 1'000'000) {
        stop_at(stepper.t(), "a million steps were not enough");
        break;
      }
      tell(stepper.t());
    }
    if (wanted_.goals.empty()) return;
    std::vector<size_t> goal_samples;
    for (const Goal& goal : wanted_.goals) {
      if (!result_.failure.empty() && goal.time > result_.times.back()) return;
      goal_samples.push_back(nearest(result_.times, goal.time));
    }
    const size_t last = std::ranges::max(goal_samples);
    states.resize(last + 1);
    const std::vector<WeightedReading> sum = reached_goals(std::move(goal_samples));
    result_.goal_gradient_over_time.leftCols(static_cast<Eigen::Index>(last + 1)) =
        reading_gradient(robot_, std::move(states), sum, start.du, wanted_.parameters);
    result_.goal_gradient = result_.goal_gradient_over_time.rowwise().sum();
  }

  /// One step on; false, and why, where none is accepted.
  bool advance(TimeStepper& stepper) {
    const bool accepted = stepper.advance(simulation_.duration);
    const TimeStepperReport& report = stepper.report();
    result_.steps = report.steps;
    result_.repeated = report.failures + report.rejections;
    result_.iterations = report.iterations;
    result_.factorisations = report.factorisations;
    result_.interrupted = !accepted && report.status == SolveStatus::interrupted;
    if (accepted) return true;
    stop_at(stepper.t(), result_.interrupted
                             ? "interrupted"
                             : fmt::format("no step was accepted, down to {} ({})",
                                           with_unit(simulation_.step * TimeStepperOptions().shortest, "s"),
                                           name_of(report.status)));
    return false;
  }

  void integrate_by_sundials() {
    OdeOptions settings;
    settings.method = simulation_.method == SimulationMethod::cvode             ? OdeMethod::bdf
                      : simulation_.method == SimulationMethod::arkode_implicit ? OdeMethod::implicit_runge_kutta
                                                                                : OdeMethod::explicit_runge_kutta;
    if (simulation_.tolerance > 0) settings.tolerance = simulation_.tolerance;
    OdeIntegrator integrator(model_, settings);
    const Schedule schedule = [&](double t) { return robot_.at(simulation_, std::max(t, 0.0)); };
    integrator.start(0, start_of_motion().u, robot_.velocity, schedule);
    if (!result_.failure.empty()) return;
    const auto keep = [&] {
      record({integrator.t(), 0, integrator.u(), integrator.v(), schedule(integrator.t()), {}});
    };
    keep();
    for (int k = 1; k <= intervals(); ++k) {
      result_.interrupted = options_.stop != nullptr && options_.stop->load();
      if (result_.interrupted) return stop_at(integrator.t(), "interrupted");
      const bool arrived = integrator.advance_to(std::min(simulation_.duration, k * simulation_.step));
      const OdeReport& report = integrator.report();
      result_.steps = report.steps;
      result_.repeated = report.error_test_failures + report.convergence_failures;
      result_.iterations = report.newton_iterations;
      result_.factorisations = report.factorisations;
      if (!arrived) return stop_at(integrator.t(), report.message());
      keep();
      tell(integrator.t());
    }
  }

  Start start_of_motion() {
    const Eigen::Index unknowns = model_.unknowns(), count = static_cast<Eigen::Index>(wanted_.parameters.size());
    const Start rest{Eigen::VectorXd::Zero(unknowns), Eigen::MatrixXd::Zero(unknowns, count)};
    if (!simulation_.from_equilibrium) return rest;
    SceneOptions with_all_held;
    with_all_held.over_time = true;
    with_all_held.free_bodies = FreeBodies::stay;
    const BuiltScene held = build_scene(simulation_, with_all_held);
    Equilibrium equilibrium = equilibrium_at_rest(simulation_, robot_, *held.scene.model, options_.stop);
    const SolveReport& report = equilibrium.solve(robot_.at(simulation_, 0));
    result_.factorisations += report.factorisations;
    if (report.status == SolveStatus::converged)
      return {equilibrium.u(), wanted_.any() ? equilibrium_derivatives(equilibrium, wanted_.parameters) : rest.du};
    result_.interrupted = report.status == SolveStatus::interrupted;
    result_.failure = fmt::format("there is no equilibrium to start from: {}; set start = \"rest\"", report.message());
    return rest;
  }

  void record(const AcceptedStep& step) {
    const Point at{step.u, step.p};
    result_.times.push_back(step.t);
    result_.states.push_back(step.u);
    for (size_t k = 0; k < robot_.controls.size(); ++k) result_.controls[k].push_back(step.p[robot_.controls[k]]);
    for (size_t k = 0; k < robot_.readings.size(); ++k) {
      const SceneReading& reading = robot_.readings[k];
      result_.readings[k].push_back(reading.channel ? reading.rest + reading.channel->value(point_of(step))
                                                    : net_force(robot_, reading, step));
    }
    Assembly potential, kinetic;
    model_.evaluate(at, potential);
    result_.potential.push_back(potential.energy);
    TimeStep moving;
    moving.inertia = 1;
    moving.rate = {1, -1, 0};
    moving.previous = step.u;
    moving.reference = step.u - step.v;
    model_.evaluate_inertia({step.u, step.p, &moving}, kinetic);
    result_.kinetic.push_back(kinetic.energy);
    for (const Joint& joint : robot_.joints) {
      const double gap = make_joint_gap(model_.mesh(), joint)->value(at);
      result_.largest_joint_gap = std::max(result_.largest_joint_gap, gap);
      if (joint.angle < 0) continue;
      const double angle = make_joint_angle(model_.mesh(), joint)->value(at);
      result_.largest_motor_error = std::max(result_.largest_motor_error, std::abs(angle - step.p[joint.angle]));
    }
  }

  /// Looks at all states again, by tests that the solvers do not use.
  void test_states() {
    const Mesh& mesh = model_.mesh();
    result_.smallest_jacobian = result_.smallest_distance = std::numeric_limits<double>::infinity();
    for (const Eigen::VectorXd& u : result_.states) {
      result_.smallest_jacobian = std::min(result_.smallest_jacobian, smallest_jacobian(mesh, u));
      if (!robot_.intersects) continue;
      if (robot_.intersects(u)) ++result_.intersecting;
      const double distance = robot_.smallest_distance(u, 0.01 * mesh.diagonal());
      result_.smallest_distance = std::min(result_.smallest_distance, distance);
    }
  }

  int intervals() const { return static_cast<int>(std::ceil(simulation_.duration / simulation_.step * (1 - 1e-9))); }
  void stop_at(double t, const std::string& why) {
    result_.failure = fmt::format("stopped at {}: {}", with_unit(t, "s"), why);
  }
  void tell(double t) const {
    if (options_.progress) options_.progress(t, result_);
  }

  const Simulation& simulation_;
  const Robot& robot_;
  const SimulateOptions& options_;
  const SimulationSensitivities& wanted_;
  const Model& model_;
  SimulationResult result_;
};

}  // namespace

Params at_rest(const Simulation& simulation, const Robot& robot) {
  Params p = robot.at(simulation, 0);
  p[robot.gravity] = 0;
  for (const LoadSettings& load : simulation.loads)
    p[robot.scene.model->parameters().index(load.control.empty() ? load.id : load.control)] = 0;
  for (size_t k = 0; k < robot.controls.size(); ++k) {
    const Quantity quantity = simulation.controls[k].quantity;
    if (quantity == Quantity::length || quantity == Quantity::angle) p[robot.controls[k]] = 0;  // retractions, motors
  }
  return p;
}

Equilibrium equilibrium_at_rest(const Simulation& simulation, const Robot& robot, const Model& model,
                                const std::atomic<bool>* stop) {
  EquilibriumOptions options = simulation.equilibrium;
  options.stop = stop;
  options.check_path = true;
  Equilibrium equilibrium(model, options);
  equilibrium.start_at_rest(at_rest(simulation, robot));
  return equilibrium;
}

SimulationResult simulate(const Simulation& simulation, const Robot& robot, const SimulateOptions& options) {
  check_method(simulation, robot, options.sensitivities);
  require_states(simulation, *robot.scene.model, options.sensitivities);
  return Run(simulation, robot, options).to_end();
}

}  // namespace taut

#include "sim/robots/simulate.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "sim/core/error.hpp"
#include "sim/core/stopwatch.hpp"
#include "sim/core/units.hpp"
#include "sim/robots/reach.hpp"
#include "sim/robots/sensitivities.hpp"
#include "sim/solve/sundials_integrator.hpp"
#include "sim/terms/solid.hpp"

namespace taut {
namespace {

class Recorder {
 public:
  Recorder(const Robot& robot, SimulationResult& result) : robot_(&robot), result_(&result) {
    result.controls.resize(robot.controls.size());
    result.readings.resize(robot.readings.size());
  }

  void add(const AcceptedStep& step) {
    const Model& model = *robot_->scene.model;
    result_->times.push_back(step.t);
    result_->states.push_back(step.u);
    for (size_t k = 0; k < robot_->controls.size(); ++k) result_->controls[k].push_back(step.p[robot_->controls[k]]);
    for (size_t k = 0; k < robot_->readings.size(); ++k) {
      const SceneReading& reading = robot_->readings[k];
      result_->readings[k].push_back(reading.channel ? reading.rest + reading.channel->value({step.u, step.p})
                                                     : net_force(*robot_, reading, step));
    }
    Assembly potential;
    model.evaluate({step.u, step.p}, potential);
    result_->potential.push_back(potential.energy);
    TimeStep moving;
    moving.inertia = 1;
    moving.rate = {1, -1, 0};
    moving.previous = step.u;
    moving.reference = step.u - step.v;
    Assembly kinetic;
    model.evaluate_inertia({step.u, step.p, &moving}, kinetic);
    result_->kinetic.push_back(kinetic.energy);
    for (const Joint& joint : robot_->joints) {
      const double gap = make_joint_gap(model.mesh(), joint)->value({step.u, step.p});
      result_->largest_joint_gap = std::max(result_->largest_joint_gap, gap);
      if (joint.angle < 0) continue;
      const double angle = make_joint_angle(model.mesh(), joint)->value({step.u, step.p});
      result_->largest_motor_error = std::max(result_->largest_motor_error, std::abs(angle - step.p[joint.angle]));
    }
  }

 private:
  const Robot* robot_;
  SimulationResult* result_;
};

std::string stopped_at(double t, const std::string& why) {
  return fmt::format("stopped at {}: {}", with_unit(t, "s"), why);
}

Equilibrium make_equilibrium(const Simulation& simulation, const Robot& robot, const std::atomic<bool>* stop) {
  EquilibriumOptions options = simulation.equilibrium;
  options.stop = stop;
  Equilibrium equilibrium(*robot.scene.model, options);
  equilibrium.start_at_rest(at_rest(simulation, robot));
  return equilibrium;
}

/// Throws InputError for sensitivities that there are none of.
void check_sensitivities(const Simulation& simulation, const Robot& robot, const SimulationSensitivities& wanted) {
  if (!wanted.any()) return;
  using enum SimulationMethod;
  if (simulation.method != quasi_static && simulation.method != implicit_euler && simulation.method != bdf2) {
    throw InputError(
        fmt::format("{}: [simulation]: SUNDIALS' integrators give no sensitivities here; choose integrator = "
                    "\"implicit_euler\", \"bdf2\" or \"static\"",
                    simulation.path));
  }
  if (wanted.goal && !robot.readings[wanted.goal->reading].channel) {
    throw InputError(
        fmt::format("{}: channel '{}' is a net force, which depends on several states and can be no goal; take its "
                    "forward sensitivities",
                    simulation.path, robot.readings[wanted.goal->reading].id));
  }
}

/// Which of the times comes nearest to t.
size_t nearest(const std::vector<double>& times, double t) {
  const auto closer = [t](double a, double b) { return std::abs(a - t) < std::abs(b - t); };
  return static_cast<size_t>(std::min_element(times.begin(), times.end(), closer) - times.begin());
}

/// du/dp at the last equilibrium.
Eigen::MatrixXd equilibrium_derivatives(Equilibrium& equilibrium, const std::vector<int>& parameters) {
  if (!equilibrium.has_factor() && !equilibrium.refactorise())
    throw std::logic_error("an equilibrium's Hessian is not positive definite");
  return equilibrium.sensitivities(parameters);
}

void follow_equilibrium(const Robot& robot, const SimulationSensitivities& wanted, Equilibrium& equilibrium,
                        const AcceptedStep& state, bool goal, SimulationResult& result) {
  if (!wanted.all_readings && !goal) return;
  const Eigen::MatrixXd du = equilibrium_derivatives(equilibrium, wanted.parameters);
  const Eigen::MatrixXd dy =
      reading_derivatives(robot, state, {du, Eigen::MatrixXd::Zero(du.rows(), du.cols())}, wanted.parameters);
  if (wanted.all_readings) result.derivatives.push_back(dy);
  if (!goal) return;
  result.goal_sample = result.times.size() - 1;
  result.goal_gradient = dy.row(static_cast<Eigen::Index>(wanted.goal->reading)).transpose();
}

void run_static(const Simulation& simulation, const Robot& robot, const SimulateOptions& options, Recorder& recorder,
                SimulationResult& result) {
  Equilibrium equilibrium = make_equilibrium(simulation, robot, options.stop);
  const int steps = static_cast<int>(std::ceil(simulation.duration / simulation.step * (1 - 1e-9)));
  std::vector<double> times;
  for (int k = 0; k <= steps; ++k) times.push_back(std::min(simulation.duration, k * simulation.step));
  const auto& goal = options.sensitivities.goal;
  const size_t goal_sample = goal ? nearest(times, goal->time) : times.size();
  for (size_t k = 0; k < times.size(); ++k) {
    const Params p = robot.at(simulation, times[k]);
    const SolveReport& report = equilibrium.solve(p);
    if (report.left_saddle) ++result.saddles_left;
    result.iterations += report.iterations;
    result.factorisations += report.factorisations;
    result.repeated += report.load_steps > 1 ? report.load_steps - 1 : 0;
    result.interrupted = report.status == SolveStatus::interrupted;
    if (report.status != SolveStatus::converged) {
      result.failure = stopped_at(times[k], report.message());
      return;
    }
    const Eigen::VectorXd still = Eigen::VectorXd::Zero(equilibrium.u().size());
    const AcceptedStep state{times[k], k == 0 ? 0 : simulation.step, equilibrium.u(), still, p, {}};
    recorder.add(state);
    follow_equilibrium(robot, options.sensitivities, equilibrium, state, k == goal_sample, result);
    ++result.steps;
    if (options.progress) options.progress(times[k], result);
  }
}

/// Displacements to start from, and their derivatives where sensitivities are asked for.
struct Start {
  Eigen::VectorXd u;
  Eigen::MatrixXd du;
};

Start start_of(const Simulation& simulation, const Robot& robot, const SimulateOptions& options,
               SimulationResult& result) {
  const std::vector<int>& parameters = options.sensitivities.parameters;
  const Eigen::Index unknowns = robot.scene.model->unknowns();
  const Start rest{Eigen::VectorXd::Zero(unknowns),
                   Eigen::MatrixXd::Zero(unknowns, static_cast<Eigen::Index>(parameters.size()))};
  if (!simulation.from_equilibrium) return rest;
  Equilibrium equilibrium = make_equilibrium(simulation, robot, options.stop);
  const SolveReport& report = equilibrium.solve(robot.at(simulation, 0));
  result.factorisations += report.factorisations;
  if (report.status == SolveStatus::converged) {
    return {equilibrium.u(), options.sensitivities.any() ? equilibrium_derivatives(equilibrium, parameters) : rest.du};
  }
  result.interrupted = report.status == SolveStatus::interrupted;
  result.failure = fmt::format(
      "there is no equilibrium to start from: {}; set start = \"rest\" (bodies without supports "
      "have no equilibrium)",
      report.message());
  return rest;
}

TimeStepperOptions stepper_options(const Simulation& simulation, const std::atomic<bool>* stop) {
  TimeStepperOptions settings;
  settings.integrator = simulation.method == SimulationMethod::bdf2 ? Integrator::bdf2 : Integrator::implicit_euler;
  settings.step = simulation.step;
  settings.tolerance = simulation.tolerance;
  settings.equilibrium = simulation.equilibrium;
  settings.equilibrium.stop = stop;
  return settings;
}

/// Steps to the end of the simulation; `record` is called after each.
void step_to_end(const Simulation& simulation, const SimulateOptions& options, TimeStepper& stepper,
                 const std::function<void()>& record, SimulationResult& result) {
  while (stepper.t() < simulation.duration) {
    const bool accepted = stepper.advance(simulation.duration);
    const TimeStepperReport& report = stepper.report();
    result.steps = report.steps;
    result.repeated = report.failures + report.rejections;
    result.iterations = report.iterations;
    result.factorisations = report.factorisations;
    if (!accepted) {
      result.interrupted = report.status == SolveStatus::interrupted;
      result.failure =
          result.interrupted
              ? stopped_at(stepper.t(), "interrupted")
              : stopped_at(stepper.t(), fmt::format("no step was accepted, down to {} ({})",
                                                    with_unit(simulation.step * TimeStepperOptions().shortest, "s"),
                                                    name_of(report.status)));
      return;
    }
    record();
    if (result.steps >= 1'000'000) {
      result.failure = stopped_at(stepper.t(), "a million steps were not enough");
      return;
    }
    if (options.progress) options.progress(stepper.t(), result);
  }
}

void run_stepper(const Simulation& simulation, const Robot& robot, const SimulateOptions& options, Recorder& recorder,
                 SimulationResult& result) {
  const SimulationSensitivities& wanted = options.sensitivities;
  TimeStepper stepper(*robot.scene.model, stepper_options(simulation, options.stop));
  const Start start = start_of(simulation, robot, options, result);
  if (!result.failure.empty()) return;
  // A parameter moves by itself and as much at all times: dp/dtheta is made of unit vectors.
  const auto count = static_cast<Eigen::Index>(wanted.parameters.size());
  Eigen::MatrixXd offsets = Eigen::MatrixXd::Zero(robot.scene.model->parameters().size(), count);
  for (Eigen::Index j = 0; j < count; ++j) offsets(wanted.parameters[static_cast<size_t>(j)], j) = 1;
  if (wanted.all_readings) stepper.track(static_cast<int>(count), [&](double) { return offsets; });
  stepper.start(
      0, start.u, robot.velocity, [&](double t) { return robot.at(simulation, t); },
      wanted.all_readings ? start.du : Eigen::MatrixXd());
  std::vector<AcceptedStep> states;  // what the adjoint method goes back through
  const auto record = [&] {
    recorder.add(stepper.last());
    if (wanted.goal) states.push_back(stepper.last());
    if (!wanted.all_readings) return;
    result.derivatives.push_back(
        reading_derivatives(robot, stepper.last(), {stepper.du(), stepper.dreference()}, wanted.parameters));
  };
  record();
  step_to_end(simulation, options, stepper, record, result);
  if (!wanted.goal || (!result.failure.empty() && wanted.goal->time > result.times.back())) return;
  result.goal_sample = nearest(result.times, wanted.goal->time);
  states.resize(*result.goal_sample + 1);
  result.goal_gradient =
      reading_gradient(robot, std::move(states), robot.readings[wanted.goal->reading], start.du, wanted.parameters);
}

void run_sundials(const Simulation& simulation, const Robot& robot, const SimulateOptions& options, Recorder& recorder,
                  SimulationResult& result) {
  OdeOptions settings;
  settings.method = simulation.method == SimulationMethod::cvode             ? OdeMethod::bdf
                    : simulation.method == SimulationMethod::arkode_implicit ? OdeMethod::implicit_runge_kutta
                                                                             : OdeMethod::explicit_runge_kutta;
  if (simulation.tolerance > 0) settings.tolerance = simulation.tolerance;
  OdeIntegrator integrator(*robot.scene.model, settings);
  const Schedule schedule = [&](double t) { return robot.at(simulation, std::max(t, 0.0)); };
  integrator.start(0, start_of(simulation, robot, options, result).u, robot.velocity, schedule);
  if (!result.failure.empty()) return;
  const auto state = [&] {
    return AcceptedStep{integrator.t(), 0, integrator.u(), integrator.v(), schedule(integrator.t()), {}};
  };
  recorder.add(state());
  const int outputs = static_cast<int>(std::ceil(simulation.duration / simulation.step * (1 - 1e-9)));
  for (int k = 1; k <= outputs; ++k) {
    if (options.stop != nullptr && options.stop->load()) {
      result.interrupted = true;
      result.failure = stopped_at(integrator.t(), "interrupted");
      return;
    }
    const bool arrived = integrator.advance_to(std::min(simulation.duration, k * simulation.step));
    const OdeReport& report = integrator.report();
    result.steps = report.steps;
    result.repeated = report.error_test_failures + report.convergence_failures;
    result.iterations = report.newton_iterations;
    result.factorisations = report.factorisations;
    if (!arrived) {
      result.failure = stopped_at(integrator.t(), report.message());
      return;
    }
    recorder.add(state());
    if (options.progress) options.progress(integrator.t(), result);
  }
}

/// Looks at all states again, by tests that the solvers do not use.
void test_states(const Robot& robot, SimulationResult& result) {
  const Mesh& mesh = robot.scene.model->mesh();
  result.smallest_jacobian = result.smallest_distance = std::numeric_limits<double>::infinity();
  for (const Eigen::VectorXd& u : result.states) {
    result.smallest_jacobian = std::min(result.smallest_jacobian, smallest_jacobian(mesh, u));
    if (!robot.intersects) continue;
    if (robot.intersects(u)) ++result.intersecting;
    result.smallest_distance = std::min(result.smallest_distance, robot.smallest_distance(u, 0.01 * mesh.diagonal()));
  }
}

/// A control of a workspace's mode and its range.
struct Axis {
  int index;
  double lower, upper;
};

std::vector<Axis> axes_of(const Simulation& simulation, const Robot& robot, const WorkspaceMode& mode) {
  std::vector<Axis> axes;
  for (size_t k = 0; k < simulation.controls.size(); ++k) {
    const auto range = mode.ranges.find(simulation.controls[k].id);
    if (range != mode.ranges.end()) axes.push_back({robot.controls[k], range->second.first, range->second.second});
  }
  return axes;
}

/// 1 / sqrt of the k-th prime: a curve of such periods never closes.
double period(size_t k) {
  int prime = 1;
  for (size_t found = 0; found <= k;) {
    ++prime;
    bool divided = false;
    for (int by = 2; by * by <= prime; ++by) divided = divided || prime % by == 0;
    if (!divided) ++found;
  }
  return 1 / std::sqrt(prime);
}

}  // namespace

Params at_rest(const Simulation& simulation, const Robot& robot) {
  Params p = robot.at(simulation, 0);
  p[robot.gravity] = 0;
  for (const LoadSettings& load : simulation.loads) {
    const std::string& id = load.control.empty() ? load.id : load.control;
    p[robot.scene.model->parameters().index(id)] = 0;
  }
  for (size_t k = 0; k < robot.controls.size(); ++k) {
    if (simulation.controls[k].quantity == Quantity::length) p[robot.controls[k]] = 0;  // retractions
    if (simulation.controls[k].quantity == Quantity::angle) p[robot.controls[k]] = 0;
  }
  return p;
}

SimulationResult simulate(const Simulation& simulation, const Robot& robot, const SimulateOptions& options) {
  check_sensitivities(simulation, robot, options.sensitivities);
  const Stopwatch stopwatch;
  SimulationResult result;
  Recorder recorder(robot, result);
  switch (simulation.method) {
    case SimulationMethod::quasi_static:
      run_static(simulation, robot, options, recorder, result);
      break;
    case SimulationMethod::implicit_euler:
    case SimulationMethod::bdf2:
      run_stepper(simulation, robot, options, recorder, result);
      break;
    default:
      run_sundials(simulation, robot, options, recorder, result);
  }
  result.seconds = stopwatch.seconds();
  test_states(robot, result);
  return result;
}

WorkspaceResult sample_workspace(const Simulation& simulation, const Robot& robot, const WorkspaceMode& mode,
                                 const std::atomic<bool>* stop) {
  WorkspaceResult result;
  result.mode = mode.name;
  const auto reading = [&](const std::string& id) -> const SceneReading& {
    return *std::find_if(robot.readings.begin(), robot.readings.end(),
                         [&](const SceneReading& r) { return r.id == id; });
  };
  const SceneReading &x = reading(simulation.workspace->x), &y = reading(simulation.workspace->y);
  Equilibrium equilibrium = make_equilibrium(simulation, robot, stop);
  Params p = robot.at(simulation, 0);
  equilibrium.solve(p);
  const auto visit = [&](const Params& next) {
    if (stop != nullptr && stop->load()) return;
    if (equilibrium.solve(next).status != SolveStatus::converged) {
      ++result.failures;  // the state stays where the last sample was
      return;
    }
    const Point at{equilibrium.u(), equilibrium.p()};
    result.points.emplace_back(x.rest + x.channel->value(at), y.rest + y.channel->value(at));
  };
  const std::vector<Axis> axes = axes_of(simulation, robot, mode);
  const auto set = [&](size_t axis, double fraction) {
    p[axes[axis].index] = axes[axis].lower + fraction * (axes[axis].upper - axes[axis].lower);
  };
  // All at one end, all at the other; the reach of a robot is often there.
  for (double end : {1.0, 0.0}) {
    for (size_t k = 0; k < axes.size(); ++k) set(k, end);
    visit(p);
  }
  const double fastest = axes.empty() ? 1 : period(axes.size() - 1);
  for (int i = 1; i <= simulation.workspace->samples; ++i) {
    for (size_t k = 0; k < axes.size(); ++k) {
      const double turns = i * fastest / (24 * period(k)), wave = turns - std::floor(turns);
      set(k, std::clamp(1.5 * (wave < 0.5 ? 2 * wave : 2 - 2 * wave) - 0.25, 0.0, 1.0));
    }
    visit(p);
  }
  const Reach reach = reach_of(result.points, robot.scene.model->mesh().diagonal() / 6);
  result.outline = reach.outline;
  result.area = reach.area;
  return result;
}

}  // namespace taut

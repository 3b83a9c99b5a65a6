#include "sim/robots/robot_ik.hpp"

#include <algorithm>

#include "sim/robots/simulate.hpp"

namespace taut {
namespace {

/// A target as SoftIk understands it.
struct Problem {
  IkAnswer blank;  ///< what all answers have in common
  std::vector<IkChannel> channels;
  std::vector<double> rest;  ///< added to each channel's value
  std::vector<IkControl> controls;
  IkOptions options;
};

/// Controls are free within their ranges, or held.
void add_controls(const Simulation& simulation, const Robot& robot, const IkTarget& target, Problem& problem) {
  for (const IkRange& range : simulation.ik->controls) {
    const auto found = std::ranges::find(simulation.controls, range.id, &ControlSettings::id);
    const auto place = static_cast<size_t>(found - simulation.controls.begin());
    const auto held = target.hold.find(range.id);
    if (held != target.hold.end()) {
      problem.options.held[robot.controls[place]] = held->second;
      continue;
    }
    problem.controls.push_back({robot.controls[place], range.lower, range.upper, range.nominal});
    problem.blank.free.push_back(place);
  }
}

Problem problem_of(const Simulation& simulation, const Robot& robot, const IkTarget& target,
                   const std::atomic<bool>* stop) {
  Problem problem;
  IkOptions& options = problem.options;
  options.tolerance = simulation.ik->tolerance;
  options.equilibrium = simulation.equilibrium;
  options.equilibrium.stop = stop;
  options.held = robot.at(simulation, 0);
  options.rest = at_rest(simulation, robot);
  add_controls(simulation, robot, target, problem);
  for (const auto& [id, values] : target.values) {
    const SceneReading& reading = robot.reading(id);
    problem.channels.push_back({{std::shared_ptr<void>(), reading.channel.get()}});  // the robot keeps it
    problem.rest.push_back(reading.rest);
    problem.blank.channels.push_back(id);
  }
  if (!target.stiffness_of.empty()) {
    const Eigen::VectorXd anywhere = Eigen::VectorXd::Zero(robot.scene.model->unknowns());  // places are linear in u
    options.stiffness_direction = robot.reading(target.stiffness_of).channel->gradient({anywhere, options.rest});
  }
  return problem;
}

}  // namespace

std::vector<IkAnswer> solve_target(const Simulation& simulation, const Robot& robot, const IkTarget& target,
                                   const std::atomic<bool>* stop) {
  const Problem problem = problem_of(simulation, robot, target, stop);
  SoftIk ik(robot.scene, problem.channels, problem.controls, problem.options);
  const auto stiffness = target.stiffness_of.empty() ? std::nullopt : std::optional(target.stiffness);
  std::vector<IkAnswer> answers;
  const size_t points = target.values.begin()->second.size();
  for (size_t k = 0; k < points && !(stop != nullptr && stop->load()); ++k) {
    IkAnswer& answer = answers.emplace_back(problem.blank);
    for (const std::string& id : answer.channels) answer.wanted.push_back(target.values.at(id)[k]);
    const Eigen::VectorXd rest = vector_of(problem.rest);
    answer.result = ik.solve(vector_of(answer.wanted) - rest, stiffness);
    if (answer.result.controls.size() == 0) continue;
    const Eigen::VectorXd places = rest + answer.result.achieved;
    answer.achieved.assign(places.begin(), places.end());
    answer.u = ik.equilibrium().u();
    answer.p = ik.equilibrium().p();
  }
  return answers;
}

}  // namespace taut

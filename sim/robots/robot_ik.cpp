#include "sim/robots/robot_ik.hpp"

#include <algorithm>

#include "sim/robots/simulate.hpp"

namespace taut {

std::vector<IkAnswer> solve_target(const Simulation& simulation, const Robot& robot, const IkTarget& target,
                                   const std::atomic<bool>* stop) {
  const auto reading_of = [&](const std::string& id) -> const SceneReading& {
    return *std::find_if(robot.readings.begin(), robot.readings.end(),
                         [&](const SceneReading& reading) { return reading.id == id; });
  };
  IkAnswer blank;
  blank.target = target.name;
  IkOptions options;
  options.tolerance = simulation.ik->tolerance;
  options.equilibrium = simulation.equilibrium;
  options.equilibrium.stop = stop;
  options.held = robot.at(simulation, 0);
  options.rest = at_rest(simulation, robot);
  std::vector<IkControl> controls;
  for (const IkRange& range : simulation.ik->controls) {
    const size_t place =
        static_cast<size_t>(std::find_if(simulation.controls.begin(), simulation.controls.end(),
                                         [&](const ControlSettings& control) { return control.id == range.id; }) -
                            simulation.controls.begin());
    const int index = robot.controls[place];
    const auto held = target.hold.find(range.id);
    if (held != target.hold.end()) {
      options.held[index] = held->second;
      continue;
    }
    controls.push_back({index, range.lower, range.upper, range.nominal});
    blank.free.push_back(place);
  }
  std::vector<IkChannel> channels;
  std::vector<double> rest;
  for (const auto& [id, values] : target.values) {
    const SceneReading& reading = reading_of(id);
    channels.push_back({{std::shared_ptr<void>(), reading.channel.get()}});  // the robot keeps it
    rest.push_back(reading.rest);
    blank.channels.push_back(id);
  }
  if (!target.stiffness_of.empty()) {
    const Eigen::VectorXd anywhere = Eigen::VectorXd::Zero(robot.scene.model->unknowns());  // places are linear in u
    options.stiffness_direction = reading_of(target.stiffness_of).channel->gradient({anywhere, options.rest});
  }
  SoftIk ik(robot.scene, channels, controls, options);
  std::vector<IkAnswer> answers;
  const size_t points = target.values.begin()->second.size();
  for (size_t k = 0; k < points && !(stop != nullptr && stop->load()); ++k) {
    IkAnswer& answer = answers.emplace_back(blank);
    Eigen::VectorXd values(static_cast<Eigen::Index>(rest.size()));
    for (size_t i = 0; i < rest.size(); ++i) {
      answer.wanted.push_back(target.values.at(answer.channels[i])[k]);
      values[static_cast<Eigen::Index>(i)] = answer.wanted[i] - rest[i];
    }
    answer.result = ik.solve(values, target.stiffness_of.empty() ? std::nullopt : std::optional(target.stiffness));
    if (answer.result.controls.size() == 0) continue;
    for (size_t i = 0; i < rest.size(); ++i)
      answer.achieved.push_back(rest[i] + answer.result.achieved[static_cast<Eigen::Index>(i)]);
    answer.u = ik.equilibrium().u();
    answer.p = ik.equilibrium().p();
  }
  return answers;
}

}  // namespace taut

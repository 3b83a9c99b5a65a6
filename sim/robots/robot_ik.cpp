#include "sim/robots/robot_ik.hpp"

#include <algorithm>

#include "sim/robots/simulate.hpp"
#include "sim/scene/channel_kinds.hpp"

namespace taut {
namespace {

std::vector<std::string> channels_of(const IkTarget& target) {
  std::vector<std::string> ids;
  for (const auto& [id, values] : target.values) ids.push_back(id);
  return ids;
}

}  // namespace

std::optional<Quantity> target_quantity(const ChannelSettings& channel) {
  if (channel.kind->is_place()) return Quantity::length;
  if (channel.kind->unit == "rad") return Quantity::angle;
  return std::nullopt;
}

RobotIk::RobotIk(const Simulation& simulation, const Robot& robot, const std::atomic<bool>* stop)
    : simulation_(&simulation), robot_(&robot), stop_(stop) {}

/// A search for targets of one kind, from where the last one ended. Controls are free within their ranges, or held.
void RobotIk::ask_for(const IkTarget& target) {
  const Simulation& simulation = *simulation_;
  const Robot& robot = *robot_;
  hold_ = target.hold;
  stiffness_of_ = target.stiffness_of;
  blank_ = {};
  blank_.channels = channels_of(target);
  rest_.clear();
  IkOptions options;
  options.tolerance = simulation.ik->tolerance;
  options.equilibrium = simulation.equilibrium;
  options.equilibrium.stop = stop_;
  options.held = robot.at(simulation, 0);
  options.rest = at_rest(simulation, robot);
  std::vector<IkControl> controls;
  for (const IkRange& range : simulation.ik->controls) {
    const auto found = std::ranges::find(simulation.controls, range.id, &ControlSettings::id);
    const auto place = static_cast<size_t>(found - simulation.controls.begin());
    const auto held = hold_.find(range.id);
    if (held != hold_.end()) {
      options.held[robot.controls[place]] = held->second;
      continue;
    }
    controls.push_back({robot.controls[place], range.lower, range.upper, range.nominal});
    blank_.free.push_back(place);
  }
  std::vector<IkChannel> channels;
  for (const std::string& id : blank_.channels) {
    const SceneReading& reading = robot.reading(id);
    channels.push_back({{std::shared_ptr<void>(), reading.channel.get()}});  // the robot keeps it
    rest_.push_back(reading.rest);
  }
  if (!stiffness_of_.empty()) {
    const Eigen::VectorXd anywhere = Eigen::VectorXd::Zero(robot.scene.model->unknowns());  // places are linear in u
    options.stiffness_direction = robot.reading(stiffness_of_).channel->gradient({anywhere, options.rest});
  }
  const std::unique_ptr<SoftIk> last = std::move(ik_);
  ik_ = std::make_unique<SoftIk>(robot.scene, channels, controls, options);
  if (last) start_ = {last->equilibrium().u(), last->equilibrium().p()};
  if (start_.first.size() > 0) ik_->start_at(start_.first, start_.second);
  start_ = {};
}

void RobotIk::start_at(const Eigen::VectorXd& u, const Params& p) {
  if (ik_)
    ik_->start_at(u, p);
  else
    start_ = {u, p};
}

IkAnswer RobotIk::solve(const IkTarget& target, size_t point) {
  const bool same =
      hold_ == target.hold && stiffness_of_ == target.stiffness_of && blank_.channels == channels_of(target);
  if (!ik_ || !same) ask_for(target);
  IkAnswer answer = blank_;
  for (const std::string& id : answer.channels) answer.wanted.push_back(target.values.at(id)[point]);
  const Eigen::VectorXd rest = vector_of(rest_);
  answer.result = ik_->solve(vector_of(answer.wanted) - rest,
                             stiffness_of_.empty() ? std::nullopt : std::optional(target.stiffness));
  if (answer.result.controls.size() == 0) {
    ik_.reset();
    return answer;
  }
  const Eigen::VectorXd places = rest + answer.result.achieved;
  answer.achieved.assign(places.begin(), places.end());
  answer.u = ik_->equilibrium().u();
  answer.p = ik_->equilibrium().p();
  return answer;
}

std::vector<IkAnswer> solve_target(const Simulation& simulation, const Robot& robot, const IkTarget& target,
                                   const std::atomic<bool>* stop) {
  RobotIk ik(simulation, robot, stop);
  std::vector<IkAnswer> answers;
  const size_t points = target.values.begin()->second.size();
  for (size_t k = 0; k < points && !(stop != nullptr && stop->load()); ++k) answers.push_back(ik.solve(target, k));
  return answers;
}

std::vector<size_t> jumps_to(const Simulation& simulation, const Robot& robot, const std::vector<IkAnswer>& answers,
                             const std::atomic<bool>* stop) {
  const Model& model = *robot.scene.model;
  Equilibrium equilibrium = equilibrium_at_rest(simulation, robot, model, stop);
  std::vector<size_t> jumps;
  for (size_t k = 0; k < answers.size(); ++k) {
    const IkAnswer& answer = answers[k];
    if (answer.u.size() == 0) continue;
    const SolveReport& report = equilibrium.solve(answer.p);
    if (report.status == SolveStatus::interrupted) break;
    const double apart = (equilibrium.u() - answer.u).cwiseAbs().maxCoeff();
    if (report.status != SolveStatus::converged || report.slipped || apart > 0.01 * model.length_scale())
      jumps.push_back(k);
    equilibrium.start_at(answer.u, answer.p);
  }
  return jumps;
}

}  // namespace taut

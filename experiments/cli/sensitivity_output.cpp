#include "experiments/cli/sensitivity_output.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <numeric>
#include <sstream>

#include "reports/axes.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

std::vector<int> parameters_of(const std::string& names, const ParameterTable& table) {
  if (names.empty()) {
    std::vector<int> all(static_cast<size_t>(table.size()));
    std::iota(all.begin(), all.end(), 0);
    return all;
  }
  std::vector<int> chosen;
  std::istringstream list(names);
  for (std::string id; std::getline(list, id, ',');) {
    if (!table.contains(id)) {
      throw InputError(fmt::format("--wrt: unknown parameter '{}'{}; write ids separated by commas, of: {}", id,
                                   did_you_mean(id, table.ids()), join(table.ids())));
    }
    if (std::find(chosen.begin(), chosen.end(), table.index(id)) == chosen.end()) chosen.push_back(table.index(id));
  }
  return chosen;
}

SimulationSensitivities::Goal goal_of(const std::string& text, const Simulation& simulation, const Robot& robot) {
  const size_t sign = text.find('@');
  const std::string id = text.substr(0, sign);
  std::vector<std::string> ids;
  for (const SceneReading& reading : robot.readings) ids.push_back(reading.id);
  const auto found = std::find(ids.begin(), ids.end(), id);
  if (found == ids.end()) {
    throw InputError(fmt::format("--goal: there is no channel '{}'{}; write CHANNEL or CHANNEL@TIME with one of: {}",
                                 id, did_you_mean(id, ids), join(ids)));
  }
  SimulationSensitivities::Goal goal{static_cast<size_t>(found - ids.begin()), simulation.duration};
  if (sign == std::string::npos) return goal;
  goal.time = parse_quantity(text.substr(sign + 1), Quantity::time, "--goal: the time");
  if (!(goal.time >= 0 && goal.time <= simulation.duration)) {
    throw InputError(fmt::format("--goal: {} is not within the simulation, which lasts {}; give a time from 0 s on",
                                 with_unit(goal.time, "s"), with_unit(simulation.duration, "s")));
  }
  return goal;
}

/// "m/Pa", "m/(N/m)": a channel's SI unit over a parameter's, "1" where nothing is left.
std::string derivative_unit(const std::string& channel, const std::string& parameter) {
  if (channel == parameter) return "1";
  if (parameter == "1") return channel;
  return channel + "/" + (parameter.find('/') == std::string::npos ? parameter : "(" + parameter + ")");
}

/// "m/(N/m)" to "m_per_N_per_m".
std::string as_suffix(std::string unit) {
  std::erase_if(unit, [](char c) { return c == '(' || c == ')'; });
  return column_suffix(unit);
}

/// A derivative that was asked for: of which channel, with respect to which parameter.
struct Derivative {
  Eigen::Index row, column;  ///< in SimulationResult::derivatives
  const SceneReading* channel;
  const ParameterSpec* parameter;
  std::string unit;
};

/// Of all channels, or of one.
std::vector<Derivative> asked_for(const Robot& robot, const SimulationSensitivities& wanted,
                                  std::optional<size_t> one = {}) {
  std::vector<Derivative> list;
  for (size_t k = 0; k < robot.readings.size(); ++k) {
    if (one.value_or(k) != k) continue;
    for (size_t j = 0; j < wanted.parameters.size(); ++j) {
      const SceneReading& channel = robot.readings[k];
      const ParameterSpec& parameter = robot.scene.model->parameters()[wanted.parameters[j]];
      list.push_back({static_cast<Eigen::Index>(k), static_cast<Eigen::Index>(j), &channel, &parameter,
                      derivative_unit(channel.unit, parameter.unit)});
    }
  }
  return list;
}

}  // namespace

SimulationSensitivities read_sensitivities(const CommandOptions& options, const Simulation& simulation,
                                           const Robot& robot) {
  SimulationSensitivities wanted;
  wanted.all_readings = options.sensitivities;
  if (!options.goal.empty()) wanted.goals = {goal_of(options.goal, simulation, robot)};
  if (wanted.any()) {
    wanted.parameters = parameters_of(options.wrt, robot.scene.model->parameters());
  } else if (!options.wrt.empty()) {
    throw InputError("--wrt: says which derivatives --sensitivities and --goal give; add one of these");
  }
  return wanted;
}

std::string sensitivities_csv(const Robot& robot, const SimulationSensitivities& wanted,
                              const SimulationResult& result) {
  std::string text = "time_s";
  for (const Derivative& d : asked_for(robot, wanted))
    text += fmt::format(",d_{}_d_{}_{}", d.channel->id, d.parameter->id, as_suffix(d.unit));
  text += "\n";
  for (size_t i = 0; i < result.derivatives.size(); ++i) {
    text += fmt::format("{}", result.times[i]);
    for (const double value : result.derivatives[i].reshaped<Eigen::RowMajor>()) text += fmt::format(",{}", value);
    text += "\n";
  }
  return text;
}

void add_sensitivities(const Simulation& simulation, const Robot& robot, const SimulationSensitivities& wanted,
                       const SimulationResult& result, nlohmann::ordered_json& json) {
  if (wanted.all_readings) {
    nlohmann::ordered_json& out = json["sensitivities"];
    out["time_s"] = std::vector<double>(result.times.begin(),
                                        result.times.begin() + static_cast<std::ptrdiff_t>(result.derivatives.size()));
    for (const Derivative& d : asked_for(robot, wanted)) {
      std::vector<double> values;
      for (const Eigen::MatrixXd& dy : result.derivatives) values.push_back(dy(d.row, d.column));
      out["channels"][d.channel->id][d.parameter->id] = {{"unit", d.unit}, {"values", values}};
    }
  }
  if (result.goal_samples.empty()) return;
  const size_t goal = wanted.goals.front().reading;
  const double t = result.times[result.goal_samples.front()];
  const Params p = robot.at(simulation, t);
  nlohmann::ordered_json& out = json["goal"];
  out = {{"channel", robot.readings[goal].id},
         {"time_s", t},
         {"unit", robot.readings[goal].unit},
         {"value", result.goal_values.front()}};
  for (const Derivative& d : asked_for(robot, wanted, goal))
    out["gradient"][d.parameter->id] = {{"parameter", p[wanted.parameters[static_cast<size_t>(d.column)]]},
                                        {"derivative", result.goal_gradient[d.column]},
                                        {"unit", d.unit}};
}

std::string goal_table(const Simulation& simulation, const Robot& robot, const SimulationSensitivities& wanted,
                       const SimulationResult& result) {
  if (result.goal_samples.empty()) return "";
  const size_t goal = wanted.goals.front().reading;
  const std::string& unit = robot.readings[goal].unit;
  const double t = result.times[result.goal_samples.front()];
  const Params p = robot.at(simulation, t);
  std::string text = fmt::format("gradient of {} = {} at {}\n{:<26} {:>14} {:>14} {:<12} {:>14}\n",
                                 robot.readings[goal].id, with_unit(result.goal_values.front(), unit),
                                 with_unit(t, "s"), "parameter", "value", "derivative", "unit", "of one percent");
  for (const Derivative& d : asked_for(robot, wanted, goal)) {
    const double value = p[wanted.parameters[static_cast<size_t>(d.column)]], slope = result.goal_gradient[d.column];
    text += fmt::format("{:<26} {:>14} {:>14.6g} {:<12} {:>14}\n", d.parameter->id, with_unit(value, d.parameter->unit),
                        slope, d.unit, with_unit(0.01 * value * slope, unit));
  }
  return text;
}

}  // namespace taut

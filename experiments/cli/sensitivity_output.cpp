#include "experiments/cli/sensitivity_output.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <numeric>
#include <sstream>

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

const ParameterSpec& spec_of(const Robot& robot, const SimulationSensitivities& wanted, size_t j) {
  return robot.scene.model->parameters()[wanted.parameters[j]];
}

/// "m/(N/m)" to "m_per_N_per_m".
std::string as_suffix(const std::string& unit) {
  std::string suffix;
  for (const char c : unit) {
    if (c == '/') suffix += "_per_";
    if (c != '/' && c != '(' && c != ')') suffix += c;
  }
  return suffix;
}

}  // namespace

std::string derivative_unit(const std::string& channel, const std::string& parameter) {
  if (channel == parameter) return "1";
  if (parameter == "1") return channel;
  return channel + "/" + (parameter.find('/') == std::string::npos ? parameter : "(" + parameter + ")");
}

SimulationSensitivities read_sensitivities(const CommandOptions& options, const Simulation& simulation,
                                           const Robot& robot) {
  SimulationSensitivities wanted;
  wanted.all_readings = options.sensitivities;
  if (!options.goal.empty()) wanted.goal = goal_of(options.goal, simulation, robot);
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
  for (const SceneReading& reading : robot.readings) {
    for (size_t j = 0; j < wanted.parameters.size(); ++j) {
      const ParameterSpec& spec = spec_of(robot, wanted, j);
      text += fmt::format(",d_{}_d_{}_{}", reading.id, spec.id, as_suffix(derivative_unit(reading.unit, spec.unit)));
    }
  }
  text += "\n";
  for (size_t i = 0; i < result.derivatives.size(); ++i) {
    text += fmt::format("{}", result.times[i]);
    for (Eigen::Index k = 0; k < result.derivatives[i].rows(); ++k) {
      for (const double value : result.derivatives[i].row(k)) text += fmt::format(",{}", value);
    }
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
    for (size_t k = 0; k < robot.readings.size(); ++k) {
      for (size_t j = 0; j < wanted.parameters.size(); ++j) {
        const ParameterSpec& spec = spec_of(robot, wanted, j);
        std::vector<double> values;
        for (const Eigen::MatrixXd& dy : result.derivatives)
          values.push_back(dy(static_cast<Eigen::Index>(k), static_cast<Eigen::Index>(j)));
        out["channels"][robot.readings[k].id][spec.id] = {{"unit", derivative_unit(robot.readings[k].unit, spec.unit)},
                                                          {"values", values}};
      }
    }
  }
  if (!result.goal_sample) return;
  const SceneReading& reading = robot.readings[wanted.goal->reading];
  const double t = result.times[*result.goal_sample];
  const Params p = robot.at(simulation, t);
  nlohmann::ordered_json& out = json["goal"];
  out = {{"channel", reading.id},
         {"time_s", t},
         {"unit", reading.unit},
         {"value", result.readings[wanted.goal->reading][*result.goal_sample]}};
  for (size_t j = 0; j < wanted.parameters.size(); ++j) {
    const ParameterSpec& spec = spec_of(robot, wanted, j);
    out["gradient"][spec.id] = {{"parameter", p[wanted.parameters[j]]},
                                {"derivative", result.goal_gradient[static_cast<Eigen::Index>(j)]},
                                {"unit", derivative_unit(reading.unit, spec.unit)}};
  }
}

std::string goal_table(const Simulation& simulation, const Robot& robot, const SimulationSensitivities& wanted,
                       const SimulationResult& result) {
  if (!result.goal_sample) return "";
  const SceneReading& reading = robot.readings[wanted.goal->reading];
  const double t = result.times[*result.goal_sample];
  const Params p = robot.at(simulation, t);
  std::string text = fmt::format("gradient of {} = {} at {}\n{:<26} {:>14} {:>14} {:<12} {:>14}\n", reading.id,
                                 with_unit(result.readings[wanted.goal->reading][*result.goal_sample], reading.unit),
                                 with_unit(t, "s"), "parameter", "value", "derivative", "unit", "of one percent");
  for (size_t j = 0; j < wanted.parameters.size(); ++j) {
    const ParameterSpec& spec = spec_of(robot, wanted, j);
    const double value = p[wanted.parameters[j]], slope = result.goal_gradient[static_cast<Eigen::Index>(j)];
    text += fmt::format("{:<26} {:>14} {:>14.6g} {:<12} {:>14}\n", spec.id, with_unit(value, spec.unit), slope,
                        derivative_unit(reading.unit, spec.unit), with_unit(0.01 * value * slope, reading.unit));
  }
  return text;
}

}  // namespace taut

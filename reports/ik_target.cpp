#include "reports/ik_target.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>
#include <nlohmann/json.hpp>

#include "sim/core/error.hpp"
#include "sim/core/units.hpp"
#include "sim/robots/robot_ik.hpp"

namespace taut {
namespace {

using Json = nlohmann::ordered_json;

/// A number in SI, or text with a unit.
double value_of(const Json& value, Quantity quantity, const std::string& where) {
  if (value.is_number()) return value.get<double>();
  if (value.is_string()) return parse_quantity(value.get<std::string>(), quantity, where);
  const std::string unit = units_of(quantity).front();
  throw InputError(
      fmt::format("{}: a number in {} or text with a unit belongs here, for example \"1 {}\"", where, unit, unit));
}

/// The entry of `list` with this id.
template <class Entry>
const Entry& known(const std::vector<Entry>& list, const std::string& id, const std::string& where, const char* what) {
  const auto found = std::ranges::find(list, id, &Entry::id);
  if (found != list.end()) return *found;
  std::vector<std::string> ids;
  for (const Entry& entry : list) ids.push_back(entry.id);
  throw InputError(fmt::format("{}: '{}' is not {}{}; allowed: {}", where, id, what, did_you_mean(id, ids), join(ids)));
}

/// "hold" and "stiffness": an object of ids.
const Json& object_of(const Json& value, const std::string& where) {
  if (!value.is_object())
    throw InputError(fmt::format("{}: an object belongs here, for example {{\"ID\": \"1 ...\"}}", where));
  return value;
}

}  // namespace

IkTarget read_ik_target(const std::string& text, const Simulation& simulation, const std::string& where) {
  const Json line = Json::parse(text, nullptr, false);
  if (!line.is_object())
    throw InputError(fmt::format(
        "{}: this is no JSON object; a target looks like {{\"tip_x\": \"170 mm\", \"tip_y\": 0.06}}", where));
  IkTarget target;
  std::vector<ChannelSettings> channels;
  std::ranges::copy_if(simulation.channels, std::back_inserter(channels),
                       [](const ChannelSettings& one) { return target_quantity(one).has_value(); });
  for (const auto& [key, value] : line.items()) {
    const std::string at = fmt::format("{}: {}", where, key);
    if (key == "hold") {
      for (const auto& [id, held] : object_of(value, at).items()) {
        known(simulation.ik->controls, id, at, "a control of [ik]");
        target.hold[id] = value_of(held, known(simulation.controls, id, at, "a control").quantity, at + "." + id);
      }
    } else if (key == "stiffness") {
      for (const auto& [id, wanted] : object_of(value, at).items()) {
        if (target_quantity(known(channels, id, at, "a channel of a place")) != Quantity::length || value.size() != 1)
          throw InputError(fmt::format("{}: one stiffness along one place belongs here", at));
        target.stiffness_of = id;
        target.stiffness = value_of(wanted, Quantity::stiffness, at + "." + id);
        if (!(target.stiffness > 0)) throw InputError(fmt::format("{}: the stiffness must be positive", at));
      }
    } else if (key != "name") {
      const Quantity quantity = *target_quantity(known(channels, key, where, "a channel of a place or angle"));
      target.values[key] = {value_of(value, quantity, at)};
    }
  }
  if (target.values.empty())
    throw InputError(fmt::format("{}: a target needs the value of a channel, for example {{\"{}\": \"1 {}\"}}", where,
                                 channels.empty() ? "tip_x" : channels.front().id,
                                 channels.empty() ? "m" : units_of(*target_quantity(channels.front())).front()));
  if (target.hold.size() == simulation.ik->controls.size())
    throw InputError(fmt::format("{}: all controls are held; leave one free at least", where));
  return target;
}

}  // namespace taut

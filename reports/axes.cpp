#include "reports/axes.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

#include "reports/figures.hpp"
#include "sim/core/units.hpp"

namespace taut {

std::string text_of(const AxisRecord& control, double value) {
  return control.labels.empty() ? with_unit(value, control.unit) : control.labels.at(static_cast<size_t>(value) - 1);
}

std::string column_suffix(const std::string& unit) {
  std::string suffix;
  for (const char c : unit) suffix += c == '/' ? std::string("_per_") : std::string(1, c);
  return suffix;
}

WrittenUnit written_unit(const std::string& si_unit) {
  if (si_unit == "m") return {"mm", "mm", 1e-3};
  if (si_unit == "m/s") return {"mm_per_s", "mm/s", 1e-3};
  if (si_unit == "m2") return {"cm2", "cm²", 1e-4};
  if (si_unit == "rad") return {"deg", "deg", std::numbers::pi / 180};
  if (si_unit == "Pa") return {"kPa", "kPa", 1e3};
  if (si_unit == "1" || si_unit.empty()) return {"1", "", 1};
  return {column_suffix(si_unit), si_unit, 1};
}

WrittenUnit shown_unit(const std::string& si_unit, double largest) {
  const bool small = largest > 0 && largest < 0.1;
  for (const char* unit : {"N", "Nm", "J", "s"}) {
    if (small && si_unit == unit) return {si_unit, si_unit == "Nm" ? "N mm" : "m" + si_unit, 1e-3};
  }
  return written_unit(si_unit);
}

WrittenUnit shown_unit(const std::string& si_unit, const std::vector<double>& values) {
  double largest = 0;
  for (const double value : values) {
    if (std::isfinite(value)) largest = std::max(largest, std::abs(value));
  }
  return shown_unit(si_unit, largest);
}

std::string bracketed(const std::string& text, const std::string& unit) {
  return unit.empty() || unit == "1" ? text : text + (text.empty() ? "[" : " [") + unit + "]";
}

bool is(const AxisRecord& axis, Quantity quantity) {
  return axis.quantity == name_of(quantity);
}

const AxisRecord& drawn_control(const RunRecord& record) {
  static const AxisRecord none;
  if (record.controls.empty()) return none;
  return record.controls.at(static_cast<size_t>(std::max(record.load_control, 0)));
}

bool over_time(const RunRecord& record) {
  return is(drawn_control(record), Quantity::time);
}

bool over_strain(const RunRecord& record) {
  const AxisRecord& control = drawn_control(record);
  return is(control, Quantity::pure) && control.id == "strain";
}

const AxisRecord& channel_axis(const RunRecord& record, const std::string& channel) {
  const auto found = std::ranges::find(record.channels, channel, &AxisRecord::id);
  if (found == record.channels.end())
    throw std::logic_error(fmt::format("RunRecord: the channel '{}' is not among its channels", channel));
  return *found;
}

ReadingUnits::ReadingUnits(const RunRecord& record, Kind kind) {
  const auto differ = [&](auto member) {
    return std::ranges::adjacent_find(record.channels, std::not_equal_to<>(), member) != record.channels.end();
  };
  for (const AxisRecord& axis : record.channels)
    units_[axis.id] = kind == si ? WrittenUnit{column_suffix(axis.unit), axis.unit, 1} : written_unit(axis.unit);
  if (record.channels.empty() || differ(&AxisRecord::unit)) return;
  common_ = units_.begin()->second;
  if (!differ(&AxisRecord::label)) what_ = record.channels.front().label;
}

const WrittenUnit& ReadingUnits::of(const std::string& channel) const {
  const auto found = units_.find(channel);
  if (found == units_.end())
    throw std::logic_error(fmt::format("RunRecord: the channel '{}' is not among its channels", channel));
  return found->second;
}

std::string ReadingUnits::column(const std::string& name) const {
  std::string column = name + (common_ ? "_" + common_->suffix : "");
  std::ranges::replace(column, ' ', '_');
  return column;
}

std::string ReadingUnits::ended(std::string line, const std::string& unit) const {
  if (!common_) line.insert(line.size() - 1, "," + unit);
  return line;
}

BenchColumns::BenchColumns(const RunRecord& record, const std::vector<std::string>& names) {
  const auto unit_of = [](const AxisRecord& axis, const std::string& column) -> std::optional<HeaderUnit> {
    std::optional<HeaderUnit> unit = unit_in_header(column);
    const bool same = unit && axis.labels.empty() && name_of(unit->quantity) == axis.quantity;
    return same ? unit : std::nullopt;
  };
  for (size_t c = 0; c < record.control_columns.size(); ++c) {
    const std::optional<HeaderUnit> unit = unit_of(record.controls[c], record.control_columns[c]);
    if (!unit || unit->factor == 1) continue;
    controls_.emplace_back(c, unit->factor);
    heads_ += "," + plot::field(record.control_columns[c]);
  }
  for (size_t c = 0; c < record.channel_columns.size(); ++c) {
    const std::optional<HeaderUnit> unit = unit_of(record.channels[c], record.channel_columns[c]);
    if (!unit) continue;
    channels_[record.channels[c].id] = {unit->unit, unit->factor};
    readings_ |= unit->factor != 1;
  }
  if (!readings_) return;
  units_ = channels_.size() < record.channels.size() || std::ranges::any_of(channels_, [&](const auto& one) {
             return one.second.name != channels_.begin()->second.name;
           });
  for (const std::string& name : names)
    heads_ += "," + name + "_" + (units_ ? "in_file" : column_suffix(channels_.begin()->second.name));
  if (units_) heads_ += ",unit_in_file";
}

std::string BenchColumns::fields(const std::vector<double>& controls, const std::string& channel,
                                 const std::vector<double>& values) const {
  std::string text;
  for (const auto& [c, factor] : controls_) text += fmt::format(",{:.10g}", controls.at(c) / factor);
  if (!readings_) return text;
  const auto unit = channels_.find(channel);
  for (const double value : values)
    text += unit != channels_.end() && std::isfinite(value) ? fmt::format(",{:.8g}", value / unit->second.factor) : ",";
  if (units_) text += unit == channels_.end() ? "," : "," + plot::field(unit->second.name);
  return text;
}

}  // namespace taut

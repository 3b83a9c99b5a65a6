#include "calib/benches/bench.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "calib/benches/assumptions.hpp"
#include "sim/core/error.hpp"
#include "sim/core/units.hpp"
#include "sim/scene/channel_kinds.hpp"

namespace taut {

AxisRecord make_axis(std::string id, Quantity quantity, std::string label) {
  return {std::move(id), std::string(name_of(quantity)), units_of(quantity).front(), std::move(label)};
}

AxisRecord make_axis(const ChannelSettings& channel) {
  return make_axis(channel.id, quantity_of_si_unit(channel.kind->unit), std::string(channel.kind->name));
}

std::vector<int> indices_of(const std::vector<FreeParameter>& free) {
  std::vector<int> indices;
  for (const FreeParameter& parameter : free) indices.push_back(parameter.index);
  return indices;
}

std::vector<FreeParameter> Bench::free() const {
  return free_parameters(experiment_, protocol());
}

std::vector<FreeParameter> Bench::starts_after(const FitResult& main) const {
  std::vector<FreeParameter> free = this->free();
  for (FreeParameter& parameter : free) {
    for (const ParameterEstimate& estimate : main.parameters) {
      if (estimate.spec.id == protocol().parameters()[parameter.index].id) parameter.start = estimate.value;
    }
  }
  return free;
}

DimensionedModel Bench::with_dimensions() const {
  throw InputError(experiment_.path + ": only readings at rest have dimensions as parameters");
}

std::unique_ptr<Bench> Bench::part(size_t /*control*/, double /*held*/) const {
  throw InputError(fmt::format("{}: only readings at rest can be fitted in parts", experiment_.path));
}

std::unique_ptr<Bench> Bench::at_loads(const std::string& path) const {
  return at_rows(trials_at_rest() == nullptr ? std::vector<LoadRow>{} : read_load_rows(experiment_.bench, path));
}

std::unique_ptr<Bench> Bench::at_rows(const std::vector<LoadRow>& /*rows*/) const {
  throw InputError(fmt::format(
      "{}: its readings run over {}, so that there is no table of loads to predict at; use `taut replay` on "
      "the experiment with --set",
      experiment_.path, controls_.front().label));
}

std::vector<double> Bench::values_of(size_t control) const {
  std::set<double> values;
  for (const BenchReading& reading : readings_) values.insert(reading.controls[control]);
  return {values.begin(), values.end()};
}

bool Bench::sets(const std::string& id) const {
  return std::any_of(controls_.begin(), controls_.end(), [&](const AxisRecord& control) { return control.id == id; });
}

std::optional<double> Bench::declared_sigma(int channel, double value) const {
  if (!experiment_.bench.sigma_column.empty()) return std::nullopt;
  return experiment_.bench.channels[static_cast<size_t>(channel)].noise.sigma(value);
}

std::string Bench::control_text(size_t control, double value) const {
  const std::vector<BenchFormat::Control>& formats = experiment_.bench.controls;  // of recordings: none
  if (control < formats.size() && !formats[control].labels.empty())
    return value < 1 ? "none" : formats[control].labels[static_cast<size_t>(value) - 1];  // 0: not set yet
  const std::string& unit = controls_[control].unit;
  if (value != 0) return with_unit(value, unit);
  double largest = 0;
  for (const BenchReading& reading : readings_) largest = std::max(largest, std::abs(reading.controls[control]));
  const DisplayUnit shown = display_unit(largest, unit);
  return shown.name.empty() || shown.name == "1" ? "0" : "0 " + shown.name;
}

std::string Bench::describe_control(size_t control, double value) const {
  return fmt::format("{} = {}", controls_[control].id, control_text(control, value));
}

void add_material_lines(const Experiment& experiment, Lines& lines) {
  for (const MaterialSettings& material : experiment.materials) {
    std::string text = material.law;
    for (const ParameterSpec& spec : material_parameters(material.law))
      text += fmt::format(", {} = {}", spec.id, with_unit(material.constants.at(spec.id), spec.unit));
    if (material.density) text += fmt::format(", density = {}", with_unit(*material.density, "kg/m3"));
    for (const auto& [g, tau] : material.prony)
      text += fmt::format(", {:.4g} of it relaxes with tau = {}", g, with_unit(tau, "s"));
    lines.emplace_back("material " + material.region, text);
  }
}

}  // namespace taut

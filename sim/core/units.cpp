#include "sim/core/units.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <numbers>
#include <stdexcept>

#include "sim/core/error.hpp"

namespace taut {
namespace {

struct Unit {
  Quantity quantity;
  std::string_view name;
  double factor;  ///< SI value of one unit
};

constexpr double kStandardGravity = 9.80665;  // m/s2, exact by definition (CGPM 1901)
constexpr double kPound = 0.45359237;         // kg, exact by definition (1959)
constexpr double kInch = 0.0254;              // m, exact by definition (1959)

// The SI unit of each quantity comes first.
constexpr Unit kUnits[] = {
    {Quantity::pure, "1", 1.0},
    {Quantity::pure, "%", 1e-2},
    {Quantity::length, "m", 1.0},
    {Quantity::length, "mm", 1e-3},
    {Quantity::length, "cm", 1e-2},
    {Quantity::length, "um", 1e-6},
    {Quantity::length, "km", 1e3},
    {Quantity::length, "in", kInch},
    {Quantity::area, "m2", 1.0},
    {Quantity::area, "mm2", 1e-6},
    {Quantity::area, "cm2", 1e-4},
    {Quantity::mass, "kg", 1.0},
    {Quantity::mass, "g", 1e-3},
    {Quantity::mass, "mg", 1e-6},
    {Quantity::mass, "lb", kPound},
    {Quantity::force, "N", 1.0},
    {Quantity::force, "mN", 1e-3},
    {Quantity::force, "kN", 1e3},
    {Quantity::force, "kgf", kStandardGravity},
    {Quantity::force, "gf", 1e-3 * kStandardGravity},
    {Quantity::force, "lbf", kPound* kStandardGravity},
    {Quantity::pressure, "Pa", 1.0},
    {Quantity::pressure, "kPa", 1e3},
    {Quantity::pressure, "MPa", 1e6},
    {Quantity::pressure, "GPa", 1e9},
    {Quantity::pressure, "N/mm2", 1e6},
    {Quantity::pressure, "psi", kPound* kStandardGravity / (kInch * kInch)},
    {Quantity::density, "kg/m3", 1.0},
    {Quantity::density, "g/cm3", 1e3},
    {Quantity::acceleration, "m/s2", 1.0},
    {Quantity::acceleration, "mm/s2", 1e-3},
    {Quantity::time, "s", 1.0},
    {Quantity::time, "ms", 1e-3},
    {Quantity::time, "min", 60.0},
    {Quantity::frequency, "1/s", 1.0},
    {Quantity::speed, "m/s", 1.0},
    {Quantity::speed, "mm/s", 1e-3},
    {Quantity::angle, "rad", 1.0},
    {Quantity::angle, "deg", std::numbers::pi / 180},
    {Quantity::stiffness, "N/m", 1.0},
    {Quantity::stiffness, "N/mm", 1e3},
    {Quantity::stiffness, "kN/m", 1e3},
    {Quantity::rotation_stiffness, "Nm/rad", 1.0},
    {Quantity::line_load, "N/m", 1.0},
    {Quantity::line_load, "N/mm", 1e3},
};

struct HandyUnits {
  std::string_view si_unit;
  std::vector<DisplayUnit> units;  ///< ascending
};

const std::vector<HandyUnits>& handy_units() {
  static const std::vector<HandyUnits> table = {
      {"m", {{"um", 1e-6}, {"mm", 1e-3}, {"m", 1}, {"km", 1e3}}},
      {"m2", {{"mm2", 1e-6}, {"cm2", 1e-4}, {"m2", 1}}},
      {"kg", {{"mg", 1e-6}, {"g", 1e-3}, {"kg", 1}}},
      {"N", {{"mN", 1e-3}, {"N", 1}, {"kN", 1e3}}},
      {"Pa", {{"Pa", 1}, {"kPa", 1e3}, {"MPa", 1e6}, {"GPa", 1e9}}},
      {"s", {{"ms", 1e-3}, {"s", 1}}},
      {"N/m", {{"N/m", 1}, {"N/mm", 1e3}}},
  };
  return table;
}

std::string_view trimmed(std::string_view text) {
  constexpr std::string_view blanks = " \t\r\n";
  const size_t begin = text.find_first_not_of(blanks);
  if (begin == std::string_view::npos) return {};
  return text.substr(begin, text.find_last_not_of(blanks) - begin + 1);
}

const Unit* find_unit(std::string_view name, Quantity quantity) {
  for (const Unit& unit : kUnits) {
    if (unit.quantity == quantity && unit.name == name) return &unit;
  }
  return nullptr;
}

/// " (it is a unit of mass)" for a unit that belongs elsewhere, " (did you mean 'mm'?)" for a misspelt one, or "".
std::string unit_hint(std::string_view name, const std::vector<std::string>& allowed) {
  for (const Unit& unit : kUnits) {
    if (unit.name == name) return fmt::format(" (it is a unit of {})", name_of(unit.quantity));
  }
  return did_you_mean(name, allowed);
}

/// `value` rounded to so many significant digits.
double rounded(double value, int digits) {
  return parse_number(fmt::format("{:.{}e}", value, std::max(digits, 1) - 1)).value_or(value);
}

DisplayUnit choose_unit(double value, std::string_view si_unit) {
  DisplayUnit chosen{std::string(si_unit), 1.0};
  if (value == 0 || !std::isfinite(value)) return chosen;
  for (const HandyUnits& handy : handy_units()) {
    if (handy.si_unit != si_unit) continue;
    chosen = handy.units.front();
    for (size_t i = 1; i < handy.units.size(); ++i) {
      const bool reaches_one = std::abs(value) / handy.units[i].factor >= 1;
      const bool smaller_too_long = std::abs(value) / handy.units[i - 1].factor >= 1000;
      if (reaches_one || smaller_too_long) chosen = handy.units[i];
    }
  }
  return chosen;
}

/// Plain decimals without trailing zeros between 1e-4 and 1e6, powers of ten outside.
std::string significant(double value, int digits) {
  digits = std::max(digits, 1);
  if (value == 0) return "0";
  if (!std::isfinite(value) || std::abs(value) < 1e-4 || std::abs(value) >= 1e6) {
    return fmt::format("{:.{}g}", value, digits);
  }
  const std::string scientific = fmt::format("{:.{}e}", value, digits - 1);
  const int exponent = std::atoi(scientific.c_str() + scientific.find('e') + 1);
  const int decimals = std::max(0, digits - 1 - exponent);
  std::string text = fmt::format("{:.{}f}", rounded(value, digits), decimals);
  if (decimals > 0) {
    text.erase(text.find_last_not_of('0') + 1);
    if (text.back() == '.') text.pop_back();
  }
  return text;
}

/// A unit as the end of a header: "N/mm" is written "N_per_mm".
std::string as_suffix(std::string_view unit) {
  std::string suffix = "_";
  for (const char c : unit) {
    if (c == '/') {
      suffix += "_per_";
    } else {
      suffix += c;
    }
  }
  return suffix;
}

}  // namespace

std::string_view name_of(Quantity quantity) {
  switch (quantity) {
    case Quantity::pure:
      return "pure number";
    case Quantity::length:
      return "length";
    case Quantity::area:
      return "area";
    case Quantity::mass:
      return "mass";
    case Quantity::force:
      return "force";
    case Quantity::pressure:
      return "pressure";
    case Quantity::density:
      return "density";
    case Quantity::acceleration:
      return "acceleration";
    case Quantity::time:
      return "time";
    case Quantity::frequency:
      return "rate";
    case Quantity::speed:
      return "speed";
    case Quantity::angle:
      return "angle";
    case Quantity::stiffness:
      return "stiffness";
    case Quantity::rotation_stiffness:
      return "rotation stiffness";
    case Quantity::line_load:
      return "line load";
  }
  return "unknown quantity";
}

std::vector<std::string> units_of(Quantity quantity) {
  std::vector<std::string> names;
  for (const Unit& unit : kUnits) {
    if (unit.quantity == quantity) names.emplace_back(unit.name);
  }
  return names;
}

double unit_factor(std::string_view unit, Quantity quantity, std::string_view where) {
  if (const Unit* found = find_unit(unit, quantity)) return found->factor;
  const std::vector<std::string> allowed = units_of(quantity);
  throw InputError(fmt::format("{}: '{}' is not a unit of {}{}; write one of: {}", where, unit, name_of(quantity),
                               unit_hint(unit, allowed), join(allowed)));
}

std::optional<double> parse_number(std::string_view text) {
  if (text.starts_with('+')) {
    text.remove_prefix(1);
    if (text.starts_with('-')) return std::nullopt;
  }
  double value = 0;
  const auto [end, status] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (status != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) return std::nullopt;
  return value;
}

Quantity quantity_of_si_unit(std::string_view si_unit) {
  for (const Unit& unit : kUnits) {
    if (unit.name == si_unit && unit.factor == 1.0) return unit.quantity;
  }
  throw std::logic_error(fmt::format("'{}' is not an SI unit that taut knows", si_unit));
}

double parse_quantity(std::string_view text, Quantity quantity, std::string_view where) {
  const std::string_view whole = trimmed(text);
  const size_t blank = whole.find_first_of(" \t");
  const std::string_view number = whole.substr(0, blank);
  const std::string_view unit = blank == std::string_view::npos ? "" : trimmed(whole.substr(blank));
  const bool pure = quantity == Quantity::pure;
  const std::string example = pure ? "0.3" : "30 " + units_of(quantity).front();

  const std::optional<double> value = parse_number(number);
  if (!value) {
    std::string hint;
    const size_t split = number.find_first_not_of("0123456789+-.eE");
    if (split != std::string_view::npos && number[split] == ',') {
      hint = " (write a decimal point, not a comma)";
    } else if (split != std::string_view::npos && parse_number(number.substr(0, split))) {
      hint =
          fmt::format(" (put a blank between number and unit: '{} {}')", number.substr(0, split), number.substr(split));
    }
    throw InputError(fmt::format("{}: '{}' does not begin with a finite number{}; write a {} like '{}'", where, whole,
                                 hint, pure ? "value" : "number and a unit", example));
  }
  if (pure) {
    if (unit.empty()) return *value;
    if (unit == "%") return *value * unit_factor(unit, quantity, where);
    throw InputError(
        fmt::format("{}: '{}' has the unit '{}', but a pure number is needed here{}; write a bare number "
                    "like '0.3' or a percentage like '30 %'",
                    where, whole, unit, unit_hint(unit, {})));
  }
  if (unit.empty()) {
    throw InputError(fmt::format("{}: '{}' has no unit; write a {} with one of: {}, for example '{} {}'", where, whole,
                                 name_of(quantity), join(units_of(quantity)), number, units_of(quantity).front()));
  }
  return *value * unit_factor(unit, quantity, where);
}

std::string with_unit(double si_value, std::string_view si_unit, int digits) {
  const double value = rounded(si_value, digits);
  const DisplayUnit unit = choose_unit(value, si_unit);
  const std::string number = significant(value / unit.factor, digits);
  return unit.name.empty() || unit.name == "1" ? number : number + " " + unit.name;
}

DisplayUnit display_unit(double si_value, std::string_view si_unit) {
  return choose_unit(rounded(si_value, 4), si_unit);
}

HeaderUnit parse_header(std::string_view header, const std::vector<Quantity>& allowed, std::string_view where) {
  // The longest suffix wins: "k_N_per_mm" ends in N/mm, not in mm.
  const Unit* found = nullptr;
  size_t found_length = 0;
  bool found_allowed = false;
  std::string quantities;
  std::vector<std::string> suffixes;
  const auto consider = [&](const Unit& unit, bool is_allowed) {
    const std::string suffix = as_suffix(unit.name);
    if (is_allowed) suffixes.push_back(suffix);
    if (header.size() <= suffix.size() || !header.ends_with(suffix) || suffix.size() <= found_length) return;
    found = &unit;
    found_length = suffix.size();
    found_allowed = is_allowed;
  };
  for (const Quantity quantity : allowed) {
    quantities += fmt::format("{}{}", quantities.empty() ? "" : " or ", name_of(quantity));
    for (const Unit& unit : kUnits) {
      if (unit.quantity == quantity) consider(unit, true);
    }
  }
  for (const Unit& unit : kUnits) {
    // A trailing "_1" of another column is a number of something ("marker_1"), not a unit.
    if (std::ranges::find(allowed, unit.quantity) == allowed.end() && unit.name != "1") consider(unit, false);
  }
  if (found != nullptr && found_allowed) {
    return {std::string(header.substr(0, header.size() - found_length)), std::string(found->name), found->quantity,
            found->factor};
  }

  const std::string example = suffixes.empty() ? "" : suffixes.front();
  std::string_view base = header;
  std::string problem;
  if (found != nullptr) {
    base = header.substr(0, header.size() - found_length);
    problem =
        fmt::format("ends in '{}', a unit of {}, but {} is needed", found->name, name_of(found->quantity), quantities);
  } else {
    const size_t underscore = header.rfind('_');
    std::string nearest;
    if (underscore != std::string_view::npos && underscore > 0) {
      nearest = nearest_name(header.substr(underscore), suffixes);
    }
    problem = fmt::format("does not end in a unit of {}", quantities);
    if (!nearest.empty()) {
      base = header.substr(0, underscore);
      problem += fmt::format(" (did you mean '{}{}'?)", base, nearest);
    }
  }
  throw InputError(fmt::format("{}: column '{}' {}; end its name in one of {}, for example '{}{}'", where, header,
                               problem, join(suffixes), base, example));
}

}  // namespace taut

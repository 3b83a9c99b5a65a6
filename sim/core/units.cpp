#include "sim/core/units.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <map>
#include <numbers>
#include <stdexcept>
#include <utility>

#include "sim/core/error.hpp"

namespace taut {
namespace {

struct Unit {
  std::string_view name;
  double factor;  ///< SI value of one unit
};

/// A quantity, its units, of which the first is the SI one, and those that numbers are shown in, ascending.
struct Measure {
  Quantity quantity;
  std::string_view name;
  std::vector<Unit> units;
  std::vector<std::string_view> shown = {};
};

constexpr double kStandardGravity = 9.80665;  // m/s2, exact by definition (CGPM 1901)
constexpr double kPound = 0.45359237;         // kg, exact by definition (1959)
constexpr double kInch = 0.0254;              // m, exact by definition (1959)
constexpr double kPoundPerSquareInch = kPound * kStandardGravity / (kInch * kInch);

/// In the order of Quantity.
const std::vector<Measure>& measures() {
  static const std::vector<Measure> table = {
      {Quantity::pure, "pure number", {{"1", 1}, {"%", 1e-2}}},
      {Quantity::length,
       "length",
       {{"m", 1}, {"mm", 1e-3}, {"cm", 1e-2}, {"um", 1e-6}, {"km", 1e3}, {"in", kInch}},
       {"um", "mm", "m", "km"}},
      {Quantity::area, "area", {{"m2", 1}, {"mm2", 1e-6}, {"cm2", 1e-4}}, {"mm2", "cm2", "m2"}},
      {Quantity::mass,
       "mass",
       {{"kg", 1}, {"g", 1e-3}, {"mg", 1e-6}, {"lb", kPound}, {"oz", kPound / 16}},
       {"mg", "g", "kg"}},
      {Quantity::force,
       "force",
       {{"N", 1},
        {"mN", 1e-3},
        {"kN", 1e3},
        {"kgf", kStandardGravity},
        {"gf", 1e-3 * kStandardGravity},
        {"lbf", kPound * kStandardGravity}},
       {"mN", "N", "kN"}},
      {Quantity::pressure,
       "pressure",
       {{"Pa", 1}, {"kPa", 1e3}, {"MPa", 1e6}, {"GPa", 1e9}, {"N/mm2", 1e6}, {"psi", kPoundPerSquareInch}},
       {"Pa", "kPa", "MPa", "GPa"}},
      {Quantity::density, "density", {{"kg/m3", 1}, {"g/cm3", 1e3}}},
      {Quantity::acceleration, "acceleration", {{"m/s2", 1}, {"mm/s2", 1e-3}}},
      {Quantity::time, "time", {{"s", 1}, {"ms", 1e-3}, {"min", 60}}, {"ms", "s"}},
      {Quantity::frequency, "rate", {{"1/s", 1}}},
      {Quantity::speed, "speed", {{"m/s", 1}, {"mm/s", 1e-3}}},
      {Quantity::angle, "angle", {{"rad", 1}, {"deg", std::numbers::pi / 180}}},
      {Quantity::stiffness, "stiffness", {{"N/m", 1}, {"N/mm", 1e3}, {"kN/m", 1e3}}, {"N/m", "N/mm"}},
      {Quantity::rotation_stiffness, "rotation stiffness", {{"Nm/rad", 1}}},
      {Quantity::line_load, "line load", {{"N/m", 1}, {"N/mm", 1e3}}},
      {Quantity::torque, "torque", {{"Nm", 1}, {"Nmm", 1e-3}, {"mNm", 1e-3}, {"kNm", 1e3}}},
  };
  return table;
}

const Measure& measure_of(Quantity quantity) {
  return measures()[static_cast<size_t>(quantity)];
}

/// The spelling of the tables: "µm" (with either sign) is "um", "N·m" and "N*m" are "Nm", "inch" is "in".
std::string plain_unit(std::string_view name) {
  std::string text(trimmed(name));
  constexpr std::pair<std::string_view, std::string_view> spellings[] = {
      {"\xC2\xB5", "u"}, {"\xCE\xBC", "u"},    {"\xC2\xB2", "2"}, {"\xC2\xB3", "3"},  {"\xC2\xB7", ""},
      {"*", ""},         {"\xE2\x8B\x85", ""}, {"^", ""},         {"\xC2\xB0", "deg"}};
  for (const auto& [from, to] : spellings) {
    for (size_t at = text.find(from); at != std::string::npos; at = text.find(from, at + to.size()))
      text.replace(at, from.size(), to);
  }
  static const std::map<std::string, std::string, std::less<>> others = {
      {"inch", "in"}, {"inches", "in"}, {"\"", "in"}, {"sec", "s"}, {"N.m", "Nm"}, {"N m", "Nm"}, {"-", "1"}};
  const auto other = others.find(text);
  return other == others.end() ? text : other->second;
}

const Unit* find_unit(std::string_view name, const Measure& measure) {
  const auto found = std::ranges::find(measure.units, plain_unit(name), &Unit::name);
  return found == measure.units.end() ? nullptr : &*found;
}

/// " (it is a unit of mass)" for a unit that belongs elsewhere, " (did you mean 'mm'?)" for a misspelt one, or "".
std::string unit_hint(std::string_view name, const std::vector<std::string>& allowed) {
  for (const Measure& measure : measures()) {
    if (find_unit(name, measure) != nullptr) return fmt::format(" (it is a unit of {})", measure.name);
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
  const auto measure = std::ranges::find_if(
      measures(), [&](const Measure& m) { return m.units.front().name == si_unit && !m.shown.empty(); });
  if (measure == measures().end()) return chosen;
  const Unit* smaller = nullptr;
  for (std::string_view name : measure->shown) {
    const Unit* unit = find_unit(name, *measure);
    if (smaller == nullptr || std::abs(value) / unit->factor >= 1 || std::abs(value) / smaller->factor >= 1000)
      chosen = {std::string(name), unit->factor};
    smaller = unit;
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

/// A header as a name and what may be its unit.
struct Ending {
  std::string_view base;
  std::string unit;
};

/// The longest endings first: "k_N_per_mm" ends in N/mm, not in mm.
std::vector<Ending> endings_of(std::string_view header) {
  std::vector<Ending> endings;
  const auto add = [&](size_t base_end, std::string_view unit) {
    std::string_view base = header.substr(0, base_end);
    while (!base.empty() && (base.back() == ' ' || base.back() == '_')) base.remove_suffix(1);
    if (!base.empty() && !unit.empty()) endings.push_back({base, std::string(unit)});
  };
  for (const std::string_view pair : {"()", "[]", "{}", "<>"}) {
    const size_t open = header.rfind(pair[0]);
    if (open != std::string_view::npos && header.ends_with(pair[1]))
      add(open, header.substr(open + 1, header.size() - open - 2));
  }
  for (const std::string_view word : {" / ", " in ", ", "}) {
    const size_t at = header.rfind(word);
    if (at != std::string_view::npos) add(at, header.substr(at + word.size()));
  }
  for (size_t at = header.find('_'); at != std::string_view::npos; at = header.find('_', at + 1)) {
    if (at == 0) continue;
    std::string unit(header.substr(at + 1));
    if (const size_t per = unit.find("_per_"); per != std::string::npos) unit.replace(per, 5, "/");
    endings.push_back({header.substr(0, at), unit});
  }
  if (const size_t slash = header.find('/'); slash != std::string_view::npos) add(slash, header.substr(slash + 1));
  return endings;
}

/// A unit as the end of a header: "N/mm" is written "N_per_mm".
std::string as_suffix(std::string_view unit) {
  std::string suffix = fmt::format("_{}", unit);
  if (const size_t slash = suffix.find('/'); slash != std::string::npos) suffix.replace(slash, 1, "_per_");
  return suffix;
}

}  // namespace

std::string_view name_of(Quantity quantity) {
  return measure_of(quantity).name;
}

std::vector<std::string> units_of(Quantity quantity) {
  std::vector<std::string> names;
  for (const Unit& unit : measure_of(quantity).units) names.emplace_back(unit.name);
  return names;
}

double unit_factor(std::string_view unit, Quantity quantity, std::string_view where) {
  if (const Unit* found = find_unit(unit, measure_of(quantity))) return found->factor;
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
  for (const Measure& measure : measures()) {
    if (measure.units.front().name == si_unit) return measure.quantity;
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
  std::vector<const Measure*> candidates;
  std::vector<std::string> names, suffixes;  // of what is allowed
  for (const Quantity quantity : allowed) {
    candidates.push_back(&measure_of(quantity));
    names.emplace_back(candidates.back()->name);
  }
  for (const Measure& measure : measures()) {
    if (std::ranges::find(allowed, measure.quantity) == allowed.end()) candidates.push_back(&measure);
  }
  const Measure* found = nullptr;
  const Unit* unit = nullptr;
  std::string_view base = header;
  for (size_t k = 0; k < allowed.size(); ++k) {
    for (const Unit& candidate : candidates[k]->units) suffixes.push_back(as_suffix(candidate.name));
  }
  for (const Ending& ending : endings_of(header)) {
    for (size_t k = 0; k < candidates.size() && found == nullptr; ++k) {
      unit = find_unit(ending.unit, *candidates[k]);
      // A trailing "_1" of another column is a number of something ("marker_1"), not a unit.
      if (unit == nullptr || (k >= allowed.size() && unit->name == "1")) continue;
      found = candidates[k];
      base = ending.base;
    }
    if (found != nullptr) break;
  }
  if (found != nullptr && std::ranges::find(allowed, found->quantity) != allowed.end())
    return {std::string(base), std::string(unit->name), found->quantity, unit->factor};

  std::string problem;
  if (found != nullptr) {
    problem = fmt::format("ends in '{}', a unit of {}, but {} is needed", unit->name, found->name, join(names, " or "));
  } else {
    problem = fmt::format("does not end in a unit of {}", join(names, " or "));
    const size_t underscore = header.rfind('_');
    const bool has_end = underscore != std::string_view::npos && underscore > 0;
    const std::string nearest = has_end ? nearest_name(header.substr(underscore), suffixes) : "";
    if (!nearest.empty()) {
      base = header.substr(0, underscore);
      problem += fmt::format(" (did you mean '{}{}'?)", base, nearest);
    }
  }
  throw InputError(fmt::format("{}: column '{}' {}; end its name in one of {}, for example '{}{}'", where, header,
                               problem, join(suffixes), base, suffixes.empty() ? "" : suffixes.front()));
}

std::optional<HeaderUnit> unit_in_header(std::string_view header) {
  for (const Ending& ending : endings_of(header)) {
    for (const Measure& measure : measures()) {
      const Unit* unit = find_unit(ending.unit, measure);
      if (unit != nullptr && (unit->name != "1" || ending.unit == "-"))
        return HeaderUnit{std::string(ending.base), std::string(unit->name), measure.quantity, unit->factor};
    }
  }
  return std::nullopt;
}

std::string without_brackets(std::string_view unit) {
  unit = trimmed(unit);
  for (const std::string_view pair : {"()", "[]", "{}", "<>"}) {
    if (unit.size() >= 2 && unit.front() == pair[0] && unit.back() == pair[1])
      return std::string(trimmed(unit.substr(1, unit.size() - 2)));
  }
  return std::string(unit);
}

bool like_units(const std::vector<std::string>& cells) {
  constexpr size_t longest = 16;
  size_t known = 0, bracketed = 0, filled = 0;
  for (const std::string& cell : cells) {
    if (cell.empty()) continue;
    ++filled;
    const std::string unit = without_brackets(cell);
    const bool number = unit != "-" && unit.find_first_of("0123456789+-.,") == 0;
    if (unit.size() > longest || number) return false;
    if (unit != cell) ++bracketed;
    if (unit != "-" && unit_in_header("x (" + unit + ")")) ++known;
  }
  return known > 0 || (filled > 0 && bracketed == filled);
}

}  // namespace taut

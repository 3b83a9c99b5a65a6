#pragma once
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace taut {

/// What a unit is of.
enum class Quantity {
  pure,
  length,
  area,
  mass,
  force,
  pressure,
  density,
  acceleration,
  time,
  frequency,  ///< [1/s], of decays; not of cycles
  speed,
  angle,
  stiffness,
  rotation_stiffness,
  line_load,
  torque
};

std::string_view name_of(Quantity quantity);  ///< "line load"

/// The units known for a quantity, SI first ("m", "mm", "um", ... for a length).
std::vector<std::string> units_of(Quantity quantity);

/// SI value of one `unit`: 1e-3 for "mm". Spellings of others are known: "µm", "N/mm²", "N*m", "inch". Throws
/// InputError with the units that are known for `quantity` and the nearest name when `unit` is not one of them; `where`
/// starts the message.
double unit_factor(std::string_view unit, Quantity quantity, std::string_view where);

/// The whole of `text` as a finite decimal number ("-1.5e-3", "+2"), independent of the locale; nullopt for all else.
std::optional<double> parse_number(std::string_view text);

/// "30 mm" to 0.030. The number and the unit are separated by blanks; a pure number has no unit, but "2 %" is 0.02.
/// Throws InputError for a missing or wrong unit or number; `where` starts the message.
double parse_quantity(std::string_view text, Quantity quantity, std::string_view where);

/// A value as it stands in the file, and where: its quantity depends on the parameter, which only the model knows.
struct GivenValue {
  std::string text;
  std::string where;
};

/// The quantity whose SI unit this is ("Pa": pressure). Throws std::logic_error for others: units of parameters are
/// ours.
Quantity quantity_of_si_unit(std::string_view si_unit);

/// A number for people: 4 significant digits and a handy unit of the same quantity ("263.8 kPa", "6.49 mm").
/// `si_unit` is the SI unit as ParameterSpec has it; unknown units are printed as they are.
std::string with_unit(double value_si, std::string_view si_unit, int digits = 4);

/// The handy unit that with_unit() would choose for this value, and its SI factor.
struct DisplayUnit {
  std::string name;
  double factor;  ///< SI value of one unit
};
DisplayUnit display_unit(double value_si, std::string_view si_unit);  ///< see DisplayUnit

/// "tip_load_N" to {"tip_load", "N"}: the unit is what follows the last underscore, if it is a unit of one of the
/// `allowed` quantities; so in "mass (g)", "mass [g]", "mass / g" and "mass in g". Otherwise throws InputError that
/// names header, allowed units and an example; `where` starts the message.
struct HeaderUnit {
  std::string name;
  std::string unit;
  Quantity quantity;
  double factor;  ///< SI value of one unit
};
/// See HeaderUnit.
HeaderUnit parse_header(std::string_view header, const std::vector<Quantity>& allowed, std::string_view where);

/// The same for a unit of any quantity; nullopt where the header has none.
std::optional<HeaderUnit> unit_in_header(std::string_view header);

/// "(mm)", "[mm]" and "mm" to "mm".
std::string without_brackets(std::string_view unit);

/// Whether the cells below a header are its units: at least one that is known, or all in brackets, and no number.
bool like_units(const std::vector<std::string>& cells);

}  // namespace taut

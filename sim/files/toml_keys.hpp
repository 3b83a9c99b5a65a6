#pragma once
#include <map>
#include <string>

namespace taut {

/// A value of a TOML file as it stands there, and in a form in which equal ones are alike: quantities in SI ("30 mm"
/// and "0.03 m"), numbers without their spelling, lists entry by entry.
struct TomlValue {
  std::string text;   ///< for people
  std::string alike;  ///< for comparing
};

/// All values of a TOML file by their places: "geometry.size", tables of arrays by their id or name, "load.pull.on",
/// else by number, "fit.variant.2.size". Comments, order and layout do not count. Throws InputError naming path and
/// line.
std::map<std::string, TomlValue> toml_values(const std::string& path);

}  // namespace taut

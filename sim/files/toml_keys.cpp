#include "sim/files/toml_keys.hpp"

#include <fmt/format.h>
#include <toml++/toml.h>

#include <optional>
#include <sstream>

#include "sim/core/error.hpp"
#include "sim/core/input_file.hpp"
#include "sim/core/text_encoding.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

/// "30 mm" as "0.03 m"; nullopt: not a number with a unit.
std::optional<std::string> in_si(const std::string& text) {
  const size_t blank = text.rfind(' ');
  if (blank == std::string::npos || !parse_number(text.substr(0, blank))) return std::nullopt;
  for (int k = static_cast<int>(Quantity::pure); k <= static_cast<int>(Quantity::torque); ++k) {
    const Quantity quantity = static_cast<Quantity>(k);
    try {
      const double value = parse_quantity(text, quantity, "");
      return fmt::format("{:.12g} {}", value, units_of(quantity).front());
    } catch (const InputError&) {  // of another quantity
    }
  }
  return std::nullopt;
}

std::string alike(const std::string& text) {
  const size_t tolerance = text.find("+-");
  if (tolerance == std::string::npos) return in_si(text).value_or(text);
  const std::string value(trimmed(std::string_view(text).substr(0, tolerance)));
  const std::string half(trimmed(std::string_view(text).substr(tolerance + 2)));
  return in_si(value).value_or(value) + " +- " + in_si(half).value_or(half);
}

TomlValue value_of(const toml::node& node) {
  if (const auto text = node.value_exact<std::string>()) return {*text, alike(*text)};
  if (node.is_boolean()) return {*node.value<bool>() ? "true" : "false", *node.value<bool>() ? "true" : "false"};
  if (const auto number = node.value<double>()) return {fmt::format("{}", *number), fmt::format("{:.12g}", *number)};
  std::ostringstream other;  // dates
  node.visit([&](const auto& what) { other << what; });
  return {other.str(), other.str()};
}

/// What a table of an array is called: by its id or name; "": by its number.
std::string name_in_array(const toml::node& node) {
  const toml::table* table = node.as_table();
  if (table == nullptr) return "";
  for (const char* key : {"id", "name"}) {
    if (const auto name = (*table)[key].value<std::string>()) return *name;
  }
  return "";
}

void collect(const toml::node& node, const std::string& place, std::map<std::string, TomlValue>& values) {
  const auto below = [&](std::string_view key) {
    return place.empty() ? std::string(key) : fmt::format("{}.{}", place, key);
  };
  if (const toml::table* table = node.as_table()) {
    for (const auto& [key, value] : *table) collect(value, below(std::string_view(key)), values);
    return;
  }
  const toml::array* array = node.as_array();
  if (array == nullptr) {
    values[place] = value_of(node);
    return;
  }
  TomlValue list{"[", "["};
  bool plain = true;
  size_t number = 0;
  for (const toml::node& entry : *array) {
    ++number;
    const bool nested = entry.is_table() || entry.is_array();
    plain = plain && !nested;
    if (nested) {
      const std::string name = name_in_array(entry);
      collect(entry, below(name.empty() ? std::to_string(number) : name), values);
      continue;
    }
    const TomlValue value = value_of(entry);
    list.text += (number == 1 ? "" : ", ") + value.text;
    list.alike += (number == 1 ? "" : ", ") + value.alike;
  }
  if (plain) values[place] = {list.text + "]", list.alike + "]"};
}

}  // namespace

std::map<std::string, TomlValue> toml_values(const std::string& path) {
  const std::string bytes = read_input_file(path);
  std::map<std::string, TomlValue> values;
  try {
    collect(toml::parse(decoded(bytes, path).text), "", values);
  } catch (const toml::parse_error& error) {
    throw InputError(
        fmt::format("{}:{}: not TOML: {}", path, error.source().begin.line, on_one_line(error.description())));
  }
  return values;
}

}  // namespace taut

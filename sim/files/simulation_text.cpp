#include "sim/files/simulation_text.hpp"

#include <fmt/format.h>
#include <toml++/toml.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <stdexcept>

#include "sim/core/error.hpp"
#include "sim/core/input_file.hpp"
#include "sim/core/text_encoding.hpp"

namespace taut {
namespace {

/// A value of the document and what it becomes.
struct Replacement {
  toml::source_region where;
  std::string text;
};

/// Offset in bytes of a place in UTF-8 text; lines and columns count from 1, columns in code points.
size_t offset_of(const std::string& text, const toml::source_position& place) {
  size_t at = 0;
  for (toml::source_index line = 1; line < place.line; ++line) at = text.find('\n', at) + 1;
  for (toml::source_index column = 1; column < place.column; ++column) {
    ++at;
    while (at < text.size() && (static_cast<unsigned char>(text[at]) & 0xC0) == 0x80) ++at;
  }
  return at;
}

/// "20.5 deg" in the unit of the old text where that gives the value to the last bit, else in the SI one.
std::string written(double value, const std::string& old, Quantity quantity) {
  const std::string_view whole = trimmed(old);
  const size_t blank = whole.find_first_of(" \t");
  if (blank != std::string_view::npos) {
    const std::string unit(trimmed(whole.substr(blank)));
    const double number = value / unit_factor(unit, quantity, "");
    for (const double near : {number, std::nextafter(number, HUGE_VAL), std::nextafter(number, -HUGE_VAL)}) {
      std::string text = fmt::format("{} {}", near, unit);
      if (parse_quantity(text, quantity, "") == value) return text;
    }
  }
  return fmt::format("{} {}", value, units_of(quantity).front());
}

std::string quoted(const std::string& text) {
  std::string result = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') result += '\\';
    result += c;
  }
  return result + "\"";
}

}  // namespace

std::string text_with_schedules(const Simulation& simulation) {
  std::string text = decoded(read_input_file(simulation.path), simulation.path).text;
  const toml::table document = toml::parse(text, simulation.path);
  std::vector<Replacement> replacements;
  for (size_t k = 0; k < simulation.controls.size(); ++k) {
    const Quantity quantity = simulation.controls[k].quantity;
    const std::vector<ControlSchedule::Piece>& pieces = simulation.schedules[k].pieces();
    for (size_t i = 0; i < pieces.size(); ++i) {
      if (!ControlSchedule::has_target(pieces[i])) continue;
      const auto to = document["control"][k]["piece"][i]["to"];
      const std::string old = to.value_or(std::string());
      if (parse_quantity(old, quantity, simulation.path) != pieces[i].target)
        replacements.push_back({to.node()->source(), written(pieces[i].target, old, quantity)});
    }
  }
  for (size_t k = 0; k < simulation.bodies.size(); ++k) {
    const auto path = document["body"][k]["geometry"]["file"];
    const std::filesystem::path old = path.value_or(std::string());
    if (!old.empty() && old.is_relative())
      replacements.push_back(
          {path.node()->source(), std::filesystem::absolute(std::filesystem::path(simulation.path).parent_path() / old)
                                      .lexically_normal()
                                      .string()});
  }
  // From the end, so that places before it stay.
  std::ranges::sort(replacements, [](const Replacement& a, const Replacement& b) {
    return std::pair(a.where.begin.line, a.where.begin.column) > std::pair(b.where.begin.line, b.where.begin.column);
  });
  for (const Replacement& one : replacements) {
    const size_t begin = offset_of(text, one.where.begin), end = offset_of(text, one.where.end);
    text.replace(begin, end - begin, quoted(one.text));
  }
  return text;
}

}  // namespace taut

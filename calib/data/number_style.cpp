#include "calib/data/number_style.hpp"

#include <algorithm>
#include <array>
#include <cctype>

#include "sim/core/units.hpp"

namespace taut {
namespace {

/// In the order of preference.
constexpr std::array<NumberStyle, 4> kStyles = {{{'.', '\0'}, {',', '\0'}, {'.', ','}, {',', '.'}}};

bool all_digits(std::string_view text) {
  return std::ranges::all_of(text, [](char c) { return c >= '0' && c <= '9'; });
}

/// Takes the marks between groups of three digits out of the integer part; false where they stand elsewhere.
bool ungroup(std::string& text, char mark, char decimal) {
  if (text.find(mark) == std::string::npos) return true;
  const size_t begin = text.starts_with('-') || text.starts_with('+') ? 1 : 0;
  size_t end = text.find_first_of(std::string("eE") + decimal);
  if (end == std::string::npos) end = text.size();
  if (text.find(mark, end) != std::string::npos) return false;
  std::string digits;
  for (size_t at = begin, next = 0; at <= end; at = next + 1) {
    next = std::min(text.find(mark, at), end);
    const std::string_view group = std::string_view(text).substr(at, next - at);
    const bool fits = at == begin ? !group.empty() && group.size() <= 3 : group.size() == 3;
    if (!fits || !all_digits(group)) return false;
    digits += group;
  }
  text = text.substr(0, begin) + digits + text.substr(end);
  return true;
}

/// With plain blanks and apostrophes in place of those of typographers.
std::string with_plain_marks(std::string_view cell) {
  std::string text(cell);
  for (const auto& [from, to] :
       {std::pair("\xC2\xA0", ' '), {"\xE2\x80\xAF", ' '}, {"\xE2\x80\x89", ' '}, {"\xE2\x80\x99", '\''}}) {
    for (size_t at = text.find(from); at != std::string::npos; at = text.find(from))
      text.replace(at, std::string_view(from).size(), 1, to);
  }
  return std::string(trimmed(text));
}

struct Place {
  const CsvTable::Row* row;
  size_t column;
  const std::string& text() const { return row->cells[column]; }
};

/// What to say where no style reads all numbers: `place` is the first that plain numbers do not.
[[noreturn]] void fail_mixed(const CsvTable& table, const std::vector<Place>& places, const Place& place) {
  const auto point =
      std::ranges::find_if(places, [](const Place& p) { return p.text().find('.') != std::string::npos; });
  if (point == places.end() || point->row == place.row)
    table.fail(*place.row, place.column, "'{}' cannot be read with the other numbers; write all like 1234.5",
               shown(place.text()));
  table.fail(*place.row, place.column,
             "'{}' has a decimal comma, but '{}' in line {}, column '{}' has a decimal point; use one of them in "
             "the whole file",
             shown(place.text()), shown(point->text()), point->row->line, shown(table.header.cells[point->column]));
}

}  // namespace

std::optional<double> NumberStyle::number(std::string_view cell) const {
  std::string text = with_plain_marks(cell);
  for (const char mark : {' ', '\'', thousands}) {
    if (mark != '\0' && !ungroup(text, mark, decimal)) return std::nullopt;
  }
  if (decimal == ',') {
    if (text.find('.') != std::string::npos) return std::nullopt;
    std::ranges::replace(text, ',', '.');
  }
  return parse_number(text);
}

std::string NumberStyle::describe() const {
  std::string text = decimal == ',' ? "decimal commas" : "";
  if (thousands == '\0') return text;
  return text + (text.empty() ? "" : ", ") + (thousands == ',' ? "commas" : "points") + " between thousands";
}

NumberStyle number_style(const CsvTable& table, const std::vector<size_t>& columns) {
  std::vector<Place> places;
  for (const CsvTable::Row& row : table.rows) {
    for (const size_t column : columns) {
      if (row.cells[column].find_first_of(",.") != std::string::npos && like_a_number(row.cells[column]))
        places.push_back({&row, column});
    }
  }
  const auto first_unread = [&](const NumberStyle& style) {
    return std::ranges::find_if(places, [&](const Place& place) { return !style.number(place.text()); });
  };
  std::vector<NumberStyle> fitting;
  for (const NumberStyle& style : kStyles) {
    if (first_unread(style) == places.end()) fitting.push_back(style);
  }
  if (fitting.empty()) {
    // Of the plain styles the one with commas is the one to name: points are what taut writes itself.
    const auto comma = first_unread(kStyles.front());
    fail_mixed(table, places, *comma);
  }
  const bool plain = fitting.front().thousands == '\0' && (fitting.front().decimal == '.' || table.separator != ',');
  for (const NumberStyle& other : fitting) {
    const auto place = std::ranges::find_if(
        places, [&](const Place& p) { return fitting.front().number(p.text()) != other.number(p.text()); });
    if (plain || place == places.end()) continue;
    table.fail(*place->row, place->column,
               "'{}' may be {} or {}, and no other number of the file tells which; write numbers without thousands "
               "separators, like 1234.5",
               shown(place->text()), *fitting.front().number(place->text()), *other.number(place->text()));
  }
  return fitting.front();
}

bool not_taken(std::string_view cell) {
  std::string text(trimmed(cell));
  std::ranges::transform(text, text.begin(), [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  constexpr std::array<std::string_view, 14> words = {"",    "na",           "n/a",          "#n/a",   "n.a.",
                                                      "nan", "null",         "none",         "-",      "--",
                                                      "---", "\xE2\x80\x93", "\xE2\x80\x94", "1.#qnan"};
  return std::ranges::find(words, text) != words.end();
}

bool like_a_number(std::string_view cell) {
  return std::ranges::any_of(kStyles, [&](const NumberStyle& style) { return style.number(cell).has_value(); });
}

}  // namespace taut

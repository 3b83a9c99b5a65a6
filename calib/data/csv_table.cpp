#include "calib/data/csv_table.hpp"

// The file is in memory before it is split: there is nothing to gain from a thread that reads ahead.
#define CSV_IO_NO_THREAD
#include <fmt/format.h>
#include <libfccp/csv.h>

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <map>
#include <optional>

#include "calib/data/number_style.hpp"
#include "sim/core/input_file.hpp"
#include "sim/core/text_encoding.hpp"
#include "sim/core/units.hpp"

namespace taut {
namespace {

using Blanks = io::trim_chars<' ', '\t'>;
using Comment = io::single_line_comment<'#', '%'>;

std::string read_text(const std::string& path) {
  namespace fs = std::filesystem;
  std::error_code ignored;
  if (!fs::exists(path, ignored)) {
    std::vector<std::string> neighbours;
    const fs::path folder = fs::path(path).has_parent_path() ? fs::path(path).parent_path() : fs::path(".");
    for (fs::directory_iterator entry(folder, ignored), end; !ignored && entry != end; entry.increment(ignored))
      neighbours.push_back(entry->path().filename().string());
    throw InputError(fmt::format("{}: there is no such file{}; correct the path of the bench file", path,
                                 did_you_mean(fs::path(path).filename().string(), neighbours)));
  }
  if (fs::is_directory(path, ignored))
    throw InputError(fmt::format("{}: this is a folder; name the CSV file in it", path));
  return read_input_file(path);
}

/// The text with line ends that LineReader knows; what it would pass over in silence is noted.
std::string with_plain_ends(std::string text, CsvTable& table) {
  table.byte_order_mark = text.starts_with("\xEF\xBB\xBF");
  table.carriage_returns = text.find("\r\n") != std::string::npos;
  for (size_t i = 0; i < text.size(); ++i) {
    if (text[i] == '\r' && (i + 1 == text.size() || text[i + 1] != '\n')) text[i] = '\n';
  }
  if (!text.empty() && text.back() != '\n') text += '\n';
  return text;
}

/// Splits a line in place. io::CSVReader wants the number of columns and the separator when it is compiled; here both
/// are known only from the header, so only its quoting and trimming policies are used.
template <char separator>
std::vector<std::string> split_at(char* line) {
  using Quotes = io::double_quote_escape<separator, '"'>;
  std::vector<std::string> cells;
  for (bool last = false; !last;) {
    char* begin = line;
    char* end = begin + (Quotes::find_next_column_end(begin) - begin);
    last = *end == '\0';
    line = end + 1;
    Blanks::trim(begin, end);
    Quotes::unescape(begin, end);
    Blanks::trim(begin, end);
    cells.emplace_back(begin, end);
  }
  return cells;
}

/// A copy: the parser splits in place.
std::vector<std::string> split(std::string line, char separator) {
  if (separator == '\t') return split_at<'\t'>(line.data());
  if (separator == ';') return split_at<';'>(line.data());
  return split_at<','>(line.data());
}

std::vector<std::string> split(const std::string& line, const CsvTable& table, int number) {
  try {
    return split(line, table.separator);
  } catch (const io::error::escaped_string_not_closed&) {
    table.fail(
        number,
        "a quoted cell is not closed on its line; close it with \" (a \" inside a quoted cell is written twice)");
  }
}

/// None where a quote is not closed: such a line is no header.
std::vector<std::string> split_or_none(const std::string& line, char separator) {
  try {
    return split(line, separator);
  } catch (const io::error::escaped_string_not_closed&) {
    return {};
  }
}

char detect_separator(std::string_view header) {
  std::map<char, int> count;
  bool quoted = false;
  for (const char c : header) {
    if (c == '"') quoted = !quoted;
    if (!quoted) ++count[c];
  }
  return std::ranges::max({',', ';', '\t'}, {}, [&](char c) { return count[c]; });
}

using Cells = std::vector<std::string>;

bool any_number(const Cells& cells) {
  return std::ranges::any_of(cells, like_a_number);
}

/// A line of the file before it is known to belong to the table.
struct Line {
  int number = 0;
  std::string text;
  bool comment = false;
  bool after_blank = false;
};

bool blank(const std::string& text) {
  return text.find_first_not_of(" \t,;\"") == std::string::npos;
}

std::vector<Line> lines_of(const std::string& path, std::string& text, CsvTable& table) {
  std::vector<Line> result;
  try {
    io::LineReader lines(path, text.data(), text.data() + text.size());
    bool after_blank = false;
    while (char* line = lines.next_line()) {
      if (blank(line)) {
        after_blank = true;
        continue;
      }
      result.push_back({static_cast<int>(lines.get_file_line()), line, Comment::is_comment(line), after_blank});
      after_blank = false;
    }
  } catch (const io::error::line_length_limit_exceeded& error) {
    table.fail(error.file_line, "the line is longer than {} characters; is this a CSV file with one row per line?",
               (1 << 24) - 1);
  }
  return result;
}

/// Where the table's names stand.
struct Header {
  size_t line = 0;  ///< index into the lines
  char separator = ',';
  std::string text;
  size_t known = 0;  ///< names that the experiment asks for
  bool numbers_below = false;
};

/// The names of a commented header ("# time,force"); a column called "#" keeps its name.
std::string uncommented(const Line& line) {
  if (!line.comment) return line.text;
  const std::string rest(trimmed(std::string_view(line.text).substr(1)));
  return rest.empty() || std::string_view(",;\t").find(rest.front()) != std::string_view::npos ? line.text : rest;
}

/// The header is the line with the most names that the experiment asks for. `comments`: whether comments may be it.
Header find_header(const std::vector<Line>& lines, const std::vector<std::string>& wanted, char declared,
                   bool comments) {
  constexpr size_t farthest = 2000;
  Header best;
  for (size_t i = 0; i < std::min(lines.size(), farthest); ++i) {
    if (lines[i].comment != comments) continue;
    for (const char separator : {',', ';', '\t'}) {
      if (declared != '\0' && separator != declared) continue;
      Header header{i, separator, uncommented(lines[i])};
      const Cells cells = split_or_none(header.text, separator);
      header.known = static_cast<size_t>(std::ranges::count_if(wanted, [&](const std::string& name) {
        return std::ranges::any_of(cells, [&](const std::string& cell) { return same_column(name, cell); });
      }));
      if (header.known == 0) continue;
      for (size_t below = i + 1; below < std::min(lines.size(), i + 3); ++below)
        header.numbers_below |= any_number(split_or_none(lines[below].text, separator));
      if (std::pair(header.known, header.numbers_below) > std::pair(best.known, best.numbers_below)) best = header;
    }
  }
  return best;
}

/// Where a table seems to start that has none of the names: above the first line with two numbers or nothing else.
Header guess_header(const std::vector<Line>& lines, char declared) {
  const auto first = std::ranges::find(lines, false, &Line::comment);
  Header header{static_cast<size_t>(first - lines.begin()), ',', first->text};
  size_t above = header.line;
  for (size_t i = header.line; i < lines.size(); ++i) {
    if (lines[i].comment) continue;
    const Cells cells = split_or_none(lines[i].text, declared != '\0' ? declared : detect_separator(lines[i].text));
    const auto numbers = static_cast<size_t>(std::ranges::count_if(cells, like_a_number));
    if (numbers >= 2 || (numbers == 1 && cells.size() == 1)) {
      header.line = above;
      break;
    }
    if (!like_units(cells)) above = i;
  }
  header.text = lines[header.line].text;
  header.separator = declared != '\0' ? declared : detect_separator(header.text);
  return header;
}

/// "sep=;", which Excel reads and writes as the first line; '\0' where it is none.
char declared_separator(const Line& line) {
  std::string_view text = trimmed(line.text);
  if (text.size() >= 2 && text.starts_with('"') && text.ends_with('"')) text = text.substr(1, text.size() - 2);
  if (text == "sep=" && line.text.ends_with('\t')) return '\t';
  if (text.size() != 5 || !(text.starts_with("sep=") || text.starts_with("SEP="))) return '\0';
  return std::string_view(",;\t").find(text.back()) == std::string_view::npos ? '\0' : text.back();
}

/// Takes away what trailing separators leave behind: cells without a name that hold nothing.
void drop_trailing_cells(CsvTable& table) {
  Cells& names = table.header.cells;
  const auto holds = [](const CsvTable::Row& row, size_t i) { return i < row.cells.size() && !row.cells[i].empty(); };
  while (names.size() > 1 && names.back().empty() &&
         std::ranges::none_of(table.rows, [&](const CsvTable::Row& row) { return holds(row, names.size() - 1); }))
    names.pop_back();
  for (CsvTable::Row& row : table.rows) {
    while (row.cells.size() > names.size() && row.cells.back().empty()) row.cells.pop_back();
  }
}

void take_units_row(CsvTable& table) {
  if (table.rows.empty() || table.rows.front().cells.size() > table.header.cells.size() ||
      !like_units(table.rows.front().cells))
    return;
  table.units = table.rows.front().cells;
  table.units.resize(table.header.cells.size());
  for (std::string& unit : table.units) unit = without_brackets(unit);
  table.units_line = table.rows.front().line;
  table.rows.erase(table.rows.begin());
}

// Footers

bool summary_word(std::string_view cell) {
  std::string word(trimmed(cell));
  while (!word.empty() && (word.back() == ':' || word.back() == '.')) word.pop_back();
  std::ranges::transform(word, word.begin(), [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  constexpr std::string_view words =
      "|mean|average|avg|median|std|sd|s|stdev|std dev|stddev|standard "
      "deviation|min|minimum|max|maximum|sum|total|range|"
      "cv|cov|count|n|variance|mittelwert|mittel|standardabweichung|stabw|summe|anzahl|varianz|moyenne|ecart "
      "type|media|"
      "promedio|gemiddelde|end|ende|eof|";
  return words.find("|" + word + "|") != std::string_view::npos;
}

/// Which trailing rows are no readings, by what the first row of the table looks like.
class Footer {
 public:
  explicit Footer(const CsvTable& table) : table_(table), first_(table.rows.front().cells) {}

  /// By itself: "Mean;..", or a sentence in a table of several columns.
  bool plain(const Cells& cells) const {
    const std::string& label = *std::ranges::find_if(cells, [](const std::string& c) { return !c.empty(); });
    if (cells.size() == 1 && table_.header.cells.size() > 1) return !like_a_number(cells[0]) && !not_taken(cells[0]);
    return summary_word(label) && (like_a_number(first_.front()) || !complete(cells));
  }
  /// Below an empty line: whatever is no row of this table.
  bool below_blank(const Cells& cells) const {
    if (plain(cells)) return true;
    if (like_a_number(first_.front()))
      return !like_a_number(cells.front()) && (cells.size() == 2 || !complete(cells, 1));
    return cells.size() != table_.header.cells.size() || !any_number(cells);
  }

 private:
  /// Has numbers wherever the first row has them, from a column on.
  bool complete(const Cells& cells, size_t from = 0) const {
    if (cells.size() != first_.size()) return false;
    for (size_t i = from; i < cells.size(); ++i) {
      if (like_a_number(first_[i]) && !like_a_number(cells[i])) return false;
    }
    return true;
  }
  const CsvTable& table_;
  const Cells& first_;
};

/// Takes the footer away: the longest end of the file without a row of the table.
void drop_footer(CsvTable& table, const std::vector<bool>& after_blank) {
  if (table.rows.empty()) return;
  const Footer footer(table);
  size_t begin = table.rows.size();
  while (begin > 1 && footer.below_blank(table.rows[begin - 1].cells)) --begin;
  bool below_blank = false;
  size_t start = begin;
  for (size_t i = begin; i < table.rows.size(); ++i) {
    below_blank = below_blank || after_blank[i];
    if (below_blank || footer.plain(table.rows[i].cells)) continue;
    start = i + 1;
  }
  if (start == table.rows.size()) return;
  table.footer_line = table.rows[start].line;
  table.rows.erase(table.rows.begin() + static_cast<std::ptrdiff_t>(start), table.rows.end());
}

}  // namespace

void check_names(const CsvTable& table, const std::vector<std::string>& ignored) {
  const std::vector<std::string>& names = table.header.cells;
  if (std::ranges::all_of(names, like_a_number))
    table.fail(table.header.line,
               "the table seems to start here, with numbers and no names above them; add a header line with column "
               "names such as 'mass_g'");
  const auto skipped = [&](size_t i) { return std::ranges::find(ignored, numbered_column(i)) != ignored.end(); };
  for (size_t i = 0; i < names.size(); ++i) {
    if (skipped(i)) continue;
    if (names[i].empty() && std::ranges::all_of(table.rows, [&](const CsvTable::Row& row) {
          return i >= row.cells.size() || row.cells[i].empty();
        }))
      continue;
    if (names[i].empty())
      table.fail(table.header.line,
                 "column {0} of {1} has no name; name it, delete the column and its separators, or list its number {0} "
                 "under ignore",
                 i + 1, names.size());
    for (size_t first = 0; first < i; ++first) {
      if (names[first] == names[i] && !skipped(first))
        table.fail(table.header.line,
                   "column '{}' stands twice, as columns {} and {}; give each column its own name, or list the number "
                   "of one under ignore",
                   shown(names[i]), first + 1, i + 1);
    }
  }
}

std::string numbered_column(size_t index) {
  return fmt::format("#{}", index + 1);
}

bool same_column(std::string_view name, std::string_view header) {
  if (name == header) return !name.empty();
  const std::optional<HeaderUnit> wanted = unit_in_header(name), present = unit_in_header(header);
  if (!present) return false;
  return wanted ? wanted->name == present->name && wanted->unit == present->unit : name == present->name;
}

std::optional<size_t> find_column(const CsvTable& table, std::string_view name,
                                  const std::vector<std::string>& ignored) {
  const std::vector<std::string>& names = table.header.cells;
  for (const bool exactly : {true, false}) {
    for (size_t i = 0; i < names.size(); ++i) {
      if (std::ranges::find(ignored, numbered_column(i)) != ignored.end()) continue;
      if (exactly ? names[i] == name : same_column(name, names[i])) return i;
    }
  }
  return std::nullopt;
}

std::string CsvTable::at(const Row& row, size_t column) const {
  return fmt::format("{}, column '{}'", at(row.line), shown(header.cells[column]));
}

std::string CsvTable::title(size_t column) const {
  const std::string& name = header.cells[column];
  const std::string unit = units.empty() ? "" : units[column];
  const std::optional<HeaderUnit> own = unit_in_header(name);
  if (unit.empty() || unit == "-" || unit == "1") return name;
  const std::string titled = fmt::format("{} ({})", name, unit);
  if (!own) return titled;
  const std::optional<HeaderUnit> below = unit_in_header(titled);
  if (below && (below->unit == own->unit)) return name;
  fail(units_line, "the unit of column '{}' is '{}' here and '{}' in the header; correct one of them", shown(name),
       shown(unit), own->unit);
}

std::string CsvTable::layout(const std::string& numbers) const {
  const bool plain = preamble_line == 0 && units_line == 0 && footer_line == 0;
  std::vector<std::string> parts;
  if (!plain) {
    parts.push_back(fmt::format("table from line {}", header.line));
    parts.push_back(separator == '\t' ? "tabs between columns" : fmt::format("'{}' between columns", separator));
  }
  if (!plain && !numbers.empty()) parts.push_back(numbers);
  if (units_line > 0) parts.push_back(fmt::format("units in line {}", units_line));
  if (footer_line > 0) parts.push_back(fmt::format("footer from line {}", footer_line));
  if (!encoding.empty()) parts.push_back(encoding);
  return parts.empty() ? "" : fmt::format("{}: {}", path, join(parts));
}

CsvTable read_csv(const std::string& path, const std::vector<std::string>& wanted) {
  CsvTable table;
  table.path = path;
  DecodedText decoded_text = decoded(read_text(path), path);
  table.encoding = decoded_text.remark();
  std::string text = with_plain_ends(std::move(decoded_text.text), table);
  std::vector<Line> lines = lines_of(path, text, table);
  const char declared = lines.empty() ? '\0' : declared_separator(lines.front());
  if (declared != '\0') lines.erase(lines.begin());
  Header header = find_header(lines, wanted, declared, false);
  if (header.known == 0) header = find_header(lines, wanted, declared, true);
  if (header.known == 0) {
    if (std::ranges::all_of(lines, &Line::comment))
      throw InputError(
          fmt::format("{}: the file is empty; it needs a header line with column names such as 'mass_g' and "
                      "one row per reading",
                      path));
    header = guess_header(lines, declared);
  }
  table.separator = header.separator;
  table.header = {lines[header.line].number, split(header.text, table, lines[header.line].number)};
  std::vector<bool> after_blank;
  for (size_t i = 0; i < lines.size(); ++i) {
    const Line& line = lines[i];
    if (i < header.line && !line.comment && table.preamble_line == 0) table.preamble_line = line.number;
    if (line.comment && i != header.line) ++table.comments;
    if (line.comment || i <= header.line) continue;
    table.rows.push_back({line.number, split(line.text, table, line.number)});
    after_blank.push_back(line.after_blank);
  }
  drop_trailing_cells(table);
  const size_t all = table.rows.size();
  take_units_row(table);
  if (table.rows.size() < all) after_blank.erase(after_blank.begin());
  drop_footer(table, after_blank);
  drop_trailing_cells(table);
  return table;
}

void check_cell_counts(const CsvTable& table) {
  for (const CsvTable::Row& row : table.rows) {
    const size_t expected = table.header.cells.size();
    if (row.cells.size() == expected) continue;
    std::string hint;
    if (table.preamble_line > 0) hint = " (the table seems to start there)";
    if (row.cells.size() > expected && table.separator == ',')
      hint = " (a decimal comma? it needs semicolons or tabs between the cells)";
    table.fail(row.line, "found {} cell{} where the header in line {} has {}{}; correct the row", row.cells.size(),
               row.cells.size() == 1 ? "" : "s", table.header.line, expected, hint);
  }
}

std::string shown(std::string_view text) {
  constexpr size_t limit = 40;
  std::string result(text.substr(0, limit));
  if (text.size() > limit) {
    // Never cut a UTF-8 character in two.
    while (!result.empty() && (static_cast<unsigned char>(text[result.size()]) & 0xC0) == 0x80) result.pop_back();
    result += "...";
  }
  for (char& c : result) {
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7F) c = '?';
  }
  return result;
}

std::string listed(const std::vector<std::string>& names) {
  constexpr size_t limit = 6;
  std::vector<std::string> words;
  for (size_t i = 0; i < std::min(limit, names.size()); ++i) words.push_back(shown(names[i]));
  if (names.size() > limit) words.push_back(fmt::format("and {} more", names.size() - limit));
  return join(words);
}

}  // namespace taut

#include "calib/data/csv_table.hpp"

// The file is in memory before it is split: there is nothing to gain from a thread that reads ahead.
#define CSV_IO_NO_THREAD
#include <fmt/format.h>
#include <libfccp/csv.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>

namespace taut {
namespace {

using Blanks = io::trim_chars<' ', '\t'>;
using CommentOrEmpty = io::single_and_empty_line_comment<'#'>;
using Comment = io::single_line_comment<'#'>;

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
  std::ifstream file(path, std::ios::binary);
  std::string text{std::istreambuf_iterator<char>(file), {}};
  if (!file.good() && !file.eof())
    throw InputError(fmt::format("{}: the file cannot be read; check its permissions", path));
  return text;
}

/// What LineReader would pass over in silence: marks to report, and bytes that are not text.
void inspect(std::string& text, CsvTable& table) {
  table.byte_order_mark = text.starts_with("\xEF\xBB\xBF");
  table.carriage_returns = text.find("\r\n") != std::string::npos;
  int line = 1;
  for (size_t i = 0; i < text.size(); ++i) {
    if (text[i] == '\n') ++line;
    if (text[i] == '\0')
      table.fail(line,
                 "there is a zero byte, so this is not a CSV text file but perhaps a spreadsheet or UTF-16; export it "
                 "as CSV in UTF-8");
    if (text[i] == '\r' && i + 1 < text.size() && text[i + 1] != '\n')
      table.fail(line,
                 "there is a carriage return that does not end the line; save the file with LF or CRLF line ends");
  }
  if (!text.empty() && text.back() != '\n') text += '\n';
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

std::vector<std::string> split(char* line, const CsvTable& table, int number) {
  try {
    if (table.separator == '\t') return split_at<'\t'>(line);
    if (table.separator == ';') return split_at<';'>(line);
    return split_at<','>(line);
  } catch (const io::error::escaped_string_not_closed&) {
    table.fail(
        number,
        "a quoted cell is not closed on its line; close it with \" (a \" inside a quoted cell is written twice)");
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

void check_header(const CsvTable& table) {
  const std::vector<std::string>& names = table.header.cells;
  for (size_t i = 0; i < names.size(); ++i) {
    if (names[i].empty())
      table.fail(table.header.line, "column {} of {} has no name; name it, or delete the column and its separators",
                 i + 1, names.size());
    const size_t first = static_cast<size_t>(std::ranges::find(names, names[i]) - names.begin());
    if (first < i)
      table.fail(table.header.line, "column '{}' stands twice, as columns {} and {}; give each column its own name",
                 shown(names[i]), first + 1, i + 1);
  }
}

}  // namespace

std::string CsvTable::at(const Row& row, size_t column) const {
  return fmt::format("{}, column '{}'", at(row.line), shown(header.cells[column]));
}

CsvTable read_csv(const std::string& path) {
  CsvTable table;
  table.path = path;
  std::string text = read_text(path);
  inspect(text, table);
  try {
    io::LineReader lines(path, text.data(), text.data() + text.size());
    while (char* line = lines.next_line()) {
      if (CommentOrEmpty::is_comment(line)) {
        if (Comment::is_comment(line)) ++table.comments;
        continue;
      }
      const int number = static_cast<int>(lines.get_file_line());
      if (table.header.line == 0) {
        table.separator = detect_separator(line);
        table.header = {number, split(line, table, number)};
        check_header(table);
      } else {
        table.rows.push_back({number, split(line, table, number)});
      }
    }
  } catch (const io::error::line_length_limit_exceeded& error) {
    table.fail(error.file_line, "the line is longer than {} characters; is this a CSV file with one row per line?",
               (1 << 24) - 1);
  }
  if (table.header.line == 0) {
    throw InputError(
        fmt::format("{}: the file is empty; it needs a header line with column names such as 'mass_g' and "
                    "one row per reading",
                    path));
  }
  return table;
}

void check_cell_counts(const CsvTable& table) {
  for (const CsvTable::Row& row : table.rows) {
    const size_t expected = table.header.cells.size();
    if (row.cells.size() == expected) continue;
    std::string hint;
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

#pragma once
#include <fmt/format.h>

#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "sim/core/error.hpp"

namespace taut {

/// A CSV file split into cells, before any cell means anything: the file's dialect lives here, its meaning in trials.
struct CsvTable {
  /// A line of the file.
  struct Row {
    int line = 0;  ///< in the file, from 1; comments and empty lines count
    std::vector<std::string> cells;
  };
  std::string path;
  Row header;
  std::vector<Row> rows;  ///< as many cells as they have, see check_cell_count(); without units and footer
  char separator = ',';   ///< comma, semicolon or tab
  bool byte_order_mark = false;
  bool carriage_returns = false;
  int comments = 0;
  std::vector<std::string> units;  ///< of each column, from a row below the header; empty where there is none
  int preamble_line = 0;           ///< first line above the header that is no comment; 0: none
  int units_line = 0;              ///< 0: none
  int footer_line = 0;             ///< from here on there are no rows of the table; 0: none
  std::string encoding;            ///< a remark, "" for UTF-8

  /// The name of a column with its unit, as parse_header() reads it, wherever the file says the unit. Throws InputError
  /// where name and units row disagree.
  std::string title(size_t column) const;
  /// Where the table was found in a file that holds more than a table, with how it writes `numbers`, and its encoding;
  /// "" for a plain file.
  std::string layout(const std::string& numbers) const;

  /// "bench.csv, line 3": how a message about this file begins.
  std::string at(int line) const { return fmt::format("{}, line {}", path, line); }
  /// "bench.csv, line 3, column 'mass_g'".
  std::string at(const Row& row, size_t column) const;

  /// Throws InputError that begins with the place.
  template <class... Args>
  [[noreturn]] void fail(int line, fmt::format_string<Args...> what, Args&&... args) const {
    throw InputError(at(line) + ": " + fmt::format(what, std::forward<Args>(args)...));
  }
  /// The same at a cell.
  template <class... Args>
  [[noreturn]] void fail(const Row& row, size_t column, fmt::format_string<Args...> what, Args&&... args) const {
    throw InputError(at(row, column) + ": " + fmt::format(what, std::forward<Args>(args)...));
  }
};

/// Reads a file with fast-cpp-csv-parser. The header is the line that holds most of the `wanted` names: what stands
/// above it is a preamble (without names: the line above the first numbers); a row of units may follow; rows at the end
/// that are none of the table (an empty line and then something else, "Mean;..", a sentence) are a footer. Lines that
/// begin with # or % are comments. Throws InputError for a missing, unreadable, empty or binary file, an unclosed
/// quote, and a line beyond the length limit of the parser (2^24 - 1).
CsvTable read_csv(const std::string& path, const std::vector<std::string>& wanted = {});

/// Throws InputError for a column name that is empty above readings or stands twice, and for a table without names.
/// `ignored`: see find_column().
void check_names(const CsvTable& table, const std::vector<std::string>& ignored = {});

/// "#3" for the third column: how a list of ignored columns names it by number.
std::string numbered_column(size_t index);

/// Whether a header is the column that is asked for: the same text, or the same name with the same unit written in
/// another way ("mass_g" and "mass [g]"), or the name alone ("mass").
bool same_column(std::string_view name, std::string_view header);

/// Index of the column that is the same, at best to the letter; not one whose number is among `ignored`.
std::optional<size_t> find_column(const CsvTable& table, std::string_view name,
                                  const std::vector<std::string>& ignored = {});

/// Throws InputError for the first row that has more or fewer cells than the header.
void check_cell_counts(const CsvTable& table);

/// Text of a file as it may stand in a message: one line, not too long.
std::string shown(std::string_view text);

/// The first few of `names` and how many more there are, for messages.
std::string listed(const std::vector<std::string>& names);

}  // namespace taut

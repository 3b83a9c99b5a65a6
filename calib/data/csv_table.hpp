#pragma once
#include <fmt/format.h>

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
  std::vector<Row> rows;  ///< as many cells as they have, see check_cell_count()
  char separator = ',';   ///< comma, semicolon or tab: the one that the header has most of
  bool byte_order_mark = false;
  bool carriage_returns = false;
  int comments = 0;

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

/// Reads a file with fast-cpp-csv-parser. Throws InputError for a missing, unreadable, empty or binary file, an
/// unclosed quote, a line beyond the length limit of the parser (2^24 - 1), and a column name that is empty or stands
/// twice.
CsvTable read_csv(const std::string& path);

/// Throws InputError for the first row that has more or fewer cells than the header.
void check_cell_counts(const CsvTable& table);

/// Text of a file as it may stand in a message: one line, not too long.
std::string shown(std::string_view text);

/// The first few of `names` and how many more there are, for messages.
std::string listed(const std::vector<std::string>& names);

}  // namespace taut

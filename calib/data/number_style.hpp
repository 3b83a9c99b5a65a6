#pragma once
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/data/csv_table.hpp"

namespace taut {

/// How a file writes its numbers. Blanks and apostrophes between groups of three digits are passed over in any style.
struct NumberStyle {
  char decimal = '.';     ///< point or comma
  char thousands = '\0';  ///< the other one between groups of three digits, or none

  /// The whole of `cell` as a finite number; nullopt for all else.
  std::optional<double> number(std::string_view cell) const;
  std::string describe() const;  ///< "decimal commas, points between thousands"; "" for plain numbers
};

/// The one style in which all numbers of these columns can be read. Throws InputError where there is none, or where two
/// would give different values ("1,234" between commas).
NumberStyle number_style(const CsvTable& table, const std::vector<size_t>& columns);

/// Whether a cell says that a reading was not taken: empty, NA, N/A, n.a., NaN, null, none, - or --.
bool not_taken(std::string_view cell);

/// Whether a cell is a number in some style.
bool like_a_number(std::string_view cell);

}  // namespace taut

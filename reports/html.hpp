#pragma once
#include <string>
#include <vector>

#include "reports/report.hpp"

/// Pieces of report.html. Used inside reports/ only.
namespace taut::html {

/// A whole page that loads nothing from anywhere.
std::string page(const std::string& title, const std::string& body);

/// A paragraph of this text, escaped here.
std::string paragraph(const std::string& text, const std::string& kind = "");

/// A figure with its caption: its SVG, or a link to its picture where that has more than `largest` bytes.
std::string figure(const Figure& figure, size_t largest = std::string::npos);

/// Text as HTML shows it: nothing in it is markup.
std::string escaped(const std::string& text);

/// A number of four significant digits, "not known" for NaN.
std::string bare_number(double value);

using Cells = std::vector<std::string>;  ///< a row of a table

/// A table of texts, escaped here. A header that starts with '#' makes its column one of numbers, set to the right; a
/// cell that starts with '`' is set as code, one that starts with '~' struck out; empty headers only give a table
/// without a head.
std::string table(const Cells& header, const std::vector<Cells>& rows);

/// One row for each item.
template <class Items, class Row>
std::vector<Cells> rows_of(const Items& items, Row&& row) {
  std::vector<Cells> rows;
  for (const auto& item : items) rows.push_back(row(item));
  return rows;
}

/// A list of texts, escaped here.
std::string list(const std::vector<std::string>& texts);

/// gnuplot's SVG as a part of a page: no prologue, ids made unique by `name`, a title for screen readers.
std::string inlined(const std::string& svg, const std::string& name, const std::string& title);

}  // namespace taut::html

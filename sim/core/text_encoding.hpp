#pragma once
#include <string>
#include <string_view>

namespace taut {

/// What a text file holds, as UTF-8.
struct DecodedText {
  std::string text;
  int cp1252_line = 0;  ///< the first line with bytes that are not UTF-8, which are taken as Windows cp1252; 0: none
  std::string remark() const;  ///< says so; "" where all was UTF-8
};

/// The bytes of the file at `path` as UTF-8: bytes that are none are taken as cp1252, which Latin-1 is part of. Throws
/// InputError, with the byte and the remedy, for workbooks (.xlsx, .xls), UTF-16 and zero bytes.
DecodedText decoded(std::string bytes, const std::string& path);

/// The text with its control characters as they are escaped in strings, "\n" and "\x1B": on one line, and without
/// orders to a terminal. For messages that quote what a stranger's file holds.
std::string on_one_line(std::string_view text);

}  // namespace taut

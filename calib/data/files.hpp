#pragma once
#include <string>

namespace taut {

/// Writes `text` to `path` so that an interruption leaves the old file or the new one, never half of one.
void write_file(const std::string& path, const std::string& text);
/// Adds a line to a table, after `header` where there is none yet. An interruption leaves what was there before and at
/// most a part of the line, without its end; such a part is taken off by the next one. Others may add to it at the same
/// time.
void append_line(const std::string& path, const std::string& header, const std::string& line);
std::string read_file(const std::string& path);       ///< InputError when it cannot be read
std::string sha256_of(const std::string& path);       ///< in hexadecimal; InputError as read_file()
std::string sha256_of_text(const std::string& text);  ///< of a file that holds it

}  // namespace taut

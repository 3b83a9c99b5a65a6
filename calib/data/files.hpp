#pragma once
#include <string>

namespace taut {

/// Writes `text` to `path` so that an interruption leaves the old file or the new one, never half of one.
void write_file(const std::string& path, const std::string& text);
std::string read_file(const std::string& path);  ///< InputError when it cannot be read
std::string sha256_of(const std::string& path);

}  // namespace taut

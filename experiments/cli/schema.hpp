#pragma once
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>

namespace taut {

/// Which language of files a text is in: "experiment" or "simulation".
std::string language_of(const std::string& path, std::string_view text);

/// JSON Schema of experiment or simulation files, valid as draft 4 and as 2020-12: the keys of each table, their words,
/// and how quantities are written. It is what the readers of those files ask for while they read all that taut ships,
/// so that it knows what they know; what depends on other keys (which of them are needed, which exclude each other) is
/// left to `taut check`. `language` is one of language_of().
nlohmann::ordered_json schema_of(std::string_view language);

}  // namespace taut

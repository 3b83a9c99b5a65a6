#pragma once
#include <map>
#include <string_view>

namespace taut {

/// Files of this folder that pages hold, by name, as the build embeds them: "page.css", "report.js", "animation.html",
/// "space.js", and of another's work "three.min.js" with its licence.
/// Used inside reports/ only.
const std::map<std::string_view, std::string_view>& page_texts();

/// One of them. Throws std::out_of_range for a name that is not among them.
inline std::string_view page_text(std::string_view name) {
  return page_texts().at(name);
}

}  // namespace taut

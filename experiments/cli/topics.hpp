#pragma once
#include <map>
#include <string>
#include <string_view>
#include <vector>

// The documentation as `taut help TOPIC` and the man page show it: sections of the Markdown files.
namespace taut {

/// What `taut help NAME` shows: the part of a document from the line that starts with `begin` to the next heading of
/// its level; where that is no heading but a key in bold, to the next such key or heading.
struct Topic {
  std::string name;
  std::string_view about;
  std::string_view document, begin;
};

/// In the order in which they are listed. A new one is a line there.
const std::vector<Topic>& all_topics();

/// A heading, paragraph, item of a list, line of code or table, without the marks of Markdown.
struct Block {
  enum Kind { heading, paragraph, item, code, table } kind;
  std::string text;                                 ///< of all but tables
  std::vector<std::vector<std::string>> rows = {};  ///< of a table, its header first
};

/// What stands there. Throws std::logic_error when the document has no such part.
std::vector<Block> blocks_of(const Topic& topic);

/// Words in lines of at most `width` characters, but for longer words.
std::vector<std::string> wrapped(std::string_view text, size_t width);

/// For a terminal.
std::string as_text(const std::vector<Block>& blocks, size_t width);

/// The Markdown files by their paths in the sources, as they were when taut was built (cmake/embed.cmake).
const std::map<std::string_view, std::string_view>& documents();

}  // namespace taut

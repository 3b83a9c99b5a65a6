#include "sim/mesh/geo_file.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <filesystem>
#include <string_view>

#include "sim/core/error.hpp"
#include "sim/core/input_file.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;

bool of_word(char c) {
  return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_';
}

/// The statements of a .geo: comments and strings are none.
class GeoText {
 public:
  explicit GeoText(const std::string& path) : path_(path) { text_ = read_input_file(path); }

  /// The names of the files that it takes in, as they stand there.
  std::vector<std::string> names() {
    std::vector<std::string> found;
    for (at_ = 0; at_ < text_.size();) {
      if (skip_comment() || skip_string()) continue;
      if (!of_word(text_[at_])) {
        ++at_;
        continue;
      }
      const bool member = at_ > 0 && text_[at_ - 1] == '.';  // an option, Mesh.Merge say
      const size_t first = at_;
      while (at_ < text_.size() && of_word(text_[at_])) ++at_;
      const std::string word = text_.substr(first, at_ - first);
      constexpr std::array<std::string_view, 4> taking{"Merge", "Include", "Open", "ShapeFromFile"};
      if (!member && std::ranges::find(taking, word) != taking.end()) read_name(word, found);
    }
    return found;
  }

 private:
  bool starts(std::string_view what) const { return text_.compare(at_, what.size(), what) == 0; }
  void skip_past(std::string_view what) {
    const size_t end = text_.find(what, at_);
    at_ = end == std::string::npos ? text_.size() : end + what.size();
  }
  bool skip_comment() {
    const bool line = starts("//");
    if (!line && !starts("/*")) return false;
    skip_past(line ? "\n" : "*/");
    return true;
  }
  bool skip_string() {
    if (text_[at_] != '"') return false;
    ++at_;
    skip_past("\"");
    return true;
  }
  void read_name(const std::string& word, std::vector<std::string>& found) {
    while (at_ < text_.size() &&
           (std::isspace(static_cast<unsigned char>(text_[at_])) != 0 || text_[at_] == '(' || text_[at_] == '{'))
      ++at_;
    if (at_ == text_.size()) return;
    if (text_[at_] == '"') {
      const size_t end = std::min(text_.find('"', at_ + 1), text_.size());
      found.push_back(text_.substr(at_ + 1, end - at_ - 1));
      at_ = std::min(end + 1, text_.size());
    } else if (of_word(text_[at_])) {
      throw InputError(fmt::format(
          "{}:{}: the name after {} is computed, so that it is not known which file belongs to the geometry; "
          "write the name there, or save the mesh as .msh",
          path_, 1 + std::count(text_.begin(), text_.begin() + static_cast<std::ptrdiff_t>(at_), '\n'), word));
    }
  }

  std::string path_, text_;
  size_t at_ = 0;
};

/// Adds what `file` takes in; both as seen from `folder`.
void add_merged(const fs::path& folder, const fs::path& file, std::vector<std::string>& found) {
  if (!file.extension().string().starts_with(".geo")) return;
  for (const std::string& name : GeoText((folder / file).string()).names()) {
    const fs::path taken = (file.parent_path() / name).lexically_normal();
    if (!fs::exists(folder / taken) || std::ranges::find(found, taken.string()) != found.end()) continue;
    check_input_file((folder / taken).string());
    found.push_back(taken.string());
    add_merged(folder, taken, found);
  }
}

}  // namespace

std::vector<std::string> merged_files(const std::string& path) {
  std::vector<std::string> found;
  const fs::path folder = fs::path(path).parent_path();
  add_merged(folder, fs::path(path).filename(), found);
  std::erase(found, fs::path(path).filename().string());
  return found;
}

}  // namespace taut

#pragma once
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

namespace taut {

/// Wrong input, written for the person who can mend it: one sentence that says where, what, what is allowed and
/// what to do. Everything that a user can get wrong throws this; solvers report numbers' troubles as a status.
class InputError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// The candidate that differs from `name` in upper and lower case only, else the one with the smallest edit distance if
/// it is near enough to be a misspelling, else "".
std::string nearest_name(std::string_view name, const std::vector<std::string>& candidates);

/// The same for names that can hardly mean anything else: a third of the letters may differ.
std::string near_name(std::string_view name, const std::vector<std::string>& candidates);

/// " (did you mean 'x'?)" or "", for appending to a message about an unknown name.
std::string did_you_mean(std::string_view name, const std::vector<std::string>& candidates);

/// Without blanks at either end.
std::string_view trimmed(std::string_view text);

/// "a, b, c" for messages that list what is allowed.
std::string join(const std::vector<std::string>& words, std::string_view separator = ", ");

}  // namespace taut

#pragma once
#include <string>
#include <string_view>
#include <vector>

#include "calib/benches/bench.hpp"

namespace taut {

struct Look;

/// A kind of implausible input. A new one is a function beside the others and its row in the table of its source.
struct Implausible {
  std::string_view name;  ///< in a few words
  /// One sentence for each case that it finds: where, what, what it would have to be, how sure.
  std::vector<std::string> (*find)(const Look& look);
};

/// All kinds.
std::vector<Implausible> kinds_of_implausible();

/// What cannot be right with a bench.
struct Finding {
  std::string_view kind;  ///< Implausible::name
  std::string sentence;
};

/// Looks at readings, settings and, where a chain of beams describes the specimen, at what that says of them. Solves
/// nothing else. Clean readings alarm in fewer than one of a hundred files.
std::vector<Finding> implausible(const Bench& bench);

}  // namespace taut

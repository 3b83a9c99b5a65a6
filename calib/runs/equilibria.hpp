#pragma once
#include <string>
#include <vector>

#include "calib/benches/bench.hpp"
#include "sim/core/numbers.hpp"

namespace taut {

/// Lines of a bench's file whose rows have two equilibria, or are near where one ends.
struct EquilibriaRecord {
  std::vector<int> lines;
  /// "path": the readings agree with the equilibrium of loads that grow from rest; "other": with another one, in which
  /// they are predicted; "undecided"; "": none was found beside it, or nothing was read there.
  std::string decided;
  double jump = not_a_number;  ///< Alternative::jump
  std::string text;            ///< a sentence for people, with controls, values and what to do

  bool has_to_be_said() const;  ///< not where all is well: the readings decided for the path, and no jump is near
};

/// What is said of a bench's alternatives, which its `measurements` may decide; rows in `followed` are predicted in the
/// other equilibrium.
std::vector<EquilibriaRecord> equilibria_of(const Bench& bench, const std::vector<Alternative>& alternatives,
                                            const std::vector<Measurement>& measurements,
                                            const std::vector<int>& followed);

/// What a row's place in a table says: "near a fold", "two", "two; undecided", "the other of two"; "": nothing.
std::string mark_of(const EquilibriaRecord& record);

}  // namespace taut

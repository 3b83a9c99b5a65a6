#pragma once
#include <compare>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <string_view>

#include "sim/core/units.hpp"

namespace taut {

/// What may stand at a key of a table.
struct KeyForm {
  /// The kinds of values that readers ask for.
  enum Kind {
    text,
    number,    ///< a plain one
    integer,   ///< at least `least`
    boolean,   ///< true or false
    quantity,  ///< "30 mm"; pure ones plain or in per cent
    given,     ///< a number, or a text with a unit that only the model knows
    column,    ///< a name, or a number from 1
    table,     ///< [key]
    tables     ///< [[key]]
  };
  Kind kind = text;
  Quantity of = Quantity::pure;                      ///< of a quantity
  bool list = false;                                 ///< a list of such
  size_t count = 0;                                  ///< entries of the list; 0: any number
  int least = 0;                                     ///< of integers
  auto operator<=>(const KeyForm&) const = default;  ///< in the order of the members
};

struct KeyTable;

/// A key of a table: all that readers asked for at it.
struct KeyUse {
  std::set<KeyForm> forms;
  std::set<std::string> words;      ///< the texts that are allowed; empty: any
  std::unique_ptr<KeyTable> table;  ///< the keys of the table or tables that stand there; null: no reader looked
};

/// The keys that readers of a table know. They note it while they read (KeyNotes), whether the key is there or not: so
/// the language of files has no second description that could differ from what is read.
struct KeyTable {
  std::map<std::string, KeyUse> keys;
  std::unique_ptr<KeyUse> id;  ///< of keys that are ids of the file's own; null: there are none
};

/// While it lives, files that this thread opens note in `root` what their readers ask for.
class KeyNotes {
 public:
  /// `root` outlives it.
  explicit KeyNotes(KeyTable& root) : before_(current()) { current() = &root; }
  ~KeyNotes() { current() = before_; }
  KeyNotes(const KeyNotes&) = delete;
  KeyNotes& operator=(const KeyNotes&) = delete;
  static KeyTable* now() { return current(); }  ///< null: nothing is noted

 private:
  static KeyTable*& current();
  KeyTable* before_;
};

}  // namespace taut

#pragma once
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "sim/core/units.hpp"

namespace taut {

class TableReader;
struct KeyTable;

/// What stands behind "+-" in a value, "17.0 mm +- 0.1 mm" or "17.0 mm +- 0.6 %": within that of it the true value lies
/// (95 %).
struct Tolerance {
  double half_width = 0;  ///< in the SI unit of the value, > 0
  std::string where;      ///< "file:line: [table] key", as messages begin
};
/// By their places, "geometry.gap_total", of lists "geometry.size.1", in arrays of tables "marker.ID.s".
using Tolerances = std::map<std::string, Tolerance>;

/// A parsed TOML file. Readers of its tables are valid as long as it lives.
class TomlFile {
 public:
  /// Throws InputError naming the path, and the line of what is not TOML.
  explicit TomlFile(const std::string& path);
  /// The same of a text; `path` is what messages call it, and what paths in it are beside.
  TomlFile(const std::string& path, std::string_view text);
  ~TomlFile();
  TableReader root() const;              ///< the top of the file
  bool has(std::string_view key) const;  ///< at the top
  /// The text at `key` of the table called `table`; "" when there is none. For asking what kind of file it is.
  std::string text_at(std::string_view table, std::string_view key) const;
  const std::string& remark() const { return remark_; }  ///< on bytes that are not UTF-8; "": there are none
  /// Of all values that were read so far. Whoever reads a file says which of them mean something.
  const Tolerances& tolerances() const { return *tolerances_; }

 private:
  std::string path_, remark_;
  std::shared_ptr<const void> document_;
  std::shared_ptr<Tolerances> tolerances_ = std::make_shared<Tolerances>();
};

/// Reads one table of an experiment file. Every key that is asked for is known; finish() refuses all others with their
/// line and the nearest known name, so a misspelt key is never silently a default. All functions throw InputError
/// "file:line: [table] key: what is wrong, what is allowed".
class TableReader {
 public:
  bool has(std::string_view key);                                ///< the table has this key
  std::string text(std::string_view key);                        ///< required
  std::string text(std::string_view key, std::string fallback);  ///< with a default
  /// A text that must be one of `allowed`; the first is the fallback.
  std::string choice(std::string_view key, const std::vector<std::string>& allowed);
  /// The same where each text stands for a value.
  template <class Value>
  Value choice(std::string_view key, const std::vector<std::pair<std::string, Value>>& allowed) {
    std::vector<std::string> names;
    for (const auto& [name, value] : allowed) names.push_back(name);
    const std::string chosen = choice(key, names);
    size_t k = 0;
    while (names[k] != chosen) ++k;
    return allowed[k].second;
  }
  double number(std::string_view key);                                                         ///< required
  int integer(std::string_view key, int fallback, int smallest, int largest = 1'000'000'000);  ///< at least `smallest`
  bool boolean(std::string_view key, bool fallback);                                           ///< true or false
  /// "30 mm" as 0.030; a plain number only where the quantity is pure. A tolerance behind it goes to the file's.
  double quantity(std::string_view key, Quantity quantity);
  /// A number or a text with a unit, as it stands: for values whose quantity is only known later.
  std::optional<GivenValue> optional_given(std::string_view key);
  std::optional<double> optional_quantity(std::string_view key, Quantity quantity);  ///< nothing when it is not there
  /// The same of what has to be larger than zero; `what` says what it is.
  double positive(std::string_view key, Quantity quantity, std::string_view what);
  /// Nothing when it is not there.
  std::optional<double> optional_positive(std::string_view key, Quantity quantity, std::string_view what);
  /// ["100 mm", "30 mm"]; `count` entries unless it is 0.
  std::vector<double> quantities(std::string_view key, Quantity quantity, size_t count);
  std::vector<double> numbers(std::string_view key, size_t count);  ///< [0, 0, -1]
  std::vector<std::string> texts(std::string_view key);             ///< required, at least one
  std::vector<std::string> texts_or_none(std::string_view key);     ///< none when it is not there
  /// Names of columns, or their numbers from 1 as "#3"; none when it is not there.
  std::vector<std::string> columns_or_none(std::string_view key);
  /// [40, 41], each at least `smallest`; none when it is not there.
  std::vector<int> integers_or_none(std::string_view key, int smallest);
  /// A sub-table; required.
  TableReader table(std::string_view key);
  /// A sub-table or an empty one.
  std::optional<TableReader> optional_table(std::string_view key);
  /// All sub-tables of a table of tables ([materials.foam], [materials.plastic]): name and reader; none when it is not
  /// there.
  std::vector<std::pair<std::string, TableReader>> named_tables(std::string_view key);
  /// An array of tables ([[load]], [[load]]); none when it is not there.
  std::vector<TableReader> tables(std::string_view key);
  /// Says that all keys asked for from now on are ids of the file's own (loads, channels), not words of its language.
  void keys_are_ids();

  /// Throws for the first key that nobody asked for.
  void finish();
  /// Throws for a key that is almost one that was asked for and is not there: what a later fault may follow from.
  void refuse_misspelt() const;
  /// An InputError at `key` (or at the table when it is empty), to be thrown by the caller for its own checks. Where
  /// the table has a misspelt key that the fault follows from, that is said instead.
  [[noreturn]] void fail(std::string_view key, const std::string& what) const;
  std::string where(std::string_view key) const;  ///< "file:line: [table] key", as messages begin

 private:
  friend class TomlFile;
  struct Nodes;  ///< what needs the TOML library, in the source file
  TableReader(const void* table, std::string file, std::string name, std::shared_ptr<Tolerances> tolerances,
              KeyTable* keys)
      : table_(table),
        file_(std::move(file)),
        name_(std::move(name)),
        place_(name_),
        tolerances_(std::move(tolerances)),
        keys_(keys) {}

  const void* table_;  ///< a toml::table
  std::string file_, name_;
  std::string place_;  ///< of tolerances: the name, in arrays of tables with the id or, where there is none, the number
  std::shared_ptr<Tolerances> tolerances_;
  KeyTable* keys_;    ///< where what is asked for is noted (key_table.hpp); null: nowhere
  bool ids_ = false;  ///< see keys_are_ids()
  std::vector<std::string> asked_;
};

}  // namespace taut

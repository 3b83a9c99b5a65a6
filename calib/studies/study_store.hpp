#pragma once
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

namespace taut {

using Cells = std::vector<std::string>;  ///< a line of a table
/// It as CSV, without its end; cells may hold commas and quotes, and ends of lines become spaces.
std::string csv_line(const Cells& cells);
/// What csv_line() was given; empty: a quotation that does not end.
Cells csv_cells(const std::string& line);

/// Stands for the contents of the files that a result is made from. Throws InputError for one that cannot be read.
std::string fingerprint_of(const std::vector<std::string>& files);

/// CRC-32 (IEEE 802.3) of a text.
std::uint32_t crc32_of(std::string_view text);

/// Finished results in a CSV file, one line each, on the disk as soon as add() is back: an interruption at any moment
/// loses no line that was finished. The last column, "check", is the CRC-32 of what stands before it on the line: a
/// line that is not whole, or was changed, is passed over. Tables that were begun before there were checksums go on
/// without; in them only a last line without its end is passed over. Lines with another fingerprint, and what is no
/// line of this table, are left alone and not used.
///
/// Processes that work on one study write a file each, so that no two append to one: "name.WRITER.csv" beside
/// "name.csv". All that are there are read.
class StudyStore {
 public:
  /// `columns` are the file's, "fingerprint" among them; the first `keys` of the others together name a result.
  /// `writer` names this process among several; "": it is the only one. Throws InputError for a file that cannot be
  /// read or holds another table.
  StudyStore(const std::string& path, Cells columns, size_t keys, std::string fingerprint,
             const std::string& writer = "");
  /// What stands in the columns after the key; nullptr: nothing yet.
  const Cells* find(const Cells& key) const;
  /// Throws InputError when the file cannot be written.
  void add(const Cells& key, const Cells& result);

 private:
  std::string header_line(bool checked) const;
  bool read(const std::string& path);
  void remember(const std::string& text, bool checked);
  std::string path_;  ///< of the file that this process writes
  Cells columns_;
  size_t keys_;
  std::string fingerprint_;
  bool checked_ = true;  ///< whether the lines of that file have checksums
  std::map<Cells, Cells> results_;
};

/// Raises a flag after some seconds, or when another one is raised.
class Deadline {
 public:
  /// After `seconds`, or as soon as `stop` (null: none) is raised.
  Deadline(double seconds, const std::atomic<bool>* stop);

  const std::atomic<bool>& flag() const { return raised_; }  ///< the flag, for solvers to watch
  bool late() const { return late_; }                        ///< raised because the seconds are over
  double seconds() const { return seconds_; }                ///< as they were given

 private:
  double seconds_;
  std::atomic<bool> raised_{false}, late_{false};
  std::jthread thread_;  ///< the last one: it works on the others
};

/// One of the runs of a study.
struct StudySetting {
  Cells key;                ///< names it in the store
  std::string description;  ///< for people
  double cost = 0;          ///< a guess, in any unit: what would not fit into the rest of the budget is not begun
  bool may_hang = false;    ///< is given a tenth of the budget, whatever the guess
};

/// What a setting came to, as it stands in the store.
struct StudyResult {
  Cells cells;
  double seconds = 0;  ///< that tell what a unit of cost takes; 0: they do not
};

/// Settings, how to run one, and the table that their results stand in.
struct Study {
  Cells columns;
  size_t keys = 1;
  std::vector<StudySetting> settings;  ///< in the order in which they are run
  size_t least = 0;                    ///< so many are run however small the budget is
  /// A setting's result; nothing when it was interrupted. May go on when the flag is raised.
  std::function<std::optional<StudyResult>(size_t setting, const Deadline& deadline)> run;
  /// Is handed each result once, from the store or just made; false: these cells are none, and it is run again.
  std::function<bool(size_t setting, const Cells& cells)> take;
};

/// The part of a study that a process runs by itself: settings whose number leaves this rest.
struct Shard {
  size_t index = 0, count = 1;

  /// Whether it runs this one.
  bool has(size_t setting) const { return setting % count == index; }
};

class Messages;

/// What a study may take, and where it keeps its results.
struct StudyOptions {
  double budget = 300;      ///< [s] for new runs
  std::string file;         ///< of the store
  std::string fingerprint;  ///< of all that the results are made from
  const std::atomic<bool>* stop = nullptr;
  /// Told before each run: what it is, how many of how many are done.
  std::function<void(const std::string& what, size_t done, size_t all)> progress;
  Shard shard = {};  ///< of several processes that know nothing of each other
  /// Whether what this process runs is a part that another one sums up.
  bool is_part() const;
  Messages* messages = nullptr;  ///< to and from the processes that this one works with (crew.hpp); null: none
};

/// Takes what the store has, then runs the rest (of its shard) in order until the budget is used up or `stop` was
/// raised. With messages the process of rank 0 hands the settings out and takes all results; the others run them, each
/// into its own file of the store, and take none.
void run_study(const Study& study, const StudyOptions& options);

}  // namespace taut

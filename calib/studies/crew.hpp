#pragma once
#include <optional>
#include <string>
#include <vector>

#include "calib/studies/study_store.hpp"

// Processes that work on one study: rank 0 hands the settings out, one at a time to whoever is free, the others run
// them. What a process that dies had begun, and what fails, is tried once more elsewhere. How messages travel is
// somebody else's business: MPI's (experiments/cli), or that of threads in tests.
namespace taut {

/// What one process hears from another.
struct Message {
  int from = 0;  ///< rank
  std::string text;
};

/// Messages among processes of ranks 0 to size() - 1. May be used by two threads at the same time.
class Messages {
 public:
  virtual ~Messages() = default;
  virtual int rank() const = 0;                                ///< of this process
  virtual int size() const = 0;                                ///< how many there are
  virtual void send(int to, const std::string& text) = 0;      ///< returns at once, whatever became of the receiver
  virtual std::optional<Message> receive(double seconds) = 0;  ///< the next one, if it comes within that time
  virtual double silence() const { return 60; }                ///< [s] after which a process counts as dead
};

/// Rank 0: has the others run `settings` of the study, the dearest first unless there is a budget, takes their results,
/// and tells them that it is over. Settings that failed twice, or whose second process died too, stay without a result.
/// Throws InputError when nobody is left to work.
void hand_out(Messages& messages, const Study& study, const StudyOptions& options, const std::vector<size_t>& settings);

/// The other ranks: runs what rank 0 says until it is over, and says every few seconds that it lives. What a setting
/// throws costs that setting.
void work_for(Messages& messages, const Study& study, const StudyOptions& options);

}  // namespace taut

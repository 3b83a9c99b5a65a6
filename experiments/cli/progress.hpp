#pragma once
#include <condition_variable>
#include <mutex>
#include <string>
#include <thread>

#include "sim/core/stopwatch.hpp"

namespace taut {

/// Progress on stderr, nothing when quiet. On a terminal a state is one line that the next one replaces; elsewhere it
/// is told with the time since the start every five seconds, and one that does not change every thirty.
class Progress {
 public:
  explicit Progress(bool quiet);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  /// A step that stays.
  void say(const std::string& line);
  /// A state that the next one replaces.
  void show(const std::string& line);

 private:
  void clear();
  void tell_now_and_then(const std::stop_token& ended);

  bool quiet_, terminal_, shown_ = false;
  Stopwatch watch_;
  std::mutex mutex_;
  std::condition_variable_any waiting_;
  std::string state_, told_;  ///< what is so, and what was said of it last
  int unchanged_ = 0;         ///< times at which they were the same
  std::jthread teller_;       ///< off a terminal; the last member, so that it ends before what it uses
};

}  // namespace taut

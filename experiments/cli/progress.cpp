#include "experiments/cli/progress.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>

namespace taut {

Progress::Progress(bool quiet) : quiet_(quiet), terminal_(isatty(STDERR_FILENO) != 0) {
  if (!quiet_ && !terminal_) teller_ = std::jthread([this](const std::stop_token& ended) { tell_now_and_then(ended); });
}

Progress::~Progress() {
  clear();
}

void Progress::clear() {
  if (shown_) std::fputs("\r\033[K", stderr);
  shown_ = false;
}

void Progress::say(const std::string& line) {
  if (quiet_) return;
  const std::lock_guard lock(mutex_);
  clear();
  fmt::print(stderr, "{}\n", line);
  state_ = told_ = line;
  unchanged_ = 0;
}

void Progress::show(const std::string& line) {
  if (quiet_) return;
  const std::lock_guard lock(mutex_);
  state_ = line;
  if (!terminal_) return;
  fmt::print(stderr, "\r\033[K{}", line.substr(0, 150));
  std::fflush(stderr);
  shown_ = true;
}

void Progress::tell_now_and_then(const std::stop_token& ended) {
  constexpr std::chrono::seconds often(5);
  constexpr int seldom = 6;  // of these
  std::unique_lock lock(mutex_);
  while (!waiting_.wait_for(lock, ended, often, [&] { return ended.stop_requested(); })) {
    if (state_.empty() || (state_ == told_ && ++unchanged_ % seldom != 0)) continue;
    if (state_ != told_) unchanged_ = 0;
    told_ = state_;
    try {
      fmt::print(stderr, "{} ({:.0f} s)\n", told_, watch_.seconds());
    } catch (const std::system_error&) {  // stderr takes no more, which is no reason to end a run
      return;
    }
  }
}

}  // namespace taut

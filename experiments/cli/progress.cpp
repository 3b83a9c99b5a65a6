#include "experiments/cli/progress.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <cstdio>
#include <filesystem>

namespace taut {
namespace {

namespace fs = std::filesystem;

}  // namespace

Progress::Progress(bool quiet) : quiet_(quiet), terminal_(isatty(STDERR_FILENO) != 0) {}
Progress::~Progress() {
  clear();
}

void Progress::clear() {
  if (shown_) std::fputs("\r\033[K", stderr);
  shown_ = false;
}

void Progress::say(const std::string& line) {
  if (quiet_) return;
  clear();
  fmt::print(stderr, "{}\n", line);
}

void Progress::show(const std::string& line) {
  if (quiet_ || !terminal_) return;
  fmt::print(stderr, "\r\033[K{}", line.substr(0, 150));
  std::fflush(stderr);
  shown_ = true;
}

std::string experiment_name(const std::string& path) {
  const fs::path file = fs::absolute(path);
  const std::string stem = file.stem().string();
  return stem == "experiment" ? file.parent_path().filename().string() : stem;
}

std::string run_folder(const CommandOptions& options) {
  return options.out.empty() ? (fs::path("runs") / experiment_name(options.target)).string() : options.out;
}

bool interrupted(const CommandOptions& options) {
  return options.stop != nullptr && options.stop->load();
}

}  // namespace taut

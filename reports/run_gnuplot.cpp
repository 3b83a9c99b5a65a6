#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/statvfs.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <filesystem>

#include "reports/gnuplot.hpp"
#include "sim/core/error.hpp"

namespace taut::plot {
namespace {

using Clock = std::chrono::steady_clock;

/// What came of a program.
struct ProgramEnd {
  enum Kind { ended, missing, too_slow, not_started } kind = ended;
  bool right = false;  ///< exit code 0
  std::string output;
};

/// After fork(): nothing here may allocate.
[[noreturn]] void become_gnuplot(pid_t parent, const char* folder, const char* script, int output) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);  // it ends with us, however that is
  if (getppid() != parent) _exit(126);
  setpgid(0, 0);  // Ctrl-C is for us; a figure that is begun is finished
  for (int signal : {SIGINT, SIGTERM, SIGHUP, SIGPIPE}) std::signal(signal, SIG_DFL);
  const int nothing = open("/dev/null", O_RDONLY);
  if (chdir(folder) != 0 || dup2(nothing, STDIN_FILENO) < 0 || dup2(output, STDOUT_FILENO) < 0 ||
      dup2(output, STDERR_FILENO) < 0)
    _exit(126);
  execlp("gnuplot", "gnuplot", "-d", script, static_cast<char*>(nullptr));
  _exit(errno == ENOENT || errno == ENOTDIR || errno == EACCES ? 127 : 126);
}

/// Takes what is written until all ends are closed, or the time is over.
bool read_until(int pipe, Clock::time_point end, std::string& output) {
  std::array<char, 4096> block{};
  while (true) {
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(end - Clock::now()).count();
    if (left <= 0) return false;
    pollfd one{pipe, POLLIN, 0};
    const int ready = poll(&one, 1, static_cast<int>(std::min<long>(left, 1000)));
    if (ready == 0 || (ready < 0 && errno == EINTR)) continue;
    const ssize_t n = read(pipe, block.data(), block.size());
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return true;
    if (output.size() < 100'000) output.append(block.data(), static_cast<size_t>(n));
  }
}

ProgramEnd draw_once(const std::string& folder, const std::string& script, double patience) {
  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0) return {ProgramEnd::not_started, false, ""};
  const pid_t parent = getpid(), child = fork();
  if (child == 0) become_gnuplot(parent, folder.c_str(), script.c_str(), ends[1]);
  close(ends[1]);
  if (child < 0) {
    close(ends[0]);
    return {ProgramEnd::not_started, false, ""};
  }
  ProgramEnd end;
  const auto limit = Clock::now() + std::chrono::milliseconds(static_cast<long>(1e3 * patience));
  const bool in_time = read_until(ends[0], limit, end.output);
  close(ends[0]);
  if (!in_time) kill(-child, SIGKILL);  // what it started as well
  if (!in_time) kill(child, SIGKILL);   // before it had a group of its own
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  if (!in_time)
    end.kind = ProgramEnd::too_slow;
  else if (WIFEXITED(status) && WEXITSTATUS(status) == 127)
    end.kind = ProgramEnd::missing;
  end.right = WIFEXITED(status) && WEXITSTATUS(status) == 0;
  return end;
}

bool all_drawn(const std::string& folder, const std::string& name) {
  for (const char* format : {".svg", ".pdf", ".png"}) {
    std::error_code error;
    const auto size = std::filesystem::file_size(std::filesystem::path(folder) / (name + format), error);
    if (error || size == 0) return false;
  }
  return true;
}

/// gnuplot's own sentence is the line that names the script.
std::string sentence_of(const std::string& output) {
  const size_t at = output.find(".gp\" line");
  if (at != std::string::npos) {
    const size_t begin = output.rfind('\n', at) == std::string::npos ? 0 : output.rfind('\n', at) + 1;
    return output.substr(begin, output.find('\n', at) - begin);
  }
  return output.empty() ? "no message" : output.substr(0, output.find('\n'));
}

/// It did not end last time: the figures that follow do not wait as long for it.
std::atomic<bool> was_too_slow{false};
constexpr double short_patience = 5;  // [s]

bool disk_is_full(const std::string& folder) {
  struct statvfs disk {};
  return statvfs(folder.c_str(), &disk) == 0 && (disk.f_bavail == 0 || (disk.f_files > 0 && disk.f_favail == 0));
}

}  // namespace

double gnuplot_patience() {
  double seconds = 120;
  if (const char* given = std::getenv("TAUT_GNUPLOT_TIMEOUT")) {
    const auto [end, error] = std::from_chars(given, given + std::strlen(given), seconds);
    if (error != std::errc{} || *end != '\0' || !(seconds > 0 && seconds <= 1e6))
      throw InputError(fmt::format("TAUT_GNUPLOT_TIMEOUT is '{}'; a number of seconds up to 1e6 belongs there", given));
  }
  return seconds;
}

void run_gnuplot(const std::string& folder, const std::string& name, double patience) {
  const std::string script = (std::filesystem::path(folder) / (name + ".gp")).string();
  const bool impatient = was_too_slow;
  ProgramEnd end;
  for (int attempt = 0; attempt < 2; ++attempt) {
    end = draw_once(folder, name + ".gp", impatient ? std::min(patience, short_patience) : patience);
    was_too_slow = end.kind == ProgramEnd::too_slow;
    if (end.kind == ProgramEnd::ended && end.right && all_drawn(folder, name)) return;
    if (end.kind == ProgramEnd::missing || (impatient && was_too_slow)) break;
  }
  if (end.kind == ProgramEnd::ended && disk_is_full(folder))
    throw InputError(fmt::format("{}: gnuplot cannot write ({}); make room and run 'taut report' on the run folder",
                                 folder, std::strerror(ENOSPC)));
  switch (end.kind) {
    case ProgramEnd::missing:
      throw InputError(
          "gnuplot was not found, and it draws the figures; install it (Debian and Ubuntu: apt-get install "
          "gnuplot-nox) and run 'taut report' on the run folder, the result itself is safe");
    case ProgramEnd::not_started:
      throw InputError(
          fmt::format("{}: gnuplot could not be started; free some memory and run 'taut report' on the run "
                      "folder",
                      script));
    case ProgramEnd::too_slow:
      throw InputError(
          fmt::format("{}: gnuplot did not end within {:g} s, twice; see whether it runs by itself, then "
                      "run 'taut report' on the run folder (TAUT_GNUPLOT_TIMEOUT is how many seconds it has)",
                      script, patience));
    default:
      throw InputError(
          fmt::format("{}: gnuplot failed ({}); it needs its svg, pdfcairo and pngcairo terminals (Debian and Ubuntu: "
                      "apt-get install gnuplot-nox), then run 'taut report' on the run folder",
                      script, shortened(sentence_of(end.output), 160)));
  }
}

}  // namespace taut::plot

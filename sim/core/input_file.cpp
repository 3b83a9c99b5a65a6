#include "sim/core/input_file.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/magic.h>
#include <sys/stat.h>
#include <sys/vfs.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "sim/core/error.hpp"
#include "sim/core/memory_budget.hpp"

namespace taut {
namespace {

[[noreturn]] void refuse_file(const std::string& path, const std::string& what) {
  throw InputError(path + ": " + what);
}

const char* kind_of(mode_t mode) {
  if (S_ISDIR(mode)) return "a folder";
  if (S_ISFIFO(mode)) return "a pipe";
  if (S_ISSOCK(mode)) return "a socket";
  return "a device";
}

void check_size_of(const std::string& path, double size, double most) {
  if (size > most)
    refuse_file(path, fmt::format("holds {} or more, and at most {} can be read; name another file", in_bytes(size),
                                  in_bytes(most)));
}

/// An open file that is an ordinary one.
class InputHandle {
 public:
  InputHandle(const std::string& path, double most) {
    struct stat state {};
    // A pipe that nobody writes to would be waited for; some devices do something when they are opened.
    if (stat(path.c_str(), &state) == 0 && !S_ISREG(state.st_mode))
      refuse_file(path,
                  fmt::format("is {}, a file is needed; {}", kind_of(state.st_mode),
                              S_ISDIR(state.st_mode) ? "name a file in it" : "save what it gives in a file first"));
    handle_ = open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (handle_ < 0) refuse_file(path, fmt::format("cannot be read ({}); check the path", std::strerror(errno)));
    struct statfs system {};
    const bool is_made_up =
        fstatfs(handle_, &system) == 0 && (system.f_type == PROC_SUPER_MAGIC || system.f_type == SYSFS_MAGIC);
    if (fstat(handle_, &state) != 0 || !S_ISREG(state.st_mode) || is_made_up) {
      close(handle_);
      refuse_file(path, "is no file on a disk but something that the system makes up; name a file");
    }
    try {
      check_size_of(path, static_cast<double>(state.st_size), most);
    } catch (...) {
      close(handle_);
      throw;
    }
  }
  ~InputHandle() { close(handle_); }
  InputHandle(const InputHandle&) = delete;
  InputHandle& operator=(const InputHandle&) = delete;
  int get() const { return handle_; }

 private:
  int handle_ = -1;
};

}  // namespace

void check_input_file(const std::string& path, double most) {
  const InputHandle file(path, most);
}

std::string read_input_file(const std::string& path, double most) {
  const InputHandle file(path, most);
  std::string text;
  char block[1 << 16];
  while (true) {
    const ssize_t n = read(file.get(), block, sizeof block);
    if (n == 0) return text;
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) refuse_file(path, fmt::format("reading failed half-way ({}); check the disk", std::strerror(errno)));
    text.append(block, static_cast<size_t>(n));
    check_size_of(path, static_cast<double>(text.size()), most);
  }
}

}  // namespace taut

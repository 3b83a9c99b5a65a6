#include "sim/core/memory_budget.hpp"

#include <fmt/format.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <fstream>
#include <limits>
#include <sstream>

#include "sim/core/error.hpp"

namespace taut {
namespace {

constexpr double unlimited = std::numeric_limits<double>::infinity();

/// The number that a file of the kernel's holds; "max", and no such file, are no limit.
double number_in(const std::string& path) {
  std::ifstream file(path);
  double value = unlimited;
  return file >> value ? value : unlimited;
}

/// What the machine can still give without swapping.
double left_of_machine() {
  std::ifstream file("/proc/meminfo");
  for (std::string line; std::getline(file, line);) {
    if (!line.starts_with("MemAvailable:")) continue;
    double kilobytes = unlimited;
    std::istringstream(line.substr(line.find(':') + 1)) >> kilobytes;
    return 1024 * kilobytes;
  }
  return unlimited;
}

/// What `ulimit -v` leaves.
double left_of_address_space() {
  rlimit limit{};
  if (getrlimit(RLIMIT_AS, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY) return unlimited;
  const double pages = number_in("/proc/self/statm");
  const double taken = pages == unlimited ? 0 : pages * static_cast<double>(sysconf(_SC_PAGESIZE));
  return std::max(0.0, static_cast<double>(limit.rlim_cur) - taken);
}

/// The same of a control group and all above it: `limit` and `taken` are the files that say so in each.
double left_of_groups(const std::string& root, std::string group, const char* limit, const char* taken) {
  double left = unlimited;
  while (true) {
    const double most = number_in(root + group + "/" + limit), now = number_in(root + group + "/" + taken);
    if (most < unlimited && now < unlimited) left = std::min(left, std::max(0.0, most - now));
    if (group.empty() || group == "/") return left;
    group.resize(group.rfind('/') == std::string::npos ? 0 : group.rfind('/'));
  }
}

/// Lines "0::/path" are of the second kind of control groups, "4:memory:/path" of the first.
double left_of_control_groups() {
  double left = unlimited;
  std::ifstream file("/proc/self/cgroup");
  for (std::string line; std::getline(file, line);) {
    const size_t first = line.find(':'), second = line.find(':', first + 1);
    if (second == std::string::npos) continue;
    const std::string kinds = line.substr(first + 1, second - first - 1), group = line.substr(second + 1);
    if (kinds.empty())
      left = std::min(left, left_of_groups("/sys/fs/cgroup", group, "memory.max", "memory.current"));
    else if (("," + kinds + ",").find(",memory,") != std::string::npos)
      left = std::min(left,
                      left_of_groups("/sys/fs/cgroup/memory", group, "memory.limit_in_bytes", "memory.usage_in_bytes"));
  }
  return left;
}

}  // namespace

double available_memory() {
  return std::min({left_of_machine(), left_of_address_space(), left_of_control_groups()});
}

std::string in_bytes(double bytes) {
  if (bytes < 1e9) return fmt::format("{:.3g} MB", bytes / 1e6);
  return bytes < 1e15 ? fmt::format("{:.{}f} GB", bytes / 1e9, bytes < 1e10 ? 1 : 0)
                      : fmt::format("{:.1e} GB", bytes / 1e9);
}

void require_memory(double bytes, const std::string& what, const std::string& remedy) {
  const double left = available_memory();
  if (bytes <= 0.9 * left) return;
  throw InputError(
      fmt::format("{} about {} of memory, and {} are free; {}", what, in_bytes(bytes), in_bytes(left), remedy));
}

}  // namespace taut

#include "calib/data/run_folder.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <iterator>
#include <sstream>

#include "calib/data/files.hpp"
#include "sim/core/error.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;

constexpr const char* list_file = ".files";
constexpr const char* publish_file = ".publish";
/// Stands in a folder whose run was interrupted.
constexpr const char* unfinished_file = ".unfinished";
/// What tells the kinds of runs apart.
constexpr const char* fit_file = "fit.json";
constexpr const char* simulation_file = "animation.html";
/// Room on the disk for the list of files, so that a run that fills it can still be published.
constexpr const char* reserve_file = ".reserve";

/// What runs wrote before they kept a list of it.
const std::vector<std::string> before_lists{"fit.json", "predictions.csv", "report.html",  "experiment.toml",
                                            "data.csv", "mesh.msh",        "channels.csv", "animation.html",
                                            "figures",  "states",          "frames"};

std::vector<std::string> lines_of(const fs::path& file) {
  std::vector<std::string> lines;
  std::istringstream text(read_file(file.string()));
  for (std::string line; std::getline(text, line);) {
    const fs::path path(line);  // a list that someone edited must not reach out of its folder
    if (path.is_relative() && std::find(path.begin(), path.end(), "..") == path.end() && !line.empty())
      lines.push_back(line);
  }
  return lines;
}

/// Files below `folder`, relative to it, but for hidden ones of our own at its top.
std::vector<std::string> files_below(const fs::path& folder) {
  std::vector<std::string> files;
  for (const fs::directory_entry& entry : fs::recursive_directory_iterator(folder)) {
    const std::string file = fs::relative(entry.path(), folder).generic_string();
    if (entry.is_regular_file() && file != publish_file && file != list_file && file != reserve_file)
      files.push_back(file);
  }
  std::sort(files.begin(), files.end());
  return files;
}

bool holds_run(const fs::path& folder) {
  return fs::exists(folder / fit_file) || fs::exists(folder / simulation_file);
}

/// What the run that stands in a folder consists of.
std::vector<std::string> published(const fs::path& folder) {
  if (fs::exists(folder / list_file)) return lines_of(folder / list_file);
  return holds_run(folder) ? before_lists : std::vector<std::string>();
}

/// An input of someone's own, with the name of a run's copy of it, in a folder where no run stands; empty: there is
/// none. Results may be those of `taut replay`, which keeps no list.
std::string own_input(const fs::path& folder) {
  if (!published(folder).empty()) return "";
  for (const char* file : {"experiment.toml", "data.csv"})
    if (fs::exists(folder / file)) return file;
  return "";
}

/// Moves what a publish() has left to move. The list of files comes last, so that a kill at any point leaves the rest
/// to the next one.
void roll_forward(const fs::path& folder) {
  const fs::path next = folder / ".next";
  if (!fs::exists(next / publish_file)) return;
  const std::vector<std::string> files = lines_of(next / publish_file);
  const std::vector<std::string> old = published(folder);
  for (const std::string& file : old) {
    if (std::find(files.begin(), files.end(), file) == files.end()) fs::remove_all(folder / file);
  }
  for (const std::string& file : files) {
    if (!fs::exists(next / file)) continue;  // moved before
    fs::create_directories((folder / file).parent_path());
    fs::rename(next / file, folder / file);
  }
  for (const std::string& file : old) {  // folders that have become empty
    std::error_code not_empty;
    if (fs::path(file).has_parent_path()) fs::remove((folder / file).parent_path(), not_empty);
  }
  fs::rename(next / publish_file, folder / list_file);
  fs::remove_all(next);
}

[[noreturn]] void cannot_use(const std::string& path, const std::string& why) {
  throw InputError(fmt::format("{}: the run folder cannot be used ({}); choose another one with --out", path, why));
}

}  // namespace

RunFolder::RunFolder(std::string path, Kind kind) : path_(std::move(path)) {
  std::error_code error;
  made_ = fs::create_directories(path_, error);
  if (error) cannot_use(path_, error.message());
  lock_ = open((fs::path(path_) / ".lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666);
  if (lock_ < 0) cannot_use(path_, std::strerror(errno));
  if (flock(lock_, LOCK_EX | LOCK_NB) != 0) {
    close(lock_);
    throw InputError(fmt::format(
        "{}: another taut is writing its run there; wait until it has ended, or choose another folder with --out",
        path_));
  }
  const bool fits = kind == Kind::fit;
  if (fs::exists(fs::path(path_) / (fits ? simulation_file : fit_file))) {
    close(lock_);
    throw InputError(fmt::format("{}: holds a {}, which a {} would replace; choose another folder with --out", path_,
                                 fits ? "simulation" : "fit", fits ? "fit" : "simulation"));
  }
  try {
    roll_forward(path_);
    if (const std::string file = own_input(path_); !file.empty()) {
      close(lock_);
      throw InputError(fmt::format(
          "{}: holds a file {}, which no run wrote and this one would replace; choose another folder with --out", path_,
          file));
    }
    fs::remove_all(next());
    fs::create_directories(next());
    write_file((fs::path(next()) / reserve_file).string(), std::string(1 << 16, ' '));
  } catch (const fs::filesystem_error& failure) {
    close(lock_);
    cannot_use(path_, failure.code().message());
  }
}

RunFolder::~RunFolder() {
  std::error_code ignored;
  if (!fs::exists(fs::path(next()) / publish_file, ignored)) fs::remove_all(next(), ignored);
  const auto left = std::distance(fs::directory_iterator(path_, ignored), fs::directory_iterator());
  if (made_ && left == 1) fs::remove_all(path_, ignored);  // the lock alone: a run that came to nothing
  close(lock_);
}

std::string RunFolder::next() const {
  return (fs::path(path_) / ".next").string();
}

std::string RunFolder::resume() const {
  return (fs::path(path_) / ".resume").string();
}

bool RunFolder::finished() const {
  return holds_run(path_) && !fs::exists(fs::path(path_) / unfinished_file);
}

void RunFolder::mark_unfinished() const {
  write_file((fs::path(next()) / unfinished_file).string(), "");
}

void RunFolder::publish(Publish what) {
  std::vector<std::string> files = files_below(next());
  if (what == Publish::part) {
    const std::vector<std::string> old = published(path_);
    files.insert(files.end(), old.begin(), old.end());
    std::sort(files.begin(), files.end());
    files.erase(std::unique(files.begin(), files.end()), files.end());
  }
  std::error_code ignored;
  fs::remove(fs::path(next()) / reserve_file, ignored);
  write_file((fs::path(next()) / publish_file).string(), join(files, "\n") + "\n");
  try {
    roll_forward(path_);
    fs::create_directories(next());
  } catch (const fs::filesystem_error& failure) {
    throw InputError(
        fmt::format("{}: the new run could not take its place ({}); the next command on this folder "
                    "finishes that",
                    path_, failure.code().message()));
  }
}

void RunFolder::forget_resume() {
  std::error_code ignored;
  fs::remove_all(resume(), ignored);
}

void settle_run_folder(const std::string& path) {
  const fs::path folder(path);
  if (fs::exists(folder / ".next" / publish_file)) RunFolder settled(path);
  if (fs::exists(folder / fit_file) || !fs::exists(folder / ".resume")) return;
  const int lock = open((folder / ".lock").c_str(), O_RDONLY | O_CLOEXEC);
  const bool at_work = lock >= 0 && flock(lock, LOCK_SH | LOCK_NB) != 0;
  if (lock >= 0) close(lock);
  if (at_work) throw InputError(fmt::format("{}: the fit there is still running; wait until it has ended", path));
  throw InputError(fmt::format(
      "{}: the fit here was interrupted before it had a result; run `taut fit` on its experiment again, it goes on "
      "where it stopped",
      path));
}

}  // namespace taut

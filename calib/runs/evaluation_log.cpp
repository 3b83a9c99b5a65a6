#include "calib/runs/evaluation_log.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <filesystem>

#include "calib/data/files.hpp"
#include "calib/fit/bytes.hpp"
#include "sim/core/error.hpp"
#include "sim/core/numbers.hpp"
#include "sim/core/stopwatch.hpp"

namespace taut {
namespace {

namespace fs = std::filesystem;

constexpr const char* log_file = "evaluations";

/// FNV-1a: enough to tell a torn record from a whole one.
uint64_t checksum(std::string_view bytes) {
  uint64_t sum = 1469598103934665603ULL;
  for (unsigned char byte : bytes) sum = (sum ^ byte) * 1099511628211ULL;
  return sum;
}

/// A length, the bytes, their checksum.
std::string framed(const std::string& bytes) {
  return Bytes()(bytes, checksum(bytes)).bytes();
}

/// The next framed bytes; nullopt where they are torn.
std::optional<std::string> unframed(Bytes& in) {
  std::string bytes;
  uint64_t sum = 0;
  try {
    in(bytes, sum);
  } catch (const std::runtime_error&) {  // the file ends within it
  }
  return sum == checksum(bytes) ? std::optional(bytes) : std::nullopt;
}

/// A call as it stands in the file: puts it, or takes it.
Bytes& walk(Bytes&& bytes, auto& section, auto& call, auto& entry) {
  auto& [values, derivatives, failures] = entry.prediction;
  return bytes(section, call, entry.p, entry.free, values, derivatives, failures, entry.factorisations, entry.fresh);
}

}  // namespace

EvaluationLog::EvaluationLog(std::string folder, const std::string& fingerprint) : folder_(std::move(folder)) {
  std::error_code error;
  fs::create_directories(folder_, error);
  read(fingerprint);
  const std::string path = (fs::path(folder_) / log_file).string();
  file_ = open(path.c_str(), O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC, 0666);
  if (file_ < 0)
    throw InputError(fmt::format("{}: cannot be written ({}); choose a folder that you may write to with --out", path,
                                 std::strerror(errno)));
}

EvaluationLog::~EvaluationLog() {
  if (file_ >= 0) close(file_);
  std::error_code ignored;
  if (known_ == 0 && added_ == 0) fs::remove_all(folder_, ignored);  // nothing to go on with
}

/// What an earlier run left, or an empty log where that belongs to something else. A torn end is cut off.
void EvaluationLog::read(const std::string& fingerprint) {
  const std::string path = (fs::path(folder_) / log_file).string();
  const std::string head = framed(fingerprint);
  const std::string text = fs::exists(path) ? read_file(path) : "";
  if (!text.starts_with(head)) {
    discarded_ = !text.empty();
    std::error_code ignored;
    for (const fs::directory_entry& entry : fs::directory_iterator(folder_, ignored)) fs::remove(entry.path(), ignored);
    write_file(path, head);
    return;
  }
  Bytes in(std::string_view(text).substr(head.size()));
  size_t whole = head.size();
  while (!in.at_end()) {
    const std::optional<std::string> bytes = unframed(in);
    if (!bytes) break;
    whole += framed(*bytes).size();
    std::string section;
    size_t call = 0;
    Entry entry;
    walk(Bytes(*bytes), section, call, entry);
    std::vector<Entry>& calls = entries_[section];
    if (call > calls.size()) continue;
    calls.resize(call);
    calls.push_back(std::move(entry));
  }
  if (whole < text.size()) fs::resize_file(path, whole);
  for (const auto& [section, calls] : entries_) known_ += calls.size();
}

const EvaluationLog::Entry* EvaluationLog::find(const std::string& section, size_t call) const {
  const auto found = entries_.find(section);
  return found == entries_.end() || call >= found->second.size() ? nullptr : &found->second[call];
}

std::string EvaluationLog::state_file(const std::string& section) const {
  return (fs::path(folder_) / fmt::format("state_{:016x}", checksum(section))).string();
}

void EvaluationLog::add(const std::string& section, size_t call, const Entry& entry) {
  const std::string record = framed(walk(Bytes(), section, call, entry).bytes());
  ++added_;
  const off_t before = lseek(file_, 0, SEEK_END);
  // Half a record would hide those after it.
  if (write(file_, record.data(), record.size()) != static_cast<ssize_t>(record.size()) &&
      ftruncate(file_, before) != 0)
    std::exchange(file_, -1);
}

void EvaluationLog::keep_state(const std::string& section, size_t calls, const std::string& state) {
  try {
    write_file(state_file(section), framed(Bytes()(calls, state).bytes()));
  } catch (const InputError&) {  // a full disk: the calls since the last state are made again then
  }
}

std::optional<std::pair<size_t, std::string>> EvaluationLog::state(const std::string& section) const {
  const std::string path = state_file(section);
  if (!fs::exists(path)) return std::nullopt;
  const std::string text = read_file(path);
  Bytes in(text);
  const std::optional<std::string> bytes = unframed(in);
  if (!bytes) return std::nullopt;
  std::pair<size_t, std::string> kept;
  Bytes record(*bytes);
  record(kept.first, kept.second);
  return kept;
}

LoggedProtocol::LoggedProtocol(Protocol& protocol, EvaluationLog& log, std::string section,
                               const std::atomic<bool>* stop)
    : protocol_(protocol), log_(log), section_(std::move(section)), stop_(stop) {
  size_t known = 0;
  while (log_.find(section_, known) != nullptr) ++known;
  known_ = known;
  if (protocol_.state().empty()) return;
  // From where on the calls can be made again: after those whose state was kept, or at one that starts afresh.
  kept_ = log_.state(section_);
  known_ = kept_ && kept_->first <= known ? kept_->first : 0;
  for (size_t call = known; call-- > known_;) {
    if (!log_.find(section_, call)->fresh) continue;
    known_ = call;
    break;
  }
}

Prediction LoggedProtocol::predict(const Params& p, const std::vector<int>& free) {
  return answer(p, free, std::exchange(fresh_, false), [&] { return protocol_.predict(p, free); });
}

/// What the log knows as the answer to the next call, or what `ask` says.
Prediction LoggedProtocol::answer(const Params& p, const std::vector<int>& free, bool fresh,
                                  const std::function<Prediction()>& ask) {
  if (!live_ && calls_ < known_) {
    const EvaluationLog::Entry& entry = *log_.find(section_, calls_);
    if (entry.p == p && entry.free == free) {
      ++calls_;
      answered_ += entry.factorisations;
      return entry.prediction;
    }
    known_ = 0;  // not the same run after all: go on without the log
  }
  if (!std::exchange(live_, true) && !fresh && kept_ && kept_->first == calls_) protocol_.restore(kept_->second);
  kept_.reset();
  const int before = protocol_.factorisations();
  const Stopwatch watch;
  const Prediction prediction = ask();
  if (stop_ != nullptr && stop_->load()) return prediction;  // it may have ended early
  log_.add(section_, calls_++, {p, free, prediction, protocol_.factorisations() - before, fresh});
  keep_state(watch.seconds());
  return prediction;
}

/// Keeps the protocol's state, unless that would take more than a twentieth of the time.
void LoggedProtocol::keep_state(double seconds) {
  since_state_ += seconds;
  if (since_state_ < 20 * state_seconds_) return;
  const Stopwatch watch;
  const std::string state = protocol_.state();
  if (state.empty()) return;
  log_.keep_state(section_, calls_, state);
  state_seconds_ = watch.seconds();
  since_state_ = 0;
}

/// Logged as the "prediction" with respect to parameter -1: a line of its matrix for each row, with the number of its
/// alternative, the row, its values and the jump.
std::vector<Alternative> LoggedProtocol::alternatives(const Params& p) {
  const Prediction logged = answer(p, {-1}, true, [&] {
    Prediction prediction;
    const std::vector<Alternative> found = protocol_.alternatives(p);
    for (size_t k = 0; k < found.size(); ++k) {
      const Alternative& one = found[k];
      for (size_t i = 0; i < one.rows.size(); ++i) {
        const auto at = static_cast<Eigen::Index>(i);
        prediction.derivatives.conservativeResize(prediction.derivatives.rows() + 1, 5);
        prediction.derivatives.bottomRows(1) << static_cast<double>(k), one.rows[i], one.path[at],
            one.other.size() > 0 ? one.other[at] : not_a_number, one.jump;
      }
    }
    return prediction;
  });
  forget();
  std::vector<Alternative> alternatives;
  for (const auto& line : logged.derivatives.rowwise()) {
    if (line[0] >= static_cast<double>(alternatives.size())) alternatives.emplace_back();
    Alternative& one = alternatives.back();
    one.rows.push_back(static_cast<int>(line[1]));
    one.jump = line[4];
    one.path.conservativeResize(one.path.size() + 1);
    one.path.tail(1) << line[2];
    if (!std::isfinite(line[3])) continue;
    one.other.conservativeResize(one.other.size() + 1);
    one.other.tail(1) << line[3];
  }
  return alternatives;
}

void LoggedProtocol::follow(const Params& at, const std::vector<int>& rows) {
  protocol_.follow(at, rows);
  forget();
}

void LoggedProtocol::forget() {
  fresh_ = true;
  protocol_.forget();
}

}  // namespace taut

#include "calib/studies/study_store.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <filesystem>
#include <limits>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string_view>

#include "calib/data/files.hpp"
#include "calib/studies/crew.hpp"
#include "sim/core/error.hpp"
#include "sim/core/stopwatch.hpp"

namespace taut {
namespace {

constexpr const char* fingerprint_column = "fingerprint";

}  // namespace

std::string csv_line(const Cells& cells) {
  std::string line;
  for (size_t k = 0; k < cells.size(); ++k) {
    if (k > 0) line += ',';
    if (cells[k].find_first_of(",\"\n") == std::string::npos) {
      line += cells[k];
      continue;
    }
    line += '"';
    for (char c : cells[k]) line += c == '"' ? std::string("\"\"") : std::string(1, c == '\n' ? ' ' : c);
    line += '"';
  }
  return line;
}

namespace {

constexpr const char* check_column = "check";

/// The line with its checksum behind it.
std::string sealed(const std::string& line) {
  return fmt::format("{},{:08x}", line, crc32_of(line));
}

/// What sealed() was given; nullopt: a part of it, or something else.
std::optional<std::string> unsealed(const std::string& text) {
  const size_t comma = text.rfind(',');
  if (comma == std::string::npos || sealed(text.substr(0, comma)) != text) return std::nullopt;
  return text.substr(0, comma);
}

}  // namespace

Cells csv_cells(const std::string& line) {
  Cells cells(1);
  bool quoted = false;
  for (size_t i = 0; i < line.size(); ++i) {
    if (quoted && line.compare(i, 2, "\"\"") == 0) {
      cells.back() += line[++i];
    } else if (line[i] == '"') {
      quoted = !quoted;
    } else if (line[i] == ',' && !quoted) {
      cells.emplace_back();
    } else if (line[i] != '\r') {
      cells.back() += line[i];
    }
  }
  return quoted ? Cells() : cells;
}

std::string fingerprint_of(const std::vector<std::string>& files) {
  std::string text;
  for (const std::string& file : files) text += (text.empty() ? "" : "-") + sha256_of(file).substr(0, 8);
  return text;
}

std::uint32_t crc32_of(std::string_view text) {
  std::uint32_t crc = 0xffffffff;
  for (const char c : text) {
    crc ^= static_cast<unsigned char>(c);
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ ((crc & 1) != 0 ? 0xedb88320 : 0);
  }
  return ~crc;
}

StudyStore::StudyStore(const std::string& path, Cells columns, size_t keys, std::string fingerprint,
                       const std::string& writer)
    : path_(path), columns_(std::move(columns)), keys_(keys), fingerprint_(std::move(fingerprint)) {
  namespace fs = std::filesystem;
  const std::string stem = fs::path(path).stem().string(), extension = fs::path(path).extension().string();
  const fs::path folder = fs::path(path).parent_path();
  std::vector<std::string> files{path};
  std::error_code missing;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder.empty() ? "." : folder, missing)) {
    const std::string name = entry.path().filename().string();
    if (name.starts_with(stem + ".") && name.ends_with(extension) && name.find("-of-") != std::string::npos)
      files.push_back((folder / name).string());
  }
  std::ranges::sort(files);
  if (!writer.empty()) path_ = (folder / fmt::format("{}.{}{}", stem, writer, extension)).string();
  for (const std::string& file : files) {
    const bool checked = read(file);
    if (file == path_) checked_ = checked;
  }
}

/// Takes what stands in a file of the table; whether its lines have, or are to have, checksums.
bool StudyStore::read(const std::string& path) {
  if (!std::filesystem::exists(path)) return true;
  const std::string text = read_file(path), old = header_line(false) + "\n", header = header_line(true) + "\n";
  const bool checked = !text.starts_with(old);  // a table that was begun before lines had checksums goes on without
  const std::string& begins = checked ? header : old;
  if (text.compare(0, begins.size(), begins, 0, text.size()) != 0) {
    throw InputError(fmt::format("{}: is not a table with the columns {}; move it away, or name another folder", path,
                                 join(columns_)));
  }
  size_t begin = begins.size();
  for (size_t end; begin < text.size() && (end = text.find('\n', begin)) != std::string::npos; begin = end + 1)
    remember(text.substr(begin, end - begin), checked);
  return checked;
}

std::string StudyStore::header_line(bool checked) const {
  return csv_line(columns_) + (checked ? fmt::format(",{}", check_column) : "");
}

void StudyStore::remember(const std::string& text, bool checked) {
  const std::optional<std::string> line = checked ? unsealed(text) : text;
  if (!line) return;
  Cells cells = csv_cells(*line);
  const auto place = std::ranges::find(columns_, fingerprint_column) - columns_.begin();
  if (cells.size() != columns_.size() || cells[static_cast<size_t>(place)] != fingerprint_) return;
  cells.erase(cells.begin() + place);
  const auto key_end = cells.begin() + static_cast<std::ptrdiff_t>(keys_);
  results_[Cells(cells.begin(), key_end)] = Cells(key_end, cells.end());
}

const Cells* StudyStore::find(const Cells& key) const {
  const auto found = results_.find(key);
  return found == results_.end() ? nullptr : &found->second;
}

void StudyStore::add(const Cells& key, const Cells& result) {
  Cells cells = key;
  cells.insert(cells.end(), result.begin(), result.end());
  cells.insert(cells.begin() + (std::ranges::find(columns_, fingerprint_column) - columns_.begin()), fingerprint_);
  append_line(path_, header_line(checked_), checked_ ? sealed(csv_line(cells)) : csv_line(cells));
  results_[key] = result;
}

Deadline::Deadline(double seconds, const std::atomic<bool>* stop)
    : seconds_(seconds), thread_([this, stop](const std::stop_token& over) {
        const Stopwatch watch;
        std::mutex mutex;
        std::condition_variable_any wake;
        std::unique_lock lock(mutex);
        while (!over.stop_requested() && !raised_) {
          late_ = watch.seconds() > seconds_;
          raised_ = late_ || (stop != nullptr && stop->load());
          wake.wait_for(lock, over, std::chrono::milliseconds(50), [] { return false; });
        }
      }) {}

bool StudyOptions::is_part() const {
  return shard.count > 1 || (messages != nullptr && messages->rank() > 0);
}

void run_study(const Study& study, const StudyOptions& options) {
  if (options.messages != nullptr && options.messages->rank() > 0) return work_for(*options.messages, study, options);
  const bool whole = options.shard.count == 1;
  StudyStore store(options.file, study.columns, study.keys, options.fingerprint,
                   whole ? "" : fmt::format("{}-of-{}", options.shard.index + 1, options.shard.count));
  std::vector<size_t> missing;
  for (size_t i = 0; i < study.settings.size(); ++i) {
    const Cells* known = store.find(study.settings[i].key);
    if ((known == nullptr || !study.take(i, *known)) && options.shard.has(i)) missing.push_back(i);
  }
  if (options.messages != nullptr) return hand_out(*options.messages, study, options, missing);
  double rate = 0;  // seconds per unit of cost, by the run before
  const Stopwatch watch;
  size_t made = 0, done = study.settings.size() - missing.size();
  for (size_t i : missing) {
    if (options.stop != nullptr && options.stop->load()) break;
    const StudySetting& setting = study.settings[i];
    const double left = options.budget - watch.seconds();
    const bool due = made < study.least;
    if (!due && (left <= 0 || (!setting.may_hang && rate * setting.cost > left))) continue;
    if (options.progress) options.progress(setting.description, done, study.settings.size());
    const double patience = setting.may_hang ? 0.1 * options.budget
                            : due            ? std::numeric_limits<double>::infinity()
                                             : 1.5 * left;
    const Deadline deadline(patience, options.stop);
    const std::optional<StudyResult> result = study.run(i, deadline);
    if (!result) continue;
    store.add(setting.key, result->cells);
    study.take(i, result->cells);
    if (result->seconds > 0) rate = result->seconds / setting.cost;
    ++made;
    ++done;
  }
}

}  // namespace taut

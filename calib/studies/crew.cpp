#include "calib/studies/crew.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <deque>
#include <functional>
#include <limits>
#include <mutex>
#include <stop_token>
#include <thread>
#include <utility>

#include "sim/core/error.hpp"
#include "sim/core/stopwatch.hpp"

// Messages are lines of a table. To rank 0: "alive", "free", "done,SETTING,cells of the result...",
// "failed,SETTING,why", "stopped". From it: "run,SETTING,SECONDS it may take", "over".
namespace taut {
namespace {

constexpr int most_tries = 2;

/// Rank 0's side of a study.
class Manager {
 public:
  Manager(Messages& messages, const Study& study, const StudyOptions& options, const std::vector<size_t>& settings)
      : messages_(messages),
        study_(study),
        options_(options),
        waiting_(settings.begin(), settings.end()),
        tries_(study.settings.size(), 0),
        finished_(study.settings.size(), true),
        workers_(static_cast<size_t>(messages.size())),
        done_(study.settings.size() - settings.size()) {
    for (size_t setting : settings) finished_[setting] = false;
    if (!std::isfinite(options.budget))
      std::ranges::stable_sort(waiting_, std::greater(), [&](size_t i) { return study.settings[i].cost; });
  }

  void run() {
    while (true) {
      const std::optional<Message> message = messages_.receive(0.05);
      if (message) {
        hear(*message);
        give_work(message->from);
      }
      const bool more = !waiting_.empty() && may_begin();
      if (message && more && round_.seconds() < 0.2) continue;  // looking at all workers takes time where they are many
      round_ = Stopwatch();
      bury_the_dead();
      for (int rank = 1; rank < messages_.size(); ++rank) give_work(rank);
      if (over()) break;
    }
    for (int rank = 1; rank < messages_.size(); ++rank) messages_.send(rank, "over");
  }

 private:
  /// Another process, as far as its messages tell.
  struct Worker {
    bool free = false, gone = false;
    std::optional<size_t> setting = {};
    Stopwatch heard = {};
  };

  bool stopped() const { return options_.stop != nullptr && options_.stop->load(); }
  bool may_begin() const { return !stopped() && (made_ < study_.least || watch_.seconds() < options_.budget); }
  bool over() const {
    const bool busy =
        std::any_of(workers_.begin() + 1, workers_.end(), [](const Worker& w) { return w.setting && !w.gone; });
    if (busy) return false;
    if (waiting_.empty() || !may_begin()) return true;
    if (std::all_of(workers_.begin() + 1, workers_.end(), [](const Worker& w) { return w.gone; }))
      throw InputError(
          fmt::format("all {} processes that were to work are gone; {} of {} settings are finished, and the "
                      "same command goes on from there",
                      messages_.size() - 1, done_, study_.settings.size()));
    return false;
  }

  void hear(const Message& message) {
    Worker& worker = workers_.at(static_cast<size_t>(message.from));
    worker.heard = Stopwatch();
    worker.gone = false;  // it was only slow
    const Cells cells = csv_cells(message.text);
    const std::string& what = cells.at(0);
    if (what == "alive") return;
    if (what == "stopped") {
      worker.gone = true;
      worker.setting.reset();
      return;
    }
    worker.free = true;
    if (what == "free") return;
    const size_t setting = std::stoul(cells.at(1));
    if (worker.setting == setting) worker.setting.reset();
    if (what == "failed") return try_again(setting);
    if (what != "done" || finished_.at(setting)) return;  // somebody else was faster
    finish(setting, Cells(cells.begin() + 2, cells.end()));
  }

  void finish(size_t setting, const Cells& result) {
    if (!study_.take(setting, result)) return try_again(setting);
    finished_[setting] = true;
    std::erase(waiting_, setting);
    ++made_;
    ++done_;
    if (options_.progress) options_.progress(study_.settings[setting].description, done_, study_.settings.size());
  }

  void try_again(size_t setting) {
    if (!finished_[setting] && tries_[setting] < most_tries) waiting_.push_back(setting);
  }

  void bury_the_dead() {
    for (Worker& worker : workers_) {
      if (&worker == workers_.data() || worker.gone || worker.heard.seconds() < messages_.silence()) continue;
      worker.gone = true;
      worker.free = false;
      if (worker.setting) try_again(*std::exchange(worker.setting, std::nullopt));
    }
  }

  void give_work(int rank) {
    Worker& worker = workers_[static_cast<size_t>(rank)];
    if (!worker.free || worker.gone || waiting_.empty() || !may_begin()) return;
    const size_t setting = waiting_.front();
    waiting_.pop_front();
    ++tries_[setting];
    worker.free = false;
    worker.setting = setting;
    const double patience =
        study_.settings[setting].may_hang ? 0.1 * options_.budget : std::numeric_limits<double>::infinity();
    messages_.send(rank, csv_line({"run", std::to_string(setting), fmt::format("{}", patience)}));
  }

  Messages& messages_;
  const Study& study_;
  const StudyOptions& options_;
  std::deque<size_t> waiting_;
  std::vector<int> tries_;
  std::vector<bool> finished_;
  std::vector<Worker> workers_;  ///< by rank; the first one is this process
  size_t made_ = 0, done_;
  Stopwatch watch_, round_;
};

/// Says "alive" while it lives.
class Heartbeat {
 public:
  explicit Heartbeat(Messages& messages)
      : thread_([&messages](const std::stop_token& over) {
          std::mutex mutex;
          std::condition_variable_any wake;
          std::unique_lock lock(mutex);
          const std::chrono::duration<double> pause(messages.silence() / 20);
          while (!over.stop_requested()) {
            messages.send(0, "alive");
            wake.wait_for(lock, over, pause, [] { return false; });
          }
        }) {}

 private:
  std::jthread thread_;
};

}  // namespace

void hand_out(Messages& messages, const Study& study, const StudyOptions& options,
              const std::vector<size_t>& settings) {
  Manager(messages, study, options, settings).run();
}

void work_for(Messages& messages, const Study& study, const StudyOptions& options) {
  StudyStore store(options.file, study.columns, study.keys, options.fingerprint,
                   fmt::format("rank-{}-of-{}", messages.rank(), messages.size()));
  const Heartbeat heartbeat(messages);
  messages.send(0, "free");
  while (true) {
    if (options.stop != nullptr && options.stop->load()) return messages.send(0, "stopped");
    const std::optional<Message> message = messages.receive(0.2);
    if (!message) continue;
    const Cells cells = csv_cells(message->text);
    if (cells.at(0) == "over") return;
    const size_t setting = std::stoul(cells.at(1));
    std::optional<StudyResult> result;
    std::string why = "interrupted";
    try {
      const Deadline deadline(std::stod(cells.at(2)), options.stop);
      result = study.run(setting, deadline);
      if (result) store.add(study.settings[setting].key, result->cells);
    } catch (const std::exception& error) {
      result.reset();
      why = error.what();
    }
    Cells answer{result ? "done" : "failed", cells[1]};
    if (result)
      answer.insert(answer.end(), result->cells.begin(), result->cells.end());
    else
      answer.push_back(why);
    messages.send(0, csv_line(answer));
  }
}

}  // namespace taut

#pragma once
#include <atomic>
#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <vector>

#include "calib/studies/crew.hpp"

namespace taut::test {

/// Messages among threads that stand for processes.
class ThreadedMessages final : public Messages {
 public:
  /// One end for each of `size` ranks.
  static std::vector<std::unique_ptr<ThreadedMessages>> crew(int size, double silence) {
    const auto boxes = std::make_shared<std::vector<Box>>(static_cast<size_t>(size));
    std::vector<std::unique_ptr<ThreadedMessages>> all;
    for (int rank = 0; rank < size; ++rank)
      all.push_back(std::unique_ptr<ThreadedMessages>(new ThreadedMessages(boxes, rank, silence)));
    return all;
  }

  int rank() const override { return rank_; }
  int size() const override { return static_cast<int>(boxes_->size()); }
  double silence() const override { return silence_; }
  void send(int to, const std::string& text) override {
    if (dead) return;
    Box& box = (*boxes_)[static_cast<size_t>(to)];
    const std::lock_guard lock(box.mutex);
    box.messages.push_back({rank_, text});
    box.arrived.notify_all();
  }
  std::optional<Message> receive(double seconds) override {
    Box& box = (*boxes_)[static_cast<size_t>(rank_)];
    std::unique_lock lock(box.mutex);
    box.arrived.wait_for(lock, std::chrono::duration<double>(seconds), [&] { return !box.messages.empty(); });
    if (box.messages.empty()) return std::nullopt;
    Message message = box.messages.front();
    box.messages.pop_front();
    return message;
  }

  std::atomic<bool> dead{false};  ///< nothing that it sends arrives any more

 private:
  struct Box {
    std::mutex mutex;
    std::condition_variable arrived;
    std::deque<Message> messages;
  };
  ThreadedMessages(std::shared_ptr<std::vector<Box>> boxes, int rank, double silence)
      : boxes_(std::move(boxes)), rank_(rank), silence_(silence) {}

  std::shared_ptr<std::vector<Box>> boxes_;
  int rank_;
  double silence_;
};

}  // namespace taut::test

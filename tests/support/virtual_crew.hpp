#pragma once
#include <map>

#include "calib/studies/crew.hpp"

namespace taut::test {

/// Workers in virtual time that need a second for each task: the messages of a crew without processes.
class VirtualCrew final : public Messages {
 public:
  explicit VirtualCrew(int workers) : workers_(workers) {
    for (int rank = 1; rank <= workers; ++rank) arrive(0, rank, "free");
  }
  int rank() const override { return 0; }
  int size() const override { return workers_ + 1; }
  double silence() const override { return 1e9; }
  void send(int to, const std::string& text) override {
    const Cells cells = csv_cells(text);
    if (cells[0] != "run") return;
    ++begun;
    arrive(now + 1, to, csv_line({"done", cells[1], "x"}));
  }
  std::optional<Message> receive(double) override {
    if (events_.empty()) return std::nullopt;
    const auto next = events_.begin();
    now = next->first;
    Message message = next->second;
    events_.erase(next);
    return message;
  }
  double now = 0;
  size_t begun = 0;

 private:
  void arrive(double time, int from, const std::string& text) { events_.emplace(time, Message{from, text}); }
  int workers_;
  std::multimap<double, Message> events_;
};

}  // namespace taut::test

#include "calib/studies/crew.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <array>
#include <filesystem>
#include <functional>
#include <latch>
#include <limits>
#include <mutex>
#include <thread>
#include <utility>

#include "sim/core/error.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/threaded_messages.hpp"
#include "tests/support/virtual_crew.hpp"

namespace taut::test {
namespace {

/// Squares of numbers, run by ranks 1, 2, ... of a crew.
class Crew : public testing::Test {
 protected:
  static constexpr size_t count = 40;

  /// What a process has of the study; `before` is what it does before it runs a setting.
  Study study(std::vector<Cells>* taken, const std::function<void(size_t)>& before = {}) {
    Study study;
    study.columns = {"fingerprint", "number", "square"};
    for (size_t i = 0; i < count; ++i)
      study.settings.push_back({{std::to_string(i)}, fmt::format("square {}", i), static_cast<double>(i)});
    study.run = [this, before](size_t i, const Deadline&) -> std::optional<StudyResult> {
      {
        const std::lock_guard lock(mutex_);
        order_.push_back(i);
      }
      if (before) before(i);
      return StudyResult{{fmt::format("{}, \"squared\"", i * i)}, 0};
    };
    study.take = [taken](size_t i, const Cells& cells) {
      if (taken != nullptr) (*taken)[i] = cells;
      return true;
    };
    return study;
  }
  StudyOptions options(Messages* messages) const {
    StudyOptions options{std::numeric_limits<double>::infinity(), folder_ / "squares.csv", "f", nullptr, {}};
    options.messages = messages;
    return options;
  }
  /// Runs the study with `workers` processes, each with what `before` of its rank does.
  std::vector<Cells> run(int workers, double silence, const std::function<void(ThreadedMessages&, size_t)>& before) {
    std::vector<Cells> taken(count);
    auto ends = ThreadedMessages::crew(workers + 1, silence);
    std::vector<std::jthread> threads;
    for (int rank = 1; rank <= workers; ++rank)
      threads.emplace_back([&, rank] {
        ThreadedMessages& end = *ends[static_cast<size_t>(rank)];
        run_study(study(nullptr, [&](size_t i) { before(end, i); }), options(&end));
      });
    try {
      run_study(study(&taken), options(ends[0].get()));
    } catch (...) {
      for (int rank = 1; rank <= workers; ++rank) ends[0]->send(rank, "over");
      throw;
    }
    for (int rank = 1; rank <= workers; ++rank) ends[0]->send(rank, "over");  // those that were taken for dead
    return taken;
  }
  static std::vector<Cells> squares() {
    std::vector<Cells> cells;
    for (size_t i = 0; i < count; ++i) cells.push_back({fmt::format("{}, \"squared\"", i * i)});
    return cells;
  }
  std::mutex mutex_;
  std::vector<size_t> order_;
  TemporaryFolder folder_;
};

TEST_F(Crew, EverySettingIsRunOnceTheDearestFirstAndEachWritesItsOwnFile) {
  std::latch all_at_work(3);  // so that the first three begun are the first three handed out
  std::array<bool, 4> at_work = {};
  const auto wait = [&](const ThreadedMessages& end, size_t) {
    if (!std::exchange(at_work.at(static_cast<size_t>(end.rank())), true)) all_at_work.arrive_and_wait();
  };
  EXPECT_EQ(run(3, 60, wait), squares());
  EXPECT_EQ(order_.size(), count);
  for (size_t k = 0; k < 3; ++k) EXPECT_GE(order_[k], count - 3) << "cost grows with the number";
  EXPECT_FALSE(std::filesystem::exists(folder_ / "squares.csv"));
  for (int rank = 1; rank <= 3; ++rank)
    EXPECT_TRUE(std::filesystem::exists(folder_ / fmt::format("squares.rank-{}-of-4.csv", rank)));
  order_.clear();
  std::vector<Cells> alone(count);
  run_study(study(&alone), options(nullptr));
  EXPECT_EQ(alone, squares()) << "one process reads what three wrote";
  EXPECT_TRUE(order_.empty());
}

TEST_F(Crew, WhatADeadProcessHadBegunIsRunElsewhere) {
  std::atomic<int> deaths = 0;
  const std::vector<Cells> taken = run(3, 2, [&](ThreadedMessages& end, size_t i) {
    if (i == 30 && end.rank() != 0 && deaths++ == 0) end.dead = true;  // it works on, and nobody hears of it
  });
  EXPECT_EQ(taken, squares());
  EXPECT_EQ(deaths, 2) << "30 was begun twice";
}

TEST_F(Crew, WhatFailsIsTriedOnceMoreAndThenLeftOut) {
  std::atomic<int> of_7 = 0, of_8 = 0;
  std::vector<Cells> taken = run(2, 60, [&](auto&, size_t i) {
    if (i == 7 && of_7++ == 0) throw std::runtime_error("once");
    if (i == 8 && of_8++ < 100) throw std::runtime_error("always");
  });
  EXPECT_EQ(of_7, 2);
  EXPECT_EQ(of_8, 2);
  std::vector<Cells> expected = squares();
  expected[8] = {};
  EXPECT_EQ(taken, expected);
}

TEST_F(Crew, WithNobodyLeftItSaysHowFarItCame) {
  const auto die_late = [](ThreadedMessages& end, size_t i) {
    if (i == 20) end.dead = true;
  };
  try {
    run(1, 4, die_late);
    FAIL() << "it went on without anybody";
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find("all 1 processes that were to work are gone; 19 of 40"), std::string::npos)
        << error.what();
  }
  std::vector<Cells> alone(count);
  run_study(study(&alone), options(nullptr));
  EXPECT_EQ(alone, squares()) << "and the rest is made by whoever goes on";
}

TEST_F(Crew, ShardsAreTheWholeAndShareNothing) {
  for (size_t index : {2, 0, 1}) {
    StudyOptions part = options(nullptr);
    part.shard = {index, 3};
    EXPECT_TRUE(part.is_part());
    const size_t before = order_.size();
    run_study(study(nullptr), part);
    for (size_t k = before; k < order_.size(); ++k) EXPECT_EQ(order_[k] % 3, index);
  }
  EXPECT_EQ(order_.size(), count);
  std::vector<Cells> whole(count);
  run_study(study(&whole), options(nullptr));
  EXPECT_EQ(whole, squares());
  EXPECT_EQ(order_.size(), count);
}

TEST_F(Crew, AThousandWorkersAreAllAtWork) {
  constexpr size_t tasks = 10'000;
  Study many;
  many.columns = {"fingerprint", "number", "x"};
  for (size_t i = 0; i < tasks; ++i) many.settings.push_back({{std::to_string(i)}, "", 1});
  size_t taken = 0;
  many.take = [&](size_t, const Cells&) { return ++taken > 0; };
  VirtualCrew crew(1000);
  run_study(many, options(&crew));
  EXPECT_EQ(taken, tasks);
  EXPECT_EQ(crew.begun, tasks);
  EXPECT_NEAR(crew.now, 10, 1e-9) << "ten rounds of a thousand";
}

}  // namespace
}  // namespace taut::test

#include "calib/studies/study_store.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <numeric>
#include <thread>

#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"

namespace taut::test {
namespace {

const Cells columns{"fingerprint", "name", "value", "remark"};

/// Settings "0", "1", ... whose results are counted.
struct Squares {
  Study study;
  std::vector<int> runs;
  std::vector<Cells> taken;

  explicit Squares(size_t count) : runs(count, 0), taken(count) {
    study.columns = columns;
    for (size_t i = 0; i < count; ++i) study.settings.push_back({{std::to_string(i)}, "square " + std::to_string(i)});
    study.run = [this](size_t i, const Deadline&) -> std::optional<StudyResult> {
      ++runs[i];
      return StudyResult{{std::to_string(i * i), "of \"" + std::to_string(i) + "\", made up"}};
    };
    study.take = [this](size_t i, const Cells& cells) {
      taken[i] = cells;
      return true;
    };
  }
  Squares(const Squares&) = delete;
  int made() const { return std::accumulate(runs.begin(), runs.end(), 0); }
};

TEST(StudyStore, CutAtAnyByteOfItsLastTwoLinesItHasWhatWasFinishedAndGoesOn) {
  const TemporaryFolder folder;
  Squares whole(4);
  run_study(whole.study, {100, folder / "whole.csv", "f", nullptr, {}});
  const std::string text = text_of(folder / "whole.csv");
  const size_t last = text.rfind('\n', text.size() - 2) + 1, before = text.rfind('\n', last - 2) + 1;
  const std::string line = "f,3,9,\"of \"\"3\"\", made up\"";
  ASSERT_EQ(text.substr(last), line + fmt::format(",{:08x}\n", crc32_of(line)));
  for (size_t cut = before; cut <= text.size(); ++cut) {
    const std::string path = folder.write("cut.csv", text.substr(0, cut));
    const StudyStore store(path, columns, 1, "f");
    EXPECT_TRUE(store.find({"0"}) != nullptr && store.find({"1"}) != nullptr);
    EXPECT_EQ(store.find({"2"}) != nullptr, cut >= last) << cut;
    EXPECT_EQ(store.find({"3"}) != nullptr, cut == text.size()) << cut;
    EXPECT_EQ(text_of(path), text.substr(0, cut)) << "reading changes nothing";
    Squares rest(4);
    run_study(rest.study, {100, path, "f", nullptr, {}});
    EXPECT_EQ(rest.made(), cut == text.size() ? 0 : cut >= last ? 1 : 2) << cut;
    EXPECT_EQ(rest.taken, whole.taken) << cut;
    EXPECT_EQ(text_of(path), text) << "and the table is as it would have been";
  }
}

TEST(StudyStore, TheChecksumIsThatOfTheStandard) {
  EXPECT_EQ(crc32_of("123456789"), 0xcbf43926u);  // the check value of CRC-32/ISO-HDLC
  EXPECT_EQ(crc32_of(""), 0u);
}

/// Editors and tools end a file that was cut with a line's end.
TEST(StudyStore, ALineThatWasCutAndEndedOrChangedDoesNotCount) {
  const TemporaryFolder folder;
  Squares whole(3);
  run_study(whole.study, {100, folder / "whole.csv", "f", nullptr, {}});
  const std::string text = text_of(folder / "whole.csv");
  const size_t last = text.rfind('\n', text.size() - 2) + 1;
  for (size_t cut = last; cut + 1 < text.size(); ++cut) {
    const StudyStore store(folder.write("cut.csv", text.substr(0, cut) + "\n"), columns, 1, "f");
    EXPECT_NE(store.find({"1"}), nullptr);
    EXPECT_EQ(store.find({"2"}), nullptr) << cut;
  }
  const StudyStore changed(folder.write("changed.csv", replaced(text, "f,2,4,", "f,2,5,")), columns, 1, "f");
  EXPECT_EQ(changed.find({"2"}), nullptr);
  EXPECT_NE(changed.find({"1"}), nullptr);
}

TEST(StudyStore, ATableFromBeforeThereWereChecksumsIsReadAndGoesOnAsItIs) {
  const TemporaryFolder folder;
  const std::string text = "fingerprint,name,value,remark\nf,a,1,\n", path = folder.write("old.csv", text);
  StudyStore store(path, columns, 1, "f");
  ASSERT_NE(store.find({"a"}), nullptr);
  store.add({"b"}, {"2", "x"});
  EXPECT_EQ(text_of(path), text + "f,b,2,x\n");
  EXPECT_NE(StudyStore(path, columns, 1, "f").find({"b"}), nullptr);
}

TEST(StudyStore, CutWithinItsHeaderItIsAFreshOne) {
  const TemporaryFolder folder;
  const std::string header = "fingerprint,name,value,remark,check\n";
  for (size_t cut = 0; cut <= header.size(); ++cut) {
    const std::string path = folder.write("cut.csv", header.substr(0, cut));
    StudyStore store(path, columns, 1, "f");
    store.add({"a"}, {"1", ""});
    EXPECT_EQ(text_of(path), header + fmt::format("f,a,1,,{:08x}\n", crc32_of("f,a,1,")));
  }
}

TEST(StudyStore, LinesOfOtherInputsStayAndDoNotCountAndWhatIsNoLineNeither) {
  const TemporaryFolder folder;
  const std::string path = folder.write("a.csv",
                                        "fingerprint,name,value,remark\nold,a,1,kept\nnew,b,\"2,torn\nnew,c,3\n"
                                        "new,d,4,\"a, \"\"b\"\"\"\n");
  const std::string text = text_of(path);
  StudyStore store(path, columns, 1, "new");
  for (const char* name : {"a", "b", "c"}) EXPECT_EQ(store.find({name}), nullptr) << name;
  ASSERT_NE(store.find({"d"}), nullptr);
  EXPECT_EQ(*store.find({"d"}), (Cells{"4", "a, \"b\""}));
  store.add({"a"}, {"5", "two\nlines"});
  EXPECT_EQ(text_of(path), text + "new,a,5,\"two lines\"\n");
  ASSERT_NE(StudyStore(path, columns, 1, "old").find({"a"}), nullptr);
}

TEST(StudyStore, TwoThatAddToOneTableLoseNothing) {
  const TemporaryFolder folder;
  const auto add = [&](const char* name) {
    StudyStore store(folder / "a.csv", columns, 1, "f");
    for (int i = 0; i < 50; ++i) store.add({name + std::to_string(i)}, {std::to_string(i), ""});
  };
  std::thread other(add, "a");
  add("b");
  other.join();
  const StudyStore store(folder / "a.csv", columns, 1, "f");
  for (int i = 0; i < 50; ++i)
    EXPECT_TRUE(store.find({"a" + std::to_string(i)}) && store.find({"b" + std::to_string(i)}));
}

TEST(StudyStore, AnotherTableAndAFolderThatCannotBeWrittenGetASentence) {
  const TemporaryFolder folder;
  const std::string path = folder.write("other.csv", "mass_g,tip_mm\n1,2\n");
  expect_input_error([&] { StudyStore(path, columns, 1, "f"); }, {path, "fingerprint, name, value", "another folder"});
  StudyStore store(path + "/a.csv", columns, 1, "f");
  expect_input_error([&] { store.add({"a"}, {"1", ""}); }, {path, "cannot be written", "choose a folder"});
}

TEST(StudyStore, AChangedFileHasAnotherFingerprint) {
  const TemporaryFolder folder;
  const std::string one = folder.write("one", "1"), two = folder.write("two", "2");
  const std::string both = fingerprint_of({one, two});
  EXPECT_EQ(both, fingerprint_of({one}) + "-" + fingerprint_of({two}));
  folder.write("two", "3");
  EXPECT_NE(fingerprint_of({one, two}), both);
}

TEST(Study, WithoutTimeOnlyTheLeastIsRunAndAResultThatIsNoneIsRunAgain) {
  const TemporaryFolder folder;
  Squares squares(4);
  const StudyOptions none{0, folder / "a.csv", "f", nullptr, {}};
  run_study(squares.study, none);
  EXPECT_EQ(squares.made(), 0);
  squares.study.least = 1;
  for (int made : {1, 2}) {
    run_study(squares.study, none);
    EXPECT_EQ(squares.made(), made);
  }
  squares.study.take = [](size_t i, const Cells&) { return i != 0; };
  run_study(squares.study, none);
  EXPECT_EQ(squares.runs, (std::vector{2, 1, 0, 0}));
}

TEST(Study, WhatWouldNotFitIntoTheBudgetAtTheRateOfTheRunBeforeIsNotBegun) {
  const TemporaryFolder folder;
  Squares squares(3);
  const auto run = squares.study.run;
  squares.study.run = [run](size_t i, const Deadline& deadline) {
    std::optional<StudyResult> result = run(i, deadline);
    result->seconds = 1;
    return result;
  };
  squares.study.settings[0].cost = 1;
  squares.study.settings[1].cost = 1000;
  squares.study.settings[2].cost = 10;
  run_study(squares.study, {100, folder / "a.csv", "f", nullptr, {}});
  EXPECT_EQ(squares.runs, (std::vector{1, 0, 1}));
}

TEST(Study, AStopEndsItAndWhatWasInterruptedIsNotKept) {
  const TemporaryFolder folder;
  Squares squares(3);
  std::atomic<bool> stop{false};
  const auto run = squares.study.run;
  squares.study.run = [&](size_t i, const Deadline& deadline) {
    stop = i == 1;
    while (i == 1 && !deadline.flag()) std::this_thread::yield();
    EXPECT_FALSE(deadline.late());
    return i == 1 ? std::nullopt : run(i, deadline);
  };
  std::vector<std::string> told;
  run_study(squares.study, {100, folder / "a.csv", "f", &stop, [&](const std::string& what, size_t done, size_t all) {
                              told.push_back(what + " " + std::to_string(done) + "/" + std::to_string(all));
                            }});
  EXPECT_EQ(squares.made(), 1);
  EXPECT_TRUE(
      text_of(folder / "a.csv").starts_with("fingerprint,name,value,remark,check\nf,0,0,\"of \"\"0\"\", made up\","));
  EXPECT_EQ(told, (std::vector<std::string>{"square 0 0/3", "square 1 1/3"}));
}

}  // namespace
}  // namespace taut::test

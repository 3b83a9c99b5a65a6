#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <sys/mount.h>

#include <chrono>
#include <csignal>
#include <nlohmann/json.hpp>
#include <thread>

#include "tests/support/command.hpp"
#include "tests/support/small_robot.hpp"

// Runs that are killed, interrupted, disturbed or starved lose nothing that was finished.
namespace taut {
namespace {

using namespace test;
using Json = nlohmann::json;
namespace fs = std::filesystem;

/// Large enough for evaluations to take some hundredths of a second.
const std::string kFit =
    replaced(replaced(beam_toml, "[fit.free.E_foam]", "[fit]\nprofiles = \"all\"\n\n[fit.free.E_foam]"),
             "cells = [10, 4]", "cells = [60, 16]") +
    "\n[[fit.variant]]\nname = \"coarser\"\ncells = [40, 12]\n";

class Run : public testing::Test {
 protected:
  void SetUp() override {
    folder.write("bench.csv", beam_csv);
    folder.write("experiment.toml", kFit);
  }
  Outcome taut(const std::vector<std::string>& arguments) { return run_in(folder / "", arguments); }
  Outcome fit(const std::string& out, const std::vector<std::string>& more = {}) {
    std::vector<std::string> arguments{"fit", "experiment.toml", "--out", out};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return taut(arguments);
  }
  /// Starts a fit and returns once it has logged `bytes` of evaluations, or has ended.
  pid_t fit_until(const std::string& out, uintmax_t bytes, int ignored_signal = 0) {
    const pid_t child = start({"fit", "experiment.toml", "--out", out, "--quiet"}, folder / "", ignored_signal);
    const std::string log = folder / out + "/.resume/evaluations";
    for (int i = 0; i < 60000; ++i) {
      std::error_code missing;
      const uintmax_t size = fs::file_size(log, missing);
      if (!missing && size >= bytes) break;
      siginfo_t ended{};
      waitid(P_PID, static_cast<id_t>(child), &ended, WEXITED | WNOHANG | WNOWAIT);
      if (ended.si_pid == child) break;
      std::this_thread::sleep_for(std::chrono::microseconds(500));
    }
    return child;
  }
  void kill_hard(pid_t child) {
    kill(child, SIGKILL);
    finish(child, folder / "");
  }
  /// fit.json without what depends on when and how fast.
  Json record(const std::string& out) {
    Json run = Json::parse(text_of(folder / out + "/fit.json"));
    for (const char* key : {"provenance", "timing"}) run.erase(key);
    for (Json& share : run["shares"]) share.erase("seconds");
    for (Json& variant : run["variants"]) variant.erase("seconds");
    run["main"].erase("seconds");
    for (const char* key : {"search", "profiles"}) {
      if (run["fit"].contains(key)) run["fit"][key].erase("seconds");
    }
    return run;
  }
  TemporaryFolder folder;
};

TEST_F(Run, AKilledFitGoesOnAndEndsAsIfNothingHadHappened) {
  ASSERT_EQ(fit("whole").code, 0);
  const Json whole = record("whole");
  EXPECT_FALSE(fs::exists(folder / "whole/.resume"));
  for (uintmax_t bytes : {400, 1200, 2000}) {
    const std::string out = "killed_" + std::to_string(bytes);
    kill_hard(fit_until(out, bytes));
    ASSERT_FALSE(fs::exists(folder / out + "/fit.json")) << "killed too late to show anything";
    const Outcome again = fit(out);
    ASSERT_EQ(again.code, 0) << again.err;
    expect_holds(again.err, {"going on with an interrupted run", "--fresh"});
    EXPECT_EQ(record(out), whole);
  }
}

TEST_F(Run, AFreshFitDoesNotGoOn) {
  kill_hard(fit_until("run", 1200));
  const Outcome fresh = fit("run", {"--fresh"});
  ASSERT_EQ(fresh.code, 0);
  EXPECT_EQ(fresh.err.find("going on"), std::string::npos) << fresh.err;
}

TEST_F(Run, WhatWasLoggedForOtherInputsIsNotUsed) {
  kill_hard(fit_until("run", 1200));
  folder.write("bench.csv", "trial,pull_N,tip_mm\na,0.05,1.1\na,0.1,2.1\nb,0.05,1\nb,0.1,2\n");
  const Outcome other = fit("run");
  ASSERT_EQ(other.code, 0);
  EXPECT_EQ(other.err.find("going on"), std::string::npos) << other.err;
}

TEST_F(Run, AnInterruptedOrKilledRerunLeavesTheFinishedRunAsItWas) {
  ASSERT_EQ(fit("run", {"--no-variants"}).code, 0);
  const std::string before = text_of(folder / "run/fit.json"), data = text_of(folder / "run/data.csv");
  folder.write("bench.csv", "trial,pull_N,tip_mm\na,0.05,3\na,0.1,6\nb,0.05,3\nb,0.1,6\n");
  kill_hard(fit_until("run", 600));
  EXPECT_EQ(text_of(folder / "run/fit.json"), before);
  EXPECT_EQ(text_of(folder / "run/data.csv"), data) << "inputs belong to their result";
  for (int signal : {SIGINT, SIGTERM, SIGHUP}) {
    fs::remove_all(folder / "run/.resume");
    const pid_t child = fit_until("run", 600);
    kill(child, signal);
    const Outcome stopped = finish(child, folder / "");
    EXPECT_EQ(stopped.code, 130) << stopped.err;
    EXPECT_EQ(text_of(folder / "run/fit.json"), before);
  }
  folder.write("rows.csv", "pull_N\n0.08\n");
  EXPECT_EQ(taut({"predict", "run", "--rows", "rows.csv"}).code, 0);
}

TEST_F(Run, AFirstRunThatWasKilledIsSaidToBeUnfinished) {
  kill_hard(fit_until("run", 600));
  folder.write("rows.csv", "pull_N\n0.08\n");
  const Outcome predict = taut({"predict", "run", "--rows", "rows.csv"});
  EXPECT_EQ(predict.code, 2);
  expect_holds(predict.err, {"run:", "interrupted before it had a result", "`taut fit`"});
}

TEST_F(Run, PartsThatDoNotBelongTogetherAreRefused) {
  ASSERT_EQ(fit("run", {"--no-variants"}).code, 0);
  folder.write("rows.csv", "pull_N\n0.08\n");
  folder.write("run/data.csv", "trial,pull_N,tip_mm\na,0.05,3\n");
  for (const std::vector<std::string>& command :
       {std::vector<std::string>{"predict", "run", "--rows", "rows.csv"}, {"report", "run"}}) {
    const Outcome refused = taut(command);
    EXPECT_EQ(refused.code, 2);
    expect_holds(refused.err, {"run/data.csv", "is not the file that fit.json", "fit again"});
  }
}

TEST_F(Run, TwoRunsIntoOneFolderAreOneTooMany) {
  const pid_t first = fit_until("run", 400);
  kill(first, SIGSTOP);
  const Outcome second = fit("run");
  kill(first, SIGCONT);
  EXPECT_EQ(second.code, 2);
  expect_holds(second.err, {"run: another taut is writing its run there", "--out"});
  EXPECT_EQ(finish(first, folder / "").code, 0);
}

TEST_F(Run, ASimulationDoesNotTakeAFitsPlace) {
  ASSERT_EQ(fit("run", {"--no-variants"}).code, 0);
  const std::string finger = std::string(TAUT_SOURCE_DIR) + "/experiments/finger_bend/experiment.toml";
  const Outcome refused = taut({"simulate", finger, "--out", "run"});
  EXPECT_EQ(refused.code, 2);
  expect_holds(refused.err, {"run: holds a fit", "--out"});
  EXPECT_TRUE(fs::exists(folder / "run/fit.json"));
}

TEST_F(Run, WhatNoRunWroteIsNotReplaced) {
  fs::create_directories(folder / "mine/figures");
  folder.write("mine/figures/sketch.txt", "mine");
  folder.write("mine/experiment.toml", "mine, too");
  const Outcome refused = fit("mine", {"--no-variants"});
  EXPECT_EQ(refused.code, 2);
  expect_holds(refused.err, {"mine: holds a file experiment.toml, which no run wrote", "--out"});
  EXPECT_EQ(text_of(folder / "mine/experiment.toml"), "mine, too");
  EXPECT_EQ(text_of(folder / "mine/figures/sketch.txt"), "mine");
}

TEST_F(Run, AFitGoesToTheFolderOfAReplay) {
  ASSERT_EQ(taut({"replay", "experiment.toml", "--out", "both"}).code, 0);
  EXPECT_TRUE(fs::exists(folder / "both/predictions.csv"));
  EXPECT_EQ(fit("both", {"--no-variants"}).code, 0);
  EXPECT_TRUE(fs::exists(folder / "both/fit.json"));
}

TEST_F(Run, PosesTakeTheOldOnesPlaceAsAWhole) {
  folder.write("robot.toml", posed_robot_toml);
  ASSERT_EQ(taut({"ik", "robot.toml", "--out", "poses"}).code, 0);
  EXPECT_TRUE(fs::exists(folder / "poses/frames/robot_ik_0001.vtu"));
  folder.write("poses/notes.txt", "mine");
  ASSERT_EQ(taut({"ik", "robot.toml", "--out", "poses", "--target", "up"}).code, 0);
  EXPECT_TRUE(fs::exists(folder / "poses/frames/robot_ik_0000.vtu"));
  EXPECT_FALSE(fs::exists(folder / "poses/frames/robot_ik_0001.vtu")) << "there is one pose now";
  EXPECT_EQ(text_of(folder / "poses/notes.txt"), "mine");
  EXPECT_FALSE(fs::exists(folder / "poses/.next/ik.csv"));

  const std::string before = text_of(folder / "poses/ik.csv");
  const int lock = open((folder / "poses/.lock").c_str(), O_RDWR | O_CLOEXEC);
  ASSERT_EQ(flock(lock, LOCK_EX), 0);
  const Outcome second = taut({"ik", "robot.toml", "--out", "poses"});
  close(lock);
  EXPECT_EQ(second.code, 2);
  expect_holds(second.err, {"poses: another taut is writing its run there", "--out"});
  EXPECT_EQ(text_of(folder / "poses/ik.csv"), before);
}

TEST_F(Run, PosesTakeNeitherAFitsNorASimulationsPlace) {
  ASSERT_EQ(fit("run", {"--no-variants"}).code, 0);
  folder.write("robot.toml", posed_robot_toml);
  const Outcome refused = taut({"ik", "robot.toml", "--out", "run"});
  EXPECT_EQ(refused.code, 2);
  expect_holds(refused.err, {"run: holds a fit", "--out"});
  EXPECT_TRUE(fs::exists(folder / "run/fit.json"));

  ASSERT_EQ(taut({"simulate", "robot.toml"}).code, 0);
  const std::string before = text_of(folder / "runs/robot/channels.csv");
  const Outcome beside = taut({"ik", "robot.toml"});
  EXPECT_EQ(beside.code, 0);
  expect_holds(beside.err, {"report: runs/robot/ik/report.html"});
  EXPECT_TRUE(fs::exists(folder / "runs/robot/ik/ik.csv"));
  EXPECT_EQ(text_of(folder / "runs/robot/channels.csv"), before);

  folder.write("other.toml", posed_robot_toml);
  folder.write("runs/robot/ik.csv", "left by somebody");
  ASSERT_EQ(taut({"ik", "other.toml", "--out", "runs/robot"}).code, 0);
  EXPECT_EQ(text_of(folder / "runs/robot/channels.csv"), before) << "poses of another robot";
  EXPECT_TRUE(fs::exists(folder / "runs/robot/ik/other_ik.pvd"));
}

TEST_F(Run, ASignalThatTheCallerIgnoresStaysIgnored) {
  const pid_t child = fit_until("run", 600, SIGHUP);  // as nohup does
  kill(child, SIGHUP);
  EXPECT_EQ(finish(child, folder / "").code, 0);
}

TEST_F(Run, StaleFilesOfTheRunBeforeGoAndThoseOfOthersStay) {
  ASSERT_EQ(fit("run").code, 0);
  folder.write("run/notes.txt", "mine");
  ASSERT_TRUE(fs::exists(folder / "run/states/state_001.vtu"));
  folder.write("bench.csv", "trial,pull_N,tip_mm\na,0.05,1\nb,0.05,1.01\nc,0.05,1.02\n");
  ASSERT_EQ(fit("run", {"--no-variants"}).code, 0);
  EXPECT_FALSE(fs::exists(folder / "run/states/state_001.vtu")) << "there is one condition now";
  EXPECT_EQ(text_of(folder / "run/notes.txt"), "mine");
}

/// A closed or full standard output costs what was to be printed there.
TEST_F(Run, OutputThatCannotBePrintedCostsNoRun) {
  for (const char* where : {">&-", ">/dev/full"}) {
    fs::remove_all(folder / "run");
    const std::string command = "cd '" + (folder / "") + "' && '" + TAUT_BINARY +
                                "' fit experiment.toml --no-variants --quiet --out run " + where + " 2>err.txt";
    const int status = std::system(command.c_str());
    EXPECT_EQ(WEXITSTATUS(status), 2) << where;
    expect_holds(text_of(folder / "err.txt"), {"standard output"});
    EXPECT_EQ(Json::parse(text_of(folder / "run/fit.json"))["status"], "converged") << where;
  }
}

/// On a disk that takes the fit but not the pictures, the fit stays.
TEST_F(Run, AFullDiskCostsPicturesAndNoFit) {
  const std::string disk = folder / "disk";
  fs::create_directory(disk);
  if (mount("none", disk.c_str(), "tmpfs", 0, "size=220k") != 0) GTEST_SKIP() << "needs the right to mount";
  const Outcome fitted = fit("disk/run", {"--no-variants"});
  const std::string result = text_of(folder / "disk/run/fit.json");
  const bool report = fs::exists(folder / "disk/run/report.html");
  umount(disk.c_str());
  EXPECT_NE(fitted.code, 0);
  EXPECT_FALSE(report);
  expect_holds(fitted.err, {"No space left"});
  ASSERT_FALSE(result.empty()) << fitted.err;
  EXPECT_EQ(Json::parse(result)["status"], "converged");
}

/// Every command on every kind of file: what it does, or one sentence that says what to use.
TEST_F(Run, EveryCommandTakesEveryKindOrSaysWhatTo) {
  const std::string root(TAUT_SOURCE_DIR);
  const std::string point = root + "/experiments/foam_point/experiment.toml",
                    swing = root + "/experiments/silicone_swing/experiment.toml",
                    finger = root + "/experiments/finger_bend/experiment.toml";
  struct Case {
    std::vector<std::string> arguments;
    int code;
  };
  const std::vector<Case> cases{{{"check", "experiment.toml"}, 0},
                                {{"check", point}, 0},
                                {{"check", swing}, 0},
                                {{"check", finger}, 0},
                                {{"draw", "experiment.toml", "--out", "a"}, 0},
                                {{"draw", point, "--out", "b"}, 2},
                                {{"draw", finger, "--out", "c"}, 2},
                                {{"replay", "experiment.toml", "--sensitivities", "--out", "d"}, 0},
                                {{"replay", point, "--sensitivities", "--out", "e"}, 0},
                                {{"replay", finger, "--out", "f"}, 2},
                                {{"fit", point, "--no-variants", "--out", "g"}, 0},
                                {{"fit", finger, "--out", "h"}, 2},
                                {{"simulate", "experiment.toml", "--out", "i"}, 2},
                                {{"simulate", point, "--out", "j"}, 2},
                                {{"ik", "experiment.toml", "--out", "k"}, 2},
                                {{"ik", finger, "--out", "l"}, 2},
                                {{"chart", "accuracy", point, "--out", "m"}, 2},
                                {{"chart", "stability", point, "--out", "n"}, 2},
                                {{"predict", "g", "--rows", "bench.csv"}, 2},
                                {{"report", "g"}, 0}};
  for (const Case& one : cases) {
    const Outcome outcome = taut(one.arguments);
    EXPECT_EQ(outcome.code, one.code) << one.arguments[0] << " " << one.arguments[1] << "\n" << outcome.err;
    if (one.code != 2) continue;
    EXPECT_TRUE(outcome.err.starts_with("taut: ")) << outcome.err;
    EXPECT_EQ(std::count(outcome.err.begin(), outcome.err.end(), '\n'), 1) << outcome.err;
  }
}

}  // namespace
}  // namespace taut

#pragma once
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdio>
#include <string>
#include <thread>
#include <vector>

#include "tests/support/experiment_files.hpp"

// The command `taut` as its users start it.
namespace taut::test {

struct Outcome {
  int code = -1;
  std::string out, err;
};

/// Starts the program with its streams in files; returns its process.
inline pid_t start(const std::vector<std::string>& arguments, const std::string& folder, int ignored_signal = 0) {
  std::vector<std::string> words{TAUT_BINARY};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  std::fflush(nullptr);  // or the child would write what is buffered again
  const pid_t child = fork();
  if (child == 0) {
    for (const int signal : {SIGINT, SIGHUP})
      std::signal(signal, SIG_DFL);  // what a shell starts in the background ignores some
    if (ignored_signal != 0) std::signal(ignored_signal, SIG_IGN);
    const bool ready = chdir(folder.c_str()) == 0 && std::freopen("stdout.txt", "w", stdout) != nullptr &&
                       std::freopen("stderr.txt", "w", stderr) != nullptr;
    if (ready) execv(argv[0], argv.data());
    _exit(127);
  }
  return child;
}

/// Waits until a program that start() started has said `words` on stderr; a failure after a minute or when it has
/// ended.
inline void wait_until_said(pid_t child, const std::string& folder, const std::string& words) {
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::minutes(1);
  while (text_of(folder + "/stderr.txt").find(words) == std::string::npos) {
    siginfo_t ended{};
    waitid(P_PID, static_cast<id_t>(child), &ended, WEXITED | WNOHANG | WNOWAIT);
    if (ended.si_pid != 0 || std::chrono::steady_clock::now() > deadline) {
      ADD_FAILURE() << "'" << words << "' was not said: " << text_of(folder + "/stderr.txt");
      return;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
}

inline Outcome finish(pid_t child, const std::string& folder) {
  int status = 0;
  waitpid(child, &status, 0);
  Outcome outcome;
  outcome.code = WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  outcome.out = text_of(folder + "/stdout.txt");
  outcome.err = text_of(folder + "/stderr.txt");
  return outcome;
}

inline Outcome run_in(const std::string& folder, const std::vector<std::string>& arguments) {
  return finish(start(arguments, folder), folder);
}

/// The same for what has to succeed.
inline Outcome done_in(const std::string& folder, const std::vector<std::string>& arguments) {
  const Outcome outcome = run_in(folder, arguments);
  EXPECT_EQ(outcome.code, 0) << outcome.err;
  return outcome;
}

inline void expect_holds(const std::string& text, const std::vector<std::string>& parts) {
  for (const std::string& part : parts)
    EXPECT_NE(text.find(part), std::string::npos) << part << " is not in:\n" << text;
}

}  // namespace taut::test

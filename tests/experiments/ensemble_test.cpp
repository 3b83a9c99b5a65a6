#include <gtest/gtest.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <thread>

#include "tests/support/command.hpp"

// `taut ensemble`, `taut fit --posterior` and shards as their users start them.
namespace taut {
namespace {

using namespace test;
using Json = nlohmann::json;
namespace fs = std::filesystem;

class EnsembleCommand : public testing::Test {
 protected:
  void SetUp() override {
    folder.write("bench.csv", beam_csv);
    folder.write("experiment.toml", beam_toml);
  }
  Outcome taut(const std::vector<std::string>& arguments) { return run_in(folder / "", arguments); }
  void fit(const std::string& out, const std::vector<std::string>& more = {}) {
    std::vector<std::string> arguments{"fit", "experiment.toml", "--no-variants", "-q", "--out", out};
    arguments.insert(arguments.end(), more.begin(), more.end());
    const Outcome outcome = taut(arguments);
    ASSERT_EQ(outcome.code, 0) << outcome.err;
  }
  std::string table(const std::string& run) { return text_of(folder / run + "/posterior.csv"); }
  /// `run` as another one, without what its ensembles left.
  void copy_without_members(const std::string& run, const std::string& to) {
    fs::copy(folder / run, folder / to, fs::copy_options::recursive);
    fs::remove_all(folder / to + "/ensembles");
    fs::remove(folder / to + "/posterior.csv");
  }
  TemporaryFolder folder;
};

TEST_F(EnsembleCommand, AFitWithAPosteriorHasItInItsFilesAndOnItsPage) {
  fit("run", {"--posterior", "60"});
  const Json run = Json::parse(text_of(folder / "run/fit.json"));
  const Json& posterior = run["ensembles"][0];
  EXPECT_EQ(posterior["kind"], "posterior");
  EXPECT_EQ(posterior["finished"], 60);
  // Readings of 0.1 mm noise on 1 and 2 mm: the parabola is good, and both intervals are nearly one.
  const Json &parameter = run["parameters"][0], &marginal = posterior["parameters"][0];
  const double half = 1.96 * parameter["standard_error"].get<double>();
  EXPECT_NEAR(marginal["interval95"][0].get<double>(), parameter["value"].get<double>() - half, 0.5 * half);
  EXPECT_NEAR(marginal["interval95"][1].get<double>(), parameter["value"].get<double>() + half, 0.5 * half);
  EXPECT_TRUE(fs::exists(folder / "run/figures/ensemble_posterior.svg"));
  expect_holds(text_of(folder / "run/report.html"), {"Beyond the parabola", "randomised maximum likelihood"});
  expect_holds(text_of(folder / "run/predictions.csv"), {"posterior_lower95_m", "posterior_upper95_m"});
  expect_holds(table("run"), {"number,status,weight,chi_squared,E_foam [Pa]"});
}

TEST_F(EnsembleCommand, ShardsMakeWhatOneProcessMakesToTheLastDigit) {
  fit("run");
  copy_without_members("run", "parts");
  ASSERT_EQ(taut({"ensemble", "posterior", "run", "--members", "40", "-q"}).code, 0);
  for (const char* shard : {"2/3", "1/3", "3/3"}) {
    const Outcome part = taut({"ensemble", "posterior", "parts", "--members", "40", "--shard", shard});
    EXPECT_EQ(part.code, 0) << part.err;
    EXPECT_FALSE(fs::exists(folder / "parts/posterior.csv")) << "a part sums nothing up";
  }
  const Outcome whole = taut({"ensemble", "posterior", "parts", "--members", "40", "-q", "--json"});
  EXPECT_EQ(whole.code, 0) << whole.err;
  EXPECT_EQ(table("parts"), table("run"));
  EXPECT_EQ(Json::parse(whole.out)["finished"], 40);
  // More members go on from there.
  ASSERT_EQ(taut({"ensemble", "posterior", "parts", "--members", "45", "-q"}).code, 0);
  EXPECT_TRUE(table("parts").starts_with(table("run").substr(0, 60)));
}

TEST_F(EnsembleCommand, AKilledOneGoesOnWhereItWas) {
  folder.write("experiment.toml", replaced(beam_toml, "cells = [10, 4]", "cells = [40, 10]"));
  fit("run");
  copy_without_members("run", "killed");
  const pid_t child = start({"ensemble", "posterior", "killed", "--members", "60", "-q"}, folder / "");
  const std::string store = folder / "killed/ensembles/posterior.csv";
  for (int i = 0; i < 6000 && (!fs::exists(store) || fs::file_size(store) < 2000); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  kill(child, SIGKILL);
  finish(child, folder / "");
  ASSERT_FALSE(fs::exists(folder / "killed/posterior.csv")) << "killed too late to show anything";
  const std::string before = text_of(store);
  ASSERT_EQ(taut({"ensemble", "posterior", "killed", "--members", "60", "-q"}).code, 0);
  EXPECT_TRUE(text_of(store).starts_with(before.substr(0, before.rfind('\n') + 1))) << "nothing was made again";
  ASSERT_EQ(taut({"ensemble", "posterior", "run", "--members", "60", "-q"}).code, 0);
  EXPECT_EQ(table("killed"), table("run"));
}

TEST_F(EnsembleCommand, WrongUseIsOneSentence) {
  fit("run");
  const std::vector<std::pair<std::vector<std::string>, std::string>> cases{
      {{"ensemble", "posterier", "run"}, "did you mean 'posterior'"},
      {{"ensemble", "posterior", "nowhere"}, "no such folder"},
      {{"ensemble", "posterior", "run", "--members", "-3"}, "--members"},
      {{"ensemble", "posterior", "run", "--seed", "-1"}, "--seed"},
      {{"ensemble", "posterior", "experiment.toml"}, "is not a folder"},
      {{"ensemble", "posterior", "run", "--shard", "0/4"}, "write I/N"},
      {{"ensemble", "posterior", "run", "--shard", "2of4"}, "write I/N"},
      {{"fit", "experiment.toml", "--posterior", "-1", "--out", "other"}, "--posterior"}};
  for (const auto& [arguments, words] : cases) {
    const Outcome outcome = taut(arguments);
    EXPECT_EQ(outcome.code, 2) << arguments[1];
    expect_holds(outcome.err, {words});
    EXPECT_EQ(std::ranges::count(outcome.err, '\n'), 1) << outcome.err;
  }
}

/// What mpirun tells each process is enough for one without MPI to refuse, and for one with it to ask MPI.
TEST_F(EnsembleCommand, UnderMpirunOnlySharedWorkIsDone) {
  fit("run");
  if (std::system("command -v mpirun >/dev/null") != 0) GTEST_SKIP() << "no mpirun";
  const auto mpi = [&](const std::string& how, const std::string& arguments) {
    const std::string command = "cd '" + (folder / "") +
                                "' && OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 "
                                "OMPI_MCA_plm_rsh_agent=sh OMPI_MCA_btl=self,vader "
                                "timeout 100 mpirun --oversubscribe " +
                                how + " '" + TAUT_BINARY + "' " + arguments + " >out.txt 2>err.txt";
    return WEXITSTATUS(std::system(command.c_str()));
  };
  if (TAUT_WITH_MPI == 0) {
    EXPECT_EQ(mpi("-n 2", "ensemble posterior run --members 20 -q"), 2);
    expect_holds(text_of(folder / "err.txt"), {"built without MPI", "--shard"});
    return;
  }
  EXPECT_EQ(mpi("-n 2", "replay experiment.toml"), 2);
  expect_holds(text_of(folder / "err.txt"), {"start it without mpirun"});
  copy_without_members("run", "together");
  ASSERT_EQ(mpi("-n 4", "ensemble posterior together --members 40"), 0) << text_of(folder / "err.txt");
  ASSERT_EQ(taut({"ensemble", "posterior", "run", "--members", "40", "-q"}).code, 0);
  EXPECT_EQ(table("together"), table("run"));
  EXPECT_TRUE(fs::exists(folder / "together/ensembles/posterior.rank-1-of-4.csv"));
  EXPECT_FALSE(fs::exists(folder / "together/ensembles/posterior.csv"));
}

/// Two hosts: network namespaces with names of their own and a cable between them, where the machine allows that.
TEST_F(EnsembleCommand, TwoHostsMakeWhatOneProcessDoes) {
  if (TAUT_WITH_MPI == 0) GTEST_SKIP() << "built without MPI";
  fit("run");
  copy_without_members("run", "together");
  folder.write("there", R"(#!/bin/sh
shift  # the host's address: there is only one other
exec ip netns exec "$TAUT_HOSTS-b" unshare -u sh -c 'hostname taut-b; exec sh -c "$0"' "$*"
)");
  fs::permissions(folder / "there", fs::perms::owner_all);
  folder.write("hosts", R"(
set -e
trap 'ip netns del "$TAUT_HOSTS-a"; ip netns del "$TAUT_HOSTS-b"' EXIT
ip netns add "$TAUT_HOSTS-a"
ip netns add "$TAUT_HOSTS-b"
ip -n "$TAUT_HOSTS-a" link add name taut_a type veth peer name taut_b netns "$TAUT_HOSTS-b"
ip -n "$TAUT_HOSTS-a" addr add 10.99.0.1/24 dev taut_a
ip -n "$TAUT_HOSTS-b" addr add 10.99.0.2/24 dev taut_b
for end in a b; do
  ip -n "$TAUT_HOSTS-$end" link set lo up
  ip -n "$TAUT_HOSTS-$end" link set taut_$end up
done
ip netns exec "$TAUT_HOSTS-b" unshare -u hostname taut-b
touch stand
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMPI_MCA_plm_rsh_agent=./there OMPI_MCA_btl=self,tcp
export OMPI_MCA_btl_tcp_if_include=10.99.0.0/24 OMPI_MCA_oob_tcp_if_include=10.99.0.0/24
ip netns exec "$TAUT_HOSTS-a" unshare -u sh -c 'hostname taut-a; exec "$0" "$@"' \
  timeout 100 mpirun --host 10.99.0.1:2,10.99.0.2:2 -n 4 "$@" ensemble posterior together --members 40
)");
  const int status = std::system(("cd '" + (folder / "") + "' && TAUT_HOSTS=taut" + std::to_string(getpid()) +
                                  " sh ./hosts '" + TAUT_BINARY + "' >out.txt 2>err.txt")
                                     .c_str());
  if (!fs::exists(folder / "stand")) GTEST_SKIP() << "no network namespaces here: " << text_of(folder / "err.txt");
  EXPECT_EQ(status, 0) << text_of(folder / "err.txt");
  ASSERT_EQ(taut({"ensemble", "posterior", "run", "--members", "40", "-q"}).code, 0);
  EXPECT_EQ(table("together"), table("run"));
  EXPECT_TRUE(fs::exists(folder / "together/ensembles/posterior.rank-3-of-4.csv")) << "it is of the other host";
}

TEST_F(EnsembleCommand, ChartsAreSharedToo) {
  const Outcome part =
      taut({"chart", "stability", "experiment.toml", "--out", "c", "--shard", "1/2", "--budget", "30"});
  EXPECT_EQ(part.code, 0) << part.err;
  EXPECT_TRUE(fs::exists(folder / "c/stability.1-of-2.csv"));
  EXPECT_TRUE(fs::is_empty(folder / "c/figures")) << "a part draws nothing";
  const Outcome sbc = taut({"chart", "sbc", "experiment.toml", "--out", "s", "--budget", "2", "--json", "-q"});
  EXPECT_EQ(sbc.code, 0) << sbc.err;
  EXPECT_GE(Json::parse(sbc.out)["truths"].get<int>(), 1);
  EXPECT_TRUE(fs::exists(folder / "s/figures/sbc.svg"));
}

}  // namespace
}  // namespace taut

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>

#include <algorithm>
#include <chrono>
#include <nlohmann/json.hpp>

#include "sim/mesh/mesh_budget.hpp"
#include "tests/support/command.hpp"

// What no machine can hold, no file has and no bench shows is refused with one sentence, at once.
namespace taut {
namespace {

using namespace test;
namespace fs = std::filesystem;

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define TAUT_SANITIZED 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define TAUT_SANITIZED 1
#endif
#endif

/// A command as a shell starts it, with what it is told before (`ulimit -v 300000`); -1: it did not end.
Outcome by_shell(const TemporaryFolder& folder, const std::string& before, const std::string& arguments,
                 const std::string& after = ">stdout.txt", int seconds = 60) {
  const std::string command = "cd '" + (folder / "") + "' && rm -f stdout.txt && (" + before +
                              "; exec timeout -s KILL " + std::to_string(seconds) + " '" + TAUT_BINARY + "' " +
                              arguments + ") " + after + " 2>stderr.txt";
  const int status = std::system(command.c_str());
  const int code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  return {code == 137 ? -1 : code, text_of(folder / "stdout.txt"), text_of(folder / "stderr.txt")};
}

/// One sentence that begins with the command's name and holds all parts.
void expect_refused(const Outcome& outcome, const std::vector<std::string>& parts, const std::string& what) {
  EXPECT_EQ(outcome.code, 2) << what << ": " << outcome.err;
  EXPECT_TRUE(outcome.err.starts_with("taut: ")) << what << ": " << outcome.err;
  EXPECT_EQ(std::ranges::count(outcome.err, '\n'), 1) << what << ": " << outcome.err;
  for (const std::string& part : parts)
    EXPECT_NE(outcome.err.find(part), std::string::npos) << what << ": " << outcome.err;
}

std::string one_body(const std::string& geometry, const std::string& mesh, int dimension,
                     const std::string& times = "duration = \"0.1 s\"\nstep = \"10 ms\"") {
  std::string text = "title = \"t\"\n[simulation]\n" + times + "\ndimension = " + std::to_string(dimension) + "\n";
  if (dimension == 2) text += "thickness = \"10 mm\"\n";
  for (const char* region : {"foam", "plastic"}) {
    if (region == std::string("plastic") && geometry.find("region") != std::string::npos) continue;
    text += "[materials." + std::string(region) +
            "]\nlaw = \"neo_hookean\"\nE = \"60 kPa\"\nnu = 0.3\ndensity = \"100 kg/m3\"\n";
  }
  return text + "[[body]]\nname = \"a\"\ngeometry = { " + geometry + " }\nmesh = { " + mesh + " }\n";
}

const std::string cube = R"(kind = "box", size = ["10 mm", "10 mm", "10 mm"], region = "foam")";
const std::string square = R"(kind = "rectangle", size = ["10 mm", "10 mm"], region = "foam")";
const std::string cone = R"(kind = "revolved", s = ["0 mm", "100 mm"], radius = ["10 mm", "8 mm"], region = "foam")";
const std::string block =
    R"(kind = "boxes", box = [{ region = "foam", lower = ["0 m", "0 m", "0 m"], upper = ["1 m", "1 m", "1 m"] }])";
const std::string triangle =
    R"(kind = "polygons", polygon = [{ region = "foam", x = ["0 m", "1 m", "1 m"], y = ["0 m", "0 m", "1 m"] }])";

class Limits : public testing::Test {
 protected:
  Outcome checked(const std::string& text) {
    folder.write("x.toml", text);
    return by_shell(folder, "true", "check x.toml");
  }
  TemporaryFolder folder;
};

/// Every geometry, with numbers up to the 32-bit limit: refused before anything is allocated.
TEST_F(Limits, MeshesThatNoMachineHoldsAreRefusedAtOnce) {
  struct Case {
    std::string geometry, mesh;
    int dimension;
    std::string part;
  };
  const std::string fits = "in which about", row = "in a row", most = "a whole number from";
  const std::string module = R"(kind = "push_puppet")", solid_module = R"(kind = "push_puppet_3d")";
  const std::vector<Case> cases{
      {cube, "cells = [1000, 1000, 1000]", 3, fits},
      {cube, "cells = [400, 400, 400], element = \"linear\"", 3, fits},
      {cone, "rings = 1000000", 3, fits},
      {cone, "layers = 999999999", 3, "at most a million"},
      {cone, "rings = 2147483647", 3, most},
      {module, "size = \"1e-6 mm\"", 2, fits},
      {module, "size = \"1e-300 m\"", 2, "too small for a length"},
      {module, "size = \"1.3 mm\", lip_cells = 1000000", 2, fits},
      {module, "size = \"1.3 mm\", lip_cells = 1000000000", 2, fits},
      {module, "size = \"1.3 mm\", lip_cells = 2147483648", 2, most},
      {module + ", cells = 100000, gap_total = \"430 m\"", "size = \"1.3 mm\"", 2, most},
      {module + ", cells = 2147483647", "size = \"1.3 mm\"", 2, most},
      {solid_module, "size = \"1e-3 mm\"", 3, fits},
      {solid_module, "size = \"2 mm\", lip_cells = 1000000", 3, fits},
      {R"(kind = "sheet")", "tile_cells = 1000000", 3, row},
      {R"(kind = "sheet", columns = 1000000000)", "tile_cells = 1", 3, most},
      {R"(kind = "sheet")", "layers = 1000000000", 3, "at most a million"},
      {R"(kind = "twist")", "layers = 1000000", 3, row},
      {R"(kind = "twist", cells = 1000000000)", "layers = 1", 3, most},
      {R"(kind = "twist")", "core_cells = 1000000000", 3, "at most a million"},
      {R"(kind = "finger", segments = 1000000000)", "size = \"3 mm\"", 2, most},
      {R"(kind = "finger")", "size = \"1e-6 mm\"", 2, fits},
      {R"(kind = "disc", radius = "10 mm", region = "foam")", "size = \"1e-7 mm\"", 2, fits},
      {block, "size = \"1e-3 mm\"", 3, fits},
      {triangle, "size = \"1e-6 mm\"", 2, fits},
  };
  const auto begin = std::chrono::steady_clock::now();
  for (const Case& one : cases)
    expect_refused(checked(one_body(one.geometry, one.mesh, one.dimension)), {one.part}, one.geometry + " " + one.mesh);
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(20 * cases.size()));
}

TEST_F(Limits, AMeshThatDoesNotFitSaysHowManyElementsHowMuchMemoryAndWhatWouldFit) {
  const Outcome outcome = checked(one_body(cube, "cells = [1000, 1000, 1000]", 3));
  expect_refused(outcome, {"6.0e+09 quadratic tetrahedra", "GB of memory", "are free, in which about", "times as long"},
                 "cube");
}

TEST_F(Limits, ABenchIsBoundAsASimulationIs) {
  folder.write("bench.csv", beam_csv);
  expect_refused(checked(replaced(beam_toml, "cells = [10, 4]", "cells = [1e9, 4]")), {"from 1 to 1000"}, "cells");
  expect_refused(
      checked(replaced(beam_toml, "[fit.free.E_foam]", "[solver]\nthreads = 1000000000\n\n[fit.free.E_foam]")),
      {"threads", "from 0 to 1024"}, "threads");
}

TEST_F(Limits, StatesThatAreAllKeptHaveToFit) {
  folder.write("x.toml", one_body(square, "cells = [200, 200]", 2, "duration = \"1000 s\"\nstep = \"1 ms\""));
  expect_refused(by_shell(folder, "true", "simulate x.toml --out o --quiet"),
                 {"x.toml: [simulation] duration: 1e+06 steps of", "which are all kept", "make the step longer"},
                 "steps");
  folder.write("x.toml", one_body(square, "cells = [2, 2]", 2, "duration = \"1e9 s\"\nstep = \"1 ms\""));
  expect_refused(by_shell(folder, "true", "check x.toml"), {"steps are too many"}, "more steps");
}

#ifndef TAUT_SANITIZED
/// The estimate against what the system says that a replay took.
TEST_F(Limits, TheMemoryOfEquationsIsEstimatedToAFactorOfThree) {
  folder.write("bench.csv", beam_csv);
  for (const int fineness : {6, 10}) {
    const int nx = 10 * fineness, ny = 4 * fineness;
    folder.write("x.toml", replaced(beam_toml, "cells = [10, 4]",
                                    "cells = [" + std::to_string(nx) + ", " + std::to_string(ny) + "]"));
    const pid_t child = start({"replay", "x.toml", "--quiet", "--threads", "1"}, folder / "");
    int status = 0;
    rusage usage{};
    ASSERT_EQ(wait4(child, &status, 0, &usage), child);
    ASSERT_EQ(status, 0) << text_of(folder / "stderr.txt");
    const bool quadratic = beam_toml.find("linear") == std::string::npos;
    const double nodes = quadratic ? (2.0 * nx + 1) * (2 * ny + 1) : (nx + 1.0) * (ny + 1);
    const double estimate = memory_of_equations(nodes, 2, quadratic ? 2 : 1),
                 peak = 1024 * static_cast<double>(usage.ru_maxrss);
    EXPECT_GT(estimate, (peak - 80e6) / 3) << nodes;  // the program itself takes some 60 MB
    EXPECT_LT(estimate, 3 * peak) << nodes;
  }
}

/// OpenBLAS tries without end to get memory; whatever the limit, the command ends: with its result or "out of memory".
TEST_F(Limits, UnderAnyLimitOfAddressSpaceTheCommandEnds) {
  folder.write("bench.csv", beam_csv);
  folder.write("experiment.toml", replaced(beam_toml, "cells = [10, 4]", "cells = [30, 8]"));
  int done = 0, refused = 0;
  for (const int megabytes : {160, 180, 200, 220, 250, 300, 350, 400, 450, 500, 600, 800, 1200, 3000}) {
    fs::remove_all(folder / "run");
    const Outcome outcome = by_shell(folder, "ulimit -v " + std::to_string(1000 * megabytes),
                                     "fit experiment.toml --no-variants --quiet --out run", ">stdout.txt", 120);
    const std::string said = std::to_string(megabytes) + " MB: " + std::to_string(outcome.code) + " " + outcome.err;
    if (outcome.err.find("error while loading shared libraries") != std::string::npos) continue;  // not even begun
    EXPECT_NE(outcome.code, -1) << "it hangs at " << said;
    EXPECT_LT(outcome.code, 128) << "it crashes at " << said;
    // 3: a part that comes after the fit had no room; 6: gnuplot had none.
    if (outcome.code == 0 || outcome.code == 3 || outcome.code == 6) {
      ++done;
      EXPECT_EQ(nlohmann::json::parse(text_of(folder / "run/fit.json"))["status"], "converged") << said;
    } else {
      ++refused;
      EXPECT_NE(outcome.err.find("memory"), std::string::npos) << said;
    }
  }
  EXPECT_GT(done, 0);
  EXPECT_GT(refused, 0);
}
#endif

/// Folders, pipes, devices, what never ends and what the kernel makes up, wherever a file is read.
TEST_F(Limits, WhatIsNoFileIsRefusedByItsKind) {
  folder.write("bench.csv", beam_csv);
  folder.write("experiment.toml", beam_toml);
  ASSERT_EQ(mkfifo((folder / "pipe").c_str(), 0600), 0);
  fs::create_directory(folder / "folder");
  ASSERT_EQ(by_shell(folder, "true", "fit experiment.toml --no-variants --quiet --out run").code, 0);
  const std::string mesh =
      one_body(R"(kind = "msh", file = "FILE", unit = "mm", dimension = 2)", "element = \"linear\"", 2);
  fs::create_directory(folder / "other");
  const std::vector<std::pair<std::string, std::string>> kinds{{"/dev/zero", "is a device"},
                                                               {"/dev/null", "is a device"},
                                                               {"folder", "folder"},
                                                               {"pipe", "is a pipe"},
                                                               {"/proc/self/mem", "the system makes up"},
                                                               {"/proc/self/environ", "the system makes up"}};
  for (const auto& [path, kind] : kinds) {
    expect_refused(by_shell(folder, "true", "check " + path), {kind}, "experiment " + path);
    folder.write("x.toml", replaced(beam_toml, "\"bench.csv\"", "\"" + path + "\""));
    expect_refused(by_shell(folder, "true", "check x.toml"), {kind}, "bench " + path);
    folder.write("x.toml", replaced(mesh, "FILE", path));
    expect_refused(by_shell(folder, "true", "check x.toml"), {kind}, "mesh " + path);
    expect_refused(by_shell(folder, "true", "predict run --rows " + path), {kind}, "rows " + path);
    fs::remove(folder / "other/fit.json");
    fs::create_symlink(path[0] == '/' ? path : folder / path, folder / "other/fit.json");
    expect_refused(by_shell(folder, "true", "report other"), {kind}, "fit.json " + path);
  }
  // Larger than anything that could be read, without a byte on the disk.
  ASSERT_EQ(std::system(("truncate -s 1T '" + (folder / "huge.csv") + "'").c_str()), 0);
  folder.write("x.toml", replaced(beam_toml, "\"bench.csv\"", "\"huge.csv\""));
  expect_refused(by_shell(folder, "true", "check x.toml"), {"huge.csv: holds", "at most"}, "a huge file");
}

TEST_F(Limits, LengthsDirectionsReadingsAndNodesOfNoWorldAreRefused) {
  folder.write("bench.csv", beam_csv);
  const std::string size = "size = [\"60 mm\", \"12 mm\"]";
  EXPECT_NE(beam_toml.find("direction = [0, -1]"), std::string::npos);
  std::string text = beam_toml;
  text.replace(text.find("direction = [0, -1]"), 19, "direction = [1e308, -1e308]");
  expect_refused(checked(text), {"direction", "no component of a direction"}, "direction");
  text = one_body(R"(kind = "rectangle", size = ["1e-300 m", "1e-300 m"], region = "foam")", "cells = [2, 2]", 2);
  expect_refused(checked(text), {"size: 1e-300 m is too small for a length", "from 1e-12 to 1e+06 m"}, "size");
  folder.write("bench.csv", beam_csv + "b,0.2,1e9\n");
  expect_refused(checked(beam_toml), {"bench", "'tip' reads 1000 km", "a thousand times"}, "reading");
  folder.write("m.msh",
               "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n2 2 \"foam\"\n$EndPhysicalNames\n$Nodes\n3\n"
               "1 0 0 2e9\n2 10 0 0\n3 10 10 0\n$EndNodes\n$Elements\n1\n1 2 2 2 1 1 2 3\n$EndElements\n");
  text = one_body(R"(kind = "msh", file = "m.msh", unit = "mm", dimension = 2)", "element = \"linear\"", 2);
  expect_refused(checked(text), {"m.msh:10: node 1 has a coordinate of 2e+06 m"}, "node");
}

/// What a command is there for is lost with its standard output: that is an error.
TEST_F(Limits, ALostStandardOutputIsAnErrorOfEveryCommand) {
  folder.write("bench.csv", beam_csv);
  folder.write("experiment.toml", beam_toml);
  ASSERT_EQ(by_shell(folder, "true", "fit experiment.toml --no-variants --quiet --out run").code, 0);
  fs::copy_file(folder / "bench.csv", folder / "rows.csv");
  for (const char* command :
       {"--help", "--version", "help init", "help man", "check experiment.toml", "schema experiment",
        "replay experiment.toml --out r", "predict run --rows rows.csv", "report run"}) {
    for (const char* where : {">/dev/full", ">&-"}) {
      const Outcome outcome = by_shell(folder, "true", command, where);
      EXPECT_EQ(outcome.code, 2) << command << where << outcome.err;
      EXPECT_NE(outcome.err.find("standard output"), std::string::npos) << command << where << outcome.err;
    }
  }
}

/// RLIMIT_FSIZE: a write that is cut off names itself, and no signal ends the command.
TEST_F(Limits, AFileThatMayNotGrowIsNamed) {
  folder.write("bench.csv", beam_csv);
  folder.write("experiment.toml", beam_toml);
  const Outcome outcome = by_shell(folder, "ulimit -f 4", "fit experiment.toml --no-variants --quiet --out run");
  EXPECT_EQ(outcome.code, 2) << outcome.err;
  EXPECT_NE(outcome.err.find("cannot be written (File too large)"), std::string::npos) << outcome.err;
}

/// Figures are the last and least of a run.
TEST_F(Limits, AMissingHangingOrFailingGnuplotCostsTheFiguresOnly) {
  folder.write("bench.csv", beam_csv);
  folder.write("experiment.toml", beam_toml);
  fs::create_directory(folder / "bin");
  const std::string fit = "fit experiment.toml --no-variants --quiet --out run";
  const Outcome drawn = by_shell(folder, "true", fit);
  ASSERT_EQ(drawn.code, 0) << drawn.err;
  for (const auto& [script, said] : {std::pair<std::string, std::string>{"sleep 1000", "did not end within 1 s"},
                                     {"exit 1", "gnuplot failed"},
                                     {"", "was not found"}}) {
    folder.write("bin/gnuplot", "#!/bin/sh\n" + script + "\n");
    fs::permissions(folder / "bin/gnuplot", script.empty() ? fs::perms::owner_read : fs::perms::owner_all);
    const std::string path = script.empty() ? "PATH=/nonexistent" : "PATH=\"$PWD/bin:$PATH\"";
    fs::remove_all(folder / "run");
    const std::string command = "cd '" + (folder / "") + "' && export TAUT_GNUPLOT_TIMEOUT=1 " + path + "; exec '" +
                                TAUT_BINARY + "' " + fit + " >stdout.txt 2>stderr.txt";
    const int status = std::system(command.c_str());
    const std::string err = text_of(folder / "stderr.txt");
    EXPECT_EQ(WEXITSTATUS(status), 6) << said << err;
    EXPECT_NE(err.find(said), std::string::npos) << err;
    EXPECT_EQ(text_of(folder / "stdout.txt"), drawn.out) << "the answer is the same";
    EXPECT_TRUE(fs::exists(folder / "run/report.html"));
    EXPECT_EQ(nlohmann::json::parse(text_of(folder / "run/fit.json"))["status"], "converged");
  }
}

/// Processes whose command line holds a text, of any user.
int processes_with(const std::string& text) {
  int found = 0;
  for (const fs::directory_entry& entry : fs::directory_iterator("/proc")) {
    const std::string name = entry.path().filename();
    if (!std::ranges::all_of(name, [](char c) { return c >= '0' && c <= '9'; })) continue;
    found += text_of(entry.path() / "cmdline").find(text) != std::string::npos;
  }
  return found;
}

/// Twice means at once, and gnuplot ends with it.
TEST_F(Limits, ASecondSignalEndsTheCommandAndItsChildren) {
  folder.write("bench.csv", beam_csv);
  folder.write("experiment.toml", beam_toml);
  fs::create_directory(folder / "bin");
  const std::string mark = folder / "bin/gnuplot";
  folder.write("bin/gnuplot", "#!/bin/sh\ntouch '" + (folder / "drawing") + "'\nwhile :; do sleep 0.05; done\n");
  fs::permissions(mark, fs::perms::owner_all);
  const std::string path = std::getenv("PATH");
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    fs::remove(folder / "drawing");
    setenv("PATH", ((folder / "bin") + ":" + path).c_str(), 1);
    const pid_t child = start({"fit", "experiment.toml", "--no-variants", "--quiet", "--out", "run"}, folder / "");
    setenv("PATH", path.c_str(), 1);
    for (int i = 0; i < 6000 && !fs::exists(folder / "drawing"); ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    ASSERT_TRUE(fs::exists(folder / "drawing"));
    kill(child, signal);
    std::this_thread::sleep_for(std::chrono::milliseconds(400));  // two at once are one
    const auto begin = std::chrono::steady_clock::now();
    kill(child, signal);
    EXPECT_EQ(finish(child, folder / "").code, 130);
    EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(5));
    for (int i = 0; i < 300 && processes_with(mark) > 0; ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    EXPECT_EQ(processes_with(mark), 0) << "its gnuplot is left over";
  }
}

}  // namespace
}  // namespace taut

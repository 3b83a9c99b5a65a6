#include "sim/mesh/mesh_budget.hpp"

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>

#include "sim/core/memory_budget.hpp"
#include "sim/mesh/structured.hpp"
#include "tests/support/message.hpp"

namespace taut {
namespace {

using test::expect_input_error;

TEST(MemoryBudget, WhatUlimitLeavesOfTheAddressSpaceIsTheMost) {
  const pid_t child = fork();
  if (child == 0) {
    const double before = available_memory();
    rlimit large{}, small{};
    getrlimit(RLIMIT_AS, &large);
    small = large;
    small.rlim_cur = 1 << 20;
    // Far beyond any machine: nothing changes. Where the tests run under a limit, that stays.
    large.rlim_cur = std::min(large.rlim_cur, rlim_t{1} << 46);
    setrlimit(RLIMIT_AS, &large);
    const bool same = std::abs(available_memory() / before - 1) < 0.2;
    setrlimit(RLIMIT_AS, &small);  // less than what is taken already
    _exit(same && available_memory() == 0 ? 0 : 1);
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
}

TEST(MemoryBudget, BytesAreSaidInUnitsThatPeopleKnow) {
  EXPECT_EQ(in_bytes(1.5e6), "1.5 MB");
  EXPECT_EQ(in_bytes(3.21e9), "3.2 GB");
  EXPECT_EQ(in_bytes(25e9), "25 GB");
  EXPECT_EQ(in_bytes(1e20), "1.0e+11 GB");
  expect_input_error([] { require_memory(1e20, "it takes", "take less"); },
                     {"it takes about 1.0e+11 GB of memory", "are free; take less"});
  EXPECT_NO_THROW(require_memory(1, "it takes", "take less"));
}

/// Nested dissection: N log N in the plane, N^(4/3) in space, from some size on.
TEST(MeshBudget, MemoryGrowsAsTheFillOfNestedDissection) {
  EXPECT_NEAR(memory_of_equations(8e12, 3, 2) / memory_of_equations(1e12, 3, 2), std::pow(8, 4.0 / 3), 0.1);
  EXPECT_NEAR(memory_of_equations(2e12, 2, 2) / memory_of_equations(1e12, 2, 2), 2 * (1 + 1 / std::log2(1e12)), 0.05);
}

TEST(MeshBudget, CountsThatOverflowAnIntAreComparedBeforeTheyDo) {
  for (const double elements : {2147483647.0, 2147483648.0, 4294967296.0, 1e18, 1e300}) {
    for (const int dimension : {2, 3})
      expect_input_error([&] { require_mesh(elements, dimension, 2); }, {"the mesh would have about", "fit"});
  }
  EXPECT_NO_THROW(require_mesh(1000, 3, 2));
  std::vector<double> line(1, 0.0);
  expect_input_error([&] { step_to(line, 1, 2147483647); }, {"elements in a row"});
  expect_input_error([] { graded(1, 2147483647); }, {"elements in a row"});
  expect_input_error([] { cells_along(1, 1e-300); }, {"elements in a row"});
  expect_input_error([] { cells_along(1, 0); }, {"elements in a row"});
  EXPECT_EQ(cells_along(1, 0.1), 10);
  // 32768^2 grid points times two coordinates are 2^31.
  std::vector<double> x{0.0};
  step_to(x, 1, 32767);
  expect_input_error([&] { rectangle(x, x, 1, "a"); }, {"2.1e+09 linear triangles"});
}

}  // namespace
}  // namespace taut

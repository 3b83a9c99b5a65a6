#include "sim/mesh/loops.hpp"

#include <gtest/gtest.h>

#include <algorithm>

#include "sim/mesh/structured.hpp"
#include "sim/shapes/push_puppet.hpp"
#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"

namespace taut {
namespace {

using namespace test;

/// Area inside a loop of nodes, positive when it runs anticlockwise.
double area_of(const Mesh& mesh, const std::vector<int>& loop) {
  double sum = 0;
  for (size_t i = 0; i < loop.size(); ++i) {
    const Eigen::Vector2d a = mesh.node(loop[i]), b = mesh.node(loop[(i + 1) % loop.size()]);
    sum += 0.5 * (a.x() * b.y() - a.y() * b.x());
  }
  return sum;
}

TEST(RegionLoops, RunAnticlockwiseAroundTheRegionAndClockwiseAroundHoles) {
  for (int order : {1, 2}) {
    Mesh mesh = rectangle(graded(0.05, 5), graded(0.03, 3), order, "all");
    assign_regions(mesh, [](const Eigen::VectorXd& c) {
      return std::abs(c[0] - 0.025) < 0.015 && std::abs(c[1] - 0.015) < 0.005 ? "core" : "frame";
    });
    const auto frame = region_loops(mesh, mesh.region_index("frame"));
    const auto core = region_loops(mesh, mesh.region_index("core"));
    ASSERT_EQ(frame.size(), 2u);
    ASSERT_EQ(core.size(), 1u);
    std::vector<double> areas{area_of(mesh, frame[0]), area_of(mesh, frame[1])};
    std::sort(areas.begin(), areas.end());
    EXPECT_NEAR(areas[0], -3e-4, 1e-15);
    EXPECT_NEAR(areas[1], 15e-4, 1e-15);
    EXPECT_NEAR(area_of(mesh, core[0]), 3e-4, 1e-15);
    EXPECT_EQ(core[0].size(), 8u * static_cast<size_t>(order));
  }
}

TEST(RegionLoops, OfAModuleEncloseItsAreas) {
  const Mesh mesh = mesh_push_puppet({}, {2e-3, 2, 2});
  for (const std::string& region : mesh.region_names) {
    const auto loops = region_loops(mesh, mesh.region_index(region));
    EXPECT_EQ(loops.size(), region == "foam" ? 4u : 5u);  // foam cells; plates and webs with their lips
    double sum = 0;
    for (const std::vector<int>& loop : loops) sum += area_of(mesh, loop);
    EXPECT_NEAR(sum, total_measure(mesh, region), 1e-15);
  }
}

TEST(RegionLoops, AreRefusedIn3D) {
  const Mesh mesh = box({0, 1}, {0, 1}, {0, 1}, 1, "body");
  expect_input_error([&] { region_loops(mesh, 0); }, {"2D", "3D"});
}

}  // namespace
}  // namespace taut

#include "sim/shapes/twist.hpp"

#include <gtest/gtest.h>

#include <numbers>

#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"

namespace taut {
namespace {

using namespace test;

TEST(TwistModule, VolumesOfFoamAndPlasticAreThoseOfTheDrawing) {
  for (int order : {1, 2}) {
    const TwistModule m;
    const Mesh mesh = m.mesh({.counts = {{"core_cells", 2}}, .order = order}, false, false);
    mesh.check("twist");
    EXPECT_EQ(order_of(mesh.shape), order);
    EXPECT_NEAR(total_measure(mesh, "foam"), 4 * 30e-3 * 30e-3 * 10e-3, 1e-16);
    const double frame = 42e-3 * 42e-3 - 34e-3 * 34e-3;
    EXPECT_NEAR(total_measure(mesh, "plastic"), 5 * 42e-3 * 42e-3 * 3e-3 + 8 * frame * 3e-3, 1e-16);
    for (const char* end : {"base", "tip"}) {
      EXPECT_NEAR(size_of(mesh, mesh.select(end)), 42e-3 * 42e-3, 1e-15);
      for (int node : mesh.select(end).nodes())
        EXPECT_NEAR(mesh.node(node)[2], end == std::string("tip") ? 55e-3 : 0, 1e-15);
    }
    // Closed: what the boundary encloses is what the elements fill.
    EXPECT_NEAR(enclosed_measure(mesh, boundary(mesh)), total_measure(mesh), 1e-15);
  }
}

TEST(TwistModule, RimsStandFreeOfTheCoreAndOfEachOther) {
  const Mesh mesh = TwistModule().mesh({.order = 1}, false, false);
  for (int e = 0; e < mesh.element_count(); ++e) {
    Eigen::Vector3d c = Eigen::Vector3d::Zero();
    for (int a = 0; a < 4; ++a) c += mesh.node(mesh.element(e)[a]) / 4;
    const double side = std::max(std::abs(c[0]), std::abs(c[1])), above = std::fmod(c[2], 13e-3) - 3e-3;
    if (above < 0) continue;
    EXPECT_FALSE(side > 15e-3 && side < 17e-3) << "between core and rim";
    EXPECT_FALSE(side > 15e-3 && above > 3e-3 && above < 7e-3) << "between two rims";
  }
}

TEST(TwistModule, CablesAreHelicesThroughThePlates) {
  const TwistModule m;
  const Mesh mesh = m.mesh({.order = 1}, false, false);
  for (int handedness : {1, -1}) {
    for (int cable = 0; cable < m.cables; ++cable) {
      const auto path = cable_path(m, cable, handedness);
      ASSERT_EQ(path.size(), 10u);
      for (size_t k = 0; k < path.size(); ++k) {
        EXPECT_NO_THROW(locate(mesh, path[k]));
        EXPECT_NEAR(path[k].head<2>().norm(), m.cable_radius, 1e-15);
        const size_t cell = k / 2;
        EXPECT_NEAR(path[k][2], 13e-3 * static_cast<double>(cell) + (k % 2 == 1 ? 3e-3 : 0), 1e-15);
        if (k < 2) continue;
        const Eigen::Vector3d &one = path[k - 2], &two = path[k];
        EXPECT_NEAR(std::atan2(one[0] * two[1] - one[1] * two[0], one.head<2>().dot(two.head<2>())),
                    handedness * m.cable_turn, 1e-12);
      }
    }
  }
  // The cables of one handedness are each other's quarter turns, those of the other their mirror images.
  const auto right = cable_path(m, 0, 1), left = cable_path(m, 0, -1), next = cable_path(m, 1, 1);
  for (size_t k = 0; k < right.size(); ++k) {
    EXPECT_NEAR((next[k] - Eigen::Vector3d(-right[k][1], right[k][0], right[k][2])).norm(), 0, 1e-15);
    EXPECT_NEAR((left[k] - Eigen::Vector3d(right[k][0], -right[k][1], right[k][2])).norm(), 0, 1e-15);
  }
}

TEST(TwistModule, WhatMakesNoModuleIsRefused) {
  TwistModule m;
  m.plate_width = 37e-3;
  expect_input_error([&] { m.mesh({.order = 1}, false, false); }, {"twist module", "37 mm", "widen the plates"});
  m = {};
  m.rim_gap = 10e-3;
  expect_input_error([&] { m.mesh({.order = 1}, false, false); }, {"rim_gap", "cell_length"});
  m = {};
  m.cells = 0;
  expect_input_error([&] { m.mesh({.order = 1}, false, false); }, {"cells is 0"});
  m = {};
  m.cable_turn = 0.5;
  expect_input_error([&] { cable_path(m, 0, 1); }, {"cable 0 cuts through the core", "turn it less"});
  m.cable_radius = 22e-3;
  m.cable_turn = std::numbers::pi / 4;
  expect_input_error([&] { cable_path(m, 0, 1); }, {"cable 0"});
  m = {};
  expect_input_error([&] { cable_path(m, 4, 1); }, {"no cable 4"});
  expect_input_error([&] { cable_path(m, 0, 2); }, {"handedness 2"});
}

}  // namespace
}  // namespace taut

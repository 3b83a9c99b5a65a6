#include "sim/shapes/sheet.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/support/mesh_checks.hpp"
#include "tests/support/message.hpp"

namespace taut {
namespace {

using namespace test;

TEST(Sheet, VolumesOfFoamAndPlasticAreThoseOfTheDrawing) {
  for (int order : {1, 2}) {
    const Sheet s;
    const Mesh mesh = s.mesh({.order = order}, false, false);
    mesh.check("sheet");
    EXPECT_NEAR(s.length(), 120e-3, 1e-15);
    EXPECT_NEAR(s.width(), 70e-3, 1e-15);
    EXPECT_NEAR(total_measure(mesh), 120e-3 * 70e-3 * 4e-3, 1e-17);
    EXPECT_NEAR(total_measure(mesh, "plastic"), 15 * 20e-3 * 20e-3 * 4e-3, 1e-17);
    EXPECT_NEAR(size_of(mesh, mesh.select("base")), 70e-3 * 4e-3, 1e-16);
    EXPECT_NEAR(size_of(mesh, mesh.select("upper")), 70e-3 * 120e-3, 1e-15);
    for (int node : mesh.select("tip").nodes()) EXPECT_NEAR(mesh.node(node)[0], 120e-3, 1e-15);
    for (int node : mesh.select("lower").nodes()) EXPECT_NEAR(mesh.node(node)[2], -2e-3, 1e-15);
  }
}

TEST(Sheet, LipsReachOverTheFoamUpToTheirGap) {
  for (int order : {1, 2}) {
    Sheet s;
    s.lip_gap = 1e-3;
    const Mesh mesh = s.mesh({.order = order}, false, false);
    mesh.check("sheet");
    const double lip = 2e-3, tiles = 15 * 20e-3 * 20e-3;
    EXPECT_NEAR(s.lip(), lip, 1e-15);
    const double frames = (5 * 20e-3 + 8 * lip) * (3 * 20e-3 + 4 * lip) - tiles;
    EXPECT_NEAR(total_measure(mesh, "plastic"), tiles * 4e-3 + frames * 1e-3, 1e-16);
    EXPECT_NEAR(total_measure(mesh, "foam"), (120e-3 * 70e-3 - tiles) * 2e-3, 1e-16);
    EXPECT_NEAR(size_of(mesh, mesh.select("upper")), tiles + frames, 1e-15);
    // Leant faces: what is left of the lips at each height, by Simpson's rule, which is exact.
    s.lip_angle = 0.4;
    const auto area = [&](double l) { return (5 * 20e-3 + 8 * l) * (3 * 20e-3 + 4 * l) - tiles; };
    const double top = lip - std::tan(0.2) * 1e-3, left = (area(lip) + 4 * area(0.5 * (lip + top)) + area(top)) / 6;
    const Mesh leant = s.mesh({.order = order}, false, false);
    leant.check("leant");
    EXPECT_NEAR(total_measure(leant, "plastic"), tiles * 4e-3 + left * 1e-3, 1e-16);
    EXPECT_NEAR(size_of(leant, leant.select("upper")), tiles + area(top), 1e-15);
    s.foam_thickness = 3e-3;  // up to the lips
    EXPECT_NEAR(total_measure(s.mesh({}, false, false), "foam"), (120e-3 * 70e-3 - tiles) * 3e-3, 1e-16);
  }
}

TEST(Sheet, CablesRunThroughTheTilesOfARow) {
  const Sheet s;
  const Mesh mesh = s.mesh({}, false, false);
  for (int row = 0; row < s.rows; ++row) {
    const auto path = cable_path(s, row, 1.2e-3);
    ASSERT_EQ(path.size(), 10u);
    for (size_t k = 0; k < path.size(); ++k) {
      EXPECT_NO_THROW(locate(mesh, path[k]));
      const size_t tile = k / 2;
      EXPECT_NEAR(path[k][0], 25e-3 * static_cast<double>(tile) + (k % 2 == 1 ? 20e-3 : 0), 1e-15);
      EXPECT_NEAR(path[k][1], 10e-3 + 25e-3 * row, 1e-15);
      EXPECT_EQ(path[k][2], 1.2e-3);
    }
  }
}

TEST(Sheet, WhatMakesNoSheetIsRefused) {
  Sheet s;
  expect_input_error([&] { cable_path(s, 3, 0); }, {"no row 3"});
  expect_input_error([&] { cable_path(s, 0, 2.5e-3); }, {"2.5 mm", "2 mm"});
  expect_input_error([&] { s.mesh({.counts = {{"tile_cells", 0}}}, false, false); }, {"tile_cells is 0"});
  Sheet lips;
  lips.lip_gap = 5e-3;
  expect_input_error([&] { lips.check(); }, {"lip_gap of 5 mm", "strips of 5 mm"});
  lips.lip_gap = 1e-3;
  lips.lip_angle = 2.5;
  expect_input_error([&] { lips.check(); }, {"lips of 2 mm", "1 mm", "lip_angle"});
  lips.lip_angle = 0;
  lips.foam_thickness = 3.5e-3;
  expect_input_error([&] { lips.check(); }, {"foam_thickness 3.5 mm", "lip_thickness 1 mm", "thickness 4 mm"});
  s.strip = 0;
  expect_input_error([&] { s.mesh({}, false, false); }, {"strip", "positive"});
}

}  // namespace
}  // namespace taut

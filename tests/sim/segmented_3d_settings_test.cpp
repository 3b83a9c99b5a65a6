#include <gtest/gtest.h>

#include "sim/files/simulation.hpp"
#include "sim/robots/simulation.hpp"
#include "sim/shapes/sheet.hpp"
#include "sim/shapes/twist.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"

namespace taut {
namespace {

using namespace test;

const std::string scene_toml = R"(title = "Two bodies"
[simulation]
integrator = "static"
dimension = 3
duration = "1 s"
step = "1 s"

[[body]]
name = "module"
geometry = { kind = "twist", cells = 2, cables = 2, cell_length = "9 mm", cable_turn = "10 deg" }
mesh = { core_cells = 3, layers = 2, element = "linear" }

[[body]]
name = "sheet"
geometry = { kind = "sheet", rows = 2, tile = "12 mm", cable_height = "1 mm" }
mesh = { tile_cells = 2, strip_cells = 3 }
at = ["200 mm", "0 mm", "0 mm"]

[materials.foam]
law = "neo_hookean"
E = "60 kPa"
nu = 0.2
)";

Simulation read(const std::string& toml) {
  const TemporaryFolder folder;
  return read_simulation(folder.write("experiment.toml", toml));
}

TEST(Segmented3dSettings, KeysAreTheMembersNames) {
  const Simulation simulation = read(scene_toml);
  const BodySettings &module = simulation.bodies[0], &sheet = simulation.bodies[1];
  EXPECT_EQ(module.geometry.as<TwistModule>().cells, 2);
  EXPECT_DOUBLE_EQ(module.geometry.as<TwistModule>().cell_length, 9e-3);
  EXPECT_DOUBLE_EQ(module.geometry.as<TwistModule>().cable_turn, 10 * M_PI / 180);
  EXPECT_EQ(module.geometry.as<TwistModule>().rim_width, TwistModule().rim_width) << "what is left out";
  EXPECT_EQ(sheet.geometry.as<Sheet>().rows, 2);
  EXPECT_DOUBLE_EQ(sheet.geometry.as<Sheet>().tile, 12e-3);
  const MeshSettings coarse{.counts = {{"core_cells", 3}, {"layers", 2}}, .order = 1};
  const Mesh expected = module.geometry.as<TwistModule>().mesh(coarse, false, false);
  EXPECT_EQ(make_mesh(module.geometry, module.mesh, true, true).X, expected.X);
  const MeshSettings fine{.counts = {{"tile_cells", 2}, {"strip_cells", 3}, {"layers", 1}}, .order = 2};
  const Mesh tiles = sheet.geometry.as<Sheet>().mesh(fine, false, false);
  EXPECT_EQ(make_mesh(sheet.geometry, sheet.mesh, true, true).X, tiles.X);
}

TEST(Segmented3dSettings, CablesAreCalledByHandAndByRow) {
  const Simulation simulation = read(scene_toml);
  const GeometrySettings &module = simulation.bodies[0].geometry, &sheet = simulation.bodies[1].geometry;
  EXPECT_EQ(own_cable(module, "right_2")[5], cable_path(module.as<TwistModule>(), 1, 1)[5]);
  EXPECT_EQ(own_cable(module, "left_1")[5], cable_path(module.as<TwistModule>(), 0, -1)[5]);
  EXPECT_EQ(own_cable(sheet, "row_2")[3], cable_path(sheet.as<Sheet>(), 1, 1e-3)[3]);
  expect_input_error([&] { own_cable(module, "right_3"); }, {"'right_3'", "allowed: right_1, right_2, left_1, left_2"});
  expect_input_error([&] { own_cable(sheet, "row_3"); }, {"'row_3'", "allowed: row_1, row_2"});
}

TEST(Segmented3dSettings, WrongKeysAreRefusedWithTheirLine) {
  expect_input_error([&] { read(replaced(scene_toml, "tile = ", "tyle = ")); },
                     {":15:", "tyle", "did you mean 'tile'"});
  expect_input_error([&] { read(replaced(scene_toml, "core_cells = 3", "core_cells = 0")); }, {":11:", "core_cells"});
  expect_input_error([&] { read(replaced(scene_toml, "core_cells = 3", "size = \"2 mm\"")); }, {":11:", "size"});
  expect_input_error([&] { read(replaced(scene_toml, "\"9 mm\"", "\"3 mm\"")); }, {":10:", "rim_gap 4 mm"});
}

}  // namespace
}  // namespace taut

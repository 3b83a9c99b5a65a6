#include <gtest/gtest.h>

#include "calib/files/experiment.hpp"
#include "sim/shapes/push_puppet.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"

namespace taut {
namespace {

using namespace test;

/// The small beam's file with a push-puppet module and these further keys of [geometry].
std::string module_toml(const std::string& keys) {
  std::string text = replaced(beam_toml, "kind = \"rectangle\"\nsize = [\"60 mm\", \"12 mm\"]\nregion = \"foam\"\n",
                              "kind = \"push_puppet\"\n" + keys);
  text = replaced(text, "cells = [10, 4]", "size = \"2 mm\"");
  text = replaced(text, "on = \"xmin\"", "on = \"base\"");
  return text + "\n[materials.plastic]\nE = \"2.3 GPa\"\nnu = 0.35\n";
}

PushPuppet module_with(const std::string& keys) {
  const TemporaryFolder folder;
  return read_experiment(folder.write("module.toml", module_toml(keys))).geometry.as<PushPuppet>();
}

TEST(PushPuppetSettings, KeysLeftOutAreTheReferenceModule) {
  const PushPuppet module = module_with(""), reference;
  EXPECT_EQ(module.cells, reference.cells);
  EXPECT_EQ(module.cell_length, reference.cell_length);
  EXPECT_EQ(module.gap_total, reference.gap_total);
  EXPECT_EQ(module.stud_length, 0.0);
}

TEST(PushPuppetSettings, EveryKeyIsReadWithItsUnit) {
  const PushPuppet module = module_with(
      "cells = 3\ncell_length = \"1.2 cm\"\ncore_height = \"28 mm\"\nweb_thickness = \"2.5 mm\"\n"
      "plate_thickness = \"4 mm\"\nclearance = \"1.5 mm\"\nlip_thickness = \"5 mm\"\nlip_relief = \"0.6 mm\"\n"
      "gap_total = \"12 mm\"\ncable_offset = \"18 mm\"\nvia_inset = \"0.4 mm\"\nstud_length = \"1 mm\"\n"
      "stud_thickness = \"1.4 mm\"\nstud_play = \"0.15 mm\"\n");
  EXPECT_EQ(module.cells, 3);
  EXPECT_DOUBLE_EQ(module.cell_length, 12e-3);
  EXPECT_DOUBLE_EQ(module.core_height, 28e-3);
  EXPECT_DOUBLE_EQ(module.web_thickness, 2.5e-3);
  EXPECT_DOUBLE_EQ(module.plate_thickness, 4e-3);
  EXPECT_DOUBLE_EQ(module.clearance, 1.5e-3);
  EXPECT_DOUBLE_EQ(module.lip_thickness, 5e-3);
  EXPECT_DOUBLE_EQ(module.lip_relief, 0.6e-3);
  EXPECT_DOUBLE_EQ(module.gap_total, 12e-3);
  EXPECT_DOUBLE_EQ(module.cable_offset, 18e-3);
  EXPECT_DOUBLE_EQ(module.via_inset, 0.4e-3);
  EXPECT_DOUBLE_EQ(module.stud_length, 1e-3);
  EXPECT_DOUBLE_EQ(module.stud_thickness, 1.4e-3);
  EXPECT_DOUBLE_EQ(module.stud_play, 0.15e-3);
}

TEST(PushPuppetSettings, NumbersThatClashAreRefusedWithFileAndLine) {
  const auto refused = [](const std::string& keys, std::vector<std::string> parts) {
    parts.insert(parts.end(), {"module.toml:", "[geometry]"});
    expect_input_error([&] { module_with(keys); }, parts);
  };
  refused("gap_total = \"60 mm\"\n", {"gap_total 60 mm", "cell_length is 11.5 mm", "smaller than 46 mm"});
  refused("cable_offset = \"10 mm\"\n", {"cable_offset 10 mm", "17.5 mm to 20.5 mm"});
  refused("cells = 0\n", {"cells", "at least 1"});
  refused("clearance = \"0 mm\"\n", {"clearance is 0 mm", "positive"});
  refused("cell_length = \"2 kg\"\n", {"cell_length", "kg"});
  refused("gap_totall = \"2 mm\"\n", {"gap_totall", "did you mean 'gap_total'"});
}

}  // namespace
}  // namespace taut

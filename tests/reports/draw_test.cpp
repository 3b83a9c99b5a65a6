#include "reports/draw.hpp"

#include <gtest/gtest.h>

#include <filesystem>

#include "calib/benches/static_replay.hpp"
#include "reports/dimensions.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"

namespace taut {
namespace {

using namespace test;

class DrawTest : public testing::Test {
 protected:
  Figure draw(const std::string& toml) {
    const Experiment experiment = read_experiment(folder_.write("experiment.toml", toml));
    return draw_experiment(experiment, make_mesh(experiment, experiment.mesh), folder_ / "run");
  }
  std::string csv() const { return text_of(folder_ / "run/figures/drawing.csv"); }

  TemporaryFolder folder_;
};

std::string module_toml(const std::string& more) {
  std::string text = replaced(beam_toml, "kind = \"rectangle\"\nsize = [\"60 mm\", \"12 mm\"]\nregion = \"foam\"\n",
                              "kind = \"push_puppet\"\n" + more);
  text = replaced(text, "cells = [10, 4]", "size = \"2 mm\"");
  text = replaced(text, "on = \"xmin\"", "on = \"base\"");
  for (int i = 0; i < 2; ++i) text.replace(text.find("on = \"xmax\""), 11, "on = \"tip\"");
  return text + "\n[materials.plastic]\nE = \"2.3 GPa\"\nnu = 0.35\n\n[cables]\nk = \"20 kN/m\"\n";
}

TEST_F(DrawTest, APlaneSpecimenGetsItsOverallDimensionsInEveryFormat) {
  const Figure figure = draw(beam_toml);
  EXPECT_EQ(figure.name, "drawing");
  for (const char* format : {"svg", "pdf", "png", "csv", "gp"}) {
    EXPECT_GT(std::filesystem::file_size(folder_ / (std::string("run/figures/drawing.") + format)), 100u) << format;
  }
  for (const char* text :
       {"60 mm", "12 mm", "20 mm thick", "xmin, fixed in x, y", "pull on xmax", "tip, mean of xmax"}) {
    EXPECT_NE(figure.svg.find(text), std::string::npos) << text;
  }
  EXPECT_NE(csv().find("outline,foam,1,"), std::string::npos);
  EXPECT_NE(csv().find("dimension,60 mm,,,,60"), std::string::npos) << csv();
}

TEST_F(DrawTest, AModuleGetsEveryLengthAndItsCables) {
  const Figure figure = draw(module_toml("stud_length = \"1.2 mm\"\nstud_thickness = \"1.2 mm\"\n"));
  for (const char* text :
       {"4 cells",       "17.2 mm in all", "cell 11.5 mm",  "core 55 mm",        "total 61 mm",      "height 42 mm",
        "gap 4.3 mm",    "web 3 mm",       "plate 3 mm",    "core 30 mm",        "cable 19 mm",      "left lip 3.6 mm",
        "left lip 3 mm", "right lip 4 mm", "relief 0.5 mm", "clearance 2 mm",    "via inset 0.5 mm", "stud 1.2 mm",
        "groove 1.4 mm", "groove 1.6 mm",  "upper, lower",  "end fixed in space"}) {
    EXPECT_NE(figure.svg.find(text), std::string::npos) << text;
  }
  EXPECT_NE(csv().find("cable,upper,"), std::string::npos);
  EXPECT_NE(csv().find("dimension,via inset 0.5 mm,,,,0.5"), std::string::npos);
}

TEST_F(DrawTest, ModulesOfOneAndManyCellsAreDrawnToo) {
  EXPECT_EQ(draw(module_toml("cells = 1\ngap_total = \"4 mm\"\n")).svg.find("web"), std::string::npos);
  EXPECT_NE(draw(module_toml("cells = 9\ngap_total = \"30 mm\"\n")).svg.find("gap 3.333 mm"), std::string::npos);
}

TEST_F(DrawTest, ThreeDimensionsAreRefusedWithWhatToDoInstead) {
  std::string text = replaced(beam_toml, "kind = \"rectangle\"\nsize = [\"60 mm\", \"12 mm\"]",
                              "kind = \"box\"\nsize = [\"60 mm\", \"12 mm\", \"9 mm\"]");
  text = replaced(text, "thickness = \"20 mm\"\nplane = \"strain\"\n", "");
  text = replaced(text, "cells = [10, 4]", "cells = [4, 2, 2]");
  text = replaced(text, "fix = [\"x\", \"y\"]", "fix = [\"x\", \"y\", \"z\"]");
  for (int i = 0; i < 2; ++i) text.replace(text.find("direction = [0, -1]"), 19, "direction = [0, 0, -1]");
  expect_input_error([&] { draw(text); }, {"experiment.toml", "\"box\"", "2D experiments only", "taut replay"});
}

TEST(DimensionRows, NumbersOfOneRowDoNotCoverEachOther) {
  using plot::Dimension;
  // Short lengths next to each other, whose numbers are wider than they are; a long one over all.
  const std::vector<Dimension> list{{Dimension::above, 0, 2, 0, "first 2 mm"},
                                    {Dimension::above, 2, 4, 0, "second 2 mm"},
                                    {Dimension::above, 4, 6, 0, "third 2 mm"},
                                    {Dimension::above, 0, 60, 0, "all 60 mm"},
                                    {Dimension::below, 0, 60, 0, "all 60 mm"}};
  const plot::Dimensions dimensions(list, 10);
  EXPECT_GE(dimensions.rows(Dimension::above), 2);
  EXPECT_EQ(dimensions.rows(Dimension::below), 1);
  EXPECT_EQ(dimensions.rows(Dimension::left), 0);
  EXPECT_GE(dimensions.highest(Dimension::above), 600);
}

}  // namespace
}  // namespace taut

#include <gtest/gtest.h>

#include <fstream>
#include <sstream>

#include "calib/benches/static_replay.hpp"
#include "calib/files/experiment.hpp"
#include "tests/support/experiment_files.hpp"
#include "tests/support/message.hpp"

// The push-puppet experiment with one thing wrong at a time, and the message a person gets.
namespace taut {
namespace {

using namespace test;

struct Wrong {
  std::string what, from, to;
  std::vector<std::string> parts;
};

std::string module_toml() {
  std::ifstream file(TAUT_SOURCE_DIR "/experiments/push_puppet/experiment.toml");
  std::stringstream text;
  text << file.rdbuf();
  return replaced(text.str(), "../../data/push_puppet_synthetic", TAUT_SOURCE_DIR "/data/push_puppet_synthetic");
}

const std::string kGap = "gap_total = \"17.0 mm\"", kCables = "slack = \"0 mm\"", kBench = "trial = \"trial\"",
                  kMesh = "element = \"quadratic\"", kSupport = "fix = [\"x\", \"y\"]";

const std::vector<Wrong>& mistakes() {
  static const std::vector<Wrong> list{
      {"gap larger than the cells",
       kGap,
       "gap_total = \"60 mm\"",
       {"[geometry]", "60 mm", "cell_length is 11.5 mm", "46 mm"}},
      {"lips that vanish", kGap, kGap + "\nlip_relief = \"2 mm\"", {"lip_relief 2 mm", "lip_thickness 4 mm"}},
      {"cable beside the lips",
       kGap,
       kGap + "\ncable_offset = \"25 mm\"",
       {"cable_offset 25 mm", "17.5 mm to 20.5 mm"}},
      {"stud too long", kGap, kGap + "\nstud_length = \"6 mm\"", {"groove 6.2 mm deep", "3.625 mm"}},
      {"misspelt key", "gap_total", "gap_totl", {"unknown key 'gap_totl'", "did you mean 'gap_total'"}},
      {"k and EA", kCables, kCables + "\nEA = \"1 kN\"", {"[cables]", "either k", "EA"}},
      {"retraction in grams",
       "retraction = \"retraction_mm\"",
       "retraction = \"mass_g\"",
       {"[cables] retraction", "length"}},
      {"one retraction in two units",
       "retraction = \"retraction_mm\"",
       "retraction = \"retraction_mm\"\n[[cables.cable]]\nid = \"upper\"\nretraction = \"retraction_m\"",
       {"same retraction in two units"}},
      {"cable twice",
       kCables,
       kCables + "\n[[cables.cable]]\nid = \"upper\"\n[[cables.cable]]\nid = \"upper\"",
       {"'upper' is there already"}},
      {"cable without points",
       kCables,
       kCables + "\n[[cables.cable]]\nid = \"middle\"",
       {"'middle' has no points", "upper and lower"}},
      {"barrier stiffness by hand",
       "[cables]",
       "[contact]\nstiffness = \"1 kN/m\"\n[cables]",
       {"[contact] stiffness", "set from materials"}},
      {"unknown barrier",
       "[cables]",
       "[contact]\nform = \"pairs\"\n[cables]",
       {"'pairs' is not known", "length_weighted"}},
      {"settings of contact that is off",
       "[cables]",
       "[contact]\non = false\nform = \"pair_sum\"\n[cables]",
       {"unknown key 'form'"}},
      {"obstacle through the module",
       "[cables]",
       "[[contact.obstacle]]\nx = [\"20 mm\", \"20.3 mm\"]\ny = [\"-50 mm\", \"50 mm\"]\n[cables]",
       {"cross each other at rest"}},
      {"obstacle without points",
       "[cables]",
       "[[contact.obstacle]]\nx = []\ny = [\"1 mm\"]\n[cables]",
       {"x", "the list is empty"}},
      {"contact gap too large", kMesh, kMesh + "\ncontact_gap = \"3 mm\"", {"contact gap of 3 mm is too large"}},
      {"contact gap without contact",
       kMesh,
       kMesh + "\ncontact_gap = \"1 um\"\n[contact]\non = false",
       {"contact_gap has no effect"}},
      {"no lip cells", kMesh, kMesh + "\nlip_cells = 0", {"[mesh] lip_cells", "at least 1"}},
      {"region without material", "[materials.plastic]\nlaw", "[materials.foam2]\nlaw", {"no region 'foam2'"}},
      {"zero error of nothing",
       kBench,
       kBench + "\nzero_offset_per = \"retractn\"",
       {"[bench] zero_offset_per", "did you mean 'retraction'"}},
      {"zero errors that stay zero", kBench, kBench + "\nzero_offset_per = \"retraction\"", {"[fit.free.zero_1]"}},
      {"clamp without stiffness",
       kSupport,
       "rotation_stiffness = \"0 Nm/rad\"",
       {"[support] rotation_stiffness", "positive"}},
      {"two clamps",
       kSupport,
       "rotation_stiffness = \"1 Nm/rad\"\n[[support]]\non = \"tip\"\nrotation_stiffness = \"1 Nm/rad\"",
       {"an elastic clamp already"}},
      {"slack longer than the cable", kCables, "slack = \"90 mm\"", {"slack = 0.09 m is outside"}},
      {"profiles", "profiles = \"all\"", "profiles = \"al\"", {"[fit] profiles", "did you mean 'all'"}},
      {"diagnostic of a fixed parameter",
       "parameter = \"E_foam\"",
       "parameter = \"nu_foam\"",
       {"'nu_foam' is not a free parameter"}},
      {"diagnostic per nothing",
       "per = \"retraction\"",
       "per = \"trial\"",
       {"'trial' is not set by the bench", "mass, retraction"}},
      {"free parameter that is none",
       "[fit.free.slack]",
       "[fit.free.slak]",
       {"unknown parameter 'slak'", "did you mean 'slack'"}},
      {"Ogden-Hill without alpha",
       "law = \"neo_hookean\"\nE = \"50 kPa\"",
       "law = \"ogden_hill\"\nE = \"50 kPa\"",
       {"'alpha' is missing"}},
  };
  return list;
}

TEST(WrongModule, EachMistakeIsSaidInOneSentence) {
  TemporaryFolder folder;
  const std::string text = module_toml();
  auto open = [&](const std::string& toml) {
    const Experiment experiment = read_experiment(folder.write("module.toml", toml));
    const StaticReplay bench = make_static_replay(experiment, experiment.mesh, read_trials(experiment.bench));
    free_parameters(experiment, *bench.protocol);
  };
  EXPECT_NO_THROW(open(text));
  for (const Wrong& wrong : mistakes()) {
    SCOPED_TRACE(wrong.what);
    expect_input_error([&] { open(replaced(text, wrong.from, wrong.to)); }, wrong.parts);
  }
}

}  // namespace
}  // namespace taut

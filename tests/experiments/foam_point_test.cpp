#include <gtest/gtest.h>

#include <filesystem>
#include <nlohmann/json.hpp>

#include "tests/support/command.hpp"

// The shipped material-point experiment through the command `taut`.
namespace taut {
namespace {

using namespace test;
using nlohmann::json;
namespace fs = std::filesystem;

const std::string foam_point_toml = TAUT_SOURCE_DIR "/experiments/foam_point/experiment.toml";

TEST(FoamPoint, FitsBothLawsAsItsReadmeSays) {
  const TemporaryFolder folder;
  ASSERT_EQ(done_in(folder / "", {"fit", "--quiet", foam_point_toml, "--out", "run"}).code, 0);
  const json run = json::parse(text_of(folder / "run/fit.json"));
  EXPECT_EQ(run["kind"], "material point");
  EXPECT_EQ(run["status"], "converged");
  EXPECT_EQ(run["readings"].size(), 32u);
  EXPECT_NEAR(run["parameters"][0]["value"].get<double>(), 293e3, 2e3);
  EXPECT_NEAR(run["parameters"][1]["value"].get<double>(), 3.53, 0.02);
  EXPECT_NEAR(run["fit"]["chi_squared"].get<double>(), 194.7, 0.5);
  struct Expected {
    const char* name;
    double E, chi_squared;
    int readings;
  };
  // By an independent program: E in closed form at given alpha, alpha on a grid of 0.05.
  const Expected expected[] = {
      {"neo-Hookean", 226.86e3, 241.12, 32},           {"neo-Hookean, compression", 217.56e3, 28.19, 12},
      {"Ogden-Hill, compression", 236.7e3, 25.81, 12}, {"neo-Hookean, tension", 747.9e3, 17.50, 10},
      {"Ogden-Hill, tension", 536.8e3, 0.0383, 10},    {"Ogden-Hill, shear", 226.9e3, 0.0003, 10}};
  ASSERT_EQ(run["variants"].size(), std::size(expected));
  for (size_t i = 0; i < std::size(expected); ++i) {
    const json& variant = run["variants"][i];
    EXPECT_EQ(variant["name"], expected[i].name);
    EXPECT_EQ(variant["unknowns"], expected[i].readings);
    EXPECT_NEAR(variant["values"][0].get<double>(), expected[i].E, 3e-3 * expected[i].E) << expected[i].name;
    EXPECT_NEAR(variant["chi_squared"].get<double>(), expected[i].chi_squared, 0.01) << expected[i].name;
  }
  EXPECT_TRUE(run["variants"][0]["values"][1].is_null()) << "a neo-Hookean solid has no exponent";

  EXPECT_TRUE(fs::exists(folder / "run/figures/stress_strain.png"));
  EXPECT_FALSE(fs::exists(folder / "run/figures/force_displacement.png"));
  const std::string html = text_of(folder / "run/report.html"), before = text_of(folder / "run/predictions.csv");
  EXPECT_NE(html.find("Stress and strain"), std::string::npos);
  EXPECT_NE(html.find("[kPa]"), std::string::npos);
  EXPECT_EQ(html.find("[mm]"), std::string::npos) << "a material point has no lengths";
  EXPECT_NE(before.find("measured_Pa"), std::string::npos);
  done_in(folder / "", {"report", "run"});
  EXPECT_EQ(text_of(folder / "run/report.html"), html);
  EXPECT_EQ(text_of(folder / "run/predictions.csv"), before);
}

TEST(FoamPoint, CheckSaysWhatItIsReplayPredictsItAndDrawSaysWhatToUse) {
  const TemporaryFolder folder;
  const std::string here = folder / "";
  expect_holds(done_in(here, {"check", foam_point_toml}).out, {"12 readings, strains from -60 to -3 %"});
  done_in(here, {"replay", foam_point_toml, "--out", "replay"});
  expect_holds(text_of(folder / "replay/predictions.csv"), {"predicted_Pa"});
  const Outcome draw = run_in(here, {"draw", foam_point_toml});
  EXPECT_EQ(draw.code, 2);
  expect_holds(draw.err, {"`taut fit`"});
}

}  // namespace
}  // namespace taut

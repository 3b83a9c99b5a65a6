#include "calib/runs/comparison.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "calib/studies/tuning.hpp"
#include "sim/core/error.hpp"
#include "sim/files/toml_keys.hpp"
#include "tests/support/experiment_files.hpp"

// What runs differ by, and what a calibration leaves open of another quantity: numbers that can be worked out by hand.
namespace taut {
namespace {

using namespace test;

/// A run with one logarithmic parameter E [Pa] of relative standard error `relative` and a reading.
RunRecord run_with(double E, double relative, double measured) {
  RunRecord record;
  record.channels = {{"tip", "length", "m", "displacement"}};
  record.controls = {{"pull", "force", "N", "pull"}};
  ParameterEstimate& e = record.fit.parameters.emplace_back();
  e.spec = {"E_foam", "E", "Pa", 1, 1e13, "modulus"};
  e.spec.logarithmic = true;
  e.value = E;
  e.standard_error = relative * E;
  record.fit.status = FitStatus::converged;
  record.fit.covariance = Eigen::MatrixXd::Constant(1, 1, relative * relative);
  record.readings.push_back(
      {.line = 2, .trial = "a", .channel = "tip", .controls = {0.1}, .measured = measured, .sigma = 1e-4});
  return record;
}

Share share(const std::string& source, double bias, double error) {
  Share one;
  one.source = source;
  one.bias = {bias};
  one.error = {error};
  return one;
}

TEST(Comparison, TheNoiseOfBothAddsUp) {
  const RunComparison found = compare(run_with(100e3, 0.03, 1e-3), run_with(120e3, 0.04, 1.1e-3), {});
  EXPECT_NEAR(found.parameters[0].in_sigmas, std::log(1.2) / 0.05, 1e-9);
  EXPECT_NEAR(found.parameters[0].sigma, 0.05 * 100e3, 1e-6);
  EXPECT_NEAR(found.chi_squared, std::pow(std::log(1.2) / 0.05, 2), 1e-9);
  EXPECT_NEAR(found.readings[0].in_sigmas, 0.1e-3 / (std::sqrt(2.0) * 1e-4), 1e-9);
  EXPECT_TRUE(found.differs(3));
  EXPECT_FALSE(compare(run_with(100e3, 0.03, 1e-3), run_with(110e3, 0.04, 1.1e-3), {}).differs(3));
}

TEST(Comparison, SharesInCommonCancelAndOthersCount) {
  RunRecord first = run_with(100e3, 0.03, 1e-3), second = run_with(120e3, 0.04, 1.1e-3);
  first.shares = {share("mesh", 5e3, 1e3), share("size_x", 0, 10e3)};
  second.shares = {share("mesh", 6e3, 1.2e3), share("size_x", 0, 12e3)};  // the same fractions of the value
  const RunComparison common = compare(first, second, {});
  EXPECT_NEAR(common.parameters[0].in_sigmas, std::log(1.2) / 0.05, 1e-9);
  EXPECT_EQ(common.parameters[0].cancelled, (std::vector<std::string>{"mesh", "size_x"}));
  const RunComparison apart = compare(first, second, {{"geometry.size_x", "60 mm", "61 mm"}});
  EXPECT_EQ(apart.parameters[0].cancelled, std::vector<std::string>{"mesh"});
  const double sigma = std::sqrt(0.05 * 0.05 + 2 * std::pow(0.1 / 1.959963984540054, 2));
  EXPECT_NEAR(apart.parameters[0].in_sigmas, std::log(1.2) / sigma, 1e-9);
}

TEST(Comparison, OfTheSameReadingsNoiseIsCommon) {
  const RunComparison found = compare(run_with(100e3, 0.03, 1e-3), run_with(101e3, 0.03, 1e-3), {});
  EXPECT_TRUE(found.same_readings);
  EXPECT_NEAR(found.parameters[0].in_sigmas, std::log(1.01) / 0.03, 1e-9);
  EXPECT_TRUE(found.differs(3));  // by a third of a sigma, which noise cannot have done
  EXPECT_FALSE(compare(run_with(100e3, 0.03, 1e-3), run_with(100.1e3, 0.03, 1e-3), {}).differs(3));
}

TEST(Comparison, ARunWithoutAResultIsRefused) {
  RunRecord none = run_with(100e3, 0.03, 1e-3);
  none.fit.covariance.resize(0, 0);
  EXPECT_THROW(compare(none, run_with(100e3, 0.03, 1e-3), {}), InputError);
}

TEST(Comparison, FilesAreComparedAsQuantitiesKeyByKey) {
  const TemporaryFolder folder;
  const std::string a = folder.write("a.toml", beam_toml);
  std::string text = replaced(beam_toml, "[\"60 mm\", \"12 mm\"]", "[\"6 cm\", \"0.012 m\"] # a comment");
  text = replaced(text, "title = \"A small beam\"", "title = \"Another\"");
  EXPECT_TRUE(input_differences(a, folder.write("b.toml", text)).empty());
  text = replaced(text, "on = \"xmax\"\ndirection = [0, -1]\ncolumn = \"pull_N\"",
                  "on = \"xmax\"\ndirection = [0, 1]\ncolumn = \"pull_N\"");
  text = replaced(text, "E = \"100 kPa\"", "E = \"0.2 MPa\"");
  text = replaced(text, "plane = \"strain\"\n", "");
  const std::vector<InputDifference> found = input_differences(a, folder.write("c.toml", text));
  ASSERT_EQ(found.size(), 3u);
  EXPECT_EQ(found[0].key, "geometry.plane");
  EXPECT_EQ(found[0].second, "");
  EXPECT_EQ(found[1].key, "load.pull.direction");
  EXPECT_EQ(found[1].first, "[0, -1]");
  EXPECT_EQ(found[2].key, "materials.foam.E");
  EXPECT_EQ(found[2].second, "0.2 MPa");
  EXPECT_THROW(toml_values(folder / "nowhere.toml"), InputError);
  EXPECT_THROW(toml_values(folder.write("d.toml", "a = [")), InputError);
}

TEST(HalfWidths, AddNoiseAndSharesAsRootOfSquares) {
  RunRecord record = run_with(100e3, 0.03, 1e-3);
  ParameterEstimate& slack = record.fit.parameters.emplace_back();
  slack.spec = {"slack", "s", "m", -1, 1, "slack"};
  slack.value = 1e-3;
  record.fit.covariance = Eigen::Matrix2d{{9e-4, 1e-6}, {1e-6, 4e-8}};
  Share mesh;
  mesh.bias = {2e3, 1e-5};
  mesh.error = {1e3, 2e-5};
  Share unstated = mesh, unknown = mesh;
  unstated.counted = false;
  unknown.bias = {NAN, NAN};
  const Eigen::Vector2d gradient(50, -3000);  // by ln E and by slack
  const HalfWidths half = half_widths(record.fit, {mesh, unstated, unknown}, gradient);
  const double noise = 1.959963984540054 * std::sqrt(2500 * 9e-4 - 2 * 150000 * 1e-6 + 9e6 * 4e-8);
  EXPECT_NEAR(half.noise, noise, 1e-9 * noise);
  const double shares = std::abs(50 * 0.02 - 3000 * 1e-5) + 50 * 0.01 + 3000 * 2e-5;
  EXPECT_NEAR(half.total, std::hypot(noise, shares), 1e-9);
  Share length;  // one number: what it does to both parameters partly cancels
  length.bias = {0, 0};
  length.moves = {1e3, 1e-4};
  length.error = {1e3, 1e-4};
  EXPECT_NEAR(half_widths(record.fit, {length}, gradient).total, std::hypot(noise, 50 * 0.01 - 3000 * 1e-4), 1e-9);
}

}  // namespace
}  // namespace taut
